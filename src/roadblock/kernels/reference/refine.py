"""Refinement of regions as plain numpy: slow, short, and what `compiled.refine` reproduces to 1e-3 px.

A region is a set of cells with a coarse disparity each. It is cut into square blocks; each block has one disparity, and
neighbouring blocks are tied to each other and to the region's mean by what surfaces do (see `Model`). All are found
together by Gauss-Newton: the left image is the template and the only source of gradients, the right one is sampled
between its pixels by an 8-tap windowed sinc.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

TAPS, PHASES = 8, 256
"""Taps of the interpolation, and steps of a pixel it is tabulated in."""

BLOCK_PX = 8
"""Blocks are so wide and twice as high, and both are doubled, tripled ... until a region has no more than its `Model`
allows."""

SWEEPS, SEARCH_PX, FURTHEST_STEP_PX = 4, 2, 0.7
"""Of Gauss-Seidel within each round of Gauss-Newton, the integer search's reach, and a block's longest step."""

SETTLED_PX = 2e-3
"""Iterations end when the mean moves by less."""

RIM_PX, THIN, CORE_PX, CORE_OF = 2, 0.3, 8, 4
"""What is no farther inside of the outline shows what is behind, too (of a thing that has less than this share farther
inside, one pixel); and a detector's cut takes along no more than so much background at either side, nor than one in so
many pixels of its width."""

WORST_PX = 900.0
"""A squared difference counts no more than this in the integer search."""

MISFIT = 8.0
"""What of a block's residuals is not noise is alike in so many neighbouring pixels: so much less do they say."""

SURVEYS, LEAST_NOISE = 9, 0.4
"""The images are surveyed at so many places along their shorter side; rounding alone makes 0.29 levels of noise."""

ROBUST, LEAST_WEIGHT = 3.0, 8.0
"""A pixel whose residual is this many standard deviations counts a quarter; and so many pixels must count in all."""

GRADIENT_NOISE = 0.903
"""What noise of variance 1 adds to the square of a gradient: the sum of its squared weights."""

LEAST_ENERGY = 1e-3
"""Of a block's gradients this share is never noise, so that every block has a say, however small."""

NEAREST_SHARE, TENTH = 0.1, 1.2816
"""So large a share of the pixels is the nearest face; a Gaussian's lies so many standard deviations off its mean."""

FRONT_SHARE = 0.3
"""How sure the nearest face is shows in the nearest blocks, which have this share of the pixels."""

PRIOR_BLOCKS = 2.0
"""The usual relief counts as much as so many well-measured blocks."""

Gray = NDArray[np.uint8]
Floats = NDArray[np.float64]

FIGURES = (
    "mean_px",
    "nearest_px",
    "scatter_px",
    "noise_px",
    "unseen_px",
    "step_px",
    "moved_px",
    "residual",
    "used",
    "pixels",
    "inner",
    "core",
    "coarse_px",
    "front_px",
    "front_unseen_px",
)
"""What a region comes to, in the order of the kernel's columns:

mean_px, nearest_px
    Disparity of the mean visible surface, and of the nearest face (10th percentile of the distance), pixels.
scatter_px
    Standard deviation of the mean as the blocks' scatter about it says.
noise_px
    The same from the pixels' residuals alone.
unseen_px
    How far parts of the surface lie from its mean beyond what the fit could resolve (standard deviation).
step_px
    How far the last iteration moved the mean; NaN where nothing could be fitted.
moved_px
    From the coarse mean to the refined one.
residual
    Root mean square difference of the two images, grey levels.
used
    Share of the pixels that count, by their robust weights.
pixels
    How many there are.
inner
    Share of them that do not lie along the outline.
core
    Share of the slopes' energy that is surely no noise and lies CORE_PX inside of the outline: the thing's own.
coarse_px
    Disparity of the nearest face as the detector saw it, pixels.
front_px
    Standard deviation of the mean of the nearest part (FRONT_SHARE), as the blocks' scatter and the residuals say.
front_unseen_px
    How far its parts lie from that beyond what the fit could resolve (standard deviation).
"""


