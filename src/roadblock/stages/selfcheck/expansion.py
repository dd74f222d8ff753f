"""What image expansion says of the vergence: disparities of standing things must grow as their images do.

A thing at Z1 and, after driving on, at Z2 is seen Z1 / Z2 times larger, and its disparity should be so too. A turned
camera adds the same to both disparities, and breaks the rule. This sees what ranges suffer from, whatever its cause,
and needs no trust in the lenses; vertical disparities do (see `epipolar`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import rotation_from_rotvec, rotvec_from_rotation
from roadblock.stages.selfcheck.epipolar import CELLS, LEAST_CELLS, biweight, blunting, cell_of, jackknife, turn_slopes
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray

SIGMA_PX = np.array([0.15, 0.2, 0.2, 0.15])
"""Noise of a first disparity, and a second column, row and disparity; only their ratios matter."""
ROUNDS, SOFT_ROUNDS = 12, 7
"""Steps; the first ones only soften outliers, the rest cut them off."""
CUT = 3.0
"""Outliers fit this many times worse than the median."""
MISFIT_DIMENSIONS = 3
"""Four measurements of a feature, less its own unknown."""
LEAST_SCALE = 0.3
"""Of the fit's own noise: nothing is so good that its neighbours become outliers."""
PRIOR = np.diag(1 / np.array([0.5, 0.5, 0.5, 50.0, 50.0, 50.0, 0.05]) ** 2)
"""Weak: turns (rad), shifts (m), yaw (rad) of any drive; only keeps the solution where the images say nothing."""
LEAST_SHARE = 0.6
"""Of the features must agree on one motion ..."""
LARGEST_SCALE = 6.0
"""... and their misfits must not be this many times what noise makes."""
FAR_PX = 2.0
"""Disparities below it say little of the shift."""


class Stretch(NamedTuple):
    """What one stretch of driving says.

    Attributes
    ----------
    yaw_rad, sigma_rad
        Of the right camera against the rig.
    turned_rad
        How far the vehicle turned.
    moved_m
        (3,) how far everything came nearer: the shift of points in the left rectified frame.
    share
        Of the features that fit.
    """

    yaw_rad: float
    sigma_rad: float
    turned_rad: float
    moved_m: FloatArray
    share: float


class _Unknowns(NamedTuple):
    """The motion of points in the left rectified frame, the yaw, and the true first disparities (n,)."""

    R: FloatArray
    t: FloatArray
    yaw: float
    d: FloatArray


def fit_stretch(first: FloatArray, second: FloatArray, rectification: Rectification) -> Stretch | None:
    """Find the drive's motion and the yaw that explain how features moved, robustly.

    Parameters
    ----------
    first, second
        (n, 3) u, v, d of the same features before and after, pixels, free of pitch and roll.
    rectification
        The twin cameras.

    Returns
    -------
    The stretch, or None where too few features agree on one motion.

    Notes
    -----
    Unknown are the motion (6), the yaw, and each feature's true disparity; the latter are eliminated feature by feature
    (variable projection), so that noise of disparities is weighed rightly against that of positions.
    """
    now = _start(first, second, rectification)
    for step in range(ROUNDS):
        residual, slopes = _reduced(now, first, second, rectification)
        misfit = np.sqrt((residual**2).mean(1))
        scale = max(float(np.median(misfit)), LEAST_SCALE)
        ratio = misfit / (CUT * scale)
        weight = 1 / (1 + (CUT * ratio) ** 2) ** 2 if step < SOFT_ROUNDS else biweight(ratio)
        parts, gradient = _cell_sums(slopes, weight, residual, cell_of(second[:, :2], rectification))
        if step < ROUNDS - 1:
            change = np.linalg.solve(parts.sum(0) + PRIOR, gradient.sum(0))
            now = _moved(now, change, first, second, rectification)
    share, areas = float((weight > 0).mean()), (parts.trace(axis1=1, axis2=2) > 0).sum()
    if share < LEAST_SHARE or scale > LARGEST_SCALE or areas < LEAST_CELLS:
        return None
    by_areas = jackknife(parts, gradient, PRIOR) * blunting(ratio, MISFIT_DIMENSIONS) ** 2
    held = np.linalg.inv(parts.sum(0) + PRIOR)
    by_prior = held @ PRIOR @ held  # where the images say nothing, leaving out an area changes nothing
    sigma = float(np.sqrt(by_areas[6, 6] + by_prior[6, 6]))
    turned = float(np.linalg.norm(rotvec_from_rotation(now.R)))
    return Stretch(now.yaw, sigma, turned, now.t, share)


def _start(first: FloatArray, second: FloatArray, r: Rectification) -> _Unknowns:
    near = (first[:, 2] > FAR_PX) & (second[:, 2] > FAR_PX)
    came = 1 / second[near, 2] - 1 / first[near, 2]
    t = np.array([0.0, 0.0, r.f_px * r.baseline_m * np.median(came) if near.any() else 0.0])
    return _Unknowns(np.eye(3), t, 0.0, first[:, 2])


