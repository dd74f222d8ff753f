"""Circles of an asymmetric grid: centres of mass, put right for perspective."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.values.board import Board, Sighting
from roadblock.values.checks import FloatArray

Grey = NDArray[np.uint8]

SEARCH_PX = 2_000_000
"""Larger pictures are searched at a smaller scale."""
REACH = 0.95 * 2**0.5 / 2
"""Half the way to the next circle, in steps of the grid: what lies nearer belongs to a circle alone."""
EDGE_PX = 3.0
"""Pixels so far outside a circle's edge still count for its centre."""
WORST_ORDER = 0.4
"""Circles numbered in the wrong order lie this many steps of the grid and more off a plane grid."""
LEAST_CONTRAST = 8.0
LEAST_SIGMA_PX = 0.005
"""Shade across a circle moves its centre of mass by about this much, whatever the noise."""


def find_circles(grey: Grey, board: Board) -> Sighting | None:
    """Find an asymmetric grid of dark or bright circles, (height, width) uint8.

    The centre of mass of a circle's picture is not the picture of its centre: the difference follows from the
    perspective of the whole grid and the circle's measured size. What the lens bends within one circle is left in.

    Rows run along x and the next row lies clockwise of it. A grid of odd rows looks alike only as it is; one of even
    rows looks alike turned by 180 degrees: its rows then run to the right in the picture.
    """
    for polarity in (grey, np.asarray(255 - grey, np.uint8)):
        centers = _search(polarity, board)
        order = None if centers is None else _in_order(centers, board)
        if order is not None:
            fits = _measured(polarity.astype(np.float64), order, board)
            ids = np.flatnonzero(np.isfinite(fits).all(-1))
            return Sighting(ids, fits[ids, :2], np.maximum(fits[ids, 2], LEAST_SIGMA_PX)) if len(ids) else None
    return None


def _search(grey: Grey, board: Board) -> FloatArray | None:
    """Return (n, 2) about where dark circles are, in OpenCV's order."""
    shrink = math.ceil((grey.size / SEARCH_PX) ** 0.5)
    small = cv2.resize(grey, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA)
    wanted = cv2.SimpleBlobDetector.Params()
    wanted.minArea, wanted.maxArea = 12.0, small.size / (2.0 * board.columns * board.rows)
    wanted.minDistBetweenBlobs = 4.0
    wanted.filterByConvexity = False
    detector = cv2.SimpleBlobDetector.create(wanted)
    for flags in (cv2.CALIB_CB_ASYMMETRIC_GRID, cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING):
        found, centers = cv2.findCirclesGrid(small, (board.columns, board.rows), flags=flags, blobDetector=detector)
        if found:
            scale = np.array(grey.shape[::-1]) / small.shape[::-1]
            return np.asarray((np.asarray(centers, np.float64).reshape(-1, 2) + 0.5) * scale - 0.5)
    return None


def _in_order(centers: FloatArray, board: Board) -> FloatArray | None:
    """Turn the grid (never mirror it) so that it is the board's; None if it cannot be.

    OpenCV begins at any corner, and takes neighbouring rows of an even grid for each other.
    """
    grid = centers.reshape(board.rows, board.columns, 2)
    swapped = grid[np.arange(board.rows) ^ 1] if board.rows % 2 == 0 else grid
    best, order = (WORST_ORDER, 0.0), None
    for g in (grid, swapped):
        for turned in (g, g[::-1, ::-1], g[::-1], g[:, ::-1]):
            points = turned.reshape(-1, 2)
            H = _homography(board, points)
            area = float(np.linalg.det(_jacobian(H, board.points_m.mean(0)[:2]))) * board.square_m**2
            if not area > 0:
                continue  # mirrored
            error = float((((_through(H, board.points_m[:, :2]) - points) ** 2).mean() / area) ** 0.5)
            rank = (round(error, 1), -float(turned[0, -1, 0] - turned[0, 0, 0]))
            if rank < best:
                best, order = rank, points
    return order


