"""The images once more, for offline work: from the raw ones by quintic B-splines, with rows that may be off."""

from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates, spline_filter

from roadblock.kernels.compiled.refine import refine_regions, survey
from roadblock.kernels.reference.refine import FIGURES, Model
from roadblock.stages.refine.views import Box, Maps, painted, sources, windows
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Gray, RectifiedPair

ORDER: Final = 5
REACH_PX = 12
"""Of the splines, and how far around they need the raw image."""

DOWN_PX, DOWN_SIGMA_PX = 0.25, 0.1
"""The right image is tried so far up and down; and how far calibrated rows usually are off (standard deviation)."""

FINELY = {"most_blocks": 4096, "many_pixels": 1 << 30, "rounds": 15}
"""A region is cut into so many blocks, all of its rows count, and there is time for what is deep to settle."""

MOVED, RESIDUAL, USED, PIXELS, COARSE = map(FIGURES.index, ("moved_px", "residual", "used", "pixels", "coarse_px"))


def refine_finely(
    pair: RectifiedPair, first: NDArray[np.int64], uvd: FloatArray, numbers: tuple[float, float]
) -> tuple[FloatArray, FloatArray, Model]:
    """Refine regions on images of their own.

    Parameters
    ----------
    pair
        With its raw images, if it has any: else the rectified ones are taken for raw.
    first, uvd
        See `kernels.reference.refine.refine_regions`.
    numbers
        Focal length, and focal length times baseline (px m).

    Returns
    -------
    (n, len(FIGURES)) figures; (n,) how much lower the right image is than the rig says, pixels: where each region's
    residual is least, held near 0; and the model.
    """
    raw, size_px = sources(pair), pair.rectification.size_px
    model = Model(*numbers, *survey(raw.left, raw.right))._replace(**FINELY)
    ours, theirs = windows(first, uvd, size_px)
    left = painted(ours, size_px, partial(finely, raw.left, raw.maps_left, 0.0))
    rights = [
        painted(theirs, size_px, partial(finely, raw.right, raw.maps_right, down_px))
        for down_px in (-DOWN_PX, 0.0, DOWN_PX)
    ]
    begun = refine_regions(left, rights[1], first, uvd, model)
    moved = uvd.copy()
    moved[:, 2] += np.repeat(np.nan_to_num(begun[:, MOVED]), np.diff(first))
    lower, level, higher = (refine_regions(left, right, first, moved, model) for right in rights)
    down = np.array([lowest(each) for each in np.stack([lower, level, higher], 1)])
    t = (down / DOWN_PX)[:, None]
    # A parabola through the three: with the rows, disparities change smoothly.
    bent = level + t * (higher - lower) / 2 + t**2 * ((lower + higher) / 2 - level)
    figures = np.where(np.isfinite(bent), bent, level)
    figures[:, MOVED] += begun[:, MOVED]
    figures[:, COARSE] = begun[:, COARSE]
    return figures, down, model


def lowest(figures: FloatArray) -> float:
    """Return where a parabola through the residuals of three tries (3, len(FIGURES)) is least; 0 without residuals."""
    misfit = figures[:, RESIDUAL] ** 2
    if not (np.isfinite(misfit).all() and misfit.min() > 0):
        return 0.0
    many = figures[1, USED] * figures[1, PIXELS] / 2 / misfit.min()
    slope = many * (misfit[2] - misfit[0]) / (2 * DOWN_PX)
    bend = many * (misfit[0] + misfit[2] - 2 * misfit[1]) / DOWN_PX**2
    return float(np.clip(-slope / (max(bend, 0.0) + DOWN_SIGMA_PX**-2), -DOWN_PX, DOWN_PX))


def finely(raw: Gray, maps: Maps | None, down_px: float, box: Box) -> Gray:
    """Return a part of a rectified image, from `down_px` lower."""
    v, u = np.mgrid[box].astype(float)
    return spline(raw, *raw_place(maps, u, v + down_px))


def raw_place(maps: Maps | None, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return columns and rows of the raw image for places of the rectified one."""
    if maps is None:
        return u, v
    at_u, at_v = (map_coordinates(m, (v, u), output=float, order=1, mode="nearest") for m in maps)
    return at_u, at_v


def spline(raw: Gray, u: FloatArray, v: FloatArray) -> Gray:
    """Return an image's grey levels between its pixels, by a quintic B-spline; 0 outside of it."""
    inside = (u >= 0) & (v >= 0) & (u <= raw.shape[1] - 1) & (v <= raw.shape[0] - 1)
    if not inside.any():
        return np.zeros(u.shape, np.uint8)
    u0, v0 = (max(int(at[inside].min()) - REACH_PX, 0) for at in (u, v))
    part = raw[v0 : int(v[inside].max()) + REACH_PX + 1, u0 : int(u[inside].max()) + REACH_PX + 1]
    levels = map_coordinates(spline_filter(part, ORDER), (v - v0, u - u0), order=ORDER, prefilter=False)
    return np.where(inside, np.clip(np.rint(levels), 0, 255), 0).astype(np.uint8)
