"""Where the car is, and where something stood on its way here: remembered until it is passed or seen to be gone."""

import math

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.decide import recall
from roadblock.stages.decide.hazards import Layout
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace

ROAD_SHARE = 0.15
"""How fast the road's direction is learnt from where the car heads."""


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
            T = ego.T_now_before
            step = -(R @ (T[:3, 3] @ T[:3, :3]))[:2]  # the way back is the inverse
            turn = _turned_rad(R @ T[:3, :3].T @ R.T)
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
    """Cells of a grid on the road where something stood; `here_m` (n, 2) are the sure ones, from where the car is."""

    def __init__(self) -> None:
        self._cells, self._evidence = np.zeros((0, 2), np.int64), np.zeros(0, np.int64)
        self.here_m = np.zeros((0, 2))

    def __len__(self) -> int:
        """Return how many cells have any evidence."""
        return len(self._cells)

    def take_in(
        self,
        free: FreeSpace,
        reach_m: FloatArray,
        gained: NDArray[np.int64],
        foot_m: float,
        own: OwnMotion,
        layout: Layout,
    ) -> None:
        """Remember where columns end, doubt what is seen to be free, forget what is passed or far away.

        Parameters
        ----------
        free
            The columns.
        reach_m, gained
            (c,) how far each is seen, and the evidence, if any, that it ends there.
        foot_m
            What is nearer is out of view.
        own
            Where the car is.
        layout
            Of the columns.
        """
        at = np.array([*own.at_m, math.cos(own.heading_rad), math.sin(own.heading_rad)])
        self._cells, self._evidence, self.here_m = recall(
            self._cells,
            self._evidence,
            at,
            free.grid,
            reach_m,
            gained,
            foot_m,
            layout.rectification.numbers,
            layout.R_road,
        )


def _turned_rad(R: FloatArray) -> float:
    """Return the last number of the rotation vector of a rotation that is less than half a turn."""
    sine = 0.5 * math.hypot(R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1])
    angle = math.atan2(sine, 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1))
    return 0.5 * float(R[1, 0] - R[0, 1]) * (angle / sine if sine > 1e-12 else 1.0)


def turned(at_m: FloatArray, angle_rad: float) -> FloatArray:
    """Return points or ways (n, 2) turned to the left by an angle."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(at_m @ np.array([[c, s], [-s, c]]))
