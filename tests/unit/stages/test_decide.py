"""Decisions of a car that drives straight on towards things whose tracks are known exactly."""

import math
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from roadblock.geometry.pose import R_VEHICLE_CAR, inverse, pose, rotation_from_rotvec
from roadblock.kernels.reference.decide import ALONE, STANDS_THERE
from roadblock.stages.decide import Decider, DecideSettings
from roadblock.stages.decide.contact import find_contact
from roadblock.stages.decide.hazards import Hazards, Layout
from roadblock.stages.decide.memory import Memory, OwnMotion
from roadblock.stages.decide.swerve import clear_of, clear_of_moving, drivable, steering, straight_on, ways_aside
from roadblock.values.camera import Rectification
from roadblock.values.decision import Decision
from roadblock.values.motion import EgoMotion, Track
from roadblock.values.scene import FreeSpace, GroundPlane, Obstacle, RoadEdges

TWIN = Rectification(705.0, 611.0, 171.0, 0.52, (1240, 374))
U = np.arange(1.5, 1240, 4)
SPEED, FRAME_S, START_NS = 8.0, 0.1, 10**9
ROAD = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.4)
SETTINGS = DecideSettings()
CAR = np.eye(4)


@dataclass
class Thing:
    """A box across the road: its near face, its middle and width, its velocity, and what its track says."""

    x: float
    y: float
    width: float = 0.8
    v: tuple[float, float] = (0.0, 0.0)
    motion: str = "standing"
    is_tracked: bool = True
    sigma_mps: float = 0.2
    age_s: float = 2.0
    coasted_s: float = 0.0
    id: int = 3

    def at(self, t_s: float) -> "Thing":
        return replace(self, x=self.x + self.v[0] * t_s, y=self.y + self.v[1] * t_s)


def obstacle(thing: Thing, over_ground: bool = True) -> Obstacle:
    z, half = thing.x, thing.width / 2
    u = [TWIN.cx_px + TWIN.f_px * (-(thing.y + side) + TWIN.baseline_m / 2) / z for side in (half, -half)]
    velocity = np.array(thing.v) if over_ground else np.array(thing.v) - [SPEED, 0.0]
    closing = SPEED - thing.v[0] or math.nan
    track = Track(
        thing.id, thing.age_s, thing.coasted_s, np.array([z, thing.y, 0.0]), np.eye(3) * 0.01, velocity,
        np.eye(2) * thing.sigma_mps**2, over_ground, thing.motion if over_ground else "unknown", z / closing, 0.1,
    )  # fmt: skip
    return Obstacle(
        np.array([z, thing.y, 0.0]), z, 0.1, np.array([thing.width, 1.5, np.nan]), np.array([sum(u) / 2, 150.0, 30.0]),
        np.eye(3), np.eye(3) * 0.01, (round(u[0]), 100, max(round(u[1]), round(u[0]) + 1), 250),
        np.zeros((0, 2), np.int32), track=track if thing.is_tracked else None,
    )  # fmt: skip


def free_space(things: list[Thing], kerb_y: tuple[float, ...] = (), reach_m: float = 40.0) -> FreeSpace:
    """Return where columns end, in closed form."""
    aside = -(U - TWIN.cx_px) / TWIN.f_px
    z = np.full(len(U), reach_m)
    for thing in things:
        y = aside * thing.x + TWIN.baseline_m / 2
        z = np.where((np.abs(y - thing.y) <= thing.width / 2) & (thing.x > 0), np.minimum(z, thing.x), z)
    edge = np.full(len(U), np.nan)
    for kerb in kerb_y:
        with np.errstate(divide="ignore"):
            crossed = (kerb - TWIN.baseline_m / 2) / aside
        edge = np.where((crossed > 0) & (crossed < 12) & (crossed < z), crossed, edge)
    seen = np.isfinite(edge)
    edges = RoadEdges(edge, np.where(seen, 0.12, np.nan), seen.astype(np.uint8)) if kerb_y else None
    return FreeSpace(U, z, z < reach_m, edges)


def step(t_ns: int, forward_m: float = SPEED * FRAME_S, left_rad: float = 0.0) -> EgoMotion:
    T_before_now = pose(rotation_from_rotvec([0.0, -left_rad, 0.0]), [0.0, 0.0, forward_m])
    return EgoMotion(t_ns - round(1e9 * FRAME_S), t_ns, inverse(T_before_now), np.eye(6) * 1e-6)


@dataclass
class Drive:
    """A car that goes straight on at 8 m/s whatever is decided, and the decisions."""

    things: list[Thing]
    settings: DecideSettings = SETTINGS
    kerb_y: tuple[float, ...] = ()
    known: bool = True
    over_ground: bool = True
    told: list[Decision] = field(default_factory=list)

    def run(self, frames: int) -> "Drive":
        decider = Decider(TWIN, None, self.settings)
        for k in range(frames):
            t_s = k * FRAME_S
            now = [replace(t, x=t.x - SPEED * t_s) for t in (thing.at(t_s) for thing in self.things)]
            ahead = [t for t in now if t.x > 1.5]
            t_ns = START_NS + round(1e9 * t_s)
            ego = step(t_ns) if k else None
            if not self.known and ego is not None:
                ego = EgoMotion.unknown(ego.before_t_ns, ego.t_ns, "too dark")
            found = [obstacle(t, self.over_ground) for t in ahead]
            self.told.append(decider.decide(found, free_space(ahead, self.kerb_y), ego, t_ns, ROAD))
        return self

    @property
    def actions(self) -> list[str]:
        return [decision.action for decision in self.told]


def test_an_empty_road_is_left_alone() -> None:
    drive = Drive([]).run(20)
    assert set(drive.actions) == {"none"}
    assert drive.told[-1].reason == "the way ahead is free"


