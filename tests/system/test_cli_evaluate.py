"""`roadblock evaluate` on a tiny simulated drive, from its pictures to its page."""

import json
from pathlib import Path

import pytest

from roadblock.cli import evaluate as command
from roadblock.errors import MissingExtraError

PROMISED = {
    "schema", "version", "commit", "machine", "results", "truth", "truth_kind", "offset_px", "frames", "things",
    "tracks", "maps",
}  # fmt: skip
SECTIONS = {
    "things": {"recall", "precision", "confusion", "sizes", "kitti_ap", "distance_ap", "readings"},
    "tracks": {"scores", "scores_place", "velocity", "ttc", "warnings"},
    "maps": {
        "frames", "duplicates", "merging_obstacles", "things", "readings", "precision", "free_space", "ground",
    },
}  # fmt: skip


@pytest.fixture
def drive(work: Path, street: Path, roadblock) -> Path:
    asked = ("--frames", 3, "--quality", "preview", "--rig", street / "rig.yaml", "--maps", "--out", "drive")
    assert roadblock("simulate", "demo", *asked).code == 0
    return Path("drive")


def test_a_drive_is_judged_by_all_that_is_known_of_it(drive: Path, roadblock, monkeypatch) -> None:
    assert roadblock("detect", drive, "--out", "found").code == 0
    ran = roadblock("evaluate", "found", "--truth", drive, "--out", "judged")
    assert (ran.code, ran.err) == (0, "")
    assert {"named things", "precision", "average precision", "tracks", "free space"} <= {
        line.partition(":")[0].partition(" (")[0].partition(",")[0].strip() for line in ran.out.splitlines()
    }
    result = json.loads(Path("judged/evaluation.json").read_text())
    assert set(result) == PROMISED
    assert {name: set(result[name]) for name in SECTIONS} == SECTIONS
    assert result["frames"] == {"judged": 3, "missing": 0, "without_truth": 0}
    everything = next(r for r in result["things"]["recall"] if (r["type"], r["to_m"]) == ("any", 60))
    true = [json.loads(line)["objects"] for line in (drive / "truth.jsonl").read_text().splitlines()]
    assert everything["n"] == sum(thing["visible_px"] >= 400 for things in true for thing in things) > 10
    assert everything["recall"] > 0.6
    assert everything["median_abs_m"] < 0.5
    assert result["tracks"]["scores"]["switches"] == 0
    assert result["tracks"]["warnings"]["false_per_km"] is None
    assert result["maps"]["ground"]["height_m_worst"] < 0.05
    page = Path("judged/evaluation.html").read_text()
    assert page.count("<svg") == 5  # named things: three with the confusion; true depths: two
    assert "http" not in page.replace("http://www.w3.org", "")

    def missing(*_: object) -> None:
        raise MissingExtraError("drawing", "report")

    monkeypatch.setattr(command, "write_evaluation_page", missing)
    lines = (drive / "truth.jsonl").read_text().splitlines()
    (drive / "truth.jsonl").write_text("\n".join([lines[0], lines[1].replace("000001", "000009")]) + "\n")
    found = Path("found/obstacles.jsonl")
    found.write_text(found.read_text().replace('"class":"unknown"', '"class":"person"'))
    turned = (drive / "rig.yaml").read_text().replace("fy_px: 387", "fy_px: 388")
    assert turned.count("388") == 2
    (drive / "rig.yaml").write_text(turned)
    for folder in ("disparity", "ids"):
        (drive / folder).rename(f"not_{folder}")
    ran = roadblock("evaluate", "found/obstacles.jsonl", "--truth", drive, "--out", "again")
    assert ran.code == 0
    assert [line.removeprefix("note: ") for line in ran.err.splitlines()] == [
        "without results, so counted as empty: 1 frame of 2",
        "without truth, so not judged: 2 frames of the results",
        "the drive's images are not rectified: true boxes are in the raw left image, found ones in the rectified one, "
        "so that they overlap less than they should",
        "drawing needs an optional library that is not installed; install it with: pip install 'roadblock[report]'",
    ]
    assert "called: 0." in ran.out
    assert json.loads(Path("again/evaluation.json").read_text())["maps"] is None
