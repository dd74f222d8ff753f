"""Steps 1 and 2 of the paper's section 2.2: grey targets cut from the background, and fused ones told apart."""

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.stages.bands.settings import BandsSettings

Gray = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Share = NDArray[np.float32]
Labels = NDArray[np.int32]

CENTRE_SHARE = 0.5
"""The road's grey is measured in this middle part of the lower half of what lies below the horizon."""

NORMAL_MAD = 1.4826
"""Standard deviation of normal noise over its median absolute deviation."""

TAIL_SHARE = 0.2
"""What stays lower than this share of a target is a shadow or a line that runs into it, no part of it."""

HALF = 0.5
"""The share at the threshold itself."""

LEAST_ROWS = 4
"""A strip of road below the horizon narrower than this tells nothing about its grey."""

LEAST_ROAD_SHARE = 0.1
"""A row with less road than this takes its grey from the row below."""

PEAK_SHARE = 0.6
"""A watershed's markers are the places further inside a target than this share of its deepest one."""


@dataclass(frozen=True, eq=False)
class Targets:
    """The grey blocks of one image.

    Attributes
    ----------
    share
        (height, width) how much of each pixel belongs to a target, 0..1; 0.5 at the threshold. An ideal mask is 0 or 1.
    labels
        (height, width) int32 number of the target, from 1; 0 = background.
    """

    share: Share
    labels: Labels


def horizon_row(cy_px: float, f_px: float, settings: BandsSettings) -> float:
    """Return the row of the horizon of a flat road, for cameras that look down by `settings.pitch_deg`."""
    return float(cy_px - f_px * np.tan(np.radians(settings.pitch_deg)))


def find_targets(gray: Gray, horizon_px: float, settings: BandsSettings) -> Targets:
    """Segment one image and separate what is fused (section 2.2).

    Dark and bright targets are cut out and numbered by themselves, so that a dark target does not fuse with a bright
    line behind it.
    """
    share, labels = np.zeros(gray.shape, np.float32), np.zeros(gray.shape, np.int32)
    for polarity in ("dark", "bright") if settings.polarity == "both" else (settings.polarity,):
        one = segment(gray, horizon_px, polarity == "bright", settings)
        parts = separate((one >= HALF) & (labels == 0), settings)
        labels = np.where(parts > 0, parts + labels.max(), labels)
        share = np.maximum(share, one)
    return Targets(share, labels)


def segment(gray: Gray, horizon_px: float, bright: bool, settings: BandsSettings) -> Share:
    """Cut grey targets from the background by a threshold (section 2.2, "threshold segmentation").

    Parameters
    ----------
    gray
        (height, width).
    horizon_px
        Row of the horizon. Only the road can be a known background, so there are no targets above it.
    bright
        Whether targets brighter than the background are wanted, or darker ones.
    settings
        Which background, which threshold.

    Returns
    -------
    (height, width) how far each pixel's grey is from the background's, as a share of twice the threshold, 0..1; so
    0.5 is the threshold itself. Small holes and gaps of a target are filled, specks taken away.
    """
    share = np.zeros(gray.shape, np.float32)
    top = int(np.clip(np.ceil(horizon_px), 0, len(gray)))
    below = gray[top:].astype(np.float32)
    if below.shape[0] < LEAST_ROWS or below.shape[1] < LEAST_ROWS:
        return share
    if settings.blur_px > 0:
        below = np.asarray(cv2.GaussianBlur(below, (0, 0), settings.blur_px))
    distance = (below - background(below, settings)) * np.float32(1 if bright else -1)
    share[top:] = np.clip(distance / (2 * threshold(distance, settings)), 0, 1)
    return _closed(share, settings.close_px)


def _closed(share: Share, close_px: int) -> Share:
    """Fill holes of what is above one half, take specks away, and leave the rim of what remains as it is."""
    square = np.ones((3, 3), np.uint8)
    mask = (share >= HALF).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((close_px, close_px), np.uint8)).astype(np.uint8)
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, square).astype(np.uint8)
    return np.where(cv2.erode(mask, square) > 0, np.float32(1), share * cv2.dilate(mask, square))


