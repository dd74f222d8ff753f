"""Kalman filters of many obstacles at once, readably: predict, expect, compare, correct.

A state is (x, y, z, vx, vy): place of what (u, v, d) measures, and velocity along the ground, in the vehicle frame;
what stands on the road stays at its height, but for a slow drift. All arrays are float64 and hold one row an obstacle;
`twin` is (f, cx, cy, baseline) of the rectified cameras, px and m, and `T_car_vehicle` (4, 4) where they are. `rows`
and `columns` say which tracks, and which measurements, are meant.
"""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Indices = NDArray[np.intp]

SIZE = 5
MOVING = 9.2
"""99 % of a squared distance of two numbers: what is further from standing still moves, or contradicts."""
RISE_M2PS = 0.02
"""Variance a second of the height of what is measured: another part of it shows, the road bends."""
SIDE_SHARE, ROW_SHARE = 0.05, 0.15
"""Share of a box's width, and of its height, by which its measured point wanders as its outline changes."""
DEPTH_M = 0.1
"""By which the nearest face wanders."""
LOOKS, EDGE_PX = 10.0, 3.0
"""What a box of e times the width, or of e times the height, costs: as three sigmas; less so for small boxes, each end
of which is off by the second."""
FAR = 1e6
"""Cost of what cannot be."""
BEFORE_M, BEHIND_M, BEHIND_SHARE = 0.7, 3.0, 0.1
"""A feature inside a box belongs to the obstacle if it is no nearer than its nearest face by the first, nor further by
the second, this share of the range, or the obstacle's length."""
UPRIGHT, ABOVE_FOOT = 1.5, 2 / 3
"""What is so many times as high as wide may walk. Only this upper part of it counts: the foot that carries stands. And
only how far that goes aside: arms and legs go up and down."""
CAUCHY, ROUNDS = 3.0, 4
"""Residuals of this many sigmas count half; so often they are weighed."""
LEAST, LEAST_SHARE = 2.0, 0.5
"""Features, as they count, that say a velocity, and how many of those on the obstacle."""
FAST_MPS, FAST_SHARE = 10.0, 0.8
"""What they say to be faster than this, so many must say: features of what is behind a thing stick to its edge."""
FLOOR_MPS, STEP_PX = 0.05, 0.03
"""Standard deviation that no number of features goes below: of the velocity, and of a step's change in disparity."""
BIAS_PX = 0.2
"""Error of a disparity that all frames share: matchers prefer whole pixels, and no filter averages that away."""
CONTRADICTED = 2
"""So often in a row, features must contradict a velocity to be believed."""
SURPRISING, CALMEST = 4.6, 0.1
"""90 % of a squared distance of two numbers; and how much less a velocity changes of which nothing is surprising."""
CLOSING_MPS, CLOSING_SIGMAS = 0.3, 2.0
"""What comes closer no faster than this has no time to collision."""
TIMIDITY, MEDIAN_OF_1 = 0.5, 0.455
"""How fast the noise is learnt, and the median of a squared normal number."""
NOISE_LIMITS = (-1.4, 2.2)
"""Log of the factors (0.25 to 9) within which the variance of the noise is learnt."""
TINY = 1e-12


