"""Writing and reading back; and files made by OpenCV itself, or by hand."""

import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from rig_examples import COEFFICIENTS, LENS_OF, SIZE_PX, assert_same, crooked_camera, crooked_rig, pose, sure_rig

from roadblock.errors import OutputError, RigError
from roadblock.geometry.uncertainty import range_sigma
from roadblock.io.rig import READERS, WRITERS, read_rig, write_rig
from roadblock.io.rig.files import Asked
from roadblock.values.camera import Camera, StereoRig

LENSES = tuple(COEFFICIENTS)
CARRIED = [(f, lens) for f in WRITERS for lens in LENSES if f != "kalibr" or lens not in ("brown_conrady", "rational")]


def at(folder: Path, name: str) -> Path:
    return folder / ("pair" if name == "ros" else "rig.yaml")


@pytest.mark.parametrize(("name", "lens"), CARRIED)
def test_written_files_read_back_the_same(tmp_path, name, lens):
    rig = crooked_rig(lens)
    written = write_rig(rig, at(tmp_path, name), name)
    assert [path.is_file() for path in written] == [True] * (2 if name == "ros" else 1)
    assert_same(read_rig(at(tmp_path, name)), rig, 1e-12 if name == "roadblock" else 1e-9)


@pytest.mark.parametrize("name", WRITERS)
def test_left_and_right_may_have_different_lenses(tmp_path, name):
    rig = crooked_rig("kannala_brandt", "radtan")
    write_rig(rig, at(tmp_path, name), name)
    assert_same(read_rig(at(tmp_path, name)), rig)


@pytest.mark.parametrize("name", ["roadblock", "opencv"])
def test_mounting_is_kept(tmp_path, name):
    rig = crooked_rig(mounting=True)
    write_rig(rig, tmp_path / "rig.yaml", name)
    assert_same(read_rig(tmp_path / "rig.yaml"), rig)
    scaled = read_rig(tmp_path / "rig.yaml", unit_m=0.5)
    np.testing.assert_allclose(scaled.T_vehicle_car[:3, 3], rig.T_vehicle_car[:3, 3] / 2)


@pytest.mark.parametrize("lens", LENSES)
def test_a_covariance_is_kept_exactly(tmp_path, lens):
    rig = sure_rig(crooked_rig(lens, "kannala_brandt", mounting=True))
    write_rig(rig, tmp_path / "rig.yaml")
    read = read_rig(tmp_path / "rig.yaml")
    assert read.covariance.names == rig.covariance.names
    np.testing.assert_array_equal(read.covariance.matrix, rig.covariance.matrix)
    assert_same(read, rig, 0)
    first = (tmp_path / "rig.yaml").read_text()
    write_rig(read, tmp_path / "rig.yaml")
    assert (tmp_path / "rig.yaml").read_text() == first


def test_a_covariance_is_in_the_unit_of_its_lengths(tmp_path):
    rig = sure_rig(crooked_rig())
    write_rig(rig, tmp_path / "rig.yaml")
    half = read_rig(tmp_path / "rig.yaml", unit_m=0.5)
    expected = rig.covariance.matrix.copy()
    expected[-3:] *= 0.5
    expected[:, -3:] *= 0.5
    np.testing.assert_allclose(half.covariance.matrix, expected, rtol=1e-15)


def test_people_read_the_range_sigma_in_our_file(tmp_path):
    rig = sure_rig(crooked_rig("kannala_brandt", rotvec=(0.021, 0.35, 0.017)))
    path = write_rig(rig, tmp_path / "rig.yaml")[0]
    told = yaml.safe_load(path.read_text())["calibration"]["range_sigma_m"]
    assert list(told) == [5, 10, 20, 40]
    for distance_m, rows in told.items():
        expected = range_sigma(rig, distance_m)
        np.testing.assert_array_equal([[cell is None for cell in row] for row in rows], np.isnan(expected))
        known = np.array([[np.nan if cell is None else cell for cell in row] for row in rows])
        np.testing.assert_allclose(known, expected, rtol=0.006)
    assert np.isnan(known).any()  # the right camera sees not all that the left one does
    text = path.read_text()
    path.write_text(text[: text.index("  # Standard deviation of the range")])  # they follow from the covariance
    np.testing.assert_array_equal(read_rig(path).covariance.matrix, rig.covariance.matrix)


