"""The road under cells of disparity, readably: candidates, drawn planes, and the fit in metres.

A road is `y = h + s*z + t*x` in the car frame (x right, y down, z forward, metres), with `- q*z^2` where it bends.
`points` are (n, 4): x, y, z in metres and the disparity in pixels. `scales` are (fb, near, side, fade): focal length
times baseline in pixels times metres; the plane is fitted up to `near` ahead; a point `side` aside, or `fade` ahead,
counts less (all metres).
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

BIN_POINTS = 200
"""Points of each step ahead that are kept."""

JUDGES = 300
"""A drawn plane is judged by every so many of the points that no more than this are; a fitted one by all."""

POLISHED = 6
"""The best drawn planes that are fitted before the winner is chosen."""

POLISHES = 3
"""Fits of each."""

GROWTH = 5
"""Steps from the near plane out to the end of the bend."""

POINT = 1000
"""What a point straight ahead adds to a plane's support."""

HOLE, HOLE_PRICE = 3, 2
"""A point this many tolerances below the road is impossible, and takes away this many times its weight."""

LEAST_PIVOT = 1e-12
"""A system with a smaller pivot has no solution."""

LEAST_POINTS = 10
"""Fewer points fit no plane."""

MULTIPLIER, INCREMENT = 6364136223846793005, 1442695040888963407
"""Knuth's linear congruential generator modulo 2^64; numbers are the upper 31 bits."""

LEAST_SPAN = 1e-6
"""Three points whose (z, x) span less than this share of `near` squared make no plane."""

HOLD = (35e3, 1e3, 1e3, 860.0)
"""Weights, over (near, near, 1, near), that hold h, s*near, t and q*near^2 to the near plane, whose q is 0."""

SLACK, SLACK_PER_M = 0.6, 0.003
"""Points are on the bent road within this share of the tolerance, plus this much per metre ahead."""

ASIDE = 1.2
"""The bent road reaches this many `side` to either side."""

TOLERANCES = (2.0, 1.0, 0.6, 0.6)
"""Shares of the tolerance of the fits in metres, one after the other."""

RANGE_SHARE = 0.99
"""The road was seen up to this share of the points on it."""


