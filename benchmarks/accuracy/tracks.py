"""Tracks on rendered drives with exact truth: `python benchmarks/accuracy/tracks.py DRIVES [--scenes parked ...]`.

Renders what is missing in the folder DRIVES (30 pairs at 10 Hz each, the paper's rig), takes each drive
through the pipeline with all its frames, and once more without three frames in ten, and judges what comes out as
`roadblock evaluate` does. Tracks of what has no name in the truth (houses, trees) are not judged.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import Settings
from roadblock.eval.motion import seen_frame, ttc_rows, velocity_rows
from roadblock.eval.things import judge_frame
from roadblock.eval.tracks import judge_tracks
from roadblock.io.results import frame_record
from roadblock.io.rig import write_rig
from roadblock.io.sources import open_source
from roadblock.io.truth import read_truth
from roadblock.pipeline import Pipeline
from roadblock.sim.conditions import combined
from roadblock.sim.drive import DriveSettings, simulate
from roadblock.sim.scene import paper_rig
from roadblock.sim.scenes import SCENES

KEPT = 0.7
"""Of the frames in the second run."""
APART = 10_000
"""Numbers of one drive's things and tracks, so that drives can be judged together."""

Pair = tuple[dict, dict]
"""What was found in a frame, and what is true."""


def render(scene: str, seed: int, folder: Path) -> Path:
    """Record a drive, if it is not there, and return where it is."""
    out, world = folder / f"{scene}_{seed}", SCENES[scene](seed)
    for _ in simulate(world, paper_rig(), DriveSettings(seed=seed, effects=combined(world.conditions)), out):
        pass
    write_rig(paper_rig(), out / "rig.yaml")
    return out


def follow(drive: Path, keep: float) -> tuple[list[Pair], list[tuple[float, float]]]:
    """Return the frames, and (error, sigma) of the own speed where it is known."""
    source, truth, rng = open_source(drive), read_truth(drive), np.random.default_rng(0)
    pipeline, pairs, speeds = Pipeline(source.rig, Settings()), [], []
    for pair, true in zip(source, truth.frames, strict=True):
        if pair.index and rng.random() > keep:
            continue
        # a drive begins at 0, which stands for "no time known"
        result, _ = pipeline.step(replace(pair, t_ns=pair.t_ns + 10**9))
        pairs.append((frame_record(result), true))
        ego = result.ego
        if ego is not None and ego.T_now_before is not None:
            dt_s = (ego.t_ns - ego.before_t_ns) / 1e9
            error_mps = -ego.T_now_before[2, 3] / dt_s - true["ego"]["speed_mps"]
            speeds.append((error_mps, float(np.sqrt(ego.cov[5, 5])) / dt_s))
    return pairs, speeds


def judge(name: str, drives: Sequence[list[Pair]]) -> list[list[str]]:
    """Return the rows of some drives together."""
    pairs = [(f, t) for drive in drives for f, t in drive]
    judged = [judge_frame(f["obstacles"], t["objects"]) for f, t in pairs]
    rows = []
    for by_place in (False, True):
        seen = []
        for k, drive in enumerate(drives):
            for f, t in drive:
                frame = seen_frame(f["obstacles"], t["objects"], by_place)
                numbers = {"true_ids": frame.true_ids + k * APART, "track_ids": frame.track_ids + k * APART}
                seen.append(replace(frame, **numbers))
        s = judge_tracks(seen)
        by, things = "by place" if by_place else "by box", sum(len(f.true_ids) for f in seen)
        parts = f"{s.hota:.2f} = {s.deta:.2f} / {s.assa:.2f} / {s.loca:.2f}"
        rows += [
            [name, f"{by}: HOTA = DetA / AssA / LocA", parts, "HOTA >= .85"],
            [name, f"{by}: IDF1; MOTA", f"{s.idf1:.2f}; {s.mota:.2f}", "IDF1 >= .95"],
            [name, f"{by}: switches; missed, false, of things", f"{s.switches}; {s.missed}, {s.false}, {things}", "0"],
        ]
    for row in velocity_rows(judged):
        if row["to_m"] == 20:
            figure = f"{row['rms_mps']:.2f} ({row['median_mps']:.2f}) m/s, {row['told_right']:.0%}, n {row['n']}"
            rows.append(
                [name, f"{row['motion']}, to 20 m: velocity error rms (median), told right", figure, "<= .3 m/s"]
            )
            rows.append([name, f"{row['motion']}, to 20 m: error^2 / variance", f"{row['normalized']:.1f}", "1"])
    for row in ttc_rows(judged, [t["ego"] for _, t in pairs]):
        if row["from_s"] == 1.5 and row["median"] is not None:
            figure = f"{row['median']:.3f} ({row['unknown']:.0%} unknown), n {row['n']}"
            rows.append([name, "time to contact at 1.5 to 2.5 s: median |error| / true", figure, "<= .05"])
    return rows


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("drives", type=Path)
    parser.add_argument("--scenes", nargs="+", default=["parked", "crossing", "city", "country", "curve"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[3])
    parser.add_argument("--dry", action="store_true", help="save nothing")
    options = parser.parse_args()
    whole: dict[str, list[list[Pair]]] = {scene: [] for scene in options.scenes}
    thinned, speeds = [], []
    for scene in options.scenes:
        for seed in options.seeds:
            drive = render(scene, seed, options.drives)
            pairs, more = follow(drive, 1.0)
            whole[scene].append(pairs)
            speeds += more
            thinned.append(follow(drive, KEPT)[0])
            print(drive)
    drives = [drive for group in whole.values() for drive in group]
    rows = judge("all", drives)
    e, sigma = np.array(speeds).T
    frames = sum(map(len, drives))
    figure = f"{np.sqrt((e**2).mean()):.3f} m/s; {np.mean((e / sigma) ** 2):.1f}; {len(e)} of {frames - len(drives)}"
    rows.append(["all", "own speed: error rms; error^2 / variance; known", figure, ""])
    rows += judge("all, 30 % of the frames dropped", thinned)
    for scene, group in whole.items():
        rows += judge(scene, group)[:6]  # scores alone
    for row in rows:
        print(*(f"{cell:62}" for cell in row))
    if not options.dry:
        seeds = ", ".join(map(str, options.seeds))
        notes = f"Rendered drives of 3 s each, {', '.join(options.scenes)}; seed {seeds}; {frames} frames."
        save(
            "tracks", "python benchmarks/accuracy/tracks.py DRIVES", ["drive", "figure", "measured", "bar"], rows, notes
        )


if __name__ == "__main__":
    main()
