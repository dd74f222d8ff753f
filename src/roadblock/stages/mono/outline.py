"""Outlines of what stands on the road, from one image: the road's own colour, and where it ends."""

from dataclasses import dataclass

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.stages.mono.ranging import road_range
from roadblock.stages.mono.settings import MonoSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image
from roadblock.values.scene import FreeSpace, GroundPlane

Mask = NDArray[np.bool_]
SAMPLE_M = (1.2, 8.0)
"""Half width and length of the road in front that shows what the road looks like."""
EDGE_NEAR_M, EDGE_FAR_M = 4.0, 20.0
"""The road's edges are looked for between these."""
LANE_M, HIDDEN_M = 0.2, 1.5
"""Width of the strips the road is cut into for that, and the widest gap (a thing on it) that is bridged."""
ASIDE_M = 0.3
"""What touches the road this close to its edge stands beside it."""
SURE_M = 0.5
"""A thing's lowest part, which is certainly its own and no background."""
PART = 0.15
"""What touches a nearer thing and is smaller than this share of it is a part of it."""
CUT_ROWS = 140
"""Outlines are cut out at this height in pixels, larger ones after shrinking."""


@dataclass(frozen=True, eq=False)
class Looks:
    """What one image shows of the road.

    Attributes
    ----------
    range_m
        (height, width) forward distance of the road at each pixel; NaN on and above the horizon.
    is_road
        (height, width) whether it looks like road.
    """

    range_m: FloatArray
    is_road: Mask


@dataclass(frozen=True, eq=False)
class Runs:
    """Unbroken pieces of image columns that stand on the road: column, and rows from `top` to before `end`."""

    u: NDArray[np.intp]
    top: NDArray[np.intp]
    end: NDArray[np.intp]
    range_m: FloatArray


def look(image: Image, rectification: Rectification, ground: GroundPlane, settings: MonoSettings) -> Looks:
    """Tell road from the rest by the colour of the road in front of the vehicle.

    Where the image is grey, only its brightness speaks.
    """
    width, height = rectification.size_px
    u, v = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    range_m = road_range(np.stack([u, v], -1), rectification, ground)
    aside_m = (u - rectification.cx_px) * range_m / rectification.f_px
    with np.errstate(invalid="ignore"):
        sample = (np.abs(aside_m) < SAMPLE_M[0]) & (range_m < SAMPLE_M[1])
    if not sample.any():
        return Looks(range_m, np.zeros_like(sample))
    lab = _lab(image)
    typical = np.median(lab[sample], axis=0)
    typical = np.median(lab[sample & _is_like(lab, typical, settings)], axis=0)
    return Looks(range_m, _is_like(lab, typical, settings) & np.isfinite(range_m))


def _lab(image: Image) -> NDArray[np.float32]:
    """Return the smoothed image in CIELAB, (height, width, 3); a and b are 0 where it is grey."""
    unit = image.astype(np.float32) / np.iinfo(image.dtype).max
    smooth = cv2.GaussianBlur(unit, (0, 0), 1.0)
    rgb = smooth if smooth.ndim == 3 else np.repeat(smooth[..., None], 3, -1)
    return np.asarray(cv2.cvtColor(rgb, cv2.COLOR_RGB2LAB))


def _is_like(lab: NDArray[np.float32], typical: NDArray[np.float32], settings: MonoSettings) -> Mask:
    low, high = np.array(settings.road_lightness) * typical[0]
    chroma = np.hypot(*np.moveaxis(lab[..., 1:] - typical[1:], -1, 0))
    return np.asarray((chroma < settings.road_chroma) & (lab[..., 0] > low) & (lab[..., 0] < high))


def find_runs(looks: Looks, rectification: Rectification, settings: MonoSettings) -> Runs:
    """Return the pieces of columns that do not look like road, stand on it, and are tall enough to be no paint."""
    other = np.isfinite(looks.range_m) & ~_closed(looks.is_road, (3, 1))
    other = _closed(other, (1, 3)) & np.isfinite(looks.range_m)
    step = np.diff(np.pad(other, ((1, 1), (0, 0))).astype(np.int8), axis=0).T
    u, top = np.nonzero(step == 1)
    _, end = np.nonzero(step == -1)
    height_px = len(other)
    range_m = looks.range_m[end - 1, u]
    with np.errstate(invalid="ignore"):
        tall = (end - top) * range_m > settings.standing_m * rectification.f_px
    # The road must be seen below it: what leaves the image at the bottom has no contact row.
    rests = (end < height_px) & (range_m < settings.reach_m)
    right_m, left_m = road_edges(looks, rectification)
    aside_m = (u - rectification.cx_px) * range_m / rectification.f_px
    on_road = (aside_m > left_m + ASIDE_M) & (aside_m < right_m - ASIDE_M)
    keep = tall & rests & on_road
    return Runs(u[keep], top[keep], end[keep], range_m[keep])


