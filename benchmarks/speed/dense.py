"""Time each stage of the `dense` pipeline against OpenCV's matchers: `python benchmarks/speed/dense.py [--rounds N]`.

All rows work on the same pair (the synthetic street, 1280x720, 128 disparities) in one process, in turns; the median of
the rounds counts. Ratios are to OpenCV's StereoBM alone. The figures go to `benchmarks/results/` and BENCHMARK.md.
"""

import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.config import load_settings
from roadblock.kernels.gray import gray8
from roadblock.pipeline import Pipeline
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street, paper_rig
from roadblock.stages.match import MatchSettings, match_bm, match_sgbm


def time_once(work: Callable[[], object]) -> float:
    """Return milliseconds of one call."""
    start = perf_counter()
    work()
    return 1e3 * (perf_counter() - start)


def measure(threads: int, rounds: int) -> list[list[str]]:
    """Return rows of (threads, what, ms, ratio)."""
    cv2.setNumThreads(threads)
    pair = render(demo_street(), paper_rig(), quality="demo").pair
    left, right = gray8(pair.left, pair.right)
    settings = MatchSettings()
    matchers = {
        "StereoBM, block 15": (match_bm, settings.model_copy(update={"block_px": 15})),
        "SGBM 3-way": (match_sgbm, settings.model_copy(update={"mode": "3way"})),
        "SGBM HH4": (match_sgbm, settings),
    }
    pipelines = {
        f"pipeline, dense ({name})": Pipeline(paper_rig(), load_settings(None, options))
        for name, options in (("SGBM HH4, default", []), ("BM", ["match.matcher=bm", "match.block_px=15"]))
    }
    times: dict[str, list[float]] = {}
    for _ in range(rounds + 1):
        for what, (matcher, chosen) in matchers.items():
            run = lambda matcher=matcher, chosen=chosen: matcher(left, right, chosen)  # noqa: E731
            times.setdefault(what, []).append(time_once(run))
        for what, pipeline in pipelines.items():
            start = perf_counter()
            result, _ = pipeline.step(pair)
            times.setdefault(what, []).append(1e3 * (perf_counter() - start))
            for stage, ms in result.timings_ms.items():
                if what.endswith("default)") and stage != "total":
                    times.setdefault(f"- its stage {stage}", []).append(ms)
    unit = float(np.median(times["StereoBM, block 15"][1:]))
    medians = {what: float(np.median(ms[1:])) for what, ms in times.items()}
    return [[str(threads), what, f"{ms:.1f}", f"{ms / unit:.2f}"] for what, ms in medians.items()]


def main() -> None:
    """Measure with one thread and with two, print, save."""
    rounds = int(sys.argv[sys.argv.index("--rounds") + 1]) if "--rounds" in sys.argv else 15
    rows = [row for threads in (1, 2) for row in measure(threads, rounds)]
    for row in rows:
        print(*(f"{cell:34}" for cell in row))
    save(
        "speed_dense",
        "python benchmarks/speed/dense.py",
        ["threads", "what", "median ms", "times StereoBM"],
        rows,
        "1280x720, 128 disparities, one pair of the synthetic street. Two shared cores: read the ratios.",
    )


if __name__ == "__main__":
    main()
