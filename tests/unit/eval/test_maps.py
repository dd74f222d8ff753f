"""Judging against true depths: a made frame by hand, and the outside scorer on real frames."""

import importlib.util

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.maps import count_duplicates, judge_claim, judge_free_space, judge_maps, judge_things
from roadblock.eval.true_road import TrueThing, fit_road, true_frame
from roadblock.io.truth import read_truth
from roadblock.values.true_map import TrueMap

F, CX, CY, B = 400.0, 203.0, 77.0, 0.5
H, W = 180, 400
HEIGHT_M = 1.6
THING_BOX, THING_M = (180, 60, 240, 131), 12.0


def made_map() -> TrueMap:
    """A level road 1.6 m below the cameras up to 60 m, and a flat thing 12 m ahead standing on it."""
    v, u = np.mgrid[:H, :W]
    with np.errstate(divide="ignore"):
        z = np.where(v > CY, HEIGHT_M * F / (v - CY), np.inf)
    d = np.where(z < 60, F * B / z, np.nan)
    ids = np.zeros((H, W), np.uint16)
    u0, v0, u1, v1 = THING_BOX
    inside = (u >= u0) & (u < u1) & (v >= v0) & (v < v1)
    d[inside], ids[inside] = F * B / THING_M, 7
    return TrueMap("a", d.astype(np.float32), ids, F, CX, CY, B)


def claim(box, range_m, **more):
    return {"box_px": list(box), "range_m": range_m, "range_sigma_m": 0.1, "class": "unknown"} | more


def test_the_road_and_the_thing_are_read_off_the_map():
    true = true_frame(made_map())
    assert true.road is not None
    pose = true.road.pose(B)
    assert pose["height_m"] == pytest.approx(HEIGHT_M, abs=1e-3)
    assert pose["pitch_rad"] == pytest.approx(0, abs=1e-4)
    assert true.things == (TrueThing(7, THING_BOX, *[pytest.approx(THING_M, rel=1e-6)] * 3),)
    inside = (true.columns >= 190) & (true.columns < 230)
    np.testing.assert_allclose(true.first_m[inside], THING_M, rtol=1e-6)
    assert np.isnan(true.first_m[true.columns < 170]).all()
    assert (true.ground_m[true.columns < 170] > 40).all()


def test_an_offset_moves_the_truth():
    true = true_frame(made_map(), offset_px=-0.4)
    assert true.things[0].range_m == pytest.approx(F * B / (F * B / THING_M - 0.4), rel=1e-5)


def test_without_a_road_heights_are_unknown():
    rng = np.random.default_rng(0)
    flat = np.full(300, 1.0)
    assert fit_road(np.linspace(-3, 3, 300), flat, np.full(300, 30.0), rng) is None  # nothing near
    assert fit_road(flat[:50], flat[:50], 5 * flat[:50], rng) is None  # too few
    high = np.random.default_rng(1).uniform(-3, 3, (2, 400))
    assert fit_road(high[0], np.full(400, 0.8), 12 + 2 * high[1], rng) is None  # 0.8 m is no road


def test_found_box_range_split_and_merged():
    thing, other = (
        TrueThing(1, (100, 0, 200, 100), 10.5, 10.0, 12.0),
        TrueThing(2, (200, 0, 300, 100), 10.5, 10.0, 12.0),
    )
    (row,) = judge_things([claim((100, 0, 200, 100), 10.5)], [thing])
    assert (row["found"], row["box"], row["range"], row["overlap"]) == (True, True, True, 1.0)
    (row,) = judge_things([claim((100, 0, 200, 100), 10.51)], [thing])  # 0.5 m is the limit up to 10 m
    assert (row["found"], row["box"], row["range"]) == (False, True, False)
    assert row["reading"].error_m == pytest.approx(0.51)
    (row,) = judge_things([claim((100, 0, 151, 100), 10), claim((151, 0, 200, 100), 12.9)], [thing])
    assert (row["found"], row["split"]) == (True, True)
    (row,) = judge_things([claim((100, 0, 151, 100), 10), claim((151, 0, 200, 100), 13.3)], [thing])
    assert not row["split"]  # 12 m + 10 % ends before
    both = judge_things([claim((100, 0, 300, 100), 10)], [thing, other])
    assert [r["merged"] for r in both] == [True, True]
    assert [r["found"] for r in both] == [True, True]  # exactly half overlaps
    assert judge_things([], [thing])[0]["overlap"] == 0
    assert judge_things([claim((0, 0, 1, 1), 10)], []) == []


