"""What a tracker remembers: one row an obstacle, in arrays."""

from dataclasses import dataclass, fields, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from roadblock.values.checks import FloatArray
from roadblock.values.scene import Obstacle


@dataclass(frozen=True, eq=False)
class Bank:
    """Tracks, as rows of arrays of one length n.

    Attributes
    ----------
    x, P
        (n, 5) states and (n, 5, 5) covariances; see `kalman`.
    id
        (n,) numbers; 0 for what was seen too rarely to have one.
    born_ns, seen_ns
        (n,) when they were measured first and last.
    found, missed
        (n,) in how many frames they were measured, and in how many they were not since.
    doubt_s
        (n,) how long free road has been seen where they should be.
    looks
        (n, 2) logarithm of width and height, smoothed.
    foot_m
        (n, 3) from what is measured to the foot point.
    last
        (n,) the `Obstacle` of the latest measurement.
    """

    x: FloatArray
    P: FloatArray
    id: NDArray[np.int64]
    born_ns: NDArray[np.int64]
    seen_ns: NDArray[np.int64]
    found: NDArray[np.int64]
    missed: NDArray[np.int64]
    doubt_s: FloatArray
    looks: FloatArray
    foot_m: FloatArray
    last: NDArray[Any]

    @classmethod
    def born(cls, x: FloatArray, P: FloatArray, t_ns: int, obstacles: list[Obstacle], looks: FloatArray) -> Self:
        """Return tracks of things just seen for the first time."""
        n = len(x)
        zero, now = np.zeros(n, np.int64), np.full(n, t_ns, np.int64)
        last = np.empty(n, object)
        last[:] = obstacles
        foot_m = np.array([o.position_m for o in obstacles]).reshape(n, 3) - x[:, :3]
        return cls(x, P, zero, now, now.copy(), zero + 1, zero.copy(), np.zeros(n), looks, foot_m, last)

    def __len__(self) -> int:
        """Return how many there are."""
        return len(self.x)

    def chosen(self, which: NDArray[Any]) -> Self:
        """Return some rows."""
        return replace(self, **{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def joined(self, other: Self) -> Self:
        """Return these rows and those of another."""
        return replace(
            self, **{f.name: np.concatenate([getattr(self, f.name), getattr(other, f.name)]) for f in fields(self)}
        )