def carry(T: Floats, cov: Floats, T_vehicle_car: Floats, dt_s: float) -> tuple[Floats, Floats, Floats]:
    """Return a motion of the car frame as one of the vehicle frame.

    Parameters
    ----------
    T, cov
        (4, 4) `T_now_before` and (6, 6) its covariance, as in `EgoMotion`.
    dt_s
        How long it took.

    Returns
    -------
    (4, 4) and (6, 6) the same of the vehicle frame; (6,) how that turns and moves, rad/s and m/s.
    """
    R, t = T_vehicle_car[:3, :3], T_vehicle_car[:3, 3]
    there = T_vehicle_car @ T @ np.linalg.inv(T_vehicle_car)
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[3:, :3] = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]]) @ R
    turn = np.array([there[2, 1] - there[1, 2], there[0, 2] - there[2, 0], there[1, 0] - there[0, 1]]) / 2
    sine = np.linalg.norm(turn)
    angle = np.arctan2(sine, (np.trace(there[:3, :3]) - 1) / 2)
    twist = np.concatenate([turn * (angle / sine if sine > TINY else 1.0), there[:3, 3]]) / dt_s
    return there, adjoint @ cov @ adjoint.T, twist


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
    """Return states and covariances after `dt_s`, seen from where the vehicle is then.

    Parameters
    ----------
    x, P, calm
        (n, 5), (n, 5, 5), and (n,) factors on the noise.
    dt_s
        Seconds; negative goes back in time.
    T_now_before, ego_cov
        (4, 4) how the vehicle moved meanwhile, vehicle frame, and (6, 6) its covariance, as in `EgoMotion`.
    noise_m2ps3, still_m2ps3
        Density of the white noise that is the acceleration, of what moves for sure and of all else.
    """
    moves = deviation(x[:, 3:], P[:, 3:, 3:]) > MOVING
    R = T_now_before[:3, :3]
    F = np.zeros((SIZE, SIZE))
    F[:3, :3], F[:3, 3:], F[3:, 3:] = R, R[:, :2] * dt_s, R[:2, :2]
    x = x @ F.T
    x[:, :3] += T_now_before[:3, 3]
    t = abs(dt_s)
    unit = np.diag([t**3 / 3, t**3 / 3, 0.0, t, t])
    unit[[0, 1, 3, 4], [3, 4, 0, 1]] = t**2 / 2 * np.sign(dt_s)
    Q = (calm * np.where(moves, noise_m2ps3, still_m2ps3))[:, None, None] * unit
    Q[:, 2, 2] = RISE_M2PS * t
    G = np.zeros((len(x), SIZE, 6))
    G[:, :3, 3:] = np.eye(3)
    px, py, pz, vx, vy = x.T
    G[:, 0, 1], G[:, 0, 2], G[:, 1, 0], G[:, 1, 2], G[:, 2, 0], G[:, 2, 1] = pz, -py, -pz, px, py, -px
    G[:, 3, 2], G[:, 4, 2] = -vy, vx
    return x, F @ P @ F.T + Q + G @ ego_cov @ G.swapaxes(1, 2)


def expect(x: Floats, P: Floats, twin: Floats, T_car_vehicle: Floats) -> tuple[Floats, Floats, Floats]:
    """Return (n, 3) u, v, d of tracks, (n, 3, 3) derivatives by the place, and covariance; NaN behind the cameras."""
    f, cx, cy, baseline_m = twin
    R = T_car_vehicle[:3, :3]
    car = x[:, :3] @ R.T + T_car_vehicle[:3, 3]
    cx_m, y, z = car[:, 0] + baseline_m / 2, car[:, 1], np.where(car[:, 2] > 0, car[:, 2], np.nan)
    scale = f / z
    J = np.zeros((len(x), 3, 3))
    J[:, 0, 0] = J[:, 1, 1] = scale
    J[:, 0, 2], J[:, 1, 2], J[:, 2, 2] = -cx_m * scale / z, -y * scale / z, -baseline_m * scale / z
    J[np.isnan(z)] = np.nan
    J = J @ R
    return np.stack([cx_m * scale + cx, y * scale + cy, baseline_m * scale], -1), J, J @ P[:, :3, :3] @ J.swapaxes(1, 2)


