"""Find a board in a picture: which of its points are where, and how sure."""

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.stages.calibrate.board import marker_dictionaries
from roadblock.stages.calibrate.circles import find_circles
from roadblock.stages.calibrate.corners import CornerFits, fit_corners, local_steps
from roadblock.values.board import Board, Sighting
from roadblock.values.checks import FloatArray

Grey = NDArray[np.uint8]

SEARCH_PX = 2_000_000
"""Larger pictures are searched at a smaller scale; corners are fitted to the full picture in any case."""
LEAST_SIDE_PX = 24
LEAST_SHARE = 0.5
"""So many of the corners found must be fitted; otherwise the picture is too blurred or too coarse for the fit."""
FEWEST = 4
UNKNOWN_SIGMA_PX = 0.1
"""Of corners refined by OpenCV on a board too small to tell."""
LEAST_SIGMA_PX = 0.001
LEAST_TURNS = 2
"""So many changes from black to white in a row make squares."""
MOST_GROWTH = 2.0
"""A square is at most so many times as wide as the one before it: tilted boards and fisheyes stay below 1.5."""
LEAST_ALTERNATING = 0.75
"""So many of the neighbouring squares must differ in the sense they should; the rest a hand may hide."""
ROUGHEST = 0.08
"""What is less regular than this share of a square is no board."""
ROOM_PX = 5.0
"""A ChArUco's edges need this much room to the markers, or their corners are OpenCV's."""


def find_board(image: NDArray[np.uint8], board: Board) -> Sighting | None:
    """Find the board's points in an image, to the noise limit where the picture allows it.

    Which point is the first: seen as the picture shows the board, rows run along x and the next row lies clockwise
    of it (never mirrored). The square before the first corner of a chessboard (left of its column and above its row)
    is black. Where that leaves a choice, because the board looks alike turned by 180 degrees (both counts odd or both
    even), or by 90 too (two equal even counts), the rows run to the right in the picture as far as they can.

    Parameters
    ----------
    image
        (height, width) grey levels or (height, width, 3) RGB, uint8.
    board
        What to look for. Chessboards must be seen as a whole (single corners may still be dropped, where something
        disturbs them), of ChArUco boards any part; both layouts of markers that OpenCV has had are tried.

    Returns
    -------
    Where it is, ids in rising order; None if the image does not show it.

    Raises
    ------
    ValueRefusedError
        If the image has another shape or type, or no pixels.
    """
    grey = to_grey(image)
    if min(grey.shape) < LEAST_SIDE_PX:
        return None
    if board.kind == "circles":
        return find_circles(grey, board)
    if board.kind == "charuco":
        grid = find_charuco(grey, board)
        return None if grid is None else _sighting(grey, grid, board, (1 - board.marker_share) / 2)
    grid = _find_chessboard(grey, board)
    return None if grid is None else _sighting(grey, grid, board, 0.5)


def to_grey(image: NDArray[np.uint8]) -> Grey:
    """Return a grey picture of a grey or RGB one; see `find_board` for what is refused."""
    array = np.asarray(image)
    if array.dtype != np.uint8 or array.ndim not in (2, 3) or array.shape[2:] not in ((), (3,)) or not array.size:
        raise ValueRefusedError(
            "an image must be uint8 of shape (height, width) or (height, width, 3), "
            f"but got {array.dtype} of shape {array.shape}"
        )
    return array if array.ndim == 2 else np.asarray(cv2.cvtColor(array, cv2.COLOR_RGB2GRAY), np.uint8)


