"""The decider: what stands or moves in the car's way, and what to do about it; remembers the last moments."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import inverse, rotvec_from_rotation
from roadblock.stages.decide.hazards import Hazards, Layout
from roadblock.stages.decide.settings import DecideSettings
from roadblock.stages.decide.swerve import Ways, clear_of, clear_of_moving, drivable, ways
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.decision import Decision
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace, Obstacle

CLOSING_MPS = 0.3
"""What comes closer no faster never arrives."""
STANDS_MPS = 0.3
KNOWN_S = 1.0
"""So long the car's own motion is taken to go on."""
KERB_MARGIN_M = 0.1
BESIDE_M, BEHIND_M = 4.0, 3.0
"""Road must be seen free so far behind what is passed; nearer than the first, at the sides, no camera sees it."""
LOOK_S, LEAST_LOOK_M = 0.4, 2.5
"""Steering aims at a point so far ahead on the way."""
AHEAD_S = 4.0
"""What is further off does not count."""
FORGET_S = 1.5


class Own(NamedTuple):
    """The car's own motion: speed ahead, how fast it turns to the left, and its step since the frame before."""

    speed_mps: float
    yaw_rate_radps: float
    step_m: FloatArray
    turn_rad: float


class Contact(NamedTuple):
    """What the car runs into if it goes on: after how long, its sigma, how hard it must brake, and the hazard's index."""

    ttc_s: float
    sigma_s: float
    needed_mps2: float
    index: int


