"""The road of small worlds in closed form."""

import numpy as np
import pytest
from pydantic import ValidationError
from stage_examples import LONG, TWIN, Board, disparity_of, noisy, plane

from roadblock.stages.ground import MOMENT_NS, GroundSettings, RoadFinder, fit_ground
from roadblock.values.camera import Rectification
from roadblock.values.frame import DisparityMap
from roadblock.values.scene import GroundPlane

SETTINGS = GroundSettings()
STREET = (Board(7.0, -2.5, -1.2, 1.5), Board(11.0, 0.8, 2.4, 1.7), Board(22.0, -1.0, 0.9, 2.5))


def found(disparity: DisparityMap, settings: GroundSettings = SETTINGS, twin: Rectification = TWIN) -> GroundPlane:
    ground = fit_ground(disparity, twin, settings)
    assert ground is not None
    return ground


def check(ground: GroundPlane, truth: GroundPlane, height_m: float, angle_deg: float) -> None:
    assert ground.height_m == pytest.approx(truth.height_m, abs=height_m)
    assert np.degrees(ground.pitch_rad) == pytest.approx(np.degrees(truth.pitch_rad), abs=angle_deg)
    assert np.degrees(ground.roll_rad) == pytest.approx(np.degrees(truth.roll_rad), abs=angle_deg)


@pytest.mark.parametrize("cell_px", [1, 4])
@pytest.mark.parametrize(
    ("height_m", "pitch_deg", "roll_deg"),
    [(1.4, 0, 0), (1.65, 4, 0), (1.2, -2.5, 0), (1.8, 0, 5), (1.5, 0, -5), (2.6, 9, 3), (0.6, 1, -1), (3.4, 12, -6)],
)
def test_an_exact_road_is_found_exactly(height_m: float, pitch_deg: float, roll_deg: float, cell_px: int) -> None:
    truth = plane(height_m, np.radians(pitch_deg), np.radians(roll_deg))
    ground = found(disparity_of(truth, cell_px=cell_px))
    check(ground, truth, 2e-4, 0.01)
    assert abs(ground.bend_per_m) < 1e-6
    assert ground.inlier_share == pytest.approx(1.0)
    assert 15 < ground.range_m <= SETTINGS.far_m


def test_the_signs_are_the_ones_of_the_values() -> None:
    """Looking down, the road comes closer ahead; left side up, it lies deeper on the left."""
    ground = found(disparity_of(plane(1.5, np.radians(3), np.radians(2))))
    _, at_feet, _ = ground.point_below(0, 0)
    _, ahead, _ = ground.point_below(0, 10)
    _, at_left, _ = ground.point_below(-3, 0)
    assert at_feet - ahead == pytest.approx(10 * np.tan(np.radians(3)), abs=0.01)
    assert at_left - at_feet == pytest.approx(3 * np.tan(np.radians(2)), abs=0.01)


@pytest.mark.parametrize("seed", range(3))
def test_noise_costs_centimetres(seed: int) -> None:
    truth = plane(1.4, np.radians(2), np.radians(-1.5))
    check(found(noisy(disparity_of(truth), 0.3, seed)), truth, 0.02, 0.2)


@pytest.mark.parametrize("seed", range(3))
def test_four_in_ten_wrong_disparities_do_not_matter(seed: int) -> None:
    truth = plane(1.4, np.radians(2), np.radians(-1.5))
    d = noisy(disparity_of(truth), 0.2, seed).d_px.copy()
    rng = np.random.default_rng(seed)
    wrong = np.isfinite(d) & (rng.random(d.shape) < 0.4)
    d[wrong] = rng.uniform(0.5, 60, wrong.sum())
    ground = found(DisparityMap(d, 0.5, 4))
    check(ground, truth, 0.03, 0.3)
    assert ground.inlier_share < 0.9


def test_obstacles_do_not_lift_the_road() -> None:
    truth = plane(1.4, np.radians(3), np.radians(1))
    check(found(noisy(disparity_of(truth, STREET), 0.15, 1)), truth, 0.02, 0.2)


