"""Match: RectifiedPair in, DisparityMap out. OpenCV's BM and SGBM behind one table."""

from collections.abc import Callable
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from roadblock.values.frame import DisparityMap, Image, RectifiedPair

Gray = NDArray[np.uint8]
UNITS_PER_PX = 16
"""OpenCV's disparities are int16 in sixteenths of a pixel; this coding stays inside this file."""

BLANK_PX, BLANK_STEP = 15, 0.2
"""A window of this size whose mean step is below this many grey levels is blank: even sensor noise makes more."""


class MatchSettings(BaseModel):
    """How disparities are found."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    matcher: Literal["sgbm", "bm"] = Field("sgbm", description="Entry of MATCHERS.")
    disparities: int = Field(
        128, ge=16, le=1024, multiple_of=16, description="Search range in px; the nearest range is f*B/this."
    )
    block_px: int = Field(3, ge=1, le=21, description="Width of the matching window (odd; BM takes at least 5).")
    mode: Literal["hh4", "hh", "sgbm", "3way"] = Field(
        "hh4",
        description="Paths of SGBM. 3way and sgbm look one way only and bend slanted roads by 0.1 to 0.3 px.",
    )
    uniqueness_percent: int = Field(10, ge=0, le=100, description="Margin of the winner over the second best.")
    speckle_px: int = Field(100, ge=0, description="Islands of disparity smaller than this are dropped.")
    sigma_px: float = Field(0.5, gt=0, description="One standard deviation of one disparity.")

    @field_validator("block_px")
    @classmethod
    def _is_odd(cls, block_px: int) -> int:
        if block_px % 2 == 0:
            raise ValueError("must be odd")
        return block_px


Matcher = Callable[[Gray, Gray, MatchSettings], NDArray[np.int16]]


def gray8(left: Image, right: Image) -> tuple[Gray, Gray]:
    """Return both images as 8-bit grey with one common scale, so that gain and offset between them stay.

    16-bit images are stretched from the 0.1th to the 99.9th percentile of the left one.
    """
    grays = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) if i.ndim == 3 else i for i in (left, right)]
    if left.dtype == np.uint16:
        low, high = np.percentile(grays[0], (0.1, 99.9))
        scale = 255.0 / max(high - low, 1.0)
        grays = [np.clip((g.astype(np.float32) - low) * scale + 0.5, 0, 255).astype(np.uint8) for g in grays]
    return np.ascontiguousarray(grays[0]), np.ascontiguousarray(grays[1])


def match_sgbm(left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.int16]:
    """OpenCV's semi-global block matching."""
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
    """OpenCV's block matching, which takes windows of 5 px and more; nothing is matched where none fits."""
    block_px = max(5, settings.block_px)
    if min(left.shape) <= block_px:
        return np.full(left.shape, -UNITS_PER_PX, np.int16)
    matcher = cv2.StereoBM.create(settings.disparities, block_px)
    matcher.setUniquenessRatio(settings.uniqueness_percent)
    matcher.setSpeckleWindowSize(settings.speckle_px)
    matcher.setSpeckleRange(1)
    matcher.setDisp12MaxDiff(1)
    return np.asarray(matcher.compute(left, right))


def _is_blank(gray: Gray) -> NDArray[np.bool_]:
    """Return where nothing can be matched: no step from column to column all around (covered, saturated)."""
    steps = np.abs(np.diff(gray.astype(np.float32), axis=1, prepend=gray[:, :1]))
    return np.asarray(cv2.blur(steps, (BLANK_PX, BLANK_PX)) < BLANK_STEP)


MATCHERS: dict[str, Matcher] = {"sgbm": match_sgbm, "bm": match_bm}


def match(pair: RectifiedPair, settings: MatchSettings) -> DisparityMap:
    """Return the dense disparity map of the left image; NaN where the matcher found none it trusts.

    OpenCV leaves the left `disparities` columns out, though far things are matched there too; so both images get
    that many columns on their left, and what points into them is dropped again.
    """
    left, right = gray8(pair.left, pair.right)
    pad = settings.disparities
    left, right = (np.pad(i, ((0, 0), (pad, 0)), mode="edge") for i in (left, right))
    units = MATCHERS[settings.matcher](left, right, settings)[:, pad:]
    d_px = units.astype(np.float32) / np.float32(UNITS_PER_PX)
    seen_by_both = d_px <= np.arange(d_px.shape[1], dtype=np.float32)
    # The last step of the search is where a matcher puts what it cannot match.
    at_the_end = d_px >= settings.disparities - 1
    d_px[(units <= 0) | at_the_end | ~seen_by_both | _is_blank(left[:, pad:])] = np.nan
    return DisparityMap(d_px, settings.sigma_px)
