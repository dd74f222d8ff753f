"""`onnx`: types by a network of one's own; all else as `shape` says it. No obstacle is lost, whatever it sees."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from roadblock.errors import SettingsError
from roadblock.geometry.boxes import shared_px2
from roadblock.network import Floats32, Session, as_bytes, as_input
from roadblock.stages.recognize.description import NetworkDescription, read_description
from roadblock.stages.recognize.layouts import Seen, decode
from roadblock.stages.recognize.settings import RecognizeSettings
from roadblock.stages.recognize.shape import ShapeRecognizer
from roadblock.stages.recognize.types import UNKNOWN
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import Detections, Obstacle, Region

INSIDE = 0.6
"""An obstacle is what the network saw if so much of its box lies in the network's, ..."""
TOGETHER_M, TOGETHER_SHARE = 1.5, 0.1
"""... and it is no further, by so much or such a share, from the one that fills the network's box most."""
COVERS = 0.15
"""That one covers at least so much of it."""


class NetworkRecognizer:
    """Recognises by a network.

    Parameters
    ----------
    settings
        Which network, and how sure a type must be.
    T_vehicle_car
        The rig's mounting, or None.

    Raises
    ------
    SettingsError
        If no description is named, or it and the network do not fit together.
    MissingExtraError
        If ONNX Runtime is not installed.
    """

    def __init__(self, settings: RecognizeSettings, T_vehicle_car: FloatArray | None = None) -> None:
        if not settings.network:
            raise SettingsError(
                "recognizer onnx needs a network: set recognize.network to the YAML file that describes it"
            )
        path = Path(settings.network)
        self.about = read_description(path)
        self.session = Session(path.parent / self.about.model)
        self._shape = ShapeRecognizer(settings, T_vehicle_car)
        width, height = self.about.input_px
        self.session.check(path, (1, 3, height, width), self.about.outputs)

    def __call__(
        self, pair: RectifiedPair, found: Detections, regions: Sequence[Region], obstacles: Sequence[Obstacle]
    ) -> tuple[Obstacle, ...]:
        """Return the same obstacles, recognised; see `ShapeRecognizer`."""
        recognized = self._shape(pair, found, regions, obstacles)
        if not recognized:
            return ()
        image, scale, shift = prepared(pair.left, self.about)
        outputs = self.session.run(dict.fromkeys(self.session.inputs, image), self.about.outputs)
        seen = decode(outputs, self.about)
        boxes = (seen.boxes - np.tile(shift, 2)) / np.tile(scale, 2)
        return named(recognized, seen._replace(boxes=boxes), self.about)


def prepared(image: Image, about: NetworkDescription) -> tuple[Floats32, FloatArray, FloatArray]:
    """Return an image as the network wants it, and how its pixels lie there: factor and shift along u and v."""
    rgb = as_bytes(image)
    rgb = np.asarray(cv2.cvtColor(rgb, cv2.COLOR_GRAY2RGB)) if rgb.ndim == 2 else rgb
    width, height = about.input_px
    scale = np.array([width / rgb.shape[1], height / rgb.shape[0]])
    if about.letterbox:
        scale[:] = scale.min()
    size = np.maximum(np.rint(scale * rgb.shape[1::-1]), 1).astype(int)
    shift = ((width, height) - size) // 2 if about.letterbox and about.centered else np.zeros(2, int)
    canvas = np.full((height, width, 3), about.pad, np.uint8)
    canvas[shift[1] : shift[1] + size[1], shift[0] : shift[0] + size[0]] = cv2.resize(rgb, size.tolist())
    return as_input(canvas, about.colors, about.mean, about.std), scale, shift.astype(float)


def named(obstacles: Sequence[Obstacle], seen: Seen, about: NetworkDescription) -> tuple[Obstacle, ...]:
    """Return the obstacles with the types of the network's boxes they lie in; those in none as they were.

    The surest box speaks first. What it saw is the obstacle that fills it most, and whatever else lies in it as near.
    """
    known = list(obstacles)
    if not len(seen.boxes):
        return tuple(known)
    boxes = np.array([o.box_px for o in obstacles], float)
    range_m = np.array([o.range_m for o in obstacles])
    area = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1)
    free = np.ones(len(known), bool)
    for box, score, number in zip(seen.boxes, seen.scores.tolist(), seen.numbers.tolist(), strict=True):
        kind = about.classes.get(number)
        if kind is None:
            continue
        shared = shared_px2(boxes, box[None])[:, 0]
        fills = np.where(free, shared / max(float(np.prod(box[2:] - box[:2])), 1.0), 0.0)
        main = int(fills.argmax())
        if fills[main] < COVERS:
            continue
        near = np.abs(range_m - range_m[main]) <= max(TOGETHER_M, TOGETHER_SHARE * range_m[main])
        for i in np.flatnonzero(free & near & (shared >= INSIDE * area)).tolist():
            free[i] = False
            odds = {kind: score, UNKNOWN: 1 - score} if kind != UNKNOWN else {UNKNOWN: 1.0}
            probability = score if kind != UNKNOWN else float("nan")
            known[i] = known[i].recognized(label=kind, probability=probability, class_odds=odds)
    return tuple(known)
