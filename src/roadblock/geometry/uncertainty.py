"""What an error of the rig's parameters does to measured points, and what its covariance makes of them."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, rotvec_from_rotation, transform
from roadblock.geometry.projection import parameter_jacobian, project, project_jacobian, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, finite

STEP = 1e-4
"""Radians, and share of the baseline, for the slopes of the rectifying rotations; their error is its square."""

WIDEST_DEG = 60.0
"""Angle from straight ahead, across or down, up to which points count as seen: there rectified images end."""


def moved_rig(rig: StereoRig, delta: ArrayLike) -> StereoRig:
    """Return the rig whose parameters differ by `delta`.

    Parameters
    ----------
    rig
        The rig; its covariance and mounting are kept.
    delta
        (p,) in the order and units of `values.camera.rig_parameters`; the rotation turns as
        `R_left_right <- exp([r]) R_left_right`.

    Raises
    ------
    RigError, ValueRefusedError
        If there is no such rig.
    """
    counts = [len(camera.parameters) for camera in (rig.left, rig.right)]
    delta = finite("delta", delta, (sum(counts) + 6,))
    of_left, of_right, r, t = np.split(delta, np.cumsum([*counts, 3]))
    T = rig.T_left_right
    T_moved = pose(rotation_from_rotvec(r) @ T[:3, :3], T[:3, 3] + t)
    return replace(
        rig, left=_moved_camera(rig.left, of_left), right=_moved_camera(rig.right, of_right), T_left_right=T_moved
    )


def _moved_camera(camera: Camera, delta: FloatArray) -> Camera:
    fx, fy, cx, cy = np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]) + delta[:4]
    return replace(camera, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=camera.distortion + delta[4:])


def calibration_jacobian(rig: StereoRig, points_car: ArrayLike) -> FloatArray:
    """Return how triangulated points change with the rig's parameters while their raw pixels stay.

    The rig is rectified anew with the changed parameters, and the point triangulated from u and v of the left
    rectified image and `d = u_left - u_right` (eqs. 4 and 8). How a lens turns the ray behind a fixed pixel follows
    from the implicit function theorem.

    Parameters
    ----------
    rig
        The nominal rig.
    points_car
        (n, 3) in its car frame, metres.

    Returns
    -------
    (n, 3, p) d(x, y, z) / d(parameters), metres per unit of `values.camera.rig_parameters`; NaN for points that are
    NaN or that a camera does not project.
    """
    points = np.asarray(points_car, float)
    slopes = rectified_jacobian(rig, points)
    x, y, z = (points[:, i, None] for i in range(3))
    B = rig.baseline_m
    d_baseline = np.zeros(slopes.shape[-1])
    d_baseline[-3:] = rig.T_left_right[:3, 3] / B
    with np.errstate(all="ignore"):
        dz = z / B * (d_baseline - z * (slopes[:, 0, 0] - slopes[:, 1, 0]))
        dx = slopes[:, 0, 0] * z + (x + B / 2) / z * dz - d_baseline / 2
        dy = slopes[:, 0, 1] * z + y / z * dz
    return np.stack([dx, dy, dz], 1)


def rectified_jacobian(rig: StereoRig, points_car: ArrayLike) -> FloatArray:
    """Return how rectified positions change with the rig's parameters while the raw pixels stay.

    Parameters
    ----------
    rig, points_car
        As in `calibration_jacobian`.

    Returns
    -------
    (n, 2, 2, p) d(x/z, y/z) / d(parameters) in the left and in the right rectified camera; times the focal length it
    is in pixels. NaN for points that are NaN or that a camera does not project.
    """
    points = np.asarray(points_car, float)
    half = (rig.baseline_m / 2, 0.0, 0.0)
    first, second = (len(camera.parameters) for camera in (rig.left, rig.right))
    turns = _rectification_slopes(rig)
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    slopes = np.zeros((len(points), 2, 2, first + second + 6))
    slopes[:, 0, :, :first], slopes[:, 0, :, -6:] = _view_slopes(rig.left, R_left, points + half, turns[0])
    slopes[:, 1, :, first:-6], slopes[:, 1, :, -6:] = _view_slopes(rig.right, R_right, points - half, turns[1])
    return np.where(np.isfinite(slopes).all((1, 2, 3), keepdims=True), slopes, np.nan)


@lru_cache(maxsize=64)
def _rectification_slopes(rig: StereoRig) -> FloatArray:
    """Derive `rectifying_rotations` by the pose's 6 parameters: (2, 3, 6) turns w, `dR = [w] R`, rad/rad and rad/m."""
    T = rig.T_left_right
    turns: list[list[FloatArray]] = [[], []]
    for axis, step in zip(np.eye(6), np.repeat([STEP, STEP * rig.baseline_m], 3), strict=True):
        ends = [
            rectifying_rotations(pose(rotation_from_rotvec(s[:3]) @ T[:3, :3], T[:3, 3] + s[3:]))
            for s in (step * axis, -step * axis)
        ]
        for side, (ahead, behind) in zip(turns, zip(*ends, strict=True), strict=True):
            side.append(rotvec_from_rotation(ahead @ behind.T) / (2 * step))
    return np.stack([np.stack(side, -1) for side in turns])


