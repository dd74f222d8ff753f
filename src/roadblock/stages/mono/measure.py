"""Masks in, Regions out: what each of the two methods reads from an outline, and how sure it is.

Both take any mask: an exact one (an oracle run) or one of `find_outlines` (a realistic run).
"""

import math

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.stages.mono.ranging import (
    area_sensitivity,
    contact_sensitivity,
    range_from_area,
    range_from_contact,
)
from roadblock.stages.mono.settings import AUTO, BUILDS, Build, MonoSettings
from roadblock.values.camera import Rectification
from roadblock.values.frame import Image
from roadblock.values.scene import GroundPlane, Region

FOOT_SHARE = 0.15
"""Columns that end within this share of a thing's height over its lowest row may touch the road."""
FOOT_PX = 2.0
"""Of these, the ones that end this close to the lowest tenth are averaged."""
SEEN_FROM = (0.0, math.pi / 2)
"""The two ways a thing is taken to stand: yaw of one seen from the front, and from the side."""


def contact_point(mask: NDArray[np.bool_]) -> tuple[float, float]:
    """Return where an outline meets the road: column and row, pixels.

    The row is the lower border of the outline's lowest part: a mean over columns, so one ragged pixel does not
    decide.

    Parameters
    ----------
    mask
        (height, width), at least one pixel set.

    Raises
    ------
    ValueRefusedError
        If the mask is empty.
    """
    _refuse_empty(mask)
    columns = np.flatnonzero(mask.any(0))
    border = len(mask) - np.argmax(mask[::-1, columns], axis=0) - 0.5
    height = border.max() - np.argmax(mask.any(1))
    low = border >= border.max() - max(2.0, FOOT_SHARE * height)
    columns, border = columns[low], border[low]
    touching = np.abs(border - np.percentile(border, 90)) <= FOOT_PX
    return float(columns[touching].mean()), float(border[touching].mean())


def outline_area(mask: NDArray[np.bool_]) -> tuple[float, float, float]:
    """Return an outline's area with its holes filled (square pixels), its length (pixels) and its middle column.

    Raises
    ------
    ValueRefusedError
        If the mask is empty.
    """
    _refuse_empty(mask)
    filled = np.asarray(scipy.ndimage.binary_fill_holes(mask))
    outlines, _ = cv2.findContours(filled.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    columns = np.flatnonzero(filled.any(0))
    length = sum(cv2.arcLength(outline, True) for outline in outlines)
    return float(filled.sum()), float(max(length, 4.0)), float(columns[[0, -1]].mean())


def guess_kind(
    mask: NDArray[np.bool_], rectification: Rectification, ground: GroundPlane, kind: str = AUTO
) -> tuple[str, float]:
    """Return the type and yaw (0 or pi/2 radians) whose front or side looks most like an outline's box.

    Width and height are compared by their logarithms, in metres at the range of the contact row; where that is
    above the horizon, only their ratio is.

    Parameters
    ----------
    mask
        (height, width).
    rectification, ground
        The camera and the road.
    kind
        A type of `BUILDS` if known: then only the yaw is guessed.

    Raises
    ------
    ValueRefusedError
        If the mask is empty, or there is no such type.
    """
    m_per_px = range_from_contact(*contact_point(mask), rectification, ground) / rectification.f_px
    if kind != AUTO and kind not in BUILDS:
        raise ValueRefusedError(f"kind must be {AUTO} or one of {', '.join(BUILDS)}, but got {kind!r}")
    known = BUILDS if kind == AUTO else {kind: BUILDS[kind]}
    size_px = np.array([np.ptp(np.flatnonzero(mask.any(axis))) + 1 for axis in (0, 1)])

    def unlike(option: tuple[str, float]) -> float:
        build, yaw_rad = known[option[0]], option[1]
        miss = np.log(size_px / (build.length_m if yaw_rad else build.width_m, build.height_m))
        return float(np.ptp(miss) if np.isnan(m_per_px) else np.hypot(*(miss + np.log(m_per_px))))

    return min(((name, yaw_rad) for name in known for yaw_rad in SEEN_FROM), key=unlike)


def region_by_contact(
    mask: NDArray[np.bool_],
    image: Image,
    rectification: Rectification,
    ground: GroundPlane,
    settings: MonoSettings,
) -> Region | None:
    """Measure an outline by its contact row (traditional algorithm 1).

    Returns
    -------
    The region; None where the outline does not end below the horizon within `reach_m`.

    Raises
    ------
    ValueRefusedError
        If the mask is empty.
    """
    point = contact_point(mask)
    z = range_from_contact(*point, rectification, ground)
    if not z <= settings.reach_m:
        return None
    moves = contact_sensitivity(*point, rectification, ground)
    sigma_m = moves.sigma_m(settings.contact_sigma_px, settings.pitch_sigma_rad, settings.height_sigma)
    return _region(mask, image, rectification, z, math.hypot(sigma_m, settings.stance_sigma_m))


def region_by_area(
    mask: NDArray[np.bool_],
    image: Image,
    rectification: Rectification,
    ground: GroundPlane,
    settings: MonoSettings,
    build: Build,
    yaw_rad: float = 0.0,
) -> Region | None:
    """Measure an outline by its area (traditional algorithm 2).

    Returns
    -------
    The region; None where no distance within `reach_m` gives the thing this area.

    Raises
    ------
    ValueRefusedError
        If the mask is empty, or the build impossible (see `range_from_area`).
    """
    area, length, u = outline_area(mask)
    z = range_from_area(area, u, build, rectification, ground, yaw_rad)
    if not z <= settings.reach_m:
        return None
    moves = area_sensitivity(area, u, build, rectification, ground, yaw_rad)
    sigma_m = moves.sigma_m(length * settings.outline_sigma_px, settings.pitch_sigma_rad, build.spread)
    return _region(mask, image, rectification, z, sigma_m)


def _refuse_empty(mask: NDArray[np.bool_]) -> None:
    if not mask.any():
        raise ValueRefusedError("the mask must have at least one pixel, but is empty")


def _region(mask: NDArray[np.bool_], image: Image, r: Rectification, range_m: float, sigma_m: float) -> Region:
    """Write a range as the disparity f * B / Z: the baseline is a change of unit here, no right image was used."""
    rows, columns = np.nonzero(mask)
    d_px = r.f_px * r.baseline_m / range_m
    outlines, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    color = image[rows, columns].mean(0) if image.ndim == 3 else np.full(3, np.nan)
    return Region(
        box_px=(int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1),
        contour_px=np.asarray(max(outlines, key=cv2.contourArea), np.int32).reshape(-1, 2),
        surface_uvd_px=np.stack([columns, rows, np.full(len(rows), d_px)], -1).astype(float),
        sigma_d_px=d_px / range_m * sigma_m,
        color_rgb=color / 257 if image.dtype == np.uint16 else color,
    )
