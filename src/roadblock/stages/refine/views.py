"""The rectified images of a pair as far as regions need them, from the raw ones where these are there."""

from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.gray import gray8
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Gray, RectifiedPair

Maps = tuple[NDArray[np.float32], NDArray[np.float32]]
Box = tuple[slice, slice]

ASIDE_PX, ABOVE_PX = 24, 8
"""So far beside the middles of a region's cells, and above and below them, is looked."""


class Sources(NamedTuple):
    """Two grey images, and the maps by which the rectified ones sample them; None where they are rectified."""

    left: Gray
    right: Gray
    maps_left: Maps | None
    maps_right: Maps | None


def sources(pair: RectifiedPair) -> Sources:
    """Return the raw images of a pair; where nobody has them, the rectified ones stand for them."""
    r = pair.rectification
    if pair.raw is None:
        return Sources(*gray8(pair.left, pair.right), None, None)
    return Sources(*pair.raw, r.maps_left, r.maps_right)


def quick_views(raw: Sources, first: NDArray[np.int64], uvd: FloatArray, size_px: tuple[int, int]) -> tuple[Gray, Gray]:
    """Return both rectified images, filled in where the regions are."""
    if raw.maps_left is None or raw.maps_right is None:
        return raw.left, raw.right
    ours, theirs = windows(first, uvd, size_px)
    left = painted(ours, size_px, partial(bilinear, raw.left, raw.maps_left))
    return left, painted(theirs, size_px, partial(bilinear, raw.right, raw.maps_right))


def bilinear(raw: Gray, maps: Maps, box: Box) -> Gray:
    """Return a part of a rectified image."""
    return np.asarray(cv2.remap(raw, maps[0][box], maps[1][box], cv2.INTER_LINEAR), np.uint8)


def windows(first: NDArray[np.int64], uvd: FloatArray, size_px: tuple[int, int]) -> tuple[Sequence[Box], Sequence[Box]]:
    """Return the rows and columns of the left and of the right image that each region needs."""
    sides: tuple[list[Box], list[Box]] = [], []
    for a, b in pairwise(first):
        (u1, v1, near), (u0, v0, far) = uvd[a:b].max(0), uvd[a:b].min(0)
        rows = slice(max(int(v0) - ABOVE_PX, 0), min(int(v1) + ABOVE_PX + 1, size_px[1]))
        for boxes, low, high in zip(sides, (u0, u0 - near), (u1, u1 - far), strict=True):
            columns = slice(max(int(low) - ASIDE_PX, 0), max(min(int(high) + ASIDE_PX, size_px[0]), 0))
            boxes.append((rows, columns))
    return sides


def painted(boxes: Sequence[Box], size_px: tuple[int, int], fill: Callable[[Box], Gray]) -> Gray:
    """Return an image of which the boxes alone are filled in; all of it where that is less."""
    image = np.zeros(size_px[::-1], np.uint8)
    if sum(image[box].size for box in boxes) > image.size:
        boxes = [(slice(0, size_px[1]), slice(0, size_px[0]))]
    for box in boxes:
        if image[box].size:
            image[box] = fill(box)
    return image
