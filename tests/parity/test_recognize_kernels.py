"""What recognition measures, compiled against its readable definition, on crooked things before a crooked road."""

import numpy as np
import pytest

from roadblock.kernels.compiled import recognize as compiled
from roadblock.kernels.reference import recognize as reference

TWIN = np.array([410.0, 151.3, 68.2, 0.31])
ROAD = np.array([0.02, -np.hypot(0.9995, 0.0244), 0.01, 1.37, 1e-4])
SIZE = np.array([305.0, 141.0])
NOWHERE = np.full(5, np.nan)


def things(seed: int, w: int = 4) -> tuple[np.ndarray, ...]:
    """Return half an image, cells of seven things (one a single cell, one a single row), bounds and lowest rows."""
    rng = np.random.default_rng(seed)
    half = rng.integers(0, 256, (70, 152)).astype(np.uint8)
    half[20:60, 40:90] //= 4
    cells, boxes = [], []
    for k, (columns, rows) in enumerate(((14, 12), (5, 20), (3, 2), (1, 1), (9, 1), (20, 16), (6, 9))):
        c, r = rng.integers(0, 300 // w - columns), rng.integers(0, 34 - rows)
        u, v = np.meshgrid((c + np.arange(columns)) * w + (w - 1) / 2, (r + np.arange(rows)) * 4 + 1.5)
        d = 6 + 2.1 * k + 0.05 * (u - u.mean()) + 0.02 * (v - v.mean()) + rng.normal(0, 0.1, u.shape)
        kept = rng.random(u.shape) < 0.8
        kept[0, 0] = True
        cells.append(np.stack([u[kept], v[kept], d[kept]], -1))
        boxes.append((c * w, r * 4, (c + columns) * w, min((r + rows) * 4 + 9, 141)))
    bounds = np.cumsum([0, *map(len, cells)]).astype(np.int32)
    return half, np.concatenate(cells), bounds, np.array(boxes, float)[:, 3]


@pytest.mark.parametrize("road", [ROAD, NOWHERE], ids=["road", "nowhere"])
@pytest.mark.parametrize("seed", range(4))
def test_figures_are_the_same(seed: int, road: np.ndarray) -> None:
    half, uvd, bounds, _ = things(seed, 4 + 4 * (seed % 2))
    free_u = np.arange(1.5, 305, 4)
    free_m = np.random.default_rng(seed).uniform(3, 30, len(free_u))
    free_m[5:40:7] = np.nan
    for u, m in ((free_u, free_m), (free_u[:1], free_m[:1]), (free_u[:0], free_m[:0])):
        found, expected = np.full((2, 7, reference.FIGURES), np.nan)
        compiled.describe_things(half, uvd, bounds, TWIN, road, SIZE, u, m, found)
        reference.describe_things(half, uvd, bounds, TWIN, road, SIZE, u, m, expected)
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_colours_are_the_same(seed: int) -> None:
    _, uvd, bounds, _ = things(seed)
    rng = np.random.default_rng(seed)
    colors = rng.integers(0, 256, (36, 77, 3)).astype(np.uint8)
    count = 40 + reference.BACKGROUND
    found, expected = np.zeros((2, 9, count, 3), np.uint8)
    for kernels, samples in ((compiled, found), (reference, expected)):
        kernels.pick_colors(colors, uvd, bounds, 4, samples[:7])
        kernels.pick_road(colors, samples[7:].reshape(-1, 3))
    np.testing.assert_array_equal(found, expected)
    grey = found.copy()
    grey[..., 1:] = 128
    for lab in (found, grey, np.full_like(found, 0)):
        for road in (np.array([38.0, 0.5, -4.0]), np.array([0.0, 0.0, 0.0]), np.array([90.0, 2.0, 3.0])):
            mine, theirs = np.full((2, 9, reference.COLOR_FIGURES), -7.0)
            compiled.tally_colors(lab, road, mine)
            reference.tally_colors(lab, road, theirs)
            np.testing.assert_allclose(mine, theirs, atol=1e-5)
            summaries = np.zeros((2, 9, reference.INPUTS))
            compiled.sum_up_colors(mine, summaries[0])
            reference.sum_up_colors(mine, summaries[1])
            np.testing.assert_allclose(*summaries)
    for count in (1, 6, 63):
        medians = np.empty((2, 3))
        compiled.middle_color(colors[0, :count], medians[0])
        reference.middle_color(colors[0, :count], medians[1])
        np.testing.assert_array_equal(*medians)


def test_hues_are_those_of_their_angles() -> None:
    rng = np.random.default_rng(3)
    ab = np.concatenate([rng.normal(0, 30, (500, 2)), [(1, 0), (-1, 0), (0, 1), (0, -1), (1, -1e-9)]])
    found = [compiled.hue_of(a, b) for a, b in ab]
    expected = np.digitize(np.degrees(np.arctan2(ab[:, 1], ab[:, 0])) % 360, reference.HUE_ENDS_DEG) % reference.HUES
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("road", [ROAD, NOWHERE], ids=["road", "nowhere"])
@pytest.mark.parametrize("seed", range(6))
def test_contours_are_the_same(seed: int, road: np.ndarray) -> None:
    half, uvd, bounds, bottoms = things(seed, 4 + 4 * (seed % 2))
    found, expected = (
        (np.full((7, 4), np.nan), np.zeros((7, 2 * reference.ROWS, 2), np.int32), np.zeros(7, np.int32))
        for _ in range(2)
    )
    compiled.trace_things(half, uvd, bounds, bottoms, TWIN, road, *found)
    reference.trace_things(half, uvd, bounds, bottoms, TWIN, road, *expected)
    for mine, theirs in zip(found, expected, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9)


@pytest.mark.parametrize("seed", range(4))
def test_outlines_are_the_same(seed: int) -> None:
    _, uvd, bounds, _ = things(seed)
    found, expected = np.full((2, 7, reference.OUTLINE_FIGURES), np.nan)
    sigma_px = np.linspace(0.1, 0.4, 7)
    compiled.outline_things(uvd, bounds, TWIN, sigma_px, found)
    reference.outline_things(uvd, bounds, TWIN, sigma_px, expected)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-2)