def _view_slopes(
    camera: Camera, R_rect: FloatArray, points_rect: FloatArray, turns: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Derive x/z, y/z in a rectified camera at fixed raw pixels: (n, 2, 4 + k) by the camera, (n, 2, 6) by the pose."""
    with np.errstate(all="ignore"):
        points = points_rect @ R_rect  # in the camera's own frame
        by_point, by_parameter = project_jacobian(camera, points), parameter_jacobian(camera, points)
        across = by_point @ by_point.swapaxes(-1, -2)
        a, b, c = across[:, 0, 0], across[:, 0, 1], across[:, 1, 1]
        inverse_2x2 = np.stack([c, -b, -b, a], -1).reshape(-1, 2, 2) / (a * c - b * b)[:, None, None]
        x, y, z = points_rect.T
        zero = 0 * z
        look = np.stack([1 / z, zero, -x / z**2, zero, 1 / z, -y / z**2], -1).reshape(-1, 2, 3)
        # 0 = by_point dp + by_parameter dk; the part of dp along the ray does not matter.
        bend = -look @ R_rect @ by_point.swapaxes(-1, -2) @ inverse_2x2 @ by_parameter
        turn = look @ np.cross(turns.T[None], points_rect[:, None]).swapaxes(-1, -2)
        return bend, turn


def calibration_cov(rig: StereoRig, points_car: ArrayLike) -> FloatArray:
    """Return the covariance of triangulated points from the rig's own uncertainty: a bias, the same every frame.

    Parameters
    ----------
    rig
        The rig.
    points_car
        (n, 3) in its car frame, metres.

    Returns
    -------
    (n, 3, 3) in the car frame, m^2; NaN where the rig has no covariance or the point is none (see
    `calibration_jacobian`).
    """
    if rig.covariance is None:
        return np.full((len(np.asarray(points_car)), 3, 3), np.nan)
    J = calibration_jacobian(rig, points_car)
    return np.asarray(J @ rig.covariance.matrix @ J.swapaxes(-1, -2))


def seen_points(rig: StereoRig, distance_m: float, rows: int = 5, columns: int = 7) -> FloatArray:
    """Return points `distance_m` ahead, seen at the centres of equal areas of the left raw image.

    Parameters
    ----------
    rig
        The rig.
    distance_m
        Forward distance in the car frame, metres.
    rows, columns
        Areas down and across the image.

    Returns
    -------
    (rows, columns, 3) in the car frame, metres; NaN where the left lens looks nowhere ahead or more than
    `WIDEST_DEG` aside, or the point is outside the right image.
    """
    width, height = rig.left.size_px
    u, v = np.meshgrid((np.arange(columns) + 0.5) / columns * width, (np.arange(rows) + 0.5) / rows * height)
    R_left, _ = rectifying_rotations(rig.T_left_right)
    rays = unproject(rig.left, np.stack([u - 0.5, v - 0.5], -1)) @ R_left.T
    with np.errstate(all="ignore"):
        slopes = rays / np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan)
        inside = np.abs(slopes).max(-1, keepdims=True) <= np.tan(np.radians(WIDEST_DEG))
        points_rect = np.where(inside, slopes, np.nan) * distance_m
        u, v = np.moveaxis(project(rig.right, transform(inverse(rig.T_left_right), points_rect @ R_left)), -1, 0)
        seen = (np.abs(u - (width - 1) / 2) <= width / 2) & (np.abs(v - (height - 1) / 2) <= height / 2)
        return np.where(seen[..., None], points_rect - (rig.baseline_m / 2, 0, 0), np.nan)


def range_sigma(rig: StereoRig, distance_m: float, rows: int = 5, columns: int = 7) -> FloatArray:
    """Return the standard deviation of the forward distance over the left raw image, from the rig's covariance.

    Parameters
    ----------
    rig, distance_m, rows, columns
        As in `seen_points`.

    Returns
    -------
    (rows, columns) metres, rows from the image's top; NaN where `seen_points` is, or the rig has no covariance.
    """
    points = seen_points(rig, distance_m, rows, columns).reshape(-1, 3)
    variance = calibration_cov(rig, points)[:, 2, 2].reshape(rows, columns)
    return np.asarray(np.sqrt(np.maximum(variance, 0)))  # rounding may leave -1e-20 where nothing is uncertain
