"""What true depths say of a frame: the road, the things on it, and how far each column is free.

The definitions are those by which results on KITTI 2015 are scored in this project's tables. Axes: x right, y down,
z forward, from the left camera, metres.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadblock.values.checks import FloatArray
from roadblock.values.scene import NEAREST_FACE_PERCENT
from roadblock.values.true_map import TrueMap

DRAWS = 600
PLANE_TO_M = 25.0
SLICE_M, SLICE_POINTS = 2.0, 400
"""From each slice of depth so many points are taken at most."""
LEAST_POINTS = 200
LEAST_PX, FARTHEST_M = 400, 50.0
"""Smaller and farther things are not judged."""
STEP_PX, HALF_WINDOW_PX = 4, 2
FREE_TO_M = 40.0


@dataclass(frozen=True, eq=False)
class TrueRoad:
    """Road as y = h + s z + r x + q z^2: `bent` holds (h, s, r, q), `plane` the near part's (h, s, r)."""

    bent: FloatArray
    plane: FloatArray

    def height_m(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Return heights over the road."""
        h, s, r, q = self.bent
        return np.asarray(h + s * z + r * x + q * z * z - y)

    def pose(self, baseline_m: float) -> dict[str, float]:
        """Return `height_m`, `pitch_rad`, `roll_rad` as in a frame's `ground`, from between the cameras."""
        h, s, r = self.plane.tolist()
        height_m = (h + r * baseline_m / 2) / np.sqrt(1 + s**2 + r**2)
        return {"height_m": float(height_m), "pitch_rad": float(np.arctan(-s)), "roll_rad": float(np.arctan(-r))}


@dataclass(frozen=True)
class TrueThing:
    """One thing of a frame: its box, median and nearest (10th percentile) depth, 90th percentile, metres."""

    id: int
    box_px: tuple[int, int, int, int]
    median_m: float
    range_m: float
    far_m: float


@dataclass(frozen=True, eq=False)
class TrueFrame:
    """A frame's truth, ready to be compared with.

    Attributes
    ----------
    z_m, height_m
        (h, w) depth, 0 where unknown, and height over the road, NaN where unknown.
    road
        None where no road was found.
    things
        Those that are large and near enough.
    columns, first_m, ground_m
        (n,) columns; the first thing in each, NaN where none is; how far its road is seen, NaN where it is not.
    """

    z_m: NDArray[np.float32]
    height_m: NDArray[np.float32]
    road: TrueRoad | None
    things: tuple[TrueThing, ...]
    columns: NDArray[np.int64]
    first_m: FloatArray
    ground_m: FloatArray


def tolerance(range_m: ArrayLike, least_m: float, share: float) -> FloatArray:
    """Return the larger of a length and a share of the range."""
    return np.maximum(least_m, share * np.asarray(range_m, float))


def true_frame(truth: TrueMap, offset_px: float = 0.0) -> TrueFrame:
    """Return what a map says; `offset_px` is added to its disparities first."""
    v, u = np.nonzero(truth.d_px > 0)
    d_px = np.maximum(truth.d_px[v, u] + np.float32(offset_px), 0.5).astype(float)
    z = truth.f_px * truth.baseline_m / d_px
    x, y = (u - truth.cx_px) / truth.f_px * z, (v - truth.cy_px) / truth.f_px * z
    road = fit_road(x, y, z, np.random.default_rng(0))
    z_m = np.zeros(truth.d_px.shape, np.float32)
    height_m = np.full(truth.d_px.shape, np.nan, np.float32)
    z_m[v, u] = z
    height_m[v, u] = np.nan if road is None else road.height_m(x, y, z)
    columns = np.arange(STEP_PX, truth.d_px.shape[1] - STEP_PX, STEP_PX)
    seen = np.array([_free_column(z_m, height_m, u) for u in columns]).reshape(-1, 2)
    return TrueFrame(z_m, height_m, road, _things(truth.ids, z_m), columns, *seen.T)


def _things(ids: NDArray[np.uint16], z_m: NDArray[np.float32]) -> tuple[TrueThing, ...]:
    found = []
    for number in np.unique(ids[ids > 0]).tolist():
        mask = ids == number
        z = z_m[mask & (z_m > 0)]
        if mask.sum() < LEAST_PX or len(z) < 10 or np.median(z) > FARTHEST_M:
            continue
        v, u = np.nonzero(mask)
        near, far = np.percentile(z, (NEAREST_FACE_PERCENT, 100 - NEAREST_FACE_PERCENT))
        box = (int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1)
        found.append(TrueThing(number, box, float(np.median(z)), float(near), float(far)))
    return tuple(found)


def _free_column(z_m: NDArray[np.float32], height_m: NDArray[np.float32], u: int) -> tuple[float, float]:
    """Return depth of the first thing (4 pixels, 0.3 to 2.5 m high, close together) and of the last road seen."""
    z, height = (a[:, u - HALF_WINDOW_PX : u + HALF_WINDOW_PX + 1] for a in (z_m, height_m))
    standing = np.sort(z[(z > 0) & (height > 0.3) & (height < 2.5) & (z <= FREE_TO_M + 4)])
    road = np.sort(z[(z > 0) & (np.abs(height) < 0.2)])
    first = np.nan
    if len(standing) > 3:
        together = standing[3:] <= standing[:-3] + tolerance(standing[:-3], 0.5, 0.05)
        if together.any() and standing[together.argmax()] <= FREE_TO_M:
            first = float(standing[together.argmax()])
    return first, float(road[-3]) if len(road) >= 5 else np.nan


def fit_road(x: FloatArray, y: FloatArray, z: FloatArray, rng: np.random.Generator) -> TrueRoad | None:
    """Return the road through points (n,): RANSAC for a plane up to 25 m, then least squares that may bend, to 50 m.

    Returns
    -------
    None where too few points lie low enough, or none of the planes tried is a road.
    """
    low = np.flatnonzero((z < 50) & (z > 3) & (np.abs(x) < 12) & (y > 0.7) & (y < 2.3 + 0.05 * z))
    slices = (z[low] / SLICE_M).astype(int)
    parts = [low[slices == k] for k in np.unique(slices)]
    parts = [p if len(p) <= SLICE_POINTS else rng.choice(p, SLICE_POINTS, replace=False) for p in parts]
    if sum(map(len, parts)) < LEAST_POINTS:
        return None
    chosen = np.concatenate(parts)
    x, y, z = x[chosen], y[chosen], z[chosen]
    near = z < PLANE_TO_M
    plane = _best_plane(x[near], y[near], z[near], rng)
    if plane is None:
        return None
    A = np.stack([np.ones_like(z), z, x], -1)
    for limit_m in (0.10, 0.06, 0.06):
        on = near & (np.abs(y - A @ plane) < limit_m)
        plane = np.asarray(np.linalg.lstsq(A[on], y[on], rcond=None)[0], float)
    bent = np.append(plane, 0.0)
    A = np.append(A, (z * z)[:, None], axis=1)
    straight = np.array([[0.0, 0.0, 0.0, 3e4]])  # unless far road says otherwise
    for reach_m in (30, 35, 40, 45, 50):
        on = (np.abs(y - A @ bent) < 0.06 + 0.003 * z) & (z < reach_m) & (np.abs(x) < 8)
        weight = 1 / (0.05 + 0.003 * z[on])
        rows, sides = np.concatenate([A[on] * weight[:, None], straight]), np.append(y[on] * weight, 0.0)
        bent = np.linalg.lstsq(rows, sides, rcond=None)[0]
    return TrueRoad(bent, plane)


def _best_plane(x: FloatArray, y: FloatArray, z: FloatArray, rng: np.random.Generator) -> FloatArray | None:
    best = -1.0
    plane: FloatArray | None = None
    for _ in range(DRAWS if len(x) >= 3 else 0):
        i = rng.choice(len(x), 3, replace=False)
        try:
            tried = np.linalg.solve(np.stack([np.ones(3), z[i], x[i]], -1), y[i])
        except np.linalg.LinAlgError:
            continue
        if not (1.3 < tried[0] < 2.0 and np.abs(tried[1:]).max() < 0.08):
            continue
        rest = y - tried[0] - tried[1] * z - tried[2] * x
        score = 5 * np.sum(np.abs(rest) < 0.05) - 3 * np.sum(rest > 0.25)  # much below the road speaks against it
        if score > best:
            best, plane = float(score), np.asarray(tried, float)
    return plane