def _measured(grey: FloatArray, centers: FloatArray, board: Board) -> FloatArray:
    """Return (n, 3) u, v and their sigma, pixels; NaN where a circle cannot be measured."""
    H = _homography(board, centers)
    on_board = board.points_m[:, :2]
    out = np.full((len(centers), 3), np.nan)
    for i, (center, X) in enumerate(zip(centers, on_board, strict=True)):
        to_steps = np.asarray(np.linalg.inv(_jacobian(H, X)) / board.square_m, np.float64)
        found = _mass(grey, center, to_steps)
        if found is not None:
            (u, v, sigma), radius = found
            out[i] = u, v, sigma
            out[i, :2] += _through(H, X[None])[0] - _ellipse_center(H, X, radius * board.square_m)
    return out


def _mass(
    grey: FloatArray, center: FloatArray, to_steps: FloatArray
) -> tuple[tuple[float, float, float], float] | None:
    """Return centre of mass and its sigma, pixels, and the radius, in steps of the grid, of a dark circle."""
    height, width = grey.shape
    half = np.ceil(REACH * np.linalg.norm(np.linalg.inv(to_steps), axis=1)).astype(int) + 1
    low = np.maximum(np.rint(center).astype(int) - half, 0)
    high = np.minimum(np.rint(center).astype(int) + half + 1, (width, height))
    v, u = np.mgrid[low[1] : high[1], low[0] : high[0]]
    levels = grey[low[1] : high[1], low[0] : high[0]]
    radius, reach, mass = 0.0, REACH, center
    for _ in range(3):
        away = np.hypot(*(to_steps @ np.stack([u - mass[0], v - mass[1]]).reshape(2, -1))).reshape(u.shape)
        ring = levels[(away > 0.85 * REACH) & (away <= REACH)]
        core = levels[away <= max(0.5 * radius, away.min(initial=np.inf))]
        if ring.size < 8 or np.median(ring) - np.median(core) < LEAST_CONTRAST:
            return None
        contrast = np.median(ring) - np.median(core)
        share = np.where(away <= reach, (np.median(ring) - levels) / contrast, 0.0)
        total = share.sum()
        if total <= 0:
            return None
        mass = np.array([(share * u).sum(), (share * v).sum()]) / total
        radius = float((total * abs(np.linalg.det(to_steps)) / np.pi) ** 0.5)
        reach = min(REACH, radius + EDGE_PX * float(np.abs(np.linalg.det(to_steps)) ** 0.5))
    noise = max(float(1.4826 * np.median(np.abs(ring - np.median(ring)))), 12**-0.5)
    arms = (np.stack([u - mass[0], v - mass[1]])[:, away <= reach] ** 2).sum() / 2
    return (float(mass[0]), float(mass[1]), float(noise / contrast * arms**0.5 / total)), radius


def _homography(board: Board, points: FloatArray) -> FloatArray:
    H, _ = cv2.findHomography(board.points_m[:, :2], points)
    return np.eye(3) * np.nan if H is None else np.asarray(H, np.float64)


def _through(H: FloatArray, points: FloatArray) -> FloatArray:
    mapped = np.c_[points, np.ones(len(points))] @ H.T
    return np.asarray(mapped[:, :2] / mapped[:, 2:])


def _jacobian(H: FloatArray, X: FloatArray) -> FloatArray:
    """d(u, v) / d(x, y) at one point, (2, 2)."""
    x, y, w = H @ (X[0], X[1], 1.0)
    return np.asarray((H[:2, :2] - np.outer((x / w, y / w), H[2, :2])) / w)


def _ellipse_center(H: FloatArray, X: FloatArray, radius: float) -> FloatArray:
    """Return the centre of the ellipse that a circle about X looks like."""
    x, y = X
    circle = np.array([[1, 0, -x], [0, 1, -y], [-x, -y, x * x + y * y - radius**2]])
    back = np.linalg.inv(H)
    conic = back.T @ circle @ back
    return np.asarray(np.linalg.solve(conic[:2, :2], -conic[:2, 2]))
