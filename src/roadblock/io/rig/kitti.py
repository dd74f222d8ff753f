"""KITTI's calibration texts: object, stereo 2015 and road, odometry, and raw `calib_cam_to_cam`. Reading only.

`P_i` projects points of the rectified camera 0, so camera i sits at `x = -P_i[0, 3] / P_i[0, 0]` there.
Cameras 0, 1 are the grey pair, 2, 3 the colour one.
"""

from pathlib import Path

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import inverse, pose
from roadblock.io.rig.files import Asked, entry, named, read_text
from roadblock.io.rig.numbers import by, camera, numbers, rotation, size
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray

Pair = tuple[int, int]
GREY, COLOR = (0, 1), (2, 3)


def read_kitti_object(path: Path | str, *, pair: Pair = COLOR, size_px: tuple[int, int] | None = None) -> StereoRig:
    """Return the rectified rig of an object, stereo 2015, road or (with names) odometry calibration text.

    Parameters
    ----------
    path
        A file with the lines `P0:` ... `P3:`.
    pair
        Numbers of the left and the right camera.
    size_px
        (width, height) of the images; the file has none.

    Raises
    ------
    RigError
        If the file cannot be read or trusted, or no size is given.
    """
    with named((Path(path),)):
        return read_object((read_text(Path(path)),), Asked(size_px=size_px, pair=pair))


def read_kitti_odometry(path: Path | str, *, pair: Pair = GREY, size_px: tuple[int, int] | None = None) -> StereoRig:
    """Return the rectified rig of an odometry `calib.txt`, with or without names.

    Parameters
    ----------
    path
        A file with the lines `P0:` ... `P3:`, or with two bare rows of 12 numbers, left and right.
    pair
        Numbers of the left and the right camera; two bare rows are taken as this pair.
    size_px
        (width, height) of the images; the file has none.

    Raises
    ------
    RigError
        If the file cannot be read or trusted, or no size is given.
    """
    with named((Path(path),)):
        return read_odometry((read_text(Path(path)),), Asked(size_px=size_px, pair=pair))


def read_kitti_raw(
    path: Path | str,
    *,
    pair: Pair | None = None,
    rectified: bool | None = None,
    size_px: tuple[int, int] | None = None,
) -> StereoRig:
    """Return the raw or the rectified rig of a `calib_cam_to_cam.txt`.

    Parameters
    ----------
    path
        The file.
    pair
        Numbers of the left and the right camera; may be left out where the file has one pair.
    rectified
        Whether the images are rectified; may be left out where `size_px` tells.
    size_px
        (width, height) of the images; must be the size that the file gives for the kind of images meant.

    Raises
    ------
    RigError
        If the file cannot be read or trusted, or which rig is meant stays open.
    """
    with named((Path(path),)):
        rig = _raw_rig(_lines(read_text(Path(path))), Asked(size_px=size_px, pair=pair), rectified)
        if size_px is not None and rig.left.size_px != tuple(size_px):
            kind, other = ("rectified", "raw") if rectified else ("raw", "rectified")
            raise RigError(f"{kind} images are {by(rig.left.size_px)}, but these are {by(size_px)}: are they {other}?")
        return rig


