"""The picture of one frame: a header line, the camera's view, and the view from above beside it."""

import math

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.values.camera import Rectification
from roadblock.values.frame import Image
from roadblock.values.scene import FrameResult
from roadblock.viz.birdseye import draw_birds_eye
from roadblock.viz.camera_view import Picture, draw_camera_view
from roadblock.viz.colors import ACTION, INK, MUTED, PAPER, STATE, Color
from roadblock.viz.text import draw_text, fit_text, measure_text, text_width

LEAST_HEIGHT_PX, MOST_SIZE_PX = 360, (1920, 1200)
"""Smaller images are enlarged by a whole number, larger ones reduced, so that the text stays readable and small."""
BIRDS_EYE_SHAPE = 0.8
"""Width of the view from above by its height."""


def draw_overlay(image: Image, result: FrameResult, rectification: Rectification) -> Picture:
    """Draw what was found.

    Parameters
    ----------
    image
        Rectified left `Image`; not changed.
    result
        What was found in it. NaN free space is drawn as unobserved, never as free; without a ground the road is not
        tinted.
    rectification
        The twin cameras it belongs to.

    Returns
    -------
    (height, width, 3) uint8 RGB: header, camera view (see `view_scale`) and bird's-eye view.

    Raises
    ------
    ValueRefusedError
        If the image is no `Image`, or not of the rectified size.
    """
    if image.shape[1::-1] != tuple(rectification.size_px):
        width, height = rectification.size_px
        raise ValueRefusedError(f"the image to draw on has shape {image.shape}, but the rig is for {width}x{height}")
    scale = view_scale(rectification.size_px)
    text_px = min(max(round(rectification.size_px[1] * scale / 30), 13), 30)
    view = draw_camera_view(image, result, rectification, scale, text_px)
    size = (round(BIRDS_EYE_SHAPE * view.shape[0]), view.shape[0])
    above = draw_birds_eye(result, rectification, size, text_px)
    body = np.hstack([view, above])
    return np.vstack([_header(result, body.shape[1], text_px), body])


def view_scale(size_px: tuple[int, int]) -> float:
    """Return by how much an image (width, height) is enlarged or reduced for viewing."""
    width, height = size_px
    return min(max(1, math.ceil(LEAST_HEIGHT_PX / height)), MOST_SIZE_PX[0] / width, MOST_SIZE_PX[1] / height)


def _header(result: FrameResult, width: int, text_px: int) -> Picture:
    """Draw name and what was found at the left, health and time at the right; the middle gives way."""
    strip = np.full((2 * text_px, width, 3), INK, np.uint8)
    base, gap = round(1.4 * text_px), text_px
    state = result.health.state
    reasons = ", ".join(result.health.reasons)
    right = width - gap
    if "total" in result.timings_ms:
        right = _draw_right(strip, f"{result.timings_ms['total']:.0f} ms", right, base, text_px, MUTED)
    verdict = fit_text(f"{state}: {reasons}" if reasons else state, text_px, width // 2)
    right = _draw_right(strip, verdict, right, base, text_px, STATE.get(state, PAPER))
    left = gap
    if result.decision is not None and result.decision.action != "none":
        told = fit_text(f"{result.decision.action}: {result.decision.reason}", text_px, right - left)
        draw_text(strip, told, (left, base), text_px, ACTION[result.decision.action])
        left += text_width(told, text_px) + gap
    for text, color in ((f"frame {result.name}", PAPER), (_summary(result), MUTED)):
        text = fit_text(text, text_px, right - left)
        draw_text(strip, text, (left, base), text_px, color)
        left += text_width(text, text_px) + gap
    return strip


def _draw_right(strip: Picture, text: str, right: int, base: int, text_px: int, color: Color) -> int:
    """Draw `text` so that it ends at `right`; return where the next one may end."""
    left = right - text_width(text, text_px)
    draw_text(strip, text, (left, base), text_px, color)
    return left - text_px


def _summary(result: FrameResult) -> str:
    if not result.obstacles:
        return "no obstacles"
    nearest = min(result.obstacles, key=lambda obstacle: obstacle.range_m)
    count = f"{len(result.obstacles)} obstacle{'s' if len(result.obstacles) > 1 else ''}"
    return f"{count}, nearest {measure_text(nearest.range_m, nearest.range_sigma_m)}"
