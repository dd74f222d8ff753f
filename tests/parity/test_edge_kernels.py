"""The compiled kernel of kerbs and verges against its readable definition."""

import numpy as np
import pytest

from roadblock.kernels.compiled import edges as compiled
from roadblock.kernels.reference import edges as reference

LIMITS = np.array([0.05, 0.3])
SHAPES = [(60, 80), (40, 12), (1, 40), (40, 1), (0, 5), (5, 0)]


def street(shape: tuple[int, int], bump_m: float, noise: float, holes: float, seed: int = 3) -> tuple[np.ndarray, ...]:
    """Return heights and ranges of a road with a slanted step of `bump_m`, with noise and holes."""
    rng = np.random.default_rng(seed)
    z = np.broadcast_to(40 / (1 + np.arange(shape[0]))[:, None], shape)
    row, column = np.indices(shape)
    height = np.where(row < 8 + 0.7 * column, bump_m, 0.0) + rng.normal(0, noise, shape)
    height[rng.random(shape) < holes] = np.nan
    return height.astype(np.float32), np.where(np.isnan(height), np.nan, z).astype(np.float32)


def both(height: np.ndarray, z: np.ndarray, free: np.ndarray, noise_per_m: float) -> list[tuple[np.ndarray, ...]]:
    found = []
    for kernels in (compiled, reference):
        n = height.shape[1]
        out = np.empty(n), np.empty(n), np.empty(n, np.uint8)
        kernels.find_edges(height, z, free, noise_per_m, LIMITS, *out)
        found.append(out)
    return found


@pytest.mark.parametrize("holes", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("noise", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("bump_m", [0.0, 0.12, 0.28])
@pytest.mark.parametrize("shape", SHAPES)
def test_edges(shape: tuple[int, int], bump_m: float, noise: float, holes: float) -> None:
    height, z = street(shape, bump_m, noise, holes)
    for free in (np.full(shape[1], np.nan), np.full(shape[1], 6.0)):
        for noise_per_m in (0.0, 0.002):
            fast, slow = both(height, z, free, noise_per_m)
            for a, b in zip(fast, slow, strict=True):
                np.testing.assert_allclose(a, b, rtol=1e-9)


KINDS = [(0.0, reference.NO_EDGE), (0.12, reference.KERB), (0.28, reference.VERGE)]


@pytest.mark.parametrize(("bump_m", "kind"), KINDS)
def test_edges_of_each_kind_are_found(bump_m: float, kind: int) -> None:
    """So that the test above compares more than NaN."""
    height, z = street(SHAPES[0], bump_m, 0.005, 0.05)
    for edge, tall, kinds in both(height, z, np.full(80, np.nan), 0.002):
        middle = slice(6, 40)
        assert (kinds[middle] == kind).all()
        if kind:
            np.testing.assert_allclose(tall[middle], bump_m, atol=0.03)
            rows = np.ceil(8 + 0.7 * np.arange(80)[middle]) - 1
            np.testing.assert_allclose(edge[middle], 40 / (1 + rows), rtol=0.1)
