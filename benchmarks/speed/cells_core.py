"""Time the cell matcher against OpenCV: `python benchmarks/speed/cells_core.py [DATA] [--rounds N] [--save]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds kitti2015. One thread; all rows work on the same frames, cut to
1242x375, in one process and in turns; the median of all rounds counts, in CPU time, since cores may be shared. From
half-resolution images to disparities without speckles. `NUMBA_CPU_NAME` and `NUMBA_CPU_FEATURES` force another target.
"""

import os
import sys
from collections.abc import Callable
from pathlib import Path
from time import thread_time

import cv2
import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "accuracy"))
from cells import halve, read_frames
from record import save

from roadblock.stages.match import MatchSettings, match_bm, match_sgbm
from roadblock.stages.match.cells import CellMatcher, CellSettings

FRAMES = 4
WIDTH, HEIGHT = 1242, 375


def measure(folder: Path, rounds: int) -> list[list[str]]:
    """Return rows of (what, median CPU ms, how many times as fast as StereoBM, and as SGBM 3-way)."""
    cv2.setNumThreads(1)
    bm = MatchSettings(block_px=15)
    matchers: dict[str, Callable[..., object]] = {
        "StereoBM, 128, block 15": lambda left, right: match_bm(left, right, bm),
        "SGBM 3-way, 128": lambda left, right: match_sgbm(left, right, MatchSettings(mode="3way")),
    }
    for width in (8, 4):
        for n in (64, 128, 256):
            matcher = CellMatcher(CellSettings(cell_width_px=width, disparities=n))
            matchers[f"cells {width}x4, {n}"] = lambda left, right, matcher=matcher: matcher(left, right)
    frames = list(read_frames(folder))[:FRAMES]
    full = [[np.ascontiguousarray(i[:HEIGHT, :WIDTH]) for i in frame[:2]] for frame in frames]
    half = [[halve(image) for image in pair] for pair in full]
    times: dict[str, list[float]] = {what: [] for what in matchers}
    for i in range(rounds + 1):
        for what, matcher in matchers.items():
            pair = (half if what.startswith("cells") else full)[i % FRAMES]
            start = thread_time()
            matcher(*pair)
            times[what].append(1e3 * (thread_time() - start))
    ms = {what: float(np.median(t[1:])) for what, t in times.items()}
    first, second = list(ms.values())[:2]
    return [[what, f"{t:.2f}", f"{first / t:.1f}", f"{second / t:.1f}"] for what, t in ms.items()]


def main() -> None:
    """Measure, print, and save with --save."""
    rounds = int(sys.argv[sys.argv.index("--rounds") + 1]) if "--rounds" in sys.argv else 40
    folders = [a for a in sys.argv[1:] if not a.startswith("--") and not a.isdigit()]
    data = Path(folders[0] if folders else os.environ.get("ROADBLOCK_DATA", "../shared/data"))
    rows = measure(data / "kitti2015", rounds)
    for row in rows:
        print(*(f"{cell:26}" for cell in row))
    if "--save" in sys.argv:
        cpu = numba.config.CPU_NAME or "native"
        columns = ["what", "CPU ms", "x StereoBM", "x SGBM 3-way"]
        notes = f"{WIDTH}x{HEIGHT}, one thread, target {cpu}. Half-resolution images to disparities without speckles."
        save("cells_core", "python benchmarks/speed/cells_core.py --save", columns, rows, notes)


if __name__ == "__main__":
    main()
