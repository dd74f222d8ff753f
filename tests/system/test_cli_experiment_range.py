import json

import numpy as np
from typer.testing import CliRunner

from roadblock.cli import app, experiment_range
from roadblock.errors import MissingExtraError
from roadblock.geometry.pose import pose
from roadblock.values.camera import Camera, StereoRig

PROMISED = {
    "detector", "type", "true_range_m", "n", "bias_m", "rms_m", "median_abs_m", "p95_abs_m", "missed", "bound_m",
    "coverage_68", "coverage_95",
}  # fmt: skip


def test_a_real_run_at_one_range(tmp_path, monkeypatch):
    camera = Camera((640, 360), 520.0, 520.0, 327.3, 171.6)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    monkeypatch.setattr(experiment_range, "paper_rig", lambda: rig)
    monkeypatch.setattr(experiment_range, "RANGES_M", (10.0,))
    done = CliRunner().invoke(app, ["experiment", "range", "--runs", "1", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert all(set(row) == PROMISED for row in result["rows"])
    assert {row["detector"] for row in result["rows"]} == {
        "refined_mean", "refined_nearest", "sgbm_exact", "bm_exact", "cells", "cells_refined", "cells_refined_mean"
    }  # fmt: skip
    assert result["anees"] > 0
    assert result["anees_as_detected"] > 0
    refined = {row["type"]: row for row in result["rows"] if row["detector"] == "refined_mean"}
    assert refined["person"]["median_abs_m"] < 0.15
    assert "person" in done.output
    assert (tmp_path / "report.html").exists()


def test_without_the_drawing_library_the_figures_are_there(tmp_path, monkeypatch):
    def missing(*_):
        raise MissingExtraError("drawing", "report")

    monkeypatch.setattr(experiment_range, "measure", lambda *_: [])
    monkeypatch.setattr(experiment_range, "write_range_page", missing)
    done = CliRunner().invoke(app, ["experiment", "range", "--runs", "1", "--out", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert "drawing" in done.output
    assert json.loads((tmp_path / "result.json").read_text("utf-8"))["rows"] == []


def test_an_interrupted_run_goes_on(tmp_path, monkeypatch):
    taken = []

    def measure(seed, range_m, *_):
        if seed == 1 and taken.count(1) == 2:
            raise KeyboardInterrupt
        taken.append(seed)
        common = {"detector": "cells", "type": "person", "nominal_m": range_m, "true_range_m": range_m, "bound_m": None}
        return [common | {"seed": seed, "range_m": range_m + 0.1, "range_sigma_m": 0.1}]

    monkeypatch.setattr(experiment_range, "measure", measure)
    command = ["experiment", "range", "--runs", "2", "--out", str(tmp_path)]
    broken = CliRunner().invoke(app, command)
    assert broken.exit_code == 130, broken.output
    assert "goes on from there" in broken.output
    assert json.loads((tmp_path / "result.json").read_text("utf-8"))["runs_done"] == 1
    taken.append(1)  # past the interruption
    done = CliRunner().invoke(app, command)
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "result.json").read_text("utf-8"))
    assert result["runs_done"] == 2
    assert taken.count(0) == len(experiment_range.RANGES_M)  # not measured again
    assert len(result["readings"]) == 2 * len(experiment_range.RANGES_M)
