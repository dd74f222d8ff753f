"""ZED's and BoofCV's files, made by hand; and the published calibrations."""

import cv2
import numpy as np
import pytest
from rig_examples import assert_same, pose

from roadblock.errors import RigError
from roadblock.io.rig import read_rig
from roadblock.values.camera import Camera, StereoRig

ROTVEC = (0.011, -0.007, 0.003)
R = cv2.Rodrigues(np.array(ROTVEC))[0]
T_RIGHT_LEFT = pose(ROTVEC, (-0.1199, 0.0002, -0.0005))
OLD_DISTORTION = "k1=-0.17\nk2=0.028\np1=0.0011\np2=-0.0012\nk3=0.0007\n"
NEW_DISTORTION = OLD_DISTORTION + "k4=0.01\nk5=0.02\nk6=0.03\n"
FISHEYE = "k1=0.03\nk2=-0.01\nk3=0.004\nk4=-0.0007\n"


def zed(resolutions=("HD",), inside="", apart="", stereo=None):
    rx, cv, rz = ROTVEC
    text = "[STEREO]\n" + (stereo or "Baseline=119.9\nTY=0.2\nTZ=-0.5\n")
    for resolution in resolutions:
        text += f"RX_{resolution}={rx}\nCV_{resolution}={cv}\nRZ_{resolution}={rz}\n" if stereo is None else ""
    for side, shift in (("LEFT", 0), ("RIGHT", 5)):
        for resolution in resolutions:
            text += f"\n[{side}_CAM_{resolution}]\nfx={700 + shift}\nfy=690\ncx=650.5\ncy={371.5 + shift}\n{inside}"
        text += f"\n[{side}_DISTO]\n{apart}" if apart else ""
    return text


def put(tmp_path, text):
    path = tmp_path / "SN1234.conf"
    path.write_text(text)
    return path


def expected(lens, d, size_px=(1280, 720), cut=0.0, scale=1.0):
    cameras = [
        Camera(size_px, (700 + s) * scale, 690 * scale, 650.5 * scale, (371.5 + s) * scale - cut, lens, d)
        for s in (0, 5)
    ]
    return StereoRig(*cameras, np.linalg.inv(T_RIGHT_LEFT))


OLD = ("brown_conrady", [-0.17, 0.028, 0.0011, -0.0012, 0.0007])


@pytest.mark.parametrize(
    ("inside", "apart", "lens", "d"),
    [
        (OLD_DISTORTION, "", *OLD),
        (OLD_DISTORTION, NEW_DISTORTION, "brown_conrady", [*OLD[1], 0.01, 0.02, 0.03]),
        ("", FISHEYE, "kannala_brandt", [0.03, -0.01, 0.004, -0.0007]),
    ],
)
def test_zed_lenses(tmp_path, inside, apart, lens, d):
    rig = read_rig(put(tmp_path, zed(inside=inside, apart=apart)))
    assert_same(rig, expected(lens, d))
    np.testing.assert_allclose(np.linalg.inv(rig.T_left_right)[:3, :3], R, atol=1e-12)


def test_zed_resolutions(tmp_path):
    path = put(tmp_path, zed(("HD", "VGA"), OLD_DISTORTION))
    assert_same(read_rig(path, size_px=(672, 376)), expected(*OLD, (672, 376)))
    with pytest.raises(RigError, match=r"SN1234.conf: must be told the resolution .* HD 1280x720, VGA 672x376"):
        read_rig(path)
    with pytest.raises(RigError, match="no calibration for images of 640x480; there is HD 1280x720"):
        read_rig(path, size_px=(640, 480))


def test_zed_derived_resolutions(tmp_path):
    path = put(tmp_path, zed(("FHD1200",), OLD_DISTORTION))
    assert_same(read_rig(path), expected(*OLD, (1920, 1200)))
    assert_same(read_rig(path, size_px=(1920, 1080)), expected(*OLD, (1920, 1080), cut=60))
    assert_same(read_rig(path, size_px=(960, 600)), expected(*OLD, (960, 600), scale=0.5))


def test_zed_translation_per_resolution(tmp_path):
    rx, cv, rz = ROTVEC
    stereo = f"Baseline=119.9\nTY=9\nTY_HD=0.2\nTZ_HD=-0.5\nRX_HD={rx}\nCV_HD={cv}\nRZ_HD={rz}\n"
    assert_same(read_rig(put(tmp_path, zed(inside=OLD_DISTORTION, stereo=stereo))), expected(*OLD))


