"""What the car runs into on a way, when, and how hard it must brake for it."""

import math
from typing import NamedTuple

from roadblock.kernels.compiled.decide import contact
from roadblock.stages.decide.hazards import Hazards
from roadblock.stages.decide.settings import DecideSettings
from roadblock.stages.decide.swerve import Ways


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
    """Return what the car touches first on a way (one) within 4 s; None if nothing.

    Hazards are in the axes of the way. What may move or stand counts only if it comes into the way even a sigma slower
    than it seems to; at the last moment, if it does as it most likely goes on. Where several are in the way, the one
    that needs the hardest braking tells how hard. A wary car (one that brakes already) gives what moves the room by
    which its way may be mistaken; one that is strict leaves no doubt to what seems to move.
    """
    h = hazards
    at, ttc_s, needed_mps2, is_sure = contact(
        way.coefficients[0], float(way.length_m[0]), h.at_m, h.velocity_mps, h.sigma_mps, h.doubt, h.likely_mps,
        float(speed_mps), float(margin_m), wary, strict, settings.numbers,
    )  # fmt: skip
    if at < 0:
        return None
    sigma_s = math.hypot(h.sigma_m[at], ttc_s * h.sigma_mps[at, 0]) / (speed_mps - h.velocity_mps[at, 0])
    return Contact(ttc_s, float(sigma_s), needed_mps2, bool(is_sure), at)
