"""The definition of what recognition measures of a region: shape, looks, surroundings, colours, contour, outline.

Each kernel writes into arrays it is given. Cells are columns, rows and disparities in pixels; the car frame has x
right, y down, z forward.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Gray = NDArray[np.uint8]
Rgb = NDArray[np.uint8]
Bounds = NDArray[np.integer[Any]]

CELLS, PITCH_CELLS = 160, 64
"""Of a thing at most so many cells are looked at, evenly spread; its first ones tell how far cells are apart."""
COLUMNS, LAYERS = 8, 6
"""Bins across and up a thing."""
CELLS_HIGH, CELLS_WIDE, TURNS, PATCH_STEP = 4, 3, 4, 6
"""Cells and directions of the histogram of gradients; it looks at so many places across and along each cell."""
BESIDE_PX, SIDES, FAR_M = 6.0, 12, 8.0
"""Free road is looked for so far beside a thing, over so many columns of free space, and up to this far behind."""
ASIDE_M = (0.3, 0.7, 1.3, 2.2)
"""So far beside a thing it is looked at how far the road is free: along a divider it is, more and more."""
BEHIND_M = 4.0
"""What is further behind the nearest face than this counts as that far."""
TOPS, WIDE = 16, 16 + COLUMNS
GRID = WIDE + LAYERS
BACK = GRID + COLUMNS * LAYERS
OWN = BACK + COLUMNS + LAYERS
"""Where figures of shape begin, and how many they are."""
LOOKS = CELLS_HIGH * CELLS_WIDE * TURNS + 1
FOOT_LOW_M = 0.8
"""A thing that begins lower is seen down to the road."""
TOGETHER_M, TOGETHER_SHARE, TOUCH_PX = 0.7, 0.04, 8.0
"""Things as near as each other, by so much or by such a share, with no larger gap between, may be pieces of one."""
BESIDE = 4 + 2 * len(ASIDE_M)
TOGETHER = OWN + LOOKS + BESIDE
FIGURES = TOGETHER + 5 + LOOKS
"""How many figures there are of a thing."""
INPUTS = FIGURES + 8
"""How many numbers the model of types looks at: the figures, and a summary of the colours."""

HUE_ENDS_DEG = (15.0, 50.0, 76.0, 112.0, 195.0, 308.0, 340.0)
"""Upper ends of the CIELAB hue angles of pink, red, orange, yellow, green, blue, purple; beyond the last it is pink."""
HUES = len(HUE_ENDS_DEG)
ROAD_ROWS = 8
"""The road is looked at in so many rows of a block before the vehicle."""
ROAD_L = 47.0
"""Lightness of asphalt under a white light of full strength."""
GAIN_LIMITS = (0.7, 1.5)
GREY_SHARE, GREY_LEAST = 0.2, 4.0
"""What has less chroma than this share of its lightness and so much more is grey."""
BODY_SHARE = 0.65
"""The body of a grey thing is as light as this share of its places: the rest is glass, tyres and shadow."""
BACKGROUND, SEEN_THROUGH = 24, 0.6
"""So many places beside a thing show what is behind it; such a share of it is taken off, as if seen through it."""
INNER = 0.6
"""Colours are looked for this share of the way from the middle of a row of cells to each: its ends see other things."""
COLOR_FIGURES = 4 * HUES + 6
"""How many figures there are of a thing's colours."""

