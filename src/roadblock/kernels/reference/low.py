"""The test of low obstacles as plain numpy: slow, short, and what `compiled.low` must reproduce to rounding.

Images are averaged `bin_px` x `bin_px`. The left one (`near`) and the right one (`far`), moved by the road's disparity
and brought to the left one's brightness, are kept row by row, in the columns `first` .. `last` of each row: what lies
on the road coincides. Of something standing, a row `rise` pixels of disparity nearer than the road's is found at
`far[u - rise]`.
"""

import numpy as np
from numpy.typing import NDArray

Plane = NDArray[np.float32]
Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

CHUNK = 32
"""Columns that share one shift."""
CLIP = 9.0
"""No pixel counts for more than three standard deviations."""
TOLERANCE_PX = 0.2
"""The road's disparity is known to this: steep edges may misfit more."""
ALIKE = (1.0, 2 / 3, 1 / 6, 0.0, 0.0)
"""Correlation of the noise of pixels 0, 1, 2, ... apart, after smoothing by 1-2-1."""
LINEAR = 1 / 3
"""Linear interpolation at t takes this times t (1 - t) from the variance of a difference of smoothed pixels."""
CORRELATED = 1.94
"""Sum of the squares of `ALIKE`, both ways: so many pixels say what one independent one would."""
BELOW = ((0.0, 0.0), (0.0, 0.3), (0.0, 0.6), (0.0, 1.0), (0.5, 0.0), (0.5, 0.5), (1.0, 0.0), (1.0, 0.5), (1.0, 1.0))
"""What a mirror in the road may show: the rise of what stands, turned down and scaled, and pixels further down."""
CALM = 0.73
"""Median of squared differences that a road may have: of Gaussian ones it is 0.455."""


def warp(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    bin_px: int,
    rows: Whole,
    first: Whole,
    last: Whole,
    d_px: Floats,
    slope: Floats,
    middle: float,
    gain: Floats,
    tilt: float,
    step: int,
    near: Plane,
    far: Plane,
) -> None:
    """Fill `near` and `far`: every `step`-th of the binned rows, smoothed by 1-2-1; the right one moved by Catmull-Rom.

    Column u of row i has the disparity `d_px[i] + slope[i] * (u - middle)` binned pixels, the right image is
    multiplied by `gain[i] + tilt * (u - middle)`; both are taken at the middle of each `CHUNK` columns.
    """
    for i in range(0, len(rows), step):
        a, b = (_binned(image, int(rows[i]), bin_px) for image in (left, right))
        for begin in range(first[i], last[i], CHUNK):
            u = np.arange(begin, min(begin + CHUNK, last[i]))
            aside = (begin + u[-1]) / 2 - middle
            shift = -(d_px[i] + slope[i] * aside)
            whole, t = int(np.floor(shift)), shift - np.floor(shift)
            cubic = [-0.5 * t + t * t - 0.5 * t**3, 1 - 2.5 * t * t + 1.5 * t**3]
            cubic += [0.5 * t + 2 * t * t - 1.5 * t**3, -0.5 * t * t + 0.5 * t**3]
            taps = np.convolve(cubic, [0.25, 0.5, 0.25]) * (gain[i] + tilt * aside)
            near[i, u] = 0.25 * (a[u - 1] + a[u + 1]) + 0.5 * a[u]
            far[i, u] = sum(tap * b[u + whole + k - 2] for k, tap in enumerate(taps))


def _binned(image: NDArray[np.uint8], row: int, c: int) -> Floats:
    width = image.shape[1] // c
    return np.asarray(image[row * c : (row + 1) * c, : width * c].reshape(c, width, c).mean((0, 2)))


