import shutil
from pathlib import Path

import numpy as np
import pytest

from roadblock.errors import SourceError
from roadblock.io.sources import open_source
from roadblock.values.camera import StereoRig

B_PX = 386.1448  # of a camera with f = 718.856 px: baseline 0.53716... m
F_PX = 718.856


def row(tx: float, f: float = F_PX) -> str:
    return f"{f} 0 45.2 {tx} 0 {f} 33.9 0 0 0 1 0"


def calib(f: float = F_PX) -> str:
    return f"P0: {row(0, f)}\nP1: {row(-B_PX, f)}\nP2: {row(40, f)}\nP3: {row(40 - B_PX, f)}\n"


def fill(root: Path, images, put, left: str, right: str, names: tuple[str, ...] = ("000000", "000001")) -> None:
    for i, name in enumerate(names):
        put(root / left / f"{name}.png", images[2 * i])
        put(root / right / f"{name}.png", images[2 * i + 1])


@pytest.mark.parametrize(
    ("left", "right", "kind"),
    [
        ("image_2", "image_3", "kitti-stills-color"),
        ("image_02", "image_03", "kitti-stills-color"),
        ("colored_0", "colored_1", "kitti-stills-color"),
        ("image_0", "image_1", "kitti-stills-gray"),
        ("image_00", "image_01", "kitti-stills-gray"),
    ],
)
def test_stills(tmp_path: Path, images, put, left: str, right: str, kind: str) -> None:
    fill(tmp_path, images, put, left, right)
    (tmp_path / "calib.txt").write_text(calib())
    (tmp_path / "disp_occ_0").mkdir()
    for source in (open_source(tmp_path), open_source(tmp_path, kind=kind)):
        assert (source.length, source.is_sequence, source.rigs) == (2, False, None)
        assert source.ground_truth == tmp_path / "disp_occ_0"
        assert source.rig.baseline_m == pytest.approx(B_PX / F_PX)
        assert source.rig.is_rectified
        pairs = list(source)
        assert [(p.name, p.t_ns) for p in pairs] == [("000000", 0), ("000001", 0)]
        np.testing.assert_array_equal(pairs[1].right, images[3])


def test_stills_with_a_calibration_per_frame(tmp_path: Path, images, put) -> None:
    fill(tmp_path, images, put, "image_2", "image_3", ("um_000000", "um_000001", "um_000002"))
    (tmp_path / "calib").mkdir()
    for name, f in (("um_000000", F_PX), ("um_000001", 707.0), ("um_000002", F_PX)):
        (tmp_path / "calib" / f"{name}.txt").write_text(calib(f))
    for side in ("image_2", "image_3"):
        put(tmp_path / side / "um_000001.png", images[5][3:, 2:])
    source = open_source(tmp_path)
    assert source.rigs is not None
    assert source.rigs[0] is source.rigs[2] is source.rig
    assert [rig.left.fx_px for rig in source.rigs] == [F_PX, 707.0, F_PX]
    assert [pair.left.shape[:2] for pair in source] == [(61, 97), (58, 95), (61, 97)]
    (tmp_path / "calib" / "um_000001.txt").unlink()
    with pytest.raises(SourceError, match=r"neither calib\.txt nor calib/um_000001\.txt: .*--rig FILE"):
        open_source(tmp_path)


def test_equal_calibrations_per_frame_are_one_rig(tmp_path: Path, images, put) -> None:
    fill(tmp_path, images, put, "image_2", "image_3", ("000000_10", "000000_11"))
    (tmp_path / "calib_cam_to_cam").mkdir()
    text = f"S_rect_02: 97 61\nS_rect_03: 97 61\nP_rect_02: {row(40)}\nP_rect_03: {row(40 - B_PX)}\n"
    (tmp_path / "calib_cam_to_cam" / "000000.txt").write_text(text)
    source = open_source(tmp_path)
    assert source.rigs is None
    assert not source.is_sequence  # two frames a tenth of a second apart
    assert [pair.name for pair in source] == ["000000_10", "000000_11"]
    assert source.rig.baseline_m == pytest.approx(B_PX / F_PX)


