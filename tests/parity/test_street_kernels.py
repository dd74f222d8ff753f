"""The compiled kernels of what stands on the road against their readable definitions: crooked and degenerate grids."""

import numpy as np
import pytest

from roadblock.kernels.compiled import street as compiled
from roadblock.kernels.reference import street as reference

TWIN = np.array([83.0, 41.7, 24.2, 0.31])
FB = TWIN[0] * TWIN[3]
ROAD = np.array([0.03, -0.998, -0.055, 1.4, 0.0011])
NO_ROAD = np.full(5, np.nan)
CELLS = [(4, 4), (8, 4), (1, 1)]
SHAPES = [(23, 31), (1, 40), (40, 1), (1, 1), (12, 7)]
EMPTY = [(0, 5), (5, 0), (0, 0)]
LIMITS = np.array([30.0, 0.35, 4.0])
LINKS = np.array([0.5, 0.4])
FLOAT = {"rtol": 1e-12, "atol": 1e-12}
"""Sums in another order."""
SINGLE = {"rtol": 1e-5, "atol": 2e-5}
"""Single precision, at ranges up to 100 m."""


def singles(values: np.ndarray) -> np.ndarray:
    """Return a read-only float32 array, as the stages hand them."""
    made = np.ascontiguousarray(values, np.float32)
    made.flags.writeable = False
    return made


def disparities(shape: tuple[int, int], kind: str, seed: int = 1) -> np.ndarray:
    """Return a grid that is `noise` with holes, steps of few `levels`, or `unknown`."""
    rng = np.random.default_rng(seed)
    d = rng.uniform(-0.3, 6, shape) if kind == "noise" else rng.integers(1, 5, shape) + rng.normal(0, 0.1, shape)
    d[rng.random(shape) < 0.25] = np.nan
    return singles(np.full(shape, np.nan) if kind == "unknown" else d)


def raised(d_px: np.ndarray, road: np.ndarray, cell: tuple[int, int] = (4, 4)) -> tuple[np.ndarray, np.ndarray]:
    z, height = np.empty_like(d_px), np.empty_like(d_px)
    compiled.raise_cells(d_px, *cell, TWIN, road, z, height)
    return z, height


def linked(shape: tuple[int, int], kind: str, road: np.ndarray = ROAD) -> tuple[np.ndarray, ...]:
    """Return disparities, ranges, heights and things."""
    d_px = disparities(shape, kind)
    z, height = raised(d_px, road)
    parent = np.empty(d_px.size, np.int32)
    compiled.link(d_px, z, height, LIMITS, LINKS, 2, 2, parent)
    return d_px, z, height, parent


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("kind", ["noise", "unknown"])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_raising(shape: tuple[int, int], kind: str, cell: tuple[int, int], road: np.ndarray) -> None:
    d_px = disparities(shape, kind)
    fast, slow = raised(d_px, road, cell), (np.empty_like(d_px), np.empty_like(d_px))
    reference.raise_cells(d_px, *cell, TWIN, road, *slow)
    near = ~(slow[0] > 100)
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(np.isnan(a), np.isnan(b))
        np.testing.assert_allclose(a[near], b[near], **SINGLE)


@pytest.mark.parametrize("known", [0.05, 0.15, 0.4, 1.0])
@pytest.mark.parametrize("sky", [0, 3, 100])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_holes(shape: tuple[int, int], sky: int, known: float) -> None:
    rng = np.random.default_rng(2)
    height = np.where(rng.random(shape) < known, 0.3, np.nan).astype(np.float32)
    road_m = np.where(np.arange(shape[0]) < sky, np.inf, 40.0 / (1 + np.arange(shape[0])))
    for hides_px_m in (2.0, 60.0, 300.0):
        fast, slow = np.empty(shape[1]), np.empty(shape[1])
        compiled.find_holes(height, road_m, 4, hides_px_m, fast)
        reference.find_holes(height, road_m, 4, hides_px_m, slow)
        np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("kind", ["noise", "levels", "unknown"])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_free_space(shape: tuple[int, int], kind: str, road: np.ndarray) -> None:
    d_px = disparities(shape, kind)
    _, height = raised(d_px, road)
    heights = np.array([0.25, 2.5, 0.2])
    for support, spread, quantile in ((1, 0, 0.15), (3, 1, 0.15), (9, 1, 0.9), (6, 3, 0.0), (500, 1, 0.15)):
        fast, slow = np.empty(shape[1]), np.empty(shape[1])
        blocked = np.empty(shape[1], bool), np.empty(shape[1], bool)
        compiled.measure_free(d_px, height, FB, heights, support, spread, quantile, fast, blocked[0])
        reference.measure_free(d_px, height, FB, heights, support, spread, quantile, slow, blocked[1])
        np.testing.assert_allclose(fast, slow, **FLOAT)
        np.testing.assert_array_equal(*blocked)


