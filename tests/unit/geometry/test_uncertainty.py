"""What an error of the rig does to points: against rigs that are really moved, rectified and triangulated anew."""

from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import RigError, ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations, triangulate
from roadblock.geometry.uncertainty import (
    calibration_cov,
    calibration_jacobian,
    moved_rig,
    range_sigma,
    rectified_jacobian,
    seen_points,
)
from roadblock.values.camera import Camera, Rectification, RigCovariance, StereoRig, rig_parameters

SIZE = (97, 61)
CAMERAS = {
    "pinhole": Camera(SIZE, 71.0, 64.0, 43.3, 33.9),
    "brown5": Camera(SIZE, 73.0, 66.0, 52.1, 27.4, "brown_conrady", [-0.31, 0.11, 2e-3, -3e-3, -0.01]),
    "brown8": Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [0.9, 0.4, -2e-3, 1e-3, 0.05, 1.2, 0.5, 0.06]),
    "kannala_brandt": Camera(SIZE, 51.0, 46.0, 43.3, 33.9, "kannala_brandt", [0.06, -0.03, 0.01, -0.002]),
}
CROOKED = pose(rotation_from_rotvec([0.05, -0.08, 0.04]), [0.2, 0.015, -0.03])
PAIRS = pytest.mark.parametrize(
    ("left", "right"),
    [("pinhole", "brown5"), ("brown5", "brown5"), ("brown8", "kannala_brandt"), ("kannala_brandt", "brown8")],
)


def rig_of(left: str, right: str, T_left_right: np.ndarray = CROOKED) -> StereoRig:
    return StereoRig(CAMERAS[left], CAMERAS[right], T_left_right)


def with_covariance(rig: StereoRig, seed: int = 3, scale: float = 1.0) -> StereoRig:
    """A full covariance with correlations: 0.2 px, 1e-3 of coefficients, 0.02 deg, 0.2 mm."""
    names = rig_parameters(rig.left, rig.right)
    sigma = [
        0.2 if n.endswith("_px") else 3e-4 if n.endswith("_rad") else 2e-4 if n.endswith("_m") else 1e-3 for n in names
    ]
    p = len(names)
    A = np.random.default_rng(seed).normal(size=(p, 2 * p)) * np.array(sigma)[:, None] * scale / np.sqrt(2 * p)
    C = A @ A.T
    return replace(rig, covariance=RigCovariance(names, (C + C.T) / 2))


def scattered(count: int = 12, seed: int = 5) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.c_[rng.uniform(-0.3, 0.3, (count, 2)), np.ones(count)] * rng.uniform(2, 40, (count, 1))


def seen_with(wrong: StereoRig, true: StereoRig, points_car: np.ndarray) -> np.ndarray:
    """Points of the true rig's car frame, measured through the wrong rig: its rectification, its triangulation."""
    R_left, R_right = rectifying_rotations(true.T_left_right)
    half = np.array([true.baseline_m / 2, 0, 0])
    raw_left = project(true.left, (points_car + half) @ R_left)
    raw_right = project(true.right, (points_car - half) @ R_right)
    R_left, R_right = rectifying_rotations(wrong.T_left_right)
    twin = Rectification(83.0, 41.7, 34.2, wrong.baseline_m, SIZE)
    twin_camera = Camera(SIZE, 83.0, 83.0, 41.7, 34.2)
    left = project(twin_camera, unproject(wrong.left, raw_left) @ R_left.T)
    right = project(twin_camera, unproject(wrong.right, raw_right) @ R_right.T)
    return triangulate(twin, np.c_[left, left[:, 0] - right[:, 0]])


# --- moved rigs -------------------------------------------------------------------------------------------------------


def test_a_moved_rig_by_hand() -> None:
    rig = with_covariance(replace(rig_of("brown5", "kannala_brandt"), T_vehicle_car=pose(np.eye(3), [1, 2, 3])))
    delta = np.arange(1, 24) * 1e-3  # 9 + 8 + 6
    moved = moved_rig(rig, delta)
    assert moved.left.fx_px == 73.0 + 0.001
    assert moved.left.cy_px == 27.4 + 0.004
    np.testing.assert_allclose(moved.left.distortion - rig.left.distortion, [0.005, 0.006, 0.007, 0.008, 0.009])
    assert moved.right.fy_px == 46.0 + 0.011
    np.testing.assert_allclose(moved.right.distortion - rig.right.distortion, [0.014, 0.015, 0.016, 0.017])
    np.testing.assert_allclose(moved.T_left_right[:3, 3], [0.221, 0.037, -0.007], rtol=0, atol=1e-15)
    turn = moved.T_left_right[:3, :3] @ rig.T_left_right[:3, :3].T  # multiplied from the left
    np.testing.assert_allclose(turn, rotation_from_rotvec([0.018, 0.019, 0.020]), rtol=0, atol=1e-15)
    assert moved.covariance is rig.covariance
    np.testing.assert_array_equal(moved.T_vehicle_car, rig.T_vehicle_car)


