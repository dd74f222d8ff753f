"""Recognize: what an obstacle looks like. So far its colour name; classes stay "unknown"."""

import math
from collections.abc import Sequence

import cv2
import numpy as np

from roadblock.values.checks import FloatArray

HUES_DEG = {"pink": 15, "red": 50, "orange": 76, "yellow": 112, "green": 195, "blue": 311, "purple": 340}
"""Upper ends of the CIELAB hue angles that bear these names, upwards from 0; beyond the last it is pink again."""


def name_colors(rgbs: Sequence[FloatArray]) -> list[str | None]:
    """Return the basic colour term nearest to each mean colour.

    Parameters
    ----------
    rgbs
        (3,) sRGB 0..255 each; NaN where unknown.

    Returns
    -------
    One of the eleven basic colour terms, or None where the colour is unknown.
    """
    if not rgbs:
        return []
    pixels = np.array(rgbs, np.float32) / 255
    known = np.asarray(np.isfinite(pixels).all(axis=1))
    pixels[~known] = 0
    labs = cv2.cvtColor(pixels[:, None], cv2.COLOR_RGB2LAB)[:, 0].tolist()
    return [_name(*lab) if sure else None for lab, sure in zip(labs, known, strict=True)]


def _name(lightness: float, a: float, b: float) -> str:
    chroma = math.hypot(a, b)
    if chroma < 8 + 0.04 * lightness:
        return "black" if lightness < 25 else "gray" if lightness < 78 else "white"
    hue = math.degrees(math.atan2(b, a)) % 360
    name = next((n for n, end in HUES_DEG.items() if hue < end), "pink")
    if name in ("orange", "yellow") and lightness < 45:
        return "brown"
    if name in ("red", "pink"):
        return "pink" if lightness > 65 else "red"
    return name
