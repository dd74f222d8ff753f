"""Try the self-check on simulated drives: `python benchmarks/accuracy/selfcheck.py [--frames N] [--seeds N]`.

Every drive is rendered once with the true rig (raw images, distorted lenses, cameras turned against each other) and
checked twice: with that rig, where no alarm may be raised, and with a rig whose right camera is turned by 0.02 deg of
yaw (one way for even seeds, the other for odd ones), which must be found at 3 sigma within 30 frames. A full run takes
about half an hour on two idle cores; with options (`--scenes A,B` is one, too) nothing is saved.
"""

import argparse
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.uncertainty import moved_rig
from roadblock.sim.conditions import combined
from roadblock.sim.photograph import photograph
from roadblock.sim.scenes import SCENES
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.stages.selfcheck import RigMonitor
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.drift import RigDrift
from roadblock.values.frame import StereoPair

YAW_DEG = 0.02
JUDGED = 30
"""The frame by which the offset must be found."""
FPS = 10.0


@dataclass
class Check:
    """One monitor on its way."""

    rig: StereoRig
    drifts: list[RigDrift] = field(default_factory=list)
    cpu_ms: list[float] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.rectification = plan_rectification(self.rig)
        self.monitor = RigMonitor(self.rig)

    def see(self, pair: StereoPair) -> None:
        """Rectify a pair and take it in."""
        rectified = rectify(pair, self.rectification, self.rig.left.size_px)
        start = time.thread_time()
        self.drifts.append(self.monitor.update(rectified))
        self.cpu_ms.append(1e3 * (time.thread_time() - start))


def true_rig() -> StereoRig:
    """Return a rig like the paper's, with lenses and mounting as real ones have them."""
    left = Camera((1280, 720), 1033, 1031, 652.3, 347.6, "brown_conrady", np.array([-0.28, 0.09, 6e-4, -4e-4, -0.01]))
    right = Camera(
        (1280, 720), 1029, 1028, 641.1, 355.2, "brown_conrady", np.array([-0.275, 0.085, -5e-4, 3e-4, -0.008])
    )
    return StereoRig(left, right, pose(rotation_from_rotvec([0.004, -0.007, 0.005]), [0.205, 0.0011, -0.0007]))


def yawed(rig: StereoRig, yaw_deg: float) -> StereoRig:
    """Return the rig whose right camera is turned."""
    delta = np.zeros(len(rig.left.parameters) + len(rig.right.parameters) + 6)
    delta[-5] = np.radians(yaw_deg)
    return moved_rig(rig, delta)


def drive(name: str, seed: int, frames: int) -> tuple[Check, Check, float]:
    """Return the healthy check, the one with an offset, and that offset (what the images show by the wrong rig)."""
    rig, scene = true_rig(), SCENES[name](seed)
    offset = YAW_DEG if seed % 2 == 0 else -YAW_DEG
    healthy, off = Check(rig), Check(yawed(rig, -offset))
    effects = combined(scene.conditions)
    for index in range(frames):
        pair = photograph(scene.at(index / FPS), rig, effects, seed=seed, index=index, t_ns=int(1e9 * index / FPS)).pair
        healthy.see(pair)
        off.see(pair)
    return healthy, off, offset


def row_of(name: str, seed: int, healthy: Check, off: Check, offset: float) -> list[str]:
    """Return one line of the table."""
    last, at = healthy.drifts[-1], off.drifts[min(JUDGED, len(off.drifts)) - 1]
    moved = [i for i, d in enumerate(off.drifts, 1) if d.state == "moved"]
    return [
        f"{name} {seed}",
        str(sum(d.state == "moved" for d in healthy.drifts)),
        last.state,
        f"{last.yaw_deg:+.4f} ± {last.yaw_sigma_deg:.4f}",
        f"{offset:+.2f}",
        f"{at.yaw_deg:+.4f} ± {at.yaw_sigma_deg:.4f}",
        f"{abs(at.yaw_deg) / at.yaw_sigma_deg:.1f}",
        str(moved[0]) if moved else "-",
        f"{np.mean(healthy.cpu_ms):.0f}",
    ]


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=34)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--scenes", default=",".join(SCENES))
    options = parser.parse_args()
    rows, frames, alarms, z, found = [], 0, 0, [], []
    for name in options.scenes.split(","):
        for seed in range(options.seeds):
            healthy, off, offset = drive(name, seed, options.frames)
            rows.append(row_of(name, seed, healthy, off, offset))
            print(*rows[-1], sep=" | ", flush=True)
            frames += len(healthy.drifts)
            alarms += sum(d.state == "moved" for d in healthy.drifts)
            last, at = healthy.drifts[-1], off.drifts[min(JUDGED, len(off.drifts)) - 1]
            z += [last.yaw_deg / last.yaw_sigma_deg] if last.motions >= 3 else []
            found += [abs(at.yaw_deg) >= 3 * at.yaw_sigma_deg] if at.motions >= 3 else []
    notes = (
        f"{alarms} alarms in {frames} healthy frames. {len(found)} of {len(rows)} drives gave enough evidence by frame "
        f"{JUDGED}; {sum(found)} of these found {YAW_DEG} deg at 3 sigma. Healthy yaw over its own sigma: rms "
        f"{np.sqrt(np.mean(np.square(z))):.2f}, {np.mean(np.abs(z) < 1):.0%} within 1, {np.mean(np.abs(z) < 2):.0%} "
        "within 2."
    )
    print(notes)
    if len(sys.argv) == 1:
        columns = [
            "drive",
            "alarms",
            "state",
            "yaw, deg",
            "offset",
            "found, deg",
            "sigmas",
            "alarm at frame",
            "CPU ms a frame",
        ]
        save("selfcheck", "python benchmarks/accuracy/selfcheck.py", columns, rows, notes)


if __name__ == "__main__":
    main()
