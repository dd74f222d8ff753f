"""StereoPair, RectifiedPair, DisparityMap: what they hold and what they refuse."""

from dataclasses import FrozenInstanceError
from functools import partial
from typing import Any

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.values.camera import Rectification
from roadblock.values.frame import DisparityMap, RectifiedPair, StereoPair, Window

TWIN = Rectification(83.0, 41.7, 34.2, 0.2, (97, 61))


@pytest.mark.parametrize("shape", [(61, 97), (61, 97, 3)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pairs_take_grey_and_rgb_8_and_16_bit(shape: tuple[int, ...], dtype: Any) -> None:
    left, right = np.zeros(shape, dtype), np.ones(shape, dtype)
    raw = StereoPair(left, right, 4, "000004", 123)
    rectified = RectifiedPair(left, right, TWIN, raw.index, raw.name, raw.t_ns)
    for pair in (raw, rectified):
        assert (pair.index, pair.name, pair.t_ns) == (4, "000004", 123)
        np.testing.assert_array_equal(pair.right, right)
        for image in (pair.left, pair.right):
            with pytest.raises(ValueError, match="read-only"):
                image[0, 0] = 1
    left[0, 0] = 1  # the caller's own array stays writable
    with pytest.raises(FrozenInstanceError):
        raw.index = 5  # type: ignore[misc]


@pytest.mark.parametrize(
    ("left", "right", "words"),
    [
        (np.zeros((61, 97)), np.zeros((61, 97)), "left image must be 8 or 16 bit, but got float64"),
        (np.zeros((61, 97), np.uint8), np.zeros((61, 97), np.int16), "right image must be 8 or 16 bit, but got int16"),
        (np.zeros(61, np.uint8), np.zeros(61, np.uint8), r"grey or RGB, but has shape \(61,\)"),
        (np.zeros((61, 97, 4), np.uint8), np.zeros((61, 97, 4), np.uint8), "grey or RGB, but has shape"),
        (np.zeros((0, 97), np.uint8), np.zeros((0, 97), np.uint8), "grey or RGB, but has shape"),
        (np.zeros((61, 97), np.uint8), np.zeros((61, 96), np.uint8), "both must be alike"),
        (np.zeros((61, 97), np.uint8), np.zeros((61, 97), np.uint16), "both must be alike"),
        (np.zeros((61, 97), np.uint8), np.zeros((61, 97, 3), np.uint8), "both must be alike"),
    ],
)
def test_pairs_refuse(left: np.ndarray, right: np.ndarray, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=f"frame a: .*{words}"):
        StereoPair(left, right, 0, "a")
    with pytest.raises(ValueRefusedError, match=f"frame a: .*{words}"):
        RectifiedPair(left, right, TWIN, 0, "a")


def test_a_rectified_pair_has_its_rig_s_size() -> None:
    image = np.zeros((97, 61), np.uint8)
    with pytest.raises(ValueRefusedError, match="images are 61x97, but the rig is for 97x61"):
        RectifiedPair(image, image, TWIN)


def test_a_pair_made_of_full_images_has_no_half_ones() -> None:
    image = np.zeros((61, 97), np.uint8)
    assert RectifiedPair(image, image, TWIN).half is None


def test_a_deferred_pair_makes_its_full_images_once_and_when_looked_at() -> None:
    half = np.zeros((30, 48), np.uint8), np.ones((30, 48), np.uint8)
    mine = {"left": np.full((61, 97, 3), 3, np.uint8), "right": np.full((61, 97, 3), 4, np.uint8)}
    made: list[str] = []

    def make(side: str, window: Window) -> np.ndarray:
        made.append(side)
        return mine[side][window]

    pair = RectifiedPair.deferred(partial(make, "left"), partial(make, "right"), half, None, TWIN, 4, "000004", 123)
    assert (pair.index, pair.name, pair.t_ns, pair.rectification) == (4, "000004", 123, TWIN)
    assert pair.half == half
    assert made == []
    assert pair.right is pair.right
    assert made == ["right"]
    assert pair.left is pair.left
    assert made == ["right", "left"]
    for side, image in (("left", pair.left), ("right", pair.right)):
        np.testing.assert_array_equal(image, mine[side])
        with pytest.raises(ValueError, match="read-only"):
            image[0, 0] = 1
        mine[side][0, 0] = 1  # the caller's own array stays writable


def test_disparity_map_is_read_only_and_keeps_unknown() -> None:
    mine = np.array([[1.5, np.nan]], np.float32)
    value = DisparityMap(mine, 0.4, 4)
    assert np.isnan(value.d_px[0, 1])
    assert (value.sigma_px, value.cell_px) == (0.4, 4)
    with pytest.raises(ValueError, match="read-only"):
        value.d_px[0, 0] = 2
    mine[0, 0] = 3


def test_cells_are_centred_between_their_pixels() -> None:
    d_px = np.array([[1, 2, 3], [4, np.nan, 6]], np.float32)
    coarse = DisparityMap(d_px, 0.4, cell_px=4).uvd_px
    # The first cell covers the columns 0 1 2 3: its centre is 1.5; the next 4 5 6 7: 5.5.
    np.testing.assert_array_equal(coarse[1], [[1.5, 5.5, 4], [5.5, 5.5, np.nan], [9.5, 5.5, 6]])
    dense = DisparityMap(d_px, 0.4).uvd_px
    np.testing.assert_array_equal(dense[0], [[0, 0, 1], [1, 0, 2], [2, 0, 3]])


def test_cells_may_be_wider_than_high() -> None:
    d_px = np.array([[1, 2, 3], [4, np.nan, 6]], np.float32)
    wide = DisparityMap(d_px, 0.4, cell_px=8, cell_height_px=4)
    # Columns 0 .. 7 and rows 0 .. 3: the first centre is (3.5, 1.5), the last (19.5, 5.5).
    np.testing.assert_array_equal(wide.uvd_px[1], [[3.5, 5.5, 4], [11.5, 5.5, np.nan], [19.5, 5.5, 6]])
    np.testing.assert_array_equal(wide.uvd_px[0, 0], [3.5, 1.5, 1])
    assert (wide.cell_px, wide.cell_height_px) == (8, 4)
    assert DisparityMap(d_px, 0.4, 8).cell_height_px == 8
    assert DisparityMap(d_px, 0.4).cell_height_px == 1


@pytest.mark.parametrize("cell_height_px", [-4, 0.5, 2.5, np.nan, np.inf])
def test_a_cell_of_no_whole_height_is_refused(cell_height_px: Any) -> None:
    with pytest.raises(ValueRefusedError, match="cell_height_px must be a whole number >= 1, but got"):
        DisparityMap(np.zeros((2, 2), np.float32), 0.4, 8, cell_height_px)


def test_true_disparities_have_no_noise() -> None:
    assert DisparityMap(np.zeros((1, 1), np.float32), 0.0).sigma_px == 0


@pytest.mark.parametrize(
    ("d_px", "sigma_px", "cell_px", "words"),
    [
        (np.zeros((2, 2)), 0.4, 1, "d_px must be a 2-D float32 array, but got 2-D float64"),
        (np.zeros((2, 2, 1), np.float32), 0.4, 1, "d_px must be a 2-D float32 array, but got 3-D float32"),
        (np.zeros((2, 2), np.float32), -0.1, 1, "sigma_px must be >= 0"),
        (np.zeros((2, 2), np.float32), np.nan, 1, "sigma_px must be finite"),
        (np.zeros((2, 2), np.float32), 0.4, 0, "cell_px must be a whole number >= 1"),
        (np.zeros((2, 2), np.float32), 0.4, np.nan, "cell_px must be a whole number >= 1"),
        (np.zeros((2, 2), np.float32), 0.4, 2.5, "cell_px must be a whole number >= 1"),
    ],
)
def test_disparity_map_refuses(d_px: np.ndarray, sigma_px: float, cell_px: Any, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        DisparityMap(d_px, sigma_px, cell_px)
