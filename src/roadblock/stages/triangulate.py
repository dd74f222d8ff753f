"""Triangulate: Regions in, Obstacles out: metres in the vehicle frame, with what noise and calibration do to them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadblock.geometry.pose import transform, vehicle_from_car
from roadblock.geometry.stereo import triangulate, triangulate_jacobian
from roadblock.geometry.uncertainty import calibration_cov
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.scene import NEAREST_FACE_PERCENT, GroundPlane, Obstacle, Region


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
    surface, sigma_d_px = measured_surface(region)
    points = triangulate(rectification, surface)
    x, y, z = points.T
    range_m = float(np.percentile(z, NEAREST_FACE_PERCENT))
    if region.refined is not None:
        range_m = rectification.f_px * rectification.baseline_m / region.refined.nearest_d_px
    face = points[np.argsort(z)[: max(1, round(0.3 * len(z)))]]
    left, right = np.percentile(x, [1, 99])
    middle_x = float((np.percentile(face[:, 0], 1) + np.percentile(face[:, 0], 99)) / 2)
    if ground is None:
        foot, height = np.array([middle_x, y.max(), range_m]), float(np.ptp(y))
    else:
        foot, height = ground.point_below(middle_x, range_m), float(np.percentile(ground.height_of(points), 99))
    scale = rectification.f_px / range_m
    d_px = rectification.baseline_m * scale
    uvd = np.array(
        [
            (middle_x + rectification.baseline_m / 2) * scale + rectification.cx_px,
            np.median(region.surface_uvd_px[:, 1]),
            d_px,
        ]
    )
    cov_uvd = np.diag([1.0, 1.0, sigma_d_px**2])
    T = vehicle_from_car(T_vehicle_car)
    J = T[:3, :3] @ triangulate_jacobian(rectification, uvd)
    sigma_m = range_m / d_px * sigma_d_px
    depth = float(np.percentile(z, 95) - range_m)
    return Obstacle(
        position_m=transform(T, foot),
        range_m=range_m,
        range_sigma_m=sigma_m,
        size_m=np.array([max(right - left, 1 / scale), height, depth if depth > max(0.5, 3 * sigma_m) else np.nan]),
        uvd_px=uvd,
        cov_uvd_px2=cov_uvd,
        cov_match_m2=J @ cov_uvd @ J.T,
        box_px=region.box_px,
        contour_px=region.contour_px,
        color=color,
    )


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
