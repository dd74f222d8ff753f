import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.errors import RigError, SourceError
from roadblock.io.rig import write_rig
from roadblock.io.truth import read_truth
from roadblock.sim.drive import truth_record
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street, paper_rig
from roadblock.values.camera import Camera, StereoRig

CALIB = "P2: 100 0 50 4 0 100 20 0 0 0 1 0\nP3: 100 0 50 -46 0 100 20 0 0 0 1 0\n"
CAR = "Car 0.1 1 -1.5 10 20 29 39 1.5 1.6 4.0 2.0 1.7 12.0 -1.5707963267948966"


def labels(folder: Path, text: str, calib: str | None = CALIB) -> Path:
    (folder / "label_2").mkdir()
    (folder / "label_2" / "000007.txt").write_text(text)
    if calib is not None:
        (folder / "calib.txt").write_text(calib)
    return folder


def maps(folder: Path, names: tuple[str, str] = ("disp_occ_0", "obj_map")) -> Path:
    steps, ids = np.zeros((4, 6), np.uint16), np.zeros((4, 6), np.uint8)
    steps[1, 2], ids[1, 2] = 5 * 256 + 64, 3
    for name, image in zip(names, (steps, ids), strict=True):
        (folder / name).mkdir()
        cv2.imwrite(str(folder / name / "a.png"), image)
    return folder


def test_a_label_by_hand(tmp_path):
    """Facing forward (-pi/2), 12 m ahead, 2 m to the right of camera 0; the eyes' middle is 0.21 m to its right."""
    read = read_truth(labels(tmp_path, CAR + "\nDontCare -1 -1 -10 1 2 3 4 -1 -1 -1 -1000 -1000 -1000 -10\n"))
    assert (read.kind, read.maps) == ("kitti labels", None)
    (frame,) = read.frames
    assert (frame["name"], frame["doubts"], frame["ego"]) == ("000007", [[1, 2, 3, 4]], None)
    (car,) = frame["objects"]
    assert car["type"] == "car"
    assert car["box_px"] == [10, 20, 30, 40]  # KITTI's last pixel belongs to the box
    assert car["size_m"] == [1.6, 1.5, 4.0]
    assert car["center_m"] == pytest.approx([12.0, 0.21 - 2.0, 0.75 - 1.7])
    assert car["yaw_rad"] == pytest.approx(0, abs=1e-9)
    assert car["range_m"] == pytest.approx(10.0, abs=0.01)  # its rear
    assert car["position_m"] == pytest.approx([10.0, -1.79, -1.7], abs=0.02)
    assert (car["occluded"], car["truncated"]) == (1, 0.1)


def test_a_label_that_faces_right_and_one_beside(tmp_path):
    right = CAR.replace("-1.5707963267948966", "0.0")
    beside = CAR.replace(" 12.0 ", " 1.0 ")
    calib = CALIB.replace("P2", "P_rect_02").replace("P3", "P_rect_03")
    read = read_truth(labels(tmp_path, f"{right}\n{beside}\n", calib))
    turned, near = read.frames[0]["objects"]
    assert turned["yaw_rad"] == pytest.approx(-np.pi / 2)
    assert near["range_m"] is near["position_m"] is None


@pytest.mark.parametrize("line", ["Cat" + CAR[3:], CAR[:-20], CAR.replace("12.0", "nan"), CAR.replace("12.0", "far")])
def test_labels_that_are_none(tmp_path, line):
    with pytest.raises(SourceError, match=r"line 1 is .* but must be a type .* and 14 numbers"):
        read_truth(labels(tmp_path, line))


def test_labels_need_a_calibration(tmp_path):
    with pytest.raises(SourceError, match=r"neither calib.txt nor calib/000007.txt"):
        read_truth(labels(tmp_path, CAR, None))
    (tmp_path / "calib.txt").write_text("P2: 1 2 3\n")
    with pytest.raises(SourceError, match=r"must hold P2 and P3, 12 numbers each"):
        read_truth(tmp_path)


def test_maps_of_kitti(tmp_path):
    (maps(tmp_path) / "calib.txt").write_text(CALIB)
    read = read_truth(tmp_path)
    assert (read.kind, read.frames) == (None, ())
    assert read.maps is not None
    (shown,) = read.maps()
    assert (shown.name, shown.f_px, shown.cx_px, shown.cy_px, shown.baseline_m) == ("a", 100, 50, 20, 0.5)
    assert shown.d_px[1, 2] == 5.25
    assert np.isnan(shown.d_px).sum() == 23
    assert shown.ids[1, 2] == 3


