"""Triangulate: Regions in, Obstacles out: metres in the vehicle frame, with what noise and calibration do to them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadblock.geometry.pose import transform, vehicle_from_car
from roadblock.geometry.stereo import image_from_car, triangulate, triangulate_jacobian
from roadblock.geometry.uncertainty import calibration_cov
from roadblock.kernels.compiled.street import measure_surfaces
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.scene import NEAREST_FACE_PERCENT, GroundPlane, Obstacle, Region, road_numbers

FACE_SHARE, DEPTH_SHARE = 0.04, 0.08
"""What a detector takes along or leaves out moves the nearest face by such shares of a thing's size (the root of its
width times its height) and of its depth, where that is seen (standard deviations)."""
EDGE_PX, WIDTH_SHARE, HEIGHT_SHARE = 3.0, 0.14, 0.07
"""How far the middle of the nearest face may lie beside the one measured (standard deviations): its edges lie between
cells; which part of the width is nearest is decided by little; and what is narrow for its height may go on unseen."""
FOOT_PX, FOOT_RAD, FOOT_FROM_M = 0.3, 0.002, 20.0
"""The same for the foot: a row's share, and what the road's slope is off by, all of it where no road is seen."""


def locate(
    region: Region,
    rectification: Rectification,
    ground: GroundPlane | None,
    color: str | None = None,
    T_vehicle_car: FloatArray | None = None,
) -> Obstacle:
    """Measure one region (the paper's section 2.3 and eq. 8).

    Parameters
    ----------
    region
        From a detector.
    rectification
        The twin cameras.
    ground
        The road, for foot point and height; without it, the lowest visible point is the foot.
    color
        Its colour's name.
    T_vehicle_car
        The rig's mounting, or None.

    Returns
    -------
    The obstacle; its length is NaN where its depth does not stand out of the noise of the disparities. What the
    calibration does to it is unknown yet: see `add_calibration_error`.
    """
    return locate_all([region], rectification, ground, [color], T_vehicle_car)[0]


def locate_all(
    regions: Sequence[Region],
    rectification: Rectification,
    ground: GroundPlane | None,
    colors: Sequence[str | None],
    T_vehicle_car: FloatArray | None = None,
) -> list[Obstacle]:
    """Measure all regions of a frame at once; see `locate`."""
    if not regions:
        return []
    r = rectification
    surfaces, sigmas = zip(*map(measured_surface, regions), strict=True)
    bounds = np.cumsum([0, *map(len, surfaces)]).astype(np.int32)
    figures = np.empty((len(regions), 8))
    near_share = NEAREST_FACE_PERCENT / 100
    measure_surfaces(np.concatenate(surfaces), bounds, r.numbers, road_numbers(ground), near_share, figures)
    range_m, far_m, left_m, right_m, middle_m, v_px, height_m, lowest_m = figures.T
    for i, region in enumerate(regions):
        if region.refined is not None:
            range_m[i] = r.f_px * r.baseline_m / region.refined.nearest_d_px
    feet = np.stack([middle_m, lowest_m if ground is None else ground.y_below(middle_m, range_m), range_m], -1)
    scale = r.f_px / range_m
    depth_m, per_m = far_m - range_m, scale * r.baseline_m / range_m
    is_seen = depth_m > 3 * np.array(sigmas) / per_m
    length_m = np.where(is_seen & (depth_m > 0.5), depth_m, np.nan)
    width_m, tall_m = right_m - left_m, np.maximum(height_m, 0.0)
    face_m = FACE_SHARE * np.sqrt(width_m * tall_m)
    sigma_d_px = np.hypot(sigmas, per_m * np.hypot(face_m, np.where(is_seen, DEPTH_SHARE * depth_m, 0.0)))
    uvd = np.stack([(middle_m + r.baseline_m / 2) * scale + r.cx_px, v_px, r.baseline_m * scale], -1)
    cov_uvd = np.zeros((len(regions), 3, 3))
    cov_uvd[:, 0, 0] = EDGE_PX**2 + ((WIDTH_SHARE * width_m) ** 2 + (HEIGHT_SHARE * tall_m) ** 2) * scale**2
    cov_uvd[:, 1, 1] = FOOT_PX**2 + (r.f_px * FOOT_RAD * range_m / (range_m + FOOT_FROM_M)) ** 2
    cov_uvd[:, 2, 2] = sigma_d_px**2
    T = vehicle_from_car(T_vehicle_car)
    J = T[:3, :3] @ _foot_jacobian(r, feet, ground)
    cov_m2 = J @ cov_uvd @ J.swapaxes(1, 2)
    sigma_m = range_m / uvd[:, 2] * sigma_d_px
    sizes_m = np.stack([np.maximum(width_m, 1 / scale), height_m, length_m], -1)
    positions_m = transform(T, feet)
    ranges, range_sigmas = range_m.tolist(), sigma_m.tolist()
    return [
        Obstacle(
            position_m=positions_m[i],
            range_m=ranges[i],
            range_sigma_m=range_sigmas[i],
            size_m=sizes_m[i],
            uvd_px=uvd[i],
            cov_uvd_px2=cov_uvd[i],
            cov_match_m2=cov_m2[i],
            box_px=region.box_px,
            contour_px=region.contour_px,
            color=colors[i],
            is_seen_through=region.is_seen_through,
        )
        for i, region in enumerate(regions)
    ]


def _foot_jacobian(r: Rectification, feet: FloatArray, ground: GroundPlane | None) -> FloatArray:
    """Return (n, 3, 3) d(x, y, z) / d(u, v, d) of foot points, m/px; farther away a foot is farther along the road."""
    J = triangulate_jacobian(r, image_from_car(r, feet))
    if ground is not None:
        n_x, n_y, n_z = ground.normal
        to_z = n_z - 2 * ground.bend_per_m * feet[:, 2]
        J[:, 1] = J[:, 1] * [0, 1, 0] - (n_x * J[:, 0] + to_z[:, None] * J[:, 2]) / n_y
    return J


def measured_surface(region: Region) -> tuple[FloatArray, float]:
    """Return (m, 3) the surface's samples, moved to the refined mean where there is one, and the sigma of the range."""
    if region.refined is None:
        return region.surface_uvd_px, region.sigma_d_px
    shift = np.array([0.0, 0.0, region.refined.moved_px])
    moved = region.surface_uvd_px + shift
    return np.where(moved[:, 2:] > 0, moved, region.surface_uvd_px), region.refined.sigma_nearest_d_px


def add_calibration_error(
    obstacles: Sequence[Obstacle], rectification: Rectification, rig: StereoRig
) -> tuple[Obstacle, ...]:
    """Return obstacles with what the rig's own uncertainty does to their place and range.

    Parameters
    ----------
    obstacles
        As `locate` measured them; all at once, because one call costs as much as one obstacle.
    rectification
        The twin cameras they were measured with.
    rig
        The rig behind these, with its mounting.

    Returns
    -------
    The same obstacles with `cov_calib_m2` and `range_sigma_calib_m`, taken at their measured points `uvd_px`; NaN where
    the rig has no covariance.
    """
    if not obstacles or rig.covariance is None:
        return tuple(obstacles)
    cov_car = calibration_cov(rig, triangulate(rectification, [obstacle.uvd_px for obstacle in obstacles]))
    R = vehicle_from_car(rig.T_vehicle_car)[:3, :3]
    return tuple(
        replace(obstacle, cov_calib_m2=R @ cov @ R.T, range_sigma_calib_m=float(np.sqrt(np.maximum(cov[2, 2], 0))))
        for obstacle, cov in zip(obstacles, cov_car, strict=True)
    )
