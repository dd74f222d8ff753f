"""Section 2.2's homonymous points of each target, and section 2.3's triangulation of them (eq. 8)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.geometry.stereo import triangulate
from roadblock.stages.bands.matching import band_interval_px, match_segments, project_band
from roadblock.stages.bands.segmentation import HALF, NORMAL_MAD, Labels, Share, Targets
from roadblock.stages.bands.settings import BandsSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray

LEAST_SIGMA_PX = 0.05
"""No target's disparity is stated to be better known than this: ends that all err alike do not spread."""

STRAY_PX = 2.0
"""Ends this close to their target's median disparity are never called stray."""


@dataclass(frozen=True, eq=False)
class Ends:
    """The matched end points of one target.

    Attributes
    ----------
    uvd_px
        (2k, 3) column and row in the left image, and disparity: left and right end of each of k line segments, from
        the top down. The row is the middle of the band.
    points_m
        (2k, 3) the same in the car frame, metres (eq. 8).
    sigma_d_px
        One standard deviation of the target's disparity, from how its ends spread; NaN where there are none.
    """

    uvd_px: FloatArray
    points_m: FloatArray
    sigma_d_px: float


def measure_target(
    left_mask: NDArray[np.bool_] | Share,
    right_mask: NDArray[np.bool_] | Share,
    rectification: Rectification,
    settings: BandsSettings,
) -> Ends:
    """Measure one target that is alone in both images ("if there is only one target in the image", section 2.2).

    Parameters
    ----------
    left_mask, right_mask
        (height, width) what belongs to the target in the rectified images; or how much of each pixel does, 0..1.
    rectification
        The twin cameras.
    settings
        Bands and matching.

    Raises
    ------
    ValueRefusedError
        If the masks are no images of one shape, or hold other values than 0..1.
    """
    if left_mask.ndim != 2 or left_mask.shape != right_mask.shape or not left_mask.size:
        raise ValueRefusedError(
            f"masks must be images of one shape (height, width), but got {left_mask.shape} and {right_mask.shape}"
        )
    for mask in (left_mask, right_mask):
        if not (mask.min() >= 0 and mask.max() <= 1):
            raise ValueRefusedError(f"masks must hold 0..1 or booleans, but got {mask.min()}..{mask.max()}")
    left, right = (Targets(m.astype(np.float32), (m >= HALF).astype(np.int32)) for m in (left_mask, right_mask))
    return (measure_targets(left, right, rectification, settings) or [measured(np.zeros((0, 3)), rectification)])[0]


def measure_targets(left: Targets, right: Targets, rectification: Rectification, settings: BandsSettings) -> list[Ends]:
    """Measure every target of the left image (section 2.2's matching, section 2.3's triangulation).

    Returns
    -------
    One entry a target, in the order of their numbers; empty ends where nothing was matched.
    """
    images = _Blocks(left), _Blocks(right)
    rows = [box[0] for box in images[0].boxes]
    found = [match_bands(number, box.start, box.stop, *images, settings) for number, box in enumerate(rows, 1)]
    return [measured(without_strays(uvd), rectification) for uvd in found]


