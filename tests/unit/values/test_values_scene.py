"""Ground, free space, obstacles: signs by hand, checks, and that nothing can be changed."""

from dataclasses import FrozenInstanceError
from typing import Any

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.values.scene import (
    HEALTH_STATES,
    Detections,
    FrameResult,
    FreeSpace,
    GroundPlane,
    Health,
    Obstacle,
    Region,
    RoadEdges,
    Stixels,
)

UP = np.array([0.0, -1.0, 0.0])


def turned(pitch: float, roll: float) -> np.ndarray:
    """The road's up direction for a rig whose nose sinks by `pitch` and whose left side then rises by `roll`."""
    # World axes: x right, y down, z forward. Sinking the nose brings the forward axis down (+y).
    nose = np.array(
        [[1, 0, 0], [0, np.cos(pitch), np.sin(pitch)], [0, -np.sin(pitch), np.cos(pitch)]]
    )  # columns: the rig's axes in the world
    side = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    return (nose @ side).T @ UP


@pytest.mark.parametrize("angle", [-0.3, -0.01, 0, 0.02, 0.4])
def test_pitch_is_positive_when_the_cameras_look_down(angle: float) -> None:
    plane = GroundPlane(turned(angle, 0), 1.4)
    assert plane.pitch_rad == pytest.approx(angle, abs=1e-15)
    assert plane.roll_rad == 0
    # A camera that looks down by `angle` meets the road on its optical axis, at height / sin(angle).
    if angle > 0:
        on_axis = np.array([0, 0, 1.4 / np.sin(angle)])
        assert plane.height_of(on_axis) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("angle", [-0.3, -0.01, 0, 0.02, 0.4])
def test_roll_is_positive_when_the_left_side_is_up(angle: float) -> None:
    plane = GroundPlane(turned(0, angle), 1.4)
    assert plane.roll_rad == pytest.approx(angle, abs=1e-15)
    assert plane.pitch_rad == 0
    left_end, right_end = plane.height_of(np.array([[-1.0, 0, 0], [1.0, 0, 0]]))
    assert left_end - right_end == pytest.approx(2 * np.sin(angle), abs=1e-12)


def test_small_pitch_and_roll_together() -> None:
    plane = GroundPlane(turned(0.03, -0.02), 1.4)
    assert plane.pitch_rad == pytest.approx(0.03, abs=2e-5)
    assert plane.roll_rad == pytest.approx(-0.02, abs=2e-5)


def test_height_above_a_level_road_is_by_hand() -> None:
    plane = GroundPlane(UP, 1.5)
    points = np.array([[0, 0, 0], [3, 1.5, 20], [-2, 0.3, 8], [1, 1.9, 5], [0, np.nan, 4]])
    np.testing.assert_allclose(plane.height_of(points), [1.5, 0, 1.2, -0.4, np.nan], rtol=0, atol=1e-15)
    assert plane.height_of(points.reshape(5, 1, 3)).shape == (5, 1)
    assert plane.height_of(points.astype(np.float32)).shape == (5,)


def test_a_positive_bend_is_a_road_that_rises_ahead() -> None:
    plane = GroundPlane(UP, 1.5, bend_per_m=1e-3)
    rise = 1e-3 * 30**2
    on_road = np.array([0.7, 1.5 - rise, 30])  # y points down: what rises has less of it
    assert plane.height_of(on_road) == pytest.approx(0, abs=1e-12)
    assert plane.height_of(on_road - [0, 0.35, 0]) == pytest.approx(0.35, abs=1e-12)


@pytest.mark.parametrize(("x", "z"), [(0, 0), (1.3, 12), (-4, 33)])
def test_the_point_below_lies_on_the_road(x: float, z: float) -> None:
    assert GroundPlane(UP, 1.5, 1e-3).point_below(x, z)[1] == pytest.approx(1.5 - 1e-3 * z * z, abs=1e-12)
    plane = GroundPlane(turned(0.05, -0.03), 1.5, 1e-3)
    point = plane.point_below(x, z)
    assert (point[0], point[2]) == (x, z)
    assert plane.height_of(point) == pytest.approx(0, abs=1e-12)


def test_ground_owns_its_normal() -> None:
    mine = UP.copy()
    plane = GroundPlane(mine, 1.4)
    mine[:] = 5
    np.testing.assert_array_equal(plane.normal, UP)
    with pytest.raises(ValueError, match="read-only"):
        plane.normal[0] = 1


