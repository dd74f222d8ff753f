"""What recognition concludes, compiled against its readable definition."""

import numpy as np
import pytest

from roadblock.kernels.compiled import judge as compiled
from roadblock.kernels.reference import judge as reference
from roadblock.kernels.reference.recognize import COLOR_FIGURES, HUES, OUTLINE_FIGURES

TWIN = np.array([410.0, 151.3, 68.2, 0.31])
ROAD = np.array([0.02, -np.hypot(0.9995, 0.0244), 0.01, 1.37, 1e-4])
NOWHERE = np.full(5, np.nan)
BOTH = (compiled, reference)


@pytest.mark.parametrize(("hidden", "classes"), [(5, 4), (16, 8), (37, 11)])
def test_odds_are_the_same(hidden: int, classes: int) -> None:
    rng = np.random.default_rng(0)
    shapes = ((9,), (9,), (9, hidden), (hidden,), (hidden, classes), (classes,))
    layers = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    inputs, found = 4 * rng.normal(size=(30, 9)), np.empty((2, 30, classes))
    for kernels, odds in zip(BOTH, found, strict=True):
        kernels.judge_types(inputs, *layers, odds)
    np.testing.assert_allclose(*found, atol=2e-5)
    np.testing.assert_allclose(found[0].sum(1), 1)


def test_names_of_colours_are_the_same() -> None:
    rng = np.random.default_rng(1)
    figures = rng.uniform(0, 100, (600, COLOR_FIGURES))
    figures[:, 2 : 4 * HUES : 4] -= 50
    figures[:, 3 : 4 * HUES : 4] -= 50
    figures[:, 0 : 4 * HUES : 4] = rng.dirichlet(np.full(HUES, 0.3), 600) * rng.random((600, 1))
    figures[:, 4 * HUES] = rng.random(600)
    figures[:9, 0 : 4 * HUES : 4] = 0
    found = [(np.zeros((600, 2), np.int64), np.zeros((600, 3))) for _ in BOTH]
    for kernels, result in zip(BOTH, found, strict=True):
        kernels.name_colors(figures, *result)
    for mine, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert set(np.unique(found[0][0])) == {-1, *range(11)}


@pytest.mark.parametrize("road", [ROAD, NOWHERE], ids=["road", "nowhere"])
def test_sizes_and_places_are_the_same(road: np.ndarray) -> None:
    rng = np.random.default_rng(2)
    edges = np.sort(rng.uniform(-4, 4, (40, 4)), axis=1)
    edges[:, 2:] = np.sort(rng.uniform(0, 140, (40, 2)), axis=1)
    u_px, range_m, sigma_m = rng.uniform(0, 305, 40), rng.uniform(3, 40, 40), rng.uniform(0.01, 1, 40)
    figures = np.sort(rng.uniform(-6, 12, (40, OUTLINE_FIGURES)), axis=1)
    figures[:, 0] = rng.uniform(0, np.pi / 2, 40)
    figures[::3, 3:5] = np.sort(rng.uniform(0, 1, (14, 2)), axis=1)
    end_m, mount = rng.choice((0.0, 2.2, 3.0), 40), rng.normal(size=(4, 4))
    found = [[np.full(shape, np.nan) for shape in ((40, 3), (40, 3), (40, 4, 2), (40, 2))] for _ in BOTH]
    for kernels, (sizes, sigmas, corners, headings) in zip(BOTH, found, strict=True):
        sizes[:] = range_m[:, None] / 9
        sizes[::4, 2] = np.nan
        kernels.size_things(edges, u_px, range_m, sigma_m, TWIN, road, sizes, sigmas)
        kernels.place_outlines(figures, end_m, sigma_m, road, mount, corners, headings)
    for mine, theirs in zip(*found, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9)
    assert 0.2 < np.isnan(found[0][3]).mean() < 0.9


def test_contours_are_lifted_alike() -> None:
    rng = np.random.default_rng(4)
    contours, counts = rng.integers(0, 140, (30, 20, 2)).astype(np.int32), rng.integers(4, 21, 30).astype(np.int32)
    contours[::4, :, 1] //= 40
    end_m, range_m = rng.choice((0.0, 2.2), 30), rng.uniform(3, 40, 30)
    found = contours.copy(), contours.copy()
    for kernels, lifted in zip(BOTH, found, strict=True):
        kernels.lift_contours(lifted, counts, end_m, range_m, 410.0)
    np.testing.assert_array_equal(*found)
    assert 0.2 < (found[0] != contours).any(axis=(1, 2)).mean() < 0.8


@pytest.mark.parametrize(
    ("end_m", "long_m", "wide_m", "quarter"),
    [
        (2.2, 4.0, 1.7, 0),
        (2.2, 0.3, 1.7, 0),
        (2.2, 1.7, 0.3, 1),
        (2.2, 1.0, 3.9, 1),
        (3.0, 0.2, 2.5, 0),
        (0.0, 0.2, 2.5, 1),
        (0.0, 6.0, 0.5, 0),
        (0.0, 2.0, 1.8, None),
    ],
)
def test_a_vehicle_runs_across_its_short_side(end_m: float, long_m: float, wide_m: float, quarter: int | None) -> None:
    """Seen from behind a car shows a side of its width only, and runs away from it; a railing runs along its side."""
    figures, headings = np.array([[0.1, 9, 9 + long_m, -1, wide_m - 1, 0.2, 1]]), np.empty((1, 2))
    ahead_is_x = np.eye(4)[[2, 0, 1, 3]]
    reference.place_outlines(figures, np.array([end_m]), np.zeros(1), ROAD, ahead_is_x, np.empty((1, 4, 2)), headings)
    expected = np.nan if quarter is None else 0.1 - quarter * np.pi / 2
    np.testing.assert_allclose(headings[0, 0], expected, atol=1e-12)
