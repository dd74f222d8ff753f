"""Calibrate: a bundle fitted to the views that agree. Adjust, leave out the views that disagree, adjust again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadblock.stages.calibrate.adjust import (
    RAYLEIGH_MEDIAN,
    Bundle,
    Mask,
    Problem,
    adjust,
    lengths,
    noise_factors,
    residuals,
    view_costs,
    weights,
)
from roadblock.stages.calibrate.covariance import WRONG
from roadblock.values.checks import FloatArray

ROUNDS = 3
"""How often views may be left out before what is left is taken as it is."""

MOST_LEFT_OUT = 1 / 3
"""Share of the views that may be left out: if more disagree, it is not the views that are wrong."""

OUTLIER_FACTOR = 3.0
"""A view is left out if its residuals are so many times those of the others, ..."""

OUTLIER_SPREADS = 3.5
"""... and so many robust standard deviations of the views' logarithms above them."""

WRONG_SHARE = 1 / 3
"""It is also left out if so many of its corners are wrong."""

POSE_STEPS = 12
"""Enough to tell the better one of two poses of a board."""


@dataclass(frozen=True, eq=False)
class Fit:
    """A bundle adjusted to the views that agree.

    Attributes
    ----------
    bundle
        With poses of all views, NaN where there is none; those of views that were not used are the best ones for what
        the others say.
    used
        (views,) which ones it was adjusted to.
    residual_px
        (cameras, views, n, 2) measured minus predicted, pixels; NaN where unseen or without a pose.
    weight
        (cameras, views, n) robust weight 0..1; NaN where unseen or without a pose.
    sigma_px
        (cameras,) robust standard deviation of one coordinate of the used views' residuals, pixels.
    view_sigma_px, view_ratio
        (cameras, views) the same of each view, and over what its camera's corners say; NaN where unseen.
    """

    bundle: Bundle
    used: Mask
    residual_px: FloatArray
    weight: FloatArray
    sigma_px: FloatArray
    view_sigma_px: FloatArray
    view_ratio: FloatArray

    @property
    def used_bundle(self) -> Bundle:
        """The bundle with the used views' poses alone."""
        return replace(self.bundle, T_left_board=self.bundle.T_left_board[self.used])


def fit_views(problem: Problem, bundle: Bundle, free: Mask, usable: Mask) -> Fit:
    """Adjust a bundle to the usable views, leaving out those that disagree; pose all others by what was found.

    Parameters
    ----------
    problem
        What was seen.
    bundle
        Where to start; poses of usable views are finite, those of views without a pose NaN.
    free
        (c,) which shared parameters are unknown.
    usable
        (views,) which views may be used.
    """
    used, rounds = usable.copy(), 0
    while True:
        bundle = _refined(problem, bundle, used, free)
        part, errors = problem.of(used), residuals(problem.of(used), _part(bundle, used))
        factors = noise_factors(part, errors, int(free.sum()) + 6 * int(used.sum()))
        ratio, wrong_share = _judge(problem, bundle, factors)
        out = outlier_views(ratio, wrong_share, used, int(usable.sum()))
        if not out.any() or rounds == ROUNDS:
            break
        used, rounds = used & ~out, rounds + 1
    rest = ~used & ~np.isnan(bundle.T_left_board[:, 0, 0])
    if rest.any():
        bundle = _refined(problem, bundle, rest, np.zeros_like(free), factors)
    return _fit(problem, bundle, free, used, factors)


def _fit(problem: Problem, bundle: Bundle, free: Mask, used: Mask, factors: FloatArray) -> Fit:
    errors = residuals(problem, bundle)
    r = lengths(problem, errors)
    posed = ~np.isnan(bundle.T_left_board[:, 0, 0])
    weight = [np.where(posed[:, None], weights(of / factor), np.nan) for of, factor in zip(r, factors, strict=True)]
    numbers = 2 * sum(int(corners.seen[used].sum()) for corners in problem.corners)
    spent = (int(free.sum()) + 6 * int(used.sum())) / numbers
    spare = np.sqrt(max(1 - spent, 1 / numbers))
    return Fit(
        bundle,
        used,
        np.stack(errors),
        np.stack(weight),
        np.array([_sigma_px(error[used]) / spare for error in errors]),
        np.array([[_sigma_px(view) for view in error] for error in errors]),
        _judge(problem, bundle, factors)[0],
    )


