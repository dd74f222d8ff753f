"""Crooked rigs for the tests: 97x61, fx != fy, off-centre, rotated about all axes."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from roadblock.values.camera import Camera, Lens, RigCovariance, StereoRig, rig_parameters

SIZE_PX = (97, 61)
COEFFICIENTS = {
    "pinhole": [],
    "brown_conrady": [-0.27, 0.11, 0.0021, -0.0013, -0.017],
    "rational": [-0.27, 0.11, 0.0021, -0.0013, -0.017, 0.03, -0.02, 0.004],
    "radtan": [-0.27, 0.11, 0.0021, -0.0013, 0.0],
    "kannala_brandt": [0.031, -0.011, 0.0042, -0.0007],
}
LENS_OF: dict[str, Lens] = {
    "pinhole": "pinhole",
    "brown_conrady": "brown_conrady",
    "rational": "brown_conrady",
    "radtan": "brown_conrady",
    "kannala_brandt": "kannala_brandt",
}


def pose(rotvec, t):
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotvec).as_matrix()
    T[:3, 3] = t
    return T


def crooked_camera(lens, scale=1.0):
    d = np.array(COEFFICIENTS[lens])
    return Camera(SIZE_PX, 81.3 * scale, 77.9 / scale, 44.2 * scale, 33.1, LENS_OF[lens], d * scale)


def crooked_rig(left="brown_conrady", right=None, mounting=False, rotvec=(0.021, -0.034, 0.017)):
    """The right camera sits right of, below and behind the left one, turned about all axes."""
    return StereoRig(
        crooked_camera(left),
        crooked_camera(right or left, 1.03),
        pose(rotvec, (0.205, 0.0113, -0.0071)),
        pose((1.1, -0.7, 0.4), (1.2, -0.1, 1.4)) if mounting else None,
    )


def sure_rig(rig, seed=4):
    """The rig with a covariance that has correlations and units of every size, and one parameter held fixed."""
    names = rig_parameters(rig.left, rig.right)
    sigma = [0.13 if n.endswith("_px") else 1.7e-4 if n.endswith(("_rad", "_m")) else 0.0023 for n in names]
    A = np.random.default_rng(seed).normal(size=(len(names), 40)) * np.array(sigma)[:, None] / np.sqrt(40)
    A[2] = 0
    C = A @ A.T
    return replace(rig, covariance=RigCovariance(names, (C + C.T) / 2))


def assert_same(a, b, tolerance=1e-9):
    for one, two in ((a.left, b.left), (a.right, b.right)):
        assert (one.size_px, one.lens) == (two.size_px, two.lens)
        np.testing.assert_allclose(one.K, two.K, rtol=0, atol=tolerance)
        np.testing.assert_allclose(one.distortion, two.distortion, rtol=0, atol=tolerance)
    np.testing.assert_allclose(a.T_left_right, b.T_left_right, rtol=0, atol=tolerance)
    assert (a.T_vehicle_car is None) == (b.T_vehicle_car is None)
    if a.T_vehicle_car is not None:
        np.testing.assert_allclose(a.T_vehicle_car, b.T_vehicle_car, rtol=0, atol=tolerance)
