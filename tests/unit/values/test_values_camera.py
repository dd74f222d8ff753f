"""Camera, StereoRig, Rectification: what they hold and what they refuse."""

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

from roadblock.errors import RigError, ValueRefusedError
from roadblock.values.camera import POSE_PARAMETERS, Camera, Rectification, RigCovariance, StereoRig, rig_parameters

SIZE = (97, 61)


def camera(**change: Any) -> Camera:
    fields = {"size_px": SIZE, "fx_px": 71.0, "fy_px": 64.0, "cx_px": 43.3, "cy_px": 33.9}
    return Camera(**(fields | change))


def beside(x: float = 0.2, y: float = 0.01, z: float = -0.02) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def turned_about_y(angle: float) -> np.ndarray:
    T = beside()
    T[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    return T


def rectification(**change: Any) -> Rectification:
    fields = {"f_px": 83.0, "cx_px": 41.7, "cy_px": 34.2, "baseline_m": 0.2, "size_px": SIZE}
    return Rectification(**(fields | change))


# --- Camera -----------------------------------------------------------------------------------------------------------


def test_camera_matrix() -> None:
    np.testing.assert_array_equal(camera().K, [[71, 0, 43.3], [0, 64, 33.9], [0, 0, 1]])


def test_camera_takes_plain_lists_and_numpy_numbers() -> None:
    cam = camera(size_px=np.array([97.0, 61.0]), fx_px=np.float32(71), lens="brown_conrady", distortion=[0.1] * 5)
    assert cam.size_px == (97, 61)
    assert [type(n) for n in cam.size_px] == [int, int]
    assert type(cam.fx_px) is float
    assert cam.distortion.dtype == np.float64


@pytest.mark.parametrize(
    ("lens", "count"), [("pinhole", 0), ("brown_conrady", 5), ("brown_conrady", 8), ("kannala_brandt", 4)]
)
def test_camera_takes_each_lens(lens: str, count: int) -> None:
    assert camera(lens=lens, distortion=np.full(count, 0.01)).distortion.shape == (count,)


def test_camera_is_frozen_and_owns_its_coefficients() -> None:
    mine = np.full(5, 0.1)
    cam = camera(lens="brown_conrady", distortion=mine)
    mine[:] = 9
    np.testing.assert_array_equal(cam.distortion, np.full(5, 0.1))
    with pytest.raises(ValueError, match="read-only"):
        cam.distortion[0] = 1
    with pytest.raises(FrozenInstanceError):
        cam.fx_px = 1.0  # type: ignore[misc]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"size_px": (0, 61)}, "size_px must be two whole numbers"),
        ({"size_px": (97, 60.5)}, "size_px must be two whole numbers"),
        ({"size_px": (97, 32768)}, "size_px must be two whole numbers from 1 to 32766"),
        ({"size_px": (97,)}, "size_px must have shape"),
        ({"size_px": "97x61"}, "size_px must be numbers"),
        ({"fx_px": 0}, "fx_px must be > 0"),
        ({"fy_px": -64}, "fy_px must be > 0"),
        ({"fy_px": np.nan}, "fy_px must be finite"),
        ({"cx_px": np.inf}, "cx_px must be finite"),
        ({"cy_px": None}, "cy_px must be numbers"),
        ({"lens": "fisheye"}, "lens must be one of pinhole, brown_conrady, kannala_brandt, but got 'fisheye'"),
        ({"lens": ["pinhole"]}, "lens must be one of"),
        ({"distortion": [0.1]}, "lens pinhole takes 0 coefficients, but got 1"),
        ({"lens": "brown_conrady", "distortion": [0.1] * 4}, "takes 5 or 8 coefficients, but got 4"),
        ({"lens": "kannala_brandt", "distortion": [0.1] * 5}, "takes 4 coefficients, but got 5"),
        ({"lens": "kannala_brandt", "distortion": np.zeros((2, 2))}, "distortion must have shape"),
        ({"lens": "kannala_brandt", "distortion": [0, 0, np.nan, 0]}, "distortion must be finite"),
        ({"lens": "kannala_brandt", "distortion": [0, 0, -1e31, 0]}, "distortion must stay below 1e.30, but got 1e.31"),
        ({"lens": "kannala_brandt", "distortion": [[1], [2, 3], 4, 5]}, "distortion must be numbers"),
    ],
)
def test_camera_refuses(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        camera(**change)


# --- StereoRig --------------------------------------------------------------------------------------------------------


def test_rig_holds_its_baseline_and_copies_its_transforms() -> None:
    mine, mounting = beside(), turned_about_y(1.2)
    rig = StereoRig(camera(), camera(cx_px=50), mine, mounting)
    assert rig.baseline_m == pytest.approx(np.sqrt(0.2**2 + 0.01**2 + 0.02**2), rel=1e-15)
    mine[0, 3] = mounting[0, 3] = 5
    assert rig.T_left_right[0, 3] == 0.2
    assert rig.T_vehicle_car is not None
    assert rig.T_vehicle_car[0, 3] == 0.2
    for T in (rig.T_left_right, rig.T_vehicle_car):
        with pytest.raises(ValueError, match="read-only"):
            T[0, 0] = 1


@pytest.mark.parametrize(
    ("T", "words"),
    [
        (beside(-0.2), "to the LEFT of the left one: the cameras are swapped"),
        (beside(0.05, 0.2), "must sit beside it"),
        (beside(0.05, 0, -0.2), "must sit beside it"),
        (beside(205), "baseline is 205 m, but .* --unit"),
        (beside(1e200), "baseline is"),
        (beside(0.004, 0, 0), "baseline is 0.004 m"),
        (beside(0, 0, 0), "baseline is 0 m"),
        (turned_about_y(1.1), "look more than 60 deg apart"),
        (turned_about_y(np.pi), "look more than 60 deg apart"),
    ],
)
def test_rig_refuses_what_cannot_be_one(T: np.ndarray, words: str) -> None:
    with pytest.raises(RigError, match=words):
        StereoRig(camera(), camera(), T)


def test_rig_takes_cameras_that_look_less_than_60_degrees_apart() -> None:
    assert StereoRig(camera(), camera(), turned_about_y(-1.0)).baseline_m > 0.2


def test_rig_refuses_two_image_sizes() -> None:
    with pytest.raises(RigError, match="one image size"):
        StereoRig(camera(), camera(size_px=(96, 61)), beside())


@pytest.mark.parametrize("which", ["T_left_right", "T_vehicle_car"])
def test_rig_refuses_what_is_no_transform(which: str) -> None:
    transforms = {"T_left_right": beside(), "T_vehicle_car": beside()} | {which: 1.01 * beside()}
    with pytest.raises(ValueRefusedError, match=which):
        StereoRig(camera(), camera(), **transforms)


def twins() -> StereoRig:
    cam = camera(fy_px=71.0)
    return StereoRig(cam, cam, beside(0.2, 0, 0))


def test_parallel_pinhole_twins_are_rectified() -> None:
    assert twins().is_rectified


@pytest.mark.parametrize(
    "rig",
    [
        replace(twins(), left=camera(fy_px=70.0), right=camera(fy_px=70.0)),
        replace(twins(), right=camera(fy_px=70.0)),
        replace(twins(), right=camera(fx_px=70.0, fy_px=70.0)),
        replace(twins(), right=camera(fy_px=71.0, cx_px=44.0)),
        replace(twins(), right=camera(fy_px=71.0, cy_px=34.0)),
        replace(twins(), left=camera(fy_px=71.0, lens="brown_conrady", distortion=np.zeros(5))),
        replace(twins(), right=camera(fy_px=71.0, lens="brown_conrady", distortion=np.zeros(5))),
        replace(twins(), T_left_right=beside(0.2, 1e-6, 0)),
        replace(twins(), T_left_right=beside(0.2, 0, 1e-6)),
        replace(twins(), T_left_right=turned_about_y(1e-4)),
    ],
)
def test_anything_else_is_not(rig: StereoRig) -> None:
    assert not rig.is_rectified


# --- RigCovariance ----------------------------------------------------------------------------------------------------

THREE = np.array([[4.0, 0.5, 0.0], [0.5, 1e-12, 0.0], [0.0, 0.0, 0.0]]) * [[1, 1e-6, 1], [1e-6, 1, 1], [1, 1, 1]]
"""Two parameters of very different units, and one that was held fixed."""


def test_parameters_have_names_in_order() -> None:
    brown = camera(lens="brown_conrady", distortion=np.full(8, 0.01))
    fish = camera(lens="kannala_brandt", distortion=np.full(4, 0.01))
    assert brown.parameters[4:] == ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    names = rig_parameters(camera(), fish)
    assert names[:5] == ("left.fx_px", "left.fy_px", "left.cx_px", "left.cy_px", "right.fx_px")
    assert names[8:12] == ("right.k1", "right.k2", "right.k3", "right.k4")
    assert names[12:] == POSE_PARAMETERS


def test_a_covariance_is_kept_as_it_is() -> None:
    mine = THREE.copy()
    covariance = RigCovariance(("a", "b", "c"), mine)
    mine[0, 0] = 9
    np.testing.assert_array_equal(covariance.matrix, THREE)
    with pytest.raises(ValueError, match="read-only"):
        covariance.matrix[0, 0] = 1


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        (THREE[:2], "covariance must have shape"),
        (np.where(THREE == 4, np.nan, THREE), "covariance must be finite"),
        (np.where(THREE == 4, -4, THREE), "symmetric with variances >= 0"),
        (THREE * [[1, 1.001, 1], [1, 1, 1], [1, 1, 1]], "symmetric with variances >= 0"),
        ([[4, 0, 1e-9], [0, 1, 0], [1e-9, 0, 0]], "positive semi-definite"),  # the fixed one moves along
        (THREE * [[1, 5, 1], [5, 1, 1], [1, 1, 1]], "positive semi-definite"),  # a correlation of 1.25
        ([[1, 0.9, 0.9], [0.9, 1, -0.9], [0.9, -0.9, 1]], "positive semi-definite"),  # each correlation alone may be
        (np.full((3, 3), 1e308) * [[1, -1, 1], [1, 1, 1], [1, 1, 1]], "symmetric with variances >= 0"),
    ],
)
def test_a_covariance_refuses_what_is_none(matrix: Any, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        RigCovariance(("a", "b", "c"), matrix)


def test_a_rig_refuses_a_covariance_of_other_parameters() -> None:
    names = rig_parameters(camera(), camera())
    good = RigCovariance(names, np.eye(len(names)))
    assert StereoRig(camera(), camera(), beside(), covariance=good).covariance is good
    for other, words in (
        (
            ("left.k1", *names[1:]),
            r"these cameras' 14 parameters, but number 1 is left\.k1 where left\.fx_px is expected",
        ),
        (names[:-1], "number 14 is nothing where tz_m is expected"),
        ((*names, "tw_m"), "number 15 is tw_m where nothing is expected"),
    ):
        with pytest.raises(ValueRefusedError, match=words):
            StereoRig(camera(), camera(), beside(), covariance=RigCovariance(other, np.eye(len(other))))


# --- Rectification ----------------------------------------------------------------------------------------------------


def test_rectification_copies_its_rotations_and_locks_its_maps() -> None:
    R, maps = np.eye(3), (np.zeros((61, 97), np.float32), np.ones((61, 97), np.float32))
    value = rectification(R_rect_left=R, maps_left=maps, maps_right=maps)
    R[0, 0] = 5
    maps[0][0, 0] = 1  # the caller's own array stays writable
    np.testing.assert_array_equal(value.R_rect_left, np.eye(3))
    assert value.maps_left is not None
    for array in (value.R_rect_left, value.R_rect_right, *value.maps_left):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1
    assert value.size_px == SIZE
    assert rectification().maps_left is rectification().maps_right is None


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"f_px": 0}, "f_px must be > 0"),
        ({"baseline_m": -0.2}, "baseline_m must be > 0"),
        ({"cx_px": np.nan}, "cx_px must be finite"),
        ({"cy_px": "34"}, "cy_px must be numbers"),
        ({"size_px": (97, 0)}, "size_px must be two whole numbers"),
        ({"R_rect_left": np.eye(4)}, "R_rect_left must have shape"),
        ({"R_rect_right": 2 * np.eye(3)}, "R_rect_right must hold an orthonormal rotation"),
        ({"R_rect_right": np.diag([1, 1, -1])}, "R_rect_right must hold a rotation"),
        ({"maps_left": (np.zeros((97, 61), np.float32),) * 2}, "maps_left must be two float32 arrays"),
        ({"maps_right": (np.zeros((61, 97)),) * 2}, "maps_right must be two float32 arrays"),
        ({"maps_right": (np.zeros((61, 97), np.float32),)}, "maps_right must be two float32 arrays"),
    ],
)
def test_rectification_refuses(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        rectification(**change)


def test_half_maps_sample_between_four_pixels() -> None:
    v, u = np.mgrid[:61, :97].astype(np.float32)
    left, right = (u * 1.5 + 2, v - 3), (v * v, u + v)
    value = rectification(maps_left=left, maps_right=right)
    assert value.half_maps is not None
    # Pixel (u, v) of the half image sits on (2u + 0.5, 2v + 0.5) of the full one; the last odd row and column go.
    y, x = np.mgrid[:30, :48]
    np.testing.assert_allclose(value.half_maps[0], (2 * x + 0.5) * 1.5 + 2)
    np.testing.assert_allclose(value.half_maps[1], 2 * y + 0.5 - 3)
    np.testing.assert_allclose(value.half_maps[2], ((2 * y) ** 2 + (2 * y + 1) ** 2) / 2)
    np.testing.assert_allclose(value.half_maps[3], 2 * x + 2 * y + 1)
    for array in value.half_maps:
        assert array.dtype == np.float32
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1


def test_without_both_maps_there_are_no_half_ones() -> None:
    maps = (np.zeros((61, 97), np.float32),) * 2
    for value in (rectification(), rectification(maps_left=maps), rectification(maps_right=maps)):
        assert value.half_maps is None
