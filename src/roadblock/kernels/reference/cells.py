"""Semi-global matching on a grid of cells as plain numpy: what `compiled.cells` must reproduce to the bit.

All images have half the resolution of the rectified ones. A cell is 2 rows by 2 or 4 columns of half-resolution pixels,
that is 4 x 4 or 8 x 4 pixels (width x height). A lane is one disparity of a cell: lane k is k half-resolution pixels,
hence 2 k pixels. Costs are bytes, and every sum of bytes stops at 255.

Kernels write into arrays that the caller owns, so that nothing of the image's size is allocated per frame.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter, uniform_filter

Bytes = NDArray[np.uint8]
Floats = NDArray[np.float32]

RING = ((-2, -2), (-2, 0), (-2, 2), (0, -2), (0, 2), (2, -2), (2, 0), (2, 2))
"""Rows and columns of the 8 samples that census compares with the middle; bit i belongs to sample i."""
BORDER = 2
"""Census codes this near to the image's border are 0."""
CELL_ROWS = 2
"""Half-resolution rows of a cell."""
OUTSIDE = 3
"""Cost per pixel where the right image ends: less than random codes cost, more than a match."""
TOP = 255
BLOCK = 1
"""Texture is judged in blocks of this many cells to each side of a middle one, ..."""
FILL = 2
"""... and carries the cells up to this many cells aside of that: matching fills in smooth paint between edges."""
ALIKE, GOOD = 2, 14
"""A pattern repeats if it fits elsewhere with as few differing bits, give or take, and with this few at most, ..."""
PATTERN, REPEATS = 3, 8
"""... in so many cells among those up to `PATTERN` cells aside."""
STRIPES = 24
"""Texture of a cell whose pattern can repeat along its row."""
QUIET_SHARE = 0.05
"""The least textured cells of an image, which show little but its noise."""


def encode(image: Bytes, codes: Bytes) -> None:
    """Write for each pixel which of its 8 ring samples are not darker, as bits.

    Parameters
    ----------
    image
        (rows, columns) grey levels.
    codes
        (rows, columns), written; 0 along the border.
    """
    rows, columns = image.shape
    codes[:] = 0
    if min(rows, columns) <= 2 * BORDER:
        return
    inner = (slice(BORDER, rows - BORDER), slice(BORDER, columns - BORDER))
    for bit, (i, j) in enumerate(RING):
        sample = image[BORDER + i : rows - BORDER + i, BORDER + j : columns - BORDER + j]
        codes[inner] |= (sample >= image[inner]).astype(np.uint8) << np.uint8(bit)


def turn(plain: Bytes, codes: Bytes) -> None:
    """Write codes with columns reversed, so that a pixel's partners at rising disparity lie one after the other.

    Parameters
    ----------
    plain
        (rows, columns) codes of `encode`.
    codes
        (rows, columns + lanes), written: pixel u is at columns - 1 - u, and 0 beyond the last one.
    """
    columns = plain.shape[1]
    codes[:, :columns] = plain[:, ::-1]
    codes[:, columns:] = 0


def cost_cells(left: Bytes, turned: Bytes, cell_columns: int, costs: Bytes) -> None:
    """Write how many census bits differ between each cell and its partner in the right image, for each disparity.

    Parameters
    ----------
    left
        (rows, columns) codes of `encode`.
    turned
        (rows, columns + lanes) codes of `turn`.
    cell_columns
        Half-resolution columns of a cell, 2 or 4.
    costs
        (cell rows, cell columns, lanes), written. A pixel whose partner is outside the right image costs `OUTSIDE`.
    """
    rows, columns, lanes = costs.shape
    height, width = rows * CELL_ROWS, columns * cell_columns
    for k in range(lanes):
        first = left.shape[1] - 1 + k
        partners = turned[:height, first - np.arange(width)]
        bits = np.bitwise_count(left[:height, :width] ^ partners)
        bits[:, :k] = OUTSIDE
        costs[:, :, k] = bits.reshape(rows, CELL_ROWS, columns, cell_columns).sum((1, 3))


def sum_paths(costs: Bytes, p1: int, p2: int, sums: Bytes) -> None:
    """Write the sum of the costs along three paths (from the left, the right and above), each bent as little as pays.

    Hirschmueller's equation 13: along a path, a cell's cost is its own plus the least of the previous cell's at the
    same lane, at a neighbouring lane plus p1, and at any lane plus p2, less the previous cell's least.

    Parameters
    ----------
    costs
        (cell rows, cell columns, lanes).
    p1, p2
        Price of a change by one lane, and by more.
    sums
        (cell rows, cell columns, lanes), written.
    """
    across, back = costs.transpose(1, 0, 2), costs[:, ::-1].transpose(1, 0, 2)
    total = _follow(costs, p1, p2)
    total += _follow(across, p1, p2).transpose(1, 0, 2)
    total += _follow(back, p1, p2).transpose(1, 0, 2)[:, ::-1]
    sums[:] = np.minimum(total, TOP)


