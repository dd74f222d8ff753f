"""One region in metres, from surfaces made of points whose place is known."""

import numpy as np
import pytest
from stage_examples import TWIN, plane

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import triangulate
from roadblock.geometry.uncertainty import calibration_cov, moved_rig
from roadblock.kernels.reference.locate import FACE_PART
from roadblock.stages.rectify import plan_rectification
from roadblock.stages.triangulate import add_calibration_error, locate
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters
from roadblock.values.checks import FloatArray
from roadblock.values.scene import Obstacle, Region

GROUND = plane(1.5, 0.03, -0.02)
F, B = TWIN.f_px, TWIN.baseline_m


def region(points: FloatArray, sigma_d_px: float = 0.3) -> Region:
    """Return a region whose surface are these car-frame points, projected by hand."""
    x, y, z = points.T
    uvd = np.stack([(x + B / 2) * F / z + TWIN.cx_px, y * F / z + TWIN.cy_px, F * B / z], -1)
    contour = np.array([[10, 20], [10, 39], [29, 39], [29, 20]], np.int32)
    return Region((10, 20, 30, 40), contour, uvd, sigma_d_px, np.full(3, np.nan))


def wall(z: float, x0: float, x1: float, low: float, high: float, n: int = 41) -> FloatArray:
    """Return the points of an upright face on the road, between two heights over it."""
    x, h = (g.ravel() for g in np.meshgrid(np.linspace(x0, x1, n), np.linspace(low, high, n)))
    y = [GROUND.point_below(a, z)[1] + b / GROUND.normal[1] for a, b in zip(x, h, strict=True)]
    return np.stack([x, np.array(y), np.full(x.shape, z)], -1)


def slab(near: float, far: float) -> FloatArray:
    """Return the side of something long: equally many points at every depth."""
    return np.concatenate([wall(z, 1.0, 1.1, 0.2, 1.0, 9) for z in np.linspace(near, far, 101)])


def test_a_flat_face_is_measured_as_it_stands() -> None:
    found = locate(region(wall(8.0, -0.4, 1.0, 0.0, 1.6)), TWIN, GROUND, "red")
    assert found.range_m == pytest.approx(8.0)
    width, height, length = found.size_m
    assert width == pytest.approx(1.4, rel=0.03)
    assert height == pytest.approx(1.6, rel=0.03)
    assert np.isnan(length)
    foot = GROUND.point_below(0.3, 8.0)
    assert found.position_m == pytest.approx([8.0, -foot[0], -foot[1]])  # x forward, y left, z up
    assert found.color == "red"
    assert (found.label, found.box_px) == ("unknown", (10, 20, 30, 40))
    assert np.isnan(found.probability)
    np.testing.assert_array_equal(found.contour_px, [[10, 20], [10, 39], [29, 39], [29, 20]])


def test_the_foot_is_on_the_road_though_the_lowest_point_is_not() -> None:
    found = locate(region(wall(8.0, -0.4, 1.0, 0.7, 1.6)), TWIN, GROUND)
    x, y, z = found.position_m
    assert GROUND.height_of(np.array([-y, -z, x])) == pytest.approx(0, abs=1e-9)
    assert found.size_m[1] == pytest.approx(1.6, rel=0.03)


def test_without_a_road_the_lowest_point_is_the_foot() -> None:
    points = wall(8.0, -0.4, 1.0, 0.5, 1.6)
    found = locate(region(points), TWIN, None)
    assert found.position_m[2] == pytest.approx(-points[:, 1].max())
    assert found.size_m[1] == pytest.approx(np.ptp(points[:, 1]))


