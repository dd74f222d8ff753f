"""Time tracking and deciding with 32 obstacles: `python benchmarks/speed/track.py`. One thread, CPU time.

32 things in 8 rows, 8 to 60 m ahead, drive as fast as the vehicle; there are 300 features, 155 columns of free space
and two kerbs. All are measured in each of 60 frames; or each is missed in every fourth; or they stand, so that the car
must find a way round them or brake. Beside it a whole step of the detector `cells`, and OpenCV's StereoBM. `--profile`
prints where the time goes, `--dry` saves nothing.
"""

import cProfile
import pstats
import sys
from pathlib import Path
from time import thread_time

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import load_settings
from roadblock.geometry.pose import pose
from roadblock.geometry.stereo import triangulate
from roadblock.kernels.gray import gray8
from roadblock.pipeline import Pipeline
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street
from roadblock.stages.decide import Decider
from roadblock.stages.match import MatchSettings, match_bm
from roadblock.stages.track import Tracker
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.frame import StereoPair
from roadblock.values.motion import EgoMotion, Flow
from roadblock.values.scene import FreeSpace, GroundPlane, Obstacle, RoadEdges

TWIN = Rectification(721.0, 600.0, 180.0, 0.54, (1242, 375))
THINGS, FEATURES, FRAMES, ROUNDS = 32, 300, 60, 20
SPEED_MPS, STEP_S = 8.0, 0.1
SIGMA_PX = np.array([1.0, 1.0, 0.1])
ROAD = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.4)
KERB_M, REACH_M = 4.0, 40.0
STEP, BM = "a step of `cells`, 128 disparities, without tracking", "StereoBM, 128 disparities, block 15"

Frame = tuple[list[Obstacle], int, EgoMotion, FreeSpace]


def obstacle(uvd: np.ndarray) -> Obstacle:
    """Return one of 0.5 by 1.5 m."""
    px_per_m = uvd[2] / TWIN.baseline_m
    half = np.array([0.25, 0.75]) * px_per_m
    u0, v0, u1, v1 = (round(float(edge)) for edge in (*(uvd[:2] - half), *(uvd[:2] + half)))
    x, y, z = triangulate(TWIN, uvd)
    contour = np.array([[u0, v0], [u1, v0], [u1, v1]])
    size_m, cov_px2 = np.array([0.5, 1.5, np.nan]), np.diag(SIGMA_PX**2)
    return Obstacle(np.array([z, -x, -y]), float(z), 0.1, size_m, uvd, cov_px2, np.eye(3), (u0, v0, u1, v1), contour)


def road(seen: list[Obstacle]) -> FreeSpace:
    """Return what is free before some obstacles, and the kerbs."""
    u = np.arange(3.5, 1240, 8.0)
    range_m = np.full(len(u), REACH_M)
    for o in seen:
        mine = (u >= o.box_px[0]) & (u < o.box_px[2])
        range_m[mine] = np.minimum(range_m[mine], o.range_m)
    kerb_m = KERB_M * TWIN.f_px / np.maximum(np.abs(u - TWIN.cx_px), 1.0)
    kerb_m[kerb_m > np.minimum(range_m, 15.0)] = np.nan
    is_kerb = np.isfinite(kerb_m)
    edges = RoadEdges(kerb_m, np.where(is_kerb, 0.12, np.nan), is_kerb.astype(np.uint8))
    return FreeSpace(u, range_m, range_m < REACH_M, edges)


