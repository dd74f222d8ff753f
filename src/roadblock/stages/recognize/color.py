"""The colour of a body: its name, and its CIELAB value, whatever light falls on it and whatever is not body.

Names are told in the light of the road, which is grey: what is white in a shadow is as much brighter than the road
there as it is in the sun.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.judge import name_colors
from roadblock.kernels.compiled.recognize import middle_color, pick_colors, pick_road, tally_colors
from roadblock.kernels.reference.judge import COLORS
from roadblock.kernels.reference.recognize import BACKGROUND, COLOR_FIGURES
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair

GRID_PX, SAMPLES = 4, 64 + BACKGROUND
"""A thing is looked at so many places of a grid of such steps."""
PER_LEVEL, NO_TINT = np.array((100 / 255, 1, 1)), np.array((0, 128, 128))
"""OpenCV's 8-bit CIELAB times the one, less the other, is CIELAB."""


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
    figures, road = np.empty((n, COLOR_FIGURES)), np.empty(3)
    middle_color(lab[n:].reshape(-1, 3), road)
    road *= PER_LEVEL
    road -= NO_TINT
    tally_colors(lab[:n], road, figures)
    return figures


def call_colors(figures: FloatArray) -> tuple[list[tuple[str, ...]], FloatArray]:
    """Return one or two names of each thing whose figures (n, COLOR_FIGURES) are given, and their (n, 3) CIELAB."""
    codes, lab = np.empty((len(figures), 2), np.int64), np.empty((len(figures), 3))
    name_colors(figures, codes, lab)
    return [(COLORS[a],) if b < 0 else (COLORS[a], COLORS[b]) for a, b in codes.tolist()], lab