def read_object(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of a text with `P0:` ... `P3:`; the colour pair, unless another is asked for.

    Raises
    ------
    RigError, ValueRefusedError
        If a matrix is missing or cannot be true, or no size is given.
    """
    lines = _lines(texts[0])
    pair = asked.pair or COLOR
    left, right = (numbers(f"P{i}", entry(lines, f"P{i}"), (12,)).reshape(3, 4) for i in pair)
    return _rectified_rig(left, right, asked)


def read_odometry(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of an odometry text, with names or as two bare rows; the grey pair, unless another is asked for.

    Raises
    ------
    RigError, ValueRefusedError
        If a matrix is missing or cannot be true, or no size is given.
    """
    if ":" in texts[0]:
        return read_object(texts, Asked(asked.unit_m, asked.size_px, asked.pair or GREY))
    rows = [line.split() for line in texts[0].splitlines() if line.strip()]
    if len(rows) != 2:
        raise RigError(f"must hold two rows of 12 numbers, left and right, but holds {len(rows)} rows")
    left, right = (numbers(f"row {i + 1}", row, (12,)).reshape(3, 4) for i, row in enumerate(rows))
    return _rectified_rig(left, right, asked)


def read_raw(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of a `calib_cam_to_cam` text; the image size asked for tells raw from rectified.

    Raises
    ------
    RigError, ValueRefusedError
        If a line is missing or cannot be true, or which rig is meant stays open.
    """
    return _raw_rig(_lines(texts[0]), asked, None)


def _lines(text: str) -> dict[str, list[str]]:
    lines: dict[str, list[str]] = {}
    for line in filter(str.strip, text.splitlines()):
        key, colon, values = line.partition(":")
        if not colon:
            raise RigError(f"must hold lines 'NAME: numbers', but holds {line.strip()!r:.60}")
        if key.strip() in lines:
            raise RigError(f"says {key.strip()!r} more than once: keep one")
        lines[key.strip()] = values.split()
    return lines


def _rectified_rig(left: FloatArray, right: FloatArray, asked: Asked) -> StereoRig:
    if asked.size_px is None:
        raise RigError("says no image size (KITTI's files do not): give it with --size, like --size 1242x375")
    if not np.array_equal(left[:, :2], right[:, :2]) or left[1, 2] != right[1, 2]:
        raise RigError("both projection matrices must have the same focal lengths and row of the centre, but differ")
    twins = [camera(asked.size_px, P[:, :3], "pinhole", (), "P: ") for P in (left, right)]
    B = asked.unit_m * (left[0, 3] - right[0, 3]) / twins[0].fx_px
    return StereoRig(twins[0], twins[1], pose(np.eye(3), (B, 0, 0)))


def _raw_rig(lines: dict[str, list[str]], asked: Asked, rectified: bool | None) -> StereoRig:
    left, right = _pair(lines, asked)
    if rectified is None:
        rectified = _is_rectified(lines, left, asked)
    if rectified:
        P_left, P_right = (numbers(key, entry(lines, key), (12,)).reshape(3, 4) for key in _keys("P_rect", left, right))
        sizes = [size(key, entry(lines, key)) for key in _keys("S_rect", left, right)]
        if sizes[0] != sizes[1]:
            raise RigError(f"both rectified images must have one size, but they are {by(sizes[0])} and {by(sizes[1])}")
        return _rectified_rig(P_left, P_right, Asked(asked.unit_m, sizes[0]))
    T_left_0, T_right_0 = (_pose(lines, i, asked.unit_m) for i in (left, right))
    return StereoRig(_camera(lines, left), _camera(lines, right), T_left_0 @ inverse(T_right_0))


def _keys(name: str, *cameras: int) -> list[str]:
    return [f"{name}_{i:02d}" for i in cameras]


def _pair(lines: dict[str, list[str]], asked: Asked) -> Pair:
    if asked.pair is not None:
        return asked.pair
    found = [pair for pair in (GREY, COLOR) if all(key in lines for key in _keys("K", *pair))]
    if not found:
        raise RigError("must hold K_00 and K_01, or K_02 and K_03, but has neither pair")
    if len(found) > 1:
        raise RigError("holds two pairs, cameras 0,1 (grey) and 2,3 (colour): say which with --pair")
    return found[0]


def _is_rectified(lines: dict[str, list[str]], left: int, asked: Asked) -> bool:
    raw, rectified = (size(key, entry(lines, key)) for key in (f"S_{left:02d}", f"S_rect_{left:02d}"))
    if asked.size_px is None or raw == rectified:
        raise RigError(
            f"describes raw {by(raw)} and rectified {by(rectified)} images: say which by their size with --size"
        )
    if asked.size_px not in (raw, rectified):
        raise RigError(
            f"describes raw {by(raw)} and rectified {by(rectified)} images, but these are {by(asked.size_px)}"
        )
    return asked.size_px == rectified


def _camera(lines: dict[str, list[str]], i: int) -> Camera:
    S, K, D = _keys("S", i)[0], _keys("K", i)[0], _keys("D", i)[0]
    size_px = size(S, entry(lines, S))
    matrix = numbers(K, entry(lines, K), (9,)).reshape(3, 3)
    return camera(size_px, matrix, "brown_conrady", numbers(D, entry(lines, D), (5,)), f"{K}: ")


def _pose(lines: dict[str, list[str]], i: int, unit_m: float) -> FloatArray:
    """Return `T_i_0`: the file's R and T take points of camera 0 to camera i."""
    R, T = _keys("R", i)[0], _keys("T", i)[0]
    matrix = rotation(R, numbers(R, entry(lines, R), (9,)).reshape(3, 3))
    return pose(matrix, unit_m * numbers(T, entry(lines, T), (3,)))
