"""The scene from above: what is free, what is unknown, and where the obstacles stand, in metres."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.stereo import triangulate
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.scene import EDGE_KINDS, FrameResult, FreeSpace, Obstacle
from roadblock.viz.camera_view import SUBPIXEL_BITS, Picture, column_half_width
from roadblock.viz.colors import (
    EDGE_COLORS,
    FREE,
    FREE_GROUND,
    GRID,
    IN_VIEW,
    INK,
    MUTED,
    PANEL,
    PAPER,
    Color,
    range_color,
)
from roadblock.viz.text import draw_text, text_width

GRID_M = 10
PLOT_RANGES_M = (10, 20, 30, 40, 60)
RANGE_PER_FB = 0.2
"""Metres of plot per metre-pixel of focal length times baseline: there 0.25 px of disparity is 5 % of the range."""
FACE_M = 0.4
"""Drawn depth of an obstacle of which one face alone is seen."""


@dataclass(frozen=True)
class _Plot:
    """From metres (x right, z forward, from the point between the cameras) to panel pixels."""

    origin_px: tuple[float, float]
    px_per_m: float
    range_m: float

    def at(self, x: FloatArray, z: FloatArray) -> FloatArray:
        return np.stack([self.origin_px[0] + self.px_per_m * x, self.origin_px[1] - self.px_per_m * z], -1)


def plot_range_m(rectification: Rectification) -> int:
    """Return how far ahead the plot reaches: as far as the rig measures well; the same for all its frames."""
    useful = RANGE_PER_FB * rectification.f_px * rectification.baseline_m
    return max([PLOT_RANGES_M[0], *(r for r in PLOT_RANGES_M if r <= useful)])


def draw_birds_eye(
    result: FrameResult, rectification: Rectification, size_px: tuple[int, int], text_px: int
) -> Picture:
    """Return the view from above.

    Green is free road, plain grey lies behind something, hatched was not observed, dark is outside the view. An
    obstacle is its visible width, with a bar of one standard deviation to both sides along the line of sight.

    Parameters
    ----------
    result
        What was found.
    rectification
        The twin cameras.
    size_px
        (width, height) of the picture.
    text_px
        Height of the letters.
    """
    width, height = size_px
    range_m = plot_range_m(rectification)
    margin = 1.9 * text_px
    plot = _Plot((width / 2, height - margin), (height - 2 * margin) / range_m, range_m)
    picture = np.full((height, width, 3), PANEL, np.uint8)
    _draw_sectors(picture, plot, result.free_space, rectification)
    _draw_edges(picture, plot, result.free_space, rectification)
    _draw_grid(picture, plot, text_px)
    points = [triangulate(rectification, obstacle.uvd_px) for obstacle in result.obstacles]
    inside = [_is_inside(plot, point, width) for point in points]
    for obstacle, point, is_inside in reversed(list(zip(result.obstacles, points, inside, strict=True))):
        if is_inside:
            _draw_obstacle(picture, plot, obstacle, point, text_px)
    _draw_cameras(picture, plot, text_px)
    if not all(inside):
        note = f"+{inside.count(False)} outside"
        left = width - text_width(note, text_px) - text_px // 2
        cv2.rectangle(picture, (left - text_px // 2, 0), (width, 2 * text_px - 1), PANEL, cv2.FILLED)
        draw_text(picture, note, (left, 3 * text_px // 2), text_px, MUTED)
    return picture


def _fill(picture: Picture, points: FloatArray, color: Color) -> None:
    fixed = np.round(points * 2**SUBPIXEL_BITS).astype(np.int32)
    cv2.fillPoly(picture, [fixed], color, cv2.LINE_AA, SUBPIXEL_BITS)


def _line(picture: Picture, points: FloatArray, color: Color, thickness: int = 1) -> None:
    fixed = np.round(points * 2**SUBPIXEL_BITS).astype(np.int32)
    cv2.polylines(picture, [fixed], False, color, thickness, cv2.LINE_AA, SUBPIXEL_BITS)


def _fan(plot: _Plot, rectification: Rectification, u_px: FloatArray, z: FloatArray) -> FloatArray:
    """Return the area seen through columns `u_px` (n,) up to forward distances `z` (n,), as a polygon."""
    x = (u_px - rectification.cx_px) / rectification.f_px * z - rectification.baseline_m / 2
    return np.vstack([plot.at(np.zeros(1), np.zeros(1)), plot.at(x, z)])


def _draw_sectors(picture: Picture, plot: _Plot, free_space: FreeSpace, rectification: Rectification) -> None:
    """Everything in view starts as unobserved; observed columns are painted over it, free up to their range."""
    width = rectification.size_px[0]
    view = _fan(plot, rectification, np.array([-0.5, width - 0.5]), np.full(2, plot.range_m))
    in_view = np.zeros(picture.shape[:2], np.uint8)
    cv2.fillPoly(in_view, [np.round(view).astype(np.int32)], 255)
    row, column = np.indices(in_view.shape)
    picture[in_view > 0] = IN_VIEW
    picture[(in_view > 0) & ((row + column) % 9 < 5)] = PANEL
    half = column_half_width(free_space)
    for run in _observed_runs(free_space):
        u = np.repeat(free_space.u_px[run], 2) + np.tile([-half, half], len(run))
        z = np.minimum(np.repeat(free_space.range_m[run], 2), plot.range_m)
        _fill(picture, _fan(plot, rectification, u, np.full_like(z, plot.range_m)), IN_VIEW)
        free = _fan(plot, rectification, u, z)
        _fill(picture, free, FREE_GROUND)
        _line(picture, free[1:], FREE)


def _draw_edges(picture: Picture, plot: _Plot, free_space: FreeSpace, rectification: Rectification) -> None:
    """Put a dot on each kerb and verge."""
    if free_space.edges is None:
        return
    z = free_space.edges.range_m
    for kind, color in EDGE_COLORS.items():
        shown = (free_space.edges.kind == EDGE_KINDS.index(kind)) & (z < plot.range_m)
        for point in _fan(plot, rectification, free_space.u_px[shown], z[shown])[1:]:
            cv2.circle(picture, np.round(point).astype(int).tolist(), 2, color, cv2.FILLED, cv2.LINE_AA)


def _observed_runs(free_space: FreeSpace) -> list[NDArray[np.intp]]:
    """Return the indices of neighbouring observed columns, run by run."""
    seen = np.flatnonzero(np.isfinite(free_space.range_m) & (free_space.range_m > 0))
    return [run for run in np.split(seen, np.flatnonzero(np.diff(seen) > 1) + 1) if len(run)]


def _draw_grid(picture: Picture, plot: _Plot, text_px: int) -> None:
    height, width = picture.shape[:2]
    step = GRID_M if plot.range_m > 2 * GRID_M else GRID_M // 2
    for z in range(0, int(plot.range_m) + 1, step):
        v = round(float(plot.at(np.zeros(1), np.array([z]))[0, 1]))
        cv2.line(picture, (0, v), (width - 1, v), GRID, 1)
        draw_text(picture, f"{z} m", (text_px // 2, v - text_px // 4), text_px, MUTED)
    side = int(width / 2 / plot.px_per_m) // step * step
    for x in range(-side, side + 1, step):
        u = round(float(plot.at(np.array([x]), np.zeros(1))[0, 0]))
        cv2.line(picture, (u, 0), (u, height - 1), GRID, 1)


def _is_inside(plot: _Plot, point: FloatArray, width: int) -> bool:
    return bool(0 < point[2] <= plot.range_m and abs(point[0]) * plot.px_per_m < width / 2)


def _draw_obstacle(picture: Picture, plot: _Plot, obstacle: Obstacle, point: FloatArray, text_px: int) -> None:
    color = range_color(obstacle.range_m)
    (x, _, z), half = point, np.nan_to_num(obstacle.size_m[0]) / 2
    depth = obstacle.size_m[2] if np.isfinite(obstacle.size_m[2]) else FACE_M
    box = plot.at(np.array([x - half, x + half, x + half, x - half]), np.array([z, z, z + depth, z + depth]))
    least = text_px / 5  # a pole 40 m away is thinner than a pixel
    box[:, 0] += np.array([-1, 1, 1, -1]) * max(0.0, least - half * plot.px_per_m)
    box[2:, 1] = np.minimum(box[2:, 1], box[0, 1] - 2 * least)
    if np.isfinite(obstacle.range_sigma_m):
        ends = z + obstacle.range_sigma_m * np.array([-1.0, 1.0])
        _draw_bar(picture, plot.at(x / z * ends, ends), text_px / 4)
    _fill(picture, box, color)
    _line(picture, np.vstack([box, box[:1]]), INK)


def _draw_bar(picture: Picture, ends: FloatArray, cap_px: float) -> None:
    """Draw an error bar with caps, light on a dark casing."""
    along = ends[1] - ends[0]
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-9) * cap_px
    strokes = [ends, *(np.stack([end - across, end + across]) for end in ends)]
    for color, thickness in ((INK, 3), (PAPER, 1)):
        for stroke in strokes:
            _line(picture, stroke, color, thickness)


def _draw_cameras(picture: Picture, plot: _Plot, text_px: int) -> None:
    """Draw a small arrow head where the cameras are, looking ahead."""
    tip = np.array(plot.origin_px)
    arrow = tip + text_px * np.array([[0.0, 0.0], [0.5, 0.9], [0.0, 0.65], [-0.5, 0.9]])
    _fill(picture, arrow, PAPER)