def test_a_wall_across_leaves_the_road_before_it() -> None:
    truth = plane(1.4, np.radians(3))
    ground = found(disparity_of(truth, (Board(9.0, -20, 20, 3.0),)))
    check(ground, truth, 0.01, 0.1)
    assert ground.range_m == pytest.approx(9.0, abs=0.6)


def test_a_deeper_road_wins_over_the_flat_roof_above_it() -> None:
    """Of two parallel planes the lower one is the road: nothing may lie below it."""
    truth = plane(2.2, 0.0)
    platform = plane(0.9, 0.0)
    d = disparity_of(truth).d_px.copy()
    d[:, 40:] = disparity_of(platform).d_px[:, 40:]
    check(found(DisparityMap(d, 0.5, 4)), truth, 0.01, 0.1)


@pytest.mark.parametrize("bend_per_m", [3e-4, -3e-4, 1e-4, -1e-4])
def test_the_bend_ahead_has_the_right_sign_and_size(bend_per_m: float) -> None:
    truth = plane(1.5, np.radians(1), 0.0, bend_per_m)
    ground = found(disparity_of(truth, twin=LONG), twin=LONG)
    # The near plane takes a share of the curve; what counts is where the road is, near and far.
    assert np.sign(ground.bend_per_m) == np.sign(bend_per_m)
    for z in (6.0, 15.0, 30.0, 45.0):
        assert ground.point_below(0, z)[1] == pytest.approx(truth.point_below(0, z)[1], abs=0.03 + 0.002 * z)
    flat = found(disparity_of(plane(1.5, np.radians(1)), twin=LONG), twin=LONG)
    assert abs(ground.bend_per_m) > 100 * abs(flat.bend_per_m)


@pytest.mark.parametrize("bend_per_m", [6e-4, -6e-4])
def test_a_strong_bend_is_followed_in_part(bend_per_m: float) -> None:
    """A radius of 830 m, 1.2 m within 45 m: less than a third of it is missed."""
    truth = plane(1.5, np.radians(1), 0.0, bend_per_m)
    ground = found(disparity_of(truth, twin=LONG), twin=LONG)
    assert np.sign(ground.bend_per_m) == np.sign(bend_per_m)
    for z in (15.0, 30.0, 45.0):
        assert ground.point_below(0, z)[1] == pytest.approx(truth.point_below(0, z)[1], abs=0.4)


def nothing() -> np.ndarray:
    return np.full((45, 80), np.nan, np.float32)


def test_without_a_road_there_is_none() -> None:
    assert fit_ground(DisparityMap(nothing(), 0.5, 4), TWIN, SETTINGS) is None
    wall = disparity_of(None, (Board(8.0, -20, 20, 20, -20),))
    assert fit_ground(wall, TWIN, SETTINGS) is None
    speckles = np.where(np.random.default_rng(0).random((45, 80)) < 0.05, 9, nothing()).astype(np.float32)
    assert fit_ground(DisparityMap(speckles, 0.5, 4), TWIN, SETTINGS) is None


def test_a_road_of_too_few_cells_is_none() -> None:
    d = nothing()
    d[-3:, 20:60] = disparity_of(plane()).d_px[-3:, 20:60]
    assert np.isfinite(d).sum() == 120
    narrow = DisparityMap(d, 0.5, 4)
    assert fit_ground(narrow, TWIN, GroundSettings(minimum_cells=60)) is not None
    assert fit_ground(narrow, TWIN, GroundSettings(minimum_cells=121)) is None


def test_a_road_seen_only_beyond_the_near_fit_is_none() -> None:
    far = disparity_of(plane(1.5), twin=LONG)
    d = np.where(far.uvd_px[..., 2] < 900 * 0.5 / 20, far.d_px, np.float32(np.nan))
    assert fit_ground(DisparityMap(d, 0.5, 4), LONG, GroundSettings(near_m=15.0)) is None
    assert fit_ground(DisparityMap(d, 0.5, 4), LONG, GroundSettings(near_m=35.0)) is not None