GOOD = zed(inside=OLD_DISTORTION)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (GOOD.replace("[STEREO]", "[STEREOO]"), r"section \[STEREO\] is missing"),
        (GOOD.replace("Baseline", "Basis"), r"\[STEREO\] Baseline is missing"),
        (GOOD.replace("119.9", "-119.9"), "to the LEFT of the left one"),
        (GOOD.replace("119.9", "abc"), r"\[STEREO\] Baseline must be numbers, but got 'abc'"),
        (GOOD.replace("TZ=", "TX="), r"\[STEREO\] TZ_HD is missing"),
        (GOOD.replace("k2=", "k9="), r"\[LEFT_CAM_HD\] k2 is missing"),
        (GOOD.replace("RIGHT_CAM_HD", "RIGHT_CAM_2K"), r"section \[RIGHT_CAM_HD\] is missing"),
        (GOOD.replace("LEFT_CAM_HD", "LEFT_CAM_4k"), "must be told the resolution with --size; there is none"),
        (GOOD + "\n[STEREO]\n", "is not a valid INI file"),
        (GOOD.replace("fx=700", "fx=-700"), "fx_px must be > 0"),
    ],
)
def test_bad_zed_files(tmp_path, text, match):
    with pytest.raises(RigError, match=match) as caught:
        read_rig(put(tmp_path, text))
    assert "\n" not in str(caught.value)


BOOFCV = """# Intrinsic and extrinsic parameters
left:
  model: pinhole_radial_tangential
  pinhole: {fx: 81.3, fy: 77.9, cx: 44.2, cy: 33.1, width: 97, height: 61, skew: 0.0}
  radial_tangential: {radial: [-0.3, 0.15], t1: 0.001, t2: -0.002}
right:
  model: pinhole
  pinhole: {fx: 82.3, fy: 78.9, cx: 45.2, cy: 34.1, width: 97, height: 61, skew: 0.0}
model: stereo_camera
rightToLeft:
  rotation: [0.96, 0.0, 0.28, 0.0, 1.0, 0.0, -0.28, 0.0, 0.96]
  x: 120.0
  y: 0.5
  z: -0.7
"""


def test_boofcv(tmp_path):
    path = tmp_path / "stereo.yaml"
    path.write_text(BOOFCV)
    rig = read_rig(path, unit_m=0.001)
    left = Camera((97, 61), 81.3, 77.9, 44.2, 33.1, "brown_conrady", [-0.3, 0.15, 0.001, -0.002, 0])
    right = Camera((97, 61), 82.3, 78.9, 45.2, 34.1)
    T = np.array([[0.96, 0, 0.28, 0.12], [0, 1, 0, 0.0005], [-0.28, 0, 0.96, -0.0007], [0, 0, 0, 1]])
    assert_same(rig, StereoRig(left, right, T))


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ("x: 120.0", "x: 120.0", "baseline is 120.003 m, .* probably another unit than metres; say which with --unit"),
        (
            "model: pinhole\n",
            "model: omni\n",
            "right.model must be pinhole or pinhole_radial_tangential, but got 'omni'",
        ),
        ("skew: 0.0", "skew: 0.1", r"left\.the camera matrix must be .*no skew"),
        ("[-0.3, 0.15]", "[1, 2, 3, 4]", "left.radial_tangential.radial may have up to 3 coefficients, but has 4"),
        ("width: 97", "width: 9.5", "left.pinhole.width, height must be width and height, whole"),
        ("rotation: [0.96", "rotation: [0.9", "rightToLeft.rotation must be a rotation"),
        ("  x: 120.0\n", "", "rightToLeft.x is missing"),
    ],
)
def test_bad_boofcv_files(tmp_path, old, new, match):
    path = tmp_path / "stereo.yaml"
    path.write_text(BOOFCV.replace(old, new))
    with pytest.raises(RigError, match=match):
        read_rig(path)


def test_published_calibrations(data_dir):
    sample = data_dir / "calibration" / "opencv"
    with pytest.raises(RigError, match=r"baseline is 3.34304 m, but a vehicle's lies between"):
        read_rig(sample, size_px=(640, 480))
    assert read_rig(sample, size_px=(640, 480), unit_m=0.025).baseline_m == pytest.approx(3.343 * 0.025, abs=1e-5)
    bumblebee = data_dir / "calibration" / "bumblebee2" / "stereo.yaml"
    with pytest.raises(RigError, match=r"stereo.yaml: baseline is 120.051 m, .* --unit"):
        read_rig(bumblebee)
    assert read_rig(bumblebee, unit_m=0.001).T_left_right[0, 3] == pytest.approx(0.12004, abs=1e-5)
