import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from roadblock.cli import app, avoidance_drive, experiment_avoidance
from roadblock.cli.avoidance_drive import STEP_S, drive, rendered, small_rig
from roadblock.errors import MissingExtraError, OutputError
from roadblock.sim.car import CarState
from roadblock.sim.challenges import CHALLENGES
from roadblock.sim.scene import on_road
from roadblock.sim.solids import going
from roadblock.sim.things import Order, build
from roadblock.values.decision import Decision

PROMISED = {"scenario", "seed", "outcome", "reason", "km", "nearest_m", "impact_mps", "at_m", "speed_mps", "actions"}
FAST = ["experiment", "avoidance", "--fast"]


def run(tmp_path, *options):
    return CliRunner().invoke(app, [*FAST, "--out", str(tmp_path), *options])


def result_in(folder):
    return json.loads((folder / "result.json").read_text("utf-8"))


def blind(decision):
    """Return eyes that decide the same for ever."""
    return lambda *_: (decision, None, None)


def test_fast_drives_are_judged_and_told(tmp_path):
    done = run(tmp_path, "--scenario", "standing", "--scenario", "empty", "--runs", "1")
    assert done.exit_code == 0, done.output
    result = result_in(tmp_path)
    assert all(set(drive) == PROMISED for drive in result["runs"])
    assert (result["failed"], result["false"], result["effective"]) == (0, 0, 2)
    assert result["km"] == pytest.approx(sum(drive["km"] for drive in result["runs"]), abs=1e-3)
    assert [row["scenario"] for row in result["rows"]] == ["standing", "empty", "all"]
    assert not result["interrupted"]
    assert (tmp_path / "report.html").exists()


def test_a_cell_of_the_grid_has_its_impact(tmp_path, monkeypatch):
    name = "grid car standing 60"
    monkeypatch.setattr(experiment_avoidance, "GRID", {name: None})
    monkeypatch.setattr(experiment_avoidance, "guessed", lambda *_: blind(Decision("none", "asleep")))
    done = run(tmp_path, "--scenario", "grid", "--runs", "1")
    assert done.exit_code == 0, done.output
    (cell,) = result_in(tmp_path)["grid"]
    assert cell["impact_kmh"] == pytest.approx(60.0, abs=0.1)
    assert cell["allowed_kmh"] == 35.0
    assert "failed: touched a car at 16.7 m/s" in done.output


def test_an_interrupted_run_goes_on_where_it_stopped(tmp_path, monkeypatch):
    asked = []

    def driven(name, seed, *_):
        asked.append(seed)
        if asked == [4, 5]:
            raise KeyboardInterrupt
        common = {"reason": "passed", "km": 0.05, "nearest_m": 1.0, "impact_mps": 0.0, "at_m": [1.0, 0.0]}
        return {"scenario": name, "seed": seed, "outcome": "effective", "speed_mps": 8.0, "actions": {}} | common

    monkeypatch.setattr(experiment_avoidance, "_driven", driven)
    options = ("--scenario", "empty", "--runs", "2", "--seed", "4")
    stopped = run(tmp_path, *options)
    assert stopped.exit_code == 130
    assert "goes on from there" in stopped.output
    assert result_in(tmp_path)["interrupted"]
    assert run(tmp_path, *options).exit_code == 0
    assert asked == [4, 5, 5]
    assert [drive["seed"] for drive in result_in(tmp_path)["runs"]] == [4, 5]
    assert run(tmp_path, *options).exit_code == 0  # a finished one is replaced
    assert asked == [4, 5, 5, 4, 5]


def test_what_is_asked_wrongly_is_refused(tmp_path):
    odd = run(tmp_path, "--scenario", "moon")
    assert isinstance(odd.exception, OutputError)
    assert "choose one of paper" in str(odd.exception)
    (tmp_path / "result.json").write_text('{"experiment": "table2"}')
    other = run(tmp_path, "--scenario", "empty")
    assert isinstance(other.exception, OutputError)
    assert "no result of this experiment" in str(other.exception)


