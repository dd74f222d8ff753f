"""A rendered calibration set on disk: what a person would have taken, and what is true in it."""

import json
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import roadblock
from roadblock.errors import OutputError
from roadblock.sim.boards import calibration_poses, render_board
from roadblock.sim.drive import plain
from roadblock.sim.sensor import SIDES
from roadblock.values.board import Board
from roadblock.values.camera import StereoRig
from roadblock.values.frame import Image

TRUTH = "truth.json"
TRUTH_SCHEMA = 1
"""Version of the record."""


def record_boards(rig: StereoRig, board: Board, out: Path, views: int, seed: int, bow_m: float) -> Iterator[int]:
    """Write pictures of a board before both cameras; yield the number of pairs that are there, first 0.

    The folder then holds `left/` and `right/` (PNG) and, written last, `truth.json`: the board, its bow, and its pose
    in every view. The same arguments give the same bytes.

    Parameters
    ----------
    rig, board, bow_m
        As in `render_board`.
    out
        A new or empty folder.
    views
        How many pairs.
    seed
        Of poses, light, background and noise.

    Raises
    ------
    OutputError
        If the folder holds something, or cannot be written.
    ValueRefusedError
        As `calibration_poses` and `render_board`.
    """
    poses = calibration_poses(rig, board, np.random.default_rng([seed, 0]), views)
    _prepare(out)
    yield 0
    names = [f"{index:02d}" for index in range(views)]
    for index, (name, T_left_board) in enumerate(zip(names, poses, strict=True)):
        pair = render_board(rig, board, T_left_board, np.random.default_rng([seed, 1, index]), bow_m=bow_m)
        for side in SIDES:
            _write(out / side / f"{name}.png", _png(pair.left if side == "left" else pair.right))
        yield index + 1
    truth = {
        "schema": TRUTH_SCHEMA,
        "version": roadblock.__version__,
        "seed": seed,
        "board": {name: value for name, value in plain(board).items() if value not in ("", "nan")},
        "bow_m": bow_m,
        "views": [{"name": name, "T_left_board": T.tolist()} for name, T in zip(names, poses, strict=True)],
    }
    _write(out / TRUTH, (json.dumps(truth, indent=1, allow_nan=False) + "\n").encode())


def _prepare(out: Path) -> None:
    try:
        for side in SIDES:
            (out / side).mkdir(parents=True, exist_ok=True)
        held = sorted(path.name for path in (*out.iterdir(), *(out / "left").iterdir(), *(out / "right").iterdir()))
    except OSError as error:
        raise OutputError(_cannot_write(out, error)) from error
    if held != ["left", "right"]:
        other = next(name for name in held if name not in SIDES)
        raise OutputError(f"{out} holds {other} already: choose a new folder with --out")


def _png(image: Image) -> bytes:
    done, data = cv2.imencode(".png", image)
    assert done, "a grey image of 8 bit can always be written as PNG"  # noqa: S101
    return data.tobytes()


def _write(path: Path, data: bytes) -> None:
    try:
        path.write_bytes(data)
    except OSError as error:
        raise OutputError(_cannot_write(path, error)) from error


def _cannot_write(path: Path, error: OSError) -> str:
    return f"cannot write {error.filename or path}: {error.strerror or error}; choose another folder, or free this one"
