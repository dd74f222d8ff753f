"""Where the car is, and where something stood on its way here: remembered until it is passed or seen to be gone."""

import math

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import inverse, rotvec_from_rotation
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion

CELL_M = 0.2
MOST, SURE = 6, 3
"""Evidence for a cell, at most `MOST`: one for each frame that saw something there, less one for each that did not."""
AHEAD_M, BESIDE_M, BEHIND_M = 30.0, 10.0, 4.0
"""What is further away is forgotten."""
ROAD_SHARE = 0.15
"""How fast the road's direction is learnt from where the car heads."""
_SHIFT = 1 << 24


class OwnMotion:
    """Where the car is and how it moves, from frame to frame.

    `at_m` (2,) and `heading_rad` since the beginning; `road_rad` where the road leads; `speed_mps`; `yaw_rate_radps`,
    to the left; `known_t_ns`, when its motion was known last.
    """

    def __init__(self) -> None:
        self.at_m, self.heading_rad, self.road_rad = np.zeros(2), 0.0, 0.0
        self.speed_mps, self.yaw_rate_radps, self.known_t_ns = 0.0, 0.0, -(10**18)

    def move(self, R: FloatArray, ego: EgoMotion | None, dt_s: float, t_ns: int) -> None:
        """Take a step in; without a known one the car goes on as it did.

        Parameters
        ----------
        R
            (3, 3) axes of the car frame in those of the vehicle.
        ego, dt_s, t_ns
            Motion and time since the frame before, and the moment.
        """
        step, turn = np.array([self.speed_mps * dt_s, 0.0]), self.yaw_rate_radps * dt_s
        if ego is not None and ego.T_now_before is not None:
            T = inverse(ego.T_now_before)
            step, turn = (R @ T[:3, 3])[:2], float((R @ rotvec_from_rotation(T[:3, :3]))[2])
            seconds = (ego.t_ns - ego.before_t_ns) / 1e9
            self.speed_mps, self.yaw_rate_radps, self.known_t_ns = float(step[0]) / seconds, turn / seconds, t_ns
        self.at_m = self.at_m + turned(step[None], self.heading_rad)[0]
        self.heading_rad += turn

    def learn_road(self) -> None:
        """Take where the car heads for where the road leads, as long as it follows its driver."""
        self.road_rad += ROAD_SHARE * (self.heading_rad - self.road_rad)

    @property
    def askew_rad(self) -> float:
        """How far the car heads to the left of the road's direction."""
        return self.heading_rad - self.road_rad

    def from_here(self, at_m: FloatArray) -> FloatArray:
        """Return remembered points (n, 2) in the axes of the vehicle."""
        return turned(at_m - self.at_m, -self.heading_rad)

    def remembered(self, at_m: FloatArray) -> FloatArray:
        """Return points (n, 2) in the axes of the vehicle as they are remembered."""
        return turned(at_m, self.heading_rad) + self.at_m


class Memory:
    """Cells of a grid on the road where something stood."""

    def __init__(self) -> None:
        self._cells = np.zeros((0, 2), np.int64)
        self._evidence = np.zeros(0, np.int64)

    def add(self, at_m: FloatArray) -> None:
        """Take in where something was seen in a frame, (n, 2)."""
        new = np.rint(at_m / CELL_M).astype(np.int64)
        keys = np.concatenate([_key(self._cells), np.unique(_key(new))])
        evidence = np.concatenate([self._evidence, np.ones(len(keys) - len(self._evidence), np.int64)])
        keys, index = np.unique(keys, return_inverse=True)
        self._evidence = np.minimum(np.bincount(index, evidence).astype(np.int64), MOST)
        self._cells = np.stack([(keys + _SHIFT // 2) // _SHIFT, (keys + _SHIFT // 2) % _SHIFT - _SHIFT // 2], 1)

    @property
    def all_m(self) -> FloatArray:
        """(n, 2) all cells that have any evidence."""
        return np.asarray(self._cells * CELL_M)

    def doubt(self, is_free: NDArray[np.bool_]) -> None:
        """Take in for `all_m` (n,) which of them were seen to be free."""
        self._evidence = self._evidence - is_free
        self._keep(self._evidence > 0)

    def forget(self, own: OwnMotion) -> None:
        """Drop what is passed or far away."""
        x, y = own.from_here(self.all_m).T
        self._keep((x > -BEHIND_M) & (x < AHEAD_M) & (np.abs(y) < BESIDE_M))

    def _keep(self, mask: NDArray[np.bool_]) -> None:
        self._cells, self._evidence = self._cells[mask], self._evidence[mask]

    @property
    def at_m(self) -> FloatArray:
        """(n, 2) where something stands."""
        return np.asarray(self._cells[self._evidence >= SURE] * CELL_M)


def _key(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(cells[:, 0] * _SHIFT + cells[:, 1])


def turned(at_m: FloatArray, angle_rad: float) -> FloatArray:
    """Return points or ways (n, 2) turned to the left by an angle."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(at_m @ np.array([[c, s], [-s, c]]))
