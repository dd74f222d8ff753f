from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import pose
from roadblock.sim.car import Body, CarState, Obstruction, car_on, clearance_m
from roadblock.sim.challenges import ALLOWED_KMH, CHALLENGES, FRONT_M, GRID, LANE_M
from roadblock.sim.render import render
from roadblock.sim.road import Road
from roadblock.values.camera import Camera, StereoRig


@pytest.mark.parametrize("name", [*CHALLENGES, *(name for name in GRID if name.endswith(" 30"))])
def test_every_challenge_has_a_kerb_and_begins_on_the_road(name: str) -> None:
    one = (CHALLENGES | GRID)[name](3)
    assert one.scene.road.kerb_m > 0
    assert one.scene.road.right_m < one.start_m[1] < one.scene.road.left_m


def test_a_challenge_is_drawn_from_its_seed() -> None:
    things = [CHALLENGES["standing"](seed).scene.things for seed in (3, 3, 4)]
    places = [[thing.T_world_thing for thing in drawn] for drawn in things]
    np.testing.assert_array_equal(places[0], places[1])
    assert not np.array_equal(places[0], places[2])


def test_who_brakes_stops_after_the_square_of_its_speed() -> None:
    challenge = CHALLENGES["braking"](1)
    (thing,) = (thing for thing in challenge.scene.things if thing.id)
    v, a = float(thing.velocity_mps[0]), challenge.brakes_mps2
    np.testing.assert_allclose(challenge.way_m(thing, 0.5), [0.5 * v, 0.0])
    np.testing.assert_allclose(challenge.way_m(thing, 30.0), [v + v**2 / (2 * a), 0.0])
    late = challenge.thing_at(thing, 30.0)
    assert not late.velocity_mps.any()
    np.testing.assert_allclose(late.T_world_thing[0, 3] - thing.T_world_thing[0, 3], v + v**2 / (2 * a))
    assert len(challenge.things_at(1.0)) == len(challenge.scene.things)
    steady = replace(challenge, brakes_s=np.inf)
    np.testing.assert_allclose(steady.way_m(thing, 30.0), [30 * v, 0.0])


def test_who_crosses_on_the_grid_meets_the_middle_of_the_front() -> None:
    challenge = GRID["grid person crossing at 5 km/h 40"](0)
    (thing,) = (thing for thing in challenge.scene.things if thing.id)
    nearest_m = thing.bounds_m(thing.T_world_thing)[0, 0]
    there_s = (nearest_m - FRONT_M) / challenge.speed_mps
    left_m = thing.T_world_thing[1, 3] + challenge.way_m(thing, there_s)[1]
    assert left_m == pytest.approx(LANE_M, abs=0.05)


def test_only_what_is_known_is_required() -> None:
    assert ALLOWED_KMH["grid car standing 40"] == 0.0
    assert ALLOWED_KMH["grid person crossing at 5 km/h 60"] == 35.0
    assert ALLOWED_KMH["grid car standing 50"] == 25.0
    assert ALLOWED_KMH["grid car at 20 km/h 40"] is None
    assert ALLOWED_KMH["grid person crossing at 5 km/h 10"] is None
    assert ALLOWED_KMH["grid bicycle crossing at 15 km/h 20"] is None


FREE = ("parked", "empty", "shadows", "bridge", "steam", "signs", "between", "bend")


@pytest.mark.parametrize("name", FREE)
def test_on_a_free_road_nothing_comes_near(name: str) -> None:
    for seed in (0, 1):
        one = CHALLENGES[name](seed)
        things = [Obstruction(thing) for thing in one.things_at(1.0)]
        for gone_m in np.arange(0.0, one.length_m, 1.5):
            car = car_on(one.scene.road, one.start_m[0] + gone_m, one.start_m[1], one.speed_mps)
            assert clearance_m(things, car, Body())[0] > 0.3, (seed, gone_m)


def test_no_house_stands_on_the_road() -> None:
    for name in ("fork", "parked", "bend"):
        scene = CHALLENGES[name](1).scene
        beside = [Obstruction(thing) for thing in scene.things if thing.type in ("house", "tree")]
        assert len(beside) == 12
        for car in along(scene.road):
            assert clearance_m(beside, car, Body())[0] > 0.3, (name, car)


def along(road: Road) -> list[CarState]:
    """Return a car at both edges of a road."""
    inner = Body().width_m / 2
    return [
        car_on(road, x, left, 8.0)
        for x in np.arange(0.0, 110.0, 3.0)
        for left in (road.right_m + inner, road.left_m - inner)
    ]


def test_shadows_fall_on_the_lane_and_a_bridge_darkens_it() -> None:
    camera = Camera((160, 60), 60.0, 60.0, 80.0, 10.0)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.2, 0.0, 0.0]))
    for name in ("shadows", "bridge"):
        scene = CHALLENGES[name](2).scene
        bare = replace(scene, things=())
        car = CarState(12.0, LANE_M, 0.0, 0.0)
        with_it, without = (
            render(replace(s, T_world_car=car.T_world_car), rig, quality="preview", noise=0) for s in (scene, bare)
        )
        road = (with_it.depth_m == without.depth_m) & np.isfinite(without.depth_m)
        darker = with_it.pair.left.astype(int) < without.pair.left.astype(int) - 20
        assert (darker.all(-1) & road)[:, 60:100].sum() > 20
