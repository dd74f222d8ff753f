"""Tracks on rendered drives with exact truth: `python benchmarks/accuracy/tracks.py DRIVES [--scenes parked ...]`.

Renders what is missing in the folder DRIVES (30 pairs at 10 Hz each, the paper's rig), takes each drive through the
pipeline with all its frames, and judges what comes out as `roadblock evaluate` does; beside it what could be had with
perfect identities, and why things are missed. Then once more without three frames in ten, with one in ten twice, and
with one in ten late. In two drives more, somebody is hidden for half a second. Tracks of what has no name in the truth
(houses, trees) are not judged. Beside it what the tracker makes of the same drives if each thing that counts is found
for itself in 19 frames of 20, with the noise of a good measurement: what is missing then is not for want of detection.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from pathlib import Path

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.stats import chi2

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import Settings
from roadblock.eval.match import boxes_of, overlaps
from roadblock.eval.motion import MOVES_MPS, STRUCTURES, seen_frame, true_velocity_mps, ttc_rows, velocity_rows
from roadblock.eval.things import counts, is_at_depth, judge_frame, share_inside
from roadblock.eval.tracks import TrackScores, judge_tracks
from roadblock.io.results import frame_record
from roadblock.io.rig import write_rig
from roadblock.io.sources import open_source
from roadblock.io.truth import read_truth
from roadblock.pipeline import Pipeline
from roadblock.sim.conditions import combined
from roadblock.sim.drive import DriveSettings, simulate
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose, paper_rig, roadside
from roadblock.sim.scenes import LEFTWARDS, SCENES, Stand, furnished
from roadblock.sim.things import Order
from roadblock.stages.rectify import plan_rectification
from roadblock.stages.track import Tracker
from roadblock.values.camera import Rectification
from roadblock.values.scene import FrameResult, Obstacle

KEPT, TWICE, LATE = 0.7, 0.1, 0.1
"""Shares of the frames that are left, come twice, and come after the next one, each in a run of its own."""
SETTLED_S = 1.0
"""States are judged from this age on."""
FOUND, EDGE_PX, DISPARITY_PX = 0.95, 1.5, 0.12
"""How often what is given is found, and how far off the sides of its box and its disparity are."""
PART = 0.2
"""A track is of a mover if so much of one box lies in the other."""
APART = 10_000
"""Numbers of one drive's things and tracks, so that drives can be judged together."""

Pair = tuple[dict, dict]
"""What was found in a frame, and what is true."""


@dataclass
class Followed:
    """What became of a drive.

    Attributes
    ----------
    pairs
        Its frames in order.
    results
        What the pipeline said of each frame that was later than all before.
    untracked
        The same, of the detections before they were tracked.
    speeds
        (error, sigma) of the own speed where it is known.
    states
        By thing and number of the track, the latest normalised squared errors of the forward distance (1 number) and of
        the velocity (2 numbers).
    told
        How many measurements with a track there are, by whether the thing moves and by what is told.
    """

    pairs: list[Pair] = field(default_factory=list)
    results: list[FrameResult] = field(default_factory=list)
    untracked: list[Pair] = field(default_factory=list)
    speeds: list[tuple[float, float]] = field(default_factory=list)
    states: dict[tuple[int, int], tuple[float, float]] = field(default_factory=dict)
    told: Counter[tuple[bool, str]] = field(default_factory=Counter)


def behind_a_crate(seed: int) -> Scene:
    """Return a street on which a person walks behind a crate, and is hidden for half a second."""
    crate = Stand(Order("box", 0, "crate", length_m=0.4, width_m=0.92, height_m=2.2), 11.0, 0.5)
    walker = Stand(Order("person", 0, walking=True), 16.0, -1.45, LEFTWARDS, 1.5)
    return quiet_street(seed, crate, walker)


def behind_a_van(seed: int) -> Scene:
    """Return a street on which a cyclist crosses behind a van, and is hidden for half a second."""
    return quiet_street(seed, Stand(Order("van", 0), 11.0, 1.5), Stand(Order("cyclist", 0), 16.5, -2.0, LEFTWARDS, 3.0))


def quiet_street(seed: int, *stands: Stand) -> Scene:
    """Return a street with nothing but some things; the vehicle goes at 2 m/s."""
    road = Road()
    scenery = roadside(np.random.default_rng(seed))
    return Scene(furnished(road, stands, seed) + scenery, road, camera_pose(), seed=seed, speed_mps=2.0)


HIDING = {"behind_a_crate": behind_a_crate, "behind_a_van": behind_a_van}


