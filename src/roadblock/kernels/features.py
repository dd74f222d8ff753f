"""Features by OpenCV: corners spread over an image, followed into another by the Lucas-Kanade method."""

from functools import partial
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.values.frame import Gray

Points = NDArray[np.float32]


class Search(NamedTuple):
    """How a feature is followed.

    Attributes
    ----------
    window_px
        Width of the window.
    levels, levels_back
        Of the image pyramid: on the way there, which make up for how bad a guess is, and on the way back.
    steps, settled_px
        The search ends after so many, or with a smaller one.
    returned_px
        There and back again, a feature must end this near to where it started.
    """

    window_px: int
    levels: int
    levels_back: int
    steps: int
    settled_px: float
    returned_px: float


def spread_corners(
    gray: Gray, count: int, block_px: int, least_cell_px: int, border_px: int, contrast: float
) -> Points:
    """Return (n, 2) column and row of the strongest corner of each of about `count` cells that has one.

    Parameters
    ----------
    gray
        The image.
    count
        Of the cells, whose side is `least_cell_px` at least.
    block_px
        Over which corners are judged.
    border_px
        Nearer to the image's edge none is taken.
    contrast
        Least strength of a corner.
    """
    height, width = gray.shape
    cell = max(least_cell_px, round((height * width / count) ** 0.5))
    rows, columns = height // cell, width // cell
    strength = cv2.cornerMinEigenVal(gray, block_px)
    strength[:border_px] = strength[-border_px:] = 0
    strength[:, :border_px] = strength[:, -border_px:] = 0
    blocks = strength[: rows * cell, : columns * cell].reshape(rows, cell, columns, cell)
    cells = blocks.swapaxes(1, 2).reshape(rows, columns, -1)
    row, column = np.nonzero(cells.max(2, initial=0) > contrast)
    best_v, best_u = np.divmod(cells[row, column].argmax(1), cell)
    return np.stack([column * cell + best_u, row * cell + best_v], -1).astype(np.float32)


def follow(here: Gray, there: Gray, points: Points, guess: Points, search: Search) -> tuple[Points, NDArray[np.bool_]]:
    """Return where points (n, 2) of one image are in another, and which of them can be trusted.

    `guess` (n, 2) is where they probably are.
    """
    if not len(points):
        return points, np.zeros(0, bool)
    s = search
    begin, start = (np.array(p, np.float32, order="C").reshape(-1, 1, 2) for p in (points, guess))
    find = partial(
        cv2.calcOpticalFlowPyrLK,
        winSize=(s.window_px, s.window_px),
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, s.steps, s.settled_px),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    found, seen, _ = find(here, there, begin, start, maxLevel=s.levels)
    back, returned, _ = find(there, here, found, begin.copy(), maxLevel=s.levels_back)
    near = np.hypot(*(back[:, 0] - points).T) < s.returned_px
    return np.asarray(found[:, 0], np.float32), np.asarray((seen[:, 0] > 0) & (returned[:, 0] > 0) & near)