def road_sums(near: Plane, far: Plane, first: Whole, last: Whole, step: int, sums: Plane) -> None:
    """Fill `sums` (strips, blocks, 8): of each block count, gradient g, difference e, g g, g e, e e, near, far."""
    sums[:] = 0
    strips, blocks, _ = sums.shape
    for i in range(0, len(first), step):
        u0, u1 = first[i] + 1, last[i] - 1
        edges = u0 + (u1 - u0) * np.arange(blocks + 1) // blocks
        for k in range(blocks):
            u = np.arange(edges[k], edges[k + 1])
            e = near[i, u] - far[i, u]
            g = 0.25 * (near[i, u + 1] - near[i, u - 1] + far[i, u + 1] - far[i, u - 1])
            terms = (np.ones_like(e), g, e, g * g, g * e, e * e, near[i, u], far[i, u])
            sums[i * strips // len(first), k] += [term.sum() for term in terms]


def weigh(near: Plane, far: Plane, first: Whole, last: Whole, variance: float, weight: Plane) -> None:
    """Fill `weight`: one over the variance of a difference on the road, greater where the image is steep."""
    for i in range(len(first)):
        u = np.arange(first[i] + 1, last[i] - 1)
        steep = np.maximum(*(((image[i, u + 1] - image[i, u - 1]) / 2) ** 2 for image in (near, far)))
        weight[i, u] = 1 / (variance + TOLERANCE_PX**2 * steep)


def score(
    near: Plane,
    far: Plane,
    weight: Plane,
    first: Whole,
    last: Whole,
    d_px: Floats,
    feet: Whole,
    tall: Whole,
    wide: Whole,
    scores: Plane,
    heights: NDArray[np.int8],
) -> None:
    """Fill `scores` (feet, columns), the log-likelihood ratio of "standing" against "road", and the best `heights`.

    A template of foot k stands on the upper edge of row `feet[k]`, is `wide[k]` columns wide and one of `tall[k]` rows
    tall. With the squares of the difference to the road G fewer than with the road itself, and D the squares of what
    standing would change in the image, it is `G / (2 CORRELATED) * sqrt(1 - N / D)`: N is the part of D that is noise
    alone, so that bare surfaces speak for nothing.
    """
    scores[:] = 0
    for k, foot in enumerate(feet):
        u0, u1, w = first[foot] + 1, last[foot] - 1, wide[k]
        if u1 - u0 < w + 8:
            continue
        gained, changed = np.zeros((2, near.shape[1]), np.float32)
        noise, done = 0.0, 0
        for t in range(tall.shape[1]):
            for i in foot - np.arange(done + 1, tall[k, t] + 1):
                rise = (d_px[foot] + d_px[foot - 1]) / 2 - d_px[i]
                u = np.arange(u0 + max(int(np.floor(rise)), 0) + 1, u1)
                e0, e1, level = _differences(near, far, int(i), u, float(rise))
                gained[u] += _clipped(e0, weight[i, u]) - _clipped(e1, weight[i, u] * level)
                changed[u] += _clipped(e1 - e0, weight[i, u] * level)
                noise += w * (1 - np.interp(abs(rise), range(len(ALIKE)), ALIKE))
            done = tall[k, t]
            for begin in range(u0, u1 - w):
                total, change = gained[begin : begin + w].sum(), changed[begin : begin + w].sum()
                if total > 0 and change > noise:
                    value = total / (2 * CORRELATED) * np.sqrt((change - noise) / change)
                    if value > scores[k, begin + w // 2]:
                        scores[k, begin + w // 2], heights[k, begin + w // 2] = value, t


def _differences(near: Plane, far: Plane, i: int, u: Whole, rise: float) -> tuple[Plane, Plane, float]:
    """Return the differences to the road and to what stands, and what interpolation took from the latter's variance."""
    whole, part = int(np.floor(rise)), rise - np.floor(rise)
    standing = (1 - part) * far[i, u - whole] + part * far[i, u - whole - 1]
    return near[i, u] - far[i, u], near[i, u] - standing, float(1 / (1 - LINEAR * part * (1 - part)))


def _clipped(e: Plane, weight: Plane) -> Plane:
    return np.asarray(np.minimum(e * e * weight, CLIP))


def pick(
    scores: Plane, heights: NDArray[np.int8], feet: Whole, tall: Whole, wide: Whole, evidence: float, hits: Floats
) -> int:
    """Take the best scores over `evidence` one by one, and clear `scores` around each.

    Fills `hits` (most, 4) with foot, column, height's index and score, and returns how many there are.
    """
    for count in range(len(hits)):
        k, u = np.unravel_index(np.argmax(scores), scores.shape)
        if scores[k, u] <= evidence:
            return count
        hits[count] = k, u, heights[k, u], scores[k, u]
        around = np.abs(feet - feet[k]) <= tall[k, -1]
        scores[around, max(0, u - wide[k]) : u + wide[k] + 1] = 0
    return len(hits)


def confirm(
    near: Plane,
    far: Plane,
    weight: Plane,
    d_px: Floats,
    first: Whole,
    last: Whole,
    foot: int,
    tall: int,
    column: int,
    wide: int,
) -> tuple[float, float]:
    """Return the share of a hit's evidence that is left, and the gain a pixel, once the surroundings are looked at.

    Light that does not lie in the road (a mirrored sky) moves the whole neighbourhood's brightness: its median is taken
    off; where the neighbourhood fits badly as it is, evidence counts for less. And standing must be better not only
    than the road, but than anything mirrored in it (`BELOW`).
    """
    u0, top = column - wide // 2, foot - tall
    u = np.arange(max(u0 - 2 * wide, first[top] + 1), min(u0 + 3 * wide, last[top] - 1))
    rows = slice(top, foot)
    around = near[rows, u[0] : u[-1] + 1] - far[rows, u[0] : u[-1] + 1]
    bias = np.median(around)
    unrest = max(1.0, float(np.median((around - bias) ** 2 * weight[rows, u[0] : u[-1] + 1])) / CALM)
    misfits = np.zeros(len(BELOW))
    plain, honest = 0.0, 0.0
    u = np.arange(u0, u0 + wide)
    for i in range(top, foot):
        rise = float((d_px[foot] + d_px[foot - 1]) / 2 - d_px[i])
        e0, e1, level = _differences(near, far, i, u, rise)
        w = weight[i, u]
        plain += float((_clipped(e0, w) - _clipped(e1, w * level)).sum())
        honest -= float(_clipped(e1 - bias, w * level).sum())
        for k, (part, down) in enumerate(BELOW):
            _, e, level = _differences(near, far, i, u, -part * rise - down)
            misfits[k] += _clipped(e - bias, w * level).sum()
    honest += float(misfits.min())
    return honest / max(plain, 1e-6) / unrest, honest / (tall * wide) / unrest
