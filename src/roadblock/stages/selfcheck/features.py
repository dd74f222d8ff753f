"""Features of a pair: corners spread over the left image, found again by the Lucas-Kanade method.

Matched in both directions, in rows and columns; no disparity map is needed.
"""

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels import features
from roadblock.kernels.features import Points
from roadblock.stages.selfcheck.settings import SelfcheckSettings
from roadblock.values.frame import Image, RectifiedPair

Gray = NDArray[np.uint8]

BLOCK_PX = 5
"""Over which corners are judged."""
LEVELS = 4
"""Of the image pyramid: 15 px windows then find shifts of over 100 px."""
STEPS, SETTLED_PX = 20, 0.005
"""The search for a feature ends after so many, or with a smaller one."""
RETURNED_PX = 0.3
"""There and back again, a feature must end this near to where it started."""
BEHIND_INFINITY_PX = 30.0
"""A turned camera shows far things at negative disparities; not at more than this."""


def gray_pair(pair: RectifiedPair) -> tuple[Gray, Gray]:
    """Return both images in 8 bit grey, scaled alike."""
    left, right = (cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) if i.ndim == 3 else i for i in (pair.left, pair.right))
    if left.dtype == np.uint8:
        return np.ascontiguousarray(left), np.ascontiguousarray(right)
    scale = 255 / max(int(left.max()), int(right.max()), 1)
    return _scaled(left, scale), _scaled(right, scale)


def _scaled(image: Image, scale: float) -> Gray:
    return np.asarray(np.rint(image * np.float32(scale)), np.uint8)


def spread_corners(gray: Gray, settings: SelfcheckSettings) -> Points:
    """Return (n, 2) column and row of the strongest corner of each of about `settings.features` cells that has one."""
    border_px = settings.window_px // 2 + 1
    return features.spread_corners(gray, settings.features, BLOCK_PX, BLOCK_PX, border_px, settings.contrast)


def follow(
    here: Gray, there: Gray, points: Points, settings: SelfcheckSettings, guess: Points | None = None
) -> tuple[Points, NDArray[np.bool_]]:
    """Return where points (n, 2) of one image are in another, and which of them can be trusted.

    Parameters
    ----------
    here, there
        The two images.
    points
        Column and row in `here`.
    settings
        The window.
    guess
        Where they probably are in `there`; as in `here` if not given.
    """
    search = features.Search(settings.window_px, LEVELS, LEVELS, STEPS, SETTLED_PX, RETURNED_PX)
    return features.follow(here, there, points, points if guess is None else guess, search)


def match_pair(
    left: Gray, right: Gray, points: Points, settings: SelfcheckSettings, d_px: NDArray[np.float32] | None = None
) -> tuple[Points, NDArray[np.bool_]]:
    """Return where points (n, 2) of the left image are in the right one, and which of them can be trusted.

    `d_px` (n,), where known, is about how large their disparities are.
    """
    guess = None if d_px is None else points - np.stack([d_px, 0 * d_px], -1)
    found, good = follow(left, right, points, settings, guess)
    d, dv = (points - found).T
    return found, good & (d > -BEHIND_INFINITY_PX) & (np.abs(dv) < settings.vertical_px)