def test_a_given_rig_needs_no_calibration(tmp_path: Path, images, put, rig: StereoRig) -> None:
    fill(tmp_path, images, put, "image_2", "image_3")
    fill(tmp_path / "odometry", images, put, "image_0", "image_1")
    (tmp_path / "odometry" / "poses.txt").touch()
    assert open_source(tmp_path, rig=rig).rig is rig
    assert open_source(tmp_path / "odometry", rig=rig).rig is rig


def test_two_layouts_in_one_folder(tmp_path: Path, images, put) -> None:
    fill(tmp_path, images, put, "image_2", "image_3")
    fill(tmp_path, images, put, "image_02", "image_03")
    with pytest.raises(SourceError, match=r"must hold one of image_2\+image_3 or .* but holds 2 of them"):
        open_source(tmp_path)


def test_both_pairs_are_ambiguous(tmp_path: Path, images, put) -> None:
    fill(tmp_path, images, put, "image_0", "image_1")
    fill(tmp_path, images, put, "image_2", "image_3")
    (tmp_path / "calib.txt").write_text(calib())
    with pytest.raises(SourceError, match="as kitti-stills-gray, kitti-stills-color: choose with --kind"):
        open_source(tmp_path)
    assert open_source(tmp_path, kind="kitti-stills-gray").length == 2


@pytest.mark.parametrize("text", [calib(), f"{row(0)}\n{row(-B_PX)}"])
def test_odometry(tmp_path: Path, images, put, text: str) -> None:
    fill(tmp_path, images, put, "image_0", "image_1")
    (tmp_path / "calib.txt").write_text(text)
    (tmp_path / "poses.txt").touch()
    source = open_source(tmp_path)
    assert source.is_sequence
    assert source.rig.baseline_m == pytest.approx(B_PX / F_PX)
    assert [pair.t_ns for pair in source] == [0, 100_000_000]
    (tmp_path / "times.txt").write_text("0.0\n1.036224e-01\n")
    assert [pair.t_ns for pair in open_source(tmp_path)] == [0, 103_622_400]
    (tmp_path / "calib.txt").unlink()
    with pytest.raises(SourceError, match=r"calib\.txt is missing"):
        open_source(tmp_path)


