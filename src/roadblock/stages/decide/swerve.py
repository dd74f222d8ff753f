"""Ways: smooth steps aside, and whether one of them is drivable and free of everything that stands or moves."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.decide import swept
from roadblock.stages.decide.hazards import Hazards
from roadblock.stages.decide.settings import DecideSettings
from roadblock.values.checks import FloatArray

LENGTHS_M = (24.0, 20.0, 17.0, 14.0, 11.0, 8.0, 6.0)
"""Over which a step aside is spread, gentlest first."""
STEP_M = 0.2
"""Between how far aside ways lead."""
DECELERATIONS_MPS2 = (0.0, 2.5)
SLOWEST_MPS = 2.5
"""Steering needs some speed."""
COMFORT = 0.85
"""Share of the hardest steering that is planned with."""
THICK_M = 0.5
"""What moves is taken to be so long, before and behind."""
BIN_M = 0.5
"""Points are compared with a way at such steps."""
LOOK_S = 0.6
"""A deviation from the way is corrected within this time."""
SHY, SHY_AHEAD, WALK_MPS = 0.5, 1.5, 1.5
"""More room by so many sigmas of how far what moves may have gone otherwise, aside and along; no sigma is larger than
the third: what nobody knows about is a person at worst."""


_CHOOSE = np.array([[math.comb(j, k) for j in range(6)] for k in range(6)], float)
_LAG = np.maximum(np.arange(6) - np.arange(6)[:, None], 0)


class Ways(NamedTuple):
    """Ways (m) from the car in the axes of the road: `y(s) = sum(c_k s^k)` up to `length_m`, then straight on.

    `offset_m` is how far aside they lead.
    """

    coefficients: FloatArray
    length_m: FloatArray
    offset_m: FloatArray
    deceleration_mps2: FloatArray

    def at(self, s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how far left, its slope and its curvature at s (m, k) or (k,), all (m, k)."""
        inside = np.clip(s, 0, self.length_m[:, None])
        c0, c1, c2, c3, c4, c5 = self.coefficients.T[:, :, None]
        y = c0 + inside * (c1 + inside * (c2 + inside * (c3 + inside * (c4 + inside * c5))))
        dy = c1 + inside * (2 * c2 + inside * (3 * c3 + inside * (4 * c4 + inside * 5 * c5)))
        ddy = 2 * c2 + inside * (6 * c3 + inside * (12 * c4 + inside * 20 * c5))
        return y + dy * (s - inside), dy, np.where(inside == s, ddy, 0.0)

    def where(self, mask: NDArray[np.bool_]) -> "Ways":
        """Return some of them."""
        return Ways(*(part[mask] for part in self))

    def only(self, index: int) -> "Ways":
        """Return one of them."""
        return Ways(*(part[index : index + 1] for part in self))

    def from_point(self, along_m: float, left_m: float) -> "Ways":
        """Return the rest of one way, seen from a point on or beside it."""
        along = min(max(along_m, 0.0), float(self.length_m[0]))
        c = (_CHOOSE * along**_LAG) @ self.coefficients[0]
        c[0] -= left_m
        return self._replace(coefficients=c[None], length_m=np.maximum(self.length_m - along, 1e-3))


def straight_on(bend_per_m: float = 0.0) -> Ways:
    """Return the way of a car that goes on as it does: an arc `y = bend x^2`."""
    c = np.array([[0.0, 0.0, bend_per_m, 0.0, 0.0, 0.0]])
    return Ways(c, np.array([1e3]), np.zeros(1), np.zeros(1))


def ways_aside(slope: float, aside_m: float, settings: DecideSettings) -> Ways:
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
    steps = np.arange(1, round(2 * settings.widest_m / STEP_M) + 1) * STEP_M
    offsets = np.concatenate([[0.0], np.stack([steps, -steps], 1).ravel()])
    offsets = offsets[np.abs(aside_m + offsets) <= settings.widest_m]
    grid = np.array([(off, length, a) for off in offsets for a in DECELERATIONS_MPS2 for length in LENGTHS_M])
    off, length, a = grid.reshape(-1, 3).T
    left = off - slope * length
    c = np.zeros((len(off), 6))
    c[:, 1] = slope
    # y(L) = off, y'(L) = 0, y''(L) = 0, with y = slope s + c3 s^3 + c4 s^4 + c5 s^5
    c[:, 3] = (10 * left + 4 * slope * length) / length**3
    c[:, 4] = -(15 * left + 7 * slope * length) / length**4
    c[:, 5] = (6 * left + 3 * slope * length) / length**5
    return Ways(c, length, off, a)


