import io
import json
import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.errors import OutputError, ValueRefusedError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.sim import drive
from roadblock.sim.conditions import Effects
from roadblock.sim.drive import DriveSettings, coded_disparity, plain, simulate, truth_record
from roadblock.sim.render import render
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.sensor import Sensor
from roadblock.sim.solids import placed
from roadblock.sim.things import crate
from roadblock.sim.weather import Weather
from roadblock.values.camera import Camera, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))
RAW = StereoRig(
    Camera((97, 61), 80.0, 77.0, 51.3, 27.6, "brown_conrady", [-0.1, 0.02, 1e-3, -1e-3, 0]),
    CAMERA,
    pose(rotation_from_rotvec([0.01, -0.02, 0.005]), [0.3, 0.004, -0.002]),
)
CRATE = placed(crate(7, "red", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.3, 0.4)
MOVING = replace(CRATE, velocity_mps=np.array([1.0, -2.0, 0.0]), yaw_rate_radps=0.5)
SCENE = Scene((MOVING,), Road(), camera_pose(1.3, 0.05), speed_mps=8.0)
NOISY = Effects(Sensor(full_well_e=3000.0, read_noise=1.0), Weather(rain_mm_h=30.0, lens_drops=2))
SETTINGS = DriveSettings(frames=3, fps=20.0, seed=4, quality="preview", effects=NOISY, maps=True)


def bytes_of(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def record_of(*things):
    scene = Scene(things, Road(), camera_pose(1.3, 0.05))
    return truth_record(render(scene, RIG, quality="preview", index=3, name="000003", t_ns=17), scene, RIG)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("drive") / "a" / "b"
    assert list(simulate(SCENE, RIG, SETTINGS, folder)) == [0, 1, 2, 3]
    return folder


def copied(recorded: Path, folder: Path) -> Path:
    for name, data in bytes_of(recorded).items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def test_record_is_plain_json_with_the_documented_keys():
    record = record_of(CRATE)
    assert json.loads(json.dumps(record, allow_nan=False)) == record
    assert list(record) == ["schema", "frame", "name", "t_ns", "objects", "ground", "ego"]
    assert (record["schema"], record["frame"], record["name"], record["t_ns"]) == (1, 3, "000003", 17)
    (true,) = record["objects"]
    keys = "id type color position_m range_m mean_range_m size_m box_px visible_px center_m yaw_rad velocity_mps"
    assert list(true) == [*keys.split(), "yaw_rate_radps"]
    assert (true["id"], true["type"], true["color"]) == (7, "box", "red")
    assert true["size_m"] == pytest.approx([1.0, 0.8, 0.5])
    assert record["ground"] == pytest.approx({"height_m": 1.3, "pitch_rad": 0.05, "roll_rad": 0.0})


def test_poses_and_motion_are_in_the_vehicle_frame():
    """Against the construction: the vehicle looks 0.05 down, 1.3 m over the world's origin, 0.2 to the left."""
    turned = pose(rotation_from_rotvec([0, 0, 0.2]), np.zeros(3))
    scene = replace(SCENE, T_world_car=turned @ SCENE.T_world_car)
    scene = replace(scene, things=(replace(MOVING, T_world_thing=turned @ MOVING.T_world_thing),))
    record = truth_record(render(scene, RIG, quality="preview"), scene, RIG)
    (true,) = record["objects"]
    T_world_vehicle = turned @ pose(rotation_from_rotvec([0, 0.05, 0]), [0, 0, 1.3])
    assert np.array(record["ego"]["T_world_vehicle"]) == pytest.approx(T_world_vehicle)
    assert record["ego"]["speed_mps"] == 8.0
    R = T_world_vehicle[:3, :3]
    assert true["velocity_mps"] == pytest.approx(R.T @ [1.0, -2.0, 0.0])
    assert true["yaw_rad"] == pytest.approx(0.4, abs=2e-3)
    middle = transform(turned @ MOVING.T_world_thing, [0, 0, 0.4])
    assert true["center_m"] == pytest.approx(transform(inverse(T_world_vehicle), middle))
    assert true["yaw_rate_radps"] == 0.5


def test_a_mounting_moves_the_vehicle_frame():
    mounted = replace(RIG, T_vehicle_car=pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [1.5, 0, 1.3]))
    scene = replace(SCENE, T_world_car=camera_pose(1.3))
    record = truth_record(render(scene, mounted, quality="preview"), scene, mounted)
    assert np.array(record["ego"]["T_world_vehicle"]) == pytest.approx(pose(np.eye(3), [-1.5, 0, 0]))
    assert record["objects"][0]["center_m"] == pytest.approx(MOVING.T_world_thing[:3, 3] + (1.5, 0, 0.4))


def test_without_the_scene_poses_are_unknown():
    record = truth_record(render(SCENE, RIG, quality="preview"))
    assert record["ego"] is None
    true = record["objects"][0]
    assert [true[key] for key in ("center_m", "yaw_rad", "velocity_mps", "yaw_rate_radps")] == [None] * 4


def test_a_level_road_has_no_minus_zero():
    scene = Scene((), Road(), camera_pose())
    record = truth_record(render(scene, RIG, quality="preview"), scene, RIG)
    assert "-0" not in json.dumps([record["ground"], record["ego"]]).replace("e-0", "")


def test_a_nameless_colour_is_null_and_an_empty_street_has_no_objects():
    (true,) = record_of(placed(crate(1, "", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.3))["objects"]
    assert true["color"] is None
    assert record_of()["objects"] == []


@pytest.mark.parametrize(
    ("name", "value"),
    [("frames", 0), ("frames", 2.5), ("frames", True), ("seed", -1), ("fps", 0.0), ("fps", 1e4), ("quality", "best")],
)
def test_settings_that_cannot_be_are_refused(name, value):
    with pytest.raises(ValueRefusedError, match=name):
        DriveSettings(**{name: value})


def test_a_drive_is_a_recording_with_its_truth(recorded):
    names = [f"{index:06d}" for index in range(3)]
    for folder in ("left", "right", "disparity", "ids"):
        assert sorted(path.stem for path in (recorded / folder).iterdir()) == names
    assert (recorded / "timestamps.txt").read_text().split() == ["0", "50000000", "100000000"]
    records = [json.loads(line) for line in (recorded / "truth.jsonl").read_text().splitlines()]
    assert [(r["frame"], r["name"], r["t_ns"]) for r in records] == [(i, names[i], 50_000_000 * i) for i in range(3)]
    # 8 m/s towards a crate that drives away at 1 m/s, for 0.1 s, and looks 0.05 rad down.
    ahead = [r["objects"][0]["center_m"][0] for r in records]
    assert ahead[0] - ahead[2] == pytest.approx(0.7, abs=0.01)
    at = np.array([r["ego"]["T_world_vehicle"] for r in records])[:, 0, 3]
    assert at == pytest.approx([0.0, 0.4, 0.8])


def test_images_and_maps_are_what_was_rendered(recorded):
    exact = render(SCENE, RIG, quality="preview")
    left = cv2.imread(str(recorded / "left" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert (left.shape, left.dtype) == ((61, 97, 3), np.uint8)
    red = left[exact.ids == 7].mean(0)
    assert red[2] > 2 * red[0]  # OpenCV reads BGR
    ids = cv2.imread(str(recorded / "ids" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert ids.dtype == np.uint16
    assert (ids == exact.ids).all()
    steps = cv2.imread(str(recorded / "disparity" / "000000.png"), cv2.IMREAD_UNCHANGED)
    d_px = exact.disparity.d_px
    assert (steps[np.isnan(d_px)] == 0).all()
    assert np.nanmax(np.abs(steps / 256 - d_px)) <= 1 / 256


def test_disparities_are_coded_so_that_zero_is_unknown():
    coded = coded_disparity(np.array([[np.nan, 0.0, 1.0, 300.0]], np.float32))
    assert coded.tolist() == [[0, 1, 256, 65535]]


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(recorded, tmp_path):
    list(simulate(SCENE, RIG, SETTINGS, tmp_path / "same"))
    assert bytes_of(tmp_path / "same") == bytes_of(recorded)
    list(simulate(SCENE, RIG, replace(SETTINGS, seed=5), tmp_path / "other"))
    other = bytes_of(tmp_path / "other")
    assert other["left/000000.png"] != bytes_of(recorded)["left/000000.png"]
    assert other["truth.jsonl"] == bytes_of(recorded)["truth.jsonl"]


def test_a_whole_drive_is_left_as_it_is(recorded, monkeypatch):
    monkeypatch.setattr(drive, "photograph", None)
    before = bytes_of(recorded)
    assert list(simulate(SCENE, RIG, SETTINGS, recorded)) == [3]
    assert bytes_of(recorded) == before


@pytest.mark.parametrize("when", [0, 1, 2])
def test_an_interrupted_drive_goes_on_to_the_same_bytes(recorded, tmp_path, monkeypatch, when):
    """Ctrl-C between two files of a frame: that frame is absent; the next run ends up with the same bytes."""
    real, calls = Path.replace, []

    def replaced(self, target):
        if self.parent.name == "right" and self.name.startswith(f"{when:06d}"):
            calls.append(self)
            raise KeyboardInterrupt
        return real(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", replaced)
        with pytest.raises(KeyboardInterrupt):
            list(simulate(SCENE, RIG, SETTINGS, tmp_path))
    assert calls
    assert len(list((tmp_path / "left").iterdir())) == len(list((tmp_path / "right").iterdir())) == when
    assert list(simulate(SCENE, RIG, SETTINGS, tmp_path)) == list(range(when, 4))
    assert bytes_of(tmp_path) == bytes_of(recorded)


@pytest.mark.parametrize("damage", ["cut", "image", "part", "extra", "no truth"])
def test_what_a_kill_left_behind_is_repaired(recorded, tmp_path, damage):
    copied(recorded, tmp_path)
    truth = tmp_path / "truth.jsonl"
    if damage == "cut":
        truth.write_bytes(truth.read_bytes()[:-20])
    elif damage == "image":
        (tmp_path / "right" / "000001.png").unlink()
    elif damage == "part":
        truth.write_bytes(b"".join(truth.read_bytes().splitlines(keepends=True)[:2]))
        (tmp_path / "left" / "000002.png.part").write_bytes(b"half")
    elif damage == "extra":
        (tmp_path / "left" / "000007.png").write_bytes(b"of nothing")
    else:
        truth.unlink()
    whole = {"cut": 2, "image": 1, "part": 2, "extra": 3, "no truth": 0}[damage]
    assert next(simulate(SCENE, RIG, SETTINGS, tmp_path)) == whole
    list(simulate(SCENE, RIG, SETTINGS, tmp_path))
    assert bytes_of(tmp_path) == bytes_of(recorded)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"seed": 9}, "seed 4, asked for 9"),
        ({"frames": 2, "fps": 5.0}, "frames 3, asked for 2, fps 20.0, asked for 5.0"),
        ({"effects": Effects()}, "other effects"),
        ({"quality": "demo"}, "quality preview, asked for demo"),
    ],
)
def test_a_folder_with_another_drive_is_refused(recorded, change, said):
    before = bytes_of(recorded)
    with pytest.raises(OutputError, match=said):
        simulate(SCENE, RIG, replace(SETTINGS, **change), recorded)
    assert bytes_of(recorded) == before


def test_another_scene_or_rig_is_another_drive(recorded):
    with pytest.raises(OutputError, match="another scene"):
        simulate(replace(SCENE, seed=3), RIG, SETTINGS, recorded)
    with pytest.raises(OutputError, match="another scene"):
        simulate(replace(SCENE, speed_mps=9.0), RIG, SETTINGS, recorded)
    with pytest.raises(OutputError, match="another rig"):
        simulate(SCENE, replace(RIG, T_left_right=pose(np.eye(3), [0.31, 0, 0])), SETTINGS, recorded)


@pytest.mark.parametrize("content", [b"", b"[]", b"\xff\xfe", b'{"seed"', b"[" * 100_000])
def test_a_plan_that_is_none_is_refused(tmp_path, content):
    (tmp_path / "simulate.json").write_bytes(content)
    with pytest.raises(OutputError, match="no record of a drive"):
        simulate(SCENE, RIG, SETTINGS, tmp_path)


@pytest.mark.parametrize("name", ["left", "truth.jsonl"])
def test_a_folder_of_something_else_is_refused(tmp_path, name):
    (tmp_path / name).mkdir()
    with pytest.raises(OutputError, match=f"holds {name} of something else"):
        simulate(SCENE, RIG, SETTINGS, tmp_path)


def test_a_folder_that_is_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        simulate(SCENE, RIG, SETTINGS, tmp_path / "file")


def test_a_full_disk_leaves_whole_frames(tmp_path, monkeypatch):
    real = Path.write_bytes

    def full(self, data):
        if self.name.startswith("000001") and self.parent.name == "right":
            raise OSError(28, "No space left on device")
        return real(self, data)

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match="No space left"):
        list(simulate(SCENE, RIG, SETTINGS, tmp_path))
    assert [path.name for path in (tmp_path / "left").iterdir()] == ["000000.png"]
    assert len((tmp_path / "truth.jsonl").read_bytes().splitlines()) == 1


def test_a_truth_that_does_not_fit_is_taken_back(tmp_path, monkeypatch):
    """A raw file may take a part of a line only, without an error."""
    real = Path.open

    class Narrow(io.FileIO):
        def write(self, data):
            return super().write(data[:50])

    def opened(self, mode="r", *more, **named):
        narrow = self.name == "truth.jsonl" and mode == "ab" and (tmp_path / "left" / "000000.png").exists()
        return Narrow(self, "ab") if narrow else real(self, mode, *more, **named)

    monkeypatch.setattr(Path, "open", opened)
    with pytest.raises(OutputError, match="No space left"):
        list(simulate(SCENE, RIG, SETTINGS, tmp_path))
    assert (tmp_path / "truth.jsonl").read_bytes().count(b"\n") == 1
    assert (tmp_path / "truth.jsonl").read_bytes().endswith(b"\n")
    assert len(list((tmp_path / "right").iterdir())) == 1


def test_a_plan_that_cannot_be_written_leaves_nothing(tmp_path, monkeypatch):
    def broken(self, target):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(Path, "replace", broken)
    with pytest.raises(OutputError, match="Input/output error"):
        simulate(SCENE, RIG, SETTINGS, tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_raw_rig_has_no_disparities(tmp_path):
    settings = replace(SETTINGS, frames=1, effects=Effects())
    assert list(simulate(SCENE, RAW, settings, tmp_path)) == [0, 1]
    assert not (tmp_path / "disparity").exists()
    assert cv2.imread(str(tmp_path / "ids" / "000000.png"), cv2.IMREAD_UNCHANGED).any()


def test_grey_images_of_16_bit_are_written_as_such(tmp_path):
    settings = replace(SETTINGS, frames=1, maps=False, effects=Effects(Sensor(bits=16, color=False)))
    list(simulate(SCENE, RIG, settings, tmp_path))
    image = cv2.imread(str(tmp_path / "left" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert (image.dtype, image.shape) == (np.uint16, (61, 97))
    assert not (tmp_path / "ids").exists()


def test_plain_values_are_json():
    value = {"a": (1, math.inf), 2: np.array([1.5]), "f": print, "b": np.float64(2.0), "t": True, "s": "x", "n": None}
    expected = {"a": [1, "inf"], "2": [1.5], "f": None, "b": 2.0, "t": True, "s": "x", "n": None}
    assert plain(value) == expected
