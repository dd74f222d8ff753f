"""Two calibrations of one rig: what differs in the images and in ranges, and whether chance explains it."""

from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincc

from roadblock.errors import RigError
from roadblock.geometry.pose import rotvec_from_rotation
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.geometry.uncertainty import calibration_cov, rectified_jacobian, seen_points
from roadblock.values.calibration import RANGES_M
from roadblock.values.camera import POSE_PARAMETERS, Camera, StereoRig, rig_parameters
from roadblock.values.checks import FloatArray

FAR_M = 1e6
"""Where disparities are zero to the last digit that matters."""

SAME_LENS_PX, OTHER_LENS_PX = 0.001, 0.05
"""Differences over the image (root mean square) that no covariance has to explain: what is left of a change beyond its
linear part, and what lies between two lens models that were fitted to one lens."""

POSE_FLOOR = 1e-6
"""The same for the pose, radians and metres."""


@dataclass(frozen=True, eq=False)
class RangeChange:
    """What one distance shows of a change.

    Attributes
    ----------
    distance_m
        Forward distance, metres; infinity is among them.
    range_m
        (rows, columns) measured through the first rig minus true by the second one, metres, over the left image;
        infinity where a point is seen behind infinity, NaN where not both cameras see it and at infinity.
    range_sigma_m
        (rows, columns) its standard deviation if nothing has changed, metres; NaN where unknown.
    row_px
        (rows, columns) left row minus right row after the first rig's rectification, pixels; NaN as above.
    """

    distance_m: float
    range_m: FloatArray
    range_sigma_m: FloatArray
    row_px: FloatArray


@dataclass(frozen=True, eq=False)
class RigChange:
    """What lies between two calibrations, if the second one is true and the first one is used.

    Attributes
    ----------
    at
        One entry per distance, the last at infinity.
    disparity_px
        (rows, columns) disparity of what is infinitely far, pixels of a rectified image of the left camera's focal
        length; NaN where not both cameras see it.
    disparity_mean_px, disparity_mean_sigma_px
        Its mean, and the standard deviation of that if nothing has changed; NaN where unknown.
    names, change, sigma
        Names of the parameters that both rigs have, (p,) by how much the second rig's differ, and the standard
        deviation of that if nothing has changed (NaN where unknown).
    p
        Probability of images, or of poses where both rigs have one lens model, as different as these or more if nothing
        has changed; NaN where one of the rigs has no covariance.
    """

    at: tuple[RangeChange, ...]
    disparity_px: FloatArray
    disparity_mean_px: float
    disparity_mean_sigma_px: float
    names: tuple[str, ...]
    change: FloatArray
    sigma: FloatArray
    p: float


def compare_rigs(used: StereoRig, true: StereoRig, rows: int = 5, columns: int = 7) -> RigChange:
    """Compare two calibrations of one rig, made independently of each other.

    The test looks at bearing, row, disparity and row difference at the centres of equal areas, at the nearest of
    `RANGES_M` and at infinity, which needs no common lens model; and at the relative pose if there is one. The smaller
    of the two probabilities counts, doubled because there were two (Bonferroni).

    Parameters
    ----------
    used, true
        The calibrations, of one image size.
    rows, columns
        Areas down and across the left image.

    Raises
    ------
    RigError
        If their image sizes differ, or nothing is seen by both rigs.
    """
    if used.left.size_px != true.left.size_px:
        sizes = " and ".join("x".join(map(str, rig.left.size_px)) for rig in (used, true))
        raise RigError(f"rigs can be compared at one image size, but these are for {sizes}: calibrate both at one")
    points = {z: seen_points(true, z, rows, columns) for z in (*RANGES_M, FAR_M)}
    off = {z: _offsets(used, true, points[z].reshape(-1, 3)).reshape(rows, columns, 4) for z in points}
    if not np.isfinite(off[FAR_M]).any():
        raise RigError("the two rigs see nothing in common: these are not two calibrations of one rig")
    names, change, sigma = _parameter_change(used, true)
    tested = (RANGES_M[0], FAR_M)
    mean_sigma_px, p = _significance(
        used,
        true,
        np.stack([points[z] for z in tested]).reshape(-1, 3),
        np.stack([off[z] for z in tested]).reshape(-1, 4),
        SAME_LENS_PX if len(names) > len(POSE_PARAMETERS) else OTHER_LENS_PX,
    )
    if len(names) > len(POSE_PARAMETERS) and used.covariance is not None and true.covariance is not None:
        pose_cov = (used.covariance.matrix + true.covariance.matrix)[-6:, -6:]
        p = min(1.0, 2 * p, 2 * _chance(change[-6:], pose_cov, POSE_FLOOR))
    disparity_px = off[FAR_M][..., 2]
    return RigChange(
        tuple(_at(used, true, z, points[z], off[z]) for z in points),
        disparity_px,
        float(np.nanmean(disparity_px)),
        mean_sigma_px,
        names,
        change,
        sigma,
        p,
    )


