import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.evaluate import evaluate
from roadblock.eval.plain import plain_record, share
from roadblock.values.true_map import TrueMap


def frame(name, number=None):
    obstacle = {"id": number, "class": "unknown", "class_probability": None, "box_px": [0, 0, 40, 40], "range_m": 10.0}
    obstacle |= {
        "position_m": [10.0, 0.0, 0.0],
        "size_m": [2.0, 1.5, None],
        "range_sigma_m": None,
        "velocity_mps": None,
    }
    return {"name": name, "obstacles": [obstacle]}


def truth(name, **more):
    thing = {"type": "car", "box_px": [0, 0, 40, 40], "range_m": 10.0, "position_m": [10.0, 0.0, 0.0]}
    return {"name": name, "objects": [thing | {"size_m": [2.0, 1.5, 4.0], "visible_px": 1600} | more]}


def test_what_is_there_is_judged_and_what_is_missing_counts():
    result = evaluate([frame("a"), frame("x")], [truth("a"), truth("b")])
    assert result["frames"] == {"judged": 2, "missing": 1, "without_truth": 1}
    assert result["things"]["recall"][0]["recall"] == 0.5
    assert [r["range_m"] for r in result["things"]["readings"]] == [10.0, None]
    assert result["tracks"] is result["maps"] is None


def test_tracks_need_numbers_on_both_sides():
    assert evaluate([frame("a", 5)], [truth("a")])["tracks"] is None
    assert evaluate([frame("a")], [truth("a", id=1)])["tracks"] is None
    tracks = evaluate([frame("a", 5)], [truth("a", id=1)])["tracks"]
    assert tracks["scores"]["hota"] == tracks["scores"]["mota"] == 1
    assert tracks["velocity"] == tracks["ttc"] == []
    assert tracks["warnings"]["false_per_km"] is None


def test_maps_alone():
    shown = TrueMap("a", np.ones((30, 30), np.float32), np.zeros((30, 30), np.uint16), 100.0, 15.0, 15.0, 0.5)
    result = evaluate([frame("a")], [], lambda: [shown])
    assert result["things"] is result["tracks"] is None
    assert result["maps"]["frames"] == result["frames"]["judged"] == 1


@pytest.mark.parametrize(
    ("found", "true", "says"),
    [
        ([frame("a")], [truth("b")], "none of the 1 frames of the results is one of the 1 of the truth"),
        ([frame("a"), frame("a")], [truth("a")], "1 frames of the results repeat a name"),
        ([frame("a")], [truth("a"), truth("a")], "1 frames of the truth repeat a name"),
    ],
)
def test_what_does_not_belong_together(found, true, says):
    with pytest.raises(ValueRefusedError, match=says):
        evaluate(found, true)


def test_plain_values():
    record = {"a": np.float64(1.234567), "b": np.int64(3), "c": float("nan"), "d": [(np.True_, "x")], "e": None}
    assert plain_record(record) == {"a": 1.23457, "b": 3, "c": None, "d": [[True, "x"]], "e": None}
    assert share(1, 4) == 0.25
    assert np.isnan(share(0, 0))
