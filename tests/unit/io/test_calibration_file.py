import json
import math
from datetime import UTC, datetime

import numpy as np
import pytest
from calibrated import NAN, SIGMA_PX, crooked_rig, made_up_calibration

from roadblock.errors import OutputError
from roadblock.geometry.pose import pose, rotvec_from_rotation
from roadblock.io.calibration import (
    baseline_sigma_m,
    calibration_record,
    lens_name,
    parameter_records,
    write_calibration,
)
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters

PROMISED = {"baseline_m", "rms_px", "views_total", "views_used", "left_out", "range_sigma_m", "lens", "verdict"}
STARTED = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)


def record_of(calibration, **others):
    return calibration_record(
        calibration, source={"left": "a", "right": None}, settings={"lens": "auto"}, started=STARTED, **others
    )


@pytest.fixture
def calibration():
    return made_up_calibration()


def test_what_is_promised(calibration):
    record = record_of(calibration, without_board=["left77"])
    assert set(record) >= PROMISED
    assert record["baseline_m"] == pytest.approx(math.sqrt(0.12**2 + 0.002**2 + 0.003**2), rel=1e-8)
    assert record["rms_px"] == pytest.approx(1.41 * SIGMA_PX)
    assert (record["views_total"], record["views_used"], record["lens"], record["verdict"]) == (
        (10, 8, "brown_conrady5", "usable")
    )
    assert record["left_out"] == [
        {"view": "left08", "reason": "its corners lie 0.37 px off: the board moved, or is another one"},
        {"view": "left77", "reason": "no board found in it"},
    ]
    assert list(record["range_sigma_m"]) == ["5", "10", "20", "40"]


def test_one_sigma_per_distance_is_the_rms_where_both_cameras_see(calibration):
    record = record_of(calibration)
    for z_m, field in calibration.range_sigma_m.items():
        known = field[:, 1:]  # the first column of the made-up map is unseen
        expected = math.sqrt(sum(value**2 for value in known.ravel()) / known.size)
        assert record["range_sigma_m"][f"{z_m:g}"] == pytest.approx(expected, rel=1e-8)
        assert [row[0] for row in record["range_sigma_map_m"][f"{z_m:g}"]] == [None] * 5
        np.testing.assert_allclose([row[1:] for row in record["range_sigma_map_m"][f"{z_m:g}"]], known, rtol=1e-8)


def test_unknown_is_null_and_the_record_is_json(calibration):
    calibration.range_sigma_m[40.0][:] = NAN
    record = record_of(calibration)
    assert record["range_sigma_m"]["40"] is None
    assert record["board"]["square_sigma_m"] is None
    assert record["views"][1]["rms_px"][1] is None
    assert record["lens_trials"][1]["held_out_rms_px"] is None
    assert json.loads(json.dumps(record, allow_nan=False)) == record


def test_views_parameters_board_and_provenance(calibration):
    record = record_of(calibration)
    assert [view["used"] for view in record["views"]] == [True] * 8 + [False]
    first, fit = record["views"][0], calibration.views[0]
    known = np.isfinite(fit.residual_left_px[:, 0])
    assert first["points"] == [known.sum(), np.isfinite(fit.residual_right_px[:, 0]).sum()]
    assert first["rms_px"][0] == pytest.approx(math.sqrt((fit.residual_left_px[known] ** 2).sum() / known.sum()))
    np.testing.assert_allclose(first["T_left_board"], fit.T_left_board, rtol=1e-8)
    rows = {row["name"]: (row["value"], row["sigma"]) for row in record["parameters"]}
    rig = calibration.rig
    assert rows["left.fx_px"] == pytest.approx((rig.left.fx_px, 0.4))
    assert rows["right.k3"] == pytest.approx((-0.01, 1e-4))
    assert rows["ry_rad"] == pytest.approx((rotvec_from_rotation(rig.T_left_right[:3, :3])[1], 1e-4))
    assert rows["tx_m"] == pytest.approx((0.12, 1e-4))
    assert len(rows) == 24
    assert (record["board"]["kind"], record["board"]["columns"], len(record["board"]["heights_m"])) == (
        ("chessboard", 5, 20)
    )
    assert record["cameras_alone"]["right"]["fx_px"] == pytest.approx(rig.right.fx_px)
    assert record["cameras_alone"]["left"]["sigma_px"] == SIGMA_PX
    assert record["coverage"]["next_gain"] == 0.71
    assert (record["source"], record["settings"]) == ({"left": "a", "right": None}, {"lens": "auto"})
    assert record["started"] == "2026-03-04T05:06:07.000+00:00"
    assert {"version", "commit", "machine", "finished", "schema"} <= set(record)


def test_views_without_a_pose(calibration):
    object.__setattr__(calibration.views[0], "T_left_board", None)
    assert record_of(calibration)["views"][0]["T_left_board"] is None


def test_the_baselines_sigma_follows_from_the_covariance():
    rig = crooked_rig()
    names = rig_parameters(rig.left, rig.right)
    rng = np.random.default_rng(4)
    root = 1e-4 * rng.normal(size=(len(names), len(names)))
    T = pose(rig.T_left_right[:3, :3], [0.12, 0.05, -0.07])
    sure = StereoRig(rig.left, rig.right, T, covariance=RigCovariance(names, root @ root.T))
    draws = rng.normal(size=(200_000, len(names))) @ root[-3:].T
    sampled = np.linalg.norm(T[:3, 3] + draws, axis=1).std()
    assert baseline_sigma_m(sure) == pytest.approx(sampled, rel=0.02)


def test_without_covariance_nothing_is_claimed():
    rig = crooked_rig()
    unsure = StereoRig(rig.left, rig.right, rig.T_left_right)
    assert math.isnan(baseline_sigma_m(unsure))
    assert parameter_records(unsure) == []


@pytest.mark.parametrize(
    ("lens", "count", "name"),
    [("brown_conrady", 5, "brown_conrady5"), ("brown_conrady", 8, "brown_conrady8"), ("kannala_brandt", 4, None)],
)
def test_lens_names(lens, count, name):
    assert lens_name(Camera((97, 61), 80.0, 81.0, 44.0, 31.0, lens, np.zeros(count))) == (name or lens)


def test_written_whole_or_not_at_all(calibration, tmp_path):
    record = record_of(calibration)
    write_calibration(tmp_path / "calibration.json", record)
    assert json.loads((tmp_path / "calibration.json").read_text("utf-8")) == record
    assert len(list(tmp_path.iterdir())) == 1
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        write_calibration(tmp_path / "file" / "calibration.json", record)
    with pytest.raises(OutputError, match="cannot hold"):
        write_calibration(tmp_path / "bad.json", {"x": NAN})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration.json", "file"]