def test_what_stands_beside_the_corridor_is_passed_without_a_word() -> None:
    assert set(Drive([Thing(25.0, -1.9), Thing(22.0, 1.9, id=4)]).run(30).actions) == {"none"}


def test_what_stands_in_the_way_is_driven_round_on_the_free_side() -> None:
    drive = Drive([Thing(30.0, -0.3)]).run(20)
    first = drive.actions.index("swerve")
    decision = drive.told[first]
    assert "brake" not in drive.actions
    assert decision.ttc_s == pytest.approx((30.0 - 0.8 * first - SETTINGS.front_m) / SPEED, abs=0.1)
    assert SETTINGS.swerve_s - 0.2 < decision.ttc_s < SETTINGS.swerve_s
    assert decision.offset_m > 0.85 + 0.1  # the thing is to the right of the middle: the left is nearer
    assert decision.curvature_per_m > 0
    assert decision.obstacle_id == 3
    assert "obstacle 3" in decision.reason
    assert "to the left is free" in decision.reason


def test_it_is_warned_before_anything_is_done_and_one_frame_does_nothing() -> None:
    decider = Decider(TWIN)
    decider.decide([], free_space([]), None, START_NS, ROAD)
    t_ns = START_NS + 100_000_000
    near = Thing(9.0, 0.0)
    once = decider.decide([obstacle(near)], free_space([near]), step(t_ns), t_ns, ROAD)
    assert once.action == "warn"
    assert "not sure enough" in once.reason


WALL = [Thing(32.0, 0.0, 30.0)]


def test_two_contacts_far_apart_do_not_confirm_each_other() -> None:
    decider, actions = Decider(TWIN), []
    wall, near = Thing(36.0, 0.0, 30.0), Thing(9.0, 0.0, 0.6, id=4)
    for k in range(6):
        t_ns = START_NS + k * 100_000_000
        things = [replace(t, x=t.x - 0.8 * max(k - 4, 0)) for t in ([wall] if k < 4 else [wall, near])]
        found = decider.decide([obstacle(t) for t in things], free_space(things), step(t_ns), t_ns, ROAD)
        actions.append(found.action)
    assert actions == ["none"] * 4 + ["warn", "brake"]


def test_a_wall_is_braked_for_so_that_room_is_left() -> None:
    drive = Drive(WALL).run(25)
    first = drive.actions.index("brake")
    gap_m = 32.0 - 0.8 * first - SETTINGS.front_m
    least = SETTINGS.brake_share * SETTINGS.brake_mps2
    stop_m = SETTINGS.delay_s * SPEED + SPEED**2 / (2 * least) + SETTINGS.stop_m
    assert stop_m - 0.8 < gap_m < stop_m + 0.8  # a frame, and a cell of what is remembered
    assert drive.told[first].deceleration_mps2 == pytest.approx(least, abs=0.4)
    assert "swerve" not in drive.actions
    assert "no way round is free" in drive.told[first].reason
    assert drive.actions[first - 1] == "warn"


def test_no_way_leads_over_a_kerb() -> None:
    between = Drive([Thing(30.0, 0.0, 1.8)], kerb_y=(-2.2, 2.2)).run(22)
    assert "swerve" not in between.actions
    assert "brake" in between.actions
    one_side = Drive([Thing(30.0, 0.4, 1.0)], kerb_y=(-2.0,)).run(18)
    assert one_side.told[one_side.actions.index("swerve")].offset_m > 0  # right would be less far aside
    no_kerb = Drive([Thing(30.0, 0.4, 1.0)]).run(18)
    assert no_kerb.told[no_kerb.actions.index("swerve")].offset_m < 0


def test_no_way_leads_where_nothing_was_seen() -> None:
    thing = Thing(14.0, 0.0)
    decider, layout = Decider(TWIN), Layout(TWIN, None)
    for k in range(4):
        now, t_ns = replace(thing, x=thing.x - 0.8 * k), START_NS + k * 100_000_000
        seen = free_space([now])
        unknown = np.abs(U - TWIN.cx_px) > 60
        seen = FreeSpace(U, np.where(unknown, np.nan, seen.range_m), seen.is_blocked & ~unknown)  # type: ignore[operator]
        decision = decider.decide([obstacle(now)], seen, step(t_ns) if k else None, t_ns, ROAD)
    assert decision.action == "brake"
    assert not layout.is_seen_free(np.array([[10.0, 5.0], [-3.0, 0.0]]), seen).any()
    assert not layout.is_seen_free(np.array([[10.0, 0.0]]), FreeSpace(np.zeros(0), np.zeros(0))).any()


def test_what_dropped_below_the_picture_is_still_there() -> None:
    memory_only = [Thing(12.0, 0.0, 30.0, is_tracked=False)]
    decider, told = Decider(TWIN), []
    for k in range(18):
        t_ns, x = START_NS + k * 100_000_000, 12.0 - 0.4 * k
        seen = [replace(memory_only[0], x=x)] if x > 6.5 else []
        told.append(decider.decide([], free_space(seen), step(t_ns, 0.4) if k else None, t_ns, ROAD))
    assert told[-1].action == "brake"
    assert "something" in told[-1].reason


def test_what_is_gone_is_forgotten() -> None:
    decider = Decider(TWIN)
    for k in range(16):
        t_ns = START_NS + k * 100_000_000
        seen = [Thing(14.0 - 0.1 * k, 0.0, 30.0, is_tracked=False)] if k < 6 else []
        decision = decider.decide([], free_space(seen), step(t_ns, 0.1) if k else None, t_ns, ROAD)
    assert decision.action == "none"


def test_who_crosses_in_time_is_left_alone_and_who_does_not_is_braked_for() -> None:
    def walks(y: float) -> Drive:
        return Drive([Thing(26.0, y, 0.5, (0.0, 1.5), "moving")]).run(24)

    assert set(walks(-1.8).actions) == {"none"}  # has crossed by then
    assert set(walks(-9.0).actions) == {"none"}  # comes late
    assert "brake" in walks(-4.6).actions


