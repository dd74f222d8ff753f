"""Average precision against examples worked by hand."""

import math

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.average_precision import Candidates, distance_average_precision, kitti_average_precision


def frame(score, overlap, *, small=(), optional=(), doubt=None, true=None):
    overlap = np.array(overlap, float).reshape(len(score), -1 if true is None else true)
    is_small, is_optional = np.zeros(len(score), bool), np.zeros(overlap.shape[1], bool)
    is_small[list(small)] = True
    is_optional[list(optional)] = True
    return Candidates(
        np.array(score, float),
        overlap,
        is_small,
        is_optional,
        np.zeros(len(score)) if doubt is None else np.array(doubt),
    )


def test_kitti_by_hand():
    """Two true things; found: a hit at .9, a ghost at .8, a hit at .7.

    Recall 1/2 is reached at .9, with precision 1; recall 1 at .7, with precision 2/3: 20 recalls of each.
    """
    frames = [frame([0.9, 0.8], [[0.8], [0.1]]), frame([0.7], [[0.75]])]
    assert kitti_average_precision(frames, 0.7) == pytest.approx((1 + 2 / 3) / 2)
    assert kitti_average_precision(frames, 0.76) == pytest.approx(1 / 2)  # of the first thing alone
    assert kitti_average_precision(frames, 0.8) == 0  # above, not at


def test_a_later_higher_precision_counts_for_lower_recalls():
    """A ghost first, then two hits: precision 1/2 at recall 1/2, but 2/3 at recall 1, which stands for both."""
    assert kitti_average_precision([frame([0.9, 0.8, 0.7], [[0, 0], [1, 0], [0, 1]])], 0.5) == pytest.approx(2 / 3)


def test_three_things_share_the_forty_recalls():
    """One hit of three: recall 1/3 covers the recalls up to 13/40."""
    assert kitti_average_precision([frame([0.9], [[1, 0, 0]])], 0.5) == pytest.approx(13 / 40)


def test_what_counts_neither_way():
    hit = frame([0.9], [[0.9]])
    small = frame([0.95], [[0.0]], small=[0], optional=[0])
    neighbour = frame([0.95], [[0.9]], optional=[0])
    doubtful = frame([0.95], np.zeros((1, 0)), doubt=[0.6], true=0)
    assert kitti_average_precision([hit, small, neighbour, doubtful], 0.5) == pytest.approx(1)
    ghost = frame([0.95], np.zeros((1, 0)), doubt=[0.4], true=0)
    assert kitti_average_precision([hit, ghost], 0.5) == pytest.approx(1 / 2)
    assert math.isnan(kitti_average_precision([neighbour], 0.5))


def test_each_thing_takes_one_found_and_the_second_is_wrong():
    twice = frame([0.9, 0.8], [[0.9], [0.95]])
    assert kitti_average_precision([twice], 0.5) == 1  # at .9 the second is not looked at yet
    late = frame([0.9, 0.8, 0.7], [[0.9, 0], [0.95, 0], [0, 0.9]])
    # recall 1 needs .7, where the better box (.8) takes the first thing and .9 is wrong: 2 of 3
    assert kitti_average_precision([late], 0.5) == pytest.approx((1 + 2 / 3) / 2)


def test_a_thing_whose_only_found_one_is_small_is_no_hit_and_no_ghost():
    assert kitti_average_precision([frame([0.9, 0.8], [[0.9, 0], [0, 0.9]], small=[0])], 0.5) == pytest.approx(1 / 2)


def test_nuscenes_by_hand():
    """Two things, a hit, a ghost, a hit: precision 1 up to recall .5, then from 1/2 (after the ghost) up to 2/3.

    Between recall .5 and 1 nuScenes interpolates linearly over the curve's points (.5, 1), (.5, 1/2), (1, 2/3). At .5
    itself numpy takes the last of the equal points.
    """
    frames = [frame([0.9, 0.8], [[0.3], [5.0]]), frame([0.7], [[0.9]])]
    recalls = np.arange(11, 101) / 100
    curve = np.where(recalls < 0.5, 1.0, 1 / 2 + (recalls - 0.5) / 3)
    assert distance_average_precision(frames, 1.0) == pytest.approx(np.mean(curve - 0.1) / 0.9)
    only_first = np.where(recalls < 0.5, 1.0, np.where(recalls == 0.5, 1 / 3, 0.0))
    assert distance_average_precision(frames, 0.5) == pytest.approx(np.maximum(only_first - 0.1, 0).mean() / 0.9)


def test_nuscenes_perfect_nothing_and_no_truth():
    assert distance_average_precision([frame([0.9], [[0.2]])], 0.5) == pytest.approx(1)
    assert distance_average_precision([frame([0.9], [[np.nan]])], 4.0) == 0
    assert distance_average_precision([frame([], np.zeros((0, 1)), true=1)], 4.0) == 0
    assert math.isnan(distance_average_precision([frame([0.9], np.zeros((1, 0)), true=0)], 4.0))


def test_nuscenes_takes_the_surest_first_and_each_thing_once():
    """Both lie near the one thing; the surer takes it, though it is farther off, and the other is a ghost."""
    frames = [frame([0.5, 0.9], [[0.1], [0.4]]), frame([0.4], [[0.1]])]
    recalls = np.arange(11, 101) / 100
    curve = np.where(recalls < 0.5, 1.0, 1 / 2 + (recalls - 0.5) / 3)
    assert distance_average_precision(frames, 0.5) == pytest.approx(np.mean(curve - 0.1) / 0.9)


def test_shapes_must_fit():
    with pytest.raises(ValueRefusedError, match=r"overlap must have shape \(1, 1\).*but got \(2, 1\), 1 and 1"):
        Candidates(np.ones(1), np.ones((2, 1)), np.zeros(1, bool), np.zeros(1, bool), np.zeros(1))
