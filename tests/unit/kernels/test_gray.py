"""Half images; greys are tested in tests/unit/stages/test_match.py."""

import numpy as np
import pytest

from roadblock.kernels.gray import gray8, half_images, halve
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair


@pytest.mark.parametrize("shape", [(8, 14), (9, 14), (8, 15), (61, 97), (2, 2), (3, 3)])
def test_a_half_image_has_the_means_of_four(shape: tuple[int, int]) -> None:
    gray = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    before = gray.copy()
    half = halve(gray)
    assert half.dtype == np.uint8
    assert half.shape == (shape[0] // 2, shape[1] // 2)
    assert half.flags.c_contiguous
    for (r, c), value in np.ndenumerate(half):
        assert abs(value - gray[2 * r : 2 * r + 2, 2 * c : 2 * c + 2].mean()) <= 0.5
    np.testing.assert_array_equal(gray, before)
    assert not np.shares_memory(half, gray)


@pytest.mark.parametrize("shape", [(1, 1), (1, 8), (8, 1)])
def test_of_one_row_or_column_nothing_is_left(shape: tuple[int, int]) -> None:
    half = halve(np.zeros(shape, np.uint8))
    assert half.shape == (shape[0] // 2, shape[1] // 2)
    assert half.dtype == np.uint8


def test_half_images_are_made_once() -> None:
    left, right = np.random.default_rng(2).integers(0, 256, (2, 8, 14, 3)).astype(np.uint8)
    pair = RectifiedPair(left, right, Rectification(9.0, 7.0, 4.0, 0.3, (14, 8)))
    made = half_images(pair)
    for half, full in zip(made, gray8(left, right), strict=True):
        np.testing.assert_array_equal(half, halve(full))
    assert half_images(pair) is pair.half is made
