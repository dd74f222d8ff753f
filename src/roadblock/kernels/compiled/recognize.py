"""What recognition measures of every region of a frame, in one call: figures of shape, looks and surroundings."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.street import quantile_of
from roadblock.kernels.reference.recognize import (
    ASIDE_M,
    BACK,
    BACKGROUND,
    BEHIND_M,
    BESIDE_PX,
    BODY_SHARE,
    CELLS,
    CELLS_HIGH,
    CELLS_WIDE,
    COLUMNS,
    EDGE_LEVELS,
    END_SHARE,
    FAR_M,
    FIGURES,
    FOOT_LOW_M,
    FOOT_M,
    GAIN_LIMITS,
    GREY_LEAST,
    GREY_SHARE,
    GRID,
    HEADINGS,
    HUE_ENDS_DEG,
    HUES,
    INNER,
    INWARD_PX,
    INWARD_SHARE,
    LAYERS,
    LIKELY_PX,
    LOOKS,
    OUTWARD_PX,
    OWN,
    PATCH_STEP,
    PITCH_CELLS,
    POINTS,
    REACH_PX,
    ROAD_L,
    ROAD_ROWS,
    ROWS,
    SEEN_THROUGH,
    SIDES,
    STRAY_FROM,
    STRAY_ROWS,
    TOGETHER,
    TOGETHER_M,
    TOGETHER_SHARE,
    TOPS,
    TOUCH_PX,
    TURNS,
    UNLIKELY,
    WIDE,
)
from roadblock.kernels.simd import either, load_bytes, reals_of, store_reals, subtract, zeros

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Singles = NDArray[np.float32]
Units = NDArray[np.int32]
Gray = NDArray[np.uint8]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pitch_of(uvd: Floats) -> float:
    """See `reference.recognize.pitch_of`."""
    pitch = np.inf
    for i in range(1, len(uvd)):
        step = uvd[i, 0] - uvd[i - 1, 0]
        if uvd[i, 1] == uvd[i - 1, 1] and step > 0:
            pitch = min(pitch, step)
    return pitch if pitch < np.inf else 4.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_shape(
    cells: Floats, n: int, pitch: float, count: int, twin: Floats, width_px: float, scratch: Floats, out: Floats
) -> None:
    """See `reference.recognize.measure_shape`; rows of `cells` are u, v, d, z and height."""
    f, fb = twin[0], twin[0] * twin[3]
    for i in range(n):
        scratch[i] = cells[3, i]
    near, far = quantile_of(scratch[:n], 0.1), quantile_of(scratch[:n], 0.9)
    for i in range(n):
        scratch[i] = cells[4, i]
    top, low = quantile_of(scratch[:n], 0.98), quantile_of(scratch[:n], 0.05)
    u0, u1, v0, v1 = cells[0, 0], cells[0, 0], cells[1, 0], cells[1, 0]
    for i in range(n):
        u0, u1 = min(u0, cells[0, i]), max(u1, cells[0, i])
        v0, v1 = min(v0, cells[1, i]), max(v1, cells[1, i])
    # The surface as a plane of disparities, and what does not lie on it.
    first, x, y, d, xx, xy, yy, xd, yd, dd, flat = cells[2, 0], 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        a, b, c = cells[0, i] - u0, cells[1, i] - v0, cells[2, i] - first
        x, y, d = x + a, y + b, d + c
        xx, xy, yy, xd, yd, dd = xx + a * a, xy + a * b, yy + b * b, xd + a * c, yd + b * c, dd + c * c
        flat += abs(cells[3, i] - near) < 0.3
    x, y, d = x / n, y / n, d / n
    u0, u1, v0, v1 = u0 - pitch / 2, u1 + pitch / 2, v0 - 2.0, v1 + 2.0
    tall, wide, high = max(top, 0.05), u1 - u0, v1 - v0
    width = wide / f * near
    xx, yy, xy = (xx / n - x * x) / wide**2, (yy / n - y * y) / high**2, (xy / n - x * y) / (wide * high)
    xd, yd, dd = (xd / n - x * d) / wide, (yd / n - y * d) / high, dd / n - d * d
    across, up, determinant = 0.0, 0.0, xx * yy - xy * xy
    if determinant >= 1e-9:
        across, up = (yy * xd - xy * yd) / determinant, (xx * yd - xy * xd) / determinant
    rms = np.sqrt(max(dd - 2 * (across * xd + up * yd) + across * across * xx + 2 * across * up * xy + up * up * yy, 0))
    per_px = near * near / fb
    out[0], out[1], out[2], out[3] = np.log(near), np.log(width), np.log(tall), low
    out[4], out[5] = np.log(far - near + 0.1), np.log(per_px)
    out[6], out[7] = np.log(width / tall), count * pitch * 4.0 / (wide * high)
    out[8], out[9] = np.log(rms + 0.02), np.log(rms * per_px + 0.02)
    out[10] = min(abs(across) * per_px / max(width, 0.1), 4.0)
    out[11] = min(max(up * per_px / tall, -4.0), 4.0)
    out[12] = flat / n
    out[13] = (u0 < 6) * 1.0 + (u1 > width_px - 6)
    out[14] = (v0 < 6) * 1.0
    out[15] = np.log(count)
    # How high it is over its columns, how wide in its layers, how much in both; and how far behind its nearest face.
    out[TOPS:OWN] = 0.0
    left, right = scratch[:LAYERS], scratch[LAYERS : 2 * LAYERS]
    columns, layers = scratch[2 * LAYERS : 2 * LAYERS + COLUMNS], scratch[2 * LAYERS + COLUMNS : 3 * LAYERS + COLUMNS]
    left[:], right[:], columns[:], layers[:] = np.inf, -np.inf, 0.0, 0.0
    per_column, per_layer = COLUMNS / wide, LAYERS / tall
    for i in range(n):
        u, height = cells[0, i], cells[4, i]
        c = min(int((u - u0) * per_column), COLUMNS - 1)
        m = min(max(int(height * per_layer), 0), LAYERS - 1)
        behind = min(max(cells[3, i] - near, 0.0), BEHIND_M)
        out[TOPS + c] = max(out[TOPS + c], height)
        left[m], right[m] = min(left[m], u), max(right[m], u)
        out[GRID + m * COLUMNS + c] += 1.0
        columns[c] += 1.0
        layers[m] += 1.0
        out[BACK + c] += behind
        out[BACK + COLUMNS + m] += behind
    for c in range(COLUMNS):
        out[TOPS + c] = min(out[TOPS + c] / tall, 1.2)
        out[BACK + c] /= max(columns[c], 1.0)
    for m in range(LAYERS):
        out[WIDE + m] = (right[m] - left[m] + pitch) / wide if layers[m] > 0 else 0.0
        out[BACK + COLUMNS + m] /= max(layers[m], 1.0)
    for k in range(GRID, BACK):
        out[k] *= COLUMNS * LAYERS / n


ACROSS_LOOKS = CELLS_WIDE * PATCH_STEP
ONE = np.uint64(1)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def add_steepness(steps: Units, sums: Singles) -> None:
    """Add (2, n) gradients, to the right and down, to (4, n) sums of upright, slanted, level and other-slanted ones."""
    for j in range(ACROSS_LOOKS):
        gx, gy = steps[0, j], steps[1, j]
        ax, ay = np.int32(10000) * abs(gx), np.int32(10000) * abs(gy)
        size = np.sqrt(np.float32(gx * gx + gy * gy))
        is_upright, is_level = ay < np.int32(4142) * abs(gx), ax < np.int32(4142) * abs(gy)
        slanted = np.float32(0.0) if is_upright or is_level else size
        one = slanted if gx * gy > 0 else np.float32(0.0)
        sums[0, j] += size if is_upright else np.float32(0.0)
        sums[1, j] += one
        sums[2, j] += size if is_level else np.float32(0.0)
        sums[3, j] += slanted - one


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_looks(
    half: Gray, u0: float, v0: float, u1: float, v1: float, across: NDArray[np.uint64], out: Floats
) -> None:
    """See `reference.recognize.measure_looks`; `across` is overwritten."""
    rows, columns = half.shape
    high = CELLS_HIGH * PATCH_STEP
    for j in range(ACROSS_LOOKS):
        across[j] = min(max(int((u0 + (j + 0.5) * (u1 - u0) / ACROSS_LOOKS) / 2), 1), columns - 2)
    steps, sums = np.empty((2, ACROSS_LOOKS), np.int32), np.empty((TURNS, ACROSS_LOOKS), np.float32)
    total = 0.0
    for band in range(CELLS_HIGH):
        sums[:] = 0.0
        for i in range(band * PATCH_STEP, (band + 1) * PATCH_STEP):
            y = min(max(int((v0 + (i + 0.5) * (v1 - v0) / high) / 2), 1), rows - 2)
            above, here, below = half[y - 1], half[y], half[y + 1]
            for j in range(ACROSS_LOOKS):
                x = across[j]
                steps[0, j] = np.int32(here[x + ONE]) - np.int32(here[x - ONE])
                steps[1, j] = np.int32(below[x]) - np.int32(above[x])
            add_steepness(steps, sums)
        for cell in range(CELLS_WIDE):
            for turn in range(TURNS):
                size = 0.0
                for j in range(cell * PATCH_STEP, (cell + 1) * PATCH_STEP):
                    size += np.float64(sums[turn, j])
                out[(band * CELLS_WIDE + cell) * TURNS + turn] = size
                total += size
    count, bins = high * ACROSS_LOOKS, CELLS_HIGH * CELLS_WIDE * TURNS
    for k in range(bins):
        out[k] = np.sqrt(out[k] / (total + count))
    out[bins] = np.log(total / count + 1.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_beside(
    u0: float, u1: float, range_m: float, f_px: float, free_u: Floats, free_m: Floats, out: Floats
) -> None:
    """See `reference.recognize.measure_beside`."""
    n = len(free_u)
    step = (free_u[n - 1] - free_u[0]) / (n - 1) if n > 1 else 1.0
    start = free_u[0] if n else 0.0
    for side in range(2):
        first = (u0 - BESIDE_PX - start) / step if side == 0 else (u1 + BESIDE_PX - start) / step
        at = int(np.floor(first)) if side == 0 else int(np.ceil(first))
        way = -1 if side == 0 else 1
        beyond, seen, wide, begun = 0.0, 0, 0.0, True
        for k in range(SIDES):
            column = at + way * k
            if column < 0 or column >= n:
                break
            room = free_m[column] - range_m
            if room == room:
                seen += 1
                beyond += min(max(room, -FAR_M), FAR_M)
            if begun and room > 0.5:
                wide += step / f_px * range_m
            elif room == room:
                begun = False
        out[2 * side] = beyond / seen if seen else 0.0
        out[2 * side + 1] = min(wide, FAR_M)
        for k in range(len(ASIDE_M)):
            place = ((u0 if side == 0 else u1) + way * ASIDE_M[k] * f_px / range_m - start) / step + 0.5
            column = int(place) if place < n else n
            room = free_m[column] - range_m if 0 <= column < n else np.nan
            out[4 + side * len(ASIDE_M) + k] = min(max(room, -FAR_M), FAR_M) if room == room else 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def grow_box(boxes: Floats, near: Floats, k: int, taken: NDArray[np.bool_], box: Floats) -> int:
    """See `reference.recognize.grow_box`."""
    reach = max(TOGETHER_M, TOGETHER_SHARE * near[k])
    taken[:] = False
    taken[k] = True
    for c in range(4):
        box[c] = boxes[k, c]
    count, grown = 1, True
    while grown:
        grown = False
        for j in range(len(boxes)):
            if taken[j] or abs(near[j] - near[k]) > reach:
                continue
            across = min(box[2], boxes[j, 2]) - max(box[0], boxes[j, 0])
            up = min(box[3], boxes[j, 3]) - max(box[1], boxes[j, 1])
            if across < -TOUCH_PX or up < -TOUCH_PX or max(across, up) <= 0:
                continue
            taken[j], grown = True, True
            count += 1
            box[0], box[1] = min(box[0], boxes[j, 0]), min(box[1], boxes[j, 1])
            box[2], box[3] = max(box[2], boxes[j, 2]), max(box[3], boxes[j, 3])
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def describe_things(
    half: Gray,
    uvd: Floats,
    bounds: NDArray[np.int32],
    twin: Floats,
    road: Floats,
    size_px: Floats,
    free_u: Floats,
    free_m: Floats,
    figures: Floats,
) -> None:
    """See `reference.recognize.describe_things`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    things = len(bounds) - 1
    scratch, some, across = np.empty(CELLS), np.empty((5, CELLS)), np.empty(ACROSS_LOOKS, np.uint64)
    boxes, near, box = np.empty((things, 4)), np.empty(things), np.empty(4)
    for k in range(things):
        begin, count = int(bounds[k]), int(bounds[k + 1] - bounds[k])
        n = min(count, CELLS)
        u0, u1, v0, v1, lowest = np.inf, -np.inf, np.inf, -np.inf, -np.inf
        for s in range(n):
            i = begin + (s * count // n if n < count else s)
            u, v, d = uvd[i, 0], uvd[i, 1], uvd[i, 2]
            z = f * baseline / d
            x, y = (u - cx) / f * z - baseline / 2, (v - cy) / f * z
            some[0, s], some[1, s], some[2, s], some[3, s] = u, v, d, z
            some[4, s] = n_x * x + n_y * y + n_z * z + height_m - bend * z * z if n_x == n_x else -y
            lowest = max(lowest, y)
            u0, u1, v0, v1 = min(u0, u), max(u1, u), min(v0, v), max(v1, v)
        if n_x != n_x:
            some[4, :n] += lowest
        pitch = pitch_of(uvd[begin : begin + min(count, PITCH_CELLS)])
        measure_shape(some, n, pitch, count, twin, size_px[0], scratch, figures[k])
        # What stands on the road is seen down to it.
        u0, u1, v0, v1 = u0 - 2, u1 + 2, v0 - 2, v1 + 2
        near[k] = np.exp(figures[k, 0])
        if figures[k, 3] < FOOT_LOW_M:
            v1 = min(v1 + max(figures[k, 3], 0.0) * f / near[k], size_px[1])
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = u0, v0, u1, v1
        measure_looks(half, u0, v0, u1, v1, across, figures[k, OWN : OWN + LOOKS])
        measure_beside(u0, u1, near[k], f, free_u, free_m, figures[k, OWN + LOOKS : TOGETHER])
    taken = np.empty(things, np.bool_)
    for k in range(things):
        at = TOGETHER
        pieces = grow_box(boxes, near, k, taken, box)
        wide, tall = (box[2] - box[0]) / f * near[k], (box[3] - box[1]) / f * near[k]
        figures[k, at], figures[k, at + 1] = np.log(wide), np.log(tall)
        figures[k, at + 2] = np.log(pieces)
        figures[k, at + 3] = (boxes[k, 2] - boxes[k, 0]) * (boxes[k, 3] - boxes[k, 1])
        figures[k, at + 3] /= (box[2] - box[0]) * (box[3] - box[1])
        figures[k, at + 4] = (boxes[k, 1] - box[1]) / (box[3] - box[1])
        at += 5
        if pieces > 1:
            measure_looks(half, box[0], box[1], box[2], box[3], across, figures[k, at : at + LOOKS])
        else:
            figures[k, at : at + LOOKS] = figures[k, OWN : OWN + LOOKS]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pick_colors(
    colors: NDArray[np.uint8], uvd: Floats, bounds: NDArray[np.int32], step_px: int, samples: NDArray[np.uint8]
) -> None:
    """See `reference.recognize.pick_colors`."""
    last_row, last_column = colors.shape[0] - 1, colors.shape[1] - 1
    own, step = samples.shape[1] - BACKGROUND, float(step_px)  # whole numbers are divided as floats: much faster
    for k in range(len(samples)):
        a, n = int(bounds[k]), int(bounds[k + 1] - bounds[k])
        left, right = last_column, 0
        end, middle = a, 0.0
        for s in range(own):
            i = a + int(s * n / own)
            u, v = uvd[i, 0], uvd[i, 1]
            if i >= end:  # the first one of another row
                begin, end = i, i + 1
                while begin > a and uvd[begin - 1, 1] == v:
                    begin -= 1
                while end < a + n and uvd[end, 1] == v:
                    end += 1
                middle = (uvd[begin, 0] + uvd[end - 1, 0]) / 2
            row, column = min(int(v / step), last_row), min(int(u / step), last_column)
            left, right = min(left, column), max(right, column)
            column = min(int((middle + INNER * (u - middle)) / step), last_column)
            for c in range(3):
                samples[k, s, c] = colors[row, column, c]
        for s in range(BACKGROUND):
            i = a + s * n // BACKGROUND
            row, away = min(int(uvd[i, 1] / step), last_row), 2 + (s >> 1 & 3)
            column = max(left - away, 0) if s & 1 else min(right + away, last_column)
            for c in range(3):
                samples[k, own + s, c] = colors[row, column, c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pick_road(colors: NDArray[np.uint8], samples: NDArray[np.uint8]) -> None:
    """See `reference.recognize.pick_road`."""
    rows, columns = colors.shape[:2]
    count = len(samples)
    for s in range(count):
        i, j = s % ROAD_ROWS, s // ROAD_ROWS
        row = int(rows * (0.75 + 0.2 * (i + 0.5) / ROAD_ROWS))
        column = int(columns * (0.25 + 0.5 * (j + 0.5) * ROAD_ROWS / count))
        for c in range(3):
            samples[s, c] = colors[row, column, c]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def middle_color(colors: NDArray[np.uint8], out: Floats) -> None:
    """See `reference.recognize.middle_color`."""
    counts = np.zeros((256, 3), np.int32)
    for s in range(len(colors)):
        for c in range(3):
            counts[colors[s, c], c] += 1
    for c in range(3):
        level, below = 0, counts[0, c]
        while below <= len(colors) // 2:
            level += 1
            below += counts[level, c]
        out[c] = level


END_COS, END_SIN = np.cos(np.radians(HUE_ENDS_DEG)), np.sin(np.radians(HUE_ENDS_DEG))
UPPER = int(np.searchsorted(HUE_ENDS_DEG, 180))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def hue_of(a: float, b: float) -> int:
    """Return in which hue of `HUE_ENDS_DEG` the angle of a and b lies, without working it out."""
    name = 0
    if b >= 0:
        for k in range(UPPER):
            name += END_COS[k] * b >= END_SIN[k] * a
        return name
    for k in range(UPPER, HUES):
        name += END_COS[k] * b >= END_SIN[k] * a
    name += UPPER
    return name if name < HUES else 0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def tally_colors(lab: NDArray[np.uint8], road_lab: Floats, out: Floats) -> None:
    """See `reference.recognize.tally_colors`."""
    own = lab.shape[1] - BACKGROUND
    grey = np.empty(own)
    gain = min(max((ROAD_L + 16) / (road_lab[0] + 16), GAIN_LIMITS[0]), GAIN_LIMITS[1])
    per_light = 1 / max(road_lab[0], 1.0)
    behind = np.empty(HUES)
    for k in range(len(lab)):
        out[k] = 0.0
        behind[:] = 0.0
        greys, lightness, squares = 0, 0.0, 0.0
        for s in range(own + BACKGROUND):
            light = lab[k, s, 0] * (100 / 255)
            tint = min(light * per_light, 1.5)
            a = gain * (lab[k, s, 1] - 128.0 - tint * road_lab[1])
            b = gain * (lab[k, s, 2] - 128.0 - tint * road_lab[2])
            light = max((light + 16) * gain - 16, 0.0)
            if s < own:
                lightness += light
                squares += light * light
            least = GREY_LEAST + GREY_SHARE * light
            if a * a + b * b < least * least:
                if s < own:
                    grey[greys] = light
                    greys += 1
                    out[k, 4 * HUES + 2] += a
                    out[k, 4 * HUES + 3] += b
                continue
            name = hue_of(a, b)
            if s >= own:
                behind[name] += 1.0
                continue
            out[k, 4 * name] += 1
            out[k, 4 * name + 1] += light
            out[k, 4 * name + 2] += a
            out[k, 4 * name + 3] += b
        for name in range(HUES):
            per_one = 1 / max(out[k, 4 * name], 1.0)
            for c in range(1, 4):
                out[k, 4 * name + c] *= per_one
            out[k, 4 * name] = max(out[k, 4 * name] / own - SEEN_THROUGH * behind[name] / BACKGROUND, 0.0)
        out[k, 4 * HUES] = greys / own
        out[k, 4 * HUES + 1] = quantile_of(grey[:greys], BODY_SHARE) if greys else np.nan
        out[k, 4 * HUES + 2] /= max(greys, 1)
        out[k, 4 * HUES + 3] /= max(greys, 1)
        mean = lightness / own
        out[k, 4 * HUES + 4] = mean
        out[k, 4 * HUES + 5] = np.sqrt(max(squares / own - mean * mean, 0.0))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sum_up_colors(colors: Floats, out: Floats) -> None:
    """See `reference.recognize.sum_up_colors`."""
    for k in range(len(colors)):
        row = colors[k]
        out[k, FIGURES] = row[4 * 4]
        out[k, FIGURES + 1] = row[4 * 1] + row[4 * 2]
        out[k, FIGURES + 2] = row[4 * 3]
        out[k, FIGURES + 3] = row[4 * 5] + row[4 * 6]
        out[k, FIGURES + 4] = row[4 * HUES]
        out[k, FIGURES + 5] = row[4 * HUES + 4] / 25
        out[k, FIGURES + 6] = row[4 * HUES + 5] / 25
        out[k, FIGURES + 7] = 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def steepest(steps: Floats, middle: float, reach: float, first: int, least: float) -> float:
    """See `reference.recognize.steepest`."""
    best, at = least, -1
    for k in range(len(steps)):
        step = steps[k] * (1 - 0.5 * abs(first + k - middle) / reach)
        if step > best:
            best, at = step, k
    if at < 0:
        return middle
    before = steps[at - 1] if at > 0 else 0.0
    after = steps[at + 1] if at + 1 < len(steps) else 0.0
    bend = 2 * steps[at] - before - after
    return first + at + (min(max((after - before) / (2 * bend), -0.5), 0.5) if bend > 0 else 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def steps_at(half: Gray, row: int, start: int) -> Any:
    """Return how much grey levels change across eight columns of a row from `start` on."""
    left, right = load_bytes(half, row, start - 1, zeros(8)), load_bytes(half, row, start + 1, zeros(8))
    return reals_of(either(subtract(left, right), subtract(right, left)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def edge_near(half: Gray, row: int, cells_end: float, way: int, inward: float, scratch: Singles) -> float:
    """See `reference.recognize.edge_near`; `scratch` (1, 8) is overwritten: it looks at no more columns."""
    rows, columns = half.shape
    begin, end = cells_end - way * OUTWARD_PX / 2, cells_end + way * inward
    first, last = max(int(np.ceil(min(begin, end))), 1), min(int(np.floor(max(begin, end))), columns - 2)
    likely = cells_end + way * min(LIKELY_PX / 2, inward)
    start = min(first, columns - 9)
    if start < 1:  # an image of a few columns
        return likely
    steps, seen = steps_at(half, row, start), 1
    if row > 0:
        steps, seen = steps + steps_at(half, row - 1, start), seen + 1
    if row < rows - 1:
        steps, seen = steps + steps_at(half, row + 1, start), seen + 1
    store_reals(scratch, 0, 0, steps)
    best, at = EDGE_LEVELS * seen, -1
    for x in range(first, last + 1):
        step, far = float(scratch[0, x - start]), 1 + UNLIKELY * abs(x - likely)
        if step > best * far:
            best, at = step / far, x
    if at < 0:
        return likely
    before = float(scratch[0, at - 1 - start]) if at > first else 0.0
    after = float(scratch[0, at + 1 - start]) if at < last else 0.0
    bend = 2 * float(scratch[0, at - start]) - before - after
    return at + (min(max((after - before) / (2 * bend), -0.5), 0.5) if bend > 0 else 0.0)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def top_near(half: Gray, middle: float, left: float, right: float, reach: float) -> float:
    """See `reference.recognize.top_near`."""
    rows, columns = half.shape
    first, last = max(int(np.ceil(middle - reach)), 1), min(int(np.floor(middle + reach)), rows - 2)
    x0, x1 = max(int(left), 0), min(int(right), columns - 1)
    steps = np.zeros(max(last - first + 1, 0))
    for y in range(first, last + 1):
        for x in range(x0, x1 + 1):
            steps[y - first] += abs(float(half[y + 1, x]) - float(half[y - 1, x]))
    return steepest(steps, middle, reach, first, EDGE_LEVELS * max(x1 - x0 + 1, 1))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def least_but(values: Floats, strays: int, sign: int) -> float:
    """Return the least of the values times a sign, but for so many strays."""
    least = np.full(strays + 1, np.inf)
    for value in values:
        rest = sign * value
        for k in range(strays + 1):
            if rest < least[k]:
                least[k], rest = rest, least[k]
    return float(least[strays])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def trace_thing(half: Gray, uvd: Floats, feet: Floats, box: Floats, edges: Floats, contour: NDArray[np.int32]) -> int:
    """See `reference.recognize.trace_thing`.

    `feet` (n,) is down to which row each cell is seen; `box` holds the principal column, the baseline and the lower
    end of the thing's box.
    """
    n = len(uvd)
    pitch = pitch_of(uvd[:PITCH_CELLS])
    v0, v1 = np.inf, -np.inf
    for i in range(n):
        v0, v1 = min(v0, uvd[i, 1] - 2), max(v1, feet[i])
    v0, v1 = max(v0, 0.0), min(v1, box[2])
    # From the cells' edges to the image's, first at the upper end.
    reach = (pitch / 2 + REACH_PX) / 2
    if v0 > 4:
        begin, end = np.inf, -np.inf
        for i in range(n):
            if uvd[i, 1] - 2 < v0 + 4:
                begin, end = min(begin, uvd[i, 0] - pitch / 2 + 2), max(end, uvd[i, 0] + pitch / 2 - 2)
        v0 = min(2 * top_near(half, (v0 - 0.5) / 2, begin / 2, end / 2, reach) + 0.5, v1 - 2)
    top = v0
    rows = min(max(int((v1 - v0) / 2), 2), ROWS)
    step, per_row = (v1 - v0) / rows, 1 / ((v1 - v0) / rows)
    left, right = np.full(rows, np.inf), np.full(rows, -np.inf)
    for i in range(n):
        first = max(int((uvd[i, 1] - 2 - v0) * per_row + 0.5), 0)
        last = min(max(int((feet[i] - v0) * per_row - 0.5), first), rows - 1)
        for k in range(first, last + 1):
            left[k], right[k] = min(left[k], uvd[i, 0] - pitch / 2), max(right[k], uvd[i, 0] + pitch / 2)
    # Rows without a cell lie between those around them.
    known = -1
    for k in range(rows):
        if left[k] < np.inf:
            for m in range(known + 1, k):
                share = (m - known) / (k - known) if known >= 0 else 1.0
                a = known if known >= 0 else k
                left[m] = left[a] + share * (left[k] - left[a])
                right[m] = right[a] + share * (right[k] - right[a])
            known = k
    for m in range(known + 1, rows):
        left[m], right[m] = left[known], right[known]
    sharp_left, sharp_right, scratch = np.empty(rows), np.empty(rows), np.empty((1, 8), np.float32)
    for k in range(rows):
        y = min(int((v0 + (k + 0.5) * step) / 2), half.shape[0] - 1)
        inward = min(INWARD_PX, INWARD_SHARE * (right[k] - left[k])) / 2
        sharp_left[k] = 2 * edge_near(half, y, (left[k] - 0.5) / 2, 1, inward, scratch) + 0.5
        sharp_right[k] = 2 * edge_near(half, y, (right[k] - 0.5) / 2, -1, inward, scratch) + 0.5
    m = 0
    lefts, rights = np.empty(rows), np.empty(rows)
    for k in range(rows):
        a, b = max(k - 1, 0), min(k + 1, rows - 1)
        u = max(min(sharp_left[a], sharp_left[k]), min(max(sharp_left[a], sharp_left[k]), sharp_left[b]))
        w = max(min(sharp_right[a], sharp_right[k]), min(max(sharp_right[a], sharp_right[k]), sharp_right[b]))
        w = max(w, u + 1)
        contour[k, 0] = int(np.ceil(u))
        contour[2 * rows - 1 - k, 0] = int(np.floor(w))
        v = int(np.rint(top if k == 0 else v1 if k == rows - 1 else v0 + (k + 0.5) * step))
        contour[k, 1] = v
        contour[2 * rows - 1 - k, 1] = v
        lefts[k], rights[k] = u, w
        m += 2
    # The outermost rows may be stray; how far away an end is, the cells there tell.
    stray = rows // STRAY_ROWS
    ends = least_but(lefts, stray, 1), -least_but(rights, stray, -1)
    margin = max(1.5 * pitch, END_SHARE * (ends[1] - ends[0]))
    for side in range(2):
        total, count, near_d, near_off = 0.0, 0, 0.0, np.inf
        for i in range(n):
            off = abs(uvd[i, 0] - ends[side])
            if off <= margin:
                total += uvd[i, 2]
                count += 1
            if off < near_off:
                near_d, near_off = uvd[i, 2], off
        edges[side] = (ends[side] - box[0]) * box[1] / (total / count if count else near_d)
    edges[2], edges[3] = top, v1
    return m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def trace_things(
    half: Gray,
    uvd: Floats,
    bounds: NDArray[np.int32],
    bottoms: Floats,
    twin: Floats,
    road: Floats,
    edges: Floats,
    contours: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> None:
    """See `reference.recognize.trace_things`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    most = 0
    for k in range(len(counts)):
        most = max(most, bounds[k + 1] - bounds[k])
    all_feet, box = np.empty(most), np.empty(3)
    box[0], box[1] = cx, baseline
    for k in range(len(counts)):
        cells = uvd[bounds[k] : bounds[k + 1]]
        feet = all_feet[: len(cells)]
        for i in range(len(cells)):
            feet[i] = cells[i, 1] + 2
        if n_x == n_x:
            for i in range(len(cells)):
                u, v, per_px = cells[i, 0], cells[i, 1], baseline / cells[i, 2]
                x, y, z = (u - cx) * per_px - baseline / 2, (v - cy) * per_px, f * per_px
                height = n_x * x + n_y * y + n_z * z + height_m - bend * z * z
                foot = max(v + 2, v + height / per_px)
                feet[i] = foot if height < FOOT_M else v + 2
        box[2] = bottoms[k]
        counts[k] = trace_thing(half, cells, feet, box, edges[k], contours[k])


UNITS, TELL = 4096.0, 128
"""Places for an outline are whole numbers of so small a part of a metre, then of so small a part of that, which only
tells them apart: LLVM makes vectors of least and largest integers only."""
ABREAST = 32
"""So many numbers LLVM's loops take at once: four vectors of eight."""
HIGHEST, LOWEST = np.int32(2**31 - 1), np.int32(1 - 2**31)
ACROSS = np.cos(np.arange(HEADINGS) * (np.pi / 2) / HEADINGS).astype(np.float32)
ALONG = np.sin(np.arange(HEADINGS) * (np.pi / 2) / HEADINGS).astype(np.float32)


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
def turn_places(
    x: Singles, z: Singles, tells: Units, c: np.float32, s: np.float32, along: Units, across: Units
) -> None:
    """Write where places are along and across a direction whose cosine and sine are given, units."""
    for i in range(len(x)):
        along[i] = np.int32(c * z[i] + s * x[i]) * np.int32(TELL) + tells[i]
    for i in range(len(x)):
        across[i] = np.int32(c * x[i] - s * z[i]) * np.int32(TELL) + tells[i]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ends_of(values: Units, has_strays: bool) -> tuple[np.int32, np.int32]:
    """See `reference.recognize.ends_of`."""
    low, high = HIGHEST, LOWEST
    for i in range(len(values)):
        low, high = min(low, values[i]), max(high, values[i])
    if not has_strays:
        return low, high
    second, last = HIGHEST, LOWEST
    for i in range(len(values)):
        value = values[i]
        second, last = min(second, value if value > low else HIGHEST), max(last, value if value < high else LOWEST)
    return second, last


@numba.njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "reassoc", "nnan", "nsz"})
def misfit(along: Units, across: Units, front: np.float32, side: np.float32, per_unit: Singles) -> float:
    """Return how badly a front and a side explain places: standard deviations, each at most 3."""
    total = np.float32(0.0)
    for i in range(len(along)):
        off = min(abs(np.float32(along[i]) - front), abs(np.float32(across[i]) - side))
        total += min(off * per_unit[i], np.float32(3.0))
    return np.float64(total)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def turned(
    x: Singles,
    z: Singles,
    per_unit: Singles,
    tells: Units,
    n: int,
    c: np.float32,
    s: np.float32,
    along: Units,
    across: Units,
    out: Floats,
) -> float:
    """See `reference.recognize.turned`; `out` (4,) is the extent, `along` and `across` are overwritten."""
    turn_places(x, z, tells, c, s, along, across)
    front, back = ends_of(along, n > STRAY_FROM)
    low, high = ends_of(across, n > STRAY_FROM)
    # One side across the direction and one along it are seen: those nearer to the cameras.
    side = low if low > 0 else high if high < 0 else np.int32(2**30)
    unit_m = 1 / (UNITS * TELL)
    out[0], out[1], out[2], out[3] = front * unit_m, back * unit_m, low * unit_m, high * unit_m
    return misfit(along, across, np.float32(front), np.float32(side), per_unit)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fit_outline(
    x: Singles, z: Singles, per_unit: Singles, tells: Units, n: int, along: Units, across: Units, out: Floats
) -> None:
    """See `reference.recognize.fit_outline`; x and z are in units, `per_unit` is 1 over their sigma.

    Of all places the first n count, the rest repeat the last one, so that vectors have no remainder: `tells`
    (-> `TELL`) are its own then, and `per_unit` is 0.
    """
    at, total, costs = 0, 0.0, np.empty(HEADINGS)
    for k in range(HEADINGS):
        costs[k] = turned(x, z, per_unit, tells, n, ACROSS[k], ALONG[k], along, across, out[1:5])
        total += costs[k]
        if costs[k] < costs[at]:
            at = k
    # Between the directions beside the best one, as a parabola tells.
    before, after = costs[(at - 1) % HEADINGS], costs[(at + 1) % HEADINGS]
    bend, angle = before + after - 2 * costs[at], at * (np.pi / 2) / HEADINGS
    if bend > 0:
        angle += (np.pi / 2) / HEADINGS * min(max((before - after) / (2 * bend), -0.5), 0.5)
    c, s = np.float32(np.cos(angle)), np.float32(np.sin(angle))
    turned(x, z, per_unit, tells, n, c, s, along, across, out[1:5])
    out[0], out[5], out[6] = angle, costs[at] / n, total / HEADINGS / n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def outline_things(uvd: Floats, bounds: NDArray[np.int32], twin: Floats, sigma_px: Floats, figures: Floats) -> None:
    """See `reference.recognize.outline_things`."""
    f, cx, _, baseline = twin
    x, z, per_unit = np.empty(POINTS, np.float32), np.empty(POINTS, np.float32), np.empty(POINTS, np.float32)
    along, across, tells = np.empty(POINTS, np.int32), np.empty(POINTS, np.int32), np.empty(POINTS, np.int32)
    for k in range(len(bounds) - 1):
        a, n = int(bounds[k]), int(bounds[k + 1] - bounds[k])
        count = min(n, POINTS)
        whole = min((count + ABREAST - 1) // ABREAST * ABREAST, POINTS)
        for s in range(whole):
            place = min(s, count - 1)
            i = a + (int(place * n / count) if count < n else place)
            z_m = f * baseline / uvd[i, 2]
            z[s] = UNITS * z_m
            x[s] = UNITS * ((uvd[i, 0] - cx) / f * z_m - baseline / 2)
            per_unit[s] = 1 / (UNITS * TELL * max(z_m / uvd[i, 2] * sigma_px[k], 0.03)) if s < count else 0.0
            tells[s] = place
        places = x[:whole], z[:whole], per_unit[:whole], tells[:whole]
        fit_outline(*places, count, along[:whole], across[:whole], figures[k])
