"""How the fast model of `experiment avoidance --fast` compares with rendered pictures through the whole pipeline.

A car drives straight on through scenarios; each picture's result is compared with what the model says without noise.
What comes out are the numbers of `roadblock.sim.observed.Noise`. Run `python benchmarks/accuracy/observed.py`.
"""

import argparse
import json
from dataclasses import replace

import numpy as np

from roadblock.cli.avoidance_drive import FRAME_S, rendered, small_rig
from roadblock.eval.match import pair_up
from roadblock.io.results import frame_record
from roadblock.sim.car import CarState
from roadblock.sim.challenges import CHALLENGES, SPEED_MPS
from roadblock.sim.observed import Noise, Observed, observe
from roadblock.stages.rectify import plan_rectification
from roadblock.values.scene import FrameResult

EXACT = Noise(d_px=0.0, column_px=0.0, edge_px=0.0, most_missed=0.0, unknown=0.0, step_share=0.0, turn_rad=0.0)
BANDS_M = ((2, 6), (6, 10), (10, 15), (15, 20), (20, 30))


def main() -> None:
    """Print what the pipeline finds of what the model says is there, by range."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenarios", nargs="*", default=["paper", "standing", "stopped", "cargo", "parked", "empty"])
    parser.add_argument("--quality", default="demo")
    options = parser.parse_args()
    rows: list[dict[str, float]] = []
    columns: list[tuple[float, float, float, float]] = []
    steps: list[tuple[float, float]] = []
    for scenario in options.scenarios:
        for seed in range(options.seeds):
            for result, model in frames(scenario, 9000 + seed, options.quality):
                rows += compare(result, model)
                columns += compare_columns(result, model)
                if result.ego is not None and result.ego.T_now_before is not None:
                    T = result.ego.T_now_before
                    steps.append((T[2, 3] / (-SPEED_MPS * FRAME_S) - 1, (T[0, 2] - T[2, 0]) / 2))
    print(json.dumps(summary(rows, np.array(columns), np.array(steps)), indent=1))


def frames(scenario: str, seed: int, quality: str) -> list[tuple[FrameResult, Observed]]:
    """Return the results of a drive straight on until something is very near, and what the exact model says."""
    rig, challenge = small_rig(), CHALLENGES[scenario](seed)
    look, twin = rendered(rig, seed, quality), plan_rectification(rig)
    car, found, rng = CarState(*challenge.start_m, 0.0, SPEED_MPS), [], np.random.default_rng(0)
    for index in range(35):
        t_s = index * FRAME_S
        model = observe(challenge.things_at(t_s), challenge.scene.road, car, twin, rng, EXACT)
        ahead = [o.range_m for o in model.obstacles if abs(o.position_m[1]) < 1.5]
        if min(ahead, default=np.inf) < 2.5:
            break
        result = look(challenge, t_s, car)[1]
        assert result is not None
        found.append((result, model))
        car = replace(car, x_m=car.x_m + SPEED_MPS * FRAME_S)
    return found


def compare(result: FrameResult, model: Observed) -> list[dict[str, float]]:
    """Return one row per thing of the model: its range, and errors of what was found of it (NaN = missed)."""
    seen = [o for o in result.obstacles if o.track is None or o.track.coasted_s == 0]
    record = frame_record(replace(result, obstacles=tuple(seen)))["obstacles"]
    things = [{"box_px": o.box_px, "range_m": o.range_m} for o in model.obstacles]
    rows = []
    for thing, index in zip(model.obstacles, pair_up(record, things), strict=True):
        row = {"range_m": thing.range_m, "d_px": np.nan, "left_px": np.nan, "right_px": np.nan, "sigma_px": np.nan}
        if index is not None:
            o = seen[index]
            row["d_px"] = o.uvd_px[2] * 0 + FB / o.range_m - FB / thing.range_m
            row |= {"left_px": o.box_px[0] - thing.box_px[0], "right_px": o.box_px[2] - thing.box_px[2]}
            row["sigma_px"] = float(np.sqrt(o.cov_uvd_px2[2, 2]))
        rows.append(row)
    return rows


FB = small_rig().left.fx_px * small_rig().baseline_m


def compare_columns(result: FrameResult, model: Observed) -> list[tuple[float, float, float, float]]:
    """Return per column of the model: its range, whether blocked, the pipeline's range there, and whether blocked."""
    free, exact = result.free_space, model.free_space
    assert exact.is_blocked is not None
    assert free.is_blocked is not None
    at = np.clip(np.searchsorted(free.u_px, exact.u_px), 0, len(free.u_px) - 1)
    return list(zip(exact.range_m, exact.is_blocked, free.range_m[at], free.is_blocked[at], strict=True))


def spread(values: np.ndarray) -> list[float]:
    """Return median and a robust standard deviation."""
    values = values[np.isfinite(values)]
    if len(values) < 5:
        return [float("nan")] * 2
    low, middle, high = np.percentile(values, [16, 50, 84])
    return [round(float(middle), 3), round(float(high - low) / 2, 3)]


def summary(rows: list[dict[str, float]], columns: np.ndarray, steps: np.ndarray) -> dict[str, object]:
    """Return the figures by range band."""
    table: dict[str, object] = {}
    for low, high in BANDS_M:
        mine = [row for row in rows if low <= row["range_m"] < high]
        at = columns[(columns[:, 0] >= low) & (columns[:, 0] < high) & (columns[:, 1] > 0)]
        off = FB / at[:, 2] - FB / at[:, 0]
        table[f"{low}-{high} m"] = {
            "things": len(mine),
            "missed": round(float(np.mean([np.isnan(row["d_px"]) for row in mine] or [np.nan])), 3),
            **{
                key: spread(np.array([row[key] for row in mine])) for key in ("d_px", "left_px", "right_px", "sigma_px")
            },
            "d_rms_px": round(float(np.sqrt(np.nanmean([row["d_px"] ** 2 for row in mine] or [np.nan]))), 3),
            "columns": len(at),
            "blocked_too": round(float(np.mean(at[:, 3] > 0)), 3) if len(at) else None,
            "column_d_px": spread(off[at[:, 3] > 0]),
            "late_by_2px": round(float(np.mean(off < -2)), 3) if len(at) else None,
            "early_by_2px": round(float(np.mean(off > 2)), 3) if len(at) else None,
            "unknown": round(float(np.mean(np.isnan(at[:, 2]))), 3) if len(at) else None,
        }
    open_ = columns[columns[:, 1] == 0]
    table["open columns"] = {
        "n": len(open_),
        "reach_m": np.round(np.nanpercentile(open_[:, 2], [5, 16, 50, 84]), 1).tolist(),
        "falsely_blocked": round(float(np.mean((open_[:, 3] > 0) & (open_[:, 2] < 20))), 4),
        "unknown": round(float(np.mean(np.isnan(open_[:, 2]))), 4),
    }
    table["own motion"] = {"step_share": spread(steps[:, 0]), "turn_rad": spread(steps[:, 1])}
    return table


if __name__ == "__main__":
    main()
