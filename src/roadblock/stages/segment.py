"""Segment: disparities and ground in; FreeSpace and Regions out. Class-less: whatever stands on the road.

Works on cells, so that a dense map (reduced by `to_cells`) and a matcher that thinks in cells share it.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, field_validator
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from roadblock.geometry.stereo import image_from_car, triangulate
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import DisparityMap, Image
from roadblock.values.scene import NEAREST_FACE_PERCENT, FreeSpace, GroundPlane, Region

Mask = NDArray[np.bool_]
Labels = NDArray[np.intp]
ROAD_M = 0.2
"""What lies this close to the ground plane is road."""
FOOT_M = 0.6
"""A column of a region that begins lower than this stands on the road itself; a higher one is an arm or a mirror."""


class SegmentSettings(BaseModel):
    """What counts as standing on the road, and what belongs together."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    height_m: tuple[float, float] = Field((0.35, 4.0), description="Heights over the road that make an obstacle.")
    overhead_m: float = Field(1.0, gt=0, description="What begins higher than this hangs over the road.")
    reach_m: float = Field(60.0, gt=0, description="Nothing further away is reported.")
    link_m: float = Field(0.5, gt=0, description="Neighbours this close in range belong together, ...")
    link_px: float = Field(0.6, gt=0, description="... or this close in disparity.")
    gap_cells: int = Field(3, ge=1, le=8, description="Holes smaller than this are bridged.")
    split_m: float = Field(8.0, ge=0.5, description="What is longer in depth (hedges, rails) is cut into pieces.")
    area_px: float = Field(250.0, ge=0, description="Smaller regions are dropped.")
    locking_px: float = Field(0.25, gt=0, description="Disparity error a whole region shares (pixel locking).")
    free_height_m: tuple[float, float] = Field((0.25, 2.5), description="Heights that end free space.")
    free_support: int = Field(8, ge=1, description="Cells that end a column's free space.")
    free_gap_m: float = Field(1.0, gt=0, description="A hole that could hide this height ends free space.")

    @field_validator("height_m", "free_height_m")
    @classmethod
    def _rises(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the first must be below the second")
        return limits


@dataclass(frozen=True, eq=False)
class Surface:
    """The cells of a frame in space: `uvd` (rows, columns, 3) px, `points` car frame m, `height_m` over the road."""

    uvd: FloatArray
    points: FloatArray
    height_m: FloatArray
    cell_px: int


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
    uvd = disparity.uvd_px
    points = triangulate(rectification, uvd)
    height_m = np.full(points.shape[:2], np.nan) if ground is None else ground.height_of(points)
    return Surface(uvd, points, height_m, disparity.cell_px)


def find_free_space(
    surface: Surface, rectification: Rectification, ground: GroundPlane | None, settings: SegmentSettings
) -> FreeSpace:
    """Return how far the road is known to be free, per column of cells.

    A column ends at the first range where `free_support` cells (of it and two neighbours on either side) stand close
    together, or where the road was last seen, or before a hole that could hide something of `free_gap_m`. NaN where
    none of these was observed, and everywhere without a ground.
    """
    columns = surface.uvd.shape[1]
    u_px = surface.cell_px * np.arange(columns, dtype=float) + (surface.cell_px - 1) / 2
    if ground is None:
        return FreeSpace(u_px, np.full(len(u_px), np.nan))
    z, h = surface.points[..., 2], surface.height_m
    low, high = settings.free_height_m
    with np.errstate(invalid="ignore"):
        standing = np.sort(_neighbourhood(np.where((h > low) & (h < high), z, np.inf)), axis=1)
        road = np.sort(_neighbourhood(np.where(np.abs(h) < ROAD_M, z, -np.inf)), axis=1)
        k = min(settings.free_support, standing.shape[1])
        first, last = standing[:, : 1 - k or None], standing[:, k - 1 :]
        supported = last - first <= np.maximum(0.5, 0.05 * first)
    column = np.arange(columns)
    # The second of the supporting cells: the first may be a stray one.
    obstacle = np.where(supported.any(1), standing[column, supported.argmax(1) + min(1, k - 1)], np.inf)
    seen = np.where(road[:, -4] > 0, road[:, -4], np.nan)
    range_m = np.where(np.isfinite(obstacle), obstacle, seen)
    hole = _first_hole(surface, rectification, ground, settings.free_gap_m)
    return FreeSpace(u_px, np.where(hole < range_m, np.where(hole > 0, hole, np.nan), range_m))


def _neighbourhood(values: FloatArray) -> FloatArray:
    """Return (columns, 5 * rows): each column with two neighbours on either side."""
    padded = np.pad(values, ((0, 0), (2, 2)), mode="edge")
    return np.concatenate([padded[:, i : i + values.shape[1]] for i in range(5)], axis=0).T


def _first_hole(surface: Surface, r: Rectification, ground: GroundPlane, gap_m: float) -> FloatArray:
    """Return per column the range where a hole begins that could hide something `gap_m` tall; inf where none.

    0 where the hole begins at the image's lower border: nothing is known there.
    """
    rows, columns = surface.height_m.shape
    seen = np.any(np.isfinite(_neighbourhood(surface.height_m)).reshape(columns, 5, rows), axis=1, keepdims=True)[
        :, 0
    ].T
    rays = (surface.uvd[:, 0, 1] - r.cy_px) / r.f_px
    slope = -ground.normal[1] * rays - ground.normal[2]
    road_m = np.where(slope > 0, ground.height_m / np.maximum(slope, 1e-9), np.inf)
    hole = np.full(columns, np.inf)
    length, begin = np.zeros(columns), np.zeros(columns)
    below_m = 0.0
    for row in range(rows - 1, -1, -1):
        if not np.isfinite(road_m[row]):
            break
        begin = np.where(length == 0, below_m, begin)
        length = np.where(seen[row], 0, length + surface.cell_px)
        hides = np.asarray(length * np.maximum(begin, road_m[-1]) >= gap_m * r.f_px)
        hole = np.where(hides & np.isinf(hole), begin, hole)
        below_m = road_m[row]
    return hole


def find_regions(
    surface: Surface,
    image: Image,
    rectification: Rectification,
    ground: GroundPlane | None,
    sigma_px: float,
    settings: SegmentSettings,
) -> tuple[Region, ...]:
    """Group the cells that stand on the road.

    Parameters
    ----------
    surface
        The cells in space.
    image
        Rectified left image, for the colour.
    rectification, ground
        The twin cameras and the road; without a road, everything in reach counts.
    sigma_px
        Noise of one cell's disparity, for regions too thin to show it themselves.
    settings
        What belongs together.

    Returns
    -------
    Regions whose lowest cell is near the road; things hanging over it and specks are left out, and so is what is
    seen through a nearer region.
    """
    z, h = surface.points[..., 2], surface.height_m
    low, high = settings.height_m
    with np.errstate(invalid="ignore"):
        stands = z < settings.reach_m
        if ground is not None:
            stands &= (h > low) & (h < high)
    if not stands.any():
        return ()
    labels = _link(stands, z, surface.uvd[..., 2], settings)
    cells = [
        piece
        for label, box in enumerate(ndimage.find_objects(labels), 1)
        for piece in _cut(*_cells_of(labels, label, box), z, rectification, settings)
        if len(piece[0]) * surface.cell_px**2 >= settings.area_px
        and (ground is None or h[piece].min() < settings.overhead_m)
    ]
    cells.sort(key=lambda piece: float(np.percentile(z[piece], NEAREST_FACE_PERCENT)))
    regions: list[Region] = []
    for piece in cells:
        region = _region(piece, surface, image, rectification, ground, sigma_px, settings)
        if not any(_shows_through(region, nearer, surface.cell_px) for nearer in regions):
            regions.append(region)
    return tuple(regions)


Cells = tuple[NDArray[np.intp], NDArray[np.intp]]


def _cells_of(labels: Labels, label: int, box: tuple[slice, ...]) -> Cells:
    rows, columns = np.nonzero(labels[box] == label)
    return rows + box[0].start, columns + box[1].start


def _link(stands: Mask, z: FloatArray, d_px: FloatArray, settings: SegmentSettings) -> Labels:
    """Give one number to cells joined by neighbours of like range or disparity, across small holes; 0 = none."""
    rows, columns = stands.shape
    number = np.arange(stands.size).reshape(stands.shape)
    pairs = []
    straight = range(1, settings.gap_cells + 1)
    for dv, du in [(0, k) for k in straight] + [(k, 0) for k in straight] + [(1, 1), (1, -1)]:
        a = (slice(0, max(0, rows - dv)), slice(max(0, -du), max(0, columns - max(0, du))))
        b = (slice(dv, rows), slice(max(0, du), max(0, columns + min(0, du))))
        with np.errstate(invalid="ignore"):
            near = np.abs(z[a] - z[b]) < settings.link_m
            near |= np.abs(d_px[a] - d_px[b]) < settings.link_px
        joined = near & stands[a] & stands[b]
        pairs.append(np.stack([number[a][joined], number[b][joined]]))
    i, j = np.concatenate(pairs, 1)
    graph = coo_array((np.ones(len(i), bool), (i, j)), shape=(stands.size, stands.size))
    component = connected_components(graph, directed=False)[1].reshape(stands.shape)
    used, labels = np.unique(np.where(stands, component + 1, 0), return_inverse=True)
    return np.asarray(labels.reshape(stands.shape) + (0 if used[0] == 0 else 1))


def _cut(
    rows: NDArray[np.intp], columns: NDArray[np.intp], z: FloatArray, r: Rectification, settings: SegmentSettings
) -> list[Cells]:
    """Cut what is longer in depth than `split_m` into pieces, so that each has a range worth its name."""
    depth = z[rows, columns]
    near, far = np.percentile(depth, [5, 95])
    noise_m = 2 * far**2 / (r.f_px * r.baseline_m)
    pieces = int(max(0.0, far - near - noise_m) // settings.split_m) + 1
    edges = np.geomspace(near, far, pieces + 1)[1:-1]
    part = np.searchsorted(edges, depth, side="right")
    return [(rows[part == i], columns[part == i]) for i in range(pieces) if (part == i).any()]


def _region(
    cells: Cells,
    surface: Surface,
    image: Image,
    r: Rectification,
    ground: GroundPlane | None,
    sigma_px: float,
    settings: SegmentSettings,
) -> Region:
    rows, columns = cells
    c = surface.cell_px
    u0, u1 = int(columns.min()) * c, int(columns.max() + 1) * c
    v0, v1 = int(rows.min()) * c, int(rows.max() + 1) * c
    if ground is not None:
        v1 = max(v1, min(r.size_px[1], round(_road_row(surface.points[cells], r, ground)) + 1))
    mask = _silhouette(cells, surface, v1 - v0)
    outlines, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE, offset=(u0, v0))
    patch = image[v0 : v0 + len(mask), u0:u1]
    color = np.array(cv2.mean(patch, mask)[:3]) if image.ndim == 3 else np.full(3, np.nan)
    if image.dtype == np.uint16:
        color = color / 257
    return Region(
        box_px=(u0, v0, u1, v1),
        contour_px=np.asarray(max(outlines, key=cv2.contourArea), np.int32).reshape(-1, 2),
        surface_uvd_px=surface.uvd[cells],
        sigma_d_px=float(np.hypot(settings.locking_px, _roughness_px(cells, surface, sigma_px))),
        color_rgb=color,
    )


def _roughness_px(cells: Cells, surface: Surface, unknown_px: float) -> float:
    """Return the scatter of single cells about their neighbours, pixels; `unknown_px` where none has two.

    Second differences, so that a slanted or evenly bent surface has none; the median, so that edges do not count. It
    is not divided by the number of cells: the nearest face is a percentile, which scatter moves, not a mean.
    """
    rows, columns = cells[0] - cells[0].min() + 1, cells[1] - cells[1].min() + 1
    d = np.full((rows.max() + 2, columns.max() + 2), np.nan)
    d[rows, columns] = surface.uvd[cells][:, 2]
    across = d[rows, columns] - (d[rows, columns - 1] + d[rows, columns + 1]) / 2
    down = d[rows, columns] - (d[rows - 1, columns] + d[rows + 1, columns]) / 2
    differences = np.concatenate([across, down])
    differences = np.abs(differences[np.isfinite(differences)])
    # A second difference of independent cells has 1.5 times their variance; 1.4826 makes a median a sigma.
    return 1.4826 / np.sqrt(1.5) * float(np.median(differences)) if len(differences) else unknown_px


def _silhouette(cells: Cells, surface: Surface, height_px: int) -> NDArray[np.uint8]:
    """Paint the cells; where they reach down to the least height that counts, the thing goes on to the road."""
    rows, columns = cells[0] - cells[0].min(), cells[1] - cells[1].min()
    c = surface.cell_px
    mask = np.zeros((int(rows.max()) + 1, int(columns.max()) + 1), np.uint8)
    mask[rows, columns] = 1
    mask = np.kron(mask, np.ones((c, c), np.uint8))
    mask = np.pad(mask, ((0, height_px - len(mask)), (0, 0)))
    lowest = np.full(columns.max() + 1, np.inf)
    np.minimum.at(lowest, columns, np.nan_to_num(surface.height_m[cells], nan=np.inf))
    bottom = np.zeros(columns.max() + 1, int)
    np.maximum.at(bottom, columns, (rows + 1) * c)
    for column in np.flatnonzero(lowest < FOOT_M):
        mask[bottom[column] :, column * c : (column + 1) * c] = 1
    return mask


def _road_row(points: FloatArray, r: Rectification, ground: GroundPlane) -> float:
    """Return the image row where the nearest face meets the road."""
    z = float(np.percentile(points[:, 2], NEAREST_FACE_PERCENT))
    x = float(np.median(points[:, 0]))
    return float(image_from_car(r, ground.point_below(x, z))[1])


def _shows_through(region: Region, nearer: Region, cell_px: int) -> bool:
    """Whether `region` lies inside `nearer`, which is solid: seen through its window, or a wrong patch on it."""
    (a0, b0, a1, b1), (c0, d0, c1, d1) = region.box_px, nearer.box_px
    common = max(0, min(a1, c1) - max(a0, c0)) * max(0, min(b1, d1) - max(b0, d0))
    solid = len(nearer.surface_uvd_px) * cell_px**2 > 0.5 * (c1 - c0) * (d1 - d0)
    return solid and common > 0.85 * (a1 - a0) * (b1 - b0)