def _closed(mask: Mask, size_px: tuple[int, int]) -> Mask:
    """Return a mask with its gaps narrower than (width, height) closed; beyond the image nothing is known."""
    return np.asarray(cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_CLOSE, np.ones(size_px[::-1], np.uint8)) > 0)


def road_edges(looks: Looks, rectification: Rectification) -> tuple[float, float]:
    """Return how far the road reaches to the right and (negative) to the left of the left camera, metres.

    Strips along a straight road are road where half of their pixels look like it; gaps as wide as a thing on the
    road are bridged. Both 0 where no road is seen.
    """
    u = np.arange(looks.range_m.shape[1])
    with np.errstate(invalid="ignore"):
        seen = (looks.range_m > EDGE_NEAR_M) & (looks.range_m < EDGE_FAR_M)
    rows, columns = np.nonzero(seen)
    aside_m = (u[columns] - rectification.cx_px) * looks.range_m[rows, columns] / rectification.f_px
    strip = np.floor(aside_m / LANE_M).astype(int)
    if not len(strip):
        return 0.0, 0.0
    first = strip.min()
    total = np.bincount(strip - first)
    road = np.bincount(strip - first, weights=looks.is_road[rows, columns])
    lanes = np.flatnonzero(road > 0.5 * np.maximum(total, 1)) + first
    return _reach(lanes[lanes >= 0]) * LANE_M, -_reach(-1 - lanes[lanes < 0][::-1]) * LANE_M


def _reach(strips: NDArray[np.intp]) -> int:
    """Return how many strips the road reaches, counted from the middle, bridging gaps."""
    reach = 0
    for strip in strips.tolist():
        if (strip - reach) * LANE_M > HIDDEN_M:
            break
        reach = strip + 1
    return reach


def find_outlines(
    image: Image, looks: Looks, runs: Runs, rectification: Rectification, settings: MonoSettings
) -> tuple[Mask, ...]:
    """Cut out each thing that stands on the road.

    Parameters
    ----------
    image
        Rectified left image.
    looks, runs
        What of it is road, and what stands on it.
    rectification
        The camera.
    settings
        Largest height.

    Returns
    -------
    (height, width) masks, the nearest first. Where a thing rises into a background of its own colours, its mask
    may hold some of that.
    """
    masks: list[Mask] = []
    taken = np.zeros_like(looks.is_road)
    for group in _groups(runs, rectification):
        own = sum(int(taken[runs.end[i] - 1, runs.u[i]]) for i in group)
        if own > 0.5 * len(group):
            continue
        mask = _cut_out(image, looks, runs, group, rectification, settings) & ~taken
        whole = _whole(mask, masks)
        if whole is not None:
            masks[whole] |= mask
        elif mask.any():
            masks.append(mask)
        taken |= scipy.ndimage.binary_dilation(mask, iterations=3)
    return tuple(masks)


def _whole(mask: Mask, nearer: list[Mask]) -> int | None:
    """Return the nearer thing that a mask is a small part of (a hand beside a sleeve), or None."""
    grown = scipy.ndimage.binary_dilation(mask, iterations=5)
    touching = (i for i, other in enumerate(nearer) if (grown & other).any() and mask.sum() < PART * other.sum())
    return next(touching, None)


def _groups(runs: Runs, r: Rectification) -> list[NDArray[np.intp]]:
    """Return the runs of each thing, nearest first: neighbouring columns whose contact is about as far."""
    open_ends: list[list[int]] = []
    for i in np.lexsort((runs.range_m, runs.u)):
        z = runs.range_m[i]
        for group in reversed(open_ends):
            gap_px = runs.u[i] - runs.u[group[-1]]
            near_m = min(runs.range_m[j] for j in group)
            alike = min(abs(z - runs.range_m[group[-1]]), abs(z - near_m)) < 0.08 * z + 0.1
            if 0 < gap_px <= max(3, 0.25 * r.f_px / z) and alike:
                group.append(int(i))
                break
        else:
            open_ends.append([int(i)])
    wide = [np.array(g) for g in open_ends if len(g) * np.median(runs.range_m[g]) > 0.1 * r.f_px]
    return sorted(wide, key=lambda g: float(np.percentile(runs.range_m[g], 20)))


