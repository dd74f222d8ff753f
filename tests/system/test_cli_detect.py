"""`roadblock detect`: from a recording to a table, JSON lines, run.json and pictures."""

import builtins
import contextlib
import io
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

import roadblock as package
from roadblock.cli import main
from roadblock.cli.detect import Tally, report
from roadblock.errors import OutputError
from roadblock.io.results import JsonlSink, read_results
from roadblock.io.rig import read_rig, write_rig
from roadblock.values.camera import RigCovariance, rig_parameters
from roadblock.values.decision import Decision
from roadblock.values.scene import FrameResult, FreeSpace, Health
from roadblock.viz.sinks import VideoSink

COMMAND_LINE = "from roadblock.cli import main; main()"
NAMES = ["000000", "000001"]


def run_record(out: Path) -> dict:
    return json.loads((out / "run.json").read_text())


def table(printed: str) -> list[list[str]]:
    """The words of each obstacle's row."""
    return [line.split() for line in printed.splitlines() if "±" in line]


def test_a_recording_becomes_a_table_json_lines_and_pictures(roadblock, recording: Path) -> None:
    ran = roadblock("detect", recording, "--out", "results", "--overlay")
    assert (ran.code, ran.err) == (0, "")
    assert "the nearest obstacles in 2 frames" in ran.out
    frame, color, what, range_m, sign, sigma_m, side_m, side, *size = table(ran.out)[0]
    assert (color, sign, side, size[1]) == ("red", "±", "right", "x")
    assert what in ("obstacle", "debris", "wall")
    assert frame in NAMES
    assert float(range_m) == pytest.approx(5, abs=0.2)
    assert 0 < float(sigma_m) < 0.5
    assert float(side_m) == pytest.approx(1.75, abs=0.1)
    assert (float(size[0]), float(size[2])) == pytest.approx((0.9, 0.8), abs=0.15)

    out = Path("results")
    assert {path.name for path in out.iterdir()} == {"obstacles.jsonl", "run.json", "overlay"}
    records = read_results(out / "obstacles.jsonl")
    assert [(r["frame"], r["name"], r["t_ns"], r["health"]["state"]) for r in records] == [
        (0, "000000", 0, "ok"),
        (1, "000001", 0, "ok"),
    ]
    truths = [json.loads(line) for line in (recording / "truth.jsonl").read_text().splitlines()]
    for record, truth in zip(records, truths, strict=True):
        found = [o["range_m"] for o in record["obstacles"]]
        assert found == sorted(found)
        assert found[0] == pytest.approx(truth["objects"][0]["range_m"], abs=0.3)
        assert record["ground"]["height_m"] == pytest.approx(truth["ground"]["height_m"], abs=0.05)
    for name in NAMES:
        picture = cv2.imread(str(out / "overlay" / f"{name}.png"))
        assert picture.shape[0] >= 270
        assert picture.shape[1] > 480


def test_run_json_says_what_made_the_results(roadblock, recording: Path) -> None:
    roadblock("detect", recording, "--out", "results", "--set", "segment.reach_m=30", "--set", "match.matcher=bm")
    run = run_record(Path("results"))
    assert run["version"] == package.__version__
    assert run["commit"] is None or len(run["commit"].removesuffix("-dirty")) == 40
    assert {"platform", "python", "cpu", "cores", "opencv", "numpy", "numba"} == set(run["machine"])
    assert run["source"] == {
        "name": "recording",
        "path": "recording",
        "frames": 2,
        "is_sequence": False,
        "warnings": [],
    }
    assert (run["settings"]["segment"]["reach_m"], run["settings"]["match"]["matcher"]) == (30, "bm")
    assert run["settings"]["detector"] == "cells"
    assert run["rig"]["left"]["size_px"] == [480, 270]
    assert run["rig"]["T_left_right"][0][3] == 0.205
    assert run["started"] < run["finished"]
    assert (run["frames_written"], run["interrupted"]) == (2, False)


