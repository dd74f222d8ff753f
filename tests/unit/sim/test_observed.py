"""The fast model without noise: what it says is there is where it was put."""

from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import inverse, transform
from roadblock.sim.car import CarState, car_on
from roadblock.sim.observed import Noise, Observed, measured_step, observe
from roadblock.sim.road import Road, place_on
from roadblock.sim.scene import on_road
from roadblock.sim.solids import Thing, box
from roadblock.sim.things import Order, build
from roadblock.values.camera import Rectification

TWIN = Rectification(516.5, 326.2, 80.3, 0.205, (640, 260))
EXACT = Noise(0.0, 0.0, 0.0, most_missed=0.0, unknown=0.0, step_share=0.0, turn_rad=0.0)
CAR = CarState(2.0, -0.6, 0.0, 8.0)


def see(things: tuple[Thing, ...], road: Road = Road(), noise: Noise = EXACT, car: CarState = CAR) -> Observed:  # noqa: B008
    return observe(things, road, car, TWIN, np.random.default_rng(0), noise)


def test_a_thing_is_found_where_it_stands() -> None:
    seen = see((on_road(build(Order("car", 1)), Road(), 12.0, -1.0),))
    (found,) = seen.obstacles
    assert found.range_m == pytest.approx(10.0, abs=0.1)
    assert found.position_m[:2] == pytest.approx([10.0, -0.4], abs=0.2)
    assert found.size_m[0] == pytest.approx(1.8, abs=0.2)
    assert seen.free_space.is_blocked is not None
    assert seen.free_space.is_blocked.sum() == pytest.approx(1.8 / 10 * 516.5 / 4, abs=4)


def test_scenery_ends_free_space_but_is_no_obstacle() -> None:
    seen = see((on_road(build(Order("car", 0)), Road(), 12.0, -1.0),))
    assert seen.obstacles == ()
    assert seen.free_space.range_m.min() == pytest.approx(10.0, abs=0.1)
    assert seen.free_space.range_m.max() == EXACT.reach_m


def test_a_long_side_is_as_far_as_it_is_in_each_column() -> None:
    wall = Thing(1, "wall", "grey", (box((20.0, 0.2, 1.0), (12.0, -2.7, 0.5), (90, 90, 90)),))
    seen, side_m = see((wall,)).free_space, -2.6 + 0.6
    u = seen.u_px[seen.is_blocked]
    expected = side_m / -((u - TWIN.cx_px) / TWIN.f_px) + TWIN.baseline_m / 2 / ((u - TWIN.cx_px) / TWIN.f_px)
    np.testing.assert_allclose(seen.range_m[seen.is_blocked][4:-1], expected[4:-1], rtol=1e-6)


def test_what_is_below_the_picture_above_the_car_or_flat_is_not_seen() -> None:
    low = Thing(1, "box", "grey", (box((0.4, 0.4, 0.4), (4.2, -0.6, 0.2), (90, 90, 90)),))
    assert see((low,)).obstacles == ()
    assert len(see((low,), car=replace(CAR, x_m=-3.0)).obstacles) == 1
    flat = Thing(1, "box", "grey", (box((0.4, 0.4, 0.06), (9.0, -0.6, 0.03), (90, 90, 90)),))
    bridge = Thing(2, "box", "grey", (box((2.0, 9.0, 1.0), (9.0, -0.6, 4.0), (90, 90, 90)),))
    assert see((flat, bridge)).obstacles == ()


def test_what_is_hidden_or_missed_is_not_found() -> None:
    near, far = (on_road(build(Order("car", n)), Road(), x, -0.6) for n, x in ((1, 12.0), (2, 20.0)))
    assert len(see((near, far)).obstacles) == 1
    assert see((near,), noise=EXACT._replace(found_m=0.0, missed_per_m=1.0, most_missed=1.0)).obstacles == ()
    unknown = see((), noise=EXACT._replace(unknown=1.0)).free_space
    assert np.isnan(unknown.range_m).all()


def test_kerbs_are_seen_where_they_are() -> None:
    seen = see((), replace(Road(), kerb_m=0.12), car=CarState(0.0, 0.0, 0.1, 8.0)).free_space
    assert seen.edges is not None
    at = np.isfinite(seen.edges.range_m)
    z, x = seen.edges.range_m[at], (seen.u_px[at] - TWIN.cx_px) / TWIN.f_px * seen.edges.range_m[at]
    left = z * np.sin(0.1) - x * np.cos(0.1)
    assert at.any()
    assert np.minimum(np.abs(left + 3.1), np.abs(left - 5.6)).max() < 1e-9
    assert see(()).free_space.edges is not None
    assert not np.isfinite(see(()).free_space.edges.range_m).any()  # type: ignore[union-attr]


@pytest.mark.parametrize("bend_per_m", [0.02, -0.015])
def test_kerbs_of_a_bend_are_seen_where_they_are(bend_per_m: float) -> None:
    road = replace(Road(), kerb_m=0.12, curvature_per_m=bend_per_m, curve_from_m=-20.0)
    car = car_on(road, 10.0, -0.6, 8.0)
    seen = see((), road, car=car).free_space
    assert seen.edges is not None
    at = np.isfinite(seen.edges.range_m)
    z, x = seen.edges.range_m[at], (seen.u_px[at] - TWIN.cx_px) / TWIN.f_px * seen.edges.range_m[at]
    world = transform(car.T_world_car, np.stack([x, np.zeros(len(x)), z], -1))
    left = np.array([place_on(road, *point[:2])[1] for point in world])
    assert at.sum() > 20
    assert np.minimum(np.abs(left + 3.1), np.abs(left - 5.6)).max() < 0.1  # an arc, not quite a parabola


def test_own_motion_is_the_true_one_and_its_noise() -> None:
    now = CAR.driven(0.0, 0.02, 0.1)
    step = measured_step(CAR, now, 0, 10**8, np.random.default_rng(0), EXACT)
    assert step.T_now_before is not None
    np.testing.assert_allclose(step.T_now_before, inverse(now.T_world_car) @ CAR.T_world_car, atol=1e-12)
    noisy = measured_step(CAR, now, 0, 10**8, np.random.default_rng(0), Noise())
    assert noisy.T_now_before is not None
    off = transform(noisy.T_now_before, np.zeros(3)) - transform(step.T_now_before, np.zeros(3))
    assert 0 < np.linalg.norm(off) < 0.05
