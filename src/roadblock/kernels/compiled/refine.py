"""Refinement of regions, compiled: see `reference.refine`."""

import numba
import numpy as np

from roadblock.kernels.reference.refine import (
    FIGURES,
    FURTHEST_STEP_PX,
    GRADIENT_NOISE,
    ITERATIONS,
    LEAST_BLOCK_PX,
    LEAST_ENERGY,
    LEAST_WEIGHT,
    MOST_BLOCKS,
    MOST_PIXELS,
    PHASES,
    PRIOR_BLOCKS,
    ROBUST,
    SEARCH_PX,
    SETTLED_PX,
    SWEEPS,
    TAPS,
    TENTH,
    interpolation,
)

FIR = interpolation()
FAST = {"reassoc", "contract", "nsz", "arcp"}
N_FIGURES = len(FIGURES)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine_regions(left, right, first, uvd, cell_px, model):  # type: ignore[no-untyped-def]
    """Refine regions against the full-resolution pair.

    Parameters
    ----------
    left, right
        (height, width) uint8.
    first
        (n + 1,) where each region's samples begin in `uvd`.
    uvd
        (m, 3) float64 column, row and disparity of the centre of each cell.
    cell_px
        (n, 2) width and height of each region's cells.
    model
        A `Model`.

    Returns
    -------
    (n, len(FIGURES)) figures; NaN where nothing could be fitted.
    """
    n = len(first) - 1
    figures = np.full((n, N_FIGURES), np.nan)
    boxes = np.zeros((n, 4), np.int64)
    most = 1
    for i in range(n):
        bounds(uvd[first[i] : first[i + 1]], cell_px[i], left.shape, boxes[i])
        most = max(most, (boxes[i, 2] - boxes[i, 0]) * (boxes[i, 3] - boxes[i, 1]))
    planes = np.empty((4, most), np.float32)
    blocks = np.empty((8, MOST_BLOCKS))
    row = np.empty(left.shape[1], np.float32)
    for i in range(n):
        u0, v0, u1, v1 = boxes[i]
        if u1 - u0 < 1 or v1 - v0 < 1:
            continue
        coarse = planes[0, : (u1 - u0) * (v1 - v0)].reshape(v1 - v0, u1 - u0)
        paint(uvd[first[i] : first[i + 1]], cell_px[i], boxes[i], coarse)
        refine_region(left, right, boxes[i], coarse, planes[1:], blocks, row, FIR, model, figures[i])
    return figures


