"""The mounting: from roads and ways to T_vehicle_car."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from stage_examples import TWIN, plane

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import inverse, pose, transform
from roadblock.geometry.stereo import image_from_car
from roadblock.sim.render import render
from roadblock.sim.scene import camera_pose
from roadblock.sim.scenes import SCENES
from roadblock.stages.mount import (
    AXLE_M,
    FLAT_AT_M,
    FLAT_RISE_M,
    Measured,
    Odometer,
    Seen,
    Step,
    _solve,
    find_mounting,
    mean_in_time,
    travel,
    why_left_out,
)
from roadblock.stages.rectify import RectifySettings, plan_rectification, rectify
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import GroundPlane, Health

CAR_IN_VEHICLE = np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
HEIGHT_M, YAW, PITCH, ROLL = 1.37, np.radians(4.0), np.radians(6.0), np.radians(-3.0)


def mounted(forward_m: float = 0.0, left_m: float = 0.0) -> FloatArray:
    """T_vehicle_car by ISO 8855's own angles: yaw, then pitch, then roll, each about the turned axis."""
    R = Rotation.from_euler("ZYX", [YAW, PITCH, ROLL]).as_matrix() @ CAR_IN_VEHICLE
    return pose(R, [forward_m, left_m, HEIGHT_M])


def road_under(T_vehicle_car: FloatArray) -> GroundPlane:
    return GroundPlane(T_vehicle_car[:3, :3].T @ [0, 0, 1], float(T_vehicle_car[2, 3]))


def seen(*grounds: GroundPlane) -> list[Seen]:
    return [Seen(i, ground) for i, ground in enumerate(grounds)]


def ways(T_axle_car: FloatArray, arc_m: float, curvatures_per_m: list[float]) -> list[Step]:
    """Steps of a vehicle whose rear axle runs on arcs, as the car frame sees them."""
    steps = []
    for i, k in enumerate(curvatures_per_m):
        turn = k * arc_m
        at = [np.sin(turn) / k, (1 - np.cos(turn)) / k, 0] if k else [arc_m, 0, 0]
        moved = pose(Rotation.from_rotvec([0, 0, turn]).as_matrix(), at)
        steps.append(Step(i + 1, inverse(T_axle_car) @ moved @ T_axle_car))
    return steps


def degrees(measured: Measured) -> float:
    return float(np.degrees(measured.value))


@pytest.mark.parametrize("forward_m", [0.0, 1.9])
@pytest.mark.parametrize("backwards", [False, True])
def test_an_exact_straight_drive_gives_the_exact_mounting(forward_m: float, backwards: bool) -> None:
    truth = mounted(forward_m, -0.2)
    steps = ways(truth, -0.8 if backwards else 0.8, [0.0] * 5)
    found = find_mounting(seen(*[road_under(truth)] * 6), TWIN, steps, forward_m=forward_m, left_m=-0.2)
    np.testing.assert_allclose(found.T_vehicle_car, truth, rtol=0, atol=1e-12)
    assert found.height_m.value == pytest.approx(HEIGHT_M)
    assert degrees(found.yaw_rad) == pytest.approx(4.0)
    assert degrees(found.climb_rad) == pytest.approx(0.0, abs=1e-9)
    assert (found.used, found.steps, found.straight_steps) == (6, 5, 5)
    # What stands on the road stands at z = 0.
    foot = road_under(truth).point_below(-1.2, 14.0)
    assert transform(found.T_vehicle_car, foot)[2] == pytest.approx(0.0, abs=1e-12)


def test_the_signs_are_the_ones_of_the_ground_plane() -> None:
    found = find_mounting(seen(plane(1.4, 0.05, 0.03)), TWIN)
    assert found.pitch_rad.value == pytest.approx(0.05)
    assert found.roll_rad.value == pytest.approx(0.03)
    # Without a yaw the cameras look straight ahead, down the road by the pitch.
    ahead = found.T_vehicle_car[:3, 2]
    assert ahead[1] == pytest.approx(0.0, abs=1e-15)
    assert ahead[2] < 0


