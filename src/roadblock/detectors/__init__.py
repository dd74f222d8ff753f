"""Detectors: ways from a RectifiedPair to Detections. Everything after that is shared.

`DETECTORS` is a plain table of name -> factory(settings); another one is named as "package.module:factory".
"""

import difflib
import importlib
from collections.abc import Callable

from roadblock.config import Settings
from roadblock.detectors.bands import bands
from roadblock.detectors.cells import cells, fast
from roadblock.detectors.dense import dense
from roadblock.detectors.mono import mono_area, mono_ground
from roadblock.errors import SettingsError
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections

Detector = Callable[[RectifiedPair], Detections]
DETECTORS: dict[str, Callable[[Settings], Detector]] = {
    "cells": cells,
    "fast": fast,
    "dense": dense,
    "bands": bands,
    "mono_ground": mono_ground,
    "mono_area": mono_area,
}


def make_detector(settings: Settings) -> Detector:
    """Return the detector that `settings.detector` names.

    Raises
    ------
    SettingsError
        If there is none of that name, a "package.module:factory" cannot be imported, or what it makes is no
        detector.
    """
    name = settings.detector
    if name in DETECTORS:
        return DETECTORS[name](settings)
    module, colon, factory = name.partition(":")
    if not colon:
        nearest = (difflib.get_close_matches(name, DETECTORS, 1) or [Settings().detector])[0]
        raise SettingsError(
            f"unknown detector {name!r}: did you mean {nearest}? "
            f"Known: {', '.join(DETECTORS)}, or package.module:factory"
        )
    try:
        made: Detector = getattr(importlib.import_module(module), factory)(settings)
    except (ImportError, AttributeError, SyntaxError, TypeError, ValueError) as error:
        raise SettingsError(f"detector {name!r} cannot be loaded: {error}") from error
    if not callable(made):
        raise SettingsError(f"detector {name!r}: the factory must return a function of a pair, but returned {made!r}")
    return made
