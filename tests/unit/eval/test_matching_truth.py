import itertools

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.match import MatchRules, overlaps, pair_up


def thing(box_px, range_m):
    return {"box_px": box_px, "range_m": range_m}


def test_overlap_of_half_open_boxes_by_hand():
    a = np.array([[0, 0, 4, 2.0], [10, 10, 13, 17]])
    b = np.array([[2, 0, 6, 2.0], [4, 0, 6, 2], [11, 11, 12, 13]])
    # 2x2 of 8 + 8 - 4; touching edges share nothing; 1x2 inside 3x7.
    np.testing.assert_allclose(overlaps(a, b), [[4 / 12, 0, 0], [0, 0, 2 / 21]])


def test_each_thing_gets_its_own_obstacle_whatever_the_order():
    true = [thing([0, 0, 10, 20], 5.0), thing([30, 0, 40, 20], 10.0), thing([60, 0, 70, 20], 20.0)]
    found = [thing([61, 0, 71, 20], 19.0), thing([1, 0, 11, 20], 5.3)]
    assert pair_up(found, true) == [1, None, 0]
    assert pair_up([], true) == [None, None, None]
    assert pair_up(found, []) == []


def test_the_best_sum_wins_where_greed_would_not():
    # The first thing overlaps both, and the near one a little better; but the second thing can only be that one.
    true = [thing([0, 0, 100, 10], 10.0), thing([60, 0, 160, 10], 10.0)]
    found = [thing([24, 0, 124, 10], 10.0), thing([-30, 0, 70, 10], 10.0)]
    greedy = overlaps(np.array([t["box_px"] for t in true], float), np.array([f["box_px"] for f in found], float))
    assert greedy[0, 0] > greedy[0, 1]
    assert pair_up(found, true) == [1, 0]


def test_range_decides_between_equal_boxes():
    true = [thing([0, 0, 10, 10], 8.0), thing([0, 0, 10, 10], 10.0)]
    assert pair_up([thing([0, 0, 10, 10], 9.9), thing([0, 0, 10, 10], 8.1)], true) == [1, 0]


def test_the_sum_is_the_largest_of_all_pairings():
    rng = np.random.default_rng(4)
    for _ in range(20):
        corners = rng.uniform(0, 20, (7, 2))
        things = [thing([u, v, u + 30, v + 25], z) for (u, v), z in zip(corners, rng.uniform(8, 12, 7), strict=True)]
        true, found = things[:3], things[3:]

        def score(pairs, true=true, found=found):
            total = 0.0
            for t, j in zip(true, pairs, strict=True):
                if j is not None:
                    box_t, box_f = np.array([t["box_px"]]), np.array([found[j]["box_px"]])
                    apart = abs(found[j]["range_m"] - t["range_m"]) / (0.5 * t["range_m"])
                    share = overlaps(box_t, box_f)[0, 0]
                    total += share * (1 - apart) if share >= 0.2 and apart < 1 else -1
            return total

        everything = itertools.permutations([0, 1, 2, 3, None, None, None], 3)
        assert score(pair_up(found, true)) == pytest.approx(max(score(pairs) for pairs in everything))


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (thing([0, 0, 10, 10], 14.9), 0),
        (thing([0, 0, 10, 10], 15.0), None),  # half the true range away
        (thing([0, 0, 10, 10], 5.1), 0),
        (thing([0, 0, 10, 10], 5.0), None),
        (thing([0, 0, 2, 10], 10.0), 0),  # overlap 0.2
        (thing([0, 0, 1.9, 10], 10.0), None),
    ],
)
def test_limits_of_the_rules(found, expected):
    assert pair_up([found], [thing([0, 0, 10, 10], 10.0)]) == [expected]


def test_stricter_rules_pair_less():
    found, true = [thing([0, 0, 5, 10], 10.0)], [thing([0, 0, 10, 10], 10.0)]
    assert pair_up(found, true) == [0]
    assert pair_up(found, true, MatchRules(least_overlap=0.6)) == [None]
    assert pair_up([thing([0, 0, 10, 10], 10.3)], true, MatchRules(largest_share=0.02)) == [None]


@pytest.mark.parametrize(
    ("record", "message"),
    [
        ({"range_m": 3.0}, "found obstacle 0 has no box_px"),
        ({"box_px": [0, 0, 1, 1]}, "found obstacle 0 has no range_m"),
        (thing([0, 0, 1, 1], 0.0), "range_m of found obstacle 0 must be > 0, but got 0"),
        (thing([0, 0, 1, 1], float("nan")), "range_m of found obstacle 0 must be finite"),
        (thing([0, 0, 1, 1], "far"), "range_m of found obstacle 0 must be numbers"),
        (thing([5, 0, 5, 1], 3.0), "box_px of found obstacle 0 must be u0 < u1"),
        (thing([0, 2, 5, 1], 3.0), "box_px of found obstacle 0 must be u0 < u1"),
        (thing([0, 2, 5], 3.0), "box_px of found obstacle 0 must have shape"),
    ],
)
def test_broken_records_are_refused(record, message):
    with pytest.raises(ValueRefusedError, match=message):
        pair_up([record], [thing([0, 0, 10, 10], 10.0)])
    with pytest.raises(ValueRefusedError, match=message.replace("found", "true")):
        pair_up([thing([0, 0, 10, 10], 10.0)], [record])


@pytest.mark.parametrize("value", [0.0, 1.1, float("nan")])
def test_an_impossible_overlap_is_refused(value):
    with pytest.raises(ValueRefusedError, match="least_overlap must be > 0 and <= 1"):
        MatchRules(least_overlap=value)


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_an_impossible_share_is_refused(value):
    with pytest.raises(ValueRefusedError, match="largest_share must be > 0 and finite"):
        MatchRules(largest_share=value)