def test_odometry_with_poses(tmp_path: Path, images, put) -> None:
    """Camera 0 turns by a right angle about y and goes on by 1 m; seven digits are made a rotation."""
    fill(tmp_path, images, put, "image_0", "image_1")
    (tmp_path / "calib.txt").write_text(calib())
    still, turned = "1 0 0 0 0 1 0 0 0 0 1 0", "1e-7 0 1 0.5 0 1 0 0 -1 0 1e-7 1"
    (tmp_path / "poses.txt").write_text(f"{still}\n{turned}\n")
    first, second = (pair.T_odom_left for pair in open_source(tmp_path))
    np.testing.assert_allclose(first, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(second[:3], [[0, 0, 1, 0.5], [0, 1, 0, 0], [-1, 0, 0, 1]], atol=2e-7)
    (tmp_path / "poses.txt").write_text(f"{still}\n{still}\n{turned}\n")  # of frames 0 to 2
    assert open_source(tmp_path).length == 2
    (tmp_path / "poses.txt").write_text(f"{still}\n")
    with pytest.raises(SourceError, match=r"holds 1 poses for 2 pairs"):
        open_source(tmp_path)
    (tmp_path / "poses.txt").write_text(f"{still}\n1 2 3\n")
    with pytest.raises(SourceError, match=r"poses.txt line 2 must be 12 numbers, but is '1 2 3'"):
        open_source(tmp_path)


@pytest.fixture
def raw(tmp_path: Path, images, put) -> Path:
    """A raw drive of frames 1 and 3, unrectified, with a calibration two folders above."""
    drive = tmp_path / "day" / "drive"
    fill(drive, images, put, "image_00/data", "image_01/data", ("0000000001", "0000000003"))
    stamps = [f"2011-09-26 14:05:4{i}.864025856" for i in range(5)]
    (drive / "image_00" / "timestamps.txt").write_text("\n".join(stamps))
    text = ""
    for i, tx in ((0, 0), (1, -0.537)):
        text += f"S_0{i}: 97 61\nK_0{i}: 103.1 0 45.2 0 101.7 33.9 0 0 1\nD_0{i}: -0.37 0.2 0.002 0.001 -0.07\n"
        text += f"R_0{i}: 1 0 0 0 1 0 0 0 1\nT_0{i}: {tx} 0 0\nS_rect_0{i}: 90 50\nP_rect_0{i}: {row(tx * F_PX)}\n"
        text += f"R_rect_0{i}: 1 0 0 0 1 0 0 0 1\n"
    (tmp_path / "calib_cam_to_cam.txt").write_text(text)
    return drive


def test_raw(raw: Path) -> None:
    source = open_source(raw)
    assert (source.name, source.length, source.is_sequence) == ("drive", 2, True)
    assert not source.rig.is_rectified
    assert source.rig.baseline_m == pytest.approx(0.537)
    # by the number in the name: lines 1 and 3, counted from 0
    assert [pair.t_ns for pair in source] == [1317045941864025856, 1317045943864025856]
    assert [pair.T_odom_left for pair in source] == [None, None]


def test_raw_rectified_is_told_by_the_size(raw: Path, images, put) -> None:
    for side in ("image_00", "image_01"):
        for name in ("0000000001", "0000000003"):
            put(raw / side / "data" / f"{name}.png", images[0][:50, :90])
    assert open_source(raw).rig.is_rectified


def test_raw_needs_its_files(raw: Path, rig: StereoRig) -> None:
    (raw / "calib_cam_to_cam_a.txt").touch()
    (raw / "calib_cam_to_cam_b.txt").touch()
    with pytest.raises(SourceError, match="several calibrations"):
        open_source(raw)
    for path in (*raw.glob("*.txt"), raw.parents[1] / "calib_cam_to_cam.txt"):
        path.unlink()
    with pytest.raises(SourceError, match=r"holds no calib_cam_to_cam\*\.txt, .*--rig FILE"):
        open_source(raw)
    assert open_source(raw, rig=rig).rig is rig
    (raw / "image_00" / "timestamps.txt").unlink()
    with pytest.raises(SourceError, match=r"timestamps\.txt is missing"):
        open_source(raw)


def test_grey_and_colour_drive_is_ambiguous(raw: Path) -> None:
    for old, new in (("image_00", "image_02"), ("image_01", "image_03")):
        shutil.copytree(raw / old, raw / new)
    with pytest.raises(SourceError, match="as kitti-raw-gray, kitti-raw-color: choose with --kind"):
        open_source(raw)
    assert open_source(raw, kind="kitti-raw-gray").length == 2


@pytest.mark.parametrize(
    ("name", "length", "is_sequence", "baseline_m", "rigs"),
    [
        ("kitti2015", 26, False, 0.53273, None),
        ("kitti_raw_0926", 38, True, 0.53717, None),
        ("kitti_odometry", 16, True, 0.53717, None),
        ("kitti_road", 14, False, 0.53273, 2),
    ],
)
def test_real_recordings(
    data_dir: Path, name: str, length: int, is_sequence: bool, baseline_m: float, rigs: int | None
) -> None:
    if not (data_dir / name).is_dir():
        pytest.skip(f"{data_dir} has no {name}")
    source = open_source(data_dir / name)
    assert (source.length, source.is_sequence) == (length, is_sequence)
    assert source.rig.baseline_m == pytest.approx(baseline_m, abs=1e-4)
    assert (source.rigs and len(set(map(id, source.rigs)))) == rigs
    times = [pair.t_ns for _, pair in zip(range(3), source, strict=False)]
    assert times == (sorted(set(times)) if is_sequence else [0, 0, 0])
