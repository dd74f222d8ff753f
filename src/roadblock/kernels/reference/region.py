"""Region matching as plain numpy: slow, short, and what `compiled.region` must reproduce to the bit.

Region matching (the paper's section 2.2) slides a window of the left image along the same row of the right one. Both
images come padded, so that no loop needs a border case: with `half` = (window - 1) / 2 and `n` disparities,

* left is (height + 2 half, width + 2 half): pixel (v, u) of the image is at [v + half, u + half];
* right is (height + 2 half, width + 2 half + n - 1): its pixel u is at column u + half + n - 1.
"""

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

COSTS = ("sad", "ssd", "ncc", "zncc", "census")
"""The kernels take a cost by its place in this tuple."""
SAD, SSD, NCC, ZNCC, CENSUS = range(len(COSTS))

CENSUS_HALF = 2
"""Census compares a pixel with its 5 x 5 neighbourhood: 24 bits."""

TIE = 1e-6
"""Correlations closer than this are equal: rounding must not decide between them."""

Codes = NDArray[np.int32]
Costs = NDArray[np.float64]


def census(image: Codes) -> Codes:
    """Return for each pixel which of its 24 neighbours are darker, as bits in reading order.

    Parameters
    ----------
    image
        (rows + 4, columns + 4) grey levels.

    Returns
    -------
    (rows, columns) codes.
    """
    rows, columns = image.shape[0] - 2 * CENSUS_HALF, image.shape[1] - 2 * CENSUS_HALF
    middle = image[CENSUS_HALF : CENSUS_HALF + rows, CENSUS_HALF : CENSUS_HALF + columns]
    codes = np.zeros((rows, columns), np.int32)
    for i in range(2 * CENSUS_HALF + 1):
        for j in range(2 * CENSUS_HALF + 1):
            if (i, j) != (CENSUS_HALF, CENSUS_HALF):
                codes = codes << 1 | (image[i : i + rows, j : j + columns] < middle)
    return codes.astype(np.int32)


def match_windows(
    left: Codes, right: Codes, half: int, disparities: int, cost: int, uniqueness_percent: int
) -> NDArray[np.float32]:
    """Return the disparity of every pixel of the left image by region matching (the paper's section 2.2).

    Parameters
    ----------
    left, right
        Padded images of grey levels 0..255, or of census codes (see the module).
    half
        (window - 1) / 2, pixels, at most 10.
    disparities
        Searched are 0 .. disparities - 1, as far as the window's centre stays inside the right image.
    cost
        Place in `COSTS`. Correlations r count as the cost 1 - r.
    uniqueness_percent
        The best must be this much below any other that is not its neighbour.

    Returns
    -------
    (height, width) disparities in pixels, refined by a parabola through the best cost and its neighbours. NaN where
    the best is at the end of the search, not unique, or not confirmed within one pixel by the right image's own
    best match.
    """
    volume = window_costs(left, right, half, disparities, cost)
    height, width, _ = volume.shape
    by_right = np.full((height, width, disparities), np.inf)
    for d in range(min(disparities, width)):
        by_right[:, : width - d, d] = volume[:, d:, d]
    best, best_right = volume.argmin(-1), by_right.argmin(-1)
    found = np.full((height, width), np.nan, np.float32)
    tie = TIE if cost in (NCC, ZNCC) else 0.0
    for v, u in np.ndindex(height, width):
        d, costs = best[v, u], volume[v, u]
        if not 0 < d < min(u, disparities - 1) or abs(best_right[v, u - d] - d) > 1:
            continue
        others = np.delete(costs, [d - 1, d, d + 1])
        if others.min(initial=np.inf) * (100 - uniqueness_percent) > costs[d] * 100 + tie:
            bend = costs[d - 1] - 2 * costs[d] + costs[d + 1]
            found[v, u] = d + (costs[d - 1] - costs[d + 1]) / (2 * bend) if bend > 0 else d
    return found


def window_costs(left: Codes, right: Codes, half: int, disparities: int, cost: int) -> Costs:
    """Return the (height, width, disparities) cost of every window pair; inf where the right one is outside."""
    n, size = disparities, 2 * half + 1
    height, width = left.shape[0] - 2 * half, left.shape[1] - 2 * half
    volume = np.full((height, width, n), np.inf)
    a = left.astype(np.int64)
    for d in range(min(n, width)):
        b = right[:, n - 1 - d : n - 1 - d + left.shape[1]].astype(np.int64)
        if cost in (NCC, ZNCC):
            volume[:, d:, d] = _decorrelation(a, b, size, cost == ZNCC)[:, d:]
        else:
            pixel = {SAD: np.abs(a - b), SSD: (a - b) ** 2, CENSUS: _count_bits(a ^ b)}[cost]
            volume[:, d:, d] = _window_sum(pixel, size)[:, d:]
    return volume


def _count_bits(codes: NDArray[np.int64]) -> NDArray[np.int64]:
    return np.asarray(sum((codes >> bit) & 1 for bit in range(24)))


def _decorrelation(a: NDArray[np.int64], b: NDArray[np.int64], size: int, without_mean: bool) -> Costs:
    """Return 1 - r; 1 where a window has no contrast."""
    ab, aa, bb = (_window_sum(x * y, size) for x, y in ((a, b), (a, a), (b, b)))
    if without_mean:
        sum_a, sum_b = _window_sum(a, size), _window_sum(b, size)
        ab, aa, bb = (size**2 * x - y for x, y in ((ab, sum_a * sum_b), (aa, sum_a**2), (bb, sum_b**2)))
    return np.asarray(1.0 - ab * _inverse_root(aa) * _inverse_root(bb))


def _inverse_root(energy: NDArray[np.int64]) -> Costs:
    return np.where(energy > 0, 1.0 / np.sqrt(np.maximum(energy, 1)), 0.0)


def _window_sum(pixel: NDArray[np.int64], size: int) -> NDArray[np.int64]:
    return np.asarray(sliding_window_view(pixel, (size, size)).sum((2, 3), dtype=np.int64))