def test_a_sequence_becomes_a_video_of_its_own_times(roadblock, sequence: Path) -> None:
    av = pytest.importorskip("av")
    ran = roadblock("detect", sequence, "--out", "results", "--overlay")
    assert (ran.code, ran.err) == (0, "")
    assert "in the last frame, 000003" in ran.out
    assert table(ran.out)
    assert [r["t_ns"] for r in read_results(Path("results/obstacles.jsonl"))] == [0, 10**8, 2 * 10**8, 3 * 10**8]
    assert not Path("results/overlay").exists()
    with av.open("results/overlay.mp4") as video:
        frames = list(video.decode(video=0))
        assert [float(frame.time) for frame in frames] == pytest.approx([0, 0.1, 0.2, 0.3])
        assert frames[0].width > 480


def test_a_sequence_is_tracked(roadblock, sequence: Path) -> None:
    ran = roadblock("detect", sequence, "--out", "results")
    assert ran.code == 0
    assert "track" in ran.out
    assert "speed" in ran.out
    *_, last = read_results(Path("results/obstacles.jsonl"))
    tracked = [o for o in last["obstacles"] if o["id"] is not None]
    assert tracked
    assert {"motion", "velocity_sigma_mps", "ttc_sigma_s", "age_s"} <= set(tracked[0])
    roadblock("detect", sequence, "--out", "results", "--set", "track.enabled=false")
    *_, last = read_results(Path("results/obstacles.jsonl"))
    assert [o["id"] for o in last["obstacles"]] == [None] * len(last["obstacles"])


def test_each_decision_is_told_once(capsys: pytest.CaptureFixture[str]) -> None:
    tally, free = Tally(interrupted=False), FreeSpace(np.zeros(0), np.zeros(0))
    told = [None, Decision("none", "free"), *[Decision("brake", "a wall ahead")] * 3, Decision("none", "free")]
    for index, decision in enumerate(told):
        tally.add(FrameResult(index, f"f{index}", 1, (), free, None, Health(), {}, decision=decision), True)
    rig = SimpleNamespace(verdict="ok")
    source = SimpleNamespace(name="drive", is_sequence=True, rigs=None, rig=rig, warnings=())
    report(source, tally, None)  # type: ignore[arg-type]
    printed = capsys.readouterr().out
    assert printed.count("a wall ahead") == 1
    assert "f2" in printed


@pytest.fixture
def no_video_library(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_av(name: str, *rest: object) -> object:
        if name == "av":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without_av)


def test_without_the_video_library_a_sequence_becomes_pictures(
    roadblock, sequence: Path, no_video_library: None
) -> None:
    ran = roadblock("detect", sequence, "--out", "results", "--overlay")
    assert ran.code == 0
    assert ran.err == (
        "note: writing a video needs an optional library that is not installed; install it with: "
        "pip install 'roadblock[video]' - drawing pictures instead\n"
    )
    assert len(list(Path("results/overlay").glob("*.png"))) == 4
    assert not Path("results/overlay.mp4").exists()


def test_nothing_is_written_without_out(roadblock, recording: Path, work: Path) -> None:
    ran = roadblock("detect", recording)
    assert (ran.code, ran.err) == (0, "")
    assert "red debris" in ran.out or "red obstacle" in ran.out
    assert "results:" not in ran.out
    assert [path.name for path in work.iterdir()] == ["recording"]


def test_what_an_earlier_run_left_is_gone_and_nothing_else(roadblock, recording: Path) -> None:
    roadblock("detect", recording, "--out", "results", "--overlay")
    Path("results/overlay/notes.txt").write_text("mine")
    (recording / "left/000001.png").unlink()
    (recording / "right/000001.png").unlink()
    roadblock("detect", recording, "--out", "results")
    assert len(read_results(Path("results/obstacles.jsonl"))) == 1
    assert [path.name for path in Path("results/overlay").iterdir()] == ["notes.txt"]
    assert run_record(Path("results"))["frames_written"] == 1


def test_settings_come_from_a_file_and_from_the_command(roadblock, recording: Path) -> None:
    Path("near.toml").write_text("[segment]\nreach_m = 8.0\n[match]\nsigma_px = 0.4\n")
    options = ("--settings", "near.toml", "--set", "match.sigma_px=2", "--detector", "dense")
    assert roadblock("detect", recording, "--out", "results", *options).code == 0
    settings = run_record(Path("results"))["settings"]
    assert (settings["segment"]["reach_m"], settings["match"]["sigma_px"]) == (8, 2)
    ranges = [o["range_m"] for r in read_results(Path("results/obstacles.jsonl")) for o in r["obstacles"]]
    assert ranges
    assert max(ranges) <= 8.5