def test_without_steps_the_yaw_is_unknown_and_taken_as_straight() -> None:
    found = find_mounting(seen(*[road_under(mounted())] * 3), TWIN)
    assert np.isnan([*found.yaw_rad, *found.climb_rad]).all()
    assert found.T_vehicle_car[1, 2] == pytest.approx(0.0, abs=1e-12)


def test_gentle_curves_are_corrected_for_where_the_rear_axle_is() -> None:
    truth = mounted(AXLE_M)
    steps = ways(truth, 1.0, [0.001, 0.002, 0.003, 0.002, 0.004])
    found = find_mounting(seen(road_under(truth)), TWIN, steps)
    assert degrees(found.yaw_rad) == pytest.approx(4.0, abs=0.003)
    # Another axle's place is within what the sigma allows for: 0.0024 per metre times 1.5 m.
    assert found.yaw_rad.sigma == pytest.approx(0.0024 * 1.5, rel=0.2)
    other = find_mounting(seen(road_under(truth)), TWIN, ways(mounted(0.0), 1.0, [0.001, 0.002, 0.003, 0.002, 0.004]))
    assert abs(other.yaw_rad.value - YAW) == pytest.approx(0.0024 * AXLE_M, rel=0.05)


@pytest.mark.parametrize("curvatures", [[0.02] * 8, [-0.006] * 8, [0.02, 0.0, 0.0, -0.02]])
def test_a_drive_that_is_never_straight_has_no_yaw(curvatures: list[float]) -> None:
    found = find_mounting(seen(road_under(mounted())), TWIN, ways(mounted(), 1.0, curvatures))
    assert np.isnan(found.yaw_rad.value)
    assert (found.steps, found.straight_steps) == (len(curvatures), curvatures.count(0.0))


def test_a_rig_that_sees_the_road_wrongly_climbs() -> None:
    truth = mounted()
    T_off = truth @ pose(Rotation.from_euler("X", -1.5, degrees=True).as_matrix(), np.zeros(3))
    found = find_mounting(seen(road_under(T_off)), TWIN, ways(truth, 1.0, [0.0] * 4))
    assert abs(degrees(found.climb_rad)) == pytest.approx(1.5, abs=0.02)


def test_steps_far_from_all_others_do_not_count() -> None:
    truth = mounted()
    aside = Step(99, ways(truth, 1.0, [0.0])[0].T_before_now @ pose(np.eye(3), [0.3, 0.0, 0.0]))
    found = find_mounting(seen(road_under(truth)), TWIN, [*ways(truth, 1.0, [0.0] * 6), aside])
    assert degrees(found.yaw_rad) == pytest.approx(4.0)
    assert found.straight_steps == 6


def test_frames_far_from_all_others_do_not_count() -> None:
    rng = np.random.default_rng(3)
    roads = [plane(1.4 + 0.004 * rng.normal(), 0.03 + 0.002 * rng.normal(), 0.01) for _ in range(12)]
    odd = [plane(1.4, 0.09, 0.01), plane(1.75, 0.03, 0.01)]
    found = find_mounting(seen(*roads, *odd), TWIN)
    assert found.used == 12
    assert found.left_out == {"far from all others": 2}
    assert found.height_m.value == pytest.approx(np.mean([r.height_m for r in roads]))


def test_a_single_frame_does_not_tell_how_sure_it_is() -> None:
    found = find_mounting(seen(plane(1.4, 0.03)), TWIN)
    assert np.isnan([found.height_m.sigma, found.pitch_rad.sigma, found.roll_rad.sigma]).all()


def test_what_all_frames_share_does_not_average_away() -> None:
    """Disparities of a road 0.1 px too large, and 0.1 px at the lowest row's in proportion, by hand."""
    found = find_mounting(seen(*[plane(1.4)] * 400), TWIN)
    f_b = TWIN.f_px * TWIN.baseline_m
    lowest = f_b * (TWIN.size_px[1] - TWIN.cy_px) / TWIN.f_px / 1.4
    assert found.pitch_rad.sigma == pytest.approx(0.1 * 1.4 / f_b)
    assert found.height_m.sigma == pytest.approx(1.4 * 0.1 / lowest)
    # The direction of travel is no better, and the angle between both no better than both.
    way = find_mounting(seen(road_under(mounted())), TWIN, ways(mounted(), 1.0, [0.0] * 5))
    shared_rad = 0.1 * HEIGHT_M / f_b
    assert way.yaw_rad.sigma == pytest.approx(shared_rad)
    assert way.climb_rad.sigma == pytest.approx(np.sqrt(2) * shared_rad)
    # d + 0.1 is the road of another pitch: f B (y / 1.4 - tan p) with f B tan p / 1.4 = -0.1.
    assert np.tan(found.pitch_rad.sigma) * f_b / 1.4 == pytest.approx(0.1, rel=1e-4)


