"""KITTI's calibration texts, made by construction."""

import numpy as np
import pytest
from rig_examples import SIZE_PX, assert_same, crooked_rig, pose

from roadblock.errors import RigError
from roadblock.io.rig import read_kitti_object, read_kitti_odometry, read_kitti_raw, read_rig
from roadblock.values.camera import StereoRig

F, CX, CY = 71.5, 48.2, 30.7
X_OF_CAMERA = (0.0, 0.54, -0.06, 0.473)


def line(key, values):
    return f"{key}: {' '.join(f'{v:.12e}' for v in np.ravel(values))}\n"


def projection(x, f=F):
    return np.array([[f, 0, CX, -f * x], [0, f, CY, 0], [0, 0, 1, 0]])


def object_text(*tail):
    return "".join(line(f"P{i}", projection(x)) for i, x in enumerate(X_OF_CAMERA)) + "".join(tail)


R0 = line("R0_rect", np.eye(3))


def check_twins(rig, baseline_m):
    assert rig.is_rectified
    assert (rig.left.fx_px, rig.left.cx_px, rig.left.cy_px, rig.left.size_px) == (F, CX, CY, SIZE_PX)
    np.testing.assert_allclose(rig.T_left_right, pose((0, 0, 0), (baseline_m, 0, 0)), atol=1e-9)


def test_object(tmp_path):
    path = tmp_path / "000000.txt"
    path.write_text(object_text(R0))
    check_twins(read_rig(path, size_px=SIZE_PX), 0.533)
    check_twins(read_kitti_object(path, size_px=SIZE_PX), 0.533)
    check_twins(read_kitti_object(path, pair=(0, 1), size_px=SIZE_PX), 0.54)
    check_twins(read_rig(path, pair=(0, 1), size_px=SIZE_PX, unit_m=2), 1.08)


def test_object_needs_a_size_and_its_cameras(tmp_path):
    path = tmp_path / "000000.txt"
    path.write_text(object_text(R0))
    with pytest.raises(RigError, match=r"000000.txt: says no image size .* --size 1242x375"):
        read_kitti_object(path)
    with pytest.raises(RigError, match=r"000000.txt: P4 is missing"):
        read_kitti_object(path, pair=(3, 4), size_px=SIZE_PX)
    with pytest.raises(RigError, match=r"000000.txt: the right camera sits 0.533 m to the LEFT"):
        read_kitti_object(path, pair=(3, 2), size_px=SIZE_PX)


def test_object_pair_must_be_twins(tmp_path):
    path = tmp_path / "000000.txt"
    path.write_text(line("P2", projection(0)) + line("P3", projection(0.5, F + 1)) + R0)
    with pytest.raises(RigError, match="both projection matrices must have the same focal lengths"):
        read_kitti_object(path, size_px=SIZE_PX)


@pytest.mark.parametrize(
    ("text", "match"), [("P2 1 2 3\n", "must hold lines 'NAME: numbers'"), (R0 + R0, "more than once")]
)
def test_text_lines_are_checked(tmp_path, text, match):
    path = tmp_path / "000000.txt"
    path.write_text(object_text() + text)
    with pytest.raises(RigError, match=match):
        read_kitti_object(path, size_px=SIZE_PX)


