"""Where each surface is, and how well that is known, readably.

Shared by all: `twin` is (f, cx, cy in pixels, baseline in metres); `road` is (n_x, n_y, n_z, h in metres, bend per
metre), all NaN without one: `n . p + h - bend z^2` is the height of p over it, in the car frame (x right, y down, z
forward).
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]

FACE_SHARE = 0.3
"""The nearest samples of a surface, whose middle is the obstacle's."""
SIDE_SHARES = (0.01, 0.99)
"""A surface's sides, and its top, lie here."""
FAR_SHARE = 0.95
"""A surface's far end lies here."""
FACE_PART, DEPTH_PART = 0.04, 0.08
"""What a detector takes along or leaves out moves the nearest face by such shares of a thing's size (the root of its
width times its height) and of its depth, where that is seen (standard deviations)."""
EDGE_PX, WIDTH_PART, HEIGHT_PART = 3.0, 0.14, 0.07
"""How far the middle of the nearest face may lie beside the one measured (standard deviations): its edges lie between
cells; which part of the width is nearest is decided by little; and what is narrow for its height may go on unseen."""
FOOT_PX, FOOT_RAD, FOOT_FROM_M = 0.3, 0.002, 20.0
"""The same for the foot: a row's share, and what the road's slope is off by, all of it where no road is seen."""
SEEN_SIGMAS, SEEN_M = 3.0, 0.5
"""A thing's depth is seen that is so many times its noise, and its length known if it is so long, too."""
FIGURES = 28
"""Numbers that `place_feet` writes of each."""


def measure_surfaces(uvd: Floats, bounds: Ints, twin: Floats, road: Floats, near_share: float, out: Floats) -> None:
    """Write where each surface is, car frame, metres.

    Parameters
    ----------
    uvd
        (m, 3) samples of one surface after the other: column, row, disparity > 0, pixels.
    bounds
        (n + 1,) where each begins, and where the last ends; none is empty.
    twin, road
        See the module.
    near_share
        Quantile of the ranges that is the nearest face.
    out
        (n, 8), written: range of the nearest face; of the far end; x of the left and the right side; x of the middle of
        the nearest face (of the nearest `FACE_SHARE`, less one sample); median row, pixels; height over the road, or
        without one the extent downwards; y of the lowest sample.
    """
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, h, bend = road
    for k in range(len(bounds) - 1):
        u, v, d = uvd[bounds[k] : bounds[k + 1]].T
        z = f * baseline / d
        x, y = (u - cx) / f * z - baseline / 2, (v - cy) / f * z
        face = x[z <= np.quantile(z, max(FACE_SHARE - 1 / len(z), 0.0))]
        height = np.quantile(n_x * x + n_y * y + n_z * z + h - bend * z * z, SIDE_SHARES[1])
        out[k, :2] = np.quantile(z, [near_share, FAR_SHARE])
        out[k, 2:4] = np.quantile(x, SIDE_SHARES)
        out[k, 4] = np.quantile(face, SIDE_SHARES).mean()
        out[k, 5] = np.median(v)
        out[k, 6] = np.ptp(y) if np.isnan(n_x) else height
        out[k, 7] = y.max()


def place_feet(
    figures: Floats, sigmas_px: Floats, cut: Floats, twin: Floats, road: Floats, T_vehicle_car: Floats, out: Floats
) -> None:
    """Write the foot point of each nearest face, and what the noise of its measurement does to it.

    Parameters
    ----------
    figures
        (n, 8) of `measure_surfaces`.
    sigmas_px
        (n,) standard deviation of the disparity of each nearest face, pixels.
    cut
        (n,) 1 where what the detector takes along or leaves out (`FACE_PART`, `DEPTH_PART`) is not in it yet, else 0.
    twin, road
        See the module. Without a road, the lowest sample is the foot.
    T_vehicle_car
        (4, 4) the car frame in the vehicle's.
    out
        (n, `FIGURES`), written: foot, vehicle frame, metres (3); standard deviation of the range, metres (1); width,
        height and length, metres, NaN where the length is not seen (3); column, row and disparity, pixels (3), their
        covariance (9), and that of the foot by its Jacobian, square metres (9).
    """
    f, cx, _, baseline = twin
    n_x, n_y, n_z, h, bend = road
    z, far, left, right, x, v, height, lowest = figures.T
    y = lowest if np.isnan(n_x) else (n_x * x + n_z * z + h - bend * z**2) / -n_y
    scale, depth = f / z, far - z
    per_m = scale * baseline / z
    is_seen = depth > SEEN_SIGMAS * sigmas_px / per_m
    width, tall = right - left, np.maximum(height, 0.0)
    out[:, :3] = np.stack([x, y, z], -1) @ T_vehicle_car[:3, :3].T + T_vehicle_car[:3, 3]
    out[:, 4], out[:, 5] = np.maximum(width, 1 / scale), height
    out[:, 6] = np.where(is_seen & (depth > SEEN_M), depth, np.nan)
    u, d = (x + baseline / 2) * scale + cx, baseline * scale
    out[:, 7], out[:, 8], out[:, 9] = u, v, d
    moved = cut * np.hypot(FACE_PART * np.sqrt(width * tall), is_seen * DEPTH_PART * depth)
    sigma_d = np.hypot(sigmas_px, per_m * moved)
    out[:, 3] = z / d * sigma_d
    cov_uvd = np.zeros((len(z), 3, 3))
    cov_uvd[:, 0, 0] = EDGE_PX**2 + ((WIDTH_PART * width) ** 2 + (HEIGHT_PART * tall) ** 2) * scale**2
    cov_uvd[:, 1, 1] = FOOT_PX**2 + (f * FOOT_RAD * z / (z + FOOT_FROM_M)) ** 2
    cov_uvd[:, 2, 2] = sigma_d**2
    J = np.zeros((len(z), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = 1 / scale
    J[:, 0, 2], J[:, 1, 2], J[:, 2, 2] = -(x + baseline / 2) / d, -y / d, -z / d
    if not np.isnan(n_x):  # farther away a foot is farther along the road
        J[:, 1, 2] = 0
        J[:, 1] -= (n_x * J[:, 0] + (n_z - 2 * bend * z)[:, None] * J[:, 2]) / n_y
    J = T_vehicle_car[:3, :3] @ J
    out[:, 10:19] = cov_uvd.reshape(-1, 9)
    out[:, 19:28] = (J @ cov_uvd @ J.swapaxes(1, 2)).reshape(-1, 9)