def render(scene: str, seed: int, folder: Path) -> Path:
    """Record a drive, if it is not there, and return where it is."""
    out, world = folder / f"{scene}_{seed}", (SCENES | HIDING)[scene](seed)
    for _ in simulate(world, paper_rig(), DriveSettings(seed=seed, effects=combined(world.conditions)), out):
        pass
    write_rig(paper_rig(), out / "rig.yaml")
    return out


def follow(drive: Path, order: Callable[[int], Iterable[int]] = range) -> Followed:
    """Take the frames of a drive through the pipeline in some order of its `n` numbers; a later one counts."""
    source, truth = open_source(drive), read_truth(drive)
    pairs, pipeline, done = list(source), Pipeline(source.rig, Settings()), Followed()
    found: dict[int, dict] = {}
    latest = -1
    for index in order(len(pairs)):
        # a drive begins at 0, which stands for "no time known"
        result, _ = pipeline.step(replace(pairs[index], t_ns=pairs[index].t_ns + 10**9))
        found[index], true = frame_record(result), truth.frames[index]
        if index <= latest:
            continue
        done.results.append(result)
        latest = index
        note_states(found[index], true, result, done)
        note_motions(found[index], true, done)
        ego = result.ego
        if ego is not None and ego.T_now_before is not None:
            dt_s = (ego.t_ns - ego.before_t_ns) / 1e9
            error_mps = -ego.T_now_before[2, 3] / dt_s - true["ego"]["speed_mps"]
            done.speeds.append((error_mps, float(np.sqrt(ego.cov[5, 5])) / dt_s))
    for index in sorted(found):
        seen = [o for o in found[index]["obstacles"] if not o.get("coasted_s")]
        numbered = [o | {"id": number} for number, o in enumerate(seen, 1)]
        done.pairs.append((found[index], truth.frames[index]))
        done.untracked.append(({"obstacles": numbered}, truth.frames[index]))
    return done


def given(done: Followed) -> list[Pair]:
    """Return what the tracker makes of a drive's things, measured with noise; all else is the pipeline's."""
    twin, rng, pairs = plan_rectification(paper_rig(), Settings().rectify), np.random.default_rng(3), []
    tracker = Tracker(twin)
    for result, (_, true) in zip(done.results, done.pairs, strict=True):
        things = [t for t in true["objects"] if counts(t) and t["type"] not in STRUCTURES]
        found = [measured(t, twin, rng) for t in things if rng.random() < FOUND]
        tracked = tracker.update(found, result.t_ns, result.ego, result.free_space)
        pairs.append((frame_record(replace(result, obstacles=tracked)), true))
    return pairs


def measured(thing: dict, twin: Rectification, rng: np.random.Generator) -> Obstacle:
    """Return a thing as it would be found by itself."""
    box = np.array(thing["box_px"]) + EDGE_PX * rng.standard_normal(4)
    disparity = twin.f_px * twin.baseline_m / thing["range_m"] + DISPARITY_PX * rng.standard_normal()
    range_m = twin.f_px * twin.baseline_m / disparity
    x, y, z = thing["position_m"]
    u0, v0, u1, v1 = np.rint(box).astype(int).tolist()
    return Obstacle(
        position_m=np.array([x, y, z]) * range_m / x,
        range_m=range_m,
        range_sigma_m=range_m / disparity * DISPARITY_PX,
        size_m=np.array(thing["size_m"]),
        uvd_px=np.array([(box[0] + box[2]) / 2, (box[1] + box[3]) / 2, disparity]),
        cov_uvd_px2=np.diag([EDGE_PX**2 / 2, EDGE_PX**2 / 2, DISPARITY_PX**2]),
        cov_match_m2=np.eye(3),
        box_px=(u0, v0, max(u1, u0 + 1), max(v1, v0 + 1)),
        contour_px=np.array([[u0, v0], [u1, v0], [u1, v1]], np.int32),
    )


def note_states(found: dict, true: dict, result: FrameResult, done: Followed) -> None:
    """Note the normalised squared errors of all settled tracks of things that can be told apart."""
    tracks = {o.track.id: o.track for o in result.obstacles if o.track is not None}
    for thing, o in judge_frame(found["obstacles"], true["objects"]).things:
        track = None if o is None else tracks.get(o["id"])
        if track is None or track.age_s < SETTLED_S or not track.is_over_ground or thing["type"] in STRUCTURES:
            continue
        off = track.velocity_mps - true_velocity_mps(thing, track.position_m)
        velocity = float(off @ np.linalg.solve(track.velocity_cov_m2ps2, off))
        place = (track.position_m[0] - thing["position_m"][0]) ** 2 / track.position_cov_m2[0, 0]
        done.states[thing["id"], track.id] = float(place), velocity


