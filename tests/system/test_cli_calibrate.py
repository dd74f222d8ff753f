"""`roadblock calibrate`, from pictures to rig, report and record; a stand-in solves where only the door is tested."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibrated import made_up_calibration
from synthetic import BOARD, crooked_rig

from roadblock.cli import calibrate as module
from roadblock.errors import MissingExtraError, SettingsError
from roadblock.io.rig import read_rig
from roadblock.viz import calibration_report

FILES = {"rig.yaml", "calibration.json", "report.html"}
ASKED = ("--board", "chessboard:7x5", "--square", "25mm")
PROMISED = {"baseline_m", "rms_px", "views_total", "views_used", "left_out", "range_sigma_m", "lens", "verdict"}


def record() -> dict:
    return json.loads(Path("calibration/calibration.json").read_text("utf-8"))


def names(folder: str = "calibration") -> set[str]:
    return {path.name for path in Path(folder).iterdir()}


@pytest.fixture
def shots(work: Path, boards: Path) -> Path:
    """Four sound pairs in `shots/left` and `shots/right`, to be changed at will."""
    for side in ("left", "right"):
        (work / "shots" / side).mkdir(parents=True)
        for number in range(4):
            shutil.copy(boards / side / f"{number:02d}.png", work / "shots" / side)
    return Path("shots")


@pytest.fixture
def made_up(monkeypatch):
    """Let a calibration made by hand come out, and note what the solver was given."""
    given, answer = [], {}

    def stand_in(views, board, size_px, settings, progress):
        given.append((views, board, size_px, settings))
        progress("each camera alone", 0, 6)
        return answer.get("result") or made_up_calibration(verdict=answer.get("verdict", "usable"))

    monkeypatch.setattr(module, "calibrate", stand_in)
    monkeypatch.setattr(calibration_report, "_plot", lambda *_: "")
    return given, answer


def test_from_pictures_to_a_rig(roadblock, work: Path, boards: Path) -> None:
    ran = roadblock("calibrate", boards / "left", boards / "right", *ASKED, "--lens", "brown_conrady5")
    assert ran.code == 0, ran.err
    assert names() == FILES
    rig, true = read_rig("calibration/rig.yaml"), crooked_rig()
    found = record()
    assert set(found) >= PROMISED
    assert (found["views_total"], found["verdict"] in ("good", "usable")) == (14, True)
    assert rig.baseline_m == pytest.approx(found["baseline_m"])
    assert abs(rig.baseline_m - true.baseline_m) < 5 * found["baseline_sigma_m"] + 1e-4
    assert rig.covariance is not None
    for words in ("range error at 20 m", "baseline", "of 14 used", "report: calibration/report.html"):
        assert words in ran.out
    assert "its scale cannot be seen in pictures" in ran.err


def test_one_folder_a_span_and_another_target(roadblock, shots: Path, made_up) -> None:
    for side in ("left", "right"):
        for path in (shots / side).iterdir():
            path.rename(shots / f"{side}{path.name}")
        (shots / side).rmdir()
    (shots / "right03.png").unlink()
    ran = roadblock(
        *("calibrate", "shots", "--board", "chessboard:7x5", "--span", "15cm", "--span-error", "0.3mm"),
        *("-o", "mine/car.yaml", "--lens", "kannala_brandt"),
    )
    assert ran.code == 0, ran.err
    assert names() == FILES - {"rig.yaml"}
    assert read_rig("mine/car.yaml").baseline_m == pytest.approx(made_up_calibration().rig.baseline_m)
    [(views, board, size_px, settings)] = made_up[0]
    assert [view.name for view in views] == [f"left{i:02d}" for i in range(4)]
    assert [view.right is None for view in views] == [i == 3 for i in range(4)]
    assert (board.square_m, board.square_sigma_m) == pytest.approx((0.025, 0.00005))
    assert (size_px, settings.lens) == ((320, 240), "kannala_brandt")
    assert record()["settings"]["span"] == "15cm"
    assert "rig: mine/car.yaml" in ran.out


def test_pictures_without_a_board_count_and_are_named(roadblock, shots: Path, made_up) -> None:
    blank = np.full((240, 320), 90, np.uint8)
    for number in range(14, 22):
        for side in ("left", "right"):
            blank[0, 0] = number + (side == "right")
            cv2.imwrite(str(shots / side / f"{number}.png"), blank)
    ran = roadblock("calibrate", "shots", *ASKED)
    assert ran.code == 0, ran.err
    assert record()["views_total"] == 9 + 8
    assert record()["left_out"][-1] == {"view": "21", "reason": "no board found in it"}
    assert "left out: 4 more, see calibration/calibration.json" in ran.out


@pytest.mark.parametrize("force", [False, True])
def test_a_refused_rig_is_written_by_force_only(roadblock, shots: Path, made_up, force: bool) -> None:
    roadblock("calibrate", "shots", *ASKED)
    assert names() == FILES
    made_up[1]["verdict"] = "refused"
    ran = roadblock("calibrate", "shots", *ASKED, *(["--force"] if force else []))
    assert record()["verdict"] == "refused"
    assert "calibration: refused" in ran.out
    if force:
        assert (ran.code, names()) == (0, FILES)
        rig = read_rig("calibration/rig.yaml")
        assert (rig.verdict, rig.covariance is not None) == ("refused", True)
        assert "REFUSED" in roadblock("rig", "show", "calibration/rig.yaml").out
        assert "REFUSED, written by force" in ran.out
    else:
        assert (ran.code, names()) == (2, FILES - {"rig.yaml"})
        assert ran.err.splitlines()[-1] == (
            "error: refused, no rig written: The range error at 20 m is above 1 %; --force writes it, marked as refused"
        )


def test_a_refused_calibration_leaves_another_rig_alone(roadblock, shots: Path, made_up) -> None:
    Path("car.yaml").write_text("mine")
    made_up[1]["result"] = replace(made_up_calibration(verdict="refused"), reasons=())
    ran = roadblock("calibrate", "shots", *ASKED, "-o", "car.yaml")
    assert (ran.code, Path("car.yaml").read_text()) == (2, "mine")
    assert "the pictures cannot support a rig" in ran.err


def test_what_the_terminal_says(roadblock, shots: Path, made_up) -> None:
    made_up[1]["result"] = made_up_calibration()
    made_up[1]["result"].range_sigma_m[40.0][:] = np.nan
    ran = roadblock("calibrate", "shots", *ASKED)
    text = " ".join(ran.out.split())
    for words in (
        "calibration: usable", "views 8 of 9 used", "brown_conrady5 (fits unseen views best)",
        "baseline 120.054 mm ± 0.100 mm", "out of its plane by 0.10 mm in all", "range error at 5 m ± 0.84 mm",
        "(median over the image; at worst 1.1 mm, RMS 0.85 mm)",
        "range error at 40 m unknown", "The range error at 20 m is above 1 %.",
        "left out: left08: its corners lie 0.37 px off", "next: hold the board at the upper right, 2 m away",
    ):  # fmt: skip
        assert words in text, words


def test_what_is_measured_is_not_asked_for_again(roadblock, shots: Path, made_up) -> None:
    calm = made_up_calibration(square_sigma_m=0.0001)
    coverage = replace(calm.coverage, next_view="")
    bare = replace(calm.rig, covariance=None)
    made_up[1]["result"] = replace(calm, rig=bare, views=calm.views[:-1], coverage=coverage, lens_trials=())
    ran = roadblock("calibrate", "shots", *ASKED)
    assert "scale" not in ran.err
    assert "next:" not in ran.out
    assert "brown_conrady5 (given)" in ran.out
    assert "±" not in next(line for line in ran.out.splitlines() if "baseline" in line)


def test_without_matplotlib_the_rest_is_written(roadblock, shots: Path, made_up, monkeypatch) -> None:
    def missing(*_: object) -> None:
        raise MissingExtraError("drawing the calibration's page", "report")

    roadblock("calibrate", "shots", *ASKED)
    monkeypatch.setattr(module, "write_calibration_page", missing)
    ran = roadblock("calibrate", "shots", *ASKED)
    assert (ran.code, names()) == (0, FILES - {"report.html"})
    assert "pip install 'roadblock[report]'" in ran.err
    assert "report:" not in ran.out


def test_ctrl_c_leaves_nothing(roadblock, shots: Path, monkeypatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "calibrate", interrupted)
    ran = roadblock("calibrate", "shots", *ASKED)
    assert (ran.code, ran.out, ran.err) == (130, "", "note: interrupted; nothing was written\n")
    assert not Path("calibration").exists()


def test_a_real_ctrl_c_while_boards_are_sought(shots: Path) -> None:
    for number in range(4, 400):
        for side in ("left", "right"):
            (shots / side / f"{number:03d}.png").symlink_to((shots / side / f"{number % 4:02d}.png").resolve())
    command = [sys.executable, "-c", "from roadblock.cli import main; main()", "calibrate", "shots", *ASKED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        maps, deadline = Path(f"/proc/{process.pid}/task"), time.monotonic() + 60
        while len(list(maps.iterdir())) < 3 + (os.cpu_count() or 1):  # until its threads look for boards
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(0.3)
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err.decode()) == (130, b"", "note: interrupted; nothing was written\n")
    assert not Path("calibration").exists()


def test_a_video_gives_still_and_different_views(roadblock, shots: Path, made_up) -> None:
    av = pytest.importorskip("av")
    for side, frames in (("left", 17), ("right", 16)):
        with av.open(f"{side}.mkv", "w") as container:
            stream = container.add_stream("ffv1", rate=30)
            stream.width, stream.height, stream.pix_fmt = 320, 240, "gray"
            for index in range(frames):
                image = cv2.imread(f"shots/{side}/{min(index // 4, 3):02d}.png", 0)
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
            container.mux(stream.encode())
    ran = roadblock("calibrate", "left.mkv", "right.mkv", *ASKED)
    assert ran.code == 0, ran.err
    [(views, *_)] = made_up[0]
    assert len(views) == 4
    assert record()["source"]["right"] == "right.mkv"
    assert "note: left out 1 left and 0 right frames that have no partner in time" in ran.err
    assert "of 16 frames with a board 4 are used: 0 show it moving, 12 where another one shows it already" in ran.err


def test_the_same_views_in_the_same_order_whatever_the_threads(shots: Path) -> None:
    images = module.open_board_images(str(shots))
    found = [[view.name for _, view in module.in_threads(images, BOARD)] for _ in range(2)]
    assert found[0] == found[1] == [f"{i:02d}" for i in range(4)]


@pytest.mark.parametrize(
    ("square", "span", "error", "expected"),
    [
        ("25mm", None, "0.5mm", (0.025, np.nan)),
        (None, "150mm", "0.6mm", (0.025, 0.0001)),
        ("1in", "15.1 cm", "0.5mm", (0.151 / 6, 0.0005 / 6)),
    ],
)
def test_lengths(square, span, error, expected) -> None:
    board = module.measured_board("chessboard:7x5", square, span, error)
    np.testing.assert_allclose((board.square_m, board.square_sigma_m), expected, rtol=1e-12)


def test_the_span_of_circles_counts_their_steps() -> None:
    # 4x11: 4 dots in a row, 2 steps apart, every other row shifted by one: 7 steps wide, 10 high.
    board = module.measured_board("circles:4x11", None, "200mm", "1mm")
    assert (board.square_m, board.square_sigma_m) == pytest.approx((0.02, 0.0001))


@pytest.mark.parametrize("text", ["25", " .5 ", "mm", "", "25parsec", "0mm", "-3mm"])
def test_lengths_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError):
        module.parse_length("--square", text)


REAL = {
    "bumblebee2": ("chessboard:4x6", "30mm"),
    "opencv": ("chessboard:9x6", "25mm"),
}
"""`benchmarks/accuracy/calibration.py --part real` has the 29 pairs of `webcams` too, which take a minute."""


@pytest.mark.parametrize("name", REAL)
def test_real_sets(roadblock, work: Path, data_dir: Path, name: str) -> None:
    """Nobody said how large the squares of `opencv` are: its published baseline is 3.343 of them."""
    folder = data_dir / "calibration" / name
    board, square = REAL[name]
    ran = roadblock("calibrate", f"{folder}/left*.jpg", f"{folder}/right*.jpg", "--board", board, "--square", square)
    assert ran.code == 0, ran.err
    found = record()
    if name == "bumblebee2":
        assert found["baseline_m"] == pytest.approx(0.12004, rel=0.005)
    else:
        assert found["baseline_m"] == pytest.approx(3.343 * 0.025, rel=0.015)
