"""What vertical disparities say of the right camera's turn, and how the turn moves its image."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray

ROUNDS = 6
"""Of reweighting."""
CUT = 4.685
"""Residuals beyond this many standard deviations do not count (Tukey's biweight at 95 % efficiency)."""
CELLS = (6, 8)
"""Rows and columns of image areas. What goes wrong in one area is taken to go wrong there in every pair."""
LEAST_CELLS = 12
"""Features in fewer areas tell no sigma."""
MATCH_BIAS_PX = 0.015
"""What the matching of features may be off by on average; measured on images shifted by known fractions."""


class Turn(NamedTuple):
    """A turn of the right camera: rotation vector (3,), its covariance (3, 3), and the features that fit it."""

    turn_rad: FloatArray
    cov_rad2: FloatArray
    used: int


UNKNOWN = Turn(np.full(3, np.nan), np.full((3, 3), np.nan), 0)


def normalized(points: FloatArray, rectification: Rectification) -> FloatArray:
    """Return pixels (n, 2) as slopes x/z, y/z of their rays (eq. 4)."""
    r = rectification
    return np.asarray((points - (r.cx_px, r.cy_px)) / r.f_px)


def cell_of(points: FloatArray, rectification: Rectification) -> NDArray[np.intp]:
    """Return in which of the image's areas (see `CELLS`) pixels (n, 2) are."""
    rows, columns = CELLS
    width, height = rectification.size_px
    row = np.clip(points[:, 1] * rows / height, 0, rows - 1).astype(int)
    column = np.clip(points[:, 0] * columns / width, 0, columns - 1).astype(int)
    return np.asarray(row * columns + column, np.intp)


def turn_slopes(xy_right: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return how a small turn `w` (rad) of the right camera moves its image: du/f and dv/f by w, both (n, 3).

    A point `p` of the untilted frame is at `exp(-[w]) p = p - w x p` in the turned one; with `p = (x, y, 1)`:

    du / f = x y wx - (1 + x^2) wy + y wz,   dv / f = (1 + y^2) wx - x y wy - x wz.
    """
    x, y = xy_right.T
    return np.stack([x * y, -(1 + x * x), y], -1), np.stack([1 + y * y, -x * y, -x], -1)


def jackknife(normal: FloatArray, gradient: FloatArray, prior: FloatArray) -> FloatArray:
    """Return the covariance of a weighted least-squares solution, by leaving out one area at a time.

    Parameters
    ----------
    normal
        (areas, p, p) each area's part of the normal matrix; 0 for areas that are empty.
    gradient
        (areas, p) each area's part of the gradient, zero in sum at the solution.
    prior
        (p, p) what else is in the normal matrix.

    Notes
    -----
    Residuals of one area are never taken for independent, neither within a pair nor from pair to pair: the same points
    bring the same error again and again.
    """
    held = normal.trace(axis1=1, axis2=2) > 0
    without = np.linalg.solve(normal.sum(0) + prior - normal[held], -gradient[held][..., None])[..., 0]
    count = int(held.sum())
    spread = without - without.mean(0)
    return np.asarray((count - 1) / count * spread.T @ spread)


def fit_turn(points: FloatArray, dv_px: FloatArray, rectification: Rectification) -> Turn:
    """Find the turn of the right camera that explains vertical disparities, robustly.

    Parameters
    ----------
    points
        (n, 2) features in the right image, of one or many pairs, pixels.
    dv_px
        (n,) their rows less those in the left image.
    rectification
        The twin cameras.

    Returns
    -------
    Pitch and roll are what they seem; the yaw is one only if the lenses are exactly known: a principal point off by
    `f * yaw` looks the same. All NaN where features cover too little of the image.
    """
    cells = cell_of(points, rectification)
    A = rectification.f_px * turn_slopes(normalized(points, rectification))[1]
    turn: FloatArray = np.zeros(3)
    weight = ratio = residual = dv_px - np.median(dv_px)
    for _ in range(ROUNDS):
        scale = 1.4826 * np.median(np.abs(residual)) + 1e-9
        ratio = np.abs(residual) / (CUT * scale)
        weight = biweight(ratio)
        normal = A.T @ (A * weight[:, None])
        turn = np.asarray(np.linalg.lstsq(normal, A.T @ (weight * dv_px), rcond=1e-12)[0], float)
        residual = dv_px - A @ turn
    parts, gradient = cell_sums(A, weight, residual, cells)
    if (parts.trace(axis1=1, axis2=2) > 0).sum() < LEAST_CELLS:
        return UNKNOWN
    bias = np.eye(3) * (MATCH_BIAS_PX / rectification.f_px) ** 2
    cov = jackknife(parts, gradient, np.eye(3) * 1e-6) * blunting(ratio, 1) ** 2
    return Turn(turn, cov + bias, int((weight > 0).sum()))


def biweight(ratio: FloatArray) -> FloatArray:
    """Return Tukey's weights of residuals given as shares of the cut."""
    return np.asarray(np.maximum(1 - ratio**2, 0) ** 2)


def blunting(ratio: FloatArray, dimensions: int) -> float:
    """Return by how much more the solution moves with a residual than its weight says, residuals having `dimensions`.

    A residual that grows loses weight; held weights, as in the jackknife, do not know that.
    """
    inside = ratio[ratio < 1]
    loss = 4 / dimensions * inside**2 * (1 - inside**2)
    weight = biweight(inside).sum()
    return float(weight / max(weight - loss.sum(), 0.1 * weight))


def cell_sums(
    A: FloatArray, weight: FloatArray, residual: FloatArray, cells: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return each area's part of the normal matrix (areas, p, p) and of the gradient (areas, p) of rows A (n, p)."""
    count, p = CELLS[0] * CELLS[1], A.shape[1]
    weighted = A * weight[:, None]
    products = (weighted[:, :, None] * A[:, None]).reshape(len(A), -1)
    columns = np.c_[products, weighted * residual[:, None]].T
    sums = np.stack([np.bincount(cells, column, count) for column in columns], -1).astype(float)
    return sums[:, : p * p].reshape(count, p, p), sums[:, p * p :]
