"""What can be set about tracking."""

from pydantic import BaseModel, ConfigDict, Field


class TrackSettings(BaseModel):
    """How obstacles are followed over time."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    enabled: bool = Field(True, description="Whether sequences are tracked at all.")
    noise_m2ps3: float = Field(0.5, gt=0, description="How fast velocities change: 1 m/s a second is 1.")
    gate: float = Field(16.3, gt=0, description="Squared distance (3 numbers) within which a measurement fits.")
    coast_s: float = Field(0.4, ge=0, description="So long an obstacle is reported though it is not measured.")
    forget_s: float = Field(1.0, gt=0, description="So long it is kept in mind if nothing hides it, ...")
    hidden_s: float = Field(2.0, gt=0, description="... and behind something.")
    contradicted_s: float = Field(0.25, gt=0, description="So long where free road is seen instead.")
    longest_gap_s: float = Field(1.5, gt=0, description="After a longer gap without frames all starts anew.")
