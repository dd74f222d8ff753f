"""Equations 6-8: the two cameras together, rectification, triangulation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, rotvec_from_rotation, transform
from roadblock.geometry.projection import project
from roadblock.geometry.stereo import (
    car_from_cameras,
    image_from_car,
    image_jacobian,
    left_from_right,
    rectifying_rotations,
    right_from_left,
    triangulate,
    triangulate_jacobian,
)
from roadblock.values.camera import Camera, Rectification, StereoRig

SIZE = (97, 61)
TWIN = Rectification(f_px=83.0, cx_px=41.7, cy_px=34.2, baseline_m=0.205, size_px=SIZE)
steady = settings(max_examples=120, deadline=None, derandomize=True)

points = st.tuples(st.floats(-8, 8), st.floats(-5, 5), st.floats(0.7, 60)).map(np.array)
measurements = st.tuples(st.floats(-20, 120), st.floats(-20, 80), st.floats(0.05, 60)).map(np.array)


@st.composite
def crooked_poses(draw: st.DrawFn) -> np.ndarray:
    """T_left_right turned up to 0.2 rad about each axis, baseline up to 40 deg off the x axis."""
    R = rotation_from_rotvec(draw(st.tuples(*[st.floats(-0.2, 0.2)] * 3)))
    t = np.array([1, draw(st.floats(-0.6, 0.6)), draw(st.floats(-0.6, 0.6))]) * draw(st.floats(0.01, 1.5))
    return pose(R, t)


def crooked_rig() -> StereoRig:
    left = Camera(SIZE, 71.0, 64.0, 43.3, 33.9)
    right = Camera(SIZE, 69.0, 73.0, 52.1, 27.4)
    return StereoRig(left, right, pose(rotation_from_rotvec([0.03, -0.05, 0.02]), [0.2, 0.01, -0.03]))


# --- equations 6 and 7 ------------------------------------------------------------------------------------------------


def test_equations_6_and_7_by_hand() -> None:
    rig = crooked_rig()
    R_s, (T1, T2, T3) = rig.T_left_right[:3, :3], rig.T_left_right[:3, 3]
    X_r = np.array([0.4, -0.3, 7.0])
    X_l = [R_s[0] @ X_r + T1, R_s[1] @ X_r + T2, R_s[2] @ X_r + T3]
    np.testing.assert_allclose(left_from_right(rig, X_r), X_l, rtol=0, atol=1e-14)
    np.testing.assert_allclose(right_from_left(rig, X_l), X_r, rtol=0, atol=1e-14)
    np.testing.assert_allclose(left_from_right(rig, [0, 0, 0]), [0.2, 0.01, -0.03], rtol=0, atol=1e-15)


# --- equation 8 -------------------------------------------------------------------------------------------------------


def test_equation_8_is_the_mean_of_both_camera_coordinates() -> None:
    in_left, in_right = np.array([1.0, 2.0, 30.0]), np.array([0.8, 2.0, 30.0])
    np.testing.assert_allclose(car_from_cameras(in_left, in_right), [0.9, 2.0, 30.0], rtol=0, atol=1e-15)


def test_equation_8_is_exact_after_rectification_only() -> None:
    half_degree = pose(rotation_from_rotvec([0, np.deg2rad(0.5), 0]), [0.205, 0, 0])
    point, aside = np.array([0.0, 0.0, 20.0]), np.array([0.1025, 0, 0])
    in_left, in_right = point + aside, transform(inverse(half_degree), point + aside)
    assert abs(car_from_cameras(in_left, in_right) - point).max() == pytest.approx(0.087, abs=0.001)
    R_left, R_right = rectifying_rotations(half_degree)
    # The car frame then hangs at the optical centres' midpoint, in rectified axes.
    by_hand = R_left @ (in_left - aside)
    np.testing.assert_allclose(car_from_cameras(R_left @ in_left, R_right @ in_right), by_hand, rtol=0, atol=1e-12)


@steady
@given(points)
def test_triangulation_is_equations_4_and_8_by_hand(point: np.ndarray) -> None:
    x, y, z = point
    f, B = TWIN.f_px, TWIN.baseline_m
    u_left, u_right = f * (x + B / 2) / z + TWIN.cx_px, f * (x - B / 2) / z + TWIN.cx_px
    uvd = [u_left, f * y / z + TWIN.cy_px, u_left - u_right]
    np.testing.assert_allclose(image_from_car(TWIN, point), uvd, rtol=0, atol=1e-9)
    exact = [uvd[0], uvd[1], f * B / z]
    np.testing.assert_allclose(triangulate(TWIN, exact), point, rtol=1e-12, atol=1e-12)


@steady
@given(measurements)
def test_triangulate_and_image_from_car_are_inverse(uvd: np.ndarray) -> None:
    np.testing.assert_allclose(image_from_car(TWIN, triangulate(TWIN, uvd)), uvd, rtol=0, atol=1e-9)


@steady
@given(points)
def test_image_from_car_and_triangulate_are_inverse(point: np.ndarray) -> None:
    np.testing.assert_allclose(triangulate(TWIN, image_from_car(TWIN, point)), point, rtol=0, atol=1e-9)


@steady
@given(measurements, st.floats(0.1, 10))
def test_a_longer_baseline_scales_the_world(uvd: np.ndarray, factor: float) -> None:
    longer = Rectification(TWIN.f_px, TWIN.cx_px, TWIN.cy_px, TWIN.baseline_m * factor, SIZE)
    np.testing.assert_allclose(triangulate(longer, uvd), factor * triangulate(TWIN, uvd), rtol=1e-12, atol=1e-12)


def test_half_the_disparity_is_twice_the_distance() -> None:
    near, far = triangulate(TWIN, [[50, 40, 8], [50, 40, 4]])
    assert far[2] == 2 * near[2] == pytest.approx(2 * 83 * 0.205 / 8)


def test_a_disparity_without_a_point_is_nan() -> None:
    uvd = [[50, 40, 0], [50, 40, -1], [50, 40, np.nan]]
    assert np.isnan(triangulate(TWIN, uvd)).all()
    assert np.isnan(triangulate_jacobian(TWIN, uvd)).all()
    assert np.isnan(image_from_car(TWIN, [[1, 1, 0], [1, 1, -4], [0, 0, -1e-300], [1, 1, np.nan]])).all()


def test_extreme_measurements_do_not_warn() -> None:
    extremes = [0.0, 5e-324, 1e-200, 1.0, 41.7, 1e200, 1.7e308, np.inf, -np.inf, np.nan]
    uvd = np.stack(np.meshgrid(extremes, extremes, extremes), -1)
    assert triangulate(TWIN, uvd).shape == image_from_car(TWIN, uvd).shape == (10, 10, 10, 3)
    assert triangulate_jacobian(TWIN, uvd).shape == (10, 10, 10, 3, 3)


@steady
@given(measurements)
def test_triangulate_jacobian_by_complex_steps(uvd: np.ndarray) -> None:
    f, B, cx, cy, h = TWIN.f_px, TWIN.baseline_m, TWIN.cx_px, TWIN.cy_px, 1e-30

    def by_hand(u: complex, v: complex, d: complex) -> np.ndarray:
        return np.array([(u - cx) * B / d - B / 2, (v - cy) * B / d, f * B / d])

    columns = [by_hand(*(uvd + 1j * h * axis)).imag / h for axis in np.eye(3)]
    np.testing.assert_allclose(triangulate_jacobian(TWIN, uvd), np.stack(columns, -1), rtol=1e-10, atol=1e-14)
    two = triangulate_jacobian(TWIN, [uvd, 2 * uvd])
    np.testing.assert_array_equal(two[0], triangulate_jacobian(TWIN, uvd))


# --- rectification ----------------------------------------------------------------------------------------------------


@steady
@given(crooked_poses(), st.integers(0, 2**32 - 1))
def test_rectified_rows_are_epipolar_lines(T_left_right: np.ndarray, seed: int) -> None:
    R_rect_left, R_rect_right = rectifying_rotations(T_left_right)
    B = np.linalg.norm(T_left_right[:3, 3])
    twin = Camera(SIZE, 83.0, 83.0, 41.7, 34.2)
    rng = np.random.default_rng(seed)
    z = rng.uniform(3 * B, 60, 50)
    in_rect = np.c_[rng.uniform(-0.6, 0.6, (50, 2)) * z[:, None], z]
    in_left = in_rect @ R_rect_left
    in_right = transform(inverse(T_left_right), in_left)
    left, right = project(twin, in_left @ R_rect_left.T), project(twin, in_right @ R_rect_right.T)
    np.testing.assert_allclose(left[:, 1], right[:, 1], rtol=0, atol=1e-9)
    disparity = left[:, 0] - right[:, 0]
    assert (disparity > 0).all()
    np.testing.assert_allclose(disparity, 83 * B / z, rtol=0, atol=1e-9)
    uvd = np.c_[left, disparity]
    rectification = Rectification(83.0, 41.7, 34.2, B, SIZE, R_rect_left, R_rect_right)
    np.testing.assert_allclose(triangulate(rectification, uvd), in_rect - [B / 2, 0, 0], rtol=1e-9, atol=1e-9)


@steady
@given(crooked_poses())
def test_rectifying_rotations_are_the_smallest_that_do(T_left_right: np.ndarray) -> None:
    R_left, R_right = rectifying_rotations(T_left_right)
    for R in (R_left, R_right):
        np.testing.assert_allclose(R @ R.T, np.eye(3), rtol=0, atol=1e-12)
        assert np.linalg.det(R) > 0
    B = np.linalg.norm(T_left_right[:3, 3])
    np.testing.assert_allclose(R_left @ T_left_right[:3, 3], [B, 0, 0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(R_left @ T_left_right[:3, :3] @ R_right.T, np.eye(3), rtol=0, atol=1e-12)
    half = rotation_from_rotvec(rotvec_from_rotation(T_left_right[:3, :3]) / 2)
    turn = R_left @ half
    np.testing.assert_allclose(turn, R_right @ half.T, rtol=0, atol=1e-12)  # both cameras share the load
    assert abs(rotvec_from_rotation(turn)[0]) < 1e-12  # and the turn has no part about the baseline


def test_parallel_cameras_stay_as_they_are() -> None:
    for R in rectifying_rotations(pose(np.eye(3), [0.2, 0, 0])):
        np.testing.assert_array_equal(R, np.eye(3))


def test_rotations_stay_right_for_a_baseline_just_off_the_axis() -> None:
    for tiny in (1e-300, 1e-160, 1e-15, 1e-9):
        R_left, _ = rectifying_rotations(pose(np.eye(3), [0.2, tiny, -tiny]))
        np.testing.assert_allclose(R_left @ R_left.T, np.eye(3), rtol=0, atol=1e-12)
        np.testing.assert_allclose(R_left, np.eye(3), rtol=0, atol=2e-8)


@given(measurements)
@steady
def test_the_derivatives_of_both_ways_are_inverse(uvd: np.ndarray) -> None:
    there, back = triangulate_jacobian(TWIN, uvd), image_jacobian(TWIN, triangulate(TWIN, uvd))
    np.testing.assert_allclose(back @ there, np.eye(3), atol=1e-6)


def test_there_is_no_derivative_behind_the_cameras() -> None:
    J = image_jacobian(TWIN, [[1.0, 2.0, -3.0], [1.0, 2.0, np.nan], [1.0, 2.0, 3.0]])
    assert np.isnan(J[:2]).all()
    assert np.isfinite(J[2]).all()
