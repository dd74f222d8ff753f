"""What keeps the two images of a pair equal before the matcher: one brightness, and a say for each of them."""

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.stages.match.settings import Matcher, MatchSettings
from roadblock.values.frame import Gray

DARKEST, BRIGHTEST = 2, 250
"""Grey levels outside may be cut off, and say nothing about gain."""
SAME_GAIN = 0.03
"""Images whose contrasts differ by less stay as they are: rounding them again would cost more than it wins."""
AGREE_PX = 1.0
"""Both views see one surface where their disparities differ by no more."""

BLANK_PX, BLANK_STEP = 15, 0.2
"""A window of this size whose mean step is below this many grey levels is blank: even sensor noise makes more."""


def is_blank(gray: Gray) -> NDArray[np.bool_]:
    """Return where nothing can be matched: no step from column to column all around (covered, saturated)."""
    steps = np.abs(np.diff(gray.astype(np.float32), axis=1, prepend=gray[:, :1]))
    return np.asarray(cv2.blur(steps, (BLANK_PX, BLANK_PX)) < BLANK_STEP)


def balance(left: Gray, right: Gray) -> tuple[Gray, Gray]:
    """Return both images with one mean and one contrast, so that neither camera's gain or offset moves a match.

    Gain and offset come from the percentiles of both whole images; each image takes half of the way. Images without
    contrast stay as they are, and so do images of nearly the same.
    """
    levels = np.stack([np.percentile(image, np.arange(2, 99, 4)) for image in (left, right)])
    levels = levels[:, ((levels >= DARKEST) & (levels <= BRIGHTEST)).all(0)]
    if levels.shape[1] < 3 or levels.std(1).min() < 1:
        return left, right
    means, spreads = levels.mean(1), levels.std(1)
    if abs(np.log(spreads[0] / spreads[1])) < SAME_GAIN:
        return left, right
    scales = np.sqrt(spreads.prod()) / spreads
    scale_left, scale_right = (
        np.clip(np.rint((np.arange(256) - mean) * scale + means.mean()), 0, 255).astype(np.uint8)
        for mean, scale in zip(means, scales, strict=True)
    )
    return scale_left[left], scale_right[right]


def match_both_ways(matcher: Matcher, left: Gray, right: Gray, settings: MatchSettings) -> NDArray[np.float32]:
    """Match left to right and right to left; return the mean of both where they agree, NaN elsewhere.

    A matcher treats its first image as the one that knows, and the errors of its sub-pixel steps differ with which
    one that is. The mean does not: exchanged and mirrored images give the mirrored map.

    Returns
    -------
    (height, width) disparities of the left image, pixels.
    """
    d_px = matcher(left, right, settings)
    mirrored = matcher(np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1]), settings)
    rows, columns = np.indices(d_px.shape)
    seen_at = np.rint(columns - np.nan_to_num(d_px)).astype(int).clip(0)
    back_px = mirrored[:, ::-1][rows, seen_at]
    with np.errstate(invalid="ignore"):
        agree = np.abs(d_px - back_px) <= AGREE_PX
    return np.where(agree, (d_px + back_px) / 2, np.float32(np.nan))
