"""Time the tracking of 32 obstacles: `python benchmarks/speed/track.py`. One thread, CPU time.

32 things in 8 rows, 8 to 60 m ahead, drive as fast as the vehicle; there are 300 features. All are measured in each of
60 frames; or each is missed in every fourth. `--profile` prints where the time goes, `--dry` saves nothing.
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

from roadblock.geometry.stereo import triangulate
from roadblock.stages.match import MatchSettings, match_bm
from roadblock.stages.track import Tracker
from roadblock.values.camera import Rectification
from roadblock.values.motion import EgoMotion, Flow
from roadblock.values.scene import FreeSpace, Obstacle

TWIN = Rectification(721.0, 600.0, 180.0, 0.54, (1242, 375))
THINGS, FEATURES, FRAMES, ROUNDS = 32, 300, 60, 20
SPEED_MPS, STEP_S = 8.0, 0.1
SIGMA_PX = np.array([1.0, 1.0, 0.1])

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


def drive(rng: np.random.Generator, missed: bool) -> list[Frame]:
    """Return what the tracker gets."""
    z = np.repeat(np.linspace(8, 60, THINGS // 4), 4)
    aside = np.tile([-0.5, -0.18, 0.18, 0.5], THINGS // 4) * 0.8
    exact = np.stack([TWIN.cx_px + TWIN.f_px * aside, TWIN.cy_px + 0.7 * TWIN.f_px / z, 721 * 0.54 / z], -1)
    T, W = np.eye(4), np.tile(10 * np.eye(3), (FEATURES, 1, 1))
    T[2, 3] = -SPEED_MPS * STEP_S
    frames = []
    for i in range(FRAMES):
        shown = (np.arange(THINGS) + i) % 4 > 0 if missed else np.ones(THINGS, bool)
        seen = [obstacle(uvd) for uvd in (exact + SIGMA_PX * rng.standard_normal(exact.shape))[shown]]
        spread = rng.uniform([0, 100, 6], [1242, 300, 50], (FEATURES, 3))
        off_px = 0.3 * rng.standard_normal((FEATURES, 3))
        off_px[:, 2] -= SPEED_MPS * STEP_S * spread[:, 2] ** 2 / (721 * 0.54)
        t_ns = 10**18 + round(i * STEP_S * 1e9)
        flow, cov = Flow(spread, off_px, W), np.diag([1e-8] * 3 + [1e-4] * 3)
        ego = EgoMotion(t_ns - round(STEP_S * 1e9), t_ns, T, cov, flow=flow)
        frames.append((seen, t_ns, ego, FreeSpace(np.arange(3.5, 1240, 8.0), np.full(155, 9.0))))
    return frames


def follow(frames: list[Frame]) -> float:
    """Return the CPU ms of a frame, the mean over all: the clock itself may take as long as one."""
    tracker = Tracker(TWIN)
    start = thread_time()
    for frame in frames:
        found = tracker.update(*frame)
    ms = 1e3 * (thread_time() - start) / len(frames)
    assert sorted(o.track.id for o in found) == list(range(1, THINGS + 1))
    return ms


def main() -> None:
    """Measure, print and save."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(0)
    drives = {"32 obstacles": drive(rng, False), "32 obstacles, a quarter of them missed": drive(rng, True)}
    for frames in drives.values():
        follow(frames)
    if "--profile" in sys.argv:
        with cProfile.Profile() as profile:
            for _ in range(ROUNDS):
                follow(next(iter(drives.values())))
        pstats.Stats(profile).sort_stats("tottime").print_stats(25)
        return
    scene = (120 + 120 * cv2.GaussianBlur(rng.standard_normal((375, 1252)), (0, 0), 1.2)).clip(0, 255).astype(np.uint8)
    left, right = np.ascontiguousarray(scene[:, :1242]), np.ascontiguousarray(scene[:, 10:])
    bm = MatchSettings(disparities=128, block_px=15)
    times: dict[str, list[float]] = {name: [] for name in (*drives, "StereoBM, 128 disparities, block 15")}
    for _ in range(ROUNDS):
        for name, frames in drives.items():
            times[name].append(follow(frames))
        start = thread_time()
        match_bm(left, right, bm)
        times["StereoBM, 128 disparities, block 15"].append(1e3 * (thread_time() - start))
    *_, slowest = (float(np.median(t)) for t in times.values())
    rows = [[n, f"{np.median(t):.3f}", f"{np.min(t):.3f}", f"{slowest / np.median(t):.0f}"] for n, t in times.items()]
    for row in rows:
        print(*(f"{cell:40}" for cell in row))
    if "--dry" not in sys.argv:
        columns = ["what", "median CPU ms", "least", "x StereoBM"]
        notes = "With 300 features. The bar for tracking and deciding is 0.3 ms."
        save("track_speed", "python benchmarks/speed/track.py", columns, rows, notes)


if __name__ == "__main__":
    main()
