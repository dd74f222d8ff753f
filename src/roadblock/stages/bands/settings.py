"""What can be set about the paper's own method."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field, PositiveInt, field_validator


class BandsSettings(BaseModel):
    """How grey targets are cut out, cut into bands, and matched."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    background: Literal["road", "local"] = Field(
        "road", description="A target differs from the road's grey in its row, or from its wide neighbourhood's."
    )
    threshold: Literal["spread", "otsu"] = Field(
        "spread", description="The threshold follows the road's own spread of grey, or Otsu's method."
    )
    polarity: Literal["both", "dark", "bright"] = Field("both", description="Targets darker or brighter than the road.")
    spreads: float = Field(2.5, gt=0, description="Threshold in standard deviations of the road's grey.")
    contrast: float = Field(15.0, gt=0, description="Least threshold, grey levels.")
    blur_px: float = Field(1.0, ge=0, description="Smoothing before the threshold, against the road's texture.")
    close_px: int = Field(5, ge=1, description="Holes and gaps up to this width are closed.")
    pitch_deg: float = Field(0.0, gt=-45, lt=45, description="How far the cameras look down: places the horizon.")
    camera_height_m: float | None = Field(None, gt=0, description="Over the road; None: no ground is reported.")

    separation: Literal["valleys", "watershed", "none"] = Field(
        "valleys", description="How fused targets are told apart: at valleys of their projection, or by watershed."
    )
    valley_share: float = Field(0.35, gt=0, lt=1, description="A valley is lower than this share of both its sides.")
    area_px: int = Field(60, ge=1, description="Smaller targets are dropped.")

    bands: float = Field(12.0, gt=0, description="Bands a target is cut into at no relative speed.")
    relative_speed_mps: float = Field(30 / 3.6, description="Of the targets; the paper drives at 30 km/h.")
    halving_speed_mps: float = Field(10.0, gt=0, description="The relative speed that halves the interval.")
    interval_px: tuple[PositiveInt, PositiveInt] = Field((2, 40), description="Smallest and largest band interval.")

    disparity_px: float = Field(192.0, gt=0, description="Largest disparity of matched ends.")
    length_share: float = Field(0.25, ge=0, description="Matched lengths differ by at most this share ...")
    length_px: float = Field(2.0, gt=0, description="... and this.")
    least_segments: int = Field(3, ge=1, description="Matched segments that make a target.")
    height_m: float = Field(0.1, ge=0, description="Lower targets are no obstacle, where the camera height is given.")
    overhead_m: float = Field(1.0, gt=0, description="What begins higher hangs over the road, or was matched wrongly.")
    reach_m: float = Field(60.0, gt=0, description="Nothing further away is reported.")
    keep_flat: bool = Field(False, description="Report paint and shadows on the road too, as the paper's figure does.")

    @field_validator("interval_px")
    @classmethod
    def _rises(cls, limits: tuple[int, int]) -> tuple[int, int]:
        if limits[0] > limits[1]:
            raise ValueError("the first must not be above the second")
        return limits
