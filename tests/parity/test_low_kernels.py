"""The compiled test of low obstacles against its readable definition, on a small crooked road."""

import numpy as np
import pytest

from roadblock.kernels.compiled import low as low_compiled
from roadblock.kernels.reference import low as low_reference

ROWS = np.arange(4, 24)
FIRST = 30 - np.arange(20) // 2
LAST = 70 + np.arange(20)
D_PX = 3.3 + 0.31 * np.arange(20)
SLOPE = np.full(20, 0.004)
FEET = np.array([19, 16, 13])
TALL = np.array([[2, 4, 7], [2, 4, 7], [1, 3, 6]])
WIDE = np.array([5, 5, 4])


def pair(bin_px: int, kind: str) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(bin_px)
    shape = (26 * bin_px, 111 * bin_px + 1)
    if kind == "flat":
        return np.full(shape, 90, np.uint8), np.full(shape, 91, np.uint8)
    left = rng.integers(0, 256, shape).astype(np.uint8)
    return left, np.roll(left, -4 * bin_px, 1) if kind == "moved" else rng.integers(0, 256, shape).astype(np.uint8)


def warped(kernels: object, bin_px: int, kind: str, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
    near, far = np.zeros((2, 20, 111), np.float32)
    gain = np.linspace(0.9, 1.1, 20)
    kernels.warp(*pair(bin_px, kind), bin_px, ROWS, FIRST, LAST, D_PX, SLOPE, 50.3, gain, 1e-3, step, near, far)  # type: ignore[attr-defined]
    return near, far


@pytest.mark.parametrize("kind", ["noise", "moved", "flat"])
@pytest.mark.parametrize("bin_px", [1, 2, 4])
def test_images_laid_over_each_other_are_the_same(bin_px: int, kind: str) -> None:
    for step in (1, 2):
        expected = warped(low_reference, bin_px, kind, step)
        for mine, theirs in zip(warped(low_compiled, bin_px, kind, step), expected, strict=True):
            np.testing.assert_allclose(mine, theirs, atol=2e-3)
        assert expected[0].any()


@pytest.mark.parametrize("kind", ["noise", "moved", "flat"])
def test_sums_weights_scores_and_hits_are_the_same(kind: str) -> None:
    near, far = warped(low_reference, 1, kind)
    out = []
    for kernels in (low_reference, low_compiled):
        sums, weight = np.zeros((3, 4, 8), np.float32), np.zeros_like(near)
        kernels.road_sums(near, far, FIRST, LAST, 1, sums)
        kernels.weigh(near, far, FIRST, LAST, 2.5, weight)
        scores, heights = np.zeros((3, 111), np.float32), np.zeros((3, 111), np.int8)
        kernels.score(near, far, weight, FIRST, LAST, D_PX, FEET, TALL, WIDE, scores, heights)
        table, hits = scores.copy(), np.zeros((5, 4))
        count = kernels.pick(table, heights, FEET, TALL, WIDE, 2.0, hits)
        sure = kernels.confirm(near, far, weight, D_PX, FIRST, LAST, 19, 4, 45, 5)
        out.append((sums, weight, scores, hits, np.array(sure), np.array(count)))
    for mine, theirs in zip(*out, strict=True):
        np.testing.assert_allclose(mine, theirs, rtol=1e-3, atol=2e-2)
    assert kind == "flat" or out[0][-1] > 0, "nothing was compared"
