"""What is in a car's way, readably: outlines of obstacles on the road, cells that are remembered, contacts.

Points on the road are (forward, left) in metres, seen from the middle between the cameras. `grid` is (middle of the
first column, distance of two) of a free space, px; `twin` (f, cx, cy, baseline) of the rectified cameras, px and m; `R`
(2, 2) turns (right, ahead) of the cameras into (forward, left); `car` (7,) is `DecideSettings.numbers`.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Integers = NDArray[np.int64]

FACE_STEP_M = 0.3
"""Between the points of a face."""
BESIDE_SHARE, DEEP_M = 0.15, 0.6
"""A column of free space that ends so near to an obstacle, whichever is more, ends there because of it."""
EDGE_PX, EDGE_M = 8.0, 0.3
"""So far beside the box of what moves, or may, its columns end, whichever is more: no trace of it stands there."""
WIDE_M = 3.0
"""What is wider has no column there that may be one of what moves."""
NEIGHBOUR_SHARE = 0.1
"""Columns that end alone, by so much of their range, say nothing."""
COLUMN_SIGMA_PX = 0.25
"""Noise of the disparity at which a column ends."""
UNTOLD, MOVES, STANDS = range(3)
"""What a track says of its motion."""
SLOW_MPS = 0.5
"""What is no faster stands."""
SETTLED_S = 0.5
"""A younger track's velocity is not known, whatever it says."""
YOUNG_S = 0.8
"""And a track older than this that still does not tell is no longer waited for."""
SETTLED_DOUBT, YOUNG_DOUBT = 0.45, 0.85
"""What may move or stand counts once so much of the hardest braking is needed to stop right before it."""
HARDLY_DOUBT, HARDLY_S, HARDLY_MPS, HARDLY_ASIDE_MPS = 0.1, 0.3, 3.0, 1.0
"""From this age on there is little doubt about what is not faster than this, forwards and across, two sigmas up."""
TOWARDS_MPS = -3.0
"""What is in doubt and seems to come faster stands: a piece of something, now larger, now smaller, looks like that."""
TINY = 1e-12
CELL_M = 0.2
STANDS_THERE, ALONE, AGAINST = 2, 1, 2
"""Evidence for a cell, of one frame: a column that ends there, one that does so alone, free road behind it."""
ALONE_M = 10.0
"""Nearer, a column that ends before all obstacles does so alone: what stands was seen from further away, steam not."""
MOST, SURE = 12, 6
"""The most there is, and how much makes sure: three frames."""
AHEAD_M, BESIDE_M, BEHIND_M = 30.0, 10.0, 4.0
"""What is further away is forgotten."""
SPREAD_M, SPREAD = 0.6, 7
"""Ends of columns that are off by more are not remembered; the others are spread over so many points."""
FREE_SIGMAS, FREE_M = 2.0, 0.3
"""Road seen so far behind a cell contradicts it."""
CLOSING_MPS = 0.3
"""What comes closer no faster never arrives."""
AHEAD_S = 4.0
"""What is further off does not count."""
AT_SIDE_M = 0.2
"""What is further behind the front is beside the car."""
WARY_M, MOST_WARY_M = 0.3, 1.0
"""A wary car gives what moves this much more room, and its sigma on top, but not more than the second."""
LEAST_ROOM_M = 0.7
"""Room before what it stops for, where it is too late for `stop_m`."""


