"""Judge free space that remembers: `python benchmarks/accuracy/fused.py [--seeds N] [--first SEED] [--set a.b=c ...]`.

Simulated drives at 10 frames a second. Each frame's free space is judged as its detector found it and as it was after
the frames before had their say. A column is *late* if it reaches more than 10 % beyond the first thing that truly
stands 0.25 to 2.5 m high in it and in both columns beside it, *near* if something is said to end it more than 10 %
before the first in any of them; both within 40 m only. The first
frames, which have nothing to remember, do not count. With `--first` or `--set` nothing is saved.
"""

import argparse
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save
from unseen import NEARER, RIG, first_standing, lift

from roadblock.config import load_settings
from roadblock.pipeline import Pipeline
from roadblock.sim.conditions import combined
from roadblock.sim.photograph import photograph
from roadblock.sim.scenes import SCENES
from roadblock.values.scene import FreeSpace

NAMES = ("city", "country", "crossing", "parked", "rain", "night")
FPS, FRAMES, FIRST = 10.0, 9, 4
REACH_M = 40.0


def count(free: FreeSpace, z_m: np.ndarray, height_m: np.ndarray) -> np.ndarray:
    """Return how many columns are known, late and near."""
    assert free.is_blocked is not None
    at = np.rint(free.u_px).astype(int)
    with np.errstate(invalid="ignore"):
        standing_m = first_standing(z_m, height_m)[at]
        late = (standing_m < REACH_M) & (NEARER * free.range_m > standing_m)
        near = (
            free.is_blocked
            & (free.range_m < REACH_M)
            & (free.range_m < NEARER * first_standing(z_m, height_m, beside=False)[at])
        )
    return np.array([np.isfinite(free.range_m).sum(), late.sum(), near.sum()])


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--set", nargs="*", default=[])
    options = parser.parse_args()
    rows = []
    for name in NAMES:
        alone, fused = np.zeros(3, int), np.zeros(3, int)
        for seed in range(options.first, options.first + options.seeds):
            scene = SCENES[name](seed)
            forgets = Pipeline(RIG, load_settings(None, [*options.set, "fuse.frames=0"]))
            remembers = Pipeline(RIG, load_settings(None, options.set))
            for index in range(FRAMES):
                seen = photograph(
                    scene.at(index / FPS),
                    RIG,
                    combined(scene.conditions),
                    seed=seed,
                    index=index,
                    t_ns=1 + index * 10**8,
                )
                results = [pipeline.step(seen.pair)[0] for pipeline in (forgets, remembers)]
                if index >= FIRST:
                    assert seen.disparity is not None
                    true = lift(seen.disparity.d_px, seen.ground)
                    for counts, result in zip((alone, fused), results, strict=True):
                        counts += count(result.free_space, *true)
        row: dict[str, object] = {"drive": name, "frames": options.seeds * (FRAMES - FIRST)}
        for what, counts in (("alone", alone), ("fused", fused)):
            row |= {f"late {what}": round(float(counts[1] / counts[0]), 4)}
            row |= {f"near {what}": round(float(counts[2] / counts[0]), 4)}
        rows.append(row)
        print(row, flush=True)
    if options.first == 1000 and not options.set:
        command = f"python benchmarks/accuracy/fused.py --seeds {options.seeds}"
        save("fused", command, None, rows, "Free space by single frames and with the memory of those before.")


if __name__ == "__main__":
    main()
