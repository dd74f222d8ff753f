"""Segment: disparities and ground in; FreeSpace and Regions out. Class-less: whatever stands on the road.

Works on cells, so that a dense map (reduced by `to_cells`) and a matcher that thinks in cells share it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator
from scipy.ndimage import minimum_filter1d

from roadblock.geometry.stereo import triangulate
from roadblock.kernels.compiled import edges
from roadblock.kernels.compiled import street as kernels
from roadblock.kernels.reference.street import BESIDE
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray, locked, unchecked
from roadblock.values.frame import DisparityMap, Image
from roadblock.values.scene import (
    NEAREST_FACE_PERCENT,
    FreeSpace,
    GroundPlane,
    Region,
    RoadEdges,
    Stixels,
    road_numbers,
)

ROAD_M = 0.2
"""What lies this close to the ground plane is road."""
FOOT_M = 0.6
"""A column of a region that begins lower than this stands on the road itself; a higher one is an arm or a mirror."""
ASIDE_PX = 4
"""A column's free space also looks this far to either side."""
NEAREST_SHARE = 0.15
"""Free space ends at this share of the cells that stand together: the very nearest may be stray ones."""
CLOSE_SHARE = 0.9
"""A hole that begins beyond this share of the range lies right before what ends free space, and shortens it."""
FREE_PX = 3.5
"""No road is known to be free where disparities are smaller than this."""
STIXEL_CELLS = 2
"""Smaller ones are specks."""
JOIN_REACH_M, JOIN_NEAR_M, BEHIND_SHARE = 15.0, 0.25, 0.1
"""Near by smooth bodies show little but their edges: pieces up to here are joined whose nearest faces differ by less,
if no more than this share of what lies between them is seen to lie behind."""
MOST_REGIONS = 1000
"""Of one frame; further ones are dropped."""


