"""Calibrate: how sure a bundle adjustment is of what it found, and whether its residuals are independent.

The information of all views about the parameters they share (the boards' poses eliminated), in the units of the noise
that was measured, gives the covariance. Whether residuals within a view hang together (a bent board, a moving one, a
lens that is not quite the model's) shows in the views' scores: what each view alone pulls at the parameters with,
against what independent noise would let it pull.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from roadblock.geometry.uncertainty import calibration_jacobian, seen_points
from roadblock.stages.calibrate.adjust import (
    LOSS_WIDTH,
    Bundle,
    Mask,
    Problem,
    lengths,
    noise_factors,
    normal_equations,
    residuals,
    weights,
)
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray

WRONG = 6.0
"""A corner so many sigma off is taken as wrong: it tells nothing."""

CHANCE = 0.01
"""Probability of taking independent residuals for dependent ones."""

FULL = 0.95
"""Share of what is known in some direction above which a view is the only one that knows it, and cannot be judged."""

JUDGED_AT_M = 20.0


@dataclass(frozen=True, eq=False)
class Evidence:
    """What views tell about the parameters they share.

    Attributes
    ----------
    each
        (views, c, c) information of each view, its pose eliminated.
    score
        (views, c) pull of each view: 0 in sum.
    total
        (c, c) information of all views and of what was known beforehand.
    tau
        Per camera the effective noise over what its corners were said to have: of one coordinate, and counting what
        the robust loss wastes.
    """

    each: FloatArray
    score: FloatArray
    total: FloatArray
    tau: FloatArray


def evidence(problem: Problem, bundle: Bundle, free: Mask) -> Evidence:
    """Return what the views of an adjusted bundle tell about its `free` shared parameters."""
    errors = residuals(problem, bundle)
    unknowns = int(free.sum()) + 6 * len(bundle.T_left_board)
    factors = noise_factors(problem, errors, unknowns)
    pulls, weight, tau = [], [], []
    for error, r_told, factor, corners in zip(errors, lengths(problem, errors), factors, problem.corners, strict=True):
        r = r_told / factor
        slope, waste = _efficiency(r[r < WRONG], unknowns / max(1, 2 * sum(c.seen.sum() for c in problem.corners)))
        pulls.append(error * weights(r)[..., None] / slope)
        tau.append(factor * waste)
        weight.append(np.where(r < WRONG, 1 / (corners.sigma_px * tau[-1]) ** 2, 0.0))
    view = normal_equations(problem, bundle, pulls, weight, free)
    gain = view.across @ np.linalg.inv(view.poses)
    each = view.shared - gain @ view.across.swapaxes(1, 2)
    score = view.shared_slope - (gain @ view.poses_slope[..., None])[..., 0]
    return Evidence(each, score, each.sum(0) + np.diag(1 / problem.sigma[free] ** 2), np.array(tau))


def _efficiency(r: FloatArray, spent: float) -> tuple[float, float]:
    """Return the mean slope of the robust loss's pull, and sigma of the pull over it, for residuals `r` sigma long.

    An M-estimator's variance is E[psi^2] / E[psi']^2 of the least squares' one. `spent` is the share of the
    residuals' numbers that went into parameters.
    """
    w = weights(r)
    slope = float(np.mean(w - (w * r / LOSS_WIDTH) ** 2))
    return slope, float(np.sqrt(np.mean((w * r) ** 2) / 2 / max(1 - spent, 1e-3)) / slope)


def covariance(information: FloatArray) -> FloatArray:
    """Return the inverse of a positive definite (c, c) matrix, positive definite in spite of rounding."""
    whiten = _whitener(information)
    return np.asarray(whiten.T @ whiten)


def _whitener(information: FloatArray) -> FloatArray:
    """Return (c, c) `W` with `W information W^T = 1`."""
    scale = 1 / np.sqrt(information.diagonal())  # units differ by many powers of ten
    return np.asarray(np.linalg.inv(np.linalg.cholesky(information * np.outer(scale, scale))) * scale)


def inflation(told: Evidence, rig: StereoRig) -> float:
    """Return the factor on standard deviations because residuals within a view hang together; 1 where chance explains.

    Scores are first freed of the part that the fit took from them (each view's leverage), so that independent
    residuals give 1 in the mean. A test over all parameters, sharp because it has many numbers to look at, decides;
    the factor is that of all parameters or that of ranges at 20 m, the larger of the two, for the latter alone is
    known from few numbers.

    Source: Bell & McCaffrey, "Bias reduction in standard errors for linear regression with multi-stage samples" (2002).
    """
    whiten = _whitener(told.total)
    leverage = whiten @ told.each @ whiten.T
    share, axes = np.linalg.eigh((leverage + leverage.swapaxes(1, 2)) / 2)
    share = np.clip(share, 0, FULL)
    white = (told.score @ whiten.T)[..., None]
    freed = (axes @ ((axes.swapaxes(1, 2) @ white) / np.sqrt(1 - share)[..., None]))[..., 0]
    expected = share.sum()
    excess = float((freed**2).sum() / expected)
    freedom = expected**2 / (share**2).sum()
    if excess <= chi2.ppf(1 - CHANCE, freedom) / freedom:
        return 1.0
    points = seen_points(rig, JUDGED_AT_M).reshape(-1, 3)
    slope = calibration_jacobian(rig, points[~np.isnan(points[:, 0])])[:, 2]
    slope = slope[~np.isnan(slope).any(-1)]
    reach = whiten[:, : slope.shape[-1]] @ slope.T
    in_range = (freed @ reach) ** 2
    usual = ((axes.swapaxes(1, 2) @ reach) ** 2 * share[..., None]).sum()
    of_range = float(in_range.sum() / usual) if slope.size else 0.0
    return float(np.sqrt(max(1.0, excess, of_range)))
