"""Where KITTI's recordings say they were taken: `poses.txt`, and `oxts/` (satellites, inertia) of raw drives."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from roadblock.errors import SourceError
from roadblock.geometry.pose import inverse, pose
from roadblock.io.sources.pairing import FramePaths
from roadblock.io.sources.text import read_lines
from roadblock.values.checks import FloatArray

EARTH_M = 6378137.0
OXTS_NUMBERS = 6
"""The first ones of a file: latitude and longitude, degrees, altitude, metres, roll, pitch and yaw, radians."""


def read_poses(path: Path, frames: tuple[FramePaths, ...]) -> tuple[FloatArray, ...] | None:
    """Return the poses of the frames: a line of 12 numbers each, in order, or by the number that a frame is named.

    None if there is no such file, or it is empty.

    Raises
    ------
    SourceError
        If a line is no pose, or there is not one per frame.
    """
    if not path.is_file():
        return None
    rows = [_posed(*np.split(_numbers(path, n, line, 12).reshape(3, 4), [3], 1)) for n, line in read_lines(path)]
    if len(rows) in (0, len(frames)):
        return tuple(rows) or None
    if all(frame.name.isdecimal() and int(frame.name) < len(rows) for frame in frames):
        return tuple(rows[int(frame.name)] for frame in frames)
    raise SourceError(f"{path} holds {len(rows)} poses for {len(frames)} pairs: one line per pair is expected")


def read_oxts(path: Path, frames: tuple[FramePaths, ...], rectified_by: Path | None) -> tuple[FloatArray, ...] | None:
    """Return the poses of camera 0 of a raw drive, in the axes of its first moment's IMU.

    None if `oxts/data` has not a file for every frame, or how the IMU stands to the camera (`calib_imu_to_velo*.txt`,
    `calib_velo_to_cam*.txt`, in the drive's folder or up to two above) is not known.

    Parameters
    ----------
    path
        The drive.
    frames
        Its pairs.
    rectified_by
        The calibration that says how the images' axes are turned against those of camera 0; None if they are not.

    Raises
    ------
    SourceError
        If a file is not what it must be.
    """
    files = [path / "oxts" / "data" / f"{frame.name}.txt" for frame in frames]
    to_velo, to_camera = (_beside(path, f"calib_{name}*.txt") for name in ("imu_to_velo", "velo_to_cam"))
    if to_velo is None or to_camera is None or not all(file.is_file() for file in files):
        return None
    T_left_imu = _placed(to_camera) @ _placed(to_velo)
    if rectified_by is not None:
        (turn,) = _entries(rectified_by, "R_rect_00")
        T_left_imu = _posed(_numbers(rectified_by, *turn, 9).reshape(3, 3), np.zeros(3)) @ T_left_imu
    places = [_imu(file) for file in files]
    scale = np.cos(np.radians(places[0][0]))
    imu = [_on_map(numbers, scale) for numbers in places]
    origin = inverse(imu[0])
    return tuple(origin @ T @ inverse(T_left_imu) for T in imu)


def _imu(path: Path) -> FloatArray:
    lines = read_lines(path)
    if len(lines) != 1:
        raise SourceError(f"{path} must hold one line of numbers, but holds {len(lines)}")
    return _numbers(path, lines[0][0], " ".join(lines[0][1].split()[:OXTS_NUMBERS]), OXTS_NUMBERS)


def _on_map(numbers: FloatArray, scale: float) -> FloatArray:
    """Return a pose on Mercator's map, true to scale where the drive begins: x east, y north, z up."""
    latitude_rad, longitude_rad = np.radians(numbers[:2])
    x_m = scale * EARTH_M * longitude_rad
    y_m = scale * EARTH_M * np.log(np.tan(np.pi / 4 + latitude_rad / 2))
    return pose(Rotation.from_euler("xyz", numbers[3:]).as_matrix(), np.array([x_m, y_m, numbers[2]]))


def _placed(path: Path) -> FloatArray:
    """Return the transform of a calibration file with lines `R:` and `T:`."""
    R, T = _entries(path, "R", "T")
    return _posed(_numbers(path, *R, 9).reshape(3, 3), _numbers(path, *T, 3))


def _entries(path: Path, *names: str) -> list[tuple[int, str]]:
    """Return line number and text of some lines `NAME: text`."""
    rows = {key.strip(): (n, text) for n, line in read_lines(path) for key, _, text in [line.partition(":")]}
    absent = [name for name in names if name not in rows]
    if absent:
        raise SourceError(f"{path} must hold a line {absent[0]}:, but has none")
    return [rows[name] for name in names]


def _posed(R: NDArray[np.float64], t: NDArray[np.float64]) -> FloatArray:
    """Return a pose; some seven digits are not quite a rotation."""
    u, _, v = np.linalg.svd(R)
    return pose(u @ v, t.ravel())


def _numbers(path: Path, number: int, text: str, count: int) -> FloatArray:
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if len(values) != count or not np.isfinite(values).all():
        raise SourceError(f"{path} line {number} must be {count} numbers, but is {text.strip()!r:.40}")
    return values


def _beside(path: Path, pattern: str) -> Path | None:
    folders = (path, *path.resolve().parents[:2])
    return next((file for folder in folders for file in sorted(folder.glob(pattern))), None)
