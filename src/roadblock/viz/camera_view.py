"""What the left camera sees, with what was found in it: free road tinted, obstacles outlined and labelled."""

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.geometry.stereo import image_from_car, triangulate
from roadblock.values.camera import Rectification
from roadblock.values.frame import Image
from roadblock.values.motion import Track
from roadblock.values.scene import EDGE_KINDS, FrameResult, FreeSpace, GroundPlane, Obstacle, Stixels
from roadblock.viz.colors import EDGE_COLORS, FREE, INK, Color, ink_on, range_color
from roadblock.viz.text import draw_text, measure_text, text_width

Picture = NDArray[np.uint8]
"""(height, width, 3) RGB."""
Rect = tuple[int, int, int, int]
"""(u0, v0, u1, v1), half open."""

SUBPIXEL_BITS = 4
ROAD_ALPHA, OBSTACLE_ALPHA = 0.30, 0.30
SOON_S, BESIDE_M = 5.0, 2.0
"""Times to contact below this are written down, of what is not farther aside by then."""
MOST_HIDDEN = 0.1
"""Of a box, by the label of what is not nearer."""
STRETCH_PERCENT = (0.5, 99.5)


def rgb8(image: Image) -> Picture:
    """Return an `Image` as a fresh 8-bit RGB picture; 16 bit is stretched between two percentiles.

    Raises
    ------
    ValueRefusedError
        If it is neither grey nor RGB, or neither 8 nor 16 bit.
    """
    if image.dtype not in (np.uint8, np.uint16) or image.ndim not in (2, 3) or image.shape[2:] not in ((), (3,)):
        raise ValueRefusedError(f"a picture must be grey or RGB of 8 or 16 bit, but got {image.shape} {image.dtype}")
    if image.dtype == np.uint16:
        low, high = np.percentile(image[::4, ::4], STRETCH_PERCENT)
        image = np.clip((image - low) * (255.0 / max(high - low, 1.0)), 0, 255).astype(np.uint8)
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2RGB), np.uint8) if image.ndim == 2 else image.copy()


