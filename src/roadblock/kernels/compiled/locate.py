"""Where each surface is, and how well that is known, compiled."""

import numba
import numpy as np

from roadblock.kernels.compiled.street import quantile_of
from roadblock.kernels.reference.locate import (
    DEPTH_PART,
    EDGE_PX,
    FACE_PART,
    FACE_SHARE,
    FAR_SHARE,
    FOOT_FROM_M,
    FOOT_PX,
    FOOT_RAD,
    HEIGHT_PART,
    SEEN_M,
    SEEN_SIGMAS,
    SIDE_SHARES,
    WIDTH_PART,
    Floats,
    Ints,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure_surfaces(uvd: Floats, bounds: Ints, twin: Floats, road: Floats, near_share: float, out: Floats) -> None:
    """See `reference.locate.measure_surfaces`."""
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def place_feet(
    figures: Floats, sigmas_px: Floats, cut: Floats, twin: Floats, road: Floats, T_vehicle_car: Floats, out: Floats
) -> None:
    """See `reference.locate.place_feet`."""
    f, cx, _, baseline = twin
    n_x, n_y, n_z, h, bend = road
    J, cov = np.zeros((3, 3)), np.zeros(3)
    for k in range(len(figures)):
        z, far, left, right, x, v, height, lowest = figures[k]
        y = lowest if n_x != n_x else (n_x * x + n_z * z + h - bend * z * z) / -n_y
        scale, depth = f / z, far - z
        d = baseline * scale
        per_m = d / z
        is_seen = depth > SEEN_SIGMAS * sigmas_px[k] / per_m
        width, tall = right - left, max(height, 0.0)
        for i in range(3):
            T = T_vehicle_car[i]
            out[k, i] = T[0] * x + T[1] * y + T[2] * z + T[3]
        out[k, 4], out[k, 5] = max(width, 1 / scale), height
        out[k, 6] = depth if is_seen and depth > SEEN_M else np.nan
        out[k, 7], out[k, 8], out[k, 9] = (x + baseline / 2) * scale + cx, v, d
        moved = DEPTH_PART * depth if is_seen else 0.0
        cov[2] = sigmas_px[k] ** 2 + per_m**2 * cut[k] * (FACE_PART**2 * width * tall + moved**2)
        cov[0] = EDGE_PX**2 + ((WIDTH_PART * width) ** 2 + (HEIGHT_PART * tall) ** 2) * scale**2
        cov[1] = FOOT_PX**2 + (f * FOOT_RAD * z / (z + FOOT_FROM_M)) ** 2
        out[k, 3] = z / d * np.sqrt(cov[2])
        J[0, 0] = J[1, 1] = 1 / scale
        J[0, 2], J[1, 2], J[2, 2] = -(x + baseline / 2) / d, -y / d, -z / d
        if n_x == n_x:  # farther away a foot is farther along the road
            to_z = n_z - 2 * bend * z
            J[1, 0] = -n_x * J[0, 0] / n_y
            J[1, 2] = -(n_x * J[0, 2] + to_z * J[2, 2]) / n_y
        for i in range(3):
            for j in range(3):
                out[k, 10 + 3 * i + j] = cov[i] if i == j else 0.0
                total = 0.0
                for m in range(3):
                    a = b = 0.0
                    for n in range(3):
                        a += T_vehicle_car[i, n] * J[n, m]
                        b += T_vehicle_car[j, n] * J[n, m]
                    total += a * b * cov[m]
                out[k, 19 + 3 * i + j] = total
