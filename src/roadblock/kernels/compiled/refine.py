"""Refinement of regions, compiled: see `reference.refine`. Eight pixels of a row go through it at a time."""

import numba
import numpy as np

from roadblock.kernels.reference.refine import (
    BLOCK_PX,
    CORE_OF,
    CORE_PX,
    FIGURES,
    FRONT_SHARE,
    FURTHEST_STEP_PX,
    GRADIENT_NOISE,
    LEAST_ENERGY,
    LEAST_NOISE,
    LEAST_WEIGHT,
    MISFIT,
    NEAREST_SHARE,
    PHASES,
    PRIOR_BLOCKS,
    RIM_PX,
    ROBUST,
    SEARCH_PX,
    SETTLED_PX,
    SURVEYS,
    SWEEPS,
    TAPS,
    TENTH,
    THIN,
    WORST_PX,
    interpolation,
)
from roadblock.kernels.simd import eight, lesser, load_reals, store_reals, total

FIR = interpolation()
N_FIGURES = len(FIGURES)
MARGIN = TAPS + 8
"""Columns beside a region that may be looked at."""


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine_regions(left, right, first, uvd, model):  # type: ignore[no-untyped-def]
    """See `reference.refine.refine_regions`."""
    n = len(first) - 1
    figures = np.full((n, N_FIGURES), np.nan)
    boxes = np.zeros((n, 6), np.int64)
    most, most_right, most_wide = 1, 1, 1
    for i in range(n):
        near, far = bounds(uvd[first[i] : first[i + 1]], left.shape, boxes[i])
        u0, v0, u1, v1 = boxes[i, 0], boxes[i, 1], boxes[i, 2], boxes[i, 3]
        if u1 <= u0 or v1 <= v0:
            continue
        b, step, across, _ = grid(boxes[i], first[i + 1] - first[i], model)
        rows, wide = (v1 - v0 + step - 1) // step, across * b + 2 * MARGIN
        most, most_wide = max(most, rows * wide), max(most_wide, wide)
        most_right = max(most_right, rows * (wide + int(near - far) + 8))
    planes = np.empty((4, most), np.float32)
    beside = np.empty(most_right, np.float32)
    lines = np.empty((2, most_wide + left.shape[1] + 64), np.float32)
    blocks = np.empty((8, model.most_blocks))
    for i in range(n):
        if boxes[i, 2] > boxes[i, 0] and boxes[i, 3] > boxes[i, 1]:
            samples = uvd[first[i] : first[i + 1]]
            refine_region(left, right, boxes[i], samples, planes, beside, lines, blocks, FIR, model, figures[i])
    return figures