def roughen(cov_px2: Floats, uvd: Floats, boxes: Floats, log_noise: Floats, twin: Floats) -> Floats:
    """Return (m, 3, 3) covariances of measurements with all that their outline does to them.

    Parameters
    ----------
    cov_px2, uvd, boxes
        (m, 3, 3) as the detector says; (m, 3) u, v, d; (m, 4) boxes u0, v0, u1, v1.
    log_noise
        (3,) logarithms by which the variances of u, v and d are larger than they are thought to be.
    """
    noise = cov_px2.copy()
    noise[:, 0, 0] += (SIDE_SHARE * (boxes[:, 2] - boxes[:, 0])) ** 2
    noise[:, 1, 1] += (ROW_SHARE * (boxes[:, 3] - boxes[:, 1])) ** 2
    noise[:, 2, 2] += (DEPTH_M * uvd[:, 2] ** 2 / (twin[0] * twin[3])) ** 2
    factor = np.exp(log_noise / 2)
    return np.asarray(noise * factor * factor[:, None])


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
    """Return (k, l) what it costs to take each measurement for each track; `FAR` where it cannot be.

    The costs are log-likelihoods: a track that knows little would take everything near, if the volume that it may be in
    did not count.

    Parameters
    ----------
    rows, columns
        (k,) and (l,).
    expected, S, looks
        (n, 3) u, v, d of the tracks, (n, 3, 3) their covariance without that of the measurement, (n, 2) log of their
        widths and heights.
    measured, noise_px2, sizes
        (m, 3), (m, 3, 3) and (m, 2) the same of the measurements.
    boxes
        (m, 4) u0, v0, u1, v1.
    gate
        Squared distance, that of the looks with it, beyond which nothing fits.
    """
    off = measured[columns] - expected[rows, None]
    both = S[rows, None] + noise_px2[columns]
    sides_px = np.maximum(boxes[columns, 2:] - boxes[columns, :2], 1.0)
    blur = 1 + LOOKS * 2 * EDGE_PX**2 / sides_px**2
    unlike = ((looks[rows, None] - sizes[columns]) ** 2 / blur).sum(2)
    with np.errstate(invalid="ignore"):
        squared = np.einsum("nmi,nmi->nm", off, np.linalg.solve(both, off[..., None])[..., 0]) + LOOKS * unlike
        return np.where(squared <= gate, squared + np.log(np.linalg.det(both) * blur.prod(1)), FAR)


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
    """Change states and covariances by what was measured of them.

    Parameters
    ----------
    rows, columns
        (k,) which track is which measurement.
    x, P
        (n, 5) and (n, 5, 5), changed.
    expected, J
        (n, 3) u, v, d; (n, 3, 3) their derivatives by the place.
    measured, noise_px2
        (m, 3) u, v, d and (m, 3, 3) their covariance.
    grown_px2
        (k, 3) by how much more u, v and d may be off.
    """
    J, noise_px2 = J[rows], noise_px2[columns]
    noise_px2[:, [0, 1, 2], [0, 1, 2]] += grown_px2
    PH = P[rows, :, :3] @ J.swapaxes(1, 2)
    K = np.linalg.solve(J @ PH[:, :3] + noise_px2, PH.swapaxes(1, 2)).swapaxes(1, 2)
    x[rows] += (K @ (measured[columns] - expected[rows])[..., None])[..., 0]
    less = P[rows] - K @ PH.swapaxes(1, 2)
    P[rows] = (less + less.swapaxes(1, 2)) / 2


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
    """Return what features say about the velocities over ground of obstacles, by robust least squares.

    An outline that comes and goes cannot fake these. A feature is linearised halfway between where it is and where it
    would be if it stood: over a whole step, disparities are far from linear.

    Parameters
    ----------
    rows
        (n,) of which.
    uvd, off_px, information_px2
        (k, 3), (k, 3) and (k, 3, 3) of the features, as in `values.motion.Flow`.
    dt_s
        Time between both frames.
    boxes, range_m, long_m
        Rows of 4, numbers and numbers: where the obstacles are, and how long.

    Returns
    -------
    (n, 2) along the vehicle's x and y, m/s; (n, 2, 2) covariance; (n,) how many features say so, 0 if they are too few.
    """
    f, cx, cy, baseline_m = twin
    boxes, range_m, long_m = boxes[rows], range_m[rows], long_m[rows]
    u, v, d = uvd.T
    half = uvd - off_px / 2
    z = f * baseline_m / d
    wide, high = (boxes[:, 2:] - boxes[:, :2]).T
    is_upright = high > UPRIGHT * wide
    low = (boxes[:, 1] + np.where(is_upright, ABOVE_FOOT, 1.0) * high)[:, None]
    inside = (u >= boxes[:, :1]) & (u < boxes[:, 2:3]) & (v >= boxes[:, 1:2]) & (v < low)
    behind_m = np.maximum(np.maximum(BEHIND_M, BEHIND_SHARE * range_m), long_m)[:, None]
    inside &= (d > 0) & (half[:, 2] > 0) & (z > range_m[:, None] - BEFORE_M) & (z < range_m[:, None] + behind_m)
    used = inside.any(0)
    n, inside, half = len(boxes), inside[:, used], half[used]
    # Derivatives of (u, v, d) by the place, then each feature's part of the normal equations for two numbers.
    by_place = np.zeros((len(half), 3, 3))
    per_m = half[:, 2] / baseline_m
    by_place[:, 0, 0] = by_place[:, 1, 1] = per_m
    by_place[:, 0, 2], by_place[:, 1, 2] = (-(half[:, i] - c) * per_m / f for i, c in ((0, cx), (1, cy)))
    by_place[:, 2, 2] = -half[:, 2] * per_m / f
    J = dt_s * by_place @ T_car_vehicle[:3, :2]
    W, off = information_px2[used], off_px[used]
    aside = W - W[:, :, 1:2] * W[:, 1:2] / W[:, 1:2, 1:2]  # what is left of it if how far it went up is not known
    W = np.stack([W, aside])
    JW = J.swapaxes(1, 2) @ W
    parts = (JW @ J).reshape(2, -1, 4), (JW @ off[..., None])[..., 0], np.einsum("ki,pkij,kj->pk", off, W, off)
    A, b, c = (part[is_upright.astype(int)] for part in parts)
    trust = inside.astype(float)
    for _ in range(ROUNDS):
        normal = np.einsum("nk,nki->ni", trust, A).reshape(n, 2, 2) + 1e-6 * np.eye(2)
        v_mps = np.linalg.solve(normal, np.einsum("nk,nki->ni", trust, b)[..., None])[..., 0]
        squared = c - 2 * np.einsum("ni,nki->nk", v_mps, b)
        squared += np.einsum("ni,nki->nk", (v_mps[:, :, None] * v_mps[:, None, :]).reshape(n, 4), A)
        trust = inside / (1 + np.maximum(squared, 0) / CAUCHY**2)
    counted = trust.sum(1)
    ahead_mps = (STEP_PX / dt_s * range_m**2 / (f * baseline_m))[:, None] * T_car_vehicle[2, :2]
    cov = np.linalg.inv(normal) + FLOOR_MPS**2 * np.eye(2) + ahead_mps[:, :, None] * ahead_mps[:, None, :]
    share = np.where(np.hypot(*v_mps.T) > FAST_MPS, FAST_SHARE, LEAST_SHARE)
    enough = (counted >= LEAST) & (counted >= share * inside.sum(1))
    return v_mps, cov, np.where(enough, counted, 0.0)


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
    """Change states and covariances by velocities that were measured.

    Where a measured velocity contradicts that of the place twice in a row, the place has wandered along something (the
    near end of a wall goes with the vehicle that looks at it): the measured one is taken for both. Once, it may be that
    of something behind.

    Parameters
    ----------
    rows
        (k,) of which.
    x, P, against, calm
        (n, 5), (n, 5, 5), (n,) how many contradictions in a row there were, and (n,) factors on the noise of
        `predict`: smaller with each velocity that was expected, 1 with one that was not; changed.
    v_mps, cov_m2ps2, known
        (k, 2), (k, 2, 2), and (k,) whether it was measured.
    calmer
        By how much smaller.
    """
    rows, v_mps, cov_m2ps2 = rows[known], v_mps[known], cov_m2ps2[known]
    then, cov = x[rows], P[rows]
    off = v_mps - then[:, 3:]
    S = cov[:, 3:, 3:] + cov_m2ps2
    squared = np.einsum("ni,ni->n", off, np.linalg.solve(S, off[..., None])[..., 0])
    K = np.linalg.solve(S, cov[:, 3:, :]).swapaxes(1, 2)
    better, less = then + (K @ off[..., None])[..., 0], cov - K @ cov[:, 3:, :]
    less = (less + less.swapaxes(1, 2)) / 2
    against[rows] = np.where(squared > MOVING, against[rows] + 1, 0)
    calm[rows] = np.where(squared > SURPRISING, 1.0, np.maximum(calm[rows] * calmer, CALMEST))
    wrong, doubtful = against[rows] >= CONTRADICTED, against[rows] == 1
    better[wrong] = then[wrong]
    better[wrong, 3:] = v_mps[wrong]
    less[wrong] = cov[wrong]
    less[wrong, :3, 3:] = less[wrong, 3:, :3] = 0.0
    less[wrong, 3:, 3:] = cov_m2ps2[wrong]
    x[rows], P[rows] = np.where(doubtful[:, None], then, better), np.where(doubtful[:, None, None], cov, less)


