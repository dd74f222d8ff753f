"""Ways round something: smooth steps aside, and whether one of them is free, seen and drivable."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.stages.decide.hazards import Hazards
from roadblock.stages.decide.settings import DecideSettings
from roadblock.values.checks import FloatArray

LENGTHS_M = (8.0, 11.0, 14.0, 17.0, 20.0, 24.0)
"""Over which a step aside is spread."""
STEP_M = 0.2
"""Between how far aside ways lead."""
DECELERATIONS_MPS2 = (0.0, 2.5)
SLOWEST_MPS = 2.5
"""Steering needs some speed."""
STRAIGHT_ON_M = 8.0
"""Behind the step the car goes on so far."""
COMFORT = 0.9
"""Share of the hardest steering that is planned with."""
MOVING_MARGIN_M = 0.5
"""More room beside what moves."""
THICK_M = 1.0
"""What moves is taken to be so long."""


class Ways(NamedTuple):
    """Ways (m): quintic steps aside in the frame of the road, from the car: `y(s) = sum(c_k s^k)` up to `length_m`."""

    coefficients: FloatArray
    length_m: FloatArray
    offset_m: FloatArray
    deceleration_mps2: FloatArray

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how far left (m, k), its slope and its curvature at s (m, k) or (k,); straight on behind the end."""
        inside = np.clip(s, 0, self.length_m[:, None])
        c = self.coefficients.T[:, :, None]
        y = c[0] + inside * (c[1] + inside * (c[2] + inside * (c[3] + inside * (c[4] + inside * c[5]))))
        dy = c[1] + inside * (2 * c[2] + inside * (3 * c[3] + inside * (4 * c[4] + inside * 5 * c[5])))
        ddy = 2 * c[2] + inside * (6 * c[3] + inside * (12 * c[4] + inside * 20 * c[5]))
        return y, dy, np.where(inside == s, ddy, 0.0)

    def only(self, index: int) -> "Ways":
        """Return one of them."""
        return Ways(*(part[index : index + 1] for part in self))


def ways(slope: float, aside_m: float, settings: DecideSettings) -> Ways:
    """Return all ways from a heading (slope to the road's direction), least aside and slow-down first.

    Parameters
    ----------
    slope
        How the car heads now.
    aside_m
        How far left of its old line it already is; ways lead at most `widest_m` from there.
    settings
        Of the car.
    """
    steps = np.arange(1, round(settings.widest_m / STEP_M) + 1) * STEP_M
    grid = np.array(
        [
            (off - aside_m, length, a)
            for off in np.stack([steps, -steps], 1).ravel()
            for a in DECELERATIONS_MPS2
            for length in LENGTHS_M[::-1]
        ]
    )
    off, length, a = grid.T
    left = off - slope * length
    c = np.zeros((len(off), 6))
    c[:, 1] = slope
    # y(L) = off, y'(L) = 0, y''(L) = 0, with y = slope s + c3 s^3 + c4 s^4 + c5 s^5
    c[:, 3] = (10 * left + 4 * slope * length) / length**3
    c[:, 4] = -(15 * left + 7 * slope * length) / length**4
    c[:, 5] = (6 * left + 3 * slope * length) / length**5
    return Ways(c, length, off + aside_m, a)


def drivable(ways: Ways, speed_mps: float, settings: DecideSettings) -> NDArray[np.bool_]:
    """Return which ways (m,) the car can steer."""
    s = np.linspace(0, 1, 13) * ways.length_m[:, None]
    curvature = np.abs(ways.at(s)[2])
    lateral = curvature * speeds(ways, s, speed_mps) ** 2
    return np.asarray(
        (curvature.max(1) <= 1 / settings.turn_m) & (lateral.max(1) <= COMFORT * settings.lateral_mps2)
    )


def speeds(ways: Ways, s: FloatArray, speed_mps: float) -> FloatArray:
    """Return (m, k) the speed at s (m, k)."""
    slowest = min(speed_mps, SLOWEST_MPS) ** 2
    return np.sqrt(np.maximum(speed_mps**2 - 2 * ways.deceleration_mps2[:, None] * s, slowest))


def clear_of(ways: Ways, at_m: FloatArray, margin_m: float, settings: DecideSettings) -> NDArray[np.bool_]:
    """Return which ways (m,) pass all points (n, 2) that stand, with so much room."""
    ahead = at_m[(at_m[:, 0] > 0) & (at_m[:, 0] < LENGTHS_M[-1] + STRAIGHT_ON_M)]
    if not len(ahead):
        return np.ones(len(ways.length_m), bool)
    body = []
    for reach in (settings.front_m, 0.0, -settings.rear_m):
        y, slope, _ = ways.at(np.broadcast_to(ahead[:, 0] - reach, (len(ways.length_m), len(ahead))))
        body.append(y + reach * slope)
    room = settings.width_m / 2 + margin_m
    low, high = np.min(body, axis=0) - room, np.max(body, axis=0) + room
    beyond = ahead[:, 0] > ways.length_m[:, None] + STRAIGHT_ON_M
    return np.asarray(((ahead[:, 1] < low) | (ahead[:, 1] > high) | beyond).all(1))


def clear_of_moving(
    ways: Ways, hazards: Hazards, speed_mps: float, margin_m: float, settings: DecideSettings
) -> NDArray[np.bool_]:
    """Return which ways (m,) keep out of the way of everything that moves, if it goes on as it does."""
    s = np.linspace(0, LENGTHS_M[-1] + STRAIGHT_ON_M, 33)
    y, _, _ = ways.at(np.broadcast_to(s, (len(ways.length_m), len(s))))
    v = speeds(ways, s[None, :], max(speed_mps, SLOWEST_MPS))
    t = np.concatenate([np.zeros((len(v), 1)), np.cumsum(np.diff(s) / ((v[:, 1:] + v[:, :-1]) / 2), axis=1)], 1)
    x_thing = hazards.at_m[:, 0, None, None] + hazards.velocity_mps[:, 0, None, None] * t
    y_thing = hazards.at_m[:, 1, None, None] + hazards.velocity_mps[:, 1, None, None] * t
    room = settings.width_m / 2 + margin_m + MOVING_MARGIN_M + hazards.sigma_mps[:, None, None] * t
    beside = np.abs(y_thing - y) < room
    along = (x_thing < s + settings.front_m + THICK_M) & (x_thing + THICK_M > s - settings.rear_m - THICK_M)
    return np.asarray(~(beside & along).any(axis=(0, 2)))