def draw_camera_view(
    image: Image, result: FrameResult, rectification: Rectification, scale: float, text_px: int
) -> Picture:
    """Return the rectified left image with the result drawn on it.

    Parameters
    ----------
    image
        Rectified left image.
    result
        What was found in it.
    rectification
        The twin cameras.
    scale
        Size of the picture relative to the image.
    text_px
        Height of the labels' letters.

    Raises
    ------
    ValueRefusedError
        As `rgb8`.
    """
    picture = rgb8(image)
    if scale != 1:
        kind = cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC
        picture = np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=kind), np.uint8)
    size_px = (picture.shape[1], picture.shape[0])
    if result.ground is not None:
        _tint(picture, road_top(result.free_space, result.ground, rectification, scale, size_px[0]))
        _dot_edges(picture, result.free_space, result.ground, rectification, scale)
    if result.stixels is not None:
        _draw_stixels(picture, result.stixels, scale)
    _draw_outlines(picture, result.obstacles, scale, thickness=max(1, round(picture.shape[0] / 360)))
    for text, rect, color in place_labels(result.obstacles, scale, text_px, size_px):
        cv2.rectangle(picture, rect[:2], (rect[2] - 1, rect[3] - 1), color, cv2.FILLED)
        draw_text(picture, text, (rect[0] + text_px // 2, rect[3] - 1 - round(0.45 * text_px)), text_px, ink_on(color))
    return picture


def road_top(
    free_space: FreeSpace, ground: GroundPlane, rectification: Rectification, scale: float, width: int
) -> NDArray[np.float64]:
    """Return up to which row each column of the picture shows free road, from its bottom.

    Parameters
    ----------
    free_space
        Per column; NaN is unobserved and never free.
    ground
        The road.
    rectification
        The twin cameras.
    scale, width
        Size of the picture relative to the image, and its columns.

    Returns
    -------
    (width,) rows of the picture; infinity where nothing is known to be free.
    """
    top = np.full(width, np.inf)
    half = column_half_width(free_space)
    rows = (road_rows(free_space, ground, rectification) + 0.5) * scale - 0.5
    edges = np.round((free_space.u_px[:, None] + 0.5 + (-half, half)) * scale).astype(int)
    for (u0, u1), v in zip(edges, rows, strict=True):
        if np.isfinite(v):
            top[max(0, u0) : max(0, u1)] = v
    return top


def road_rows(free_space: FreeSpace, ground: GroundPlane, rectification: Rectification) -> NDArray[np.float64]:
    """Return (n,) the image row of the road at each column's free-space range; NaN where unobserved.

    The point of the column at that forward distance whose height over the road is 0 (`GroundPlane.height_of`).
    """
    z = np.where(np.isfinite(free_space.range_m) & (free_space.range_m > 0), free_space.range_m, np.nan)
    d = rectification.f_px * rectification.baseline_m / z
    points = triangulate(rectification, np.stack([free_space.u_px, np.full_like(z, rectification.cy_px), d], -1))
    points[..., 1] = 0.0
    points[..., 1] = -ground.height_of(points) / ground.normal[1]
    return np.asarray(image_from_car(rectification, points)[..., 1])


def column_half_width(free_space: FreeSpace) -> float:
    """Return half the width of a free-space column, pixels; a single one stands for its own pixel alone."""
    return float(np.median(np.diff(free_space.u_px))) / 2 if len(free_space.u_px) > 1 else 0.5


def _tint(picture: Picture, top: NDArray[np.float64]) -> None:
    """Lay green over the free road, and a line along its far end."""
    height = picture.shape[0]
    rows = np.clip(np.ceil(top), 0, height)
    mask = (np.arange(height)[:, None] >= rows).astype(np.uint8)
    green = np.full_like(picture, FREE)
    cv2.copyTo(cv2.addWeighted(green, ROAD_ALPHA, picture, 1 - ROAD_ALPHA, 0), mask, picture)
    edge = mask - np.vstack([np.zeros((2, mask.shape[1]), np.uint8), mask[:-2]])
    cv2.copyTo(green, edge, picture)


def _dot_edges(
    picture: Picture, free_space: FreeSpace, ground: GroundPlane, rectification: Rectification, scale: float
) -> None:
    """Put a dot where a kerb or a verge crosses each column."""
    if free_space.edges is None:
        return
    rows = road_rows(FreeSpace(free_space.u_px, free_space.edges.range_m), ground, rectification)
    radius = max(1, round(picture.shape[0] / 360))
    for u, v, kind in zip(free_space.u_px, rows, free_space.edges.kind, strict=True):
        if np.isfinite(v):
            at = (round(float((u + 0.5) * scale - 0.5)), round(float((v + 0.5) * scale - 0.5)))
            cv2.circle(picture, at, radius, EDGE_COLORS[EDGE_KINDS[kind]], cv2.FILLED, cv2.LINE_AA)


def _draw_stixels(picture: Picture, stixels: Stixels, scale: float) -> None:
    """Lay each stixel's colour over its place, the nearest last."""
    filled = picture.copy()
    half = np.diff(np.unique(stixels.u_px)).min(initial=np.inf) / 2
    half = half if np.isfinite(half) else 0.5
    rows = np.round(np.stack([stixels.top_px, stixels.bottom_px], -1) * scale).astype(int)
    columns = np.round((stixels.u_px[:, None] + 0.5 + (-half, half)) * scale).astype(int)
    for i in np.argsort(-stixels.range_m):
        filled[rows[i, 0] : rows[i, 1], max(0, columns[i, 0]) : columns[i, 1]] = range_color(float(stixels.range_m[i]))
    cv2.addWeighted(filled, OBSTACLE_ALPHA, picture, 1 - OBSTACLE_ALPHA, 0, dst=picture)


def _draw_outlines(picture: Picture, obstacles: tuple[Obstacle, ...], scale: float, thickness: int) -> None:
    """Fill and outline what each obstacle covers, and frame it; the nearest last, so that it lies on top."""
    far_first = sorted(obstacles, key=lambda obstacle: -obstacle.range_m)
    filled = picture.copy()
    for obstacle in far_first:
        _polygon(filled, obstacle, scale, cv2.FILLED)
    cv2.addWeighted(filled, OBSTACLE_ALPHA, picture, 1 - OBSTACLE_ALPHA, 0, dst=picture)
    for obstacle in far_first:
        color = range_color(obstacle.range_m)
        u0, v0, u1, v1 = view_box(obstacle, scale, (picture.shape[1], picture.shape[0]))
        cv2.rectangle(picture, (u0, v0), (u1 - 1, v1 - 1), INK, thickness + 2)
        cv2.rectangle(picture, (u0, v0), (u1 - 1, v1 - 1), color, thickness)
        _polygon(picture, obstacle, scale, 1)


def _polygon(picture: Picture, obstacle: Obstacle, scale: float, thickness: int) -> None:
    contour = np.asarray(obstacle.contour_px, float).reshape(-1, 2)
    if not len(contour):
        return
    points = [np.round(((contour + 0.5) * scale - 0.5) * 2**SUBPIXEL_BITS).astype(np.int32)]
    color = range_color(obstacle.range_m)
    if thickness == cv2.FILLED:
        cv2.fillPoly(picture, points, color, cv2.LINE_AA, SUBPIXEL_BITS)
    else:
        cv2.polylines(picture, points, True, color, thickness, cv2.LINE_AA, SUBPIXEL_BITS)


def view_box(obstacle: Obstacle, scale: float, size_px: tuple[int, int]) -> Rect:
    """Return the obstacle's box in the scaled picture, cut to it, at least one pixel wide and high."""
    (width, height), (u0, v0, u1, v1) = size_px, (round(edge * scale) for edge in obstacle.box_px)
    u0, v0 = min(max(u0, 0), width - 1), min(max(v0, 0), height - 1)
    return u0, v0, max(u0 + 1, min(u1, width)), max(v0 + 1, min(v1, height))


def label_texts(obstacle: Obstacle) -> tuple[str, str]:
    """Return the label in full ("red obstacle 12.3 ± 0.2 m") and in short ("12.3 ± 0.2 m"), with number and speed."""
    short = measure_text(obstacle.range_m, obstacle.range_sigma_m)
    if obstacle.track is not None:
        short = f"#{obstacle.track.id} {short}{_speed_text(obstacle, obstacle.track)}"
    kind = obstacle.label if obstacle.label != "unknown" else "obstacle"
    return " ".join(filter(None, (obstacle.color, kind, short))), short


def _speed_text(obstacle: Obstacle, track: Track) -> str:
    """Return the speed of what moves, and the time to contact where it is short."""
    text = f", {np.hypot(*track.velocity_mps):.1f} m/s" if track.motion == "moving" else ""
    aside_m = abs(obstacle.position_m[1] + track.ttc_s * track.velocity_mps[1]) - np.nan_to_num(obstacle.size_m[0]) / 2
    return text + (f", in {track.ttc_s:.1f} s" if track.ttc_s < SOON_S and aside_m < BESIDE_M else "")


def place_labels(
    obstacles: tuple[Obstacle, ...], scale: float, text_px: int, size_px: tuple[int, int]
) -> list[tuple[str, Rect, Color]]:
    """Return the labels that fit, none over another: the nearest obstacles choose first.

    Each takes the first place over, under or inside its box, in full or in short, that hides nothing of nearer
    obstacles, else the first that hides little of each of them and of its own; one that finds none is left out.

    Parameters
    ----------
    obstacles
        In any order.
    scale
        As in `draw_camera_view`.
    text_px
        Height of the letters.
    size_px
        (width, height) of the picture.

    Returns
    -------
    Text, rectangle and colour of each label.
    """
    placed: list[tuple[str, Rect, Color]] = []
    nearer: list[Rect] = []
    for obstacle in sorted(obstacles, key=lambda obstacle: obstacle.range_m):
        box = view_box(obstacle, scale, size_px)
        labels = [rect for _, rect, _ in placed]
        spots = [(text, rect) for text in label_texts(obstacle) for rect in _spots(text, box, text_px, size_px)]
        free = [spot for spot in spots if not _overlaps(spot[1], labels) and _hidden(spot[1], box) <= MOST_HIDDEN]
        best = [spot for spot in free if not _overlaps(spot[1], nearer)]
        best = best or [spot for spot in free if all(_hidden(spot[1], other) <= MOST_HIDDEN for other in nearer)]
        placed += [(*spot, range_color(obstacle.range_m)) for spot in best[:1]]
        nearer.append(box)
    return placed


def _spots(text: str, box: Rect, text_px: int, size_px: tuple[int, int]) -> list[Rect]:
    """Return where a label of this box may stand inside the picture, best first."""
    width, height = text_width(text, text_px) + 2 * (text_px // 2), round(1.7 * text_px)
    lefts = (box[0], box[2] - width)
    tops = (box[1] - height, box[3], box[1], box[1] - 2 * height)
    rects = [(left, top, left + width, top + height) for top in tops for left in lefts]
    rects = [(u + s, v, w + s, x) for u, v, w, x in rects for s in (max(0, -u) + min(0, size_px[0] - w),)]
    return [r for r in rects if r[0] >= 0 and r[1] >= 0 and r[2] <= size_px[0] and r[3] <= size_px[1]]


def _hidden(label: Rect, box: Rect) -> float:
    """Return the share of a box that a label hides."""
    width, height = (min(label[i + 2], box[i + 2]) - max(label[i], box[i]) for i in (0, 1))
    return max(width, 0) * max(height, 0) / ((box[2] - box[0]) * (box[3] - box[1]))


def _overlaps(a: Rect, others: list[Rect]) -> bool:
    return any(a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3] for b in others)