def _follow(costs: Bytes, p1: int, p2: int) -> NDArray[np.int64]:
    """Return the costs along paths from the first to the last row."""
    paths = costs.astype(np.int64)
    for i in range(1, len(costs)):
        paths[i] = np.minimum(costs[i] + _cheapest(paths[i - 1], p1, p2), TOP)
    return paths


def _cheapest(path: NDArray[np.int64], p1: int, p2: int) -> NDArray[np.int64]:
    least = path.min(-1, keepdims=True)
    beside = np.pad(path, ((0, 0), (1, 1)), constant_values=TOP)
    ways = [path, beside[:, :-2] + p1, beside[:, 2:] + p1, np.broadcast_to(least + p2, path.shape)]
    return np.asarray(np.minimum.reduce(ways) - least)


def choose(
    costs: Bytes,
    sums: Bytes,
    p1: int,
    p2: int,
    cell_columns: int,
    tolerance: int,
    least_margin: int,
    d_px: Floats,
    margin: Bytes,
) -> None:
    """Add the fourth path, from below; write each cell's disparity, and by how much it beats all but its neighbours.

    Parameters
    ----------
    costs, sums
        (cell rows, cell columns, lanes) of `cost_cells` and `sum_paths`.
    p1, p2
        As for `sum_paths`.
    cell_columns
        Half-resolution columns of a cell, 2 or 4.
    tolerance
        A cell is confirmed if no cell matches its partner in the right image better by more than this.
    least_margin
        A cell that beats the others by less is unknown.
    d_px
        (cell rows, cell columns), written: disparity in full-resolution pixels, NaN where the best lane is the first or
        last, reaches out of the right image, is not confirmed, or has too small a margin.
    margin
        (cell rows, cell columns), written: second best (at least 2 lanes away) less best.
    """
    rows, columns, lanes = sums.shape
    totals = np.minimum(sums + _follow(costs[::-1], p1, p2)[::-1], TOP).astype(np.uint8)
    at_right = np.full((rows, columns * cell_columns + lanes), TOP, np.uint8)
    for c in range(columns):
        seen = at_right[:, c * cell_columns : c * cell_columns + lanes]
        np.minimum(seen, totals[:, c, ::-1], out=seen)
    best = totals.argmin(-1)
    for r, c in np.ndindex(rows, columns):
        k, total = best[r, c], totals[r, c].astype(np.int32)
        others = np.delete(total, np.arange(max(k - 1, 0), min(k + 2, lanes)))
        margin[r, c] = others.min(initial=TOP) - total[k]
        d_px[r, c] = np.nan
        confirmed = total[k] - tolerance <= at_right[r, c * cell_columns + lanes - 1 - k]
        if 0 < k < lanes - 1 and k <= c * cell_columns and confirmed and margin[r, c] >= least_margin:
            d_px[r, c] = 2 * (k + refine(total[k - 1], total[k], total[k + 1]))


def refine(before: int, least: int, after: int) -> np.float32:
    """Return where the minimum lies between lanes (-0.5 .. 0.5), by two lines of opposite slope."""
    steep = max(before - least, after - least)
    return np.float32(before - after) / np.float32(2 * steep) if steep > 0 else np.float32(0)


