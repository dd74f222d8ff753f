"""What must be said of a network so that it can be used: a short YAML file beside the model."""

from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from roadblock.errors import SettingsError
from roadblock.stages.recognize.types import CLASSES

Three = Annotated[tuple[float, float, float], Field()]
Type = Literal[
    "person", "bicycle", "car", "truck", "railing", "pole", "fork", "wall", "vegetation", "debris", "unknown"
]


class NetworkDescription(BaseModel):
    """How a detector network wants its image, and how it says what it saw. See docs/recognition.md."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    model: str = Field(description="The ONNX file, beside this one.")
    layout: Literal["yolox", "yolov8", "rtdetr", "ssd"]
    input_px: tuple[Annotated[int, Field(ge=8, le=4096)], Annotated[int, Field(ge=8, le=4096)]] = Field(
        description="Width and height."
    )
    colors: Literal["rgb", "bgr"] = "rgb"
    mean: Three = (0.0, 0.0, 0.0)
    std: Three = (1.0, 1.0, 1.0)
    letterbox: bool = Field(True, description="Keep the image's shape and pad; otherwise stretch.")
    centered: bool = Field(False, description="Padding on both sides, not only right and below.")
    pad: int = Field(114, ge=0, le=255)
    strides: tuple[int, ...] = Field((8, 16, 32), description="Of the undecoded grids of yolox.")
    decoded: bool = Field(False, description="Whether yolox boxes come in pixels already.")
    outputs: tuple[str, ...] = Field((), description="Names: boxes, scores (rtdetr); boxes, classes, scores (ssd).")
    boxes: Literal["yxyx", "xyxy"] = Field("yxyx", description="Order of the corners of ssd, as shares of the image.")
    least_score: float = Field(0.3, ge=0, le=1)
    overlap: float = Field(0.5, gt=0, le=1, description="Of boxes that overlap more, the surest stays.")
    classes: dict[int, Type] = Field(min_length=1, description="The network's class numbers and our types.")


def read_description(path: Path) -> NetworkDescription:
    """Read a description.

    Raises
    ------
    SettingsError
        If there is no such file, it is no YAML, or a field is missing, unknown or does not fit.
    """
    try:
        values = yaml.safe_load(path.read_text("utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = getattr(error, "strerror", None) or " ".join(str(error).split())
        raise SettingsError(f"{path}: cannot be read as the description of a network: {reason}") from error
    try:
        return NetworkDescription.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "the file"
        hint = f" (our types: {', '.join(CLASSES)})" if field.startswith("classes") else ""
        raise SettingsError(f"{path}: {field}: {first['msg']}{hint}") from error
