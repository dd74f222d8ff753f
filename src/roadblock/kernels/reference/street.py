"""What stands on the road, readably: heights, free space per column, and cells joined to things.

Shared by all: `d_px` is (rows, columns) float32 disparities of cells, NaN (or not above 0) where unknown; `z` and
`height` are (rows, columns) float32 metres, NaN where unknown; a cell's number is row * columns + column. `twin` is
(f, cx, cy in pixels, baseline in metres); `road` is (n_x, n_y, n_z, h in metres, bend per metre), all NaN without one:
`n . p + h - bend z^2` is the height of p over it, in the car frame (x right, y down, z forward).

Kernels write into arrays that the caller owns.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Ints = NDArray[np.int32]

NOTHING = np.int32(-1)
"""Number of what belongs to no thing."""
SLANT = 1.5
"""Neighbours beside each other may differ by this many times what others may."""
BINS_PER_PX = 2
"""Disparities of a column are counted in steps of half a pixel."""
BESIDE = 2
"""A cell is seen if one of this many columns to either side is known."""
DEEP_M, DEEP_SHARE = 0.5, 0.05
"""What stands together lies within this depth, or this share of its range."""
STRAY = 2
"""Free space ends at this many cells of what stands together, at least."""
ROAD_CELLS = 4
"""The farthest cells of road, past which a column is unknown."""
DEPTH_SHARES = (0.05, 0.95)
"""A thing's depth reaches from here to there."""
BESIDE_SHARE, BEHIND = 0.5, 0.9
"""Pieces lie side by side that share so much of the lower one's rows; and what has less than this share of their
disparity lies behind them."""
HIDDEN_SHARE = 0.85
"""A box that lies in a nearer one by more than this is seen through it, ..."""
FULL_SHARE = 0.5
"""... if more than this of the nearer one is cells."""
LATTICE, SPREAD = 2, 0.6
"""What encloses cells of a nearer thing in this share of its columns (or so many beside them) is behind a lattice."""
SECOND_DIFFERENCE = 1.4826 / np.sqrt(1.5)
"""From the median of |d - mean of two neighbours| to one standard deviation of d."""


def raise_cells(
    d_px: Singles, cell_w: int, cell_h: int, twin: Floats, road: Floats, z: Singles, height: Singles
) -> None:
    """Write how far ahead each cell is, and how high over the road.

    Parameters
    ----------
    d_px
        Disparities.
    cell_w, cell_h
        Width and height of a cell, pixels.
    twin, road
        See the module.
    z, height
        Written; heights are NaN without a road.
    """
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, h, bend = road
    rows, columns = d_px.shape
    depth = f * baseline / np.where(d_px > 0, d_px, np.nan).astype(np.float64)
    x = (cell_w * np.arange(columns) + (cell_w - 1) / 2 - cx) / f * depth - baseline / 2
    y = (cell_h * np.arange(rows)[:, None] + (cell_h - 1) / 2 - cy) / f * depth
    z[:] = depth
    height[:] = n_x * x + n_y * y + n_z * depth + h - bend * depth**2


def find_holes(height: Singles, road_m: Floats, cell_h: int, hides_px_m: float, hole: Floats) -> None:
    """Write where each column, from below, has the first hole that could hide something.

    Parameters
    ----------
    height
        Heights of the cells. A cell is seen if it or one of `BESIDE` columns to either side is known.
    road_m
        (rows,) range at which each row sees the road; not finite from the horizon upwards.
    cell_h
        Height of a cell, pixels.
    hides_px_m
        Focal length times the height that may not hide, pixels times metres.
    hole
        (columns,), written: range of the road below the hole, metres; 0 where the hole begins at the image's edge,
        infinity where there is none.
    """
    rows, columns = height.shape
    hole[:] = np.inf
    if rows == 0:
        return
    seen = maximum_filter1d(~np.isnan(height), 2 * BESIDE + 1, axis=1, mode="constant")
    ranges = np.append(road_m, 0.0)
    for column in range(columns):
        last_seen = rows
        for row in range(rows - 1, -1, -1):
            if not road_m[row] < np.inf:
                break
            if seen[row, column]:
                last_seen = row
            elif (last_seen - row) * cell_h * max(ranges[last_seen], road_m[-1]) >= hides_px_m:
                hole[column] = ranges[last_seen]
                break


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
    """Write how far each column is free: up to what stands first, or else to the last road seen.

    Parameters
    ----------
    d_px, height
        Disparities and heights of the cells.
    fb
        Focal length times baseline, pixels times metres.
    heights
        (low, high, road), metres: what is between the first two stands; what else is this near to 0 is road.
    support
        So many cells must stand close together, ...
    spread
        ... in a column and as many to either side.
    quantile
        Free space ends at this share of those cells, and at `STRAY` of them at least.
    free
        (columns,), written: range in metres, the mean of the cells of one disparity bin; NaN where neither was seen.
    blocked
        (columns,), written: whether something standing ends it.
    """
    low, high, road = heights
    known = d_px > 0
    bins = (np.where(known, d_px, 0) * BINS_PER_PX).astype(np.int64)
    stands = known & (low < height) & (height < high)
    lies = known & ~stands & (abs(height) < road)
    for column in range(len(free)):
        near = slice(max(0, column - spread), column + spread + 1)
        mine, d = bins[:, near], d_px[:, near]
        ends, at = stands[:, near], _first_standing(mine[stands[:, near]], fb, support, quantile)
        blocked[column] = at >= 0
        if at < 0:
            ends = lies[:, near]
            farthest = np.sort(mine[ends])
            at = farthest[ROAD_CELLS - 1] if len(farthest) >= ROAD_CELLS else -1
        free[column] = fb / d[ends & (mine == at)].mean(dtype=np.float64) if at >= 0 else np.nan


