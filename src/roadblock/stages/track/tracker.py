"""The tracker: obstacles of a frame in, the same obstacles with their tracks out; remembers the drive."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, rotvec_from_rotation, skew, vehicle_from_car
from roadblock.stages.track.associate import LOOKS, assign, covered, distances
from roadblock.stages.track.bank import Bank
from roadblock.stages.track.describe import WELL_KNOWN, describe, deviation, moved_obstacle
from roadblock.stages.track.flow import velocities
from roadblock.stages.track.kalman import Optics, begin, correct, correct_velocity, predict
from roadblock.stages.track.settings import TrackSettings
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion, Flow, Track
from roadblock.values.scene import FreeSpace, Obstacle

Indices = NDArray[np.intp]

SPEED_MPS = 8.0
"""Standard deviation of the velocity of something just born."""
CONFIRMED, GIVEN_UP = 2, 2
"""Measured so often, an obstacle has a track; missed so often before, it never was there: two of three."""
SIDE_SHARE, ROW_SHARE = 0.05, 0.15
"""Share of a box's width, and of its height, by which its measured point wanders as its outline changes."""
DEPTH_M = 0.1
"""By which the nearest face wanders."""
TIMIDITY, MEDIAN_OF_1 = 0.5, 0.455
"""How fast the noise is learnt, and the median of a squared normal number."""
NOISE_LIMITS = (-1.4, 2.2)
"""Log of the factors (0.25 to 9) within which the variance of the noise is learnt."""
TRUSTED_S = 0.4
"""Tracks of this age tell how noisy measurements are."""
SAME_SHARE = 0.5
"""Boxes of which so much is shared are pieces of each other."""
LOOKS_SHARE, PIECE_SHARE = 0.3, 0.05
"""How fast a track learns what it looks like, from all of it and from pieces."""
SLIP_M = 1.5
"""They may be so far apart: the near end of a wall goes with the vehicle that looks at it."""
ALIKE_M, ALIKE_SHARE = 2.0, 0.15
"""What covers a track may be so far before or behind it to be taken for the whole of which it is a part."""
SMALLEST_M = 0.05
LEAST_HALF_PX = 4.0
CLEAR_M = 1.0
"""Free road must be seen this far behind an obstacle to contradict it."""
EGO_KNOWN_S = 1.0
"""So long the vehicle's motion is taken to go on."""
EGO_MPS2, EGO_RADPS2 = 3.0, 0.3
"""By about how much it changes meanwhile."""
RELATIVE_NOISE, STILL_NOISE = 4.0, 0.2
"""Velocities relative to the vehicle change so much faster, and those of what does not move for sure so much slower."""
MOVING = 9.2
"""99 % of a squared distance from standing still."""


class _Seen(NamedTuple):
    """The obstacles of a frame, in arrays of m rows: u, v, d; their covariance as learnt; boxes; log of the size."""

    obstacles: Sequence[Obstacle]
    uvd: FloatArray
    noise_px2: FloatArray
    boxes: FloatArray
    looks: FloatArray


class _Expected(NamedTuple):
    """Where tracks should be seen, in arrays of n rows: u, v, d; derivatives by the place; the tracks' covariance."""

    uvd: FloatArray
    J: FloatArray
    S: FloatArray


