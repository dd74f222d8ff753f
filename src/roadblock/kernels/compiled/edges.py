"""Where the road ends without a wall, compiled: kerbs and verges, per column of cells."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.edges import (
    AGREE,
    ALONG,
    BACK_M,
    BEFORE_M,
    BESIDE,
    EDGE_ROWS,
    FOLLOW_M,
    KERB,
    LONG_M,
    NO_EDGE,
    ROAD_ROWS,
    ROUGH_M,
    RUN_M,
    SLOPE,
    VERGE,
    VERGE_M,
    Floats,
    Singles,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def find_edges(
    height: Singles,
    z: Singles,
    free: Floats,
    noise_per_m: float,
    limits_m: Floats,
    edge: Floats,
    tall: Floats,
    kind: NDArray[np.uint8],
) -> None:
    """See `reference.edges.find_edges`."""
    rise_m, high_m = limits_m
    rows, columns = height.shape
    first, verges = np.full(columns, -1, np.int32), np.zeros(columns, np.bool_)
    for column in range(columns):
        edge[column], tall[column], kind[column] = np.nan, np.nan, NO_EDGE
        base_m, last_m, seen = 0.0, 0.0, 0
        run, begin_m, end_m, back, total, square = 0, 0.0, 0.0, 0, 0.0, 0.0
        for row in range(rows - 1, -1, -1):
            h_m, z_m, n = 0.0, 0.0, 0
            for i in range(max(0, column - BESIDE), min(columns, column + BESIDE + 1)):
                h = np.float64(height[row, i])
                if -2 * high_m < h < 2 * high_m:
                    h_m += h
                    z_m += z[row, i]
                    n += 1
            if n == 0:
                continue
            h_m /= n
            z_m /= n
            noise_m = noise_per_m * z_m
            if z_m > free[column] - BEFORE_M or noise_m > rise_m / 2:
                break
            up_m = h_m - base_m
            if seen >= ROAD_ROWS and up_m > max(rise_m, 2 * noise_m) and h_m < high_m + 2 * noise_m:
                if run == 0:
                    begin_m, first[column] = z_m, row
                run += 1
                end_m = z_m
                if z_m - begin_m >= BACK_M:
                    back += 1
                    total += up_m
                    square += up_m * up_m
                if run >= EDGE_ROWS and z_m - begin_m >= LONG_M:
                    break
            elif run > 0 and up_m > rise_m / 2:
                continue
            elif run >= EDGE_ROWS and end_m - begin_m >= RUN_M:
                break
            else:
                run, back, total, square = 0, 0, 0.0, 0.0
                if abs(up_m) < rise_m:
                    share = 1.0 if seen == 0 else min(1.0, max(0.0, z_m - last_m) / FOLLOW_M)
                    base_m += share * up_m
                    last_m = max(z_m, last_m)
                    seen += 1
        if run >= EDGE_ROWS and end_m - begin_m >= RUN_M:
            edge[column], tall[column] = begin_m, total / back
            noise_m = noise_per_m * begin_m
            rough_m2 = max(0.0, square / back - (total / back) ** 2) - noise_m * noise_m
            verges[column] = rough_m2 > ROUGH_M**2 or total / back > VERGE_M
        else:
            first[column] = -1
    for column in range(columns):
        if first[column] < 0:
            continue
        joined, rough = 0, 0
        for i in range(max(0, column - ALONG), min(columns, column + ALONG + 1)):
            if first[i] >= 0 and abs(first[i] - first[column]) <= BESIDE + SLOPE * abs(i - column):
                joined += 1
                rough += verges[i]
        if joined >= AGREE:
            kind[column] = VERGE if 2 * rough > joined else KERB
    for column in range(columns):
        if kind[column] == NO_EDGE:
            edge[column] = tall[column] = np.nan