def _first_standing(bins: NDArray[np.int64], fb: float, support: int, quantile: float) -> int:
    """Return the disparity bin where free space ends, given those of all cells that stand; -1 if too few do."""
    for first in np.unique(bins)[::-1]:
        nearest = fb * BINS_PER_PX / (first + 1)
        behind = int(fb * BINS_PER_PX / (nearest + max(DEEP_M, DEEP_SHARE * nearest)))
        together = np.sort(bins[(bins >= behind) & (bins <= first)])[::-1]
        n = len(together)
        if n >= support:
            return int(together[int(np.ceil(min(max(STRAY, quantile * n), n))) - 1])
    return -1


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
    """Write which cells that stand on the road belong together: the parts of a graph.

    Two cells are linked if they are near in range or in disparity, and lie in one row up to `gap_columns` apart, in one
    column up to `gap_rows` apart, or corner to corner. Side by side, the disparity may differ `SLANT` times as much: a
    wall along the road does.

    Parameters
    ----------
    d_px, z, height
        The cells. Where the height is NaN, what is in reach stands.
    limits
        (reach, low, high), metres: what is nearer than the first, between the other two heights, stands.
    links
        (metres, pixels): less than this apart is near.
    gap_columns, gap_rows
        Cells; 1 links direct neighbours.
    parent
        (rows * columns,), written: smallest cell number of the thing each cell belongs to, `NOTHING` for none.
    """
    reach, low, high = limits
    link_m, link_px = links
    stands = (z < reach) & ((low < height) & (height < high) | np.isnan(height))
    ways = [(0, k, SLANT if k == 1 else 1.0) for k in range(1, gap_columns + 1)]
    ways += [(k, 0, 1.0) for k in range(1, gap_rows + 1)] + [(1, 1, 1.0), (1, -1, 1.0)]
    linked = np.zeros((z.size, z.size), np.bool_)
    for r, c in np.argwhere(stands):
        for up, left, slant in ways:
            i, j = r - up, c - left
            if i < 0 or not 0 <= j < z.shape[1] or not stands[i, j]:
                continue
            near = abs(z[i, j] - z[r, c]) < link_m or abs(d_px[i, j] - d_px[r, c]) < slant * link_px
            linked[r * z.shape[1] + c, i * z.shape[1] + j] = near
    if z.size:
        _, thing = connected_components(coo_array(linked), directed=False)
        _, first = np.unique(thing, return_index=True)
        parent[:] = np.where(stands.ravel(), first[thing], NOTHING)


