"""Which measurement belongs to which track: globally cheapest assignment within a gate."""

import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.values.checks import FloatArray

LOOKS = 10.0
"""What a box of e times the width, or of e times the height, costs: as three sigmas."""
FAR = 1e6
"""Cost of what cannot be."""


def distances(
    expected: FloatArray, S: FloatArray, measured: FloatArray, noise_px2: FloatArray, gate: float
) -> tuple[FloatArray, FloatArray]:
    """Return (n, m) squared Mahalanobis distances of n tracks to m measurements and the log of the volumes.

    Parameters
    ----------
    expected, S
        (n, 3) u, v, d of the tracks and their covariance (n, 3, 3) without that of the measurement.
    measured, noise_px2
        (m, 3) u, v, d and their covariance (m, 3, 3).
    gate
        What is further is infinity.
    """
    squared = np.full((len(expected), len(measured)), np.inf)
    volume = np.zeros_like(squared)
    off = measured[None] - expected[:, None]
    alone = S[:, [0, 1, 2], [0, 1, 2]][:, None] + noise_px2[:, [0, 1, 2], [0, 1, 2]][None]
    # No number alone may be further off than all three together.
    i, j = np.nonzero((off * off <= gate * alone).all(2))
    both = S[i] + noise_px2[j]
    found = np.einsum("ni,ni->n", off[i, j], np.linalg.solve(both, off[i, j][..., None])[..., 0])
    squared[i, j] = np.where(found <= gate, found, np.inf)
    volume[i, j] = np.log(np.linalg.det(both))
    return squared, volume


def assign(squared: FloatArray, volume: FloatArray, gate: float) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which track (rows) gets which measurement (columns).

    A track that knows little would take everything near: the volume it may be in counts as well, which makes the costs
    log-likelihoods.

    Parameters
    ----------
    squared, volume
        (n, m) squared distances, and the log of the volumes.
    gate
        What is further does not fit.
    """
    fits = squared <= gate
    rows, columns = scipy.optimize.linear_sum_assignment(np.where(fits, squared + volume, FAR))
    fit = fits[rows, columns]
    return rows[fit], columns[fit]


def covered(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Return (n, m) how much of each box (n, 4) lies in each of the others (m, 4); (u0, v0, u1, v1) each."""
    low = np.maximum(boxes[:, None, :2], others[None, :, :2])
    high = np.minimum(boxes[:, None, 2:], others[None, :, 2:])
    shared = np.maximum(high - low, 0).prod(2)
    own = np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(1), 1.0)
    return np.asarray(shared / own[:, None])
