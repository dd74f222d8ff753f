"""The colour of a body: its name, and its CIELAB value, whatever light falls on it and whatever is not body.

Names are told in the light of the road, which is grey: what is white in a shadow is as much brighter than the road
there as it is in the sun.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.recognize import pick_colors, pick_road, tally_colors
from roadblock.kernels.reference.recognize import BACKGROUND, COLOR_FIGURES, HUES
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair

GRID_PX, SAMPLES = 4, 64 + BACKGROUND
"""A thing is looked at so many places of a grid of such steps."""

NAMES = ("pink", "red", "orange", "yellow", "green", "blue", "purple")
LEAST_SHARE, SECOND_SHARE = 0.18, 0.25
"""A hue is the body's from such a share of its places on, and names it beside another one from such a share on."""
BLACK_L, WHITE_L = 29.0, 52.0
"""What is darker, and what is lighter, of what is grey."""


class Color(NamedTuple):
    """The colour of a body: one or two names, and its CIELAB value."""

    names: tuple[str, ...]
    lab: tuple[float, float, float]


def read_colors(pair: RectifiedPair, uvd_px: FloatArray, bounds: NDArray[np.int32]) -> FloatArray | None:
    """Return (n, COLOR_FIGURES) figures of each thing's colours (`tally_colors`); None where the camera sees none.

    Parameters
    ----------
    pair
        The images.
    uvd_px, bounds
        (m, 3) the cells of all things, one thing after the other, and (n + 1,) where each begins.
    """
    colors = pair.left_colors(GRID_PX, GRID_PX)
    if colors is None or colors.size == 0:
        return None
    if colors.dtype == np.uint16:
        colors = np.asarray(colors >> 8, np.uint8)
    n = len(bounds) - 1
    samples = np.empty((n + 2, SAMPLES, 3), np.uint8)  # the last two are the road's
    pick_colors(colors, uvd_px, bounds, GRID_PX, samples[:n])
    pick_road(colors, samples[n:].reshape(-1, 3))
    lab = np.asarray(cv2.cvtColor(samples, cv2.COLOR_RGB2LAB), np.uint8)
    road = np.median(lab[n:].reshape(-1, 3), axis=0) * (100 / 255, 1, 1) - (0, 128, 128)
    figures = np.empty((n, COLOR_FIGURES))
    tally_colors(lab[:n], road, figures)
    return figures


def name_colors(figures: FloatArray) -> list[Color]:
    """Return the colour of each thing whose figures (n, COLOR_FIGURES) are given."""
    return [_name(row) for row in figures.tolist()]


def _name(row: list[float]) -> Color:
    shares = row[0 : 4 * HUES : 4]
    first, second = sorted(range(HUES), key=lambda i: -shares[i])[:2]
    labs = [tuple(row[4 * i + 1 : 4 * i + 4]) for i in (first, second)]
    grey, light, a, b = row[4 * HUES : 4 * HUES + 4]
    if shares[first] < min(LEAST_SHARE, grey):
        return Color((_grey_name(light),), (light, a, b))
    names = [_hue_name(NAMES[first], *labs[0])]
    if shares[second] >= SECOND_SHARE:
        names.append(_hue_name(NAMES[second], *labs[1]))
    elif grey >= 2 * SECOND_SHARE and light > WHITE_L:
        names.append("white")
    return Color(tuple(dict.fromkeys(names)), labs[0])  # type: ignore[arg-type]


def _grey_name(lightness: float) -> str:
    return "black" if lightness < BLACK_L else "white" if lightness > WHITE_L else "gray"


def _hue_name(name: str, lightness: float, a: float, b: float) -> str:
    """Return what a hue is called that is as light and as strong as this."""
    weak = math.hypot(a, b) < 0.62 * lightness + 4 and lightness < 55
    if (name in ("orange", "yellow") and (weak or lightness < 33)) or (name == "red" and weak and b > 0.6 * a):
        return "brown"
    if name in ("red", "pink"):
        return "pink" if lightness > 62 else "red"
    return name