def measure_texture(image: Bytes, cell_columns: int, texture: Bytes) -> None:
    """Write four times the mean step |I(u + 1) - I(u - 1)| in each cell, in grey levels, at most 255.

    Parameters
    ----------
    image
        (rows, columns) grey levels. Steps at the first and last column are 0.
    cell_columns
        Half-resolution columns of a cell, 2 or 4.
    texture
        (cell rows, cell columns), written.
    """
    rows, columns = texture.shape
    steps = np.zeros(image.shape, np.int32)
    if image.shape[1] > 2:
        steps[:, 1:-1] = np.abs(image[:, 2:].astype(np.int32) - image[:, :-2])
    steps = steps[: rows * CELL_ROWS, : columns * cell_columns]
    total = steps.reshape(rows, CELL_ROWS, columns, cell_columns).sum((1, 3))
    texture[:] = np.minimum(4 * total // (CELL_ROWS * cell_columns), TOP)


def measure_noise(texture: Bytes) -> int:
    """Return the texture that `QUIET_SHARE` of the cells do not exceed: what noise alone gives, or more.

    Parameters
    ----------
    texture
        (cell rows, cell columns) of `measure_texture`.
    """
    wanted = int(QUIET_SHARE * texture.size)
    return int(np.sort(texture, axis=None)[wanted]) if texture.size else 0


def drop_weak(
    texture: Bytes, margin: Bytes, least_texture: int, least_margin: int, blocks: NDArray[np.int16], d_px: Floats
) -> None:
    """Set cells that nothing speaks for to NaN: blank ones (smooth, burnt out, covered), and those hardly preferred.

    Parameters
    ----------
    texture, margin
        (cell rows, cell columns) of `measure_texture` and `choose`.
    least_texture
        A cell is blank if in no block of cells (`BLOCK`) within `FILL` cells of it the texture reaches this mean.
        Cells outside the image have none.
    least_margin
        Cells with less margin are unknown.
    blocks
        (cell rows, cell columns), scratch.
    d_px
        (cell rows, cell columns) disparities, changed in place.
    """
    rows, columns = texture.shape
    padded = np.pad(texture.astype(np.int16), BLOCK)
    side = range(2 * BLOCK + 1)
    sums = sum((padded[i : i + rows, j : j + columns] for i in side for j in side), np.zeros_like(blocks))
    blocks[:] = maximum_filter(sums, 2 * FILL + 1, mode="constant") if texture.size else 0
    d_px[(blocks < (2 * BLOCK + 1) ** 2 * least_texture) | (margin < least_margin)] = np.nan


def drop_repeated(costs: Bytes, texture: Bytes, cell_columns: int, marks: Bytes, d_px: Floats) -> None:
    """Set cells of a pattern that fits at several disparities (a fence's pickets) to NaN.

    The images alone are asked, without the paths: does a cell, with those above and below, fit elsewhere as well?

    Parameters
    ----------
    costs
        (cell rows, cell columns, lanes) of `cost_cells`.
    texture
        (cell rows, cell columns) of `measure_texture`.
    cell_columns
        Half-resolution columns of a cell, 2 or 4.
    marks
        (cell rows, cell columns), scratch.
    d_px
        (cell rows, cell columns) disparities, changed in place.
    """
    rows, _, lanes = costs.shape
    alike, good = ALIKE * cell_columns // 2, GOOD * cell_columns // 2
    marks[:] = 0
    for r, c in np.argwhere((d_px > 0) & (texture >= STRIPES)):
        tall = costs[[max(r - 1, 0), r, min(r + 1, rows - 1)], c].sum(0, dtype=np.int64)
        k = int(d_px[r, c] * np.float32(0.5) + np.float32(0.5))
        near = np.abs(np.arange(lanes) - k) <= 1
        best, other = (int(tall[lanes_].min(initial=TOP)) for lanes_ in (near, ~near))
        marks[r, c] = other <= min(best + alike, good)
    near_by = uniform_filter(marks.astype(float), 2 * PATTERN + 1, mode="constant") * (2 * PATTERN + 1) ** 2
    d_px[np.rint(near_by) >= REPEATS] = np.nan


def drop_speckles(d_px: Floats, step_px: float, cells: int, labels: NDArray[np.int32]) -> None:
    """Set islands of fewer than `cells` cells to NaN.

    Parameters
    ----------
    d_px
        (cell rows, cell columns) disparities, changed in place.
    step_px
        Neighbours (above, below, left, right) belong together up to this difference.
    cells
        Smallest island that stays.
    labels
        (2, cell rows * cell columns), scratch.
    """
    parents, sizes = labels
    rows, columns = d_px.shape
    parents[:], sizes[:] = np.arange(rows * columns), 1
    for r, c in np.ndindex(rows, columns):
        for other in ((r, c - 1), (r - 1, c)):
            if min(other) >= 0 and abs(d_px[r, c] - d_px[other]) <= np.float32(step_px):
                a, b = sorted((_root(parents, r * columns + c), _root(parents, other[0] * columns + other[1])))
                if a != b:
                    parents[b] = a
                    sizes[a] += sizes[b]
    for r, c in np.ndindex(rows, columns):
        if sizes[_root(parents, r * columns + c)] < cells:
            d_px[r, c] = np.nan


def _root(parents: NDArray[np.int32], cell: int) -> int:
    while parents[cell] != cell:
        cell = int(parents[cell])
    return cell


def smooth(d_px: Floats, step_px: float, smoothed: Floats) -> None:
    """Write the mean of each cell and those of its 8 neighbours that lie on its surface.

    Neighbours count in opposite pairs, so that a slope stays as it is; a pair counts if both differ from the cell by no
    more than a step, so that edges stay. Cells at the border, and unknown ones, stay as they are.

    Parameters
    ----------
    d_px
        (cell rows, cell columns) disparities, NaN unknown.
    step_px
        Largest difference on one surface.
    smoothed
        (cell rows, cell columns), written.
    """
    rows, columns = d_px.shape
    smoothed[:] = d_px
    if min(rows, columns) < 3:
        return
    middle = d_px[1:-1, 1:-1]
    bend, n = np.zeros_like(middle), np.ones_like(middle)
    for i, j in ((-1, -1), (-1, 0), (-1, 1), (0, -1)):
        a, b = (d_px[1 + i * k : rows - 1 + i * k, 1 + j * k : columns - 1 + j * k] - middle for k in (1, -1))
        alike = (abs(a) <= np.float32(step_px)) & (abs(b) <= np.float32(step_px))
        bend += np.where(alike, a + b, np.float32(0))
        n += np.float32(2) * alike
    smoothed[1:-1, 1:-1] = middle + bend / n