def drivable(ways: Ways, speed_mps: float, settings: DecideSettings) -> NDArray[np.bool_]:
    """Return which ways (m,) the car can steer."""
    s = np.linspace(0, 1, 13) * ways.length_m[:, None]
    curvature = np.abs(ways.at(s)[2])
    lateral = curvature * speeds(ways, s, speed_mps) ** 2
    return np.asarray(
        (curvature.max(1) <= COMFORT / settings.turn_m) & (lateral.max(1) <= COMFORT * settings.lateral_mps2)
    )


def speeds(ways: Ways, s: FloatArray, speed_mps: float) -> FloatArray:
    """Return (m, k) the speed at s (m, k)."""
    slowest = min(speed_mps, SLOWEST_MPS) ** 2
    return np.sqrt(np.maximum(speed_mps**2 - 2 * ways.deceleration_mps2[:, None] * s, slowest))


def clear_of(
    ways: Ways, at_m: FloatArray, until_m: float, margin_m: float, settings: DecideSettings
) -> NDArray[np.bool_]:
    """Return which ways (m,) pass all points (n, 2) up to `until_m` ahead that stand, with so much room.

    What the car is beside already needs no room: it must not be touched.
    """
    near = at_m[(at_m[:, 0] > -settings.rear_m) & (at_m[:, 0] < until_m)]
    if not len(near):
        return np.ones(len(ways.length_m), bool)
    bins, index = np.unique(np.rint(near[:, 0] / BIN_M), return_inverse=True)
    low, high = (part[:, index] for part in swept(ways.coefficients, ways.length_m, bins * BIN_M, settings.numbers))
    room = np.where(near[:, 0] < settings.front_m, 0.0, margin_m)
    return np.asarray(((near[:, 1] < low - room) | (near[:, 1] > high + room)).all(1))


def clear_of_moving(
    ways: Ways, moving: Hazards, until_m: float, speed_mps: float, settings: DecideSettings
) -> NDArray[np.bool_]:
    """Return which ways (m,) keep out of the way of everything that moves or may, if it goes on about as it does."""
    s = np.arange(0.0, until_m + 1.0)
    y, dy, _ = ways.at(np.broadcast_to(s, (len(ways.length_m), len(s))))
    v = speeds(ways, s[None, :], max(speed_mps, SLOWEST_MPS))
    t = np.concatenate([np.zeros((len(v), 1)), np.cumsum(2 * np.diff(s) / (v[:, 1:] + v[:, :-1]), axis=1)], 1)
    x_thing, y_thing = (moving.at_m[:, i, None, None] + moving.velocity_mps[:, i, None, None] * t for i in (0, 1))
    unsure_mps = np.minimum(moving.sigma_mps, WALK_MPS)
    room = settings.width_m / 2 + settings.margin_m + SHY * unsure_mps[:, 1, None, None] * t
    thick_m = THICK_M + SHY_AHEAD * unsure_mps[:, 0, None, None] * t
    along = (x_thing - thick_m < s + settings.front_m) & (x_thing + thick_m > s - settings.rear_m)
    # The car is askew: of what is beside its middle it may be further away or nearer than of what is beside its ends.
    ends = [y + dy * np.clip(x_thing + part - s, -settings.rear_m, settings.front_m) for part in (-thick_m, thick_m)]
    hit = (y_thing > np.minimum(*ends) - room) & (y_thing < np.maximum(*ends) + room)
    return np.asarray(~(hit & along).any(axis=(0, 2)))


def steering(rest: Ways, slope: float, speed_mps: float, pending_per_m: float, settings: DecideSettings) -> float:
    """Return the curvature, 1/m, that leads back to a way: where the car will be when steering acts.

    Parameters
    ----------
    rest
        One way from where the car is.
    slope
        How the car heads to the road's direction.
    speed_mps, pending_per_m
        Its speed, and how it is steered until then.
    settings
        Of the car.
    """
    v = max(speed_mps, SLOWEST_MPS)
    gone_m = speed_mps * settings.delay_s
    heading = math.atan(slope)
    there, left_m = heading + gone_m * pending_per_m, gone_m * math.sin(heading + gone_m * pending_per_m / 2)
    y, dy, ddy = (float(part[0, 0]) for part in rest.at(np.array([[gone_m]])))
    look_m = max(3.0, LOOK_S * v)
    wanted = ddy + 2 * (y - left_m) / look_m**2 + 2 * (math.atan(dy) - there) / look_m
    most = min(1 / settings.turn_m, settings.lateral_mps2 / v**2)
    return float(np.clip(wanted, -most, most))