def outlier_views(ratio: FloatArray, wrong_share: FloatArray, used: Mask, usable: int) -> Mask:
    """Return which of the used views disagree with the others by more than chance explains.

    Parameters
    ----------
    ratio
        (cameras, views) each view's robust sigma over that of its camera; NaN where unseen.
    wrong_share
        (cameras, views) share of corners more than `covariance.WRONG` sigma off; NaN where unseen.
    used
        (views,) which ones were fitted.
    usable
        Of how many.

    Returns
    -------
    (views,), the worst first until `MOST_LEFT_OUT` of the usable ones are left out.
    """
    logs = np.log(np.maximum(ratio[:, used], 1e-12))
    middle = np.nanmedian(logs)
    fence = np.exp(middle + OUTLIER_SPREADS * 1.4826 * np.nanmedian(np.abs(logs - middle)))
    worst = np.nan_to_num(ratio).max(0)
    wrong = np.nan_to_num(wrong_share).max(0) > WRONG_SHARE
    out = used & ((worst > max(OUTLIER_FACTOR * float(np.exp(middle)), float(fence))) | wrong)
    room = int(MOST_LEFT_OUT * usable) - (usable - int(used.sum()))
    out[np.argsort(np.where(out, -worst, np.inf), kind="stable")[max(room, 0) :]] = False
    return np.asarray(out)


def best_poses(problem: Problem, bundle: Bundle, usable: Mask, others: Sequence[FloatArray]) -> Bundle:
    """Return the bundle with each usable view's best pose: its own or one of the `others`, these refined first.

    The others are (views, 4, 4), NaN where there is none.
    """
    part, fixed = problem.of(usable), np.zeros(len(problem.sigma), bool)
    own = _part(bundle, usable)
    factors = noise_factors(part, residuals(part, own), 0)
    trials = [own]
    for poses in others:
        start = np.where(np.isnan(poses), bundle.T_left_board, poses)[usable]
        trials.append(adjust(part, replace(bundle, T_left_board=start), fixed, factors, POSE_STEPS))
    costs = [view_costs(lengths(part, residuals(part, trial)), factors) for trial in trials]
    best = np.argmin(costs, 0)
    poses = bundle.T_left_board.copy()
    poses[usable] = np.stack([trial.T_left_board for trial in trials])[best, np.arange(len(best))]
    return replace(bundle, T_left_board=poses)


def _part(bundle: Bundle, views: Mask) -> Bundle:
    return replace(bundle, T_left_board=bundle.T_left_board[views])


def _refined(problem: Problem, bundle: Bundle, views: Mask, free: Mask, factors: FloatArray | None = None) -> Bundle:
    """Return the bundle adjusted to some views, the poses of all others as they were."""
    part = adjust(problem.of(views), _part(bundle, views), free, factors)
    poses = bundle.T_left_board.copy()
    poses[views] = part.T_left_board
    return replace(part, T_left_board=poses)


def _judge(problem: Problem, bundle: Bundle, factors: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (cameras, views) robust sigma of residuals over the camera's, and the share of wrong corners, or NaN."""
    ratio = np.full((len(factors), len(bundle.T_left_board)), np.nan)
    share = ratio.copy()
    posed = ~np.isnan(bundle.T_left_board[:, 0, 0])
    for side, r_told in enumerate(lengths(problem, residuals(problem, bundle))):
        for view, r in enumerate(r_told / factors[side]):
            known = r[~np.isnan(r)]
            if known.size and posed[view]:
                ratio[side, view], share[side, view] = np.median(known) / RAYLEIGH_MEDIAN, np.mean(known > WRONG)
    return ratio, share


def _sigma_px(errors_px: FloatArray) -> float:
    """Return the robust standard deviation of one coordinate; NaN of nothing."""
    length = np.hypot(errors_px[..., 0], errors_px[..., 1])
    known = length[~np.isnan(length)]
    return float(np.median(known) / RAYLEIGH_MEDIAN) if known.size else float("nan")
