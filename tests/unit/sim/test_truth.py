from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import R_VEHICLE_CAR, pose, rotation_from_rotvec
from roadblock.sim.render import render
from roadblock.sim.scene import Road, Scene, camera_pose
from roadblock.sim.solids import placed
from roadblock.sim.things import crate, person
from roadblock.sim.truth import true_ground
from roadblock.values.camera import Camera, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))
RED = (200, 30, 30)


def scene_of(*things, **pose_of):
    return Scene(things, Road(), camera_pose(**pose_of))


def test_box_by_hand():
    scene = scene_of(placed(crate(7, "red", RED, (0.5, 1.0, 0.8)), 5.0, 0.0), height_m=1.39)
    (true,) = render(scene, RIG, quality="preview").objects
    assert (true.id, true.type, true.color) == (7, "box", "red")
    assert true.range_m == pytest.approx(5.0, abs=1e-12)
    # The lateral position is that of whole pixels, 5/80 m wide.
    assert true.position_m == pytest.approx([5.0, 0.0, -1.39], abs=5 / 80 / 2)
    assert true.position_m[[0, 2]] == pytest.approx([5.0, -1.39], abs=1e-12)
    assert true.size_m == pytest.approx([1.0, 0.8, 0.5])
    # Front face: x -0.5..0.5 m, 0.15 m to the right of the left camera; top edge 0.59, bottom 1.39 m below it. Its
    # top is seen up to its back edge 5.5 m away.
    u0, u1 = 51.3 + 80 * (0.15 - 0.5) / 5, 51.3 + 80 * (0.15 + 0.5) / 5
    v0, v1 = 27.6 + 80 * 0.59 / 5.5, 27.6 + 80 * 1.39 / 5
    assert true.box_px == tuple(int(np.ceil(e)) for e in (u0, v0, u1, v1))
    assert 5.0 < true.mean_range_m < 5.25
    assert true.visible_px == (render(scene, RIG, quality="preview").ids == 7).sum()


def test_range_is_the_tenth_percentile_and_the_mean_is_the_mean():
    scene = scene_of(placed(person(1, "blue", RED, RED), 4.0, 0.2, np.pi))
    rendered = render(scene, RIG, quality="preview")
    (true,) = rendered.objects
    z = np.sort(80 * 0.3 / rendered.disparity.d_px[rendered.ids == 1])
    assert true.range_m == pytest.approx(z[round(0.1 * (len(z) - 1))], abs=2e-3)
    assert true.mean_range_m == pytest.approx(z.mean(), rel=1e-6)
    assert 4.0 < true.range_m < true.mean_range_m


def test_foot_stands_on_the_road_of_a_tilted_rig():
    scene = scene_of(placed(crate(1, "red", RED, (0.5, 1, 0.8)), 5.0, 0.6), height_m=1.3, pitch_rad=0.1, roll_rad=0.06)
    rendered = render(scene, RIG, quality="preview")
    (true,) = rendered.objects
    forward, left, up = true.position_m
    assert forward == pytest.approx(true.range_m)
    assert rendered.ground.height_of(np.array([-left, -up, forward])) == pytest.approx(0, abs=1e-12)


def test_a_mounting_moves_the_position_but_not_the_range():
    mounting = pose(rotation_from_rotvec([0, 0, 0.2]) @ R_VEHICLE_CAR, [1.5, 0.1, 1.2])
    scene = scene_of(placed(crate(1, "red", RED, (0.5, 1, 0.8)), 5.0, 0.6))
    (plain,) = render(scene, RIG, quality="preview").objects
    (mounted,) = render(scene, replace(RIG, T_vehicle_car=mounting), quality="preview").objects
    assert mounted.range_m == plain.range_m
    turned = rotation_from_rotvec([0, 0, 0.2]) @ plain.position_m + [1.5, 0.1, 1.2]
    assert mounted.position_m == pytest.approx(turned, abs=1e-12)


def test_hidden_and_nameless_things_are_left_out_and_the_nearest_comes_first():
    near = placed(crate(1, "red", RED, (0.5, 1.5, 1.6)), 5.0, -1.2)
    hidden = placed(crate(2, "blue", RED, (0.1, 0.2, 0.2)), 9.0, -2.2)
    far = placed(crate(3, "green", RED, (0.5, 1.0, 0.8)), 7.0, 1.5)
    scenery = placed(crate(0, "grey", RED, (0.5, 1.0, 0.8)), 6.0, 2.9)
    scene = scene_of(far, hidden, near, scenery)
    assert [true.id for true in render(scene, RIG, quality="preview").objects] == [1, 3]


def test_ground_has_the_poses_height_pitch_and_roll():
    ground = true_ground(scene_of(height_m=1.3, pitch_rad=0.05))
    assert (ground.height_m, ground.pitch_rad, ground.roll_rad) == pytest.approx((1.3, 0.05, 0))
    ground = true_ground(scene_of(height_m=1.3, roll_rad=-0.04))
    assert (ground.height_m, ground.pitch_rad, ground.roll_rad) == pytest.approx((1.3, 0, -0.04))
