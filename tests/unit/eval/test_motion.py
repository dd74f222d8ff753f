"""What is known over time, by hand."""

import numpy as np
import pytest

from roadblock.eval.motion import (
    driven_km,
    seen_frame,
    true_ttc_s,
    true_velocity_mps,
    ttc_rows,
    velocity_rows,
    warning_record,
)
from roadblock.eval.things import Judged, judge_frame


def thing(number, u0, velocity_mps=(0.0, 0.0, 0.0), range_m=10.0, **more):
    base = {"id": number, "type": "car", "box_px": [u0, 0, u0 + 40, 40], "range_m": range_m, "visible_px": 1600}
    base |= {"size_m": [2.0, 1.5, 4.0], "position_m": [range_m, 0.0, 0.0], "velocity_mps": list(velocity_mps)}
    return base | more


def track(number, u0, range_m=10.0, **more):
    base = {"id": number, "box_px": [u0, 0, u0 + 40, 40], "range_m": range_m, "age_s": 2.0, "ttc_s": None}
    return base | {"velocity_mps": [0.0, 0.0, 0.0], "velocity_over_ground": True, "motion": "standing"} | more


def ego(x_m, speed_mps=10.0):
    pose = np.eye(4)
    pose[0, 3] = x_m
    return {"T_world_vehicle": pose.tolist(), "speed_mps": speed_mps}


def test_tracks_of_what_has_no_name_are_not_judged():
    true = [thing(1, 0), thing(2, 100, visible_px=10)]
    frame = seen_frame([track(7, 10), track(8, 100), track(9, 300), track(None, 0)], true)
    assert (frame.true_ids.tolist(), frame.track_ids.tolist()) == ([1], [7])  # 8 follows a thing that does not count
    assert frame.similarity.tolist() == [[pytest.approx(30 / 50)]]
    assert seen_frame([], []).similarity.shape == (0, 0)


def test_tracks_of_a_house_behind_a_thing_are_not_judged():
    """What overlaps by 0.14 is the thing if at its depth (10 to 14 m and a bit), and what does by 0.6 at any depth."""
    true = [thing(1, 0)]
    frame = seen_frame([track(7, 30, 25.0), track(8, 30, 13.0), track(9, 10, 25.0)], true)
    assert frame.track_ids.tolist() == [8, 9]


def test_structures_and_their_tracks_count_neither_way():
    true = [thing(1, 0), thing(2, 100) | {"type": "railing"}]
    frame = seen_frame([track(7, 0), track(8, 100)], true)
    assert (frame.true_ids.tolist(), frame.track_ids.tolist()) == ([1], [7])


def test_what_has_no_range_has_no_tracks():
    frame = seen_frame([track(7, 10)], [thing(1, 0, range_m=None)])
    assert (len(frame.true_ids), len(frame.track_ids)) == (0, 0)


def test_places_are_alike_up_to_two_metres():
    """0.3 m ahead and 0.4 m aside of one; of what is 5 m off nothing is alike, though the boxes touch."""
    true = [thing(1, 0), thing(2, 100)]
    found = [track(7, 0, position_m=[10.3, 0.4, 0.0]), track(8, 100, position_m=[15.0, 0.0, 0.0])]
    alike = seen_frame(found, true, by_place=True).similarity
    np.testing.assert_allclose(alike, [[0.75, 0.0], [0.75, 0.0]])


def test_velocities_by_hand():
    """Standing: off by 0.3 and 0.4 m/s with sigmas of 0.2; moving at 4 m/s: off by 1 m/s without sigma."""
    true = [thing(1, 0), thing(2, 100, (4.0, 0.0, 0.0), 30.0), thing(3, 200, (0.3, 0.0, 0.0)), thing(4, 300)]
    found = [
        track(1, 0, velocity_mps=[0.3, 0.4, 0.0], velocity_sigma_mps=[0.2, 0.2]),
        track(2, 100, 30.0, velocity_mps=[5.0, 0.0, 0.0]),
        track(3, 200),  # neither stands nor moves
        track(4, 300, age_s=0.5),  # not settled
    ]
    rows = {(r["motion"], r["from_m"], r["to_m"]): r for r in velocity_rows([judge_frame(found, true)])}
    assert set(rows) == {("standing", 0, 20), ("standing", 0, 40), ("moving", 20, 40), ("moving", 0, 40)}
    standing, moving = rows["standing", 0, 20], rows["moving", 20, 40]
    assert (standing["n"], standing["rms_mps"]) == (1, pytest.approx(0.5))
    assert standing["normalized"] == pytest.approx((1.5**2 + 2**2) / 2)
    assert standing["told_right"] == 1
    assert (moving["rms_mps"], moving["normalized"], moving["told_right"]) == (1.0, None, 0.0)


