from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, transform
from roadblock.sim.conditions import CONDITIONS, Effects, combined
from roadblock.sim.photograph import photograph, street_lamps
from roadblock.sim.render import render_linear
from roadblock.sim.road import Road, height_m, pose_on
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.sensor import MIDDLE_GREY, Sensor, luminance
from roadblock.sim.solids import placed
from roadblock.sim.things import crate, street_lamp
from roadblock.sim.weather import AIRLIGHT, Weather, hanging_lamps
from roadblock.values.camera import Camera, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))
CRATE = placed(crate(7, "red", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.3)
SCENE = Scene((CRATE,), Road(), camera_pose(1.3, 0.05), speed_mps=8.0)
LINEAR = Effects(Sensor(gamma=1.0, bits=16))


def taken(effects: Effects = LINEAR, scene: Scene = SCENE, rig: StereoRig = RIG, **more):
    return photograph(scene, rig, effects, quality="preview", **more)


def test_without_effects_the_image_is_the_light():
    seen = render_linear(SCENE, RIG, quality="preview")
    picture = taken(index=4, name="x", t_ns=9)
    for image, sighted in ((picture.pair.left, seen.left), (picture.pair.right, seen.right)):
        assert image / 65535 == pytest.approx(np.minimum(sighted.light, 1), abs=1e-5)
    assert (picture.pair.index, picture.pair.name, picture.pair.t_ns) == (4, "x", 9)
    assert (picture.ids == seen.left.ids).all()
    assert [true.id for true in picture.objects] == [7]


def test_no_such_quality():
    with pytest.raises(ValueRefusedError, match="quality"):
        photograph(SCENE, RIG, LINEAR, quality="best")


def test_both_cameras_are_metered_by_the_left_one():
    picture = taken(Effects(replace(LINEAR.sensor, exposure=None)))
    left = luminance((picture.pair.left / 65535).astype(np.float32))
    assert np.exp(np.log(left).mean()) == pytest.approx(MIDDLE_GREY, rel=0.1)  # the sky is clipped
    plain = taken()
    ratios = [
        np.median(a[40:] / np.maximum(b[40:], 1))
        for a, b in ((picture.pair.left, plain.pair.left), (picture.pair.right, plain.pair.right))
    ]
    assert ratios[0] == pytest.approx(ratios[1], rel=1e-3)


@pytest.mark.parametrize("name", CONDITIONS)
def test_every_condition_gives_the_same_bytes_for_the_same_seed(name):
    first, again, other = (taken(combined((name,)), seed=seed) for seed in (1, 1, 2))
    assert (first.pair.left == again.pair.left).all()
    assert (first.pair.right == again.pair.right).all()
    assert (first.pair.left != other.pair.left).any()
    assert first.pair.left.std() > 2


def test_noise_differs_between_cameras_and_frames():
    blank = Scene((), Road(contrast=0.0), camera_pose(1.3), seed=1)
    effects = Effects(Sensor(full_well_e=500.0, gamma=1.0, bits=16))
    clean = taken(scene=blank)
    noise = [
        (picture - reference.astype(float))[45:].ravel()
        for frame in (0, 1)
        for pair in [taken(effects, blank, index=frame).pair]
        for picture, reference in ((pair.left, clean.pair.left), (pair.right, clean.pair.right))
    ]
    assert np.abs(np.corrcoef(noise) - np.eye(4)).max() < 0.06


def test_dirt_stays_where_it_is_from_frame_to_frame():
    effects = replace(LINEAR, weather=Weather(dirt=0.9, dirty_side="right"))
    first, later = taken(effects, index=0), taken(effects, index=5)
    assert (first.pair.right == later.pair.right).all()
    assert (first.pair.left == taken().pair.left).all()
    assert (first.pair.right != taken().pair.right).any()


def test_fog_is_thicker_for_the_camera_that_is_farther_off():
    effects = replace(LINEAR, weather=Weather(visibility_m=6.0))
    picture, clear = taken(effects), taken()
    through = 0.05 ** (picture.depth_m[45, 60] / 6.0)  # near the axis of the camera
    expected = clear.pair.left[45, 60] / 65535 * through + AIRLIGHT * (1 - through)
    assert picture.pair.left[45, 60] / 65535 == pytest.approx(expected, rel=0.05)


def test_only_the_asphalt_gets_wet():
    road = Road(-1.0, 1.0, (), curvature_per_m=0.05, grade=0.1, grade_from_m=3.0, kerb_m=0.1)
    scenery = placed(crate(0, "", (90, 90, 90), (0.3, 0.4, 0.5)), 3.0, -0.6)
    scene = Scene((CRATE, scenery), road, camera_pose(1.3, 0.05))
    changed = (
        taken(replace(LINEAR, weather=Weather(wetness=1.0)), scene).pair.left != taken(scene=scene).pair.left
    ).any(-1)
    points = render_linear(scene, RIG, quality="preview")
    v, u = np.nonzero(changed)
    depth = points.left.depth_m[v, u]
    rays = np.stack([(u - CAMERA.cx_px) / 80.0, (v - CAMERA.cy_px) / 80.0, np.ones(len(u))], 1) * depth[:, None]
    world = transform(scene.T_world_car @ points.left.T_car_camera, rays)
    assert len(u) > 200
    line = np.array([pose_on(road, along, 0.0)[:2, 3] for along in np.linspace(0, 60, 601)])
    for x, y, z in world[::20]:
        assert np.hypot(*(line - (x, y)).T).min() < 1.06
        assert z == pytest.approx(height_m(road, x, y), abs=0.006)


def test_the_right_camera_may_expose_later():
    effects = Effects(replace(LINEAR.sensor, right_delay_s=0.1))
    picture, now, then = taken(effects), taken(), taken(scene=SCENE.at(0.1))
    assert (picture.pair.left == now.pair.left).all()
    assert (picture.pair.right == then.pair.right).all()


def test_a_rolling_shutter_exposes_rows_one_after_the_other():
    effects = Effects(replace(LINEAR.sensor, rolling_shutter_s=0.1))
    wall = replace(SCENE, things=(placed(crate(7, "red", (200, 30, 30), (0.5, 6.0, 3.0)), 5.0, 0.3),))
    rolling, now = (taken(e, wall).pair.left.astype(int) for e in (effects, LINEAR))
    early, late = (taken(scene=wall.at(t)).pair.left.astype(int) for t in (-0.045, 0.045))
    assert np.abs(rolling[:5] - early[:5]).mean() < np.abs(rolling[:5] - late[:5]).mean()
    assert np.abs(rolling[-5:] - late[-5:]).mean() < np.abs(rolling[-5:] - early[-5:]).mean()
    assert (rolling[-5:] != now[-5:]).any()


def test_the_scenes_own_street_lamps_shine_where_their_heads_are():
    lamp = placed(street_lamp((120, 120, 120), 6.0), 12.0, 4.0, -np.pi / 2)
    scene = replace(SCENE, things=(CRATE, lamp))
    (at,) = transform(scene.T_world_car, street_lamps(scene))
    assert at == pytest.approx([12.125, 2.6, 6.04], abs=0.1)
    assert street_lamps(SCENE) == pytest.approx(hanging_lamps(SCENE.T_world_car))


def test_a_lens_that_sees_nothing_in_the_corners_is_no_trouble():
    raw = Camera((97, 61), 40.0, 40.0, 48.0, 30.0, "brown_conrady", [-0.5, 0, 0, 0, 0])
    rig = StereoRig(raw, raw, pose(np.eye(3), [0.3, 0, 0]))
    picture = taken(Effects(Sensor(), combined(("night", "rain", "fog", "dirty")).weather), rig=rig)
    assert picture.pair.left.shape == (61, 97, 3)
    assert picture.disparity is None
