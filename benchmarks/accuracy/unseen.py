"""Judge what cannot be seen: `python benchmarks/accuracy/unseen.py [--seeds N] [--first SEED] [--set key=value ...]`.

Five kinds of simulated worlds (`unseen_world.py`) with exact truth. An obstacle is *invented* if it is nearer by more
than 10 % than all that truly stands (over 0.15 m) in its box and 4 px around, or if nothing does. A column of free
space is *unseen* if it reaches more than 10 % beyond the nearest thing that truly stands 0.25 m or higher in it (and in
both columns beside it), or beyond a piece of road that no pair of pixels can show - covered, saturated in both images,
or outside the right one - and that could hide something 0.35 m high. Seeds from 0 on were looked at while settings were
chosen; the figures are of seeds from 1000 on. `--pictures DIR` keeps the pictures; with `--first` or `--set` nothing is
saved.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save
from unseen_world import KINDS, Mask, world

from roadblock.config import load_settings
from roadblock.geometry.stereo import triangulate
from roadblock.pipeline import Pipeline
from roadblock.sim.photograph import photograph
from roadblock.sim.scene import paper_rig
from roadblock.stages.rectify import plan_rectification
from roadblock.values.frame import StereoPair
from roadblock.values.scene import FrameResult, FreeSpace, GroundPlane, Obstacle

Floats = NDArray[np.float64]
NEARER = 0.9
HIDES_M = 0.35
NOISE = 1.5
FULL = 254
RIG = paper_rig()
RECTIFICATION = plan_rectification(RIG)
FB = RECTIFICATION.f_px * RECTIFICATION.baseline_m


def picture(kind: str, seed: int, folder: Path | None) -> dict[str, NDArray[np.float64]]:
    """Return the pair, and what is true: disparities, ground, and the lens's tile; from a file if there is one."""
    path = None if folder is None else folder / f"{kind.replace(' ', '_')}_{seed}.npz"
    if path is not None and path.exists():
        return dict(np.load(path))
    made = world(kind, seed)
    seen = photograph(made.scene, RIG, made.effects, seed=seed)
    assert seen.disparity is not None
    images = [seen.pair.left.copy(), seen.pair.right.copy()]
    if made.tile is not None:
        side, u0, v0, u1, v1, level = made.tile
        rng = np.random.default_rng([seed, 72])
        noise = level + NOISE * rng.normal(size=(v1 - v0, u1 - u0, 3))
        images[side][v0:v1, u0:u1] = np.clip(np.rint(noise), 0, 255)
    drawn = {
        "left": images[0],
        "right": images[1],
        "d_px": seen.disparity.d_px.astype(np.float32),
        "ground": np.array([*seen.ground.normal, seen.ground.height_m, seen.ground.bend_per_m]),
        "tile": np.array(made.tile or ()),
    }
    if path is not None:
        np.savez_compressed(path, **drawn)
    return drawn


def lift(d_px: NDArray[np.float32], ground: GroundPlane) -> tuple[Floats, Floats]:
    """Return the forward distance and the height over the road of every pixel, metres; infinite and NaN in the sky."""
    rows, columns = np.indices(d_px.shape)
    points = triangulate(RECTIFICATION, np.stack([columns, rows, np.nan_to_num(d_px, nan=1e-3)], -1))
    sky = ~np.isfinite(d_px)
    return np.where(sky, np.inf, points[..., 2]), np.where(sky, np.nan, ground.height_of(points))


def is_invented(obstacle: Obstacle, z_m: Floats, height_m: Floats) -> bool:
    """Whether it is nearer than all that truly stands there."""
    u0, v0, u1, v1 = obstacle.box_px
    place = slice(max(v0 - 4, 0), v1 + 4), slice(max(u0 - 4, 0), u1 + 4)
    standing = z_m[place][height_m[place] > 0.15]
    return bool(obstacle.range_m < NEARER * standing.min(initial=np.inf))


def hidden(shot: dict[str, NDArray[np.float64]]) -> Mask:
    """Return which pixels of the left image no pair of pixels can show: covered, saturated, or not in the right one."""
    d_px = np.nan_to_num(shot["d_px"])
    columns = np.arange(d_px.shape[1])
    partner = np.rint(columns - d_px).astype(int)
    rows = np.indices(d_px.shape)[0]
    dark = np.zeros((2, *d_px.shape), bool)
    for side, name in enumerate(("left", "right")):
        dark[side] = (shot[name] >= FULL).all(-1)
    if len(shot["tile"]):
        side, u0, v0, u1, v1 = shot["tile"][:5].astype(int)
        dark[side, v0:v1, u0:u1] = True
    return np.asarray((partner < 0) | dark[0] | dark[1][rows, np.maximum(partner, 0)])