@pytest.mark.parametrize(("rho", "count"), [(0.0, 5), (0.0, 40), (0.5, 10), (0.7, 20), (0.9, 40)])
def test_sigma_holds_for_values_that_hang_together(rho: float, count: int) -> None:
    rng = np.random.default_rng(11)
    held = []
    for _ in range(600):
        noise, series = rng.normal(size=count), np.empty(count)
        series[0] = noise[0]
        for i in range(1, count):
            series[i] = rho * series[i - 1] + np.sqrt(1 - rho * rho) * noise[i]
        mean = mean_in_time(series, np.arange(count) if rho else None)
        held.append(abs(mean.value) < mean.sigma)
    assert np.mean(held) == pytest.approx(0.68, abs=0.06)


def test_the_mean_of_few_values() -> None:
    assert np.isnan(mean_in_time(np.zeros(0))).all()
    one = mean_in_time(np.array([2.5]))
    assert one.value == 2.5
    assert np.isnan(one.sigma)
    assert mean_in_time(np.full(4, 2.0), np.arange(4)) == Measured(2.0, 0.0)
    # Two values half a unit from their mean: 0.71 / sqrt 2, times Student's 1.84 for one degree of freedom.
    assert mean_in_time(np.array([1.0, 2.0])).sigma == pytest.approx(0.5 * 1.837, rel=1e-3)


def test_frames_between_which_some_are_missing_hang_together_as_well() -> None:
    rng = np.random.default_rng(5)
    slow = np.cumsum(rng.normal(size=60))
    every_third = 3 * np.arange(60)
    assert mean_in_time(slow, every_third).sigma == mean_in_time(slow, np.arange(60)).sigma
    assert mean_in_time(slow, every_third).sigma > 3 * mean_in_time(slow).sigma


@pytest.mark.parametrize(
    ("grounds", "says"),
    [
        ([], "no frame shows a flat road: record one in daylight"),
        ([plane(1500.0)] * 3, r"would be 1\.5e\+03 m over the road, but a vehicle's are 0\.1 to 5 m.*--unit"),
        ([plane(0.05)], r"would be 0\.05 m over the road"),
        ([plane(1.0), plane(1.5), plane(2.0)], r"lies 1\.00 to 2\.00 m below the cameras, other in each frame"),
    ],
)
def test_roads_that_cannot_be_one_are_refused(grounds: list[GroundPlane], says: str) -> None:
    with pytest.raises(CalibrationError, match=says):
        find_mounting(seen(*grounds), TWIN)


@pytest.mark.parametrize(
    ("ground", "health", "reason"),
    [
        (plane(), Health(), ""),
        (None, Health("degraded", ("no road found",)), "no road found"),
        (plane(), Health("failed", ("little could be matched: 3%",)), "little could be matched"),
        (plane(), Health("degraded"), "degraded"),
        (plane(bend_per_m=1.1 * FLAT_RISE_M / FLAT_AT_M**2), Health(), "the road bends up ahead"),
        (plane(bend_per_m=-1.1 * FLAT_RISE_M / FLAT_AT_M**2), Health(), "the road bends down ahead"),
        (plane(bend_per_m=-0.9 * FLAT_RISE_M / FLAT_AT_M**2), Health(), ""),
    ],
)
def test_frames_that_tell_nothing(ground: GroundPlane | None, health: Health, reason: str) -> None:
    assert why_left_out(ground, health) == reason


CAMERA = Camera((320, 180), 258.0, 258.0, 163.2, 86.9)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))
WAY = pose(Rotation.from_rotvec([0.004, 0.012, -0.006]).as_matrix(), [0.07, -0.03, 0.8])
"""The car frame after one step, in the car frame before: ahead, a little aside, and turned to the right."""


