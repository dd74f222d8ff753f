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
    assert {"refined_mean", "refined_nearest", "sgbm_exact", "bm_exact", "dense"} == {
        row["detector"] for row in result["rows"]
    }
    assert result["anees"] > 0
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