def weigh(
    velocity_mps: Floats, cov_m2ps2: Floats, motion: Integers, age_s: Floats, has_velocity: Flags, is_mover: Flags
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return how fast things are as far as it is known, (n, 2), its sigmas (n, 2), and how much is in doubt (n,).

    And (n,) how fast they most likely go to the left. The sigmas of what has no velocity are 0. What may as well stand
    comes towards the car no faster than people do.

    Parameters
    ----------
    velocity_mps, cov_m2ps2, motion, age_s
        (n, 2), (n, 2, 2), (n,) and (n,) what their tracks say.
    has_velocity
        (n,) whether there is one over ground.
    is_mover
        (n,) whether it is known from before that it moves.
    """
    sigma = np.sqrt(cov_m2ps2[:, [0, 1], [0, 1]])
    counts = has_velocity & (motion != STANDS)
    counts &= is_mover | (age_s >= SETTLED_S)
    known = (motion == STANDS) | (counts & (is_mover | (motion == MOVES)))
    ahead, aside = velocity_mps[:, 0], np.abs(velocity_mps[:, 1])
    hardly = (ahead + 2 * sigma[:, 0] < HARDLY_MPS) & (aside + 2 * sigma[:, 1] < HARDLY_ASIDE_MPS)
    hardly &= has_velocity & (age_s >= HARDLY_S)
    waits = np.where(hardly, HARDLY_DOUBT, np.where(age_s >= YOUNG_S, SETTLED_DOUBT, YOUNG_DOUBT))
    # If it does not come that fast, what its distance seems to change does not carry it aside either.
    nears = ~known & (ahead < TOWARDS_MPS)
    slope = cov_m2ps2[:, 0, 1] / np.maximum(cov_m2ps2[:, 0, 0], TINY)
    standing_mps = np.stack([np.zeros(len(ahead)), velocity_mps[:, 1] - slope * ahead], 1)
    velocity_mps = np.where(nears[:, None], standing_mps, velocity_mps)
    sure = counts[:, None] & (np.abs(velocity_mps) > 2 * sigma)
    likely = has_velocity & (motion != STANDS) & (age_s >= HARDLY_S)
    likely &= is_mover | (np.abs(velocity_mps[:, 1]) > sigma[:, 1])
    speed = np.where(sure, velocity_mps, 0.0)
    return (
        speed,
        np.where(has_velocity[:, None], sigma, 0.0),
        np.where(known, 0.0, waits),
        np.where(likely, velocity_mps[:, 1], 0.0),
    )


def among(numbers: Integers, others: Integers) -> Flags:
    """Return (n,) which numbers are among some others."""
    return np.isin(numbers, others)


def place(u_px: Floats, z_m: Floats, twin: Floats, R: Floats) -> Floats:
    """Return (n, 2) points of columns at forward distances."""
    x = (u_px - twin[1]) / twin[0] * z_m - twin[3] / 2
    return np.stack([x, z_m], -1) @ R.T


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
    """Return points (m, 2) along the faces of things, (m,) of which, and (c,) evidence that columns end at what stands.

    Its columns tell how a side runs, its range how near it comes; without any that end there it is where both its box
    (which may be that of its far end) and its width (if it is long, too large) have it. A column is of the thing to
    whose range it ends nearest, and not before that; whose columns are all of others is behind them. Beside what moves,
    or may, none is of something wide that stands: its range is that of its nearest end, wherever that is.

    Parameters
    ----------
    sides_px, range_m, size_m, feet_m, velocity_mps
        (n, 2) first and last column; (n,); (n, 2) width and length; (n, 2) middle of the foot; (n, 2).
    is_new, tracked
        (n,) what may turn out to move: like what moves, it leaves no traces. Only the first ones have faces.
    grid, free_m, is_blocked
        The free space, (c,); what is blocked has a range.
    """
    u = grid[0] + grid[1] * np.arange(len(free_m))
    with np.errstate(invalid="ignore"):
        near = np.abs(np.diff(free_m)) <= NEIGHBOUR_SHARE * np.minimum(free_m[1:], free_m[:-1])
    near &= is_blocked[1:] & is_blocked[:-1]
    ends = np.append(near, False) | np.insert(near, 0, False) if len(u) else is_blocked.copy()
    evidence = np.where(ends, np.where(free_m < ALONE_M, ALONE, STANDS_THERE), 0)
    leaves_none, is_wall = np.zeros(len(u), np.bool_), np.zeros(len(range_m) + 1, np.bool_)
    off_m = np.full((len(range_m) + 1, len(u)), np.inf)  # how far a column ends from a thing's range; no thing at last
    for k in range(len(range_m)):
        near_m, is_fast = max(BESIDE_SHARE * range_m[k], DEEP_M), np.hypot(*velocity_mps[k]) > SLOW_MPS
        leaves = not (is_fast or is_new[k])
        edge_px = 0.0 if leaves else max(EDGE_PX, EDGE_M * twin[0] / range_m[k])
        with np.errstate(invalid="ignore"):
            beside = (u >= sides_px[k, 0] - edge_px) & (u < sides_px[k, 1] + edge_px)
            runs_on = beside & is_blocked & (free_m >= range_m[k] - near_m)
            mine = runs_on & (free_m <= range_m[k] + near_m + size_m[k, 1])
            off_m[k] = np.where(mine, np.abs(free_m - range_m[k]), np.inf)
        evidence[ends & runs_on & leaves] = STANDS_THERE
        leaves_none |= np.isfinite(off_m[k]) & (not leaves)
        is_wall[k] = leaves and size_m[k, 0] > WIDE_M
    evidence[leaves_none] = 0
    nearest = np.where(is_wall[:, None] & leaves_none, np.inf, off_m).argmin(0)
    points, owners = [np.zeros((0, 2))], [np.zeros(0, np.int64)]
    for k in range(tracked):
        shared = (u >= sides_px[k, 0]) & (u < sides_px[k, 1]) & np.isfinite(off_m[k])
        mine = shared & (nearest == k)
        if shared.sum() > 1:
            at_m = place(u[mine], np.maximum(free_m[mine], range_m[k]), twin, R)
        else:
            sides_m = place(sides_px[k], np.full(2, range_m[k]), twin, R)[:, 1]
            low = max(sides_m.min(), feet_m[k, 1] - size_m[k, 0] / 2)
            high = min(sides_m.max(), feet_m[k, 1] + size_m[k, 0] / 2)
            if low > high:
                low = high = feet_m[k, 1]
            count = max(2, int(np.ceil((high - low) / FACE_STEP_M)) + 1)
            at_m = np.stack([np.full(count, feet_m[k, 0]), np.linspace(low, high, count)], 1)
        points.append(at_m)
        owners.append(np.full(len(at_m), k))
    return np.concatenate(points), np.concatenate(owners), evidence


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
    """Return cells (k, 2) of the road that are remembered, the evidence for them, and points (m, 2) of the sure ones.

    Parameters
    ----------
    cells, evidence
        (n, 2) and (n,) as they were remembered before.
    own
        (4,) where the car is, and cosine and sine of where it heads; the points are seen from there.
    grid, reach_m, gained
        How far the road is seen in each column, (c,), and the evidence, if any, that it ends there at something.
    foot_m
        What is nearer is below the picture; NaN where nobody knows.
    """
    scale = COLUMN_SIGMA_PX / (twin[0] * twin[3])
    turn = np.array([[own[2], -own[3]], [own[3], own[2]]])
    ends = gained > 0
    u, z, more = (grid[0] + grid[1] * np.arange(len(reach_m)))[ends], reach_m[ends], gained[ends]
    u, z, more = (part[z * z * scale < SPREAD_M] for part in (u, z, more))
    z = z + np.linspace(-1, 1, SPREAD)[:, None] * z * z * scale
    here = place(np.tile(u, SPREAD), z.ravel(), twin, R)
    new: dict[tuple[int, int], int] = {}
    seen = np.rint((here @ turn.T + own[:2]) / CELL_M).astype(int)
    for (i, j), n in zip(seen.tolist(), np.tile(more, SPREAD).tolist(), strict=True):
        new[i, j] = max(new.get((i, j), 0), n)
    remembered = {(int(i), int(j)): int(n) for (i, j), n in zip(cells, evidence, strict=True)}
    for cell, n in new.items():
        remembered[cell] = min(remembered.get(cell, 0) + n, MOST)
    kept, sure = {}, []
    for (i, j), count in remembered.items():
        at = (CELL_M * np.array([i, j]) - own[:2]) @ turn
        if not (-BEHIND_M < at[0] < AHEAD_M and abs(at[1]) < BESIDE_M):
            continue
        x, z_m = at @ R
        column = -1 if z_m <= 0 else ((x + twin[3] / 2) / z_m * twin[0] + twin[1] - grid[0]) / grid[1]
        column = int(np.rint(np.clip(column, -1, len(reach_m))))
        if 0 <= column < len(reach_m) and z_m > foot_m:
            count -= AGAINST * bool(z_m + FREE_M + FREE_SIGMAS * scale * z_m * z_m < reach_m[column])
        if count > 0:
            kept[i, j] = count
            if count >= SURE:
                sure.append(at)
    return (
        np.array([*kept], np.int64).reshape(-1, 2),
        np.array([*kept.values()], np.int64),
        np.array(sure).reshape(-1, 2),
    )


def swept(ways: Floats, lengths_m: Floats, x_m: Floats, car: Floats) -> tuple[Floats, Floats]:
    """Return (m, n) right and left end of what the car takes of the road at x (n,) while it goes by, on some ways.

    A way is `y(s) = sum(c_k s^k)` up to its length (m,), and straight on behind; `ways` (m, 6) are the coefficients.
    """
    ends = [_swept(way, float(length_m), x_m, car) for way, length_m in zip(ways, lengths_m, strict=True)]
    low, high = np.array(ends).reshape(len(ways), 2, len(x_m)).swapaxes(0, 1)
    return low, high


def _swept(way: Floats, length_m: float, x_m: Floats, car: Floats) -> tuple[Floats, Floats]:
    """Return (n,) the same of one way."""
    c0, c1, c2, c3, c4, c5 = way
    body = []
    for reach in (car[0], 0.0, -car[1]):
        s = x_m - reach
        t = np.clip(s, 0, length_m)
        slope = c1 + t * (2 * c2 + t * (3 * c3 + t * (4 * c4 + t * 5 * c5)))
        body.append(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5)))) + slope * (s - t + reach))
    return np.min(body, axis=0) - car[2] / 2, np.max(body, axis=0) + car[2] / 2


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
    """Return what the car touches first on a way within `AHEAD_S`, after how long, how hard to brake, and if for sure.

    The first is -1 if nothing is. What may move or stand must come into the way even if it goes a sigma slower. See
    `stages.decide.contact`.

    Parameters
    ----------
    way, length_m
        (6,) and its length, as in `swept`.
    at_m, velocity_mps, sigma_mps, doubt, likely_mps
        (n, 2), (n, 2), (n, 2) and (n,) points of things, their velocities, and as in `weigh`.
    speed_mps, margin_m
        How fast the car is, and how much room it takes on each side.
    is_wary, is_strict
        Whether what moves gets the room by which its way may be mistaken; whether what moves is never in doubt.
    """
    front_m, rear_m = car[:2]
    moves = np.hypot(velocity_mps[:, 0], velocity_mps[:, 1]) > SLOW_MPS
    doubt = np.where(moves & is_strict, 0.0, doubt)
    gap_m, closing = at_m[:, 0] - front_m, speed_mps - velocity_mps[:, 0]
    arrives = (closing > CLOSING_MPS) & (gap_m > -AT_SIDE_M)
    with np.errstate(divide="ignore", invalid="ignore"):
        ttc = np.where(arrives, np.maximum(gap_m, 0) / closing, np.inf)
        passed = np.minimum(ttc + np.where(moves, (front_m + rear_m) / closing, 0.0), AHEAD_S)
    arrives &= ttc < AHEAD_S
    first = np.where(arrives, ttc, 0.0)
    low, high = _swept(way, length_m, at_m[:, 0] + velocity_mps[:, 0] * first, car)
    aside = velocity_mps[:, 1]
    slower = np.sign(aside) * np.maximum(np.abs(aside) - sigma_mps[:, 1], 0)
    # As long as there is time to learn more: at the last moment it is taken to go on as it most likely does.
    needed, last = needed_mps2(gap_m, speed_mps, velocity_mps[:, 0], car)
    aside = np.where(last >= YOUNG_DOUBT * car[3], likely_mps, np.where(doubt > 0, slower, aside))
    one, other = (at_m[:, 1] + aside * np.where(arrives, t, 0.0) for t in (ttc, passed))
    mistaken_m = np.minimum(WARY_M + sigma_mps[:, 1] * first, MOST_WARY_M)
    room = margin_m + np.where(moves & is_wary, mistaken_m, 0.0)
    hit = arrives & (np.minimum(one, other) < high + room) & (np.maximum(one, other) > low - room)
    if not hit.any():
        return -1, np.nan, np.nan, False
    counts = hit & (last >= doubt * car[3])
    of = counts if counts.any() else hit
    index = int(np.argmin(np.where(of, ttc, np.inf)))
    return index, float(ttc[index]), float(needed[of].max()), bool(counts.any())


def needed_mps2(gap_m: Floats, speed_mps: float, ahead_mps: Floats, car: Floats) -> tuple[Floats, Floats]:
    """Return (n,) how hard to brake to stay `stop_m` behind each, or as near as may be where that is too late.

    And (n,) to come as near as may be anyway. What drives on ahead may at any moment brake as hard as the car can.
    """
    brake_mps2, brake_share, stop_m, delay_s = car[3:7]
    closing = speed_mps - ahead_mps
    left_m = gap_m - delay_s * closing
    soft, hard = (_braked(closing, left_m - room) for room in (stop_m, LEAST_ROOM_M))
    stops_m = gap_m + ahead_mps**2 / (2 * brake_mps2) - delay_s * speed_mps - LEAST_ROOM_M
    stops = np.where(ahead_mps > 0, _braked(speed_mps, stops_m), 0.0)
    as_is = np.where(soft <= brake_mps2, soft, np.maximum(hard, brake_share * brake_mps2))
    return np.maximum(as_is, stops), np.maximum(hard, stops)


def _braked(speed_mps: Floats | float, way_m: Floats) -> Floats:
    return np.asarray(np.square(speed_mps) / (2 * np.maximum(way_m, 1e-3)))
