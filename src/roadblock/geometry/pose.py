"""Poses as 4x4 matrices `T_a_b`: `p_a = T_a_b @ p_b`, inner letters cancel (the paper's eqs. 3 and 6-7)."""

import numpy as np
import scipy
from numpy.typing import ArrayLike

from roadblock.values.checks import FloatArray

R_VEHICLE_CAR = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Car axes (x right, y down, z forward) seen in vehicle axes (x forward, y left, z up; ISO 8855, REP 103)."""


def pose(R: ArrayLike, t: ArrayLike) -> FloatArray:
    """Return the 4x4 `T_a_b` of a 3x3 rotation `R_a_b` and the origin of b in a, `t` (3,) in metres (eq. 3)."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = np.ravel(np.asarray(t, float))
    return T


def inverse(T_a_b: FloatArray) -> FloatArray:
    """Return `T_b_a`."""
    R = T_a_b[:3, :3].T
    return pose(R, -R @ T_a_b[:3, 3])


def transform(T_a_b: FloatArray, points_b: ArrayLike) -> FloatArray:
    """Return points (..., 3) of frame b in frame a (eqs. 3 and 6); NaN stays NaN."""
    return np.asarray(points_b, float) @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def rotation_from_rotvec(rotvec_rad: ArrayLike) -> FloatArray:
    """Return the 3x3 rotation by `|rotvec|` radians about `rotvec` (3,)."""
    return scipy.spatial.transform.Rotation.from_rotvec(np.array(rotvec_rad, float).reshape(3)).as_matrix()


def rotvec_from_rotation(R: ArrayLike) -> FloatArray:
    """Return the rotation vector (3,) of a 3x3 rotation, radians, at most pi long."""
    return scipy.spatial.transform.Rotation.from_matrix(np.array(R, float)).as_rotvec()


def skew(vectors: ArrayLike) -> FloatArray:
    """Return the matrices (..., 3, 3) of the cross product with vectors (..., 3)."""
    x, y, z = np.moveaxis(np.asarray(vectors, float), -1, 0)
    zero = 0 * x
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)


def vehicle_from_car(T_vehicle_car: FloatArray | None) -> FloatArray:
    """Return `T_vehicle_car`, or the plain change of axes where no mounting is known."""
    return pose(R_VEHICLE_CAR, np.zeros(3)) if T_vehicle_car is None else T_vehicle_car
