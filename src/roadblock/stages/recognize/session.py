"""The one door to ONNX Runtime: a model file in; a function from arrays to arrays out."""

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import MissingExtraError, SettingsError

Floats32 = NDArray[np.float32]
INPUTS = {"tensor(float)": np.float32, "tensor(float16)": np.float16, "tensor(uint8)": np.uint8}
"""What a network may take."""


class Session:
    """A network, ready to run.

    Parameters
    ----------
    path
        The ONNX file; whole, without data in files beside it, and without operators of its own.

    Raises
    ------
    MissingExtraError
        If ONNX Runtime is not installed.
    SettingsError
        If the file cannot be read or run.
    """

    def __init__(self, path: Path) -> None:
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
        if len(inputs) != 1 or inputs[0].type not in INPUTS:
            found = ", ".join(f"{i.name} {i.type}" for i in inputs)
            raise SettingsError(f"{path} must take one image of numbers, but takes: {found}")
        self.name, self.shape, self._dtype = inputs[0].name, tuple(inputs[0].shape), INPUTS[inputs[0].type]
        self.outputs = tuple(output.name for output in self._session.get_outputs())

    def run(self, image: Floats32, outputs: Sequence[str]) -> list[Floats32]:
        """Return the named outputs for a (1, channels, height, width) image; all of them where none is named.

        Raises
        ------
        SettingsError
            If the network fails on it.
        """
        try:
            found = self._session.run(list(outputs) or None, {self.name: image.astype(self._dtype)})
        except Exception as error:
            raise SettingsError(f"the network failed: {' '.join(str(error).split()):.160}") from error
        return [np.asarray(array, np.float32) for array in found]
