"""What is said of tracks: velocity, whether they move, time to collision; and obstacles moved on unseen."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from roadblock.stages.track.bank import Bank
from roadblock.stages.track.kalman import Optics
from roadblock.values.checks import FloatArray
from roadblock.values.motion import Track
from roadblock.values.scene import Obstacle

SURE = 13.8
"""Squared distance from standing still beyond which something moves: 99.9 % of two numbers."""
SLOW_MPS = 0.7
"""What is slower stands, if that is known well."""
STANDING_SIGMA_MPS = 0.6
"""Largest standard deviation of a velocity that is known well."""
WELL_KNOWN = 4
"""What was measured less often, neither moves nor stands, nor coasts: two pieces of one thing may look like a fast one.
"""
CLOSING_MPS = 0.3
CLOSING_SIGMAS = 2.0
"""What comes closer no faster than this has no time to collision."""


def describe(
    bank: Bank,
    rows: NDArray[np.intp],
    t_ns: int,
    optics: Optics,
    standing_mps: FloatArray,
    over_ground: bool,
    twist_cov: FloatArray,
) -> list[Track]:
    """Return what is known of some tracks.

    Parameters
    ----------
    bank, rows
        The tracks.
    t_ns
        Now.
    optics
        Where the cameras are.
    standing_mps
        (k, 3) how things there move relative to the vehicle if they stand still.
    over_ground
        Whether velocities are over ground.
    twist_cov
        (6, 6) covariance of the vehicle's own motion by second.
    """
    x, P = bank.x[rows], bank.P[rows]
    n = optics.T_car_vehicle[2, :3]
    z_m = x[:, :3] @ n + optics.T_car_vehicle[2, 3]
    closing_mps = -(x[:, 3:] @ n[:2])
    ego_var = 0.0
    if over_ground:
        closing_mps = closing_mps - standing_mps @ n
        ego_var = float(n @ twist_cov[3:, 3:] @ n)
    closing_var = np.einsum("i,nij,j->n", n[:2], P[:, 3:, 3:], n[:2]) + ego_var
    z_var = np.einsum("i,nij,j->n", n, P[:, :3, :3], n)
    both = np.einsum("i,nij,j->n", n, P[:, :3, 3:], n[:2])
    sure = closing_mps > np.maximum(CLOSING_MPS, CLOSING_SIGMAS * np.sqrt(closing_var))
    v = np.where(sure, closing_mps, np.nan)
    ttc_s = z_m / v
    ttc_sigma_s = np.sqrt(np.maximum(z_var + ttc_s**2 * closing_var + 2 * ttc_s * both, 0)) / v
    ages_s, unseen_s = (t_ns - bank.born_ns[rows]) / 1e9, (t_ns - bank.seen_ns[rows]) / 1e9
    motions = np.where(
        over_ground & (bank.found[rows] >= WELL_KNOWN), motion_states(x[:, 3:], P[:, 3:, 3:]), "unknown"
    ).tolist()
    return [
        Track(number, age_s, coasted_s, x[i, :3], P[i, :3, :3], x[i, 3:], P[i, 3:, 3:], over_ground, *rest)
        for i, (number, age_s, coasted_s, *rest) in enumerate(
            zip(
                bank.id[rows].tolist(),
                ages_s.tolist(),
                unseen_s.tolist(),
                motions,
                ttc_s.tolist(),
                ttc_sigma_s.tolist(),
                strict=True,
            )
        )
    ]


def motion_states(v: FloatArray, cov: FloatArray) -> NDArray[np.str_]:
    """Return for each velocity (n, 2) over ground with covariance (n, 2, 2) whether it moves."""
    speed = np.hypot(*v.T)
    moves = (deviation(v, cov) > SURE) & (speed > SLOW_MPS)
    stands = (speed <= SLOW_MPS) & (np.maximum(cov[:, 0, 0], cov[:, 1, 1]) <= STANDING_SIGMA_MPS**2)
    return np.where(moves, "moving", np.where(stands, "standing", "unknown"))


def deviation(v: FloatArray, cov: FloatArray) -> FloatArray:
    """Return (n,) squared Mahalanobis distances of (n, 2) from 0 by covariances (n, 2, 2)."""
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    x, y = v.T
    return np.asarray((c * x * x - 2 * b * x * y + a * y * y) / np.maximum(a * c - b * b, 1e-12))


def moved_obstacle(bank: Bank, row: int, optics: Optics) -> Obstacle:
    """Return the latest measurement of a track, moved on to where it should be now."""
    last: Obstacle = bank.last[row]
    (uvd,), (J,) = optics.see(bank.x[row : row + 1, :3])
    P = bank.P[row, :3, :3]
    n = optics.T_car_vehicle[2, :3]
    r = optics.rectification
    scale = uvd[2] / last.uvd_px[2]

    def shifted(points: FloatArray) -> FloatArray:
        return np.asarray(np.rint((points - last.uvd_px[:2]) * scale + uvd[:2]))

    u0, v0, u1, v1 = shifted(np.array(last.box_px, float).reshape(2, 2)).ravel().astype(int).tolist()
    return replace(
        last,
        position_m=bank.x[row, :3] + bank.foot_m[row],
        range_m=r.f_px * r.baseline_m / float(uvd[2]),
        range_sigma_m=float(np.sqrt(n @ P @ n)),
        uvd_px=uvd,
        cov_uvd_px2=J @ P @ J.T,
        cov_match_m2=P,
        box_px=(u0, v0, max(u1, u0 + 1), max(v1, v0 + 1)),
        contour_px=shifted(last.contour_px.astype(float)).astype(np.int32),
        track=None,
    )
