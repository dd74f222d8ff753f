"""How sure the rig itself is of the turn that the self-check measures, and the rig that a found turn proposes."""

from dataclasses import replace

import numpy as np

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.geometry.uncertainty import moved_rig
from roadblock.stages.selfcheck.epipolar import turn_slopes
from roadblock.values.camera import RigCovariance, StereoRig, rig_parameters
from roadblock.values.checks import FloatArray
from roadblock.values.drift import RigDrift

DISTANCES_M = (6.0, 12.0, 25.0, 50.0)
"""At which a drive's features are taken to be."""
GRID = (6, 8)
"""Rows and columns of their positions in the left image."""


def turn_covariance(rig: StereoRig) -> FloatArray:
    """Return the covariance of the apparent turn that the rig's own uncertainty makes, rad^2.

    Returns
    -------
    (4, 4) of pitch, yaw as image expansion sees it, roll, and yaw as vertical disparities see it; NaN where the rig has
    no covariance.

    Notes
    -----
    Each parameter is moved by one of its sigmas, and what would be seen is looked at through the nominal rig.
    """
    if rig.covariance is None:
        return np.full((4, 4), np.nan)
    sigma = np.sqrt(rig.covariance.matrix.diagonal())
    J = np.zeros((4, len(sigma)))
    for index in np.flatnonzero(sigma):
        step = np.zeros(len(sigma))
        step[index] = sigma[index]
        ends = [apparent_turn(rig, moved_rig(rig, s * step)) for s in (1, -1)]
        J[:, index] = (ends[0] - ends[1]) / (2 * sigma[index])
    return np.asarray(J @ rig.covariance.matrix @ J.T)


def apparent_turn(rig: StereoRig, true: StereoRig) -> FloatArray:
    """Return pitch, yaw (expansion), roll, yaw (vertical disparities) that pictures of `true` show by `rig`, rad."""
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    width, height = rig.left.size_px
    u, v = np.meshgrid(
        *(np.linspace(0.05, 0.95, n) * (size - 1) for n, size in zip(GRID[::-1], (width, height), strict=True))
    )
    rays = unproject(true.left, np.stack([u, v], -1).reshape(-1, 2))
    points = np.concatenate([rays * distance for distance in DISTANCES_M])
    with np.errstate(all="ignore"):
        left = unproject(rig.left, project(true.left, points)) @ R_left.T
        right = unproject(rig.right, project(true.right, transform(inverse(true.T_left_right), points))) @ R_right.T
        left, right = left[:, :2] / left[:, 2:], right[:, :2] / right[:, 2:]
        z = (points @ R_left.T)[:, 2]
    seen = np.isfinite(left + right).all(1)
    left, right, true_d = left[seen], right[seen], rig.baseline_m / z[seen]
    by_u, by_v = turn_slopes(right)
    pitch, epipolar_yaw, roll = np.linalg.lstsq(by_v, right[:, 1] - left[:, 1], rcond=None)[0]
    # The drive's length is free, and takes all that scales disparities.
    A = np.stack([true_d, -by_u[:, 1]], -1)
    too_large = left[:, 0] - right[:, 0] - true_d + by_u[:, 0] * pitch + by_u[:, 2] * roll
    return np.array([pitch, np.linalg.lstsq(A, too_large, rcond=None)[0][1], roll, epipolar_yaw])


def proposed_rig(rig: StereoRig, drift: RigDrift) -> StereoRig:
    """Return the rig with its right camera turned as the self-check found it; what is unknown stays.

    The proposal is for whoever decides; nothing applies it by itself. Its covariance, where the rig has one, grows by
    that of the found turn. The distance and direction between the cameras stay.
    """
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    turn = np.radians(np.nan_to_num(drift.turn_deg))
    T = pose(R_left.T @ rotation_from_rotvec(turn) @ R_right, rig.T_left_right[:3, 3])
    if rig.covariance is None:
        return replace(rig, T_left_right=T)
    matrix = rig.covariance.matrix.copy()
    at = rig_parameters(rig.left, rig.right).index("rx_rad")
    matrix[at : at + 3, at : at + 3] += R_left.T @ np.radians(np.radians(np.nan_to_num(drift.cov_deg2))) @ R_left
    return replace(rig, T_left_right=T, covariance=RigCovariance(rig.covariance.names, matrix))
