"""What a user says of the board, into a `Board`."""

import difflib
import math
import re
from typing import get_args

import cv2

from roadblock.errors import SettingsError
from roadblock.values.board import Board, BoardKind

EXAMPLES = "chessboard:9x6, charuco:8x6:5x5_100:0.75 or circles:4x11"
MARKERS = ("5X5_100", 0.75)
"""Dictionary and share of a ChArUco board that does not name them."""
MARKER_SHARES = (0.3, 0.95)
LEAST_COUNT = 3
"""OpenCV finds no smaller boards."""


def marker_dictionaries() -> dict[str, int]:
    """Return OpenCV's marker dictionaries, upper-case names without "DICT_"; the values are OpenCV's own numbers."""
    return {name[5:].upper(): value for name, value in vars(cv2.aruco).items() if name.startswith("DICT_")}


def parse_board(text: str, square_m: float, square_sigma_m: float = math.nan) -> Board:
    """Return the board that `text` describes.

    Parameters
    ----------
    text
        "chessboard:COLUMNSxROWS", "charuco:COLUMNSxROWS[:DICTIONARY[:SHARE]]" or "circles:COLUMNSxROWS". Chessboards
        and ChArUco boards count their inner corners (OpenCV's ChArUco boards count squares: one more each way);
        circles are the asymmetric grid, counted in OpenCV's order: dots in a row, rows. DICTIONARY is OpenCV's name
        without "DICT_" (5x5_100 if not given), SHARE the marker's side over the square's (0.75).
    square_m, square_sigma_m
        See `Board`.

    Raises
    ------
    SettingsError
        If the text describes no board that can be found.
    ValueRefusedError
        If the board has too many points, or the square cannot be one of a board.
    """
    kind, *parts = (part.strip() for part in text.strip().lower().split(":"))
    kinds = get_args(BoardKind)
    if kind not in kinds:
        near = difflib.get_close_matches(kind, kinds, 1, 0.5)
        hint = f"did you mean {near[0]}? " if near else ""
        raise SettingsError(f"no board is called {kind[:40]!r}: {hint}Write {EXAMPLES}")
    if not 1 <= len(parts) <= (3 if kind == "charuco" else 1):
        raise SettingsError(f"board must be written as {EXAMPLES}, but got {text[:60]!r}")
    columns, rows = _counts(kind, parts[0])
    if kind != "charuco":
        return Board(kind, columns, rows, square_m, square_sigma_m)  # type: ignore[arg-type]
    dictionary = _dictionary(parts[1] if len(parts) > 1 else MARKERS[0], (columns + 1) * (rows + 1) // 2)
    share = _share(parts[2]) if len(parts) > 2 else MARKERS[1]
    return Board("charuco", columns, rows, square_m, square_sigma_m, dictionary, share)


def _counts(kind: str, text: str) -> tuple[int, int]:
    counts = re.fullmatch(r"(\d{1,4})\s*x\s*(\d{1,4})", text)
    what = "circles in a row, and rows" if kind == "circles" else "inner corners in a row, and rows of them"
    if counts is None:
        raise SettingsError(f"{kind} must be followed by {what}, as {kind}:9x6, but got {text[:40]!r}")
    columns, rows = int(counts[1]), int(counts[2])
    if min(columns, rows) < LEAST_COUNT:
        raise SettingsError(f"{kind} must have {LEAST_COUNT} {what} or more, but got {columns}x{rows}")
    return columns, rows


def _dictionary(text: str, markers: int) -> str:
    name = text.upper().removeprefix("DICT_")
    known = marker_dictionaries()
    if name not in known:
        near = difflib.get_close_matches(name, known, 1, 0.0)
        raise SettingsError(f"no marker dictionary is called {text[:40]!r}: did you mean {near[0].lower()}?")
    held = len(cv2.aruco.getPredefinedDictionary(known[name]).bytesList)
    if held < markers:
        raise SettingsError(f"this board has {markers} markers, but {name.lower()} holds {held}: name a larger one")
    return name


def _share(text: str) -> float:
    low, high = MARKER_SHARES
    try:
        share = float(text)
    except ValueError:
        share = math.nan
    if not low <= share <= high:
        raise SettingsError(
            f"a marker's share of its square's side must be a number from {low:g} to {high:g}, but got {text[:40]!r}"
        )
    return share
