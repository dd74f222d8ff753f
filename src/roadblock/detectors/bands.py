"""The `bands` detector: the paper's own method (sections 2.2 and 2.3). No disparity map, no ground fit."""

from collections.abc import Callable, Sequence
from time import perf_counter

import cv2
import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.config import Settings
from roadblock.kernels.gray import gray8
from roadblock.stages.bands import (
    BandsSettings,
    Ends,
    Targets,
    find_targets,
    horizon_row,
    lies_flat,
    measure_targets,
    merged,
)
from roadblock.stages.bands.segmentation import HALF, Labels
from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import NEAREST_FACE_PERCENT, Detections, FreeSpace, GroundPlane, Region

GAP_PX = 4
"""Pieces of one target are no further apart than this, up or down."""


def bands(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the detector."""

    def detect(pair: RectifiedPair) -> Detections:
        r, chosen = pair.rectification, settings.bands
        horizon_px = horizon_row(r.cy_px, r.f_px, chosen)
        clock = [perf_counter()]
        left, right = (find_targets(gray, horizon_px, chosen) for gray in gray8(pair.left, pair.right))
        clock.append(perf_counter())
        ends = measure_targets(left, right, r, chosen)
        clock.append(perf_counter())
        standing = [n for n, found in enumerate(ends, 1) if counts(found, horizon_px, chosen)]
        regions = [
            to_region(np.isin(left.labels, group), merged([ends[n - 1] for n in group]), pair.left)
            for group in joined(left.labels, ends, standing)
        ]
        free_space = free_columns(left, ends, standing)
        clock.append(perf_counter())
        return Detections(
            tuple(regions),
            known_ground(chosen),
            free_space,
            timings_ms=dict(zip(("segment", "match", "regions"), (1e3 * np.diff(clock)).tolist(), strict=True)),
        )

    return detect


def counts(ends: Ends, horizon_px: float, settings: BandsSettings) -> bool:
    """Return whether a target has enough end points, is within reach, and stands on the road."""
    if len(ends.uvd_px) < 2 * settings.least_segments or not (ends.uvd_px[:, 2] > 0).all():
        return False
    if nearest_m(ends) > settings.reach_m:
        return False
    ground = known_ground(settings)
    if ground is not None:
        height_m = ground.height_of(ends.points_m)
        if height_m.max() < settings.height_m or height_m.min() > settings.overhead_m:
            return False
    return settings.keep_flat or not lies_flat(ends.uvd_px, horizon_px)


def nearest_m(ends: Ends) -> float:
    """Return the forward distance of a target's nearest face, metres."""
    return float(np.percentile(ends.points_m[:, 2], NEAREST_FACE_PERCENT))


def known_ground(settings: BandsSettings) -> GroundPlane | None:
    """Return the road that the settings' camera height and pitch describe; None where no height is given."""
    if settings.camera_height_m is None:
        return None
    pitch = np.radians(settings.pitch_deg)
    return GroundPlane(np.array([0.0, -np.cos(pitch), -np.sin(pitch)]), settings.camera_height_m)


def to_region(mask: NDArray[np.bool_], ends: Ends, image: Image) -> Region:
    """Return a target of the left image as a region; its surface are its end points."""
    rows, columns = np.nonzero(mask)
    u0, v0, u1, v1 = int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1
    patch = mask[v0:v1, u0:u1].astype(np.uint8)
    outlines, _ = cv2.findContours(patch, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(u0, v0))
    color = np.array(cv2.mean(image[v0:v1, u0:u1], patch)[:3]) if image.ndim == 3 else np.full(3, np.nan)
    return Region(
        box_px=(u0, v0, u1, v1),
        contour_px=np.asarray(max(outlines, key=cv2.contourArea), np.int32).reshape(-1, 2),
        surface_uvd_px=ends.uvd_px,
        sigma_d_px=ends.sigma_d_px,
        color_rgb=color / 257 if image.dtype == np.uint16 else color,
    )


def joined(labels: Labels, ends: Sequence[Ends], standing: Sequence[int]) -> list[list[int]]:
    """Group the targets that are pieces of one: above each other or inside each other, and at one disparity.

    The threshold cuts a person's dark trousers from a bright jacket; matching is over, so they may be put together.
    Neighbours side by side stay apart.
    """
    boxes = scipy.ndimage.find_objects(labels)
    groups: list[list[int]] = []
    for n in standing:
        with_n = [
            g for g in groups if any(_are_pieces(boxes[n - 1], boxes[m - 1], ends[n - 1], ends[m - 1]) for m in g)
        ]
        groups = [g for g in groups if g not in with_n] + [sum(with_n, [n])]
    return groups


def _are_pieces(a: tuple[slice, ...], b: tuple[slice, ...], ends_a: Ends, ends_b: Ends) -> bool:
    common = min(a[1].stop, b[1].stop) - max(a[1].start, b[1].start)
    narrower = min(a[1].stop - a[1].start, b[1].stop - b[1].start)
    apart = max(a[0].start, b[0].start) - min(a[0].stop, b[0].stop)
    off_px = float(np.median(ends_a.uvd_px[:, 2]) - np.median(ends_b.uvd_px[:, 2]))
    tolerance_px = 3 * float(np.hypot(ends_a.sigma_d_px, ends_b.sigma_d_px))
    return common > HALF * narrower and apart <= GAP_PX and abs(off_px) < tolerance_px


def free_columns(left: Targets, ends: Sequence[Ends], standing: Sequence[int]) -> FreeSpace:
    """Return how far the road is free, per image column: up to a measured target above nothing but the road's grey.

    NaN where a column holds no measured target, or anything else between it and the image's lower border: paint that
    was told from an obstacle by its matches is no road seen. How far a column of mere road reaches, this method cannot
    tell.
    """
    height, width = left.labels.shape
    taken = (left.labels > 0) | (left.share >= HALF)
    column = np.arange(width)
    lowest = height - 1 - np.argmax(taken[::-1], axis=0)
    range_m = np.full(left.labels.max() + 1, np.nan)
    for number in standing:
        range_m[number] = nearest_m(ends[number - 1])
    return FreeSpace(column.astype(float), np.where(taken.any(axis=0), range_m[left.labels[lowest, column]], np.nan))
