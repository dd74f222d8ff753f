"""What is wrong with a rig file is said in one line that starts with the file's name; nothing is printed."""

import re

import numpy as np
import pytest
from rig_examples import crooked_rig, pose, sure_rig

from roadblock.errors import RigError
from roadblock.io.rig import WRITERS, read_rig, write_rig
from roadblock.io.rig.files import MAX_BYTES

GOOD = WRITERS["roadblock"](crooked_rig("brown_conrady", mounting=True))[""]


def matrix(name, rows, cols, data):
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: [ {data} ]\n"


# By hand, because versions of OpenCV print numbers differently.
K_TEXT = "81.3, 0., 44.2, 0., 77.9, 33.1, 0., 0., 1."
OPENCV = (
    "%YAML:1.0\n---\nimage_width: 97\nimage_height: 61\ndistortion_model1: plumb_bob\n"
    + matrix("M1", 3, 3, K_TEXT)
    + matrix("D1", 5, 1, "-0.27, 0.11, 0.002, -0.001, 0.01")
    + matrix("M2", 3, 3, K_TEXT)
    + matrix("D2", 5, 1, "0., 0., 0., 0., 0.")
    + matrix("R", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1.")
    + matrix("T", 3, 1, "-0.2, 0., 0.")
)
SURE = WRITERS["roadblock"](sure_rig(crooked_rig("pinhole")))[""]
ROW = SURE[SURE.index("      - [") : SURE.index("\n", SURE.index("      - ["))]  # of left.fx_px
KALIBR = WRITERS["kalibr"](crooked_rig("radtan"))[""]


def with_T(T, name="T_left_right"):
    rows = "".join(f"\n  - {row}" for row in np.asarray(T).tolist())
    return re.sub(rf"{name}:(\n  - .*){{4}}", f"{name}:{rows}", GOOD)


BOMB = "roadblock_rig: 1\na: &a [x, x]\n" + "".join(
    f"{c}: &{c} [*{b}, *{b}]\n" for b, c in zip("abcdefgh", "bcdefghi", strict=True)
)
MIRRORED = np.diag([1.0, -1, 1, 1]) + np.array([[0, 0, 0, 0.2]] + [[0] * 4] * 3)
SHEARED = np.eye(4) + np.array([[0, 0.01, 0, 0.2]] + [[0] * 4] * 3)

BAD = {
    "empty": ("", "is empty"),
    "blank": (" \n\n", "is empty"),
    "binary": (b"\x89PNG\r\n\x1a\n\xff\xfe", "is no text"),
    "zero bytes": (b"roadblock_rig: 1\n\0\0", "holds zero bytes"),
    "too large": (b"#" * (MAX_BYTES + 1), "is larger than 1000 kB"),
    "another text": ("Dear diary,\n", r"is no rig file known here, .*looked for roadblock \(roadblock_rig:\); opencv"),
    "two formats": (GOOD + "cam0: 1\n", "may be roadblock or kalibr: say which with --format"),
    "bomb": (BOMB, "uses a YAML anchor or alias at line 2"),
    "alias": ("roadblock_rig: 1\nleft: *a\n", "uses a YAML anchor or alias at line 2|undefined alias"),
    "python tag": (GOOD + "x: !!python/object/apply:os.system [ls]\n", "uses the YAML tag .*python/object"),
    "binary tag": (GOOD + "x: !!binary aaaa\n", "uses the YAML tag"),
    "deep": ("roadblock_rig: 1\nleft: " + "[" * 100_000, "nested deeper than 16 levels"),
    "truncated in a list": (GOOD[: GOOD.rindex("]")], "is not valid YAML.*truncated"),
    "truncated at a line": (GOOD[: GOOD.index("T_left_right:")], "T_left_right is missing"),
    "truncated in a matrix": (GOOD[: GOOD.index("T_left_right:") + 40], "not valid YAML|must be 4x4 numbers"),
    "two documents": (GOOD + "---\n" + GOOD, "is not valid YAML"),
    "tab": (GOOD.replace("  size_px", "\tsize_px"), "is not valid YAML"),
    "repeated key": (GOOD.replace("  lens", "  fx_px: 3\n  lens"), "says 'fx_px' more than once"),
    "other version": (GOOD.replace("rig: 1", "rig: 2"), "is version '2', but this program reads version 1"),
    "version no number": (GOOD.replace("rig: 1", "rig: [1]"), "roadblock_rig is version"),
    "unknown key": (GOOD + "T_left_righ: 1\n", r"T_left_righ is no known name \(did you mean T_left_right\?\)"),
    "far key": (GOOD + "zzz: 1\n", r"zzz is no known name \(known: roadblock_rig"),
    "unknown camera key": (
        GOOD.replace("  lens", "  fx: 3\n  lens", 1),
        r"left.fx is no known name \(known: size_px, fx_px",
    ),
    "missing key": (GOOD.replace("  cy_px", "  # cy_px", 1), "left.cy_px is missing"),
    "missing camera": (re.sub(r"right:\n(  .*\n)*", "", GOOD, count=1), "right is missing"),
    "camera a text": (
        re.sub(r"right:\n(  .*\n)*", "right: wide\n", GOOD, count=1),
        "right must hold names with values",
    ),
    "camera nothing": (re.sub(r"right:\n(  .*\n)*", "right: []\n", GOOD, count=1), "right must hold .* holds a list"),
    "missing distortion": (GOOD.replace("  distortion", "  # ", 1), "left.distortion is missing"),
    "NaN": (GOOD.replace("fx_px: 81.3", "fx_px: nan"), "left.fx_px must be finite"),
    "YAML NaN": (GOOD.replace("fx_px: 81.3", "fx_px: .nan"), "left.fx_px must be numbers"),
    "inf": (GOOD.replace("cx_px: 44.2", "cx_px: 1e999"), "left.cx_px must be finite"),
    "text for number": (GOOD.replace("fx_px: 81.3", "fx_px: wide"), "left.fx_px must be numbers, but got 'wide'"),
    "bool for number": (GOOD.replace("fx_px: 81.3", "fx_px: true"), "left.fx_px must be numbers, but got 'true'"),
    "list for number": (GOOD.replace("fx_px: 81.3", "fx_px: [1, 2]"), "left.fx_px must be a single number"),
    "mapping for number": (GOOD.replace("fx_px: 81.3", "fx_px: {a: 1}"), "left.fx_px must be numbers"),
    "zero focal length": (GOOD.replace("fx_px: 81.3", "fx_px: 0"), "fx_px must be > 0"),
    "negative focal length": (GOOD.replace("fx_px: 81.3", "fx_px: -81.3"), "fx_px must be > 0"),
    "wrong shape": (with_T(np.eye(3)), "T_left_right must be 4x4 numbers, but got 3x3"),
    "ragged": (GOOD.replace("  - [0.0, 0.0, 0.0, 1.0]", "  - [1.0]", 1), "T_left_right must be numbers"),
    "pose key": (
        re.sub(r"T_left_right:(\n  - .*){4}", "T_left_right: {R: 1, t: 2}", GOOD),
        "T_left_right.t is no known",
    ),
    "pose without R": (
        re.sub(r"T_left_right:(\n  - .*){4}", "T_left_right: {t_m: 2}", GOOD),
        "T_left_right.R is missing",
    ),
    "last row": (with_T(pose((0, 0, 0), (0.2, 0, 0)) + np.diag([0, 0, 0, 1])), "must end in the row 0 0 0 1"),
    "mirrored": (with_T(MIRRORED), "mirrored"),
    "not orthonormal": (with_T(SHEARED), "orthonormal rotation"),
    "mounting not orthonormal": (with_T(SHEARED, "T_vehicle_car"), "T_vehicle_car must hold an orthonormal rotation"),
    "swapped": (with_T(np.linalg.inv(crooked_rig().T_left_right)), "to the LEFT of the left one"),
    "zero baseline": (with_T(np.eye(4)), "baseline is 0 m"),
    "millimetres": (with_T(pose((0, 0, 0), (120, 0, 0))), "baseline is 120 m, .*probably another unit.*--unit"),
    "vertical": (with_T(pose((0, 0, 0), (0.01, 0.2, 0))), "above or behind the other are not supported"),
    "behind": (with_T(pose((0, 0, 0), (0.01, 0, -0.3))), "above or behind the other are not supported"),
    "looking away": (with_T(pose((0, 2, 0), (0.2, 0, 0))), "more than 60 deg apart"),
    "sizes differ": (GOOD.replace("[97, 61]", "[97, 62]", 1), "both cameras must have one image size"),
    "size zero": (GOOD.replace("[97, 61]", "[97, 0]", 1), "left.size_px must be width and height, whole and >= 1"),
    "size of one": (GOOD.replace("[97, 61]", "[97]", 1), "left.size_px must be 2 numbers, but got 1"),
    "unknown lens": (GOOD.replace("brown_conrady", "omni", 1), "left.lens must be one of pinhole, brown_conrady"),
    "lens a list": (GOOD.replace("brown_conrady", "[a]", 1), "left.lens must be one of"),
    "coefficients": (GOOD.replace("distortion: [", "distortion: [1, ", 1), "takes 5 or 8 coefficients, but got 6"),
    "calibration a text": (GOOD + "calibration: good\n", "calibration must hold names with values, but holds a single"),
    "calibration empty": (GOOD + "calibration: {}\n", r"calibration.covariance is missing \(found: nothing\)"),
    "calibration key": (
        SURE.replace("  covariance:", "  covarianc:"),
        r"calibration.covarianc is no known name \(did you mean covariance",
    ),
    "covariance a list": (
        GOOD + "calibration: {covariance: []}\n",
        r"calibration.covariance must hold names with values, but holds a list",
    ),
    "verdict": (
        SURE.replace("calibration:\n", "calibration:\n  verdict: fine\n"),
        "verdict must be one of good, usable, refused, but got 'fine'",
    ),
    "covariance key": (SURE.replace("    matrix:", "    matix:"), r"calibration.covariance.matix is no .*mean matrix"),
    "covariance without names": (
        re.sub(r"    names: .*\n", "", SURE),
        "calibration.covariance.names is missing",
    ),
    "names a text": (re.sub(r"names: .*", "names: all", SURE), "names must be a list of .*, but got 'all'"),
    "names nested": (SURE.replace("[left.fx_px", "[[left.fx_px]"), "names must be a list of .*, but got"),
    "wrong names": (
        SURE.replace("right.cx_px", "right.cx"),
        "covariance must be of these cameras' 14 parameters, but number 7 is right.cx where right.cx_px is expected",
    ),
    "names of another lens": (
        SURE.replace("lens: pinhole\n  distortion: []", "lens: kannala_brandt\n  distortion: [0, 0, 0, 0]", 1),
        "cameras' 18 parameters, but number 5 is right.fx_px where left.k1 is expected",
    ),
    "one row less": (SURE.replace(ROW + "\n", ""), "matrix must be 14x14 numbers, but got 13x14"),
    "one name less": (SURE.replace("[left.fx_px, ", "["), "matrix must be 13x13 numbers, but got 14x14"),
    "ragged covariance": (SURE.replace(ROW, "      - [1.0]"), "calibration.covariance.matrix must be numbers"),
    "covariance NaN": (re.sub(r"- \[[\d.e-]+", "- [nan", SURE, count=1), "covariance.matrix must be numbers|finite"),
    "covariance .nan": (SURE.replace(ROW, ROW.replace("0.", ".nan", 1)), "covariance.matrix must be numbers"),
    "covariance null": (SURE.replace(ROW, ROW.replace("[0.", "[null, 0.", 1)), "covariance.matrix must be numbers"),
    "not symmetric": (SURE.replace(ROW, ROW.replace(", ", ", 1", 1)), "covariance must be symmetric with variances >="),
    "negative variance": (SURE.replace(ROW, ROW.replace("[", "[-", 1)), "covariance must be symmetric with variances"),
    "not positive semi-definite": (
        SURE.replace(ROW, ROW.replace("[0.", "[0.000", 1)),
        "covariance must be positive semi-definite, but is not",
    ),
    "a list": ("- roadblock_rig: 1\nroadblock_rig: 1\n", "is not valid YAML"),
    "opencv: missing matrix": (OPENCV.replace("M1", "M9"), "holds none of M1, K1, cameraMatrix1"),
    "opencv: two names": (OPENCV.replace("image_width", "K1: 3\nimage_width"), "holds M1 and K1, which mean the same"),
    "opencv: NaN": (OPENCV.replace("81.3", ".Nan", 1), "M1.data must be numbers"),
    "opencv: rows": (OPENCV.replace("rows: 3", "rows: 2", 1), "M1 must hold 2 x 3 numbers, but has 9"),
    "opencv: half a row": (OPENCV.replace("rows: 3\n   cols: 3", "rows: 4.5\n   cols: 2", 1), "M1 must hold 4.5 x 2"),
    "opencv: no data": (OPENCV.replace("data:", "dat:", 1), "M1.data is missing"),
    "opencv: height": (OPENCV.replace("image_height", "height"), "image_height is missing"),
    "opencv: model": (OPENCV.replace("plumb_bob", "omni", 1), "distortion_model must be one of plumb_bob"),
    "opencv: model a list": (OPENCV.replace("plumb_bob", "[x]", 1), "distortion_model must be one of plumb_bob"),
    "opencv: 6 coefficients": (
        OPENCV.replace("rows: 5", "rows: 6", 1).replace("-0.27", "1., -0.27"),
        "M1, D1: Brown-Conrady lenses take 4, 5 or 8 coefficients, but got 6",
    ),
    "opencv: thin prism": (
        OPENCV.replace("rows: 5", "rows: 12", 1).replace("-0.27", "1., 1., 1., 1., 1., 1., 1., -0.27"),
        "thin-prism and tilted-sensor coefficients are not supported",
    ),
    "opencv: fisheye of 5": (
        OPENCV.replace("plumb_bob", "equidistant", 1),
        "M1, D1: lens kannala_brandt takes 4 coefficients, but got 5",
    ),
    "opencv: skew": (OPENCV.replace("81.3, 0.,", "81.3, 0.5,", 1), r"M1, D1: the camera matrix must be .*no skew"),
    "opencv: no K": (OPENCV.replace("0., 0., 1.", "0., 0., 2.", 1), "M1, D1: the camera matrix must be"),
    "opencv: mirrored": (
        OPENCV.replace("0., 1., 0., 0., 0., 1. ]", "0., -1., 0., 0., 0., 1. ]"),
        "R must .* a mirrored one",
    ),
    "opencv: not a rotation": (OPENCV.replace("[ 1., 0., 0., 0.,", "[ 1., 0.1, 0., 0.,"), "R must be a rotation"),
    "opencv: R of 4": (
        OPENCV.replace(matrix("R", 3, 3, "1., 0., 0., 0., 1., 0., 0., 0., 1."), "R: [0, 0, 0, 1]\n"),
        "R must be 3x3 numbers, but got 4",
    ),
    "opencv: T of 2": (
        OPENCV.replace(matrix("T", 3, 1, "-0.2, 0., 0."), "T: [0, 0]\n"),
        "T must be 3 numbers, but got 2",
    ),
    "opencv: 8 TB": (
        OPENCV.replace("rows: 3\n   cols: 3", "rows: 1000000\n   cols: 1000000", 1),
        "M1 must hold 1e.06 x 1e.06",
    ),
    "opencv: swapped": (OPENCV.replace("-0.2,", "0.2,"), "to the LEFT of the left one"),
    "kalibr: model": (
        KALIBR.replace("camera_model: pinhole", "camera_model: ds", 1),
        "cam0.camera_model 'ds' is not supp",
    ),
    "kalibr: lens": (
        KALIBR.replace("radtan", "fov", 1),
        "cam0.distortion_model must be one of radtan, equidistant, none",
    ),
    "kalibr: lens a list": (KALIBR.replace("radtan", "[x]", 1), "cam0.distortion_model must be one of"),
    "kalibr: three": (KALIBR + "cam2: 1\n", "must hold two cameras, cam0 and cam1, but holds cam0, cam1, cam2"),
    "kalibr: last row": (KALIBR.replace("0.0, 0.0, 0.0, 1.0", "0.0, 0.0, 0.0, 2.0"), "must end in the row 0 0 0 1"),
}


@pytest.mark.parametrize("name", BAD)
def test_one_clear_line(tmp_path, capfd, name):
    content, match = BAD[name]
    path = tmp_path / "rig.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    assert content not in (GOOD, OPENCV, KALIBR)
    with pytest.raises(RigError, match=match) as caught:
        read_rig(path)
    message = str(caught.value)
    assert message.startswith("rig.yaml: ")
    assert "\n" not in message
    assert len(message) < 600
    assert capfd.readouterr() == ("", "")


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(RigError, match=r"^gone.yaml: there is no such file"):
        read_rig(tmp_path / "gone.yaml")
    with pytest.raises(RigError, match="is a folder without a pair of rig files"):
        read_rig(tmp_path)
    with pytest.raises(RigError, match="is a folder, but a rig file was expected"):
        read_rig(tmp_path, right=tmp_path)
    with pytest.raises(RigError, match="cannot be read: embedded null byte"):
        read_rig("a\0b")


def test_text_that_is_no_mapping(tmp_path):
    (tmp_path / "a.yaml").write_text("- 1\n- 2\n")
    with pytest.raises(RigError, match=r"^a.yaml: must hold names with values, but holds a list"):
        read_rig(tmp_path / "a.yaml", format="roadblock")


def test_folder_with_several_pairs(tmp_path):
    for name in ("left.yaml", "right.yaml", "left.yml", "right.yml"):
        (tmp_path / name).write_text("x")
    with pytest.raises(
        RigError, match=r"several pairs of rig files \(left.yaml \+ right.yaml; left.yml \+ right.yml\)"
    ):
        read_rig(tmp_path)


@pytest.mark.parametrize("unit_m", [0, -1, float("nan"), float("inf")])
def test_units_must_be_positive(tmp_path, unit_m):
    path = write_rig(crooked_rig(), tmp_path / "rig.yaml")[0]
    with pytest.raises(RigError, match=r"rig.yaml: unit_m must be finite and > 0"):
        read_rig(path, unit_m=unit_m)


def test_size_must_be_the_files_own(tmp_path):
    path = write_rig(crooked_rig(), tmp_path / "rig.yaml")[0]
    assert read_rig(path, size_px=(97, 61)).left.size_px == (97, 61)
    with pytest.raises(RigError, match=r"rig.yaml: is for images of 97x61, but these are 640x480"):
        read_rig(path, size_px=(640, 480))
    with pytest.raises(RigError, match="size_px must be width and height"):
        read_rig(path, size_px=(0, 480))


def test_two_files_where_one_is_enough(tmp_path):
    path = write_rig(crooked_rig(), tmp_path / "rig.yaml")[0]
    with pytest.raises(RigError, match=r"rig.yaml \+ rig.yaml: format roadblock is one file, but two were given"):
        read_rig(path, right=path)
    opencv = write_rig(crooked_rig(), tmp_path / "rig.yml", "opencv")[0]
    with pytest.raises(RigError, match="or two different ones"):
        read_rig(path, right=opencv)
    with pytest.raises(RigError, match="D1 is in both files: keep it in one"):
        read_rig(opencv, right=opencv)


ROS_BAD = {
    "uncalibrated": (r"camera_matrix:(\n.*){2}\n  data: \[81.3", r"camera_matrix:\1\n  data: [0.0", "not calibrated"),
    "lens": ("plumb_bob", "omni", "left: distortion_model must be one of plumb_bob"),
    "lens a list": ("plumb_bob", "[x]", "left: distortion_model must be one of plumb_bob"),
    "no matrix": ("rectification_matrix", "rect", "left: rectification_matrix is missing"),
    "no height": ("image_height", "height", "left: image_height is missing"),
    "few numbers": (
        r"(camera_matrix:(\n.*){2}\n  data: \[)81.3, ",
        r"\1",
        "camera_matrix.data must be 9 numbers, but got 8",
    ),
    "other focal length": (
        r"(projection_matrix:(\n.*){2}\n  data: \[)[\d.]+",
        r"\g<1>50.0",
        "must have the same focal",
    ),
    "negative focal length": (r"(projection_matrix:(\n.*){2}\n  data: \[)", r"\1-", "must have positive focal lengths"),
    "not a rotation": (
        r"(rectification_matrix:(\n.*){2}\n  data: \[)[\d.]+",
        r"\g<1>0.5",
        "left: rectification_matrix must",
    ),
}


@pytest.mark.parametrize("name", ROS_BAD)
def test_bad_ros_pairs(tmp_path, name):
    old, new, match = ROS_BAD[name]
    left, _ = write_rig(crooked_rig(), tmp_path / "pair", "ros")
    text = left.read_text()
    left.write_text(re.sub(old, new, text))
    if name == "uncalibrated":
        left.write_text(text.replace("81.3", "0.0"))
    assert left.read_text() != text
    with pytest.raises(RigError, match=match) as caught:
        read_rig(tmp_path / "pair")
    assert str(caught.value).startswith("left.yaml + right.yaml: ")


def test_swapped_or_half_or_vertical_ros_pairs(tmp_path):
    left, right = write_rig(crooked_rig("pinhole", rotvec=(0, 0, 0)), tmp_path / "pair", "ros")
    with pytest.raises(RigError, match=r"left.yaml: holds one camera, but a rig needs two"):
        read_rig(left)
    with pytest.raises(RigError, match=r"right.yaml \+ left.yaml: the right camera sits .* to the LEFT"):
        read_rig(right, right=left)
    lines = right.read_text().splitlines()
    P = re.findall(r"[-\d.e]+", lines[-1])
    P[7] = "-5.0"
    right.write_text("\n".join([*lines[:-1], f"  data: [{', '.join(P)}]"]))
    with pytest.raises(RigError, match="vertical baseline"):
        read_rig(tmp_path / "pair")
