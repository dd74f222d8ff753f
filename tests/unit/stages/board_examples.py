"""Pictures of chessboards with edges at exactly known places."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from roadblock.geometry.projection import project, unproject
from roadblock.values.camera import Camera

FINE = 4
"""Sub-pixels per pixel and axis; within one, the share that an edge covers is exact to first order."""


def pose(rotation_rad: tuple[float, float, float], position: tuple[float, float, float]) -> NDArray[np.float64]:
    """3x4 pose of a board in the camera: turned about x, then y, then z."""
    a, b, c = rotation_rad
    Rx = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    Ry = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    Rz = np.array([[np.cos(c), -np.sin(c), 0], [np.sin(c), np.cos(c), 0], [0, 0, 1]])
    return np.c_[Rz @ Ry @ Rx, position]


def corners_px(camera: Camera, T: NDArray[np.float64], columns: int, rows: int) -> NDArray[np.float64]:
    """(columns * rows, 2) exact pixels of the inner corners; the middle of the board is at the pose's position."""
    row, column = np.divmod(np.arange(columns * rows), columns)
    flat = np.stack([column - (columns - 1) / 2, row - (rows - 1) / 2, 0 * row, 1 + 0 * row], -1)
    return project(camera, flat @ T.T)


def chessboard(
    camera: Camera,
    T: NDArray[np.float64],
    columns: int,
    rows: int,
    *,
    blur_px: float,
    black: float = 40.0,
    white: float = 200.0,
    first_black: bool = True,
) -> NDArray[np.float64]:
    """Render a board of unit squares with a white border of one square, without noise: float grey levels."""
    width, height = camera.size_px
    sub = (np.arange(-FINE * 4, (max(width, height) + 4) * FINE) + 0.5) / FINE - 0.5
    u, v = np.meshgrid(sub[: (width + 8) * FINE], sub[: (height + 8) * FINE])
    ray = unproject(camera, np.stack([u, v], -1))
    normal = T[:, 2]
    with np.errstate(all="ignore"):
        point = ray * ((normal @ T[:, 3]) / (ray @ normal))[..., None] - T[:, 3]
    x = point @ T[:, 0] + (columns - 1) / 2
    y = point @ T[:, 1] + (rows - 1) / 2
    pattern = _edge(x) * _edge(y)
    board = _between(x, -1, columns) * _between(y, -1, rows)
    sign = -1.0 if first_black else 1.0
    light = board * (0.5 + 0.5 * sign * pattern) + (1 - board)
    fine = gaussian_filter(black + (white - black) * light, blur_px * FINE)
    coarse = fine.reshape(height + 8, FINE, width + 8, FINE).mean((1, 3))
    return coarse[4:-4, 4:-4]


def noisy(image: NDArray[np.float64], sigma: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add Gaussian noise and round to 8 bits."""
    return np.clip(np.rint(image + sigma * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)


def _slope(x: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.hypot(*np.gradient(x))


def _edge(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """+1 between 2k-1 and 2k (the square before the first corner), -1 between 2k and 2k+1, with exact edges."""
    wave = np.abs((x + 0.5) % 2 - 1) - 0.5
    return np.clip(wave / _slope(x), -0.5, 0.5) * 2


def _between(x: NDArray[np.float64], low: float, high: float) -> NDArray[np.float64]:
    return np.clip(np.minimum(x - low, high - x) / _slope(x) + 0.5, 0, 1)