def quantile_of(values: Floats | Singles, share: float) -> float:
    """Return the value that `share` of the others lie below, between neighbours linearly.

    Parameters
    ----------
    values
        (n,), n >= 1, no NaN; the compiled one reorders them.
    share
        0 .. 1.
    """
    return float(np.quantile(values.astype(np.float64), share))


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
    """Cut things that are long in depth into pieces of one ratio of ranges; leave out specks and what hangs above.

    Parameters
    ----------
    parent
        (rows * columns,) of `link`.
    z, height
        Of the cells.
    fb
        Focal length times baseline, pixels times metres. A pixel of disparity to either side adds to a thing's depth.
    least
        Cells of the smallest thing, and piece, that stays.
    overhead_m
        A piece whose lowest cell is as high or higher hangs; NaN without a road.
    split_m
        Depth of a piece, metres.
    near_share
        Quantile of a piece's ranges that is its nearest face.
    cells
        (rows * columns,), written: cell numbers of one piece after the other, rising within each. Things come in the
        order of their first cell, their pieces from near to far.
    bounds
        (most + 1,), written: where each piece begins, and where the last ends. Pieces beyond `most` are left out.
    nearest
        (most,), written: range of each piece's nearest face, metres.

    Returns
    -------
    Number of pieces.
    """
    depths, heights = z.ravel(), height.ravel()
    found = used = 0
    for thing in np.unique(parent[parent != NOTHING]):
        members = np.flatnonzero(parent == thing)
        if len(members) < least:
            continue
        near, far = np.quantile(depths[members].astype(np.float64), DEPTH_SHARES)
        pieces = int(max(0.0, far - near - 2 * far * far / fb) / split_m) + 1
        edges = near * (far / near) ** (np.arange(1, pieces) / pieces)
        places = np.searchsorted(edges, depths[members], side="right")
        for place in range(pieces):
            piece = members[places == place]
            if len(piece) < max(least, 1) or heights[piece].min() >= overhead_m or found + 1 >= len(bounds):
                continue
            cells[used : used + len(piece)] = piece
            bounds[found], nearest[found] = used, quantile_of(depths[piece], near_share)
            used += len(piece)
            found += 1
    bounds[found] = used
    return found


def measure_boxes(cells: Ints, bounds: Ints, found: int, columns: int, boxes: Ints) -> None:
    """Write the box around each piece.

    Parameters
    ----------
    cells, bounds, found
        Of `gather_pieces`.
    columns
        Of the grid.
    boxes
        (found, 4), written: first column, first row, last column + 1, last row + 1, cells.
    """
    for k in range(found):
        row, column = np.divmod(cells[bounds[k] : bounds[k + 1]], columns)
        boxes[k] = column.min(), row.min(), column.max() + 1, row.max() + 1


def join_pieces(
    d_px: Singles,
    z: Singles,
    limits: Floats,
    near_share: float,
    cells: Ints,
    bounds: Ints,
    boxes: Ints,
    nearest: Floats,
) -> int:
    """Join pieces side by side between which nothing was seen: smooth bodies show little but their edges near by.

    Parameters
    ----------
    d_px, z
        The cells.
    limits
        (reach, near, gap, share): pieces nearer than the first, whose nearest faces differ by less than the second,
        metres, are joined if no more than `gap / range` columns lie between them, and in these no more than this share
        of the cells is known and lies behind them.
    near_share
        Of `gather_pieces`.
    cells, bounds, boxes, nearest
        Of `gather_pieces` and `measure_boxes`, of all pieces, (found + 1,), (found, 4) and (found,); changed.

    Returns
    -------
    Number of things, which come first in all of them, in the order of their first pieces.
    """
    reach, near, gap, share = limits
    found = len(nearest)
    joined = np.eye(found, dtype=bool)
    for i in range(found):
        for j in range(found):
            (_, r0, c1, r1), (e0, s0, _, s1) = boxes[i], boxes[j]
            first, last, range_m = max(r0, s0), min(r1, s1), min(nearest[i], nearest[j])
            if not (max(nearest[i], nearest[j]) < reach and abs(nearest[i] - nearest[j]) < near):
                continue
            if not 0 <= e0 - c1 <= gap / range_m or last - first < BESIDE_SHARE * min(r1 - r0, s1 - s0):
                continue
            between = d_px[first:last, c1:e0]
            front = min(d_px.ravel()[cells[bounds[k] : bounds[k + 1]]].mean(dtype=np.float64) for k in (i, j))
            joined[i, j] = np.count_nonzero((between > 0) & (between < BEHIND * front)) <= share * between.size
    _, thing = connected_components(coo_array(joined), directed=False)
    members = [np.flatnonzero(thing == k) for k in dict.fromkeys(thing.tolist())]
    pieces = [np.sort(np.concatenate([cells[bounds[k] : bounds[k + 1]] for k in mine])) for mine in members]
    around = [[*boxes[mine, :2].min(0), *boxes[mine, 2:].max(0)] for mine in members]
    for k, piece in enumerate(pieces):
        if len(members[k]) > 1:
            nearest[k] = quantile_of(z.ravel()[piece], near_share)
        else:
            nearest[k] = nearest[members[k][0]]
        boxes[k] = around[k]
        cells[bounds[k] : bounds[k] + len(piece)] = piece
        bounds[k + 1] = bounds[k] + len(piece)
    return len(pieces)


