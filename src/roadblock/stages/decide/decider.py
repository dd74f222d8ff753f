"""The decider: what stands or moves in the car's way, and what to do about it; remembers the last moments."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.decide import among, needed_mps2, swept
from roadblock.kernels.reference.decide import CELL_M, STANDS_THERE
from roadblock.stages.decide.contact import Contact, find_contact
from roadblock.stages.decide.hazards import Hazards, Layout
from roadblock.stages.decide.memory import Memory, OwnMotion, turned
from roadblock.stages.decide.settings import DecideSettings
from roadblock.stages.decide.swerve import (
    Ways,
    clear_of,
    clear_of_moving,
    drivable,
    steering,
    straight_on,
    ways_aside,
)
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.decision import Decision
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace, GroundPlane, Obstacle

KNOWN_S = 1.0
"""So long the car's own motion is taken to go on."""
FORGET_S = 1.5
"""After a longer gap without frames all starts anew."""
FOOT_M = 1.0
"""The road must be in view this much before a cell to contradict it."""
BESIDE_M = 3.0
"""Who moves so near to the car's front may be beside it soon."""
LOST_S, LOST_M = 1.5, 8.0
"""What moved for sure is taken to go on so long if it is so near, ..."""
UNSEEN_S = 4.0
"""... and so long out of view."""
KERB_M = 0.15
"""Room to a kerb or a verge."""
BEHIND_M = 3.0
"""Road must be seen free so far behind what is passed."""
ROOMY_M = 3.0
"""Further aside, about a lane's width, no way leads for twice the room: nobody may see where the road ends."""
BEYOND_M = 12.0
PREFERRED = (BEYOND_M, 2.0, ROOMY_M), (BEYOND_M, 1.0, np.inf), (0.0, 2.0, ROOMY_M), (0.0, 1.0, np.inf)
"""Ways, best first: so far behind what is passed they are clear, with so much of `margin_m`, and lead so far aside."""
SEEN_FROM_M = 4.0
"""Nearer, at the sides, no camera sees it."""
CROSSING_MPS = 0.6
"""What goes across the road so fast, or along it faster than `PASSED_MPS`, is not driven round."""
PASSED_MPS, TOWARDS_MPS = 2.0, -0.3
"""Nor is what comes towards the car: the car stops for it."""
CREEP_MPS = 2.0
"""How fast a car that has stopped would go on."""
BLOCKED = 2
"""So many frames in a row must find a way blocked."""
SLOWER_MPS2 = 2.5
"""How a car slows down that finds its way round blocked further on."""
SAME_S, SAME_SHARE = 0.7, 0.3
"""Contacts of frames that follow each other that are further apart, whichever is more, are not one."""
SAME_M = 1.0
"""What is remembered so near to a track belongs to it."""
BEND_S = 0.3
"""So long what bounds the road ahead is taken to go on doing so."""
STRAIGHT_RADPS = 0.12
"""A road that turns the car faster bends too much to plan a way aside."""


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
        self._t_ns, self._own = t_ns, OwnMotion()
        self._stood, self._kerbs, self._height_m = Memory(), Memory(), math.nan
        self._movers, self._seen_ns = Hazards.of(np.zeros((0, 2))), np.zeros(0, np.int64)  # remembered, and when seen
        self._last = Decision("none", "nothing was seen yet")
        self._recent: list[float] = []  # after how long there would be a contact, NaN = none for sure
        self._brakes, self._until_ns, self._yields_ns, self._bends_ns = False, 0, 0, 0
        self._way: Ways | None = None
        self._begun_m, self._line_m = np.zeros(2), 0.0  # where the way begins, and the driver's line, left of 0
        self._blocked = 0
        self._commands: list[tuple[int, float]] = []  # how it was steered, and when: not all of it has come into force

    def decide(
        self,
        obstacles: Sequence[Obstacle],
        free_space: FreeSpace,
        ego: EgoMotion | None,
        t_ns: int,
        ground: GroundPlane | None = None,
    ) -> Decision:
        """Decide what to do in the next frame.

        Parameters
        ----------
        obstacles
            With tracks; what has none counts only as far as it ends free space.
        free_space
            Of the same frame. What it does not know is never driven into.
        ego
            How the car moved since the frame before; None or unknown: as it did before, for a second.
        t_ns
            When. A frame of the same moment or of an earlier one changes nothing.
        ground
            The road; without one, what goes out of view below is not told from what is gone.
        """
        dt_s = (t_ns - self._t_ns) / 1e9
        if abs(dt_s) > FORGET_S:
            self._restart(t_ns)
        elif dt_s <= 0:
            return self._last
        self._t_ns = t_ns
        self._own.move(self._layout.R, ego, min(dt_s, FORGET_S), t_ns)
        if self._way is None and not self._brakes:
            self._own.learn_road()
        if (t_ns - self._own.known_t_ns) / 1e9 > KNOWN_S:
            self._last = self._blind(obstacles)
        else:
            if ground is not None:
                self._height_m = ground.height_m
            hazards = self._seen(obstacles, free_space)
            self._last = self._choose(hazards, free_space)
        return self._last

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
        told = f"contact in {ttc_s:.1f} s, and the car's own motion is unknown"
        return Decision("warn", told, ttc_s, sigma_s, obstacle_id=number)

    def _seen(self, obstacles: Sequence[Obstacle], free: FreeSpace) -> Hazards:
        """Take a frame in, and return everything that stands or moves, in the axes of the vehicle."""
        r, own = self._layout.rectification, self._own
        faces, gained, movers = self._layout.faces(obstacles, free, set(self._movers.number.tolist()))
        foot_m = self._height_m * r.f_px / (r.size_px[1] - r.cy_px) + FOOT_M  # NaN: nothing is in view for sure
        self._stood.take_in(free, free.range_m, gained, foot_m, own, self._layout)
        if free.edges is not None:
            edge_m = free.edges.range_m
            is_edge = np.isfinite(edge_m)
            reach_m = np.where(is_edge, edge_m, free.range_m)
            self._kerbs.take_in(free, reach_m, STANDS_THERE * is_edge, foot_m, own, self._layout)
        stood = Hazards.of(self._stood.here_m, sigma_m=CELL_M)
        return Hazards.joined([stood, faces, self._lost(faces, movers, free)])

    def _lost(self, faces: Hazards, moving: NDArray[np.int64], free: FreeSpace) -> Hazards:
        """Keep what moves for sure; return what did, was near and is not found now, moved on."""
        own, kept = self._own, self._movers
        ago_s = (self._t_ns - self._seen_ns) / 1e9
        here_m = own.from_here(kept.at_m + kept.velocity_mps * ago_s[:, None])
        if len(kept.number):
            column, _ = self._layout.columns(here_m, free)
            fresh = (ago_s <= np.where(column < 0, UNSEEN_S, LOST_S)) & ~among(kept.number, moving)
            kept, here_m, self._seen_ns = kept.where(fresh), here_m[fresh], self._seen_ns[fresh]
        lost = kept._replace(at_m=here_m, velocity_mps=turned(kept.velocity_mps, -own.heading_rad))
        lost = lost.where(~among(kept.number, faces.number) & (here_m[:, 0] < LOST_M))
        if len(moving):
            new = faces.where(among(faces.number, moving))
            likely_mps = np.stack([new.velocity_mps[:, 0], new.likely_mps], 1)
            velocity_mps = turned(likely_mps, own.heading_rad)
            new = new._replace(at_m=own.remembered(new.at_m), velocity_mps=velocity_mps)
            kept = Hazards.joined([kept, new])
            self._seen_ns = np.concatenate([self._seen_ns, np.full(len(new.number), self._t_ns)])
        self._movers = kept
        return lost

    def _choose(self, hazards: Hazards, free: FreeSpace) -> Decision:
        if self._way is not None:
            return self._follow(hazards, free)
        own, s = self._own, self.settings
        way = straight_on(own.yaw_rate_radps / max(own.speed_mps, 3.0) / 2)
        found = find_contact(way, hazards, own.speed_mps, s.margin_m / 2, s, wary=self._brakes)
        if self._brakes and found is None:  # would it drive on, it would stop again
            near = find_contact(way, hazards, max(own.speed_mps, CREEP_MPS), s.margin_m / 2, s, wary=True)
            if near is not None and hazards.at_m[near.at, 0] < s.front_m + s.stop_m + 1:
                found = near
        self._recent = [*self._recent[-s.confirm :], found.ttc_s if found is not None and found.is_sure else math.nan]
        if found is None:
            if self._t_ns < self._until_ns:
                return Decision("brake", "the road is free again, but only just", deceleration_mps2=0.5)
            self._brakes = False
            return Decision("none", "the way ahead is free")
        return self._against(found, hazards, free)

    def _against(self, found: Contact, hazards: Hazards, free: FreeSpace) -> Decision:
        """Return what to do about what is in the way."""
        s, t_ns = self.settings, self._t_ns
        told, number = _told(found, hazards)
        same = (abs(t - found.ttc_s) < max(SAME_S, SAME_SHARE * max(t, found.ttc_s)) for t in self._recent)
        confirmed = found.is_sure and sum(same) >= s.confirm
        # What bounds a road that bends is not in the way: the car will turn, or brake, while there is room, for that.
        if found.ttc_s < s.warn_s + BEND_S and self._layout.is_in_bend(hazards.at_m[found.at], free):
            self._bends_ns = t_ns + round(1e9 * BEND_S)
        bends = t_ns <= self._bends_ns
        early = found.ttc_s < s.swerve_s and not bends
        needed = found.needed_mps2
        if bends:
            speed_mps = self._own.speed_mps
            _, needed = needed_mps2(found.ttc_s * speed_mps, speed_mps, 0.0, s.numbers)
        urgent = needed >= s.brake_share * s.brake_mps2
        if confirmed and (early or self._brakes) and self._can_pass(hazards, found.at):
            way = self._way_round(self._in_road(hazards), free, hazards.at_m[found.at, 0] + BEHIND_M)
            if way is not None:
                self._begin(way)
                return self._steered(
                    way, float(way.deceleration_mps2[0]), f"{told}; {_side(way)} is free", found, number
                )
        if self._brakes or (confirmed and urgent):
            self._brakes, self._until_ns = True, t_ns + round(1e9 * s.hold_s)
            hard = min(s.brake_mps2, max(found.needed_mps2, 0.5))
            reason = (
                f"{told}; no way round is free" if self._own.speed_mps > CREEP_MPS else f"{told}; standing before it"
            )
            return Decision("brake", reason, found.ttc_s, found.sigma_s, hard, obstacle_id=number)
        if found.ttc_s < s.warn_s or urgent:
            doubt = "" if confirmed else "; not sure enough to act"
            return Decision("warn", told + doubt, found.ttc_s, found.sigma_s, obstacle_id=number)
        return Decision("none", told, found.ttc_s, found.sigma_s, obstacle_id=number)

    def _can_pass(self, hazards: Hazards, index: int) -> bool:
        """Return whether what is in the way stands, or goes along before the car, for sure, on a straight road."""
        mine = np.hypot(*(hazards.at_m - hazards.at_m[index]).T) < SAME_M
        ahead, aside = hazards.velocity_mps[mine].T
        slow = (ahead < PASSED_MPS) & (ahead > TOWARDS_MPS) & (np.abs(aside) < CROSSING_MPS)
        known = bool(hazards.doubt[index] == 0) or self._brakes
        return bool(slow.all()) and known and abs(self._own.yaw_rate_radps) < STRAIGHT_RADPS

    def _in_road(self, hazards: Hazards) -> Hazards:
        """Return hazards in the axes of the road."""
        askew = self._own.askew_rad
        return hazards._replace(at_m=turned(hazards.at_m, askew), velocity_mps=turned(hazards.velocity_mps, askew))

    def _begin(self, way: Ways) -> None:
        here = turned(self._own.at_m[None], -self._own.road_rad)[0]
        if self._way is None:
            self._line_m = here[1]
        self._way, self._begun_m, self._blocked, self._brakes, self._until_ns = way, here, 0, False, 0

    def _way_round(self, hazards: Hazards, free: FreeSpace, until_m: float) -> Ways | None:
        """Return the way nearest to the one it is on that is drivable, free and seen to be road; None without one."""
        s, own = self.settings, self._own
        here = turned(own.at_m[None], -own.road_rad)[0]
        aside_m = here[1] - self._line_m if self._way is not None else 0.0
        ways = ways_aside(math.tan(own.askew_rad), aside_m, s)
        ways = ways.where(drivable(ways, own.speed_mps, s))
        # Half of the room: who is on a way round must get through; but past nobody who moves and was braked for.
        least = 0.5 if self._way is not None and self._t_ns >= self._yields_ns else 1.0
        ways = ways.where(self._is_clear(ways, hazards, until_m, least * s.margin_m))
        ways = ways.where(self._is_seen(ways, free, until_m))
        if not len(ways.length_m):
            return None
        for beyond_m, share, most_m in PREFERRED:
            roomy = self._is_clear(ways, hazards, until_m + beyond_m, share * s.margin_m)
            roomy &= np.abs(aside_m + ways.offset_m) <= most_m
            if roomy.any():
                ways = ways.where(roomy)
                break
        wanted_m = 0.0 if self._way is None else self._begun_m[1] + float(self._way.offset_m[0]) - here[1]
        return ways.only(int(np.argmin(np.abs(ways.offset_m - wanted_m))))

    def _is_clear(self, ways: Ways, hazards: Hazards, until_m: float, margin_m: float) -> NDArray[np.bool_]:
        s, own, moves = self.settings, self._own, hazards.moves
        good = clear_of(ways, hazards.at_m[~moves], until_m, margin_m, s) & self._is_inside(ways, until_m, KERB_M)
        may_move = moves | ((hazards.doubt > 0) & (hazards.sigma_mps[:, 0] > 0))  # not what the picture cuts
        if may_move.any() and good.any():
            good &= clear_of_moving(ways, hazards.where(may_move), until_m, own.speed_mps, s)
        return good

    def _is_inside(self, ways: Ways, until_m: float, room_m: float) -> NDArray[np.bool_]:
        """Return which ways (m,) stay inside the known kerbs, which run along the road, seen or not."""
        y = turned(self._kerbs.here_m, self._own.askew_rad)[:, 1]
        right, left = y[y < 0].max(initial=-np.inf), y[y > 0].min(initial=np.inf)
        ends = swept(ways.coefficients, ways.length_m, np.arange(0.0, until_m, 1.0), self.settings.numbers)
        return np.asarray((ends[0].min(1) > right + room_m) & (ends[1].max(1) < left - room_m))

    def _is_seen(self, ways: Ways, free: FreeSpace, until_m: float) -> NDArray[np.bool_]:
        """Return which ways (m,) lead over road that is seen to be free."""
        at = np.arange(SEEN_FROM_M, max(until_m, SEEN_FROM_M + 1.0), 1.0)
        y, _, _ = ways.at(np.broadcast_to(at, (len(ways.length_m), len(at))))
        room = self.settings.width_m / 2
        sides = y[..., None] + np.array([-room, 0.0, room])
        points = np.stack([np.broadcast_to(at[None, :, None], sides.shape), sides], -1)
        seen = self._layout.is_seen_free(turned(points.reshape(-1, 2), -self._own.askew_rad), free)
        return np.asarray(seen.reshape(sides.shape).all((1, 2)))

    def _follow(self, hazards: Hazards, free: FreeSpace) -> Decision:
        """Return how the swerve goes on."""
        assert self._way is not None  # noqa: S101
        s, own = self.settings, self._own
        along, left = turned(own.at_m[None], -own.road_rad)[0] - self._begun_m
        if along >= self._way.length_m[0]:
            self._way, self._recent = None, []
            return self._choose(hazards, free)
        rest, in_road = self._way.from_point(along, left), self._in_road(hazards)
        to_go_m, speed_mps = float(rest.length_m[0]) + BEHIND_M, max(own.speed_mps, CREEP_MPS)
        things, found = in_road, find_contact(rest, in_road, speed_mps, s.margin_m / 2, s, strict=True)
        blocked = found is not None and found.is_sure and found.ttc_s < s.swerve_s
        self._blocked = self._blocked + 1 if blocked else 0
        if self._blocked < BLOCKED:
            # Who comes nearer than was thought is given room again as long as there is any.
            things = in_road.where(in_road.moves)
            beside = things.where(things.at_m[:, 0] < s.front_m + BESIDE_M)
            if own.speed_mps < CREEP_MPS and not clear_of_moving(rest, beside, s.rear_m, own.speed_mps, s)[0]:
                told = "on the way round: who is beside goes first"
                return self._steered(rest, s.brake_mps2, told, None, int(beside.number[0]) or None, "brake")
            found = find_contact(rest, things, speed_mps, s.margin_m, s, strict=True)
            if found is None and self._is_inside(rest, to_go_m, 0.0)[0]:
                told, slower_mps2 = f"on the way round; {_side(rest)} is free", float(rest.deceleration_mps2[0])
                if self._t_ns < self._until_ns:
                    hard = self._last.deceleration_mps2
                    return self._steered(rest, hard, f"{told}, but only just", None, self._last.obstacle_id, "brake")
                return self._steered(rest, slower_mps2, told, None, self._last.obstacle_id)
        told, number = _told(found, things) if found else ("a kerb comes close", self._last.obstacle_id)
        told = f"on the way round: {told}"
        other = self._way_round(in_road, free, things.at_m[found.at, 0] + BEHIND_M if found else to_go_m)
        if other is not None:
            self._begin(other)
            slower_mps2 = float(other.deceleration_mps2[0])
            return self._steered(other, slower_mps2, f"{told}; {_side(other)} is free", found, number)
        hard = min(s.brake_mps2, max(found.needed_mps2 if found else 0.0, SLOWER_MPS2))
        if found and (things.moves[found.at] or hard >= s.brake_share * s.brake_mps2):
            self._until_ns = self._t_ns + round(1e9 * s.hold_s)
            if things.moves[found.at]:
                self._yields_ns = self._until_ns
            return self._steered(rest, hard, f"{told}; braking on it", found, number, "brake")
        return self._steered(rest, SLOWER_MPS2, f"{told}; slowing down", found, number)

    def _steered(
        self,
        rest: Ways,
        slower_mps2: float,
        reason: str,
        found: Contact | None,
        number: int | None,
        action: str = "swerve",
    ) -> Decision:
        own = self._own
        delay_ns = round(1e9 * self.settings.delay_s)
        self._commands = [(t_ns, c) for t_ns, c in self._commands if self._t_ns - t_ns <= delay_ns]
        pending = float(np.mean([c for _, c in self._commands])) if self._commands else 0.0
        curvature = steering(rest, math.tan(own.askew_rad), own.speed_mps, pending, self.settings)
        self._commands.append((self._t_ns, curvature))
        ttc = (math.nan, math.nan) if found is None else (found.ttc_s, found.sigma_s)
        return Decision(action, reason, *ttc, slower_mps2, curvature, float(rest.offset_m[0]), number)


def _side(way: Ways) -> str:
    offset = float(way.offset_m[0])
    return f"{abs(offset):.1f} m to the {'left' if offset > 0 else 'right'}"


def _told(found: Contact, hazards: Hazards) -> tuple[str, int | None]:
    """Return in words what is in the way, and the number of its track, if it has one."""
    at_m, numbers = hazards.at_m, hazards.number
    number = int(numbers[found.at])
    near = (numbers > 0) & (np.hypot(*(at_m - at_m[found.at]).T) < SAME_M)
    if not number and near.any():
        number = int(numbers[near][0])
    what = f"obstacle {number}" if number else "something"
    moves = ", which moves," if hazards.moves[found.at] else ""
    return f"{what}{moves} {at_m[found.at, 0]:.1f} m ahead, contact in {found.ttc_s:.1f} s", number or None
