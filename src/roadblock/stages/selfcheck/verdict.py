"""From evidence to a verdict: what has turned, by how much, and whether that is beyond doubt."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from roadblock.stages.selfcheck.epipolar import Turn
from roadblock.stages.selfcheck.expansion import Stretch, combined
from roadblock.stages.selfcheck.settings import SelfcheckSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.drift import RigDrift

TRACK_BIAS_PX = 0.025
"""What disparities of a whole drive may be off by on average: windows change as things come nearer. Measured on drives
with exact truth, whose yaws scatter by so much more than their own sigmas."""
LEAST_STRETCHES = 3
"""Before their scatter says something."""
RULED_OUT_SIGMAS = 4.0
"""Yaws that differ by more cannot both be right."""
CLEARED = 0.7
"""An alarm ends where what raised it falls below this share of its limits."""
RANGE_M = 20.0
"""At which errors are told."""


def measure(
    turn: Turn, stretches: Sequence[Stretch], rig_cov_rad2: FloatArray, frames: int, rectification: Rectification
) -> RigDrift:
    """Put the evidence together; no verdict yet.

    The yaw is that of image expansion, or of vertical disparities if they are surer: their sigma includes what the
    rig's lenses may feign, and is unknown where the rig has no covariance.

    Parameters
    ----------
    turn
        By vertical disparities.
    stretches
        Of driving.
    rig_cov_rad2
        (4, 4) as `trust.turn_covariance` returns it.
    frames
        How many pairs the turn is from.
    rectification
        The twin cameras.
    """
    mean, cov = turn.turn_rad.copy(), turn.cov_rad2.copy()
    rig_cov = rig_cov_rad2[:3, :3].copy()
    feigned = rig_cov_rad2[3, 3]
    yaws = [(turn.turn_rad[1], cov[1, 1] + feigned, feigned)]
    if len(stretches) >= LEAST_STRETCHES:
        yaw, sigma = combined(stretches)
        yaws.append((yaw, sigma**2 + (TRACK_BIAS_PX / rectification.f_px) ** 2, rig_cov[1, 1]))
    known = [(yaw, variance) for yaw, variance, _ in yaws if np.isfinite(variance)]
    mean[1], variance = min(known, key=lambda pair: pair[1], default=(np.nan, np.nan))
    epipolar = float(np.degrees(turn.turn_rad[1])), float(np.degrees(np.sqrt(cov[1, 1])))
    cov[1], cov[:, 1] = (0.0, 0.0) if np.isfinite(variance) else (np.nan, np.nan)
    cov[1, 1] = variance
    return RigDrift(
        "unknown",
        "",
        np.degrees(mean),
        np.degrees(np.degrees(cov)),
        np.degrees(np.degrees(rig_cov)),
        *epipolar,
        frames,
        turn.used / max(frames, 1),
        len(stretches),
        rectification.f_px,
        rectification.baseline_m,
        rectification.size_px[0],
    )


def offsets_px(drift: RigDrift) -> FloatArray:
    """Return (3,) what pitch, yaw and roll do to the right image: middle row, disparity, row at the edge; pixels."""
    return np.array([drift.vertical_offset_px, drift.disparity_offset_px, drift.roll_offset_px])


def offset_sigmas_px(drift: RigDrift) -> FloatArray:
    """Return (3,) their standard deviations, by the measurement alone."""
    return np.radians(drift.sigma_deg) * (drift.f_px, drift.f_px, drift.width_px / 2)


def is_off(drift: RigDrift, settings: SelfcheckSettings, share: float = 1.0) -> NDArray[np.bool_]:
    """Return (3,) which of pitch, yaw and roll are notable and beyond their own and the rig's sigma.

    `share` of the limits is enough. What is unknown is not off.
    """
    total = np.sqrt(drift.cov_deg2.diagonal() + np.nan_to_num(drift.rig_cov_deg2.diagonal()))
    notable = np.abs(offsets_px(drift)) >= share * settings.notable_px
    return np.asarray(notable & (np.abs(drift.turn_deg) >= share * settings.alarm_sigmas * total))


def is_sure(drift: RigDrift, settings: SelfcheckSettings) -> bool:
    """Whether all three are known well enough to call the rig ok."""
    return bool((offset_sigmas_px(drift) <= settings.sure_px).all())


def worded(drift: RigDrift, alarmed: bool, settings: SelfcheckSettings) -> RigDrift:
    """Return the drift with its state and the reason in words."""
    if alarmed:
        return replace(drift, state="moved", reason=_why_moved(drift, settings) + _contradiction(drift))
    if is_sure(drift, settings):
        return replace(drift, state="ok", reason="the cameras stand as the rig says" + _contradiction(drift))
    return replace(drift, state="unknown", reason=_why_unknown(drift, settings))


def _why_moved(drift: RigDrift, settings: SelfcheckSettings) -> str:
    looks = (("looks", "further up", "further down"), ("looks", "further to the right", "further to the left"))
    words = (*looks, ("is turned", "clockwise", "counterclockwise"))
    off = is_off(drift, settings, CLEARED)
    if not off.any():
        return "the right camera has moved"
    parts = []
    for index in np.flatnonzero(off):
        turn, sigma = drift.turn_deg[index], drift.sigma_deg[index]
        parts.append(f"{words[index][0]} {abs(turn):.3f} ± {sigma:.3f} deg {words[index][1 if turn > 0 else 2]}")
    said = f"the right camera {', '.join(parts)} {'than the rig says' if off[:2].any() else 'against the rig'}"
    if off[1]:
        said += (
            f": disparities are {drift.disparity_offset_px:+.2f} px off, ranges {drift.range_error_m(RANGE_M):+.2f} m "
            f"at {RANGE_M:.0f} m"
        )
    return said


def _why_unknown(drift: RigDrift, settings: SelfcheckSettings) -> str:
    if not drift.features:
        return "too few features in the images (dark, blurred, covered, or nothing to see)"
    if np.isnan(drift.yaw_deg):
        return f"the yaw shows only while driving: {drift.motions} of {LEAST_STRETCHES} stretches seen"
    worst = float(np.nanmax(offset_sigmas_px(drift)))
    return f"offsets are known to {worst:.2f} px only, not to {settings.sure_px:g} px"


def _contradiction(drift: RigDrift) -> str:
    """Say where vertical disparities ask for a yaw that image expansion rules out."""
    if drift.motions < LEAST_STRETCHES or np.isnan(drift.yaw_deg):
        return ""
    difference = drift.epipolar_yaw_deg - drift.yaw_deg
    sigma = np.hypot(drift.epipolar_yaw_sigma_deg, drift.yaw_sigma_deg)
    if not abs(difference) > RULED_OUT_SIGMAS * sigma or abs(np.radians(difference)) * drift.f_px < 1:
        return ""
    return (
        f"; vertical disparities alone would ask for a yaw of {drift.epipolar_yaw_deg:+.3f} deg, which image expansion "
        "rules out: the lens calibration is off (principal points, tangential distortion)"
    )
