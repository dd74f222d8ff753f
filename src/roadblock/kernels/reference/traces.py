"""Whether things left where they were, and came to where the road was free; readably.

Free space is a range for each image column; `grid` is (middle of the first column, distance of two, px). `twin` is (f,
cx, cy, baseline) of the rectified cameras, px and m. The outline of a wall along the road goes along with the vehicle,
as its near end is where the picture ends: it seems to move, but nothing of it has left its place.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOST = 12
"""Of so many columns of a thing at most is asked where they were, evenly spread."""
NEAREST_M = 0.5
"""Nothing is compared that is nearer."""
CLEAR_M, SIGMAS, COLUMN_SIGMA_PX = 0.3, 2.0, 0.25
"""Road must be seen so far behind a point for it to be free: metres, and standard deviations of its range."""
BESIDE_SHARE = 0.15
"""A column that ends so near to an obstacle's range ends there because of it."""
LEAST, MOVED_SHARE = 2, 0.5
"""So many columns of a thing, and so many of those known, must have come to free road or left it free."""
FAR_ENOUGH = 2.0
"""What seems to have gone so many times as far as free road can be told from it should have done so."""


def slack(z_m: Floats | float, twin: Floats) -> Floats:
    """Return how far behind points at these forward distances the road must be free, m."""
    return np.asarray(CLEAR_M + SIGMAS * COLUMN_SIGMA_PX * np.square(z_m) / (twin[0] * twin[3]))


def ends(span: Floats, grid: Floats, range_m: Floats, is_blocked: Flags, twin: Floats) -> Floats:
    """Return (k, 2) x and z, car frame, at which the columns of a thing end.

    Parameters
    ----------
    span
        (4,) first column and the one behind the last, px; least and largest forward distance of the thing, m.
    grid, range_m, is_blocked
        The free space, (c,).
    """
    u = grid[0] + grid[1] * np.arange(len(range_m))
    mine = (u >= span[0]) & (u < span[1]) & (range_m >= span[2]) & (range_m <= span[3]) & is_blocked
    index = np.flatnonzero(mine)
    index = index[:: 1 + len(index) // MOST]
    z = range_m[index]
    return np.stack([(u[index] - twin[1]) / twin[0] * z - twin[3] / 2, z], -1)


def asked(points: Floats, T: Floats, grid: Floats, range_m: Floats, is_blocked: Flags, twin: Floats) -> tuple[int, int]:
    """Return how many of some points (k, 2) are free road in another frame, and at how many something stands.

    Both columns beside a point must be known. `T` (4, 4) leads there.
    """
    free = taken = 0
    for x, z in points:
        there_x, there_z = T[0, 0] * x + T[0, 2] * z + T[0, 3], T[2, 0] * x + T[2, 2] * z + T[2, 3]
        if there_z < NEAREST_M:
            continue
        column = ((there_x + twin[3] / 2) / there_z * twin[0] + twin[1] - grid[0]) / grid[1]
        if not 0 <= column < len(range_m) - 1:
            continue
        beside = slice(int(column), int(column) + 2)
        low, high = range_m[beside].min(), range_m[beside].max()  # NaN if either is
        slack_m = slack(there_z, twin)
        free += bool(low > there_z + slack_m)
        taken += bool(low <= there_z + slack_m and high > there_z - slack_m and is_blocked[beside].all())
    return free, taken


def revisit(
    slots: NDArray[np.int64],
    spans: Floats,
    spans_then: Floats,
    grid: Floats,
    range_m: Floats,
    is_blocked: Flags,
    ranges_then: Floats,
    blocked_then: Flags,
    T_now_then: Floats,
    twin: Floats,
) -> NDArray[np.int64]:
    """Return (n, 4) how many columns of things are where the road was free, and where something stood.

    The other two numbers: at how many that they had then the road is free now, and at how many something stands.

    Parameters
    ----------
    slots
        (n,) with which earlier frame each is compared; -1 = with none.
    spans, spans_then
        (n, 4) now and (n, k, 4) in the earlier frames, as in `ends`.
    grid, range_m, is_blocked, ranges_then, blocked_then
        The free space now, (c,), and then, (k, c).
    T_now_then
        (k, 4, 4) how the cameras moved since, car frame.
    """
    counts = np.zeros((len(slots), 4), np.int64)
    for i, k in enumerate(slots):
        if k >= 0:
            here = ends(spans[i], grid, range_m, is_blocked, twin)
            there = ends(spans_then[i, k], grid, ranges_then[k], blocked_then[k], twin)
            T = T_now_then[k]
            counts[i, :2] = asked(here, np.linalg.inv(T), grid, ranges_then[k], blocked_then[k], twin)
            counts[i, 2:] = asked(there, T, grid, range_m, is_blocked, twin)
    return counts


def spans(boxes: Floats, range_m: Floats, long_m: Floats) -> Floats:
    """Return (n, 4) the columns and ranges of things, as in `ends`.

    Parameters
    ----------
    boxes, range_m, long_m
        (n, 4) u0, v0, u1, v1, px; (n,) how far; (n,) how long, m.
    """
    near_m = BESIDE_SHARE * range_m + long_m
    return np.stack([boxes[:, 0], boxes[:, 2], range_m - near_m, range_m + near_m], 1)


def judge(
    spans_now: Floats,
    spans_then: Floats,
    is_seen: Flags,
    speed_mps: Floats,
    lag_s: Floats,
    grid: Floats,
    range_m: Floats,
    is_blocked: Flags,
    ranges_then: Floats,
    blocked_then: Flags,
    T_now_then: Floats,
    twin: Floats,
) -> tuple[Flags, Flags]:
    """Return which things (n,) have moved from where they were, and which only seem to have.

    Each is compared with the oldest frame that it was in.

    Parameters
    ----------
    is_seen, speed_mps
        (n,) which are seen now, and how fast they seem to be.
    lag_s
        (k,) how long ago the earlier frames were; 0 = not to be used.
    spans_now, spans_then, grid, range_m, is_blocked, ranges_then, blocked_then, T_now_then
        As in `revisit`; columns that end at 0 stand for not seen then.
    """
    lags_s = np.where(is_seen[:, None] & (spans_then[..., 1] > 0), lag_s, 0.0)
    oldest = lags_s.argmax(1)
    longest_s = lags_s.max(1, initial=0.0)
    came_free, came_taken, left_free, left_taken = revisit(
        np.where(longest_s > 0, oldest, -1), spans_now, spans_then, grid, range_m, is_blocked,
        ranges_then, blocked_then, T_now_then, twin,
    ).T  # fmt: skip
    moved = (came_free >= LEAST) & (came_free > MOVED_SHARE * (came_free + came_taken))
    moved |= (left_free >= LEAST) & (left_free > MOVED_SHARE * (left_free + left_taken))
    should_m = FAR_ENOUGH * slack((spans_now[:, 2] + spans_now[:, 3]) / 2, twin)
    return moved, ~moved & (speed_mps * longest_s > should_m)
