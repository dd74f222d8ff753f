"""The compiled kernels against their readable definitions: the same bits, on small crooked images."""

import numpy as np
import pytest

from roadblock.kernels.compiled import region as compiled
from roadblock.kernels.reference import region as reference
from roadblock.kernels.reference.region import CENSUS_HALF, COSTS

SHAPES = [(13, 31), (1, 1), (2, 9), (9, 3), (4, 40)]


def padded(image: np.ndarray, half: int, before: int = 0) -> np.ndarray:
    return np.pad(image, ((half, half), (half + before, half)), mode="edge").astype(np.int32)


def views(shape: tuple[int, int], seed: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """A noisy wall at 5 px, bright enough that products pass 32 bits in float; or pure noise; or nothing."""
    rng = np.random.default_rng(seed)
    height, width = shape
    wall = {
        "wall": rng.integers(150, 256, (height, width + 5)),
        "binary": 255 * rng.integers(0, 2, (height, width + 5)),
        "flat": np.full((height, width + 5), 200),
    }[kind]
    left, right = wall[:, :width].copy(), wall[:, 5 : 5 + width].copy()
    if kind == "wall":
        right = np.clip(right + rng.integers(-6, 7, shape), 0, 255)
    return left, right


@pytest.mark.parametrize("shape", SHAPES)
def test_census_is_the_same_to_the_bit(shape: tuple[int, int]) -> None:
    image = padded(np.random.default_rng(1).integers(0, 9, shape), CENSUS_HALF)
    codes = reference.census(image)
    assert codes.shape == shape
    assert codes.dtype == np.int32
    np.testing.assert_array_equal(compiled.census(image), codes)


@pytest.mark.parametrize("kind", ["wall", "binary", "flat"])
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("cost", COSTS)
def test_matching_is_the_same_to_the_bit(cost: str, shape: tuple[int, int], kind: str) -> None:
    for half, disparities, uniqueness in ((1, 16, 0), (2, 16, 10), (3, 5, 30)):
        left, right = views(shape, half, kind)
        extra = CENSUS_HALF if cost == "census" else 0
        a, b = padded(left, half + extra), padded(right, half + extra, disparities - 1)
        if extra:
            a, b = reference.census(a), reference.census(b)
        arguments = (a, b, half, disparities, COSTS.index(cost), uniqueness)
        expected = reference.match_windows(*arguments)
        assert expected.shape == shape
        np.testing.assert_array_equal(compiled.match_windows(*arguments), expected)
        if kind == "wall" and shape == SHAPES[0] and disparities == 16:
            assert np.abs(expected[:, 9:-4] - 5).max() < 0.5, "nothing was compared"


@pytest.mark.parametrize("cost", ["sad", "ssd", "ncc", "zncc"])
def test_the_widest_window_on_the_brightest_images_overflows_nothing(cost: str) -> None:
    left, right = (255 - image // 16 for image in views((9, 31), 2, "wall"))
    a, b = padded(left, 10), padded(right, 10, 15)
    arguments = (a, b, 10, 16, COSTS.index(cost), 5)
    np.testing.assert_array_equal(compiled.match_windows(*arguments), reference.match_windows(*arguments))


def test_census_bits_are_in_reading_order() -> None:
    image = np.full((5, 5), 7, np.int32)
    image[0, 0] = image[4, 4] = 3
    image[1, 1] = 9
    assert reference.census(image)[0, 0] == 1 << 23 | 1


def test_window_costs_are_those_of_the_books() -> None:
    """By numpy on one pair of windows, cut by hand."""
    rng = np.random.default_rng(8)
    image_left, image_right = rng.integers(0, 256, (7, 20)), rng.integers(0, 256, (7, 20))
    v, u, d, half, n = 3, 12, 4, 2, 16
    a = image_left[v - 2 : v + 3, u - 2 : u + 3].astype(float).ravel()
    b = image_right[v - 2 : v + 3, u - d - 2 : u - d + 3].astype(float).ravel()
    books = {
        "sad": np.abs(a - b).sum(),
        "ssd": ((a - b) ** 2).sum(),
        "ncc": 1 - a @ b / np.linalg.norm(a) / np.linalg.norm(b),
        "zncc": 1 - np.corrcoef(a, b)[0, 1],
    }
    for cost, expected in books.items():
        volume = reference.window_costs(
            padded(image_left, half), padded(image_right, half, n - 1), half, n, COSTS.index(cost)
        )
        assert volume[v, u, d] == pytest.approx(expected, rel=1e-12)
        assert np.isinf(volume[v, 3, 4:]).all()