def test_a_car_ahead_is_left_alone_as_long_as_it_drives() -> None:
    assert set(Drive([Thing(14.0, 0.0, 1.7, (8.0, 0.0), "moving")]).run(20).actions) == {"none"}
    slow = Drive([Thing(20.0, 0.0, 1.7, (3.0, 0.0), "moving")]).run(24)
    assert "brake" in slow.actions
    assert "which moves" in slow.told[slow.actions.index("brake")].reason


def test_what_may_move_or_stand_is_acted_on_only_when_it_must_be() -> None:
    sure = Drive([*WALL]).run(25).actions.index("brake")
    unsure = [replace(WALL[0], motion="unknown", width=1.9, sigma_mps=3.0)]
    drive = Drive(unsure, DecideSettings(swerve_s=0.1)).run(25)
    assert drive.actions.index("brake") >= sure
    young = Drive([replace(unsure[0], age_s=0.1)], DecideSettings(swerve_s=0.1)).run(31)
    assert young.actions.index("brake") > drive.actions.index("brake")
    aside = Drive([replace(unsure[0], y=-2.5, is_tracked=False)]).run(30)
    assert set(aside.actions) == {"none"}


def test_little_doubt_is_left_about_what_hardly_moves() -> None:
    young = Thing(40.0, 0.0, 0.6, motion="unknown", age_s=0.4, sigma_mps=3.0)
    settings = DecideSettings(swerve_s=0.1)
    slow, unsure = (Drive([replace(young, sigma_mps=s)], settings).run(45).actions for s in (0.3, 3.0))
    assert slow.index("brake") < unsure.index("brake") - 5


def test_without_its_own_motion_it_only_warns() -> None:
    drive = Drive([Thing(22.0, 0.0)], known=False, over_ground=False).run(20)
    assert set(drive.actions) == {"none", "warn"}
    assert "own motion is unknown" in drive.told[-1].reason
    assert Drive([Thing(22.0, 6.0)], known=False, over_ground=False).run(20).actions[-1] == "none"


def test_a_standing_car_stays_where_it_is_before_something() -> None:
    decider, thing = Decider(TWIN), Thing(20.0, 0.0, 30.0)
    x, v, actions = 20.0, SPEED, []
    for k in range(60):
        t_ns = START_NS + k * 100_000_000
        now = replace(thing, x=x)
        decision = decider.decide(
            [obstacle(now)], free_space([now]), step(t_ns, v * FRAME_S) if k else None, t_ns, ROAD
        )
        actions.append(decision.action)
        v = max(0.0, v - decision.deceleration_mps2 * FRAME_S) if decision.action == "brake" else min(v + 0.15, SPEED)
        x -= v * FRAME_S
    assert actions[-20:] == ["brake"] * 20
    assert v == 0
    assert 2.0 < x - SETTINGS.front_m < SETTINGS.stop_m + 1
    assert "standing before it" in decision.reason


def test_the_road_that_is_free_again_is_not_trusted_at_once() -> None:
    decider = Decider(TWIN, None, DecideSettings(hold_s=0.25))
    actions = []
    for k in range(14):
        t_ns = START_NS + k * 100_000_000
        things = [Thing(18.0 - 0.8 * k, 0.0, 30.0, (0.0, 0.0), "standing")] if k < 8 else []
        told = decider.decide([obstacle(t) for t in things], free_space([]), step(t_ns) if k else None, t_ns, ROAD)
        actions.append(told.action)
    assert actions[7:10] == ["brake", "brake", "brake"]
    assert actions[-1] == "none"


def test_bad_stamps_change_nothing_and_a_gap_begins_anew() -> None:
    decider = Decider(TWIN)
    first = decider.decide([], free_space([]), None, START_NS)
    assert decider.decide([], free_space([]), None, START_NS) is first
    assert decider.decide([], free_space([]), None, START_NS - 10**8) is first
    later = decider.decide([], free_space([]), None, START_NS + 10**10)
    assert later.action == "none"
    assert later is not first


@dataclass
class Obeyed:
    """A car that obeys exactly, in closed form; things by their place over ground, from a moment on."""

    things: list[tuple[float, Thing]]
    kerb_y: tuple[float, ...] = ()
    kerb_from_s: float = 0.0
    gone_s: tuple[float, float] = (99.0, 99.0)
    """When nothing is found."""
    told: list[Decision] = field(default_factory=list)
    nearest_m: float = 99.0
    right_m: float = 99.0
    """How far to the right the car's side got."""
    speed: float = SPEED
    heading: float = 0.0

    def run(self, frames: int, decider: Decider | None = None) -> "Obeyed":
        decider, x, y, before = decider or Decider(TWIN), 0.0, 0.0, (0.0, 0.0, 0.0)
        for k in range(frames):
            c, s = math.cos(self.heading), math.sin(self.heading)
            there = [t.at(k * FRAME_S) for since, t in self.things if k * FRAME_S >= since]
            seen = [replace(t, x=(t.x - x) * c + (t.y - y) * s, y=(t.y - y) * c - (t.x - x) * s) for t in there]
            ahead = [t for t in seen if t.x > 1.5 and not self.gone_s[0] <= k * FRAME_S < self.gone_s[1]]
            kerb_y = tuple(kerb - y for kerb in self.kerb_y) if k * FRAME_S >= self.kerb_from_s else ()
            t_ns = START_NS + k * 100_000_000
            ego = step(t_ns, float(np.hypot(x - before[0], y - before[1])), self.heading - before[2]) if k else None
            decision = decider.decide([obstacle(t) for t in ahead], free_space(ahead, kerb_y), ego, t_ns, ROAD)
            self.told.append(decision)
            before = (x, y, self.heading)
            self.speed = max(0.0, self.speed - decision.deceleration_mps2 * FRAME_S)
            self.heading += decision.curvature_per_m * self.speed * FRAME_S
            x += self.speed * FRAME_S * math.cos(self.heading)
            y += self.speed * FRAME_S * math.sin(self.heading)
            self.right_m = min(self.right_m, y - SETTINGS.width_m / 2)
            for t in there:
                if -SETTINGS.rear_m < t.x - x < SETTINGS.front_m:
                    self.nearest_m = min(self.nearest_m, abs(t.y - y) - (SETTINGS.width_m + t.width) / 2)
        return self

    @property
    def actions(self) -> list[str]:
        return [decision.action for decision in self.told]


