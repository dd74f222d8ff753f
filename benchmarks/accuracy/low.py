"""Find low obstacles in the simulated world: `python benchmarks/accuracy/low.py [options]`.

Cubes of 15 cm, as grey as the asphalt to 20 %, stand at 10, 20 and 30 m, two each, on three kinds of textured road;
roads with nothing on them come in six kinds (`low_world.py`). The ground is the true one with an error of 0.02 m in
height and 0.08 deg in pitch (one sigma), or with `--fitted` what `fit_ground` makes of SGBM. Settings were chosen on
cubes 0 to 39 and roads 0 to 119; the figures are of seeds from 1000 on. `--pictures DIR` keeps the pictures,
`--cubes N` and `--roads N` take fewer; with `--first SEED` or `--fitted` nothing is saved.
"""

import argparse
import sys
import time
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from low_world import RANGES_M, ROADS, World, cubes, empty_road
from record import save

from roadblock.geometry.pose import rotation_from_rotvec
from roadblock.sim.photograph import photograph
from roadblock.sim.scene import paper_rig
from roadblock.stages.ground import GroundSettings, fit_ground
from roadblock.stages.low import LowFinder
from roadblock.stages.match import MatchSettings, match
from roadblock.stages.rectify import plan_rectification
from roadblock.stages.segment import to_cells
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import GroundPlane, Region

HEIGHT_SIGMA_M, PITCH_SIGMA_DEG = 0.02, 0.08
RIG = paper_rig()
RECTIFICATION = plan_rectification(RIG)
FB = RECTIFICATION.f_px * RECTIFICATION.baseline_m


def picture(make: str, seed: int, folder: Path | None) -> dict[str, np.ndarray]:
    """Return the grey pair, the true ground and the true boxes and ranges; from a file if there is one."""
    path = None if folder is None else folder / f"{make}_{seed}.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    world: World = {"cubes": cubes, "roads": empty_road}[make](seed)
    seen = photograph(world.scene, RIG, world.effects, seed=seed)
    left, right = (cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (seen.pair.left, seen.pair.right))
    named = [(*o.box_px, o.range_m) for o in seen.objects if o.type == "box"]
    ground = np.array([*seen.ground.normal, seen.ground.height_m, seen.ground.bend_per_m])
    drawn = {"left": left, "right": right, "ground": ground, "truth": np.array(named).reshape(-1, 5)}
    if path is not None:
        np.savez(path, **drawn)
    return drawn


def assumed_ground(shot: dict[str, np.ndarray], seed: int) -> GroundPlane:
    """Return the true ground with the error a good estimate has."""
    rng = np.random.default_rng([seed, 9])
    pitch = np.radians(PITCH_SIGMA_DEG) * rng.normal()
    normal = rotation_from_rotvec([pitch, 0.0, 0.0]) @ shot["ground"][:3]
    return GroundPlane(normal, float(shot["ground"][3]) + HEIGHT_SIGMA_M * rng.normal(), float(shot["ground"][4]))


def fitted_ground(pair: RectifiedPair) -> GroundPlane | None:
    """Return what the dense detector makes of the pair."""
    return fit_ground(to_cells(match(pair, MatchSettings()), 4), RECTIFICATION, GroundSettings())


def is_at(region: Region, truth: np.ndarray) -> bool:
    """Whether a region is this true thing: their boxes meet, and their ranges agree to 10 %."""
    (a0, b0, a1, b1), (c0, d0, c1, d1, range_m) = region.box_px, truth
    meets = min(a1, c1) > max(a0, c0) and min(b1, d1) > max(b0, d0)
    return bool(meets and abs(FB / np.median(region.surface_uvd_px[:, 2]) / range_m - 1) < 0.1)


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--cubes", type=int, default=60)
    parser.add_argument("--roads", type=int, default=300)
    parser.add_argument("--fitted", action="store_true")
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    find = LowFinder()
    found: dict[float, list[bool]] = {range_m: [] for range_m in RANGES_M}
    errors: dict[float, list[float]] = {range_m: [] for range_m in RANGES_M}
    false: dict[str, list[int]] = {kind: [] for kind in (*ROADS, "beside cubes")}
    spent_ms, matcher_ms = [], []
    matcher = cv2.StereoBM.create(128, 15)
    cv2.setNumThreads(1)
    for make, count in (("cubes", options.cubes), ("roads", options.roads)):
        for seed in range(options.first, options.first + count):
            shot = picture(make, seed, options.pictures)
            pair = RectifiedPair(shot["left"], shot["right"], RECTIFICATION)
            ground = fitted_ground(pair) if options.fitted else assumed_ground(shot, seed)
            start = time.thread_time()
            regions, _ = find(pair, ground)
            spent_ms.append(1e3 * (time.thread_time() - start))
            if seed % 10 == 0:
                start = time.thread_time()
                matcher.compute(shot["left"], shot["right"])
                matcher_ms.append(1e3 * (time.thread_time() - start))
            for truth in shot["truth"]:
                near = min(RANGES_M, key=lambda range_m: abs(range_m - truth[4]))
                mine = [region for region in regions if is_at(region, truth)]
                found[near].append(bool(mine))
                errors[near] += [FB / float(np.median(r.surface_uvd_px[:, 2])) - truth[4] for r in mine[:1]]
            wrong = [r for r in regions if not any(is_at(r, truth) for truth in shot["truth"])]
            kind = "beside cubes" if make == "cubes" else ROADS[seed % len(ROADS)]
            false[kind].append(len(wrong))
            for r in wrong:
                print(
                    make, seed, kind, "false:", r.box_px, f"{FB / np.median(r.surface_uvd_px[:, 2]):.1f} m", flush=True
                )
    rows = [
        [f"cube at {z:g} m", f"{np.mean(f):.3f} of {len(f)}", bar, f"{np.median(np.abs(errors[z])):.2f} m"]
        for (z, f), bar in zip(found.items(), (">= .99", ">= .95", ">= .80"), strict=True)
        if f
    ]
    rows += [[f"false, {kind}", f"{sum(f)} in {len(f)} frames", "", ""] for kind, f in false.items() if f]
    empty = [n for kind in ROADS for n in false[kind]]
    if empty:
        rows.append(["false, all empty roads", f"{np.mean(empty):.4f} a frame", "<= .01", ""])
    share = np.median(spent_ms) / np.median(matcher_ms)
    rows.append(
        ["CPU time over StereoBM's (128 disparities, block 15)", f"{share:.4f}", "", f"{np.median(spent_ms):.2f} ms"]
    )
    for row in rows:
        print(*(f"{cell:45}" for cell in row))
    if options.first == 1000 and not options.fitted:
        notes = (
            "Low cubes in the simulated world, `low.enabled=true`; ground off by 0.02 m and 0.08 deg (one sigma). Last "
            "column: range error."
        )
        save("low_obstacles", "python benchmarks/accuracy/low.py", ["what", "measured", "bar", "median"], rows, notes)


if __name__ == "__main__":
    main()