def test_the_range_is_the_tenth_percentile() -> None:
    """A mirror of 5 % of the surface does not count, nor does all that lies behind."""
    rng = np.random.default_rng(0)
    points = wall(9.0, -0.5, 0.5, 0.0, 1.5, 30)
    points = points[rng.permutation(len(points))]
    near, far = len(points) // 20, len(points) // 3
    points[:near] *= 8.0 / 9.0
    points[near : near + far] *= 9.7 / 9.0
    assert locate(region(points), TWIN, GROUND).range_m == pytest.approx(9.0, abs=1e-6)
    z = np.linspace(10, 20, 101)
    line = np.stack([0.1 * z, 0.05 * z, z], -1)
    assert locate(region(line), TWIN, GROUND).range_m == pytest.approx(11.0)


def test_the_middle_is_that_of_the_nearest_face() -> None:
    """A car seen at an angle: its rear face is narrow, its side goes on to the right."""
    rear = wall(8.0, -1.0, 0.6, 0.3, 1.4)
    side = np.concatenate(
        [wall(z, 0.6 + 0.2 * (z - 8), 0.65 + 0.2 * (z - 8), 0.3, 1.4, 8) for z in np.arange(8, 12, 0.2)]
    )
    found = locate(region(np.concatenate([rear, side])), TWIN, GROUND)
    assert found.position_m[1] == pytest.approx(0.2, abs=0.1)
    assert found.size_m[0] > 2.0


def test_a_depth_that_stands_out_is_the_length() -> None:
    visible = locate(region(slab(6.0, 10.0)), TWIN, GROUND)
    assert visible.size_m[2] == pytest.approx(4 * 0.85)  # 10th to 95th percentile
    # 30 m away three sigma are 4.3 m.
    assert np.isnan(locate(region(slab(30.0, 34.0), 0.15), TWIN, GROUND).size_m[2])
    assert locate(region(slab(30.0, 34.0), 0.02), TWIN, GROUND).size_m[2] == pytest.approx(4 * 0.85)
    assert np.isnan(locate(region(slab(6.0, 6.4), 0.01), TWIN, GROUND).size_m[2])


@pytest.mark.parametrize("sigma_d_px", [0.05, 0.3])
@pytest.mark.parametrize("z", [4.0, 8.0, 25.0])
def test_the_sigma_of_the_range_is_the_one_of_the_disparity_propagated(z: float, sigma_d_px: float) -> None:
    """And, beside it, what the detector's cut does to the nearest face."""
    found = locate(region(wall(z, 0.0, 1.0, 0.0, 1.0), sigma_d_px), TWIN, GROUND)
    face_m = FACE_PART * np.sqrt(found.size_m[0] * found.size_m[1])
    assert found.range_sigma_m == pytest.approx(np.hypot(z * z / (F * B) * sigma_d_px, face_m), rel=1e-9)
    assert found.cov_uvd_px2[2, 2] == pytest.approx(sigma_d_px**2 + (face_m * F * B / z**2) ** 2)


def test_the_nearest_face_of_what_is_deep_is_less_sure() -> None:
    flat, deep = (locate(region(points, 0.01), TWIN, GROUND) for points in (wall(6.0, 0, 1, 0, 1), slab(6.0, 10.0)))
    assert deep.range_sigma_m > 3 * flat.range_sigma_m


def test_the_measurement_lies_where_the_range_and_the_middle_are() -> None:
    found = locate(region(wall(8.0, -0.4, 1.0, 0.0, 1.6)), TWIN, GROUND)
    x, _, z = triangulate(TWIN, found.uvd_px)
    assert (x, z) == pytest.approx((0.3, 8.0))


MOUNTING = pose(rotation_from_rotvec([0.4, -0.9, 0.6]), [1.7, 0.3, 1.5])


