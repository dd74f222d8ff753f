"""The kernels of `reference.track`, compiled: same names, same arguments, same numbers to rounding."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.track import (
    ABOVE_FOOT,
    BEFORE_M,
    BEHIND_M,
    BEHIND_SHARE,
    BIAS_PX,
    CALMEST,
    CAUCHY,
    CLOSING_MPS,
    CLOSING_SIGMAS,
    CONTRADICTED,
    DEPTH_M,
    EDGE_PX,
    FAR,
    FAST_MPS,
    FAST_SHARE,
    FLOOR_MPS,
    LEAST,
    LEAST_SHARE,
    LOOKS,
    MEDIAN_OF_1,
    MOVING,
    NOISE_LIMITS,
    RISE_M2PS,
    ROUNDS,
    ROW_SHARE,
    SIDE_SHARE,
    SIZE,
    STEP_PX,
    SURPRISING,
    TIMIDITY,
    TINY,
    UPRIGHT,
    Floats,
    Indices,
)

LEAST_LOG, MOST_LOG = NOISE_LIMITS


@numba.njit(cache=True, nogil=True, error_model="numpy")
def carry(T: Floats, cov: Floats, T_vehicle_car: Floats, dt_s: float) -> tuple[Floats, Floats, Floats]:
    """See `reference.track.carry`."""
    A = T_vehicle_car
    there, first = np.zeros((4, 4)), np.empty((3, 4))
    for i in range(3):
        for j in range(4):
            first[i, j] = A[i, 0] * T[0, j] + A[i, 1] * T[1, j] + A[i, 2] * T[2, j] + (A[i, 3] if j == 3 else 0.0)
    for i in range(3):
        there[i, 3] = first[i, 3]
        for j in range(3):
            there[i, j] = first[i, 0] * A[j, 0] + first[i, 1] * A[j, 1] + first[i, 2] * A[j, 2]
            there[i, 3] -= there[i, j] * A[j, 3]
    there[3, 3] = 1.0
    adjoint = np.zeros((6, 6))
    for j in range(3):
        for i in range(3):
            adjoint[i, j] = adjoint[3 + i, 3 + j] = A[i, j]
        adjoint[3, j] = A[1, 3] * A[2, j] - A[2, 3] * A[1, j]
        adjoint[4, j] = A[2, 3] * A[0, j] - A[0, 3] * A[2, j]
        adjoint[5, j] = A[0, 3] * A[1, j] - A[1, 3] * A[0, j]
    half, cov_there = np.zeros((6, 6)), np.zeros((6, 6))
    for i in range(6):
        for j in range(6):
            for k in range(6):
                half[i, j] += adjoint[i, k] * cov[k, j]
    for i in range(6):
        for j in range(6):
            for k in range(6):
                cov_there[i, j] += half[i, k] * adjoint[j, k]
    twist = np.empty(6)
    twist[0], twist[1] = (there[2, 1] - there[1, 2]) / 2, (there[0, 2] - there[2, 0]) / 2
    twist[2] = (there[1, 0] - there[0, 1]) / 2
    sine = np.sqrt(twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2)
    angle = np.arctan2(sine, (there[0, 0] + there[1, 1] + there[2, 2] - 1) / 2)
    share = angle / sine if sine > TINY else 1.0
    for i in range(3):
        twist[i], twist[3 + i] = twist[i] * share / dt_s, there[i, 3] / dt_s
    return there, cov_there, twist


@numba.njit(cache=True, nogil=True, error_model="numpy")
def predict(
    x: Floats,
    P: Floats,
    calm: Floats,
    dt_s: float,
    T_now_before: Floats,
    ego_cov: Floats,
    noise_m2ps3: float,
    still_m2ps3: float,
) -> tuple[Floats, Floats]:
    """See `reference.track.predict`."""
    n, t = len(x), abs(dt_s)
    side = -1.0 if dt_s < 0 else 1.0
    R = T_now_before
    F = np.zeros((SIZE, SIZE))
    for i in range(3):
        for j in range(3):
            F[i, j] = R[i, j]
        for j in range(2):
            F[i, 3 + j] = R[i, j] * dt_s
    for i in range(2):
        for j in range(2):
            F[3 + i, 3 + j] = R[i, j]
    then, cov = np.empty((n, SIZE)), np.empty((n, SIZE, SIZE))
    FP, G, GC = np.empty((SIZE, SIZE)), np.zeros((SIZE, 6)), np.empty((SIZE, 6))
    G[0, 3] = G[1, 4] = G[2, 5] = 1.0
    for k in range(n):
        q = calm[k] * (noise_m2ps3 if _deviation(x[k], P[k]) > MOVING else still_m2ps3)
        for i in range(SIZE):
            total = R[i, 3] if i < 3 else 0.0
            for j in range(SIZE):
                total += F[i, j] * x[k, j]
            then[k, i] = total
        for i in range(SIZE):
            for j in range(SIZE):
                total = 0.0
                for m in range(SIZE):
                    total += F[i, m] * P[k, m, j]
                FP[i, j] = total
        px, py, pz, vx, vy = then[k]
        G[0, 1], G[0, 2], G[1, 0], G[1, 2], G[2, 0], G[2, 1] = pz, -py, -pz, px, py, -px
        G[3, 2], G[4, 2] = -vy, vx
        for i in range(SIZE):
            for j in range(6):
                total = 0.0
                for m in range(6):
                    total += G[i, m] * ego_cov[m, j]
                GC[i, j] = total
        for i in range(SIZE):
            for j in range(SIZE):
                total = 0.0
                for m in range(SIZE):
                    total += FP[i, m] * F[j, m]
                for m in range(6):
                    total += GC[i, m] * G[j, m]
                cov[k, i, j] = total
        for i in range(2):
            cov[k, i, i] += q * t**3 / 3
            cov[k, 3 + i, 3 + i] += q * t
            cov[k, i, 3 + i] += q * t * t / 2 * side
            cov[k, 3 + i, i] += q * t * t / 2 * side
        cov[k, 2, 2] += RISE_M2PS * t
    return then, cov


@numba.njit(cache=True, nogil=True, error_model="numpy")
def expect(x: Floats, P: Floats, twin: Floats, T_car_vehicle: Floats) -> tuple[Floats, Floats, Floats]:
    """See `reference.track.expect`."""
    n, T = len(x), T_car_vehicle
    f, cx, cy, baseline_m = twin
    uvd, J, S = np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3, 3))
    JP = np.empty((3, 3))
    for k in range(n):
        px, py, pz = x[k, 0], x[k, 1], x[k, 2]
        cx_m = T[0, 0] * px + T[0, 1] * py + T[0, 2] * pz + T[0, 3] + baseline_m / 2
        y = T[1, 0] * px + T[1, 1] * py + T[1, 2] * pz + T[1, 3]
        z = T[2, 0] * px + T[2, 1] * py + T[2, 2] * pz + T[2, 3]
        if not z > 0:
            z = np.nan
        scale = f / z
        uvd[k, 0], uvd[k, 1], uvd[k, 2] = cx_m * scale + cx, y * scale + cy, baseline_m * scale
        for j in range(3):
            J[k, 0, j] = scale * (T[0, j] - cx_m / z * T[2, j])
            J[k, 1, j] = scale * (T[1, j] - y / z * T[2, j])
            J[k, 2, j] = -baseline_m * scale / z * T[2, j]
        _sandwich(J[k], P[k], JP, S[k])
    return uvd, J, S


@numba.njit(cache=True, nogil=True, error_model="numpy")
def roughen(cov_px2: Floats, uvd: Floats, boxes: Floats, log_noise: Floats, twin: Floats) -> Floats:
    """See `reference.track.roughen`."""
    noise, factor = np.empty_like(cov_px2), np.exp(log_noise / 2)
    for k in range(len(uvd)):
        for i in range(3):
            for j in range(3):
                noise[k, i, j] = cov_px2[k, i, j]
        noise[k, 0, 0] += (SIDE_SHARE * (boxes[k, 2] - boxes[k, 0])) ** 2
        noise[k, 1, 1] += (ROW_SHARE * (boxes[k, 3] - boxes[k, 1])) ** 2
        noise[k, 2, 2] += (DEPTH_M * uvd[k, 2] ** 2 / (twin[0] * twin[3])) ** 2
        for i in range(3):
            for j in range(3):
                noise[k, i, j] *= factor[i] * factor[j]
    return noise


@numba.njit(cache=True, nogil=True, error_model="numpy")
def compare(
    rows: Indices,
    columns: Indices,
    expected: Floats,
    S: Floats,
    looks: Floats,
    measured: Floats,
    noise_px2: Floats,
    sizes: Floats,
    boxes: Floats,
    gate: float,
) -> Floats:
    """See `reference.track.compare`."""
    cost = np.full((len(rows), len(columns)), FAR)
    off, both, inverse = np.empty(3), np.empty((3, 3)), np.empty((3, 3))
    for k, i in enumerate(rows):
        for m, j in enumerate(columns):
            near = True
            for a in range(3):
                off[a] = measured[j, a] - expected[i, a]
                # No number alone may be further off than all three together; nor is NaN near.
                near &= off[a] * off[a] <= gate * (S[i, a, a] + noise_px2[j, a, a])
            if not near:
                continue
            for a in range(3):
                for b in range(3):
                    both[a, b] = S[i, a, b] + noise_px2[j, a, b]
            det = _invert(both, inverse)
            squared = 0.0
            for a in range(2):
                blur = 1 + LOOKS * 2 * EDGE_PX**2 / max(boxes[j, 2 + a] - boxes[j, a], 1.0) ** 2
                squared += LOOKS * (looks[i, a] - sizes[j, a]) ** 2 / blur
                det *= blur
            for a in range(3):
                for b in range(3):
                    squared += off[a] * inverse[a, b] * off[b]
            if squared <= gate:
                cost[k, m] = squared + np.log(det)
    return cost


@numba.njit(cache=True, nogil=True, error_model="numpy")
def correct(
    rows: Indices,
    columns: Indices,
    x: Floats,
    P: Floats,
    expected: Floats,
    J: Floats,
    measured: Floats,
    noise_px2: Floats,
    grown_px2: Floats,
) -> None:
    """See `reference.track.correct`."""
    PH, S, inverse, K = np.empty((SIZE, 3)), np.empty((3, 3)), np.empty((3, 3)), np.empty((SIZE, 3))
    for m in range(len(rows)):
        k, c = rows[m], columns[m]
        H, before = J[k], P[k].copy()
        for i in range(SIZE):
            for j in range(3):
                PH[i, j] = before[i, 0] * H[j, 0] + before[i, 1] * H[j, 1] + before[i, 2] * H[j, 2]
        for i in range(3):
            for j in range(3):
                S[i, j] = H[i, 0] * PH[0, j] + H[i, 1] * PH[1, j] + H[i, 2] * PH[2, j] + noise_px2[c, i, j]
        for i in range(3):
            S[i, i] += grown_px2[m, i]
        _invert(S, inverse)
        o0, o1, o2 = (
            measured[c, 0] - expected[k, 0],
            measured[c, 1] - expected[k, 1],
            measured[c, 2] - expected[k, 2],
        )
        for i in range(SIZE):
            for j in range(3):
                K[i, j] = PH[i, 0] * inverse[0, j] + PH[i, 1] * inverse[1, j] + PH[i, 2] * inverse[2, j]
            x[k, i] += K[i, 0] * o0 + K[i, 1] * o1 + K[i, 2] * o2
        for i in range(SIZE):
            for j in range(i + 1):
                there = K[i, 0] * PH[j, 0] + K[i, 1] * PH[j, 1] + K[i, 2] * PH[j, 2]
                back = K[j, 0] * PH[i, 0] + K[j, 1] * PH[i, 1] + K[j, 2] * PH[i, 2]
                P[k, i, j] = P[k, j, i] = (before[i, j] + before[j, i] - there - back) / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def feel(
    rows: Indices,
    uvd: Floats,
    off_px: Floats,
    information_px2: Floats,
    dt_s: float,
    boxes: Floats,
    range_m: Floats,
    long_m: Floats,
    twin: Floats,
    T_car_vehicle: Floats,
) -> tuple[Floats, Floats, Floats]:
    """See `reference.track.feel`."""
    n, count = len(rows), len(uvd)
    f, cx, cy, baseline_m = twin
    A, b, c, z = np.empty((2, count, 3)), np.empty((2, count, 2)), np.empty((2, count)), np.empty(count)
    J, JW, aside = np.empty((3, 2)), np.empty((2, 3)), np.empty((3, 3))
    for k in range(count):
        h = uvd[k, 2] - off_px[k, 2] / 2
        z[k] = f * baseline_m / uvd[k, 2] if uvd[k, 2] > 0 and h > 0 else np.nan
        u_m, v_m = (uvd[k, 0] - off_px[k, 0] / 2 - cx) / f, (uvd[k, 1] - off_px[k, 1] / 2 - cy) / f
        scale = dt_s * h / baseline_m
        for j in range(2):
            J[0, j] = scale * (T_car_vehicle[0, j] - u_m * T_car_vehicle[2, j])
            J[1, j] = scale * (T_car_vehicle[1, j] - v_m * T_car_vehicle[2, j])
            J[2, j] = -scale * h / f * T_car_vehicle[2, j]
        whole, off = information_px2[k], off_px[k]
        for i in range(3):
            for j in range(3):
                aside[i, j] = whole[i, j] - whole[i, 1] * whole[1, j] / whole[1, 1]
        for p, W in enumerate((whole, aside)):
            for j in range(2):
                for i in range(3):
                    JW[j, i] = J[0, j] * W[0, i] + J[1, j] * W[1, i] + J[2, j] * W[2, i]
                b[p, k, j] = JW[j, 0] * off[0] + JW[j, 1] * off[1] + JW[j, 2] * off[2]
            A[p, k, 0] = JW[0, 0] * J[0, 0] + JW[0, 1] * J[1, 0] + JW[0, 2] * J[2, 0]
            A[p, k, 1] = JW[0, 0] * J[0, 1] + JW[0, 1] * J[1, 1] + JW[0, 2] * J[2, 1]
            A[p, k, 2] = JW[1, 0] * J[0, 1] + JW[1, 1] * J[1, 1] + JW[1, 2] * J[2, 1]
            c[p, k] = 0.0
            for i in range(3):
                for j in range(3):
                    c[p, k] += off[i] * W[i, j] * off[j]
    v_mps, cov, count_of = np.empty((n, 2)), np.empty((n, 2, 2)), np.empty(n)
    mine, trust = np.empty(count, np.int64), np.empty(count)
    for o in range(n):
        m, p, r = 0, 0, rows[o]
        u0, v0, u1, v1 = boxes[r]
        if v1 - v0 > UPRIGHT * (u1 - u0):
            p, v1 = 1, v0 + ABOVE_FOOT * (v1 - v0)
        near_m, far_m = range_m[r] - BEFORE_M, range_m[r] + max(BEHIND_M, BEHIND_SHARE * range_m[r], long_m[r])
        for k in range(count):
            if u0 <= uvd[k, 0] < u1 and v0 <= uvd[k, 1] < v1 and near_m < z[k] < far_m:
                mine[m], trust[m] = k, 1.0
                m += 1
        for _ in range(ROUNDS):
            a0, a1, a2, b0, b1 = 1e-6, 0.0, 1e-6, 0.0, 0.0
            for i in range(m):
                k, w = mine[i], trust[i]
                a0 += w * A[p, k, 0]
                a1 += w * A[p, k, 1]
                a2 += w * A[p, k, 2]
                b0 += w * b[p, k, 0]
                b1 += w * b[p, k, 1]
            det = a0 * a2 - a1 * a1
            vx, vy = (a2 * b0 - a1 * b1) / det, (a0 * b1 - a1 * b0) / det
            counted = 0.0
            for i in range(m):
                k = mine[i]
                squared = c[p, k] - 2 * (vx * b[p, k, 0] + vy * b[p, k, 1])
                squared += vx * vx * A[p, k, 0] + 2 * vx * vy * A[p, k, 1] + vy * vy * A[p, k, 2]
                trust[i] = 1 / (1 + max(squared, 0.0) / CAUCHY**2)
                counted += trust[i]
        v_mps[o, 0], v_mps[o, 1] = vx, vy
        cov[o, 0, 0], cov[o, 1, 1] = a2 / det + FLOOR_MPS**2, a0 / det + FLOOR_MPS**2
        cov[o, 0, 1] = cov[o, 1, 0] = -a1 / det
        step_mps = STEP_PX / dt_s * range_m[r] ** 2 / (f * baseline_m)
        for i in range(2):
            for j in range(2):
                cov[o, i, j] += step_mps * T_car_vehicle[2, i] * step_mps * T_car_vehicle[2, j]
        share = FAST_SHARE if vx * vx + vy * vy > FAST_MPS**2 else LEAST_SHARE
        count_of[o] = counted if counted >= LEAST and counted >= share * m else 0.0
    return v_mps, cov, count_of


@numba.njit(cache=True, nogil=True, error_model="numpy")
def correct_velocity(
    rows: Indices,
    x: Floats,
    P: Floats,
    against: NDArray[np.int64],
    calm: Floats,
    v_mps: Floats,
    cov_m2ps2: Floats,
    known: NDArray[np.bool_],
    calmer: float,
) -> None:
    """See `reference.track.correct_velocity`."""
    K = np.empty((SIZE, 2))
    for m in range(len(rows)):
        if not known[m]:
            continue
        k, before, C = rows[m], P[rows[m]].copy(), cov_m2ps2[m]
        o0, o1 = v_mps[m, 0] - x[k, 3], v_mps[m, 1] - x[k, 4]
        s0, s1, s2, s3 = before[3, 3] + C[0, 0], before[3, 4] + C[0, 1], before[4, 3] + C[1, 0], before[4, 4] + C[1, 1]
        det = s0 * s3 - s1 * s2
        squared = (o0 * (s3 * o0 - s1 * o1) + o1 * (s0 * o1 - s2 * o0)) / det
        calm[k] = 1.0 if squared > SURPRISING else max(calm[k] * calmer, CALMEST)
        if squared > MOVING:
            against[k] += 1
            if against[k] < CONTRADICTED:
                continue
            for j in range(2):
                x[k, 3 + j] = v_mps[m, j]
                for i in range(3):
                    P[k, i, 3 + j] = P[k, 3 + j, i] = 0.0
                for i in range(2):
                    P[k, 3 + i, 3 + j] = (C[i, j] + C[j, i]) / 2
            continue
        against[k] = 0
        for i in range(SIZE):
            K[i, 0] = (before[3, i] * s3 - before[4, i] * s1) / det
            K[i, 1] = (before[4, i] * s0 - before[3, i] * s2) / det
            x[k, i] += K[i, 0] * o0 + K[i, 1] * o1
        for i in range(SIZE):
            for j in range(i + 1):
                there = K[i, 0] * before[3, j] + K[i, 1] * before[4, j]
                back = K[j, 0] * before[3, i] + K[j, 1] * before[4, i]
                P[k, i, j] = P[k, j, i] = (before[i, j] + before[j, i] - there - back) / 2


@numba.njit(cache=True, nogil=True, error_model="numpy")
def approach(
    x: Floats, P: Floats, ahead: Floats, eye: Floats, fb: float, twist: Floats, twist_cov: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """See `reference.track.approach`."""
    count = len(x)
    ttc_s, sigma_s, off = np.full(count, np.nan), np.full(count, np.nan), np.empty(count)
    places, sight = np.empty((count, 3, 3)), np.empty(3)
    ego_var = 0.0
    for i in range(3):
        for j in range(3):
            ego_var += ahead[i] * twist_cov[3 + i, 3 + j] * ahead[j]
    for k in range(count):
        off[k] = _deviation(x[k], P[k])
        px, py, pz = x[k, 0], x[k, 1], x[k, 2]
        v = -(x[k, 3] * ahead[0] + x[k, 4] * ahead[1])
        v -= (twist[1] * pz - twist[2] * py + twist[3]) * ahead[0]
        v -= (twist[2] * px - twist[0] * pz + twist[4]) * ahead[1]
        v -= (twist[0] * py - twist[1] * px + twist[5]) * ahead[2]
        v_var, z_var, both = ego_var, 0.0, 0.0
        z_m = ahead[0] * px + ahead[1] * py + ahead[2] * pz + ahead[3]
        for i in range(3):
            sight[i] = (x[k, i] - eye[i]) * BIAS_PX * z_m / fb
        for i in range(3):
            for j in range(3):
                places[k, i, j] = P[k, i, j] + sight[i] * sight[j]
                z_var += ahead[i] * places[k, i, j] * ahead[j]
            for j in range(2):
                both += ahead[i] * P[k, i, 3 + j] * ahead[j]
        for i in range(2):
            for j in range(2):
                v_var += ahead[i] * P[k, 3 + i, 3 + j] * ahead[j]
        if v > max(CLOSING_MPS, CLOSING_SIGMAS * np.sqrt(v_var)):
            t = z_m / v
            ttc_s[k], sigma_s[k] = t, np.sqrt(max(z_var + t * t * v_var + 2 * t * both, 0.0)) / v
    return ttc_s, sigma_s, off, places


@numba.njit(cache=True, nogil=True, error_model="numpy")
def deviation(v: Floats, cov: Floats) -> Floats:
    """See `reference.track.deviation`."""
    off = np.empty(len(v))
    for k in range(len(v)):
        off[k] = _squared(v[k, 0], v[k, 1], cov[k, 0, 0], cov[k, 0, 1], cov[k, 1, 1])
    return off


@numba.njit(cache=True, nogil=True, error_model="numpy")
def learn(
    rows: Indices,
    columns: Indices,
    log_noise: Floats,
    expected: Floats,
    S: Floats,
    measured: Floats,
    noise_px2: Floats,
) -> Floats:
    """See `reference.track.learn`."""
    n, learnt = len(rows), np.empty(3)
    for a in range(3):
        surprises = 0
        for m in range(n):
            k, c = rows[m], columns[m]
            variance = S[k, a, a] + noise_px2[c, a, a]
            surprises += (measured[c, a] - expected[k, a]) ** 2 > MEDIAN_OF_1 * variance
        step = TIMIDITY * (surprises - 0.5 * n) / (n + 2)
        learnt[a] = min(max(log_noise[a] + step, LEAST_LOG), MOST_LOG)
    return learnt


@numba.njit(cache=True, nogil=True, error_model="numpy")
def clearance(
    u_px: Floats, half_px: Floats, wide_px: Floats, column_px: Floats, free_m: Floats
) -> tuple[Floats, Floats]:
    """See `reference.track.clearance`."""
    n, count = len(u_px), len(column_px)
    median, least, near = np.empty(n), np.full(n, np.nan), np.empty(count)
    for k in range(n):
        m = 0
        for i in range(count):
            apart_px = abs(column_px[i] - u_px[k])
            if not np.isfinite(free_m[i]):
                continue
            if apart_px <= half_px[k]:
                near[m] = free_m[i]
                m += 1
            if apart_px <= wide_px[k] and not free_m[i] >= least[k]:
                least[k] = free_m[i]
        near[:m].sort()
        median[k] = (near[(m - 1) // 2] + near[m // 2]) / 2 if m else np.nan
    return median, least


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _deviation(x: Floats, P: Floats) -> float:
    """Return how far the velocity of one state is from 0."""
    return _squared(x[3], x[4], P[3, 3], P[3, 4], P[4, 4])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _squared(x: float, y: float, a: float, b: float, c: float) -> float:
    return (c * x * x - 2 * b * x * y + a * y * y) / max(a * c - b * b, TINY)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sandwich(J: Floats, P: Floats, JP: Floats, S: Floats) -> None:
    """Write J P J^T of the places' part of P."""
    for i in range(3):
        for j in range(3):
            JP[i, j] = J[i, 0] * P[0, j] + J[i, 1] * P[1, j] + J[i, 2] * P[2, j]
    for i in range(3):
        for j in range(3):
            S[i, j] = JP[i, 0] * J[j, 0] + JP[i, 1] * J[j, 1] + JP[i, 2] * J[j, 2]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _invert(A: Floats, into: Floats) -> float:
    """Write the inverse of a 3x3 matrix and return its determinant."""
    c0 = A[1, 1] * A[2, 2] - A[1, 2] * A[2, 1]
    c1 = A[1, 2] * A[2, 0] - A[1, 0] * A[2, 2]
    c2 = A[1, 0] * A[2, 1] - A[1, 1] * A[2, 0]
    det = A[0, 0] * c0 + A[0, 1] * c1 + A[0, 2] * c2
    into[0, 0], into[1, 0], into[2, 0] = c0 / det, c1 / det, c2 / det
    into[0, 1] = (A[0, 2] * A[2, 1] - A[0, 1] * A[2, 2]) / det
    into[1, 1] = (A[0, 0] * A[2, 2] - A[0, 2] * A[2, 0]) / det
    into[2, 1] = (A[0, 1] * A[2, 0] - A[0, 0] * A[2, 1]) / det
    into[0, 2] = (A[0, 1] * A[1, 2] - A[0, 2] * A[1, 1]) / det
    into[1, 2] = (A[0, 2] * A[1, 0] - A[0, 0] * A[1, 2]) / det
    into[2, 2] = (A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]) / det
    return det  # type: ignore[no-any-return]