def test_a_detector_of_ones_own(roadblock, recording: Path, monkeypatch) -> None:
    Path("mine.py").write_text(
        "from roadblock.detectors.dense import dense\n"
        "from dataclasses import replace\n"
        "def blind(settings):\n"
        "    look = dense(settings)\n"
        "    return lambda pair: replace(look(pair), regions=())\n"
    )
    monkeypatch.syspath_prepend(str(Path.cwd()))
    ran = roadblock("detect", recording, "--out", "results", "--detector", "mine:blind")
    assert ran.code == 0
    assert ran.out == "recording: no obstacles in 2 frames\nresults: results\n"
    assert run_record(Path("results"))["settings"]["detector"] == "mine:blind"


def test_grey_obstacles_have_no_color(roadblock, recording: Path) -> None:
    assert " red " in roadblock("detect", recording).out
    assert roadblock("detect", recording, "--gray", "--out", "results").code == 0
    obstacles = [o for r in read_results(Path("results/obstacles.jsonl")) for o in r["obstacles"]]
    assert obstacles
    assert all(o["color"] is None for o in obstacles)


def test_a_recording_that_may_be_two_kinds_is_opened_as_told(roadblock, recording: Path) -> None:
    for side, other in (("left", "image_2"), ("right", "image_3")):
        shutil.copytree(recording / side, recording / other)
    assert roadblock("detect", recording).code == 2
    assert roadblock("detect", recording, "--kind", "folder").code == 0


def test_the_rig_may_lie_elsewhere_in_other_units_and_without_a_size(roadblock, recording: Path) -> None:
    roadblock("rig", "convert", recording / "rig.yaml", "chain.yaml", "--to", "opencv")
    (recording / "rig.yaml").unlink()
    text = Path("chain.yaml").read_text()
    text = re.sub(r"image_(width|height).*\n", "", text)
    Path("odd").write_text(re.sub(r"-0\.20[45]\d*|-2\.05\d*e-0?1", "-20.5", text))
    options = ("--rig", "odd", "--unit", "cm", "--size", "480x270", "--format", "opencv")
    assert roadblock("detect", recording, "--out", "results", *options).code == 0
    rig = run_record(Path("results"))["rig"]
    assert rig["T_left_right"][0][3] == pytest.approx(0.205, abs=1e-12)
    assert rig["left"]["size_px"] == [480, 270]


def test_a_rig_written_by_force_is_named(roadblock, recording: Path) -> None:
    path = recording / "rig.yaml"
    rig = read_rig(path)
    names = rig_parameters(rig.left, rig.right)
    sure = RigCovariance(names, np.zeros((len(names), len(names))))
    for verdict, said in (("usable", False), ("refused", True)):
        write_rig(replace(rig, covariance=sure, verdict=verdict), path)
        assert ("do not trust these ranges" in roadblock("detect", recording).err) == said


def test_frames_of_several_rigs_are_measured_each_with_its_own(roadblock, recording: Path) -> None:
    """The same picture twice; the second rig's baseline is half as long, so everything is half as far."""
    for side, folder in (("left", "image_2"), ("right", "image_3")):
        (recording / side).rename(recording / folder)
        shutil.copy(recording / folder / "000000.png", recording / folder / "000001.png")
    (recording / "rig.yaml").unlink()
    (recording / "calib").mkdir()
    f, cx, cy = 1033 * 480 / 1280, 0.51 * 480, 0.49 * 270
    for name, baseline_m in (("000000", 0.205), ("000001", 0.1025)):
        rows = [f"P{i}: {f} 0 {cx} {-f * x} 0 {f} {cy} 0 0 0 1 0\n" for i, x in enumerate((0, 0, 0, baseline_m))]
        (recording / "calib" / f"{name}.txt").write_text("".join(rows) + "R0_rect: 1 0 0 0 1 0 0 0 1\n")
    assert roadblock("detect", recording, "--out", "results").code == 0
    far, near = (r["obstacles"][0]["range_m"] for r in read_results(Path("results/obstacles.jsonl")))
    assert far == pytest.approx(5, abs=0.2)
    assert near == pytest.approx(2.5, abs=0.1)
    rigs = run_record(Path("results"))["rig"]["rigs"]
    assert [rig["T_left_right"][0][3] for rig in rigs] == pytest.approx([0.205, 0.1025])