class Model(NamedTuple):
    """What surfaces and images are like.

    Attributes
    ----------
    f_px, f_baseline
        Focal length, and focal length times baseline (px m).
    noise
        Standard deviation of one grey level.
    gain
        Left over right contrast, of the cameras.
    slope
        How much deeper a surface gets per metre across, usually.
    relief_m, relief_share, relief_most_m
        How far parts of a thing lie from its mean (standard deviation): usually `relief_m` and this share of its width,
        for what is wide is often deep; and at most.
    rim_m, rim_px
        How far its outline lies behind its mean surface, and how far what is behind it pulls the outline.
    most_blocks, many_pixels
        A region is cut into no more blocks; of one of n times so many pixels every sqrt(n)th row is looked at.
    rounds
        Of Gauss-Newton, at most.
    """

    f_px: float
    f_baseline: float
    noise: float
    gain: float
    slope: float = 3.0
    relief_m: float = 0.03
    relief_share: float = 0.15
    relief_most_m: float = 1.0
    rim_m: float = 0.0
    rim_px: float = 0.01
    most_blocks: int = 256
    many_pixels: int = 1024
    rounds: int = 5


def interpolation() -> NDArray[np.float32]:
    """Return (PHASES + 1, TAPS) weights of pixels -3..4 for a place `phase / PHASES` after pixel 0.

    A sinc under a Kaiser window (beta 6), each row summing to 1.
    """
    phase = np.arange(PHASES + 1)[:, None] / PHASES
    x = np.arange(TAPS) - (TAPS // 2 - 1) - phase
    window = np.i0(6 * np.sqrt(np.clip(1 - (2 * x / TAPS) ** 2, 0, 1))) / np.i0(6.0)
    weights = np.sinc(x) * window * (np.abs(x) <= TAPS / 2)
    return np.asarray(weights / weights.sum(1, keepdims=True), np.float32)


@dataclass
class Blocks:
    """The blocks of a region, (rows, columns) each: disparity, what the data say of it and how surely, pixel count.

    `worse` is by how much less the data say where not noise but something else is left.

    Each is `side` pixels wide and twice as high; the region itself is `width_px` wide.
    """

    d: Floats
    target: Floats
    inform: Floats
    count: Floats
    worse: Floats
    side: int
    width_px: int


def refine_regions(left: Gray, right: Gray, first: NDArray[np.int64], uvd: Floats, model: Model) -> Floats:
    """Refine regions against the full-resolution pair.

    Parameters
    ----------
    left, right
        (height, width) grey levels.
    first
        (n + 1,) where each region's samples begin in `uvd`.
    uvd
        (m, 3) column, row and disparity of the centre of each cell.
    model
        See `Model`.

    Returns
    -------
    (n, len(FIGURES)) figures; NaN where nothing could be fitted.
    """
    figures = np.full((len(first) - 1, len(FIGURES)), np.nan)
    for i, (a, b) in enumerate(pairwise(first)):
        coarse, of_cell = paint(uvd[a:b], left.shape)
        if (coarse > 0).any():
            rows, columns = np.nonzero(coarse)
            v0, u0 = int(rows.min()), int(columns.min())
            box = np.s_[v0 : rows.max() + 1, u0 : columns.max() + 1]
            figures[i] = refine_region(left, right, u0, v0, coarse[box], of_cell[box], cell_area(uvd[a:b]), model)
    return figures


def cell_size(uvd: Floats) -> tuple[int, int]:
    """Return width and height of the cells that a surface consists of: the smallest step between two of them."""
    steps = np.abs(np.diff(uvd[:, :2], axis=0))
    width, height = (int(np.min(s[s > 0], initial=np.inf)) if (s > 0).any() else 0 for s in steps.T)
    return width or height or 1, height or width or 1


def cell_area(uvd: Floats) -> int:
    """Return how many pixels all cells have."""
    return len(uvd) * int(np.prod(cell_size(uvd)))


def paint(uvd: Floats, shape: tuple[int, ...]) -> tuple[Floats, NDArray[np.int64]]:
    """Return images of the coarse disparities, 0 where there is no cell, and of each cell's first (row, column)."""
    coarse, of_cell, size = np.zeros(shape), np.zeros((*shape, 2), np.int64), cell_size(uvd)
    for u, v, d in uvd:
        column, row = (round(x - (c - 1) / 2) for x, c in zip((u, v), size, strict=True))
        there = np.s_[max(row, 0) : max(row + size[1], 0), max(column, 0) : max(column + size[0], 0)]
        coarse[there], of_cell[there] = max(d, 1e-3), (max(row, 0), max(column, 0))
    return coarse, of_cell


def refine_region(
    left: Gray, right: Gray, u0: int, v0: int, coarse: Floats, of_cell: NDArray[np.int64], area: int, model: Model
) -> Floats:
    """Return the figures of one region, its coarse disparities and their cells given in a box at (u0, v0)."""
    nothing, side = np.full(len(FIGURES), np.nan), BLOCK_PX
    while -(-coarse.shape[0] // (2 * side)) * -(-coarse.shape[1] // side) > model.most_blocks:
        side += BLOCK_PX
    step = min(max(int(np.ceil(np.sqrt(area / model.many_pixels))), 1), side)
    v, u = (at.ravel() for at in np.mgrid[0 : coarse.shape[0] : step, : coarse.shape[1]])
    there = coarse[v, u] > 0
    pixels = int(there.sum())
    if pixels == 0:
        return nothing
    mean = float(coarse[v, u][there].mean())
    blocks = start_blocks(coarse, of_cell - np.array([v0, u0]), v[there], u[there], side, mean)
    coarse_px = nearest(blocks.d, blocks.count, NEAREST_SHARE)
    deepest = float(np.sqrt(np.average((blocks.d - mean) ** 2, weights=blocks.count)))
    template, slope, weight, inner, core = template_of(left, u0, v0, coarse, u, v, step, mean, model)
    keep = there & (u + u0 >= 2) & (u + u0 < left.shape[1] - 2) & (blocks.count[v // (2 * side), u // side] > 0)
    u, v, template, slope, weight = u[keep], v[keep], template[keep], slope[keep], weight[keep]
    of = (v // (2 * side), u // side)
    other = v % (2 * step) == 0
    moved = search(template[other], right, (u + u0)[other], (v + v0)[other], blocks.d[of][other])
    blocks.d += moved
    coarse_mean, mean = mean, mean + moved
    gain, offset, residual2, noise2 = model.gain, 0.0, -1.0, 2 * model.noise**2
    for iteration in range(model.rounds):
        seen, r = sampled(right, u + u0, v + v0, blocks.d[of])
        e = template - gain * r - offset
        w = weight * seen
        if residual2 > 0:
            w = w / (1 + e * e / (ROBUST**2 * residual2)) ** 2
        if w.sum() < LEAST_WEIGHT:
            return nothing
        residual2 = max(float((w * e * e).sum() / w.sum()), noise2 / 4)
        used = float(w.sum())
        if iteration > 0:  # gain and offset, held near the cameras' own
            hold = np.array([1 / 6.0, 1e2]) * np.sqrt(residual2)
            A = np.concatenate([np.stack([np.ones_like(r), r], -1) * np.sqrt(w)[:, None], np.diag(hold)])
            y = np.concatenate([np.sqrt(w) * e, hold * (-offset, model.gain - gain)])
            change = np.linalg.lstsq(A, y, rcond=None)[0]
            offset, gain = offset + change[0], gain + change[1]
        if not inform_blocks(blocks, of, w, slope, e, residual2, mean, model):
            return nothing
        before, relief = mean, seen_relief(blocks, mean, deepest, model)
        mean = smooth(blocks, mean, relief, model)
        if iteration > 1 and abs(mean - before) < SETTLED_PX:
            break
    figures, front = summarize(blocks, mean, relief)
    measured = [
        abs(mean - before),
        figures[0] - coarse_mean,
        np.sqrt(residual2),
        used / pixels,
        pixels * step,
        inner,
        core,
        coarse_px,
        *front,
    ]
    return np.array([*figures, *measured])


def start_blocks(
    coarse: Floats, of_cell: NDArray[np.int64], v: NDArray[np.int64], u: NDArray[np.int64], side: int, mean: float
) -> Blocks:
    """Return the blocks at their mean coarse disparity; a cell belongs to the block of its first pixel."""
    rows, columns = -(-coarse.shape[0] // (2 * side)), -(-coarse.shape[1] // side)
    of = of_cell[v, u, 0].clip(0) // (2 * side), of_cell[v, u, 1].clip(0) // side
    count, d = np.zeros((rows, columns)), np.zeros((rows, columns))
    np.add.at(count, of, 1)
    np.add.at(d, of, coarse[v, u])
    d = np.where(count > 0, d / np.maximum(count, 1), mean)
    return Blocks(d, d.copy(), np.zeros_like(d), count, np.ones_like(d), side, coarse.shape[1])


def template_of(
    left: Gray,
    u0: int,
    v0: int,
    coarse: Floats,
    u: NDArray[np.int64],
    v: NDArray[np.int64],
    step: int,
    mean: float,
    model: Model,
) -> tuple[Floats, Floats, Floats, float, float]:
    """Return the left image's levels, slopes along the row, weights, and the shares inside: of pixels, and of energy.

    Weights are 0 outside and where the camera saw only black or white, and less along the outline: its pixels share
    what is wrong with them (it lies behind the mean surface, and what is behind it pulls), so all together count as one
    measurement with that error.
    """
    x, image = u + u0, left.astype(float)
    known = (coarse[v, u] > 0) & (x >= 2) & (x < left.shape[1] - 2)
    c, usable = min(CORE_PX, max(coarse.shape[1] // CORE_OF, RIM_PX)), coarse > 0
    usable[:, : max(2 - u0, 0)], usable[:, max(left.shape[1] - 2 - u0, 0) :] = False, False
    a = -(-c // step) * step
    beside = np.pad(usable, ((a, a), (c, c)))
    within = known & beside[v + a, u + c - 1] & beside[v + a, u + c + 1]
    deeper = within & beside[v + a, u + c - RIM_PX] & beside[v + a, u + c + RIM_PX]
    deep = known & beside[v + a, u] & beside[v + a, u + 2 * c] & beside[v, u + c] & beside[v + 2 * a, u + c]
    at = [image[v + v0, (x + shift).clip(0, left.shape[1] - 1)] for shift in (-2, -1, 1, 2)]
    slope = np.where(known, (8 * (at[2] - at[1]) - at[3] + at[0]) / 12, 0.0)
    level = image[v + v0, x]
    exposed = ((level > 0) & (level < 255)).astype(float)
    rim_px2 = (model.rim_m * mean * mean / model.f_baseline) ** 2 + model.rim_px**2
    noise2, rim = 2 * model.noise**2, known & ~(within if deeper.sum() < THIN * known.sum() else deeper)
    gg, n = exposed * slope**2, float((exposed * deep).sum())
    share = noise2 / (noise2 + gg[rim].sum() * rim_px2)
    core = max(gg[deep].sum() - GRADIENT_NOISE * model.noise**2 * (1.3 * n + 3 * np.sqrt(n)), 0) / max(
        gg[known].sum(), 1e-9
    )
    inner = within.sum() / max(known.sum(), 1)
    return level, slope, exposed * np.where(rim, share, known.astype(float)), float(inner), float(core)


def search(template: Floats, right: Gray, x: NDArray[np.int64], y: NDArray[np.int64], d: Floats) -> int:
    """Return by how many whole pixels these pixels fit best, -SEARCH_PX..SEARCH_PX."""
    costs = {}
    for shift in range(-SEARCH_PX, SEARCH_PX + 1):
        there = x - np.floor(d + 0.5).astype(int) - shift
        seen = (there >= TAPS // 2) & (there + TAPS // 2 <= right.shape[1])
        if seen.any():
            e = template[seen] - right[y[seen], there[seen]]
            costs[shift] = float(np.minimum(e * e, WORST_PX).mean())
    return min(costs, key=lambda shift: costs[shift]) if costs else 0


def sampled(right: Gray, x: NDArray[np.int64], y: NDArray[np.int64], d: Floats) -> tuple[NDArray[np.bool_], Floats]:
    """Return which pixels of the right image at x - d are inside, and their grey levels (0 outside)."""
    whole = np.floor(d).astype(int)
    taps = interpolation()[np.floor((1 - (d - whole)) * PHASES + 0.5).astype(int)]
    base = x - whole - TAPS // 2
    seen = (base >= 0) & (base + TAPS <= right.shape[1])
    columns = np.where(seen, base, 0)[:, None] + np.arange(TAPS)
    return seen, np.where(seen, (taps * right[y[:, None], columns.clip(0, right.shape[1] - 1)]).sum(1), 0.0)


def inform_blocks(
    blocks: Blocks,
    of: tuple[NDArray[np.int64], NDArray[np.int64]],
    w: Floats,
    slope: Floats,
    e: Floats,
    residual2: float,
    mean: float,
    model: Model,
) -> bool:
    """Fill in what the data say of each block and how surely; return whether they say anything.

    What noise alone may make of the gradients' energy (three standard deviations) is taken off, and a block whose
    pixels fit badly counts less.
    """
    sums = []
    for values in (w * slope**2, w * slope * e, w * e * e, w):
        each = np.zeros_like(blocks.d)
        np.add.at(each, of, values)
        sums.append(each)
    gg, ge, ee, total = sums
    with np.errstate(all="ignore"):
        local2 = np.maximum(np.where(total > 4, ee / total, residual2), residual2 / 2)
        level2 = np.clip(local2 / 2, model.noise**2, 4 * model.noise**2)
        by_noise = GRADIENT_NOISE * level2 * (total + 3 * np.sqrt(total))
        blocks.worse = 1 + MISFIT * np.maximum(1 - 2 * model.noise**2 / local2, 0)
    energy = np.maximum(gg - by_noise, LEAST_ENERGY * gg)
    known = (blocks.count > 0) & (total > 0) & (energy > 0)
    with np.errstate(all="ignore"):
        step = np.clip(-ge / energy, -FURTHEST_STEP_PX, FURTHEST_STEP_PX)
    blocks.target = np.where(known, blocks.d + step, mean)
    blocks.inform = np.where(known, energy / (2 * local2), 0.0)
    return bool(known.any())


def seen_relief(blocks: Blocks, mean: float, deepest: float, model: Model) -> float:
    """Return how far the blocks lie from their mean, pixels: their scatter less what noise makes of it.

    It is no more than things have, unless the detector saw a deeper one (`deepest`, pixels).
    """
    known = blocks.inform > 0
    weight, target = blocks.inform[known], blocks.target[known]
    total, n, per_m = weight.sum(), len(weight), mean * mean / model.f_baseline
    width_m = blocks.width_px * model.f_baseline / model.f_px / mean
    usual = ((model.relief_m + model.relief_share * width_m) * per_m) ** 2
    seen = (weight * (target - (weight * target).sum() / total) ** 2).sum() / total - (n - 1) / total
    trust = n * usual / (usual + n / total)
    relief2 = (max(seen, 0.0) * trust + usual * PRIOR_BLOCKS) / (trust + PRIOR_BLOCKS)
    return float(max(min(np.sqrt(relief2), max(model.relief_most_m * per_m, deepest)), 2e-3))


def smooth(blocks: Blocks, mean: float, relief: float, model: Model) -> float:
    """Move the blocks to what data, neighbours and mean together say (Gauss-Seidel); return the mean."""
    tie = 1 / max(model.slope * blocks.side * mean / model.f_px, 2e-3) ** 2
    known = blocks.inform > 0
    weight = 1 / (1 / blocks.inform[known] + relief**2)
    mean = float((weight * blocks.target[known]).sum() / weight.sum())
    there = np.pad(blocks.count > 0, 1)
    for _ in range(SWEEPS):
        d = np.pad(blocks.d, 1)
        for i, j in zip(*np.nonzero(blocks.count), strict=True):
            beside = [(i + 1, j, tie), (i + 1, j + 2, tie), (i, j + 1, tie / 4), (i + 2, j + 1, tie / 4)]  # padded
            near = [(d[y, x], by) for y, x, by in beside if there[y, x]]
            total = blocks.inform[i, j] * blocks.target[i, j] + mean / relief**2 + sum(value * by for value, by in near)
            d[i + 1, j + 1] = total / (blocks.inform[i, j] + 1 / relief**2 + sum(by for _, by in near))
        blocks.d = d[1:-1, 1:-1]
    return mean


def nearest(d: Floats, count: Floats, share: float) -> float:
    """Return the disparity that this share of the pixels reach or exceed."""
    there = count > 0
    order = np.argsort(-d[there], kind="stable")
    return float(d[there][order][np.argmax(np.cumsum(count[there][order]) >= share * count.sum())])


def summarize(blocks: Blocks, mean: float, relief: float) -> tuple[list[float], list[float]]:
    """Return mean_px, nearest_px, scatter_px, noise_px and unseen_px; and front_px and front_unseen_px."""
    there, known = blocks.count > 0, blocks.inform > 0
    count, d = blocks.count[there], blocks.d[there]
    middle = float(count.sum() / (count / np.maximum(d, 0.05)).sum())
    unseen = relief * float(np.sqrt((count / (1 + blocks.inform[there] * relief**2)).sum() / count.sum()))
    front, front_unseen = summarize_front(blocks, relief)
    face = max(nearest(blocks.d, blocks.count, NEAREST_SHARE) - middle, 0.0)
    near = middle + float(np.hypot(face, TENTH * front_unseen))
    weight = 1 / (1 / blocks.inform[known] + relief**2)
    scatter = float(np.sqrt(((weight * (blocks.target[known] - mean)) ** 2).sum()) / weight.sum())
    noise = float(np.sqrt((weight**2 / blocks.inform[known] * blocks.worse[known]).sum()) / weight.sum())
    return [middle, near, scatter, noise, unseen], [front, front_unseen]


def summarize_front(blocks: Blocks, relief: float) -> tuple[float, float]:
    """Return front_px and front_unseen_px."""
    front = (blocks.count > 0) & (blocks.d >= nearest(blocks.d, blocks.count, FRONT_SHARE))
    known = front & (blocks.inform > 0)
    unseen = relief * float(
        np.sqrt(np.average(1 / (1 + blocks.inform[front] * relief**2), weights=blocks.count[front]))
    )
    if not known.any():
        return relief, unseen
    weight = 1 / (1 / blocks.inform[known] + relief**2)
    scatter2 = ((weight * (blocks.target - blocks.d)[known]) ** 2).sum()
    noise2 = (weight**2 / blocks.inform[known] * blocks.worse[known]).sum()
    return float(np.sqrt(max(scatter2, noise2)) / weight.sum()), unseen


def survey(left: Gray, right: Gray) -> tuple[float, float]:
    """Return the standard deviation of one grey level's noise, and the left image's contrast over the right one's.

    From 8x8 pixels at places all over the images. For the noise a 3x3 difference that neither slopes nor edges along
    the axes leave anything of (Immerkaer 1996); the quietest tenth of the places that are neither dark nor bright is
    taken as free of texture. At least LEAST_NOISE; 1 where there are none.
    """
    height, width = left.shape
    apart = max(min(height, width) // SURVEYS, 10)
    levels, both = [], []
    for v in range(1, 1 + max(height - 2, 0) // apart * apart, apart):
        for u in range(1, 1 + max(width - 2, 0) // apart * apart, apart):
            a = left[v - 1 : v + 9, u - 1 : u + 9].astype(float)
            rough = a[:-2] - 2 * a[1:-1] + a[2:]
            rough = rough[:, :-2] - 2 * rough[:, 1:-1] + rough[:, 2:]
            both.append((a[1:-1, 1:-1], right[v : v + 8, u : u + 8].astype(float)))
            if 16 < a[1:-1, 1:-1].mean() < 240:
                levels.append(float(np.sqrt((rough**2).mean())) / 6)
    here, there = (float(np.std([pair[i] for pair in both])) if both else 0.0 for i in (0, 1))
    noise = max(sorted(levels)[len(levels) // 10], LEAST_NOISE) if levels else 1.0
    return noise, float(np.clip(here / there, 0.7, 1.4)) if min(here, there) > 1 else 1.0
