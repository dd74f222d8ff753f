"""The compiled kernel of what things leave behind against its readable definition."""

import numpy as np
import pytest

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.kernels.compiled import traces as compiled
from roadblock.kernels.reference import traces as reference

TWIN = np.array([705.0, 601.0, 171.0, 0.52])
GRID = np.array([3.5, 8.0])
COLUMNS, KEPT = 150, 4


def free_space(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges, some unknown, of a few things side by side, and which columns end at one."""
    range_m = np.repeat(rng.uniform(3, 40, COLUMNS // 10), 10) * rng.uniform(0.95, 1.05, COLUMNS)
    range_m[rng.random(COLUMNS) < 0.1] = np.nan
    return range_m, np.isfinite(range_m) & (range_m < 30)


@pytest.mark.parametrize("n", [0, 1, 40])
def test_revisit(n: int) -> None:
    rng = np.random.default_rng(3)
    (range_m, is_blocked), *then = (free_space(rng) for _ in range(KEPT + 1))
    ranges_then, blocked_then = (np.array(part) for part in zip(*then, strict=True))
    T = np.array([pose(rotation_from_rotvec([0.01, 0.02 * k, 0.0]), [0.1, 0.0, -0.8 * k]) for k in range(KEPT)])
    spans = np.sort(rng.uniform(-50, 1250, (n, KEPT + 1, 2))), np.sort(rng.uniform(0, 40, (n, KEPT + 1, 2)))
    spans = np.concatenate(spans, 2)
    slots = rng.integers(-1, KEPT, n)
    given = (slots, spans[:, 0].copy(), spans[:, 1:].copy(), GRID, range_m, is_blocked, ranges_then, blocked_then)
    found, expected = (kernels.revisit(*given, T, TWIN) for kernels in (compiled, reference))
    assert found.tolist() == expected.tolist()
    if n == 40:
        assert (expected.sum(0) > 5).all()


@pytest.mark.parametrize("n", [0, 1, 60])
def test_judge(n: int) -> None:
    rng = np.random.default_rng(5)
    (range_m, is_blocked), *then = (free_space(rng) for _ in range(KEPT + 1))
    ranges_then, blocked_then = (np.array(part) for part in zip(*then, strict=True))
    T = np.array([pose(rotation_from_rotvec([0.01, 0.02 * k, 0.0]), [0.1, 0.0, -0.8 * k]) for k in range(KEPT)])
    boxes = np.concatenate([np.sort(rng.uniform(0, 1200, (n, 2))), np.full((n, 2), 300.0)], 1)[:, [0, 2, 1, 3]]
    range_m_of, long_m = rng.uniform(5, 20, n), rng.uniform(0, 10, n)
    spans = [kernels.spans(boxes, range_m_of, long_m) for kernels in (compiled, reference)]
    np.testing.assert_allclose(*spans)
    spans_then = np.repeat(spans[0][:, None], KEPT, 1) * (rng.random((n, KEPT, 1)) < 0.7)
    given = spans_then, rng.random(n) < 0.9, rng.uniform(0, 15, n), np.array([0.0, 0.3, 0.9, 0.6]), GRID
    given += range_m, is_blocked, ranges_then, blocked_then, T, TWIN
    found, expected = (kernels.judge(spans[0], *given) for kernels in (compiled, reference))
    np.testing.assert_array_equal(found, expected)
    if n == 60:
        assert all(5 < part.sum() < 50 for part in expected)


@pytest.mark.parametrize("kernels", [compiled, reference])
@pytest.mark.parametrize(("gone_m", "counts"), [(0.0, [0, 11, 0, 11]), (4.0, [0, 0, 11, 0])])
def test_a_car_ahead_that_goes_on_leaves_free_road_behind(kernels, gone_m: float, counts: list[int]) -> None:
    """22 columns, of which every other one is asked; where it is now could not be seen before."""
    mine = slice(60, 82)
    then, now = np.full(COLUMNS, 40.0), np.full(COLUMNS, 40.0)
    then[mine], now[mine] = 10.0, 10.0 + gone_m
    span = np.array([60 * 8.0, 82 * 8.0, 0.0, 20.0])
    is_blocked = now < 40
    given = (np.zeros(1, np.int64), span[None], span[None, None], GRID, now, is_blocked, then[None], is_blocked[None])
    found = kernels.revisit(*given, np.eye(4)[None], TWIN)
    assert np.abs(found[0] - counts).max() <= 1
