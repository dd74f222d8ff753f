"""What is concluded from what recognition measured, of all things of a frame in one call each."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.judge import (
    BLACK,
    BLACK_L,
    BROWN,
    CLEARANCE_M,
    CONTRAST,
    EDGE_PX,
    GRAY,
    HEADING_RAD,
    HEADING_SHARE,
    LEAST_HIGH_M,
    LEAST_SHARE,
    LIMIT,
    ORANGE,
    PINK,
    RED,
    ROAD_M,
    ROW_PX,
    SECOND_SHARE,
    SIDES_RATIO,
    SIZE_SHARE,
    SUREST_RAD,
    WHITE,
    WHITE_L,
    WIDTH_SHARE,
    YELLOW,
)
from roadblock.kernels.reference.recognize import HUES
from roadblock.kernels.simd import eight, load_reals, store_reals

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Codes = NDArray[np.int64]


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def judge_types(
    inputs: Floats,
    mean: Singles,
    per_spread: Singles,
    hidden: Singles,
    hidden_bias: Singles,
    output: Singles,
    output_bias: Singles,
    odds: Floats,
) -> None:
    """See `reference.judge.judge_types`."""
    n, m, h = len(inputs), len(mean), len(hidden_bias)
    scaled, limit = np.zeros((n + 3, m), np.float32), np.float32(LIMIT)  # for whole fours of things
    for k in range(n):
        for i in range(m):
            scaled[k, i] = min(max((np.float32(inputs[k, i]) - mean[i]) * per_spread[i], -limit), limit)
    inner = np.empty((n + 3, h), np.float32)
    for k in range(0, n, 4):
        for j in range(0, h - 15, 16):
            a0 = b0 = c0 = d0 = eight(0.0)
            a1 = b1 = c1 = d1 = eight(0.0)
            for i in range(m):
                w0, w1 = load_reals(hidden, i, j), load_reals(hidden, i, j + 8)
                a, b, c, d = (
                    eight(scaled[k, i]),
                    eight(scaled[k + 1, i]),
                    eight(scaled[k + 2, i]),
                    eight(scaled[k + 3, i]),
                )
                a0, a1, b0, b1 = a0 + a * w0, a1 + a * w1, b0 + b * w0, b1 + b * w1
                c0, c1, d0, d1 = c0 + c * w0, c1 + c * w1, d0 + d * w0, d1 + d * w1
            store_reals(inner, k, j, a0)
            store_reals(inner, k, j + 8, a1)
            store_reals(inner, k + 1, j, b0)
            store_reals(inner, k + 1, j + 8, b1)
            store_reals(inner, k + 2, j, c0)
            store_reals(inner, k + 2, j + 8, c1)
            store_reals(inner, k + 3, j, d0)
            store_reals(inner, k + 3, j + 8, d1)
    for k in range(n):
        for j in range(h // 16 * 16, h):
            inner[k, j] = 0.0
            for i in range(m):
                inner[k, j] += scaled[k, i] * hidden[i, j]
        for j in range(h):
            inner[k, j] = max(inner[k, j] + hidden_bias[j], np.float32(0.0))
    classes, padded = len(output_bias), (len(output_bias) + 7) // 8 * 8
    ends, scores = np.zeros((h, padded), np.float32), np.empty((n + 3, padded), np.float32)
    ends[:, :classes] = output
    for k in range(0, n, 4):
        for j in range(0, classes, 8):
            a0 = b0 = c0 = d0 = eight(0.0)
            for i in range(h):
                w0 = load_reals(ends, i, j)
                a0, b0 = a0 + eight(inner[k, i]) * w0, b0 + eight(inner[k + 1, i]) * w0
                c0, d0 = c0 + eight(inner[k + 2, i]) * w0, d0 + eight(inner[k + 3, i]) * w0
            store_reals(scores, k, j, a0)
            store_reals(scores, k + 1, j, b0)
            store_reals(scores, k + 2, j, c0)
            store_reals(scores, k + 3, j, d0)
    for k in range(n):
        highest, total = np.float32(-np.inf), 0.0
        for c in range(classes):
            scores[k, c] += output_bias[c]
            highest = max(highest, scores[k, c])
        for c in range(classes):
            odds[k, c] = np.exp(np.float64(scores[k, c] - highest))
            total += odds[k, c]
        for c in range(classes):
            odds[k, c] /= total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def hue_name(name: int, lightness: float, a: float, b: float) -> int:
    """See `reference.judge.hue_name`."""
    weak = np.hypot(a, b) < 0.62 * lightness + 4 and lightness < 55
    if (name in (ORANGE, YELLOW) and (weak or lightness < 33)) or (name == RED and weak and b > 0.6 * a):
        return BROWN
    if name in (RED, PINK):
        return PINK if lightness > 62 else RED
    return name


@numba.njit(cache=True, nogil=True, error_model="numpy")
def name_colors(figures: Floats, codes: Codes, lab: Floats) -> None:
    """See `reference.judge.name_colors`."""
    for k in range(len(figures)):
        row = figures[k]
        first, second = 0, -1
        for hue in range(1, HUES):
            if row[4 * hue] > row[4 * first]:
                first, second = hue, first
            elif second < 0 or row[4 * hue] > row[4 * second]:
                second = hue
        grey, light = row[4 * HUES], row[4 * HUES + 1]
        codes[k, 1] = -1
        at = 4 * first + 1
        if row[4 * first] < min(LEAST_SHARE, grey):
            at = 4 * HUES + 1
            codes[k, 0] = BLACK if light < BLACK_L else WHITE if light > WHITE_L else GRAY
        else:
            codes[k, 0] = hue_name(first, row[at], row[at + 1], row[at + 2])
            if row[4 * second] >= SECOND_SHARE:
                other = hue_name(second, row[4 * second + 1], row[4 * second + 2], row[4 * second + 3])
                codes[k, 1] = other if other != codes[k, 0] else -1
            elif grey >= 2 * SECOND_SHARE and light > WHITE_L:
                codes[k, 1] = WHITE
        for c in range(3):
            lab[k, c] = row[at + c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def size_things(
    edges: Floats,
    u_px: Floats,
    range_m: Floats,
    sigma_m: Floats,
    twin: Floats,
    road: Floats,
    sizes: Floats,
    sigmas: Floats,
) -> None:
    """See `reference.judge.size_things`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    for k in range(len(edges)):
        z = range_m[k]
        per_px = z / f
        sizes[k, 0] = max(edges[k, 1] - edges[k, 0], per_px)
        if n_x == n_x:
            x, y = (u_px[k] - cx) * per_px - baseline / 2, (edges[k, 2] - cy) * per_px
            sizes[k, 1] = max(n_x * x + n_y * y + n_z * z + height_m - bend * z * z, LEAST_HIGH_M)
        relative = (sigma_m[k] / z) ** 2 + SIZE_SHARE**2
        sigmas[k, 0] = np.sqrt(2 * (EDGE_PX * per_px) ** 2 + (relative + WIDTH_SHARE**2) * sizes[k, 0] ** 2)
        sigmas[k, 1] = np.sqrt((ROW_PX * per_px) ** 2 + ROAD_M**2 + relative * sizes[k, 1] ** 2)
        sigmas[k, 2] = np.hypot(2 * sigma_m[k], 0.1 * sizes[k, 2])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lift_contours(
    contours: NDArray[np.int32], counts: NDArray[np.int32], longest_end_m: Floats, range_m: Floats, f_px: float
) -> None:
    """See `reference.judge.lift_contours`."""
    for k in range(len(counts)):
        if longest_end_m[k] > 0:
            rows = contours[k, : counts[k], 1]
            low = rows.max()
            last = low - min(int(np.rint(CLEARANCE_M * f_px / range_m[k])), (low - rows.min()) // 2)
            for i in range(len(rows)):
                rows[i] = min(rows[i], last)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_outlines(
    figures: Floats,
    longest_end_m: Floats,
    sigma_m: Floats,
    road: Floats,
    mount: Floats,
    corners: Floats,
    headings: Floats,
) -> None:
    """See `reference.judge.place_outlines`."""
    n_x, n_y, n_z, height_m, bend = road
    for k in range(len(figures)):
        turn, front, back, low, high, best, mean = figures[k]
        c, s = np.cos(turn), np.sin(turn)
        for i in range(4):
            along, across = front if i < 2 else back, low if i in (0, 3) else high
            x, z = c * across + s * along, c * along - s * across
            y = (n_x * x + n_z * z + height_m - bend * z * z) / -n_y if n_x == n_x else 0.0
            for axis in range(2):
                corners[k, i, axis] = mount[axis, 0] * x + mount[axis, 1] * y + mount[axis, 2] * z + mount[axis, 3]
        long_m, wide_m, is_vehicle = back - front, high - low, longest_end_m[k] > 0
        longer, shorter = max(long_m, wide_m), min(long_m, wide_m)
        sigma = np.hypot(HEADING_RAD, HEADING_SHARE * sigma_m[k] / max(longer, 0.1))
        sure = sigma < SUREST_RAD and best < (1 - CONTRAST) * mean and (is_vehicle or longer >= SIDES_RATIO * shorter)
        headings[k, 0] = headings[k, 1] = np.nan
        if sure:
            # The second axis is its direction: the longer one, or across a vehicle's end.
            second = (long_m <= wide_m) != (is_vehicle and longer <= longest_end_m[k])
            angle = turn + np.pi / 2 * second
            ahead = mount[0, 0] * np.sin(angle) + mount[0, 2] * np.cos(angle)
            aside = mount[1, 0] * np.sin(angle) + mount[1, 2] * np.cos(angle)
            headings[k, 0] = (np.arctan2(aside, ahead) + np.pi / 2) % np.pi - np.pi / 2
            headings[k, 1] = sigma