def _yaw_slope(uvd: FloatArray, r: Rectification) -> FloatArray:
    """Return by how much a yaw of the right camera makes disparities larger, pixels per radian."""
    right = (uvd[:, :2] - np.stack([uvd[:, 2], 0 * uvd[:, 2]], -1) - (r.cx_px, r.cy_px)) / r.f_px
    return np.asarray(-r.f_px * turn_slopes(right)[0][:, 1])


def _full(
    now: _Unknowns, first: FloatArray, second: FloatArray, r: Rectification
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return residuals (n, 4) of d1, u2, v2, d2 and their slopes by the 7 unknowns and by each feature's own one."""
    f, n = r.f_px, len(first)
    ray = np.c_[(first[:, :2] - (r.cx_px, r.cy_px)) / f, np.ones(n)] @ now.R.T
    near = now.d / (f * r.baseline_m)  # inverse distance
    p = ray + near[:, None] * now.t
    z = np.where(np.abs(p[:, 2]) > 1e-6, p[:, 2], 1e-6)

    def seen(dp: FloatArray) -> FloatArray:  # change of u2, v2, d2 when p changes by dp
        change = np.c_[f * dp[:, :2], 0 * z] - np.c_[f * p[:, :2], now.d] * (dp[:, 2] / z)[:, None]
        return np.asarray(change / z[:, None])

    by_yaw = np.stack([_yaw_slope(first, r), _yaw_slope(second, r)], -1)
    expected = np.c_[f * p[:, :2] / z[:, None] + (r.cx_px, r.cy_px), now.d / z + now.yaw * by_yaw[:, 1]]
    residual = np.c_[first[:, 2] - now.d - now.yaw * by_yaw[:, 0], second - expected]
    slopes = np.zeros((n, 4, 7))
    for axis, e in enumerate(np.eye(3)):
        slopes[:, 1:, axis] = seen(np.cross(e, ray))
        slopes[:, 1:, 3 + axis] = seen(near[:, None] * e)
    slopes[:, 0, 6], slopes[:, 3, 6] = by_yaw.T
    own = np.c_[np.ones(n), seen(np.broadcast_to(now.t / (f * r.baseline_m), (n, 3)))]
    own[:, 3] += 1 / z
    return residual / SIGMA_PX, slopes / SIGMA_PX[:, None], own / SIGMA_PX


def _reduced(now: _Unknowns, first: FloatArray, second: FloatArray, r: Rectification) -> tuple[FloatArray, FloatArray]:
    """Return residuals (n, 4) and slopes (n, 4, 7) with each feature's own unknown projected out."""
    residual, slopes, own = _full(now, first, second, r)
    along = own / np.linalg.norm(own, axis=1)[:, None]
    residual = residual - along * (along * residual).sum(1)[:, None]
    return residual, slopes - along[:, :, None] * np.einsum("na,nap->np", along, slopes)[:, None]


def _moved(now: _Unknowns, change: FloatArray, first: FloatArray, second: FloatArray, r: Rectification) -> _Unknowns:
    """Return the unknowns after a step, each feature's own one following it."""
    residual, slopes, own = _full(now, first, second, r)
    left_over = residual - slopes @ change
    d = now.d + (own * left_over).sum(1) / (own * own).sum(1)
    return _Unknowns(rotation_from_rotvec(change[:3]) @ now.R, now.t + change[3:6], now.yaw + float(change[6]), d)


def _cell_sums(
    slopes: FloatArray, weight: FloatArray, residual: FloatArray, cells: NDArray[np.intp]
) -> tuple[FloatArray, FloatArray]:
    """Return each area's part of the normal matrix (areas, 7, 7) and of the gradient (areas, 7)."""
    weighted = slopes * weight[:, None, None]
    parts, gradient = np.zeros((CELLS[0] * CELLS[1], 7, 7)), np.zeros((CELLS[0] * CELLS[1], 7))
    np.add.at(parts, cells, weighted.swapaxes(1, 2) @ slopes)
    np.add.at(gradient, cells, np.einsum("nap,na->np", weighted, residual))
    return parts, gradient


def combined(stretches: Sequence[Stretch]) -> tuple[float, float]:
    """Return the yaw of several stretches and its sigma, radians.

    The sigma grows by how much the stretches differ more than their own sigmas say.
    """
    yaw, sigma = np.array([(s.yaw_rad, s.sigma_rad) for s in stretches]).T
    weight = 1 / sigma**2
    mean = float((weight * yaw).sum() / weight.sum())
    excess = float((weight * (yaw - mean) ** 2).sum() / (len(yaw) - 1))
    return mean, float(np.sqrt(max(excess, 1.0) / weight.sum()))