def test_without_the_drawing_library_the_figures_are_there(tmp_path, monkeypatch):
    def missing(*_):
        raise MissingExtraError("drawing", "report")

    monkeypatch.setattr(experiment_avoidance, "write_avoidance_page", missing)
    monkeypatch.setattr(experiment_avoidance, "guessed", lambda *_: blind(Decision("none", "free")))
    done = run(tmp_path, "--scenario", "empty", "--runs", "1")
    assert done.exit_code == 0, done.output
    assert "roadblock[report]" in done.output


def test_pictures_become_decisions_and_a_video(tmp_path, monkeypatch):
    pytest.importorskip("av")
    monkeypatch.setattr(avoidance_drive, "LONGEST_S", 2 * STEP_S + 0.1)
    done = CliRunner().invoke(
        app, ["experiment", "avoidance", "--runs", "1", "--scenario", "empty", "--video", "0", "--out", str(tmp_path)]
    )
    assert done.exit_code == 0, done.output
    assert (tmp_path / "empty-0.mp4").stat().st_size > 1000
    (one,) = result_in(tmp_path)["runs"]
    assert one["actions"] == {"none": 2}


def test_the_pipeline_decides_only_when_it_is_told_to():
    look = rendered(small_rig(), 0, "preview")
    challenge = CHALLENGES["empty"](0)
    decision, result, _ = look(challenge, 0.0, CarState(*challenge.start_m, 0.0, 8.0))
    assert result is not None
    assert result.decision is decision
    assert "own motion is unknown" in decision.reason


@pytest.mark.parametrize(
    ("scenario", "decision", "outcome", "reason"),
    [
        ("standing", Decision("none", "asleep"), "failed", "touched a person"),
        (
            "empty",
            Decision("brake", "ghosts", deceleration_mps2=6.0),
            "false",
            "brake on a free road after 0.0 s: ghosts",
        ),
        ("empty", Decision("swerve", "ghosts", curvature_per_m=0.04), "failed", "left the road"),
        ("stopped", Decision("brake", "a car", deceleration_mps2=1.3), "effective", "can go on"),
        ("empty", Decision("warn", "perhaps"), "effective", "reached the end"),
    ],
)
def test_the_judge(scenario, decision, outcome, reason, monkeypatch):
    monkeypatch.setattr(avoidance_drive, "FREE_S", 6.0)
    judged = drive(scenario, 1, blind(decision))
    assert judged["outcome"] == outcome
    assert reason in judged["reason"]


def test_to_stand_right_before_something_is_no_success(monkeypatch):
    challenge = CHALLENGES["standing"](0)
    (person,) = (thing for thing in challenge.scene.things if thing.id)
    near = on_road(person, challenge.scene.road, 12.0 / 6 + 5.0, challenge.start_m[1])
    scene = replace(challenge.scene, things=(near,))
    monkeypatch.setitem(avoidance_drive.SCENARIOS, "near", lambda _: replace(challenge, scene=scene, speed_mps=6.0))
    judged = drive("near", 0, blind(Decision("brake", "near", deceleration_mps2=6.0)))
    assert (judged["outcome"], "cannot go on" in judged["reason"]) == ("failed", True)


def test_who_walks_into_a_standing_car_was_not_run_into(monkeypatch):
    challenge = CHALLENGES["walking"](0)
    road = challenge.scene.road
    walker = going(on_road(build(Order("person", 1, walking=True)), road, 5.0, -0.6, np.pi), 4.0)
    scene = replace(challenge.scene, things=(walker,))
    monkeypatch.setitem(avoidance_drive.SCENARIOS, "met", lambda _: replace(challenge, scene=scene, speed_mps=0.05))
    judged = drive("met", 0, blind(Decision("brake", "a person", deceleration_mps2=6.0)))
    assert (judged["outcome"], "came up to it" in judged["reason"]) == ("effective", True)
