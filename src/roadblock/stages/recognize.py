"""Recognize: what an obstacle looks like. So far its colour name; classes stay "unknown"."""

import cv2
import numpy as np

from roadblock.values.checks import FloatArray

HUES_DEG = {"pink": 15, "red": 50, "orange": 76, "yellow": 112, "green": 195, "blue": 311, "purple": 340}
"""Upper ends of the CIELAB hue angles that bear these names, upwards from 0; beyond the last it is pink again."""


def name_color(rgb: FloatArray) -> str | None:
    """Return the basic colour term nearest to a mean colour.

    Parameters
    ----------
    rgb
        (3,) sRGB 0..255; NaN where unknown.

    Returns
    -------
    One of the eleven basic colour terms, or None where the colour is unknown.
    """
    if not np.isfinite(rgb).all():
        return None
    pixel = (np.asarray(rgb, np.float32) / 255).reshape(1, 1, 3)
    lightness, a, b = (float(c) for c in cv2.cvtColor(pixel, cv2.COLOR_RGB2LAB)[0, 0])
    chroma = np.hypot(a, b)
    if chroma < 8 + 0.04 * lightness:
        return "black" if lightness < 25 else "gray" if lightness < 78 else "white"
    hue = np.degrees(np.arctan2(b, a)) % 360
    name = next((n for n, end in HUES_DEG.items() if hue < end), "pink")
    if name in ("orange", "yellow") and lightness < 45:
        return "brown"
    if name in ("red", "pink"):
        return "pink" if lightness > 65 else "red"
    return name
