"""Measure what a step keeps in memory: `python benchmarks/speed/memory.py [--frames N]`. Linux only.

Peak: a process with its kernels compiled and its images loaded makes a pipeline of 1280x720, and steps. How far
resident memory is, at its highest while it steps, above what it was before the pipeline was made: maps, buffers,
rectified images and results together. Growth: how much more is resident after N (10,000) small frames than after the
first tenth of them.
"""

import os
import subprocess
import sys
from pathlib import Path

import cv2

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save
from step import read_scene

from roadblock.config import Settings
from roadblock.pipeline import Pipeline

MB = 1e6
NOWHERE = Path("nowhere")
"""No recordings: rendered frames only."""


def resident(what: str) -> float:
    """Return megabytes that are resident now (`VmRSS`), or were at most (`VmHWM`)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(what)) * 1024 / MB


def peak(detector: str) -> float:
    """Return megabytes by which a pipeline's steps rise above what was there before it."""
    (small_rig, small), (rig, pairs) = read_scene((320, 180), NOWHERE), read_scene((1280, 720), NOWHERE)
    Pipeline(small_rig, Settings(detector=detector)).step(small[0])
    before = resident("VmRSS")
    pipeline = Pipeline(rig, Settings(detector=detector))
    Path("/proc/self/clear_refs").write_text("5")  # the peak begins anew
    for pair in pairs * 3:
        pipeline.step(pair)
    return resident("VmHWM") - before


def grown(detector: str, frames: int) -> float:
    """Return megabytes by which memory grows over the last nine tenths of many frames."""
    rig, pairs = read_scene((320, 180), NOWHERE)
    pipeline, early = Pipeline(rig, Settings(detector=detector)), 0.0
    for i in range(frames):
        if i == frames // 10:
            early = resident("VmRSS")
        pipeline.step(pairs[i % len(pairs)])
    return resident("VmRSS") - early


def main() -> None:
    """Measure each figure in a process of its own, print and save."""
    cv2.setNumThreads(1)
    frames = int(sys.argv[sys.argv.index("--frames") + 1]) if "--frames" in sys.argv else 10_000
    if "--measure" in sys.argv:
        what, detector = sys.argv[sys.argv.index("--measure") + 1 :][:2]
        print(peak(detector) if what == "peak" else grown(detector, frames))
        return
    rows = []
    for what, words in (
        ("peak", "peak above the images, 1280x720"),
        ("growth", f"growth over {frames} frames, 320x180"),
    ):
        for detector in ("cells", "fast"):
            command = [sys.executable, __file__, "--frames", str(frames), "--measure", what, detector]
            megabytes = float(
                subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True, env=os.environ).stdout
            )
            rows.append([detector, words, f"{megabytes:.1f}", "<= 64" if what == "peak" else "0"])
            print(*(f"{cell:34}" for cell in rows[-1]))
    save("memory", "python benchmarks/speed/memory.py", ["detector", "what", "MB", "bar"], rows)


if __name__ == "__main__":
    main()