def note_motions(found: dict, true: dict, done: Followed) -> None:
    """Count what is told of each track measured now, also of pieces, and of what has no name."""
    movers = [t for t in true["objects"] if np.hypot(*t["velocity_mps"][:2]) > MOVES_MPS]
    for o in found["obstacles"]:
        if o["id"] is not None and not o["coasted_s"]:
            shares = [
                max(share_inside(o["box_px"], t["box_px"]), share_inside(t["box_px"], o["box_px"]))
                for t in movers
                if is_at_depth(o, t)
            ]
            done.told[max(shares, default=0.0) > PART, o["motion"]] += 1


def dropped(n: int) -> list[int]:
    """Return the numbers of the frames but three in ten."""
    rng = np.random.default_rng(0)
    return [i for i in range(n) if i == 0 or rng.random() < KEPT]


def twice(n: int) -> list[int]:
    """Return the numbers of the frames, one in ten twice."""
    rng = np.random.default_rng(1)
    return [i for i in range(n) for _ in range(1 + (rng.random() < TWICE))]


def late(n: int) -> list[int]:
    """Return the numbers of the frames, one in ten after the next one."""
    rng, order = np.random.default_rng(2), list(range(n))
    for i in range(1, n - 1):
        if order[i] == i and rng.random() < LATE:
            order[i], order[i + 1] = order[i + 1], order[i]
    return order


def scored(drives: Sequence[list[Pair]], by_place: bool, perfect: bool = False) -> tuple[TrackScores, int]:
    """Return the scores of some drives together, and how many things there are.

    `perfect`: every obstacle has the identity of the thing that it is most alike, as no tracker can do better.
    """
    seen = []
    for k, drive in enumerate(drives):
        for f, t in drive:
            frame = seen_frame(f["obstacles"], t["objects"], by_place)
            ids = frame.track_ids + (len(seen) + 1) * APART**2 if perfect else frame.track_ids
            if perfect and frame.similarity.size:
                i, j = linear_sum_assignment(-frame.similarity)
                good = frame.similarity[i, j] > 0
                ids[j[good]] = frame.true_ids[i[good]] + k * APART
            numbers = {"true_ids": frame.true_ids + k * APART, "track_ids": ids if perfect else ids + k * APART}
            seen.append(replace(frame, **numbers))
    return judge_tracks(seen), sum(len(f.true_ids) for f in seen)


def hota(s: TrackScores) -> str:
    """Return HOTA and what it is made of."""
    return f"{s.hota:.2f} = {s.deta:.2f} / {s.assa:.2f} / {s.loca:.2f}"


def reason(thing: dict, found: Sequence[dict], true: Sequence[dict]) -> str:
    """Return why a thing has no obstacle whose box overlaps its own by half; empty if it has one."""
    if not found:
        return "nothing there"
    alike = overlaps(boxes_of([thing], "true"), boxes_of(found, "found"))[0]
    if alike.max() >= 0.5:
        return ""
    level = [o for o in found if is_at_depth(o, thing)]
    around = [o for o in level if share_inside(thing["box_px"], o["box_px"]) > 0.7]
    inside = [o for o in level if share_inside(o["box_px"], thing["box_px"]) > 0.6]
    if around:
        others = [t for t in true if t is not thing and share_inside(t["box_px"], around[0]["box_px"]) > 0.5]
        return "one obstacle with another thing" if others else "one obstacle with something unnamed"
    if inside:
        return "in pieces" if len(inside) > 1 else "only part of it"
    return "otherwise cut" if any(share_inside(o["box_px"], thing["box_px"]) > 0.1 for o in level) else "nothing there"


def causes(drives: Sequence[list[Pair]]) -> str:
    """Return how many things are missed for which reason."""
    count: Counter[str] = Counter()
    for f, t in (pair for drive in drives for pair in drive):
        count.update(
            reason(thing, f["obstacles"], t["objects"])
            for thing in t["objects"]
            if counts(thing) and thing["type"] not in STRUCTURES
        )
    missed = {name: n for name, n in count.most_common() if name}
    return f"{sum(missed.values())} of {count.total()}: " + ", ".join(f"{name} {n}" for name, n in missed.items())


def consistency(drives: Sequence[Followed]) -> list[str]:
    """Return the mean normalised squared errors of the latest states of all tracks, and the 95 % bounds of each."""
    states = np.array([state for drive in drives for state in drive.states.values()]).reshape(-1, 2)
    n, figures = len(states), []
    for name, mean, dof in zip(("forward distance", "velocity"), states.mean(0), (1, 2), strict=True):
        low, high = chi2.ppf([0.025, 0.975], dof * n) / n
        figures.append(f"{name} {mean:.2f} ({low:.2f} to {high:.2f})")
    return [f"{'; '.join(figures)}; {n} tracks", "within"]


