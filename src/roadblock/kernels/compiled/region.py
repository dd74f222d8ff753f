"""The kernels of `reference.region`, compiled: same names, same arguments, same bits.

Costs of whole windows come from running sums, so their price does not depend on the window's size: each step adds the
row (or column) that enters and takes away the one that leaves. Sums are integers, hence exact in any order.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.region import CENSUS, CENSUS_HALF, NCC, SAD, SSD, TIE, ZNCC, Codes, Costs

Sums = NDArray[np.int64]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def census(image: Codes) -> Codes:
    """See `reference.census`."""
    rows, columns = image.shape[0] - 2 * CENSUS_HALF, image.shape[1] - 2 * CENSUS_HALF
    codes = np.zeros((rows, columns), np.int32)
    for v in range(rows):
        for i in range(2 * CENSUS_HALF + 1):
            for j in range(2 * CENSUS_HALF + 1):
                if i != CENSUS_HALF or j != CENSUS_HALF:
                    for u in range(columns):
                        darker = image[v + i, u + j] < image[v + CENSUS_HALF, u + CENSUS_HALF]
                        codes[v, u] = codes[v, u] << 1 | darker
    return codes


@numba.njit(cache=True, nogil=True, error_model="numpy")
def match_windows(
    left: Codes, right: Codes, half: int, disparities: int, cost: int, uniqueness_percent: int
) -> NDArray[np.float32]:
    """See `reference.match_windows`."""
    height, width = left.shape[0] - 2 * half, left.shape[1] - 2 * half
    # Reversed, so that neighbouring disparities lie next to each other in memory.
    turned = np.ascontiguousarray(right[:, ::-1])
    columns = np.zeros((left.shape[1], disparities), np.int32)
    costs = np.full((width, disparities), np.inf)
    roots_left, sums_left = window_energies(left, half, cost)
    roots_right, sums_right = window_energies(turned, half, cost)
    found = np.full((height, width), np.nan, np.float32)
    for v in range(2 * half):
        add_row(left[v], turned[v], columns, cost, 1)
    for v in range(height):
        add_row(left[v + 2 * half], turned[v + 2 * half], columns, cost, 1)
        row_costs(columns, half, cost, sums_left[v], sums_right[v], roots_left[v], roots_right[v], costs)
        choose(costs, cost, uniqueness_percent, found[v])
        add_row(left[v], turned[v], columns, cost, -1)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_row(left, turned, columns, cost, sign):  # type: ignore[no-untyped-def]
    """Add one row's pixel costs (products, for correlations) to the column sums, or take them away."""
    disparities = columns.shape[1]
    for u in range(len(left)):
        # Pixel u - d of the right image is at column u - d + n - 1, and reversed at len - n - u + d.
        a, b, sums = left[u], turned[len(left) - 1 - u : len(left) - 1 - u + disparities], columns[u]
        if cost == SAD:
            for d in range(disparities):
                sums[d] += np.int32(sign * abs(np.int32(a - b[d])))
        elif cost == SSD:
            for d in range(disparities):
                sums[d] += np.int32(sign * np.int32(a - b[d]) * np.int32(a - b[d]))
        elif cost == CENSUS:
            for d in range(disparities):
                sums[d] += np.int32(sign * count_bits(np.uint32(a ^ b[d])))
        else:
            for d in range(disparities):
                sums[d] += np.int32(sign * a * b[d])


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def count_bits(x):  # type: ignore[no-untyped-def]
    """Return how many of 32 bits are set."""
    x = np.uint32(x - ((x >> np.uint32(1)) & np.uint32(0x55555555)))
    x = np.uint32((x & np.uint32(0x33333333)) + ((x >> np.uint32(2)) & np.uint32(0x33333333)))
    x = np.uint32((x + (x >> np.uint32(4))) & np.uint32(0x0F0F0F0F))
    return np.int32(np.uint32(x * np.uint32(0x01010101)) >> np.uint32(24))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def window_energies(image: Codes, half: int, cost: int) -> tuple[Costs, Sums]:
    """Return one over the root of each window's energy, and its sum (0 for NCC); ones for costs that need neither."""
    size = 2 * half + 1
    height, width = image.shape[0] - 2 * half, image.shape[1] - 2 * half
    roots, sums = np.ones((height, width)), np.zeros((height, width), np.int64)
    if cost not in (NCC, ZNCC):
        return roots, sums
    first, second = np.zeros(image.shape[1], np.int64), np.zeros(image.shape[1], np.int64)
    for v in range(image.shape[0]):
        for u in range(image.shape[1]):
            first[u] += image[v, u]
            second[u] += np.int64(image[v, u]) * image[v, u]
            if v >= size:
                first[u] -= image[v - size, u]
                second[u] -= np.int64(image[v - size, u]) * image[v - size, u]
        if v < size - 1:
            continue
        total, energy = np.int64(0), np.int64(0)
        for u in range(image.shape[1]):
            total += first[u]
            energy += second[u]
            if u >= size:
                total -= first[u - size]
                energy -= second[u - size]
            if u >= size - 1:
                spread = size * size * energy - total * total if cost == ZNCC else energy
                roots[v - size + 1, u - size + 1] = 1.0 / np.sqrt(spread) if spread > 0 else 0.0
                sums[v - size + 1, u - size + 1] = total if cost == ZNCC else 0
    return roots, sums


