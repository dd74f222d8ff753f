"""The kernels of `reference.low`, compiled: same names, same arguments, same numbers to rounding."""

from typing import Any

import numba
import numpy as np

from roadblock.kernels.reference.low import ALIKE, BELOW, CALM, CHUNK, CLIP, CORRELATED, LINEAR, TOLERANCE_PX

MODE: Any = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"reassoc", "contract", "nsz", "arcp", "nnan"},
}


@numba.njit(**MODE)
def warp(left, right, bin_px, rows, first, last, d_px, slope, middle, gain, tilt, step, near, far):  # type: ignore[no-untyped-def]
    """See `reference.low.warp`."""
    c = bin_px
    width = left.shape[1] // c
    a = np.zeros(width + 8, np.float32)
    b = np.zeros(width + 8, np.float32)
    q, h = np.float32(0.25), np.float32(0.5)
    for i in range(0, len(rows), step):
        u0, u1 = first[i], last[i]
        if u1 <= u0:
            continue
        reach = abs(slope[i]) * (max(abs(u0 - middle), abs(u1 - middle)))
        low, high = int(u0 - d_px[i] - reach) - 4, int(u1 - d_px[i] + reach) + 5
        binned_row(left, rows[i] * c, c, u0 - 1, u1 + 1, a)
        binned_row(right, rows[i] * c, c, max(0, low), min(width, high), b)
        before, at, after, n = a[u0 - 1 : u1 - 1], a[u0:u1], a[u0 + 1 : u1 + 1], near[i, u0:u1]
        for u in range(len(n)):
            n[u] = q * (before[u] + after[u]) + h * at[u]
        for begin in range(u0, u1, CHUNK):
            end = min(begin + CHUNK, u1)
            # One shift and one gain a chunk: both are linear, and a chunk is short.
            aside = (begin + end - 1) / 2 - middle
            shift = -(d_px[i] + slope[i] * aside)
            whole = int(np.floor(shift))
            t = shift - whole
            g = gain[i] + tilt * aside
            # Catmull-Rom, then the same 1-2-1 as on the left.
            k0, k1 = np.float32(g * (-0.5 * t + t * t - 0.5 * t**3)), np.float32(g * (1 - 2.5 * t * t + 1.5 * t**3))
            k2, k3 = np.float32(g * (0.5 * t + 2 * t * t - 1.5 * t**3)), np.float32(g * (-0.5 * t * t + 0.5 * t**3))
            s0, s1, s2 = q * k0, h * k0 + q * k1, q * k0 + h * k1 + q * k2
            s3, s4, s5 = q * k1 + h * k2 + q * k3, q * k2 + h * k3, q * k3
            r, w = b[begin + whole - 2 : end + whole + 4], far[i, begin:end]
            for u in range(len(w)):
                w[u] = s0 * r[u] + s1 * r[u + 1] + s2 * r[u + 2] + s3 * r[u + 3] + s4 * r[u + 4] + s5 * r[u + 5]


@numba.njit(**MODE)
def binned_row(image, row, c, u0, u1, into):  # type: ignore[no-untyped-def]
    """Average c x c pixels of an image into columns u0 .. u1 of one binned row."""
    line = into[u0:u1]
    if c == 1:
        one = image[row, u0:u1]
        for u in range(len(line)):
            line[u] = np.float32(one[u])
        return
    line[:] = 0
    scale = np.float32(1.0 / (c * c))
    for k in range(c):
        one = image[row + k, c * u0 : c * u1]
        if c == 2:
            for u in range(len(line)):
                line[u] += scale * (np.float32(one[2 * u]) + np.float32(one[2 * u + 1]))
        else:
            for u in range(len(line)):
                p, q = np.float32(one[4 * u]), np.float32(one[4 * u + 1])
                line[u] += scale * (p + q + (np.float32(one[4 * u + 2]) + np.float32(one[4 * u + 3])))


