"""The kernels of `low_reference`, compiled: same names, same arguments, same numbers to rounding."""

import numba
import numpy as np

from roadblock.kernels.low_reference import ALIKE, CHUNK, CLIP, CORRELATED, LINEAR, TOLERANCE_PX

MODE = {"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {"reassoc", "contract", "nsz", "arcp"}}


@numba.njit(**MODE)
def warp(left, right, bin_px, rows, first, last, d_px, slope, middle, gain, tilt, near, far):  # type: ignore[no-untyped-def]
    """See `low_reference.warp`."""
    c = bin_px
    width = left.shape[1] // c
    a = np.zeros(width + 8, np.float32)
    b = np.zeros(width + 8, np.float32)
    scale = np.float32(1.0 / (c * c))
    for i in range(len(rows)):
        u0, u1 = first[i], last[i]
        if u1 <= u0:
            continue
        low = max(0, int(u0 - d_px[i] - abs(slope[i]) * (u1 - u0)) - 8)
        binned_row(left, rows[i] * c, c, max(0, u0 - 1), min(width, u1 + 1), scale, a)
        binned_row(right, rows[i] * c, c, low, min(width, u1 + 4), scale, b)
        n = near[i]
        for u in range(u0, u1):
            n[u] = np.float32(0.25) * (a[u - 1] + a[u + 1]) + np.float32(0.5) * a[u]
        f = far[i]
        for begin in range(u0, u1, CHUNK):
            end = min(begin + CHUNK, u1)
            # One shift a chunk: its disparity is linear, and a chunk is short.
            shift = -(d_px[i] + slope[i] * ((begin + end - 1) / 2 - middle))
            whole = int(np.floor(shift))
            t = shift - whole
            # Catmull-Rom, then the same 1-2-1 as on the left.
            k0 = np.float32(-0.5 * t + t * t - 0.5 * t * t * t)
            k1 = np.float32(1.0 - 2.5 * t * t + 1.5 * t * t * t)
            k2 = np.float32(0.5 * t + 2.0 * t * t - 1.5 * t * t * t)
            k3 = np.float32(-0.5 * t * t + 0.5 * t * t * t)
            q, h = np.float32(0.25), np.float32(0.5)
            s0, s1, s2 = q * k0, h * k0 + q * k1, q * k0 + h * k1 + q * k2
            s3, s4, s5 = q * k1 + h * k2 + q * k3, q * k2 + h * k3, q * k3
            r = b[begin + whole - 2 : end + whole + 4]
            w = f[begin:end]
            g0, g1 = np.float32(gain[i] + tilt * (begin - middle)), np.float32(tilt)
            for u in range(end - begin):
                w[u] = (g0 + g1 * np.float32(u)) * (
                    s0 * r[u] + s1 * r[u + 1] + s2 * r[u + 2] + s3 * r[u + 3] + s4 * r[u + 4] + s5 * r[u + 5]
                )


@numba.njit(**MODE)
def binned_row(image, row, c, u0, u1, scale, into):  # type: ignore[no-untyped-def]
    """Average c x c pixels of an image into columns u0 .. u1 of one binned row."""
    if c == 1:
        line = image[row]
        for u in range(u0, u1):
            into[u] = scale * np.float32(line[u])
    elif c == 2:
        one, two = image[row], image[row + 1]
        for u in range(u0, u1):
            total = np.int32(one[2 * u]) + one[2 * u + 1] + two[2 * u] + two[2 * u + 1]
            into[u] = scale * np.float32(total)
    else:
        for u in range(u0, u1):
            into[u] = 0
        for k in range(c):
            line = image[row + k]
            for u in range(u0, u1):
                total = np.int32(0)
                for m in range(c):
                    total += line[c * u + m]
                into[u] += scale * np.float32(total)


@numba.njit(**MODE)
def road_sums(near, far, first, last, sums):  # type: ignore[no-untyped-def]
    """See `low_reference.road_sums`."""
    sums[:] = 0
    strips, blocks = sums.shape[0], sums.shape[1]
    for i in range(len(first)):
        u0, u1 = first[i] + 1, last[i] - 1
        n, f = near[i], far[i]
        for k in range(blocks):
            a, b = u0 + (u1 - u0) * k // blocks, u0 + (u1 - u0) * (k + 1) // blocks
            add_block(n, f, a, b, sums[i * strips // len(first), k])


@numba.njit(**MODE)
def add_block(n, f, a, b, s):  # type: ignore[no-untyped-def]
    """Add the sums over columns a .. b of one row."""
    zero = np.float32(0)
    g1, e1, gg, ge, ee, n1, f1 = zero, zero, zero, zero, zero, zero, zero
    for u in range(a, b):
        e = n[u] - f[u]
        g = np.float32(0.25) * (n[u + 1] - n[u - 1] + f[u + 1] - f[u - 1])
        g1 += g
        e1 += e
        gg += g * g
        ge += g * e
        ee += e * e
        n1 += n[u]
        f1 += f[u]
    s[0] += max(b - a, 0)
    s[1] += g1
    s[2] += e1
    s[3] += gg
    s[4] += ge
    s[5] += ee
    s[6] += n1
    s[7] += f1


@numba.njit(**MODE)
def weigh(near, far, first, last, variance, weight, misfit):  # type: ignore[no-untyped-def]
    """See `low_reference.weigh`."""
    tolerance = np.float32(TOLERANCE_PX * TOLERANCE_PX)
    for i in range(len(first)):
        n, f, w, m = near[i], far[i], weight[i], misfit[i]
        v = np.float32(variance[i])
        for u in range(first[i] + 1, last[i] - 1):
            g = np.float32(0.5) * (n[u + 1] - n[u - 1])
            h = np.float32(0.5) * (f[u + 1] - f[u - 1])
            w[u] = np.float32(1) / (v + tolerance * max(g * g, h * h))
            e = n[u] - f[u]
            m[u] = min(e * e * w[u], np.float32(CLIP))


@numba.njit(**MODE)
def score(near, far, weight, misfit, first, last, d_px, feet, tall, wide, scores, heights):  # type: ignore[no-untyped-def]
    """See `low_reference.score`."""
    gained = np.zeros(near.shape[1], np.float32)
    changed = np.zeros(near.shape[1], np.float32)
    for k in range(len(feet)):
        foot = feet[k]
        u0, u1 = first[foot] + 1, last[foot] - 1
        half = wide[k] // 2
        scores[k, :] = 0
        heights[k, :] = 0
        if u1 - u0 < wide[k] + 8:
            continue
        gained[u0:u1] = 0
        changed[u0:u1] = 0
        d_foot = 0.5 * (d_px[foot] + d_px[foot - 1])
        done = 0
        noise = np.float32(0)
        for t in range(tall.shape[1]):
            for j in range(done + 1, tall[k, t] + 1):
                i = foot - j
                rise = d_foot - d_px[i]
                whole = int(np.floor(rise))
                r = np.float32(rise - whole)
                rest = np.float32(1) - r
                level = np.float32(1) / (np.float32(1) - np.float32(LINEAR) * r * rest)
                noise += np.float32(wide[k]) * (np.float32(1) - np.float32(alike(rise)))
                a = u0 + whole + 1
                n, w, m, s, c = near[i, a:u1], weight[i, a:u1], misfit[i, a:u1], gained[a:u1], changed[a:u1]
                f, f0, f1 = far[i, a:u1], far[i, a - whole : u1 - whole], far[i, a - whole - 1 : u1 - whole - 1]
                for u in range(u1 - a):
                    p = rest * f0[u] + r * f1[u]
                    e = n[u] - p
                    d = f[u] - p
                    s[u] += m[u] - min(e * e * w[u] * level, np.float32(CLIP))
                    c[u] += min(d * d * w[u] * level, np.float32(CLIP))
            done = tall[k, t]
            total = np.float32(0)
            change = np.float32(0)
            best, which = scores[k], heights[k]
            for u in range(u0, u0 + wide[k]):
                total += gained[u]
                change += changed[u]
            for u in range(u0, u1 - wide[k]):
                if total > 0 and change > noise:
                    value = total / np.float32(2 * CORRELATED) * np.sqrt((change - noise) / change)
                    if value > best[u + half]:
                        best[u + half] = value
                        which[u + half] = t
                total += gained[u + wide[k]] - gained[u]
                change += changed[u + wide[k]] - changed[u]


@numba.njit(**MODE)
def alike(shift_px):  # type: ignore[no-untyped-def]
    """Return the correlation of the noise of two smoothed pixels so far apart."""
    if shift_px >= 3:
        return 0.0
    i = int(shift_px)
    return ALIKE[i] + (shift_px - i) * (ALIKE[i + 1] - ALIKE[i])