def test_a_swerve_is_driven_to_its_end() -> None:
    """It passes with room, parallel to the road at last."""
    drive = Obeyed([(0.0, Thing(32.0, 0.2))]).run(60)
    assert drive.nearest_m > SETTINGS.margin_m / 2
    assert drive.actions[-1] == "none"
    assert abs(drive.heading) < 0.05
    assert "brake" not in drive.actions


def test_a_way_that_gets_blocked_is_changed() -> None:
    first = Thing(30.0, 0.2)
    second = Thing(38.0, -2.8, 1.0, id=4)  # where the way past the first one leads
    drive = Obeyed([(0.0, first), (2.2, second)]).run(60)
    assert drive.told[21].action == "swerve"
    assert drive.nearest_m > 0
    assert any("on the way round: obstacle 4" in told.reason for told in drive.told)


def test_a_way_that_ends_is_braked_on() -> None:
    decider = Decider(TWIN)
    drive = Obeyed([(0.0, Thing(30.0, 0.2)), (2.0, Thing(38.0, 0.0, 30.0, id=4))]).run(60, decider)
    assert decider._yields_ns == 0  # what stands may be passed more closely
    assert "brake" in drive.actions[drive.actions.index("swerve") :]
    assert any("braking on it" in told.reason for told in drive.told)
    assert drive.speed < 1.5
    gentle = Obeyed([(0.0, Thing(22.0, 0.2)), (1.3, Thing(37.0, 0.0, 30.0, id=4))]).run(32)
    assert any("slowing down" in told.reason for told in gentle.told)


@pytest.mark.parametrize("wall_y", [None, -3.6])
def test_who_comes_nearer_than_was_thought_is_given_room_again(wall_y: float | None) -> None:
    """The way leads round on the right, where someone walks then; past the wall there is no other way at once."""
    walker = Thing(26.0, 0.6, 0.5)
    walls = [] if wall_y is None else [(0.0, Thing(x, wall_y, 0.6, id=k)) for k, x in enumerate((20.0, 24.0, 28.0), 5)]
    drive = Obeyed([(0.0, walker), *walls, (1.6, Thing(27.0, 1.9, 0.5, (0.0, -0.8), "moving", id=4))]).run(40)
    told = [t.reason for t in drive.told[16:]]
    assert drive.nearest_m > 0
    assert any("braking on it" in reason for reason in told) == (wall_y is not None)


def test_a_swerve_keeps_out_of_the_way_of_oncoming_cars() -> None:
    things = [(0.0, Thing(30.0, -0.3)), (0.0, Thing(50.0, 2.6, 1.8, (-8.0, 0.0), "moving", id=4))]
    drive = Obeyed(things).run(30)
    assert drive.told[drive.actions.index("swerve")].offset_m < 0
    assert drive.nearest_m > 0


def test_ways_begin_where_the_car_is_and_end_along_the_road() -> None:
    ways = ways_aside(0.1, 1.0, SETTINGS)
    y, slope, curvature = ways.at(np.array([0.0]))
    assert np.allclose([y, slope - 0.1, curvature], 0)
    y, slope, _ = ways.at(ways.length_m[:, None] + 5)
    assert np.allclose(y[:, 0], ways.offset_m)
    assert np.allclose(slope, 0, atol=1e-9)
    assert np.abs(ways.offset_m + 1.0).max() <= SETTINGS.widest_m + 1e-9
    rest = ways.only(40).from_point(3.0, 0.4)
    assert rest.at(np.array([[2.0]]))[0] == pytest.approx(ways.only(40).at(np.array([[5.0]]))[0] - 0.4)


def test_fast_cars_steer_gently() -> None:
    ways = ways_aside(0.0, 0.0, SETTINGS)
    slow, fast = (np.abs(ways.offset_m[drivable(ways, v, SETTINGS) & (ways.length_m == 11)]).max() for v in (3, 10))
    # a quintic step bends by 5.77 times its width over the square of its length
    assert fast == pytest.approx(0.85 * 3.0 / 100 * 121 / 5.77, abs=0.2)
    assert slow > 3 * fast


def test_ways_keep_clear_of_what_moves() -> None:
    ways = ways_aside(0.0, 0.0, SETTINGS)
    oncoming = Hazards.of(np.array([[30.0, 2.5]]), np.array([-6.0, 0.0]))
    good = ways.where(clear_of_moving(ways, oncoming, 24.0, 8.0, SETTINGS))
    assert not ((good.offset_m > 1.3) & (good.offset_m < 3.7) & (good.length_m < 12)).any()
    assert {-2.0, 0.0, 4.0} <= set(good.offset_m.round(1))
    assert clear_of(ways, np.zeros((0, 2)), 20.0, 0.2, SETTINGS).all()


