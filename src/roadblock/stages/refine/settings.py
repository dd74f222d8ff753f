"""What can be set about refinement."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class RefineSettings(BaseModel):
    """How the disparity of a whole region is measured."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    level: Literal["fast", "off"] = Field("fast", description="fast: least squares over a region; off: as detected.")
