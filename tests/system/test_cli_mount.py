"""`roadblock calibrate-mount`: drives and pictures of known mounting, end to end."""

import json
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic import paper_rig_of_width

from roadblock.cli import mount
from roadblock.cli.mount import _doubt, parse_offset
from roadblock.errors import SettingsError
from roadblock.geometry.pose import pose
from roadblock.io.rig import read_rig, write_rig
from roadblock.io.sources.source import ImagePairs
from roadblock.pipeline import Pipeline
from roadblock.sim.drive import DriveSettings, simulate
from roadblock.sim.road import Road
from roadblock.sim.scene import camera_pose
from roadblock.sim.scenes import SCENES
from roadblock.stages.mount import Measured, find_mounting

HEIGHT_M, PITCH_RAD, ROLL_RAD, YAW_RAD = 1.55, 0.06, -0.03, np.radians(3.0)


def record(folder: Path, frames: int, **world: object) -> Path:
    """Drive 8 m/s through a street of parked cars, the cameras looking 3 deg to the left of the way."""
    aside = pose(Rotation.from_euler("z", YAW_RAD).as_matrix(), np.zeros(3))
    scene = replace(SCENES["parked"](1), T_world_car=aside @ camera_pose(HEIGHT_M, PITCH_RAD, ROLL_RAD), speed_mps=8.0)
    rig = paper_rig_of_width(480)
    for _ in simulate(replace(scene, **world), rig, DriveSettings(frames=frames, quality="preview"), folder):
        pass
    write_rig(rig, folder / "rig.yaml")
    return folder


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Six frames; read only."""
    return record(tmp_path_factory.mktemp("drive") / "drive", 6)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One frame; read only."""
    folder = record(tmp_path_factory.mktemp("picture") / "picture", 1)
    (folder / "timestamps.txt").unlink()
    return folder


def told(out: str) -> dict[str, tuple[str, str]]:
    """The table's numbers and sigmas by name."""
    rows = re.findall(r"^ *(height over the road|pitch|roll|yaw) +(unknown|\S+ \S+) +(unknown|\S+ \S+)", out, re.M)
    return {name: (value, sigma) for name, value, sigma in rows}


def test_a_straight_drive_tells_the_whole_mounting(roadblock, work: Path, drive: Path) -> None:
    ran = roadblock("calibrate-mount", drive, "-o", "mounted.yaml", "--forward", "1.6m", "--left", "-12cm")
    assert (ran.code, ran.err) == (0, "")
    assert re.search(r"^6 of 6 frames used, [45] of 5 steps straight$", ran.out, re.M)
    assert ran.out.endswith("wrote mounted.yaml\n")
    T = read_rig("mounted.yaml").T_vehicle_car
    assert T is not None
    np.testing.assert_allclose(T[:3, 3], [1.6, -0.12, HEIGHT_M], rtol=0, atol=0.02)
    # The world's x is the way, its z is up: the camera's axes in it are those in the vehicle.
    truth = Rotation.from_euler("z", YAW_RAD).as_matrix() @ camera_pose(1.0, PITCH_RAD, ROLL_RAD)[:3, :3]
    off = Rotation.from_matrix(T[:3, :3].T @ truth).magnitude()
    assert np.degrees(off) < 0.5
    numbers = told(ran.out)
    for name, unit, true in (
        ("height over the road", "m", HEIGHT_M),
        ("pitch", "deg", np.degrees(PITCH_RAD)),
        ("roll", "deg", np.degrees(ROLL_RAD)),
        ("yaw", "deg", np.degrees(YAW_RAD)),
    ):
        value, sigma = (float(text.removesuffix(f" {unit}")) for text in numbers[name])
        assert abs(value - true) < 4 * sigma
        assert 0 < sigma < 0.5


def test_obstacles_of_a_mounted_rig_stand_on_the_road(roadblock, work: Path, drive: Path) -> None:
    assert roadblock("calibrate-mount", drive, "-o", "mounted.yaml", "--forward", "1.6m").code == 0
    for name, options in (("plain", []), ("mounted", ["--rig", "mounted.yaml"])):
        assert roadblock("detect", drive, "--out", name, *options).code == 0
    plain, mounted = (
        [json.loads(line)["obstacles"][0] for line in Path(name, "obstacles.jsonl").read_text().splitlines()]
        for name in ("plain", "mounted")
    )
    T = read_rig("mounted.yaml").T_vehicle_car
    assert T is not None
    for a, b in zip(plain, mounted, strict=True):
        assert a["range_m"] == b["range_m"]
        x, y, z = a["position_m"]
        np.testing.assert_allclose(b["position_m"], (T @ [-y, -z, x, 1])[:3], rtol=0, atol=3e-4)
        assert b["position_m"][2] == pytest.approx(0.0, abs=0.05)
        assert abs(a["position_m"][2]) > 0.9  # unmounted, heights count from the cameras