def test_a_car_askew_sweeps_more_than_its_width() -> None:
    """It heads 17 degrees to the left: who is 1.7 m to the right of it is touched by its rear, not by its front."""
    way = ways_aside(0.3, 0.0, SETTINGS)
    way = way.where((way.offset_m == 4.0) & (way.length_m == 24.0) & (way.deceleration_mps2 == 0))
    for x_m, is_clear in ((-2.0, False), (1.0, True)):
        walker = Hazards.of(np.array([[x_m, -1.7]]), np.array([-0.6, 0.0]))
        assert clear_of_moving(way, walker, 2.0, 1.0, SETTINGS).tolist() == [is_clear]


def test_steering_leads_back_to_the_way() -> None:
    way = straight_on()
    right_of_it = way.from_point(0.0, -0.5)
    assert steering(right_of_it, 0.0, 8.0, 0.0, SETTINGS) > 0.01
    assert steering(way, 0.05, 8.0, 0.0, SETTINGS) < -0.01
    assert steering(way, 0.0, 8.0, 0.02, SETTINGS) < -0.01  # it is still being steered to the left
    assert abs(steering(right_of_it.from_point(0.0, -9.0), 0.0, 8.0, 0.0, SETTINGS)) <= 3.0 / 64 + 1e-9


def test_a_contact_counts_what_is_swept_in_a_bend() -> None:
    way = straight_on(1 / 40)  # y = x^2 / 40: 5.6 m to the left at 15 m
    left = Hazards.of(np.array([[15.0, 5.6]]))
    ahead = Hazards.of(np.array([[15.0, 0.0]]))
    assert find_contact(way, left, 8.0, 0.2, SETTINGS) is not None
    assert find_contact(way, ahead, 8.0, 0.2, SETTINGS) is None
    assert find_contact(straight_on(), ahead, 8.0, 0.2, SETTINGS) is not None


def test_no_more_braking_is_wanted_than_leaves_room() -> None:
    found = find_contact(straight_on(), Hazards.of(np.array([[6.0, 0.0]])), 8.0, 0.2, SETTINGS)
    assert found is not None
    # too late for stop_m: as near as may be
    assert found.needed_mps2 == pytest.approx(64 / (2 * (6.0 - 1.3 - 2.4 - 0.7)))


@pytest.mark.parametrize(("evidence", "frames"), [(STANDS_THERE, 3), (ALONE, 6)])
def test_memory_needs_evidence_and_gives_in_to_it(evidence: int, frames: int) -> None:
    memory, own, layout = Memory(), OwnMotion(), Layout(TWIN, None)
    here = free_space([Thing(5.03, -1.2, 0.12)])
    gained, nothing = np.where(here.ends, evidence, 0), np.zeros(len(U), np.int64)
    for _ in range(frames - 1):
        memory.take_in(here, here.range_m, gained, 2.0, own, layout)
    assert not len(memory.here_m)
    memory.take_in(here, here.range_m, gained, 2.0, own, layout)
    np.testing.assert_allclose(memory.here_m, [[5.0, -1.2]])
    gone = free_space([])
    memory.take_in(gone, gone.range_m, nothing, math.nan, own, layout)
    assert len(memory.here_m)
    memory.take_in(gone, gone.range_m, nothing, 2.0, own, layout)
    assert not len(memory.here_m)
    assert len(memory)
    own.at_m = np.array([40.0, 0.0])
    memory.take_in(gone, gone.range_m, nothing, 2.0, own, layout)
    assert not len(memory)


