"""The paper's region matching (section 2.2): a window slid along the epipolar line."""

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled import region as compiled
from roadblock.kernels.reference.region import CENSUS, CENSUS_HALF, COSTS
from roadblock.stages.match.settings import MatchSettings
from roadblock.values.frame import Gray

SMALLEST_BLOCK_PX = 5
"""Smaller windows hold too little to tell one place of a row from another."""


def match_region(left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.float32]:
    """Match every pixel of the left image by the window around it (the paper's section 2.2).

    The window slides over the same row of the right image; the best of `settings.cost` wins if it is unique and if
    the right image's own best match confirms it; a parabola gives the sub-pixel part.

    Returns
    -------
    (height, width) pixels; NaN where nothing was found, and on islands below `settings.speckle_px`.
    """
    half, n = max(SMALLEST_BLOCK_PX, settings.block_px) // 2, settings.disparities
    cost = COSTS.index(settings.cost)
    border = half + CENSUS_HALF if cost == CENSUS else half
    images = (
        np.pad(left, border, mode="edge").astype(np.int32),
        np.pad(right, ((border, border), (border + n - 1, border)), mode="edge").astype(np.int32),
    )
    if cost == CENSUS:
        images = (compiled.census(images[0]), compiled.census(images[1]))
    d_px = compiled.match_windows(*images, half, n, cost, settings.uniqueness_percent)
    return drop_islands(d_px, settings.speckle_px)


def drop_islands(d_px: NDArray[np.float32], speckle_px: int) -> NDArray[np.float32]:
    """Return the map without islands of less than `speckle_px` pixels; a step of more than 1 px ends an island."""
    units = np.nan_to_num(d_px * np.float32(16), nan=-16.0).astype(np.int16)
    cv2.filterSpeckles(units, -16, speckle_px, 16)
    return np.where(units < 0, np.float32(np.nan), d_px)