def test_the_verdict_stands_beside_the_covariance(tmp_path):
    path = write_rig(replace(sure_rig(crooked_rig()), verdict="refused"), tmp_path / "rig.yaml")[0]
    assert yaml.safe_load(path.read_text())["calibration"]["verdict"] == "refused"
    assert read_rig(path).verdict == "refused"


def test_a_file_without_a_covariance_has_none(tmp_path):
    path = write_rig(crooked_rig(), tmp_path / "rig.yaml")[0]
    assert "calibration" not in path.read_text()
    assert read_rig(path).covariance is None


@pytest.mark.parametrize("name", ["opencv", "ros", "kalibr"])
def test_other_formats_carry_no_covariance(tmp_path, name):
    write_rig(sure_rig(crooked_rig("radtan")), at(tmp_path, name), name)
    assert read_rig(at(tmp_path, name)).covariance is None


@pytest.mark.parametrize("name", ["ros", "kalibr"])
def test_formats_without_room_for_the_mounting_refuse_it(tmp_path, name):
    with pytest.raises(RigError, match="no room for the mounting"):
        write_rig(crooked_rig("pinhole", mounting=True), at(tmp_path, name), name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("lens", ["brown_conrady", "rational"])
def test_kalibr_refuses_lenses_it_cannot_carry(tmp_path, lens):
    with pytest.raises(RigError, match=r"rig.yaml: kalibr's radtan has k1 k2 p1 p2 only"):
        write_rig(crooked_rig(lens), tmp_path / "rig.yaml", "kalibr")


def test_ros_refuses_cameras_without_a_common_view_ahead(tmp_path):
    lost = Camera(SIZE_PX, 80, 80, -4000, 30, "brown_conrady", [-0.3, 0, 0, 0, 0])
    with pytest.raises(RigError, match="pair: ros files need a common view ahead, but a lens sees nothing"):
        write_rig(StereoRig(lost, lost, pose((0, 0, 0), (0.2, 0, 0))), tmp_path / "pair", "ros")


numbers_ = st.floats(-0.2, 0.2)
coefficients = st.lists(st.floats(-0.3, 0.3), min_size=8, max_size=8)


@st.composite
def rigs(draw):
    def a_camera():
        lens = draw(st.sampled_from(LENSES))
        d = np.array(draw(coefficients)[: len(COEFFICIENTS[lens])])
        d[4:5] *= lens != "radtan"
        d[:1] += 0.31 * (len(d) > 0)  # zeros alone would be a pinhole
        fx, fy, cx, cy = (draw(st.floats(30, 900)) for _ in range(4))
        return Camera(SIZE_PX, fx, fy, cx, cy, LENS_OF[lens], d)

    rotvec = [draw(numbers_) for _ in range(3)]
    t = (draw(st.floats(0.05, 1.5)), 0.2 * draw(numbers_), 0.2 * draw(numbers_))
    return StereoRig(a_camera(), a_camera(), pose(rotvec, t))


@settings(max_examples=60, deadline=None)
@given(rig=rigs(), name=st.sampled_from(list(WRITERS)))
def test_any_crooked_rig_reads_back_the_same(rig, name):
    try:
        texts = WRITERS[name](rig)
    except RigError:
        assume(False)  # a lens that the format has no room for; tested above
    assert_same(READERS[name](tuple(texts.values()), Asked()), rig)


def test_our_file_is_exact_and_readable_by_any_yaml_reader(tmp_path):
    tiny = Camera(SIZE_PX, 1e3 / 3, 2e22, 1e-5, 0.1, "kannala_brandt", [1e-7, -3e-300, 1e16, -0.0])
    rig = StereoRig(tiny, tiny, pose((0.01, 0.02, 1e-9), (0.2, 1e-7, -1e-5)))
    write_rig(rig, tmp_path / "rig.yaml")
    assert_same(read_rig(tmp_path / "rig.yaml"), rig, 0)
    plain = yaml.safe_load((tmp_path / "rig.yaml").read_text())
    assert plain["left"]["cx_px"] == 1e-5
    assert plain["left"]["distortion"] == tiny.distortion.tolist()
    np.testing.assert_array_equal(plain["T_left_right"], rig.T_left_right)


def test_our_pose_may_be_rotation_and_translation(tmp_path):
    rig = crooked_rig()
    text = WRITERS["roadblock"](rig)[""]
    head = text[: text.index("T_left_right:")]
    R, t = rig.T_left_right[:3, :3].tolist(), rig.T_left_right[:3, 3].tolist()
    (tmp_path / "rig.yaml").write_text(f"{head}T_left_right:\n  R: {R}\n  t_m: {t}\n")
    assert_same(read_rig(tmp_path / "rig.yaml"), rig, 1e-12)


def test_floats_without_a_dot_are_numbers(tmp_path):
    text = WRITERS["roadblock"](crooked_rig("pinhole"))[""]
    (tmp_path / "rig.yaml").write_text(re.sub(r"fx_px: 81.3", "fx_px: 1e3", text))
    assert read_rig(tmp_path / "rig.yaml").left.fx_px == 1000


# --- OpenCV ---------------------------------------------------------------------------------------------------------


def opencv_convention(rig):
    T = np.linalg.inv(rig.T_left_right)
    return T[:3, :3].copy(), T[:3, 3:].copy()


def opencv_file(path, **nodes):
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, value in nodes.items():
        storage.write(name, value)
    storage.release()


NAMES = [
    ("M1", "D1", "M2", "D2"),
    ("K1", "D1", "K2", "D2"),
    ("cameraMatrix1", "distCoeffs1", "cameraMatrix2", "distCoeffs2"),
    ("camera_matrix_1", "dist_coeffs_1", "camera_matrix_2", "dist_coeffs_2"),
]


@pytest.mark.parametrize("names", NAMES)
@pytest.mark.parametrize("flat", [False, True])
def test_files_that_opencv_wrote(tmp_path, names, flat):
    rig = crooked_rig("rational")
    R, T = opencv_convention(rig)
    d = [np.r_[c.distortion, np.zeros(6)] for c in (rig.left, rig.right)]
    values = (rig.left.K, d[0] if flat else d[0][None], rig.right.K, d[1] if flat else d[1][:, None])
    width, height = SIZE_PX
    opencv_file(
        tmp_path / "a.yml",
        **dict(zip(names, values, strict=True)),
        R=R,
        T=T.ravel() if flat else T,
        image_width=width,
        image_height=height,
    )
    assert_same(read_rig(tmp_path / "a.yml"), rig)


@pytest.mark.parametrize("head", ["%YAML:1.0", "%YAML 1.2"])
def test_both_heads_and_a_size_as_list(tmp_path, head):
    rig = crooked_rig("rational")
    text = WRITERS["opencv"](rig)[""]
    text = re.sub(r"\A%YAML.*", head, text).replace("image_width: 97\nimage_height: 61\n", "imageSize: [ 97, 61 ]\n")
    assert "imageSize" in text
    (tmp_path / "a.yml").write_text(text)
    assert_same(read_rig(tmp_path / "a.yml"), rig)


def test_opencv_reads_what_we_write(tmp_path):
    rig = crooked_rig("rational", mounting=True)
    write_rig(rig, tmp_path / "rig.yml", "opencv")
    storage = cv2.FileStorage(str(tmp_path / "rig.yml"), cv2.FILE_STORAGE_READ)
    R, T = opencv_convention(rig)
    for name, value in (("M1", rig.left.K), ("M2", rig.right.K), ("R", R), ("T", T)):
        np.testing.assert_allclose(storage.getNode(name).mat(), value, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(storage.getNode("D2").mat().ravel(), rig.right.distortion)
    assert (storage.getNode("image_width").real(), storage.getNode("image_height").real()) == SIZE_PX


def test_intrinsics_and_extrinsics_in_two_files(tmp_path):
    rig = crooked_rig("radtan")
    R, T = opencv_convention(rig)
    left, right = rig.left, rig.right
    D1, D2 = (c.distortion[:, None].copy() for c in (left, right))
    opencv_file(tmp_path / "intrinsics.yml", M1=left.K, D1=D1, M2=right.K, D2=D2)
    opencv_file(tmp_path / "extrinsics.yml", R=R, T=T * 1000)
    for path, second in ((tmp_path, None), (tmp_path / "intrinsics.yml", tmp_path / "extrinsics.yml")):
        assert_same(read_rig(path, right=second, size_px=SIZE_PX, unit_m=0.001), rig)
    with pytest.raises(RigError, match=r"intrinsics.yml \+ extrinsics.yml: says no image size .* --size 640x480"):
        read_rig(tmp_path)


@pytest.mark.parametrize("fisheye", [False, True])
def test_zed_own_opencv_file(tmp_path, fisheye):
    rig = crooked_rig("kannala_brandt" if fisheye else "rational")
    R, T = opencv_convention(rig)
    tail = "_FE" if fisheye else ""
    D = {f"D_LEFT{tail}": rig.left.distortion[:, None].copy(), f"D_RIGHT{tail}": rig.right.distortion[:, None].copy()}
    size = np.array(SIZE_PX, np.int32)
    opencv_file(
        tmp_path / "z.yml", Size=size, K_LEFT=rig.left.K, K_RIGHT=rig.right.K, **D, R=cv2.Rodrigues(R)[0], T=T * 1000
    )
    assert_same(read_rig(tmp_path / "z.yml"), rig)


@pytest.mark.parametrize(("model", "lens"), [("equidistant", "kannala_brandt"), ("plumb_bob", "brown_conrady")])
def test_four_coefficients_need_their_lens_named(tmp_path, model, lens):
    R, T = opencv_convention(crooked_rig())
    D = np.array([[0.1, 0.02, 0.003, 0.004]])
    K = crooked_camera("pinhole").K
    nodes = {"image_width": 97, "image_height": 61, "M1": K, "D1": D, "M2": K, "D2": D, "R": R, "T": T}
    opencv_file(tmp_path / "a.yml", **nodes)
    with pytest.raises(
        RigError, match=r"D1 has 4 coefficients, which may be .*add the line 'distortion_model: plumb_bob'"
    ):
        read_rig(tmp_path / "a.yml")
    opencv_file(tmp_path / "b.yml", **nodes, distortion_model=model)
    rig = read_rig(tmp_path / "b.yml")
    assert rig.left.lens == lens
    np.testing.assert_array_equal(rig.left.distortion[:4], D[0])


# --- ROS ------------------------------------------------------------------------------------------------------------


def test_ros_pair_made_with_opencv_rectification(tmp_path):
    """An independent rectification (cv2.stereoRectify) must lead back to the same raw rig."""
    rig = crooked_rig("brown_conrady")
    R, T = opencv_convention(rig)
    left, right = rig.left, rig.right
    R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, left.distortion, right.K, right.distortion, SIZE_PX, R, T, alpha=0)
    for name, camera, R_, P in (("left", left, R1, P1), ("right", right, R2, P2)):
        document = {"image_width": 97, "image_height": 61, "camera_name": name, "distortion_model": "plumb_bob"}
        for key, matrix in (
            ("camera_matrix", camera.K),
            ("distortion_coefficients", camera.distortion[None]),
            ("rectification_matrix", R_),
            ("projection_matrix", P),
        ):
            rows, cols = matrix.shape
            document[key] = {"rows": rows, "cols": cols, "data": matrix.ravel().tolist()}
        (tmp_path / f"{name}.yaml").write_text(yaml.safe_dump(document))
    assert_same(read_rig(tmp_path), rig)
    assert_same(read_rig(tmp_path / "left.yaml", right=tmp_path / "right.yaml"), rig)


def test_written_ros_pair_projects_one_point_into_one_row(tmp_path):
    rig = crooked_rig("pinhole")
    left, right = (path for path in write_rig(rig, tmp_path / "pair", "ros"))
    point_left = np.array([0.4, -0.3, 5.0])
    point_right = np.linalg.solve(rig.T_left_right, [*point_left, 1])[:3]
    pixels = []
    for path, point in ((left, point_left), (right, point_left)):
        info = yaml.safe_load(path.read_text())
        R1 = np.reshape(yaml.safe_load(left.read_text())["rectification_matrix"]["data"], (3, 3))
        P = np.reshape(info["projection_matrix"]["data"], (3, 4))
        u, v, w = P @ [*(R1 @ point), 1]
        pixels.append((u / w, v / w))
    R2 = np.reshape(yaml.safe_load(right.read_text())["rectification_matrix"]["data"], (3, 3))
    P2 = np.reshape(yaml.safe_load(right.read_text())["projection_matrix"]["data"], (3, 4))
    x, y, z = P2[:, :3] @ R2 @ point_right
    np.testing.assert_allclose(pixels[1], (x / z, y / z), atol=1e-9)
    assert pixels[0][1] == pytest.approx(pixels[1][1], abs=1e-9)
    assert pixels[0][0] > pixels[1][0]


# --- Kalibr ---------------------------------------------------------------------------------------------------------

KALIBR = """
cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [0.01, -0.02, 0.003, 0.004]
  distortion_model: radtan
  intrinsics: [80.5, 79.5, 48.1, 30.2]
  resolution: [97, 61]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.0, 0.0, -1.0, 0.1]
  - [0.0, 1.0, 0.0, 0.02]
  - [1.0, 0.0, 0.0, 0.03]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: []
  distortion_model: none
  intrinsics: [81.5, 78.5, 47.1, 31.2]
  resolution: [97, 61]
  rostopic: /cam1/image_raw
"""


def test_kalibr_by_hand(tmp_path):
    """cam1's points are T times cam0's; an angle of 30 deg about y and 0.2 m to the right, worked out by hand."""
    c, s = math.sqrt(3) / 2, 0.5
    rows = f"  - [{c!r}, 0.0, {s!r}, -0.2]\n  - [0.0, 1.0, 0.0, 0.0]\n  - [-0.5, 0.0, {c!r}, 0.0]\n"
    text = re.sub(r"  - \[0.0, 0.0, -1.0, 0.1\](.|\n)*?(?=  - \[0.0, 0.0, 0.0, 1.0\])", rows, KALIBR)
    (tmp_path / "camchain.yaml").write_text(text)
    rig = read_rig(tmp_path / "camchain.yaml")
    np.testing.assert_allclose(rig.T_left_right[:3, 3], [0.2 * c, 0, 0.2 * s], atol=1e-12)
    np.testing.assert_allclose(rig.T_left_right[:3, :3], [[c, 0, -s], [0, 1, 0], [s, 0, c]], atol=1e-12)
    assert (rig.left.fx_px, rig.left.fy_px, rig.left.cx_px, rig.left.cy_px) == (80.5, 79.5, 48.1, 30.2)
    assert (rig.left.lens, rig.right.lens) == ("brown_conrady", "pinhole")
    np.testing.assert_array_equal(rig.left.distortion, [0.01, -0.02, 0.003, 0.004, 0])


# --- finding and writing files --------------------------------------------------------------------------------------


def test_writing_replaces_whole_files_and_leaves_no_crumbs(tmp_path):
    path = tmp_path / "new" / "rig.yaml"
    assert write_rig(crooked_rig("pinhole"), path) == [path]
    write_rig(crooked_rig("rational"), path)
    assert read_rig(str(path)).left.lens == "brown_conrady"
    assert [p.name for p in path.parent.iterdir()] == ["rig.yaml"]


def test_failed_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "rig.yaml"
    path.write_text("old")

    def full_disk(self, text, encoding):
        with self.open("w") as file:
            file.write(text[:10])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full_disk)
    with pytest.raises(OutputError, match=r"rig.yaml cannot be written: No space left on device"):
        write_rig(crooked_rig(), path)
    assert path.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["rig.yaml"]