def test_one_picture_tells_no_yaw_and_no_sigma(roadblock, work: Path, picture: Path) -> None:
    ran = roadblock("calibrate-mount", picture, "-o", "mounted.yaml")
    assert ran.code == 0
    numbers = told(ran.out)
    assert float(numbers["height over the road"][0].removesuffix(" m")) == pytest.approx(HEIGHT_M, abs=0.03)
    assert {sigma for _, sigma in numbers.values()} == {"unknown"}
    assert numbers["yaw"][0] == "unknown"
    assert "yaw unknown, taken as straight: single pictures do not show the direction of travel" in ran.err
    assert "a single frame does not tell how sure it is" in ran.err
    T = read_rig("mounted.yaml").T_vehicle_car
    assert T is not None
    assert T[1, 2] == pytest.approx(0.0, abs=1e-12)


def test_a_mounting_of_before_is_replaced_and_all_else_kept(roadblock, work: Path, picture: Path) -> None:
    before = replace(paper_rig_of_width(480), T_vehicle_car=pose(np.eye(3), [9, 9, 9]))
    write_rig(before, "rig.yaml")
    ran = roadblock("calibrate-mount", picture, "--rig", "rig.yaml", "-o", "rig.yaml")
    assert ran.code == 0
    assert "the rig had a mounting already: this one replaces it" in ran.err
    after = read_rig("rig.yaml")
    assert after.T_vehicle_car is not None
    assert after.T_vehicle_car[0, 3] == 0.0
    assert after.left.fx_px == before.left.fx_px
    np.testing.assert_array_equal(after.T_left_right, before.T_left_right)


def test_without_o_nothing_is_written(roadblock, work: Path, picture: Path) -> None:
    assert roadblock("calibrate-mount", picture).code == 0
    assert list(work.iterdir()) == []


@pytest.mark.parametrize(
    ("world", "says"),
    [
        ({"speed_mps": 0.0}, "the cameras nowhere moved 0.3 m between frames that show the same"),
        ({"road": Road(curvature_per_m=1 / 30)}, "0 of 3 steps were straight; record a longer straight drive"),
    ],
)
def test_drives_that_tell_no_yaw_say_why(roadblock, work: Path, world: dict[str, object], says: str) -> None:
    ran = roadblock("calibrate-mount", record(work / "drive", 4, **world))
    assert ran.code == 0
    assert told(ran.out)["yaw"] == ("unknown", "unknown")
    assert f"note: yaw unknown, taken as straight: {says}\n" in ran.err


def test_a_sequence_of_one_frame_has_no_yaw(roadblock, work: Path) -> None:
    ran = roadblock("calibrate-mount", record(work / "drive", 1))
    assert "one frame does not show the direction of travel" in ran.err


def test_frames_left_out_are_counted_with_reasons(roadblock, work: Path) -> None:
    folder = record(work / "drive", 4)
    for side in ("left", "right"):
        _blank(folder / side / "000002.png")
    ran = roadblock("calibrate-mount", folder)
    assert ran.code == 0
    assert "3 of 4 frames used" in ran.out
    assert "left out: no road found (1 of 4 frames)" in ran.err
    # Nothing is followed into the blank frame, nor out of it: one step is left.
    assert re.search(r"yaw unknown, taken as straight: [01] of 1 steps were straight", ran.err)


def _blank(path: Path) -> None:
    cv2.imwrite(str(path), np.full((270, 480, 3), 90, np.uint8))


def test_where_no_frame_shows_a_road_there_is_no_mounting(roadblock, work: Path) -> None:
    folder = record(work / "drive", 2)
    for side in ("left", "right"):
        for name in ("000000.png", "000001.png"):
            _blank(folder / side / name)
    ran = roadblock("calibrate-mount", folder, "-o", "rig.yaml")
    assert (ran.code, ran.out) == (2, "")
    assert ran.err == (
        "error: drive: none of 2 frames shows flat road 0.2 to 4 m below the cameras: no road found (2); "
        "check the rig's unit, or record free road in daylight\n"
    )
    assert not Path("rig.yaml").exists()


def test_a_height_that_cannot_be_is_refused(roadblock, work: Path, picture: Path) -> None:
    """A rig in other units makes the road lie elsewhere: here ten times too far below."""
    rig = paper_rig_of_width(480)
    wide = replace(rig, T_left_right=pose(np.eye(3), [2.05, 0, 0]))
    write_rig(wide, "wide.yaml")
    lengths = {"height_m": "[2, 40]", "near_m": 350, "far_m": 500, "side_m": 60, "tolerance_m": 1.0}
    options = [word for key, value in lengths.items() for word in ("--set", f"ground.{key}={value}")]
    ran = roadblock("calibrate-mount", picture, "--rig", "wide.yaml", *options)
    assert (ran.code, ran.out) == (2, "")
    assert re.fullmatch(r"error: the cameras would be 15\.\d m over the road, but a vehicle's are .*--unit\n", ran.err)


