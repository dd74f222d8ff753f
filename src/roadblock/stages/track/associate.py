"""Which measurement belongs to which track: globally cheapest assignment within a gate."""

import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.geometry.boxes import shared_px2
from roadblock.kernels.reference.track import FAR
from roadblock.values.checks import FloatArray


def assign(cost: FloatArray) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return which track (rows) gets which measurement (columns).

    Parameters
    ----------
    cost
        (n, m); `FAR` and more cannot be.
    """
    rows, columns = scipy.optimize.linear_sum_assignment(cost)  # scipy loads it when it is called first
    fit = cost[rows, columns] < FAR
    return rows[fit], columns[fit]


def covered(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Return (n, m) how much of each box (n, 4) lies in each of the others (m, 4); (u0, v0, u1, v1) each."""
    own = np.maximum((boxes[:, 2:] - boxes[:, :2]).prod(1), 1.0)
    return np.asarray(shared_px2(boxes, others) / own[:, None])
