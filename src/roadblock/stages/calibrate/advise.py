"""What pictures show that do not show the board: one sentence of advice."""

from collections import Counter
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.stages.calibrate.board import MARKERS, marker_dictionaries
from roadblock.stages.calibrate.circles import find_circles
from roadblock.stages.calibrate.detect import find_board, find_charuco, shrunk, to_grey
from roadblock.values.board import Board

Grey = NDArray[np.uint8]

MOST_IMAGES = 4
"""So many pictures, spread over all, are looked at."""
FAMILIES = ("4X4", "5X5", "6X6", "7X7")
FAMILY_SIZES = (50, 100, 250, 1000)
OTHER_DICTIONARIES = ("APRILTAG_36H11", "ARUCO_ORIGINAL")
FEWEST_MARKERS = 4
USUAL_CIRCLES = ((4, 11), (3, 9), (4, 9), (5, 13), (3, 5), (4, 5), (4, 7), (5, 7), (5, 9), (7, 5))
MOST_COUNT = 20


def explain_missing(images: Sequence[NDArray[np.uint8]], board: Board) -> str:
    """Say what images show in which nobody found the board.

    Parameters
    ----------
    images
        Grey or RGB pictures as `find_board` takes them; up to `MOST_IMAGES` of them are looked at.
    board
        What was looked for.

    Returns
    -------
    One sentence that says what was seen and what to write instead, or "" if nothing known was seen.

    Raises
    ------
    ValueRefusedError
        If an image has another shape or type, or no pixels.
    """
    some = np.unique(np.linspace(0, max(0, len(images) - 1), MOST_IMAGES).astype(int))[: len(images)]
    looks = [shrunk(to_grey(images[i])) for i in some]
    # Dots may look like a chessboard's corners, but hardly the other way round.
    grids = (_circles, _chessboard) if board.kind == "circles" else (_chessboard, _circles)
    for explain in (_changed, _markers, *grids):
        sentence = explain(looks, board)
        if sentence:
            return sentence
    return ""


def _changed(looks: Sequence[Grey], board: Board) -> str:
    """Mirrored and inverted pictures of the board itself: other boards than ChArUco are found in them, too."""
    for image in looks if board.kind == "charuco" else ():
        if find_board(np.ascontiguousarray(image[:, ::-1]), board) is not None:
            return (
                "these images are mirrored: the board is found once they are flipped; "
                "turn mirroring off in the camera, or flip the images"
            )
        if find_board(np.asarray(255 - image, np.uint8), board) is not None:
            return "these images are negatives: the board is found once black and white are exchanged; exchange them"
    return ""


def _markers(looks: Sequence[Grey], board: Board) -> str:
    """Markers of another dictionary, or in another number of squares, than the board's."""
    best: tuple[int, str, int, Grey | None] = (FEWEST_MARKERS - 1, "", 0, None)
    for family in (*FAMILIES, *OTHER_DICTIONARIES):
        whole = f"{family}_{FAMILY_SIZES[-1]}" if family in FAMILIES else family
        detector = cv2.aruco.ArucoDetector(_dictionary(whole))
        for image in looks:
            ids = detector.detectMarkers(image)[1]
            if ids is not None and len(ids) > best[0]:
                best = len(ids), family, int(np.max(ids)) + 1, image
    _, family, markers, showing = best
    if showing is None:
        return ""
    name = _name(family, markers, board)
    size = _charuco_size(showing, name, markers, board)
    if (name, size) == (board.dictionary, f"{board.columns}x{board.rows}"):
        return ""
    return (
        f"these images show markers of {name.lower()} on a ChArUco board, not {_words(board)}: "
        f"use --board charuco:{size}:{name.lower()}"
    )


def _name(family: str, markers: int, board: Board) -> str:
    """Return the board's own dictionary if the markers are of it, else the smallest of the family that holds them."""
    if family not in FAMILIES:
        return family
    names = {f"{family}_{n}": n for n in FAMILY_SIZES if n >= markers}
    return board.dictionary if board.dictionary in names else next(iter(names))


def _charuco_size(image: Grey, name: str, markers: int, board: Board) -> str:
    """Return columns and rows of inner corners for which most corners fit to the markers, the smallest such board."""
    counts = range(3, MOST_COUNT + 1)
    fitting = [(c, r) for c in counts for r in counts if (c + 1) * (r + 1) // 2 == markers]
    share = board.marker_share if board.kind == "charuco" else MARKERS[1]
    best, text = (0, 0), "COLUMNSxROWS"
    for c, r in dict.fromkeys([(board.columns, board.rows), *fitting, *_near(board)]):
        if (c + 1) * (r + 1) // 2 <= len(_dictionary(name).bytesList):
            trial = Board("charuco", c, r, board.square_m, dictionary=name, marker_share=share)
            grid = find_charuco(image, trial)
            score = (0 if grid is None else int(np.isfinite(grid[..., 0]).sum()), -c * r)
            if score > best:
                best, text = score, f"{c}x{r}"
    return text


def _dictionary(name: str) -> "cv2.aruco.Dictionary":
    return cv2.aruco.getPredefinedDictionary(marker_dictionaries()[name])


def _chessboard(looks: Sequence[Grey], board: Board) -> str:
    """Tell a chessboard of another size: OpenCV grows the smallest one as far as it goes."""
    flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_LARGER
    sizes: Counter[tuple[int, int]] = Counter()
    for image in looks:
        found, _, meta = cv2.findChessboardCornersSBWithMeta(image, (3, 3), flags)
        size = (max(meta.shape), min(meta.shape)) if found else (3, 3)
        if size > (3, 3) and find_board(image, Board("chessboard", size[0], size[1], board.square_m)) is not None:
            sizes[size] += 1
    own = (max(board.columns, board.rows), min(board.columns, board.rows))
    for (columns, rows), _ in sizes.most_common(1):
        if (columns, rows) != own or board.kind == "circles":
            return (
                f"these images show a chessboard of {columns}x{rows} inner corners, not {_words(board)}: "
                f"use --board chessboard:{columns}x{rows}"
            )
    return ""


def _circles(looks: Sequence[Grey], board: Board) -> str:
    """Tell an asymmetric grid of circles of another size."""
    for columns, rows in dict.fromkeys([*USUAL_CIRCLES, *_near(board)]):
        trial = Board("circles", columns, rows, board.square_m)
        if any(find_circles(image, trial) is not None for image in looks):
            return (
                f"these images show {columns} circles in each of {rows} rows, not {_words(board)}: "
                f"use --board circles:{columns}x{rows}"
            )
    return ""


def _near(board: Board) -> list[tuple[int, int]]:
    """Sizes that are easily mistaken for the board's: transposed, and one more or less each way."""
    c, r = board.columns, board.rows
    sizes = [(a + i, b + j) for a, b in ((c, r), (r, c)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return [size for size in sizes if min(size) >= 3 and size != (c, r)]


def _words(board: Board) -> str:
    extra = f" with markers of {board.dictionary.lower()}" if board.kind == "charuco" else ""
    return f"a {board.kind} of {board.columns}x{board.rows}{extra}"
