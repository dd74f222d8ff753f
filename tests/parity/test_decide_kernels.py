"""The compiled kernels of deciding against their readable definition."""

import numpy as np
import pytest

from roadblock.kernels.compiled import decide as compiled
from roadblock.kernels.reference import decide as reference
from roadblock.stages.decide import DecideSettings

TWIN, GRID, COLUMNS = np.array([705.0, 601.0, 171.0, 0.52]), np.array([3.5, 8.0]), 150
R = np.array([[0.02, 1.0], [-1.0, 0.02]]) / np.hypot(1, 0.02)
CAR = DecideSettings().numbers
COUNTS = [0, 1, 40]


def free_space(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return ranges, some unknown, of a few things side by side, and which columns end at one."""
    range_m = np.repeat(rng.uniform(3, 40, COLUMNS // 10), 10) * rng.uniform(0.97, 1.03, COLUMNS)
    range_m[rng.random(COLUMNS) < 0.1] = np.nan
    return range_m, np.isfinite(range_m) & (range_m < 30)


def velocities(rng: np.random.Generator, n: int) -> np.ndarray:
    return rng.normal(0, 3, (n, 2)) * (rng.random((n, 1)) < 0.6)


@pytest.mark.parametrize("n", COUNTS)
def test_weigh(n: int) -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(0, 0.7, (n, 2, 2)) * (rng.random((n, 1, 1)) < 0.7)
    cov = A @ A.swapaxes(1, 2) + 0.1 * np.eye(2)
    given = (
        velocities(rng, n),
        cov,
        rng.integers(0, 3, n),
        rng.uniform(0, 1.5, n),
        rng.random(n) < 0.8,
        rng.random(n) < 0.2,
    )
    results = [kernels.weigh(*given) for kernels in (compiled, reference)]
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-12)
    if n == 40:
        doubts = reference.HARDLY_DOUBT, reference.SETTLED_DOUBT, reference.YOUNG_DOUBT
        assert sorted(set(results[1][2])) == [0.0, *doubts]


def test_among() -> None:
    numbers, others = np.array([3, 1, 4, 1, 5]), np.array([1, 5, 9])
    for kernels in (compiled, reference):
        assert kernels.among(numbers, others).tolist() == [False, True, False, True, True]
        assert not kernels.among(numbers, others[:0]).any()


@pytest.mark.parametrize("columns", [COLUMNS, 1, 0])
@pytest.mark.parametrize("n", COUNTS)
def test_outline(n: int, columns: int) -> None:
    rng = np.random.default_rng(2)
    free_m, is_blocked = (part[:columns] for part in free_space(rng))
    sides_px = np.sort(rng.uniform(-40, 1240, (n, 2)))
    range_m, size_m = rng.uniform(3, 40, n), rng.uniform(0, 4, (n, 2))
    given = sides_px, range_m, size_m, rng.normal(0, 8, (n, 2)), velocities(rng, n), rng.random(n) < 0.2, 2 * n // 3
    given = *given, GRID, free_m, is_blocked, TWIN, R
    results = [kernels.outline(*given) for kernels in (compiled, reference)]
    for found, expected in zip(*results, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)
    if n == 40 and columns > 1:
        assert 0 < (results[1][2] > 0).sum() < is_blocked.sum()
    if n == 1 and columns > 1:
        assert set(results[1][2]) == {0, reference.ALONE, reference.STANDS_THERE}


@pytest.mark.parametrize("foot_m", [3.0, np.nan])
def test_recall(foot_m: float) -> None:
    """A car creeps through a bend, and something else comes into view: the same cells are remembered at each step."""
    rng = np.random.default_rng(3)
    states = [(np.zeros((0, 2), np.int64), np.zeros(0, np.int64))] * 2
    for step in range(6):
        reach_m, is_blocked = free_space(np.random.default_rng(step // 4))
        heading = 0.004 * step
        own = np.array([0.02 * step, 0.01 * step, np.cos(heading), np.sin(heading)])
        gained, told = is_blocked * rng.choice([0, 1, 2, 2, 2], COLUMNS), []
        for i, kernels in enumerate((compiled, reference)):
            cells, evidence, sure_m = kernels.recall(*states[i], own, GRID, reach_m, gained, foot_m, TWIN, R)
            states[i] = cells, evidence
            told.append((sorted(zip(*cells.T.tolist(), evidence.tolist(), strict=True)), sorted(sure_m.tolist())))
        assert told[0][0] == told[1][0]
        np.testing.assert_allclose(told[0][1], told[1][1], rtol=1e-9, atol=1e-9)
    assert len(told[0][1]) > 10
    assert len(told[0][0]) > len(told[0][1])


@pytest.mark.parametrize("is_strict", [False, True])
@pytest.mark.parametrize("is_wary", [False, True])
@pytest.mark.parametrize("n", [0, 1, 2, 3, 5])
def test_contact(n: int, is_wary: bool, is_strict: bool) -> None:
    rng, found = np.random.default_rng([4, n]), 0
    for _ in range(60):
        at_m = np.stack([rng.uniform(-2, 40, n), rng.normal(0, 2.5, n)], 1)
        doubt, sigma = rng.choice([0.0, 0.6, 0.85], n), rng.uniform(0.1, 1, (n, 2))
        way, v = rng.normal(0, 1, 6) * [0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-6], rng.uniform(0, 12)
        given = way, 14.0, at_m, velocities(rng, n), sigma, doubt, rng.normal(0, 2, n), v, 0.2, is_wary, is_strict, CAR
        results = [kernels.contact(*given) for kernels in (compiled, reference)]
        assert results[0][::3] == results[1][::3]
        np.testing.assert_allclose(results[0][1:3], results[1][1:3], rtol=1e-9)
        found += results[1][0] >= 0
    assert (found > 0) == (n > 0)


@pytest.mark.parametrize(("m", "n"), [(0, 3), (1, 0), (1, 1), (5, 9)])
def test_swept(m: int, n: int) -> None:
    rng = np.random.default_rng([5, m, n])
    ways = rng.normal(0, 1, (m, 6)) * [0.5, 0.1, 1e-2, 1e-3, 1e-5, 1e-6]
    given = ways, rng.uniform(5, 20, m), rng.uniform(-3, 30, n), CAR
    low, high = compiled.swept(*given)
    for found, expected in zip((low, high), reference.swept(*given), strict=True):
        assert found.shape == (m, n)
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
    assert (high - low >= CAR[2] - 1e-12).all()
