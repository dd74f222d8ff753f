"""Pose algebra: equation 3 and the rule `p_a = T_a_b @ p_b`."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from roadblock.geometry.pose import (
    R_VEHICLE_CAR,
    inverse,
    pose,
    rotation_from_rotvec,
    rotvec_from_rotation,
    skew,
    transform,
    vehicle_from_car,
)

steady = settings(max_examples=150, deadline=None, derandomize=True)
close = {"rtol": 0, "atol": 1e-12}


def rodrigues(rotvec: np.ndarray) -> np.ndarray:
    """The rotation formula by hand: I + sin a [k] + (1 - cos a) [k]^2."""
    angle = np.linalg.norm(rotvec)
    x, y, z = rotvec / angle if angle > 0 else rotvec
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + 2 * np.sin(angle / 2) ** 2 * k @ k


@st.composite
def rotvecs(draw: st.DrawFn) -> np.ndarray:
    """Any axis; angles also at and near 0 and pi."""
    axis = np.array([0.3, -0.2, 1.3]) + draw(st.tuples(*[st.floats(-1, 1)] * 3))
    near = st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 1e-4, np.pi - 1e-4, np.pi - 1e-8, np.pi])
    return axis / np.linalg.norm(axis) * draw(near | st.floats(0, np.pi))


@st.composite
def poses(draw: st.DrawFn) -> np.ndarray:
    return pose(rodrigues(draw(rotvecs())), draw(st.tuples(*[st.floats(-10, 10)] * 3)))


points = st.tuples(*[st.floats(-10, 10)] * 3).map(np.array)


def test_equation_3_by_hand() -> None:
    R = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]])  # a quarter turn about z
    T = pose(R, [[1.0], [2.0], [3.0]])  # a column, as the paper writes it
    np.testing.assert_array_equal(T, [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    np.testing.assert_array_equal(T @ [5, 7, 11, 1], [-7 + 1, 5 + 2, 11 + 3, 1])
    np.testing.assert_array_equal(transform(T, [5, 7, 11]), [-6, 7, 14])


@steady
@given(poses(), points)
def test_transform_is_the_homogeneous_product(T: np.ndarray, p: np.ndarray) -> None:
    many = np.stack([p, -p, 2 * p + 1]).reshape(3, 1, 3)
    by_hand = [[(T @ [*q, 1])[:3] for q in row] for row in many]
    np.testing.assert_allclose(transform(T, many), by_hand, **close)


@steady
@given(poses())
def test_inverse(T: np.ndarray) -> None:
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), **close)
    np.testing.assert_allclose(T @ inverse(T), np.eye(4), **close)
    np.testing.assert_allclose(inverse(T), np.linalg.inv(T), **close)


@steady
@given(poses(), poses(), poses(), points)
def test_poses_compose(T_a_b: np.ndarray, T_b_c: np.ndarray, T_c_d: np.ndarray, p_d: np.ndarray) -> None:
    np.testing.assert_allclose((T_a_b @ T_b_c) @ T_c_d, T_a_b @ (T_b_c @ T_c_d), **close)
    stepwise = transform(T_a_b, transform(T_b_c, transform(T_c_d, p_d)))
    np.testing.assert_allclose(transform(T_a_b @ T_b_c @ T_c_d, p_d), stepwise, **close)
    np.testing.assert_allclose(inverse(T_a_b @ T_b_c), inverse(T_b_c) @ inverse(T_a_b), **close)


@steady
@given(rotvecs())
def test_rotation_vectors(rotvec: np.ndarray) -> None:
    R = rotation_from_rotvec(rotvec)
    np.testing.assert_allclose(R, rodrigues(rotvec), **close)
    np.testing.assert_allclose(R.T @ R, np.eye(3), **close)
    back = rotvec_from_rotation(R)
    assert np.linalg.norm(back) <= np.pi + 1e-12
    np.testing.assert_allclose(rotation_from_rotvec(back), R, **close)
    if np.linalg.norm(rotvec) < np.pi - 1e-9:  # at pi both signs name one rotation
        np.testing.assert_allclose(back, rotvec, rtol=0, atol=1e-12)


def test_a_rotation_vector_turns_right_handed() -> None:
    np.testing.assert_allclose(rotation_from_rotvec([[0], [0], [np.pi / 2]]) @ [1, 0, 0], [0, 1, 0], **close)


def test_unknown_stays_unknown() -> None:
    moved = transform(pose(R_VEHICLE_CAR, [1, 2, 3]), [[np.nan, 1, 2], [4, 5, 6]])
    assert np.isnan(moved[0]).any()
    np.testing.assert_array_equal(moved[1], [6 + 1, -4 + 2, -5 + 3])


def test_the_vehicle_frame_is_the_car_frame_re_axed_until_a_mounting_is_known() -> None:
    right, down, forward = np.eye(3)
    T = vehicle_from_car(None)
    np.testing.assert_array_equal(transform(T, [forward, -right, -down]), np.eye(3))
    assert np.linalg.det(R_VEHICLE_CAR) == pytest.approx(1)
    mounted = pose(R_VEHICLE_CAR, [1.6, 0.1, 1.2])
    np.testing.assert_array_equal(vehicle_from_car(mounted), mounted)


def test_inputs_stay_as_they_are() -> None:
    R, t = np.eye(3), np.ones(3)
    T = pose(R, t)
    T[0, 0] = T[0, 3] = 9
    inverse(T), transform(T, t)
    np.testing.assert_array_equal(R, np.eye(3))
    np.testing.assert_array_equal(t, np.ones(3))


@pytest.mark.parametrize("shape", [(3,), (0, 3), (2, 4, 3)])
def test_a_skew_matrix_is_the_cross_product(shape: tuple[int, ...]) -> None:
    a, b = np.random.default_rng(3).normal(size=(2, *shape))
    assert skew(a).shape == (*shape, 3)
    np.testing.assert_allclose((skew(a) @ b[..., None])[..., 0], np.cross(a, b), **close)