def test_what_supports_a_claim():
    shown = made_map()
    true = true_frame(shown)

    def state(box, range_m, **more):
        judged = judge_claim(claim(box, range_m, **more), true, shown)
        return judged["state"], judged["phantom"]

    assert state(THING_BOX, 12.3) == ("supported", False)
    assert state(THING_BOX, 30.0) == ("hidden", False)  # nearer things fill it, no road there
    assert state((150, 60, 176, 131), 12.0) == ("unsupported", True)  # 1.45 m to the left, road seen there
    assert state((150, 60, 176, 131), 12.0, position_m=[12.0, 2.0, 0.0]) == ("unsupported", False)  # out of the way
    assert state((100, 0, 160, 60), 12.0)[0] == "unknown"  # sky
    assert state((-50, 300, -10, 400), 12.0)[0] == "unknown"  # outside


def test_free_space_late_near_and_unobserved():
    true = true_frame(made_map())
    columns = true.columns.astype(float)
    said = [None if u < 100 else 5.0 if u < 150 else 12.2 if 172 <= u < 248 else 60.0 for u in columns]
    judged = judge_free_space({"u_px": columns.tolist(), "range_m": said}, true)
    _, reported, near = judged.T
    assert len(judged) == len(columns)
    assert np.isnan(reported[columns < 100]).all()
    assert near[(columns >= 100) & (columns < 150)].all()  # road goes on beyond 5 m
    assert not near[columns >= 150].any()
    assert np.isnan(judge_free_space({}, true)[:, 1]).all()


def test_a_recording_by_hand():
    shown = made_map()
    found = {
        "obstacles": [claim(THING_BOX, 12.5), claim(THING_BOX, 12.6), claim((150, 60, 176, 131), 12.0)],
        "free_space": {"u_px": [200.0, 206.0], "range_m": [12.0, 20.0]},
        "ground": {"height_m": 1.7, "pitch_rad": 0.01, "roll_rad": None},
    }
    result = judge_maps({"a": found}, [shown, TrueMap("b", shown.d_px, shown.ids, F, CX, CY, B)])
    assert (result["frames"], result["duplicates"]) == (2, 1)
    assert [row["n"] for row in result["things"]] == [2, 0, 0, 2]
    assert result["things"][-1]["found_share"] == 0.5  # nothing in the second frame
    assert result["things"][1]["found_share"] is None
    error = result["things"][0]["range_error"]
    assert (error["n"], error["missed"], error["bias_m"]) == (2, 1, pytest.approx(0.5))
    assert error["within_2_sigma"] == 0
    total = next(r for r in result["precision"] if (r["class"], r["from_m"], r["to_m"]) == ("any", 0, 40))
    assert (total["supported"], total["unsupported"], total["precision"]) == (2, 1, pytest.approx(2 / 3, abs=1e-5))
    assert total["corridor_phantoms"] == 1
    assert result["free_space"]["late"] > 0
    assert result["ground"]["n"] == 1
    assert result["ground"]["height_m_bias"] == pytest.approx(0.1, abs=1e-3)


def test_nothing_at_all():
    result = judge_maps({}, [])
    assert (result["free_space"], result["ground"], result["frames"]) == (None, None, 0)


def test_duplicates_need_box_and_range():
    same = claim((0, 0, 10, 10), 10)
    assert count_duplicates([same, same, same]) == 2
    assert count_duplicates([same, claim((0, 0, 10, 10), 11.2)]) == 0
    assert count_duplicates([same, claim((5, 0, 15, 10), 10)]) == 0


