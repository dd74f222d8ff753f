"""Small synthetic recordings with known truth."""

import json
from pathlib import Path

import cv2
import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.rig import write_rig
from roadblock.sim.boards import calibration_poses, render_board
from roadblock.sim.drive import truth_record
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street
from roadblock.values.board import Board
from roadblock.values.camera import Camera, Lens, StereoRig


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


BOARD = Board("chessboard", 7, 5, 0.025)


def crooked_rig(size_px: tuple[int, int] = (320, 240)) -> StereoRig:
    """Two cameras with lenses that are alike but not equal, turned against each other about all axes."""
    lens: Lens = "brown_conrady"
    k = np.array([-0.12, 0.02, 0.0005, -0.0004, 0.0])
    width, height = size_px
    left = Camera(size_px, 0.94 * width, 0.935 * width, 0.494 * width, 0.506 * height, lens, k)
    right = Camera(size_px, 0.947 * width, 0.943 * width, 0.503 * width, 0.492 * height, lens, k)
    turn = rotation_from_rotvec([0.01, -0.012, 0.006])
    return StereoRig(left, right, pose(turn, [0.12, 0.001, -0.002]))


def record_boards(folder: Path, views: int, seed: int) -> Path:
    """Take pictures of a board as a careful person would hold it: `left/00.png`, `right/00.png`, ..."""
    rig, rng = crooked_rig(), np.random.default_rng(seed)
    for index, T_left_board in enumerate(calibration_poses(rig, BOARD, rng, views)):
        pair = render_board(rig, BOARD, T_left_board, rng, samples=16)
        for side, image in (("left", pair.left), ("right", pair.right)):
            (folder / side).mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(folder / side / f"{index:02d}.png"), image)
    return folder
