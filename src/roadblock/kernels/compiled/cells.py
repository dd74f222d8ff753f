"""The kernels of `reference.cells`, compiled: same names, same arguments, same bits; see `simd` for their vectors."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels import simd
from roadblock.kernels.reference.cells import (
    ALIKE,
    BLOCK,
    BORDER,
    CELL_ROWS,
    FILL,
    GOOD,
    OUTSIDE,
    PATTERN,
    QUIET_SHARE,
    REPEATS,
    RING,
    STRIPES,
    TOP,
    Bytes,
    Floats,
)

AT_ONCE = 32
"""Pixels that one step of the census takes."""
(Y0, X0), (Y1, X1), (Y2, X2), (Y3, X3), (Y4, X4), (Y5, X5), (Y6, X6), (Y7, X7) = RING


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def sample_bit(image, v, u, middle, bit):  # type: ignore[no-untyped-def]
    """Return `bit` where the sample is not darker than the middle."""
    darkest = simd.minimum(simd.load_bytes(image, v, u, middle), middle)
    return simd.both(simd.equal(darkest, middle), simd.splat(bit, middle))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def encode(image: Bytes, codes: Bytes) -> None:
    """See `reference.cells.encode`."""
    rows, columns = image.shape
    codes[: min(BORDER, rows)] = 0
    codes[max(rows - BORDER, 0) :] = 0
    like = simd.zeros(32)
    for v in range(BORDER, rows - BORDER):
        codes[v, : min(BORDER, columns)] = 0
        codes[v, max(columns - BORDER, 0) :] = 0
        u = BORDER
        while u + AT_ONCE <= columns - BORDER:
            m = simd.load_bytes(image, v, u, like)
            a = simd.either(sample_bit(image, v + Y0, u + X0, m, 1), sample_bit(image, v + Y1, u + X1, m, 2))
            b = simd.either(sample_bit(image, v + Y2, u + X2, m, 4), sample_bit(image, v + Y3, u + X3, m, 8))
            c = simd.either(sample_bit(image, v + Y4, u + X4, m, 16), sample_bit(image, v + Y5, u + X5, m, 32))
            d = simd.either(sample_bit(image, v + Y6, u + X6, m, 64), sample_bit(image, v + Y7, u + X7, m, 128))
            simd.store(codes, v, u, simd.either(simd.either(a, b), simd.either(c, d)))
            u += AT_ONCE
            if u < columns - BORDER < u + AT_ONCE and columns >= AT_ONCE + 2 * BORDER:
                u = columns - BORDER - AT_ONCE  # the last step overlaps the one before
        while u < columns - BORDER:
            code = np.uint8(0)
            for bit in range(8):
                if image[v + RING[bit][0], u + RING[bit][1]] >= image[v, u]:
                    code |= np.uint8(1 << bit)
            codes[v, u] = code
            u += 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turn(plain: Bytes, codes: Bytes) -> None:
    """See `reference.cells.turn`."""
    rows, columns = plain.shape
    like = simd.zeros(32)
    for v in range(rows):
        u = 0
        while u + AT_ONCE <= columns:
            simd.store(codes, v, columns - AT_ONCE - u, simd.reverse(simd.load_bytes(plain, v, u, like)))
            u += AT_ONCE
        while u < columns:
            codes[v, columns - 1 - u] = plain[v, u]
            u += 1
        codes[v, columns:] = 0


def cost_cells(left: Bytes, turned: Bytes, cell_columns: int, costs: Bytes) -> None:
    """See `reference.cells.cost_cells`."""
    _cost_cells(left, turned, cell_columns, simd.in_registers(costs))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def pixel_cost(left, turned, v, u, like):  # type: ignore[no-untyped-def]
    """Return how many bits differ between a pixel and its partners at all disparities."""
    partners = simd.load_bytes(turned, v, left.shape[1] - 1 - u, like)
    return simd.count_bits(simd.differing(simd.splat(left[v, u], like), partners))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def keep(costs, numbers, last, otherwise):  # type: ignore[no-untyped-def]
    """Return the costs of the lanes up to `last`, and `otherwise` in those beyond."""
    inside = simd.equal(simd.minimum(numbers, simd.splat(min(last, TOP), costs)), numbers)
    return simd.select(inside, costs, otherwise)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _cost_cells(left, turned, cell_columns, costs):  # type: ignore[no-untyped-def]
    rows, columns = costs.shape
    if rows == 0 or columns == 0:
        return
    like = simd.load(costs, 0, 0)
    lanes, numbers, twice = costs.itemsize, simd.lane_numbers(like), simd.splat(CELL_ROWS * OUTSIDE, like)
    for r in range(rows):
        for c in range(columns):
            total = simd.splat(0, like)
            for u in range(c * cell_columns, (c + 1) * cell_columns, 2):
                a = simd.add(pixel_cost(left, turned, 2 * r, u, like), pixel_cost(left, turned, 2 * r + 1, u, like))
                b = simd.add(
                    pixel_cost(left, turned, 2 * r, u + 1, like), pixel_cost(left, turned, 2 * r + 1, u + 1, like)
                )
                if u < lanes - 1:
                    a, b = keep(a, numbers, u, twice), keep(b, numbers, u + 1, twice)
                total = simd.add(total, simd.add(a, b))
            simd.store(costs, r, c, total)


def sum_paths(costs: Bytes, p1: int, p2: int, sums: Bytes) -> None:
    """See `reference.cells.sum_paths`."""
    _sum_paths(simd.in_registers(costs), p1, p2, simd.in_registers(sums))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def step(path, cost, p1, p2):  # type: ignore[no-untyped-def]
    """Return the path's cost at the next cell."""
    above = simd.subtract(path, simd.splat(simd.least(path), path))
    beside = simd.minimum(simd.shift_up(above, 1), simd.shift_down(above, 1))
    return simd.add(cost, simd.minimum(simd.minimum(above, p2), simd.add(beside, p1)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sum_paths(costs, price1, price2, sums):  # type: ignore[no-untyped-def]
    rows, columns = costs.shape
    if rows == 0 or columns == 0:
        return
    like = simd.load(costs, 0, 0)
    nothing, p1, p2 = simd.splat(0, like), simd.splat(price1, like), simd.splat(price2, like)
    down = np.empty((1, columns), costs.dtype)
    for c in range(columns):
        simd.store(down, 0, c, nothing)
    # Four rows at once, since the steps along one row wait for each other. A path starts as the step from nothing. Rows
    # past the last one do the last one again: all four are read before any is written, so that counts once.
    for r in range(0, rows, 4):
        r1, r2, r3 = min(r + 1, rows - 1), min(r + 2, rows - 1), min(r + 3, rows - 1)
        x0, x1, x2, x3 = nothing, nothing, nothing, nothing
        for c in range(columns):
            x0 = step(x0, simd.load(costs, r, c), p1, p2)
            x1 = step(x1, simd.load(costs, r1, c), p1, p2)
            x2 = step(x2, simd.load(costs, r2, c), p1, p2)
            x3 = step(x3, simd.load(costs, r3, c), p1, p2)
            simd.store(sums, r, c, x0)
            simd.store(sums, r1, c, x1)
            simd.store(sums, r2, c, x2)
            simd.store(sums, r3, c, x3)
        x0, x1, x2, x3 = nothing, nothing, nothing, nothing
        for c in range(columns - 1, -1, -1):
            x0 = step(x0, simd.load(costs, r, c), p1, p2)
            x1 = step(x1, simd.load(costs, r1, c), p1, p2)
            x2 = step(x2, simd.load(costs, r2, c), p1, p2)
            x3 = step(x3, simd.load(costs, r3, c), p1, p2)
            s0, s1, s2, s3 = (
                simd.load(sums, r, c),
                simd.load(sums, r1, c),
                simd.load(sums, r2, c),
                simd.load(sums, r3, c),
            )
            simd.store(sums, r, c, simd.add(s0, x0))
            simd.store(sums, r1, c, simd.add(s1, x1))
            simd.store(sums, r2, c, simd.add(s2, x2))
            simd.store(sums, r3, c, simd.add(s3, x3))
        for row in range(r, min(r + 4, rows)):
            for c in range(columns):
                x = step(simd.load(down, 0, c), simd.load(costs, row, c), p1, p2)
                simd.store(down, 0, c, x)
                simd.store(sums, row, c, simd.add(simd.load(sums, row, c), x))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def cover_of_three(lanes: int) -> Bytes:
    """Return (1, 2 lanes) bytes that, loaded from `lanes - k` on, cover lanes k - 1 .. k + 1."""
    cover = np.zeros((1, 2 * lanes), np.uint8)
    cover[0, lanes - 1 : lanes + 2] = TOP
    return cover


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
    """See `reference.cells.choose`."""
    cells = simd.in_registers(costs), simd.in_registers(sums)
    _choose(*cells, p1, p2, cell_columns, tolerance, least_margin, d_px, margin)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _choose(costs, sums, price1, price2, cell_columns, tolerance, least_margin, d_px, margin):  # type: ignore[no-untyped-def]
    rows, columns = costs.shape
    lanes = costs.itemsize
    if rows == 0 or columns == 0:
        return
    like = simd.load(costs, 0, 0)
    nothing, p1, p2 = simd.splat(0, like), simd.splat(price1, like), simd.splat(price2, like)
    up = np.empty((1, columns), costs.dtype)
    for c in range(columns):
        simd.store(up, 0, c, nothing)
    worst = simd.splat(TOP, like)
    cover = cover_of_three(lanes)
    best = np.empty(columns, np.uint8)
    totals = np.empty((1, lanes * columns), np.uint8)
    at_right = np.empty((1, columns * cell_columns + lanes), np.uint8)
    # at_right[0, end - x] is the least total at pixel x of the right image;
    # lane k of `seen` is for x = c * cell_columns - k.
    end = columns * cell_columns
    for r in range(rows - 1, -1, -1):
        seen = worst
        for c in range(columns):
            path = step(simd.load(up, 0, c), simd.load(costs, r, c), p1, p2)
            simd.store(up, 0, c, path)
            total = simd.add(simd.load(sums, r, c), path)
            simd.store(totals, 0, c * lanes, total)
            seen = simd.minimum(seen, total)
            if cell_columns == 2:
                simd.store(at_right, 0, end - 2 * c + lanes - 2, simd.last(seen, 2))
                seen = simd.shift_up(seen, 2)
            else:
                simd.store(at_right, 0, end - 4 * c + lanes - 4, simd.last(seen, 4))
                seen = simd.shift_up(seen, 4)
            least = simd.least(total)
            k = simd.first_equal(total, simd.splat(least, like))
            best[c] = k
            near = simd.load_bytes(cover, 0, lanes - k, like)
            margin[r, c] = simd.least(simd.either(total, near)) - least
        # What is left are pixels to whose totals no later cell adds.
        simd.store(at_right, 0, 0, seen)
        for c in range(columns):
            k = np.int64(best[c])
            inside = 0 < k < lanes - 1
            k = k if inside else np.int64(1)
            i = c * lanes + k
            before, least, after = np.int32(totals[0, i - 1]), np.int32(totals[0, i]), np.int32(totals[0, i + 1])
            confirmed = least <= at_right[0, end - c * cell_columns + k] + tolerance
            known = inside & (k <= c * cell_columns) & confirmed & (margin[r, c] >= least_margin)
            steeper = before if before > after else after
            steep = steeper - least if steeper > least else np.int32(1)
            part = np.float32(before - after) / np.float32(2 * steep)
            d_px[r, c] = np.float32(2) * (np.float32(k) + part) if known else np.float32(np.nan)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_texture(image: Bytes, cell_columns: int, texture: Bytes) -> None:
    """See `reference.cells.measure_texture`."""
    rows, columns = texture.shape
    steps = np.zeros(columns * cell_columns, np.int16)
    for r in range(rows):
        upper, lower = image[CELL_ROWS * r], image[CELL_ROWS * r + 1]
        for u in range(1, min(len(steps), image.shape[1] - 1)):
            a = abs(np.int16(upper[u + 1]) - np.int16(upper[u - 1]))
            steps[u] = np.int16(a + abs(np.int16(lower[u + 1]) - np.int16(lower[u - 1])))
        if cell_columns == 2:
            for c in range(columns):
                texture[r, c] = min(steps[2 * c] + steps[2 * c + 1], TOP)
        else:
            for c in range(columns):
                a = steps[4 * c] + steps[4 * c + 1] + steps[4 * c + 2] + steps[4 * c + 3]
                texture[r, c] = min(a >> 1, TOP)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_noise(texture: Bytes) -> int:
    """See `reference.cells.measure_noise`."""
    counts = np.zeros(256, np.int64)
    for r in range(texture.shape[0]):
        for c in range(texture.shape[1]):
            counts[texture[r, c]] += 1
    wanted, passed = int(QUIET_SHARE * texture.size), 0
    for level in range(256):
        passed += counts[level]
        if passed > wanted:
            return level
    return 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def drop_weak(
    texture: Bytes, margin: Bytes, least_texture: int, least_margin: int, blocks: NDArray[np.int16], d_px: Floats
) -> None:
    """See `reference.cells.drop_weak`."""
    rows, columns = texture.shape
    # The rows are padded by what blocks and their neighbours reach over the border.
    tall, wide = np.zeros(columns + 2 * BLOCK, np.int16), np.zeros(columns + 2 * FILL, np.int16)
    for r in range(rows):
        tall[BLOCK : BLOCK + columns] = 0
        for i in range(max(0, r - BLOCK), min(rows, r + BLOCK + 1)):
            row = texture[i]
            for c in range(columns):
                tall[c + BLOCK] += np.int16(row[c])
        for c in range(columns):
            wide[c + FILL] = np.int16(tall[c] + tall[c + 1] + tall[c + 2])
        into = blocks[r]
        for c in range(columns):
            into[c] = max(max(wide[c], wide[c + 1]), max(wide[c + 2], max(wide[c + 3], wide[c + 4])))
    least = np.int16((2 * BLOCK + 1) ** 2 * least_texture)
    for r in range(rows):
        wide[:] = 0
        for i in range(max(0, r - FILL), min(rows, r + FILL + 1)):
            row = blocks[i]
            for c in range(columns):
                wide[c] = max(wide[c], row[c])
        for c in range(columns):
            d_px[r, c] = np.float32(np.nan) if wide[c] < least or margin[r, c] < least_margin else d_px[r, c]


def drop_repeated(costs: Bytes, texture: Bytes, cell_columns: int, marks: Bytes, d_px: Floats) -> None:
    """See `reference.cells.drop_repeated`."""
    _drop_repeated(simd.in_registers(costs), texture, cell_columns, marks, d_px)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _drop_repeated(costs, texture, cell_columns, marks, d_px):  # type: ignore[no-untyped-def]
    rows, columns = costs.shape
    lanes = costs.itemsize
    if rows == 0 or columns == 0:
        return
    like = simd.load(costs, 0, 0)
    everywhere = simd.splat(TOP, like)
    alike, good = ALIKE * cell_columns // 2, GOOD * cell_columns // 2
    cover = cover_of_three(lanes)
    for r in range(rows):
        above, below = max(r - 1, 0), min(r + 1, rows - 1)
        for c in range(columns):
            marks[r, c] = 0
            d = d_px[r, c]
            if not (d > 0 and texture[r, c] >= STRIPES):
                continue
            tall = simd.add(simd.add(simd.load(costs, above, c), simd.load(costs, r, c)), simd.load(costs, below, c))
            near = simd.load_bytes(cover, 0, lanes - np.int64(d * np.float32(0.5) + np.float32(0.5)), like)
            other = np.int64(simd.least(simd.either(tall, near)))
            if other > good:
                continue
            best = np.int64(simd.least(simd.either(tall, simd.differing(near, everywhere))))
            marks[r, c] = other <= best + alike
    repeats = np.zeros(columns + 2 * PATTERN + 1, np.int16)  # column c is at c + PATTERN + 1, after a sum of none
    for r in range(rows):
        repeats[:] = 0
        for i in range(max(0, r - PATTERN), min(rows, r + PATTERN + 1)):
            row = marks[i]
            for c in range(columns):
                repeats[c + PATTERN + 1] += np.int16(row[c])
        for c in range(1, len(repeats)):
            repeats[c] += repeats[c - 1]
        for c in range(columns):
            if repeats[c + 2 * PATTERN + 1] - repeats[c] >= REPEATS:
                d_px[r, c] = np.nan


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def root(parents, cell):  # type: ignore[no-untyped-def]
    """Return the first cell of the island that a cell belongs to, and shorten the way there."""
    while parents[cell] != cell:
        parents[cell] = parents[parents[cell]]
        cell = parents[cell]
    return cell


@numba.njit(cache=True, nogil=True, error_model="numpy")
def drop_speckles(d_px: Floats, step_px: float, cells: int, labels: NDArray[np.int32]) -> None:
    """See `reference.cells.drop_speckles`."""
    rows, columns = d_px.shape
    parents, sizes = labels[0], labels[1]
    step = np.float32(step_px)
    for r in range(rows):
        for c in range(columns):
            cell = r * columns + c
            parents[cell], sizes[cell] = cell, 0
            d = d_px[r, c]
            joins_left = c > 0 and abs(d - d_px[r, c - 1]) <= step
            if joins_left:
                parents[cell] = parents[cell - 1]
            if r > 0 and abs(d - d_px[r - 1, c]) <= step:
                if (
                    joins_left
                    and abs(d_px[r - 1, c - 1] - d_px[r - 1, c]) <= step
                    and abs(d_px[r - 1, c - 1] - d_px[r, c - 1]) <= step
                ):
                    continue  # the two are one island already
                a, b = root(parents, cell), root(parents, cell - columns)
                parents[max(a, b)] = min(a, b)
                parents[cell] = min(a, b)
    # Parents come before their children, so one pass in order leaves every cell pointing at its island's first.
    for cell in range(rows * columns):
        parents[cell] = parents[parents[cell]]
        sizes[parents[cell]] += 1
    for r in range(rows):
        for c in range(columns):
            if sizes[parents[r * columns + c]] < cells:
                d_px[r, c] = np.nan


@numba.njit(cache=True, nogil=True, error_model="numpy")
def smooth(d_px: Floats, step_px: float, smoothed: Floats) -> None:
    """See `reference.cells.smooth`."""
    rows, columns = d_px.shape
    step = np.float32(step_px)
    smoothed[:] = d_px
    for r in range(1, rows - 1):
        above, here, below, into = d_px[r - 1], d_px[r], d_px[r + 1], smoothed[r]
        for c in range(1, columns - 1):
            d = here[c]
            bend, n = np.float32(0), np.float32(1)
            for a, b in (
                (above[c - 1], below[c + 1]),
                (above[c], below[c]),
                (above[c + 1], below[c - 1]),
                (here[c - 1], here[c + 1]),
            ):
                alike = (abs(a - d) <= step) & (abs(b - d) <= step)
                bend += (a - d) + (b - d) if alike else np.float32(0)
                n += np.float32(2) if alike else np.float32(0)
            into[c] = d + bend / n
