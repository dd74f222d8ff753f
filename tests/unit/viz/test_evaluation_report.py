from pathlib import Path

from roadblock.viz.evaluation_report import draw_bands, page, table, write_evaluation_page

READINGS = [
    {"type": "<car>", "true_range_m": 10.0, "range_m": 10.4},
    {"type": "person", "true_range_m": 20.0, "range_m": None},
]
BAND = {"from_m": 0, "to_m": 10, "n": 3}


def things(right):
    confusion = {"classes": ["<car>"], "called": ["car", "missed"], "counts": [[3, 1]], "right": right}
    recall = [{"type": "any", **BAND, "recall": 0.5, "recall_right_range": None}]
    precision = [{"class": "any", **BAND, "precision": 0.25}]
    return {
        "recall": recall,
        "precision": precision,
        "confusion": confusion,
        "sizes": [],
        "kitti_ap": [{"class": "<car>", "ap_2d": 0.123456, "ap_bev": None}],
        "distance_ap": [],
        "readings": READINGS,
    }


def maps(ground):
    row = {**BAND, "found_share": 0.5, "range_error": {"n": 3, "missed": 1, "bias_m": 0.7}}
    claims = {"class": "any", "from_m": 0, "to_m": 40, "supported": 3, "unsupported": 1, "hidden": 0, "precision": 0.75}
    free = {"columns": 9, "ok": 0.5, "bands": [{**BAND, "ok": 0.5}]}
    return {"things": [row], "readings": READINGS, "precision": [claims], "free_space": free, "ground": ground}


def result(**sections):
    empty = {"things": None, "tracks": None, "maps": None}
    counted = {"judged": 2, "missing": 1, "without_truth": 0}
    made = {"results": "found", "truth": "<street>", "machine": {"cpu": "any", "more": {}}, "commit": None}
    return {"frames": counted, **made, **empty, **sections}


def test_the_page_shows_what_was_judged(tmp_path: Path) -> None:
    assert "<svg" not in page(result())
    tracks = {
        "scores": {"hota": 0.5},
        "scores_place": {"hota": 0.7},
        "velocity": [],
        "ttc": [],
        "warnings": {"false": None},
    }
    text = page(result(things=things(0.75), tracks=tracks, maps=maps({"n": 2})))
    assert text.count("<svg") == 5
    assert text.count("<h2>") == 4
    assert "Nothing to judge." in text
    assert "&lt;street&gt;" in text
    assert "<car>" not in text
    assert "<td>0.123</td><td>&ndash;</td>" in text
    write_evaluation_page(tmp_path / "page.html", result())
    assert (tmp_path / "page.html").read_text("utf-8") == page(result())


def test_nothing_named_has_no_confusion_and_no_road_no_ground() -> None:
    text = page(result(things=things(None), maps=maps(None)))
    assert text.count("<svg") == 4
    assert "Ground" not in text


def test_bands_that_join_others_are_not_drawn() -> None:
    joined = things(None)
    joined["recall"] += [joined["recall"][0] | {"from_m": 10, "to_m": 20}, joined["recall"][0] | {"to_m": 20, "n": 77}]
    assert ">77<" not in page(result(things=joined)).partition("Recall and range errors")[0]
    assert ">3<" in draw_bands({"recall": [{**BAND, "share": 0.5}, {**BAND, "share": None}]})


def test_a_table_has_the_first_rows_columns() -> None:
    text = table([{"a_b": 1, "c": "<"}, {"a_b": None}])
    assert "<th>a b</th><th>c</th>" in text
    assert "<td>1</td><td>&lt;</td>" in text
    assert "<td>&ndash;</td><td>&ndash;</td>" in text
