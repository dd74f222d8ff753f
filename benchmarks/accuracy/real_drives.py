"""Judge tracks and ego-motion on real drives: `python benchmarks/accuracy/real_drives.py [DATA] [--dry]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds kitti_odometry, whose poses are the truth of the ego-motion, and
kitti_raw_0926, on which nothing but the vehicle moves. Where its parked cars stand was looked up in the pictures; a
track is of a car if its place is that of the car.
"""

import os
import sys
from collections import Counter, defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import Settings, make_settings
from roadblock.geometry.pose import inverse, transform, vehicle_from_car
from roadblock.io.sources import open_source
from roadblock.pipeline import Pipeline

PARKED_M = {
    "trailer, left": (16.3, 3.5),
    "third car, right": (17.1, -1.8),
    "second car, left": (20.5, 2.9),
    "third car, left": (41.7, 3.6),
    "fourth car, right": (47.6, -1.9),
    "fifth car, right, never nearer than 25 m": (55.8, -1.4),
    "fourth car, left, never nearer than 25 m": (58.9, 3.9),
}
"""x and y of what is nearest of them, in the vehicle frame of the first picture."""
ALONG_M, ASIDE_M = 2.5, 1.5
"""A track this near to a car is of it."""
LEAST = 5
"""Tracks of fewer measurements are not judged."""
SETTLED_S = 1.0
"""Speeds are judged from this age on."""
START_NS = 10**9
"""Before the first frame of a recording that begins at 0, which stands for no time known."""


def ego_rows(folder: Path, source: str) -> list[list[str]]:
    """Compare the motion of kitti_odometry, by its images or its own record, with its poses."""
    recording = open_source(folder)
    pipeline = Pipeline(recording.rig, make_settings({"egomotion": {"source": source}}))
    half = np.eye(4)
    half[0, 3] = recording.rig.baseline_m / 2
    T, truth, off, way_m = np.eye(4), [], [], 0.0
    for pair in recording:
        result, _ = pipeline.step(replace(pair, t_ns=pair.t_ns + START_NS))
        assert pair.T_odom_left is not None
        truth.append(pair.T_odom_left @ half)
        if result.ego is not None:
            assert result.ego.T_now_before is not None, result.ego.reason
            T = T @ inverse(result.ego.T_now_before)
            step = inverse(truth[-2]) @ truth[-1]
            way_m += float(np.linalg.norm(step[:3, 3]))
            off.append(np.linalg.norm((step @ result.ego.T_now_before)[:3, 3]) / np.linalg.norm(step[:3, 3]))
    end = float(np.linalg.norm((inverse(truth[0]) @ truth[-1])[:3, 3] - T[:3, 3])) / way_m
    what = f"kitti_odometry, by {source}"
    return [
        [
            what,
            f"translation error at the end of {way_m:.1f} m",
            f"{end:.2%}",
            "<= 1.5 %" if source == "images" else "0",
        ],
        [what, "from frame to frame, median", f"{np.median(off):.2%}", ""],
    ]


def parked_rows(folder: Path) -> list[list[str]]:
    """Return how fast the parked cars of kitti_raw_0926 seem, and how many numbers each has."""
    recording = open_source(folder)
    pipeline, T = Pipeline(recording.rig, Settings()), np.eye(4)
    A = vehicle_from_car(recording.rig.T_vehicle_car)
    seen: dict[int, list[tuple[np.ndarray, float, float]]] = defaultdict(list)
    motions: Counter[str] = Counter()
    for pair in recording:
        result, _ = pipeline.step(pair)
        if result.ego is not None and result.ego.T_now_before is not None:
            T = T @ inverse(A @ result.ego.T_now_before @ inverse(A))
        for o in result.obstacles:
            if o.track is None or o.track.coasted_s:
                continue
            motions[o.track.motion] += 1
            speed_mps = float(np.hypot(*o.track.velocity_mps)) if o.track.is_over_ground else np.nan
            seen[o.track.id].append((transform(T, o.position_m), o.track.age_s, speed_mps))
    rows, used = [], []
    for name, (x_m, y_m) in PARKED_M.items():
        mine = []
        for states in seen.values():
            x, y = np.median([place[:2] for place, *_ in states], 0)
            if len(states) >= LEAST and abs(x - x_m) <= ALONG_M and abs(y - y_m) <= ASIDE_M:
                mine.append(states)
        longest = max(mine, key=len)
        speeds = [speed for _, age_s, speed in longest if age_s >= SETTLED_S]
        used.append(float(np.median(speeds)))
        figure = f"{used[-1]:.2f} m/s; {len(mine)} ({' + '.join(str(len(m)) for m in mine)} frames)"
        rows.append(["kitti_raw_0926", f"{name}: median speed; numbers", figure, "<= .5; 1"])
    rows.append(["kitti_raw_0926", "parked cars: median of their speeds", f"{np.median(used):.2f} m/s", "<= .5"])
    total = motions.total()
    told = ", ".join(f"{name} {n / total:.0%}" for name, n in motions.most_common())
    rows.append(["kitti_raw_0926", f"of {total} measurements with a track, {len(seen)} tracks", told, "0 % moving"])
    return rows


def main() -> None:
    """Run all, print, save."""
    given = [a for a in sys.argv[1:2] if not a.startswith("--")]
    data = Path(given[0] if given else os.environ.get("ROADBLOCK_DATA", "../shared/data")).resolve()
    rows = [row for source in ("images", "recording") for row in ego_rows(data / "kitti_odometry", source)]
    rows += parked_rows(data / "kitti_raw_0926")
    for row in rows:
        print(*(f"{cell:60}" for cell in row))
    if "--dry" not in sys.argv:
        save(
            "real_drives",
            "python benchmarks/accuracy/real_drives.py",
            ["recording", "figure", "measured", "bar"],
            rows,
            "Default settings. Speeds of tracks of at least one second.",
        )


if __name__ == "__main__":
    main()
