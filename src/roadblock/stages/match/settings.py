"""What can be set about matching, and what a matcher is."""

from collections.abc import Callable
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from roadblock.values.frame import Gray


class MatchSettings(BaseModel):
    """How disparities are found."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    matcher: Literal["region", "sgbm", "bm", "onnx"] = Field(
        "sgbm", description="Entry of MATCHERS; onnx: a stereo network of one's own."
    )
    network: str | None = Field(None, description="For onnx: the YAML file that describes it.")
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

    @model_validator(mode="after")
    def _is_asked_for_what_it_can(self) -> Self:
        if self.both_ways and self.matcher == "onnx":
            raise ValueError("both_ways is for sgbm, bm and region: a network takes both images at once; leave it out")
        return self


Matcher = Callable[[Gray, Gray, MatchSettings], NDArray[np.float32]]
"""Left and right grey image in; disparities of the left one out, pixels, NaN where unknown."""
