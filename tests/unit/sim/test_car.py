"""A car in closed form: how it obeys, what it touches, and whether it can go on."""

from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import pose
from roadblock.sim.car import Body, CarState, Obstruction, can_go_on, clearance_m
from roadblock.sim.road import Road
from roadblock.sim.scene import on_road
from roadblock.sim.solids import Thing, box
from roadblock.sim.things import Order, build

BODY = Body(1.7, 1.3, 2.8)


def block(x: float, y: float, size: tuple[float, float, float] = (1.0, 1.0, 1.0), low: float = 0.0) -> Obstruction:
    part = box(size, (x, y, low + size[2] / 2), (90, 90, 90))
    return Obstruction(Thing(1, "box", "grey", (part,)))


def test_it_brakes_and_turns_as_far_as_it_can() -> None:
    car = CarState(0.0, 0.0, 0.0, 8.0)
    assert car.driven(-20.0, 0.0, 0.5).speed_mps == pytest.approx(5.0)
    assert car.driven(-20.0, 0.0, 9.0).speed_mps == 0.0
    turned = car.driven(0.0, 1.0, 0.1)  # 3 m/s2 aside at most
    assert turned.heading_rad == pytest.approx(3.0 / 64 * 0.8)
    slow = replace(car, speed_mps=1.0).driven(0.0, 1.0, 0.1)
    assert slow.heading_rad == pytest.approx(0.1 / 5.5)


def test_its_cameras_look_where_it_heads() -> None:
    T = CarState(3.0, 2.0, np.pi / 2, 0.0).T_world_car
    np.testing.assert_allclose(T[:3, 2], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(T[:3, 3], [3, 2, 1.4], atol=1e-12)


@pytest.mark.parametrize(
    ("at", "heading", "clear_m"),
    [
        ((5.0, 0.0), 0.0, 5.0 - 0.5 - 1.3),
        ((0.0, 3.0), 0.0, 3.0 - 0.5 - 0.85),
        ((-6.0, 0.0), 0.0, 6.0 - 0.5 - 2.8),
        ((0.0, 4.0), np.pi / 2, 4.0 - 0.5 - 1.3),
        ((1.0, 0.0), 0.0, -0.8),
    ],
)
def test_clearance_is_that_of_two_boxes(at: tuple[float, float], heading: float, clear_m: float) -> None:
    assert block(*at).clearance_m(CarState(0, 0, heading, 0), BODY) == pytest.approx(clear_m)


def test_bridges_and_manholes_are_not_touched() -> None:
    car = CarState(0, 0, 0, 0)
    assert block(0.0, 0.0, (1, 1, 0.06)).clearance_m(car, BODY) == np.inf
    assert block(0.0, 0.0, low=3.0).clearance_m(car, BODY) == np.inf
    far = Obstruction(replace(block(0.0, 0.0).thing, T_world_thing=pose(np.eye(3), [50.0, 0.0, 0.0])))
    assert far.clearance_m(car, BODY) == np.inf
    assert clearance_m([], car, BODY) == (np.inf, "")


def test_what_moved_on_is_as_far_as_it_went() -> None:
    car = CarState(0, 0, 0, 0)
    gone = block(5.0, 0.0).shifted(np.array([2.0, 0.0]))
    assert gone.clearance_m(car, BODY) == pytest.approx(7.0 - 0.5 - 1.3)
    low = block(0.0, 0.0, (1, 1, 0.06)).shifted(np.array([2.0, 0.0]))
    assert low.clearance_m(car, BODY) == np.inf


def test_clearance_of_a_real_thing_is_to_its_nearest_face() -> None:
    car = on_road(build(Order("car", 1)), Road(), 10.0, 0.0)
    assert Obstruction(car).clearance_m(CarState(0, 0, 0, 0), BODY) == pytest.approx(8.7, abs=0.05)


def test_it_can_go_on_where_there_is_room() -> None:
    car, road = CarState(0, 0, 0, 0), Road(-3.0, 5.0)
    assert can_go_on([block(7.0, 0.0)], car, BODY, road)
    assert not can_go_on([block(2.0, 0.0)], car, BODY, road)  # too near to turn
    assert not can_go_on([block(7.0, 1.0, (1, 9, 1))], car, BODY, road)
    assert not can_go_on([block(7.0, 0.0, (1, 2, 1))], car, BODY, Road(-1.2, 1.2))