def test_free_space_ends_at_road_and_at_things() -> None:
    """So that the test above compares more than NaN."""
    d_px = disparities(SHAPES[0], "levels")
    free = np.empty(31)
    for heights, ends in (((0.25, 2.5, 0.2), True), ((90.0, 91.0, 5.0), True), ((90.0, 91.0, 0.0), False)):
        blocked = np.empty(31, bool)
        reference.measure_free(d_px, raised(d_px, ROAD)[1], FB, np.array(heights), 3, 1, 0.15, free, blocked)
        assert np.isfinite(free).any() == ends
        assert blocked.any() == (heights[0] < 1)


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("kind", ["noise", "levels", "unknown"])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_links(shape: tuple[int, int], kind: str, road: np.ndarray) -> None:
    d_px = disparities(shape, kind)
    z, height = raised(d_px, road)
    for links in (LINKS, np.array([0.05, 0.1]), np.zeros(2), np.array([99.0, 99.0])):
        for gaps in ((1, 1), (2, 1), (1, 3), (50, 50)):
            fast, slow = np.full(d_px.size, 7, np.int32), np.full(d_px.size, 9, np.int32)
            compiled.link(d_px, z, height, LIMITS, links, *gaps, fast)
            reference.link(d_px, z, height, LIMITS, links, *gaps, slow)
            np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("n", [1, 2, 3, 10, 101])
@pytest.mark.parametrize("levels", [1, 4, 0])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_quantiles(n: int, levels: int, dtype: type) -> None:
    rng = np.random.default_rng(n)
    for share in (0.0, 0.01, 0.3, 0.5, 0.95, 1.0):
        values = (rng.integers(0, levels, n) if levels else rng.normal(0, 9, n)).astype(dtype)
        expected = reference.quantile_of(values, share)
        assert compiled.quantile_of(values.copy(), share) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("kind", ["noise", "levels", "unknown"])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_pieces(shape: tuple[int, int], kind: str, road: np.ndarray) -> None:
    _, z, height, parent = linked(shape, kind, road)
    columns = shape[1]
    overhead_m = np.nan if road is NO_ROAD else 1.0
    for least, split_m, most, fb in (
        (0, 8, 999, FB),
        (1, 0.5, 999, FB),
        (4, 0.5, 999, 1e9),
        (1, 2, 2, 1e9),
        (1, 2, 0, FB),
    ):
        results = []
        for kernels in (compiled, reference):
            cells, bounds = np.empty(parent.size, np.int32), np.empty(most + 1, np.int32)
            nearest = np.empty(most)
            found = kernels.gather_pieces(
                parent, z, height, fb, least, overhead_m, float(split_m), 0.1, cells, bounds, nearest
            )
            boxes = np.empty((found, 4), np.int32)
            kernels.measure_boxes(cells, bounds, found, columns, boxes)
            results.append((bounds[: found + 1], cells[: bounds[found]], boxes, nearest[:found]))
        (*fast, fast_m), (*slow, slow_m) = results
        for a, b in zip(fast, slow, strict=True):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_allclose(fast_m, slow_m, **FLOAT)


def test_long_things_are_cut() -> None:
    """So that the test above compares more than whole things."""
    _, z, height, parent = linked(SHAPES[0], "noise")
    cells, bounds, nearest = np.empty(parent.size, np.int32), np.empty(99, np.int32), np.empty(98)
    counts = [
        reference.gather_pieces(parent, z, height, 1e9, 1, 1.0, split_m, 0.1, cells, bounds, nearest)
        for split_m in (1e3, 0.5)
    ]
    assert counts[0] < counts[1]