@pytest.mark.parametrize("T_vehicle_car", [None, MOUNTING])
def test_the_covariance_is_the_one_of_samples(T_vehicle_car: FloatArray | None) -> None:
    found = locate(region(wall(8.0, 1.0, 2.0, 0.0, 1.6), 0.15), TWIN, GROUND, None, T_vehicle_car)
    rng = np.random.default_rng(1)
    u, v, d = rng.multivariate_normal(found.uvd_px, found.cov_uvd_px2, 100_000).T
    x, _, z = np.moveaxis(triangulate(TWIN, np.stack([u, v, d], -1)), -1, 0)
    road_y = (GROUND.normal[0] * x + GROUND.normal[2] * z + GROUND.height_m) / -GROUND.normal[1]
    car = np.stack([x, road_y + (v - found.uvd_px[1]) * z / F, z], -1)  # with a farther range, farther on the road
    axes = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]) if T_vehicle_car is None else T_vehicle_car[:3, :3]
    sampled = np.cov(car @ axes.T, rowvar=False)
    np.testing.assert_allclose(found.cov_match_m2, sampled, rtol=0.05, atol=0.02 * sampled.max())
    assert found.cov_match_m2 == pytest.approx(found.cov_match_m2.T)


def test_a_mounting_moves_the_place_and_not_the_range() -> None:
    plain: Obstacle = locate(region(wall(8.0, 1.0, 2.0, 0.0, 1.6)), TWIN, GROUND)
    mounted = locate(region(wall(8.0, 1.0, 2.0, 0.0, 1.6)), TWIN, GROUND, None, MOUNTING)
    foot = GROUND.point_below(1.5, 8.0)
    assert mounted.position_m == pytest.approx(MOUNTING[:3, :3] @ foot + MOUNTING[:3, 3])
    assert mounted.range_m == plain.range_m
    assert mounted.range_sigma_m == plain.range_sigma_m
    np.testing.assert_array_equal(mounted.size_m, plain.size_m)


def test_a_single_cell_is_as_wide_as_a_pixel() -> None:
    found = locate(region(np.array([[0.5, 0.9, 7.0]])), TWIN, GROUND)
    assert found.range_m == pytest.approx(7.0)
    assert found.size_m[0] == pytest.approx(7.0 / F)
    assert np.isnan(found.size_m[2])


def test_points_in_any_order_give_the_same_obstacle() -> None:
    points = np.concatenate([wall(8.0, -1.0, 0.6, 0.3, 1.4, 12), slab(8.0, 12.0)])
    shuffled = points[np.random.default_rng(0).permutation(len(points))]
    a, b = locate(region(points), TWIN, GROUND), locate(region(shuffled), TWIN, GROUND)
    assert a.range_m == b.range_m
    np.testing.assert_array_equal(a.size_m, b.size_m)


# --- what the calibration does ----------------------------------------------------------------------------------------

LENS = Camera((97, 61), 71.0, 64.0, 43.3, 33.9, "brown_conrady", [-0.25, 0.08, 2e-3, -3e-3, -0.01])
CROOKED = StereoRig(LENS, LENS, pose(rotation_from_rotvec([0.03, -0.04, 0.02]), [0.2, 0.01, -0.02]))
NAMES = rig_parameters(LENS, LENS)


def only_vergence(rig: StereoRig, sigma_rad: float) -> StereoRig:
    variances = np.where(np.array(NAMES) == "ry_rad", sigma_rad**2, 0.0)
    return StereoRig(rig.left, rig.right, rig.T_left_right, rig.T_vehicle_car, RigCovariance(NAMES, np.diag(variances)))


def two_obstacles(rig: StereoRig) -> list[Obstacle]:
    twin = plan_rectification(rig)
    uvd = [[20.0, 12.0, 0.9 * twin.f_px * twin.baseline_m / 8], [50.0, 31.0, twin.f_px * twin.baseline_m / 16]]
    contour = np.zeros((0, 2), np.int32)
    regions = [Region((0, 0, 9, 9), contour, np.array([each]), 0.2, np.full(3, np.nan)) for each in uvd]
    return [locate(each, twin, None, "red", rig.T_vehicle_car) for each in regions]


