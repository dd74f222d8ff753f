"""`roadblock rig show` and `roadblock rig convert`."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadblock.cli.rig import parse_pair, parse_size, parse_unit
from roadblock.errors import SettingsError
from roadblock.geometry.pose import pose
from roadblock.io.rig import read_rig, write_rig
from roadblock.values.camera import Camera, StereoRig


def crooked_rig() -> StereoRig:
    left = Camera((97, 61), 81.3, 77.9, 44.2, 33.1, "brown_conrady", np.array([-0.27, 0.11, 0.0021, -0.0013, 0.0]))
    right = Camera((97, 61), 83.7, 75.6, 45.5, 33.1, "brown_conrady", np.array([-0.25, 0.09, -0.0011, 0.0007, 0.0]))
    turn = Rotation.from_rotvec((0.021, -0.034, 0.017)).as_matrix()
    return StereoRig(left, right, pose(turn, (0.205, 0.0113, -0.0071)))


def assert_same(a: StereoRig, b: StereoRig) -> None:
    for one, two in ((a.left, b.left), (a.right, b.right)):
        assert (one.size_px, one.lens) == (two.size_px, two.lens)
        np.testing.assert_allclose(one.K, two.K, rtol=0, atol=1e-9)
        np.testing.assert_allclose(one.distortion, two.distortion, rtol=0, atol=1e-9)
    np.testing.assert_allclose(a.T_left_right, b.T_left_right, rtol=0, atol=1e-9)


@pytest.fixture
def rig_file(work: Path) -> Path:
    write_rig(crooked_rig(), work / "rig.yaml")
    return Path("rig.yaml")


def test_show_says_what_a_rig_is(roadblock, rig_file: Path) -> None:
    ran = roadblock("rig", "show", rig_file)
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.startswith("rig.yaml")
    told = {" ".join(cell.split()) for line in ran.out.splitlines() for cell in line.strip().split("  ", 1)}
    assert {"97 x 61 px", "fx 81.300, fy 77.900 px", "(45.500, 33.100) px", "x 0.205, y 0.0113, z -0.0071 m"} <= told


@pytest.mark.parametrize("to", ["opencv", "ros", "kalibr", "roadblock"])
def test_there_and_back_is_the_same_rig(roadblock, rig_file: Path, to: str) -> None:
    ran = roadblock("rig", "convert", rig_file, "there/other", "--to", to)
    assert (ran.code, ran.err) == (0, "")
    written = [Path(line.removeprefix("wrote ")) for line in ran.out.splitlines()]
    assert len(written) == (2 if to == "ros" else 1)
    assert all(path.is_file() for path in written)
    assert roadblock("rig", "convert", "there/other", "back.yaml", "--format", to).code == 0
    assert_same(read_rig("back.yaml"), crooked_rig())


def test_two_files_are_given_as_a_folder_or_one_beside_the_other(roadblock, rig_file: Path) -> None:
    roadblock("rig", "convert", rig_file, "ros", "--to", "ros")
    Path("ros/right.yaml").rename("r.yaml")
    assert roadblock("rig", "convert", "ros/left.yaml", "a.yaml", "--right", "r.yaml").code == 0
    assert_same(read_rig("a.yaml"), crooked_rig())


@pytest.mark.parametrize(("unit", "metres"), [("mm", 0.001), ("25mm", 0.025), ("0.5", 0.5), ("in", 0.0254)])
def test_lengths_in_any_unit(roadblock, work: Path, unit: str, metres: float) -> None:
    f, B = 129.0, 0.205 / metres
    Path("calib.txt").write_text(f"P0: {f} 0 80 0 0 {f} 45 0 0 0 1 0\nP1: {f} 0 80 {-f * B} 0 {f} 45 0 0 0 1 0\n")
    ran = roadblock("rig", "convert", "calib.txt", "rig.yaml", "--unit", unit, "--size", "160x90")
    assert (ran.code, ran.err) == (0, "")
    rig = read_rig("rig.yaml")
    assert rig.baseline_m == pytest.approx(0.205, rel=1e-12)
    assert rig.left.size_px == (160, 90)


def test_the_pair_of_four_cameras(roadblock, work: Path) -> None:
    f = 129.0
    rows = [f"P{i}: {f} 0 80 {-f * x} 0 {f} 45 0 0 0 1 0\n" for i, x in enumerate((0, 0.5, 0.06, 0.59))]
    Path("calib.txt").write_text("".join(rows))
    for pair, baseline_m in (("0,1", 0.5), (" 2 , 3 ", 0.53)):
        assert roadblock("rig", "convert", "calib.txt", "rig.yaml", "--size", "160x90", "--pair", pair).code == 0
        assert read_rig("rig.yaml").baseline_m == pytest.approx(baseline_m)


@pytest.mark.parametrize(
    ("text", "metres"), [("m", 1), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), (" 25 mm ", 0.025), (".5", 0.5)]
)
def test_units(text: str, metres: float) -> None:
    assert parse_unit(text) == pytest.approx(metres, rel=1e-15)


@pytest.mark.parametrize(
    "text", ["", " ", "0", "0.0mm", "-1", "1e-3", "nan", "inf", "parsec", "mm25", "1.2.3", "٣", "m m"]
)
def test_units_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError, match=r"^a unit must be m, cm, mm, in, or a number with one \(25mm\), but got '"):
        parse_unit(text)


@pytest.mark.parametrize("text", ["", "640", "0x480", "640x0", "-640x480", "6.4x4.8", "640x480x3", "9999999x1", "٣x٣"])
def test_sizes_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError, match=r"^a size must look like 640x480, but got '"):
        parse_size(text)


@pytest.mark.parametrize("text", ["", "2", "2,", "2;3", "10,11", "-1,2", "a,b", "2,3,4"])
def test_pairs_that_are_none(text: str) -> None:
    with pytest.raises(SettingsError, match=r"^a pair of cameras must look like 2,3, but got '"):
        parse_pair(text)


def test_what_is_not_given_stays_unknown() -> None:
    assert parse_size(None) is None
    assert parse_pair(None) is None
    assert parse_size(" 640 X 480 ") == (640, 480)
