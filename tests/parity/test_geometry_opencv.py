"""Our lenses and rectifying rotations against OpenCV's, on crooked cameras."""

import cv2
import numpy as np
import pytest

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.values.camera import Camera

SIZE = (97, 61)
BROWN = [
    [-0.31, 0.11, 2e-3, -3e-3, -0.01],
    [0.12, -0.08, -4e-3, 1e-3, 0.03],
    [0.9, 0.4, -2e-3, 1e-3, 0.05, 1.2, 0.5, 0.06],
    [-0.2, 0.1, 1e-3, 2e-3, -0.02, 0.1, 0.05, -0.01],
]
FISHEYE = [[0.06, -0.03, 0.01, -0.002], [-0.02, 0.004, -0.003, 0.0005]]
EXACT = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 500, 1e-15)


def scattered_points(seed: int, spread: float, count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(seed)
    z = rng.uniform(0.4, 70, (count, 1))
    return np.c_[rng.uniform(-spread, spread, (count, 2)) * z, z]


@pytest.mark.parametrize("k", BROWN)
def test_brown_conrady_projects_as_opencv_does(k: list[float]) -> None:
    camera = Camera(SIZE, 171.0, 164.0, 43.3, 33.9, "brown_conrady", k)
    points = scattered_points(1, 0.45)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.K, np.array(k))
    np.testing.assert_allclose(project(camera, points), theirs[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("k", BROWN)
def test_brown_conrady_projects_posed_points_as_opencv_does(k: list[float]) -> None:
    camera = Camera(SIZE, 171.0, 164.0, 43.3, 33.9, "brown_conrady", k)
    rotvec, t = np.array([0.11, -0.07, 0.4]), np.array([0.3, -0.2, 1.1])
    points = scattered_points(2, 0.3)
    theirs, _ = cv2.projectPoints(points, rotvec, t, camera.K, np.array(k))
    T = pose(rotation_from_rotvec(rotvec), t)
    np.testing.assert_allclose(project(camera, points @ T[:3, :3].T + t), theirs[:, 0], rtol=0, atol=1e-9)


def undistort_points(pixels: np.ndarray, K: np.ndarray, k: np.ndarray) -> np.ndarray:
    """OpenCV's undistortion, iterated to the end; version 4 has that under a name of its own."""
    if "undistortPointsIter" in dir(cv2):
        return cv2.undistortPointsIter(pixels[:, None], K, k, np.eye(3), np.eye(3), EXACT)[:, 0]
    return cv2.undistortPoints(pixels[:, None], K, k, None, None, None, EXACT)[:, 0]


@pytest.mark.parametrize("k", BROWN)
def test_brown_conrady_undistorts_as_opencv_does(k: list[float]) -> None:
    camera = Camera(SIZE, 171.0, 164.0, 43.3, 33.9, "brown_conrady", k)
    pixels = np.random.default_rng(3).uniform((-0.5, -0.5), (96.5, 60.5), (300, 2))
    theirs = undistort_points(pixels, camera.K, np.array(k))
    rays = unproject(camera, pixels)
    ours = rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(ours * 171, theirs * 171, rtol=0, atol=1e-9)


@pytest.mark.parametrize("k", FISHEYE)
def test_kannala_brandt_projects_as_opencv_does(k: list[float]) -> None:
    camera = Camera(SIZE, 31.0, 27.0, 43.3, 33.9, "kannala_brandt", k)
    points = scattered_points(4, 4.0)  # up to 80 degrees aside
    theirs, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.K, np.array(k))
    np.testing.assert_allclose(project(camera, points), theirs[:, 0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("k", FISHEYE)
def test_kannala_brandt_undistorts_as_opencv_does(k: list[float]) -> None:
    camera = Camera(SIZE, 61.0, 57.0, 43.3, 33.9, "kannala_brandt", k)
    pixels = np.random.default_rng(5).uniform((0, 0), (96, 60), (300, 2))
    theirs = cv2.fisheye.undistortPoints(pixels[:, None], camera.K, np.array(k), None, None, None, EXACT)[:, 0]
    rays = unproject(camera, pixels)
    ours = rays[:, :2] / rays[:, 2:]
    np.testing.assert_allclose(ours * 61, theirs * 61, rtol=0, atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_rectifying_rotations_are_opencv_s(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_left_right = pose(rotation_from_rotvec(rng.uniform(-0.1, 0.1, 3)), [0.3, *rng.uniform(-0.08, 0.08, 2)])
    T_right_left = inverse(T_left_right)  # OpenCV: x_right = R x_left + T
    K = np.array([[833.0, 0, 631.0], [0, 821.0, 352.0], [0, 0, 1]])
    none = np.zeros(5)
    R_left, R_right, P_left, P_right, *_ = cv2.stereoRectify(
        K, none, K, none, (1280, 720), np.ascontiguousarray(T_right_left[:3, :3]), T_right_left[:3, 3:].copy()
    )
    ours = rectifying_rotations(T_left_right)
    np.testing.assert_allclose(ours[0], R_left, rtol=0, atol=1e-9)
    np.testing.assert_allclose(ours[1], R_right, rtol=0, atol=1e-9)
    baseline = -P_right[0, 3] / P_left[0, 0]
    assert baseline == pytest.approx(np.linalg.norm(T_left_right[:3, 3]), abs=1e-9)