@pytest.mark.parametrize("T_vehicle_car", [None, MOUNTING])
def test_the_calibration_s_error_is_that_of_the_measured_point(T_vehicle_car: FloatArray | None) -> None:
    """One parameter alone: the covariance is the outer product of the displacement that this parameter causes."""
    sigma_rad = 1e-6
    rig = only_vergence(StereoRig(LENS, LENS, CROOKED.T_left_right, T_vehicle_car), sigma_rad)
    twin, plain = plan_rectification(rig), two_obstacles(rig)
    told = add_calibration_error(plain, twin, rig)
    turned = moved_rig(rig, sigma_rad * (np.array(NAMES) == "ry_rad"))
    axes = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]) if T_vehicle_car is None else T_vehicle_car[:3, :3]
    for before, after in zip(plain, told, strict=True):
        shift = seen_through(turned, rig, triangulate(twin, before.uvd_px)) - triangulate(twin, before.uvd_px)
        by_hand = np.outer(axes @ shift, axes @ shift)
        np.testing.assert_allclose(after.cov_calib_m2, by_hand, rtol=0, atol=1e-3 * by_hand.max())
        assert after.range_sigma_calib_m == pytest.approx(abs(shift[2]), rel=1e-3)
        np.testing.assert_array_equal(after.cov_match_m2, before.cov_match_m2)
        np.testing.assert_array_equal(after.position_m, before.position_m)
        assert (after.range_sigma_m, after.color) == (before.range_sigma_m, "red")


def seen_through(wrong: StereoRig, true: StereoRig, point_car: FloatArray) -> FloatArray:
    """Return where a point of the true rig's car frame is measured by the pipeline of a wrong rig."""
    twin = plan_rectification(true)
    half = np.array([true.baseline_m / 2, 0, 0])
    rays = [
        unproject(camera, project(true_camera, (point_car + sign * half) @ R)) @ R_wrong.T
        for camera, true_camera, R, R_wrong, sign in (
            (wrong.left, true.left, twin.R_rect_left, plan_rectification(wrong).R_rect_left, 1),
            (wrong.right, true.right, twin.R_rect_right, plan_rectification(wrong).R_rect_right, -1),
        )
    ]
    (a, b), (c, _) = (ray[:2] / ray[2] for ray in rays)
    z = wrong.baseline_m / (a - c)
    return np.array([a * z - wrong.baseline_m / 2, b * z, z])


def test_without_a_covariance_the_calibration_s_error_is_unknown() -> None:
    plain = two_obstacles(CROOKED)
    told = add_calibration_error(plain, plan_rectification(CROOKED), CROOKED)
    assert told == tuple(plain)
    assert all(np.isnan(obstacle.cov_calib_m2).all() for obstacle in told)
    assert all(np.isnan(obstacle.range_sigma_calib_m) for obstacle in told)
    sure = only_vergence(CROOKED, 1e-4)
    assert add_calibration_error([], plan_rectification(sure), sure) == ()


def test_a_rig_known_exactly_has_no_error_of_calibration() -> None:
    exact = only_vergence(CROOKED, 0.0)
    for obstacle in add_calibration_error(two_obstacles(exact), plan_rectification(exact), exact):
        np.testing.assert_array_equal(obstacle.cov_calib_m2, np.zeros((3, 3)))
        assert obstacle.range_sigma_calib_m == 0


def test_the_error_is_the_one_of_the_whole_rig_s_covariance() -> None:
    names = rig_parameters(LENS, LENS)
    rig = StereoRig(LENS, LENS, CROOKED.T_left_right, None, RigCovariance(names, 1e-8 * np.eye(len(names))))
    twin = plan_rectification(rig)
    first, second = add_calibration_error(two_obstacles(rig), twin, rig)
    cov = calibration_cov(rig, triangulate(twin, [first.uvd_px, second.uvd_px]))
    assert [first.range_sigma_calib_m, second.range_sigma_calib_m] == pytest.approx(np.sqrt(cov[:, 2, 2]))
    assert first.range_sigma_calib_m < second.range_sigma_calib_m