def test_odometry_with_names(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_text(object_text(line("Tr", np.eye(4)[:3])))
    check_twins(read_rig(path, size_px=SIZE_PX), 0.54)
    check_twins(read_kitti_odometry(path, size_px=SIZE_PX), 0.54)
    check_twins(read_kitti_odometry(path, pair=(2, 3), size_px=SIZE_PX), 0.533)


@pytest.mark.parametrize("blank", ["", "\n", "\r\n"])
def test_odometry_bare_rows(tmp_path, blank):
    path = tmp_path / "calib.txt"
    rows = [" ".join(f"{v:.12e}" for v in projection(x).ravel()) for x in X_OF_CAMERA[:2]]
    path.write_text(f"{blank}{rows[0]}\n{rows[1]}")
    check_twins(read_rig(path, size_px=SIZE_PX), 0.54)
    path.write_text(f"{blank}{rows[0]}\n")
    with pytest.raises(RigError, match="two rows of 12 numbers, left and right, but holds 1 rows"):
        read_kitti_odometry(path, size_px=SIZE_PX)


RAW = crooked_rig("brown_conrady")
RAW_SIZE, RECT_SIZE = SIZE_PX, (93, 55)


def raw_text(cameras=(0, 1), rect_size=RECT_SIZE):
    """Cameras at R_i, T_i with `x_i = R_i x_0 + T_i`; camera `cameras[0]` itself stands crooked to camera 0."""
    T_first_0 = pose((0.02, -0.01, 0.03), (0.06, 0.001, -0.002)) if cameras[0] else np.eye(4)
    T_second_0 = np.linalg.inv(RAW.T_left_right) @ T_first_0
    text = "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
    for i, camera, T, x in zip(cameras, (RAW.left, RAW.right), (T_first_0, T_second_0), (0, 0.5), strict=True):
        values = [("S", RAW_SIZE), ("K", camera.K), ("D", camera.distortion), ("R", T[:3, :3]), ("T", T[:3, 3])]
        values += [("S_rect", rect_size), ("P_rect", projection(x))]
        text += "".join(line(f"{key}_{i:02d}", value) for key, value in values)
    return text


@pytest.mark.parametrize("cameras", [(0, 1), (2, 3)])
def test_raw(tmp_path, cameras):
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(raw_text(cameras))
    assert_same(read_rig(path, size_px=RAW_SIZE), RAW)
    assert_same(read_kitti_raw(path, rectified=False), RAW)
    assert_same(read_kitti_raw(path, pair=cameras, size_px=RAW_SIZE), RAW)
    scaled = read_rig(path, size_px=RAW_SIZE, unit_m=2)
    np.testing.assert_allclose(scaled.T_left_right[:3, 3], 2 * RAW.T_left_right[:3, 3], atol=1e-9)


def test_raw_rectified(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(raw_text())
    for rig in (read_rig(path, size_px=RECT_SIZE), read_kitti_raw(path, rectified=True)):
        assert rig.is_rectified
        assert isinstance(rig, StereoRig)
        assert rig.left.size_px == RECT_SIZE
        assert rig.baseline_m == pytest.approx(0.5, abs=1e-9)


def test_raw_must_know_which_images(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(raw_text())
    with pytest.raises(RigError, match="raw 97x61 and rectified 93x55 images: say which by their size"):
        read_rig(path)
    with pytest.raises(RigError, match="raw 97x61 and rectified 93x55 images, but these are 640x480"):
        read_rig(path, size_px=(640, 480))
    with pytest.raises(RigError, match="raw images are 97x61, but these are 93x55: are they rectified"):
        read_kitti_raw(path, rectified=False, size_px=RECT_SIZE)
    with pytest.raises(RigError, match="rectified images are 93x55, but these are 97x61: are they raw"):
        read_kitti_raw(path, rectified=True, size_px=RAW_SIZE)
    path.write_text(raw_text(rect_size=RAW_SIZE))
    with pytest.raises(RigError, match="raw 97x61 and rectified 97x61 images: say which"):
        read_rig(path, size_px=RAW_SIZE)


def test_raw_pairs(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    head = "calib_time: 09-Jan-2012 13:57:47\ncorner_dist: 9.950000e-02\n"
    path.write_text(raw_text() + raw_text((2, 3)).replace(head, ""))
    with pytest.raises(RigError, match=r"two pairs, cameras 0,1 \(grey\) and 2,3 \(colour\): say which with --pair"):
        read_kitti_raw(path, rectified=False)
    assert_same(read_rig(path, pair=(2, 3), size_px=RAW_SIZE), RAW)
    path.write_text(line("K_00", np.eye(3)))
    with pytest.raises(RigError, match="has neither pair"):
        read_kitti_raw(path, rectified=False)


def test_raw_rectified_sizes_must_agree(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    path.write_text(raw_text().replace(line("S_rect_01", RECT_SIZE), line("S_rect_01", (92, 55))))
    with pytest.raises(RigError, match="must have one size, but they are 93x55 and 92x55"):
        read_kitti_raw(path, rectified=True)


def test_few_digits_are_made_a_rotation_but_no_nonsense(tmp_path):
    path = tmp_path / "calib_cam_to_cam.txt"
    R = np.linalg.inv(RAW.T_left_right)[:3, :3]
    path.write_text(raw_text().replace(line("R_01", R), line("R_01", np.round(R, 6))))
    rig = read_kitti_raw(path, rectified=False)
    np.testing.assert_allclose(rig.T_left_right[:3, :3], RAW.T_left_right[:3, :3], atol=1e-6)
    np.testing.assert_allclose(rig.T_left_right[:3, :3] @ rig.T_left_right[:3, :3].T, np.eye(3), atol=1e-14)
    path.write_text(raw_text().replace(line("R_01", R), line("R_01", np.round(R, 2))))
    with pytest.raises(RigError, match=r"R_01 must be a rotation .* off identity by"):
        read_kitti_raw(path, rectified=False)


def test_published_kitti_files(data_dir):
    raw = next((data_dir / "kitti_raw_0926").glob("calib_cam_to_cam*"))
    assert read_rig(raw, size_px=(1392, 512)).baseline_m == pytest.approx(0.537, abs=5e-4)
    assert read_rig(raw, size_px=(1242, 375)).baseline_m == pytest.approx(0.537, abs=5e-4)
    odometry = read_rig(data_dir / "kitti_odometry" / "calib.txt", size_px=(1241, 376))
    assert odometry.baseline_m == pytest.approx(0.537, abs=5e-4)
    assert odometry.left.fx_px == 718.856
    assert read_rig(data_dir / "kitti2015" / "calib.txt", size_px=(1242, 375)).baseline_m == pytest.approx(
        0.5327, abs=1e-4
    )
    for path in sorted((data_dir / "kitti_road" / "calib").glob("*.txt")):
        assert read_kitti_object(path, size_px=(1242, 375)).is_rectified
