"""KITTI's own poses of raw drives."""

from pathlib import Path

import numpy as np
import pytest

from roadblock.errors import SourceError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.sources.kitti_poses import EARTH_M, read_oxts
from roadblock.io.sources.pairing import FramePaths

LATITUDE = 49.0
NAMES = ("0000000003", "0000000004")
FRAMES = tuple(FramePaths(Path(name), Path(name), name) for name in NAMES)
R_VELO_IMU = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
"""So that its rows and columns cannot be taken for each other."""
R_CAMERA_VELO = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])


def text(values) -> str:
    return " ".join(f"{value:.12g}" for value in np.ravel(values))


def transform_file(R: np.ndarray, t) -> str:
    return f"calib_time: 25-May-2012 16:47:16\nR: {text(R)}\nT: {text(t)}\n"


@pytest.fixture
def drive(tmp_path: Path) -> Path:
    """A drive that heads north, goes 2 m, climbs 0.1 m and turns to the left by a tenth."""
    folder = tmp_path / "day" / "drive"
    (folder / "oxts" / "data").mkdir(parents=True)
    step_deg = np.degrees(2 / EARTH_M)
    for name, (north_deg, up_m, yaw) in zip(NAMES, ((0, 0, 0), (step_deg, 0.1, 0.1)), strict=True):
        numbers = [LATITUDE + north_deg, 8.0, 116.0 + up_m, 0.0, 0.0, np.pi / 2 + yaw, *range(24)]
        (folder / "oxts" / "data" / f"{name}.txt").write_text(" ".join(f"{n:.14g}" for n in numbers) + "\n")
    (tmp_path / "day" / "calib_imu_to_velo.txt").write_text(transform_file(R_VELO_IMU, [-0.8, 0.3, -0.8]))
    (tmp_path / "calib_velo_to_cam_day.txt").write_text(transform_file(R_CAMERA_VELO, [0.0, -0.1, -0.3]))
    return folder


@pytest.mark.parametrize("is_rectified", [False, True])
def test_poses_of_a_raw_drive(drive: Path, is_rectified: bool) -> None:
    """By the tool of the data set: the first IMU's axes, then the camera as it is mounted."""
    turn = rotation_from_rotvec([0.01, -0.02, 0.03])
    calibration = drive / "calib_cam_to_cam.txt"
    calibration.write_text(f"R_rect_00: {text(turn)}\n")
    first, second = read_oxts(drive, FRAMES, calibration if is_rectified else None)
    R_rect = turn if is_rectified else np.eye(3)
    T_camera_imu = pose(R_CAMERA_VELO, [0.0, -0.1, -0.3]) @ pose(R_VELO_IMU, [-0.8, 0.3, -0.8])
    mount = np.linalg.inv(pose(R_rect, np.zeros(3)) @ T_camera_imu)
    # 2 m along the ground are 2 m on the map, but for how its scale changes on the way.
    went = pose(rotation_from_rotvec([0.0, 0.0, 0.1]), [2.0, 0.0, 0.1])
    np.testing.assert_allclose(first, mount, atol=1e-9)
    np.testing.assert_allclose(second, went @ mount, atol=1e-5)


def test_what_is_not_whole_says_nothing(drive: Path) -> None:
    later = (*FRAMES, FramePaths(Path("x"), Path("x"), "0000000005"))
    assert read_oxts(drive, later, None) is None
    (drive.parent / "calib_imu_to_velo.txt").unlink()
    assert read_oxts(drive, FRAMES, None) is None


def test_what_is_broken_is_named(drive: Path) -> None:
    file = drive / "oxts" / "data" / f"{NAMES[1]}.txt"
    file.write_text("49 8 116 0 nan 0 1 2 3\n")
    with pytest.raises(SourceError, match=rf"{NAMES[1]}.txt line 1 must be 6 numbers, but is '49 8 116 0 nan 0'"):
        read_oxts(drive, FRAMES, None)
    file.write_text("1 2 3 4 5 6\n1 2 3 4 5 6\n")
    with pytest.raises(SourceError, match="must hold one line of numbers, but holds 2"):
        read_oxts(drive, FRAMES, None)
    (drive.parent / "calib_imu_to_velo.txt").write_text("R: 1 2 3\n")
    with pytest.raises(SourceError, match="must hold a line T:, but has none"):
        read_oxts(drive, FRAMES, None)
