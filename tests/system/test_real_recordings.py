"""The first frames of real recordings through `roadblock detect`, as far as they are there."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.io.results import read_results

FRAMES = 2
LAYOUTS = {
    "kitti2015": (("image_02", "image_03"), ("calib.txt",)),
    "kitti_raw_0926": (("image_00/data", "image_01/data"), ("calib_cam_to_cam*.txt",)),
    "kitti_odometry": (("image_0", "image_1"), ("calib.txt", "poses.txt")),
    "kitti_road": (("image_2", "image_3"), ("calib/*.txt",)),
}
"""Recording -> its image folders, and what else belongs to it."""
SEQUENCES = ("kitti_raw_0926", "kitti_odometry")


def first_frames(source: Path, target: Path) -> Path:
    """Link the first frames of a recording, and its calibration, into a folder of their own."""
    if not source.is_dir():
        pytest.skip(f"no recording at {source}")
    sides, rest = LAYOUTS[source.name]
    images = [path for side in sides for path in sorted((source / side).iterdir())[:FRAMES]]
    for path in [*images, *(path for pattern in rest for path in source.glob(pattern))]:
        link = target / path.relative_to(source)
        link.parent.mkdir(parents=True, exist_ok=True)
        link.symlink_to(path)
    if (stamps := source / "image_00/timestamps.txt").is_file():
        lines = stamps.read_text().splitlines(keepends=True)[:FRAMES]
        (target / "image_00/timestamps.txt").write_text("".join(lines))
    return target


@pytest.mark.parametrize("name", LAYOUTS)
def test_obstacles_are_found_in(name: str, data_dir: Path, work: Path, roadblock) -> None:
    ran = roadblock("detect", first_frames(data_dir / name, work / name), "--out", "results", "--overlay")
    assert (ran.code, ran.err) == (0, "")
    records = read_results(Path("results/obstacles.jsonl"))
    assert len(records) == FRAMES
    for record in records:
        assert record["health"] == {"state": "ok", "reasons": []}
        assert record["obstacles"]
        assert record["ground"]["height_m"] == pytest.approx(1.65, abs=0.2)
        assert abs(record["ground"]["pitch_rad"]) < 0.06
        assert sum(value is not None for value in record["free_space"]["range_m"]) > 50
    run = json.loads(Path("results/run.json").read_text())
    assert run["source"]["is_sequence"] is (name in SEQUENCES)
    pictures = sorted(path.name for path in Path("results").rglob("overlay*"))
    assert pictures == (["overlay.mp4"] if name in SEQUENCES else ["overlay"])
    if name not in SEQUENCES:
        assert [r["t_ns"] for r in records] == [0, 0]
        assert len(list(Path("results/overlay").iterdir())) == FRAMES


def test_a_side_by_side_video_gives_what_its_folder_gives(data_dir: Path, work: Path, roadblock) -> None:
    av = pytest.importorskip("av")
    folder = first_frames(data_dir / "kitti_odometry", work / "kitti_odometry")
    sides = [sorted((folder / side).iterdir()) for side in ("image_0", "image_1")]
    with av.open("drive.mkv", "w") as container:
        stream = container.add_stream("ffv1", rate=10)
        stream.width, stream.height, stream.pix_fmt = 2 * 1241, 376, "gray"
        for pair in zip(*sides, strict=True):
            image = np.hstack([cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in pair])
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="gray")))
        container.mux(stream.encode())
    assert (
        roadblock("rig", "convert", folder / "calib.txt", "rig.yaml", "--size", "1241x376", "--pair", "0,1").code == 0
    )
    assert roadblock("detect", "drive.mkv", "--out", "from-video").code == 0
    assert roadblock("detect", folder, "--out", "from-folder").code == 0
    video, images = (read_results(Path(out, "obstacles.jsonl")) for out in ("from-video", "from-folder"))
    for one, two in zip(video, images, strict=True):
        assert one["t_ns"] == two["t_ns"]
        for what in ("obstacles", "free_space", "ground", "health"):
            assert one[what] == two[what]