@pytest.mark.parametrize("more", [{"velocity_over_ground": False}, {"velocity_mps": None}])
def test_velocities_that_are_none_over_ground_are_not_judged(more):
    assert velocity_rows([judge_frame([track(1, 0, **more)], [thing(1, 0)])]) == []


def test_the_rear_of_a_car_that_turns_left_swings_out_to_the_right():
    turning = thing(1, 0, (8.0, 1.0, 0.0), center_m=[12.0, 1.0, 0.7], yaw_rate_radps=0.1)
    assert true_velocity_mps(turning, [10.0, 1.5, 0.0]) == pytest.approx((7.95, 0.8))
    for unknown in ({"center_m": None}, {"yaw_rate_radps": None}):
        assert true_velocity_mps(turning | unknown, [10.0, 1.5, 0.0]) == (8.0, 1.0)
    found = track(1, 0, velocity_mps=[8.1, 0.8, 0.0], position_m=[10.0, 0.0, 0.0])
    row = velocity_rows([judge_frame([found], [turning])])[0]
    assert row["rms_mps"] == pytest.approx(0.0, abs=1e-6)


def test_true_times_to_contact():
    assert true_ttc_s(thing(1, 0), ego(0)) == 1.0
    assert true_ttc_s(thing(1, 0, (-10.0, 0, 0)), ego(0)) == 0.5
    assert np.isnan(true_ttc_s(thing(1, 0, (9.6, 0, 0)), ego(0)))  # comes closer by less than 0.5 m/s
    assert np.isnan(true_ttc_s(thing(1, 0), None))
    assert np.isnan(true_ttc_s(thing(1, 0, range_m=None), ego(0)))


def test_times_to_contact_by_hand():
    true = [thing(k, 100 * k, range_m=20.0) for k in range(4)]
    found = [
        track(0, 0, 20.0, ttc_s=2.1, ttc_sigma_s=0.06),
        track(1, 100, 20.0, ttc_s=1.8, ttc_sigma_s=0.05),
        track(2, 200, 20.0),
    ]
    (row, total) = ttc_rows([judge_frame(found, true)], [ego(0)])
    assert (row["from_s"], row["n"]) == (1.5, 3)
    assert row["unknown"] == pytest.approx(1 / 3, abs=1e-5)
    assert row["median"] == pytest.approx((0.05 + 0.1) / 2)
    assert row["within_2_sigma"] == 0.5
    assert total["n"] == 3
    (nothing, _) = ttc_rows([judge_frame(found[2:], true)], [ego(0)])
    assert (nothing["unknown"], nothing["median"]) == (1, None)
    assert ttc_rows([Judged((), ())], [None]) == []


def test_false_warnings_per_km():
    """2 km; one warning before a thing ahead, one before a thing far aside; the second lasts two frames."""
    aside = thing(1, 0, range_m=40.0, position_m=[40.0, 5.0, 0.0])
    far = thing(1, 0, range_m=70.0)
    objects = [[thing(1, 0, range_m=40.0)], [], [aside], [aside], [far]]
    true = [{"objects": o, "ego": ego(500.0 * k)} for k, o in enumerate(objects)]
    actions = ["brake", "none", "warn", "warn", None]
    found = [{"decision": None if a is None else {"action": a}} for a in actions]
    assert warning_record(found, true) == {"warnings": 2, "false": 1, "false_per_km": 0.5, "km": 2.0}
    found[4] = {"decision": {"action": "swerve"}}  # 7 s ahead, but the warning goes on
    assert warning_record(found, true)["warnings"] == 2
    found[3] = {}
    assert warning_record(found, true)["false"] == 2


def test_without_decisions_or_poses_nothing_is_said():
    true = [{"objects": [], "ego": None}] * 2
    expected = {"warnings": None, "false": None, "false_per_km": None, "km": None}
    assert warning_record([{}, {}], true) == expected
    assert driven_km([ego(0), ego(30)]) == pytest.approx(0.03)
    assert warning_record([{"decision": {"action": "warn"}}, {}], true)["false_per_km"] is None