def approach(
    x: Floats, P: Floats, ahead: Floats, eye: Floats, fb: float, twist: Floats, twist_cov: Floats
) -> tuple[Floats, Floats, Floats, Floats]:
    """Return when tracks will be level with the cameras, the sigma of that, and how far they are from standing still.

    Parameters
    ----------
    x, P
        (n, 5) and (n, 5, 5).
    ahead
        (4,) the cameras' forward axis in the vehicle frame, and how far before the origin of that the cameras' is.
    eye, fb
        (3,) where the left camera is in the vehicle frame; focal length times baseline, px m.
    twist, twist_cov
        (6,) how what stands still turns and moves as seen from the vehicle, rad/s and m/s, and (6, 6) its covariance;
        zeros where velocities are relative to the vehicle.

    Returns
    -------
    (n,) and (n,) seconds, NaN where they do not come closer for sure; (n,) squared Mahalanobis distances of their
    velocities from 0; (n, 3, 3) covariance of their places, with what all frames share.
    """
    n = ahead[:3]
    z_m = x[:, :3] @ n + ahead[3]
    closing_mps = -(x[:, 3:] @ n[:2]) - (np.cross(twist[:3], x[:, :3]) + twist[3:]) @ n
    closing_var = np.einsum("i,nij,j->n", n[:2], P[:, 3:, 3:], n[:2]) + n @ twist_cov[3:, 3:] @ n
    # An error of the disparity moves a point along its line of sight.
    sight = (x[:, :3] - eye) * (BIAS_PX * z_m / fb)[:, None]
    places = P[:, :3, :3] + sight[:, :, None] * sight[:, None, :]
    z_var = np.einsum("i,nij,j->n", n, places, n)
    both = np.einsum("i,nij,j->n", n, P[:, :3, 3:], n[:2])
    sure = closing_mps > np.maximum(CLOSING_MPS, CLOSING_SIGMAS * np.sqrt(closing_var))
    v = np.where(sure, closing_mps, np.nan)
    ttc_s = z_m / v
    sigma_s = np.sqrt(np.maximum(z_var + ttc_s**2 * closing_var + 2 * ttc_s * both, 0)) / v
    return ttc_s, sigma_s, deviation(x[:, 3:], P[:, 3:, 3:]), places


