"""Whether the nearest obstacle is there again in the next frame: `python benchmarks/accuracy/flicker.py [DATA]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds kitti_raw_0926 and kitti_odometry. Of each frame the nearest
obstacle within 40 m counts that does not touch the sides of the view, where it may leave it. It is there again if an
obstacle of the next frame covers 0.3 of the smaller box, at a range that differs by less than 15 % and 1.5 m.
"""

import os
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import load_settings
from roadblock.geometry.boxes import shared_px2
from roadblock.io.sources import open_source
from roadblock.pipeline import Pipeline
from roadblock.values.scene import FrameResult, Obstacle

REACH_M, LEFT_PX, RIGHT_PX = 40.0, 40, 8
"""Matching leaves a border at the left."""
RECORDINGS, SEARCHES = ("kitti_odometry", "kitti_raw_0926"), (128, 256)


def same(a: Obstacle, b: Obstacle) -> bool:
    """Whether two obstacles of successive frames may be one."""
    boxes = np.array([a.box_px, b.box_px], float)
    smaller = np.prod(boxes[:, 2:] - boxes[:, :2], axis=1).min()
    shared = shared_px2(boxes[:1], boxes[1:])[0, 0]
    return bool(shared > 0.3 * smaller and abs(a.range_m - b.range_m) < 0.15 * a.range_m + 1.5)


def losses(frames: list[FrameResult], width_px: int) -> tuple[int, list[float]]:
    """Return how many nearest obstacles were judged, and the ranges of those that were lost."""
    judged, lost = 0, []
    for now, then in pairwise(frames):
        inside = [
            o
            for o in now.obstacles
            if o.range_m < REACH_M and o.box_px[0] > LEFT_PX and o.box_px[2] < width_px - RIGHT_PX
        ]
        if inside:
            judged += 1
            lost += [] if any(same(inside[0], other) for other in then.obstacles) else [inside[0].range_m]
    return judged, lost


def main() -> None:
    """Measure, print, save."""
    data = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("ROADBLOCK_DATA", "../shared/data"))
    rows = []
    for name in RECORDINGS:
        for disparities in SEARCHES:
            source = open_source(str(data / name))
            pipeline = Pipeline(source.rig, load_settings(None, [f"cells.disparities={disparities}"]))
            frames = [pipeline.step(pair)[0] for pair in source]
            judged, lost = losses(frames, pipeline.rectification.size_px[0])
            where = ", ".join(f"{range_m:.1f} m" for range_m in sorted(lost))
            rows.append([name, disparities, f"{judged - len(lost)} of {judged}", where])
            print(rows[-1])
    columns = ["recording", "disparities", "there again", "lost at"]
    save("flicker", "python benchmarks/accuracy/flicker.py DATA", columns, rows, "Bar: 99 %.")


if __name__ == "__main__":
    main()