class SegmentSettings(BaseModel):
    """What counts as standing on the road, and what belongs together."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    height_m: tuple[float, float] = Field((0.35, 4.0), description="Heights over the road that make an obstacle.")
    overhead_m: float = Field(1.0, gt=0, description="What begins higher than this hangs over the road.")
    reach_m: float = Field(60.0, gt=0, description="Nothing further away is reported.")
    link_m: float = Field(0.5, gt=0, description="Neighbours this close in range belong together, ...")
    link_px: float = Field(0.4, gt=0, description="... or this close in disparity.")
    gap_px: int = Field(8, ge=1, le=64, description="Holes smaller than this are bridged.")
    join_m: float = Field(1.0, ge=0, description="Near pieces this far apart are one, if nothing is seen between.")
    split_m: float = Field(8.0, ge=0.5, description="What is longer in depth (hedges, rails) is cut into pieces.")
    area_px: float = Field(250.0, ge=0, description="Smaller regions are dropped.")
    locking_px: float = Field(0.25, gt=0, description="Disparity error a whole region shares (pixel locking).")
    free_height_m: tuple[float, float] = Field((0.25, 2.5), description="Heights that end free space.")
    free_area_px: float = Field(32.0, gt=0, description="Area of the cells that end a column's free space.")
    free_gap_m: float = Field(0.35, gt=0, description="A hole that could hide this height leaves a column unknown.")
    edge_height_m: tuple[float, float] = Field((0.05, 0.25), description="Heights of kerbs and verges.")
    edge_sigma_px: float = Field(0.17, ge=0, description="Noise of a cell's disparity, as far as edges go.")
    stixels: bool = Field(False, description="Also what stands, column by column.")

    @field_validator("height_m", "free_height_m", "edge_height_m")
    @classmethod
    def _rises(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the first must be below the second")
        return limits


@dataclass(frozen=True, eq=False)
class Surface:
    """The cells of a frame in space.

    Attributes
    ----------
    disparity
        (rows, columns), as matched.
    rectification
        The twin cameras.
    z_m
        (rows, columns) float32 forward distance, metres; NaN where unknown.
    height_m
        (rows, columns) float32 height over the road; NaN where unknown, and everywhere without a road.
    """

    disparity: DisparityMap
    rectification: Rectification
    z_m: NDArray[np.float32]
    height_m: NDArray[np.float32]

    @property
    def points(self) -> FloatArray:
        """(rows, columns, 3) of every cell in the car frame, metres."""
        return triangulate(self.rectification, self.disparity.uvd_px)


def to_cells(disparity: DisparityMap, cell_px: int) -> DisparityMap:
    """Reduce a dense map to cells: the median where at least half of a cell's pixels are known, else NaN."""
    c = cell_px
    rows, columns = (n // c for n in disparity.d_px.shape)
    blocks = disparity.d_px[: rows * c, : columns * c].reshape(rows, c, columns, c).swapaxes(1, 2)
    values = np.sort(blocks.reshape(rows, columns, c * c), axis=-1)
    known = np.isfinite(values).sum(-1)[..., None]
    low = np.take_along_axis(values, np.maximum(known - 1, 0) // 2, -1)
    high = np.take_along_axis(values, np.minimum(known // 2, c * c - 1), -1)
    median = np.where(2 * known >= c * c, (low + high) / 2, np.nan)[..., 0]
    return DisparityMap(median.astype(np.float32), disparity.sigma_px, c)


def lift(disparity: DisparityMap, rectification: Rectification, ground: GroundPlane | None) -> Surface:
    """Put every cell in space. Without a ground, heights are NaN."""
    r, d_px = rectification, disparity.d_px
    z_m, height_m = np.empty_like(d_px), np.empty_like(d_px)
    cell = disparity.cell_px, disparity.cell_height_px
    kernels.raise_cells(d_px, *cell, r.numbers, road_numbers(ground), z_m, height_m)
    return Surface(disparity, r, z_m, height_m)


def find_free_space(surface: Surface, ground: GroundPlane | None, settings: SegmentSettings) -> FreeSpace:
    """Return how far the road is known to be free, per column of cells, and the kerbs and verges on the way.

    A column ends at the first range where cells of `free_area_px` (of it and its neighbours) stand close together, or
    where the road was last seen. NaN where neither was observed, where a hole before it could hide something of
    `free_gap_m`, and everywhere without a ground.
    """
    disparity, r = surface.disparity, surface.rectification
    w, h = disparity.cell_px, disparity.cell_height_px
    rows, columns = disparity.d_px.shape
    u_px = w * np.arange(columns, dtype=float) + (w - 1) / 2
    range_m = np.full(columns, np.nan)
    if ground is None or rows == 0:
        return FreeSpace(u_px, range_m, np.zeros(columns, bool))
    aside = round(ASIDE_PX / w)
    support = min(max(1, round(settings.free_area_px / (w * h))), rows * (2 * aside + 1))
    heights = np.array([*settings.free_height_m, ROAD_M])
    fb = r.f_px * r.baseline_m
    blocked = np.empty(columns, bool)
    kernels.measure_free(disparity.d_px, surface.height_m, fb, heights, support, aside, NEAREST_SHARE, range_m, blocked)
    hole = np.empty(columns)
    kernels.find_holes(surface.height_m, _road_ranges(surface, ground), h, settings.free_gap_m * r.f_px, hole)
    # A hole was made narrower by what is seen beside it, and its edges lie within cells.
    beside = minimum_filter1d(hole, 2 * BESIDE + 3, mode="nearest")
    end_m = np.minimum(beside, fb / FREE_PX)
    blocked &= end_m >= range_m
    range_m = np.where(beside < CLOSE_SHARE * range_m, np.nan, np.minimum(end_m, range_m))
    return FreeSpace(u_px, range_m, blocked, _find_edges(surface, ground, range_m, settings))


def _find_edges(surface: Surface, ground: GroundPlane, free_m: FloatArray, settings: SegmentSettings) -> RoadEdges:
    """Return the kerbs and verges before the end of each column's free space."""
    r, n = surface.rectification, len(free_m)
    noise_per_m = ground.height_m / (r.f_px * r.baseline_m) * settings.edge_sigma_px
    range_m, height_m, kind = np.empty(n), np.empty(n), np.empty(n, np.uint8)
    limits_m = np.array(settings.edge_height_m)
    edges.find_edges(surface.height_m, surface.z_m, free_m, noise_per_m, limits_m, range_m, height_m, kind)
    return RoadEdges(range_m, height_m, kind)


def _road_ranges(surface: Surface, ground: GroundPlane) -> FloatArray:
    """Return the range at which each row of cells sees the road; infinity from the horizon upwards."""
    r, h = surface.rectification, surface.disparity.cell_height_px
    rays = (h * np.arange(len(surface.z_m)) + (h - 1) / 2 - r.cy_px) / r.f_px
    slope = -ground.normal[1] * rays - ground.normal[2]
    return np.where(slope > 0, ground.height_m / np.maximum(slope, 1e-9), np.inf)


def find_regions(
    surface: Surface, colors: Image | None, ground: GroundPlane | None, settings: SegmentSettings
) -> tuple[Region, ...]:
    """Group the cells that stand on the road.

    Parameters
    ----------
    surface
        The cells in space.
    colors
        (at least rows, at least columns, 3) pixel of the rectified left image in the middle of each cell; None if grey.
    ground
        The road; without one, everything in reach counts.
    settings
        What belongs together.

    Returns
    -------
    Regions whose lowest cell is near the road, nearest first; things hanging over it and specks are left out, and so
    is what is seen through a nearer region.
    """
    disparity, r = surface.disparity, surface.rectification
    w, h, d_px = disparity.cell_px, disparity.cell_height_px, disparity.d_px
    columns = d_px.shape[1]
    parent = np.empty(d_px.size, np.int32)
    limits = np.array([settings.reach_m, *settings.height_m])
    links = np.array([settings.link_m, settings.link_px])
    gaps = max(1, settings.gap_px // w), max(1, settings.gap_px // h)
    kernels.link(d_px, surface.z_m, surface.height_m, limits, links, *gaps, parent)
    cells, bounds = np.empty(d_px.size, np.int32), np.empty(MOST_REGIONS + 1, np.int32)
    nearest, near_share = np.empty(MOST_REGIONS), NEAREST_FACE_PERCENT / 100
    found = kernels.gather_pieces(
        parent,
        surface.z_m,
        surface.height_m,
        r.f_px * r.baseline_m,
        int(np.ceil(settings.area_px / (w * h))),
        np.nan if ground is None else settings.overhead_m,
        settings.split_m,
        near_share,
        cells,
        bounds,
        nearest,
    )
    if found == 0:
        return ()
    boxes = np.empty((found, 4), np.int32)
    kernels.measure_boxes(cells, bounds, found, columns, boxes)
    joins = np.array([JOIN_REACH_M, JOIN_NEAR_M, settings.join_m * r.f_px / w, BEHIND_SHARE])
    found = kernels.join_pieces(
        d_px, surface.z_m, joins, near_share, cells, bounds[: found + 1], boxes, nearest[:found]
    )
    boxes = boxes[:found] * np.array([w, h, w, h], np.int32)
    if ground is not None:
        boxes[:, 3] = np.maximum(boxes[:, 3], _road_rows(boxes, nearest[:found], r, ground))
    order = np.argsort(nearest[:found])
    kept = np.empty(found, bool)
    kernels.drop_hidden(boxes[order], (np.diff(bounds[: found + 1]) * w * h)[order], kept)
    order, through = order[kept], np.empty(np.count_nonzero(kept), bool)
    kernels.find_through(cells, bounds[: found + 1], order, columns, through)
    return _describe(surface, colors, cells, bounds[: found + 1], boxes, order, through, settings.locking_px)


def find_stixels(surface: Surface, settings: SegmentSettings) -> Stixels | None:
    """Return what stands, column by column, on the road or over it; None if the settings want none."""
    if not settings.stixels:
        return None
    disparity, r = surface.disparity, surface.rectification
    w, h = disparity.cell_px, disparity.cell_height_px
    found = np.empty((disparity.d_px.size, 5))
    n = kernels.find_stixels(
        disparity.d_px,
        surface.z_m,
        surface.height_m,
        np.array([settings.reach_m, *settings.height_m]),
        np.array([settings.link_m, settings.link_px]),
        max(1, settings.gap_px // h),
        STIXEL_CELLS,
        found,
    )
    column, first, end, d_px, height_m = found[:n].T
    return Stixels(w * column + (w - 1) / 2, h * first, h * end, r.f_px * r.baseline_m / d_px, height_m)


def _describe(
    surface: Surface,
    colors: Image | None,
    cells: NDArray[np.int32],
    bounds: NDArray[np.int32],
    boxes: NDArray[np.int32],
    order: NDArray[np.int64],
    through: NDArray[np.bool_],
    locking_px: float,
) -> tuple[Region, ...]:
    """Return the pieces of `order`, in that order."""
    disparity = surface.disparity
    w, h, d_px = disparity.cell_px, disparity.cell_height_px, disparity.d_px
    uvd, rough_px = np.empty((bounds[-1], 3)), np.empty(len(order))
    corners = np.empty(len(order) + 1, np.int32)
    outline = np.empty((4 * int((boxes[order, 2] - boxes[order, 0]).sum()) // w, 2), np.int32)
    kernels.describe_pieces(
        d_px, surface.height_m, cells, bounds, order, boxes, w, h, FOOT_M, uvd, outline, corners, rough_px
    )
    rgb = np.full((len(order), 3), np.nan)
    if colors is not None:
        kernels.mean_colors(colors, cells, bounds, order, d_px.shape[1], rgb)
        rgb /= 257 if colors.dtype == np.uint16 else 1
    scatter_px = np.where(np.isfinite(rough_px), rough_px, disparity.sigma_px)
    sigma_px = np.hypot(locking_px, scatter_px).tolist()
    ends, starts = bounds[order + 1].tolist(), bounds[order].tolist()
    turns, seen_through = corners.tolist(), through.tolist()
    outline, uvd, rgb = locked(outline), locked(uvd), locked(rgb)
    return tuple(
        unchecked(
            Region,
            box_px=tuple(box),
            contour_px=outline[turns[k] : turns[k + 1]],
            surface_uvd_px=uvd[starts[k] : ends[k]],
            sigma_d_px=sigma_px[k],
            color_rgb=rgb[k],
            is_seen_through=seen_through[k],
        )
        for k, box in enumerate(boxes[order].tolist())
    )


def _road_rows(boxes: NDArray[np.int32], range_m: FloatArray, r: Rectification, ground: GroundPlane) -> FloatArray:
    """Return the image row below which each nearest face stands on the road, within the image."""
    x_m = ((boxes[:, 0] + boxes[:, 2] - 1) / 2 - r.cx_px) / r.f_px * range_m - r.baseline_m / 2
    return np.asarray(np.clip(np.rint(ground.y_below(x_m, range_m) / range_m * r.f_px + r.cy_px) + 1, 0, r.size_px[1]))