def shrunk(grey: Grey) -> Grey:
    """Return the picture itself, or a smaller one that is quick to search."""
    if grey.size <= SEARCH_PX:
        return grey
    scale = 1 / math.ceil((grey.size / SEARCH_PX) ** 0.5)
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _find_chessboard(grey: Grey, board: Board) -> FloatArray | None:
    """Return (rows, columns, 2) about where the corners are, pixels."""
    size, small = (board.columns, board.rows), shrunk(grey)
    found, corners = cv2.findChessboardCornersSB(small, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
    if not found and cv2.checkChessboard(small, size):
        found, corners = _search_harder(small, size)
    if not found:
        return None
    scale = np.array(grey.shape[::-1]) / small.shape[::-1]
    points = (np.asarray(corners, np.float64).reshape(-1, 2) + 0.5) * scale - 0.5
    if small is not grey:
        points = _refined(grey, points, math.ceil(scale.max()) + 2)
    return points.reshape(board.rows, board.columns, 2)


def _search_harder(grey: Grey, size: tuple[int, int]) -> tuple[bool, FloatArray]:
    found, corners = cv2.findChessboardCorners(
        grey, size, flags=cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    )
    if found:
        return True, _refined(grey, np.asarray(corners, np.float64).reshape(-1, 2), 3)
    found, corners = cv2.findChessboardCornersSB(
        grey, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    )
    return bool(found), np.asarray(corners, np.float64)


def charuco_detector(board: Board, legacy: bool) -> "cv2.aruco.CharucoDetector":
    """Return OpenCV's detector for a ChArUco board; `legacy`: the layout of OpenCV before 4.6."""
    dictionary = cv2.aruco.getPredefinedDictionary(marker_dictionaries()[board.dictionary])
    squares = (board.columns + 1, board.rows + 1)
    layout = cv2.aruco.CharucoBoard(squares, board.square_m, board.marker_share * board.square_m, dictionary)
    layout.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(layout)


def find_charuco(grey: Grey, board: Board) -> FloatArray | None:
    """Return (rows, columns, 2) about where the corners are, pixels, NaN where one was not found."""
    best = None
    for legacy in (False, True) if board.rows % 2 else (False,):  # the layouts differ for an even count of squares only
        points, ids, *_ = charuco_detector(board, legacy).detectBoard(grey)
        if ids is not None and len(ids) >= FEWEST and (best is None or len(ids) > len(best[0])):
            best = np.ravel(ids), np.asarray(points, np.float64).reshape(-1, 2)
    if best is None:
        return None
    grid = np.full((board.rows * board.columns, 2), np.nan)
    grid[best[0]] = best[1]
    return grid.reshape(board.rows, board.columns, 2)


def _sighting(grey: Grey, grid: FloatArray, board: Board, clear: float) -> Sighting | None:
    """Fit the corners near `grid`, and number them."""
    if board.kind == "chessboard":
        if not (_grows_evenly(grid) and _alternates(grey, grid)) or _goes_on(grey, grid):
            return None
        grid = grid if _right_handed(grid) else grid[:, ::-1]
    fits = fit_corners(grey, grid, clear)
    found = np.isfinite(grid[..., 0]).sum()
    if fits.usable.sum() < max(FEWEST, LEAST_SHARE * found):
        fits = _coarse(grey, grid)
    if not fits.usable.any():
        return None
    order = np.arange(board.columns * board.rows).reshape(board.rows, board.columns)
    if board.kind == "chessboard":
        order = _from_first(grey, grid, order)
    ids = np.flatnonzero(fits.usable[order.ravel()])
    place = order.ravel()[ids]
    blur = float(np.median(fits.blur_px[place]))
    return Sighting(ids, fits.points_px[place], np.maximum(fits.sigma_px[place], LEAST_SIGMA_PX), blur)


def _grows_evenly(grid: FloatArray) -> bool:
    """Whether each step from corner to corner, along rows and columns, is about as long as the one before it."""
    for axis in (0, 1):
        step = np.linalg.norm(np.diff(grid, axis=axis), axis=-1)
        before, after = step.take(range(step.shape[axis] - 1), axis), step.take(range(1, step.shape[axis]), axis)
        if (np.maximum(before, after) > MOST_GROWTH * np.minimum(before, after)).any():
            return False
    return True


def _alternates(grey: Grey, grid: FloatArray) -> bool:
    """Whether the squares between the corners are bright and dark in turns."""
    levels = _cell_levels(grey, grid)
    turn = np.where(np.indices(levels.shape).sum(0) % 2, -1.0, 1.0)
    brighter = np.concatenate([(np.diff(levels, axis=axis) * np.delete(turn, 0, axis)).ravel() for axis in (0, 1)])
    share = float((brighter > 0).mean())
    return max(share, 1 - share - float((brighter == 0).mean())) >= LEAST_ALTERNATING


def _goes_on(grey: Grey, grid: FloatArray) -> bool:
    """Whether the grid is a part of a larger chessboard: beyond the squares around it, on one side, come squares.

    Which part a picture shows would be anyone's guess, and another one in the next picture.
    """
    dark, bright = np.sort(_cell_levels(grey, grid), axis=None)[[0, -1]]
    for turned in (grid, grid[::-1], grid.swapaxes(0, 1), grid[:, ::-1].swapaxes(0, 1)):
        line = 2.5 * turned[0] - 1.5 * turned[1]
        centers = (line[1:] + line[:-1]) / 2
        inside = ((centers >= 0) & (centers <= np.array(grey.shape[::-1]) - 1)).all(-1)
        u, v = np.rint(centers[inside]).astype(int).T
        is_bright = grey[v, u] > (float(dark) + float(bright)) / 2
        turns = is_bright[1:] != is_bright[:-1]
        if len(turns) >= LEAST_TURNS and inside.all() and turns.all():
            return True
    return False


def _right_handed(grid: FloatArray) -> bool:
    steps = local_steps(grid)
    return bool(np.nanmedian(np.linalg.det(steps)) > 0)


def _from_first(grey: Grey, grid: FloatArray, order: NDArray[np.intp]) -> NDArray[np.intp]:
    """Turn `order`, (rows, columns) indices of corners, so that it begins where `find_board` says."""
    rows, columns = order.shape
    colour = _colour(grey, grid)
    turns = []
    for quarter in range(4) if rows == columns else (0, 2):
        turned = np.rot90(order, quarter)
        flips = columns if quarter % 2 else columns + rows if quarter == 2 else 0
        along_u = (grid[..., 0].ravel()[turned[:, -1]] - grid[..., 0].ravel()[turned[:, 0]]).mean()
        turns.append((colour * (-1) ** flips < 0, along_u, -quarter, turned))
    return max(turns, key=lambda turn: turn[:3])[3]


def _colour(grey: Grey, grid: FloatArray) -> float:
    """Return > 0 if the square before the first corner (and so that behind it) is white, < 0 if it is black."""
    levels = _cell_levels(grey, grid)
    even = np.indices(levels.shape).sum(0) % 2 == 0
    return float(np.median(levels[even]) - np.median(levels[~even]))


def _cell_levels(grey: Grey, grid: FloatArray) -> FloatArray:
    """Grey levels in the middles of the (rows - 1, columns - 1) squares between the corners."""
    u, v = np.moveaxis((grid[1:, 1:] + grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:]) / 4, -1, 0)
    rows, columns = np.clip(np.rint([v, u]), 0, np.array(grey.shape)[:, None, None] - 1).astype(int)
    return np.asarray(grey[rows, columns], np.float64)


