"""How networks say what they saw: raw outputs in; boxes, scores and class numbers out."""

from collections.abc import Callable
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.errors import SettingsError
from roadblock.stages.recognize.description import NetworkDescription
from roadblock.stages.recognize.session import Floats32

Floats = NDArray[np.floating[Any]]


class Seen(NamedTuple):
    """What a network saw: (n, 4) boxes u0, v0, u1, v1 in pixels of its input, (n,) scores 0..1, (n,) class numbers."""

    boxes: Floats
    scores: Floats
    numbers: NDArray[np.int64]


def decode(outputs: list[Floats32], about: NetworkDescription) -> Seen:
    """Return what the network saw, surest first and each thing once.

    Raises
    ------
    SettingsError
        If the outputs are not those of the layout, or there are fewer classes than the description names.
    """
    seen = LAYOUTS[about.layout](outputs, about)
    sure = seen.scores >= about.least_score
    boxes, scores, numbers = seen.boxes[sure], seen.scores[sure], seen.numbers[sure]
    if about.layout in ("yolox", "yolov8") and len(boxes):
        corners = np.concatenate([boxes[:, :2], boxes[:, 2:] - boxes[:, :2]], 1)
        found = cv2.dnn.NMSBoxesBatched(
            corners.tolist(), scores.tolist(), numbers.tolist(), about.least_score, about.overlap
        )
        kept = np.asarray(found, np.int64).ravel()
        boxes, scores, numbers = boxes[kept], scores[kept], numbers[kept]
    order = np.argsort(-scores, kind="stable")
    return Seen(boxes[order], scores[order], numbers[order])


def _yolox(outputs: list[Floats32], about: NetworkDescription) -> Seen:
    """(1, n, 5 + classes): centre and size on the cells of three grids, objectness, classes."""
    rows = _single(outputs, about, lambda shape: shape[1] > shape[2] > 5, "(1, boxes, 5 + classes)")
    if not about.decoded:
        width, height = about.input_px
        sides = [(width // s, height // s, s) for s in about.strides]
        if sum(w * h for w, h, _ in sides) != len(rows):
            raise SettingsError(
                f"the network gives {len(rows)} boxes, but an input of {width}x{height} px with strides "
                f"{list(about.strides)} has {sum(w * h for w, h, _ in sides)}: set input_px and strides, "
                "or decoded: true"
            )
        cells = np.concatenate(
            [np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).reshape(-1, 2) for w, h, _ in sides]
        )
        stride = np.concatenate([np.full((w * h, 1), s) for w, h, s in sides])
        rows = rows.copy()
        rows[:, :2] = (rows[:, :2] + cells) * stride
        rows[:, 2:4] = np.exp(np.minimum(rows[:, 2:4], 20)) * stride
    return _best(_corners(rows[:, :4]), rows[:, 4:5] * rows[:, 5:], about)


def _yolov8(outputs: list[Floats32], about: NetworkDescription) -> Seen:
    """(1, 4 + classes, n): centre and size in pixels, classes."""
    rows = _single(outputs, about, lambda shape: 4 < shape[1] < shape[2], "(1, 4 + classes, boxes)").T
    return _best(_corners(rows[:, :4]), rows[:, 4:], about)


def _rtdetr(outputs: list[Floats32], about: NetworkDescription) -> Seen:
    """Boxes (1, n, 4) as shares of the image, centre and size; logits (1, n, classes)."""
    if (
        len(outputs) != 2
        or outputs[0].ndim != 3
        or outputs[0].shape[2] != 4
        or outputs[1].shape[:2] != outputs[0].shape[:2]
    ):
        raise _unfit(outputs, about, "boxes (1, n, 4) and scores (1, n, classes): name them in outputs")
    boxes = _corners(outputs[0][0]) * np.tile(about.input_px, 2).astype(np.float32)
    return _best(boxes, 1 / (1 + np.exp(-np.clip(outputs[1][0], -50, 50))), about)


def _ssd(outputs: list[Floats32], about: NetworkDescription) -> Seen:
    """Boxes (1, n, 4) as shares of the image, class numbers (1, n), scores (1, n): after suppression."""
    if len(outputs) < 3 or outputs[0].ndim != 3 or outputs[0].shape[2] != 4 or outputs[1].shape != outputs[2].shape:
        raise _unfit(outputs, about, "boxes (1, n, 4), classes (1, n) and scores (1, n): name them in outputs")
    boxes = outputs[0][0][:, [1, 0, 3, 2]] if about.boxes == "yxyx" else outputs[0][0]
    boxes = boxes * np.tile(about.input_px, 2).astype(np.float32)
    return Seen(boxes, outputs[2][0], outputs[1][0].astype(np.int64))


LAYOUTS: dict[str, Callable[[list[Floats32], NetworkDescription], Seen]] = {
    "yolox": _yolox,
    "yolov8": _yolov8,
    "rtdetr": _rtdetr,
    "ssd": _ssd,
}


def _single(
    outputs: list[Floats32], about: NetworkDescription, fits: Callable[[tuple[int, ...]], bool], wanted: str
) -> Floats32:
    if len(outputs) != 1 or outputs[0].ndim != 3 or not fits(outputs[0].shape):
        raise _unfit(outputs, about, wanted)
    only: Floats32 = outputs[0][0]
    return only


def _unfit(outputs: list[Floats32], about: NetworkDescription, wanted: str) -> SettingsError:
    found = ", ".join(str(tuple(array.shape)) for array in outputs)
    return SettingsError(f"the network's outputs {found} are not of layout {about.layout}, which has {wanted}")


def _corners(boxes: Floats32) -> Floats32:
    """Return boxes by their corners, given centre and size."""
    return np.concatenate([boxes[:, :2] - boxes[:, 2:] / 2, boxes[:, :2] + boxes[:, 2:] / 2], 1)


def _best(boxes: Floats32, scores: Floats32, about: NetworkDescription) -> Seen:
    """Return for each box its surest class."""
    if max(about.classes) >= scores.shape[1]:
        raise SettingsError(
            f"the description names class {max(about.classes)}, but the network has {scores.shape[1]} classes, "
            "counted from 0"
        )
    numbers = scores.argmax(1)
    return Seen(boxes, scores[np.arange(len(scores)), numbers], numbers)
