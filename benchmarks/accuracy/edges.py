"""Judge kerbs and verges: `python benchmarks/accuracy/edges.py [--seeds N] [--first SEED] [--set key=value ...]`.

Simulated roads with kerb stones of 8 to 15 cm, roads with verges of tufts of 8 to 25 cm, and roads without either
(`low_world.py`: markings, patches, manholes, shadows, wet). A column's true edge is where, from below, the ground (or a
tuft) first rises by more than 4 cm and half of the next metre stays up. Found: within 10 % and 0.5 m of it. On roads
without edges, and nearer than a true edge by more than that, an edge is false. Seeds from 0 on were looked at while the
settings were chosen; the figures are of seeds from 1000 on. With `--first` or `--set` nothing is saved.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
import low_world
from record import save

from roadblock.config import load_settings
from roadblock.geometry.stereo import triangulate
from roadblock.pipeline import Pipeline
from roadblock.sim.conditions import CONDITIONS
from roadblock.sim.photograph import photograph
from roadblock.sim.render import Rendered
from roadblock.sim.road import Line, Road
from roadblock.sim.scene import Scene, camera_pose, paper_rig, roadside
from roadblock.sim.solids import Thing, ellipsoid
from roadblock.stages.rectify import plan_rectification
from roadblock.values.scene import EDGE_KINDS, FreeSpace, GroundPlane

Floats = NDArray[np.float64]
RIG = paper_rig()
RECTIFICATION = plan_rectification(RIG)
KINDS = ("kerb", "verge", *low_world.FLAT, "wet")
RISE_M, OFF_M, OFF_SHARE, BANDS_M = 0.04, 0.5, 0.1, (10.0, 20.0)


def verge(rng: np.random.Generator, road: Road) -> tuple[Thing, ...]:
    """Draw two strips of tufts along both edges of the asphalt."""
    tufts = []
    for side, edge in ((1, road.left_m), (-1, road.right_m)):
        for ahead in np.arange(3.0, 26.0, 0.22):
            for out in np.arange(0.1, 1.6, 0.22):
                half = np.array([*rng.uniform(0.12, 0.25, 2), rng.uniform(0.04, 0.13)])
                green = tuple(int(c) for c in np.array([86, 118, 50]) * rng.uniform(0.8, 1.2))
                at = (ahead + rng.uniform(-0.08, 0.08), edge + side * (out + rng.uniform(-0.08, 0.08)), half[2] * 0.8)
                tufts.append(ellipsoid(half, at, green, 0.4))
    # Many small things are quicker to see through than a large one.
    return tuple(Thing(0, "verge", "green", tuple(tufts[i : i + 24])) for i in range(0, len(tufts), 24))


def scene_of(kind: str, seed: int) -> Rendered:
    """Return the picture of a road of a kind of `KINDS`."""
    rng = np.random.default_rng([seed, 61])
    if kind not in ("kerb", "verge"):
        world = low_world.road(kind, seed)
        # The street of that module has kerbs.
        road = replace(world.scene.road, kerb_m=0.0)
        return photograph(replace(world.scene, road=road), RIG, world.effects, seed=seed)
    kerb_m = rng.uniform(0.08, 0.15) if kind == "kerb" else 0.0
    road = Road(-rng.uniform(1.3, 3.0), rng.uniform(1.5, 5.0), (Line(0.0, gap_m=4.5),), rng.uniform(0.1, 0.2))
    road = replace(road, kerb_m=kerb_m)
    things = verge(rng, road) if kind == "verge" else ()
    scene = Scene((*things, *roadside(rng)), road, camera_pose(rng.uniform(1.3, 1.6)), low_world.sun(rng), seed)
    return photograph(scene, RIG, CONDITIONS["day"], seed=seed)


def true_edges(d_px: NDArray[np.float32], ground: GroundPlane, u_px: Floats) -> Floats:
    """Return the range of the true edge of each column (n,), infinity without one."""
    rows, columns = np.indices(d_px.shape)
    points = triangulate(RECTIFICATION, np.stack([columns, rows, np.nan_to_num(d_px, nan=1e-3)], -1))
    z_m, height_m = points[..., 2], ground.height_of(points)
    edges = np.full(len(u_px), np.inf)
    for n, u in enumerate(np.rint(u_px).astype(int)):
        z, up = z_m[::-1, u], height_m[::-1, u] > RISE_M
        for begin in np.flatnonzero(up & (z < 40)):
            ahead = (z >= z[begin]) & (z <= z[begin] + 1) & (np.arange(len(z)) >= begin)
            if up[ahead].mean() >= 0.5 and np.ptp(z[ahead & up]) > OFF_M / 2:
                edges[n] = z[begin]
                break
    return edges


def judge(free: FreeSpace, true_m: Floats, kind: str) -> dict[str, int]:
    """Return the counts of one frame."""
    assert free.edges is not None
    found_m = free.edges.range_m
    off_m = np.maximum(OFF_M, OFF_SHARE * np.where(np.isinf(true_m), 0, true_m))
    hit = np.abs(found_m - true_m) <= off_m
    counts = {"columns": len(found_m), "false": int(((found_m < true_m - off_m) & np.isfinite(found_m)).sum())}
    near = 0.0
    for far in BANDS_M:
        inside = (true_m >= near) & (true_m < far)
        counts |= {f"true <{far:g} m": int(inside.sum()), f"found <{far:g} m": int((inside & hit).sum())}
        near = far
    named = free.edges.kind[hit] == EDGE_KINDS.index(kind) if kind in EDGE_KINDS else np.zeros(0)
    return counts | {"hits": len(named), "named right": int(named.sum())}


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--set", nargs="*", default=[])
    options = parser.parse_args()
    pipeline = Pipeline(RIG, load_settings(None, options.set))
    rows = []
    for kind in KINDS:
        total: dict[str, int] = {}
        for seed in range(options.first, options.first + options.seeds):
            seen = scene_of(kind, seed)
            assert seen.disparity is not None
            result, _ = pipeline.step(seen.pair)
            flat = kind not in ("kerb", "verge")
            u_px = result.free_space.u_px
            true_m = np.full(len(u_px), np.inf)
            if not flat:
                true_m = true_edges(seen.disparity.d_px, seen.ground, u_px)
            if result.free_space.edges is None:
                continue
            for name, count in judge(result.free_space, true_m, kind).items():
                total[name] = total.get(name, 0) + count
        row: dict[str, object] = {"road": kind, "frames": options.seeds}
        row["false columns"] = round(total["false"] / total["columns"], 4)
        for far in BANDS_M:
            if total[f"true <{far:g} m"]:
                row[f"found <{far:g} m"] = round(total[f"found <{far:g} m"] / total[f"true <{far:g} m"], 3)
        if total["hits"]:
            row["named right"] = round(total["named right"] / total["hits"], 3)
        rows.append(row)
        print(row, flush=True)
    if options.first == 1000 and not options.set:
        command = f"python benchmarks/accuracy/edges.py --seeds {options.seeds}"
        save("edges", command, None, rows, "Kerbs and verges in the simulated world, by columns of cells.")


if __name__ == "__main__":
    main()
