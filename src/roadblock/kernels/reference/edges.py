"""Where the road ends without a wall, readably: kerbs and verges, per column of cells.

Shared by all: `height` and `z` are (rows, columns) float32 metres over the road and ahead, NaN where unknown. Kernels
write into arrays that the caller owns.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

NO_EDGE, KERB, VERGE = 0, 1, 2
BESIDE = 1
"""A column is looked at together with this many to either side."""
BEFORE_M = 0.5
"""What stands is no edge: edges end this far before the end of the free space."""
ROAD_ROWS = 2
"""So many rows of road must be seen below an edge."""
FOLLOW_M = 1.5
"""The road before the edge takes on the height of what goes on for so long."""
EDGE_ROWS, RUN_M = 3, 0.3
"""What is higher must go on for so many rows, and so many metres: what stands upright on the road does not."""
BACK_M, LONG_M = 0.2, 1.2
"""From here to there behind its edge, the ground is past the kerb's face and judged."""
ROUGH_M, VERGE_M = 0.008, 0.25
"""What is rougher or higher than this behind its edge is no pavement."""
ALONG, SLOPE, AGREE = 5, 1.2, 6
"""Of so many columns to either side, so many must have an edge that this slope, in rows a column, joins."""


def find_edges(
    height: Singles,
    z: Singles,
    free: Floats,
    noise_per_m: float,
    limits_m: Floats,
    edge: Floats,
    tall: Floats,
    kind: NDArray[np.uint8],
) -> None:
    """Write where each column, from below, steps up to a kerb or a verge, and how high that is.

    Parameters
    ----------
    height, z
        See the module.
    free
        (columns,) range of the free space, metres; NaN where it is unknown.
    noise_per_m
        Standard deviation of a cell's height per metre of its range. Beyond where it is half the least rise, nothing is
        looked at.
    limits_m
        (least rise, greatest height), metres.
    edge, tall, kind
        (columns,), written: range and height of the edge (mean of what follows it), NaN without one; `NO_EDGE`,
        `KERB` or `VERGE`.
    """
    columns = height.shape[1]
    first, found = np.full(columns, -1), np.zeros(columns, np.uint8)
    edge[:], tall[:], kind[:] = np.nan, np.nan, NO_EDGE
    for column in range(columns):
        step = _step_of(height, z, column, free[column], noise_per_m, limits_m)
        if step is not None:
            first[column], edge[column], tall[column], found[column] = step
    for column in np.flatnonzero(first >= 0).tolist():
        around = np.arange(max(0, column - ALONG), min(columns, column + ALONG + 1))
        joined = (first[around] >= 0) & (abs(first[around] - first[column]) <= BESIDE + SLOPE * abs(around - column))
        if joined.sum() >= AGREE:
            kind[column] = VERGE if 2 * (found[around][joined] == VERGE).sum() > joined.sum() else KERB
    edge[kind == NO_EDGE] = tall[kind == NO_EDGE] = np.nan


def _step_of(
    height: Singles, z: Singles, column: int, free_m: float, noise_per_m: float, limits_m: Floats
) -> tuple[int, float, float, int] | None:
    """Return the row, range, height and kind of a column's first step; None if there is none."""
    rise_m, high_m = limits_m
    beside = slice(max(0, column - BESIDE), column + BESIDE + 1)
    base_m, last_m, seen, first = 0.0, 0.0, 0, -1
    run: list[tuple[float, float]] = []
    for row in range(len(height) - 1, -1, -1):
        h = height[row, beside].astype(float)
        near = (h > -2 * high_m) & (h < 2 * high_m)
        if not near.any():
            continue
        h_m, z_m = float(h[near].mean()), float(z[row, beside].astype(float)[near].mean())
        noise_m = noise_per_m * z_m
        if z_m > free_m - BEFORE_M or noise_m > rise_m / 2:
            break
        up_m = h_m - base_m
        if seen >= ROAD_ROWS and up_m > max(rise_m, 2 * noise_m) and h_m < high_m + 2 * noise_m:
            if not run:
                first = row
            run.append((z_m, up_m))
            if len(run) >= EDGE_ROWS and z_m - run[0][0] >= LONG_M:
                break
        elif run and up_m > rise_m / 2:
            continue
        elif _goes_on(run):
            break
        else:
            run = []
            if abs(up_m) < rise_m:
                share = 1.0 if seen == 0 else min(1.0, max(0.0, z_m - last_m) / FOLLOW_M)
                base_m, last_m, seen = base_m + share * up_m, max(z_m, last_m), seen + 1
    if not _goes_on(run):
        return None
    ups = np.array([up_m for z_m, up_m in run if z_m - run[0][0] >= BACK_M])
    rough_m2 = max(0.0, float(ups.var())) - (noise_per_m * run[0][0]) ** 2
    is_verge = rough_m2 > ROUGH_M**2 or ups.mean() > VERGE_M
    return first, run[0][0], float(ups.mean()), VERGE if is_verge else KERB


def _goes_on(run: list[tuple[float, float]]) -> bool:
    return len(run) >= EDGE_ROWS and run[-1][0] - run[0][0] >= RUN_M
