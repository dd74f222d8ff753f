"""What the two methods with one camera assume about camera and world."""

import math
from dataclasses import dataclass

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, field_validator

AUTO = "auto"


@dataclass(frozen=True)
class Build:
    """What a type of thing measures: a cuboid, and how much of the cuboid's silhouette the thing covers.

    Attributes
    ----------
    width_m, height_m, length_m
        Of the cuboid: width across and length along its own front direction.
    fill
        Area of the thing's outline, holes filled, as a share of the cuboid's, 0..1.
    spread
        Standard deviation of all three sizes within the type, as a share.
    """

    width_m: float
    height_m: float
    length_m: float
    fill: float
    spread: float = 0.05


BUILDS: dict[str, Build] = {
    "person": Build(0.55, 1.75, 0.30, 0.52),
    "bicycle": Build(0.55, 1.05, 1.75, 0.55),
    "car": Build(1.80, 1.50, 4.40, 0.85, 0.08),
    "fork": Build(4.10, 2.20, 10.0, 0.35),
    "box": Build(1.00, 1.00, 1.00, 1.0, 0.35),
}
"""The types that `mono_area` knows; assumptions (docs/mono-baselines.md)."""


class MonoSettings(BaseModel):
    """What is known beforehand, and how well."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    height_m: float = Field(1.4, gt=0, description="Of the cameras above the road: known, not found.")
    pitch_deg: float | None = Field(None, gt=-45, lt=45, description="Known pitch (> 0 = down); none = found.")
    roll_deg: float = Field(0.0, gt=-45, lt=45, description="Known roll (> 0 = left up); never found.")
    kind: str = Field(AUTO, description="Type that mono_area takes everything for; auto = by its size.")
    largest_pitch_deg: float = Field(10.0, gt=0, lt=45, description="The horizon is looked for up to here.")
    segment_px: float = Field(20.0, gt=2, description="Shorter line segments have no vote for the horizon.")
    horizon_px: float = Field(3.0, gt=0, description="A horizon known worse than this is none.")
    road_chroma: float = Field(6.0, gt=0, description="Furthest from the road's own colour, CIELAB a and b.")
    road_lightness: tuple[PositiveFloat, PositiveFloat] = Field(
        (0.58, 1.25), description="Darkest (shadow) and brightest road, as a share of its typical CIELAB lightness."
    )
    standing_m: float = Field(0.35, gt=0, description="Things lower than this are not seen.")
    tallest_m: float = Field(2.2, gt=0, description="Outlines end here.")
    reach_m: float = Field(40.0, gt=0, description="Nothing further away is reported.")
    contact_sigma_px: float = Field(1.0, gt=0, description="Noise of a contact row.")
    stance_sigma_m: float = Field(0.15, ge=0, description="How far a thing's contact lies from its nearest face.")
    outline_sigma_px: float = Field(0.5, gt=0, description="How far a whole outline may lie too far out or in.")
    pitch_sigma_deg: float = Field(0.1, gt=0, description="Noise of the pitch.")
    height_sigma: float = Field(0.01, gt=0, description="Error of the known camera height, as a share.")

    @field_validator("kind")
    @classmethod
    def _is_known(cls, kind: str) -> str:
        if kind != AUTO and kind not in BUILDS:
            raise ValueError(f"must be {AUTO} or one of {', '.join(BUILDS)}")
        return kind

    @field_validator("road_lightness")
    @classmethod
    def _rises(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the first must be below the second")
        return limits

    @property
    def pitch_sigma_rad(self) -> float:
        """Noise of the pitch, radians."""
        return math.radians(self.pitch_sigma_deg)
