"""Measure each region's disparity over all of its pixels, and say how sure that is."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadblock.kernels.compiled.refine import refine_regions, survey
from roadblock.kernels.gray import gray8
from roadblock.kernels.reference.refine import FIGURES, Model
from roadblock.stages.refine.fine import refine_finely
from roadblock.stages.refine.settings import RefineSettings
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Refinement, Region

SETTLED_PX, FARTHEST_PX, LEAST_USED, LEAST_PIXELS, LEAST_INNER = 0.05, 3.0, 0.3, 24, 0.1
"""A fit counts whose last step was no larger, which ended no farther from the coarse disparity, and that explains this
share of its pixels, of which there are at least so many and this share inside the outline: what is two pixels wide
is seen mixed with what is behind it everywhere."""

CONTRADICTS = 2.5
"""The nearest face is no more than so many of the detector's standard deviations from where that saw it."""

MEAN_SPREAD, MEAN_UNSEEN = 0.9, 0.45
NEAREST_SPREAD, NEAREST_UNSEEN = 1.0, 0.75
FLOOR_PX, NEAREST_M = 0.006, 0.03
"""What the blocks' scatter and the relief that the fit could not resolve do to the mean and to the nearest face; and
what is left: of both, pixels; and of the nearest face, of which a detector misses the lowest part, metres."""

OWN_LOOKS, MISFIT, DOUBT = 0.05, 5.0, 0.4
"""Where less than this share of the energy is surely the thing's own, or the two images differ by more than so many
times the noise, the fit may be that of the background around it, or of what hides it: then it is unsure by so much of
how far it moved from what the detector saw, or of that one's standard deviation."""


def refine(pair: RectifiedPair, regions: Sequence[Region], settings: RefineSettings) -> tuple[Region, ...]:
    """Refine every region by least squares over all of its pixels.

    Parameters
    ----------
    pair
        The images, rectified.
    regions
        From a detector that matches: their surfaces are cells of one size.
    settings
        Which level.

    Returns
    -------
    The same regions in the same order, with `refined` where the fit converged and is surer than the detector was. Where
    it did not (no texture, too few pixels, not the same thing in both images) they are as they came.
    """
    if settings.level == "off" or not regions:
        return tuple(regions)
    surfaces, r = [region.surface_uvd_px for region in regions], pair.rectification
    first, uvd, numbers = np.cumsum([0, *map(len, surfaces)]), np.concatenate(surfaces), (r.f_px, r.f_px * r.baseline_m)
    if settings.level == "shape":
        figures, down_px, model = refine_finely(pair, first, uvd, numbers)
    else:
        left, right = gray8(pair.left, pair.right)
        model, down_px = Model(*numbers, *survey(left, right)), np.zeros(len(regions))
        figures = refine_regions(left, right, first, uvd, model)
    return tuple(
        replace(region, refined=judged(row, down, region, model))
        for region, row, down in zip(regions, figures.tolist(), down_px.tolist(), strict=True)
    )


def judged(figures: Sequence[float], down_px: float, region: Region, model: Model) -> Refinement | None:
    """Return what a fit is worth; None where it is no better than what the detector knew, or contradicts it."""
    f = dict(zip(FIGURES, figures, strict=True))
    converged = (
        f["step_px"] <= SETTLED_PX
        and abs(f["moved_px"]) <= FARTHEST_PX
        and f["used"] >= LEAST_USED
        and f["pixels"] >= LEAST_PIXELS
        and f["inner"] >= LEAST_INNER
        and min(f["mean_px"], f["nearest_px"]) > 0
    )
    if not converged:
        return None
    sigma_mean, sigma_nearest = sigmas(f, model, region.sigma_d_px)
    if sigma_nearest >= region.sigma_d_px or abs(f["nearest_px"] - f["coarse_px"]) > CONTRADICTS * region.sigma_d_px:
        return None
    shown = (f["moved_px"], f["residual"], f["used"], down_px)
    return Refinement(f["mean_px"], sigma_mean, f["nearest_px"], sigma_nearest, *shown)


def sigmas(f: dict[str, float], model: Model, coarse_px: float) -> tuple[float, float]:
    """Return one standard deviation of mean_px and of nearest_px, pixels.

    The factors were chosen once, on exact masks of simulated streets (docs/refinement.md).
    """
    spread, unseen = max(f["scatter_px"], f["noise_px"]), f["unseen_px"]
    doubt = max(1 - f["core"] / OWN_LOOKS, 1 - (MISFIT * model.noise / f["residual"]) ** 2, 0.0)
    unsure = math.sqrt(doubt) * DOUBT * max(abs(f["moved_px"]), coarse_px)
    mean = math.hypot(MEAN_SPREAD * spread, MEAN_UNSEEN * unseen, FLOOR_PX, unsure)
    edge = NEAREST_M * f["mean_px"] ** 2 / model.f_baseline
    return mean, math.hypot(NEAREST_SPREAD * spread, NEAREST_UNSEEN * unseen, FLOOR_PX, unsure, edge)
