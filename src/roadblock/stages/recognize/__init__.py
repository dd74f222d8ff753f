"""Recognize: what an obstacle is, what colour, what shape. Obstacles in, the same obstacles out.

`RECOGNIZERS` is a plain table of name -> factory(settings, T_vehicle_car).
"""

from collections.abc import Callable, Sequence

from roadblock.stages.recognize.motion import weigh_motion
from roadblock.stages.recognize.network import NetworkRecognizer
from roadblock.stages.recognize.settings import RecognizeSettings
from roadblock.stages.recognize.shape import ShapeRecognizer
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, Obstacle, Region

Recognizer = Callable[[RectifiedPair, Detections, Sequence[Region], Sequence[Obstacle]], tuple[Obstacle, ...]]


def _nothing(
    _pair: RectifiedPair, _found: Detections, _regions: Sequence[Region], obstacles: Sequence[Obstacle]
) -> tuple[Obstacle, ...]:
    return tuple(obstacles)


RECOGNIZERS: dict[str, Callable[[RecognizeSettings, FloatArray | None], Recognizer]] = {
    "none": lambda _settings, _T: _nothing,
    "shape": ShapeRecognizer,
    "onnx": NetworkRecognizer,
}


def make_recognizer(settings: RecognizeSettings, T_vehicle_car: FloatArray | None = None) -> Recognizer:
    """Return the recogniser that the settings name.

    Raises
    ------
    SettingsError, MissingExtraError
        As `NetworkRecognizer`.
    """
    return RECOGNIZERS[settings.recognizer](settings, T_vehicle_car)


__all__ = ["RECOGNIZERS", "NetworkRecognizer", "RecognizeSettings", "Recognizer", "make_recognizer", "weigh_motion"]
