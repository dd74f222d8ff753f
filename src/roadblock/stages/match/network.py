"""A learned stereo network of one's own as a matcher: a short YAML file beside the model says what it wants."""

from functools import lru_cache
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from roadblock.errors import SettingsError
from roadblock.network import Floats32, Session, Side, Three, as_bytes, as_input, read_description
from roadblock.stages.match.settings import MatchSettings
from roadblock.values.frame import Image, RectifiedPair


class StereoNetworkDescription(BaseModel):
    """How a stereo network wants its two images, and how it says disparities. See docs/stereo-networks.md."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    model: str = Field(description="The ONNX file, beside this one.")
    input_px: tuple[Side, Side] = Field(description="Width and height of each image.")
    colors: Literal["rgb", "bgr", "gray"] = "rgb"
    mean: Three = (0.0, 0.0, 0.0)
    std: Three = (1.0, 1.0, 1.0)
    keep_shape: bool = Field(True, description="Shrink to fit and pad right and below; otherwise stretch.")
    left: str = Field("", description="Name of the input of the left image; the first one if not given.")
    output: str = Field("", description="Name of the disparities; the first output if not given.")
    scale: float = Field(1.0, description="Pixels of the network's own image per unit of its output.")
    confidence: str = Field("", description="Name of an output that says how sure each pixel is.")
    least_confidence: float = Field(0.5, description="Less sure ones are unknown.")


class StereoNetwork:
    """A described network, ready to match.

    Raises
    ------
    SettingsError
        If the description or the model cannot be read, or they do not fit together.
    MissingExtraError
        If ONNX Runtime is not installed.
    """

    def __init__(self, path: Path) -> None:
        self.about = read_description(path, StereoNetworkDescription, {})
        self.session = Session(path.parent / self.about.model, images=2)
        width, height = self.about.input_px
        names = [name for name in (self.about.output, self.about.confidence) if name]
        self.session.check(path, (1, 1 if self.about.colors == "gray" else 3, height, width), names)
        self._inputs = list(self.session.inputs)
        if self.about.left:
            if self.about.left not in self._inputs:
                raise SettingsError(
                    f"{path}: the network has no input {self.about.left!r}; it has: {', '.join(self._inputs)}"
                )
            self._inputs.sort(key=lambda name: name != self.about.left)
        self._outputs = [self.about.output or self.session.outputs[0], *filter(None, [self.about.confidence])]

    def __call__(self, pair: RectifiedPair) -> NDArray[np.float32]:
        """Return (height, width) disparities of the left image, pixels.

        NaN where the network says none above 0, is not sure, or points out of the right image.

        Raises
        ------
        SettingsError
            If it fails, or its outputs are no images of the size it takes.
        """
        height, width = pair.left.shape[:2]
        wide, tall = self.about.input_px
        across, down = wide / width, tall / height
        if self.about.keep_shape:
            across = down = min(across, down)
        size = max(round(width * across), 1), max(round(height * down), 1)
        images = [self._prepared(image, size) for image in (pair.left, pair.right)]
        maps = self.session.run(dict(zip(self._inputs, images, strict=True)), self._outputs)
        for found in maps:
            if found.size != wide * tall:
                raise SettingsError(
                    f"the stereo network's output {list(found.shape)} is no image of {wide}x{tall} px: name the one "
                    "that holds disparities"
                )
        # The nearest one: between two surfaces there is none.
        shown = [found.reshape(tall, wide)[: size[1], : size[0]] for found in maps]
        units, *sure = (cv2.resize(found, (width, height), interpolation=cv2.INTER_NEAREST) for found in shown)
        d_px = np.asarray(units * np.float32(self.about.scale * width / size[0]), np.float32)
        known = (d_px > 0) & (d_px <= np.arange(width))
        for confidence in sure:
            known &= confidence >= self.about.least_confidence
        d_px[~known] = np.nan
        return d_px

    def _prepared(self, image: Image, size: tuple[int, int]) -> Floats32:
        """Return an image as the network takes it."""
        image = as_bytes(image)
        is_gray = self.about.colors == "gray"
        if (image.ndim == 2) != is_gray:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY if is_gray else cv2.COLOR_GRAY2RGB))
        shrunk = cv2.resize(image, size, interpolation=cv2.INTER_AREA).reshape(size[1], size[0], -1)
        wide, tall = self.about.input_px
        padded = np.pad(shrunk, ((0, tall - size[1]), (0, wide - size[0]), (0, 0)), mode="edge")
        return as_input(padded, self.about.colors, self.about.mean, self.about.std)


def stereo_network(settings: MatchSettings) -> StereoNetwork:
    """Return the network that the settings name, read once; errors as `StereoNetwork`, and where none is named."""
    if not settings.network:
        raise SettingsError("matcher onnx needs a network: set match.network to the YAML file that describes it")
    path = Path(settings.network)
    return _opened(path, path.stat().st_mtime_ns if path.exists() else 0)


@lru_cache(maxsize=4)
def _opened(path: Path, _changed_ns: int) -> StereoNetwork:
    return StereoNetwork(path)