def deviation(v: Floats, cov: Floats) -> Floats:
    """Return (n,) squared Mahalanobis distances of (n, 2) from 0 by covariances (n, 2, 2)."""
    a, b, c = cov[:, 0, 0], cov[:, 0, 1], cov[:, 1, 1]
    x, y = v.T
    return np.asarray((c * x * x - 2 * b * x * y + a * y * y) / np.maximum(a * c - b * b, TINY))


def learn(
    rows: Indices,
    columns: Indices,
    log_noise: Floats,
    expected: Floats,
    S: Floats,
    measured: Floats,
    noise_px2: Floats,
) -> Floats:
    """Return (3,) how noisy u, v and d are, from how often they surprise: half must be off by less than expected.

    The detector's own sigmas may be wrong by a factor, and are wrong for all obstacles alike.

    Parameters
    ----------
    rows, columns
        (k,) which track is which measurement.
    log_noise
        (3,) as it was thought to be, see `roughen`.
    expected, S, measured, noise_px2
        As in `compare`.
    """
    squared = (measured[columns] - expected[rows]) ** 2
    variance = (S[rows] + noise_px2[columns])[:, [0, 1, 2], [0, 1, 2]]
    step = TIMIDITY * ((squared > MEDIAN_OF_1 * variance) - 0.5).sum(0) / (len(rows) + 2)
    return np.asarray(np.clip(log_noise + step, *NOISE_LIMITS))


def clearance(
    u_px: Floats, half_px: Floats, wide_px: Floats, column_px: Floats, free_m: Floats
) -> tuple[Floats, Floats]:
    """Return (n,) the median range of free space, m, within `half_px` of each `u_px`, and (n,) the least in `wide_px`.

    Both are NaN where nothing is known.

    Parameters
    ----------
    u_px, half_px, wide_px
        (n,) where to look.
    column_px, free_m
        (k,) the free space; NaN where it is unknown.
    """
    apart_px, known = np.abs(column_px - u_px[:, None]), np.isfinite(free_m)
    own = [free_m[row] for row in (apart_px <= half_px[:, None]) & known]
    near = [free_m[row] for row in (apart_px <= wide_px[:, None]) & known]
    return (
        np.array([np.median(m) if len(m) else np.nan for m in own]),
        np.array([m.min() if len(m) else np.nan for m in near]),
    )