@numba.njit(**MODE)
def road_sums(near, far, first, last, step, sums):  # type: ignore[no-untyped-def]
    """See `reference.low.road_sums`."""
    sums[:] = 0
    strips, blocks = sums.shape[0], sums.shape[1]
    for i in range(0, len(first), step):
        u0, u1 = first[i] + 1, last[i] - 1
        for k in range(blocks):
            a, b = u0 + (u1 - u0) * k // blocks, u0 + (u1 - u0) * (k + 1) // blocks
            if b > a:
                add_block(near[i, a - 1 : b + 1], far[i, a - 1 : b + 1], sums[i * strips // len(first), k])


@numba.njit(**MODE)
def add_block(n, f, s):  # type: ignore[no-untyped-def]
    """Add the sums over one row of a block, which comes with a column more on either side."""
    zero = np.float32(0)
    g1, e1, gg, ge, ee, n1, f1 = zero, zero, zero, zero, zero, zero, zero
    for u in range(len(n) - 2):
        e = n[u + 1] - f[u + 1]
        g = np.float32(0.25) * (n[u + 2] - n[u] + f[u + 2] - f[u])
        g1 += g
        e1 += e
        gg += g * g
        ge += g * e
        ee += e * e
        n1 += n[u + 1]
        f1 += f[u + 1]
    s[0] += len(n) - 2
    s[1] += g1
    s[2] += e1
    s[3] += gg
    s[4] += ge
    s[5] += ee
    s[6] += n1
    s[7] += f1


@numba.njit(**MODE)
def weigh(near, far, first, last, variance, weight):  # type: ignore[no-untyped-def]
    """See `reference.low.weigh`."""
    tolerance = np.float32(TOLERANCE_PX * TOLERANCE_PX / 4)
    v = np.float32(variance)
    for i in range(len(first)):
        n, f, w = near[i, first[i] : last[i]], far[i, first[i] : last[i]], weight[i, first[i] + 1 : last[i] - 1]
        for u in range(len(w)):
            g, h = n[u + 2] - n[u], f[u + 2] - f[u]
            w[u] = np.float32(1) / (v + tolerance * max(g * g, h * h))


@numba.njit(**MODE)
def score(near, far, weight, first, last, d_px, feet, tall, wide, scores, heights):  # type: ignore[no-untyped-def]
    """See `reference.low.score`."""
    sums = np.zeros((2, near.shape[1]), np.float32)
    gained, changed = sums[0], sums[1]
    for k in range(len(feet)):
        foot = feet[k]
        u0, u1 = first[foot] + 1, last[foot] - 1
        scores[k, :] = 0
        if u1 - u0 < wide[k] + 8:
            continue
        sums[:, u0:u1] = 0
        d_foot = 0.5 * (d_px[foot] + d_px[foot - 1])
        done = 0
        noise = np.float32(0)
        for t in range(tall.shape[1]):
            for j in range(done + 1, tall[k, t] + 1):
                i = foot - j
                rise = d_foot - d_px[i]
                whole = int(np.floor(rise))
                noise += np.float32(wide[k] * (1 - alike(rise)))
                a = u0 + max(whole, 0) + 1
                add_row(near[i, a:u1], weight[i, a:u1], far[i], a, whole, rise - whole, gained[a:u1], changed[a:u1])
            done = tall[k, t]
            slide(gained, changed, u0, u1, wide[k], noise, scores[k], heights[k], t)


@numba.njit(**MODE)
def add_row(n, w, far, a, whole, part, gained, changed):  # type: ignore[no-untyped-def]
    """Add one row of a template: how much better it fits, and how much it differs from the road."""
    r = np.float32(part)
    rest = np.float32(1) - r
    # Between two pixels noise is averaged away; an honest comparison puts it back.
    level = np.float32(1 / (1 - LINEAR * part * (1 - part)))
    clip = np.float32(CLIP)
    f, g = far[a : a + len(n)], far[a - whole - 1 : a - whole + len(n)]
    for u in range(len(n)):
        p = rest * g[u + 1] + r * g[u]
        e0, e1, d = n[u] - f[u], n[u] - p, f[u] - p
        v = w[u] * level
        gained[u] += min(e0 * e0 * w[u], clip) - min(e1 * e1 * v, clip)
        changed[u] += min(d * d * v, clip)


@numba.njit(**MODE)
def slide(gained, changed, u0, u1, wide, noise, best, which, t):  # type: ignore[no-untyped-def]
    """Slide a window over a row of templates and keep the best height of each place."""
    half = wide // 2
    total = np.float32(0)
    change = np.float32(0)
    for u in range(u0, u0 + wide):
        total += gained[u]
        change += changed[u]
    for u in range(u0, u1 - wide):
        if total > 0 and change > noise:
            value = total / np.float32(2 * CORRELATED) * np.sqrt((change - noise) / change)
            if value > best[u + half]:
                best[u + half] = value
                which[u + half] = t
        total += gained[u + wide] - gained[u]
        change += changed[u + wide] - changed[u]


@numba.njit(**MODE)
def alike(shift_px):  # type: ignore[no-untyped-def]
    """Return the correlation of the noise of two smoothed pixels so far apart."""
    shift = abs(shift_px)
    if shift >= 3:
        return 0.0
    i = int(shift)
    return ALIKE[i] + (shift - i) * (ALIKE[i + 1] - ALIKE[i])


@numba.njit(**MODE)
def pick(scores, heights, feet, tall, wide, evidence, hits):  # type: ignore[no-untyped-def]
    """See `reference.low.pick`."""
    count = 0
    while count < len(hits):
        best = np.float32(evidence)
        at_k, at_u = -1, -1
        for k in range(scores.shape[0]):
            row = scores[k]
            top = np.float32(0)
            for u in range(len(row)):
                top = max(top, row[u])
            if top > best:
                best, at_k = top, k
        if at_k < 0:
            break
        for u in range(scores.shape[1]):
            if scores[at_k, u] == best:
                at_u = u
                break
        hit = hits[count]
        hit[0], hit[1], hit[2], hit[3] = at_k, at_u, heights[at_k, at_u], best
        count += 1
        for k in range(scores.shape[0]):
            if abs(feet[k] - feet[at_k]) <= tall[at_k, -1]:
                scores[k, max(0, at_u - wide[at_k]) : at_u + wide[at_k] + 1] = 0
    return count


@numba.njit(**MODE)
def confirm(near, far, weight, d_px, first, last, foot, tall, column, wide):  # type: ignore[no-untyped-def]
    """See `reference.low.confirm`."""
    u0 = column - wide // 2
    d_foot = 0.5 * (d_px[foot] + d_px[foot - 1])
    # The rows above are the shorter ones.
    top = foot - tall
    a, b = max(u0 - 2 * wide, first[top] + 1), min(u0 + 3 * wide, last[top] - 1)
    around = np.empty(tall * (b - a), np.float32)
    for j in range(tall):
        for u in range(a, b):
            around[j * (b - a) + u - a] = near[foot - 1 - j, u] - far[foot - 1 - j, u]
    bias = np.median(around)
    for j in range(tall):
        for u in range(a, b):
            k = j * (b - a) + u - a
            around[k] = (around[k] - bias) ** 2 * weight[foot - 1 - j, u]
    unrest = max(1.0, np.median(around) / CALM)
    misfits = np.zeros(len(BELOW))
    plain, honest = 0.0, 0.0
    for j in range(1, tall + 1):
        i = foot - j
        rise = d_foot - d_px[i]
        for u in range(u0, u0 + wide):
            w = weight[i, u]
            e0, e1 = near[i, u] - far[i, u], difference(near[i], far[i], u, rise)
            v = w * level_of(rise)
            plain += min(e0 * e0 * w, CLIP) - min(e1 * e1 * v, CLIP)
            honest -= min((e1 - bias) ** 2 * v, CLIP)
            for k in range(len(BELOW)):
                sunk = -BELOW[k][0] * rise - BELOW[k][1]
                e = difference(near[i], far[i], u, sunk) - bias
                misfits[k] += min(e * e * w * level_of(sunk), CLIP)
    honest += misfits.min()
    return honest / max(plain, 1e-6) / unrest, honest / (tall * wide) / unrest


@numba.njit(**MODE)
def difference(n, f, u, rise):  # type: ignore[no-untyped-def]
    """Return how a pixel differs from what stands `rise` pixels of disparity over the road."""
    whole = int(np.floor(rise))
    r = rise - whole
    return n[u] - (1 - r) * f[u - whole] - r * f[u - whole - 1]


@numba.njit(**MODE)
def level_of(rise):  # type: ignore[no-untyped-def]
    """Return what puts back the noise that interpolation averages away."""
    r = rise - np.floor(rise)
    return 1 / (1 - LINEAR * r * (1 - r))
