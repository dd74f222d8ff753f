"""Measure each region's disparity over all of its pixels, and say how sure that is."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields

import numpy as np

from roadblock.kernels.compiled.refine import refine_regions, survey
from roadblock.kernels.reference.refine import FIGURES, Model
from roadblock.stages.refine.fine import refine_finely
from roadblock.stages.refine.settings import RefineSettings
from roadblock.stages.refine.views import quick_views, sources
from roadblock.values.checks import FloatArray, unchecked
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Refinement, Region

SETTLED_PX, FARTHEST_PX, LEAST_USED, LEAST_PIXELS, LEAST_INNER = 0.05, 3.0, 0.3, 24, 0.1
"""A fit counts whose last step was no larger, which ended no farther from the coarse disparity, and that explains this
share of its pixels, of which there are at least so many and this share inside the outline: what is two pixels wide
is seen mixed with what is behind it everywhere."""

CONTRADICTS = 2.5
"""The nearest face is no more than so many of the detector's standard deviations from where that saw it."""

MEAN_SPREAD, MEAN_UNSEEN = 0.9, 0.45
NEAREST_SPREAD, NEAREST_UNSEEN = 1.0, 1.0
FLOOR_PX, NEAREST_M = 0.006, 0.02
"""What the blocks' scatter and the relief that the fit could not resolve do to the mean, and those of the nearest part
to the nearest face; and what is left: of both, pixels; and of the nearest face, of which a detector misses the lowest
part, metres."""

OWN_LOOKS, MISFIT, DOUBT = 0.05, 5.0, 0.4
"""Where less than this share of the energy is surely the thing's own, or the two images differ by more than so many
times the noise, the fit may be that of the background around it, or of what hides it: then it is unsure by so much of
how far it moved from what the detector saw, or of that one's standard deviation."""

FIT = tuple(field.name for field in fields(Refinement))


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
        raw, down_px = sources(pair), np.zeros(len(regions))
        model = Model(*numbers, *survey(raw.left, raw.right))
        figures = refine_regions(*quick_views(raw, first, uvd, r.size_px), first, uvd, model)
    fits = judged(figures, np.array([region.sigma_d_px for region in regions]), down_px, model)
    return tuple(
        region if fit is None else unchecked(Region, **(vars(region) | {"refined": fit}))
        for region, fit in zip(regions, fits, strict=True)
    )


def judged(
    figures: FloatArray, coarse_px: FloatArray, down_px: FloatArray, model: Model
) -> Iterator[Refinement | None]:
    """Yield what each fit is worth; None where it is no better than what the detector knew, or contradicts it.

    Parameters
    ----------
    figures
        (n, len(FIGURES)) of the fits; NaN where there is none.
    coarse_px
        (n,) standard deviations of the detector's disparities, pixels.
    down_px
        (n,) by how much lower the right image lies, pixels.
    model
        See `Model`.
    """
    f = dict(zip(FIGURES, figures.T, strict=True))
    sigma_mean, sigma_nearest = sigmas(f, coarse_px, model)
    counts = (f["step_px"] <= SETTLED_PX) & (np.abs(f["moved_px"]) <= FARTHEST_PX) & (f["used"] >= LEAST_USED)
    counts &= (f["pixels"] >= LEAST_PIXELS) & (f["inner"] >= LEAST_INNER) & (sigma_nearest < coarse_px)
    counts &= (np.minimum(f["mean_px"], f["nearest_px"]) > 0) & (sigma_mean > 0)
    counts &= np.abs(f["nearest_px"] - f["coarse_px"]) <= CONTRADICTS * coarse_px
    fits = (f["mean_px"], sigma_mean, f["nearest_px"], sigma_nearest, f["moved_px"], f["residual"], f["used"], down_px)
    for is_better, fit in zip(counts.tolist(), np.stack(fits, 1).tolist(), strict=True):
        yield unchecked(Refinement, **dict(zip(FIT, fit, strict=True))) if is_better else None


def sigmas(f: Mapping[str, FloatArray], coarse_px: FloatArray, model: Model) -> tuple[FloatArray, FloatArray]:
    """Return one standard deviation of mean_px and of nearest_px, (n,) each, pixels.

    The factors were chosen once, on simulated streets (docs/refinement.md).
    """
    with np.errstate(divide="ignore"):
        misfit = 1 - (MISFIT * model.noise / f["residual"]) ** 2
    doubt = np.maximum(np.maximum(1 - f["core"] / OWN_LOOKS, misfit), 0.0)
    all2 = FLOOR_PX**2 + doubt * (DOUBT * np.maximum(np.abs(f["moved_px"]), coarse_px)) ** 2
    edge2 = (NEAREST_M * f["mean_px"] ** 2 / model.f_baseline) ** 2
    mean2 = (MEAN_SPREAD * np.maximum(f["scatter_px"], f["noise_px"])) ** 2 + (MEAN_UNSEEN * f["unseen_px"]) ** 2
    nearest2 = (NEAREST_SPREAD * f["front_px"]) ** 2 + (NEAREST_UNSEEN * f["front_unseen_px"]) ** 2 + edge2
    return np.sqrt(mean2 + all2), np.sqrt(nearest2 + all2)
