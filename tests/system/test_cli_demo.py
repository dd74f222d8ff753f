"""`roadblock demo`: a street with known distances, no data needed."""

import json
import sys
from pathlib import Path

import cv2
import pytest
from synthetic import paper_rig_of_width

from roadblock.cli.demo import overlap
from roadblock.config import load_settings
from roadblock.io.results import JsonlSink, read_results
from roadblock.io.rig import read_rig
from roadblock.sim.scene import paper_rig
from roadblock.values.scene import Obstacle

MODULE = sys.modules["roadblock.cli.demo"]
"""`roadblock.cli.demo` itself is the command."""
NAMED = ["red box", "blue person", "yellow box", "green person", "orange box", "white person"]


def rows_of(printed: str) -> dict[str, list[str]]:
    """Name -> words of its row in the last table."""
    table = printed[printed.index("truth beside measurement") :]
    lines = [line.split() for line in table.splitlines()]
    return {" ".join(words[:2]): words[2:] for words in lines if " ".join(words[:2]) in NAMED}


@pytest.fixture
def small_demo(monkeypatch: pytest.MonkeyPatch, work: Path) -> None:
    """The demo in small pictures."""
    monkeypatch.setattr(MODULE, "paper_rig", lambda: paper_rig_of_width(480))


def test_the_demo_finds_everything_and_shows_it(roadblock, work: Path) -> None:
    ran = roadblock("demo", "--out", "street")
    assert ran.code == 0
    assert ran.err == ""
    rows = rows_of(ran.out)
    assert set(rows) == set(NAMED)
    for name, (true, measured, sign, sigma, error, *sizes) in rows.items():
        assert sign == "±"
        assert float(error) == pytest.approx(float(measured) - float(true), abs=0.011), name
        assert abs(float(error)) < 3 * float(sigma), name
        assert abs(float(error)) < 0.05 * float(true), name
        assert sizes[1] == sizes[4] == "x"
    assert [float(row[0]) for row in rows.values()] == sorted(float(row[0]) for row in rows.values())
    assert ran.out.endswith("picture: street/results/overlay/000000.png\n")

    recording = Path("street/recording")
    assert {path.name for path in recording.iterdir()} == {"left", "right", "rig.yaml", "truth.jsonl"}
    assert cv2.imread(str(recording / "left/000000.png")).shape == (720, 1280, 3)
    assert read_rig(recording / "rig.yaml").baseline_m == paper_rig().baseline_m
    truth = json.loads((recording / "truth.jsonl").read_text())
    assert [f"{o['color']} {o['type']}" for o in truth["objects"]] == NAMED
    (record,) = read_results(Path("street/results/obstacles.jsonl"))
    assert record["health"]["state"] == "ok"
    assert cv2.imread("street/results/overlay/000000.png").shape[1] > 1280


def test_the_same_seed_gives_the_same_bytes(roadblock, small_demo: None) -> None:
    for out, seed in (("a", 5), ("b", 5), ("c", 6)):
        assert roadblock("demo", "--out", out, "--seed", seed).code == 0

    def made(out: str) -> tuple[object, ...]:
        images = [path.read_bytes() for path in sorted(Path(out, "recording").rglob("*.png"))]
        (record,) = read_results(Path(out, "results/obstacles.jsonl"))
        return images, record["obstacles"], record["free_space"], Path(out, "recording/truth.jsonl").read_text()

    assert made("a") == made("b")
    assert all(one != other for one, other in zip(made("a")[:3], made("c")[:3], strict=True))
    one, other = (cv2.imread(f"{out}/recording/left/000000.png").astype(int) for out in "ac")
    assert abs(one - other).mean() > 4  # other textures, not only other noise


def test_the_default_folder_and_another_run_in_it(roadblock, small_demo: None) -> None:
    for seed in (1, 2):
        assert roadblock("demo", "--seed", seed).code == 0
    assert Path("roadblock-demo/results/overlay/000000.png").is_file()
    assert len(list(Path("roadblock-demo/recording/left").iterdir())) == 1


def test_what_the_detector_misses_is_said(roadblock, small_demo: None, monkeypatch) -> None:
    monkeypatch.setattr(MODULE, "overlap", lambda found, true: 0.9 if true.color == "red" else 0.29)
    rows = rows_of(roadblock("demo").out)
    assert len(rows["red box"]) > 5
    assert all(rows[name][1:] == ["missed"] for name in NAMED[1:])


def test_nothing_found_is_said_too(roadblock, small_demo: None, monkeypatch) -> None:
    monkeypatch.setattr(MODULE, "Settings", lambda: load_settings(None, ["segment.reach_m=0.5"]))
    ran = roadblock("demo")
    assert ran.code == 0
    assert "no obstacles in 1 frame" in ran.out
    assert all(row[1:] == ["missed"] for row in rows_of(ran.out).values())


def test_overlap_is_intersection_over_union() -> None:
    def box(*edges: int) -> Obstacle:
        obstacle = object.__new__(Obstacle)
        object.__setattr__(obstacle, "box_px", edges)
        return obstacle

    one = box(0, 0, 40, 20)
    assert overlap(one, one) == 1  # type: ignore[arg-type]
    assert overlap(one, box(20, 10, 60, 30)) == pytest.approx(200 / 1400)  # type: ignore[arg-type]
    assert overlap(one, box(40, 0, 50, 20)) == 0  # type: ignore[arg-type]


def test_a_recording_that_cannot_be_written_is_one_line(roadblock, small_demo: None) -> None:
    Path("out").mkdir()
    Path("out/recording").write_text("mine")
    ran = roadblock("demo", "--out", "out")
    assert ran.code == 2
    assert ran.err.startswith("error: cannot write out/recording: ")
    assert ran.err.endswith("; choose another with --out\n")
    assert Path("out/recording").read_text() == "mine"


def test_an_interrupted_demo_compares_nothing(roadblock, small_demo: None, monkeypatch) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(JsonlSink, "write", interrupted)
    ran = roadblock("demo")
    assert ran.code == 130
    assert "truth beside measurement" not in ran.out


@pytest.mark.parametrize("seed", ["-1", "1000000", "99999999999999999999", "x"])
def test_seeds_the_world_has_no_street_for(roadblock, work: Path, seed: str) -> None:
    ran = roadblock("demo", "--seed", seed)
    assert ran.code == 2
    assert "Traceback" not in ran.err
    assert list(work.iterdir()) == []