def _offsets(used: StereoRig, true: StereoRig, points_car: FloatArray) -> FloatArray:
    """Return by how many pixels points (n, 3) of the true car frame are off in the images that the used rig rectifies.

    (n, 4): bearing across and down as seen from the car, disparity, left minus right row. NaN where a camera does not
    see the point.
    """
    half = np.array([true.baseline_m / 2, 0.0, 0.0])
    R_left, R_right = rectifying_rotations(true.T_left_right)
    U_left, U_right = rectifying_rotations(used.T_left_right)
    left = unproject(used.left, project(true.left, (points_car + half) @ R_left)) @ U_left.T
    right = unproject(used.right, project(true.right, (points_car - half) @ R_right)) @ U_right.T
    x, y, z = points_car.T
    with np.errstate(all="ignore"):
        left, right = left / np.where(left[:, 2:] > 0, left[:, 2:], np.nan), right / right[:, 2:]
        across = (left[:, 0] + right[:, 0]) / 2 - x / z
        disparity = left[:, 0] - right[:, 0] - used.baseline_m / z
        off = np.stack([across, left[:, 1] - y / z, disparity, left[:, 1] - right[:, 1]], -1)
    return np.where(np.isfinite(off).all(1, keepdims=True), off * used.left.fx_px, np.nan)


def _offset_slopes(rig: StereoRig, points_car: FloatArray, f_px: float) -> FloatArray:
    """Derive `_offsets` by the used rig's parameters, (n, 4, p)."""
    left, right = rectified_jacobian(rig, points_car).swapaxes(0, 1)
    d_baseline = np.zeros(left.shape[-1])
    d_baseline[-3:] = rig.T_left_right[:3, 3] / rig.baseline_m
    disparity = left[:, 0] - right[:, 0] - d_baseline / points_car[:, 2:]
    return f_px * np.stack([(left[:, 0] + right[:, 0]) / 2, left[:, 1], disparity, left[:, 1] - right[:, 1]], 1)


def _significance(
    used: StereoRig, true: StereoRig, points_car: FloatArray, off_px: FloatArray, floor_px: float
) -> tuple[float, float]:
    """Return the standard deviation of the mean disparity of far points, and the chance of `off_px` (n, 4), or more."""
    if used.covariance is None or true.covariance is None:
        return float("nan"), float("nan")
    f_px = used.left.fx_px
    known = np.isfinite(off_px).all(1)
    points, off = points_car[known], off_px[known]
    shifted = points + np.pad(off[:, :2], ((0, 0), (0, 1))) / f_px * points[:, 2:]  # where the used rig sees them
    cov = np.zeros((off.size, off.size))
    for rig, covariance, at in ((used, used.covariance, shifted), (true, true.covariance, points)):
        slopes = np.nan_to_num(_offset_slopes(rig, at, f_px)).reshape(off.size, -1)
        cov += slopes @ covariance.matrix @ slopes.T
    far = np.repeat(points[:, 2] > RANGES_M[-1], 4) & (np.arange(off.size) % 4 == 2)
    mean_variance = np.maximum(cov[np.ix_(far, far)].mean(), 0)
    return float(np.sqrt(mean_variance)), _chance(off.ravel(), cov, floor_px)


def _chance(off: FloatArray, cov: FloatArray, floor: float) -> float:
    """Return the probability of `off` (n,), or more, by its covariance and a floor on the root mean square.

    There are fewer directions than numbers: each is weighed by the share of its variance that is not the floor, and
    chi-square is fitted to the mean and the variance of the weighted sum (Satterthwaite).
    """
    variance, axes = np.linalg.eigh(cov)
    variance = np.maximum(variance, 0)
    whole = variance + floor**2 * off.size
    distance = float(((axes.T @ off) ** 2 / whole).sum())
    share = variance / whole
    freedom = float(share.sum())
    if freedom < 1e-6:  # both rigs are known exactly
        return float(distance < 1)
    unit = float((share**2).sum()) / freedom
    return float(gammaincc(freedom / unit / 2, distance / unit / 2))


def _parameter_change(used: StereoRig, true: StereoRig) -> tuple[tuple[str, ...], FloatArray, FloatArray]:
    """Return names, differences and their standard deviations: of all parameters, or the pose's where lenses differ."""
    R_used, R_true = used.T_left_right[:3, :3], true.T_left_right[:3, :3]
    change = np.r_[rotvec_from_rotation(R_true @ R_used.T), (true.T_left_right - used.T_left_right)[:3, 3]]
    names: tuple[str, ...] = POSE_PARAMETERS
    if rig_parameters(used.left, used.right) == rig_parameters(true.left, true.right):
        names = rig_parameters(used.left, used.right)
        pairs = ((used.left, true.left), (used.right, true.right))
        change = np.r_[*(_values(after) - _values(before) for before, after in pairs), change]
    if used.covariance is None or true.covariance is None:
        return names, change, np.full(len(names), np.nan)
    variance = [rig.matrix.diagonal()[-len(names) :] for rig in (used.covariance, true.covariance)]
    return names, change, np.sqrt(variance[0] + variance[1])


def _values(camera: Camera) -> FloatArray:
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])


def _at(used: StereoRig, true: StereoRig, z: float, points: FloatArray, off_px: FloatArray) -> RangeChange:
    if z == FAR_M:
        unknown = np.full(points.shape[:2], np.nan)
        return RangeChange(float("inf"), unknown, unknown, off_px[..., 3])
    inverse = 1 / z + off_px[..., 2] / (used.left.fx_px * used.baseline_m)
    first, second = (calibration_cov(rig, points.reshape(-1, 3))[:, 2, 2] for rig in (used, true))
    with np.errstate(all="ignore"):
        range_m = np.asarray(np.where(inverse <= 0, np.inf, 1 / inverse - z))
    return RangeChange(z, range_m, np.sqrt(np.maximum(first + second, 0)).reshape(points.shape[:2]), off_px[..., 3])
