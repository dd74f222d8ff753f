"""Triangulate: Regions in, Obstacles out: metres in the vehicle frame, with what noise and calibration do to them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from roadblock.geometry.pose import vehicle_from_car
from roadblock.geometry.stereo import triangulate
from roadblock.geometry.uncertainty import calibration_cov
from roadblock.kernels.compiled import locate as kernels
from roadblock.kernels.reference.locate import FIGURES
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray, finite, locked, positive, unchecked
from roadblock.values.scene import (
    NEAREST_FACE_PERCENT,
    UNRECOGNIZED,
    GroundPlane,
    Obstacle,
    Region,
    road_numbers,
)


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
    r, road = rectification, road_numbers(ground)
    surfaces, sigmas = zip(*map(measured_surface, regions), strict=True)
    bounds = np.cumsum([0, *map(len, surfaces)]).astype(np.int32)
    figures, feet = np.empty((len(regions), 8)), np.empty((len(regions), FIGURES))
    kernels.measure_surfaces(np.concatenate(surfaces), bounds, r.numbers, road, NEAREST_FACE_PERCENT / 100, figures)
    cut = np.ones(len(regions))
    for i, region in enumerate(regions):
        if region.refined is not None:
            figures[i, 0], cut[i] = r.f_px * r.baseline_m / region.refined.nearest_d_px, 0
    kernels.place_feet(figures, np.array(sigmas), cut, r.numbers, road, vehicle_from_car(T_vehicle_car), feet)
    # What `Obstacle` checks of one, of all at once.
    positive("range_m", float(figures[:, 0].min()))
    positions_m = finite("position_m", feet[:, :3], (-1, 3))
    feet = locked(feet)
    sizes_m, uvd_px, covs = feet[:, 4:7], feet[:, 7:10], feet[:, 10:].reshape(-1, 2, 3, 3)
    ranges_m, sigmas_m = figures[:, 0].tolist(), feet[:, 3].tolist()
    return [
        unchecked(
            Obstacle,
            position_m=positions_m[i],
            range_m=ranges_m[i],
            range_sigma_m=sigmas_m[i],
            size_m=sizes_m[i],
            uvd_px=uvd_px[i],
            cov_uvd_px2=covs[i, 0],
            cov_match_m2=covs[i, 1],
            box_px=region.box_px,
            contour_px=region.contour_px,
            color=colors[i],
            is_seen_through=region.is_seen_through,
            **UNRECOGNIZED,
        )
        for i, region in enumerate(regions)
    ]


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
