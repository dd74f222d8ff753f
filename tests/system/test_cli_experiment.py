import json
import sys

import numpy as np
import pytest
from typer.testing import CliRunner

from roadblock.cli import app, experiment
from roadblock.errors import OutputError
from roadblock.eval.accuracy import Reading
from roadblock.eval.table2 import TARGETS, reading_record
from roadblock.geometry.pose import pose
from roadblock.io.rig import write_rig
from roadblock.sim.render import render
from roadblock.sim.scenes import SCENES
from roadblock.stages.rectify import RectifySettings, plan_rectification
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.scene import GroundPlane

PROMISED = {"detector", "type", "true_range_m", "n", "bias_m", "rms_m", "median_abs_m", "p95_abs_m", "missed"}


def run(*arguments):
    return CliRunner().invoke(app, ["experiment", "table2", *map(str, arguments)])


def small_rig(lens=()):
    """The paper's rig at a third of its resolution."""
    camera = Camera((426, 240), 344.0, 344.0, 217.2, 115.8, *lens)
    return StereoRig(camera, camera, pose(np.eye(3), [0.205, 0.0, 0.0]))


def made_up(seed, *_):
    """Readings without a picture: they err by a centimetre per seed."""
    return [
        reading_record("dense", target, seed, Reading(target.type, target.nominal_m, target.nominal_m + 0.01 * seed))
        for target in TARGETS
    ]


@pytest.fixture
def quick(monkeypatch):
    """Take made-up readings, and note whose turn it was."""
    seeds = []

    def measure(seed, *rest):
        seeds.append(seed)
        return made_up(seed)

    monkeypatch.setattr(experiment, "measure", measure)
    return seeds


def test_the_detectors_go_by_the_calibrated_rig(tmp_path, monkeypatch):
    """Which here believes in a baseline that is a tenth too long: so is every range."""
    monkeypatch.setattr(experiment, "METHODS", {"dense": {"detector": "dense"}})
    rig = small_rig()
    write_rig(rig, tmp_path / "rig.yaml")
    write_rig(StereoRig(rig.left, rig.right, pose(np.eye(3), [0.2255, 0.0, 0.0])), tmp_path / "long.yaml")
    both = ["--calibrated", tmp_path / "long.yaml", "--rig", tmp_path / "rig.yaml"]
    person_m = []
    for options in (both[2:], both):
        done = run("--runs", 1, *options, "--out", tmp_path / f"out{len(options)}")
        assert done.exit_code == 0, done.output
        readings = json.loads((tmp_path / f"out{len(options)}" / "result.json").read_text("utf-8"))["readings"]
        person_m += [r["range_m"] for r in readings if (r["type"], r["detector"]) == ("person", "dense")]
    assert person_m[1] == pytest.approx(1.1 * person_m[0], rel=0.01)


def test_two_real_runs_of_everything(tmp_path):
    write_rig(small_rig(), tmp_path / "rig.yaml")
    done = run("--runs", 2, "--rig", tmp_path / "rig.yaml", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "out" / "result.json").read_text("utf-8"))
    rows = result["rows"]
    assert all(set(row) >= PROMISED for row in rows)
    expected = [
        (target.type, name)
        for target in TARGETS
        for name in [*experiment.METHODS, "mono_ground_oracle", "mono_area_oracle"]
    ]
    assert [(row["type"], row["detector"]) for row in rows] == expected
    assert all(row["n"] == 2 for row in rows)
    assert [row["true_range_m"] for row in rows] == pytest.approx([row["nominal_m"] for row in rows], rel=0.06)
    best = {row["type"]: row for row in rows if row["detector"] == "dense"}
    assert best["person"]["missed"] == 0
    assert best["person"]["median_abs_m"] < 0.3
    assert not result["interrupted"]
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert page.count("<svg") == 1
    for words in (
        "person at 5 m",
        "proposed 20.01",
        "mono_area_oracle",
        "paper: trad. 2",
        "result.json",
        "report.html",
    ):
        assert words in done.output


def test_the_exact_mask_is_seen_as_the_detectors_see_it():
    """With a lens, truth and measurement meet in the rectified image."""
    raw = small_rig(("brown_conrady", (-0.25, 0.06, 0.001, -0.0005, 0.0)))
    picture = render(SCENES["paper"](3), raw)
    rectification = plan_rectification(raw, RectifySettings())
    ids = experiment._rectified(picture.ids, rectification)
    person = next(true for true in picture.objects if true.type == "person")
    u0, v0, u1, v1 = experiment._box(ids == person.id)
    # Feet on the ground at their range, by hand: v = cy + f * h / Z.
    foot_px = rectification.cy_px + rectification.f_px * 1.4 / 5.0
    assert v1 == pytest.approx(foot_px, abs=4)
    assert (u0 + u1) / 2 == pytest.approx(
        rectification.cx_px
        + rectification.f_px * (-person.position_m[1] + rectification.baseline_m / 2) / person.position_m[0],
        abs=6,
    )
    assert (u1 - u0, v1 - v0) != (
        person.box_px[2] - person.box_px[0],
        person.box_px[3] - person.box_px[1],
    )


