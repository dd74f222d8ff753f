from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, transform
from roadblock.geometry.projection import project
from roadblock.sim.render import render
from roadblock.sim.scene import Road, Scene, camera_pose, demo_street, paper_rig
from roadblock.sim.solids import corners_m
from roadblock.sim.things import crate
from roadblock.values.camera import Camera, StereoRig

NAMED = {1: 5.0, 2: 5.0, 3: 10.0, 4: 10.0, 5: 20.0, 6: 20.0}


def quarter_rig():
    """The paper's rig with four times larger pixels."""
    camera = Camera((320, 180), 1033 / 4, 1033 / 4, (652.3 + 0.5) / 4 - 0.5, (347.6 + 0.5) / 4 - 0.5)
    return StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))


def test_paper_rig():
    rig = paper_rig()
    assert rig.baseline_m == 0.205
    assert (rig.left.fx_px, rig.left.size_px) == (1033, (1280, 720))
    assert rig.is_rectified
    assert (rig.left.cx_px, rig.left.cy_px) != (639.5, 359.5)


def test_demo_things_stand_exactly_at_their_distances():
    scene = demo_street()
    from_world = inverse(scene.T_world_car)
    found = {t.id: t.bounds_m(from_world @ t.T_world_thing)[0, 2] for t in scene.things if t.id}
    assert found == pytest.approx(NAMED, abs=1e-12)
    types = [t.type for t in scene.things if t.id]
    assert types == ["box", "person"] * 3
    assert len({t.color for t in scene.things if t.id}) == 6


@pytest.mark.parametrize("side_m", [-0.1025, 0.1025])
def test_both_cameras_see_every_demo_thing_whole(side_m):
    scene, camera = demo_street(), paper_rig().left
    eye = scene.T_world_car @ pose(np.eye(3), [side_m, 0, 0])
    for thing in (t for t in scene.things if t.id):
        corners = np.concatenate([corners_m(p, inverse(eye) @ thing.T_world_thing) for p in thing.parts])
        pixels = project(camera, corners)
        assert (pixels > 0).all()
        assert (pixels < (1279, 719)).all()


@pytest.mark.parametrize("side_m", [0.0, 0.205])
def test_nothing_hides_a_demo_thing_from_either_camera(side_m):
    scene, rig = demo_street(), quarter_rig()
    moved = replace(scene, T_world_car=scene.T_world_car @ pose(np.eye(3), [side_m, 0, 0]))
    together = {o.id: o.visible_px for o in render(moved, rig, samples=1).objects}
    for thing in (t for t in scene.things if t.id):
        (alone,) = render(replace(moved, things=(thing,)), rig, samples=1).objects
        assert together[thing.id] == alone.visible_px > 0


def test_seed_changes_the_scenery_alone():
    a, b = demo_street(0), demo_street(1)
    poses = [[t.T_world_thing for t in s.things if t.id] for s in (a, b)]
    assert np.array_equal(*poses)
    scenery = [[t.T_world_thing for t in s.things if not t.id] for s in (a, b)]
    assert not np.array_equal(*scenery)


def test_camera_pose_has_the_signs_of_its_names():
    down = camera_pose(1.4, 0.1)
    ahead = transform(down, [0, 0, 1.0])
    assert ahead == pytest.approx([np.cos(0.1), 0, 1.4 - np.sin(0.1)])
    left = transform(camera_pose(1.4, 0.0, 0.1), [-1.0, 0, 0])
    assert left == pytest.approx([0, np.cos(0.1), 1.4 + np.sin(0.1)])


def test_sun_becomes_a_unit_vector():
    assert np.linalg.norm(Scene((), Road(), camera_pose(), np.array([0, 3, 4.0])).towards_sun) == pytest.approx(1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"things": (crate(1, "red", (9, 9, 9), (1, 1, 1)),) * 2}, r"id of its own, but got \[1, 1\]"),
        ({"T_world_car": camera_pose(-0.2)}, "above the road, but are at -0.2"),
        ({"T_world_car": np.zeros((4, 4))}, "orthonormal"),
        ({"towards_sun": np.array([1.0, 0, -0.1])}, "above the horizon"),
        ({"towards_sun": np.array([1.0, 0, np.nan])}, "towards_sun must be finite"),
    ],
)
def test_scene_refuses(change, message):
    fields = {"things": (), "road": Road(), "T_world_car": camera_pose(), **change}
    with pytest.raises(ValueRefusedError, match=message):
        Scene(**fields)
