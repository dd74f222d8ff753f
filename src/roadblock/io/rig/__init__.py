"""Rig files: one stereo rig from, or to, one file or two; the content tells the format, not the name."""

import re
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from roadblock.errors import RigError
from roadblock.io.rig.boofcv import read_boofcv
from roadblock.io.rig.describe import describe_rig
from roadblock.io.rig.files import Asked, named, read_text, write_whole
from roadblock.io.rig.kalibr import read_kalibr, write_kalibr
from roadblock.io.rig.kitti import (
    read_kitti_object,
    read_kitti_odometry,
    read_kitti_raw,
    read_object,
    read_odometry,
    read_raw,
)
from roadblock.io.rig.native import read_native, write_native
from roadblock.io.rig.numbers import by, size
from roadblock.io.rig.opencv import read_opencv, write_opencv
from roadblock.io.rig.ros import read_ros, write_ros
from roadblock.io.rig.zed import read_zed
from roadblock.values.camera import StereoRig

__all__ = [
    "READERS",
    "WRITERS",
    "describe_rig",
    "read_kitti_object",
    "read_kitti_odometry",
    "read_kitti_raw",
    "read_rig",
    "write_rig",
]

READERS: dict[str, Callable[[tuple[str, ...], Asked], StereoRig]] = {
    "roadblock": read_native,
    "opencv": read_opencv,
    "ros": read_ros,
    "kalibr": read_kalibr,
    "kitti_object": read_object,
    "kitti_odometry": read_odometry,
    "kitti_raw": read_raw,
    "zed": read_zed,
    "boofcv": read_boofcv,
}
"""Format -> function of the texts of its files and what the caller adds."""

WRITERS: dict[str, Callable[[StereoRig], dict[str, str]]] = {
    "roadblock": write_native,
    "opencv": write_opencv,
    "ros": write_ros,
    "kalibr": write_kalibr,
}
"""Format -> function that returns the texts by file name; the name "" is the path itself, others lie in it."""

_P: set[str] = {"P0", "P1", "P2", "P3"}
_OBJECT: set[str] = {"R0_rect", "R_rect", "Tr_velo_to_cam", "Tr_velo_cam"}
_BARE_ROW = re.compile(r"\s*([-+.\deE]+[ \t]+){11}[-+.\deE]+[ \t]*\r?\n")

MARKS: dict[str, tuple[str, Callable[[str, set[str]], bool]]] = {
    "roadblock": ("roadblock_rig:", lambda _, names: "roadblock_rig" in names),
    "opencv": ("%YAML or !!opencv-matrix", lambda text, _: text.startswith("%YAML") or "!!opencv-" in text),
    "ros": ("camera_matrix: and distortion_model:", lambda _, names: {"camera_matrix", "distortion_model"} <= names),
    "kalibr": ("cam0:", lambda _, names: "cam0" in names),
    "kitti_object": ("P2: and R0_rect:", lambda _, names: bool(_P & names and _OBJECT & names)),
    "kitti_odometry": (
        "P0: without R0_rect:, or rows of 12 numbers",
        lambda text, names: bool(_P & names and not _OBJECT & names) or _BARE_ROW.match(text) is not None,
    ),
    "kitti_raw": ("K_00: or K_02:", lambda _, names: bool({"K_00", "K_02"} & names)),
    "zed": ("[LEFT_CAM_...]", lambda text, _: "[LEFT_CAM_" in text),
    "boofcv": ("rightToLeft:", lambda _, names: "rightToLeft" in names),
}
"""Format -> what tells it, in words, and as a test of a file's text and the names that start its lines."""

PAIRS_IN_FOLDER = tuple(
    (f"{first}{suffix}", f"{second}{suffix}")
    for first, second in (("left", "right"), ("intrinsics", "extrinsics"))
    for suffix in (".yaml", ".yml")
)
"""File names of two-file formats, looked for where a folder is given."""

TWO_FILES = ("opencv", "ros")


