"""Named things against found obstacles, by hand."""

import math

import pytest

from roadblock.eval.detection import distance_rows, kitti_rows, surety
from roadblock.eval.things import confusion, judge_frame, precision_rows, recall_rows, size_rows


def thing(kind, u0, range_m, **more):
    """A thing 40 px wide and high, 2 m wide, 1.5 m high and 4 m long, straight ahead of u0."""
    box = [u0, 100, u0 + 40, 140]
    place = {"position_m": [range_m, -u0 / 100, 0.0], "center_m": [range_m + 2, -u0 / 100, 0.75], "yaw_rad": 0.0}
    return (
        {"type": kind, "box_px": box, "range_m": range_m, "size_m": [2.0, 1.5, 4.0], "visible_px": 1600} | place | more
    )


def found(u0, range_m, kind="unknown", **more):
    base = {"class": kind, "class_probability": None, "box_px": [u0, 100, u0 + 40, 140], "range_m": range_m}
    base |= {"range_sigma_m": 0.1, "position_m": [range_m, -u0 / 100, 0.0], "size_m": [2.0, 1.5, None]}
    return base | more


TRUE = [thing("car", 0, 9.0), thing("car", 100, 15.0), thing("person", 200, 15.0), thing("van", 300, 18.0)]
FOUND = [
    found(0, 9.4, "car"),
    found(100, 15.9, "truck"),  # 0.9 m off: more than 5 %
    found(300, 18.0, "bus"),
    found(302, 18.4, "car", box_px=[310, 110, 330, 130]),  # a piece of the van
    found(500, 20.0, "car"),
    found(600, 70.0, "car"),  # out of reach
]


def row_of(rows, **keys):
    (row,) = [row for row in rows if all(row[key] == value for key, value in keys.items())]
    return row


def test_recall_by_type_and_range():
    rows = recall_rows([judge_frame(FOUND, TRUE)])
    everything = row_of(rows, type="any", from_m=0, to_m=60)
    assert (everything["n"], everything["recall"], everything["recall_right_range"]) == (4, 0.75, 0.5)
    assert everything["bias_m"] == pytest.approx((0.4 + 0.9 + 0) / 3, abs=1e-5)
    near = row_of(rows, type="car", from_m=0, to_m=10)
    assert (near["n"], near["recall"], near["within_2_sigma"]) == (1, 1.0, 0.0)
    assert row_of(rows, type="person", from_m=10, to_m=20)["recall"] == 0


def test_the_calibrations_sigma_counts_too():
    judged = judge_frame([found(0, 9.4, range_sigma_calib_m=0.4)], TRUE[:1])
    assert recall_rows([judged])[0]["within_1_sigma"] == 1
    assert recall_rows([judge_frame([found(0, 9.4, range_sigma_m=None)], TRUE[:1])])[0]["within_1_sigma"] is None


def test_precision_of_all_and_of_a_class():
    rows = precision_rows([judge_frame(FOUND, TRUE)])
    everything = row_of(rows, **{"class": "any"}, from_m=0, to_m=60)
    figures = [everything[key] for key in ("n", "right", "pieces", "unexplained", "precision")]
    assert figures == [5, 3, 1, 1, 0.8]
    car = row_of(rows, **{"class": "car"}, from_m=0, to_m=60)  # one of two; the piece is no claim of its own
    assert (car["n"], car["right"], car["precision"]) == (3, 1, 0.5)
    truck = row_of(rows, **{"class": "truck"}, from_m=0, to_m=60)  # a car, and a van called bus
    assert (truck["n"], truck["right"], truck["precision"]) == (2, 0, 0.0)


@pytest.mark.parametrize(
    "more", [{"visible_px": 399}, {"range_m": 65.0}, {"occluded": 3}, {"truncated": 0.6}, {"range_m": None}]
)
def test_what_does_not_count_counts_neither_way(more):
    hidden = TRUE[0] | more
    judged = judge_frame([found(0, 58.0 if more.get("range_m") else 9.0)], [hidden])
    assert judged.things == ()
    assert len(judged.claims) == (1 if more == {"range_m": None} else 0)


def test_without_a_count_of_pixels_the_height_decides():
    low = TRUE[0] | {"visible_px": None, "box_px": [0, 100, 40, 124]}
    assert judge_frame([], [low]).things == ()
    assert len(judge_frame([], [low | {"box_px": [0, 100, 40, 125]}]).things) == 1


def test_doubts_excuse_what_lies_half_in_them():
    assert judge_frame([found(500, 20.0)], [], [[500, 100, 520, 140]]).claims == ()
    assert len(judge_frame([found(500, 20.0)], [], [[500, 100, 519, 140]]).claims) == 1


def test_confusion_by_hand():
    """Of 4 things 3 are found: car as car, car as truck, van (a car for this) as bus (a truck)."""
    result = confusion([judge_frame(FOUND, TRUE)])
    assert result["classes"] == ["car", "person"]
    assert result["called"] == ["car", "truck", "unknown", "missed"]
    assert result["counts"] == [[1, 2, 0, 0], [0, 0, 0, 1]]
    assert result["right"] == pytest.approx(1 / 3, abs=1e-5)
    # car: 2 * 1 right / (1 called + 3 true); person, never found: 0
    assert result["macro_f1"] == pytest.approx((2 / 4 + 0) / 2)
    assert result["calibration_error"] is None


def test_where_nothing_is_named_there_is_no_share():
    result = confusion([judge_frame([found(0, 9.0)], TRUE[:1])])
    assert (result["right"], result["macro_f1"], result["counts"]) == (None, None, [[1, 0]])