def source_of(monkeypatch: pytest.MonkeyPatch, **fields: object) -> None:
    rig = paper_rig_of_width(160)
    found = ImagePairs(**({"name": "made", "rig": rig, "frames": ()} | fields))
    monkeypatch.setattr(mount, "open_source", lambda *_, **__: found)


def test_a_source_without_frames_is_refused(roadblock, work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source_of(monkeypatch)
    ran = roadblock("calibrate-mount", "made")
    assert ran.code == 2
    assert ran.err == "error: made holds no frames: give a picture of flat road, or a short drive\n"


def test_a_source_of_several_rigs_is_refused(roadblock, work: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source_of(monkeypatch, rigs=(paper_rig_of_width(160), paper_rig_of_width(160)))
    ran = roadblock("calibrate-mount", "made")
    assert ran.code == 2
    assert ran.err.startswith("error: made holds frames of 2 rigs, but a mounting is of one: ")


def test_warnings_of_the_source_are_passed_on(
    roadblock, work: Path, picture: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    really = mount.open_source

    def warned(*given: object, **named: object) -> object:
        source = really(*given, **named)
        source.warnings.append("one file was passed over")
        return source

    monkeypatch.setattr(mount, "open_source", warned)
    assert "note: one file was passed over\n" in roadblock("calibrate-mount", picture).err


def test_ctrl_c_writes_nothing(roadblock, work: Path, picture: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Pipeline, "step", stop)
    ran = roadblock("calibrate-mount", picture, "-o", "rig.yaml")
    assert (ran.code, ran.out) == (130, "")
    assert ran.err == "note: interrupted after 0 frames; nothing was written\n"
    assert not Path("rig.yaml").exists()


@pytest.mark.parametrize(
    ("text", "metres"),
    [("1.2m", 1.2), ("-35cm", -0.35), ("0", 0.0), ("+.5", 0.5), (" 250 mm ", 0.25), ("-2in", -0.0508)],
)
def test_offsets(text: str, metres: float) -> None:
    assert parse_offset("--left", text) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize("text", ["", "m", "1.2 parsec", "nan", "1e3", "--1", "1.2.3"])
def test_offsets_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError, match=r"^--left must be a length as 1\.2m or -35cm, but got '"):
        parse_offset("--left", text)


def test_offsets_longer_than_vehicles_are_refused(roadblock, work: Path, picture: Path) -> None:
    ran = roadblock("calibrate-mount", picture, "--forward", "1600m")
    assert ran.code == 2
    assert ran.err == "error: --forward must be at most 20 m, but got 1600 m: another unit?\n"


@pytest.mark.parametrize(
    ("climb_deg", "sigma_deg", "says"),
    [
        (0.4, 0.01, None),
        (0.9, 0.4, None),
        (0.9, 0.1, "travel 0.9 deg out of the road they see"),
        (-1.2, 0.3, "travel 1.2 deg into the road they see"),
    ],
)
def test_ways_that_leave_the_road_are_in_doubt(climb_deg: float, sigma_deg: float, says: str | None) -> None:
    text = _doubt(Measured(np.radians(climb_deg), np.radians(sigma_deg)))
    assert text == "" if says is None else says in text


def test_a_way_in_doubt_is_said(roadblock, work: Path, drive: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def squinting(*given: object, **named: object) -> object:
        return replace(find_mounting(*given, **named), climb_rad=Measured(-0.03, 0.004))

    monkeypatch.setattr(mount, "find_mounting", squinting)
    ran = roadblock("calibrate-mount", drive)
    assert ran.code == 0
    assert "note: the cameras travel 1.7 deg into the road they see, but must travel along it" in ran.err


def test_a_real_drive(roadblock, work: Path, data_dir: Path) -> None:
    """Velodyne scans of these frames have the road 1.68 to 1.69 m below, pitch -0.5 to 0.2 deg, roll 0.9 to 1.5 deg."""
    raw = data_dir / "kitti_raw_0926"
    images = [[raw / f"image_0{i}" / "data" / f"{n:010d}.png" for i in (0, 1)] for n in range(52, 64)]
    Path("ten.txt").write_text("".join(f"{a} {b} {10**8 * i}\n" for i, (a, b) in enumerate(images)))
    rig = next(raw.glob("calib_cam_to_cam*.txt"))
    ran = roadblock("calibrate-mount", "ten.txt", "--rig", rig, "--size", "1392x512")
    assert (ran.code, ran.err) == (0, "")
    numbers = told(ran.out)
    for name, unit, true, least in (
        ("height over the road", "m", 1.685, 0.03),
        ("pitch", "deg", -0.2, 0.2),
        ("roll", "deg", 1.2, 0.2),
        ("yaw", "deg", 0.0, 0.2),
    ):
        value, sigma = (float(text.removesuffix(f" {unit}")) for text in numbers[name])
        assert abs(value - true) < 2.5 * max(sigma, least)