def gather_candidates(d_px: Singles, cell_w: int, cell_h: int, twin: Floats, limits: Floats, points: Floats) -> int:
    """Write the points that may be road, in the order of the cells, and return how many.

    Parameters
    ----------
    d_px
        (rows, columns) disparities of cells; NaN, or not above 0, where unknown.
    cell_w, cell_h
        Width and height of a cell, pixels.
    twin
        (f, cx, cy in pixels, baseline in metres).
    limits
        (far, side, low, high, slope, step): points up to `far` ahead and `side` aside, lower than half the `low` camera
        and not below the road under the `high` one that falls by `slope`. Of each `step` ahead, every so many are kept
        that no more than `BIN_POINTS` are: the near road does not outvote the far one. Metres, metres per metre.
    points
        (BIN_POINTS * (int(far / step) + 1), 4), written.
    """
    f, cx, cy, baseline = twin
    far, side, low, high, slope, step = limits
    row, column = np.nonzero(d_px > 0)
    d = d_px[row, column].astype(np.float64)
    z = f * baseline / d
    x = (column * cell_w + (cell_w - 1) / 2 - cx) / f * z - baseline / 2
    y = (row * cell_h + (cell_h - 1) / 2 - cy) / f * z
    within = (z < far) & (abs(x) < side) & (y > 0.5 * low) & (y < high + slope * z)
    candidates = np.stack([x, y, z, d], -1)[within]
    place = (candidates[:, 2] / step).astype(np.int64)
    kept = np.zeros(len(place), np.bool_)
    for i in np.unique(place):
        members = np.flatnonzero(place == i)
        stride = -(-len(members) // BIN_POINTS)
        kept[members[stride - 1 :: stride]] = True
    n = int(np.count_nonzero(kept))
    points[:n] = candidates[kept]
    return n


def is_allowed(h: float, s: float, t: float, limits: Floats) -> bool:
    """Whether a plane (h, s, t) lies within (low, high, slope of pitch, slope of roll)."""
    low, high, pitch, roll = limits
    return bool(low < h < high and abs(s) < pitch and abs(t) < roll)


def support(rays: Singles, n: int, plane: Floats, fb: float, tolerance_px: float) -> float:
    """Return the weight of the points on a plane, less that of the points below it.

    Parameters
    ----------
    rays
        (4, n or more): x/z, y/z, weight (cut to whole numbers) and disparity in pixels of each point.
    n
        Points.
    plane
        (h, s, t).
    fb
        Focal length times baseline, pixels times metres.
    tolerance_px
        Points this near in disparity are on the plane; see `HOLE` for the others.
    """
    x, y, weight, d = rays[:, :n]
    h, s, t = plane
    nearer = d - (y - np.float32(s) - np.float32(t) * x) * np.float32(fb / h)
    whole = weight.astype(np.int64)
    on, below = abs(nearer) < np.float32(tolerance_px), nearer < np.float32(-HOLE * tolerance_px)
    return float(whole[on].sum() - HOLE_PRICE * whole[below].sum())


def solve(A: Floats, b: Floats, x: Floats) -> bool:
    """Write the solution x of A x = b, A symmetric; False where A is not positive.

    Parameters
    ----------
    A
        (n, n), of which the lower triangle is read; the compiled one overwrites it.
    b
        (n,).
    x
        (n,), written.
    """
    try:
        L = np.linalg.cholesky(A)
    except np.linalg.LinAlgError:
        return False
    if not L.diagonal().min() ** 2 > LEAST_PIVOT:
        return False
    x[:] = cho_solve((L, True), b)
    return True


def fit_plane(
    points: Floats, n: int, plane: Floats, by_px: float, by_m: float, scales: Floats, A: Floats, b: Floats
) -> int:
    """Fit y by least squares to the points near a plane, and return how many these are.

    Parameters
    ----------
    points, n
        Points, and how many of them.
    plane
        (h, s, t), changed in place if `LEAST_POINTS` are near and span a plane.
    by_px, by_m
        Points are near that differ less in metres of y or, where `by_m` is 0, in pixels of disparity.
    scales
        See the module; a point's weight is `1 / (1 + (x/side)^2) / (1 + z/fade)^2`.
    A, b
        (3, 3) and (3,), scratch.
    """
    fb, near, side, fade = scales
    h, s, t = plane
    x, y, z, d = points[:n][points[:n, 2] < near].T
    on = abs(y - h - s * z - t * x) < by_m if by_m > 0 else abs(d - (y - s * z - t * x) / z * fb / h) < by_px
    x, y, z = x[on], y[on], z[on]
    rows = np.stack([np.ones_like(x), z / near, x])
    weighted = rows / (1 + (x / side) ** 2) / (1 + z / fade) ** 2
    A[:], b[:] = weighted @ rows.T, weighted @ y
    fitted = np.empty(3)
    if len(x) >= LEAST_POINTS and solve(A, b, fitted):
        plane[:] = fitted / (1, near, 1)
    return len(x)


def draw_plane(
    points: Floats,
    n: int,
    draws: int,
    seed: int,
    tolerance_px: float,
    minimum: int,
    allowed: Floats,
    scales: Floats,
    prior: Floats,
    plane: Floats,
) -> bool:
    """Write the best plane by far through drawn points: of all draws the `POLISHED` best are fitted, then one wins.

    Parameters
    ----------
    points, n
        Points, and how many of them; those nearer than `near` count.
    draws
        Threes of points that are drawn.
    seed
        Of the draws.
    tolerance_px
        Points this near to a plane, in disparity, are on it.
    minimum
        Fewer points are no road.
    allowed
        Of `is_allowed`.
    scales
        See the module.
    prior
        (h, s, t) that is tried as well; NaN for none.
    plane
        (3,), written.

    Returns
    -------
    Whether `minimum` points are on it.
    """
    fb, near, side, _ = scales
    points = points[:n][points[:n, 2] < near]
    m = len(points)
    if m < minimum:
        return False
    x, y, z, d = points.T
    rays = np.stack([x / z, y / z, POINT / (1 + (x / side) ** 2), d]).astype(np.float32)
    some = rays[:, :: -(-m // JUDGES)]
    best = np.full((POLISHED, 4), -np.inf)
    numbers = _numbers(seed)
    drawn = (_plane_through(points[[next(numbers) % m for _ in range(3)]], near) for _ in range(draws))
    for candidate in [*drawn, prior]:
        if not is_allowed(candidate[0], candidate[1], candidate[2], allowed):
            continue
        score = support(some, some.shape[1], candidate, fb, tolerance_px)
        worst = best[:, 0].argmin()
        if score > best[worst, 0]:
            best[worst] = score, *candidate
    top, on_top = -np.inf, 0
    for candidate in best[best[:, 0] > -np.inf, 1:]:
        for _ in range(POLISHES):
            fit_plane(points, m, candidate, tolerance_px, 0.0, scales, np.empty((3, 3)), np.empty(3))
        score = support(rays, m, candidate, fb, tolerance_px)
        if score > top:
            h, s, t = plane[:] = candidate
            off_px = d.astype(np.float32) - (rays[1] - s - t * rays[0]) * fb / h
            top, on_top = score, int(np.count_nonzero(abs(off_px) < tolerance_px))
    return on_top >= minimum


def _numbers(seed: int) -> Iterator[int]:
    state = 2 * seed + 1
    while True:
        state = (state * MULTIPLIER + INCREMENT) % 2**64
        yield state >> 33


def _plane_through(points: Floats, near: float) -> Floats:
    """Return (h, s, t) through three points by Cramer's rule; NaN where they span none."""
    (x0, x1, x2), (y0, y1, y2), (z0, z1, z2) = points[:, :3].T
    det = (z1 - z0) * (x2 - x0) - (z2 - z0) * (x1 - x0)
    if abs(det) < LEAST_SPAN * near * near:
        return np.full(3, np.nan)
    s = ((y1 - y0) * (x2 - x0) - (y2 - y0) * (x1 - x0)) / det
    t = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / det
    return np.array([y0 - s * z0 - t * x0, s, t])


def bend(points: Floats, n: int, start: Floats, far: float, tolerance_m: float, scales: Floats, bent: Floats) -> None:
    """Let a plane bend ahead: least squares over points ever further away, held to the plane (see `HOLD`).

    Parameters
    ----------
    points, n
        Points, and how many of them.
    start
        (h, s, t) of the near plane.
    far
        The last fit reaches this far ahead, metres; the first `near`.
    tolerance_m
        See `SLACK`.
    scales
        See the module.
    bent
        (4,), written: h, s, t and -q of the bent road.
    """
    _, near, side, _ = scales
    x, y, z, _ = points[:n].T
    unit = np.array([1, near, 1, near**2])
    hold = (np.array(HOLD) / (near, near, 1, near)) ** 2
    held = np.array([*start, 0.0])
    rows = np.stack([np.ones_like(x), z / near, x, (z / near) ** 2])
    slack = SLACK * tolerance_m + SLACK_PER_M * z
    bent[:] = held
    for reach in np.linspace(near, far, GROWTH):
        on = (abs(y - (bent * unit) @ rows) < slack) & (z < reach) & (abs(x) < ASIDE * side)
        weighted = rows[:, on] / slack[on] ** 2
        fitted = np.empty(4)
        if solve(weighted @ rows[:, on].T + np.diag(hold), weighted @ y[on] + hold * held * unit, fitted):
            bent[:] = fitted / unit


def find_road(
    d_px: Singles,
    cell_w: int,
    cell_h: int,
    twin: Floats,
    limits: Floats,
    allowed: Floats,
    scales: Floats,
    tolerances: Floats,
    draws: int,
    minimum: int,
    seed: int,
    prior: Floats,
    road: Floats,
) -> bool:
    """Write the road and return whether there is one.

    Parameters
    ----------
    d_px, cell_w, cell_h, twin, limits
        Of `gather_candidates`.
    allowed
        Of `is_allowed`.
    scales
        See the module.
    tolerances
        (pixels, metres) that a point on the road may be off.
    draws, minimum, seed, prior
        Of `draw_plane`.
    road
        (6,), written where there is one: h, s, t, q, share of the candidates that are on it, and range in metres up to
        which it was seen.
    """
    tolerance_px, tolerance_m = tolerances
    points = np.empty((BIN_POINTS * (int(limits[0] / limits[5]) + 1), 4))
    n = gather_candidates(d_px, cell_w, cell_h, twin, limits, points)
    plane, bent = np.empty(3), np.empty(4)
    if n < minimum or not draw_plane(points, n, draws, seed, tolerance_px, minimum, allowed, scales, prior, plane):
        return False
    for share in TOLERANCES:
        if fit_plane(points, n, plane, 0.0, share * tolerance_m, scales, np.empty((3, 3)), np.empty(3)) < minimum:
            return False
    if not is_allowed(plane[0], plane[1], plane[2], allowed):
        return False
    bend(points, n, plane, limits[0], tolerance_m, scales, bent)
    x, y, z, _ = points[:n].T
    depths = z[abs(y - bent[0] - bent[1] * z - bent[2] * x - bent[3] * z * z) < tolerance_m]
    if len(depths) == 0:
        return False
    road[:] = *plane, -bent[3], len(depths) / n, np.sort(depths)[int(RANGE_SHARE * (len(depths) - 1))]
    return True