ROWS = 48
"""A contour has at most so many rows."""
REACH_PX, EDGE_LEVELS = 3.0, 6.0
"""A level edge of the image so far beyond a cell's edge, and of so many grey levels, is the thing's upper end."""
OUTWARD_PX, LIKELY_PX, INWARD_PX, INWARD_SHARE, UNLIKELY = 3.0, 4.0, 12.0, 0.3, 0.15
"""A thing's sides are looked for from so far outside its cells to so far inside, but to no more than this share of
their width; an edge one half-pixel further from where it is likely must be steeper by this share."""
STRAY_ROWS, END_SHARE = 16, 0.1
"""Of so many rows one may be stray; what lies within this share of the width is an end."""
FOOT_M = 0.6
"""What begins lower stands on the road and is seen down to it."""
HEADINGS, POINTS = 18, 96
"""Directions in a right angle and places of a thing's surface that its outline on the road is fitted with."""
STRAY_FROM = 20
"""Of more places than these the outermost on each side is a stray one."""
OUTLINE_FIGURES = 7
"""How many figures there are of an outline."""


def pitch_of(uvd: Floats) -> float:
    """Return how far cells are apart along a row, pixels: the least step between neighbours; 4 where none is told."""
    steps = np.diff(uvd[:, 0])[(np.diff(uvd[:, 1]) == 0) & (np.diff(uvd[:, 0]) > 0)]
    return float(steps.min()) if len(steps) else 4.0


def lifted(uvd: Floats, twin: Floats, road: Floats) -> Floats:
    """Return (n, 4) x and z of cells in the car frame, their height over the road (NaN without one), and y."""
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    z = f * baseline / uvd[:, 2]
    x, y = (uvd[:, 0] - cx) / f * z - baseline / 2, (uvd[:, 1] - cy) / f * z
    return np.stack([x, z, n_x * x + n_y * y + n_z * z + height_m - bend * z * z, y], -1)


def measure_shape(
    uvd: Floats, z: Floats, height: Floats, pitch: float, count: int, twin: Floats, width_px: float
) -> Floats:
    """Return the (OWN,) figures of a thing's shape.

    Parameters
    ----------
    uvd, z, height
        (n, 3) the cells looked at, (n,) their forward distance and height over the road, metres.
    pitch, count
        How far cells are apart, pixels, and how many there are in all.
    twin, width_px
        Focal length, principal point and baseline; width of the image.

    Returns
    -------
    Logarithms of distance, width and height, the lowest height, logarithms of depth and of metres per pixel of
    disparity; of width over height, and the filled share; how far the surface is from a plane (pixels and metres), its
    slants across and up, the share near the nearest face; whether it is cut at the sides and at the top; the logarithm
    of its cells. Then in bins across: how high it is (`TOPS`); in bins up: how wide (`WIDE`); in both, layer by layer:
    how much of it is there (`GRID`); in bins across and in bins up: how far behind its nearest face it is on average.
    """
    f, fb = twin[0], twin[0] * twin[3]
    near, far = np.quantile(z, 0.1), np.quantile(z, 0.9)
    low, tall = np.quantile(height, 0.05), max(np.quantile(height, 0.98), 0.05)
    u, v, d = uvd.T
    u0, u1, v0, v1 = u.min() - pitch / 2, u.max() + pitch / 2, v.min() - 2, v.max() + 2
    width = (u1 - u0) / f * near
    across, up = (u - u.mean()) / (u1 - u0), (v - v.mean()) / (v1 - v0)
    (xx, xy), (_, yy) = moments = np.cov(np.stack([across, up]), bias=True)
    known = xx * yy - xy * xy >= 1e-9
    slants = np.linalg.solve(moments, [np.mean(across * d), np.mean(up * d)]) if known else np.zeros(2)
    rms, per_px = np.std(d - across * slants[0] - up * slants[1]), near * near / fb
    own = [
        *np.log([near, width, tall]),
        low,
        *np.log([far - near + 0.1, per_px, width / tall]),
        count * pitch * 4 / ((u1 - u0) * (v1 - v0)),
        *np.log([rms + 0.02, rms * per_px + 0.02]),
        min(abs(slants[0]) * per_px / max(width, 0.1), 4.0),
        np.clip(slants[1] * per_px / tall, -4.0, 4.0),
        np.mean(np.abs(z - near) < 0.3),
        float(u0 < 6) + float(u1 > width_px - 6),
        float(v0 < 6),
        np.log(count),
    ]
    column = np.minimum((u - u0) / (u1 - u0) * COLUMNS, COLUMNS - 1).astype(int)
    layer = np.clip((height / tall * LAYERS).astype(int), 0, LAYERS - 1)
    tops = [min(max(height[column == c].max(initial=0.0), 0.0) / tall, 1.2) for c in range(COLUMNS)]
    wide = [(np.ptp(u[layer == m]) + pitch) / (u1 - u0) if (layer == m).any() else 0.0 for m in range(LAYERS)]
    grid = np.bincount(layer * COLUMNS + column, minlength=COLUMNS * LAYERS) * (COLUMNS * LAYERS / len(u))
    behind = np.clip(z - near, 0, BEHIND_M)
    back = [behind[column == c].mean() if (column == c).any() else 0.0 for c in range(COLUMNS)]
    back += [behind[layer == m].mean() if (layer == m).any() else 0.0 for m in range(LAYERS)]
    return np.array([*own, *tops, *wide, *grid, *back])


