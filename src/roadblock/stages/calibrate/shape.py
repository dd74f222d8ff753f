"""Calibrate: the shape of a board that is not quite flat, as a smooth surface over its plane."""

from dataclasses import dataclass

import numpy as np

from roadblock.values.board import Board
from roadblock.values.checks import FloatArray

DEGREE = 4
"""Of the polynomials that a shape is made of; the lowest ones are bow and twist."""

BOW_SHARE = 0.005
"""One sigma of a board's bow over its longer side before anything was seen: 1 mm of 200 mm."""

ROUGHER = 3.0
"""By how much every further degree of its shape is expected to be smaller."""


@dataclass(frozen=True, eq=False)
class Shape:
    """The shapes a board may have: heights over its plane are `basis @ coefficients`.

    Attributes
    ----------
    basis
        (n, k) heights of the board's points for a coefficient of 1: polynomials of degree 2 and more in x and y,
        orthogonal to each other and to any plane, of root mean square 1 over the points.
    sigma_m
        (k,) expected size of the coefficients, metres; they are 0 in the mean.
    """

    basis: FloatArray
    sigma_m: FloatArray


def shape_of(board: Board) -> Shape:
    """Return the shapes that a board's points can show; fewer where the points are few."""
    xy = board.points_m[:, :2]
    x, y = (2 * (xy - xy.mean(0)) / np.ptp(xy, axis=0)).T
    powers = [(degree - j, j) for degree in range(DEGREE + 1) for j in range(degree + 1)]
    basis: list[FloatArray] = []
    degrees: list[int] = []
    for i, j in powers:
        column = x**i * y**j
        size = np.linalg.norm(column)
        for other in 2 * basis:  # twice is enough for rounding
            column = column - other * (other @ column)
        length = np.linalg.norm(column)
        if length > 1e-6 * size:
            basis.append(column / length)
            degrees.append(i + j)
    smooth = np.array(degrees)
    sigma = BOW_SHARE * max(board.size_m) / ROUGHER ** (smooth - 2.0)
    shown = smooth >= 2
    return Shape(np.sqrt(len(xy)) * np.stack(basis, -1)[:, shown], sigma[shown])
