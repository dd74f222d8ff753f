"""The compiled kernels of the road against their readable definitions, on noisy, crooked and degenerate grids."""

import numpy as np
import pytest

from roadblock.kernels.compiled import road as compiled
from roadblock.kernels.reference import road as reference

TWIN = np.array([310.0, 151.3, 60.6, 0.31])
FB = TWIN[0] * TWIN[3]
LIMITS = np.array([50.0, 6.0, 0.2, 4.0, 0.27, 1.43])
ALLOWED = np.array([0.2, 4.0, 0.27, 0.14])
SCALES = np.array([FB, 25.0, 4.0, 14.3])
NO_PRIOR = np.full(3, np.nan)
CELLS = [(4, 4), (8, 4), (1, 1)]
SHAPES = [(43, 75), (1, 40), (40, 1), (1, 1), (0, 5), (5, 0)]
SUMS = {"rtol": 1e-8, "atol": 1e-8}
"""Sums in another order, solved."""


def street(
    shape: tuple[int, int], cell: tuple[int, int], seed: int = 1, plane: tuple[float, ...] = (1.4, -0.03, 0.02, 0.0003)
) -> np.ndarray:
    """Return noisy disparities of a bent road (h, s, t, q) with holes, boxes on it, and mismatches."""
    rng = np.random.default_rng(seed)
    h, s, t, q = plane
    v, u = (np.mgrid[: shape[0], : shape[1]].T * cell[::-1] + (np.array(cell[::-1]) - 1) / 2).T
    x_ray, y_ray = (u - TWIN[1]) / TWIN[0], (v - TWIN[2]) / TWIN[0]
    b, c = y_ray - s - t * x_ray, h - t * TWIN[3] / 2
    root = np.sqrt(np.maximum(b * b + 4 * q * c, 0))
    d = FB * (b + root) / (2 * c) + rng.normal(0, 0.2, shape)  # 1/z of q z^2 + b z - c = 0
    d[shape[0] // 3 : shape[0] // 2, shape[1] // 4 : shape[1] // 3] = 14.0
    wrong = rng.random(shape)
    d = np.where(wrong < 0.05, rng.uniform(0, 30, shape), np.where(wrong > 0.8, np.nan, d)).astype(np.float32)
    d.flags.writeable = False
    return d


def gathered(
    shape: tuple[int, int] = SHAPES[0], cell: tuple[int, int] = (4, 4), seed: int = 1
) -> tuple[np.ndarray, int]:
    points = np.empty((reference.BIN_POINTS * (int(LIMITS[0] / LIMITS[5]) + 1), 4))
    return points, reference.gather_candidates(street(shape, cell, seed), *cell, TWIN, LIMITS, points)


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("shape", [*SHAPES, (172, 300)])
def test_candidates(shape: tuple[int, int], cell: tuple[int, int]) -> None:
    """To the bit: also where a step ahead has more points than are kept."""
    slow, n = gathered(shape, cell)
    fast = np.empty_like(slow)
    assert compiled.gather_candidates(street(shape, cell), *cell, TWIN, LIMITS, fast) == n
    np.testing.assert_array_equal(fast[:n], slow[:n])
    assert n > 100 or min(shape[0], shape[0] * cell[1] - 60) < 43


@pytest.mark.parametrize("by_m", [0.0, 0.3])
@pytest.mark.parametrize("n", [0, 1, 9, 10, 30, 1000])
def test_plane(n: int, by_m: float) -> None:
    """Points come nearest to the plane first, so that the first ten are near it."""
    points, most = gathered()
    assert most >= 1000
    x, y, z, _ = points[:most].T
    points = points[np.argsort(abs(y - 1.35 + 0.02 * z - 0.01 * x) + 99 * (z > 24))]
    fast, slow = (np.array([1.35, -0.02, 0.01]) for _ in range(2))
    near = [
        kernels.fit_plane(points, n, plane, 0.7, by_m, SCALES, np.full((3, 3), 7.0), np.full(3, 7.0))
        for kernels, plane in ((compiled, fast), (reference, slow))
    ]
    assert near[0] == near[1]
    assert (slow[0] == 1.35) == (n < reference.LEAST_POINTS)
    np.testing.assert_allclose(fast, slow, **SUMS)


def test_points_in_a_row_leave_the_plane_as_it_is() -> None:
    points = np.tile([0.4, 1.4, 9.0, FB / 9], (50, 1))
    for kernels in (compiled, reference):
        plane = np.array([1.4, 0.0, 0.0])
        assert kernels.fit_plane(points, 50, plane, 0.7, 0.3, SCALES, np.empty((3, 3)), np.empty(3)) == 50
        assert plane.tolist() == [1.4, 0.0, 0.0]


@pytest.mark.parametrize("n", [3, 4])
def test_systems(n: int) -> None:
    rng = np.random.default_rng(n)
    rows = rng.normal(size=(n, 9))
    good, flat, mixed = rows @ rows.T, rows[:, :1] @ rows[:, :1].T, np.diag([1.0] * (n - 1) + [-1.0])
    for A, solved in ((good, True), (flat, False), (mixed, False), (np.zeros((n, n)), False), (good * np.nan, False)):
        lower = np.tril(A) + np.triu(np.full((n, n), 9.0), 1)
        b, x, y = rng.normal(size=n), np.zeros(n), np.zeros(n)
        assert compiled.solve(lower.copy(), b, x) is reference.solve(lower.copy(), b, y) is solved
        if solved:
            np.testing.assert_allclose(x, y, **SUMS)
            np.testing.assert_allclose(good @ y, b, **SUMS)


@pytest.mark.parametrize("n", [0, 1, 700])
def test_support(n: int) -> None:
    """To the bit: it counts."""
    points, most = gathered()
    x, y, z, d = points[:most].T
    rays = np.stack([x / z, y / z, 1000 / (1 + x * x), d]).astype(np.float32)
    for plane in ([1.4, -0.03, 0.02], [1.1, 0.0, 0.0], [3.0, 0.1, -0.1], [0.3, 0.0, 0.0]):
        scores = [kernels.support(rays, n, np.array(plane), FB, 0.7) for kernels in (compiled, reference)]
        assert scores[0] == scores[1]


@pytest.mark.parametrize(
    "plane", [(1.0, 0.0, 0.0), (0.2, 0.0, 0.0), (4.0, 0.0, 0.0), (1.0, -0.27, 0.0), (1.0, 0.0, 0.14)]
)
def test_limits(plane: tuple[float, float, float]) -> None:
    assert compiled.is_allowed(*plane, ALLOWED) == reference.is_allowed(*plane, ALLOWED) == (plane == (1.0, 0.0, 0.0))
    assert not reference.is_allowed(np.nan, 0.0, 0.0, ALLOWED)


@pytest.mark.parametrize("seed", [0, 1, 12345])
@pytest.mark.parametrize("draws", [0, 1, 2, 3, 60])
def test_drawn_plane(draws: int, seed: int) -> None:
    """Few draws lead to planes that tell which points were drawn."""
    points, n = gathered()
    for prior in (NO_PRIOR, np.array([1.4, -0.03, 0.02]), np.array([9.0, 0.0, 0.0])):
        for minimum in (10, 10**6):
            fast, slow = np.zeros(3), np.zeros(3)
            found = [
                kernels.draw_plane(points, n, draws, seed, 0.7, minimum, ALLOWED, SCALES, prior, plane)
                for kernels, plane in ((compiled, fast), (reference, slow))
            ]
            assert found[0] == found[1]
            assert draws in (1, 2, 3) or found[1] == (minimum == 10 and (draws == 60 or prior[0] == 1.4))
            np.testing.assert_allclose(fast, slow, **SUMS)


def test_of_points_in_a_row_none_is_drawn() -> None:
    points = np.tile([0.4, 1.4, 9.0, FB / 9], (50, 1))
    for kernels in (compiled, reference):
        assert not kernels.draw_plane(points, 50, 20, 0, 0.7, 10, ALLOWED, SCALES, NO_PRIOR, np.empty(3))


@pytest.mark.parametrize("n", [0, 1, 40, 1000])
@pytest.mark.parametrize("far", [50.0, 25.0, 10.0])
@pytest.mark.parametrize("q", [0.0, 0.0004, 0.0008, -0.0006])
def test_bend(q: float, far: float, n: int) -> None:
    rng = np.random.default_rng(5)
    z, x = rng.uniform(4, 50, 1000), rng.uniform(-6, 6, 1000)
    y = 1.4 - 0.03 * z + 0.02 * x - q * np.maximum(z - 12, 0) ** 2 + rng.normal(0, 0.05, 1000)
    points = np.stack([x, y, z, FB / z], -1)
    start = np.array([1.4, -0.03, 0.02])
    fast, slow = np.empty(4), np.empty(4)
    compiled.bend(points, n, start, far, 0.1, SCALES, fast)
    reference.bend(points, n, start, far, 0.1, SCALES, slow)
    np.testing.assert_allclose(fast, slow, **SUMS)
    if n == 0:
        np.testing.assert_allclose(slow, [*start, 0], **SUMS)


def found_by(kernels: object, d_px: np.ndarray, cell: tuple[int, int], **change: object) -> np.ndarray:
    """Return the road, NaN where there is none."""
    given = {"tolerances": np.array([0.7, 0.1]), "draws": 60, "minimum": 60, "seed": 3, "prior": NO_PRIOR} | change
    road = np.full(6, np.nan)
    found = kernels.find_road(d_px, *cell, TWIN, LIMITS, ALLOWED, SCALES, *given.values(), road)  # type: ignore[attr-defined]
    assert found == np.isfinite(road).all()
    return road


@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("seed", [1, 2])
def test_road(seed: int, shape: tuple[int, int], cell: tuple[int, int]) -> None:
    d_px = street(shape, cell, seed)
    for prior in (NO_PRIOR, np.array([1.4, -0.03, 0.02])):
        slow = found_by(reference, d_px, cell, prior=prior)
        np.testing.assert_allclose(found_by(compiled, d_px, cell, prior=prior), slow, **SUMS)
    if shape == SHAPES[0] and cell != (1, 1):
        assert (abs(slow[:4] - (1.4, -0.03, 0.02, 0.0003)) < (0.05, 0.01, 0.01, 0.0004)).all()


@pytest.mark.parametrize(
    ("plane", "change"),
    [
        ((1.4, 0.5, 0.0, 0.0), {}),
        ((5.0, 0.0, 0.0, 0.0), {}),
        ((1.4, 0.0, 0.0, 0.0), {"minimum": 5000}),
        ((1.4, 0.0, 0.0, 0.0), {"minimum": 500, "tolerances": np.array([0.7, 1e-4])}),
        ((1.4, 0.0, 0.0, 0.0), {"minimum": 500, "tolerances": np.array([1e-3, 0.1])}),
    ],
    ids=["steep", "deep", "few", "uneven", "noisy"],
)
def test_what_is_no_road(plane: tuple[float, ...], change: dict[str, object]) -> None:
    d_px = street(SHAPES[0], (4, 4), 1, plane)
    for kernels in (compiled, reference):
        assert np.isnan(found_by(kernels, d_px, (4, 4), **change)).all()


def test_nothing_matched_is_no_road() -> None:
    for value in (np.nan, 0.0, -1.0):
        d_px = np.full((9, 7), value, np.float32)
        d_px.flags.writeable = False
        for kernels in (compiled, reference):
            assert np.isnan(found_by(kernels, d_px, (4, 4))).all()
