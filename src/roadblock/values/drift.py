"""What the self-check found: how the right camera has turned against what the rig says, and how sure that is."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray, finite, numbers, positive

DriftState = Literal["unknown", "ok", "moved"]


@dataclass(frozen=True, eq=False)
class RigDrift:
    """The turn of the right camera against the rig, in the rectified frame.

    Attributes
    ----------
    state
        "unknown" (too little evidence to say), "ok", or "moved".
    reason
        Why, in a sentence.
    turn_deg
        (3,) pitch, yaw, roll: the rotation vector about the rectified axes x (right), y (down), z (forward), by which
        the right camera is turned against the rig. Pitch > 0: it looks further up; yaw > 0: further to the right, away
        from the left camera; roll > 0: its right side is further down. NaN where unknown.
    cov_deg2
        (3, 3) covariance of the measurement; rows and columns of what is unknown are NaN.
    rig_cov_deg2
        (3, 3) covariance of what the rig itself says of them; NaN where it says nothing.
    epipolar_yaw_deg, epipolar_yaw_sigma_deg
        The yaw that vertical disparities alone ask for, were the lenses exactly known; NaN where unknown.
    frames, features
        Pairs looked at, and features per pair that fit.
    motions
        Stretches of driving whose image expansion the yaw is from.
    f_px, baseline_m, width_px
        Of the rectified cameras.

    Raises
    ------
    ValueRefusedError
        If a number has another shape, a count is negative, or there is no such state.
    """

    state: DriftState
    reason: str
    turn_deg: FloatArray
    cov_deg2: FloatArray
    rig_cov_deg2: FloatArray
    epipolar_yaw_deg: float
    epipolar_yaw_sigma_deg: float
    frames: int
    features: float
    motions: int
    f_px: float
    baseline_m: float
    width_px: int

    def __post_init__(self) -> None:
        if self.state not in get_args(DriftState):
            raise ValueRefusedError(f"state must be one of {', '.join(get_args(DriftState))}, but got {self.state!r}")
        object.__setattr__(self, "turn_deg", numbers("turn_deg", self.turn_deg, (3,)))
        for name in ("cov_deg2", "rig_cov_deg2"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), (3, 3)))
        for name in ("epipolar_yaw_deg", "epipolar_yaw_sigma_deg"):
            object.__setattr__(self, name, float(numbers(name, getattr(self, name), ())))
        for name in ("f_px", "baseline_m"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("frames", "features", "motions"):
            if finite(name, getattr(self, name), ()) < 0:
                raise ValueRefusedError(f"{name} must be >= 0, but got {getattr(self, name)}")

    @property
    def sigma_deg(self) -> FloatArray:
        """(3,) standard deviations of `turn_deg`, of the measurement alone."""
        return np.asarray(np.sqrt(self.cov_deg2.diagonal()))

    @property
    def yaw_deg(self) -> float:
        """Vergence error; NaN where unknown."""
        return float(self.turn_deg[1])

    @property
    def yaw_sigma_deg(self) -> float:
        """Its standard deviation."""
        return float(self.sigma_deg[1])

    @property
    def disparity_offset_px(self) -> float:
        """By how much disparities in the middle of the image are measured too large; NaN where unknown."""
        return float(self.f_px * np.radians(self.turn_deg[1]))

    @property
    def vertical_offset_px(self) -> float:
        """How far down from its row the right image shows what the left one shows in the middle."""
        return float(self.f_px * np.radians(self.turn_deg[0]))

    @property
    def roll_offset_px(self) -> float:
        """The same at the image's left edge, as the roll makes it, less the middle's."""
        return float(self.width_px / 2 * np.radians(self.turn_deg[2]))

    def range_error_m(self, range_m: float) -> float:
        """Return measured less true range of what stands at `range_m`, ahead in the middle; NaN where unknown.

        Infinity where the rig shows it beyond infinity.
        """
        d_px = self.f_px * self.baseline_m / range_m + self.disparity_offset_px
        return np.inf if d_px <= 0 else self.f_px * self.baseline_m / d_px - range_m
