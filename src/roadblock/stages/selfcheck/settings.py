"""What can be set about the self-check."""

from pydantic import BaseModel, ConfigDict, Field


class SelfcheckSettings(BaseModel):
    """How much evidence the self-check asks for, and when it speaks."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    frames: int = Field(30, ge=1, le=1000, description="Latest pairs whose vertical disparities count.")
    motions: int = Field(8, ge=3, le=100, description="Latest stretches of driving whose image expansion counts.")
    features: int = Field(800, ge=50, le=10_000, description="Cells of the image; each may give one feature.")
    contrast: float = Field(1e-4, gt=0, description="Least strength of a corner, as OpenCV's cornerMinEigenVal.")
    window_px: int = Field(15, ge=5, le=51, description="Width of the window that is matched.")
    vertical_px: float = Field(8.0, gt=0, description="Largest vertical disparity a match may have.")
    least_features: int = Field(60, ge=20, description="Fewer features of a pair say nothing.")
    closing: float = Field(0.2, gt=0, lt=2, description="A stretch ends when disparities have grown by this share ...")
    kept_share: float = Field(0.6, gt=0, lt=1, description="... or fewer than this share of its features are left.")
    growth: float = Field(
        0.08,
        gt=0,
        description="Features growing faster than this share per frame are left out: they are tracked with bias.",
    )
    turning_deg: float = Field(
        1.0, gt=0, description="Stretches turning faster per frame are left out: unequal exposure looks like yaw there."
    )
    notable_px: float = Field(0.1, gt=0, description="Smaller offsets raise no alarm.")
    alarm_sigmas: float = Field(4.0, gt=0, description="Offsets below this many of their sigmas raise no alarm.")
    confirm: int = Field(5, ge=1, description="Pairs in a row that must agree before an alarm.")
    sure_px: float = Field(0.1, gt=0, description="The rig is called ok only if offsets are known to this sigma.")
