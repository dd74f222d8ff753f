"""What moves: the vehicle itself between two frames, and an obstacle over time."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray, numbers, rigid_transform

MOTIONS = ("moving", "standing", "unknown")


@dataclass(frozen=True, eq=False)
class Flow:
    """Features of the picture that were followed from one frame to the next.

    Attributes
    ----------
    uvd_px
        (k, 3) where they are now: column, row, disparity.
    off_px
        (k, 3) how far that is from where they would be if they stood still.
    information_px2
        (k, 3, 3) inverse covariance of `off_px`, per square pixel.
    """

    uvd_px: FloatArray
    off_px: FloatArray
    information_px2: FloatArray


@dataclass(frozen=True, eq=False)
class EgoMotion:
    """How the cameras moved between two frames, or why nobody knows.

    Attributes
    ----------
    before_t_ns, t_ns
        The two frames.
    T_now_before
        (4, 4) pose of the car frame of the earlier frame in that of the later one; None if unknown.
    cov
        (6, 6) covariance of a small motion (rotation vector, translation; rad and m, axes of the later frame) that goes
        on top: `exp(small) @ T_now_before`. NaN if unknown.
    reason
        Why it is unknown, in words; empty if it is known.
    used
        How many features agree with it.
    flow
        All features, those that disagree too; None if the motion is unknown.

    Raises
    ------
    ValueRefusedError
        If the later frame is not later, the motion is no rigid transform, the covariance not 6x6, or a motion is
        missing without a reason.
    """

    before_t_ns: int
    t_ns: int
    T_now_before: FloatArray | None
    cov: FloatArray
    reason: str = ""
    used: int = 0
    flow: Flow | None = None

    def __post_init__(self) -> None:
        if self.t_ns <= self.before_t_ns:
            raise ValueRefusedError(f"t_ns must be after {self.before_t_ns}, but got {self.t_ns}")
        if (self.T_now_before is None) != bool(self.reason):
            raise ValueRefusedError("a motion must be known, or unknown for a reason")
        if self.T_now_before is not None:
            object.__setattr__(self, "T_now_before", rigid_transform("T_now_before", self.T_now_before))
        object.__setattr__(self, "cov", numbers("cov", self.cov, (6, 6)))

    @classmethod
    def unknown(cls, before_t_ns: int, t_ns: int, reason: str) -> Self:
        """Return that nobody knows, and why."""
        return cls(before_t_ns, t_ns, None, np.full((6, 6), np.nan), reason)


@dataclass(frozen=True, eq=False)
class Track:
    """One obstacle over time.

    Attributes
    ----------
    id
        Its number: unique for a run, from 1.
    age_s
        How long it has been known.
    coasted_s
        How long ago it was measured last; 0 when it was in this frame.
    position_m, position_cov_m2
        (3,) filtered place of what `Obstacle.uvd_px` measures, vehicle frame, metres; (3, 3) its covariance from
        matching noise. The calibration's stays beside, in `Obstacle.cov_calib_m2`.
    velocity_mps, velocity_cov_m2ps2
        (2,) along the vehicle's x and y, m/s; (2, 2) its covariance.
    is_over_ground
        Whether the velocity is over ground; relative to the vehicle where its own motion is unknown.
    motion
        One of `MOTIONS`; "unknown" where the velocity is not over ground or not known well enough.
    ttc_s, ttc_sigma_s
        Time until its nearest face is level with the cameras if both go on as they do, and its standard deviation;
        NaN where it does not come closer for sure.

    Raises
    ------
    ValueRefusedError
        If there is no such motion.
    """

    id: int
    age_s: float
    coasted_s: float
    position_m: FloatArray
    position_cov_m2: FloatArray
    velocity_mps: FloatArray
    velocity_cov_m2ps2: FloatArray
    is_over_ground: bool
    motion: str
    ttc_s: float
    ttc_sigma_s: float

    def __post_init__(self) -> None:
        if self.motion not in MOTIONS:
            raise ValueRefusedError(f"motion must be one of {', '.join(MOTIONS)}, but got {self.motion!r}")

    @classmethod
    def known(cls, **fields: object) -> Self:
        """Return a track of fields that need no check, from a stage that made them itself."""
        track = object.__new__(cls)
        object.__setattr__(track, "__dict__", fields)
        return track

    @property
    def velocity_sigma_mps(self) -> FloatArray:
        """(2,) standard deviations of the velocity, m/s."""
        return np.sqrt(np.diag(self.velocity_cov_m2ps2))