def test_calibration_error_by_hand():
    """Four at .95, three of them right (off by .2); one at .35, wrong (off by .35): (4 * .2 + .35) / 5."""
    things = [thing("car", 100 * k, 10.0) for k in range(5)]
    names = ["car", "car", "car", "person", "person"]
    obstacles = [found(100 * k, 10.0, name, class_probability=0.95) for k, name in enumerate(names)]
    obstacles[4]["class_probability"] = 0.35
    assert confusion([judge_frame(obstacles, things)])["calibration_error"] == pytest.approx(1.15 / 5)


def test_sizes_across_and_along():
    """A car turned by 90 degrees is 4 m across; one cut at 2.5 m is 1.5 m too narrow."""
    aside = thing("car", 0, 9.0, yaw_rad=math.pi / 2)
    ahead = thing("car", 100, 9.0)
    obstacles = [found(0, 9.0, size_m=[4.1, 1.5, 1.95]), found(100, 9.0, size_m=[0.5, 1.7, None])]
    rows = size_rows([judge_frame(obstacles, [aside, ahead])])
    width = row_of(rows, type="car", size="width")
    assert (width["n"], width["bias_m"], width["right"]) == (2, pytest.approx(-0.7), 0.5)
    assert row_of(rows, type="any", size="height")["median_abs_m"] == pytest.approx(0.1)
    assert row_of(rows, type="car", size="length")["bias_m"] == pytest.approx(-0.05)
    assert size_rows([judge_frame(obstacles, [aside | {"yaw_rad": None}])]) == []


def test_kitti_levels_and_likes():
    """Two cars, one hidden: easy and moderate want one; the van counts neither way; nobody has a length."""
    true = [thing("car", 0, 9.0), thing("car", 100, 15.0, occluded=2), thing("van", 300, 18.0)]
    obstacles = [found(0, 9.0, "car", class_probability=0.9), found(300, 18.0, "car", class_probability=0.99)]
    rows = kitti_rows([(obstacles, true, [])])
    assert [row_of(rows, **{"class": "car"}, level=level)["ap_2d"] for level in ("moderate", "hard")] == [1, 0.5]
    assert row_of(rows, **{"class": "car"}, level="easy")["ap_2d"] == 1
    assert row_of(rows, **{"class": "car"}, level="hard")["ap_bev"] is None
    # of any class the van counts: 2 of 3 found
    assert row_of(rows, **{"class": "any"}, level="hard")["ap_2d"] == pytest.approx(26 / 40)


def test_small_boxes_of_either_side_count_neither_way():
    """24 px are too few for every level, 39 px for easy."""
    true = [thing("car", 0, 9.0), thing("car", 100, 15.0, box_px=[100, 100, 140, 124])]
    obstacles = [found(0, 9.0, "car"), found(300, 9.0, "car", box_px=[300, 100, 340, 124], class_probability=0.9)]
    rows = kitti_rows([(obstacles, true, [])])
    assert [row["ap_2d"] for row in rows if row["class"] == "car"] == [1, 1, 1]
    lower = [o | {"box_px": [o["box_px"][0], 100, o["box_px"][0] + 40, 139]} for o in obstacles[:1]]
    rows = kitti_rows([(lower, true, [])])
    assert [row["ap_2d"] for row in rows if row["class"] == "car"] == [0, 1, 1]


def test_kitti_from_above():
    """Boxes of 2 x 4 m: the same place overlaps wholly, 1 m nearer by 6 of 10 (too little for a car)."""
    true = [thing("car", 0, 9.0), thing("car", 100, 15.0), thing("car", 200, 15.0, yaw_rad=None)]
    obstacles = [
        found(0, 9.0, "car", size_m=[2.0, 1.5, 4.0]),
        found(100, 14.0, "car", size_m=[2.0, 1.5, 4.0]),
        found(200, 15.0, "car"),
    ]
    rows = kitti_rows([(obstacles, true, [])])
    assert row_of(rows, **{"class": "car"}, level="hard")["ap_bev"] == pytest.approx(13 / 40)
    assert row_of(rows, **{"class": "any"}, level="hard")["ap_bev"] == pytest.approx(26 / 40)


def test_a_heading_turns_the_footprint():
    """4 m long to the left, seen from its side at 9 m: its middle is 1 m behind the face."""
    true = [thing("car", 0, 9.0, yaw_rad=math.pi / 2, center_m=[10.0, 0.0, 0.75])]
    aside = found(0, 9.0, "car", size_m=[2.0, 1.5, 4.0], heading_rad=math.pi / 2)
    assert row_of(kitti_rows([([aside], true, [])]), **{"class": "car"}, level="hard")["ap_bev"] == 1
    straight = found(0, 9.0, "car", size_m=[2.0, 1.5, 4.0])
    assert row_of(kitti_rows([([straight], true, [])]), **{"class": "car"}, level="hard")["ap_bev"] == 0


def test_distances_on_the_road():
    """0.4 m off counts at half a metre, 0.9 m at one; precision of all that counts."""
    rows = distance_rows([judge_frame(FOUND[:2], TRUE[:2])])
    car = row_of(rows, **{"class": "car"})
    assert (car["ap_1m"], car["ap_4m"]) == (car["ap_0.5m"], car["ap_0.5m"])  # the other is called truck
    assert row_of(rows, **{"class": "any"})["ap_1m"] == pytest.approx(1)
    assert row_of(rows, **{"class": "any"})["ap_0.5m"] < 0.5


def test_the_surest_is_the_one_with_the_score_or_the_nearest():
    assert surety(found(0, 9.0, score=0.3, class_probability=0.9)) == 0.3
    assert surety(found(0, 9.0, class_probability=0.9)) == 0.9
    assert surety(found(0, 9.0)) == pytest.approx(0.1)