def drive(rng: np.random.Generator, missed: bool = False, own_mps: float = 0.0) -> list[Frame]:
    """Return what the tracker gets; things come nearer by `own_mps`."""
    z0 = np.repeat(np.linspace(8, 60, THINGS // 4), 4)
    aside = np.tile([-0.5, -0.18, 0.18, 0.5], THINGS // 4) * 0.8
    T, W = np.eye(4), np.tile(10 * np.eye(3), (FEATURES, 1, 1))
    T[2, 3] = -SPEED_MPS * STEP_S
    frames = []
    for i in range(FRAMES):
        z = np.maximum(z0 - own_mps * STEP_S * i, 0.1)
        lateral = TWIN.cx_px + TWIN.f_px * aside * z0 / z
        exact = np.stack([lateral, TWIN.cy_px + 0.7 * TWIN.f_px / z, 721 * 0.54 / z], -1)
        shown = (np.arange(THINGS) + i) % 4 > 0 if missed else (z > 3) & (lateral > 0) & (lateral < 1240)
        seen = [obstacle(uvd) for uvd in (exact + SIGMA_PX * rng.standard_normal(exact.shape))[shown]]
        spread = rng.uniform([0, 100, 6], [1242, 300, 50], (FEATURES, 3))
        off_px = 0.3 * rng.standard_normal((FEATURES, 3))
        if not own_mps:
            off_px[:, 2] -= SPEED_MPS * STEP_S * spread[:, 2] ** 2 / (721 * 0.54)
        t_ns = 10**18 + round(i * STEP_S * 1e9)
        flow, cov = Flow(spread, off_px, W), np.diag([1e-8] * 3 + [1e-4] * 3)
        ego = EgoMotion(t_ns - round(STEP_S * 1e9), t_ns, T, cov, flow=flow)
        frames.append((seen, t_ns, ego, road(seen)))
    return frames


def follow(frames: list[Frame]) -> tuple[float, float]:
    """Return the CPU ms of tracking and of deciding a frame, the mean over all: the clock may take as long as one."""
    tracker, decider = Tracker(TWIN), Decider(TWIN)
    start = thread_time()
    tracked = [tracker.update(*frame) for frame in frames]
    between = thread_time()
    for found, (_, t_ns, ego, free) in zip(tracked, frames, strict=True):
        decider.decide(found, free, ego, t_ns, ROAD)
    end = thread_time()
    return 1e3 * (between - start) / len(frames), 1e3 * (end - between) / len(frames)


def stepper() -> tuple[Pipeline, StereoPair]:
    """Return a pipeline that does not track, and a pair for it."""
    size = (1242, 375)
    camera = Camera(size, 1002.0, 1002.0, 633.0, 184.0)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    pair = render(demo_street(0), rig, quality="preview", seed=0).pair
    pipeline = Pipeline(rig, load_settings(None, ["track.enabled=false", "cells.disparities=128"]))
    return pipeline, StereoPair(*gray8(pair.left, pair.right))


def main() -> None:
    """Measure, print and save."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    drives = {
        "32 obstacles": drive(rng),
        "32 obstacles, a quarter of them missed": drive(rng, missed=True),
        "32 obstacles that stand, the nearest pass by": drive(rng, own_mps=SPEED_MPS),
    }
    for frames in drives.values():
        follow(frames)
    if "--profile" in sys.argv:
        with cProfile.Profile() as profile:
            for _ in range(ROUNDS):
                follow(list(drives.values())[int(sys.argv[-1]) if sys.argv[-1].isdigit() else 0])
        pstats.Stats(profile).sort_stats("tottime").print_stats(45)
        return
    scene = (120 + 120 * cv2.GaussianBlur(rng.standard_normal((375, 1252)), (0, 0), 1.2)).clip(0, 255).astype(np.uint8)
    left, right = np.ascontiguousarray(scene[:, :1242]), np.ascontiguousarray(scene[:, 10:])
    pipeline, pair = stepper()
    pipeline.step(pair)
    others = {
        STEP: lambda: pipeline.step(pair),
        BM: lambda: match_bm(left, right, MatchSettings(disparities=128, block_px=15)),
    }
    times: dict[str, list[tuple[float, ...]]] = {name: [] for name in (*drives, *others)}
    for _ in range(ROUNDS):
        for name, frames in drives.items():
            times[name].append(follow(frames))
        for name, run in others.items():
            start = thread_time()
            run()
            times[name].append((1e3 * (thread_time() - start),))
    medians = {name: np.median(t, 0) for name, t in times.items()}
    least = {name: np.min(np.sum(t, 1)) for name, t in times.items()}
    step_ms, bm_ms = medians[STEP].sum(), medians[BM].sum()
    rows = []
    for name, parts in medians.items():
        both = parts.sum()
        track, decide = (f"{part:.3f}" for part in parts) if len(parts) == 2 else ("", "")
        rows.append(
            [name, track, decide, f"{both:.3f}", f"{least[name]:.3f}", f"{both / step_ms:.1%}", f"{bm_ms / both:.0f}"]
        )
    for row in rows:
        print(*(f"{cell:>12}" if i else f"{cell:52}" for i, cell in enumerate(row)))
    if "--dry" not in sys.argv:
        columns = ["what", "tracking", "deciding", "both, CPU ms", "least", "share of a step", "x StereoBM"]
        notes = "With 300 features. Medians; least of both. The bar for tracking and deciding is 0.3 ms."
        save("track_speed", "python benchmarks/speed/track.py", columns, rows, notes)


if __name__ == "__main__":
    main()