def test_what_is_wrong_with_frames_is_counted(roadblock, recording: Path) -> None:
    for side in ("left", "right"):
        cv2.imwrite(str(recording / side / "000001.png"), np.full((270, 480, 3), 40, np.uint8))
    ran = roadblock("detect", recording, "--out", "results")
    assert ran.code == 0
    assert "note: no road found (1 of 2 frames)\n" in ran.err
    assert all(line.startswith("note: ") for line in ran.err.splitlines())
    assert [r["health"]["state"] for r in read_results(Path("results/obstacles.jsonl"))] == ["ok", "failed"]


def test_what_a_source_passed_over_is_said(roadblock, recording: Path) -> None:
    av = pytest.importorskip("av")
    sides = [cv2.imread(str(recording / side / "000000.png")) for side in ("left", "right")]
    with av.open("drive.mkv", "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 960, 270, "bgr0"
        for _ in range(8):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(np.hstack(sides), format="bgr24")))
        container.mux(stream.encode())
    data = Path("drive.mkv").read_bytes()
    Path("drive.mkv").write_bytes(data[: len(data) * 3 // 10])
    ran = roadblock("detect", "drive.mkv", "--rig", recording / "rig.yaml", "--out", "results")
    assert ran.code == 0
    assert ran.err.startswith("note: drive.mkv breaks off after 2 whole frames: ")
    assert run_record(Path("results"))["source"]["warnings"] == [ran.err.removeprefix("note: ").rstrip()]


def test_an_error_midway_leaves_whole_lines_and_says_so(roadblock, sequence: Path) -> None:
    (sequence / "right/000002.png").write_bytes(b"")
    ran = roadblock("detect", sequence, "--out", "results")
    assert ran.code == 2
    assert ran.err.startswith("error: recording/right/000002.png is empty")
    assert len(read_results(Path("results/obstacles.jsonl"))) == 2
    run = run_record(Path("results"))
    assert (run["frames_written"], run["interrupted"]) == (2, True)


@pytest.mark.parametrize("where", ["pictures", "results"])
def test_an_interruption_midway_leaves_as_many_lines_as_run_json_says(
    roadblock, sequence: Path, monkeypatch, where: str
) -> None:
    """Whether Ctrl-C comes while a picture is drawn, after its line was written, or before that."""
    sink = VideoSink if where == "pictures" else JsonlSink
    write, left = sink.write, [2]

    def interrupted(self: object, *rest: object) -> None:
        if not left[0]:
            raise KeyboardInterrupt
        left[0] -= 1
        write(self, *rest)

    monkeypatch.setattr(sink, "write", interrupted)
    ran = roadblock("detect", sequence, "--out", "results", "--overlay")
    lines = 3 if where == "pictures" else 2
    assert ran.code == 130
    assert ran.err == f"note: interrupted after {lines} frames; what was written is whole\n"
    assert len(read_results(Path("results/obstacles.jsonl"))) == lines
    run = run_record(Path("results"))
    assert (run["frames_written"], run["interrupted"]) == (lines, True)


def test_a_disk_that_fills_up_ends_the_run_in_one_line(roadblock, sequence: Path, monkeypatch) -> None:
    write, left = JsonlSink.write, [1]

    def full(self: object, result: object) -> None:
        if not left[0]:
            raise OutputError("cannot write results/obstacles.jsonl: No space left on device")
        left[0] -= 1
        write(self, result)

    monkeypatch.setattr(JsonlSink, "write", full)
    ran = roadblock("detect", sequence, "--out", "results")
    assert (ran.code, ran.err) == (2, "error: cannot write results/obstacles.jsonl: No space left on device\n")
    assert run_record(Path("results"))["frames_written"] == 1


def test_help_and_version(roadblock) -> None:
    assert roadblock("--version") == (0, f"roadblock {package.__version__}\n", "")
    for command in ((), ("detect",), ("demo",), ("doctor",), ("rig", "show"), ("rig", "convert")):
        ran = roadblock(*command, "--help")
        assert (ran.code, ran.err) == (0, "")
        assert ran.out.startswith(f"Usage: roadblock {' '.join(command)}".rstrip())


def test_a_video_without_the_video_library_is_one_line(roadblock, work: Path, no_video_library: None) -> None:
    Path("drive.mp4").write_bytes(b"\0")
    ran = roadblock("detect", "drive.mp4", "--out", "results")
    assert ran.code == 2
    assert ran.err.startswith("error: reading a video needs an optional library that is not installed; install it with")
    assert not Path("results").exists()


def test_hostile_names_do_not_steer_the_terminal(roadblock, recording: Path) -> None:
    name = "a\x1b[2Jb\nc"
    for side in ("left", "right"):
        (recording / side / "000000.png").rename(recording / side / f"{name}.png")
    ran = roadblock("detect", recording, "--out", name)
    assert ran.code == 0
    assert ran.out.endswith("results: a?[2Jb?c\n")
    assert len([row for row in table(ran.out) if row[0] == "a?[2Jb?c"]) >= 2
    (recording / "left" / f"{name}.png").write_bytes(b"")
    ran = roadblock("detect", recording)
    assert ran.err.startswith("error: recording/left/a?[2Jb c.png is empty")
    assert "\x1b" not in ran.out + ran.err


def test_names_are_no_markup(roadblock, recording: Path) -> None:
    folder = recording.rename("[bold]drive[ 1]")
    assert roadblock("detect", folder).out.startswith("[bold]drive[ 1]: the nearest obstacles")
    (Path("a[") / "b]").mkdir(parents=True)
    shutil.copy(folder / "rig.yaml", "a[/b]/rig.yaml")
    ran = roadblock("rig", "show", "a[/b]/rig.yaml")
    assert ran.code == 0
    assert ran.out.startswith("a[/b]/rig.yaml")


def test_output_that_goes_to_a_string(work: Path, monkeypatch) -> None:
    """As notebooks and other programs may have it."""
    monkeypatch.setattr(sys, "argv", ["roadblock", "--version"])
    with contextlib.redirect_stdout(io.StringIO()) as printed, pytest.raises(SystemExit):
        main()
    assert printed.getvalue() == f"roadblock {package.__version__}\n"


@pytest.mark.parametrize("command", [["detec"], ["detect"], ["detect", "a", "--fast"], ["demo", "--seed", "-1"]])
def test_usage_errors_exit_with_2_and_no_trace(roadblock, command: list[str]) -> None:
    ran = roadblock(*command)
    assert ran.code == 2
    assert ran.err.startswith("Usage: roadblock")
    assert "Traceback" not in ran.err


def command_line(*arguments: object, **environment: str) -> "subprocess.CompletedProcess[bytes]":
    command = [sys.executable, "-c", COMMAND_LINE, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, env=os.environ | environment, check=False)


def test_as_a_process_of_its_own(recording: Path) -> None:
    ran = command_line("detect", recording, "--out", "results", "--overlay")
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert b" red " in ran.stdout
    assert len(read_results(Path("results/obstacles.jsonl"))) == 2


def test_names_and_terminals_of_any_encoding(recording: Path) -> None:
    """A file name that is no UTF-8, printed where only ASCII can be: what cannot be shown is a question mark."""
    name = os.fsdecode(b"\xff")
    try:
        for side in ("left", "right"):
            (recording / side / "000000.png").rename(recording / side / f"{name}.png")
    except OSError:
        pytest.skip("this file system takes no such names")
    ran = command_line("detect", recording, "--out", f"results{name}", PYTHONIOENCODING="ascii")
    assert (ran.returncode, ran.stderr) == (0, b"")
    assert b"? obstacle" not in ran.stdout
    assert b"5.0" in ran.stdout or b"4.9" in ran.stdout
    assert ran.stdout.endswith(b"results: results?\n")
    ran = command_line("detect", name, PYTHONIOENCODING="ascii")
    assert ran.returncode == 2
    assert ran.stderr.startswith(b"error: there is no '")


def test_a_terminal_shows_how_far_it_is(recording: Path) -> None:
    pty = pytest.importorskip("pty")
    ours, theirs = pty.openpty()
    command = [sys.executable, "-c", COMMAND_LINE, "detect", str(recording)]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "120"}
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs, env=environment) as process:
        os.close(theirs)
        shown = b""
        with contextlib.suppress(OSError):  # the terminal is gone with the process
            while part := os.read(ours, 4096):
                shown += part
    os.close(ours)
    assert process.returncode == 0
    assert b"detecting" in shown
    assert b"2/2" in shown
    assert re.search(rb"\d+ obstacles, nearest \d\.\d m", shown)
