"""The tracker: obstacles of a frame in, the same obstacles with their tracks out; remembers the drive."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import pose, rotation_from_rotvec, vehicle_from_car
from roadblock.kernels.compiled.track import (
    carry,
    clearance,
    compare,
    correct,
    correct_velocity,
    deviation,
    feel,
    learn,
    predict,
)
from roadblock.kernels.reference.track import FAR, SIZE, TINY
from roadblock.stages.track.associate import assign, covered
from roadblock.stages.track.bank import CONFIRMED, Bank, Seen, see
from roadblock.stages.track.describe import FIXED_BY_NATURE, MOVED_S, SURE, WELL_KNOWN, describe, moved_obstacle
from roadblock.stages.track.optics import Optics
from roadblock.stages.track.settings import TrackSettings
from roadblock.stages.track.traces import Traces
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion, Flow, Track
from roadblock.values.scene import FreeSpace, Obstacle

Indices = NDArray[np.intp]

SPEED_MPS, SIDE_MPS = 8.0, 4.0
"""Standard deviation of the velocity of something just born, along the road and across."""
GIVEN_UP = 2
"""Missed so often before it has a track, it never was there: two of three."""
TRUSTED_S = 0.4
"""Tracks of this age tell how noisy measurements are."""
SAME_SHARE = 0.5
"""Boxes of which so much is shared are pieces of each other."""
LOOKS_SHARE, PIECE_SHARE = 0.3, 0.05
"""How fast a track learns what it looks like, from all of it and from pieces."""
SLIP_M, SLIP_S = 1.5, 1.0
"""They may be so far apart: the near end of a wall goes with the vehicle that looks at it. Or they have gone there
within this time: the velocity is so much less sure."""
RETURN_S, RETURN_M = 0.25, 1.0
"""What was unseen for so long comes out from behind something: in part, joined to it, its distance may be off."""
CUT_PX = 8
"""A box that ends so near to the picture's side is cut by it: what shows of it is another part in each frame."""
ALIKE_M, ALIKE_SHARE = 2.0, 0.15
"""What covers a track may be so far before or behind it to be taken for the whole of which it is a part."""
LEAST_HALF_PX = 4.0
CLEAR_M = 1.0
"""Free road must be seen this far behind an obstacle to contradict it."""
EGO_KNOWN_S = 1.0
"""So long the vehicle's motion is taken to go on."""
EGO_MPS2, EGO_RADPS2 = 3.0, 0.3
"""By about how much it changes meanwhile."""
MANY = 8.0
"""What so many features say to move is not of a type that stands, whatever it looks like."""
CALM_S = 0.3
"""In this time, features that say what was expected let the noise of a velocity shrink to 1/e."""
RELATIVE_NOISE, STILL_NOISE = 4.0, 0.2
"""Velocities relative to the vehicle change so much faster, and those of what does not move for sure so much slower."""


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
        self._ids = 0
        self._log_noise = np.zeros(3)
        self._restart(0)
        assign(np.zeros((1, 1)))  # so that no frame waits for a library

    def _restart(self, t_ns: int) -> None:
        self._begun, self._t_ns = False, t_ns
        self._bank = Bank.born(
            np.zeros((0, SIZE)), np.zeros((0, SIZE, SIZE)), 0, see([], np.zeros(3), self.optics.twin)
        )
        self._twist, self._twist_cov, self._twist_t_ns = np.zeros(6), np.zeros((6, 6)), 0
        self._over_ground = False
        self._traces = Traces(self.optics.twin)

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
        seen = see(obstacles, self._log_noise, self.optics.twin)
        if self._begun and dt_s <= 0:
            return self._recognized(seen, dt_s)
        if self._begun:
            self._predict(dt_s, t_ns, ego)
        self._begun, self._t_ns = True, t_ns
        expected = self._expected(self._bank)
        rows, columns, grown_px2 = self._matched(seen, expected)
        self._correct(rows, columns, grown_px2, seen, expected)
        self._look_back(free_space)
        if ego is not None and ego.flow is not None and self._over_ground:
            self._feel(rows, ego.flow, dt_s)
        merged = self._merged(rows, seen, expected)
        shown = self._forget(rows, merged, dt_s, free_space)
        self._bear(columns, seen)  # behind those that are left
        if free_space is not None:
            self._traces.keep(self._bank, free_space, t_ns)
        return self._reported(seen, np.concatenate([shown, np.ones(len(self._bank) - len(shown), bool)]))

    def _expected(self, bank: Bank) -> _Expected:
        return _Expected(*self.optics.see(bank.x, bank.P))

    def _predict(self, dt_s: float, t_ns: int, ego: EgoMotion | None) -> None:
        """Bring all tracks to the next frame."""
        if ego is not None and ego.T_now_before is not None and (ego.before_t_ns, ego.t_ns) == (self._t_ns, t_ns):
            self._traces.move(ego.T_now_before)
            T, cov, self._twist = carry(ego.T_now_before, ego.cov, self.optics.T_vehicle_car, dt_s)
            self._twist_cov, self._twist_t_ns = cov / dt_s**2, t_ns
            self._ground(True)
        else:
            self._traces.move(None)
            unknown_s = (t_ns - self._twist_t_ns) / 1e9
            if unknown_s > EGO_KNOWN_S:
                self._ground(False)
            T, cov = self._going_on(dt_s, unknown_s)
        self._bank.x, self._bank.P = self._moved_on(dt_s, T, cov)

    def _moved_on(self, dt_s: float, T: FloatArray, cov: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return all states and covariances after `dt_s`; what does not move for sure mostly stands."""
        noise_m2ps3 = self.settings.noise_m2ps3
        still_m2ps3 = STILL_NOISE * noise_m2ps3
        if not self._over_ground:
            noise_m2ps3 = still_m2ps3 = RELATIVE_NOISE * noise_m2ps3
        return predict(self._bank.x, self._bank.P, self._bank.calm, dt_s, T, cov, noise_m2ps3, still_m2ps3)

    def _ground(self, over_ground: bool) -> None:
        """Let velocities be over ground, or relative to the vehicle."""
        if over_ground == self._over_ground:
            return
        self._over_ground = over_ground
        still = self._standing_mps(self._bank.x[:, :3])[:, :2]
        x = self._bank.x
        x[:, 3:] += -still if over_ground else still
        x[self._bank.found == 1, 3:] = 0.0  # nothing but a guess, which stays

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

    def _matched(self, seen: Seen, expected: _Expected) -> tuple[Indices, Indices, FloatArray]:
        """Return which track (rows) is which obstacle (columns), and how much more (k, 3) u, v and d may be off.

        Tracks choose first, by distance; then, by shared pixels, those that were torn apart, grew together or slipped;
        what is left is for those seen but once.
        """
        looks, is_known, is_left = self._bank.looks, self._bank.id > 0, np.ones(len(seen.uvd), bool)
        known, new = np.flatnonzero(is_known), np.flatnonzero(~is_known)
        rows, columns = self._near(known, np.flatnonzero(is_left), seen, expected)
        grown_px2 = np.zeros((len(rows), 3))
        returned = self._t_ns - self._bank.seen_ns[rows] > 1e9 * RETURN_S
        grown_px2[returned, 2] = (RETURN_M * seen.uvd[columns[returned], 2] ** 2 / self.optics.fb) ** 2
        self._learn(rows, columns, seen, expected)
        looks[rows] += LOOKS_SHARE * (seen.looks[columns] - looks[rows])
        is_known[rows], is_left[columns] = False, False
        if is_left.any():
            parts, wholes, more_px2 = self._pieces(np.flatnonzero(is_known), np.flatnonzero(is_left), seen, expected)
            looks[parts] += PIECE_SHARE * (seen.looks[wholes] - looks[parts])
            is_left[wholes] = False
            late = self._near(new, np.flatnonzero(is_left), seen, expected)
            rows, columns = np.concatenate([rows, parts, late[0]]), np.concatenate([columns, wholes, late[1]])
            grown_px2 = np.concatenate([grown_px2, more_px2, np.zeros((len(late[0]), 3))])
        return rows, columns, grown_px2

    def _near(self, rows: Indices, columns: Indices, seen: Seen, expected: _Expected) -> tuple[Indices, Indices]:
        """Return which of some tracks is which of some obstacles, by distance."""
        if not len(rows) or not len(columns):
            return rows[:0], columns[:0]
        i, j = assign(
            compare(
                rows,
                columns,
                expected.uvd,
                expected.S,
                self._bank.looks,
                seen.uvd,
                seen.noise_px2,
                seen.looks,
                seen.boxes,
                self.settings.gate,
            )
        )
        return rows[i], columns[j]

    def _pieces(
        self, rows: Indices, columns: Indices, seen: Seen, expected: _Expected
    ) -> tuple[Indices, Indices, FloatArray]:
        """Return which of some tracks is part of which of some obstacles, or the other way round.

        Their distance says much about them, but where in the picture their middle is says little: the last is how much
        larger the variances (k, 3) of u, v and d are.
        """
        if not len(rows) or not len(columns):
            return rows[:0], columns[:0], np.zeros((0, 3))
        boxes, others = self._boxes(rows, expected), seen.boxes[columns]
        mine, theirs = covered(boxes, others), covered(others, boxes).T
        # Of two that are inside, who is most of it gets it: intersection over union.
        alike = mine * theirs / np.maximum(mine + theirs - mine * theirs, TINY)
        off_px = seen.uvd[columns, 2] - expected.uvd[rows, None, 2]
        off_m = self.optics.fb / seen.uvd[columns, 2] - self.optics.fb / expected.uvd[rows, None, 2]
        sigma_px2 = expected.S[rows, None, 2, 2] + seen.noise_px2[columns, 2, 2]
        # However unsure it is where something went: a person before a wall that is lost is no piece of it.
        there_m = self.optics.fb / expected.uvd[rows, None, 2]
        close = (off_px**2 <= self.settings.gate * sigma_px2) & (np.abs(off_m) <= _alike_m(there_m))
        close |= np.abs(off_m) <= SLIP_M
        i, j = assign(
            np.where(
                close & (np.maximum(mine, theirs) >= SAME_SHARE), 1 - np.maximum(mine, theirs) + (1 - alike) / 2, FAR
            )
        )
        sides_px = others[j, 2:] - others[j, :2]
        px_per_m = seen.uvd[columns[j], 2] / self.optics.rectification.baseline_m
        self._slip(rows[i], off_m[i, j], sides_px[:, 0] / px_per_m)
        grown_px2 = np.zeros((len(i), 3))
        grown_px2[:, :2] = (sides_px / 2) ** 2
        return rows[i], columns[j], grown_px2

    def _slip(self, rows: Indices, off_m: FloatArray, wide_m: FloatArray) -> None:
        """Let the places of tracks be off by so much ahead, and aside by half of how wide they are at most.

        That says nothing about their velocities but doubt of the one ahead.
        """
        P, ahead = self._bank.P, self.optics.ahead[:3]
        along, side_m = np.outer(ahead, ahead), np.minimum(np.abs(off_m), wide_m / 2)
        P[rows, :3, 3:] = 0.0
        P[rows, 3:, :3] = 0.0
        P[rows, :3, :3] += (off_m**2)[:, None, None] * along + (side_m**2)[:, None, None] * (np.eye(3) - along)
        P[rows, 3:, 3:] += ((off_m / SLIP_S) ** 2)[:, None, None] * along[:2, :2]

    def _boxes(self, rows: Indices, expected: _Expected) -> FloatArray:
        """Return (k, 4) where the boxes of some tracks should be now; NaN behind the cameras."""
        uvd, before = expected.uvd[rows], self._bank.uvd[rows]
        box = self._bank.boxes[rows].reshape(-1, 2, 2)
        scale = (uvd[:, 2] / before[:, 2])[:, None, None]
        return np.asarray((box - before[:, None, :2]) * scale + uvd[:, None, :2]).reshape(-1, 4)

    def _learn(self, rows: Indices, columns: Indices, seen: Seen, expected: _Expected) -> None:
        """Learn how noisy measurements are, from tracks that are known for a while."""
        old = self._t_ns - self._bank.born_ns[rows] >= 1e9 * TRUSTED_S
        self._log_noise = learn(
            rows[old], columns[old], self._log_noise, expected.uvd, expected.S, seen.uvd, seen.noise_px2
        )

    def _correct(self, rows: Indices, columns: Indices, grown_px2: FloatArray, seen: Seen, expected: _Expected) -> None:
        """Let tracks know what was measured of them; the place of what the picture cuts is where it is seen."""
        b = self._bank
        boxes = seen.boxes[columns]
        is_cut = (boxes[:, 0] < CUT_PX) | (boxes[:, 2] > self.optics.rectification.size_px[0] - CUT_PX)
        whole = ~is_cut
        correct(
            rows[whole],
            columns[whole],
            b.x,
            b.P,
            expected.uvd,
            expected.J,
            seen.uvd,
            seen.noise_px2,
            grown_px2[whole],
        )
        if is_cut.any():
            self._replace(rows[is_cut], columns[is_cut], seen)
        b.note(rows, columns, seen, self._t_ns)
        for row in np.flatnonzero((b.id == 0) & (b.found >= CONFIRMED)).tolist():
            self._ids += 1
            b.id[row] = self._ids

    def _replace(self, rows: Indices, columns: Indices, seen: Seen) -> None:
        """Put tracks where they are measured, which says nothing about their velocities."""
        b = self._bank
        b.x[rows, :3], b.P[rows, :3, :3] = self.optics.place(seen.uvd[columns], seen.noise_px2[columns])
        b.P[rows, :3, 3:] = 0.0
        b.P[rows, 3:, :3] = 0.0

    def _look_back(self, free_space: FreeSpace | None) -> None:
        """Let tracks know whether they left where they were; without a road, their outlines are believed."""
        b = self._bank
        if free_space is None:
            b.moved_ns[:] = self._t_ns
            return
        verdict = self._traces.judge(b, free_space, self._t_ns)
        b.moved_ns[verdict.moved] = self._t_ns
        b.slid = np.where(b.seen_ns == self._t_ns, verdict.slid, b.slid) & (self._t_ns - b.moved_ns > 1e9 * MOVED_S)

    def _feel(self, rows: Indices, flow: Flow, dt_s: float) -> None:
        """Let tracks measured now know the velocity of the features on them."""
        if not len(rows) or not len(flow.uvd_px):
            return
        b, o = self._bank, self.optics
        v_mps, cov, count = feel(
            rows,
            flow.uvd_px,
            flow.off_px,
            flow.information_px2,
            dt_s,
            b.boxes,
            b.range_m,
            b.long_m,
            o.twin,
            o.T_car_vehicle,
        )
        cov += self._twist_cov[3:5, 3:5]
        known = count > 0
        correct_velocity(rows, b.x, b.P, b.against, b.calm, v_mps, cov, known, math.exp(-dt_s / CALM_S))
        moves = known & (deviation(v_mps, cov) > SURE)
        felt, sure = rows[moves], rows[moves & (count >= MANY)]
        b.slid[felt], b.moved_ns[felt] = False, self._t_ns
        b.fixed[sure[b.fixed[sure] > FIXED_BY_NATURE]] = 0.0

    def _merged(self, rows: Indices, seen: Seen, expected: _Expected) -> NDArray[np.bool_]:
        """Return (n,) which tracks are not measured because they are part of something that is, at their distance."""
        merged, missing = np.zeros(len(self._bank), bool), self._bank.id > 0
        missing[rows] = False
        lost = np.flatnonzero(missing)
        if len(lost) and len(seen.uvd):
            there_m = self.optics.fb / expected.uvd[lost, 2]
            off_m = np.abs(self.optics.fb / seen.uvd[:, 2] - there_m[:, None])
            alike = off_m <= _alike_m(there_m)[:, None]
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
        b.calm[missing] = 1.0
        uvd, _, S = self.optics.see(b.x, b.P)
        inside = ((uvd[:, :2] >= 0) & (uvd[:, :2] < self.optics.rectification.size_px)).all(1)  # not so for NaN
        limit_s = np.where(merged, s.hidden_s, s.forget_s)
        looked = np.flatnonzero(missing & inside & ~merged & (b.id > 0))
        if free_space is not None and len(looked):
            off_m, least_m, sigma_m = self._free_behind(looked, uvd[looked], S[looked, 0, 0], free_space)
            b.doubt_s[looked[least_m > CLEAR_M + 3 * sigma_m]] += dt_s
            limit_s[looked[off_m < -CLEAR_M]] = s.hidden_s
        unseen_s = (self._t_ns - b.seen_ns) / 1e9
        gone = missing & (~inside | (unseen_s > limit_s) | (b.doubt_s > s.contradicted_s))
        gone |= (b.id == 0) & (b.missed >= GIVEN_UP)
        if not gone.any():
            return ~merged
        self._bank = b.chosen(~gone)
        return ~merged[~gone]

    def _free_behind(
        self, rows: Indices, uvd: FloatArray, u_var_px2: FloatArray, free_space: FreeSpace
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return how far behind some tracks the road is seen to be free (< 0: it ends before), m, and their sigmas.

        First where they should be, then at least anywhere they may be. NaN where nothing was seen.
        """
        n = self.optics.ahead[:3]
        half_px = np.exp(self._bank.looks[rows, 0]) * uvd[:, 2] / self.optics.rectification.baseline_m / 4
        half_px = np.maximum(half_px, LEAST_HALF_PX)
        u_px, wide_px = np.ascontiguousarray(uvd[:, 0]), half_px + 2 * np.sqrt(u_var_px2)
        free_m, least_m = clearance(u_px, half_px, wide_px, free_space.u_px, free_space.range_m)
        at_m = self.optics.fb / uvd[:, 2]
        return free_m - at_m, least_m - at_m, np.sqrt(n @ self._bank.P[rows, :3, :3] @ n)

    def _bear(self, columns: Indices, seen: Seen) -> None:
        """Begin a track of everything that belongs to none."""
        left = np.ones(len(seen.uvd), bool)
        left[columns] = False
        new = np.flatnonzero(left)
        if len(new):
            place, cov_m2 = self.optics.place(seen.uvd[new], seen.noise_px2[new])
            x, P = np.zeros((len(new), SIZE)), np.zeros((len(new), SIZE, SIZE))
            x[:, :3], P[:, :3, :3] = place, cov_m2
            P[:, 3, 3], P[:, 4, 4] = SPEED_MPS**2, SIDE_MPS**2
            self._bank = self._bank.joined(Bank.born(x, P, self._t_ns, seen.chosen(new)))

    def _reported(self, seen: Seen, shown: NDArray[np.bool_]) -> tuple[Obstacle, ...]:
        """Return all obstacles of this frame with their tracks, and those that coast if they may be shown."""
        b = self._bank
        coasted_s = (self._t_ns - b.seen_ns) / 1e9
        coasts = shown & (coasted_s <= self.settings.coast_s) & (b.doubt_s == 0) & (b.found >= WELL_KNOWN)
        rows = np.flatnonzero((b.id > 0) & ((coasted_s == 0) | coasts))
        tracks = self._described(b, rows)
        own = {id(b.last[row]): track for row, track in zip(rows.tolist(), tracks, strict=True)}
        measured = [o.with_track(own[id(o)]) if id(o) in own else o for o in seen.obstacles]
        coasting = [
            moved_obstacle(b, row, self.optics, track)
            for row, track in zip(rows.tolist(), tracks, strict=True)
            if track.coasted_s > 0
        ]
        return (*measured, *coasting)

    def _recognized(self, seen: Seen, dt_s: float) -> tuple[Obstacle, ...]:
        """Return obstacles of an earlier moment, or of the same again, with their tracks; remember nothing."""
        b = self._bank
        T, cov = self._going_on(dt_s, abs(dt_s))
        x, P = self._moved_on(dt_s, T, cov)
        then = replace(b, x=x, P=P)
        rows, columns = self._near(np.flatnonzero(b.id), np.arange(len(seen.uvd)), seen, self._expected(then))
        own = dict(zip(columns.tolist(), self._described(then, rows), strict=True))
        return tuple(o.with_track(own[j]) if j in own else o for j, o in enumerate(seen.obstacles))

    def _described(self, bank: Bank, rows: Indices) -> list[Track]:
        twist = self._twist if self._over_ground else None
        return describe(bank, rows, self._t_ns, self.optics, twist, self._twist_cov)


def _alike_m(there_m: FloatArray) -> FloatArray:
    """Return how far apart along the view pieces of one thing may be that is so far ahead."""
    return np.maximum(ALIKE_M, ALIKE_SHARE * there_m)
