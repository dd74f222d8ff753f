"""What a car could run into, as points on the road with velocities; and which of the road was seen to be free."""

from collections.abc import Collection, Sequence
from itertools import chain
from operator import attrgetter
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import vehicle_from_car
from roadblock.kernels.compiled.decide import outline, weigh
from roadblock.kernels.reference.decide import (
    BESIDE_SHARE,
    DEEP_M,
    MOVES,
    SLOW_MPS,
    STANDS,
    UNTOLD,
    YOUNG_S,
)
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.scene import FreeSpace, Obstacle

LONGEST_COAST_S = 0.3
BORDER_SHARE = 0.04
"""So near to the picture's side, by its width, nothing has a velocity that had none before: ends of walls go along."""
BESIDE = np.array([[-2, -1], [0, 1]])
"""Nor if one of these columns beside it, from the first one behind each of its ends, ends at something nearer."""
JOINED_SHARE, GAP, ALONG_SHARE = 0.15, 3, 0.5
"""Columns that follow each other, but for a gap of less than so many, end at one boundary if their ranges differ by
less than the first; it comes along the road if its near end is nearer than the last share of its far end."""
_VELOCITY, _COV = attrgetter("velocity_mps"), attrgetter("velocity_cov_m2ps2")
_SIZE, _POSITION = attrgetter("size_m"), attrgetter("position_m")
TOLD = {"moving": MOVES, "standing": STANDS, "unknown": UNTOLD}


class Hazards(NamedTuple):
    """Points (n) in the axes of the vehicle, seen from the cameras.

    `at_m` (n, 2) forward and left; `velocity_mps` (n, 2) over ground; `sigma_m` of the distance, `sigma_mps` (n, 2) of
    the velocity; `number` of the track, 0 = none; `doubt`: the share of the hardest braking that must be needed before
    it counts at all, 0 where it is known that it moves, or that it stands; `likely_mps` (n,) how fast it most likely
    goes to the left, also where that is not known.
    """

    at_m: FloatArray
    velocity_mps: FloatArray
    sigma_m: FloatArray
    sigma_mps: FloatArray
    number: NDArray[np.int64]
    doubt: FloatArray
    likely_mps: FloatArray

    @classmethod
    def of(
        cls,
        at_m: FloatArray,
        velocity_mps: FloatArray = np.zeros(2),  # noqa: B008 - never written to
        sigma_m: float = 0.2,
        sigma_mps: FloatArray = np.zeros(2),  # noqa: B008
        doubt: float = 0.0,
    ) -> Self:
        """Return points (n, 2) that belong to one thing without a number."""
        n, speeds, sigmas = len(at_m), np.empty((len(at_m), 2)), np.empty((len(at_m), 2))
        speeds[:], sigmas[:] = velocity_mps, sigma_mps
        return cls(at_m, speeds, np.full(n, sigma_m), sigmas, np.zeros(n, np.int64), np.full(n, doubt), speeds[:, 1])

    @classmethod
    def joined(cls, parts: Sequence["Hazards"]) -> Self:
        """Return the points of all, at least one."""
        return cls(*(np.concatenate(part) for part in zip(*parts, strict=True)))

    def where(self, mask: NDArray[np.bool_]) -> "Hazards":
        """Return some of the points."""
        rows = mask.nonzero()[0]
        at_m, velocity, sigma, sigma_mps, number, doubt, likely = self
        return Hazards(
            at_m.take(rows, 0),
            velocity.take(rows, 0),
            sigma.take(rows),
            sigma_mps.take(rows, 0),
            number.take(rows),
            doubt.take(rows),
            likely.take(rows),
        )

    @property
    def moves(self) -> NDArray[np.bool_]:
        """(n,) whether it moves."""
        return np.asarray(np.hypot(self.velocity_mps[:, 0], self.velocity_mps[:, 1]) > SLOW_MPS)


