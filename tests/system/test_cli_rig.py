"""`roadblock rig show`, `roadblock rig convert` and `roadblock rig compare`."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadblock.cli.rig import parse_pair, parse_size, parse_unit
from roadblock.errors import SettingsError
from roadblock.geometry.pose import pose
from roadblock.geometry.uncertainty import moved_rig
from roadblock.io.results import read_results
from roadblock.io.rig import read_rig, write_rig
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters


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


def sure_rig(sigma_rad: float = 1e-5) -> StereoRig:
    """Known exactly but for its turns."""
    rig = crooked_rig()
    names = rig_parameters(rig.left, rig.right)
    variances = np.where([name.endswith("_rad") for name in names], sigma_rad**2, 0.0)
    return replace(rig, covariance=RigCovariance(names, np.diag(variances)))


def turned(rig: StereoRig, ry_rad: float) -> StereoRig:
    return moved_rig(rig, [ry_rad * (name == "ry_rad") for name in rig_parameters(rig.left, rig.right)])


def test_what_the_calibration_does_reaches_the_results(roadblock, recording: Path) -> None:
    plain = roadblock("detect", recording, "--out", "plain")
    assert "calibration" not in plain.out
    (rig_file,) = recording.glob("rig.yaml")
    rig = read_rig(rig_file)
    names = rig_parameters(rig.left, rig.right)
    variances = np.where([name == "tx_m" for name in names], 0.01**2 * rig.baseline_m**2, 0.0)  # 1 % of the baseline
    write_rig(replace(rig, covariance=RigCovariance(names, np.diag(variances))), rig_file)
    ran = roadblock("detect", recording, "--out", "sure")
    assert (ran.code, ran.err) == (0, plain.err)
    assert "calibration" in ran.out
    before, after = (read_results(Path(folder, "obstacles.jsonl")) for folder in ("plain", "sure"))
    found = 0
    for one, two in zip(before, after, strict=True):
        for a, b in zip(one["obstacles"], two["obstacles"], strict=True):
            assert (a["range_m"], a["range_sigma_calib_m"], a["cov_calib_m2"]) == (b["range_m"], None, None)
            assert b["range_sigma_calib_m"] == pytest.approx(0.01 * b["range_m"], abs=6e-5)
            assert b["cov_calib_m2"][0][0] == pytest.approx((0.01 * b["range_m"]) ** 2, rel=0.01)
            found += 1
    assert found > 2
    told = json.loads(Path("sure/run.json").read_text())["rig"]["calibration"]
    assert told["covariance"]["names"] == list(names)


def test_show_says_how_sure_ranges_are(roadblock, work: Path) -> None:
    write_rig(sure_rig(), "rig.yaml")
    ran = roadblock("rig", "show", "rig.yaml")
    assert (ran.code, ran.err) == (0, "")
    assert [f"range error from calibration at {z} m" in ran.out for z in (5, 10, 20, 40)] == [True] * 4
    assert "1 sigma; worst corner" in " ".join(ran.out.split())


def test_convert_says_what_it_loses(roadblock, work: Path) -> None:
    write_rig(sure_rig(), "rig.yaml")
    ran = roadblock("rig", "convert", "rig.yaml", "other.yaml", "--to", "kalibr")
    assert ran.code == 0
    assert ran.err == (
        "note: kalibr files have no room for the covariance: the range error from calibration is unknown there\n"
    )
    assert roadblock("rig", "convert", "rig.yaml", "same.yaml").err == ""


def compared(roadblock, a: StereoRig, b: StereoRig):
    write_rig(a, "a.yaml")
    write_rig(b, "b.yaml")
    return roadblock("rig", "compare", "a.yaml", "b.yaml")


def test_compare_finds_the_same(roadblock, work: Path) -> None:
    ran = compared(roadblock, sure_rig(), turned(sure_rig(), 3e-5))
    assert (ran.code, ran.err) == (0, "")
    assert re.fullmatch(r"the same within their errors \(p = 0\.\d+\)", ran.out.splitlines()[-1])
    row = next(line.split() for line in ran.out.splitlines() if line.strip().startswith("turn about y (deg)"))
    assert row[-3:] == ["+0.00172", "0.00081", "+2.1"]  # 3e-5 rad, sqrt(2) * 1e-5, their ratio


def test_compare_finds_a_move(roadblock, work: Path) -> None:
    """The right camera turned by 0.5 mrad to the right: 0.5e-3 Z^2 / B at the middle."""
    ran = compared(roadblock, sure_rig(), turned(sure_rig(), 0.5e-3))
    assert (ran.code, ran.err) == (0, "")
    told = re.fullmatch(
        r"moved: ranges at 20 m are off by (\S+) m, at worst (\S+) m \(p < 1e-6\)", ran.out.splitlines()[-1]
    )
    assert told is not None
    assert float(told[1]) == pytest.approx(-(20**2) / 0.205 * 0.5e-3, rel=0.15)
    assert float(told[2]) < float(told[1])
    first = next(line.split() for line in ran.out.splitlines() if line.strip().startswith("20 m"))
    assert first[2:4] == [told[1], told[2]]


def test_compare_without_a_covariance_says_what_differs_but_not_whether(roadblock, rig_file: Path) -> None:
    ran = compared(roadblock, crooked_rig(), turned(sure_rig(), 0.5e-3))
    assert (ran.code, ran.err) == (0, "")
    assert ran.out.splitlines()[-1] == "cannot be told: no covariance in a.yaml"
    assert "+0.0286" in ran.out  # degrees
    ran = roadblock("rig", "compare", rig_file, rig_file)
    assert ran.out.splitlines()[-1] == "cannot be told: no covariance in rig.yaml and rig.yaml"


def test_compare_takes_other_lenses_and_refuses_other_sizes(roadblock, work: Path) -> None:
    rig = sure_rig()
    wide = Camera((97, 61), 81.3, 77.9, 44.2, 33.1, "kannala_brandt", np.zeros(4))
    names = rig_parameters(wide, wide)
    fisheye = StereoRig(wide, wide, rig.T_left_right, None, RigCovariance(names, 1e-10 * np.eye(len(names))))
    ran = compared(roadblock, rig, fisheye)
    assert ran.code == 0
    assert ran.err.startswith("note: the lens models differ: only the pose and what both do to the images")
    assert ran.out.splitlines()[-1].startswith("moved: ")
    small = Camera((48, 30), 40.0, 40.0, 24.0, 15.0)
    ran = compared(roadblock, rig, StereoRig(small, small, rig.T_left_right))
    assert (ran.code, ran.out) == (2, "")
    assert ran.err.startswith("error: rigs can be compared at one image size, but these are for 97x61 and 48x30")
    assert ran.err.count("\n") == 1


def test_compare_where_nothing_near_is_seen_by_both(roadblock, work: Path) -> None:
    narrow = Camera((97, 61), 2000.0, 2000.0, 48.0, 30.0)
    ran = compared(roadblock, rig := StereoRig(narrow, narrow, pose(np.eye(3), (0.5, 0, 0))), rig)
    assert (ran.code, ran.err) == (0, "")
    row = next(line.split() for line in ran.out.splitlines() if line.strip().startswith("5 m"))
    assert row == ["5", "m", "-", "-", "-", "-", "-"]


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