@pytest.mark.parametrize(
    ("normal", "height", "words"),
    [
        ([0, -1], 1.4, "normal must have shape"),
        ([0, np.nan, 0], 1.4, "normal must be finite"),
        ([0, 1, 0], 1.4, "normal must be one long and point up"),
        ([0, -1.01, 0], 1.4, "normal must be one long and point up"),
        ([1, 0, 0], 1.4, "normal must be one long and point up"),
        ([0, -1, 0], 0, "height_m must be > 0"),
        ([0, -1, 0], np.inf, "height_m must be finite"),
    ],
)
def test_ground_refuses(normal: list[float], height: float, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        GroundPlane(np.array(normal, float), height)


def test_ground_refuses_a_bend_that_is_not_known() -> None:
    with pytest.raises(ValueRefusedError, match="bend_per_m must be finite"):
        GroundPlane(UP, 1.4, np.nan)


def test_free_space_is_owned_and_keeps_unknown() -> None:
    u, reach = np.array([0.0, 1.0]), np.array([12.0, np.nan])
    free = FreeSpace(u, reach)
    u[:], reach[:] = 7, 7
    np.testing.assert_array_equal(free.u_px, [0, 1])
    np.testing.assert_array_equal(free.range_m, [12, np.nan])
    for array in (free.u_px, free.range_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(("u", "reach"), [([0, 1], [5]), ([[0]], [[5]]), ([0, np.nan], [5, 5]), ("ab", [5, 5])])
def test_free_space_refuses(u: Any, reach: Any) -> None:
    with pytest.raises(ValueRefusedError, match="must"):
        FreeSpace(u, reach)


def test_edges_refuse() -> None:
    nan, none = np.full(2, np.nan), np.zeros(2, np.uint8)
    with pytest.raises(ValueRefusedError, match=r"kind must be uint8 of 0\.\.2"):
        RoadEdges(nan, nan, np.array([0, 3], np.uint8))
    with pytest.raises(ValueRefusedError, match="kind must be uint8"):
        RoadEdges(nan, nan, np.zeros(2))
    with pytest.raises(ValueRefusedError, match="height_m must have shape"):
        RoadEdges(nan, np.zeros(3), none)
    with pytest.raises(ValueRefusedError, match="edges must have 1 columns, but got 2"):
        FreeSpace(np.zeros(1), np.zeros(1), None, RoadEdges(nan, nan, none))


@pytest.mark.parametrize("blocked", [np.zeros(2, bool), np.zeros(1, np.uint8)])
def test_free_space_refuses_what_is_no_flag_per_column(blocked: np.ndarray) -> None:
    with pytest.raises(ValueRefusedError, match=r"is_blocked must be bool \(1,\)"):
        FreeSpace(np.zeros(1), np.zeros(1), blocked)


def test_stixels_refuse_unknown_ranges() -> None:
    one = np.ones(1)
    assert np.isnan(Stixels(one, one, one, one, np.full(1, np.nan)).height_m).all()
    with pytest.raises(ValueRefusedError, match="range_m must be finite"):
        Stixels(one, one, one, np.full(1, np.nan), one)


def region(sigma_d_px: float = 0.2) -> Region:
    contour, surface = np.zeros((3, 2), np.int32), np.full((4, 3), np.nan)
    return Region((3, 4, 9, 12), contour, surface, sigma_d_px, np.zeros(3))


def test_a_region_cannot_be_changed() -> None:
    value = region()
    for array in (value.contour_px, value.surface_uvd_px, value.color_rgb):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1


@pytest.mark.parametrize(("sigma", "words"), [(0, "must be > 0"), (np.nan, "must be finite")])
def test_a_region_states_its_noise(sigma: float, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=f"sigma_d_px {words}"):
        region(sigma)


def obstacle(**change: Any) -> Obstacle:
    fields = {
        "position_m": np.array([10.0, 1.0, 0.0]),
        "range_m": 10.0,
        "range_sigma_m": 0.1,
        "size_m": np.array([1.8, 1.5, np.nan]),
        "uvd_px": np.array([40.0, 30.0, 5.0]),
        "cov_uvd_px2": np.eye(3),
        "cov_match_m2": np.eye(3),
        "box_px": (30, 20, 50, 40),
        "contour_px": np.array([[30, 20], [50, 20], [50, 40]], np.int32),
    }
    return Obstacle(**(fields | change))


def test_an_obstacle_is_unknown_until_recognised_and_owns_its_position() -> None:
    mine = np.array([10.0, 1.0, 0.0])
    value = obstacle(position_m=mine)
    mine[:] = 5
    assert (value.label, value.color) == ("unknown", None)
    assert np.isnan(value.probability)
    np.testing.assert_array_equal(value.position_m, [10, 1, 0])
    with pytest.raises(ValueError, match="read-only"):
        value.position_m[0] = 1
    with pytest.raises(FrozenInstanceError):
        value.range_m = 3  # type: ignore[misc]


def test_what_the_calibration_does_is_unknown_until_said() -> None:
    value = obstacle()
    assert np.isnan(value.range_sigma_calib_m)
    assert np.isnan(value.cov_calib_m2).all()
    assert value.cov_calib_m2.shape == (3, 3)
    told = obstacle(cov_calib_m2=np.diag([1, 2, 3]), range_sigma_calib_m=1.0)
    np.testing.assert_array_equal(told.cov_calib_m2, np.diag([1, 2, 3]))
    with pytest.raises(ValueError, match="read-only"):
        told.cov_calib_m2[0, 0] = 2


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"cov_calib_m2": np.eye(2)}, "cov_calib_m2 must have shape"),
        ({"position_m": [1, 2]}, "position_m must have shape"),
        ({"position_m": [1, np.nan, 2]}, "position_m must be finite"),
        ({"range_m": 0}, "range_m must be > 0"),
        ({"range_m": np.nan}, "range_m must be finite"),
    ],
)
def test_an_obstacle_refuses_an_unknown_place(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        obstacle(**change)


def test_results_gather_what_one_step_found() -> None:
    free = FreeSpace(np.zeros(0), np.zeros(0))
    found = Detections((), None, free)
    result = FrameResult(0, "a", 0, (obstacle(),), free, found.ground, Health(), {"total": 1.0})
    assert found.timings_ms == {}
    assert result.health == Health("ok", ())
    assert result.health.state in HEALTH_STATES
    assert result.obstacles[0].range_m == 10


def test_health_refuses_a_state_that_does_not_exist() -> None:
    with pytest.raises(ValueRefusedError, match="state must be one of ok, degraded, failed, but got 'fine'"):
        Health("fine")