def roughness(d_px: Singles, cells: Ints, scratch: Singles, member: Ints, number: int) -> float:
    """Return one standard deviation of a surface's disparities, from how each differs from its two neighbours' mean.

    Parameters
    ----------
    d_px
        Disparities.
    cells
        (n,) cell numbers of one piece.
    scratch
        (2 n,), written.
    member
        (rows * columns,), set to `number` at `cells`; neighbours count if they have it, too.
    number
        Of the piece, not given to another.

    Returns
    -------
    Pixels; NaN if no cell lies between two others.
    """
    rows, columns = d_px.shape
    member[cells] = number
    mine = member.reshape(rows, columns) == number
    d = d_px.astype(np.float64)
    across = mine[:, 1:-1] & mine[:, :-2] & mine[:, 2:]
    down = mine[1:-1] & mine[:-2] & mine[2:]
    off = np.concatenate(
        [
            (d[:, 1:-1] - (d[:, :-2] + d[:, 2:]) / 2)[across],
            (d[1:-1] - (d[:-2] + d[2:]) / 2)[down],
        ]
    )
    scratch[: len(off)] = abs(off)
    return float(SECOND_DIFFERENCE * np.median(abs(off))) if len(off) else np.nan


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
    """Write the samples of one piece and its outline.

    Parameters
    ----------
    d_px, height
        Of the grid.
    cells
        (n,) cell numbers of the piece, n >= 1.
    cell_w, cell_h
        Width and height of a cell, pixels.
    foot_m
        A column whose lowest cell is below this height goes on down to the road.
    bottom_px
        Row of the image that ends the piece there.
    member, number
        As for `roughness`.
    uvd
        (n, 3), written: column, row and disparity of each cell's centre, pixels.
    outline
        (4 per column of the piece or more, 2), written: column and row of each corner, pixels that belong to the
        piece; its top from left to right, then its bottom from right to left. A column without a cell takes after its
        left neighbour.

    Returns
    -------
    The `roughness`, and the number of corners.
    """
    row, column = np.divmod(cells, d_px.shape[1])
    uvd[:, 0] = column * cell_w + (cell_w - 1) / 2
    uvd[:, 1] = row * cell_h + (cell_h - 1) / 2
    uvd[:, 2] = d_px.ravel()[cells]
    heights = height.ravel()[cells]
    tops: list[int] = []
    bottoms: list[int] = []
    for k in range(column.min(), column.max() + 1):
        own = column == k
        if not own.any():
            tops.append(tops[-1])
            bottoms.append(bottoms[-1])
            continue
        bottom = (row[own].max() + 1) * cell_h - 1
        tops.append(row[own].min() * cell_h)
        bottoms.append(max(bottom, bottom_px - 1) if heights[own].min() < foot_m else bottom)
    first_px = column.min() * cell_w
    corners = np.concatenate([_steps(tops, first_px, cell_w), _steps(bottoms, first_px, cell_w)[::-1]])
    outline[: len(corners)] = corners
    return roughness(d_px, cells, np.empty(2 * len(cells), np.float32), member, number), len(corners)


def _steps(levels: list[int], first_px: int, cell_w: int) -> NDArray[np.int64]:
    """Return (n, 2) the first and the last pixel of each level stretch of a line of steps, left to right."""
    change = np.flatnonzero(np.diff(levels))
    firsts, lasts = np.append(0, change + 1), np.append(change, len(levels) - 1)
    level = np.array(levels)[firsts]
    left, right = first_px + firsts * cell_w, first_px + (lasts + 1) * cell_w - 1
    return np.stack([left, level, right, level], -1).reshape(-1, 2)


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
    """Write the samples of some pieces, and their outlines.

    Parameters
    ----------
    d_px, height
        Of the grid.
    cells, bounds
        Of `gather_pieces`.
    order
        (n,) numbers of the pieces to describe.
    boxes
        (pieces, 4) first column, first row, last column + 1, last row + 1, pixels, down to the road.
    cell_w, cell_h, foot_m
        As for `describe`.
    uvd
        (cells, 3), written where `cells` are of a described piece; see `describe`.
    outline
        (4 per column of each piece or more, 2), written: the outlines, in order.
    corners
        (n + 1,), written: where each outline begins, and where the last ends.
    rough_px
        (n,), written: the `roughness` of each.
    """
    member = np.full(d_px.size, NOTHING)
    corners[0] = 0
    for k, piece in enumerate(order):
        own = slice(bounds[piece], bounds[piece + 1])
        about = cell_w, cell_h, foot_m, boxes[piece, 3], member, k
        rough_px[k], n = describe(d_px, height, cells[own], *about, uvd[own], outline[corners[k] :])
        corners[k + 1] = corners[k] + n