class Tracker:
    """Follows obstacles through a drive; one rig, one tracker.

    Parameters
    ----------
    rectification
        The twin cameras.
    T_vehicle_car
        The rig's mounting, or None.
    settings
        What counts as evidence.
    """

    def __init__(
        self,
        rectification: Rectification,
        T_vehicle_car: FloatArray | None = None,
        settings: TrackSettings | None = None,
    ) -> None:
        self.settings = settings or TrackSettings()
        self.optics = Optics(rectification, vehicle_from_car(T_vehicle_car))
        self._fb = rectification.f_px * rectification.baseline_m
        self._ids = 0
        self._log_noise = np.zeros(3)
        self._restart(0)
        assign(np.zeros((1, 1)), np.zeros((1, 1)), 0.0)  # so that no frame waits for a library

    def _restart(self, t_ns: int) -> None:
        self._begun, self._t_ns = False, t_ns
        self._bank = Bank.born(np.zeros((0, 5)), np.zeros((0, 5, 5)), 0, [], np.zeros((0, 2)))
        self._twist, self._twist_cov, self._twist_t_ns = np.zeros(6), np.zeros((6, 6)), 0
        self._over_ground = False

    def update(
        self, obstacles: Sequence[Obstacle], t_ns: int, ego: EgoMotion | None, free_space: FreeSpace | None = None
    ) -> tuple[Obstacle, ...]:
        """Take the obstacles of the next frame in.

        Parameters
        ----------
        obstacles
            As measured.
        t_ns
            When. A frame of the same moment or of an earlier one (duplicated, out of order) changes nothing: its
            obstacles are only recognised. One that is much earlier or later begins a new drive.
        ego
            How the vehicle moved since the frame before; None or unknown: as it did before, for a second.
        free_space
            Of the same frame: free road contradicts what should stand on it.

        Returns
        -------
        The same obstacles, with tracks where they have one; and those not measured now that must still be there.
        """
        if abs(t_ns - self._t_ns) > 1e9 * self.settings.longest_gap_s:
            self._restart(t_ns)
        dt_s = (t_ns - self._t_ns) / 1e9
        seen = self._seen(obstacles)
        if self._begun and dt_s <= 0:
            return self._recognized(seen, dt_s)
        if self._begun:
            self._predict(dt_s, t_ns, ego)
        self._begun, self._t_ns = True, t_ns
        expected = self._expected(self._bank)
        rows, columns, noise_px2 = self._matched(seen, expected)
        self._correct(rows, columns, noise_px2, seen, expected)
        if ego is not None and ego.flow is not None and self._over_ground:
            self._feel(rows, ego.flow, dt_s)
        merged = self._merged(rows, seen, expected)
        shown = self._forget(rows, merged, dt_s, free_space)
        self._bear(columns, seen)  # behind those that are left
        return self._reported(seen, np.concatenate([shown, np.ones(len(self._bank) - len(shown), bool)]))

    def _seen(self, obstacles: Sequence[Obstacle]) -> _Seen:
        m = len(obstacles)
        uvd = np.array([o.uvd_px for o in obstacles]).reshape(m, 3)
        boxes = np.array([o.box_px for o in obstacles], float).reshape(m, 4)
        noise_px2 = np.array([o.cov_uvd_px2 for o in obstacles]).reshape(m, 3, 3)
        noise_px2[:, 0, 0] += (SIDE_SHARE * (boxes[:, 2] - boxes[:, 0])) ** 2
        noise_px2[:, 1, 1] += (ROW_SHARE * (boxes[:, 3] - boxes[:, 1])) ** 2
        noise_px2[:, 2, 2] += (DEPTH_M * uvd[:, 2] ** 2 / self._fb) ** 2
        factor = np.exp(self._log_noise / 2)
        size_m = np.array([o.size_m for o in obstacles]).reshape(m, 3)[:, :2]
        return _Seen(
            obstacles, uvd, noise_px2 * factor * factor[:, None], boxes, np.log(np.maximum(size_m, SMALLEST_M))
        )

    def _expected(self, bank: Bank) -> _Expected:
        uvd, J = self.optics.see(bank.x[:, :3])
        return _Expected(uvd, J, _projected(J, bank.P))

    def _predict(self, dt_s: float, t_ns: int, ego: EgoMotion | None) -> None:
        """Bring all tracks to the next frame."""
        if ego is not None and ego.T_now_before is not None and (ego.before_t_ns, ego.t_ns) == (self._t_ns, t_ns):
            T, cov = _in_vehicle(ego.T_now_before, ego.cov, self.optics.T_vehicle_car)
            self._twist = np.concatenate([rotvec_from_rotation(T[:3, :3]), T[:3, 3]]) / dt_s
            self._twist_cov, self._twist_t_ns = cov / dt_s**2, t_ns
            self._ground(True)
        else:
            unknown_s = (t_ns - self._twist_t_ns) / 1e9
            if unknown_s > EGO_KNOWN_S:
                self._ground(False)
            T, cov = self._going_on(dt_s, unknown_s)
        x, P = predict(self._bank.x, self._bank.P, dt_s, T, cov, self._noise())
        self._bank = replace(self._bank, x=x, P=P)

    def _noise(self) -> FloatArray:
        """Return (n,) how fast velocities change: what does not move for sure mostly stands."""
        b, noise_m2ps3 = self._bank, self.settings.noise_m2ps3
        if not self._over_ground:
            return np.full(len(b), RELATIVE_NOISE * noise_m2ps3)
        moves = deviation(b.x[:, 3:], b.P[:, 3:, 3:]) > MOVING
        return np.where(moves, noise_m2ps3, STILL_NOISE * noise_m2ps3)

    def _ground(self, over_ground: bool) -> None:
        """Let velocities be over ground, or relative to the vehicle."""
        if over_ground == self._over_ground:
            return
        self._over_ground = over_ground
        still = self._standing_mps(self._bank.x[:, :3])[:, :2]
        x = self._bank.x.copy()
        x[:, 3:] += -still if over_ground else still
        x[self._bank.found == 1, 3:] = 0.0  # nothing but a guess, which stays
        self._bank = replace(self._bank, x=x)

    def _standing_mps(self, places: FloatArray) -> FloatArray:
        """Return (n, 3) how places (n, 3) that stand still move as seen from the vehicle."""
        return np.asarray(np.cross(self._twist[:3], places) + self._twist[3:])

    def _going_on(self, dt_s: float, unknown_s: float) -> tuple[FloatArray, FloatArray]:
        """Return how the vehicle moves in `dt_s` if it goes on as it did `unknown_s` ago, and how sure that is."""
        if not self._over_ground:
            return np.eye(4), np.zeros((6, 6))
        T = pose(rotation_from_rotvec(self._twist[:3] * dt_s), self._twist[3:] * dt_s)
        sigma = np.array([EGO_RADPS2] * 3 + [EGO_MPS2] * 3) * unknown_s * dt_s
        return T, self._twist_cov * dt_s**2 + np.diag(sigma**2)

    def _matched(self, seen: _Seen, expected: _Expected) -> tuple[Indices, Indices, FloatArray]:
        """Return which track (rows) is which obstacle (columns), and the noise (k, 3, 3) of these measurements.

        Tracks choose first, by distance; then, by shared pixels, those that were torn apart, grew together or slipped;
        what is left is for those seen but once.
        """
        free, left = self._bank.id > 0, np.ones(len(seen.uvd), bool)
        new = np.flatnonzero(~free)
        near = self._near(np.flatnonzero(free), np.flatnonzero(left), seen, expected)
        free[near[0]], left[near[1]] = False, False
        self._learn(*near, seen, expected)
        *pieces, grown_px2 = self._pieces(np.flatnonzero(free), np.flatnonzero(left), seen, expected)
        left[pieces[1]] = False
        for share, (i, j) in ((LOOKS_SHARE, near), (PIECE_SHARE, pieces)):
            self._bank.looks[i] += share * (seen.looks[j] - self._bank.looks[i])
        late = self._near(new, np.flatnonzero(left), seen, expected)
        rows, columns = (np.concatenate(part) for part in zip(near, pieces, late, strict=True))
        noise_px2 = seen.noise_px2[columns]
        noise_px2[len(near[0]) : len(near[0]) + len(grown_px2), [0, 1], [0, 1]] += grown_px2
        return rows, columns, noise_px2

    def _near(self, rows: Indices, columns: Indices, seen: _Seen, expected: _Expected) -> tuple[Indices, Indices]:
        """Return which of some tracks is which of some obstacles, by distance."""
        if not len(rows) or not len(columns):
            return rows[:0], columns[:0]
        squared, volume = distances(
            expected.uvd[rows], expected.S[rows], seen.uvd[columns], seen.noise_px2[columns], self.settings.gate
        )
        unlike = ((self._bank.looks[rows, None] - seen.looks[columns]) ** 2).sum(2)
        i, j = assign(squared + LOOKS * unlike, volume, self.settings.gate)
        return rows[i], columns[j]

    def _pieces(
        self, rows: Indices, columns: Indices, seen: _Seen, expected: _Expected
    ) -> tuple[Indices, Indices, FloatArray]:
        """Return which of some tracks is part of which of some obstacles, or the other way round.

        Their distance says much about them, but where in the picture their middle is says little: the last is how much
        larger the variances (k, 2) of u and v are.
        """
        if not len(rows) or not len(columns):
            return rows[:0], columns[:0], np.zeros((0, 2))
        boxes, others = self._boxes(rows, expected), seen.boxes[columns]
        shared = np.maximum(covered(boxes, others), covered(others, boxes).T)
        off_px = seen.uvd[columns, 2] - expected.uvd[rows, None, 2]
        off_m = self._fb / seen.uvd[columns, 2] - self._fb / expected.uvd[rows, None, 2]
        sigma_px2 = expected.S[rows, None, 2, 2] + seen.noise_px2[columns, 2, 2]
        close = (off_px**2 <= self.settings.gate * sigma_px2) | (np.abs(off_m) <= SLIP_M)
        i, j = assign(np.where(close, 1 - shared, np.inf), np.zeros_like(shared), 1 - SAME_SHARE)
        self._slip(rows[i], off_m[i, j])
        expected.S[rows[i]] = _projected(expected.J[rows[i]], self._bank.P[rows[i]])
        return rows[i], columns[j], ((others[j, 2:] - others[j, :2]) / 2) ** 2

    def _slip(self, rows: Indices, off_m: FloatArray) -> None:
        """Let the places of tracks be off by so much, which says nothing about their velocities."""
        P = self._bank.P
        P[rows, :3, 3:] = 0.0
        P[rows, 3:, :3] = 0.0
        P[rows, :3, :3] += np.eye(3) * (off_m**2)[:, None, None]

    def _boxes(self, rows: Indices, expected: _Expected) -> FloatArray:
        """Return (k, 4) where the boxes of some tracks should be now; NaN behind the cameras."""
        last, uvd = self._bank.last[rows], expected.uvd[rows]
        before = np.array([o.uvd_px for o in last]).reshape(-1, 3)
        box = np.array([o.box_px for o in last], float).reshape(-1, 2, 2)
        scale = (uvd[:, 2] / before[:, 2])[:, None, None]
        return np.asarray((box - before[:, None, :2]) * scale + uvd[:, None, :2]).reshape(-1, 4)

    def _learn(self, rows: Indices, columns: Indices, seen: _Seen, expected: _Expected) -> None:
        """Learn how noisy u, v and d are from how often they surprise: half of all must be off by less than expected.

        The detector's own sigmas may be wrong by a factor, and are wrong for all obstacles alike.
        """
        old = self._t_ns - self._bank.born_ns[rows] >= 1e9 * TRUSTED_S
        rows, columns = rows[old], columns[old]
        if len(rows):
            S = (expected.S[rows] + seen.noise_px2[columns])[:, [0, 1, 2], [0, 1, 2]]
            surprises = (seen.uvd[columns] - expected.uvd[rows]) ** 2 > MEDIAN_OF_1 * S
            step = TIMIDITY * (surprises - 0.5).sum(0) / (len(rows) + 2)
            self._log_noise = np.clip(self._log_noise + step, *NOISE_LIMITS)

    def _correct(
        self, rows: Indices, columns: Indices, noise_px2: FloatArray, seen: _Seen, expected: _Expected
    ) -> None:
        """Let tracks know what was measured of them."""
        if not len(rows):
            return
        b = self._bank
        off = seen.uvd[columns] - expected.uvd[rows]
        b.x[rows], b.P[rows] = correct(b.x[rows], b.P[rows], off, expected.J[rows], noise_px2)
        b.found[rows] += 1
        b.missed[rows], b.doubt_s[rows], b.seen_ns[rows] = 0, 0.0, self._t_ns
        for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
            b.last[row] = seen.obstacles[column]
        b.foot_m[rows] = np.array([o.position_m for o in b.last[rows]]) - b.x[rows, :3]
        for row in np.flatnonzero((b.id == 0) & (b.found >= CONFIRMED)):
            self._ids += 1
            b.id[row] = self._ids

    def _feel(self, rows: Indices, flow: Flow, dt_s: float) -> None:
        """Let tracks measured now know the velocity of the features on them."""
        if not len(rows) or not len(flow.uvd_px):
            return
        b = self._bank
        boxes = np.array([o.box_px for o in b.last[rows]], float)
        range_m = np.array([o.range_m for o in b.last[rows]])
        v_mps, cov, known = velocities(flow, dt_s, boxes, range_m, self.optics)
        rows = rows[known]
        ego_cov = self._twist_cov[3:5, 3:5]
        b.x[rows], b.P[rows] = correct_velocity(b.x[rows], b.P[rows], v_mps[known], cov[known] + ego_cov)

    def _merged(self, rows: Indices, seen: _Seen, expected: _Expected) -> NDArray[np.bool_]:
        """Return (n,) which tracks are not measured because they are part of something that is, at their distance."""
        merged, missing = np.zeros(len(self._bank), bool), self._bank.id > 0
        missing[rows] = False
        lost = np.flatnonzero(missing)
        if len(lost) and len(seen.uvd):
            there_m = self._fb / expected.uvd[lost, 2]
            off_m = np.abs(self._fb / seen.uvd[:, 2] - there_m[:, None])
            alike = off_m <= np.maximum(ALIKE_M, ALIKE_SHARE * there_m)[:, None]
            merged[lost] = ((covered(self._boxes(lost, expected), seen.boxes) >= SAME_SHARE) & alike).any(1)
        return merged

    def _forget(
        self, rows: Indices, merged: NDArray[np.bool_], dt_s: float, free_space: FreeSpace | None
    ) -> NDArray[np.bool_]:
        """Count what was not measured, drop what is gone; return which of those left may be shown unseen."""
        b, s = self._bank, self.settings
        missing = np.ones(len(b), bool)
        missing[rows] = False
        if not missing.any():
            return ~merged
        b.missed[missing] += 1
        uvd, _ = self.optics.see(b.x[:, :3])
        inside = ((uvd[:, :2] >= 0) & (uvd[:, :2] < self.optics.rectification.size_px)).all(1)  # not so for NaN
        limit_s = np.where(merged, s.hidden_s, s.forget_s)
        for row in np.flatnonzero(missing & inside & ~merged & (b.id > 0)).tolist():
            off_m, sigma_m = self._free_behind(row, uvd[row], free_space)
            if off_m > CLEAR_M + 3 * sigma_m:
                b.doubt_s[row] += dt_s
            elif off_m < -CLEAR_M:
                limit_s[row] = s.hidden_s
        unseen_s = (self._t_ns - b.seen_ns) / 1e9
        gone = missing & (~inside | (unseen_s > limit_s) | (b.doubt_s > s.contradicted_s))
        gone |= (b.id == 0) & (b.missed >= GIVEN_UP)
        self._bank = b.chosen(~gone)
        return ~merged[~gone]

    def _free_behind(self, row: int, uvd: FloatArray, free_space: FreeSpace | None) -> tuple[float, float]:
        """Return how far behind a track the road is seen to be free (< 0: it ends before), and the track's sigma, m.

        NaN where nothing was seen.
        """
        n = self.optics.T_car_vehicle[2, :3]
        sigma_m = float(np.sqrt(n @ self._bank.P[row, :3, :3] @ n))
        if free_space is None:
            return float("nan"), sigma_m
        half_px = np.exp(self._bank.looks[row, 0]) * uvd[2] / self.optics.rectification.baseline_m / 4
        ranges = free_space.range_m[np.abs(free_space.u_px - uvd[0]) <= max(half_px, LEAST_HALF_PX)]
        ranges = ranges[np.isfinite(ranges)]
        return float(np.median(ranges) - self._fb / uvd[2]) if len(ranges) else float("nan"), sigma_m

    def _bear(self, columns: Indices, seen: _Seen) -> None:
        """Begin a track of everything that belongs to none."""
        left = np.ones(len(seen.uvd), bool)
        left[columns] = False
        new = np.flatnonzero(left)
        if len(new):
            place, cov_m2 = self.optics.place(seen.uvd[new], seen.noise_px2[new])
            x, P = begin(place, cov_m2, SPEED_MPS)
            born = Bank.born(x, P, self._t_ns, [seen.obstacles[j] for j in new.tolist()], seen.looks[new])
            self._bank = self._bank.joined(born)

    def _reported(self, seen: _Seen, shown: NDArray[np.bool_]) -> tuple[Obstacle, ...]:
        """Return all obstacles of this frame with their tracks, and those that coast if they may be shown."""
        b = self._bank
        coasted_s = (self._t_ns - b.seen_ns) / 1e9
        coasts = shown & (coasted_s <= self.settings.coast_s) & (b.doubt_s == 0) & (b.found >= WELL_KNOWN)
        rows = np.flatnonzero((b.id > 0) & ((coasted_s == 0) | coasts))
        tracks = self._described(b, rows)
        own = {id(b.last[row]): track for row, track in zip(rows.tolist(), tracks, strict=True)}
        measured = [o.with_track(own[id(o)]) if id(o) in own else o for o in seen.obstacles]
        coasting = [
            moved_obstacle(b, row, self.optics).with_track(track)
            for row, track in zip(rows.tolist(), tracks, strict=True)
            if track.coasted_s > 0
        ]
        return (*measured, *coasting)

    def _recognized(self, seen: _Seen, dt_s: float) -> tuple[Obstacle, ...]:
        """Return obstacles of an earlier moment, or of the same again, with their tracks; remember nothing."""
        b = self._bank
        T, cov = self._going_on(dt_s, abs(dt_s))
        x, P = predict(b.x, b.P, dt_s, T, cov, self._noise())
        then = replace(b, x=x, P=P)
        rows, columns = self._near(np.flatnonzero(b.id), np.arange(len(seen.uvd)), seen, self._expected(then))
        own = dict(zip(columns.tolist(), self._described(then, rows), strict=True))
        return tuple(o.with_track(own[j]) if j in own else o for j, o in enumerate(seen.obstacles))

    def _described(self, bank: Bank, rows: Indices) -> list[Track]:
        standing_mps = self._standing_mps(bank.x[rows, :3])
        return describe(bank, rows, self._t_ns, self.optics, standing_mps, self._over_ground, self._twist_cov)


def _projected(J: FloatArray, P: FloatArray) -> FloatArray:
    """Return (n, 3, 3) the covariance of u, v, d that is the tracks' own."""
    return np.asarray(J @ P[:, :3, :3] @ J.swapaxes(1, 2))


def _in_vehicle(T: FloatArray, cov: FloatArray, A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a motion of the car frame, and its covariance, as one of the vehicle frame; `A` is `T_vehicle_car`."""
    R = A[:3, :3]
    adjoint = np.zeros((6, 6))
    adjoint[:3, :3] = adjoint[3:, 3:] = R
    adjoint[3:, :3] = skew(A[:3, 3]) @ R
    return A @ T @ inverse(A), adjoint @ cov @ adjoint.T
