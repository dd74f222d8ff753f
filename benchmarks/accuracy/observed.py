"""How the fast model of `experiment avoidance --fast` compares with rendered pictures through the whole pipeline.

A car drives straight on through scenarios; each picture's result is compared with what the model says without noise,
and so is the model with its noise. The first gave the numbers of `roadblock.sim.observed.Noise`, the second checks
them. Run `python benchmarks/accuracy/observed.py`.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.cli.avoidance_drive import FRAME_S, rendered, small_rig
from roadblock.eval.match import pair_up
from roadblock.sim.car import CarState
from roadblock.sim.challenges import CHALLENGES, SPEED_MPS
from roadblock.sim.observed import Noise, Observed, observe
from roadblock.stages.rectify import plan_rectification
from roadblock.values.scene import FrameResult

EXACT = Noise(d_px=0.0, column_px=0.0, edge_px=0.0, most_missed=0.0, unknown=0.0)
BANDS_M = ((2, 6), (6, 10), (10, 15), (15, 20), (20, 30))
SCENARIOS = ("paper", "standing", "stopped", "cargo", "parked", "empty")
FB = small_rig().left.fx_px * small_rig().baseline_m
TOLERATED_M = 2.5
"""A drive ends when something in its way is so near."""


def main() -> None:
    """Compare, and save the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--seed", type=int, default=9000)
    options = parser.parse_args()
    tables: dict[str, tuple[list[list[float]], list[np.ndarray]]] = {"pipeline": ([], []), "model": ([], [])}
    steps = []
    for scenario in SCENARIOS:
        for seed in range(options.seed, options.seed + options.seeds):
            for result, noisy, exact in frames(scenario, seed):
                for who, seen in (("pipeline", result), ("model", noisy)):
                    tables[who][0].extend(compare(seen, exact))
                    tables[who][1].append(compare_columns(seen, exact))
                if result.ego is not None and result.ego.T_now_before is not None:
                    steps.append(-result.ego.T_now_before[2, 3] / (SPEED_MPS * FRAME_S) - 1)
    rows = [
        row
        for band in BANDS_M
        for who, (things, columns) in tables.items()
        for row in band_rows(who, band, np.array(things), np.concatenate(columns))
    ]
    notes = f"Own motion of the pipeline: {np.mean(steps):+.2%} of a step too long, {np.std(steps):.2%} scatter."
    save("observed", "python benchmarks/accuracy/observed.py", None, rows, notes)


def frames(scenario: str, seed: int) -> Iterator[tuple[FrameResult, Observed, Observed]]:
    """Yield the pipeline's results of a drive straight on, and what the model says with noise and without."""
    rig, challenge = small_rig(), CHALLENGES[scenario](seed)
    look, twin, rng = rendered(rig, seed, "demo"), plan_rectification(rig), np.random.default_rng(seed)
    car = CarState(*challenge.start_m, 0.0, SPEED_MPS)
    for index in range(35):
        t_s = index * FRAME_S
        things, road = challenge.things_at(t_s), challenge.scene.road
        noisy, exact = (observe(things, road, car, twin, rng, noise) for noise in (Noise(), EXACT))
        if any(o.range_m < TOLERATED_M and abs(o.position_m[1]) < 1.5 for o in exact.obstacles):
            return
        result = look(challenge, t_s, car)[1]
        assert result is not None
        yield result, noisy, exact
        car = replace(car, x_m=car.x_m + SPEED_MPS * FRAME_S)


def compare(seen: FrameResult | Observed, exact: Observed) -> list[list[float]]:
    """Return per thing its range, and the errors of disparity, left and right end of what was found of it, pixels."""
    found = [o for o in seen.obstacles if o.track is None or o.track.coasted_s == 0]
    records, things = (
        [{"box_px": o.box_px, "range_m": o.range_m, "range_sigma_m": None} for o in obstacles]
        for obstacles in (found, exact.obstacles)
    )
    rows = []
    for thing, index in zip(exact.obstacles, pair_up(records, things), strict=True):
        row = [thing.range_m, np.nan, np.nan, np.nan]
        if index is not None:
            o = found[index]
            row[1] = FB / o.range_m - FB / thing.range_m
            row[2:] = [o.box_px[0] - thing.box_px[0], o.box_px[2] - thing.box_px[2]]
        rows.append(row)
    return rows


def compare_columns(seen: FrameResult | Observed, exact: Observed) -> np.ndarray:
    """Return (n, 3) per column that ends at something: its range, the range as seen, and whether that is blocked."""
    free, true = seen.free_space, exact.free_space
    at = np.clip(np.searchsorted(free.u_px, true.u_px), 0, len(free.u_px) - 1)
    assert free.is_blocked is not None
    assert true.is_blocked is not None
    return np.stack([true.range_m, free.range_m[at], free.is_blocked[at]], 1)[true.is_blocked]


def band_rows(who: str, band: tuple[int, int], things: np.ndarray, columns: np.ndarray) -> Iterator[dict[str, object]]:
    """Yield the figures of a range band."""
    mine = things[(things[:, 0] >= band[0]) & (things[:, 0] < band[1])]
    at = columns[(columns[:, 0] >= band[0]) & (columns[:, 0] < band[1])]
    off = (FB / at[:, 1] - FB / at[:, 0])[at[:, 2] > 0]
    if len(mine) and len(at):
        yield {
            "range": f"{band[0]} to {band[1]} m",
            "who": who,
            "things": len(mine),
            "missed": f"{np.isnan(mine[:, 1]).mean():.2f}",
            "disparity (px)": spread(mine[:, 1]),
            "left end (px)": spread(mine[:, 2]),
            "right end (px)": spread(mine[:, 3]),
            "columns": len(at),
            "blocked": f"{(at[:, 2] > 0).mean():.2f}",
            "unknown": f"{np.isnan(at[:, 1]).mean():.2f}",
            "their disparity (px)": spread(off),
        }


def spread(values: np.ndarray) -> str:
    """Return median and half the distance of the percentiles of one standard deviation."""
    values = values[np.isfinite(values)]
    if len(values) < 5:
        return ""
    low, middle, high = np.percentile(values, [16, 50, 84])
    return f"{middle:+.2f} +- {(high - low) / 2:.2f}"


if __name__ == "__main__":
    main()