@pytest.fixture(scope="module")
def pairs() -> list[RectifiedPair]:
    """Five moments of a street: two standing, two steps, and one of elsewhere."""
    rectification = plan_rectification(RIG, RectifySettings())
    start = camera_pose(1.5, 0.04, 0.02)
    scene = SCENES["parked"](3)
    poses = [start, start, start @ WAY, start @ WAY @ WAY, camera_pose(9.0, 0.9)]
    rendered = [
        render(replace(scene, T_world_car=T), RIG, quality="preview", seed=i, index=i).pair for i, T in enumerate(poses)
    ]
    return [rectify(pair, rectification, CAMERA.size_px) for pair in rendered]


def test_the_way_between_two_frames(pairs: list[RectifiedPair]) -> None:
    T = travel(pairs[0], pairs[2])
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], WAY[:3, 3], rtol=0, atol=0.04)
    turn = Rotation.from_matrix(T[:3, :3].T @ WAY[:3, :3]).magnitude()
    assert np.degrees(turn) < 0.1
    again = travel(pairs[0], pairs[2])
    assert again is not None
    assert np.array_equal(T, again)


def shown(pair: RectifiedPair, left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    """Return the pair with other images."""
    return RectifiedPair(left, right, pair.rectification, pair.index, pair.name, pair.t_ns)


@pytest.mark.parametrize("kind", ["16 bit", "colour"])
def test_the_way_in_other_images(pairs: list[RectifiedPair], kind: str) -> None:
    def other(pair: RectifiedPair) -> RectifiedPair:
        left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (pair.left, pair.right))
        if kind == "16 bit":
            return shown(pair, left.astype(np.uint16) * 16, right.astype(np.uint16) * 16)
        return shown(pair, np.stack([left] * 3, -1), np.stack([right] * 3, -1))

    T = travel(other(pairs[0]), other(pairs[2]))
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], WAY[:3, 3], rtol=0, atol=0.05)


def test_the_way_is_that_of_the_car_frame_not_of_the_left_camera() -> None:
    """In a turn on the spot about the car frame's origin the left camera moves."""
    rng = np.random.default_rng(8)
    points = rng.uniform((-6, -2, 5), (6, 2, 25), (60, 3))
    T = pose(Rotation.from_rotvec([0.02, 0.2, -0.03]).as_matrix(), [0.0, 0.0, 0.0])
    pixels = image_from_car(TWIN, transform(inverse(T), points))[:, :2]
    found = _solve(points, pixels, TWIN)
    assert found is not None
    np.testing.assert_allclose(found, T, rtol=0, atol=1e-5)


def test_where_nothing_can_be_followed_there_is_no_way(pairs: list[RectifiedPair]) -> None:
    blank = np.full_like(pairs[0].left, 90)
    assert travel(shown(pairs[0], blank, pairs[0].right), pairs[1]) is None
    assert travel(pairs[0], shown(pairs[1], blank, pairs[1].right)) is None
    assert travel(pairs[0], pairs[4]) is None


def test_features_that_move_each_as_it_likes_are_no_way(pairs: list[RectifiedPair]) -> None:
    """Each of 60 tiles moves by a random few pixels: all can be followed, none agree."""
    rng = np.random.default_rng(2)
    torn = pairs[0].left.copy()
    for v in range(0, 180, 30):
        for u in range(0, 320, 32):
            moved = np.roll(pairs[0].left, rng.integers(-12, 13, 2), (0, 1))
            torn[v : v + 30, u : u + 32] = moved[v : v + 30, u : u + 32]
    assert travel(pairs[0], shown(pairs[1], torn, pairs[1].right)) is None


def test_the_odometer_waits_until_the_cameras_have_moved(pairs: list[RectifiedPair]) -> None:
    odometer = Odometer()
    steps = [odometer.add(pair) for pair in pairs]
    assert [step is not None for step in steps] == [False, False, True, True, False]
    assert odometer.lost == 1
    assert steps[2] is not None
    assert steps[3] is not None
    assert (steps[2].frame, steps[3].frame) == (2, 3)
    np.testing.assert_allclose(steps[3].T_before_now[:3, 3], WAY[:3, 3], rtol=0, atol=0.05)
