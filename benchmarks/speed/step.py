"""Time the whole step and its stages against OpenCV's matchers: `python benchmarks/speed/step.py [DATA] [--quick]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) may hold kitti2015, whose frames are those of 1242x375; all others are
rendered. Every size and search range is a race of its own: StereoBM, SGBM and our steps take turns on the same grey
frames, and the median of their turns counts. One thread is timed in CPU time, so that a shared core does not count; two
threads by the clock. OpenCV's matchers get rectified images for nothing; ours begin with raw ones, of a rig turned by
`TURN_RAD`, and end with obstacles: `step cells` and `step fast` with `recognize.recognizer=none`, `recognized` with the
default, and `refined` with `refine.level=fast` besides.

`--quick` runs 1242x375 with 128 disparities only, and saves nothing. `--native` leaves out the lesser processors.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter, thread_time
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import RESULTS, save

from roadblock.config import load_settings
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.sources import open_source
from roadblock.kernels.gray import gray8
from roadblock.pipeline import Pipeline
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street
from roadblock.stages.match import MatchSettings, match_bm, match_sgbm
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.frame import StereoPair

SIZES = ((640, 360), (1242, 375), (1280, 720), (1920, 1080))
KITTI = (1242, 375)
DISPARITIES = (64, 128, 256)
STAGED = (KITTI, (1280, 720))
"""Sizes whose stages are told one by one, at 128 disparities."""
TARGETS = {
    "avx2": ("haswell", "+avx2,+avx,+bmi,+popcnt,+sse4.2,+sse4.1,+ssse3,+sse3"),
    "sse2": ("x86-64", "+sse2"),
}
"""Lesser processors, as `NUMBA_CPU_NAME` and `NUMBA_CPU_FEATURES`: at 1242x375, 128 disparities."""
TURN_RAD = 1e-4
FRAMES = 3
LEAST_ROUNDS, MOST_ROUNDS, BUDGET_S = 5, 40, 4.0
"""Turns of a race: as many as fit into the budget."""
SLOW_EVERY = 5
"""SGBM HH4 takes only one turn of so many."""
BM, SGBM, HH4 = "StereoBM, block 15", "SGBM 3-way", "SGBM HH4"

Size = tuple[int, int]
Row = dict[str, Any]
Scene = tuple[StereoRig, list[StereoPair]]


def read_scene(size: Size, data: Path) -> Scene:
    """Return the rig and the grey frames of one size."""
    if size == KITTI and (data / "kitti2015").is_dir():
        source = open_source(data / "kitti2015")
        rig, pairs = source.rig, (pair for pair in source if pair.left.shape[1::-1] == size)
    else:
        width, height = size
        f_px = 1033 / 1280 * width
        camera = Camera(size, f_px, f_px, 0.51 * width, 0.49 * height)
        rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
        pairs = (render(demo_street(seed), rig, quality="preview", seed=seed).pair for seed in range(FRAMES))
    frames = [StereoPair(*gray8(pair.left, pair.right)) for pair, _ in zip(pairs, range(FRAMES), strict=False)]
    turned = pose(rotation_from_rotvec([0, TURN_RAD, 0]), rig.T_left_right[:3, 3])
    return replace(rig, T_left_right=turned), frames


def racers(rig: StereoRig, disparities: int) -> dict[str, Callable[[StereoPair], dict[str, float]]]:
    """Return who takes turns: functions of a frame that return milliseconds per stage, if they have stages."""
    bm = MatchSettings(disparities=disparities, block_px=15)
    way3, hh4 = MatchSettings(disparities=disparities, mode="3way"), MatchSettings(disparities=disparities)

    def alone(
        matcher: Callable[..., NDArray[Any]], settings: MatchSettings
    ) -> Callable[[StereoPair], dict[str, float]]:
        return lambda pair: (matcher(pair.left, pair.right, settings), {})[1]

    def step(detector: str, *more: str) -> Callable[[StereoPair], dict[str, float]]:
        options = [f"detector={detector}", f"cells.disparities={disparities}", *more]
        pipeline = Pipeline(rig, load_settings(None, options))
        return lambda pair: pipeline.step(pair)[0].timings_ms

    matchers = {BM: alone(match_bm, bm), SGBM: alone(match_sgbm, way3), HH4: alone(match_sgbm, hh4)}
    kinds = {"": ("recognize.recognizer=none",), ", recognized": (), ", refined": ("refine.level=fast",)}
    steps = {f"step {name}{kind}": step(name, *more) for kind, more in kinds.items() for name in ("cells", "fast")}
    return matchers | steps


def race(scene: Scene, disparities: int, threads: int) -> tuple[dict[str, float], dict[str, float]]:
    """Return median milliseconds of each racer, and of each stage (by the clock) of the refined steps."""
    cv2.setNumThreads(threads)
    clock = thread_time if threads == 1 else perf_counter
    rig, frames = scene
    times: dict[str, list[float]] = {}
    stages: dict[str, list[float]] = {}
    runners = racers(rig, disparities)
    for run in runners.values():
        run(frames[0])
    begin = perf_counter()
    for i in range(MOST_ROUNDS):
        if i >= LEAST_ROUNDS and perf_counter() - begin > BUDGET_S:
            break
        for what, run in runners.items():
            if what == HH4 and i % SLOW_EVERY:
                continue
            start = clock()
            inner = run(frames[i % len(frames)])
            times.setdefault(what, []).append(1e3 * (clock() - start))
            for stage, ms in inner.items():
                if stage != "total" and what.endswith(", refined"):
                    stages.setdefault(f"{what[5:-9]}: {stage}", []).append(ms)
    return tuple({what: float(np.median(ms)) for what, ms in found.items()} for found in (times, stages))  # type: ignore[return-value]


def measure(
    sizes: tuple[Size, ...], disparities: tuple[int, ...], counts: tuple[int, ...], data: Path
) -> Iterator[Row]:
    """Yield the rows of all races, on the target that numba is told."""
    target = os.environ.get("ROADBLOCK_TARGET", "native")
    for size in sizes:
        scene = read_scene(size, data)
        for n in disparities:
            for threads in counts:
                times, stages = race(scene, n, threads)
                if threads == 1 and n == 128 and size in STAGED and target == "native":
                    times |= stages
                for what, ms in times.items():
                    yield {
                        "size": f"{size[0]}x{size[1]}",
                        "disparities": n,
                        "threads": threads,
                        "target": target,
                        "what": what,
                        "median_ms": round(ms, 3),
                        "ratio_to_stereobm": round(times[BM] / ms, 2),
                        "ratio_to_sgbm3way": round(times[SGBM] / ms, 2),
                    }


def measure_targets(data: Path) -> Iterator[Row]:
    """Yield the rows of lesser processors, each from a process of its own; OpenCV's code is as ever in all of them."""
    for name, (cpu, features) in TARGETS.items():
        told = {"NUMBA_CPU_NAME": cpu, "NUMBA_CPU_FEATURES": features, "ROADBLOCK_TARGET": name}
        command = [sys.executable, __file__, str(data), "--quick", "--json"]
        done = subprocess.run(command, env=os.environ | told, stdout=subprocess.PIPE, text=True, check=True)
        yield from json.loads(done.stdout)


