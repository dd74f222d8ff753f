"""Line-ups show every target once, where it is said to stand."""

import numpy as np
import pytest

from roadblock.sim.lineup import TARGETS, lineup
from roadblock.sim.render import render_linear
from roadblock.sim.scene import paper_rig


@pytest.mark.parametrize("range_m", [5.0, 20.0, 60.0])
def test_every_target_is_shown_once_and_at_its_range(range_m: float) -> None:
    pictures = lineup(3, range_m, paper_rig())
    assert sorted(t.name for _, shown in pictures for t in shown.values()) == sorted(t.name for t in TARGETS)
    for scene, shown in pictures:
        for thing in scene.things:
            if thing.id:
                nearest_m = thing.bounds_m(thing.T_world_thing)[0, 0]
                assert nearest_m == pytest.approx(range_m, rel=0.051)
                assert thing.type == shown[thing.id].order.type


def test_a_seed_is_a_line_up() -> None:
    (a, _), (b, _), (c, _) = (lineup(seed, 20.0, paper_rig())[0] for seed in (1, 1, 2))
    np.testing.assert_array_equal(a.things[0].T_world_thing, b.things[0].T_world_thing)
    assert not np.array_equal(a.things[0].T_world_thing, c.things[0].T_world_thing)


def test_both_cameras_see_all_of_them_near_by() -> None:
    for scene, shown in lineup(4, 5.0, paper_rig()):
        seen = render_linear(scene, paper_rig(), quality="preview", threads=1)
        for side in (seen.left, seen.right):
            assert set(shown) <= set(np.unique(side.ids).tolist())
            assert not set(np.unique(side.ids[:, [0, -1]]).tolist()) & set(shown), "cut off by the border"