def test_maps_are_checked():
    with pytest.raises(ValueRefusedError, match=r"one size, but are \(2, 3\) and \(3, 2\)"):
        TrueMap("a", np.zeros((2, 3), np.float32), np.zeros((3, 2), np.uint16), 1.0, 0.0, 0.0, 1.0)
    with pytest.raises(ValueRefusedError, match="baseline_m must be > 0"):
        TrueMap("a", np.zeros((2, 3), np.float32), np.zeros((2, 3), np.uint16), 1.0, 0.0, 0.0, 0.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")  # it leaves files open
def test_as_the_outside_scorer(tmp_path, data_dir):
    """Three real frames with made-up obstacles: every figure that both have agrees."""
    data, scorer_file = data_dir / "kitti2015", data_dir.parent / "tools" / "score_kitti2015.py"
    if not data.is_dir() or not scorer_file.is_file():
        pytest.skip(f"no recording at {data}, or no {scorer_file}")
    names, offset_px = ["000010", "000028", "000083"], -0.4
    for folder in ("disp_occ_0", "obj_map", "image_02"):
        (tmp_path / folder).mkdir()
        for name in names:
            (tmp_path / folder / f"{name}.png").symlink_to(data / folder / f"{name}.png")
    (tmp_path / "calib.txt").symlink_to(data / "calib.txt")
    read = read_truth(tmp_path)
    assert read.maps is not None
    frames = {}
    for shown in read.maps():
        true, rng = true_frame(shown), np.random.default_rng(int(shown.name))
        boxes = [t.box_px for t in true.things] + rng.integers(100, 300, (8, 4)).tolist()
        obstacles = []
        for u0, v0, u1, v1 in boxes:
            box = np.rint(np.array([u0, v0, max(u1, u0 + 40), max(v1, v0 + 40)]) + rng.normal(0, 5, 4)).astype(int)
            u, v = int(box[[0, 2]].mean()), int(box[[1, 3]].mean())
            range_m = float(true.z_m[v, u] * rng.uniform(0.9, 1.1)) or 20.0
            obstacles.append(claim(box.tolist(), range_m))
        first = np.where(np.isnan(true.first_m), true.ground_m, true.first_m) * rng.uniform(0.8, 1.2, len(true.columns))
        free = {"u_px": true.columns.tolist(), "range_m": [None if np.isnan(r) else float(r) for r in first]}
        ground = {"height_m": 1.6, "pitch_rad": 0.01, "roll_rad": 0.0}
        frames[shown.name] = {"obstacles": obstacles, "free_space": free, "ground": ground}
    spec = importlib.util.spec_from_file_location("scorer", scorer_file)
    assert spec is not None
    assert spec.loader is not None
    scorer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scorer)
    theirs = scorer.score(str(tmp_path), frames, offset=offset_px)
    ours = judge_maps(frames, read.maps(), offset_px)
    for row, name in zip(ours["things"], theirs["vehicles"], strict=True):
        v, r, e = theirs["vehicles"][name], theirs["range"][name], row["range_error"]
        assert row["n"] == v["n"]
        assert (row["split"], row["merged"]) == (v["split"], v["merged"])
        if v["n"]:
            shares = (row["found_share"], row["box_share"], row["range_share"], row["mean_overlap"])
            assert shares == pytest.approx((v["found"], v["box"], v["ronly"], v["mean_iou"]), abs=1e-5)
        if r["n"]:
            figures = (e["bias_m"], e["rms_m"], e["median_abs_m"], e["p95_abs_m"], e["within_1_sigma"])
            expected = (r["bias"], r["rms"], r["median_abs"], r["p95"], r["cov1"])
            assert figures == pytest.approx(expected, abs=1e-5)
    p = theirs["precision"]
    total = next(r for r in ours["precision"] if (r["class"], r["from_m"], r["to_m"]) == ("any", 0, 40))
    counts = (total["supported"], total["unsupported"] + total["hidden"], total["hidden"], total["unknown"])
    assert counts == (p["sup"], p["unsup"], p["hidden"], p["unknown"])
    assert (total["corridor_phantoms"], ours["duplicates"]) == (p["corridor_phantoms"], theirs["duplicates"])
    f, g = ours["free_space"], ours["ground"]
    keys = {"ok": "ok", "late": "late", "near": "near", "observed": "observed", "columns": "gt_columns"}
    assert [f[key] for key in keys] == pytest.approx([theirs["free_space"][key] for key in keys.values()], abs=1e-5)
    assert g["height_m_worst"] == pytest.approx(theirs["ground"]["dh_absmax"], abs=1e-5)
    assert g["pitch_deg_bias"] == pytest.approx(theirs["ground"]["dpitch_median_deg"], abs=1e-5)
