"""Grey images for matching, by OpenCV."""

import cv2
import numpy as np

from roadblock.values.frame import Gray, Image, RectifiedPair


def gray8(left: Image, right: Image) -> tuple[Gray, Gray]:
    """Return both images as 8-bit grey with one common scale, so that gain and offset between them stay.

    16-bit images are stretched from the 0.1th to the 99.9th percentile of the left one.
    """
    grays = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) if i.ndim == 3 else i for i in (left, right)]
    if left.dtype == np.uint16:
        low, high = np.percentile(grays[0], (0.1, 99.9))
        scale = 255.0 / max(high - low, 1.0)
        grays = [np.clip((g.astype(np.float32) - low) * scale + 0.5, 0, 255).astype(np.uint8) for g in grays]
    return np.ascontiguousarray(grays[0]), np.ascontiguousarray(grays[1])


def halve(gray: Gray) -> Gray:
    """Return the means of 2x2 pixels; an odd last row or column is left out."""
    rows, columns = (n // 2 for n in gray.shape)
    if min(rows, columns) == 0:
        return np.empty((rows, columns), np.uint8)
    even = gray[: 2 * rows, : 2 * columns]
    return np.asarray(cv2.resize(even, (columns, rows), interpolation=cv2.INTER_AREA))


def half_images(pair: RectifiedPair) -> tuple[Gray, Gray]:
    """Return the pair's half images, 8-bit grey; where it came without, they are made once and stay with it."""
    if pair.half is None:
        left, right = gray8(pair.left, pair.right)
        pair.half = halve(left), halve(right)
    return pair.half