def mean_colors(
    middles: NDArray[np.uint8], cells: Ints, bounds: Ints, order: NDArray[np.int64], columns: int, colors: Floats
) -> None:
    """Write the mean colour of some pieces, in the image's own scale.

    Parameters
    ----------
    middles
        (rows or more, columns or more, 3) the pixel in the middle of each cell.
    cells, bounds
        Of `gather_pieces`.
    order
        (n,) numbers of the pieces.
    columns
        Of the grid.
    colors
        (n, 3), written.
    """
    for k, piece in enumerate(order):
        colors[k] = middles[np.divmod(cells[bounds[piece] : bounds[piece + 1]], columns)].mean(0)


def drop_hidden(boxes: Ints, areas: Ints, kept: NDArray[np.bool_]) -> None:
    """Write which boxes are not seen through a nearer one that is kept.

    Parameters
    ----------
    boxes
        (n, 4) first column, first row, last column + 1, last row + 1, pixels; nearest first.
    areas
        (n,) what of each is cells, pixels squared.
    kept
        (n,), written.
    """
    low, high = boxes[:, :2].astype(np.int64), boxes[:, 2:].astype(np.int64)
    full = areas > FULL_SHARE * (high - low).prod(-1)
    for i in range(len(boxes)):
        common = np.maximum(0, np.minimum(high[i], high[:i]) - np.maximum(low[i], low[:i])).prod(-1)
        kept[i] = not (kept[:i] & full[:i] & (common > HIDDEN_SHARE * (high[i] - low[i]).prod())).any()


def find_through(cells: Ints, bounds: Ints, order: NDArray[np.int64], columns: int, through: NDArray[np.bool_]) -> None:
    """Write which pieces are seen through a nearer one that is no solid thing: a fence, a railing, twigs.

    A cell of a nearer piece is enclosed if cells of the farther one lie both above and below it, or both left and right
    of it. Enclosed cells all over the farther piece make a lattice; in one part of it, they are something before it.

    Parameters
    ----------
    cells, bounds
        As `gather_pieces` writes them.
    order
        (n,) the pieces to look at, nearest first.
    columns
        Of the grid.
    through
        (n,), written.
    """
    pieces = [np.stack(np.divmod(cells[bounds[k] : bounds[k + 1]], columns), -1) for k in order]
    for i, mine in enumerate(pieces):
        low, high = mine.min(0), mine.max(0) + 1
        far, near = np.zeros(high - low, bool), np.zeros(high - low, bool)
        far[tuple((mine - low).T)] = True
        for other in pieces[:i]:
            inside = other[((other >= low) & (other < high)).all(-1)]
            near[tuple((inside - low).T)] = True
        enclosed = np.zeros_like(near)
        for axis in (0, 1):
            before = np.logical_or.accumulate(far, axis)
            after = np.flip(np.logical_or.accumulate(np.flip(far, axis), axis), axis)
            enclosed |= near & before & after
        crossed = maximum_filter1d(enclosed.any(0), 2 * LATTICE + 1, mode="constant")
        through[i] = np.count_nonzero(crossed) >= SPREAD * len(crossed)


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
    """Write the upright pieces of each column: cells of like range, one above the other.

    Parameters
    ----------
    d_px, z, height
        See the module.
    limits
        (reach, low, high), metres: what is nearer than the first, and of a height between the others, stands.
    links
        (metres, pixels): the next cell upwards belongs to the piece if it is this near to the last one.
    gap_rows
        And no more rows above it.
    least
        Pieces of fewer cells are left out.
    stixels
        (m, 5), written: column, first row, last row + 1, mean disparity, height of the top cell. What does not fit in
        is left out.

    Returns
    -------
    How many there are.
    """
    reach, low, high = limits
    rows, columns = z.shape
    stands = (z < reach) & (((height > low) & (height < high)) | np.isnan(height))
    found = 0
    for column in range(columns):
        run: list[int] = []
        for row in [*range(rows - 1, -1, -1), -1]:
            if row >= 0 and not stands[row, column]:
                continue
            goes_on = row >= 0 and (
                not run
                or (
                    run[-1] - row <= gap_rows
                    and (
                        abs(z[row, column] - z[run[-1], column]) < links[0]
                        or abs(d_px[row, column] - d_px[run[-1], column]) < links[1]
                    )
                )
            )
            if goes_on:
                run.append(row)
                continue
            if len(run) >= least and found < len(stixels):
                d = float(d_px[run, column].astype(float).mean())
                stixels[found] = column, run[-1], run[0] + 1, d, height[run[-1], column]
                found += 1
            run = [row]
    return found