def road_limit(unseen: Mask, z_m: Floats, height_m: Floats) -> Floats:
    """Return per column the range of road below the first run of unseen pixels that hides `HIDES_M`; or infinity."""
    height, width = unseen.shape
    limit = np.full(width, np.inf)
    road = np.where((height_m < 0.15) & np.isfinite(z_m), z_m, np.nan)
    lowest = np.nanmedian(road[-1])
    length, begin, below = np.zeros(width), np.full(width, lowest), np.full(width, lowest)
    for row in range(height - 1, -1, -1):
        begin = np.where(length == 0, below, begin)
        length = np.where(unseen[row], length + 1, 0)
        hides = length * begin / RECTIFICATION.f_px >= HIDES_M
        limit = np.where(np.isinf(limit) & hides, begin, limit)
        below = np.where(np.isfinite(road[row]), road[row], below)
    return limit


def first_standing(z_m: Floats, height_m: Floats, *, beside: bool = True) -> Floats:
    """Return per column how far ahead the first thing 0.25 to 2.5 m high stands that ends it and the cells beside it.

    With `beside` False, the first that ends it or one of them.
    """
    stands = np.where((height_m > 0.25) & (height_m < 2.5), z_m, np.inf)
    nearest = np.partition(stands, 7, axis=0)[7].astype(np.float32)  # the 8 nearest pixels: no stray one
    farther = cv2.dilate if beside else cv2.erode
    return farther(nearest[None], np.ones((1, 12)))[0].astype(float)


def unseen_columns(free: FreeSpace, standing_m: Floats, limit_m: Floats) -> tuple[int, int]:
    """Return how many columns of free space reach beyond what stands, and beyond what cannot be seen."""
    u = np.rint(free.u_px).astype(int)
    with np.errstate(invalid="ignore"):
        late = NEARER * free.range_m > standing_m[u]
        blind = ~late & (NEARER * free.range_m > limit_m[u])
    return int(late.sum()), int(blind.sum())


def judge(result: FrameResult, shot: dict[str, NDArray[np.float64]]) -> dict[str, float]:
    """Return the counts of one frame."""
    ground = GroundPlane(shot["ground"][:3], float(shot["ground"][3]), float(shot["ground"][4]))
    z_m, height_m = lift(shot["d_px"], ground)
    unseen = hidden(shot)
    late, blind = unseen_columns(result.free_space, first_standing(z_m, height_m), road_limit(unseen, z_m, height_m))
    known = np.isfinite(result.free_space.range_m)
    return {
        "invented": sum(is_invented(o, z_m, height_m) for o in result.obstacles),
        "late": late,
        "blind": blind,
        "obstacles": len(result.obstacles),
        "known": float(known.mean()),
        "columns": known.size,
    }


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--set", nargs="*", default=[])
    parser.add_argument("--kinds", nargs="*", default=KINDS)
    parser.add_argument("--pictures", type=Path)
    options = parser.parse_args()
    pipeline = Pipeline(RIG, load_settings(None, options.set))
    rows = []
    for kind in options.kinds:
        counts = []
        for seed in range(options.first, options.first + options.seeds):
            shot = picture(kind, seed, options.pictures)
            result, _ = pipeline.step(StereoPair(shot["left"], shot["right"], seed, str(seed), 0))
            counts.append(judge(result, shot))
            if sum(counts[-1][name] for name in ("invented", "late", "blind")):
                print(kind, seed, counts[-1], flush=True)
        total = {name: [c[name] for c in counts] for name in counts[0]}
        frames = {name: int(np.count_nonzero(total[name])) for name in ("invented", "late", "blind")}
        row = {"kind": kind, "seeds": options.seeds}
        for name, what in (("invented", "obstacles"), ("late", "columns"), ("blind", "columns")):
            row |= {f"{name} {what}": int(sum(total[name])), f"frames with {name} {what}": frames[name]}
        rows.append(row | {"free space known": round(float(np.mean(total["known"])), 3)})
        print(rows[-1], flush=True)
    if options.first == 1000 and not options.set and list(options.kinds) == list(KINDS):
        notes = "What cannot be seen, in the simulated world: bar 0 for each count. Definitions in the command's head."
        save("unseen", f"python benchmarks/accuracy/unseen.py --seeds {options.seeds}", None, rows, notes)


if __name__ == "__main__":
    main()
