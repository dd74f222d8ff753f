"""The road's vanishing point by robust voting of line segments, and the road plane that follows from it."""

from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.stages.mono.settings import MonoSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image
from roadblock.values.scene import GroundPlane

VOTERS = 120
"""Longest segments that vote."""
STEEP_DEG = (6.0, 80.0)
"""Slopes of segments that may run along the road: flatter ones cross it, steeper ones stand on it."""
AGREE_RAD = np.radians(0.7)
"""A segment agrees with a vanishing point that it misses by this angle."""
END_PX = 0.7
"""Noise of a segment's ends at right angles to it."""


def full_scale(image: Image) -> Image:
    """Return a 16-bit image whose brightest value uses the highest bit: cameras of 10 or 12 bits leave that empty.

    Multiplied by a power of two, so nothing is rounded. 8-bit images are returned as they are.
    """
    if image.dtype != np.uint16:
        return image
    return np.asarray(image << (16 - int(image.max()).bit_length()), np.uint16)


def gray_8bit(image: Image) -> NDArray[np.uint8]:
    """Return the image in 8-bit grey."""
    eight = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image
    return np.asarray(cv2.cvtColor(eight, cv2.COLOR_RGB2GRAY) if eight.ndim == 3 else eight, np.uint8)


def find_road(image: Image, rectification: Rectification, settings: MonoSettings) -> GroundPlane | None:
    """Find the road plane of one picture: its pitch from the vanishing point, height and roll as known.

    Parameters
    ----------
    image
        Rectified left image.
    rectification
        The camera.
    settings
        Height, roll and, where known, pitch.

    Returns
    -------
    The plane in the car frame; None where no vanishing point is known to `horizon_px`.
    """
    if settings.pitch_deg is not None:
        return _plane(float(np.radians(settings.pitch_deg)), settings)
    point = vanishing_point(find_segments(image, settings.segment_px), rectification, settings)
    if point is None:
        return None
    r = rectification
    along = np.array([(point[0] - r.cx_px) / r.f_px, (point[1] - r.cy_px) / r.f_px])
    # The road's normal is at right angles to the road's direction: n . (x, y, 1) = 0, with n_x fixed by the roll.
    rolled = np.tan(np.radians(settings.roll_deg)) * along[0]
    return _plane(float(np.arctan(-along[1] - rolled)), settings)


def _plane(pitch_rad: float, settings: MonoSettings) -> GroundPlane:
    normal = np.array([-np.tan(np.radians(settings.roll_deg)), -1.0, -np.tan(pitch_rad)])
    return GroundPlane(normal / np.linalg.norm(normal), settings.height_m)


def find_segments(image: Image, shortest_px: float) -> FloatArray:
    """Return straight edges (n, 4) as u0, v0, u1, v1, pixels, the longest first."""
    # OpenCV returns None for a picture without edges; its type stubs do not say so.
    found = cast("NDArray[np.float32] | None", cv2.createLineSegmentDetector().detect(gray_8bit(image))[0])
    if found is None:
        return np.zeros((0, 4))
    segments = np.asarray(found, float).reshape(-1, 4)
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).T)
    order = np.argsort(-length)
    return np.asarray(segments[order[: int((length >= shortest_px).sum())]])


def vanishing_point(segments: FloatArray, rectification: Rectification, settings: MonoSettings) -> FloatArray | None:
    """Return the (2,) pixel in which most segments of the road meet.

    Parameters
    ----------
    segments
        (n, 4) u0, v0, u1, v1, pixels, the longest first.
    rectification
        The camera.
    settings
        Limits of the pitch, and how well the row must be known.

    Returns
    -------
    The point; None where fewer than three segments agree, or its row is not known to `horizon_px`.
    """
    slope = np.degrees(np.arctan2(*np.abs(segments[:, 3:1:-1] - segments[:, 1::-1]).T))
    voters = segments[(slope > STEEP_DEG[0]) & (slope < STEEP_DEG[1])][:VOTERS]
    candidates = _crossings(voters, rectification, settings.largest_pitch_deg)
    if not len(candidates):
        return None
    point = candidates[int(np.argmax(_votes(candidates, voters).sum(1)))]
    for _ in range(5):
        weight = _votes(point[None], voters)[0]
        on = weight > 0.01 * weight.max()
        if on.sum() < 3:
            return None
        point, sigma_px = _meeting(voters[on], weight[on], point)
    return point if sigma_px[1] <= settings.horizon_px else None


def _lines(segments: FloatArray) -> FloatArray:
    """Return (n, 3) unit normal and offset of each segment's line: a u + b v + c = 0."""
    du, dv = (segments[:, 2:] - segments[:, :2]).T
    normal = np.stack([-dv, du], -1) / np.hypot(du, dv)[:, None]
    return np.column_stack([normal, -np.sum(normal * segments[:, :2], 1)])


def _crossings(segments: FloatArray, r: Rectification, largest_pitch_deg: float) -> FloatArray:
    """Return where pairs of lines cross, (m, 2) pixels, within the image's width and the rows of allowed pitches."""
    lines = _lines(segments)
    i, j = np.triu_indices(len(lines), 1)
    meet = np.cross(lines[i], lines[j])
    # Nearly parallel lines meet nowhere in particular.
    meet = meet[np.abs(meet[:, 2]) > np.sin(np.radians(3.0))]
    uv = meet[:, :2] / meet[:, 2:]
    reach = r.f_px * np.tan(np.radians(largest_pitch_deg))
    allowed = (np.abs(uv[:, 1] - r.cy_px) < reach) & (uv[:, 0] > 0) & (uv[:, 0] < r.size_px[0] - 1)
    return np.asarray(uv[allowed])


def _votes(points: FloatArray, segments: FloatArray) -> FloatArray:
    """Return (m, n) how much each segment votes for each point: its length, if it points there from below."""
    along = segments[:, 2:] - segments[:, :2]
    length = np.hypot(*along.T)
    towards = points[:, None] - (segments[:, 2:] + segments[:, :2]) / 2
    distance = np.maximum(np.hypot(towards[..., 0], towards[..., 1]), 1e-9)
    sine = np.abs(along[:, 0] * towards[..., 1] - along[:, 1] * towards[..., 0]) / (length * distance)
    below = segments[:, 1::2].min(1) > points[:, 1:]
    # A short segment cannot aim better than its ends are known.
    slack = AGREE_RAD + END_PX / length
    return np.asarray(below * length * np.exp(-0.5 * (sine / slack) ** 2))


def _meeting(segments: FloatArray, votes: FloatArray, near: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the point nearest to all lines (2,), each weighted by how well it is known there, and its sigmas (2,)."""
    lines = _lines(segments)
    length = np.hypot(*(segments[:, 2:] - segments[:, :2]).T)
    distance = np.hypot(*((segments[:, 2:] + segments[:, :2]) / 2 - near).T)
    miss_px = END_PX * np.hypot(1.0, 2 * distance / length) / np.sqrt(votes / length)
    A, b = lines[:, :2] / miss_px[:, None], -lines[:, 2] / miss_px
    # A weak hold at the old point keeps a bundle of parallel lines solvable.
    information = A.T @ A + 1e-9 * np.eye(2)
    point = np.linalg.solve(information, A.T @ b + 1e-9 * near)
    return point, np.sqrt(np.diag(np.linalg.inv(information)))
