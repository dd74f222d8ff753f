"""The road under cells of disparity, compiled: candidates, drawn planes, and the fit in metres.

A road is `y = h + s*z + t*x` in the car frame (x right, y down, z forward, metres), with `- q*z^2` where it bends.
A plane in the world is a plane in (u, v, d), where noise is even: so planes are judged in pixels.
"""

from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.road import (
    ASIDE,
    BIN_POINTS,
    GROWTH,
    HOLD,
    HOLE,
    HOLE_PRICE,
    INCREMENT,
    JUDGES,
    LEAST_PIVOT,
    LEAST_POINTS,
    LEAST_SPAN,
    MULTIPLIER,
    POINT,
    POLISHED,
    POLISHES,
    RANGE_SHARE,
    SLACK,
    SLACK_PER_M,
    TOLERANCES,
    Floats,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def gather_candidates(
    d_px: NDArray[np.float32], cell_w: int, cell_h: int, twin: Floats, limits: Floats, points: Floats
) -> int:
    """See `reference.road.gather_candidates`."""
    f, cx, cy, baseline = twin
    far, side, low, high, slope, step = limits
    rows, columns = d_px.shape
    bins = int(far / step) + 1
    count = np.zeros(bins, np.int32)
    place = np.empty(rows * columns, np.int32)
    first, across, per_step = ((cell_w - 1) / 2 - cx) / f, cell_w / f, 1 / step
    i: Any
    for row in range(rows):
        v = (row * cell_h + (cell_h - 1) / 2 - cy) / f
        if v * far <= 0.5 * low:
            place[row * columns : (row + 1) * columns] = -1
            continue
        here = place[row * columns : (row + 1) * columns]
        for column in range(columns):
            d = np.float64(d_px[row, column])
            z = f * baseline / d
            x = first * z + across * column * z - baseline / 2
            y = v * z
            within = (d > 0) & (z < far) & (abs(x) < side) & (y > 0.5 * low) & (y < high + slope * z)
            here[column] = np.int32(z * per_step) if within else np.int32(-1)
        for column in range(columns):
            if here[column] >= 0:
                count[here[column]] += 1
    # Every so many of a bin, so that the near road does not outvote the far one.
    stride = np.empty(bins, np.int32)
    for i in range(bins):
        stride[i] = max(1, -(-count[i] // BIN_POINTS))
        count[i] = 0
    n = 0
    for cell in range(rows * columns):
        i = place[cell]
        if i < 0:
            continue
        count[i] += 1
        if count[i] == stride[i]:
            count[i] = 0
            row, column = cell // columns, cell % columns
            d = np.float64(d_px[row, column])
            z = f * baseline / d
            points[n, 0] = (column * cell_w + (cell_w - 1) / 2 - cx) / f * z - baseline / 2
            points[n, 1] = (row * cell_h + (cell_h - 1) / 2 - cy) / f * z
            points[n, 2] = z
            points[n, 3] = d
            n += 1
    return n


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def is_allowed(h, s, t, limits):  # type: ignore[no-untyped-def]
    """See `reference.road.is_allowed`."""
    return h > limits[0] and h < limits[1] and abs(s) < limits[2] and abs(t) < limits[3]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def support(rays: NDArray[np.float32], n: int, plane: Floats, fb: float, tolerance_px: float) -> float:
    """See `reference.road.support`."""
    c = np.float32(fb / plane[0])
    s, t = np.float32(plane[1]), np.float32(plane[2])
    near, below = np.float32(tolerance_px), np.float32(-HOLE * tolerance_px)
    score = np.int64(0)
    for i in range(n):
        nearer = rays[3, i] - (rays[1, i] - s - t * rays[0, i]) * c
        weight = np.int32(rays[2, i])
        score += (abs(nearer) < near) * weight - HOLE_PRICE * (nearer < below) * weight
    return float(score)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def solve(A: Floats, b: Floats, x: Floats) -> bool:
    """See `reference.road.solve`; by Cholesky, in place."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            total = A[i, j]
            for k in range(j):
                total -= A[i, k] * A[j, k]
            if i == j:
                if not total > LEAST_PIVOT:
                    return False
                A[i, i] = np.sqrt(total)
            else:
                A[i, j] = total / A[j, j]
    for i in range(n):
        total = b[i]
        for k in range(i):
            total -= A[i, k] * x[k]
        x[i] = total / A[i, i]
    for i in range(n - 1, -1, -1):
        total = x[i]
        for k in range(i + 1, n):
            total -= A[k, i] * x[k]
        x[i] = total / A[i, i]
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fit_plane(
    points: Floats, n: int, plane: Floats, by_px: float, by_m: float, scales: Floats, A: Floats, b: Floats
) -> int:
    """See `reference.road.fit_plane`."""
    fb, near, side, fade = scales
    h, s, t = plane
    # A pixel of disparity is z h / fb of y.
    least_m, per_m = (by_m, 0.0) if by_m > 0 else (0.0, by_px * h / fb)
    aside, away = 1 / side, 1 / fade
    one = of_z = of_zz = of_x = of_xz = of_xx = y1 = yz = yx = 0.0
    on = 0
    for i in range(n):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if z < near and abs(y - h - s * z - t * x) < least_m + per_m * z:
            q, r = x * aside, 1 + z * away
            w = 1 / ((1 + q * q) * r * r)
            one += w
            of_z += w * z
            of_zz += w * z * z
            of_x += w * x
            of_xz += w * x * z
            of_xx += w * x * x
            y1 += w * y
            yz += w * y * z
            yx += w * y * x
            on += 1
    A[0, 0], A[1, 0], A[1, 1] = one, of_z / near, of_zz / (near * near)
    A[2, 0], A[2, 1], A[2, 2] = of_x, of_xz / near, of_xx
    b[0], b[1], b[2] = y1, yz / near, yx
    fitted = np.empty(3)
    if on >= LEAST_POINTS and solve(A, b, fitted):
        plane[0] = fitted[0]
        plane[1] = fitted[1] / near
        plane[2] = fitted[2]
    return on


@numba.njit(cache=True, nogil=True, error_model="numpy")
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
    """See `reference.road.draw_plane`."""
    fb, near, side, _ = scales
    rays = np.empty((4, n), np.float32)
    near_points = np.empty((n, 4))
    m: Any = np.int64(0)  # for a plain 0, `support` and `fit_plane` would be compiled a second time
    for i in range(n):
        x, y, z, d = points[i]
        if z < near:
            rays[0, m] = x / z
            rays[1, m] = y / z
            rays[2, m] = POINT / (1 + (x / side) ** 2)
            rays[3, m] = d
            near_points[m] = points[i]
            m += 1
    if m < minimum:
        return False
    stride = -(-m // JUDGES)
    judges = (m + stride - 1) // stride
    some = np.empty((4, judges), np.float32)
    for k in range(judges):
        for j in range(4):
            some[j, k] = rays[j, k * stride]
    best = np.full((POLISHED, 4), -np.inf)
    candidate = np.empty(3)
    A, b = np.zeros((3, 3)), np.zeros(3)
    state = np.uint64(seed * 2 + 1)
    for draw in range(draws + 1):
        if draw == draws:
            if not np.isfinite(prior[0]):
                break
            candidate[:] = prior
        else:
            picked = np.zeros(3, np.int64)
            for j in range(3):
                state = state * np.uint64(MULTIPLIER) + np.uint64(INCREMENT)
                picked[j] = np.int64((state >> np.uint64(33)) % np.uint64(m))
            x0, y0, z0, _ = near_points[picked[0]]
            x1, y1, z1, _ = near_points[picked[1]]
            x2, y2, z2, _ = near_points[picked[2]]
            det = (z1 - z0) * (x2 - x0) - (z2 - z0) * (x1 - x0)
            if abs(det) < LEAST_SPAN * near * near:
                continue
            candidate[1] = ((y1 - y0) * (x2 - x0) - (y2 - y0) * (x1 - x0)) / det
            candidate[2] = ((z1 - z0) * (y2 - y0) - (z2 - z0) * (y1 - y0)) / det
            candidate[0] = y0 - candidate[1] * z0 - candidate[2] * x0
        if not is_allowed(candidate[0], candidate[1], candidate[2], allowed):
            continue
        score = support(some, judges, candidate, fb, tolerance_px)
        worst = 0
        for k in range(1, POLISHED):
            if best[k, 0] < best[worst, 0]:
                worst = k
        if score > best[worst, 0]:
            best[worst, 0] = score
            best[worst, 1:] = candidate
    top = -np.inf
    for k in range(POLISHED):
        if best[k, 0] == -np.inf:
            continue
        candidate[:] = best[k, 1:]
        for _ in range(POLISHES):
            fit_plane(near_points, m, candidate, tolerance_px, 0.0, scales, A, b)
        score = support(rays, m, candidate, fb, tolerance_px)
        if score > top:
            top = score
            plane[:] = candidate
    if top == -np.inf:
        return False
    c, on = fb / plane[0], 0
    for i in range(m):
        on += abs(rays[3, i] - (rays[1, i] - plane[1] - plane[2] * rays[0, i]) * c) < tolerance_px
    return on >= minimum


@numba.njit(cache=True, nogil=True, error_model="numpy")
def bend(points: Floats, n: int, start: Floats, far: float, tolerance_m: float, scales: Floats, bent: Floats) -> None:
    """See `reference.road.bend`."""
    _, near, side, _ = scales
    reach_x = ASIDE * side
    bent[:3] = start
    bent[3] = 0.0
    A, b, fitted = np.empty((4, 4)), np.empty(4), np.empty(4)
    # Weights of a prior in the scaled unknowns (h, s*near, t, q*near^2): no curvature, the near plane near itself.
    hold = np.array([(HOLD[0] / near) ** 2, (HOLD[1] / near) ** 2, HOLD[2] ** 2, (HOLD[3] / near) ** 2])
    for step in range(GROWTH):
        reach = near + (far - near) * step / (GROWTH - 1)
        h, s, t, q = bent
        one = z1 = z2 = z3 = z4 = x1 = xz = xzz = xx = y1 = yz = yzz = yx = 0.0
        for i in range(n):
            x, y, z = points[i, 0], points[i, 1], points[i, 2]
            slack = SLACK * tolerance_m + SLACK_PER_M * z
            if abs(y - h - s * z - t * x - q * z * z) < slack and z < reach and abs(x) < reach_x:
                w = 1 / (slack * slack)
                wz, wx, zz = w * z, w * x, z * z
                one += w
                z1 += wz
                z2 += wz * z
                z3 += wz * zz
                z4 += w * zz * zz
                x1 += wx
                xz += wx * z
                xzz += wx * zz
                xx += wx * x
                y1 += w * y
                yz += wz * y
                yzz += w * zz * y
                yx += wx * y
        per, per2 = 1 / near, 1 / (near * near)
        A[0, 0], A[1, 0], A[1, 1] = one + hold[0], z1 * per, z2 * per2 + hold[1]
        A[2, 0], A[2, 1], A[2, 2] = x1, xz * per, xx + hold[2]
        A[3, 0], A[3, 1], A[3, 2], A[3, 3] = z2 * per2, z3 * per * per2, xzz * per2, z4 * per2 * per2 + hold[3]
        b[0], b[1] = y1 + hold[0] * start[0], yz * per + hold[1] * start[1] * near
        b[2], b[3] = yx + hold[2] * start[2], yzz * per2
        if solve(A, b, fitted):
            bent[0], bent[1], bent[2], bent[3] = fitted[0], fitted[1] * per, fitted[2], fitted[3] * per2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_road(
    d_px: NDArray[np.float32],
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
    """See `reference.road.find_road`."""
    tolerance_px, tolerance_m = tolerances
    far = limits[0]
    points = np.empty((BIN_POINTS * (int(far / limits[5]) + 1), 4))
    n = gather_candidates(d_px, cell_w, cell_h, twin, limits, points)
    if n < minimum:
        return False
    plane = np.empty(3)
    if not draw_plane(points, n, draws, seed, tolerance_px, minimum, allowed, scales, prior, plane):
        return False
    A, b = np.zeros((3, 3)), np.zeros(3)
    for tolerance in TOLERANCES:
        if fit_plane(points, n, plane, 0.0, tolerance * tolerance_m, scales, A, b) < minimum:
            return False
    if not is_allowed(plane[0], plane[1], plane[2], allowed):
        return False
    bent = np.empty(4)
    bend(points, n, plane, far, tolerance_m, scales, bent)
    depths = np.empty(n)
    on = 0
    for i in range(n):
        x, y, z, _ = points[i]
        if abs(y - bent[0] - bent[1] * z - bent[2] * x - bent[3] * z * z) < tolerance_m:
            depths[on] = z
            on += 1
    if on == 0:
        return False
    road[:3] = plane
    road[3] = -bent[3]
    road[4] = on / n
    last = int(RANGE_SHARE * (on - 1))
    road[5] = np.partition(depths[:on], last)[last]
    return True