def test_runs_are_moments_of_one_drive():
    scenes = [experiment.moment(seed) for seed in range(12)]
    origins_m = np.array([scene.T_world_car[:3, 3] for scene in scenes])
    assert np.ptp(origins_m[:, 0]) > 0.3
    assert np.abs(origins_m[:, 0]).max() <= 30 / 3.6 * experiment.FRAME_S / 2
    down = np.degrees([np.arcsin(-scene.T_world_car[2, 2]) for scene in scenes])
    assert 0.05 < np.std(down) < 0.5
    again = experiment.moment(3)
    assert np.array_equal(again.T_world_car, scenes[3].T_world_car)


def test_without_a_horizon_the_oracles_know_nothing():
    ranges_m = experiment.oracles(
        np.ones((4, 4), bool), "person", plan_rectification(small_rig(), RectifySettings()), None
    )
    assert list(ranges_m) == ["mono_ground_oracle", "mono_area_oracle"]
    assert np.isnan(list(ranges_m.values())).all()


def test_the_contact_oracle_is_the_pinhole_formula():
    rectification = plan_rectification(small_rig(), RectifySettings())
    ground = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.4)
    mask = np.zeros((240, 426), bool)
    mask[150:200, 190:210] = True
    ranges_m = experiment.oracles(mask, "person", rectification, ground)
    # The lower border of row 199 is 199.5; Z = f * h / (v - cy).
    expected = rectification.f_px * 1.4 / (199.5 - rectification.cy_px)
    assert ranges_m["mono_ground_oracle"] == pytest.approx(expected)


def test_seeds_count_on_from_the_first(tmp_path, quick):
    assert run("--runs", 3, "--seed", 5, "--out", tmp_path).exit_code == 0
    assert quick == [5, 6, 7]
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert result["settings"]["seed"] == 5
    assert {row["bias_m"] for row in result["rows"]} == {0.06}
    assert {row["n"] for row in result["rows"]} == {3}


def interrupt(monkeypatch, after):
    seeds = []

    def measure(seed, *rest):
        if len(seeds) == after:
            raise KeyboardInterrupt
        seeds.append(seed)
        return made_up(seed)

    monkeypatch.setattr(experiment, "measure", measure)


def test_interrupted_files_are_whole_and_the_same_command_goes_on(tmp_path, monkeypatch):
    interrupt(monkeypatch, 2)
    stopped = run("--runs", 4, "--out", tmp_path)
    assert stopped.exit_code == 130
    assert "interrupted after run 2 of 4" in stopped.output
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert (result["runs_done"], result["interrupted"], result["rows"][0]["n"]) == (2, True, 2)
    assert "Interrupted: 4 were asked for" in (tmp_path / "report.html").read_text("utf-8")

    seeds = []
    monkeypatch.setattr(experiment, "measure", lambda seed, *_: seeds.append(seed) or made_up(seed))
    assert run("--runs", 4, "--out", tmp_path).exit_code == 0
    assert seeds == [2, 3]
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert (result["runs_done"], result["interrupted"], result["rows"][0]["n"]) == (4, False, 4)
    assert [reading["seed"] for reading in result["readings"][::3]] == [0, 1, 2, 3]


def test_interrupted_before_the_first_run_there_is_still_a_page(tmp_path, monkeypatch):
    interrupt(monkeypatch, 0)
    stopped = run("--runs", 4, "--out", tmp_path)
    assert stopped.exit_code == 130, stopped.output
    assert json.loads((tmp_path / "result.json").read_text("utf-8"))["rows"] == []
    assert "no stereo detector found it" in (tmp_path / "report.html").read_text("utf-8")


@pytest.mark.parametrize("change", [["--seed", 1], ["--quality", "evidence"]])
def test_other_settings_start_anew(tmp_path, monkeypatch, change):
    interrupt(monkeypatch, 2)
    run("--runs", 3, "--out", tmp_path)
    seeds = []
    monkeypatch.setattr(experiment, "measure", lambda seed, *_: seeds.append(seed) or made_up(seed))
    run("--runs", 3, "--out", tmp_path, *change)
    assert len(seeds) == 3


def test_a_finished_run_starts_anew(tmp_path, quick):
    run("--runs", 2, "--out", tmp_path)
    run("--runs", 2, "--out", tmp_path)
    assert quick == [0, 1, 0, 1]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[1]",
        "null",
        '{"experiment": "table3"}',
        '{"experiment": "table2"}',
        '{"experiment": "table2", "readings": 3, "interrupted": true}',
        '{"experiment": "table2", "readings": [{"detector": "dense"}], "interrupted": true}',
        '{"experiment": "table2", "readings": [], "interrupted": true, "settings": []}',
        "[" * 100_000,
        "\xff\xfe",
    ],
)
def test_what_is_not_ours_is_not_overwritten(tmp_path, quick, text):
    (tmp_path / "result.json").write_text(text, "latin-1")
    head = {"experiment": "table2", "settings": {"seed": 0, "runs": 1}}
    with pytest.raises(OutputError, match=r"is no result of this experiment .*--out"):
        experiment.earlier(tmp_path / "result.json", head, experiment.rows)
    assert run("--runs", 1, "--out", tmp_path).exit_code != 0
    assert (tmp_path / "result.json").read_text("latin-1") == text
    assert not quick


def test_without_the_plotting_library_there_is_a_note_instead_of_a_page(tmp_path, quick, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = run("--runs", 1, "--out", tmp_path)
    assert done.exit_code == 0
    assert "roadblock[report]" in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


@pytest.mark.parametrize("arguments", [["--runs", 0], ["--seed", -1], ["--quality", "best"]])
def test_impossible_options_are_refused(arguments):
    assert run(*arguments).exit_code == 2
