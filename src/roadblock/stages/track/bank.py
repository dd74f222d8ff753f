"""What a tracker remembers, and what it sees: one row an obstacle, in arrays."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.track import roughen
from roadblock.values.checks import FloatArray
from roadblock.values.scene import Obstacle

KEPT = 10
"""Frames that are remembered."""
LEAST_M = np.array([0.05, 0.05, 0.0])
"""Widths, heights and lengths are at least this, unknown ones too."""
FIXED = ("railing", "pole", "fork")
"""Thin things that stand by nature; a car in real pictures is often said to be a wall or a plant, but none of these."""
NONE = (0.0,) * len(FIXED)
"""What types have that are not among those known."""
FIXED_SHARE = 0.3
"""How fast a track learns whether it is one of these."""


class Seen(NamedTuple):
    """What is measured of obstacles, as rows of arrays of one length m.

    Attributes
    ----------
    obstacles
        (m,) themselves.
    uvd, noise_px2
        (m, 3) u, v, d; (m, 3, 3) their covariance.
    boxes
        (m, 4) u0, v0, u1, v1.
    looks
        (m, 2) logarithm of width and height.
    foot
        (m, 3) the foot points.
    range_m, long_m
        (m,) how far and how long; 0 where the length is unknown.
    fixed
        (m,) how probable it is of a type in `FIXED`; 0 where no type is known.
    """

    obstacles: NDArray[Any]
    uvd: FloatArray
    noise_px2: FloatArray
    boxes: FloatArray
    looks: FloatArray
    foot: FloatArray
    range_m: FloatArray
    long_m: FloatArray
    fixed: FloatArray

    def chosen(self, which: NDArray[np.intp]) -> "Seen":
        """Return some rows."""
        return Seen(*(part.take(which, axis=0) for part in self))


def see(obstacles: Sequence[Obstacle], log_noise: FloatArray, twin: FloatArray) -> Seen:
    """Return the numbers of obstacles; for the rest see `kernels.reference.track.roughen`."""
    m = len(obstacles)
    objects = np.empty(m, object)
    objects[:] = obstacles
    uvd = _rows([o.uvd_px for o in obstacles], 3)
    cov_px2 = _rows([o.cov_uvd_px2 for o in obstacles], 9).reshape(m, 3, 3)
    boxes = np.fromiter(chain.from_iterable([o.box_px for o in obstacles]), float, 4 * m).reshape(m, 4)
    size_m = np.fmax(_rows([o.size_m for o in obstacles], 3), LEAST_M)
    foot = _rows([o.position_m for o in obstacles], 3)
    range_m = np.array([o.range_m for o in obstacles], float)
    noise_px2 = roughen(cov_px2, uvd, boxes, log_noise, twin)
    fixed = np.array([sum(map(o.class_odds.get, FIXED, NONE)) for o in obstacles], float)
    return Seen(objects, uvd, noise_px2, boxes, np.log(size_m[:, :2]), foot, range_m, size_m[:, 2], fixed)


def _rows(arrays: list[FloatArray], width: int) -> FloatArray:
    """Return arrays of `width` numbers as rows: faster than `np.array` of them."""
    return np.concatenate(arrays, dtype=float).reshape(-1, width) if arrays else np.zeros((0, width))


CONFIRMED = 2
"""Measured so often, an obstacle has a track."""
LOST_S = 0.35
"""After a longer time unseen it is measured again before it is said to move or to stand: it may be another one."""


@dataclass(eq=False)
class Bank:
    """Tracks, as rows of arrays of one length n.

    Attributes
    ----------
    x, P
        (n, 5) states and (n, 5, 5) covariances; see `kernels.reference.track`.
    id
        (n,) numbers; 0 for what was seen too rarely to have one.
    born_ns, seen_ns
        (n,) when they were measured first and last.
    found, missed
        (n,) in how many frames they were measured, and in how many they were not since.
    doubt_s
        (n,) how long free road has been seen where they should be.
    spans
        (n, `KEPT`, 4) where it was in the frames that are remembered; see `kernels.reference.traces.ends`. 0 = nowhere.
    moved_ns
        (n,) when it was seen last that it had left where it was.
    slid
        (n,) whether its outline moves though nothing has left its place.
    against
        (n,) how many times in a row the features on them contradicted their velocities.
    calm
        (n,) by how much less their velocities change than is usual: the features on them say so.
    looks
        (n, 2) logarithm of width and height, smoothed.
    foot_m
        (n, 3) from what is measured to the foot point.
    last
        (n,) the `Obstacle` of the latest measurement.
    uvd, boxes, range_m, long_m
        (n, 3), (n, 4), (n,) and (n,) of the latest measurement, as in `Seen`.
    fixed
        (n,) as in `Seen`, smoothed.
    """

    x: FloatArray
    P: FloatArray
    id: NDArray[np.int64]
    born_ns: NDArray[np.int64]
    seen_ns: NDArray[np.int64]
    found: NDArray[np.int64]
    missed: NDArray[np.int64]
    doubt_s: FloatArray
    against: NDArray[np.int64]
    spans: FloatArray
    moved_ns: NDArray[np.int64]
    slid: NDArray[np.bool_]
    calm: FloatArray
    looks: FloatArray
    foot_m: FloatArray
    last: NDArray[Any]
    uvd: FloatArray
    boxes: FloatArray
    range_m: FloatArray
    long_m: FloatArray
    fixed: FloatArray

    @classmethod
    def born(cls, x: FloatArray, P: FloatArray, t_ns: int, seen: Seen) -> Self:
        """Return tracks of things just seen for the first time."""
        n = len(x)
        zero, now = np.zeros(n, np.int64), np.full(n, t_ns, np.int64)
        counts = (zero, now, now.copy(), zero + 1, zero.copy(), np.zeros(n), zero + 1)
        return cls(
            x,
            P,
            *counts,
            np.zeros((n, KEPT, 4)),
            zero.copy(),
            np.zeros(n, bool),
            np.ones(n),
            seen.looks,
            seen.foot - x[:, :3],
            seen.obstacles,
            seen.uvd,
            seen.boxes,
            seen.range_m,
            seen.long_m,
            seen.fixed,
        )

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.x)

    def note(self, rows: NDArray[np.intp], columns: NDArray[np.intp], seen: Seen, t_ns: int) -> None:
        """Remember that some tracks were measured, and as what."""
        lost = t_ns - self.seen_ns[rows] > 1e9 * LOST_S
        self.found[rows] = np.where(lost, np.minimum(self.found[rows], CONFIRMED), self.found[rows]) + 1
        self.missed[rows], self.doubt_s[rows], self.seen_ns[rows] = 0, 0.0, t_ns
        seen = seen.chosen(columns)
        self.last[rows], self.uvd[rows], self.boxes[rows] = seen.obstacles, seen.uvd, seen.boxes
        self.range_m[rows], self.long_m[rows], self.foot_m[rows] = (
            seen.range_m,
            seen.long_m,
            seen.foot - self.x[rows, :3],
        )
        self.fixed[rows] += FIXED_SHARE * (seen.fixed - self.fixed[rows])

    def chosen(self, which: NDArray[Any]) -> Self:
        """Return some rows."""
        return replace(self, **{name: getattr(self, name)[which] for name in PARTS})

    def joined(self, other: Self) -> Self:
        """Return these rows and those of another."""
        return replace(self, **{name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in PARTS})


PARTS = tuple(f.name for f in fields(Bank))