def read_rig(
    path: Path | str,
    *,
    format: str | None = None,  # noqa: A002 - the word the command line has for it
    unit_m: float = 1.0,
    right: Path | None = None,
    size_px: tuple[int, int] | None = None,
    pair: tuple[int, int] | None = None,
) -> StereoRig:
    """Read a stereo rig of any known format.

    Parameters
    ----------
    path
        A rig file, or a folder with the two files of one (see `PAIRS_IN_FOLDER`).
    format
        A name of `READERS`; None looks into the file.
    unit_m
        Metres per unit of the file's lengths, on top of the format's own unit (ZED: mm; all others: m).
    right
        The second file of a two-file format: the right camera's, or OpenCV's extrinsics.
    size_px
        (width, height) of the images: needed where the file has none, chooses where it has several, and must agree
        where it has one.
    pair
        Numbers of the left and right camera, for KITTI files of four cameras.

    Returns
    -------
    The rig; rectified if the file describes rectified images.

    Raises
    ------
    RigError
        If the files cannot be read, are of no known format or of several, or cannot be trusted. The message starts
        with the files' names.
    """
    paths = _paths(Path(path), right)
    with named(paths):
        if not (np.isfinite(unit_m) and unit_m > 0):
            raise RigError(f"unit_m must be finite and > 0, but got {unit_m}")
        size_px = None if size_px is None else size("size_px", size_px)
        texts = tuple(map(read_text, paths))
        name = _recognised(texts) if format is None else _known(format, READERS)
        if len(texts) > 1 and name not in TWO_FILES:
            raise RigError(f"format {name} is one file, but two were given")
        rig = READERS[name](texts, Asked(unit_m, size_px, pair))
        if size_px is not None and rig.left.size_px != size_px:
            raise RigError(
                f"is for images of {by(rig.left.size_px)}, but these are {by(size_px)}: calibrate at that size"
            )
        return rig


def write_rig(rig: StereoRig, path: Path | str, format: str | None = None) -> list[Path]:  # noqa: A002 - as above
    """Write a rig, replacing what was there; each file appears whole or not at all.

    Parameters
    ----------
    rig
        The rig.
    path
        The file; for "ros" the folder of `left.yaml` and `right.yaml`, made if need be.
    format
        A name of `WRITERS`; None is our own, "roadblock".

    Returns
    -------
    The files written.

    Raises
    ------
    RigError
        If there is no such format or it has no room for a lens or the mounting.
    OutputError
        If a file cannot be written.
    """
    path = Path(path)
    name = _known(format or "roadblock", WRITERS)
    with named((path,)):
        texts = WRITERS[name](rig)
        if "" not in texts and (path.suffix in (".yaml", ".yml") or path.is_file()):
            raise RigError(f"format {name} is two files, {' and '.join(texts)}: name a folder for them")
    return write_whole({path / file if file else path: text for file, text in texts.items()})


def _paths(path: Path, right: Path | None) -> tuple[Path, ...]:
    if right is not None:
        return path, Path(right)
    if not path.is_dir():
        return (path,)
    found = [pair for pair in PAIRS_IN_FOLDER if all((path / name).is_file() for name in pair)]
    names = "; ".join(" + ".join(pair) for pair in (found or PAIRS_IN_FOLDER))
    if not found:
        raise RigError(f"{path.name or path}: is a folder without a pair of rig files ({names}): name the file")
    if len(found) > 1:
        raise RigError(f"{path.name or path}: holds several pairs of rig files ({names}): name the files")
    return path / found[0][0], path / found[0][1]


def _known(format_: str, table: Mapping[str, object]) -> str:
    if format_ not in table:
        near = get_close_matches(format_, table, 1)
        hint = f"did you mean {near[0]}? " if near else ""
        raise RigError(f"{format_!r:.40} is no format here; {hint}known: {', '.join(table)}")
    return format_


def _recognised(texts: tuple[str, ...]) -> str:
    found = [name for name, (_, test) in MARKS.items() if all(test(text, _names(text)) for text in texts)]
    if len(found) > 1:
        raise RigError(f"may be {' or '.join(found)}: say which with --format")
    if not found:
        marks = "; ".join(f"{name} ({words})" for name, (words, _) in MARKS.items())
        raise RigError(f"is no rig file known here, or two different ones; looked for {marks}")
    return found[0]


def _names(text: str) -> set[str]:
    return set(re.findall(r"^(\w+)[ \t]*:", text, re.MULTILINE))
