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
UNSURE_SHARE = 0.85
"""What may stand or move counts only once this share of the hardest braking is needed if it stands."""
LEAST_ROOM_M = 0.7
"""Room before what it stops for, where it is too late for `stop_m`."""


class Contact(NamedTuple):
    """After how long, its sigma, how hard the car must brake for it, whether that is sure, and which hazard it is."""

    ttc_s: float
    sigma_s: float
    needed_mps2: float
    is_sure: bool
    index: int


def find_contact(
    way: Ways, hazards: Hazards, speed_mps: float, margin_m: float, settings: DecideSettings
) -> Contact | None:
    """Return what the car touches first on a way (one) within `AHEAD_S`; None if nothing.

    Hazards are in the axes of the way. What is only beside it, and not known to come into it, never counts. Where
    several are in the way, the one that needs the hardest braking tells how hard.
    """
    s = settings
    if not len(hazards.at_m):
        return None
    gap_m = hazards.at_m[:, 0] - s.front_m
    closing = speed_mps - hazards.velocity_mps[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where((closing > CLOSING_MPS) & (gap_m > -s.front_m), np.maximum(gap_m, 0) / closing, np.inf)
        passed = np.minimum(ttc + np.where(hazards.moves, (s.front_m + s.rear_m) / closing, 0.0), AHEAD_S)
    aside = hazards.velocity_mps[:, 1]
    arrives = ttc < AHEAD_S
    x = hazards.at_m[:, 0] + hazards.velocity_mps[:, 0] * np.where(arrives, ttc, 0.0)
    low, high = (part[0] for part in swept(way, x, s))
    ends = hazards.at_m[:, 1] + aside * np.where(arrives, [ttc, passed], 0.0)
    now = hazards.at_m[:, 1]
    hit = arrives & (ends.min(0) < high + margin_m) & (ends.max(0) > low - margin_m)
    hit &= hazards.is_sure | ((now < high + margin_m) & (now > low - margin_m))
    if not hit.any():
        return None
    needed = np.where(hit, _needed_mps2(gap_m, speed_mps, hazards.velocity_mps[:, 0], s), 0.0)
    counts = hit & (hazards.is_sure | (needed >= UNSURE_SHARE * s.brake_mps2))
    of = counts if counts.any() else hit
    first = int(np.argmin(np.where(of, ttc, np.inf)))
    sigma = math.hypot(hazards.sigma_m[first], ttc[first] * hazards.sigma_mps[first]) / closing[first]
    hardest = float(needed[of].max())
    return Contact(float(ttc[first]), float(sigma), hardest, bool(counts.any()), first)


def _needed_mps2(gap_m: FloatArray, speed_mps: float, ahead_mps: FloatArray, s: DecideSettings) -> FloatArray:
    """Return (n,) how hard to brake to stop `stop_m` before each, or as near as may be; more than possible: too late.

    What drives on ahead may brake as hard as the car itself can.
    """
    ahead = np.maximum(ahead_mps, 0)
    closing = speed_mps - ahead_mps
    far = gap_m + ahead**2 / (2 * s.brake_mps2) - s.delay_s * np.where(ahead > 0, speed_mps, closing)
    speed = np.where(ahead > 0, speed_mps, closing)
    left, least = (np.maximum(far - room, 1e-3) for room in (s.stop_m, LEAST_ROOM_M))
    soft, hard = speed**2 / (2 * left), speed**2 / (2 * least)
    return np.where(soft <= s.brake_mps2, soft, np.maximum(hard, s.brake_share * s.brake_mps2))
