"""Measure each region's disparity over all of its pixels, and say how sure that is."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.refine import refine_regions
from roadblock.kernels.reference.refine import FIGURES, Model
from roadblock.stages.refine.settings import RefineSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import NEAREST_FACE_PERCENT, Refinement, Region

Gray = NDArray[np.uint8]

SETTLED_PX, FARTHEST_PX, LEAST_USED, LEAST_PIXELS, LEAST_INNER = 0.05, 3.0, 0.3, 24, 0.1
"""A fit counts whose last step was no larger, which ended no farther from the coarse disparity, and that explains this
share of its pixels, of which there are at least so many and this share inside the outline: what is two pixels wide
is seen mixed with what is behind it everywhere."""

CONTRADICTS = 4.0
"""The nearest face is no more than so many of the detector's standard deviations from where that saw it."""

MEAN_SPREAD, MEAN_UNSEEN = 1.35, 0.6
NEAREST_SPREAD, NEAREST_UNSEEN = 2.0, 0.9
FLOOR_PX, NEAREST_M = 0.006, 0.02
"""What the blocks' scatter and the relief that the fit could not resolve do to the mean and to the nearest face; and
what is left: of both, pixels; and of the nearest face, of which a detector misses the lowest part, metres."""


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
    left, right = to_gray8(pair.left), to_gray8(pair.right)
    sizes = [len(region.surface_uvd_px) for region in regions]
    figures = refine_regions(
        left,
        right,
        np.concatenate([[0], np.cumsum(sizes)]),
        np.concatenate([region.surface_uvd_px for region in regions]),
        np.array([cell_size(region.surface_uvd_px) for region in regions]),
        surface_model(left, right, pair.rectification),
    )
    return tuple(
        replace(region, refined=judged(row, region, pair.rectification.f_px * pair.rectification.baseline_m))
        for region, row in zip(regions, figures, strict=True)
    )


def to_gray8(image: Image) -> Gray:
    """Return an image as 8-bit grey."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    return np.ascontiguousarray(gray if gray.dtype == np.uint8 else (gray // 256).astype(np.uint8))


def cell_size(uvd: FloatArray) -> tuple[int, int]:
    """Return width and height of the cells that a surface consists of: the smallest step between two of them."""
    steps = np.abs(np.diff(uvd[:, :2], axis=0))
    width, height = (int(np.min(s[s > 0], initial=np.inf)) if (s > 0).any() else 0 for s in steps.T)
    return width or height or 1, height or width or 1


def surface_model(left: Gray, right: Gray, r: Rectification) -> Model:
    """Return what the kernel must know of these images and cameras."""
    spreads = [float(np.std(image[::8, ::8])) for image in (left, right)]
    gain = spreads[0] / spreads[1] if min(spreads) > 1 else 1.0
    return Model(r.f_px, r.f_px * r.baseline_m, noise_level(left), float(np.clip(gain, 0.7, 1.4)))


def noise_level(image: Gray) -> float:
    """Return the standard deviation of one grey level's noise, from the image itself.

    A 3x3 difference that neither slopes nor edges along the axes leave anything of (Immerkaer 1996), in blocks of 8x8;
    the quietest tenth of the blocks that are neither dark nor bright is taken as free of texture. At least 0.4:
    rounding alone makes 0.29.
    """
    small = image[: len(image) // 8 * 8, : image.shape[1] // 8 * 8].astype(np.float32)
    difference = cv2.filter2D(small, -1, np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32) / 6)
    blocks = difference.reshape(len(small) // 8, 8, -1, 8).std((1, 3))
    levels = small.reshape(len(small) // 8, 8, -1, 8).mean((1, 3))
    usable = blocks[(levels > 16) & (levels < 240)]
    return max(0.4, float(np.percentile(usable, 10))) if len(usable) else 1.0


def judged(figures: FloatArray, region: Region, f_baseline: float) -> Refinement | None:
    """Return what a fit is worth; None where it is no better than what the detector knew, or contradicts it."""
    f = dict(zip(FIGURES, figures.tolist(), strict=True))
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
    sigma_mean, sigma_nearest = sigmas(f, f_baseline)
    coarse_px = float(np.percentile(region.surface_uvd_px[:, 2], 100 - NEAREST_FACE_PERCENT))
    if sigma_nearest >= region.sigma_d_px or abs(f["nearest_px"] - coarse_px) > CONTRADICTS * region.sigma_d_px:
        return None
    return Refinement(f["mean_px"], sigma_mean, f["nearest_px"], sigma_nearest, f["moved_px"], f["residual"], f["used"])


def sigmas(f: dict[str, float], f_baseline: float) -> tuple[float, float]:
    """Return one standard deviation of mean_px and of nearest_px, pixels.

    The factors were chosen once, on exact masks of simulated streets (docs/refinement.md).
    """
    spread, unseen = max(f["scatter_px"], f["noise_px"]), f["unseen_px"]
    mean = np.sqrt((MEAN_SPREAD * spread) ** 2 + (MEAN_UNSEEN * unseen) ** 2 + FLOOR_PX**2)
    edge = NEAREST_M * f["mean_px"] ** 2 / f_baseline
    nearest = np.sqrt((NEAREST_SPREAD * spread) ** 2 + (NEAREST_UNSEEN * unseen) ** 2 + FLOOR_PX**2 + edge**2)
    return float(mean), float(nearest)