def hidden(drive: list[Pair], number: int) -> str:
    """Return through which numbers a thing went, and how long it was hidden."""
    ids, gaps_s, last_s = [], [0.0], 0.0
    for f, t in drive:
        things = judge_frame(f["obstacles"], t["objects"]).things
        mine = [(thing, o) for thing, o in things if thing["id"] == number]
        if mine:
            gaps_s.append(t["t_ns"] / 1e9 - last_s)
            last_s = t["t_ns"] / 1e9
        ids += [o["id"] for _, o in mine if o is not None and o["id"] is not None and not o["coasted_s"]]
    return f"{' -> '.join(str(i) for i, _ in groupby(ids))}; too little of it to be seen for {max(gaps_s) - 0.1:.1f} s"


def judge(name: str, drives: Sequence[list[Pair]]) -> list[list[str]]:
    """Return the rows of some drives together."""
    judged = [judge_frame(f["obstacles"], t["objects"]) for drive in drives for f, t in drive]
    rows = []
    for by, by_place in (("by place", True), ("by box", False)):
        s, things = scored(drives, by_place)
        parts = hota(s)
        rows += [
            [name, f"{by}: HOTA = DetA / AssA / LocA", parts, "HOTA >= .85"],
            [name, f"{by}: IDF1; MOTA", f"{s.idf1:.2f}; {s.mota:.2f}", "IDF1 >= .95"],
            [name, f"{by}: switches; missed, false, of things", f"{s.switches}; {s.missed}, {s.false}, {things}", ""],
        ]
    for row in velocity_rows(judged):
        if row["to_m"] == 20:
            figure = f"{row['rms_mps']:.2f} ({row['median_mps']:.2f}) m/s, {row['told_right']:.0%}, n {row['n']}"
            rows.append(
                [name, f"{row['motion']}, to 20 m: velocity error rms (median), told right", figure, "<= .3 m/s"]
            )
            rows.append([name, f"{row['motion']}, to 20 m: error^2 / variance", f"{row['normalized']:.1f}", "1"])
    for row in ttc_rows(judged, [t["ego"] for drive in drives for _, t in drive]):
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
    drives = {
        scene: [render(scene, seed, options.drives) for seed in options.seeds] for scene in (*options.scenes, *HIDING)
    }
    whole = {scene: [follow(drive) for drive in group] for scene, group in drives.items()}
    everything = [done for scene in options.scenes for done in whole[scene]]
    rows = judge("all", [done.pairs for done in everything])
    rows.append(["all", "normalised squared errors, latest of each track (bounds)", *consistency(everything)])
    raw = [done.untracked for done in everything]
    for by, by_place in (("by place", True), ("by box", False)):
        s, _ = scored(raw, by_place, perfect=True)
        parts = f"{hota(s)}; {s.idf1:.2f}"
        rows.append(["all, perfect identities", f"{by}: HOTA = DetA / AssA / LocA; IDF1", parts, ""])
    exact = [given(done) for done in everything]
    for by, by_place in (("by place", True), ("by box", False)):
        s, _ = scored(exact, by_place)
        parts = f"{hota(s)}; {s.idf1:.2f}; {s.switches}"
        bar = "HOTA >= .85, IDF1 >= .95"
        rows.append(["all, things given", f"{by}: HOTA = DetA / AssA / LocA; IDF1; switches", parts, bar])
    rows.append(["all", "no box that overlaps by half, and why", causes(raw), ""])
    told = sum((done.told for done in everything), Counter())
    for moves, name in ((False, "stands, also without a name"), (True, "moves")):
        mine = {motion: n for (is_mover, motion), n in told.items() if is_mover == moves}
        figure = f"moving {mine.get('moving', 0)}, of {sum(mine.values())}"
        rows.append(["all", f"told of tracks of what {name}", figure, "" if moves else "0 moving"])
    e, sigma = np.array([speed for done in everything for speed in done.speeds]).T
    frames = sum(len(done.pairs) for done in everything)
    figure = (
        f"{np.sqrt((e**2).mean()):.3f} m/s; {np.mean((e / sigma) ** 2):.1f}; {len(e)} of {frames - len(everything)}"
    )
    rows.append(["all", "own speed: error rms; error^2 / variance; known", figure, ""])
    for scene in HIDING:
        for done in whole[scene]:
            rows.append([scene, "numbers of who goes behind it", hidden(done.pairs, 2), "one"])
    for what, order in {"30 % dropped": dropped, "10 % twice": twice, "10 % late": late}.items():
        again = [follow(drive, order) for scene in options.scenes for drive in drives[scene]]
        rows += judge(f"all, {what}", [done.pairs for done in again])
        rows.append([f"all, {what}", "normalised squared errors, latest of each track (bounds)", *consistency(again)])
    for scene in options.scenes:
        rows += judge(scene, [done.pairs for done in whole[scene]])[:6]  # scores alone
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
