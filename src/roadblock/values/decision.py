"""What to do about the road ahead, and why."""

import math
from dataclasses import dataclass

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import finite

ACTIONS = ("none", "warn", "brake", "swerve")
"""From nothing to do to the last resort."""


@dataclass(frozen=True)
class Decision:
    """What the car should do now.

    Attributes
    ----------
    action
        One of `ACTIONS`.
    reason
        Why, in words; never empty.
    ttc_s, ttc_sigma_s
        Time until the front of the car touches what stands in its way, and its standard deviation, s; NaN where nothing
        does.
    deceleration_mps2
        How hard to brake, m/s^2; 0 = not at all.
    curvature_per_m
        How to steer, 1/m (> 0 = left); 0 = as the driver does.
    offset_m
        How far a swerve leads aside in the end, metres (> 0 = left); 0 for all else.
    obstacle_id
        Track of what is in the way; None where nothing is, or it has no track.

    Raises
    ------
    ValueRefusedError
        If there is no such action, the reason is empty, the deceleration negative, or a command not finite.
    """

    action: str
    reason: str
    ttc_s: float = math.nan
    ttc_sigma_s: float = math.nan
    deceleration_mps2: float = 0.0
    curvature_per_m: float = 0.0
    offset_m: float = 0.0
    obstacle_id: int | None = None

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise ValueRefusedError(f"action must be one of {', '.join(ACTIONS)}, but got {self.action!r}")
        if not self.reason:
            raise ValueRefusedError(f"a decision must have a reason, but {self.action!r} has none")
        for name in ("deceleration_mps2", "curvature_per_m", "offset_m"):
            finite(name, getattr(self, name), ())
        if self.deceleration_mps2 < 0:
            raise ValueRefusedError(f"deceleration_mps2 must be >= 0, but got {self.deceleration_mps2:g}")
