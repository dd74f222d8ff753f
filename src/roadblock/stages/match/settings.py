"""What can be set about matching, and the greys that every matcher gets."""

from collections.abc import Callable
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator

from roadblock.values.frame import Image

Gray = NDArray[np.uint8]


class MatchSettings(BaseModel):
    """How disparities are found."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    matcher: Literal["region", "sgbm", "bm"] = Field("sgbm", description="Entry of MATCHERS.")
    disparities: int = Field(
        128, ge=16, le=1024, multiple_of=16, description="Search range in px; the nearest range is f*B/this."
    )
    block_px: int = Field(
        3, ge=1, le=21, description="Width of the matching window (odd; bm and region take at least 5)."
    )
    cost: Literal["sad", "ssd", "ncc", "zncc", "census"] = Field(
        "zncc", description="How region compares two windows; zncc and census do not mind gain and offset."
    )
    mode: Literal["hh4", "hh", "sgbm", "3way"] = Field(
        "hh4",
        description="Paths of SGBM. 3way and sgbm look one way only and bend slanted roads by 0.1 to 0.3 px.",
    )
    uniqueness_percent: int = Field(10, ge=0, le=100, description="Margin of the winner over the second best.")
    speckle_px: int = Field(100, ge=0, description="Islands of disparity smaller than this are dropped.")
    both_ways: bool = Field(
        False, description="Match right to left as well and take the mean: twice the time, no side preferred."
    )
    sigma_px: float = Field(0.5, gt=0, description="One standard deviation of one disparity.")

    @field_validator("block_px")
    @classmethod
    def _is_odd(cls, block_px: int) -> int:
        if block_px % 2 == 0:
            raise ValueError("must be odd")
        return block_px


Matcher = Callable[[Gray, Gray, MatchSettings], NDArray[np.float32]]
"""Left and right grey image in; disparities of the left one out, pixels, NaN where unknown."""


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
