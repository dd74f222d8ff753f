"""What `refine_compiled` computes: the names, the tables, and the numbers it returns.

A region is a set of cells with a coarse disparity each. It is cut into square blocks; each block has one disparity, and
neighbouring blocks are tied to each other and to the region's mean by what surfaces do (see `Model`). All are found
together by Gauss-Newton: the left image is the template and the only source of gradients, the right one is sampled
between its pixels by an 8-tap windowed sinc.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

TAPS, PHASES = 8, 256
"""Taps of the interpolation, and steps of a pixel it is tabulated in."""

FIGURES = (
    "mean_px",
    "nearest_px",
    "scatter_px",
    "noise_px",
    "relief_px",
    "step_px",
    "moved_px",
    "residual",
    "used",
    "pixels",
)
"""What a region comes to, in the order of the kernel's columns:

mean_px, nearest_px
    Disparity of the mean visible surface, and of the nearest face (10th percentile of the distance), pixels.
scatter_px
    Standard deviation of the mean as the blocks' scatter about it says.
noise_px
    The same from the pixels' residuals alone.
relief_px
    What `relief_m` is in pixels here.
step_px
    How far the last iteration moved the mean; NaN where nothing could be fitted.
moved_px
    From the coarse mean to the refined one.
residual
    Root mean square difference of the two images, grey levels.
used
    Share of the pixels that count, by their robust weights.
pixels
    How many there are.
"""


class Model(NamedTuple):
    """What surfaces and images are like.

    Attributes
    ----------
    f_px, f_baseline
        Focal length, and focal length times baseline (px m).
    noise
        Standard deviation of one grey level.
    gain
        Left over right contrast, of the cameras.
    slope
        How much deeper a surface gets per metre across, usually.
    relief_m
        How far parts of a thing lie from its mean, usually.
    rim_m, rim_px
        How far its outline lies behind its mean surface, and how far what is behind it pulls the outline.
    """

    f_px: float
    f_baseline: float
    noise: float
    gain: float
    slope: float = 0.5
    relief_m: float = 0.2
    rim_m: float = 0.02
    rim_px: float = 0.01


def interpolation() -> NDArray[np.float32]:
    """Return (PHASES + 1, TAPS) weights of pixels -3..4 for a place `phase / PHASES` after pixel 0.

    A sinc under a Kaiser window (beta 6), each row summing to 1.
    """
    phase = np.arange(PHASES + 1)[:, None] / PHASES
    x = np.arange(TAPS) - (TAPS // 2 - 1) - phase
    window = np.i0(6 * np.sqrt(np.clip(1 - (2 * x / TAPS) ** 2, 0, 1))) / np.i0(6.0)
    weights = np.sinc(x) * window * (np.abs(x) <= TAPS / 2)
    return np.asarray(weights / weights.sum(1, keepdims=True), np.float32)
