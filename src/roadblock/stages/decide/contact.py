"""What the car runs into on a way, when, and how hard it must brake for it."""

import math
from typing import NamedTuple

import numpy as np

from roadblock.stages.decide.hazards import Hazards
from roadblock.stages.decide.settings import DecideSettings
from roadblock.stages.decide.swerve import Ways, swept
from roadblock.values.checks import FloatArray

CLOSING_MPS = 0.3
"""What comes closer no faster never arrives."""
AHEAD_S = 4.0
"""What is further off does not count."""
BESIDE_M = 0.2
"""What is further behind the front is beside the car."""
WARY_M, MOST_WARY_M = 0.3, 1.0
"""A wary car gives what moves this much more room, and its sigma on top, but not more than the second."""
LEAST_ROOM_M = 0.7
"""Room before what it stops for, where it is too late for `stop_m`."""


class Contact(NamedTuple):
    """After how long, its sigma, how hard the car must brake for it, whether that is sure, and at which hazard."""

    ttc_s: float
    sigma_s: float
    needed_mps2: float
    is_sure: bool
    at: int


def find_contact(
    way: Ways,
    hazards: Hazards,
    speed_mps: float,
    margin_m: float,
    settings: DecideSettings,
    *,
    wary: bool = False,
    strict: bool = False,
) -> Contact | None:
    """Return what the car touches first on a way (one) within `AHEAD_S`; None if nothing.

    Hazards are in the axes of the way. What is only beside it, and not known to come into it, never counts. Where
    several are in the way, the one that needs the hardest braking tells how hard. A wary car (one that brakes already)
    gives what moves the room by which its way may be mistaken; one that is strict leaves no doubt to what seems to
    move.
    """
    s = settings
    doubt = np.where(hazards.moves, 0.0, hazards.doubt) if strict else hazards.doubt
    if not len(hazards.at_m):
        return None
    gap_m = hazards.at_m[:, 0] - s.front_m
    closing = speed_mps - hazards.velocity_mps[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where((closing > CLOSING_MPS) & (gap_m > -BESIDE_M), np.maximum(gap_m, 0) / closing, np.inf)
        passed = np.minimum(ttc + np.where(hazards.moves, (s.front_m + s.rear_m) / closing, 0.0), AHEAD_S)
    aside = hazards.velocity_mps[:, 1]
    arrives = ttc < AHEAD_S
    x = hazards.at_m[:, 0] + hazards.velocity_mps[:, 0] * np.where(arrives, ttc, 0.0)
    low, high = (part[0] for part in swept(way, x, s))
    ends = hazards.at_m[:, 1] + aside * np.where(arrives, [ttc, passed], 0.0)
    now = hazards.at_m[:, 1]
    mistaken_m = np.minimum(WARY_M + hazards.sigma_mps[:, 1] * np.where(arrives, ttc, 0.0), MOST_WARY_M)
    room = margin_m + np.where(hazards.moves & wary, mistaken_m, 0.0)
    hit = arrives & (ends.min(0) < high + room) & (ends.max(0) > low - room)
    hit &= (doubt == 0) | ((now < high + margin_m) & (now > low - margin_m))
    if not hit.any():
        return None
    needed = np.where(hit, _needed_mps2(gap_m, speed_mps, hazards.velocity_mps[:, 0], s), 0.0)
    counts = hit & (needed >= doubt * s.brake_mps2)
    of = counts if counts.any() else hit
    first = int(np.argmin(np.where(of, ttc, np.inf)))
    sigma = math.hypot(hazards.sigma_m[first], ttc[first] * hazards.sigma_mps[first, 0]) / closing[first]
    hardest = float(needed[of].max())
    return Contact(float(ttc[first]), float(sigma), hardest, bool(counts.any()), first)


def _needed_mps2(gap_m: FloatArray, speed_mps: float, ahead_mps: FloatArray, s: DecideSettings) -> FloatArray:
    """Return (n,) how hard to brake to stay `stop_m` behind each, or as near as may be where that is too late.

    What drives on ahead may at any moment brake as hard as the car itself can.
    """
    closing = speed_mps - ahead_mps
    left_m = gap_m - s.delay_s * closing
    soft, hard = (_braked(closing, left_m - room) for room in (s.stop_m, LEAST_ROOM_M))
    as_is = np.where(soft <= s.brake_mps2, soft, np.maximum(hard, s.brake_share * s.brake_mps2))
    stops_m = gap_m + ahead_mps**2 / (2 * s.brake_mps2) - s.delay_s * speed_mps - LEAST_ROOM_M
    return np.where(ahead_mps > 0, np.maximum(as_is, _braked(speed_mps, stops_m)), as_is)


def _braked(speed_mps: FloatArray | float, way_m: FloatArray) -> FloatArray:
    return np.asarray(np.square(speed_mps) / (2 * np.maximum(way_m, 1e-3)))