def growth(rows: list[Row], what: str) -> float:
    """Return the exponent e of `ms ~ (pixels * disparities)^e`, fitted to one thread's rows."""
    chosen = [r for r in rows if (r["what"], r["threads"], r["target"]) == (what, 1, "native")]
    return float(np.polyfit(np.log([work(r) for r in chosen]), np.log([r["median_ms"] for r in chosen]), 1)[0])


def work(row: Row) -> float:
    """Return pixels times disparities."""
    width, height = map(int, row["size"].split("x"))
    return width * height * float(row["disparities"])


def draw(rows: list[Row], path: Path) -> None:
    """Plot one thread's times over pixels times disparities."""
    from matplotlib.figure import Figure

    figure = Figure((8, 5), layout="constrained")
    axes = figure.subplots()
    whats = dict.fromkeys(r["what"] for r in rows if ":" not in r["what"])
    for what in whats:
        mine = sorted(
            (work(r), r["median_ms"]) for r in rows if (r["what"], r["threads"], r["target"]) == (what, 1, "native")
        )
        axes.loglog(*zip(*mine, strict=True), "o-", label=what, markersize=4)
    axes.set(xlabel="pixels x disparities", ylabel="CPU ms, one thread")
    axes.grid(which="both", alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=110)


def main() -> None:
    """Measure, print, and save with the plot."""
    flags = {a for a in sys.argv[1:] if a.startswith("--")}
    folders = [a for a in sys.argv[1:] if not a.startswith("--")]
    data = Path(folders[0] if folders else os.environ.get("ROADBLOCK_DATA", "../shared/data"))
    quick = "--quick" in flags
    rows = []
    for row in measure(*(((KITTI,), (128,), (1,)) if quick else (SIZES, DISPARITIES, (1, 2))), data):
        rows.append(row)
        print(*(f"{cell!s:>12}" for cell in row.values()), file=sys.stderr, flush=True)
    if "--json" in flags:
        print(json.dumps(rows))
    if quick:
        return
    rows += [] if "--native" in flags else list(measure_targets(data))
    exponents = {
        what: round(growth(rows, what), 3) for what in dict.fromkeys(r["what"] for r in rows if ":" not in r["what"])
    }
    draw(rows, RESULTS / "speed.png")
    notes = (
        "![Times over pixels x disparities](benchmarks/results/speed.png)\n\n"
        "Ratios: how many times as fast as OpenCV's StereoBM (block 15) and SGBM 3-way on the same grey frames in "
        "the same turns. `step`: raw images to obstacles, with the rectification that OpenCV's rows are spared; "
        "`recognized`: with types, colours and contours, as by default; `refined`: with `refine.level=fast` besides; "
        "`cells: match` and the like are stages, by the clock. One thread in CPU ms, two by the clock."
        "\n\nCost grows with pixels x disparities to the power of "
        f"{', '.join(f'{e} ({what})' for what, e in exponents.items())}."
    )
    save("speed", "python benchmarks/speed/step.py", None, rows, notes, more={"growth_exponent": exponents})


if __name__ == "__main__":
    main()
