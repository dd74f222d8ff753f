"""Small synthetic recordings with known truth."""

import json
from pathlib import Path

import cv2
import numpy as np

from roadblock.geometry.pose import pose
from roadblock.io.rig import write_rig
from roadblock.sim.drive import truth_record
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street
from roadblock.values.camera import Camera, StereoRig


def paper_rig_of_width(width: int) -> StereoRig:
    """The paper's cameras with larger pixels."""
    scale = width / 1280
    size_px = (width, round(720 * scale))
    camera = Camera(size_px, 1033 * scale, 1033 * scale, 0.51 * width, 0.49 * size_px[1])
    return StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))


def record_street(folder: Path, width: int, frames: int) -> Path:
    """Render the demo street, once per frame with other textures and noise, and save it as `detect` opens it."""
    rig, truth = paper_rig_of_width(width), []
    for index in range(frames):
        street = render(demo_street(index), rig, quality="preview", seed=index, index=index, name=f"{index:06d}")
        for side, image in (("left", street.pair.left), ("right", street.pair.right)):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{index:06d}.png"), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        truth.append(json.dumps(truth_record(street)))
    (folder / "truth.jsonl").write_text("\n".join(truth) + "\n")
    write_rig(rig, folder / "rig.yaml")
    return folder