def test_a_simulated_drive_with_maps(tmp_path):
    rig = paper_rig()
    street = render(demo_street(0), rig, quality="preview", seed=0, name="a")
    maps(tmp_path, ("disparity", "ids"))
    (tmp_path / "truth.jsonl").write_text(json.dumps(truth_record(street)) + "\n")
    write_rig(rig, tmp_path / "rig.yaml")
    read = read_truth(tmp_path)
    assert read.kind == "simulated"
    assert {thing["type"] for thing in read.frames[0]["objects"]} == {"box", "person"}
    assert read.frames[0]["doubts"] == []
    assert read.maps is not None
    assert next(read.maps()).baseline_m == pytest.approx(0.205)
    assert len(read_truth(tmp_path / "truth.jsonl").frames) == 1


def at(x_m: float, y_m: float) -> dict:
    """A box of 2x2x2 m, seen from 1 m over its bottom."""
    thing = {"id": 1, "type": "box", "color": None, "box_px": [0, 0, 9, 9], "range_m": 4.0, "mean_range_m": 4.0}
    return (
        thing
        | {"size_m": [2.0, 2.0, 2.0], "position_m": [x_m - 1, y_m, -1.0], "center_m": [x_m, y_m, 0.0], "yaw_rad": 0.0}
        | {"visible_px": 400, "velocity_mps": [0.0] * 3, "yaw_rate_radps": 0.0}
    )


@pytest.mark.parametrize(
    ("x_m", "y_m", "share"),
    [
        (5.0, 0.0, 0.0),
        (5.0, 2.0, 25 / (25 + 100 / 3)),  # from -25 (3 m aside, 4 m ahead) to 33.3 (1 m aside, 6 m ahead)
        (0.5, 0.0, 1.0),  # around the cameras
    ],
)
def test_how_much_of_a_thing_the_picture_cuts_off(tmp_path, x_m, y_m, share):
    camera = Camera((101, 101), 100.0, 100.0, 50.0, 50.0)
    T = np.eye(4)
    T[0, 3] = 0.02
    frame = {"schema": 1, "frame": 0, "name": "a", "t_ns": 0, "objects": [at(x_m, y_m)], "ego": None}
    frame["ground"] = {"height_m": 1.0, "pitch_rad": 0.0, "roll_rad": 0.0}
    (tmp_path / "truth.jsonl").write_text(json.dumps(frame) + "\n")
    assert "truncated" not in read_truth(tmp_path).frames[0]["objects"][0]
    write_rig(StereoRig(camera, camera, T), tmp_path / "rig.yaml")
    (thing,) = read_truth(tmp_path).frames[0]["objects"]
    assert thing["truncated"] == pytest.approx(share, abs=0.01)


def test_what_is_no_truth(tmp_path):
    with pytest.raises(SourceError, match=r"holds no truth: expected truth.jsonl, label_2/, or maps"):
        read_truth(tmp_path)
    (tmp_path / "truth.jsonl").write_text('{"schema": 1, "name": "a", "t_ns": 0, "objects": [{"id": 1}]}\n')
    with pytest.raises(SourceError, match=r"line 1: field objects.0.type: Field required"):
        read_truth(tmp_path)


def test_maps_that_cannot_be_read(tmp_path):
    (maps(tmp_path) / "calib.txt").write_text(CALIB)
    read = read_truth(tmp_path)
    assert read.maps is not None
    (tmp_path / "obj_map" / "a.png").unlink()
    with pytest.raises(SourceError, match=r"obj_map/a.png is missing or no picture of one channel"):
        list(read.maps())
    (tmp_path / "disp_occ_0" / "a.png").unlink()
    with pytest.raises(SourceError, match=r"disp_occ_0 holds no .png files"):
        list(read.maps())


def test_true_disparities_are_rectified(tmp_path):
    maps(tmp_path, ("disparity", "ids"))
    left, right = (Camera((6, 4), f, f, 3.0, 2.0) for f in (100.0, 101.0))
    turned = np.eye(4)
    turned[0, 3] = 0.2
    write_rig(StereoRig(left, right, turned), tmp_path / "rig.yaml")
    (tmp_path / "truth.jsonl").write_text('{"schema": 1, "name": "a", "t_ns": 0, "objects": []}\n')
    read = read_truth(tmp_path)
    assert read.maps is not None
    assert "not rectified: true boxes are in the raw left image" in read.warnings[0]
    with pytest.raises(RigError, match=r"is not rectified, but true disparities are"):
        list(read.maps())
