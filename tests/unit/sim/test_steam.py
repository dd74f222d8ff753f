"""Steam by hand: what it takes and adds, that it comes anew, and that nobody can touch it."""

import numpy as np
import pytest

from roadblock.geometry.pose import pose
from roadblock.sim.challenges import CHALLENGES
from roadblock.sim.render import render
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.solids import Thing, ellipsoid, moved
from roadblock.sim.steam import BRIGHTNESS, FADE_M, GROWTH, LEAST_M, THICKNESS, WAY_M, steam, veiled
from roadblock.values.camera import Camera, StereoRig


def puff(at_m: tuple[float, float, float], way_m: float = 0.0) -> Thing:
    half = np.full(3, 2 * (LEAST_M + GROWTH * way_m))
    return Thing(0, "steam", "white", (ellipsoid(half, at_m, (255, 255, 255)),))


@pytest.mark.parametrize(
    ("far_m", "aside_m", "way_m", "thickness"),
    [
        (np.inf, 0.0, 0.0, THICKNESS),
        (5.0, 0.0, 0.0, THICKNESS / 2),
        (2.0, 0.0, 0.0, 0.0),
        (np.inf, LEAST_M, 0.0, THICKNESS * np.exp(-0.5)),
        (np.inf, 0.0, FADE_M, THICKNESS / np.e),
    ],
)
def test_a_puff_takes_light_as_thick_as_it_is_before_what_is_seen(
    far_m: float, aside_m: float, way_m: float, thickness: float
) -> None:
    light = np.full((1, 1, 3), 0.2, np.float32)
    veiled(light, np.full((1, 1), far_m), np.array([[[1.0, 0.0, 0.0]]]), np.zeros(3), puff((5.0, aside_m, 0.0), way_m))
    through = np.exp(-thickness)
    np.testing.assert_allclose(light, 0.2 * through + BRIGHTNESS * (1 - through), rtol=1e-5)


def test_what_is_behind_the_camera_is_not_seen() -> None:
    light = np.full((1, 1, 3), 0.2, np.float32)
    veiled(light, np.full((1, 1), np.inf), np.array([[[1.0, 0.0, 0.0]]]), np.zeros(3), puff((-5.0, 0.0, 0.0)))
    np.testing.assert_allclose(light, 0.2)


def test_steam_rises_from_where_it_is_and_never_ends() -> None:
    cloud = steam(np.random.default_rng(1))
    for t_s in (0.0, 1.0, 50.0):
        now = moved(cloud, t_s)
        at = np.array([(now.T_world_thing @ part.T_thing_part)[:3, 3] for part in now.parts])
        assert -0.5 < at[:, 2].min() < 0.5
        assert 2.0 < at[:, 2].max() < WAY_M + 0.5
        assert np.hypot(at[:, 0], at[:, 1]).max() < 0.7 * WAY_M


def test_it_is_in_nobodys_way_and_moves_with_its_scene() -> None:
    scene = CHALLENGES["steam"](0).scene
    (cloud,) = scene.clouds
    assert cloud.type == "steam"
    assert all(thing.type != "steam" for thing in scene.things)
    (later,) = scene.at(0.5).clouds
    np.testing.assert_allclose(later.T_world_thing[:3, 3] - cloud.T_world_thing[:3, 3], 0.5 * cloud.velocity_mps)


@pytest.mark.parametrize("lens", ["pinhole", "kannala_brandt"])
def test_a_cloud_shows_where_it_is_and_hides_nothing_from_the_truth(lens: str) -> None:
    camera = Camera((64, 48), 60.0, 60.0, 31.0, 20.0, lens, () if lens == "pinhole" else (0.0,) * 4)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.2, 0.0, 0.0]))
    cloud = puff((6.0, 0.1, 1.4))
    with_it, without = (
        render(Scene((), Road(), camera_pose(), clouds=clouds), rig, quality="preview", noise=0)
        for clouds in ((cloud,), ())
    )
    changed = (with_it.pair.left != without.pair.left).any(-1)
    v, u = np.nonzero(changed)
    assert abs(u.mean() - 31.0) < 1.5
    assert abs(v.mean() - 20.0) < 1.5
    np.testing.assert_array_equal(with_it.depth_m, without.depth_m)
    np.testing.assert_array_equal(with_it.ids, without.ids)
