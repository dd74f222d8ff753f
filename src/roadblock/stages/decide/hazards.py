"""What a car could run into, as points on the road with velocities; and which of the road was seen to be free."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import vehicle_from_car
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.scene import FreeSpace, Obstacle

COMPACT_M = 2.5
"""The face of what is wider is not a straight line across the road: its columns of free space say where it is."""
FACE_STEP_M = 0.3
"""Between the points of a face."""
BESIDE_SHARE = 0.15
"""A column of free space that ends so near to an obstacle's range ends there because of it."""
NEIGHBOUR_SHARE = 0.1
"""Columns that end alone, by so much of their range, say nothing."""
SLOW_MPS = 0.5
"""What is no faster stands."""
LONGEST_COAST_S = 0.3


class Hazards(NamedTuple):
    """Points (n) in the axes of the vehicle, seen from the cameras.

    `at_m` (n, 2) forward and left; `velocity_mps` (n, 2) over ground; `sigma_m` of the distance, `sigma_mps` of the
    velocity; `number` of the track, 0 = none.
    """

    at_m: FloatArray
    velocity_mps: FloatArray
    sigma_m: FloatArray
    sigma_mps: FloatArray
    number: NDArray[np.int64]

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(n,) whether it moves."""
        return np.asarray(np.hypot(*self.velocity_mps.T) > SLOW_MPS)


class Layout:
    """Where columns of the picture lead to on the road; one rig, one layout."""

    def __init__(self, rectification: Rectification, T_vehicle_car: FloatArray | None) -> None:
        self.rectification = rectification
        T = vehicle_from_car(T_vehicle_car)
        self.R, self.origin_m = T[:3, :3], T[:2, 3]

    def points(self, u_px: FloatArray, range_m: FloatArray) -> FloatArray:
        """Return (n, 2) forward and left of columns at forward distances."""
        r = self.rectification
        x = (u_px - r.cx_px) / r.f_px * range_m - r.baseline_m / 2
        return np.asarray(np.outer(x, self.R[:2, 0]) + np.outer(range_m, self.R[:2, 2]))

    def columns(self, at_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return in which columns, and how far ahead, points (..., 2) on the road are; NaN behind the cameras."""
        r = self.rectification
        x, z = at_m @ self.R[:2, 0], at_m @ self.R[:2, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (x + r.baseline_m / 2) / z * r.f_px + r.cx_px
        return np.where(z > 0, u, np.nan), z

    def hazards(self, obstacles: Sequence[Obstacle], free: FreeSpace) -> Hazards:
        """Return all points: faces of compact obstacles that have a track, and what ends free space."""
        tracked = [o for o in obstacles if o.track is not None and o.track.coasted_s <= LONGEST_COAST_S]
        faces = [self._face(o) for o in tracked if o.size_m[0] <= COMPACT_M]
        return Hazards(*(np.concatenate(part) for part in zip(*faces, self._ends(tracked, free), strict=True)))

    def _face(self, o: Obstacle) -> Hazards:
        assert o.track is not None  # noqa: S101
        half = o.size_m[0] / 2
        aside = np.linspace(-half, half, max(2, int(np.ceil(2 * half / FACE_STEP_M)) + 1))
        forward, left = o.position_m[:2] - self.origin_m
        n = len(aside)
        return Hazards(
            np.stack([np.full(n, forward), left + aside], 1),
            np.tile(velocity_mps(o), (n, 1)),
            np.full(n, o.range_sigma_m),
            np.full(n, o.track.velocity_sigma_mps.max()),
            np.full(n, o.track.id),
        )

    def _ends(self, tracked: Sequence[Obstacle], free: FreeSpace) -> Hazards:
        z = free.range_m
        blocked = np.isfinite(z) if free.is_blocked is None else free.is_blocked & np.isfinite(z)
        with np.errstate(invalid="ignore"):
            near = np.abs(np.diff(z)) <= NEIGHBOUR_SHARE * np.minimum(z[1:], z[:-1])
        near &= blocked[1:] & blocked[:-1]
        at = np.flatnonzero(np.append(near, False) | np.insert(near, 0, False))
        r = self.rectification
        velocity, sigma_mps = np.zeros((len(at), 2)), np.zeros(len(at))
        number = np.zeros(len(at), np.int64)
        for o in tracked:
            assert o.track is not None  # noqa: S101
            u0, _, u1, _ = o.box_px
            mine = (free.u_px[at] >= u0) & (free.u_px[at] < u1)
            mine &= np.abs(z[at] - o.range_m) <= BESIDE_SHARE * o.range_m + np.nan_to_num(o.size_m[2])
            velocity[mine], number[mine] = velocity_mps(o), o.track.id
            sigma_mps[mine] = o.track.velocity_sigma_mps.max()
        sigma_m = z[at] ** 2 / (r.f_px * r.baseline_m) * 0.5
        return Hazards(self.points(free.u_px[at], z[at]), velocity, sigma_m, sigma_mps, number)

    def kerbs(self, free: FreeSpace) -> FloatArray:
        """Return (k, 2) where kerbs and verges are; none where they were not looked for."""
        if free.edges is None:
            return np.zeros((0, 2))
        at = np.isfinite(free.edges.range_m)
        return self.points(free.u_px[at], free.edges.range_m[at])

    def is_seen_free(self, at_m: FloatArray, free: FreeSpace) -> NDArray[np.bool_]:
        """Return for points (..., 2) whether road was seen there, before anything that ends it."""
        u, z = self.columns(at_m)
        with np.errstate(invalid="ignore"):
            step = float(free.u_px[1] - free.u_px[0]) if len(free.u_px) > 1 else 1.0
            column = np.rint((u - free.u_px[0]) / step)
            inside = (column >= 0) & (column < len(free.u_px))
            reach = free.range_m[np.where(inside, column, 0).astype(int)]
            return np.asarray(inside & (z <= reach))


def velocity_mps(o: Obstacle) -> FloatArray:
    """Return (2,) velocity over ground as far as it is known: what does not move for sure stands."""
    assert o.track is not None  # noqa: S101
    if o.track.motion == "standing" or not o.track.is_over_ground:
        return np.zeros(2)
    v, sigma = o.track.velocity_mps, o.track.velocity_sigma_mps
    return np.asarray(v if o.track.motion == "moving" else np.where(np.abs(v) > 2 * sigma, v, 0.0))
