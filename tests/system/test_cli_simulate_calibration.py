"""`roadblock simulate-calibration`, in process, with a tiny rig."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import roadblock.cli as cli
from roadblock.cli.detect import INTERRUPTED
from roadblock.errors import OutputError, RoadblockError, SettingsError, ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.boards import open_board_images
from roadblock.io.rig import read_rig, write_rig
from roadblock.sim import board_set
from roadblock.sim.boards import bowed_points, built_rig
from roadblock.stages.calibrate.board import parse_board
from roadblock.values.camera import Camera, StereoRig

LEFT = Camera((97, 61), 83.0, 79.0, 44.3, 33.6, "brown_conrady", [-0.1, 0.02, 0.001, -0.002, 0.0])
RIGHT = Camera((97, 61), 81.0, 80.0, 50.1, 27.2)
QUICK = ("--board", "chessboard:4x3", "--views", "2")


@pytest.fixture
def rig(tmp_path) -> str:
    path = tmp_path / "tiny.yaml"
    write_rig(StereoRig(LEFT, RIGHT, pose(rotation_from_rotvec([0.01, -0.02, 0.015]), [0.05, 0.002, 0.001])), path)
    return str(path)


def run(*arguments: object):
    result = CliRunner().invoke(cli.app, ["simulate-calibration", *map(str, arguments)])
    if isinstance(result.exception, RoadblockError):
        raise result.exception
    return result


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_set_holds_pictures_the_true_rig_and_the_poses(tmp_path, rig):
    out = tmp_path / "new" / "set"
    result = run("--rig", rig, "--out", out, "--square", "20mm", *QUICK)
    assert result.exit_code == 0, result.output
    assert sorted(contents(out)) == [
        "left/00.png", "left/01.png", "rig.yaml", "right/00.png", "right/01.png", "truth.json",
    ]  # fmt: skip
    assert f"roadblock calibrate {out}/left {out}/right --board chessboard:4x3 --square 20mm" in result.output
    assert read_rig(out / "rig.yaml").left.fx_px == 83.0
    truth = json.loads((out / "truth.json").read_text())
    assert (truth["schema"], truth["seed"], truth["bow_m"]) == (1, 0, 0.0)
    assert truth["board"] == {"kind": "chessboard", "columns": 4, "rows": 3, "square_m": 0.02}
    assert [view["name"] for view in truth["views"]] == ["00", "01"]
    assert all(np.shape(view["T_left_board"]) == (4, 4) for view in truth["views"])


def test_the_set_opens_as_pictures_of_a_board(tmp_path, rig):
    run("--rig", rig, "--out", tmp_path / "set", *QUICK)
    images = open_board_images(str(tmp_path / "set" / "left"), str(tmp_path / "set" / "right"))
    assert [(shot.name, shot.left.shape, shot.right.shape) for shot in images] == [
        ("00", (61, 97), (61, 97)),
        ("01", (61, 97), (61, 97)),
    ]


def test_the_same_seed_gives_the_same_bytes_and_another_one_does_not(tmp_path, rig):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        run("--rig", rig, "--out", tmp_path / name, "--seed", seed, *QUICK)
    a, b, c = (contents(tmp_path / name) for name in "abc")
    assert a == b
    assert a["left/00.png"] != c["left/00.png"]


def test_a_bowed_board_is_written_down(tmp_path, rig):
    run("--rig", rig, "--out", tmp_path / "set", "--bow", "2mm", *QUICK)
    truth = json.loads((tmp_path / "set" / "truth.json").read_text())
    assert truth["bow_m"] == 0.002
    assert bowed_points(parse_board("chessboard:4x3", 0.025), truth["bow_m"])[0, 2] == pytest.approx(0.002)


def test_without_a_rig_there_is_one_with_lenses(tmp_path):
    run("--out", tmp_path / "set", "--seed", 2, "--views", 1)
    found, built = read_rig(tmp_path / "set" / "rig.yaml"), built_rig(np.random.default_rng(2))
    assert found.left.distortion == pytest.approx(built.left.distortion)
    assert np.abs(found.left.distortion).max() > 0.01
    assert found.T_left_right == pytest.approx(built.T_left_right)
    assert cv2.imread(str(tmp_path / "set" / "left" / "00.png"), cv2.IMREAD_UNCHANGED).shape == (720, 1280)


@pytest.mark.parametrize("place", [".", "left"])
def test_a_folder_that_holds_something_is_refused(tmp_path, rig, place):
    out = tmp_path / "set"
    (out / place).mkdir(parents=True)
    (out / place / "holiday.png").write_bytes(b"")
    with pytest.raises(OutputError, match=r"holiday\.png already: choose a new folder"):
        run("--rig", rig, "--out", out, *QUICK)


def test_an_interruption_leaves_no_truth_and_says_so(tmp_path, rig, monkeypatch):
    def interrupted(*_arguments, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(board_set, "render_board", interrupted)
    result = run("--rig", rig, "--out", tmp_path / "set", *QUICK)
    assert result.exit_code == INTERRUPTED
    assert "interrupted after 0 of 2" in result.output
    assert not list(contents(tmp_path / "set"))


def test_what_cannot_be_written_is_an_error(tmp_path, rig, monkeypatch):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(OutputError, match="cannot write"):
        run("--rig", rig, "--out", tmp_path / "file" / "set", *QUICK)

    def full(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OutputError, match=r"00\.png: No space left"):
        run("--rig", rig, "--out", tmp_path / "set", *QUICK)


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        (("--board", "chess:4x3"), SettingsError, "chessboard"),
        (("--square", "25"), SettingsError, "25mm"),
        (("--square", "25m"), ValueRefusedError, "unit"),
        (("--bow", "0.1"), SettingsError, "--bow"),
        (("--bow", "40mm"), ValueRefusedError, "bow_m"),
        (("--rig", "nowhere.yaml"), RoadblockError, "nowhere"),
    ],
)
def test_what_makes_no_sense_is_refused(tmp_path, rig, options, error, words):
    arguments = {"--rig": rig, "--board": "chessboard:4x3", "--out": str(tmp_path / "set"), "--views": "1"}
    arguments[options[0]] = options[1]
    with pytest.raises(error, match=words):
        run(*(word for pair in arguments.items() for word in pair))