class Decider:
    """Decides for one car; one rig, one decider.

    Parameters
    ----------
    rectification
        The twin cameras.
    T_vehicle_car
        The rig's mounting, or None.
    settings
        The car, and when something is done.
    """

    def __init__(
        self,
        rectification: Rectification,
        T_vehicle_car: FloatArray | None = None,
        settings: DecideSettings | None = None,
    ) -> None:
        self.settings = settings or DecideSettings()
        self._layout = Layout(rectification, T_vehicle_car)
        self._restart(0)

    def _restart(self, t_ns: int) -> None:
        self._t_ns, self._own, self._own_t_ns = t_ns, Own(0.0, 0.0, np.zeros(2), 0.0), -(10**18)
        self._recent: list[bool] = []
        self._last = Decision("none", "nothing was seen yet")
        self._until_ns = 0
        self._way: Ways | None = None
        self._pose = np.zeros(3)  # along, left, heading on the frame of the way
        self._aside_m, self._blocked = 0.0, 0

    def decide(
        self, obstacles: Sequence[Obstacle], free_space: FreeSpace, ego: EgoMotion | None, t_ns: int
    ) -> Decision:
        """Decide what to do in the next frame.

        Parameters
        ----------
        obstacles
            With tracks; what has none is not acted upon yet.
        free_space
            Of the same frame. What it does not know is never driven into.
        ego
            How the car moved since the frame before; None or unknown: as it did before, for a second.
        t_ns
            When. A frame of the same moment or of an earlier one changes nothing.
        """
        dt_s = (t_ns - self._t_ns) / 1e9
        if abs(dt_s) > FORGET_S:
            self._restart(t_ns)
        elif dt_s <= 0:
            return self._last
        self._t_ns = t_ns
        self._move(ego, dt_s, t_ns)
        if (t_ns - self._own_t_ns) / 1e9 > KNOWN_S:
            self._last = self._blind(obstacles)
        else:
            self._last = self._choose(self._layout.hazards(obstacles, free_space), free_space, t_ns)
        return self._last

    def _move(self, ego: EgoMotion | None, dt_s: float, t_ns: int) -> None:
        """Take the car's own step in."""
        R = self._layout.R
        if ego is not None and ego.T_now_before is not None:
            T = inverse(ego.T_now_before)
            seconds = (ego.t_ns - ego.before_t_ns) / 1e9
            step, turn = (R @ T[:3, 3])[:2], float((R @ rotvec_from_rotation(T[:3, :3]))[2])
            self._own = Own(float(step[0]) / seconds, turn / seconds, step, turn)
            self._own_t_ns = t_ns
        else:
            own = self._own
            self._own = own._replace(
                step_m=np.array([own.speed_mps * dt_s, 0.0]), turn_rad=own.yaw_rate_radps * dt_s
            )
        if self._way is not None:
            heading = self._pose[2]
            self._pose[:2] += _turned(self._own.step_m[None], heading)[0]
            self._pose[2] += self._own.turn_rad

    def _blind(self, obstacles: Sequence[Obstacle]) -> Decision:
        """Warn by relative velocities alone while the car's own motion is unknown."""
        s = self.settings
        room = s.width_m / 2 + s.margin_m
        near = [
            (o.track.ttc_s, o.track.ttc_sigma_s, o.track.id)
            for o in obstacles
            if o.track is not None
            and o.track.ttc_s < s.warn_s
            and abs(o.position_m[1] - self._layout.origin_m[1]) - o.size_m[0] / 2 < room
        ]
        if not near:
            return Decision("none", "the car's own motion is unknown, and nothing comes close")
        ttc_s, sigma_s, number = min(near)
        return Decision(
            "warn",
            f"contact in {ttc_s:.1f} s, and the car's own motion is unknown",
            ttc_s,
            sigma_s,
            obstacle_id=number,
        )

    def contact(self, hazards: Hazards) -> Contact | None:
        """Return what the car touches first if it goes on as it does, within `AHEAD_S`; None if nothing."""
        s, own = self.settings, self._own
        if not len(hazards.at_m):
            return None
        gap_m = hazards.at_m[:, 0] - s.front_m
        closing = own.speed_mps - hazards.velocity_mps[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            ttc = np.where((closing > CLOSING_MPS) & (gap_m > -s.front_m), np.maximum(gap_m, 0) / closing, np.inf)
            passed = ttc + np.where(hazards.moves, (s.front_m + s.rear_m) / closing, 0.0)
        bend = own.yaw_rate_radps / max(own.speed_mps, 1.0) / 2
        swept = bend * np.minimum(hazards.at_m[:, 0], AHEAD_S * own.speed_mps) ** 2
        start, speed = hazards.at_m[:, 1] - swept, hazards.velocity_mps[:, 1]
        with np.errstate(invalid="ignore"):
            y0, y1 = start + speed * ttc, start + speed * np.minimum(passed, AHEAD_S)
        room = s.width_m / 2 + s.margin_m
        hit = (ttc < AHEAD_S) & (np.minimum(y0, y1) < room) & (np.maximum(y0, y1) > -room)
        if not hit.any():
            return None
        at = np.flatnonzero(hit)
        left_m = gap_m[at] - s.stop_m - closing[at] * s.delay_s
        needed = np.where(left_m > 0, closing[at] ** 2 / (2 * np.maximum(left_m, 1e-6)), np.inf)
        first = at[np.argmin(ttc[at])]
        sigma = math.hypot(hazards.sigma_m[first], ttc[first] * hazards.sigma_mps[first]) / closing[first]
        return Contact(float(ttc[first]), float(sigma), float(needed.max()), int(first))

    def _choose(self, hazards: Hazards, free: FreeSpace, t_ns: int) -> Decision:
        if self._way is not None:
            going_on = self._follow(hazards, free)
            if going_on is not None:
                return going_on
        found = self.contact(hazards)
        self._recent = [*self._recent[-self.settings.confirm :], found is not None]
        sure = sum(self._recent) >= self.settings.confirm
        if found is None:
            if t_ns < self._until_ns:  # the road was not free a moment ago
                return Decision("brake", "the road is free again, but only just", deceleration_mps2=0.5)
            return self._standing(hazards) or Decision("none", "the way ahead is free")
        return self._against(found, hazards, free, t_ns, sure)

    def _standing(self, hazards: Hazards) -> Decision | None:
        """Stay where the car stands before something."""
        s = self.settings
        if self._own.speed_mps > STANDS_MPS or not len(hazards.at_m):
            return None
        aside = np.abs(hazards.at_m[:, 1]) < s.width_m / 2 + s.margin_m
        gap_m = np.where(aside, hazards.at_m[:, 0] - s.front_m, np.inf)
        index = int(np.argmin(gap_m))
        if gap_m[index] > 2 * s.stop_m or hazards.velocity_mps[index, 0] > STANDS_MPS:
            return None
        return Decision(
            "brake",
            f"standing {gap_m[index]:.1f} m before {_name(hazards, index)}",
            deceleration_mps2=1.0,
            obstacle_id=_number(hazards, index),
        )

    def _against(self, found: Contact, hazards: Hazards, free: FreeSpace, t_ns: int, sure: bool) -> Decision:
        """Return what to do about what is in the way."""
        s, index = self.settings, found.index
        told = f"{_name(hazards, index)} {hazards.at_m[index, 0]:.1f} m ahead, contact in {found.ttc_s:.1f} s"
        common = (found.ttc_s, found.sigma_s)
        number = _number(hazards, index)
        urgent = found.needed_mps2 >= s.brake_share * s.brake_mps2
        if sure and not hazards.moves[index] and found.ttc_s < s.swerve_s:
            way = self._way_round(hazards, free, hazards.at_m[index, 0] + BEHIND_M)
            if way is not None:
                self._way, self._pose, self._blocked = way, np.zeros(3), 0
                return self._steered(f"{told}; {_side(way)} is free", *common, number)
        if sure and urgent:
            self._until_ns = t_ns + round(1e9 * s.hold_s)
            hard = min(s.brake_mps2, max(1.15 * found.needed_mps2, 1.0))
            return Decision("brake", f"{told}; no way round is free, {hard:.1f} m/s2 needed", *common, hard, 0, 0, number)
        if t_ns < self._until_ns:
            hard = min(s.brake_mps2, found.needed_mps2)
            return Decision("brake", f"{told}; braking goes on", *common, hard, 0, 0, number)
        if found.ttc_s < s.warn_s or urgent:
            doubt = "" if sure else "; seen too few times to act"
            return Decision("warn", told + doubt, *common, obstacle_id=number)
        return Decision("none", told, *common, obstacle_id=number)

    def _way_round(self, hazards: Hazards, free: FreeSpace, until_m: float) -> Ways | None:
        """Return the least way aside that is drivable, free of everything, and seen to be road; None if there is none."""
        heading = self._pose[2] if self._way is not None else 0.0
        s = self.settings
        candidates = ways(math.tan(heading), self._aside_m, s)
        good = drivable(candidates, self._own.speed_mps, s)
        good[good] = self._is_free(Ways(*(part[good] for part in candidates)), hazards, free, heading, until_m)
        return candidates.only(int(np.argmax(good))) if good.any() else None

    def _is_free(
        self, some: Ways, hazards: Hazards, free: FreeSpace, heading: float, until_m: float
    ) -> NDArray[np.bool_]:
        """Return which ways (m,) from the car are free of what stands, moves or was not seen up to `until_m`."""
        s = self.settings
        lane = hazards._replace(
            at_m=_turned(hazards.at_m, heading), velocity_mps=_turned(hazards.velocity_mps, heading)
        )
        moves = lane.moves
        good = clear_of(some, lane.at_m[~moves], s.margin_m, s)
        good &= clear_of(some, _turned(self._layout.kerbs(free), heading), KERB_MARGIN_M, s)
        if moves.any():
            moving = Hazards(*(part[moves] for part in lane))
            good &= clear_of_moving(some, moving, self._own.speed_mps, s.margin_m, s)
        if good.any():
            kept = Ways(*(part[good] for part in some))
            good[good] = self._is_seen(kept, free, heading, until_m)
        return good

    def _is_seen(self, some: Ways, free: FreeSpace, heading: float, until_m: float) -> NDArray[np.bool_]:
        at = np.arange(BESIDE_M, max(until_m, BESIDE_M + 1.0), 1.0)
        y, _, _ = some.at(np.broadcast_to(at, (len(some.length_m), len(at))))
        room = self.settings.width_m / 2
        sides = y[..., None] + np.array([-room, 0.0, room])
        points = np.stack([np.broadcast_to(at[None, :, None], sides.shape), sides], -1)
        seen = self._layout.is_seen_free(_turned(points.reshape(-1, 2), -heading), free).reshape(len(y), -1)
        return np.asarray(seen.all(1))

    def _follow(self, hazards: Hazards, free: FreeSpace) -> Decision | None:
        """Return how the swerve goes on; None when it is over, or something came into its way."""
        assert self._way is not None  # noqa: S101
        along, left, heading = self._pose
        if along >= self._way.length_m[0]:
            self._aside_m, self._way = 0.0, None
            return None
        rest = _shifted(self._way, along, left)
        is_free = bool(self._is_free(rest, hazards, free, heading, BESIDE_M)[0])
        self._blocked = 0 if is_free else self._blocked + 1
        if self._blocked >= 2:
            before, self._aside_m = self._aside_m, self._aside_m + left
            other = self._way_round(hazards, free, BESIDE_M)
            if other is None:
                self._aside_m = before
                return Decision(
                    "brake",
                    "something came into the way round; braking on it",
                    deceleration_mps2=self.settings.brake_mps2,
                    curvature_per_m=self._steering(),
                    offset_m=float(self._way.offset_m[0]),
                )
            self._way, self._blocked = other, 0
            self._pose = np.array([0.0, 0.0, heading])
        last = self._last
        return self._steered(f"on the way round; {_side(self._way)} is free", math.nan, math.nan, last.obstacle_id)

    def _steered(self, reason: str, ttc_s: float, sigma_s: float, number: int | None) -> Decision:
        assert self._way is not None  # noqa: S101
        hard, offset = float(self._way.deceleration_mps2[0]), float(self._way.offset_m[0])
        return Decision("swerve", reason, ttc_s, sigma_s, hard, self._steering(), offset, number)

    def _steering(self) -> float:
        """Return the curvature, 1/m, that leads back to the way from where the car will be when steering acts."""
        assert self._way is not None  # noqa: S101
        s, v = self.settings, max(self._own.speed_mps, 1.0)
        along, left, heading = self._pose
        later = heading + v * s.delay_s * self._last.curvature_per_m
        middle = (heading + later) / 2
        along, left = along + v * s.delay_s * math.cos(middle), left + v * s.delay_s * math.sin(middle)
        ahead = max(LEAST_LOOK_M, LOOK_S * v)
        y, _, _ = self._way.at(np.array([[along + ahead]]))
        target = _turned(np.array([[ahead, float(y[0, 0]) - left]]), -later)[0]
        curvature = 2 * target[1] / float(target @ target)
        limit = min(1 / s.turn_m, s.lateral_mps2 / v**2)
        return float(np.clip(curvature, -limit, limit))


def _shifted(way: Ways, along_m: float, left_m: float) -> Ways:
    """Return the rest of a way, seen from a point beside it."""
    c = np.poly1d(way.coefficients[0][::-1])
    rest = c(np.poly1d([1.0, along_m])) - left_m
    coefficients = np.zeros(6)
    coefficients[: len(rest.coeffs)] = rest.coeffs[::-1]
    return way._replace(coefficients=coefficients[None], length_m=way.length_m - along_m)


def _turned(at_m: FloatArray, angle_rad: float) -> FloatArray:
    """Return points or ways (n, 2) in axes that are turned to the right by an angle."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.asarray(at_m @ np.array([[c, s], [-s, c]]))


def _side(way: Ways) -> str:
    offset = float(way.offset_m[0])
    return f"{abs(offset):.1f} m to the {'left' if offset > 0 else 'right'}"


def _number(hazards: Hazards, index: int) -> int | None:
    return int(hazards.number[index]) or None


def _name(hazards: Hazards, index: int) -> str:
    number, moves = _number(hazards, index), hazards.moves[index]
    what = "something" if number is None else f"obstacle {number}"
    return f"{what} that moves" if moves else what