def test_writing_over_a_folder_or_below_a_file_is_refused(tmp_path):
    with pytest.raises(OutputError, match="is a folder, but a file was to be written there"):
        write_rig(crooked_rig(), tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(OutputError, match="cannot be written"):
        write_rig(crooked_rig(), tmp_path / "file" / "rig.yaml")


@pytest.mark.parametrize("name", ["pair.yaml", "file"])
def test_ros_needs_a_folder(tmp_path, name):
    (tmp_path / "file").write_text("x")
    with pytest.raises(RigError, match=r"two files, left.yaml and right.yaml: name a folder"):
        write_rig(crooked_rig(), tmp_path / name, "ros")


def test_unknown_formats_are_named_with_the_nearest(tmp_path):
    with pytest.raises(RigError, match="'openvc' is no format here; did you mean opencv"):
        write_rig(crooked_rig(), tmp_path / "a", "openvc")
    (tmp_path / "a").write_text("x")
    with pytest.raises(RigError, match="'xyzzy' is no format here; known: roadblock"):
        read_rig(tmp_path / "a", format="xyzzy")


def test_a_named_format_is_believed(tmp_path):
    write_rig(crooked_rig(), tmp_path / "a.yaml", "opencv")
    assert_same(read_rig(tmp_path / "a.yaml", format="opencv"), crooked_rig())
    with pytest.raises(RigError, match=r"a.yaml: roadblock_rig is missing"):
        read_rig(tmp_path / "a.yaml", format="roadblock")
