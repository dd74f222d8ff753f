"""What can be set about refinement."""

from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator


class RefineSettings(BaseModel):
    """How the disparity of a whole region is measured."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    level: Literal["shape", "fast", "off"] = Field(
        "off", description="fast: least squares over a region; shape: finer, on the raw images, slow; off: as detected."
    )

    @field_validator("level", mode="before")
    @classmethod
    def _off_is_a_word(cls, level: Any) -> Any:
        """YAML reads a plain `off` as false."""
        return "off" if level is False else level
