"""OpenCV's block matching and semi-global block matching, and what both need around them."""

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.stages.match.settings import Matcher, MatchSettings
from roadblock.values.frame import Gray

UNITS_PER_PX = 16
"""OpenCV's disparities are int16 in sixteenths of a pixel; this coding stays inside this file."""


def match_sgbm(left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.int16]:
    """OpenCV's semi-global block matching, in its own units."""
    area = settings.block_px**2
    modes: dict[str, Any] = {
        "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
        "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
        "hh": cv2.STEREO_SGBM_MODE_HH,
        "hh4": cv2.STEREO_SGBM_MODE_HH4,
    }
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=settings.disparities,
        blockSize=settings.block_px,
        P1=8 * area,
        P2=32 * area,
        disp12MaxDiff=1,
        preFilterCap=31,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=settings.speckle_px,
        speckleRange=1,
        mode=modes[settings.mode],
    )
    return np.asarray(matcher.compute(left, right))


def match_bm(left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.int16]:
    """OpenCV's block matching, in its own units. Windows of 5 px and more; nothing is matched where none fits."""
    block_px = max(5, settings.block_px)
    if min(left.shape) <= block_px:
        return np.full(left.shape, -UNITS_PER_PX, np.int16)
    matcher = cv2.StereoBM.create(settings.disparities, block_px)
    matcher.setUniquenessRatio(settings.uniqueness_percent)
    matcher.setSpeckleWindowSize(settings.speckle_px)
    matcher.setSpeckleRange(1)
    matcher.setDisp12MaxDiff(1)
    return np.asarray(matcher.compute(left, right))


def in_pixels(match_units: Callable[[Gray, Gray, MatchSettings], NDArray[np.int16]]) -> Matcher:
    """Return a matcher in pixels made of one in OpenCV's units.

    OpenCV leaves the left `disparities` columns out, though far things are matched there too; so both images get
    that many columns on their left, and what points into them is dropped again.
    """

    def match_px(left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.float32]:
        pad = settings.disparities
        left, right = (np.pad(i, ((0, 0), (pad, 0)), mode="edge") for i in (left, right))
        units = match_units(left, right, settings)[:, pad:]
        d_px = units.astype(np.float32) / np.float32(UNITS_PER_PX)
        seen_by_both = d_px <= np.arange(d_px.shape[1], dtype=np.float32)
        # The last step of the search is where a matcher puts what it cannot match.
        at_the_end = d_px >= settings.disparities - 1
        d_px[(units <= 0) | at_the_end | ~seen_by_both] = np.nan
        return d_px

    return match_px
