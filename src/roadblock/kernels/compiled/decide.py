"""The kernels of `reference.decide`, compiled: same names, same arguments, same numbers to rounding."""

import math

import numba
import numpy as np

from roadblock.kernels.reference.decide import (
    AGAINST,
    AHEAD_M,
    AHEAD_S,
    ALONE,
    ALONE_M,
    AT_SIDE_M,
    BEHIND_M,
    BESIDE_M,
    BESIDE_SHARE,
    CELL_M,
    CLOSING_MPS,
    COLUMN_SIGMA_PX,
    DEEP_M,
    EDGE_M,
    EDGE_PX,
    FACE_STEP_M,
    FREE_M,
    FREE_SIGMAS,
    HARDLY_ASIDE_MPS,
    HARDLY_DOUBT,
    HARDLY_MPS,
    HARDLY_S,
    LEAST_ROOM_M,
    MOST,
    MOST_WARY_M,
    MOVES,
    NEIGHBOUR_SHARE,
    SETTLED_DOUBT,
    SETTLED_S,
    SLOW_MPS,
    SPREAD,
    SPREAD_M,
    STANDS,
    STANDS_THERE,
    SURE,
    TINY,
    TOWARDS_MPS,
    WARY_M,
    WIDE_M,
    YOUNG_DOUBT,
    YOUNG_S,
    Flags,
    Floats,
    Integers,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def weigh(
    velocity_mps: Floats, cov_m2ps2: Floats, motion: Integers, age_s: Floats, has_velocity: Flags, is_mover: Flags
) -> tuple[Floats, Floats, Floats, Floats]:
    """See `reference.decide.weigh`."""
    n = len(motion)
    speed, sigma, doubt, likely = np.zeros((n, 2)), np.empty((n, 2)), np.zeros(n), np.zeros(n)
    for k in range(n):
        counts = has_velocity[k] and motion[k] != STANDS and (is_mover[k] or age_s[k] >= SETTLED_S)
        known = motion[k] == STANDS or (counts and (is_mover[k] or motion[k] == MOVES))
        for i in range(2):
            sigma[k, i] = math.sqrt(cov_m2ps2[k, i, i])
        ahead, aside = velocity_mps[k, 0] + 2 * sigma[k, 0], abs(velocity_mps[k, 1]) + 2 * sigma[k, 1]
        hardly = has_velocity[k] and age_s[k] >= HARDLY_S and ahead < HARDLY_MPS and aside < HARDLY_ASIDE_MPS
        if not known:
            doubt[k] = HARDLY_DOUBT if hardly else SETTLED_DOUBT if age_s[k] >= YOUNG_S else YOUNG_DOUBT
        v0, v1 = velocity_mps[k, 0], velocity_mps[k, 1]
        if not known and v0 < TOWARDS_MPS:
            v0, v1 = 0.0, v1 - cov_m2ps2[k, 0, 1] / max(cov_m2ps2[k, 0, 0], TINY) * v0
        if has_velocity[k] and motion[k] != STANDS and age_s[k] >= HARDLY_S:
            likely[k] = v1 if is_mover[k] or abs(v1) > sigma[k, 1] else 0.0
        if counts:
            speed[k, 0] = v0 if abs(v0) > 2 * sigma[k, 0] else 0.0
            speed[k, 1] = v1 if abs(v1) > 2 * sigma[k, 1] else 0.0
        if not has_velocity[k]:
            sigma[k, :] = 0.0
    return speed, sigma, doubt, likely


@numba.njit(cache=True, nogil=True, error_model="numpy")
def among(numbers: Integers, others: Integers) -> Flags:
    """See `reference.decide.among`."""
    found = np.zeros(len(numbers), np.bool_)
    for k in range(len(numbers)):
        for other in others:
            if other == numbers[k]:
                found[k] = True
                break
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def outline(
    sides_px: Floats,
    range_m: Floats,
    size_m: Floats,
    feet_m: Floats,
    velocity_mps: Floats,
    is_new: Flags,
    tracked: int,
    grid: Floats,
    free_m: Floats,
    is_blocked: Flags,
    twin: Floats,
    R: Floats,
) -> tuple[Floats, Integers, Integers]:
    """See `reference.decide.outline`."""
    n, columns = len(range_m), len(free_m)
    evidence, leaves_none = np.zeros(columns, np.int64), np.zeros(columns, np.bool_)
    for c in range(columns - 1):
        apart_m, most_m = abs(free_m[c + 1] - free_m[c]), NEIGHBOUR_SHARE * min(free_m[c], free_m[c + 1])
        if is_blocked[c] and is_blocked[c + 1] and apart_m <= most_m:
            for one in (c, c + 1):
                evidence[one] = ALONE if free_m[one] < ALONE_M else STANDS_THERE
    most = 2
    # Of all things, and of those that are no walls.
    off_m, nearest = np.full((2, columns), np.inf), np.full((2, columns), -1)
    near_m = np.maximum(BESIDE_SHARE * range_m, DEEP_M)
    first_m, last_m = range_m - near_m, range_m + near_m + size_m[:, 1]
    for k in range(n):
        most += columns + 2 + math.ceil(size_m[k, 0] / FACE_STEP_M)
        is_fast = math.hypot(velocity_mps[k, 0], velocity_mps[k, 1]) > SLOW_MPS
        leaves = not (is_fast or is_new[k])
        is_wall = leaves and size_m[k, 0] > WIDE_M
        edge_px = 0.0 if leaves else max(EDGE_PX, EDGE_M * twin[0] / range_m[k])
        first = max(0, math.ceil((sides_px[k, 0] - edge_px - grid[0]) / grid[1]))
        last = min(columns, math.ceil((sides_px[k, 1] + edge_px - grid[0]) / grid[1]))
        for c in range(first, last):
            if not (is_blocked[c] and free_m[c] >= first_m[k]):
                continue
            if leaves and evidence[c] > 0:
                evidence[c] = STANDS_THERE
            if free_m[c] > last_m[k]:
                continue
            if not leaves:
                leaves_none[c] = True
            off = abs(free_m[c] - range_m[k])
            for i in range(1 if is_wall else 2):
                if off < off_m[i, c]:
                    off_m[i, c], nearest[i, c] = off, k
    evidence[leaves_none] = 0
    at_m, owner, m = np.empty((most, 2)), np.empty(most, np.int64), 0
    for k in range(tracked):
        begin, shared = m, 0
        first = max(0, math.ceil((sides_px[k, 0] - grid[0]) / grid[1]))
        last = min(columns, math.ceil((sides_px[k, 1] - grid[0]) / grid[1]))
        for c in range(first, last):
            if not (is_blocked[c] and first_m[k] <= free_m[c] <= last_m[k]):
                continue
            shared += 1
            if nearest[1 if leaves_none[c] else 0, c] != k:
                continue
            z = max(free_m[c], range_m[k])
            x = (grid[0] + grid[1] * c - twin[1]) / twin[0] * z - twin[3] / 2
            at_m[m, 0], at_m[m, 1] = R[0, 0] * x + R[0, 1] * z, R[1, 0] * x + R[1, 1] * z
            m += 1
        if shared < 2:
            x0, x1 = (sides_px[k] - twin[1]) / twin[0] * range_m[k] - twin[3] / 2
            y0, y1 = R[1, 0] * x0 + R[1, 1] * range_m[k], R[1, 0] * x1 + R[1, 1] * range_m[k]
            low = max(min(y0, y1), feet_m[k, 1] - size_m[k, 0] / 2)
            high = min(max(y0, y1), feet_m[k, 1] + size_m[k, 0] / 2)
            if low > high:
                low = high = feet_m[k, 1]
            count = max(2, math.ceil((high - low) / FACE_STEP_M) + 1)
            m = begin + count
            for i in range(count):
                at_m[begin + i, 0], at_m[begin + i, 1] = feet_m[k, 0], low + (high - low) * i / (count - 1)
        owner[begin:m] = k
    return at_m[:m], owner[:m], evidence


@numba.njit(cache=True, nogil=True, error_model="numpy")
def recall(
    cells: Integers,
    evidence: Integers,
    own: Floats,
    grid: Floats,
    reach_m: Floats,
    gained: Integers,
    foot_m: float,
    twin: Floats,
    R: Floats,
) -> tuple[Integers, Integers, Floats]:
    """See `reference.decide.recall`; cells are found again by a hash table with open addresses."""
    old, columns = len(cells), len(reach_m)
    scale = COLUMN_SIGMA_PX / (twin[0] * twin[3])
    most = old + SPREAD * (gained > 0).sum()
    mask = 64
    while mask < 2 * most:
        mask *= 2
    mask -= 1
    table = np.full(mask + 1, -1, np.int64)
    all_cells, counts, fresh = np.empty((most, 2), np.int64), np.empty(most, np.int64), np.zeros(most, np.int64)
    for k in range(old):
        all_cells[k], counts[k] = cells[k], evidence[k]
        h = (cells[k, 0] * 73856093 ^ cells[k, 1] * 19349663) & mask
        while table[h] >= 0:
            h = (h + 1) & mask
        table[h] = k
    n, cos, sin = old, own[2], own[3]
    for c in range(columns):
        if gained[c] == 0:
            continue
        z0 = reach_m[c]
        sigma_m = z0 * z0 * scale
        if not sigma_m < SPREAD_M:
            continue
        aside = (grid[0] + grid[1] * c - twin[1]) / twin[0]
        for step in range(SPREAD):
            z = z0 + (2.0 * step / (SPREAD - 1) - 1.0) * sigma_m
            x = aside * z - twin[3] / 2
            a, b = R[0, 0] * x + R[0, 1] * z, R[1, 0] * x + R[1, 1] * z
            i = int(np.rint((cos * a - sin * b + own[0]) / CELL_M))
            j = int(np.rint((sin * a + cos * b + own[1]) / CELL_M))
            h = (i * 73856093 ^ j * 19349663) & mask
            while table[h] >= 0 and (all_cells[table[h], 0] != i or all_cells[table[h], 1] != j):
                h = (h + 1) & mask
            k = table[h]
            if k < 0:
                k = table[h] = n
                all_cells[k, 0], all_cells[k, 1], counts[k] = i, j, 0
                n += 1
            if gained[c] > fresh[k]:
                counts[k] = min(counts[k] + gained[c] - fresh[k], MOST)
                fresh[k] = gained[c]
    kept, sure, m = 0, np.empty((n, 2)), 0
    for k in range(n):
        dx, dy = CELL_M * all_cells[k, 0] - own[0], CELL_M * all_cells[k, 1] - own[1]
        a, b = cos * dx + sin * dy, cos * dy - sin * dx
        if not (-BEHIND_M < a < AHEAD_M and abs(b) < BESIDE_M):
            continue
        count = counts[k]
        x, z = R[0, 0] * a + R[1, 0] * b, R[0, 1] * a + R[1, 1] * b
        if z > 0 and z > foot_m:
            column = ((x + twin[3] / 2) / z * twin[0] + twin[1] - grid[0]) / grid[1]
            if -1 < column < columns:
                c = int(np.rint(column))
                if 0 <= c < columns and z + FREE_M + FREE_SIGMAS * scale * z * z < reach_m[c]:
                    count -= AGAINST
        if count <= 0:
            continue
        all_cells[kept, 0], all_cells[kept, 1], counts[kept] = all_cells[k, 0], all_cells[k, 1], count
        kept += 1
        if count >= SURE:
            sure[m, 0], sure[m, 1] = a, b
            m += 1
    return all_cells[:kept].copy(), counts[:kept].copy(), sure[:m]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def contact(
    way: Floats,
    length_m: float,
    at_m: Floats,
    velocity_mps: Floats,
    sigma_mps: Floats,
    doubt: Floats,
    likely_mps: Floats,
    speed_mps: float,
    margin_m: float,
    is_wary: bool,
    is_strict: bool,
    car: Floats,
) -> tuple[int, float, float, bool]:
    """See `reference.decide.contact`."""
    best, best_ttc, hardest, is_sure = -1, np.inf, 0.0, False
    for k in range(len(at_m)):
        vx, vy, y = velocity_mps[k, 0], velocity_mps[k, 1], at_m[k, 1]
        gap_m, closing = at_m[k, 0] - car[0], speed_mps - vx
        if not (closing > CLOSING_MPS and gap_m > -AT_SIDE_M):
            continue
        ttc = max(gap_m, 0.0) / closing
        if not ttc < AHEAD_S:
            continue
        moves = math.hypot(vx, vy) > SLOW_MPS
        mine = 0.0 if moves and is_strict else doubt[k]
        passed = min(ttc + ((car[0] + car[1]) / closing if moves else 0.0), AHEAD_S)
        low, high = _swept(way, length_m, at_m[k, 0] + vx * ttc, car)
        needed, last = needed_mps2(gap_m, speed_mps, vx, car)
        if last >= YOUNG_DOUBT * car[3]:
            vy = likely_mps[k]
        elif mine > 0:
            vy = math.copysign(max(abs(vy) - sigma_mps[k, 1], 0.0), vy)
        one, other = y + vy * ttc, y + vy * passed
        room = margin_m
        if moves and is_wary:
            room += min(WARY_M + sigma_mps[k, 1] * ttc, MOST_WARY_M)
        if not (min(one, other) < high + room and max(one, other) > low - room):
            continue
        counts = last >= mine * car[3]
        if counts and not is_sure:  # what is not sure no longer counts
            is_sure, best_ttc, hardest = True, np.inf, 0.0
        if counts == is_sure:
            hardest = max(hardest, needed)
            if ttc < best_ttc:
                best, best_ttc = k, ttc
    return best, best_ttc if best >= 0 else np.nan, hardest if best >= 0 else np.nan, is_sure


@numba.njit(cache=True, nogil=True, error_model="numpy")
def swept(ways: Floats, lengths_m: Floats, x_m: Floats, car: Floats) -> tuple[Floats, Floats]:
    """See `reference.decide.swept`."""
    low, high = np.empty((len(ways), len(x_m))), np.empty((len(ways), len(x_m)))
    for m in range(len(ways)):
        for k in range(len(x_m)):
            low[m, k], high[m, k] = _swept(ways[m], lengths_m[m], x_m[k], car)
    return low, high


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _swept(way: Floats, length_m: float, x_m: float, car: Floats) -> tuple[float, float]:
    """Return the right and the left end of what the car takes of the road at x."""
    low, high = np.inf, -np.inf
    for i in range(3):
        reach = car[0] if i == 0 else -car[1] if i == 1 else 0.0
        s = x_m - reach
        t = min(max(s, 0.0), length_m)
        y = way[0] + t * (way[1] + t * (way[2] + t * (way[3] + t * (way[4] + t * way[5]))))
        slope = way[1] + t * (2 * way[2] + t * (3 * way[3] + t * (4 * way[4] + t * 5 * way[5])))
        y += slope * (s - t + reach)
        low, high = min(low, y), max(high, y)
    return low - car[2] / 2, high + car[2] / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def needed_mps2(gap_m: float, speed_mps: float, ahead_mps: float, car: Floats) -> tuple[float, float]:
    """See `reference.decide.needed_mps2`; of one thing."""
    brake_mps2, brake_share, stop_m, delay_s = car[3], car[4], car[5], car[6]
    closing = speed_mps - ahead_mps
    left_m = gap_m - delay_s * closing
    needed = closing * closing / (2 * max(left_m - stop_m, 1e-3))
    last = closing * closing / (2 * max(left_m - LEAST_ROOM_M, 1e-3))
    if needed > brake_mps2:
        needed = max(last, brake_share * brake_mps2)
    if ahead_mps > 0:
        stops_m = gap_m + ahead_mps * ahead_mps / (2 * brake_mps2) - delay_s * speed_mps - LEAST_ROOM_M
        stops = speed_mps * speed_mps / (2 * max(stops_m, 1e-3))
        needed, last = max(needed, stops), max(last, stops)
    return needed, last