@numba.njit(cache=True, nogil=True, error_model="numpy")
def row_costs(columns, half, cost, sums_left, sums_right, roots_left, roots_right, costs):  # type: ignore[no-untyped-def]
    """Sum the column sums over each window of a row, and turn products into 1 - correlation; inf stays outside."""
    width, disparities = costs.shape
    size = 2 * half + 1
    scale = np.int64(size * size if cost == ZNCC else 1)
    window = np.zeros(disparities, np.int32)
    for u in range(2 * half):
        for d in range(disparities):
            window[d] += columns[u, d]
    for u in range(width):
        entering, leaving, into = columns[u + 2 * half], columns[u], costs[u]
        n = min(u + 1, disparities)
        for d in range(disparities):
            window[d] += entering[d]
        if cost in (NCC, ZNCC):
            total, root = sums_left[u], roots_left[u]
            totals, roots = sums_right[width - 1 - u :], roots_right[width - 1 - u :]
            for d in range(n):
                into[d] = 1.0 - np.float64(scale * window[d] - total * totals[d]) * root * roots[d]
        else:
            for d in range(n):
                into[d] = window[d]
        for d in range(disparities):
            window[d] -= leaving[d]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def choose(costs, cost, uniqueness_percent, found):  # type: ignore[no-untyped-def]
    """Pick the best disparity of each pixel of a row, if it is unique and the right image agrees."""
    width, disparities = costs.shape
    best, best_right = np.zeros(width, np.int32), np.zeros(width, np.int32)
    lowest_right = np.full(width, np.inf)
    for u in range(width):
        lowest = np.inf
        for d in range(min(u + 1, disparities)):
            c = costs[u, d]
            if c < lowest:
                lowest, best[u] = c, d
            if c < lowest_right[u - d]:
                lowest_right[u - d], best_right[u - d] = c, d
    tie = TIE if cost in (NCC, ZNCC) else 0.0
    for u in range(width):
        d = best[u]
        if d <= 0 or d >= min(u, disparities - 1) or abs(best_right[u - d] - d) > 1:
            continue
        other = np.inf
        for e in range(min(u + 1, disparities)):
            if abs(e - d) > 1:
                other = min(other, costs[u, e])
        if other * (100 - uniqueness_percent) > costs[u, d] * 100 + tie:
            before, after = costs[u, d - 1], costs[u, d + 1]
            bend = before - 2 * costs[u, d] + after
            found[u] = d + (before - after) / (2 * bend) if bend > 0 else d
