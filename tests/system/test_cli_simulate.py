"""`roadblock simulate`, in process, with a tiny rig."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import roadblock.cli as cli
from roadblock.cli.simulate import in_words, open_scene
from roadblock.errors import OutputError, RigError, RoadblockError, SettingsError, ValueRefusedError
from roadblock.geometry.pose import pose
from roadblock.io.rig import write_rig
from roadblock.io.sources import open_source
from roadblock.sim import drive
from roadblock.sim.conditions import combined
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.scenes import SCENES
from roadblock.values.camera import Camera, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
QUICK = ("--quality", "preview", "--frames", "2")


@pytest.fixture
def rig(tmp_path) -> str:
    path = tmp_path / "tiny.yaml"
    write_rig(StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0])), path)
    return str(path)


def run(*arguments: object):
    result = CliRunner().invoke(cli.app, ["simulate", *map(str, arguments)])
    if isinstance(result.exception, RoadblockError):
        raise result.exception
    return result


def test_list_shows_every_ready_scene_in_one_line_each():
    lines = run("--list").output.splitlines()
    assert [line.split()[0] for line in lines] == list(SCENES)
    assert all(len(line.split()) > 1 for line in lines)


def test_a_scene_becomes_a_recording_that_opens_as_a_sequence(tmp_path, rig):
    out = tmp_path / "drive"
    result = run("demo", "--rig", rig, "--out", out, "--fps", 5, "--maps", *QUICK)
    assert result.exit_code == 0, result.output
    assert "2 frames" in result.output
    source = open_source(out)
    assert source.is_sequence
    assert source.ground_truth == out / "truth.jsonl"
    assert [(pair.name, pair.t_ns) for pair in source] == [("000000", 0), ("000001", 200_000_000)]
    assert source.rig.left.fx_px == 80.0
    assert {path.name for path in out.iterdir()} >= {"disparity", "ids"}


def test_options_reach_the_record(tmp_path, rig):
    out = tmp_path / "drive"
    run("city", "--rig", rig, "--out", out, "--seed", 3, "--condition", "night", "--condition", "fog", *QUICK)
    plan = json.loads((out / "simulate.json").read_text())
    assert (plan["seed"], plan["quality"], plan["maps"], plan["fps"]) == (3, "preview", False, 10.0)
    both = combined(("night", "fog"))
    assert plan["effects"] == drive.plain(both)


def test_a_scene_brings_its_own_weather():
    assert open_scene("rain", 2)[1].effects == combined(("rain",))
    assert open_scene("city", None)[1].seed == 0


def test_a_scene_file_brings_its_settings_and_options_win(tmp_path, rig):
    file = tmp_path / "scene.yaml"
    file.write_text(
        "roadblock_scene: 1\nthings:\n  - {type: person, nearest_m: 6.0}\nrig: tiny.yaml\nquality: preview\n"
        "duration_s: 0.4\nfps: 5\nconditions: [fog]\n"
    )
    assert run(file, "--out", tmp_path / "drive").exit_code == 0
    plan = json.loads((tmp_path / "drive" / "simulate.json").read_text())
    assert (plan["frames"], plan["fps"]) == (2, 5.0)
    assert plan["effects"]["weather"]["visibility_m"] == 60.0
    run(file, "--out", tmp_path / "other", "--frames", 1, "--condition", "day")
    plan = json.loads((tmp_path / "other" / "simulate.json").read_text())
    assert (plan["frames"], plan["effects"]["weather"]["visibility_m"]) == (1, "inf")


def test_ctrl_c_leaves_whole_frames_and_the_same_command_goes_on(tmp_path, rig, monkeypatch):
    arguments = ("demo", "--rig", rig, "--out", tmp_path / "drive", *QUICK)
    real = drive.photograph

    def tired(*given, index, **named):
        if index == 1:
            raise KeyboardInterrupt
        return real(*given, index=index, **named)

    with monkeypatch.context() as patch:
        patch.setattr(drive, "photograph", tired)
        result = run(*arguments)
    assert result.exit_code == 130
    assert "interrupted after 1 frame of 2" in result.output
    assert [pair.name for pair in open_source(tmp_path / "drive")] == ["000000"]
    assert run(*arguments).exit_code == 0
    run("demo", "--rig", rig, "--out", tmp_path / "whole", *QUICK)
    for name in ("left/000001.png", "truth.jsonl", "timestamps.txt", "simulate.json", "rig.yaml"):
        assert (tmp_path / "drive" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "error", "said"),
    [
        ((), SettingsError, "name a scene"),
        (("demo",), SettingsError, "add --out"),
        (("dmeo", "--out", "x"), SettingsError, "did you mean demo"),
        (("nothing like it", "--out", "x"), SettingsError, "choose one of these"),
        (("missing.yaml", "--out", "x"), SettingsError, "no such file"),
        (("demo", "--out", "x", "--condition", "fgo"), SettingsError, "did you mean fog"),
        (("demo", "--out", "x", "--quality", "best"), ValueRefusedError, "quality must be one of"),
        (("demo", "--out", "x", "--fps", "0"), ValueRefusedError, "fps"),
        (("demo", "--out", "x", "--rig", "missing.yaml"), RigError, "missing.yaml"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(arguments, error, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=said) as caught:
        run(*arguments)
    assert "\n" not in str(caught.value)
    assert not Path("x").exists()


def test_another_drive_is_not_overwritten(tmp_path, rig):
    run("demo", "--rig", rig, "--out", tmp_path / "drive", *QUICK)
    with pytest.raises(OutputError, match="seed 0, asked for 1"):
        run("demo", "--rig", rig, "--out", tmp_path / "drive", "--seed", 1, *QUICK)


def test_scenes_in_words():
    scene = Scene((), Road(), camera_pose())
    assert in_words(scene) == "nothing on the road; standing"
    moving = replace(SCENES["demo"](0), road=Road(curvature_per_m=0.01, grade=0.1), speed_mps=10.0, conditions=("fog",))
    assert in_words(moving) == "3 box, 3 person; the road bends; the road climbs; at 36 km/h; fog"
