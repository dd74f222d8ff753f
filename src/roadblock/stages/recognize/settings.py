"""Settings of recognition."""

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class RecognizeSettings(BaseModel):
    """What is said of an obstacle, and by whom."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    recognizer: Literal["none", "shape", "onnx"] = Field(
        "shape", description="none: nothing is said; shape: type, colour, contour, outline; onnx: types by a network."
    )
    least_probability: float = Field(
        0.45, ge=0, le=1, description="A type less probable than this is not named: the obstacle stays unknown."
    )
    network: str = Field("", description="YAML file that describes the network of `onnx` (docs/recognition.md).")
