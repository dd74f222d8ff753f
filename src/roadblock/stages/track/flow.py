"""Velocities of obstacles from the features on them: what an outline that comes and goes cannot fake."""

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.stereo import image_jacobian, triangulate
from roadblock.stages.track.kalman import Optics
from roadblock.values.checks import FloatArray
from roadblock.values.motion import Flow

BEFORE_M, BEHIND_M = 0.7, 3.0
"""A feature inside a box belongs to the obstacle if it is no nearer and no further than this of its nearest face."""
BEHIND_SHARE = 0.1
"""Or no further than this share of the range."""
CAUCHY = 3.0
"""Residuals of this many sigmas count half."""
ROUNDS = 4
LEAST = 2.0
"""Features, as they count, that say a velocity."""
LEAST_SHARE = 0.5
"""And how many of those on the obstacle."""
FLOOR_MPS = 0.15
"""Standard deviation that no number of features goes below."""


def velocities(
    flow: Flow, dt_s: float, boxes: FloatArray, range_m: FloatArray, long_m: FloatArray, optics: Optics
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Return what features say about the velocities over ground of obstacles, by robust least squares.

    Parameters
    ----------
    flow
        The features.
    dt_s
        Time between both frames.
    boxes, range_m
        (n, 4) and (n,) where the obstacles are.
    optics
        The cameras.

    Returns
    -------
    (n, 2) along the vehicle's x and y, m/s; (n, 2, 2) covariance; (n,) whether there were features enough.
    """
    car = triangulate(optics.rectification, flow.uvd_px)
    u, v = flow.uvd_px[:, :2].T
    z = car[:, 2]
    inside = (u >= boxes[:, :1]) & (u < boxes[:, 2:3]) & (v >= boxes[:, 1:2]) & (v < boxes[:, 3:])
    behind_m = np.maximum(np.maximum(BEHIND_M, BEHIND_SHARE * range_m), long_m)[:, None]
    inside &= (z > range_m[:, None] - BEFORE_M) & (z < range_m[:, None] + behind_m)
    # Halfway between where it is and would be if it stood: over a whole step, disparities are far from linear.
    halfway = triangulate(optics.rectification, flow.uvd_px - flow.off_px / 2)
    used = inside.any(0) & np.isfinite(halfway[:, 2])
    n, inside = len(boxes), inside[:, used]
    # Each feature's part of the normal equations, for two numbers.
    J = dt_s * image_jacobian(optics.rectification, halfway[used]) @ optics.T_car_vehicle[:3, :2]
    W, off = flow.information_px2[used], flow.off_px[used]
    JW = J.swapaxes(1, 2) @ W
    A, b = (JW @ J).reshape(-1, 4), (JW @ off[..., None])[..., 0]
    c = np.einsum("ki,kij,kj->k", off, W, off)
    trust = inside.astype(float)
    for _ in range(ROUNDS):
        normal = (trust @ A).reshape(n, 2, 2) + 1e-6 * np.eye(2)
        v_mps = np.linalg.solve(normal, (trust @ b)[..., None])[..., 0]
        squared = c - 2 * v_mps @ b.T + (v_mps[:, :, None] * v_mps[:, None, :]).reshape(n, 4) @ A.T
        trust = inside / (1 + np.maximum(squared, 0) / CAUCHY**2)
    counted = trust.sum(1)
    cov = np.linalg.inv(normal) + FLOOR_MPS**2 * np.eye(2)
    return v_mps, cov, (counted >= LEAST) & (counted >= LEAST_SHARE * inside.sum(1))
