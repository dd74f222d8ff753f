"""Ctrl-C and kill -9 while `roadblock detect` runs: whole lines and a video that plays."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from roadblock.io.results import read_results

FRAMES = 400
"""Far more than are detected before the signal comes."""


@pytest.fixture
def long_list(street: Path, work: Path) -> Path:
    """A long sequence: one pair again and again, 0.1 s apart."""
    pair = [street / side / "000000.png" for side in ("left", "right")]
    path = work / "long.txt"
    path.write_text("".join(f"{pair[0]} {pair[1]} {100_000_000 * i}\n" for i in range(FRAMES)))
    return path


def stopped_by(what: signal.Signals, spec: Path, rig: Path) -> "subprocess.CompletedProcess[bytes]":
    """Run `detect` on a sequence, and send a signal when a few frames are done."""
    command = [sys.executable, "-c", "from roadblock.cli import main; main()", "detect", str(spec)]
    command += ["--rig", str(rig), "--out", "results", "--overlay"]
    results = Path("results/obstacles.jsonl")
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        deadline = time.monotonic() + 60
        while not results.exists() or results.read_bytes().count(b"\n") < 4:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.01)
        os.kill(process.pid, what)
        out, err = process.communicate(timeout=30)
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def played_frames(video: Path) -> int:
    av = pytest.importorskip("av")
    with av.open(str(video)) as container:
        return sum(1 for _ in container.decode(video=0))


def test_ctrl_c_leaves_whole_lines_and_says_how_many(long_list: Path, street: Path) -> None:
    ended = stopped_by(signal.SIGINT, long_list, street / "rig.yaml")
    assert ended.returncode == 130
    records = read_results(Path("results/obstacles.jsonl"))
    run = json.loads(Path("results/run.json").read_text())
    assert 4 <= len(records) == run["frames_written"] < FRAMES
    assert run["interrupted"] is True
    assert run["source"]["frames"] == FRAMES
    assert len(records) - 1 <= played_frames(Path("results/overlay.mp4")) <= len(records)
    assert ended.stderr.decode() == f"note: interrupted after {len(records)} frames; what was written is whole\n"
    assert b"in the last frame" in ended.stdout
    assert {path.name for path in Path("results").iterdir()} == {"obstacles.jsonl", "run.json", "overlay.mp4"}


def test_a_kill_leaves_whole_lines_and_a_video_that_plays(long_list: Path, street: Path) -> None:
    ended = stopped_by(signal.SIGKILL, long_list, street / "rig.yaml")
    assert ended.returncode == -signal.SIGKILL
    records = read_results(Path("results/obstacles.jsonl"))
    assert 4 <= len(records) < FRAMES
    assert len(records) - 2 <= played_frames(Path("results/overlay.mp4")) <= len(records)
    assert not Path("results/run.json").exists()