def test_a_rig_that_is_not_moved_stays() -> None:
    rig = rig_of("brown5", "brown8")
    moved = moved_rig(rig, np.zeros(27))
    np.testing.assert_allclose(moved.T_left_right, rig.T_left_right, rtol=0, atol=1e-16)
    assert moved.right.parameters == rig.right.parameters


def test_a_rig_cannot_be_moved_beyond_what_one_can_be() -> None:
    rig = rig_of("pinhole", "pinhole")
    with pytest.raises(ValueRefusedError, match="fx_px must be > 0"):
        moved_rig(rig, np.r_[-100, np.zeros(13)])
    with pytest.raises(RigError, match="to the LEFT"):
        moved_rig(rig, np.r_[np.zeros(11), -0.5, 0, 0])
    with pytest.raises(ValueRefusedError, match="must have shape"):
        moved_rig(rig, np.zeros(15))


# --- the Jacobian -----------------------------------------------------------------------------------------------------


@PAIRS
def test_the_jacobian_against_rigs_that_are_moved(left: str, right: str) -> None:
    rig, points = rig_of(left, right), scattered()
    J = calibration_jacobian(rig, points)
    names = rig_parameters(rig.left, rig.right)
    assert J.shape == (12, 3, len(names))
    for i, name in enumerate(names):
        step = np.zeros(len(names))
        step[i] = 1e-5
        near, far = (
            seen_with(moved_rig(rig, k * step), rig, points) - seen_with(moved_rig(rig, -k * step), rig, points)
            for k in (1, 2)
        )
        slope = (8 * near - far) / 12e-5
        np.testing.assert_allclose(J[..., i], slope, rtol=0, atol=1e-6 * np.abs(slope).max() + 1e-6, err_msg=name)


def test_the_jacobian_of_rectified_images_is_the_paper_s_formula() -> None:
    f, B = 83.0, 0.2
    camera = Camera(SIZE, f, f, 41.7, 34.2)
    rig = StereoRig(camera, camera, pose(np.eye(3), [B, 0, 0]))
    dz = dict(zip(rig_parameters(camera, camera), calibration_jacobian(rig, [[1.0, -0.5, 20.0]])[0, 2], strict=True))
    assert dz["right.cx_px"] == pytest.approx(-(20.0**2) / (f * B))  # one pixel of disparity: Z^2 / (f B)
    assert dz["left.cx_px"] == pytest.approx(20.0**2 / (f * B))
    assert dz["tx_m"] == pytest.approx(20.0 / B)  # Z = f B / d
    # The right camera turned to the right by r looks at b = x/z + (1 + b^2) r; the car frame stays.
    b = (1.0 - B / 2) / 20.0
    assert dz["ry_rad"] == pytest.approx(20.0**2 / B * (1 + b * b), rel=1e-6)


def test_a_hundredth_of_a_degree_of_vergence_moves_20_m_by_a_third_of_a_metre() -> None:
    camera = Camera((1280, 720), 1033.0, 1033.0, 639.5, 359.5)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    J = calibration_jacobian(rig, [[0.0, 0.0, z] for z in (5.0, 10.0, 20.0)])
    shift = np.abs(J[:, 2, rig_parameters(camera, camera).index("ry_rad")]) * np.deg2rad(0.01)
    np.testing.assert_allclose(shift, [0.0213, 0.0852, 0.3405], rtol=2e-3)


def test_rows_differ_by_what_the_rectified_slopes_say() -> None:
    rig = rig_of("brown5", "kannala_brandt")
    points = scattered(6)
    delta = np.random.default_rng(2).normal(size=23) * 1e-7
    change = rectified_jacobian(rig, points) @ delta
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    moved = moved_rig(rig, delta)
    sides = zip(
        (rig.left, rig.right),
        (moved.left, moved.right),
        (R_left, R_right),
        rectifying_rotations(moved.T_left_right),
        (0.5, -0.5),
        strict=True,
    )
    for i, (camera, moved_camera, R, R_moved, sign) in enumerate(sides):
        in_rect = points + np.array([sign * rig.baseline_m, 0, 0])
        rays = unproject(moved_camera, project(camera, in_rect @ R)) @ R_moved.T
        shift = rays[:, :2] / rays[:, 2:] - in_rect[:, :2] / in_rect[:, 2:]
        np.testing.assert_allclose(change[:, i], shift, rtol=0, atol=1e-5 * np.abs(shift).max())


def test_points_that_a_camera_does_not_see_are_unknown() -> None:
    rig = with_covariance(rig_of("brown5", "kannala_brandt"))
    points = np.array([[0.1, 0.2, 5.0], [0.1, 0.2, -5.0], [np.nan, 0.0, 5.0], [90.0, 0.0, 1.0], [np.inf, 0.0, 9.0]])
    for unknown in (calibration_jacobian(rig, points), calibration_cov(rig, points), rectified_jacobian(rig, points)):
        assert np.isfinite(unknown[0]).all()
        assert np.isnan(unknown[1:]).all()
    assert calibration_jacobian(rig, np.zeros((0, 3))).shape == (0, 3, 23)


