"""What a car could run into, as points on the road with velocities; and which of the road was seen to be free."""

from collections.abc import Collection, Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import vehicle_from_car
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.scene import FreeSpace, Obstacle

FACE_STEP_M = 0.3
"""Between the points of a face."""
BESIDE_SHARE = 0.15
"""A column of free space that ends so near to an obstacle's range ends there because of it."""
NEIGHBOUR_SHARE = 0.1
"""Columns that end alone, by so much of their range, say nothing."""
SLOW_MPS = 0.5
"""What is no faster stands."""
LONGEST_COAST_S = 0.3
SETTLED_S = 0.5
"""A younger track's velocity is not known, whatever it says."""
YOUNG_S = 0.8
"""And a track older than this that still does not tell is no longer waited for."""
SETTLED_DOUBT, YOUNG_DOUBT = 0.6, 0.85
"""What may move or stand counts once so much of the hardest braking is needed if it does as it seems to."""
BORDER_SHARE = 0.04
"""So near to the picture's side, by its width, nothing has a velocity: ends of walls go along with the car there."""
COLUMN_SIGMA_PX = 0.25
"""Noise of the disparity at which a column ends."""


class Hazards(NamedTuple):
    """Points (n) in the axes of the vehicle, seen from the cameras.

    `at_m` (n, 2) forward and left; `velocity_mps` (n, 2) over ground; `sigma_m` of the distance, `sigma_mps` (n, 2) of
    the velocity; `number` of the track, 0 = none; `doubt`: the share of the hardest braking that must be needed before
    it counts at all, 0 where it is known that it moves, or that it stands.
    """

    at_m: FloatArray
    velocity_mps: FloatArray
    sigma_m: FloatArray
    sigma_mps: FloatArray
    number: NDArray[np.int64]
    doubt: FloatArray

    @classmethod
    def of(
        cls,
        at_m: FloatArray,
        velocity_mps: FloatArray = np.zeros(2),  # noqa: B008 - never written to
        sigma_m: FloatArray | float = 0.2,
        sigma_mps: FloatArray = np.zeros(2),  # noqa: B008
        number: int = 0,
        doubt: float = 0.0,
    ) -> Self:
        """Return points (n, 2) that belong to one thing."""
        n = len(at_m)
        speeds = np.broadcast_to(velocity_mps, (n, 2))
        sigmas = np.broadcast_to(np.asarray(sigma_m, float), n)
        sigmas_mps = np.broadcast_to(sigma_mps, (n, 2))
        return cls(at_m, speeds, sigmas, sigmas_mps, np.full(n, number), np.full(n, doubt))

    @classmethod
    def joined(cls, parts: Sequence["Hazards"]) -> Self:
        """Return the points of all, at least one."""
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def where(self, mask: NDArray[np.bool_]) -> "Hazards":
        """Return some of the points."""
        at_m, velocity, sigma, sigma_mps, number, doubt = self
        return Hazards(at_m[mask], velocity[mask], sigma[mask], sigma_mps[mask], number[mask], doubt[mask])

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

    def columns(self, at_m: FloatArray, u_px: FloatArray) -> tuple[NDArray[np.intp], FloatArray]:
        """Return in which column of `u_px` points (n, 2) on the road are, -1 = in none, and how far ahead."""
        r = self.rectification
        x, z = at_m @ self.R[:2, 0], at_m @ self.R[:2, 2]
        u = (x + r.baseline_m / 2) / np.where(z > 0, z, np.nan) * r.f_px + r.cx_px
        step = float(u_px[1] - u_px[0]) if len(u_px) > 1 else 1.0
        column = np.rint((u - u_px[0]) / step) if len(u_px) else np.full(len(at_m), np.nan)
        with np.errstate(invalid="ignore"):
            inside = (column >= 0) & (column < len(u_px))
        return np.where(inside, np.nan_to_num(column), -1).astype(np.intp), z

    def sigma_m(self, range_m: FloatArray) -> FloatArray:
        """Return by how much a column's end is off."""
        r = self.rectification
        return np.asarray(range_m**2 / (r.f_px * r.baseline_m) * COLUMN_SIGMA_PX)

    def faces(self, obstacles: Sequence[Obstacle], free: FreeSpace, movers: Collection[int] = ()) -> list[Hazards]:
        """Return the faces of all obstacles that have a track, one by one; `movers` are known to move from before."""
        tracked = [o for o in obstacles if o.track is not None and o.track.coasted_s <= LONGEST_COAST_S]
        return [self._face(o, free, movers) for o in tracked]

    def _face(self, o: Obstacle, free: FreeSpace, movers: Collection[int]) -> Hazards:
        assert o.track is not None  # noqa: S101
        mine = self._columns_of(o, free)
        if mine.sum() > 1:  # its columns tell how a side runs, the obstacle itself how near it comes
            at_m = self.points(free.u_px[mine], np.maximum(free.range_m[mine], o.range_m))
        else:
            half = o.size_m[0] / 2
            aside = np.linspace(-half, half, max(2, int(np.ceil(2 * half / FACE_STEP_M)) + 1))
            forward, left = o.position_m[:2] - self.origin_m
            at_m = np.stack([np.full(len(aside), forward), left + aside], 1)
        velocity, doubt = self._velocity_mps(o, movers)
        return Hazards.of(at_m, velocity, o.range_sigma_m, o.track.velocity_sigma_mps, o.track.id, doubt)

    def _velocity_mps(self, o: Obstacle, movers: Collection[int] = ()) -> tuple[FloatArray, float]:
        """Return (2,) velocity over ground, as far as it is known, and how much that is in doubt."""
        assert o.track is not None  # noqa: S101
        track, width = o.track, self.rectification.size_px[0]
        doubt = 0.0 if track.motion == "standing" else SETTLED_DOUBT if track.age_s >= YOUNG_S else YOUNG_DOUBT
        is_cut = o.box_px[0] < BORDER_SHARE * width or o.box_px[2] > (1 - BORDER_SHARE) * width
        if track.motion == "standing" or is_cut or not track.is_over_ground:
            return np.zeros(2), doubt
        is_known = track.id in movers or (track.motion == "moving" and track.age_s >= SETTLED_S)
        sure = np.abs(track.velocity_mps) > 2 * track.velocity_sigma_mps
        return np.where(sure, track.velocity_mps, 0.0), 0.0 if is_known else doubt

    def _columns_of(self, o: Obstacle, free: FreeSpace) -> NDArray[np.bool_]:
        u0, _, u1, _ = o.box_px
        near_m = BESIDE_SHARE * o.range_m + np.nan_to_num(o.size_m[2])
        with np.errstate(invalid="ignore"):
            return np.asarray((free.u_px >= u0) & (free.u_px < u1) & (np.abs(free.range_m - o.range_m) <= near_m))

    def standing_ends(self, obstacles: Sequence[Obstacle], free: FreeSpace) -> NDArray[np.bool_]:
        """Return (n,) which columns end at something that does not move as far as is known, and not alone."""
        z = free.range_m
        blocked = np.isfinite(z) if free.is_blocked is None else free.is_blocked & np.isfinite(z)
        with np.errstate(invalid="ignore"):
            near = np.abs(np.diff(z)) <= NEIGHBOUR_SHARE * np.minimum(z[1:], z[:-1])
        near &= blocked[1:] & blocked[:-1]
        ends = np.append(near, False) | np.insert(near, 0, False)
        for o in obstacles:
            if o.track is not None and np.hypot(*self._velocity_mps(o)[0]) > SLOW_MPS:
                ends &= ~self._columns_of(o, free)
        return np.asarray(ends)

    def is_seen_free(self, at_m: FloatArray, free: FreeSpace) -> NDArray[np.bool_]:
        """Return for points (n, 2) whether road was seen there, before anything that ends it."""
        column, z = self.columns(at_m, free.u_px)
        if not len(free.u_px):
            return np.zeros(len(at_m), bool)
        with np.errstate(invalid="ignore"):
            return np.asarray((column >= 0) & (z <= free.range_m[column]))
