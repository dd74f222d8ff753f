"""The compiled kernels behind rendered boards: where rays meet the paper, and what is printed there.

Places on a board are given in squares (for circles in steps of the grid), from its first point on.
"""

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.values.checks import FloatArray

CHESSBOARD, CHARUCO, CIRCLES = range(3)

RIM_SQUARES = 2
"""Squares from the outermost points to the edge of the paper."""

WHITE, BLACK = 0.75, 0.05
"""Light that paper and ink send back where the lamp falls straight on them."""

DOT_STEPS = 0.4
"""Radius of a dot, in steps of the grid."""


class Pattern(NamedTuple):
    """What is printed, as the kernels take it: in squares, from the first point on."""

    kind: int
    columns: int
    rows: int
    width: float
    height: float
    bits: NDArray[np.uint8]
    share: float


@numba.njit(cache=True, nogil=True, error_model="numpy")
def meet(
    rays: FloatArray, eye: FloatArray, curvature: float, middle: FloatArray, square_m: float, onto: FloatArray
) -> None:
    """Fill in where rays (h, w, 3) meet the board, (h, w, 2) in squares; NaN where they do not, or from behind.

    `eye` is the camera's pose in the board's frame. Newton's method on `z = curvature * r^2`, started on the plane.
    """
    ox, oy, oz = eye[0, 3] - middle[0], eye[1, 3] - middle[1], eye[2, 3]
    for row in range(rays.shape[0]):
        for column in range(rays.shape[1]):
            a, b, c = rays[row, column]
            dx = eye[0, 0] * a + eye[0, 1] * b + eye[0, 2] * c
            dy = eye[1, 0] * a + eye[1, 1] * b + eye[1, 2] * c
            dz = eye[2, 0] * a + eye[2, 1] * b + eye[2, 2] * c
            s = -oz / dz if dz > 0 else np.nan
            if curvature != 0:
                for _ in range(6):
                    x, y = ox + s * dx, oy + s * dy
                    s -= (oz + s * dz - curvature * (x * x + y * y)) / (dz - 2 * curvature * (x * dx + y * dy))
            if not s > 0:
                s = np.nan
            onto[row, column, 0] = (ox + s * dx + middle[0]) / square_m
            onto[row, column, 1] = (oy + s * dy + middle[1]) / square_m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def on_paper(pattern: Pattern, x: float, y: float) -> bool:
    """Whether a place, in squares, is on the paper."""
    return -RIM_SQUARES <= x < pattern.width - RIM_SQUARES and -RIM_SQUARES <= y < pattern.height - RIM_SQUARES


@numba.njit(cache=True, nogil=True, error_model="numpy")
def is_black(pattern: Pattern, x: float, y: float) -> bool:
    """Whether a place on the paper, in squares, is printed on."""
    if pattern.kind == CIRCLES:
        row = round(y)
        if not 0 <= row < pattern.rows:
            return False
        column = min(max(round((x - row % 2) / 2), 0), pattern.columns - 1)
        return bool(math.hypot(x - 2 * column - row % 2, y - row) < DOT_STEPS)
    column, row = math.floor(x) + 1, math.floor(y) + 1
    if not (0 <= column <= pattern.columns and 0 <= row <= pattern.rows):
        return False
    if (row + column) % 2 == 0:
        return True
    if pattern.kind == CHESSBOARD:
        return False
    side = pattern.bits.shape[2]
    i = math.floor(((y - row + 0.5) / pattern.share + 0.5) * side)
    j = math.floor(((x - column + 0.5) / pattern.share + 0.5) * side)
    return 0 <= i < side and 0 <= j < side and bool(pattern.bits[row, column, i, j])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def meets_edge(pattern: Pattern, x: float, y: float, reach: float) -> bool:
    """Whether there may be an edge within `reach` squares of a place."""
    if abs(x - round(x)) <= reach or abs(y - round(y)) <= reach:
        return True  # lines of squares, and the edge of the paper
    if pattern.kind == CIRCLES:
        row = round(y)
        column = round((x - row % 2) / 2)
        return bool(abs(math.hypot(x - 2 * column - row % 2, y - row) - DOT_STEPS) <= 1.5 * reach)
    if pattern.kind == CHARUCO:  # lines of the markers' bits
        per_square = pattern.bits.shape[2] / pattern.share
        i, j = per_square * (x - math.floor(x) - 0.5), per_square * (y - math.floor(y) - 0.5)
        half = pattern.bits.shape[2] % 2 / 2  # the middle of an odd number of bits is no line
        return bool(min(abs(i - half - round(i - half)), abs(j - half - round(j - half))) <= reach * per_square)
    return False


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def lamp(pattern: Pattern, slope: FloatArray, x: float, y: float) -> float:
    """Return how brightly a place on the paper is lit, 1 in the middle."""
    across = 2 * x / (pattern.width - 2 * RIM_SQUARES) - 1
    down = 2 * y / (pattern.height - 2 * RIM_SQUARES) - 1
    return float(max(0.0, 1 + slope[0] * across + slope[1] * down))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def draw(
    onto: FloatArray,
    pattern: Pattern,
    slope: FloatArray,
    places: FloatArray,
    reach_px: float,
    behind: NDArray[np.float32],
    light: NDArray[np.float32],
) -> None:
    """Fill in the light (h, w), averaged over the rays of each pixel.

    `onto` is where the rays of the pixels and one more on each side meet the board; between them a parabola is
    followed. `places` (h, n, 2) are the rays of a pixel, `reach_px` how far off they lie at most; `slope` is how much
    brighter the board gets over half its size.
    """
    for v in range(light.shape[0]):
        for u in range(light.shape[1]):
            light[v, u] = behind[v, u]
            around = onto[v : v + 3, u : u + 3]
            if not np.isfinite(around.sum()):
                continue
            x, y = around[1, 1]
            du, dv = (around[1, 2] - around[1, 0]) / 2, (around[2, 1] - around[0, 1]) / 2
            duu = around[1, 2] - 2 * around[1, 1] + around[1, 0]
            dvv = around[2, 1] - 2 * around[1, 1] + around[0, 1]
            duv = (around[2, 2] - around[2, 0] - around[0, 2] + around[0, 0]) / 4
            reach = reach_px * max(abs(du[0]) + abs(dv[0]), abs(du[1]) + abs(dv[1]))
            if not meets_edge(pattern, x, y, reach):
                if on_paper(pattern, x, y):
                    light[v, u] = lamp(pattern, slope, x, y) * (BLACK if is_black(pattern, x, y) else WHITE)
                continue
            total = 0.0
            for i in range(places.shape[1]):
                a, b = places[v, i]
                px = x + a * du[0] + b * dv[0] + a * a / 2 * duu[0] + b * b / 2 * dvv[0] + a * b * duv[0]
                py = y + a * du[1] + b * dv[1] + a * a / 2 * duu[1] + b * b / 2 * dvv[1] + a * b * duv[1]
                if on_paper(pattern, px, py):
                    total += lamp(pattern, slope, px, py) * (BLACK if is_black(pattern, px, py) else WHITE)
                else:
                    total += behind[v, u]
            light[v, u] = total / places.shape[1]
