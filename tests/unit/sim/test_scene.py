from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, transform
from roadblock.geometry.projection import project
from roadblock.sim.render import render
from roadblock.sim.road import Road, height_m, pose_on
from roadblock.sim.scene import Scene, camera_pose, demo_street, on_road, paper_rig
from roadblock.sim.solids import corners_m, going, placed
from roadblock.sim.things import crate, person
from roadblock.values.camera import Camera, StereoRig

NAMED = {1: 5.0, 2: 5.0, 3: 10.0, 4: 10.0, 5: 20.0, 6: 20.0}
BRICK = crate(1, "red", (200, 30, 30), (0.6, 0.4, 0.5))
BENT = Road(curvature_per_m=0.02, curve_from_m=8.0, grade=0.08, grade_from_m=10.0, grade_over_m=15.0)


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
    together = {o.id: o.visible_px for o in render(moved, rig, quality="preview").objects}
    for thing in (t for t in scene.things if t.id):
        (alone,) = render(replace(moved, things=(thing,)), rig, quality="preview").objects
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


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, -2.1])
def test_on_a_flat_road_things_stand_as_placed(yaw_rad):
    there, on = placed(BRICK, 7.25, -1.5, yaw_rad), on_road(BRICK, Road(), 7.25, -1.5, yaw_rad)
    assert on.T_world_thing == pytest.approx(there.T_world_thing, abs=1e-12)
    assert on.bounds_m(on.T_world_thing)[0] == pytest.approx(there.bounds_m(there.T_world_thing)[0], abs=1e-12)


def test_on_a_bent_road_things_stand_on_its_surface_and_face_along_it():
    at = on_road(BRICK, BENT, 30.0, -1.0).T_world_thing
    assert at == pytest.approx(pose_on(BENT, 30.3, -1.0), abs=1e-12)
    # An arc of 22.3 m of radius 50 m.
    assert np.arctan2(at[1, 0], at[0, 0]) == pytest.approx(22.3 / 50, abs=0.004)
    assert at[2, 3] == pytest.approx(height_m(BENT, *at[:2, 3]))
    assert at[2, 2] < 0.999
    man = on_road(person(1, "", (9, 9, 9), (9, 9, 9)), BENT, 30.0, -1.0).T_world_thing
    assert man[2, 2] == pytest.approx(1)


def test_a_drive_moves_the_cameras_along_the_road_and_the_things_on_their_ways():
    walker = going(placed(BRICK, 10.0, -2.0, np.pi / 2), 1.5)
    scene = Scene((walker,), Road(), camera_pose(1.4, 0.05), speed_mps=8.0, conditions=("rain",))
    later = scene.at(0.5)
    assert later.T_world_car[:3, 3] == pytest.approx([4.0, 0, 1.4])
    assert later.T_world_car[:3, :3] == pytest.approx(scene.T_world_car[:3, :3])
    way = later.things[0].T_world_thing[:3, 3] - walker.T_world_thing[:3, 3]
    assert way == pytest.approx([0, 0.75, 0])
    assert (later.along_m, later.conditions) == (4.0, ("rain",))
    assert later.at(-0.5).T_world_car == pytest.approx(scene.T_world_car, abs=1e-12)


def test_the_cameras_follow_a_bent_road():
    scene = Scene((), BENT, camera_pose(1.3), speed_mps=10.0)
    later = scene.at(3.0)
    # 22 m of arc of radius 50 m.
    x, y = 8 + 50 * np.sin(0.44), 50 * (1 - np.cos(0.44))
    up = later.T_world_car[:3, 3] - [x, y, height_m(BENT, x, y)]
    assert np.linalg.norm(up) == pytest.approx(1.3)
    assert up[:2] != pytest.approx([0, 0], abs=0.01)
    ahead = later.T_world_car[:3, 2]
    assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(0.44, abs=0.003)
    assert ahead[2] > 0.05
    twice = scene.at(1.0).at(2.0)
    assert twice.T_world_car == pytest.approx(later.T_world_car)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"things": (BRICK,) * 2}, r"id of its own, but got \[1, 1\]"),
        ({"T_world_car": camera_pose(-0.2)}, "above the road, but are at -0.2"),
        ({"T_world_car": np.zeros((4, 4))}, "orthonormal"),
        ({"towards_sun": np.array([1.0, 0, -0.1])}, "above the horizon"),
        ({"towards_sun": np.array([1.0, 0, np.nan])}, "towards_sun must be finite"),
        ({"speed_mps": np.nan}, "speed_mps must be finite"),
        ({"along_m": np.inf}, "along_m must be finite"),
    ],
)
def test_scene_refuses(change, message):
    fields = {"things": (), "road": Road(), "T_world_car": camera_pose(), **change}
    with pytest.raises(ValueRefusedError, match=message):
        Scene(**fields)


def test_cameras_below_a_hill_are_not_below_its_road():
    falling = replace(BENT, grade=-0.1)
    low = Scene((), falling, camera_pose(1.3), speed_mps=20.0).at(5.0)
    assert low.T_world_car[2, 3] < 0
