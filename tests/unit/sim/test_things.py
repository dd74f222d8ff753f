import numpy as np
import pytest

from roadblock.sim.things import crate, house, person, tree


def test_crate_has_its_size():
    assert crate(1, "red", (200, 0, 0), (0.7, 0.9, 0.8)).size_m == pytest.approx([0.9, 0.8, 0.7])


@pytest.mark.parametrize("height_m", [1.2, 1.75, 1.95])
def test_person_has_a_persons_size(height_m):
    thing = person(1, "blue", (0, 0, 200), (0, 0, 90), height_m)
    low, high = thing.bounds_m(np.eye(4))
    assert low[2] == pytest.approx(0, abs=0.01)
    assert high[2] == pytest.approx(height_m, rel=0.005)
    width, _, length = thing.size_m / height_m
    assert 0.25 < width < 0.4
    assert 0.25 < length < 0.4


def test_scenery_has_no_name():
    assert house((200, 200, 200), (150, 60, 50), (10.0, 8.0, 5.0)).id == 0
    assert tree((70, 110, 50), 7.0, np.random.default_rng(0)).id == 0


def test_house_stands_on_the_ground_with_a_roof_over_its_eaves():
    low, high = house((200, 200, 200), (150, 60, 50), (10.0, 8.0, 5.0)).bounds_m(np.eye(4))
    assert low[2] == 0
    # A right-angled gable over 8 m and 0.4 m of eaves on both sides.
    assert high[2] == pytest.approx(5 + 4.4)


def test_tree_is_drawn_from_its_generator():
    a, b = (tree((70, 110, 50), 7.0, np.random.default_rng(seed)) for seed in (3, 3))
    c = tree((70, 110, 50), 7.0, np.random.default_rng(4))
    assert np.array_equal(a.bounds_m(np.eye(4)), b.bounds_m(np.eye(4)))
    assert not np.array_equal(a.bounds_m(np.eye(4)), c.bounds_m(np.eye(4)))
