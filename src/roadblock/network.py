"""Networks of one's own: the one door to ONNX Runtime, and the YAML files that describe models.

A model file in; a function from arrays to arrays out.
"""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
import yaml
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from roadblock.errors import MissingExtraError, SettingsError
from roadblock.values.frame import Image

Three = Annotated[tuple[float, float, float], Field()]
Side = Annotated[int, Field(ge=8, le=4096)]
Description = TypeVar("Description", bound=BaseModel)

Floats32 = NDArray[np.float32]
INPUTS = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}
"""What a network may take."""


class Session:
    """A network, ready to run.

    Parameters
    ----------
    path
        The ONNX file; whole, without data in files beside it, and without operators of its own.
    images
        How many images it must take.

    Raises
    ------
    MissingExtraError
        If ONNX Runtime is not installed.
    SettingsError
        If the file cannot be read or run.
    """

    def __init__(self, path: Path, images: int = 1) -> None:
        try:
            import onnxruntime
        except ImportError as error:
            raise MissingExtraError("running a network", "onnx") from error
        try:
            data = path.read_bytes()
        except OSError as error:
            raise SettingsError(f"cannot read the network {path}: {error.strerror or error}") from error
        self.sha256 = hashlib.sha256(data).hexdigest()
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4
        options.intra_op_num_threads = 1
        try:
            # From bytes: data in other files is not looked for.
            self._session: Any = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
        except Exception as error:  # ONNX Runtime has no common class of its own
            reason = " ".join(str(error).split())
            raise SettingsError(
                f"{path} is no network that ONNX Runtime can run: {reason:.160}; it must be one whole ONNX file with "
                "standard operators"
            ) from error
        inputs = self._session.get_inputs()
        if len(inputs) != images or any(i.type not in INPUTS for i in inputs):
            found = ", ".join(f"{i.name} {i.type}" for i in inputs)
            raise SettingsError(f"{path} must take {images} image(s) of numbers, but takes: {found}")
        self.inputs: dict[str, tuple[Any, ...]] = {i.name: tuple(i.shape) for i in inputs}
        self._dtypes = {i.name: INPUTS[i.type] for i in inputs}
        self.outputs = tuple(output.name for output in self._session.get_outputs())

    def check(self, path: Path, wanted: tuple[int, ...], outputs: Sequence[str]) -> None:
        """Refuse a network that takes other images than its description at `path` says, or lacks an output.

        Raises
        ------
        SettingsError
            If it does.
        """
        for shape in self.inputs.values():
            if len(shape) != 4 or any(isinstance(n, int) and n != w for n, w in zip(shape, wanted, strict=True)):
                raise SettingsError(
                    f"{path}: the network takes an input of {list(shape)}, but input_px says {list(wanted)}"
                )
        missing = [name for name in outputs if name not in self.outputs]
        if missing:
            raise SettingsError(f"{path}: the network has no output {missing[0]!r}; it has: {', '.join(self.outputs)}")

    def run(self, images: Mapping[str, Floats32], outputs: Sequence[str]) -> list[Floats32]:
        """Return the named outputs for (1, channels, height, width) images by input; all where none is named.

        Raises
        ------
        SettingsError
            If the network fails on them.
        """
        try:
            given = {name: image.astype(self._dtypes[name]) for name, image in images.items()}
            found = self._session.run(list(outputs) or None, given)
        except Exception as error:
            raise SettingsError(f"the network failed: {' '.join(str(error).split()):.160}") from error
        return [np.asarray(array, np.float32) for array in found]


def as_bytes(image: Image) -> Image:
    """Return an image of 8 or 16 bit as 8 bit."""
    return (image // 257).astype(np.uint8) if image.dtype == np.uint16 else image


def as_input(image: Image, colors: str, mean: Sequence[float], std: Sequence[float]) -> Floats32:
    """Return an image (height, width, channels), RGB or grey, as a network takes it: (1, channels, height, width)."""
    ordered, channels = image[..., ::-1] if colors == "bgr" else image, image.shape[2]
    scaled = (ordered - np.array(mean)[:channels]) / np.array(std)[:channels]
    return np.ascontiguousarray(scaled.transpose(2, 0, 1)[None], np.float32)


def read_description(path: Path, kind: type[Description], hints: Mapping[str, str]) -> Description:
    """Read what a YAML file says of a network.

    Parameters
    ----------
    path
        The file.
    kind
        What must be said.
    hints
        What to add to complaints about fields that begin so.

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
        return kind.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"])) or "the file"
        hint = next((text for start, text in hints.items() if field.startswith(start)), "")
        raise SettingsError(f"{path}: {field}: {first['msg']}{hint}") from error