def test_own_motion_is_dead_reckoning_and_goes_on_for_a_while() -> None:
    own, turn = OwnMotion(), math.pi / 2
    own.move(R_VEHICLE_CAR, step(10**9, 1.0, turn), 0.1, 10**9)
    np.testing.assert_allclose(own.at_m, [1.0, 0.0], atol=1e-12)
    assert own.heading_rad == pytest.approx(turn)
    np.testing.assert_allclose(own.from_here(np.array([[1.0, 2.0]])), [[2.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(own.remembered(np.array([[2.0, 0.0]])), [[1.0, 2.0]], atol=1e-12)
    own.yaw_rate_radps = 0.0
    own.move(R_VEHICLE_CAR, None, 0.1, 10**9)
    np.testing.assert_allclose(own.at_m, [1.0, 1.0], atol=1e-12)
    assert own.speed_mps == pytest.approx(10.0)


def test_who_walked_out_of_view_is_still_expected() -> None:
    decider, told = Decider(TWIN), []
    for k in range(12):
        t_ns, v = START_NS + k * 100_000_000, 2.0
        walker = Thing(5.0 - 0.2 * k, -3.2 + 0.2 * k, 0.5, (0.0, v), "moving")
        seen = [obstacle(walker)] if k < 6 else []
        told.append(decider.decide(seen, free_space([]), step(t_ns, 0.2) if k else None, t_ns, ROAD))
    assert told[7].action == "brake"
    assert "which moves" in told[7].reason


@pytest.mark.parametrize("motion", ["moving", "unknown"])
def test_who_walks_towards_the_car_is_stopped_for(motion: str) -> None:
    walker = Thing(24.0, 0.0, 0.5, (-1.3, 0.0), motion, sigma_mps=0.3)
    actions = Drive([walker]).run(16).actions
    assert "brake" in actions
    assert "swerve" not in actions


def test_ways_keep_clear_of_where_something_may_have_gone() -> None:
    """What seems to stand 14 m ahead may walk towards the car, if its sigma allows it: it would be met too soon."""
    way, at_m = ways_aside(0.0, 0.0, SETTINGS), np.array([[14.0, 0.0]])
    way = way.where(np.isclose(way.offset_m, 1.4) & (way.length_m == 14.0) & (way.deceleration_mps2 == 0))
    for sigma_mps, is_clear in ((0.1, True), (3.0, False)):
        thing = Hazards.of(at_m, sigma_mps=np.array([sigma_mps, 0.1]), doubt=0.6)
        assert clear_of_moving(way, thing, 17.0, 8.0, SETTINGS).tolist() == [is_clear]


def test_who_is_on_a_way_round_gets_through_with_half_the_room() -> None:
    """Between two walls 2.4 m apart, what is planned with 0.4 m of room on either side finds no way."""
    decider, free = Decider(TWIN), free_space([])
    decider.decide([], free, None, START_NS, ROAD)
    decider.decide([], free, step(START_NS + 100_000_000), START_NS + 100_000_000, ROAD)
    along = np.arange(2.0, 16.0, 0.2)
    walls = Hazards.of(np.concatenate([np.stack([along, np.full(len(along), side)], 1) for side in (1.25, -1.15)]))
    assert decider._way_round(walls, free, 16.0) is None
    decider._way = straight_on()
    assert decider._way_round(walls, free, 16.0) is not None
    decider._yields_ns = START_NS + 200_000_000  # it braked for who moves, a moment ago
    assert decider._way_round(walls, free, 16.0) is None


def test_what_the_picture_cuts_has_no_velocity_to_be_shy_of() -> None:
    layout, wall = Layout(TWIN, None), Thing(6.0, -4.6, 3.0, (3.0, 0.0), "unknown")
    faces, *_ = layout.faces([obstacle(wall)], free_space([wall]))
    assert (faces.doubt > 0).all()
    assert not faces.sigma_mps.any()
    assert not faces.velocity_mps.any()
    known, ends, _ = layout.faces([obstacle(wall)], free_space([wall]), {wall.id})  # it moved before it came there
    assert known.moves.all()
    assert not ends.any()


def test_on_a_way_round_what_seems_to_move_counts() -> None:
    walker = Hazards.of(np.array([[12.0, -2.5]]), np.array([0.0, 1.5]), sigma_mps=np.array([0.1, 0.9]), doubt=0.6)
    contacts = [find_contact(straight_on(), walker, 8.0, 0.2, SETTINGS, strict=strict) for strict in (False, True)]
    assert [contact is not None for contact in contacts] == [False, True]


@pytest.mark.parametrize(("sigma_mps", "counts"), [(0.4, True), (1.2, False)])
def test_what_seems_to_cross_counts_if_it_would_even_a_sigma_slower(sigma_mps: float, counts: bool) -> None:
    def crosser(x_m: float, y_m: float) -> Hazards:
        sigmas_mps = np.full(2, sigma_mps)
        return Hazards.of(np.array([[x_m, y_m]]), np.array([0.0, 1.5]), sigma_mps=sigmas_mps, doubt=0.6)

    assert (find_contact(straight_on(), crosser(12.0, -2.5), 8.0, 0.2, SETTINGS) is not None) == counts
    assert find_contact(straight_on(), crosser(10.0, -2.2), 8.0, 0.2, SETTINGS) is not None  # no time is left to learn


@pytest.mark.parametrize(("motion", "age_s"), [("moving", 2.0), ("unknown", 0.3)])
def test_what_ends_beside_what_moves_or_may_is_it(motion: str, age_s: float) -> None:
    """Its box is 6 px narrower than its columns: nothing stands there."""
    layout, walker = Layout(TWIN, None), Thing(8.0, -1.0, 0.5, (0.0, 1.5), motion, age_s=age_s)
    o = obstacle(walker)
    narrow = replace(o, box_px=(o.box_px[0] + 6, 100, o.box_px[2] - 6, 250))
    faces, ends, _ = layout.faces([narrow], free_space([walker]))
    assert len(faces.number)
    assert not ends.any()


@pytest.mark.parametrize(("width", "is_hidden"), [(16.0, True), (1.5, False)])
def test_beside_a_mover_no_column_is_of_a_wall(width: float, is_hidden: bool) -> None:
    """A house along the road, in its box up to a cyclist, whose edge ends nearer to the house's range than to his."""
    cyclist, edge = Thing(19.0, 0.3, 0.7, motion="moving", v=(3.0, 0.0)), Thing(21.0, -0.15, 0.2)
    house = replace(obstacle(Thing(21.6, -width / 2, width, id=4)), range_m=21.6)
    faces, *_ = Layout(TWIN, None).faces([obstacle(cyclist), house], free_space([edge, cyclist]))
    assert (4 not in faces.number) == is_hidden


def test_near_by_more_beside_a_mover_is_it() -> None:
    walker, limb = Thing(3.0, 0.0, 0.5, v=(0.0, 1.2), motion="moving"), Thing(3.5, -0.35, 0.18)
    _, ends, _ = Layout(TWIN, None).faces([obstacle(walker)], free_space([walker, limb]), {3})
    assert not ends.any()


def test_a_column_is_of_the_thing_whose_range_it_ends_at() -> None:
    wall, cyclist = Thing(21.5, -4.8, 8.4, id=4), Thing(19.0, -0.4, 0.6, v=(3.0, 0.0), motion="moving")
    beside = Thing(19.7, -0.8, 0.2)  # what the matcher smears, inside the wall's box
    hazards, *_ = Layout(TWIN, None).faces([obstacle(wall), obstacle(cyclist)], free_space([wall, cyclist, beside]))
    at_m = hazards.at_m[hazards.number == 4]
    assert len(at_m) > 10
    assert at_m[:, 1].max() < -0.9


def test_whose_columns_are_all_of_others_is_behind_them() -> None:
    """A row of parked cars was one thing a moment ago; now its columns end at one of them."""
    row, car = Thing(12.0, -5.0, 9.0, coasted_s=0.2, id=4), Thing(11.0, -2.3, 1.5)
    hazards, *_ = Layout(TWIN, None).faces([obstacle(row), obstacle(car)], free_space([car]))
    assert set(hazards.number) == {3}
    hazards, *_ = Layout(TWIN, None).faces([obstacle(row)], free_space([]))
    assert set(hazards.number) == {4}  # what ends no columns has its width


def test_where_sight_ends_nothing_stands() -> None:
    wall = Thing(30.0, -8.0, 12.0)
    seen = free_space([replace(wall, y=-10.0, width=8.0)], reach_m=30.5)
    hazards, *_ = Layout(TWIN, None).faces([obstacle(wall)], seen)
    assert hazards.at_m[:, 1].max() == pytest.approx(-6.0, abs=0.2)


@pytest.mark.parametrize("is_tracked", [False, True])
def test_what_is_new_leaves_no_traces(is_tracked: bool) -> None:
    thing = Thing(15.0, 0.0, 1.6, motion="unknown", is_tracked=is_tracked, age_s=0.2)
    hazards, ends, _ = Layout(TWIN, None).faces([obstacle(thing)], free_space([thing]))
    assert not ends.any()
    assert len(hazards.at_m) > 10 if is_tracked else not len(hazards.at_m)
    _, ends, _ = Layout(TWIN, None).faces([obstacle(replace(thing, is_tracked=True, age_s=1.0))], free_space([thing]))
    assert ends.any()


def test_near_columns_of_no_obstacle_are_less_evidence() -> None:
    """A cloud of steam ends free space in places that change; what stands was seen from further away."""
    post, wall, near, far = Thing(15.0, 2.0, 0.6), Thing(7.0, 4.0, 2.0), Thing(8.0, -2.0, 0.6), Thing(12.0, -2.0, 6.0)
    behind = Thing(9.0, 5.6, 3.0)  # the wall goes on
    seen = free_space([post, wall, near, far, behind])
    _, evidence, _ = Layout(TWIN, None).faces(
        [obstacle(post), replace(obstacle(wall), box_px=(0, 100, 340, 250))], seen
    )
    ends = {8.0: ALONE, 15.0: STANDS_THERE, 12.0: STANDS_THERE, 7.0: STANDS_THERE, 9.0: STANDS_THERE, 40.0: 0}
    assert {z: set(evidence[np.isclose(seen.range_m, z)]) for z in ends} == {z: {n} for z, n in ends.items()}


def test_what_ends_free_space_before_a_house_is_not_the_house() -> None:
    """A cloud in the box of a house that is 30 m long and further away has no face at the house."""
    house, cloud = Thing(17.0, -6.0, 12.0), Thing(9.0, -0.4, 0.6)
    long = replace(obstacle(house), size_m=np.array([12.0, 4.0, 30.0]))
    hazards, *_ = Layout(TWIN, None).faces([long], free_space([replace(house, y=-8.0, width=8.0), cloud]))
    assert hazards.at_m[:, 1].max() < -3.9


def test_a_kerb_that_is_seen_late_changes_the_way() -> None:
    """A way round leads over a kerb that comes into view on it: another one leads past it."""
    free, kerb = (Obeyed([(0.0, Thing(32.0, 1.0, 2.8))], kerb_y=y, kerb_from_s=1.8).run(60) for y in ((), (-2.6,)))
    assert free.right_m < -2.7
    assert kerb.right_m > -2.65  # kerbs are remembered to 0.1 m
    assert kerb.nearest_m > 0


def test_who_is_beside_a_car_that_creeps_on_its_way_goes_first() -> None:
    """Out of view, and for longer than what is in view would be waited for."""
    walker = Thing(3.4, -1.6, 0.5, (-0.9, 0.0), "moving")
    decider, told = Decider(TWIN), []
    for k in range(60):
        t_ns = START_NS + k * 100_000_000
        seen = [obstacle(walker.at(k * FRAME_S))] if k < 6 else []
        told.append(decider.decide(seen, free_space([]), step(t_ns, 0.0) if k else None, t_ns, ROAD))
        if k == 2:
            decider._begin(ways_aside(0.0, 0.0, SETTINGS).only(1))
    waits = [decision.reason.endswith("who is beside goes first") for decision in told]
    assert waits[30]
    assert told[30].action == "brake"
    assert not any(waits[55:])


def test_braking_on_a_way_round_goes_on_for_a_moment() -> None:
    """A wall that is not found for two frames leaves the car no faster."""
    wall = Thing(30.0, 0.0, 12.0, (-1.0, 0.0), "moving", id=4)
    decider = Decider(TWIN)
    drive = Obeyed([(0.0, Thing(30.0, 0.2)), (2.0, wall)], gone_s=(2.25, 2.45)).run(26, decider)
    assert decider._yields_ns > 0  # to who moves
    assert [told.action for told in drive.told[22:26]] == ["brake"] * 4
    assert [told.reason.endswith("but only just") for told in drive.told[22:26]] == [False, True, True, False]
    assert drive.told[24].deceleration_mps2 == drive.told[22].deceleration_mps2 > 3


def test_far_aside_no_way_asks_for_twice_the_room() -> None:
    wide, wider = Thing(24.0, 0.0, 3.4), Thing(24.0, 0.0, 4.4)
    offsets = [next(d.offset_m for d in Drive([t]).run(12).told if d.action == "swerve") for t in (wide, wider)]
    least_m = [t.width / 2 + SETTINGS.width_m / 2 + SETTINGS.margin_m for t in (wide, wider)]
    assert abs(offsets[0]) < 3.0 + 0.01
    assert least_m[1] - 0.1 < abs(offsets[1]) < least_m[1] + 0.3


def test_a_wary_car_gives_more_room_to_what_moves() -> None:
    gone = Hazards.of(np.array([[13.3, -0.9]]), np.array([0.0, 1.5]), sigma_mps=np.array([0.1, 0.3]))  # 1.5 s away
    contacts = [find_contact(straight_on(), gone, 8.0, 0.2, SETTINGS, wary=wary) for wary in (False, True)]
    assert [contact is not None for contact in contacts] == [False, True]
    still = gone._replace(velocity_mps=np.zeros((1, 2)), at_m=np.array([[13.3, -1.2]]))
    assert find_contact(straight_on(), still, 8.0, 0.2, SETTINGS, wary=True) is None


def test_what_moved_for_sure_is_not_doubted_at_once() -> None:
    def first_braked(forgets_s: float) -> int:
        decider, actions = Decider(TWIN), []
        for k in range(22):
            t_s, t_ns = k * FRAME_S, START_NS + k * 100_000_000
            walker = Thing(26.0 - SPEED * t_s, -4.6 + 1.5 * t_s, 0.5, (0.0, 1.5), "moving")
            if t_s >= forgets_s:
                walker = replace(walker, motion="unknown", sigma_mps=0.6)
            actions.append(decider.decide([obstacle(walker)], free_space([]), step(t_ns), t_ns, ROAD).action)
        return actions.index("brake")

    assert first_braked(0.8) < first_braked(0.0)


@pytest.mark.parametrize(("towards_mps", "comes"), [(-1.5, True), (-7.0, False)])
def test_what_may_stand_comes_no_faster_than_people_do(towards_mps: float, comes: bool) -> None:
    """A part of a car behind another, now larger, now smaller, seems to come fast."""
    thing = Thing(18.0, 0.0, v=(towards_mps, 0.0), motion="unknown")
    faces, *_ = Layout(TWIN, None).faces([obstacle(thing)], free_space([thing]))
    assert set(faces.velocity_mps[:, 0]) == {towards_mps if comes else 0.0}
    known, *_ = Layout(TWIN, None).faces([obstacle(replace(thing, motion="moving"))], free_space([thing]))
    assert set(known.velocity_mps[:, 0]) == {towards_mps}


@pytest.mark.parametrize(("shared", "aside_mps"), [(1.0, 0.0), (0.0, 2.0)])
def test_what_comes_no_faster_is_not_carried_aside_either(shared: float, aside_mps: float) -> None:
    """If only its distance seems to change, all of its velocity leads along the view; else it really goes aside."""
    thing = Thing(10.0, -3.0, v=(-6.0, 2.0), motion="unknown")
    seen = obstacle(thing)
    cov = np.array([[4.0, -4.0 / 3 * shared], [-4.0 / 3 * shared, 0.5]])
    seen = replace(seen, track=replace(seen.track, velocity_cov_m2ps2=cov))
    faces, *_ = Layout(TWIN, None).faces([seen], free_space([thing]))
    np.testing.assert_allclose(faces.likely_mps, aside_mps, atol=1e-9)


@pytest.mark.parametrize("is_bend", [True, False])
def test_no_swerve_begins_before_a_road_that_bends(is_bend: bool) -> None:
    """A rail along the right leads across the way ahead: the car is to turn. It is not if that part stands alone."""
    rail = [Thing(x, -4.0 + 4.0 * max(0.0, (x - 12) / 12) ** 2, 0.4) for x in np.arange(3.0, 34.0, 0.25)]
    decider, actions = Decider(TWIN), []
    for k in range(8):
        gone_m, t_ns = SPEED * FRAME_S * k, START_NS + round(1e9 * FRAME_S * k)
        ahead = [replace(t, x=t.x - gone_m) for t in rail if t.x > gone_m + 1.5 and (is_bend or t.y > -2.0)]
        whole = replace(obstacle(Thing(20.0 - gone_m, 0.0, 1.6)), box_px=(0, 100, 1240, 250))
        actions.append(decider.decide([whole], free_space(ahead), step(t_ns), t_ns, ROAD).action)
    assert ("swerve" in actions) != is_bend


def test_what_ends_no_columns_is_as_wide_as_its_box() -> None:
    """A wall along the road whose near end was measured: its width, all that is known of it, leads into the road."""
    wall = obstacle(Thing(20.0, -6.0, 4.0))
    wall = replace(wall, size_m=np.array([19.0, 3.0, 35.0]), position_m=np.array([20.0, -3.3, 0.0]))
    faces, *_ = Layout(TWIN, None).faces([wall], free_space([], reach_m=12.0))
    assert len(faces.at_m) > 10
    np.testing.assert_allclose(faces.at_m[:, 0], 20.0)
    np.testing.assert_allclose([faces.at_m[:, 1].min(), faces.at_m[:, 1].max()], [-8.0, -4.0], atol=0.05)


@pytest.mark.parametrize(
    ("thing", "is_kept"),
    [
        (Thing(6.0, 1.0, v=(-1.0, 0.0), motion="moving"), True),
        (Thing(6.0, 1.0, v=(-1.0, 0.0), motion="moving", age_s=0.5, coasted_s=0.1), False),
        (Thing(6.0, 5.0, v=(-1.0, 0.0), motion="moving"), False),
        (Thing(6.0, -0.3, v=(-1.0, 0.0), motion="moving"), False),
    ],
)
def test_what_moved_is_remembered_if_it_was_seen_whole(thing: Thing, is_kept: bool) -> None:
    """A part at the picture's side, or of something behind a post, or seen too shortly, does not move for sure yet."""
    decider, post = Decider(TWIN), Thing(4.0, -0.55)
    decider.decide([obstacle(thing)], free_space([thing, post]), step(START_NS), START_NS, ROAD)
    assert (len(decider._movers.number) > 0) == is_kept


def test_the_likely_way_of_who_moves_for_sure_needs_no_certainty() -> None:
    thing = Thing(12.0, 1.0, v=(-1.4, 0.25), motion="moving", sigma_mps=0.3)
    for movers, aside_mps in ((set(), 0.0), ({3}, 0.25)):
        faces, *_ = Layout(TWIN, None).faces([obstacle(thing)], free_space([thing]), movers)
        assert set(faces.likely_mps) == {aside_mps}
