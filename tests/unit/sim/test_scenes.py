from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import inverse, pose
from roadblock.geometry.projection import project
from roadblock.sim.conditions import combined
from roadblock.sim.render import render
from roadblock.sim.road import Road
from roadblock.sim.scene import paper_rig
from roadblock.sim.scenes import SCENES, Stand, furnished, paper
from roadblock.sim.solids import corners_m
from roadblock.sim.things import Order
from roadblock.values.camera import Camera, StereoRig

SMALL = Camera((320, 180), 1033 / 4, 1033 / 4, (652.3 + 0.5) / 4 - 0.5, (347.6 + 0.5) / 4 - 0.5)
RIG = StereoRig(SMALL, SMALL, pose(np.eye(3), [0.205, 0, 0]))


def told(scene):
    """All that makes a scene, as plain values."""
    things = [
        (t.id, t.type, t.T_world_thing.tolist(), t.velocity_mps.tolist(), [(p.rgb, p.half_m.tolist()) for p in t.parts])
        for t in scene.things
    ]
    return things, scene.towards_sun.tolist(), scene.seed


@pytest.mark.parametrize("name", [name for name in SCENES if not SCENES[name](0).conditions])
def test_the_same_seed_gives_the_same_scene(name):
    assert told(SCENES[name](3)) == told(SCENES[name](3))
    assert told(SCENES[name](3)) != told(SCENES[name](4))


@pytest.mark.parametrize("name", SCENES)
def test_every_scene_is_seen_and_can_be_driven_through(name):
    scene = SCENES[name](1)
    objects = render(scene, RIG, quality="preview").objects
    named = [t for t in scene.things if t.id]
    assert len(objects) >= 0.6 * len(named)
    combined(scene.conditions)
    later = scene.at(0.4)
    assert (later.speed_mps, len(later.things)) == (scene.speed_mps, len(scene.things))
    if name not in ("demo",):
        assert later.along_m > 1.5


def test_there_are_a_dozen_scenes_and_all_types_of_things_in_them():
    assert len(SCENES) >= 12
    types = {t.type for scene in SCENES.values() for t in scene(0).things if t.id}
    assert types >= {"person", "cyclist", "bicycle", "car", "van", "truck", "railing", "fork"}
    assert types >= {"pole", "wall", "hedge", "cone", "tyre", "box", "stone"}
    assert SCENES["empty"](0).things == ()
    assert SCENES["night"](0).conditions == ("night",)


@pytest.mark.parametrize("seed", [0, 1, 2, 17])
def test_the_papers_things_begin_exactly_at_its_distances(seed):
    scene = paper(seed)
    from_world = inverse(scene.T_world_car)
    found = {t.type: t.bounds_m(from_world @ t.T_world_thing)[0, 2] for t in scene.things if t.id}
    assert found == pytest.approx({"person": 5.0, "bicycle": 10.0, "fork": 20.0}, abs=1e-12)
    assert scene.speed_mps == pytest.approx(30 / 3.6)
    assert scene.conditions == ()


@pytest.mark.parametrize("seed", [0, 1, 6])
@pytest.mark.parametrize("side_m", [0.0, 0.205])
def test_nothing_hides_anything_in_the_papers_scene(seed, side_m):
    scene = paper(seed)
    moved = replace(scene, T_world_car=scene.T_world_car @ pose(np.eye(3), [side_m, 0, 0]))
    together = {o.id: o.visible_px for o in render(moved, RIG, quality="preview").objects}
    for thing in (t for t in scene.things if t.id):
        (alone,) = render(replace(moved, things=(thing,)), RIG, quality="preview").objects
        assert together[thing.id] == alone.visible_px > 0
        corners = [corners_m(p, inverse(moved.T_world_car) @ thing.T_world_thing) for p in thing.parts]
        pixels = project(paper_rig().left, np.concatenate(corners) + np.array([0.1025, 0, 0]))
        assert (pixels > 0).all()
        assert (pixels < (1279, 719)).all()


def test_stands_are_numbered_and_go_where_they_face():
    order = Order("cone", 0, height_m=0.5)
    road = Road(curvature_per_m=0.02, curve_from_m=10.0)
    a, b, c, d = furnished(
        road, (Stand(order, 5.0, 0.0), Stand(order, 20.0, 1.0, 0.0, 6.0), *2 * (Stand(order, 9.0, 2.0),)), 3
    )
    assert [t.id for t in (a, b, c, d)] == [1, 2, 3, 4]
    assert (a.velocity_mps.tolist(), a.yaw_rate_radps) == ([0, 0, 0], 0)
    assert np.linalg.norm(b.velocity_mps) == pytest.approx(6)
    # 6 m/s along an arc of 50 m.
    assert b.yaw_rate_radps == pytest.approx(0.12)
    (oncoming,) = furnished(road, [Stand(order, 20.0, 3.0, 180.0, 6.0)], 3)
    assert oncoming.yaw_rate_radps == pytest.approx(-0.12)
    assert oncoming.velocity_mps[0] < 0
    (crossing,) = furnished(road, [Stand(order, 20.0, 3.0, 90.0, 6.0)], 3)
    assert crossing.yaw_rate_radps == pytest.approx(0)


def test_a_seed_draws_the_looks_of_things():
    heads = {furnished(Road(), [Stand(Order("person", 0), 5.0, 0.0)], seed)[0].parts[-1].rgb for seed in range(8)}
    assert len(heads) > 1
    twins = furnished(Road(), [Stand(Order("stone", 0), 5.0, left) for left in (0.0, 1.0)], 0)
    assert twins[0].size_m != pytest.approx(twins[1].size_m)