@pytest.mark.parametrize(
    ("truth", "limits"),
    [
        (plane(1.4), {"height_m": (1.6, 4.0)}),
        (plane(1.4), {"height_m": (0.2, 1.2)}),
        (plane(1.4, np.radians(6)), {"pitch_deg": 4.0}),
        (plane(1.4, np.radians(-6)), {"pitch_deg": 4.0}),
        (plane(1.4, 0.0, np.radians(6)), {"roll_deg": 4.0}),
        (plane(1.4, 0.0, np.radians(-6)), {"roll_deg": 4.0}),
    ],
)
def test_a_road_beyond_the_limits_is_none(truth: GroundPlane, limits: dict[str, object]) -> None:
    disparity = disparity_of(truth)
    found(disparity)
    assert fit_ground(disparity, TWIN, GroundSettings.model_validate(limits)) is None


def test_a_fit_that_ends_beyond_the_limits_is_none() -> None:
    """Some drawn planes of a noisy road lie within a limit that the road itself lies just beyond."""
    noisy_road = noisy(disparity_of(plane(1.4)), 0.4, 2)
    for low in (1.38, 1.4, 1.42, 1.44, 1.46):
        ground = fit_ground(noisy_road, TWIN, GroundSettings(height_m=(low, 4.0)))
        assert ground is None or ground.height_m / -ground.normal[1] > low


def test_ground_rougher_than_the_tolerance_is_none() -> None:
    rough = noisy(disparity_of(plane(1.4)), 1.0, 1)
    assert fit_ground(rough, TWIN, GroundSettings(tolerance_px=3.0)) is not None
    assert fit_ground(rough, TWIN, GroundSettings(tolerance_px=3.0, tolerance_m=0.005, minimum_cells=300)) is None


def test_drawn_planes_that_carry_next_to_nothing_do_no_harm() -> None:
    d = nothing()
    d[-5:, 30:34] = disparity_of(plane()).d_px[-5:, 30:34]
    rough = noisy(DisparityMap(d, 0.5, 4), 0.3, 5)
    ground = fit_ground(rough, TWIN, GroundSettings(minimum_cells=10, tolerance_px=0.05))
    assert ground is None or ground.height_m == pytest.approx(1.4, abs=0.3)


def test_the_same_disparities_give_the_same_road() -> None:
    disparity = noisy(disparity_of(plane(1.4, 0.03), STREET), 0.3, 3)
    a, b = found(disparity), found(disparity)
    assert np.array_equal(a.normal, b.normal)
    assert (a.height_m, a.bend_per_m, a.inlier_share, a.range_m) == (
        b.height_m,
        b.bend_per_m,
        b.inlier_share,
        b.range_m,
    )
    c = fit_ground(disparity, TWIN, SETTINGS, seed=1)
    assert c is not None
    assert c.height_m == pytest.approx(a.height_m, abs=0.02)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"height_m": (4.0, 0.2)}, "the first must be below the second"),
        ({"height_m": (-1.0, 2.0)}, "greater than 0"),
        ({"draws": 10**9}, "less than or equal to 5000"),
        ({"near_m": float("inf")}, "finite"),
        ({"pitch_deg": 60}, "less than 60"),
        ({"minimum_cells": 9}, "greater than or equal to 10"),
    ],
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        GroundSettings.model_validate(bad)


def test_the_road_of_a_moment_ago_helps_where_draws_fail() -> None:
    """Of ten draws among mostly wrong disparities hardly one is of three points of the road."""
    truth = plane(1.4, np.radians(2), np.radians(-1.5))
    rng = np.random.default_rng(11)
    few = GroundSettings(draws=10)
    alone, next_, later = 0, 0, 0
    for seed in range(20):
        clear = noisy(disparity_of(truth), 0.2, seed)
        d = np.where(rng.random(clear.d_px.shape) < 0.7, rng.uniform(2, 60, clear.d_px.shape), clear.d_px)
        crowded = DisparityMap(d.astype(np.float32), 0.5, 4)
        is_right = []
        for t_ns in (0, MOMENT_NS, MOMENT_NS + 1):
            find_road = RoadFinder(few)
            if t_ns:
                find_road(clear, TWIN, 1)
            ground = find_road(crowded, TWIN, t_ns and 1 + t_ns)
            is_right.append(ground is not None and abs(ground.pitch_rad - truth.pitch_rad) < 0.01)
        alone, next_, later = (n + right for n, right in zip((alone, next_, later), is_right, strict=True))
    assert next_ == 20
    assert later == alone < 15
