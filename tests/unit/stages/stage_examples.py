"""A crooked little world in closed form: a road and upright boards, as the disparities twin cameras would see."""

from dataclasses import dataclass

import numpy as np

from roadblock.values.camera import Rectification
from roadblock.values.frame import DisparityMap
from roadblock.values.scene import GroundPlane

TWIN = Rectification(f_px=310.0, cx_px=171.3, cy_px=78.6, baseline_m=0.31, size_px=(320, 180))
LONG = Rectification(f_px=900.0, cx_px=331.3, cy_px=158.6, baseline_m=0.5, size_px=(640, 360))


@dataclass(frozen=True)
class Board:
    """An upright board facing the cameras: car-frame x from `left_m` to `right_m`, heights from `low_m` to `high_m`."""

    z_m: float
    left_m: float
    right_m: float
    high_m: float
    low_m: float = 0.0


def plane(height_m: float = 1.4, pitch_rad: float = 0.0, roll_rad: float = 0.0, bend_per_m: float = 0.0) -> GroundPlane:
    """Return a road by its numbers; its y falls with the pitch ahead, and with the roll to the right."""
    normal = np.array([-np.tan(roll_rad), -1.0, -np.tan(pitch_rad)])
    return GroundPlane(normal / np.linalg.norm(normal), height_m, bend_per_m)


def disparity_of(
    ground: GroundPlane | None,
    boards: tuple[Board, ...] = (),
    *,
    twin: Rectification = TWIN,
    cell_px: int = 4,
    road_to_m: float = np.inf,
) -> DisparityMap:
    """Return exact disparities at the cells' centres: per ray the nearest of road and boards, NaN at the sky."""
    width, height = twin.size_px
    v, u = np.mgrid[0 : height // cell_px, 0 : width // cell_px] * float(cell_px) + (cell_px - 1) / 2
    x_ray, y_ray = (u - twin.cx_px) / twin.f_px, (v - twin.cy_px) / twin.f_px
    z = np.full(u.shape, np.inf)
    if ground is not None:
        z = road_depth(ground, x_ray, y_ray, twin.baseline_m / 2)
        z = np.where(z < road_to_m, z, np.inf)
    for board in sorted(boards, key=lambda board: -board.z_m):
        x, y = x_ray * board.z_m - twin.baseline_m / 2, y_ray * board.z_m
        points = np.stack([x, y, np.full(x.shape, board.z_m)], -1)
        high = -y if ground is None else ground.height_of(points)
        hit = (x >= board.left_m) & (x < board.right_m) & (high >= board.low_m) & (high < board.high_m)
        z = np.where(hit & (z > board.z_m), board.z_m, z)
    d_px = np.where(np.isfinite(z), twin.f_px * twin.baseline_m / z, np.nan)
    return DisparityMap(d_px.astype(np.float32), 0.5, cell_px)


def road_depth(ground: GroundPlane, x_ray: np.ndarray, y_ray: np.ndarray, half_baseline_m: float) -> np.ndarray:
    """Solve `n . p + h = q z^2` along p = (x_ray z - B/2, y_ray z, z) for the nearest z > 0; infinity without one."""
    n_x, n_y, n_z = ground.normal
    b, c, q = n_x * x_ray + n_y * y_ray + n_z, ground.height_m - n_x * half_baseline_m, ground.bend_per_m
    with np.errstate(all="ignore"):
        if q == 0:
            return np.where(b < 0, -c / b, np.inf)
        root = np.sqrt(b * b + 4 * q * c)
        both = np.stack([(b - root) / (2 * q), (b + root) / (2 * q)])
    return np.where(both > 0, both, np.inf).min(0)


def noisy(disparity: DisparityMap, sigma_px: float, seed: int) -> DisparityMap:
    """Add Gaussian noise; what would come out negative is unknown."""
    d = disparity.d_px + np.random.default_rng(seed).normal(0, sigma_px, disparity.d_px.shape).astype(np.float32)
    return DisparityMap(np.where(d > 0, d, np.float32(np.nan)), disparity.sigma_px, disparity.cell_px)
