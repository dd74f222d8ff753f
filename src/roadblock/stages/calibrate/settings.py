"""What a calibration may be told."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class CalibrateSettings(BaseModel):
    """How a rig is calibrated."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    lens: Literal["auto", "brown_conrady5", "brown_conrady8", "kannala_brandt"] = Field(
        "auto", description="Lens model of both cameras; auto: the one that predicts views best that it did not see."
    )
