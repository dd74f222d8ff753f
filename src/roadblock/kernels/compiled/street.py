"""What stands on the road, compiled: heights, free space per column, and cells joined to things."""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.street import (
    BESIDE,
    BINS_PER_PX,
    DEEP_M,
    DEEP_SHARE,
    DEPTH_SHARES,
    FACE_SHARE,
    FAR_SHARE,
    FULL_SHARE,
    HIDDEN_SHARE,
    LATTICE,
    NOTHING,
    ROAD_CELLS,
    SECOND_DIFFERENCE,
    SIDE_SHARES,
    SLANT,
    SPREAD,
    STRAY,
    Floats,
    Ints,
    Singles,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def raise_cells(
    d_px: Singles, cell_w: int, cell_h: int, twin: Floats, road: Floats, z: Singles, height: Singles
) -> None:
    """See `reference.street.raise_cells`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, h, bend = road
    rows, columns = d_px.shape
    fb = np.float32(f * baseline)
    bend32 = np.float32(bend)
    base = np.float32(h - n_x * baseline / 2)
    for row in range(rows):
        along = np.float32(n_y * (row * cell_h + (cell_h - 1) / 2 - cy) / f + n_z)
        first = np.float32(n_x * ((cell_w - 1) / 2 - cx) / f)
        step = np.float32(n_x * cell_w / f)
        for column in range(columns):
            d = d_px[row, column]
            depth = fb / d if d > 0 else np.float32(np.nan)
            z[row, column] = depth
            height[row, column] = base + depth * (along + first + step * np.float32(column)) - bend32 * depth * depth


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_holes(height: Singles, road_m: Floats, cell_h: int, hides_px_m: float, hole: Floats) -> None:
    """See `reference.street.find_holes`."""
    rows, columns = height.shape
    known = np.zeros(columns + 2 * BESIDE, np.uint8)
    seen = np.empty(columns, np.uint8)
    length, begin = np.zeros(columns, np.int32), np.zeros(columns)
    hole[:] = np.inf
    below_m = 0.0
    for row in range(rows - 1, -1, -1):
        if not road_m[row] < np.inf:
            break
        for column in range(columns):
            known[column + BESIDE] = height[row, column] == height[row, column]
        seen[:] = 0
        for i in range(2 * BESIDE + 1):
            for column in range(columns):
                seen[column] |= known[column + i]
        for column in range(columns):
            if length[column] == 0:
                begin[column] = below_m
            length[column] = 0 if seen[column] else length[column] + cell_h
            hides = length[column] * max(begin[column], road_m[rows - 1]) >= hides_px_m
            if hides and hole[column] == np.inf:
                hole[column] = begin[column]
        below_m = road_m[row]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_free(
    d_px: Singles,
    height: Singles,
    fb: float,
    heights: Floats,
    support: int,
    spread: int,
    quantile: float,
    free: Floats,
    blocked: NDArray[np.bool_],
) -> None:
    """See `reference.street.measure_free`."""
    low, high, road = heights
    rows, columns = d_px.shape
    # Of each cell, column by column: its bin if it stands, less than NOTHING if it is road.
    bins = np.empty((columns, rows), np.int32)
    k: Any
    top: Any = 1
    for row in range(rows):
        for column in range(columns):
            d, h = d_px[row, column], height[row, column]
            k = NOTHING
            if d > 0:
                k = np.int32(d * BINS_PER_PX)
                top = max(top, k + 1)
                if not low < h < high:
                    k = NOTHING - 1 - k if abs(h) < road else NOTHING
            bins[column, row] = k
    counts = np.zeros((columns, top + 1), np.int16)
    roads = np.zeros((columns, top + 1), np.int16)
    for column in range(columns):
        for row in range(rows):
            k = bins[column, row]
            if k >= 0:
                counts[column, k] += 1
            elif k < NOTHING:
                roads[column, NOTHING - 1 - k] += 1
    standing = np.zeros(top + 1, np.int32)
    seen = np.zeros(top + 1, np.int32)
    behind = np.empty(top + 1, np.int64)
    for i in range(top + 1):
        # The bin of what lies as far behind bin i as things of one range may lie apart.
        nearest = fb * BINS_PER_PX / (i + 1)
        behind[i] = int(fb * BINS_PER_PX / (nearest + max(DEEP_M, DEEP_SHARE * nearest)))
    for column in range(columns):
        standing[:] = 0
        seen[:] = 0
        first, end = max(0, column - spread), min(columns, column + spread + 1)
        for i in range(first, end):
            for k in range(top + 1):
                standing[k] += counts[i, k]
                seen[k] += roads[i, k]
        free[column] = np.nan
        at: Any = np.int64(NOTHING)
        for i in range(top, -1, -1):
            if standing[i] == 0:
                continue
            inside = 0
            for k in range(behind[i], i + 1):
                inside += standing[k]
            if inside >= support:
                wanted = min(max(float(STRAY), quantile * inside), inside)
                passed = 0
                for k in range(i, behind[i] - 1, -1):
                    passed += standing[k]
                    if passed >= wanted:
                        at = k
                        break
                break
        blocked[column] = at >= 0
        if at < 0:
            passed = 0
            for k in range(top + 1):
                passed += seen[k]
                if passed >= ROAD_CELLS:
                    at = NOTHING - 1 - k
                    break
        if at != NOTHING:
            total, n = 0.0, 0
            for i in range(first, end):
                for row in range(rows):
                    if bins[i, row] == at:
                        total += d_px[row, i]
                        n += 1
            free[column] = fb / (total / n)


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def root(parent, i):  # type: ignore[no-untyped-def]
    """Return the first cell of the thing that cell i belongs to, halving the way there."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@numba.njit(cache=True, nogil=True, error_model="numpy")
def link(
    d_px: Singles,
    z: Singles,
    height: Singles,
    limits: Floats,
    links: Floats,
    gap_columns: int,
    gap_rows: int,
    parent: Ints,
) -> None:
    """See `reference.street.link`."""
    reach, low, high = limits
    link_m, link_px = links
    rows, columns = z.shape
    for row in range(rows):
        for column in range(columns):
            i = row * columns + column
            depth, h = z[row, column], height[row, column]
            # Without a road heights are NaN, and everything in reach stands.
            if not (depth < reach and (low < h < high or h != h)):
                parent[i] = NOTHING
                continue
            parent[i] = i
            d = d_px[row, column]
            mine = i
            for step in range(1, gap_columns + 1):
                if step > column:
                    break
                j = i - step
                # Beside each other, a wall along the road differs by more than one above the other.
                near_px = SLANT * link_px if step == 1 else link_px
                if (
                    parent[j] != NOTHING
                    and parent[j] != mine
                    and (abs(z[row, column - step] - depth) < link_m or abs(d_px[row, column - step] - d) < near_px)
                ):
                    other = root(parent, j)
                    if other != mine:
                        first, second = min(other, mine), max(other, mine)
                        parent[second] = first
                        mine = first
            for step in range(1, gap_rows + 1):
                if step > row:
                    break
                j = i - step * columns
                if (
                    parent[j] != NOTHING
                    and parent[j] != mine
                    and (abs(z[row - step, column] - depth) < link_m or abs(d_px[row - step, column] - d) < link_px)
                ):
                    other = root(parent, j)
                    if other != mine:
                        first, second = min(other, mine), max(other, mine)
                        parent[second] = first
                        mine = first
            if row > 0:
                for side in (-1, 1):
                    if column + side < 0 or column + side >= columns:
                        continue
                    j = i - columns + side
                    if (
                        parent[j] != NOTHING
                        and parent[j] != mine
                        and (
                            abs(z[row - 1, column + side] - depth) < link_m
                            or abs(d_px[row - 1, column + side] - d) < link_px
                        )
                    ):
                        other = root(parent, j)
                        if other != mine:
                            first, second = min(other, mine), max(other, mine)
                            parent[second] = first
                            mine = first
    for i in range(rows * columns):
        if parent[i] != NOTHING:
            parent[i] = root(parent, i)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def quantile_of(values: Floats | Singles, share: float) -> float:
    """See `reference.street.quantile_of`."""
    n = len(values)
    position = share * (n - 1)
    k = int(position)
    low, high = 0, n - 1
    while low < high:
        pivot = values[(low + high) >> 1]
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i += 1
                j -= 1
        if k <= j:
            high = j
        elif k >= i:
            low = i
        else:
            break
    at = np.float64(values[k])
    if position == k:
        return at
    above = values[k + 1]
    for i in range(k + 2, n):
        above = min(above, values[i])
    return at + (position - k) * (np.float64(above) - at)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def gather_pieces(
    parent: Ints,
    z: Singles,
    height: Singles,
    fb: float,
    least: int,
    overhead_m: float,
    split_m: float,
    near_share: float,
    cells: Ints,
    bounds: Ints,
    nearest: Floats,
) -> int:
    """See `reference.street.gather_pieces`."""
    size = len(parent)
    depths, heights = z.ravel(), height.ravel()
    count = np.zeros(size, np.int32)
    for i in range(size):
        if parent[i] != NOTHING:
            count[parent[i]] += 1
    start = np.full(size, NOTHING, np.int32)
    total = 0
    things = 0
    for i in range(size):
        if count[i] >= max(least, 1):
            start[i] = total
            total += count[i]
            things += 1
    order = np.empty(total, np.int32)
    firsts = np.empty(things + 1, np.int32)
    k = 0
    for i in range(size):
        if start[i] != NOTHING:
            firsts[k] = start[i]
            k += 1
    firsts[things] = total
    for i in range(size):
        if parent[i] != NOTHING and start[parent[i]] != NOTHING:
            order[start[parent[i]]] = i
            start[parent[i]] += 1
    scratch = np.empty(total, np.float32)
    found, used = 0, 0
    for thing in range(things):
        a, b = firsts[thing], firsts[thing + 1]
        n = b - a
        least_m, most_m = np.inf, 0.0
        for i in range(n):
            scratch[i] = depths[order[a + i]]
            least_m, most_m = min(least_m, scratch[i]), max(most_m, scratch[i])
        pieces, near, ratio = 1, 0.0, 1.0
        if most_m - least_m >= split_m:
            near = quantile_of(scratch[:n], DEPTH_SHARES[0])
            far = quantile_of(scratch[:n], DEPTH_SHARES[1])
            pieces = int(max(0.0, far - near - 2 * far * far / fb) / split_m) + 1
            ratio = (far / near) ** (1 / pieces)
        edge_low = -np.inf
        for piece in range(pieces):
            edge_high = near * ratio ** (piece + 1) if piece < pieces - 1 else np.inf
            n = 0
            lowest = np.inf
            for i in range(a, b):
                depth = depths[order[i]]
                if edge_low <= depth < edge_high:
                    cells[used + n] = order[i]
                    scratch[n] = depth
                    n += 1
                    lowest = min(lowest, heights[order[i]])
            edge_low = edge_high
            if n < max(least, 1) or lowest >= overhead_m or found + 1 >= len(bounds):
                continue
            nearest[found] = quantile_of(scratch[:n], near_share)
            bounds[found] = used
            used += n
            found += 1
    bounds[found] = used
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_boxes(cells: Ints, bounds: Ints, found: int, columns: int, boxes: Ints) -> None:
    """See `reference.street.measure_boxes`."""
    for k in range(found):
        c0, r0, c1, r1 = columns, 1 << 30, 0, 0
        for i in range(bounds[k], bounds[k + 1]):
            row, column = cells[i] // columns, cells[i] % columns
            c0, r0 = min(c0, column), min(r0, row)
            c1, r1 = max(c1, column + 1), max(r1, row + 1)
        boxes[k, 0], boxes[k, 1], boxes[k, 2], boxes[k, 3] = c0, r0, c1, r1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def roughness(d_px: Singles, cells: Ints, scratch: Singles, member: Ints, number: int) -> float:
    """See `reference.street.roughness`."""
    rows, columns = d_px.shape
    for i in cells:
        member[i] = number
    n = 0
    flat = d_px.ravel()
    for i in cells:
        row, column = i // columns, i % columns
        if 0 < column < columns - 1 and member[i - 1] == number and member[i + 1] == number:
            scratch[n] = abs(flat[i] - (flat[i - 1] + flat[i + 1]) / 2)
            n += 1
        if 0 < row < rows - 1 and member[i - columns] == number and member[i + columns] == number:
            scratch[n] = abs(flat[i] - (flat[i - columns] + flat[i + columns]) / 2)
            n += 1
    if n == 0:
        return np.nan
    return float(SECOND_DIFFERENCE * quantile_of(scratch[:n], 0.5))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def describe(
    d_px: Singles,
    height: Singles,
    cells: Ints,
    cell_w: int,
    cell_h: int,
    foot_m: float,
    bottom_px: int,
    member: Ints,
    number: int,
    uvd: Floats,
    outline: Ints,
) -> tuple[float, int]:
    """See `reference.street.describe`."""
    columns = d_px.shape[1]
    flat, heights = d_px.ravel(), height.ravel()
    c0, c1 = columns, 0
    for k in range(len(cells)):
        i = cells[k]
        row, column = i // columns, i % columns
        uvd[k, 0] = column * cell_w + (cell_w - 1) / 2
        uvd[k, 1] = row * cell_h + (cell_h - 1) / 2
        uvd[k, 2] = flat[i]
        c0, c1 = min(c0, column), max(c1, column + 1)
    width = c1 - c0
    tops = np.full(width, 1 << 30, np.int32)
    bottoms = np.full(width, -1, np.int32)
    lowest = np.full(width, np.inf, np.float32)
    for i in cells:
        row, column = i // columns, i % columns - c0
        tops[column] = min(tops[column], row * cell_h)
        bottoms[column] = max(bottoms[column], (row + 1) * cell_h - 1)
        lowest[column] = min(lowest[column], heights[i])
    # Columns without a cell (holes) take after their left neighbour; what reaches down goes on to the road.
    for column in range(width):
        if bottoms[column] < 0:
            tops[column], bottoms[column] = tops[column - 1], bottoms[column - 1]
        elif lowest[column] < foot_m:
            bottoms[column] = max(bottoms[column], bottom_px - 1)
    n = 0
    for column in range(width):
        if column == 0 or tops[column] != tops[column - 1]:
            outline[n, 0], outline[n, 1] = (c0 + column) * cell_w, tops[column]
            n += 1
        if column == width - 1 or tops[column] != tops[column + 1]:
            outline[n, 0], outline[n, 1] = (c0 + column + 1) * cell_w - 1, tops[column]
            n += 1
    for column in range(width - 1, -1, -1):
        if column == width - 1 or bottoms[column] != bottoms[column + 1]:
            outline[n, 0], outline[n, 1] = (c0 + column + 1) * cell_w - 1, bottoms[column]
            n += 1
        if column == 0 or bottoms[column] != bottoms[column - 1]:
            outline[n, 0], outline[n, 1] = (c0 + column) * cell_w, bottoms[column]
            n += 1
    scratch = np.empty(2 * len(cells), np.float32)
    return roughness(d_px, cells, scratch, member, number), n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def describe_pieces(
    d_px: Singles,
    height: Singles,
    cells: Ints,
    bounds: Ints,
    order: NDArray[np.int64],
    boxes: Ints,
    cell_w: int,
    cell_h: int,
    foot_m: float,
    uvd: Floats,
    outline: Ints,
    corners: Ints,
    rough_px: Floats,
) -> None:
    """See `reference.street.describe_pieces`."""
    member = np.full(d_px.size, NOTHING, np.int32)
    corners[0] = 0
    for k in range(len(order)):
        piece, at = order[k], corners[k]
        a, b = bounds[piece], bounds[piece + 1]
        rough_px[k], n = describe(
            d_px, height, cells[a:b], cell_w, cell_h, foot_m, boxes[piece, 3], member, k, uvd[a:b], outline[at:]
        )
        corners[k + 1] = at + n


@numba.njit(cache=True, nogil=True, error_model="numpy")
def mean_colors(
    middles: NDArray[np.uint8], cells: Ints, bounds: Ints, order: NDArray[np.int64], columns: int, colors: Floats
) -> None:
    """See `reference.street.mean_colors`."""
    for k in range(len(order)):
        a, b = bounds[order[k]], bounds[order[k] + 1]
        colors[k] = 0
        for i in range(a, b):
            pixel = middles[cells[i] // columns, cells[i] % columns]
            for channel in range(3):
                colors[k, channel] += pixel[channel]
        colors[k] /= b - a


@numba.njit(cache=True, nogil=True, error_model="numpy")
def drop_hidden(boxes: Ints, areas: Ints, kept: NDArray[np.bool_]) -> None:
    """See `reference.street.drop_hidden`."""
    for i in range(len(boxes)):
        kept[i] = True
        a0, b0, a1, b1 = boxes[i]
        for j in range(i):
            c0, d0, c1, d1 = boxes[j]
            common = max(0, min(a1, c1) - max(a0, c0)) * max(0, min(b1, d1) - max(b0, d0))
            if (
                kept[j]
                and common > HIDDEN_SHARE * ((a1 - a0) * (b1 - b0))
                and areas[j] > FULL_SHARE * ((c1 - c0) * (d1 - d0))
            ):
                kept[i] = False
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_through(cells: Ints, bounds: Ints, order: NDArray[np.int64], columns: int, through: NDArray[np.bool_]) -> None:
    """See `reference.street.find_through`."""
    boxes = np.empty((len(bounds) - 1, 4), np.int32)
    measure_boxes(cells, bounds, len(bounds) - 1, columns, boxes)
    for i in range(len(order)):
        a, b = bounds[order[i]], bounds[order[i] + 1]
        c0, r0, c1, r1 = boxes[order[i]]
        wide, tall = c1 - c0, r1 - r0
        through[i] = False
        # Only where nearer boxes reach over most of its columns.
        over = np.zeros(wide, np.bool_)
        for j in range(i):
            e0, s0, e1, s1 = boxes[order[j]]
            if s0 < r1 and s1 > r0:
                over[max(0, e0 - LATTICE - c0) : max(0, e1 + LATTICE - c0)] = True
        if np.count_nonzero(over) < SPREAD * wide:
            continue
        # First and last cell of each row and column.
        left, right = np.full(tall, wide), np.full(tall, -1)
        top, bottom = np.full(wide, tall), np.full(wide, -1)
        for k in range(a, b):
            row, column = cells[k] // columns - r0, cells[k] % columns - c0
            left[row], right[row] = min(left[row], column), max(right[row], column)
            top[column], bottom[column] = min(top[column], row), max(bottom[column], row)
        crossed = np.zeros(wide, np.bool_)
        for j in range(i):
            e0, s0, e1, s1 = boxes[order[j]]
            if s0 >= r1 or s1 <= r0 or e0 >= c1 or e1 <= c0:
                continue
            for k in range(bounds[order[j]], bounds[order[j] + 1]):
                row, column = cells[k] // columns - r0, cells[k] % columns - c0
                if (
                    0 <= row < tall
                    and 0 <= column < wide
                    and (left[row] < column < right[row] or top[column] < row < bottom[column])
                ):
                    for near in range(max(0, column - LATTICE), min(wide, column + LATTICE + 1)):
                        crossed[near] = True
        count = 0
        for column in range(wide):
            count += crossed[column]
        through[i] = count >= SPREAD * wide


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_stixels(
    d_px: Singles,
    z: Singles,
    height: Singles,
    limits: Floats,
    links: Floats,
    gap_rows: int,
    least: int,
    stixels: Floats,
) -> int:
    """See `reference.street.find_stixels`."""
    reach, low, high = limits
    rows, columns = z.shape
    found = 0
    for column in range(columns):
        last, first, n, total = -1, -1, 0, 0.0
        for row in range(rows - 1, -2, -1):
            if row >= 0:
                depth, h = z[row, column], height[row, column]
                if not (depth < reach and (low < h < high or h != h)):
                    continue
                d = d_px[row, column]
                if n > 0 and (
                    last - row <= gap_rows
                    and (abs(depth - z[last, column]) < links[0] or abs(d - d_px[last, column]) < links[1])
                ):
                    last = row
                    n += 1
                    total += d
                    continue
            if n >= max(least, 1) and found < len(stixels):
                stixels[found, 0], stixels[found, 1], stixels[found, 2] = column, last, first + 1
                stixels[found, 3], stixels[found, 4] = total / n, height[last, column]
                found += 1
            if row >= 0:
                last, first, n, total = row, row, 1, np.float64(d)
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_surfaces(uvd: Floats, bounds: Ints, twin: Floats, road: Floats, near_share: float, out: Floats) -> None:
    """See `reference.street.measure_surfaces`."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, h, bend = road
    scratch = np.empty(len(uvd))
    z = np.empty(len(uvd))
    for k in range(len(bounds) - 1):
        a, n = bounds[k], bounds[k + 1] - bounds[k]
        for i in range(n):
            z[i] = f * baseline / uvd[a + i, 2]
            scratch[i] = z[i]
        out[k, 0] = quantile_of(scratch[:n], near_share)
        out[k, 1] = quantile_of(scratch[:n], FAR_SHARE)
        face_m = quantile_of(scratch[:n], max(FACE_SHARE - 1 / n, 0.0))
        for i in range(n):
            scratch[i] = (uvd[a + i, 0] - cx) / f * z[i] - baseline / 2
        out[k, 2] = quantile_of(scratch[:n], SIDE_SHARES[0])
        out[k, 3] = quantile_of(scratch[:n], SIDE_SHARES[1])
        m = 0
        for i in range(n):
            if z[i] <= face_m or n == 1:
                scratch[m] = (uvd[a + i, 0] - cx) / f * z[i] - baseline / 2
                m += 1
        out[k, 4] = (quantile_of(scratch[:m], SIDE_SHARES[0]) + quantile_of(scratch[:m], SIDE_SHARES[1])) / 2
        for i in range(n):
            scratch[i] = uvd[a + i, 1]
        out[k, 5] = quantile_of(scratch[:n], 0.5)
        top, bottom = np.inf, -np.inf
        for i in range(n):
            y = (uvd[a + i, 1] - cy) / f * z[i]
            x = (uvd[a + i, 0] - cx) / f * z[i] - baseline / 2
            scratch[i] = n_x * x + n_y * y + n_z * z[i] + h - bend * z[i] * z[i]
            top, bottom = min(top, y), max(bottom, y)
        # Without a road the height is the extent downwards.
        out[k, 6] = quantile_of(scratch[:n], SIDE_SHARES[1]) if n_x == n_x else bottom - top
        out[k, 7] = bottom