@numba.njit(cache=True, nogil=True, error_model="numpy")
def bounds(uvd, shape, box):  # type: ignore[no-untyped-def]
    """Fill in a region's box inside the image, half open, and its cells' size; return the most and least disparity."""
    width, height = 1 << 30, 1 << 30
    for k in range(1, len(uvd)):
        across, down = abs(uvd[k, 0] - uvd[k - 1, 0]), abs(uvd[k, 1] - uvd[k - 1, 1])
        if across > 0:
            width = min(width, int(across))
        if down > 0:
            height = min(height, int(down))
    one = 1 << 30
    box[4] = width if width < one else (height if height < one else 1)
    box[5] = height if height < one else box[4]
    box[0], box[1], box[2], box[3] = shape[1], shape[0], 0, 0
    near, far = 0.0, 1e9
    for k in range(len(uvd)):
        u, v = int(np.rint(uvd[k, 0] - (box[4] - 1) / 2)), int(np.rint(uvd[k, 1] - (box[5] - 1) / 2))
        box[0], box[1] = min(box[0], max(u, 0)), min(box[1], max(v, 0))
        box[2], box[3] = max(box[2], min(u + box[4], shape[1])), max(box[3], min(v + box[5], shape[0]))
        near, far = max(near, uvd[k, 2]), min(far, uvd[k, 2])
    return near, max(far, 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def grid(box, cells, model):  # type: ignore[no-untyped-def]
    """Return width of the blocks (they are twice as high), every which row counts, and blocks across and down."""
    height, width = box[3] - box[1], box[2] - box[0]
    b = BLOCK_PX
    while ((height + 2 * b - 1) // (2 * b)) * ((width + b - 1) // b) > model.most_blocks:
        b += BLOCK_PX
    step = int(np.ceil(np.sqrt(cells * box[4] * box[5] / model.many_pixels)))
    return b, min(max(step, 1), b), (width + b - 1) // b, (height + 2 * b - 1) // (2 * b)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def refine_region(left, right, box, uvd, planes, beside, lines, blocks, fir, model, figures):  # type: ignore[no-untyped-def]
    """Refine one region: its box, its samples, scratch, and where its figures go."""
    u0, v0, height = box[0], box[1], box[3] - box[1]
    b, step, across, down = grid(box, len(uvd), model)
    n, rows, wide = across * down, (height + step - 1) // step, across * b + 2 * MARGIN
    d, target, inform, count, sums = blocks[0, :n], blocks[1, :n], blocks[2, :n], blocks[3, :n], blocks[4:, :n]
    mask = planes[0, : rows * wide].reshape(rows, wide)
    template = planes[1, : rows * wide].reshape(rows, wide)
    slope = planes[2, : rows * wide].reshape(rows, wide)
    weight = planes[3, : rows * wide].reshape(rows, wide)
    pixels, mean, near, far = paint(uvd, box, b, step, across, mask, d, count)
    if pixels == 0:
        return
    noise2 = 2 * model.noise * model.noise
    coarse_px = nearest(d, count, target, NEAREST_SHARE)
    inner, core = fill_template(left, box, step, mean, noise2, model, mask, lines, template, slope, weight)
    deepest = 0.0
    for k in range(n):
        deepest += count[k] * (d[k] - mean) ** 2
    deepest = np.sqrt(deepest / pixels)
    low = u0 - int(np.floor(near)) - MARGIN - 1
    span = min(u0 + across * b - int(np.floor(far)) + MARGIN - low, lines.shape[1])
    other = beside[: rows * span].reshape(rows, span)
    seen = lines[1:2]
    for j in range(span):
        seen[0, j] = 1.0 if 0 <= low + j <= right.shape[1] - TAPS else 0.0
    for k in range(rows):
        copy_row(right, v0 + k * step, low, other[k])
    coarse_mean, moved = mean, search(template, mask, other, seen, u0 - low, step, b, across, d, count)
    for k in range(n):
        d[k] += moved
    mean += moved
    gain, offset, scale2, last, used = model.gain, 0.0, -1.0, np.nan, 0.0
    residual2, relief = noise2, 0.0
    for iteration in range(model.rounds):
        robust = eight(1 / (ROBUST * ROBUST * scale2)) if scale2 > 0 else eight(0.0)
        gains, offsets, one = eight(gain), eight(offset), eight(1.0)
        all_r, all_rr, all_e, all_er = eight(0.0), eight(0.0), eight(0.0), eight(0.0)
        sums[:] = 0
        for k in range(n):
            if count[k] == 0:
                continue
            i, c = k // across, k % across
            whole = int(np.floor(d[k]))
            taps = fir[int(np.floor((1.0 - (d[k] - whole)) * PHASES + 0.5))]
            t0, t1, t2, t3 = eight(taps[0]), eight(taps[1]), eight(taps[2]), eight(taps[3])
            t4, t5, t6, t7 = eight(taps[4]), eight(taps[5]), eight(taps[6]), eight(taps[7])
            s_gg, s_ge, s_ee, s_w = eight(0.0), eight(0.0), eight(0.0), eight(0.0)
            for y in range((i * 2 * b + step - 1) // step, min((2 * b * (i + 1) + step - 1) // step, rows)):
                for x in range(c * b, c * b + b, 8):
                    at, from_left = u0 + x - whole - TAPS // 2 - low, MARGIN + x
                    w = load_reals(weight, y, from_left) * load_reals(seen, 0, at)
                    r = t0 * load_reals(other, y, at) + t1 * load_reals(other, y, at + 1)
                    r = r + t2 * load_reals(other, y, at + 2) + t3 * load_reals(other, y, at + 3)
                    r = r + t4 * load_reals(other, y, at + 4) + t5 * load_reals(other, y, at + 5)
                    r = r + t6 * load_reals(other, y, at + 6) + t7 * load_reals(other, y, at + 7)
                    g = load_reals(slope, y, from_left)
                    e = load_reals(template, y, from_left) - gains * r - offsets
                    ee = e * e
                    q = one + ee * robust
                    w = w / (q * q)
                    we, wg = w * e, w * g
                    s_gg, s_ge, s_ee, s_w = s_gg + wg * g, s_ge + wg * e, s_ee + w * ee, s_w + w
                    all_r, all_rr, all_e, all_er = all_r + w * r, all_rr + w * r * r, all_e + we, all_er + we * r
            sums[0, k], sums[1, k] = total(s_gg), total(s_ge)
            sums[2, k], sums[3, k] = total(s_ee), total(s_w)
        r_w, ee_all = sums[3].sum(), sums[2].sum()
        if r_w < LEAST_WEIGHT:
            return
        residual2 = max(ee_all / r_w, noise2 / 4)
        scale2, used = residual2, r_w
        if iteration > 0:  # gain and offset, held near the cameras' own
            r_r, r_rr, r_e, r_er = total(all_r), total(all_rr), total(all_e), total(all_er)
            a11, a22 = r_w + residual2 / 36, r_rr + residual2 / 1e-4
            e1, e2 = r_e - residual2 / 36 * offset, r_er + residual2 / 1e-4 * (model.gain - gain)
            det = a11 * a22 - np.float64(r_r) * r_r
            offset += (e1 * a22 - e2 * r_r) / det
            gain += (a11 * e2 - r_r * e1) / det
        if not inform_blocks(sums, d, mean, residual2, model, target, inform):
            return
        before = mean
        relief = seen_relief(target, inform, model, mean, deepest, box[2] - box[0])
        tie = max(model.slope * b * mean / model.f_px, 2e-3)
        mean = smooth(across, d, target, inform, count, mean, 1 / (tie * tie), relief)
        last = abs(mean - before)
        if iteration > 1 and last < SETTLED_PX:
            break
    summarize(d, target, inform, count, mean, relief, sums[3], sums[0], figures)
    figures[5], figures[6] = last, figures[0] - coarse_mean
    figures[7], figures[8], figures[9] = np.sqrt(residual2), used / pixels, pixels * step
    figures[10], figures[11], figures[12] = inner, core, coarse_px


@numba.njit(cache=True, nogil=True, error_model="numpy")
def copy_row(image, v, low, out):  # type: ignore[no-untyped-def]
    """Copy a row's levels from column `low` on; 0 outside of the image."""
    begin, end = max(-low, 0), min(len(out), image.shape[1] - low)
    out[: min(begin, len(out))] = 0
    row = image[v]
    x = np.uintp(low + begin)
    for j in range(np.uintp(max(end - begin, 0))):
        out[np.uintp(begin) + j] = row[x + j]
    out[max(end, 0) :] = 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def paint(uvd, box, b, step, across, mask, d, count):  # type: ignore[no-untyped-def]
    """Fill in the mask (1 inside) and the blocks' disparities and pixels; return pixels, mean, most and least."""
    mask[:] = 0
    d[:] = 0
    count[:] = 0
    height, width = box[3] - box[1], box[2] - box[0]
    pixels, whole, near, far = 0.0, 0.0, 0.0, 1e9
    for k in range(len(uvd)):
        u = int(np.rint(uvd[k, 0] - (box[4] - 1) / 2)) - box[0]
        v = int(np.rint(uvd[k, 1] - (box[5] - 1) / 2)) - box[1]
        u1, v1 = min(u + box[4], width), min(v + box[5], height)
        u, v = max(u, 0), max(v, 0)
        first, last = (v + step - 1) // step, (v1 + step - 1) // step
        if last <= first or u1 <= u:
            continue
        for y in range(first, last):
            for x in range(u, u1):
                mask[y, MARGIN + x] = 1
        block, area = (v // (2 * b)) * across + u // b, (last - first) * (u1 - u)
        value = max(uvd[k, 2], 1e-3)
        d[block] += area * value
        count[block] += area
        pixels += area
        whole += area * value
        near, far = max(near, value), min(far, value)
    mean = whole / max(pixels, 1.0)
    for k in range(len(d)):
        d[k] = d[k] / count[k] if count[k] > 0 else mean
    return pixels, mean, near, far


@numba.njit(cache=True, nogil=True, error_model="numpy")
def nearest(d, count, scratch, share):  # type: ignore[no-untyped-def]
    """Return the disparity that this share of the pixels reach or exceed."""
    pixels = 0.0
    for k in range(len(d)):
        pixels += count[k]
        scratch[k] = d[k] if count[k] > 0 else -1.0
    seen, value = 0.0, 0.0
    while seen < share * pixels:
        best = 0
        for k in range(len(d)):
            if scratch[k] > scratch[best]:
                best = k
        value = scratch[best]
        seen += count[best]
        scratch[best] = -1.0
    return value


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fill_template(left, box, step, mean, noise2, model, mask, lines, template, slope, weight):  # type: ignore[no-untyped-def]
    """Fill in grey levels, slopes along the row, and weights; return the shares inside: of pixels, and of energy."""
    rows, wide = mask.shape
    inset = min(CORE_PX, max((box[2] - box[0]) // CORE_OF, RIM_PX))
    away = (inset + step - 1) // step
    line = lines[0:1]
    low = box[0] - MARGIN - 2
    first, last = max(2 - box[0], 0), min(left.shape[1] - 2 - box[0], wide - 2 * MARGIN)  # columns whose slope is known
    one, white, eighth, twelfth = eight(1.0), eight(255.0), eight(8.0), eight(1 / 12)
    rim, inside, known = eight(0.0), eight(0.0), eight(0.0)
    thin_rim, deeper = eight(0.0), eight(0.0)
    all_gg, core_gg, core_n = eight(0.0), eight(0.0), eight(0.0)
    mask[:, MARGIN : MARGIN + first] = 0
    mask[:, MARGIN + last :] = 0
    for y in range(rows):
        copy_row(left, box[1] + y * step, low, lines[0, : wide + 4])
        for x in range(MARGIN, wide - MARGIN, 8):
            level = load_reals(line, 0, x + 2)
            near = load_reals(line, 0, x + 3) - load_reals(line, 0, x + 1)
            g = (eighth * near - load_reals(line, 0, x + 4) + load_reals(line, 0, x)) * twelfth
            there = load_reals(mask, y, x)
            within = there * load_reals(mask, y, x - 1) * load_reals(mask, y, x + 1)
            deep = within * load_reals(mask, y, x - RIM_PX) * load_reals(mask, y, x + RIM_PX)
            known, inside, deeper = known + there, inside + within, deeper + deep
            exposed = lesser(one, lesser(white - level, level))
            gg = exposed * g * g
            thin_rim, rim = thin_rim + (there - within) * gg, rim + (there - deep) * gg
            all_gg = all_gg + there * gg
            if away <= y < rows - away:
                core = exposed * load_reals(mask, y, x - inset) * load_reals(mask, y, x + inset)
                core = core * there * load_reals(mask, y - away, x) * load_reals(mask, y + away, x)
                core_gg, core_n = core_gg + core * g * g, core_n + core
            store_reals(template, y, x, level)
            store_reals(slope, y, x, g)
            store_reals(weight, y, x, exposed * (there + within + deep))  # 1 along the outline, 3 deep inside
    # What is thin has an outline of one pixel, or nothing would be left of it.
    is_thin = np.float64(total(deeper)) < THIN * np.float64(total(known))
    rim_px2 = (model.rim_m * mean * mean / model.f_baseline) ** 2 + model.rim_px**2
    rim_gg = np.float64(total(thin_rim)) if is_thin else np.float64(total(rim))
    share, outline = eight(noise2 / (noise2 + rim_gg * rim_px2)), eight(1.0 if is_thin else 2.0)
    for y in range(rows):
        for x in range(MARGIN, wide - MARGIN, 8):
            w = load_reals(weight, y, x)
            inner = lesser(one, w - lesser(w, outline))
            store_reals(weight, y, x, inner + (lesser(one, w) - inner) * share)
    n, level2 = np.float64(total(core_n)), noise2 / 2
    core = max(np.float64(total(core_gg)) - GRADIENT_NOISE * level2 * (1.3 * n + 3 * np.sqrt(n)), 0.0)
    return np.float64(total(inside)) / max(np.float64(total(known)), 1.0), core / max(np.float64(total(all_gg)), 1e-9)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def search(template, mask, other, seen, origin, step, b, across, d, count):  # type: ignore[no-untyped-def]
    """Return by how many whole pixels every other row fits best, -SEARCH_PX..SEARCH_PX."""
    best, least, rows = 0, np.float64(np.inf), len(mask)
    most = eight(WORST_PX)
    for shift in range(-SEARCH_PX, SEARCH_PX + 1):
        cost, pixels = eight(0.0), eight(0.0)
        for k in range(len(d)):
            if count[k] == 0:
                continue
            i, c = k // across, k % across
            to = origin - int(np.floor(d[k] + 0.5)) - shift
            top = (i * 2 * b + step - 1) // step
            for y in range(top + top % 2, min((2 * b * (i + 1) + step - 1) // step, rows), 2):
                for x in range(c * b, c * b + b, 8):
                    w = load_reals(mask, y, MARGIN + x) * load_reals(seen, 0, to + x - TAPS // 2)
                    e = load_reals(template, y, MARGIN + x) - load_reals(other, y, to + x)
                    cost, pixels = cost + w * lesser(e * e, most), pixels + w
        n = np.float64(total(pixels))
        if n > 0 and np.float64(total(cost)) / n < least:
            best, least = shift, np.float64(total(cost)) / n
    return best


@numba.njit(cache=True, nogil=True, error_model="numpy")
def inform_blocks(sums, d, mean, residual2, model, target, inform):  # type: ignore[no-untyped-def]
    """Fill in what the data say of each block and how surely; return whether they say anything.

    The last of the sums becomes by how much less they say where not noise but something else is left.
    """
    known, level2 = False, model.noise**2
    for k in range(len(d)):
        gg, ge, ee, w = sums[0, k], sums[1, k], sums[2, k], sums[3, k]
        target[k], inform[k] = mean, 0.0
        if w > 0:
            local2 = max(ee / w if w > 4 else residual2, 0.5 * residual2)
            by_noise = GRADIENT_NOISE * min(max(local2 / 2, level2), 4 * level2) * (w + 3 * np.sqrt(w))
            energy = max(gg - by_noise, LEAST_ENERGY * gg)
            if energy > 0:
                target[k] = d[k] + min(max(-ge / energy, -FURTHEST_STEP_PX), FURTHEST_STEP_PX)
                inform[k] = energy / (2 * local2)
                sums[3, k] = 1 + MISFIT * max(1 - 2 * level2 / local2, 0.0)
                known = True
    return known


@numba.njit(cache=True, nogil=True, error_model="numpy")
def seen_relief(target, inform, model, mean, deepest, width_px):  # type: ignore[no-untyped-def]
    """Return how far the blocks lie from their mean, pixels: their scatter less what noise makes of it."""
    whole, at, square, blocks = 0.0, 0.0, 0.0, 0
    for k in range(len(target)):
        if inform[k] > 0:
            whole += inform[k]
            at += inform[k] * (target[k] - mean)
            square += inform[k] * (target[k] - mean) ** 2
            blocks += 1
    at /= whole
    per_m = mean * mean / model.f_baseline
    width_m = width_px * model.f_baseline / model.f_px / mean
    usual = ((model.relief_m + model.relief_share * width_m) * per_m) ** 2
    seen = (square / whole - at * at) - (blocks - 1) / whole
    trust = blocks * usual / (usual + blocks / whole)
    relief2 = (max(seen, 0.0) * trust + usual * PRIOR_BLOCKS) / (trust + PRIOR_BLOCKS)
    return max(min(np.sqrt(relief2), max(model.relief_most_m * per_m, deepest)), 2e-3)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def smooth(across, d, target, inform, count, mean, tie, relief):  # type: ignore[no-untyped-def]
    """Move the blocks' disparities to what data, neighbours (weight `tie`) and mean together say; return the mean."""
    n = len(d)
    to_mean, apart = 1 / (relief * relief), tie / 4
    sure, whole = 0.0, 0.0
    for k in range(n):
        if inform[k] > 0:
            weight = inform[k] / (1 + inform[k] * relief * relief)
            sure, whole = sure + weight, whole + weight * target[k]
    mean = whole / sure
    for _ in range(SWEEPS):
        for k in range(n):
            if count[k] == 0:
                continue
            weight, whole = inform[k] + to_mean, inform[k] * target[k] + to_mean * mean
            c = k % across
            if c > 0 and count[k - 1] > 0:
                weight, whole = weight + tie, whole + tie * d[k - 1]
            if c < across - 1 and count[k + 1] > 0:
                weight, whole = weight + tie, whole + tie * d[k + 1]
            if k >= across and count[k - across] > 0:
                weight, whole = weight + apart, whole + apart * d[k - across]
            if k + across < n and count[k + across] > 0:
                weight, whole = weight + apart, whole + apart * d[k + across]
            d[k] = whole / weight
    return mean


@numba.njit(cache=True, nogil=True, error_model="numpy")
def summarize(d, target, inform, count, mean, relief, worse, scratch, figures):  # type: ignore[no-untyped-def]
    """Fill in mean_px, nearest_px, scatter_px, noise_px, unseen_px, front_px and front_unseen_px."""
    pixels, depth, sure, scatter, noise, unseen = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(d)):
        if count[k] > 0:
            pixels += count[k]
            depth += count[k] / max(d[k], 0.05)
            unseen += count[k] / (1 + inform[k] * relief * relief)
        if inform[k] > 0:
            weight = inform[k] / (1 + inform[k] * relief * relief)
            sure += weight
            scatter += (weight * (target[k] - mean)) ** 2
            noise += weight * weight / inform[k] * worse[k]
    figures[0] = pixels / depth
    unseen = relief * np.sqrt(unseen / pixels)
    front = nearest(d, count, scratch, NEAREST_SHARE)
    figures[2], figures[3], figures[4] = np.sqrt(scatter) / sure, np.sqrt(noise) / sure, unseen
    least = nearest(d, count, scratch, FRONT_SHARE)
    pixels, sure, scatter, noise, unseen = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(len(d)):
        if count[k] > 0 and d[k] >= least:
            pixels += count[k]
            unseen += count[k] / (1 + inform[k] * relief * relief)
            if inform[k] > 0:
                weight = inform[k] / (1 + inform[k] * relief * relief)
                sure += weight
                scatter += (weight * (target[k] - d[k])) ** 2
                noise += weight * weight / inform[k] * worse[k]
    figures[13] = np.sqrt(max(scatter, noise)) / sure if sure > 0 else relief
    figures[14] = relief * np.sqrt(unseen / pixels)
    figures[1] = figures[0] + np.sqrt(max(front - figures[0], 0.0) ** 2 + (TENTH * figures[14]) ** 2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def survey(left, right):  # type: ignore[no-untyped-def]
    """See `reference.refine.survey`."""
    height, width = left.shape
    apart = max(min(height, width) // SURVEYS, 10)
    down, across = max(height - 2, 0) // apart, max(width - 2, 0) // apart
    levels, n, zero = np.empty(down * across), 0, np.int64(0)
    sums = np.zeros(4)
    for i in range(down):
        for j in range(across):
            v0, u0 = i * apart + 1, j * apart + 1
            here, square, there, other_square, rough = zero, zero, zero, zero, zero
            for v in range(v0, v0 + 8):
                for u in range(u0, u0 + 8):
                    a, b = np.int64(left[v, u]), np.int64(right[v, u])
                    here, square, there, other_square = here + a, square + a * a, there + b, other_square + b * b
                    x = np.int64(left[v - 1, u - 1]) + left[v - 1, u + 1] + left[v + 1, u - 1] + left[v + 1, u + 1]
                    x += 4 * a - 2 * (np.int64(left[v - 1, u]) + left[v + 1, u] + left[v, u - 1] + left[v, u + 1])
                    rough += x * x
            sums += np.array([here, square, there, other_square], np.float64)
            if 16 * 64 < here < 240 * 64:
                levels[n] = np.sqrt(rough / 64) / 6
                n += 1
    noise = max(np.sort(levels[:n])[n // 10], LEAST_NOISE) if n > 0 else 1.0
    pixels = max(64.0 * down * across, 1.0)
    ours = np.sqrt(max(sums[1] / pixels - (sums[0] / pixels) ** 2, 0.0))
    theirs = np.sqrt(max(sums[3] / pixels - (sums[2] / pixels) ** 2, 0.0))
    gain = min(max(ours / theirs, 0.7), 1.4) if min(ours, theirs) > 1 else 1.0
    return noise, gain
