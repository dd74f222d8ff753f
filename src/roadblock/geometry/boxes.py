"""Boxes in an image, and those that stand on the road: how far they overlap, outlines from above, visible faces."""

import cv2
import numpy as np

from roadblock.values.checks import FloatArray

SIGHTS = 200
"""Lines of sight by which a face is measured."""


def shared_px2(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Return (n, m) how much boxes (n, 4) of an image share with others (m, 4); each u0, v0, u1, v1, half open."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    return np.asarray(np.maximum(high - low, 0).prod(2))


def footprint(center_m: FloatArray, yaw_rad: float, length_m: float, width_m: float) -> FloatArray:
    """Return (4, 2) corners of a box from above, x forward and y left, going round to the left.

    Parameters
    ----------
    center_m
        Its middle; the first two numbers count.
    yaw_rad
        Which way its length points, > 0 = to the left of x.
    length_m, width_m
        Its sides.
    """
    ahead, aside = 0.5 * length_m * np.array([1, -1, -1, 1]), 0.5 * width_m * np.array([1, 1, -1, -1])
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.stack([center_m[0] + c * ahead - s * aside, center_m[1] + s * ahead + c * aside], -1)


def polygon_overlap(a: FloatArray, b: FloatArray) -> float:
    """Return intersection over union of two convex polygons (n, 2) and (m, 2)."""
    origin = a.mean(0)  # OpenCV counts in single precision
    first, second = ((p - origin).astype(np.float32) for p in (a, b))
    areas = [cv2.contourArea(p) for p in (first, second)]
    common, _ = cv2.intersectConvexConvex(first, second)
    return float(common / max(sum(areas) - common, 1e-9))


def visible_face(corners_m: FloatArray, percent: float) -> tuple[float, float]:
    """Return (x, y) of the nearest visible face of an upright box, seen from the origin along x.

    Parameters
    ----------
    corners_m
        (4, 2) its footprint.
    percent
        x is this percentile of the forward distance over its visible surface, as an image counts it; y is the middle of
        what is seen within 0.1 m of it.

    Returns
    -------
    NaN where it reaches beside or behind the origin.
    """
    if corners_m[:, 0].min() <= 0:
        return np.nan, np.nan
    slopes = corners_m[:, 1] / corners_m[:, 0]
    edges = np.linspace(slopes.min(), slopes.max(), SIGHTS + 1)
    k = (edges[1:] + edges[:-1])[:, None] / 2
    p, q = corners_m, np.roll(corners_m, -1, axis=0)
    (px, py), (dx, dy) = p.T, (q - p).T
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (k * px - py) / (dy - k * dx)
        x = np.where((t >= 0) & (t <= 1), px + t * dx, np.inf).min(1)
    k, x = k[np.isfinite(x), 0], x[np.isfinite(x)]
    order = np.argsort(x)
    seen = np.cumsum(1 / x[order])  # a column shows 1/x of its height
    nearest = float(x[order][np.searchsorted(seen, percent / 100 * seen[-1])])
    face = (k * x)[x <= nearest + 0.1]
    return nearest, float((face.min() + face.max()) / 2)
