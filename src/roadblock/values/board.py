"""Calibration boards and where they were seen: what goes into a calibration."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray, finite, locked, positive

BoardKind = Literal["chessboard", "charuco", "circles"]

SQUARE_RANGE_M = (0.001, 1.0)
"""What the squares of a board that one can hold and print have; beyond it the unit is wrong."""

MOST_POINTS = 10_000


@dataclass(frozen=True, eq=False)
class Board:
    """A flat board of known points.

    Attributes
    ----------
    kind
        "chessboard" and "charuco": the inner corners of a chessboard, without and with markers; "circles": dots in
        rows, every other row shifted by half a step (OpenCV's asymmetric grid).
    columns, rows
        Inner corners (dots) per row, and rows.
    square_m
        Side of a square, metres; for circles half the distance of neighbours in a row: the step of the grid.
    square_sigma_m
        One standard deviation of that length, metres; NaN where nobody measured it.
    dictionary, marker_share
        ChArUco only: name of OpenCV's marker dictionary without "DICT_", and the marker's side over the square's.

    Raises
    ------
    ValueRefusedError
        If there is no such kind, the counts are below 2 or not whole, or the square cannot be one of a board.
    """

    kind: BoardKind
    columns: int
    rows: int
    square_m: float
    square_sigma_m: float = float("nan")
    dictionary: str = ""
    marker_share: float = float("nan")

    def __post_init__(self) -> None:
        if self.kind not in get_args(BoardKind):
            raise ValueRefusedError(f"board must be one of {', '.join(get_args(BoardKind))}, but got {self.kind!r}")
        counts = finite("columns and rows", (self.columns, self.rows), (2,))
        if (counts < 2).any() or (counts != np.floor(counts)).any() or counts.prod() > MOST_POINTS:
            found = f"{self.columns}x{self.rows}"
            raise ValueRefusedError(f"a board must have 2 to {MOST_POINTS} points in 2 rows or more, but got {found}")
        object.__setattr__(self, "square_m", positive("square_m", self.square_m))
        low, high = SQUARE_RANGE_M
        if not low <= self.square_m <= high:
            raise ValueRefusedError(
                f"a board's squares are {low:g} to {high:g} m wide, but got {self.square_m:g} m: "
                "probably another unit; write it with the number, as 25mm"
            )

    @cached_property
    def points_m(self) -> FloatArray:
        """(columns * rows, 3) points of the flat board in its own frame: x along rows, y down the rows, z = 0, metres.

        Row by row; seen from the front, z points away from the viewer. The first point is the origin.
        """
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        x = 2 * column + row % 2 if self.kind == "circles" else column
        points: FloatArray = locked(self.square_m * np.stack([x, row, np.zeros(len(row))], -1).astype(np.float64))
        return points

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height of the area that its points span, metres."""
        width, height, _ = self.points_m.max(0)
        return float(width), float(height)

    @property
    def looks_alike_turned(self) -> bool:
        """Whether its points cannot tell the board from itself turned by 180 degrees."""
        if self.kind == "chessboard":
            return (self.columns + self.rows) % 2 == 0
        return self.kind == "circles" and self.rows % 2 == 0


@dataclass(frozen=True, eq=False)
class Sighting:
    """The board's points found in one image.

    Attributes
    ----------
    ids
        (n,) int, indices into `Board.points_m`, each at most once.
    points_px
        (n, 2) where they are, pixels.
    sigma_px
        (n,) one standard deviation of each coordinate, pixels, as the fit of that point itself estimates it.
    blur_px
        Median width (sigma) of the blurred edges, pixels; NaN where it was not fitted.

    Raises
    ------
    ValueRefusedError
        If the lengths differ, an id comes twice or is negative, a position is not finite or a sigma not positive.
    """

    ids: NDArray[np.int64]
    points_px: FloatArray
    sigma_px: FloatArray
    blur_px: float = float("nan")

    def __post_init__(self) -> None:
        ids = np.array(self.ids, dtype=np.int64).reshape(-1)
        if len(np.unique(ids)) != len(ids) or (ids < 0).any():
            raise ValueRefusedError(f"ids must be 0 or more, each at most once, but got {ids.tolist()!r:.80}")
        object.__setattr__(self, "ids", locked(ids))
        object.__setattr__(self, "points_px", finite("points_px", self.points_px, (len(ids), 2)))
        object.__setattr__(self, "sigma_px", finite("sigma_px", self.sigma_px, (len(ids),)))
        if (self.sigma_px <= 0).any():
            raise ValueRefusedError(f"sigma_px must be > 0, but got {self.sigma_px.min():g}")


@dataclass(frozen=True, eq=False)
class BoardView:
    """One moment of a calibration recording: the board as each camera saw it, None where it did not."""

    name: str
    left: Sighting | None
    right: Sighting | None