# --- the covariance ---------------------------------------------------------------------------------------------------


def test_the_covariance_against_sampled_rigs() -> None:
    rig = with_covariance(rig_of("brown8", "kannala_brandt"), scale=0.05)
    assert rig.covariance is not None
    points = scattered(4)
    rng = np.random.default_rng(11)
    draws = rng.multivariate_normal(np.zeros(len(rig.covariance.names)), rig.covariance.matrix, 300, method="eigh")
    errors = np.array([seen_with(moved_rig(rig, delta), rig, points) - points for delta in draws])
    stated = calibration_cov(rig, points)
    for i in range(4):
        sampled = np.cov(errors[:, i].T)
        whiten = np.linalg.inv(np.linalg.cholesky(stated[i]))
        np.testing.assert_allclose(np.linalg.eigvalsh(whiten @ sampled @ whiten.T), 1, rtol=0, atol=0.25)


def test_without_a_covariance_nothing_is_known() -> None:
    rig = rig_of("brown5", "brown5")
    assert calibration_cov(rig, scattered(3)).shape == (3, 3, 3)
    assert np.isnan(calibration_cov(rig, scattered(3))).all()
    assert np.isnan(range_sigma(rig, 20.0)).all()


# --- over the image ---------------------------------------------------------------------------------------------------


@PAIRS
def test_seen_points_are_where_the_left_camera_looks(left: str, right: str) -> None:
    rig = rig_of(left, right)
    points = seen_points(rig, 17.0, 3, 4)
    assert points.shape == (3, 4, 3)
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    half = np.array([rig.baseline_m / 2, 0, 0])
    raw_left = project(rig.left, (points + half) @ R_left)
    raw_right = project(rig.right, (points - half) @ R_right)
    known = np.isfinite(points[..., 0])
    assert known.sum() >= 6
    u, v = np.meshgrid((np.arange(4) + 0.5) * 97 / 4 - 0.5, (np.arange(3) + 0.5) * 61 / 3 - 0.5)
    np.testing.assert_allclose(raw_left[known], np.stack([u, v], -1)[known], rtol=0, atol=1e-9)
    np.testing.assert_allclose(points[known][:, 2], 17.0, rtol=1e-14)
    assert (raw_right[known] >= -0.5).all()
    assert (raw_right[known] <= [96.5, 60.5]).all()


def test_a_right_camera_turned_away_sees_one_side_only() -> None:
    turned = pose(rotation_from_rotvec([0, 0.5, 0]), [0.2, 0, 0])  # to the right
    seen = np.isfinite(seen_points(rig_of("pinhole", "pinhole", turned), 20.0)[..., 0])
    assert not seen[:, 0].any()
    assert seen[:, -2].all()
    near = np.isfinite(seen_points(rig_of("pinhole", "pinhole"), 0.3)[..., 0])
    far = np.isfinite(seen_points(rig_of("pinhole", "pinhole"), 30.0)[..., 0])
    assert near.sum() < far.sum()  # what is near and left in the left image is outside the right one


def test_what_lies_more_than_60_degrees_aside_is_not_ahead() -> None:
    """An equidistant lens has angle = radius / f: the columns look 73, 36, 0, -36, -73 degrees aside."""
    camera = Camera((501, 101), 160.0, 160.0, 250.0, 50.0, "kannala_brandt", np.zeros(4))
    points = seen_points(StereoRig(camera, camera, pose(np.eye(3), [0.2, 0, 0])), 20.0, 1, 5)
    np.testing.assert_array_equal(np.isnan(points[0, :, 0]), [True, False, False, False, True])
    np.testing.assert_allclose(points[0, 3], [20 * np.tan(100.2 / 160) - 0.1, 0, 20], rtol=0, atol=1e-9)


def test_the_range_sigma_over_the_image() -> None:
    rig = with_covariance(rig_of("brown5", "kannala_brandt"))
    points = seen_points(rig, 20.0)
    sigma = range_sigma(rig, 20.0)
    assert sigma.shape == (5, 7)
    np.testing.assert_array_equal(np.isnan(sigma), np.isnan(points[..., 0]))
    i, j = np.argwhere(np.isfinite(sigma))[-1]
    assert rig.covariance is not None
    by_hand = calibration_jacobian(rig, points[i, j][None])[0, 2]
    assert sigma[i, j] == pytest.approx(np.sqrt(by_hand @ rig.covariance.matrix @ by_hand))
    assert np.nanmedian(range_sigma(rig, 40.0)) > 3 * np.nanmedian(sigma)  # grows with the square


def test_a_rig_known_exactly_has_no_range_sigma() -> None:
    rig = rig_of("brown5", "brown5")
    names = rig_parameters(rig.left, rig.right)
    sigma = range_sigma(replace(rig, covariance=RigCovariance(names, np.zeros((24, 24)))), 20.0, 2, 2)
    np.testing.assert_array_equal(sigma, np.zeros((2, 2)))