@numba.njit(cache=True, nogil=True, error_model="numpy")
def bounds(uvd, cell_px, shape, box):  # type: ignore[no-untyped-def]
    """Fill in the box (u0, v0, u1, v1), half open, of a region's cells inside the image."""
    box[0], box[1], box[2], box[3] = shape[1], shape[0], 0, 0
    for k in range(len(uvd)):
        u, v = int(np.rint(uvd[k, 0] - (cell_px[0] - 1) / 2)), int(np.rint(uvd[k, 1] - (cell_px[1] - 1) / 2))
        box[0], box[1] = min(box[0], max(u, 0)), min(box[1], max(v, 0))
        box[2], box[3] = max(box[2], min(u + cell_px[0], shape[1])), max(box[3], min(v + cell_px[1], shape[0]))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def paint(uvd, cell_px, box, coarse):  # type: ignore[no-untyped-def]
    """Paint each cell's disparity into the region's box; 0 where there is no cell."""
    coarse[:] = 0
    for k in range(len(uvd)):
        u = int(np.rint(uvd[k, 0] - (cell_px[0] - 1) / 2)) - box[0]
        v = int(np.rint(uvd[k, 1] - (cell_px[1] - 1) / 2)) - box[1]
        coarse[max(v, 0) : v + cell_px[1], max(u, 0) : u + cell_px[0]] = max(uvd[k, 2], 1e-3)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def refine_region(left, right, box, coarse, planes, blocks, row, fir, model, figures):  # type: ignore[no-untyped-def]
    """Refine one region: its box, the coarse disparity of its pixels (0 = none), scratch, and where its figures go."""
    height, width = coarse.shape
    u0, v0 = box[0], box[1]
    b = LEAST_BLOCK_PX
    while ((height + b - 1) // b) * ((width + b - 1) // b) > MOST_BLOCKS:
        b += 4
    across = (width + b - 1) // b
    n = across * ((height + b - 1) // b)
    d, target, inform, count = blocks[0, :n], blocks[1, :n], blocks[2, :n], blocks[3, :n]
    sum_gg, sum_ge, sum_ee, sum_w = blocks[4, :n], blocks[5, :n], blocks[6, :n], blocks[7, :n]
    pixels, mean = start_blocks(coarse, b, across, d, count)
    if pixels == 0:
        return
    step = (pixels + MOST_PIXELS - 1) // MOST_PIXELS
    size = height * width
    template = planes[0, :size].reshape(height, width)
    slope = planes[1, :size].reshape(height, width)
    weight = planes[2, :size].reshape(height, width)
    noise2 = 2 * model.noise * model.noise
    inner = fill_template(left, u0, v0, coarse, step, mean, noise2, model, template, slope, weight)
    coarse_mean = mean
    deepest = 0.0
    for k in range(n):
        deepest += count[k] * (d[k] - mean) ** 2
    deepest = np.sqrt(deepest / pixels)
    moved = search(left, right, u0, v0, weight, step, b, across, d)
    for k in range(n):
        d[k] += moved
    mean += moved
    gain, offset, scale2, residual2, last, used = model.gain, 0.0, -1.0, noise2, np.nan, 0.0
    relief = 0.0
    for iteration in range(ITERATIONS):
        sum_gg[:] = 0
        sum_ge[:] = 0
        sum_ee[:] = 0
        sum_w[:] = 0
        r_w, r_r, r_rr, r_e, r_er = 0.0, 0.0, 0.0, 0.0, 0.0
        nearest, farthest = d.max(), d.min()
        low = max(u0 - int(np.floor(nearest)) - TAPS, 0)
        high = min(u0 + width - int(np.floor(farthest)) + TAPS, right.shape[1])
        gain32, offset32 = np.float32(gain), np.float32(offset)
        robust = np.float32(1 / (ROBUST * ROBUST * scale2)) if scale2 > 0 else np.float32(0)
        for v in range(0, height, step):
            for x in range(low, high):
                row[x] = right[v0 + v, x]
            for c in range(across):
                k = (v // b) * across + c
                if count[k] == 0:
                    continue
                whole = int(np.floor(d[k]))
                base = u0 - whole - TAPS // 2
                begin = max(c * b, low - base)
                end = min(min(width, c * b + b), high - TAPS + 1 - base)
                taps = fir[int(np.floor((1.0 - (d[k] - whole)) * PHASES + 0.5))]
                gg, ge, ee, w, r, rr, e, er = sums_of_row(
                    row, taps, base, begin, end, v, template, slope, weight, gain32, offset32, robust
                )
                sum_gg[k] += gg
                sum_ge[k] += ge
                sum_ee[k] += ee
                sum_w[k] += w
                r_w += w
                r_r += r
                r_rr += rr
                r_e += e
                r_er += er
        if r_w < LEAST_WEIGHT:
            return
        total = 0.0
        for k in range(n):
            total += sum_ee[k]
        residual2 = max(total / r_w, noise2 / 4)
        scale2 = residual2
        used = r_w
        if iteration > 0:  # gain and offset, held near the cameras' own
            a11, a22 = r_w + residual2 / 36, r_rr + residual2 / 1e-4
            e1, e2 = r_e - residual2 / 36 * offset, r_er + residual2 / 1e-4 * (model.gain - gain)
            det = a11 * a22 - r_r * r_r
            offset += (e1 * a22 - e2 * r_r) / det
            gain += (a11 * e2 - r_r * e1) / det
        tie = max(model.slope * b * mean / model.f_px, 2e-3)
        known = 0.0
        for k in range(n):
            target[k], inform[k] = mean, 0.0
            if count[k] > 0 and sum_w[k] > 0:
                local2 = max(sum_ee[k] / sum_w[k] if sum_w[k] > 4 else residual2, 0.5 * residual2)
                level2 = min(max(local2 / 2, model.noise**2), 4 * model.noise**2)
                by_noise = GRADIENT_NOISE * level2 * (sum_w[k] + 3 * np.sqrt(sum_w[k]))
                energy = max(sum_gg[k] - by_noise, LEAST_ENERGY * sum_gg[k])
                if energy > 0:
                    target[k] = d[k] + min(max(-sum_ge[k] / energy, -FURTHEST_STEP_PX), FURTHEST_STEP_PX)
                    inform[k] = energy / (2 * local2)
                    known += inform[k]
        if known <= 0:
            return
        before = mean
        relief = seen_relief(target, inform, model, mean, deepest, width)
        mean = smooth(across, d, target, inform, count, mean, 1 / (tie * tie), relief)
        last = abs(mean - before)
        if iteration > 0 and last < SETTLED_PX:
            break
    summarize(d, target, inform, count, mean, relief, figures)
    figures[5], figures[6] = last, figures[0] - coarse_mean
    figures[7], figures[8], figures[9] = np.sqrt(residual2), used * step / pixels, pixels
    figures[10] = inner


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def sums_of_row(row, taps, base, begin, end, v, template, slope, weight, gain, offset, robust):  # type: ignore[no-untyped-def]
    """Return one row's share of a block's sums: gg, ge, ee, weight, r, rr, e, er.

    Nothing is stored in the loop and no index can be negative, so that eight pixels at a time go through it.
    """
    t0, t1, t2, t3, t4, t5, t6, t7 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6], taps[7]
    zero = np.float32(0)
    s_gg, s_ge, s_ee, s_w, s_r, s_rr, s_e, s_er = zero, zero, zero, zero, zero, zero, zero, zero
    y, first, x = np.uintp(v), np.uintp(begin), np.uintp(max(base + begin, 0))
    for i in range(np.uintp(max(end - begin, 0))):
        at = x + i
        r = t0 * row[at] + t1 * row[at + np.uintp(1)] + t2 * row[at + np.uintp(2)] + t3 * row[at + np.uintp(3)]
        r += t4 * row[at + np.uintp(4)] + t5 * row[at + np.uintp(5)] + t6 * row[at + np.uintp(6)]
        r += t7 * row[at + np.uintp(7)]
        g = slope[y, first + i]
        e = template[y, first + i] - gain * r - offset
        q = np.float32(1) + e * e * robust
        w = weight[y, first + i] / (q * q)
        s_gg += w * g * g
        s_ge += w * g * e
        s_ee += w * e * e
        s_w += w
        s_r += w * r
        s_rr += w * r * r
        s_e += w * e
        s_er += w * e * r
    return s_gg, s_ge, s_ee, s_w, s_r, s_rr, s_e, s_er


@numba.njit(cache=True, nogil=True, error_model="numpy")
def start_blocks(coarse, b, across, d, count):  # type: ignore[no-untyped-def]
    """Fill in each block's mean coarse disparity and pixel count; return the number of pixels and their mean."""
    d[:] = 0
    count[:] = 0
    pixels, total = 0, 0.0
    for v in range(coarse.shape[0]):
        for u in range(coarse.shape[1]):
            if coarse[v, u] > 0:
                k = (v // b) * across + u // b
                d[k] += coarse[v, u]
                count[k] += 1
                total += coarse[v, u]
                pixels += 1
    mean = total / max(pixels, 1)
    for k in range(len(d)):
        d[k] = d[k] / count[k] if count[k] > 0 else mean
    return pixels, mean


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_template(left, u0, v0, coarse, step, mean, noise2, model, template, slope, weight):  # type: ignore[no-untyped-def]
    """Fill in grey levels, slopes along the row, and weights; return the share of pixels inside the outline.

    The outline's pixels share what is wrong with them (it lies behind the mean surface, and what is behind it pulls),
    so all together count as one measurement with that error.
    """
    height, width = coarse.shape
    rim, inner, pixels = 0.0, 0, 0
    for v in range(0, height, step):
        row = left[v0 + v]
        for u in range(width):
            x = u0 + u
            template[v, u] = row[x]
            weight[v, u] = 0
            slope[v, u] = 0
            if coarse[v, u] > 0 and 2 <= x < left.shape[1] - 2:
                near = np.float32(row[x + 1]) - np.float32(row[x - 1])
                slope[v, u] = (8 * near - np.float32(row[x + 2]) + np.float32(row[x - 2])) / 12
                inside = 0 < u < width - 1 and coarse[v, u - 1] > 0 and coarse[v, u + 1] > 0
                inside = inside and (v == 0 or coarse[v - 1, u] > 0) and (v == height - 1 or coarse[v + 1, u] > 0)
                weight[v, u] = 1 if inside else -1
                pixels += 1
                inner += inside
                if not inside:
                    rim += slope[v, u] ** 2
    rim_px2 = (model.rim_m * mean * mean / model.f_baseline) ** 2 + model.rim_px**2
    share = np.float32(noise2 / (noise2 + rim * rim_px2))
    for v in range(0, height, step):
        for u in range(width):
            if weight[v, u] < 0:
                weight[v, u] = share
    return inner / max(pixels, 1)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=FAST)
def search(left, right, u0, v0, weight, step, b, across, d):  # type: ignore[no-untyped-def]
    """Return by how many whole pixels the region fits best, -SEARCH_PX..SEARCH_PX."""
    best, least = 0, np.float64(np.inf)
    height, width = weight.shape
    for shift in range(-SEARCH_PX, SEARCH_PX + 1):
        cost, pixels = np.float64(0), np.float64(0)
        for v in range(0, height, step):
            for c in range(across):
                to = u0 - int(np.floor(d[(v // b) * across + c] + 0.5)) - shift
                part, seen = np.float32(0), np.float32(0)
                begin, end = max(c * b, -to), min(min(width, c * b + b), left.shape[1] - to)
                y, a, x = np.uintp(v0 + v), np.uintp(begin), np.uintp(max(to + begin, 0))  # never negative
                from_left = np.uintp(u0 + begin)
                for i in range(np.uintp(max(end - begin, 0))):
                    e = np.float32(left[y, from_left + i]) - np.float32(right[y, x + i])
                    counts = np.float32(1) if weight[np.uintp(v), a + i] > 0 else np.float32(0)
                    part += counts * min(e * e, np.float32(900))
                    seen += counts
                cost += part
                pixels += seen
        if pixels > 0 and cost / pixels < least:
            best, least = shift, cost / pixels
    return best


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_relief(target, inform, model, mean, deepest, width_px):  # type: ignore[no-untyped-def]
    """Return how far the blocks lie from their mean, pixels: their scatter less what noise makes of it."""
    total, at, square, blocks = 0.0, 0.0, 0.0, 0
    for k in range(len(target)):
        if inform[k] > 0:
            total += inform[k]
            at += inform[k] * target[k]
            square += inform[k] * target[k] * target[k]
            blocks += 1
    at /= total
    per_m = mean * mean / model.f_baseline
    width_m = width_px * model.f_baseline / model.f_px / mean
    usual = ((model.relief_m + model.relief_share * width_m) * per_m) ** 2
    seen = (square / total - at * at) - (blocks - 1) / total
    trust = blocks * usual / (usual + blocks / total)
    relief2 = (max(seen, 0.0) * trust + usual * PRIOR_BLOCKS) / (trust + PRIOR_BLOCKS)
    return max(min(np.sqrt(relief2), max(model.relief_most_m * per_m, deepest)), 2e-3)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def smooth(across, d, target, inform, count, mean, tie, relief):  # type: ignore[no-untyped-def]
    """Move the blocks' disparities to what data, neighbours (weight `tie`) and mean together say; return the mean."""
    n = len(d)
    to_mean = 1 / (relief * relief)
    for _ in range(SWEEPS):
        for k in range(n):
            if count[k] == 0:
                continue
            weight, total = inform[k] + to_mean, inform[k] * target[k] + to_mean * mean
            c = k % across
            if c > 0 and count[k - 1] > 0:
                weight, total = weight + tie, total + tie * d[k - 1]
            if c < across - 1 and count[k + 1] > 0:
                weight, total = weight + tie, total + tie * d[k + 1]
            if k >= across and count[k - across] > 0:
                weight, total = weight + tie, total + tie * d[k - across]
            if k + across < n and count[k + across] > 0:
                weight, total = weight + tie, total + tie * d[k + across]
            d[k] = total / weight
        sure, total = 0.0, 0.0
        for k in range(n):
            if inform[k] > 0:
                weight = 1 / (1 / inform[k] + relief * relief)
                sure, total = sure + weight, total + weight * target[k]
        mean = total / sure
    return mean


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summarize(d, target, inform, count, mean, relief, figures):  # type: ignore[no-untyped-def]
    """Fill in mean_px, nearest_px, scatter_px and noise_px."""
    pixels, depth, sure, scatter, noise, unseen = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(d)):
        if count[k] > 0:
            pixels += count[k]
            depth += count[k] / max(d[k], 0.05)
            unseen += count[k] / (1 + inform[k] * relief * relief)
        if inform[k] > 0:
            weight = 1 / (1 / inform[k] + relief * relief)
            sure += weight
            scatter += (weight * (target[k] - mean)) ** 2
            noise += weight * weight / inform[k]
    figures[0] = pixels / depth
    order = np.argsort(-d)
    seen = 0.0
    for k in order:
        seen += count[k]
        if seen >= 0.1 * pixels:
            figures[1] = d[k]
            break
    unseen = relief * np.sqrt(unseen / pixels)
    figures[1] = figures[0] + np.sqrt(max(figures[1] - figures[0], 0.0) ** 2 + (TENTH * unseen) ** 2)
    figures[2], figures[3], figures[4] = np.sqrt(scatter) / sure, np.sqrt(noise) / sure, unseen