def _cut_out(
    image: Image, looks: Looks, runs: Runs, group: NDArray[np.intp], r: Rectification, settings: MonoSettings
) -> Mask:
    """Return a thing's mask: GrabCut, started from its lowest part, within reach of its contact."""
    z = float(np.percentile(runs.range_m[group], 20))
    scale = r.f_px / z
    u0, u1 = int(runs.u[group].min()), int(runs.u[group].max()) + 1
    end = int(runs.end[group].max())
    aside = round(max(0.3 * scale, 0.2 * (u1 - u0)))
    top = max(0, end - round(settings.tallest_m * scale))
    a0, a1 = max(0, u0 - 2 * aside), min(r.size_px[0], u1 + 2 * aside)
    b1 = min(r.size_px[1], end + max(4, round(0.1 * scale)))
    state = np.full((b1, a1), cv2.GC_BGD, np.uint8)
    state[top:end, max(0, u0 - aside) : u1 + aside] = cv2.GC_PR_BGD
    beside = np.flatnonzero((runs.u > u0 - aside) & (runs.u < u1 + aside) & (runs.end <= end))
    for i in beside:
        state[max(top, runs.top[i]) : runs.end[i], runs.u[i]] = cv2.GC_PR_FGD
    state[looks.is_road[:b1, :a1]] = cv2.GC_BGD
    for i in group:
        state[max(runs.top[i], runs.end[i] - round(SURE_M * scale)) : runs.end[i], runs.u[i]] = cv2.GC_FGD
    window = (slice(top, b1), slice(a0, a1))
    mask = np.zeros_like(looks.is_road)
    mask[window] = _grab_cut(image[window], state[window])
    labels, _ = scipy.ndimage.label(mask)
    own = np.unique(labels[runs.end[group] - 1, runs.u[group]])
    return np.isin(labels, own[own > 0])


def _grab_cut(image: Image, state: NDArray[np.uint8]) -> Mask:
    """Run GrabCut on a window, shrunk where it is tall. Returns the foreground."""
    eight = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image
    rgb = eight if eight.ndim == 3 else np.repeat(eight[..., None], 3, -1)
    shrink = min(1.0, CUT_ROWS / len(state))
    size = (max(2, round(state.shape[1] * shrink)), max(2, round(state.shape[0] * shrink)))
    small = cv2.resize(np.ascontiguousarray(rgb), size, interpolation=cv2.INTER_AREA)
    labels = np.asarray(cv2.resize(np.ascontiguousarray(state), size, interpolation=cv2.INTER_NEAREST), np.uint8)
    if not ((labels & 1 == 1).any() and (labels & 1 == 0).any()):
        return np.asarray(state & 1 == 1)
    cv2.setRNGSeed(0)
    cv2.grabCut(small, labels, (0, 0, 1, 1), np.zeros((1, 65)), np.zeros((1, 65)), 3, cv2.GC_INIT_WITH_MASK)
    share = cv2.resize((labels & 1).astype(np.float32), state.shape[::-1], interpolation=cv2.INTER_LINEAR)
    return np.asarray(share > 0.5)


def find_free_space(looks: Looks, runs: Runs, settings: MonoSettings) -> FreeSpace:
    """Return per column how far the road is free, from contact rows alone.

    Up to the nearest thing that stands in the column on road that is seen; without one, up to where the road was
    last seen without a break of more than paint, at most `reach_m`. NaN where no road is seen at the bottom.
    """
    height, width = looks.is_road.shape
    range_m = np.full(width, np.nan)
    nearest = np.full(width, -1)
    np.maximum.at(nearest, runs.u, runs.end)
    for u in range(width):
        rows = np.flatnonzero(looks.is_road[:, u])[::-1]
        rows = rows[rows >= nearest[u]]
        if len(rows) and rows[0] >= height - 3:
            z = looks.range_m[rows, u]
            breaks = np.flatnonzero(np.diff(z) > 0.3 + 0.1 * z[:-1])
            last = breaks[0] if len(breaks) else len(rows) - 1
            range_m[u] = min(z[last], settings.reach_m)
    return FreeSpace(np.arange(width, dtype=float), range_m)
