"""What recognition measures of every region of a frame, in one call: figures of shape, looks and surroundings."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.street import quantile_of
from roadblock.kernels.reference.recognize import (
    BACKGROUND,
    BESIDE_PX,
    BODY_SHARE,
    CELLS,
    CELLS_HIGH,
    CELLS_WIDE,
    COLUMNS,
    EDGE_LEVELS,
    END_SHARE,
    FAR_M,
    FOOT_LOW_M,
    FOOT_M,
    GAIN_LIMITS,
    GREY_LEAST,
    GREY_SHARE,
    HEADINGS,
    HUE_ENDS_DEG,
    HUES,
    LAYERS,
    LOOKS,
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
    TOGETHER_M,
    TOGETHER_SHARE,
    TOUCH_PX,
    TURNS,
)

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
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
def solve3(A: Floats, y: Floats) -> Floats:
    """Return the solution of a symmetric 3 x 3 system by Cramer's rule; zeros where it has none."""
    c00 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c01 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c02 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    determinant = A[0, 0] * c00 + A[0, 1] * c01 + A[0, 2] * c02
    out = np.zeros(3)
    if abs(determinant) < 1e-9:
        return out
    out[0] = (y[0] * c00 + y[1] * c01 + y[2] * c02) / determinant
    out[1] = (
        y[0] * c01 + y[1] * (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) + y[2] * (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2])
    ) / determinant
    out[2] = (
        y[0] * c02 + y[1] * (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]) + y[2] * (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0])
    ) / determinant
    return out


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_shape(
    uvd: Floats, xzh: Floats, count: int, twin: Floats, size_px: Floats, scratch: Floats, out: Floats
) -> None:
    """See `reference.recognize.measure_shape`."""
    f, fb = twin[0], twin[0] * twin[3]
    n = len(xzh)
    pitch = pitch_of(uvd[:PITCH_CELLS])
    for i in range(n):
        scratch[i] = xzh[i, 1]
    near = quantile_of(scratch[:n], 0.1)
    far = quantile_of(scratch[:n], 0.9)
    for i in range(n):
        scratch[i] = xzh[i, 2]
    top = quantile_of(scratch[:n], 0.98)
    low = quantile_of(scratch[:n], 0.05)
    u0, u1, v0, v1 = np.inf, -np.inf, np.inf, -np.inf
    for i in range(n):
        u0, u1 = min(u0, xzh[i, 3]), max(u1, xzh[i, 3])
        v0, v1 = min(v0, xzh[i, 4]), max(v1, xzh[i, 4])
    u0, u1, v0, v1 = u0 - pitch / 2, u1 + pitch / 2, v0 - 2.0, v1 + 2.0
    tall = max(top, 0.05)
    width = (u1 - u0) / f * near
    # The surface as a plane of disparities, and what does not lie on it.
    A, y = np.zeros((3, 3)), np.zeros(3)
    cu, cv = (u0 + u1) / 2, (v0 + v1) / 2
    row = np.empty(3)
    for i in range(n):
        row[0], row[1], row[2] = 1.0, (xzh[i, 3] - cu) / (u1 - u0), (xzh[i, 4] - cv) / (v1 - v0)
        for a in range(3):
            y[a] += row[a] * xzh[i, 5]
            for b in range(3):
                A[a, b] += row[a] * row[b]
    plane = solve3(A, y)
    rms, flat = 0.0, 0.0
    for i in range(n):
        off = xzh[i, 5] - plane[0] - plane[1] * (xzh[i, 3] - cu) / (u1 - u0) - plane[2] * (xzh[i, 4] - cv) / (v1 - v0)
        rms += off * off
        flat += abs(xzh[i, 1] - near) < 0.3
    rms = np.sqrt(rms / n)
    per_px = near * near / fb
    out[0], out[1], out[2], out[3] = np.log(near), np.log(width), np.log(tall), low
    out[4], out[5] = np.log(far - near + 0.1), np.log(per_px)
    out[6], out[7] = np.log(width / tall), count * pitch * 4.0 / ((u1 - u0) * (v1 - v0))
    out[8], out[9] = np.log(rms + 0.02), np.log(rms * per_px + 0.02)
    out[10] = min(abs(plane[1]) * per_px / max(width, 0.1), 4.0)
    out[11] = min(max(plane[2] * per_px / tall, -4.0), 4.0)
    out[12] = flat / n
    out[13] = (u0 < 6) * 1.0 + (u1 > size_px[0] - 6)
    out[14] = (v0 < 6) * 1.0
    out[15] = np.log(count)
    # How high it is over its columns, and how wide in its layers.
    k = 16
    tops, counts = np.zeros(COLUMNS), np.zeros(COLUMNS)
    layers, left, right = np.zeros(LAYERS), np.full(LAYERS, np.inf), np.full(LAYERS, -np.inf)
    for i in range(n):
        c = min(int((xzh[i, 3] - u0) / (u1 - u0) * COLUMNS), COLUMNS - 1)
        tops[c] = max(tops[c], xzh[i, 2])
        counts[c] += 1
        m = min(max(int(xzh[i, 2] / tall * LAYERS), 0), LAYERS - 1)
        layers[m] += 1
        left[m], right[m] = min(left[m], xzh[i, 3]), max(right[m], xzh[i, 3])
    for c in range(COLUMNS):
        out[k + c] = min(tops[c] / tall, 1.2)
        out[k + COLUMNS + c] = counts[c] * COLUMNS / n
    k += 2 * COLUMNS
    for m in range(LAYERS):
        wide = max(right[m] - left[m] + pitch, 0.0) if layers[m] > 0 else 0.0
        out[k + m] = wide / (u1 - u0)
        out[k + LAYERS + m] = layers[m] * LAYERS / n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_looks(half: Gray, u0: float, v0: float, u1: float, v1: float, out: Floats) -> None:
    """See `reference.recognize.measure_looks`."""
    rows, columns = half.shape
    total = 0.0
    out[:] = 0.0
    for i in range(CELLS_HIGH * PATCH_STEP):
        y = int((v0 + (i + 0.5) * (v1 - v0) / (CELLS_HIGH * PATCH_STEP)) / 2)
        y = min(max(y, 1), rows - 2)
        for j in range(CELLS_WIDE * PATCH_STEP):
            x = int((u0 + (j + 0.5) * (u1 - u0) / (CELLS_WIDE * PATCH_STEP)) / 2)
            x = min(max(x, 1), columns - 2)
            gx = float(half[y, x + 1]) - float(half[y, x - 1])
            gy = float(half[y + 1, x]) - float(half[y - 1, x])
            ax, ay = abs(gx), abs(gy)
            # Upright, level, and the two slants.
            if ay < 0.4142 * ax:
                turn = 0
            elif ax < 0.4142 * ay:
                turn = 2
            else:
                turn = 1 if gx * gy > 0 else 3
            size = np.sqrt(gx * gx + gy * gy)
            out[((i // PATCH_STEP) * CELLS_WIDE + j // PATCH_STEP) * TURNS + turn] += size
            total += size
    count = CELLS_HIGH * CELLS_WIDE * PATCH_STEP**2
    bins = CELLS_HIGH * CELLS_WIDE * TURNS
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def grow_box(boxes: Floats, near: Floats, k: int, box: Floats) -> int:
    """See `reference.recognize.grow_box`."""
    reach = max(TOGETHER_M, TOGETHER_SHARE * near[k])
    taken = np.zeros(len(boxes), np.bool_)
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
    scratch, xzh = np.empty(CELLS), np.empty((CELLS, 6))
    boxes, near, box = np.empty((things, 4)), np.empty(things), np.empty(4)
    for k in range(things):
        cells = uvd[bounds[k] : bounds[k + 1]]
        count = len(cells)
        n = min(count, CELLS)
        u0, u1, v0, v1, lowest = np.inf, -np.inf, np.inf, -np.inf, -np.inf
        for s in range(n):
            u, v, d = cells[s * count // n]
            z = f * baseline / d
            x, y = (u - cx) / f * z - baseline / 2, (v - cy) / f * z
            xzh[s, 0], xzh[s, 1], xzh[s, 3], xzh[s, 4], xzh[s, 5] = x, z, u, v, d
            xzh[s, 2] = n_x * x + n_y * y + n_z * z + height_m - bend * z * z if n_x == n_x else -y
            lowest = max(lowest, y)
            u0, u1 = min(u0, u - 2), max(u1, u + 2)
            v0, v1 = min(v0, v - 2), max(v1, v + 2)
        if n_x != n_x:
            xzh[:n, 2] += lowest
        measure_shape(cells, xzh[:n], count, twin, size_px, scratch, figures[k])
        # What stands on the road is seen down to it.
        near[k] = np.exp(figures[k, 0])
        if figures[k, 3] < FOOT_LOW_M:
            v1 = min(v1 + max(figures[k, 3], 0.0) * f / near[k], size_px[1])
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = u0, v0, u1, v1
        at = OWN
        measure_looks(half, u0, v0, u1, v1, figures[k, at : at + LOOKS])
        at += LOOKS
        measure_beside(u0, u1, near[k], f, free_u, free_m, figures[k, at : at + 4])
    for k in range(things):
        at = OWN + LOOKS + 4
        pieces = grow_box(boxes, near, k, box)
        wide, tall = (box[2] - box[0]) / f * near[k], (box[3] - box[1]) / f * near[k]
        figures[k, at], figures[k, at + 1] = np.log(wide), np.log(tall)
        figures[k, at + 2] = np.log(pieces)
        figures[k, at + 3] = (boxes[k, 2] - boxes[k, 0]) * (boxes[k, 3] - boxes[k, 1])
        figures[k, at + 3] /= (box[2] - box[0]) * (box[3] - box[1])
        figures[k, at + 4] = (boxes[k, 1] - box[1]) / (box[3] - box[1])
        at += 5
        if pieces > 1:
            measure_looks(half, box[0], box[1], box[2], box[3], figures[k, at : at + LOOKS])
        else:
            figures[k, at : at + LOOKS] = figures[k, OWN : OWN + LOOKS]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def pick_colors(
    colors: NDArray[np.uint8], uvd: Floats, bounds: NDArray[np.int32], step_px: int, samples: NDArray[np.uint8]
) -> None:
    """See `reference.recognize.pick_colors`."""
    rows, columns = colors.shape[:2]
    own = samples.shape[1] - BACKGROUND
    for k in range(len(samples)):
        a, n = bounds[k], bounds[k + 1] - bounds[k]
        left, right = columns - 1, 0
        for s in range(own):
            i = a + s * n // own
            row, column = min(int(uvd[i, 1]) // step_px, rows - 1), min(int(uvd[i, 0]) // step_px, columns - 1)
            left, right = min(left, column), max(right, column)
            for c in range(3):
                samples[k, s, c] = colors[row, column, c]
        for s in range(BACKGROUND):
            i = a + s * n // BACKGROUND
            row, away = min(int(uvd[i, 1]) // step_px, rows - 1), 2 + s // 2 % 4
            column = max(left - away, 0) if s % 2 else min(right + away, columns - 1)
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
def tally_colors(lab: NDArray[np.uint8], road_lab: Floats, out: Floats) -> None:
    """See `reference.recognize.tally_colors`."""
    own = lab.shape[1] - BACKGROUND
    grey = np.empty(own)
    gain = min(max((ROAD_L + 16) / (road_lab[0] + 16), GAIN_LIMITS[0]), GAIN_LIMITS[1])
    behind = np.empty(HUES)
    for k in range(len(lab)):
        out[k] = 0.0
        behind[:] = 0.0
        greys, lightness, squares = 0, 0.0, 0.0
        for s in range(own + BACKGROUND):
            light = lab[k, s, 0] * (100 / 255)
            tint = min(light / max(road_lab[0], 1.0), 1.5)
            a = gain * (lab[k, s, 1] - 128.0 - tint * road_lab[1])
            b = gain * (lab[k, s, 2] - 128.0 - tint * road_lab[2])
            light = max((light + 16) * gain - 16, 0.0)
            if s < own:
                lightness += light
                squares += light * light
            if a * a + b * b < (GREY_LEAST + GREY_SHARE * light) ** 2:
                if s >= own:
                    continue
                grey[greys] = light
                greys += 1
                out[k, 4 * HUES + 2] += a
                out[k, 4 * HUES + 3] += b
                continue
            hue = np.degrees(np.arctan2(b, a)) % 360
            name = 0
            while name < HUES and hue >= HUE_ENDS_DEG[name]:
                name += 1
            name %= HUES
            if s >= own:
                behind[name] += 1.0
                continue
            out[k, 4 * name] += 1
            out[k, 4 * name + 1] += light
            out[k, 4 * name + 2] += a
            out[k, 4 * name + 3] += b
        for name in range(HUES):
            for c in range(1, 4):
                out[k, 4 * name + c] /= max(out[k, 4 * name], 1.0)
            out[k, 4 * name] = max(out[k, 4 * name] / own - SEEN_THROUGH * behind[name] / BACKGROUND, 0.0)
        out[k, 4 * HUES] = greys / own
        out[k, 4 * HUES + 1] = quantile_of(grey[:greys], BODY_SHARE) if greys else np.nan
        out[k, 4 * HUES + 2] /= max(greys, 1)
        out[k, 4 * HUES + 3] /= max(greys, 1)
        mean = lightness / own
        out[k, 4 * HUES + 4] = mean
        out[k, 4 * HUES + 5] = np.sqrt(max(squares / own - mean * mean, 0.0))


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
def edge_near(half: Gray, row: int, middle: float, reach: float, scratch: Floats) -> float:
    """See `reference.recognize.edge_near`."""
    rows, columns = half.shape
    first, last = max(int(np.ceil(middle - reach)), 1), min(int(np.floor(middle + reach)), columns - 2)
    y0, y1 = max(row - 1, 0), min(row + 1, rows - 1)
    steps = scratch[: min(max(last - first + 1, 0), len(scratch))]
    steps[:] = 0.0
    for y in range(y0, y1 + 1):
        for k in range(len(steps)):
            steps[k] += abs(float(half[y, first + k + 1]) - float(half[y, first + k - 1]))
    return steepest(steps, middle, reach, first, EDGE_LEVELS * (y1 - y0 + 1))


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
def trace_thing(
    half: Gray, uvd: Floats, xzh: Floats, f_px: float, box: Floats, edges: Floats, contour: NDArray[np.int32]
) -> int:
    """See `reference.recognize.trace_thing`."""
    n = len(uvd)
    pitch = pitch_of(uvd)
    v0, v1 = np.inf, -np.inf
    for i in range(n):
        v0 = min(v0, uvd[i, 1] - 2)
        foot = uvd[i, 1] + 2
        if xzh[i, 2] < FOOT_M:
            foot = max(foot, uvd[i, 1] + xzh[i, 2] * f_px / xzh[i, 1])
        v1 = max(v1, foot)
    v0, v1 = max(v0, 0.0), min(v1, box[3])
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
    step = (v1 - v0) / rows
    left, right = np.full(rows, np.inf), np.full(rows, -np.inf)
    for i in range(n):
        foot = uvd[i, 1] + 2
        if xzh[i, 2] < FOOT_M:
            foot = max(foot, uvd[i, 1] + xzh[i, 2] * f_px / xzh[i, 1])
        first = max(int((uvd[i, 1] - 2 - v0) / step + 0.5), 0)
        last = min(max(int((foot - v0) / step - 0.5), first), rows - 1)
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
    sharp_left, sharp_right, scratch = np.empty(rows), np.empty(rows), np.empty(64)
    for k in range(rows):
        y = min(int((v0 + (k + 0.5) * step) / 2), half.shape[0] - 1)
        width = (right[k] - left[k]) / 2
        near = min(reach, max(width, 1.0))
        sharp_left[k] = 2 * edge_near(half, y, (left[k] - 0.5) / 2, near, scratch) + 0.5
        sharp_right[k] = 2 * edge_near(half, y, (right[k] - 0.5) / 2, near, scratch) + 0.5
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
    lefts.sort()
    rights.sort()
    stray = rows // STRAY_ROWS
    ends = lefts[stray], rights[rows - 1 - stray]
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
        edges[side] = (ends[side] - box[4]) * box[5] / (total / count if count else near_d)
    edges[2], edges[3] = top, v1
    return m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def trace_things(
    half: Gray,
    uvd: Floats,
    bounds: NDArray[np.int32],
    boxes: NDArray[np.int32],
    twin: Floats,
    road: Floats,
    edges: Floats,
    contours: NDArray[np.int32],
    counts: NDArray[np.int32],
) -> None:
    """See `reference.recognize.trace_things`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    box = np.empty(6)
    box[4], box[5] = cx, baseline
    for k in range(len(bounds) - 1):
        cells = uvd[bounds[k] : bounds[k + 1]]
        xzh = np.empty((len(cells), 3))
        for i in range(len(cells)):
            z = f * baseline / cells[i, 2]
            x, y = (cells[i, 0] - cx) / f * z - baseline / 2, (cells[i, 1] - cy) / f * z
            xzh[i, 0], xzh[i, 1] = x, z
            xzh[i, 2] = n_x * x + n_y * y + n_z * z + height_m - bend * z * z if n_x == n_x else FOOT_M
        for c in range(4):
            box[c] = boxes[k, c]
        counts[k] = trace_thing(half, cells, xzh, f, box, edges[k], contours[k])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ends_of(values: Floats) -> tuple[float, float]:
    """See `reference.recognize.ends_of`."""
    low, lowest, high, highest = np.inf, np.inf, -np.inf, -np.inf
    for i in range(len(values)):
        value = values[i]
        if value < low:
            low = value
            if value < lowest:
                low, lowest = lowest, value
        if value > high:
            high = value
            if value > highest:
                high, highest = highest, value
    return (low, high) if len(values) > STRAY_FROM else (lowest, highest)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fit_outline(x: Floats, z: Floats, sigma_m: Floats, out: Floats) -> None:
    """See `reference.recognize.fit_outline`."""
    n = len(x)
    costs = np.empty(HEADINGS)
    along, across = np.empty(n), np.empty(n)
    best, at = np.inf, 0
    for turn in range(HEADINGS + 1):
        k = turn if turn < HEADINGS else at
        angle = k * (np.pi / 2) / HEADINGS
        if turn == HEADINGS:
            # Between the directions beside the best one, as a parabola tells.
            before, after = costs[(at - 1) % HEADINGS], costs[(at + 1) % HEADINGS]
            bend = before + after - 2 * costs[at]
            if bend > 0:
                angle += (np.pi / 2) / HEADINGS * min(max((before - after) / (2 * bend), -0.5), 0.5)
        c, s = np.cos(angle), np.sin(angle)
        # One side across the direction and one along it are seen: those nearer to the cameras.
        for i in range(n):
            along[i] = c * z[i] + s * x[i]
            across[i] = c * x[i] - s * z[i]
        front, back = ends_of(along)
        low, high = ends_of(across)
        side = low if low > 0 else high if high < 0 else np.nan
        cost = 0.0
        for i in range(n):
            off = abs(along[i] - front)
            if side == side:
                off = min(off, abs(across[i] - side))
            cost += min(off / sigma_m[i], 3.0)
        if turn < HEADINGS:
            costs[k] = cost
            if cost < best:
                best, at = cost, k
        else:
            out[0], out[1], out[2], out[3], out[4] = angle, front, back, low, high
            out[5] = best / n
            mean = 0.0
            for m in range(HEADINGS):
                mean += costs[m]
            out[6] = mean / HEADINGS / n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def outline_things(uvd: Floats, bounds: NDArray[np.int32], twin: Floats, sigma_px: Floats, figures: Floats) -> None:
    """See `reference.recognize.outline_things`."""
    f, cx, _, baseline = twin
    x, z, sigma_m = np.empty(POINTS), np.empty(POINTS), np.empty(POINTS)
    for k in range(len(bounds) - 1):
        a, n = bounds[k], bounds[k + 1] - bounds[k]
        count = min(n, POINTS)
        for s in range(count):
            i = a + s * n // count
            z[s] = f * baseline / uvd[i, 2]
            x[s] = (uvd[i, 0] - cx) / f * z[s] - baseline / 2
            sigma_m[s] = max(z[s] / uvd[i, 2] * sigma_px[k], 0.03)
        fit_outline(x[:count], z[:count], sigma_m[:count], figures[k])