def background(gray: NDArray[np.float32], settings: BandsSettings) -> NDArray[np.float32]:
    """Return the grey of the background at every pixel of the rows below the horizon.

    "road": per row, from the near road upwards, the median of what is within three spreads of the row below; so haze
    and light may change it along the road. "local": the median of the row within a quarter of the image's width on
    either side, for roads whose grey changes from side to side.
    """
    if settings.background == "local":
        step = max(1, gray.shape[1] // 128)
        wide = scipy.ndimage.median_filter(gray[:, ::step], (1, 64), mode="nearest")
        return np.repeat(wide, step, axis=1)[:, : gray.shape[1]]
    road = near_road(gray)
    middle = float(np.median(road))
    reach = 3 * max(NORMAL_MAD * float(np.median(np.abs(road - middle))), 1.0)
    rows = np.empty((len(gray), 1), np.float32)
    for v in range(len(gray) - 1, -1, -1):
        alike = gray[v][np.abs(gray[v] - middle) < reach]
        if len(alike) >= LEAST_ROAD_SHARE * gray.shape[1]:
            middle = float(np.median(alike))
        rows[v] = middle
    return np.broadcast_to(rows, gray.shape)


def near_road(gray: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the part of the rows below the horizon that is road if anything is: the middle of their lower half."""
    height, width = gray.shape
    side = int(width * (1 - CENTRE_SHARE) / 2)
    return gray[height // 2 :, side : width - side]


def threshold(distance: NDArray[np.float32], settings: BandsSettings) -> float:
    """Return the threshold on the distance from the background's grey, grey levels (section 2.2)."""
    if settings.threshold == "otsu":
        levels = np.clip(np.abs(distance), 0, 255).astype(np.uint8)
        return max(settings.contrast, float(cv2.threshold(levels, 0, 255, cv2.THRESH_OTSU)[0]))
    spread = NORMAL_MAD * float(np.median(np.abs(near_road(distance))))  # the same for either polarity
    return max(settings.contrast, settings.spreads * spread)


def separate(mask: Mask, settings: BandsSettings) -> Labels:
    """Give each target a number, fused ones cut apart: section 2.2 wants single targets.

    Parameters
    ----------
    mask
        (height, width) what belongs to any target.
    settings
        How to cut; blocks below `area_px` are dropped.

    Returns
    -------
    (height, width) numbers from 1, left to right and top to bottom by block; 0 = none.
    """
    blocks, _ = scipy.ndimage.label(mask, np.ones((3, 3)))
    labels, count = np.zeros(mask.shape, np.int32), 0
    for number, box in enumerate(scipy.ndimage.find_objects(blocks), 1):
        block = blocks[box] == number
        for part in _parts(block, settings):
            if part.sum() >= settings.area_px:
                count += 1
                labels[box][part] = count
    return labels


def _parts(block: Mask, settings: BandsSettings) -> list[Mask]:
    if settings.separation == "none":
        return [block]
    if settings.separation == "watershed":
        return watershed(block)
    edges = [0, *valleys(block.sum(0), settings.valley_share), block.shape[1]]
    column = np.arange(block.shape[1])
    return [block & (column >= a) & (column < b) for a, b in pairwise(edges)]


def valleys(projection: NDArray[np.integer], share: float) -> list[int]:
    """Return the columns where a block's projection is to be cut: each begins a new part.

    Cut are valleys, lower than `share` of the highest columns on both their sides, at their lowest column; and flanks
    that stay below `TAIL_SHARE` of the highest column (shadows and lines that run into a target).
    """
    from_left = np.maximum.accumulate(projection)
    from_right = np.maximum.accumulate(projection[::-1])[::-1]
    low = projection <= share * np.minimum(from_left, from_right)
    cuts = [a + int(np.argmin(projection[a:b])) for a, b in _runs(low)]
    tall = projection >= TAIL_SHARE * projection.max()
    first, last = int(np.argmax(tall)), len(tall) - int(np.argmax(tall[::-1]))
    return sorted({*cuts, first, last} - {0, len(projection)})


def watershed(block: Mask) -> list[Mask]:
    """Cut a block where it is thin: watershed of its distance transform from its thick places."""
    padded = np.pad(block, 1).astype(np.uint8)
    depth = cv2.distanceTransform(padded, cv2.DIST_L2, 5)
    markers, count = scipy.ndimage.label(depth > PEAK_SHARE * depth.max())
    height = np.round(255 * (1 - depth / depth.max())).astype(np.uint8)
    flooded = scipy.ndimage.watershed_ift(height, markers.astype(np.int32))[1:-1, 1:-1]
    return [block & (flooded == number) for number in range(1, count + 1)]


def _runs(flags: Mask) -> list[tuple[int, int]]:
    """Return the half-open runs of True."""
    steps = np.flatnonzero(np.diff(np.r_[False, flags, False]))
    return list(zip(steps[::2].tolist(), steps[1::2].tolist(), strict=True))