def measure_looks(half: Gray, box: Floats) -> Floats:
    """Return (LOOKS,) how steep a box of the image is, by its cells and by direction; and in all.

    Gradients of `half` are taken at evenly spread places; each adds its size to upright, slanted, level or other-
    slanted.
    """
    u0, v0, u1, v1 = box
    high, wide = CELLS_HIGH * PATCH_STEP, CELLS_WIDE * PATCH_STEP
    y = ((v0 + (np.arange(high) + 0.5) * (v1 - v0) / high) / 2).astype(int).clip(1, half.shape[0] - 2)[:, None]
    x = ((u0 + (np.arange(wide) + 0.5) * (u1 - u0) / wide) / 2).astype(int).clip(1, half.shape[1] - 2)[None]
    image = half.astype(float)
    gx, gy = image[y, x + 1] - image[y, x - 1], image[y + 1, x] - image[y - 1, x]
    slanted = np.where(gx * gy > 0, 1, 3)
    turn = np.where(abs(gy) < 0.4142 * abs(gx), 0, np.where(abs(gx) < 0.4142 * abs(gy), 2, slanted))
    size = np.hypot(gx, gy)
    cells = np.add.outer(np.arange(high) // PATCH_STEP * CELLS_WIDE, np.arange(wide) // PATCH_STEP)
    bins = np.bincount((cells * TURNS + turn).ravel(), size.ravel(), LOOKS - 1)
    return np.array([*np.sqrt(bins / (size.sum() + size.size)), np.log(size.mean() + 1)])


def measure_beside(u0: float, u1: float, range_m: float, f_px: float, free_u: Floats, free_m: Floats) -> Floats:
    """Return (BESIDE,) where the road is free to the left and right of a thing.

    First how far beyond it on its left, on average, and how wide beside it; and on its right. Then how far beyond it in
    each distance of `ASIDE_M`, on its left and on its right; 0 where nothing is known.
    """
    out = np.zeros(BESIDE)
    n = len(free_u)
    step = (free_u[-1] - free_u[0]) / (n - 1) if n > 1 else 1.0
    start = free_u[0] if n else 0.0
    firsts = int(np.floor((u0 - BESIDE_PX - start) / step)), int(np.ceil((u1 + BESIDE_PX - start) / step))
    for side, (first, way) in enumerate(zip(firsts, (-1, 1), strict=True)):
        columns = first + way * np.arange(SIDES)
        columns = columns[np.cumprod((columns >= 0) & (columns < n)).astype(bool)]
        room = free_m[columns] - range_m
        known = ~np.isnan(room)
        if known.any():
            out[2 * side] = np.clip(room[known], -FAR_M, FAR_M).mean()
        blocked = np.flatnonzero(known & (room <= 0.5))
        before = room[: blocked[0]] if len(blocked) else room
        out[2 * side + 1] = min(np.count_nonzero(before > 0.5) * step / f_px * range_m, FAR_M)
        for k, aside_m in enumerate(ASIDE_M):
            at = int(((u0, u1)[side] + way * aside_m * f_px / range_m - start) / step + 0.5)
            if 0 <= at < n and not np.isnan(free_m[at]):
                out[4 + side * len(ASIDE_M) + k] = np.clip(free_m[at] - range_m, -FAR_M, FAR_M)
    return out


def grow_box(boxes: Floats, near: Floats, k: int) -> tuple[int, Floats]:
    """Return how many things, as near as thing k and touching it or each other, there are, and the box around them."""
    taken, box = {k}, boxes[k].copy()
    while True:
        reach = max(TOGETHER_M, TOGETHER_SHARE * near[k])
        before = len(taken)
        for j in range(len(boxes)):
            across, up = np.minimum(box[2:], boxes[j, 2:]) - np.maximum(box[:2], boxes[j, :2])
            touches = min(across, up) >= -TOUCH_PX and max(across, up) > 0
            if j not in taken and abs(near[j] - near[k]) <= reach and touches:
                taken.add(j)
                box[:2], box[2:] = np.minimum(box[:2], boxes[j, :2]), np.maximum(box[2:], boxes[j, 2:])
        if len(taken) == before:
            return before, box


def describe_things(
    half: Gray,
    uvd: Floats,
    bounds: Bounds,
    twin: Floats,
    road: Floats,
    size_px: Floats,
    free_u: Floats,
    free_m: Floats,
    figures: Floats,
) -> None:
    """Write the figures of all things: shape, looks, what is beside, and what it may be a piece of.

    Parameters
    ----------
    half
        Left image of half the size.
    uvd, bounds
        (m, 3) cells of all things, pixels, and (n + 1,) where each begins.
    twin, road, size_px
        (f, cx, cy, baseline); normal, height and bend of the road in the car frame, NaN without one; width and height.
    free_u, free_m
        Free space.
    figures
        (n, FIGURES or more), written.
    """
    boxes, near = np.empty((len(bounds) - 1, 4)), np.empty(len(bounds) - 1)
    beside = OWN + LOOKS
    for k in range(len(boxes)):
        cells = uvd[bounds[k] : bounds[k + 1]]
        n = min(len(cells), CELLS)
        some = cells[np.arange(n) * len(cells) // n]
        _, z, height, y = lifted(some, twin, road).T
        if np.isnan(road[0]):
            height = y.max() - y
        pitch = pitch_of(cells[:PITCH_CELLS])
        figures[k, :OWN] = measure_shape(some, z, height, pitch, len(cells), twin, size_px[0])
        near[k], low = np.exp(figures[k, 0]), figures[k, 3]
        boxes[k] = [*(some[:, :2].min(0) - 2), *(some[:, :2].max(0) + 2)]
        if low < FOOT_LOW_M:  # what stands on the road is seen down to it
            boxes[k, 3] = min(boxes[k, 3] + max(low, 0.0) * twin[0] / near[k], size_px[1])
        figures[k, OWN:beside] = measure_looks(half, boxes[k])
        u0, u1 = boxes[k, [0, 2]]
        figures[k, beside:TOGETHER] = measure_beside(u0, u1, near[k], twin[0], free_u, free_m)
    for k in range(len(boxes)):
        pieces, box = grow_box(boxes, near, k)
        size = box[2:] - box[:2]
        figures[k, TOGETHER : TOGETHER + 2] = np.log(size / twin[0] * near[k])
        share = np.prod(boxes[k, 2:] - boxes[k, :2]) / np.prod(size)
        figures[k, TOGETHER + 2 : TOGETHER + 5] = np.log(pieces), share, (boxes[k, 1] - box[1]) / size[1]
        figures[k, TOGETHER + 5 : FIGURES] = measure_looks(half, box)


def pick_colors(colors: Rgb, uvd: Floats, bounds: Bounds, step_px: int, samples: Rgb) -> None:
    """Write (n, s, 3) colours of all things: of evenly spread cells, the last `BACKGROUND` beside them.

    `colors` holds a pixel for each `step_px` pixels of the image both ways. Cells of one row come one after the other.
    """
    last = np.array(colors.shape[:2]) - 1
    own = samples.shape[1] - BACKGROUND
    for k in range(len(samples)):
        cells = uvd[bounds[k] : bounds[k + 1]]
        n = len(cells)
        row_of = np.concatenate([[0], np.cumsum(np.diff(cells[:, 1]) != 0)])
        ends = np.searchsorted(row_of, row_of, "left"), np.searchsorted(row_of, row_of, "right") - 1
        middle = (cells[ends[0], 0] + cells[ends[1], 0]) / 2
        rows = np.minimum(cells[:, 1].astype(int) // step_px, last[0])
        columns = np.minimum(cells[:, 0].astype(int) // step_px, last[1])
        inner = np.minimum((middle + INNER * (cells[:, 0] - middle)).astype(int) // step_px, last[1])
        some = np.arange(own) * n // own
        samples[k, :own] = colors[rows[some], inner[some]]
        s = np.arange(BACKGROUND)
        away = 2 + s // 2 % 4
        left, right = columns[some].min(), columns[some].max()
        beside = np.where(s % 2, np.maximum(left - away, 0), np.minimum(right + away, last[1]))
        samples[k, own:] = colors[rows[s * n // BACKGROUND], beside]


def pick_road(colors: Rgb, samples: Rgb) -> None:
    """Write (s, 3) colours of a block before the vehicle: its middle half, from 0.75 to 0.95 of the height down."""
    rows, columns = colors.shape[:2]
    s = np.arange(len(samples))
    row = rows * (0.75 + 0.2 * (s % ROAD_ROWS + 0.5) / ROAD_ROWS)
    column = columns * (0.25 + 0.5 * (s // ROAD_ROWS + 0.5) * ROAD_ROWS / len(samples))
    samples[:] = colors[row.astype(int), column.astype(int)]


def middle_color(colors: Rgb, out: Floats) -> None:
    """Write the (3,) median of (s, 3) colours, channel by channel; of an even number of them the upper one."""
    out[:] = np.sort(colors, axis=0)[len(colors) // 2]


def tally_colors(lab: Rgb, road_lab: Floats, out: Floats) -> None:
    """Write (n, COLOR_FIGURES) what colours things have, in the light of the road.

    Parameters
    ----------
    lab
        (n, s, 3) samples as `pick_colors` took them, in OpenCV's 8-bit CIELAB.
    road_lab
        (3,) CIELAB of the road.
    out
        Written: for each hue of `HUE_ENDS_DEG` its share (less what is seen beside) and its mean L, a, b; the share of
        grey, the lightness of a grey body (NaN without grey), the mean a and b of grey; mean and spread of the
        lightness.
    """
    gain = np.clip((ROAD_L + 16) / (road_lab[0] + 16), *GAIN_LIMITS)
    light = lab[..., 0] * (100 / 255)
    tint = np.minimum(light / max(road_lab[0], 1.0), 1.5)
    a, b = (gain * (lab[..., c] - 128.0 - tint * road_lab[c]) for c in (1, 2))
    light = np.maximum((light + 16) * gain - 16, 0.0)
    hues = np.digitize(np.degrees(np.arctan2(b, a)) % 360, HUE_ENDS_DEG) % HUES
    hues[a * a + b * b < (GREY_LEAST + GREY_SHARE * light) ** 2] = HUES
    own = lab.shape[1] - BACKGROUND
    for k, hue in enumerate(hues):
        for name in range(HUES):
            mine = np.flatnonzero(hue[:own] == name)
            behind = np.mean(hue[own:] == name)
            means = [c[k, mine].mean() if len(mine) else 0.0 for c in (light, a, b)]
            out[k, 4 * name : 4 * name + 4] = [max(len(mine) / own - SEEN_THROUGH * behind, 0.0), *means]
        grey = np.flatnonzero(hue[:own] == HUES)
        body = np.quantile(light[k, grey], BODY_SHARE) if len(grey) else np.nan
        tints = [c[k, grey].mean() if len(grey) else 0.0 for c in (a, b)]
        out[k, 4 * HUES :] = [len(grey) / own, body, *tints, light[k, :own].mean(), light[k, :own].std()]


def sum_up_colors(colors: Floats, out: Floats) -> None:
    """Write the last 8 of (n, INPUTS) what the model of types looks at: shares of hues, and that colours are seen."""
    share = colors[:, : 4 * HUES : 4].T
    groups = share[4], share[1] + share[2], share[3], share[5] + share[6], colors[:, 4 * HUES]
    out[:, FIGURES:] = np.stack([*groups, *colors[:, -2:].T / 25, np.ones(len(colors))], -1)


def steepest(steps: Floats, middle: float, reach: float, first: int, least: float) -> float:
    """Return where the largest of `steps` lies, to less than a step; `middle` where none is above `least`.

    The steps lie at `first`, `first` + 1, ...; one `reach` away from the middle counts half.
    """
    weighed = steps * (1 - 0.5 * np.abs(first + np.arange(len(steps)) - middle) / reach)
    if not len(steps) or weighed.max() <= least:
        return middle
    return first + peak(steps, int(weighed.argmax()))


def peak(steps: Floats, at: int) -> float:
    """Return where the peak of steps around the one `at` lies, as a parabola tells."""
    before, after = (steps[i] if 0 <= i < len(steps) else 0.0 for i in (at - 1, at + 1))
    bend = 2 * steps[at] - before - after
    return at + (float(np.clip((after - before) / (2 * bend), -0.5, 0.5)) if bend > 0 else 0.0)


def edge_near(half: Gray, row: int, cells_end: float, way: int, inward: float) -> float:
    """Return the column of the most likely upright edge of three rows of `half` near an end of the cells there.

    Cells reach beyond a thing more often than not: an edge is most likely `LIKELY_PX` inside of them, where it also is
    if none is seen. `way` is 1 at a left end, -1 at a right one; `inward` is how far inside it may be.
    """
    ends = sorted((cells_end - way * OUTWARD_PX / 2, cells_end + way * inward))
    first, last = max(int(np.ceil(ends[0])), 1), min(int(np.floor(ends[1])), half.shape[1] - 2)
    band = half[max(row - 1, 0) : min(row + 1, half.shape[0] - 1) + 1].astype(float)
    x = np.arange(first, last + 1)
    steps = abs(band[:, x + 1] - band[:, x - 1]).sum(0)
    likely = cells_end + way * min(LIKELY_PX / 2, inward)
    worth = steps / (1 + UNLIKELY * abs(x - likely))
    return likely if not len(x) or worth.max() <= EDGE_LEVELS * len(band) else first + peak(steps, int(worth.argmax()))


def top_near(half: Gray, middle: float, left: float, right: float, reach: float) -> float:
    """Return the row of the steepest level edge of the columns `left` to `right`, within `reach` of `middle`."""
    first, last = max(int(np.ceil(middle - reach)), 1), min(int(np.floor(middle + reach)), half.shape[0] - 2)
    band = half[:, max(int(left), 0) : min(int(right), half.shape[1] - 1) + 1].astype(float)
    y = np.arange(first, last + 1)
    return steepest(abs(band[y + 1] - band[y - 1]).sum(1), middle, reach, first, EDGE_LEVELS * max(band.shape[1], 1))


def cell_rows(uvd: Floats, feet: Floats, pitch: float, v0: float, step: float, rows: int) -> tuple[Floats, Floats]:
    """Return (rows,) left and right edge of the cells of each row; where there is none, between those around it."""
    first = np.maximum((uvd[:, 1] - 2 - v0) * (1 / step) + 0.5, 0).astype(int)
    last = np.minimum(np.maximum(((feet - v0) * (1 / step) - 0.5).astype(int), first), rows - 1)
    mine = (first[:, None] <= np.arange(rows)) & (np.arange(rows) <= last[:, None])
    known = np.flatnonzero(mine.any(0))
    left = [uvd[mine[:, k], 0].min() - pitch / 2 for k in known]
    right = [uvd[mine[:, k], 0].max() + pitch / 2 for k in known]
    return np.interp(np.arange(rows), known, left), np.interp(np.arange(rows), known, right)


def trace_thing(
    half: Gray, uvd: Floats, xzh: Floats, twin: Floats, bottom: float, edges: Floats, contour: Bounds
) -> int:
    """Write the outline of one thing, row by row from its upper end down its left and up its right side.

    Each row lies between the outermost cells of it, moved to the steepest edge of the image nearby; of three rows the
    middle place counts.

    Parameters
    ----------
    half
        Left image of half the size.
    uvd, xzh
        (n, 3) its cells, pixels; where they are: x, z, and height over the road, metres.
    twin, bottom
        Focal length, principal point and baseline; lower end of its box.
    edges
        (4,), written: leftmost and rightmost x in the left camera's frame, metres; upper and lower row.
    contour
        (2 * ROWS, 2), written.

    Returns
    -------
    How many points the contour has.
    """
    f_px, cx, _, baseline_m = twin
    pitch, v = pitch_of(uvd[:PITCH_CELLS]), uvd[:, 1]
    feet = np.where(xzh[:, 2] < FOOT_M, np.maximum(v + 2, v + xzh[:, 2] * f_px / xzh[:, 1]), v + 2)
    v0, v1 = max(v.min() - 2, 0.0), min(feet.max(), bottom)
    reach = (pitch / 2 + REACH_PX) / 2
    if v0 > 4:
        highest = uvd[v - 2 < v0 + 4, 0]
        begin, end = highest.min() - pitch / 2 + 2, highest.max() + pitch / 2 - 2
        v0 = min(2 * top_near(half, (v0 - 0.5) / 2, begin / 2, end / 2, reach) + 0.5, v1 - 2)
    rows = min(max(int((v1 - v0) / 2), 2), ROWS)
    step = (v1 - v0) / rows
    sides = cell_rows(uvd, feet, pitch, v0, step, rows)
    inward = np.minimum(INWARD_PX, INWARD_SHARE * (sides[1] - sides[0])) / 2
    y = np.minimum((v0 + (np.arange(rows) + 0.5) * step) / 2, half.shape[0] - 1).astype(int)
    sharp = [
        [
            2 * edge_near(half, row, (u - 0.5) / 2, way, r) + 0.5
            for row, u, r in zip(y.tolist(), side, inward, strict=True)
        ]
        for way, side in zip((1, -1), sides, strict=True)
    ]
    beside = [np.pad(side, 1, mode="edge") for side in sharp]
    u, w = (np.median([side[:-2], side[1:-1], side[2:]], axis=0) for side in beside)
    w = np.maximum(w, u + 1)
    at = v0 + (np.arange(rows) + 0.5) * step
    at[0], at[-1] = v0, v1
    contour[:rows] = np.stack([np.ceil(u), np.rint(at)], -1)
    contour[rows : 2 * rows] = np.stack([np.floor(w), np.rint(at)], -1)[::-1]
    # The outermost rows may be stray; how far away an end is, the cells there tell.
    ends = np.sort(u)[rows // STRAY_ROWS], np.sort(w)[-1 - rows // STRAY_ROWS]
    margin = max(1.5 * pitch, END_SHARE * (ends[1] - ends[0]))
    for side, end in enumerate(ends):
        off = abs(uvd[:, 0] - end)
        there = off <= margin if (off <= margin).any() else off == off.min()
        edges[side] = (end - cx) * baseline_m / uvd[there, 2].mean()
    edges[2:] = v0, v1
    return 2 * rows


def trace_things(
    half: Gray,
    uvd: Floats,
    bounds: Bounds,
    bottoms: Floats,
    twin: Floats,
    road: Floats,
    edges: Floats,
    contours: Bounds,
    counts: Bounds,
) -> None:
    """Write the outlines of all things, whose boxes end at rows `bottoms` (n,); see `trace_thing`."""
    for k in range(len(counts)):
        cells = uvd[bounds[k] : bounds[k + 1]]
        xzh = np.nan_to_num(lifted(cells, twin, road)[:, :3], nan=FOOT_M)
        counts[k] = trace_thing(half, cells, xzh, twin, bottoms[k], edges[k], contours[k])


def ends_of(values: Floats) -> tuple[float, float]:
    """Return the least and the largest value; where there are many, the second ones."""
    stray = int(len(values) > STRAY_FROM)
    ordered = np.sort(values)
    return float(ordered[stray]), float(ordered[-1 - stray])


def turned(x: Floats, z: Floats, sigma_m: Floats, angle: float) -> tuple[float, tuple[float, ...]]:
    """Return how badly the visible sides of a rectangle turned by `angle` explain places, and its (4,) extent."""
    along, across = np.cos(angle) * z + np.sin(angle) * x, np.cos(angle) * x - np.sin(angle) * z
    front, back, low, high = *ends_of(along), *ends_of(across)
    off = abs(along - front)
    if low > 0 or high < 0:
        off = np.minimum(off, abs(across - (low if low > 0 else high)))
    return float(np.minimum(off / sigma_m, 3.0).sum()), (front, back, low, high)


def fit_outline(x: Floats, z: Floats, sigma_m: Floats, out: Floats) -> None:
    """Fit a rectangle to places of a surface seen from above: one side across and one along are seen, the nearer ones.

    Parameters
    ----------
    x, z, sigma_m
        (n,) places to the right and ahead, and one standard deviation of the distance, metres.
    out
        (OUTLINE_FIGURES,), written: by how much its first axis is turned from straight ahead to the right, radians;
        where it begins and ends along it, and across it, metres; how badly the best rectangle explains the places
        (standard deviations, each at most 3), and how badly all directions do on average.
    """
    unit = np.pi / 2 / HEADINGS
    costs = np.array([turned(x, z, sigma_m, k * unit)[0] for k in range(HEADINGS)])
    at = int(costs.argmin())
    before, after = costs[at - 1], costs[(at + 1) % HEADINGS]
    bend = before + after - 2 * costs[at]
    angle = unit * (at + (np.clip((before - after) / (2 * bend), -0.5, 0.5) if bend > 0 else 0.0))
    extent = turned(x, z, sigma_m, angle)[1]
    out[:] = [angle, *extent, costs[at] / len(x), costs.mean() / len(x)]


def outline_things(uvd: Floats, bounds: Bounds, twin: Floats, sigma_px: Floats, figures: Floats) -> None:
    """Write (n, OUTLINE_FIGURES) the outlines on the road of all things, whose disparities have these sigmas (n,)."""
    f, cx, _, baseline = twin
    for k in range(len(figures)):
        n = bounds[k + 1] - bounds[k]
        count = min(n, POINTS)
        u, _, d = uvd[bounds[k] + np.arange(count) * n // count].T
        z = f * baseline / d
        sigma_m = np.maximum(z / d * sigma_px[k], 0.03)
        fit_outline((u - cx) / f * z - baseline / 2, z, sigma_m, figures[k])