class Layout:
    """Where columns of the picture lead to on the road; one rig, one layout."""

    def __init__(self, rectification: Rectification, T_vehicle_car: FloatArray | None) -> None:
        self.rectification = rectification
        T = vehicle_from_car(T_vehicle_car)
        self.R, self.origin_m = T[:3, :3], T[:2, 3]
        self.R_road = np.ascontiguousarray(self.R[:2, [0, 2]])
        """(2, 2) right and ahead of the cameras as forward and left."""

    def columns(self, at_m: FloatArray, free: FreeSpace) -> tuple[NDArray[np.intp], FloatArray]:
        """Return in which column points (n, 2) on the road are, -1 = in none, and how far ahead."""
        r = self.rectification
        x, z = (at_m @ self.R_road).T
        with np.errstate(divide="ignore", invalid="ignore"):
            u = (x + r.baseline_m / 2) / np.where(z > 0, z, np.nan) * r.f_px + r.cx_px
            first_px, step_px = free.grid
            column = np.rint((u - first_px) / step_px)
            inside = (column >= 0) & (column < len(free.u_px))
        return np.where(inside, np.nan_to_num(column), -1).astype(np.intp), z

    def faces(
        self, obstacles: Sequence[Obstacle], free: FreeSpace, movers: Collection[int] = ()
    ) -> tuple[Hazards, NDArray[np.int64], NDArray[np.int64]]:
        """Return the faces of all obstacles that have a track, (c,) evidence that something stands, and movers.

        Those are the numbers of tracks that move for sure; `movers` are known from before. What ends a column alone
        does not count, nor what may turn out to move.
        """
        seen = [(o, t) for o in obstacles if (t := o.track) is not None and t.coasted_s <= LONGEST_COAST_S]
        new = [o for o in obstacles if o.track is None]
        rows = [
            (
                t.id,
                t.age_s - t.coasted_s,
                TOLD[t.motion],
                t.is_over_ground,
                t.id in movers,
                o.range_m,
                o.range_sigma_m,
                o.box_px[0],
                o.box_px[2],
            )
            for o, t in seen
        ]
        rows += [(0, 0.0, UNTOLD, False, False, o.range_m, o.range_sigma_m, o.box_px[0], o.box_px[2]) for o in new]
        told = np.fromiter(chain.from_iterable(rows), float, 9 * len(rows)).reshape(-1, 9)
        number, seen_s, motion, over_ground, is_mover, range_m, sigma_m = told[:, :7].T
        has_velocity = (over_ground > 0) & ((is_mover > 0) | self._is_whole(told[:, 7:], range_m, free))
        velocity, cov = (_table([part(t) for _, t in seen], n, len(rows)) for part, n in ((_VELOCITY, 2), (_COV, 4)))
        everything = [*(o for o, _ in seen), *new]
        size_m, foot_m = (_table([part(o) for o in everything], 3, len(rows)) for part in (_SIZE, _POSITION))
        speeds, sigmas, doubt, likely = weigh(
            velocity, cov.reshape(-1, 2, 2), motion.astype(np.int64), seen_s, has_velocity, is_mover > 0
        )
        at_m, owner, evidence = outline(
            told[:, 7:],
            range_m,
            np.where(size_m > 0, size_m, 0.0)[:, ::2],  # unknown lengths are NaN
            foot_m[:, :2] - self.origin_m,
            speeds,
            (doubt > 0) & (seen_s < YOUNG_S),
            len(seen),
            free.grid,
            free.range_m,
            free.ends,
            self.rectification.numbers,
            self.R_road,
        )
        numbers, is_sure = number.astype(np.int64), (motion == MOVES) & (doubt == 0)
        sigma_m, sigmas, doubt, likely = sigma_m[owner], sigmas[owner], doubt[owner], likely[owner]
        faces = Hazards(at_m, speeds[owner], sigma_m, sigmas, numbers[owner], doubt, likely)
        return faces, evidence, numbers[is_sure]

    def _is_whole(self, sides_px: FloatArray, range_m: FloatArray, free: FreeSpace) -> NDArray[np.bool_]:
        """Return (n,) whether neither the picture's side nor something nearer cuts things; sides as in `outline`."""
        width_px = self.rectification.size_px[0]
        whole = (sides_px[:, 0] >= BORDER_SHARE * width_px) & (sides_px[:, 1] <= (1 - BORDER_SHARE) * width_px)
        if len(free.u_px):
            first_px, step_px = free.grid
            columns = np.ceil((sides_px - first_px) / step_px).astype(np.intp)[..., None] + BESIDE
            before_m = range_m - np.maximum(BESIDE_SHARE * range_m, DEEP_M)
            column_m = np.where(free.ends, free.range_m, np.inf).take(columns, mode="clip")
            whole &= (column_m >= before_m[:, None, None]).all((1, 2))
        return np.asarray(whole)

    def is_in_bend(self, at_m: FloatArray, free: FreeSpace) -> bool:
        """Return whether what stands at a point (2,) bounds the road from further back: the road bends before it."""
        (column,), (there_m,) = self.columns(at_m[None], free)
        if column < 0:
            return False
        range_m = np.where(free.ends, free.range_m, np.inf)
        for side_m in (range_m[column:].tolist(), range_m[column::-1].tolist()):
            last_m, missed = there_m, 0
            for next_m in side_m:
                joined = abs(next_m - last_m) < JOINED_SHARE * last_m
                last_m, missed = (next_m, 0) if joined else (last_m, missed + 1)
                if last_m < ALONG_SHARE * there_m:
                    return True
                if missed == GAP:
                    break
        return False

    def is_seen_free(self, at_m: FloatArray, free: FreeSpace) -> NDArray[np.bool_]:
        """Return for points (n, 2) whether road was seen there, before anything that ends it."""
        column, z = self.columns(at_m, free)
        if not len(free.u_px):
            return np.zeros(len(at_m), bool)
        with np.errstate(invalid="ignore"):
            return np.asarray((column >= 0) & (z <= free.range_m[column]))


def _table(rows: Sequence[Any], columns: int, most: int) -> FloatArray:
    """Return rows of numbers as an array, zeros behind them."""
    table = np.zeros((most, columns))
    if rows:
        table[: len(rows)] = np.concatenate(rows, dtype=float).reshape(-1, columns)
    return table