def some(shape: tuple[int, int], share: float, seed: int) -> np.ndarray:
    """Return the numbers of some cells, one at least."""
    chosen = np.random.default_rng(seed).random(shape).ravel() < share
    chosen[chosen.size // 2] = True
    return np.flatnonzero(chosen).astype(np.int32)


@pytest.mark.parametrize("share", [0.0, 0.2, 0.9])
@pytest.mark.parametrize("shape", SHAPES)
def test_roughness(shape: tuple[int, int], share: float) -> None:
    d_px = disparities(shape, "noise")
    cells = some(shape, share, 4)
    cells = cells[np.isfinite(d_px.ravel()[cells])]
    members = np.full((2, d_px.size), -1, np.int32)
    fast, slow = (
        kernels.roughness(d_px, cells, np.empty(2 * len(cells), np.float32), member, 3)
        for kernels, member in zip((compiled, reference), members, strict=True)
    )
    assert fast == pytest.approx(slow, rel=1e-6, nan_ok=True)
    np.testing.assert_array_equal(*members)
    assert np.isfinite(slow) or share < 0.9 or d_px.size == 1


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("share", [0.0, 0.1, 0.9])
@pytest.mark.parametrize("shape", SHAPES)
def test_description(shape: tuple[int, int], share: float, cell: tuple[int, int], road: np.ndarray) -> None:
    d_px = singles(np.random.default_rng(5).uniform(1, 6, shape))
    _, height = raised(d_px, road, cell)
    cells = some(shape, share, 6)
    results = []
    for kernels in (compiled, reference):
        uvd, outline = np.empty((len(cells), 3)), np.empty((4 * shape[1], 2), np.int32)
        member = np.full(d_px.size, -1, np.int32)
        rough, n = kernels.describe(d_px, height, cells, *cell, 0.6, shape[0] * cell[1], member, 2, uvd, outline)
        results.append((uvd, outline[:n], member, rough))
    (*fast, fast_px), (*slow, slow_px) = results
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(a, b)
    assert fast_px == pytest.approx(slow_px, rel=1e-6, nan_ok=True)


@pytest.mark.parametrize("kind", ["noise", "levels"])
@pytest.mark.parametrize("shape", SHAPES)
def test_descriptions_of_some_pieces(shape: tuple[int, int], kind: str) -> None:
    d_px, z, height, parent = linked(shape, kind)
    cells, bounds, nearest = np.empty(parent.size, np.int32), np.empty(99, np.int32), np.empty(98)
    found = reference.gather_pieces(parent, z, height, FB, 1, 9.0, 0.5, 0.1, cells, bounds, nearest)
    boxes = np.empty((found, 4), np.int32)
    reference.measure_boxes(cells, bounds, found, shape[1], boxes)
    order = np.random.default_rng(3).permutation(found)[: found // 2 + 1]
    image = np.random.default_rng(7).integers(0, 65535, (shape[0] + 1, shape[1] + 2, 3)).astype(np.uint16)
    image.flags.writeable = False
    results = []
    for kernels in (compiled, reference):
        uvd, outline = np.full((len(cells), 3), 7.0), np.empty((4 * shape[1] * (found + 1), 2), np.int32)
        corners, rough, colors = np.empty(len(order) + 1, np.int32), np.empty(len(order)), np.empty((len(order), 3))
        kernels.describe_pieces(d_px, height, cells, bounds, order, boxes * 4, 4, 4, 0.6, uvd, outline, corners, rough)
        kernels.mean_colors(image, cells, bounds, order, shape[1], colors)
        results.append((corners, outline[: corners[-1]], uvd, rough, colors))
    (*fast, fast_px, fast_rgb), (*slow, slow_px, slow_rgb) = results
    for a, b in zip(fast, slow, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_allclose(fast_px, slow_px, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(fast_rgb, slow_rgb, **FLOAT)


@pytest.mark.parametrize("n", [0, 1, 60])
def test_hiding(n: int) -> None:
    rng = np.random.default_rng(9)
    low = rng.integers(0, 40, (n, 2))
    boxes = np.concatenate([low, low + rng.integers(1, 60, (n, 2))], 1).astype(np.int32)
    areas = (rng.uniform(0.3, 1, n) * (boxes[:, 2:] - boxes[:, :2]).prod(1)).astype(np.int32)
    fast, slow = np.empty(n, bool), np.empty(n, bool)
    compiled.drop_hidden(boxes, areas, fast)
    reference.drop_hidden(boxes, areas, slow)
    np.testing.assert_array_equal(fast, slow)
    assert n < 60 or 0 < np.count_nonzero(slow) < n


def test_what_is_hidden_hides_nothing() -> None:
    """The third box lies in the second, which the first hides, but beside the first."""
    boxes = np.array([[0, 0, 100, 90], [0, 0, 110, 90], [101, 0, 110, 90]], np.int32)
    for kernels in (compiled, reference):
        kept = np.empty(3, bool)
        kernels.drop_hidden(boxes, np.array([9000, 9900, 810], np.int32), kept)
        assert kept.tolist() == [True, False, True]


def test_the_largest_images_hide_things_too() -> None:
    """Whose areas nearly fill 32 bits."""
    boxes = np.array([[0, 0, 32766, 32766], [5, 5, 32760, 32760], [0, 0, 9, 9]], np.int32)
    for kernels in (compiled, reference):
        kept = np.empty(3, bool)
        kernels.drop_hidden(boxes, np.array([32766**2, 1, 81], np.int32), kept)
        assert kept.tolist() == [True, False, False]


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("sizes", [[1], [1, 2, 3, 4, 200], []], ids=["one", "many", "none"])
def test_surfaces(sizes: list[int], road: np.ndarray) -> None:
    rng = np.random.default_rng(10)
    uvd = rng.uniform((0, 0, 0.5), (83, 50, 9), (sum(sizes), 3))
    uvd[::3] = np.rint(uvd[::3] + 0.5)  # equal disparities
    bounds = np.cumsum([0, *sizes]).astype(np.int32)
    fast, slow = np.empty((len(sizes), 8)), np.empty((len(sizes), 8))
    compiled.measure_surfaces(uvd, bounds, TWIN, road, 0.1, fast)
    reference.measure_surfaces(uvd, bounds, TWIN, road, 0.1, slow)
    np.testing.assert_allclose(fast, slow, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("share", [0.3, 0.5])
@pytest.mark.parametrize("n", [0, 1, 2, 8])
def test_what_is_seen_through(n: int, share: float) -> None:
    rng = np.random.default_rng(11)
    columns, cells = 30, []
    for _ in range(n):
        (row, column), (tall, wide) = rng.integers(0, 8, 2), rng.integers(2, 20, 2)
        grid = np.stack(np.mgrid[row : row + tall, column : column + wide], -1).reshape(-1, 2)
        mine = grid[rng.random(len(grid)) < share] @ [columns, 1]
        mine = np.setdiff1d(mine, np.concatenate([*cells, []]))  # a cell belongs to one piece
        cells.append(mine if len(mine) else np.array([40 * columns + len(cells)]))
    bounds = np.cumsum([0, *map(len, cells)]).astype(np.int32)
    flat = np.concatenate([*cells, []]).astype(np.int32)
    order = rng.permutation(n).astype(np.int64)
    fast, slow = np.empty(n, bool), np.empty(n, bool)
    compiled.find_through(flat, bounds, order, columns, fast)
    reference.find_through(flat, bounds, order, columns, slow)
    np.testing.assert_array_equal(fast, slow)
    assert n < 8 or 0 < np.count_nonzero(slow) < n


def test_a_fence_is_seen_through_and_a_person_is_not() -> None:
    """Cells of a car, behind pickets in every third column, and behind a person in its middle third."""
    columns = 24
    column = np.arange(6 * columns) % columns
    for near, is_through in ((column % 3 == 0, True), ((column >= 8) & (column < 16), False)):
        cells = np.concatenate([np.flatnonzero(near), np.flatnonzero(~near)]).astype(np.int32)
        bounds = np.array([0, near.sum(), near.size], np.int32)
        for kernels in (compiled, reference):
            through = np.empty(2, bool)
            kernels.find_through(cells, bounds, np.array([0, 1]), columns, through)
            assert through.tolist() == [False, is_through]


@pytest.mark.parametrize("road", [ROAD, NO_ROAD], ids=["road", "none"])
@pytest.mark.parametrize("kind", ["noise", "levels", "unknown"])
@pytest.mark.parametrize("shape", SHAPES + EMPTY)
def test_stixels(shape: tuple[int, int], kind: str, road: np.ndarray) -> None:
    d_px = disparities(shape, kind)
    z, height = raised(d_px, road)
    for gap, least, room in ((1, 1, 2000), (2, 3, 2000), (3, 2, 4)):
        fast, slow = np.zeros((room, 5)), np.zeros((room, 5))
        n = compiled.find_stixels(d_px, z, height, LIMITS, LINKS, gap, least, fast)
        assert n == reference.find_stixels(d_px, z, height, LIMITS, LINKS, gap, least, slow)
        np.testing.assert_allclose(fast, slow, **FLOAT)
        assert n > 0 or kind == "unknown" or shape != SHAPES[0]