def _coarse(grey: Grey, grid: FloatArray) -> CornerFits:
    """Refine corners by OpenCV; their sigma is what keeps them from lying evenly."""
    found = np.isfinite(grid[..., 0])
    square = float(np.nanmedian(np.linalg.norm(local_steps(grid), axis=-1)))
    refined = grid.copy()
    refined[found] = _refined(grey, grid[found], int(np.clip(0.35 * square, 2, 5)))
    sigma = roughness(refined)
    usable = found.ravel() & (sigma < ROUGHEST * square)
    nans = np.full(grid.shape[0] * grid.shape[1], np.nan)
    return CornerFits(refined.reshape(-1, 2), np.full_like(nans, sigma), nans, nans, usable)


def roughness(grid: FloatArray) -> float:
    """Return how far a coordinate of a grid's points lies off a smooth grid, one standard deviation, pixels.

    From fourth differences along rows and columns, which perspective and lens hardly reach (their variance is 70
    times that of one coordinate), by their median; `UNKNOWN_SIGMA_PX` where the grid has fewer than 8.
    """
    rough = np.concatenate([np.diff(grid, 4, axis).ravel() for axis in (0, 1)])
    rough = rough[np.isfinite(rough)]
    return float(1.4826 * np.median(np.abs(rough)) / 70**0.5) if len(rough) >= 8 else UNKNOWN_SIGMA_PX


def _refined(grey: Grey, points: FloatArray, half: int) -> FloatArray:
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-3)
    start = np.ascontiguousarray(points[:, None], np.float32)
    return np.asarray(cv2.cornerSubPix(grey, start, (half, half), (-1, -1), criteria), np.float64).reshape(-1, 2)