class _Blocks:
    """The targets of one image, ready to be projected band by band."""

    def __init__(self, targets: Targets) -> None:
        self.share = targets.share
        self.boxes = scipy.ndimage.find_objects(targets.labels)
        # The rim below the threshold belongs to the block beside it: there its edge is, to a part of a pixel.
        self.labels = _grown(targets.labels)

    def segments(self, first: int, last: int) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return the line segments of all targets in the rows first..last - 1, left to right, and whose they are."""
        ends, owners = [np.zeros((0, 2))], [np.zeros(0, np.intp)]
        for number, (rows, columns) in enumerate(self.boxes, 1):
            if rows.start < last and rows.stop > first:
                start = max(0, columns.start - 2)
                band = np.s_[first:last, start : columns.stop + 2]
                found = project_band(self.share[band] * (self.labels[band] == number)) + start
                ends.append(found)
                owners.append(np.full(len(found), number))
        all_ends, all_owners = np.concatenate(ends), np.concatenate(owners)
        order = np.argsort(all_ends[:, 0], kind="stable")
        return all_ends[order], all_owners[order]


def match_bands(
    number: int, first: int, last: int, left: _Blocks, right: _Blocks, settings: BandsSettings
) -> FloatArray:
    """Return (2k, 3) homonymous points of target `number`, which reaches over the rows first..last - 1.

    The bands are those of this target; all targets of both images are projected in them, so that none takes the
    partner of another.
    """
    interval = band_interval_px(last - first, settings)
    uvd = []
    for top in range(first, last, interval):
        bottom = min(top + interval, last)
        (ends_l, owners), (ends_r, _) = left.segments(top, bottom), right.segments(top, bottom)
        for i, j in match_segments(ends_l, ends_r, settings):
            if owners[i] == number:
                uvd += [
                    (u, (top + bottom - 1) / 2, u - partner) for u, partner in zip(ends_l[i], ends_r[j], strict=True)
                ]
    return np.array(uvd).reshape(-1, 3)


def without_strays(uvd: FloatArray) -> FloatArray:
    """Return the segments both of whose ends have about the disparity of their side of the target.

    Each side has its own: of a box seen over its corner, one side's edge is a box's length further away.
    """
    if not len(uvd):
        return uvd
    d = uvd[:, 2].reshape(-1, 2)
    off = np.abs(d - np.median(d, axis=0))
    near = (off <= np.maximum(STRAY_PX, 3 * NORMAL_MAD * np.median(off, axis=0))).all(1)
    return uvd[np.repeat(near, 2)]


def measured(uvd: FloatArray, rectification: Rectification) -> Ends:
    """Triangulate the end points (section 2.3, eq. 8), and say from their spread how well the disparity is known.

    What does not go on from band to band is noise of single ends and no depth of the target: it is shrunk away before
    the triangulation, for the nearest face is a low percentile, and noise alone would bring that nearer.

    The stated sigma is the spread of single ends, whatever their number: ends of one target err together, where the
    background, a shadow or clothes are cut wrong, and where the silhouette lies behind the face.
    """
    if not len(uvd):
        return Ends(uvd, triangulate(rectification, uvd), float("nan"))
    middle = np.median(uvd[:, 2])
    off = uvd[:, 2] - middle
    spread = NORMAL_MAD * float(np.median(np.abs(off)))
    sigma = max(LEAST_SIGMA_PX, spread)
    smooth = np.column_stack([uvd[:, :2], middle + off * _depth_share(off)])
    return Ends(smooth, triangulate(rectification, smooth), sigma)


def merged(pieces: Sequence[Ends]) -> Ends:
    """Return the ends of several pieces of one target as one; it is known as badly as the worst of them."""
    uvd, points = (np.concatenate(parts) for parts in ([p.uvd_px for p in pieces], [p.points_m for p in pieces]))
    return Ends(uvd, points, max(p.sigma_d_px for p in pieces))


def _depth_share(off: FloatArray) -> float:
    """Return which share of the spread of disparities goes on from band to band, 0..1; 1 for too few to tell."""
    if len(off) < 8:
        return 1.0
    jumps = off.reshape(-1, 2)[1:] - off.reshape(-1, 2)[:-1]
    total = float((off**2).mean())
    return float(np.sqrt(max(0.0, 1 - (jumps**2).mean() / 2 / total))) if total > 0 else 1.0


def lies_flat(uvd: FloatArray, horizon_px: float) -> bool:
    """Return whether a target is paint or shadow on the road rather than something that stands on it.

    On a flat road the disparity grows with the row's distance from the horizon, on something upright it does not; so
    whichever of the two explains the end points better decides, left and right ends each for themselves. Ours: the
    paper keeps such lines as targets.
    """
    below, d = (uvd[:, 1] - horizon_px).reshape(-1, 2), uvd[:, 2].reshape(-1, 2)
    if not len(d) or below.min() <= 0:
        return False
    upright = np.abs(d - np.median(d, axis=0)).sum()
    flat = np.abs(d - np.median(d / below, axis=0) * below).sum()
    return bool(flat < upright)


def _grown(labels: Labels) -> Labels:
    """Return the labels grown by one pixel to the left and right, into what has none."""
    beside = np.pad(labels, ((0, 0), (1, 1)))
    return np.where(labels > 0, labels, np.where(beside[:, 2:] > 0, beside[:, 2:], beside[:, :-2]))
