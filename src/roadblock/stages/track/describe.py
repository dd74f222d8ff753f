"""What is said of tracks: velocity, whether they move, time to collision; and obstacles moved on unseen."""

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.track import approach
from roadblock.stages.track.bank import Bank
from roadblock.stages.track.optics import Optics
from roadblock.values.checks import FloatArray
from roadblock.values.motion import MOTIONS, Track
from roadblock.values.scene import Obstacle

MOVING, STANDING, UNKNOWN = range(3)
"""Of `MOTIONS`."""
SURE = 13.8
"""Squared distance from standing still beyond which something moves: 99.9 % of two numbers."""
STILL = 6.0
"""And within which what has just left its place may stand: 95 %."""
SLOW_MPS, MOST_MPS = 0.7, 1.0
"""What is slower than the first, and a sigma faster slower than the second, stands."""
WELL_KNOWN = 4
"""What was measured less often, neither moves nor stands, nor coasts: two pieces of one thing may look like a fast one.
"""
FIXED_BY_NATURE = 0.5
"""What is more probably of a type that stands does so, however seldom it was measured."""
MOVED_S = 0.5
"""Who has left where he was is believed to move for so long."""


def describe(
    bank: Bank, rows: NDArray[np.intp], t_ns: int, optics: Optics, twist: FloatArray | None, twist_cov: FloatArray
) -> list[Track]:
    """Return what is known of some tracks.

    Parameters
    ----------
    bank, rows
        The tracks.
    t_ns
        Now.
    optics
        The cameras.
    twist, twist_cov
        (6,) how what stands turns and moves as seen from the vehicle, and (6, 6) its covariance; None where that is
        unknown and velocities are relative.
    """
    x, P = bank.x.take(rows, axis=0), bank.P.take(rows, axis=0)
    # What slid has the velocity of its outline, which is not its own: it may as well stand.
    slid = np.flatnonzero(bank.slid[rows])
    if len(slid):
        v = x[slid, 3:]
        P[slid, 3:, 3:] += v[:, :, None] * v[:, None, :]
        x[slid, 3:] = 0.0
    # Pieces of rails seem to move along them, and features of what is behind a pole stick to it.
    fixed = bank.fixed[rows] > FIXED_BY_NATURE
    x[fixed, 3:] = 0.0
    over_ground = twist is not None
    if twist is None:
        twist, twist_cov = np.zeros(6), np.zeros((6, 6))
    ttc_s, sigma_s, off, places = approach(x, P, optics.ahead, optics.eye, optics.fb, twist, twist_cov)
    is_known = over_ground & (bank.found[rows] >= WELL_KNOWN)
    speed = np.hypot(x[:, 3], x[:, 4])
    has_moved = t_ns - bank.moved_ns[rows] <= 1e9 * MOVED_S
    moves = is_known & (off > SURE) & (speed > SLOW_MPS) & has_moved
    sigma_mps = np.sqrt(np.maximum(P[:, 3, 3], P[:, 4, 4]))
    stands = is_known & (speed <= SLOW_MPS) & (speed + sigma_mps <= MOST_MPS)
    stands &= ~has_moved | (off <= STILL)
    stands |= over_ground & fixed
    return [
        Track.known(
            id=number,
            age_s=age_s,
            coasted_s=coasted_s,
            position_m=place,
            position_cov_m2=place_cov,
            velocity_mps=v,
            velocity_cov_m2ps2=v_cov,
            is_over_ground=over_ground,
            motion=MOTIONS[motion],
            ttc_s=t_s,
            ttc_sigma_s=t_sigma_s,
        )
        for number, age_s, coasted_s, place, place_cov, v, v_cov, motion, t_s, t_sigma_s in zip(
            bank.id[rows].tolist(),
            ((t_ns - bank.born_ns[rows]) / 1e9).tolist(),
            ((t_ns - bank.seen_ns[rows]) / 1e9).tolist(),
            x[:, :3],
            places,
            x[:, 3:],
            P[:, 3:, 3:],
            np.where(moves, MOVING, np.where(stands, STANDING, UNKNOWN)).tolist(),
            ttc_s.tolist(),
            sigma_s.tolist(),
            strict=True,
        )
    ]


def moved_obstacle(bank: Bank, row: int, optics: Optics, track: Track) -> Obstacle:
    """Return the latest measurement of a track, moved on to where it should be now, with what is known of it."""
    last: Obstacle = bank.last[row]
    (uvd,), _, (S,) = optics.see(bank.x[row : row + 1], bank.P[row : row + 1])
    P = bank.P[row, :3, :3]
    n = optics.ahead[:3]
    scale = uvd[2] / last.uvd_px[2]

    def shifted(points: FloatArray) -> FloatArray:
        return np.asarray(np.rint((points - last.uvd_px[:2]) * scale + uvd[:2]))

    u0, v0, u1, v1 = shifted(bank.boxes[row].reshape(2, 2)).ravel().astype(int).tolist()
    return last.recognized(
        position_m=bank.x[row, :3] + bank.foot_m[row],
        range_m=optics.fb / float(uvd[2]),
        range_sigma_m=float(np.sqrt(n @ P @ n)),
        uvd_px=uvd,
        cov_uvd_px2=S,
        cov_match_m2=P,
        box_px=(u0, v0, max(u1, u0 + 1), max(v1, v0 + 1)),
        contour_px=shifted(last.contour_px.astype(float)).astype(np.int32),
        track=track,
    )
