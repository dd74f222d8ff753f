"""Drives that ask for something: what the car meets on a straight road at 30 km/h, by name; a seed draws the rest."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from roadblock.geometry.pose import pose
from roadblock.sim.road import Mark, Road, pose_on
from roadblock.sim.scene import Scene, on_road, roadside
from roadblock.sim.scenes import (
    AWAY,
    KMH,
    LEFTWARDS,
    RIGHTWARDS,
    STREET,
    TOWARDS,
    ZEBRA,
    Stand,
    furnished,
    paper,
    stood,
    to_sun,
)
from roadblock.sim.solids import Thing, box, moved, placed
from roadblock.sim.steam import steam
from roadblock.sim.things import SIGNS, Order, bridge, railing, tree
from roadblock.sim.things.colors import STEEL
from roadblock.values.checks import FloatArray

LANE_M = -0.6
"""Middle of the own lane."""
SPEED_MPS = 30 * KMH
KERB_M = 0.12
"""Every road ends at kerbs: an edge that is only painted is not seen."""
RAIL_M = 4.0
"""Length of one part of a guard rail."""
PASSAGE_M = 4.5
"""Between two cars that stand on both sides."""


@dataclass(frozen=True, eq=False)
class Challenge:
    """A drive.

    Attributes
    ----------
    scene
        The world when it begins.
    start_m
        Where the cameras begin: along and to the left.
    length_m
        The drive ends after so much way.
    brakes_s, brakes_mps2
        When what moves begins to brake, and how hard; infinity = never.
    goes_on
        Whether what is ahead goes on by itself: to stand behind it is to drive on.
    speed_mps
        How fast the driver drives.
    """

    scene: Scene
    start_m: tuple[float, float] = (0.0, LANE_M)
    length_m: float = 60.0
    brakes_s: float = float("inf")
    brakes_mps2: float = 4.0
    goes_on: bool = False
    speed_mps: float = SPEED_MPS

    def things_at(self, t_s: float) -> tuple[Thing, ...]:
        """Return all things after so many seconds."""
        return tuple(self.thing_at(thing, t_s) if thing.velocity_mps.any() else thing for thing in self.scene.things)

    def clouds_at(self, t_s: float) -> tuple[Thing, ...]:
        """Return all clouds after so many seconds."""
        return tuple(moved(cloud, t_s) for cloud in self.scene.clouds)

    def thing_at(self, thing: Thing, t_s: float) -> Thing:
        """Return one of the scene's things after so many seconds, if it moves."""
        v, braking_s = float(np.linalg.norm(thing.velocity_mps)), max(0.0, t_s - self.brakes_s)
        there = moved(thing, self._gone_s(v, t_s))
        return replace(there, velocity_mps=there.velocity_mps * max(0.0, 1 - self.brakes_mps2 * braking_s / v))

    def way_m(self, thing: Thing, t_s: float) -> FloatArray:
        """Return (2,) how far it has got."""
        v = thing.velocity_mps[:2]
        return np.asarray(v * self._gone_s(float(np.linalg.norm(v)), t_s))

    def _gone_s(self, speed_mps: float, t_s: float) -> float:
        """Return how long it would take to get as far without braking."""
        braked = min(max(0.0, t_s - self.brakes_s), speed_mps / self.brakes_mps2)
        return min(t_s, self.brakes_s) + braked - self.brakes_mps2 * braked**2 / (2 * speed_mps)


def _street(seed: int, stands: tuple[Stand, ...], road: Road | None = None) -> Scene:
    base = paper(seed)
    road = road or Road(kerb_m=KERB_M)
    scenery = tuple(_beside(thing, road) for thing in roadside(np.random.default_rng([seed, 21])))
    return replace(base, things=furnished(road, stands, seed) + scenery, road=road, speed_mps=0.0)


def _beside(thing: Thing, road: Road) -> Thing:
    """Return a house or a tree that stands beside the default road as far beside another one."""
    further_m = road.left_m - Road().left_m if thing.T_world_thing[1, 3] > 0 else road.right_m - Road().right_m
    T = pose(np.eye(3), [0.0, further_m, 0.0]) @ thing.T_world_thing
    if road.curvature_per_m:
        x, y, z = T[:3, 3]
        flat = replace(road, kerb_m=0.0)
        T = pose_on(flat, x, y, upright=True) @ pose(T[:3, :3], [0.0, 0.0, z])
    return replace(thing, T_world_thing=T)


def _rng(seed: int, number: int) -> np.random.Generator:
    return np.random.default_rng([seed, 22, number])


def _paper(seed: int) -> Challenge:
    scene = paper(seed)
    return Challenge(replace(scene, speed_mps=0.0, road=replace(scene.road, kerb_m=KERB_M)), (-22.0, 0.0), 62.0)


def _standing(seed: int) -> Challenge:
    rng = _rng(seed, 1)
    order = Order("person", 0, color=str(rng.choice(["blue", "red", "green"])))
    stand = Stand(order, rng.uniform(28, 40), LANE_M + rng.uniform(-0.6, 0.6), rng.uniform(-180, 180))
    return Challenge(_street(seed, (stand,)))


def _crossing(seed: int) -> Challenge:
    rng = _rng(seed, 2)
    ahead, speed = rng.uniform(30, 40), rng.uniform(1.0, 1.8)
    side = float(rng.choice([-1, 1]))
    away = speed * (ahead / SPEED_MPS + rng.uniform(-0.5, 0.5))
    order = Order("person", 0, model=str(rng.choice(["adult", "child"])), walking=True)
    stand = Stand(order, ahead, LANE_M + side * away, RIGHTWARDS if side > 0 else LEFTWARDS, speed)
    return Challenge(_street(seed, (stand,)))


def _walking(seed: int) -> Challenge:
    rng = _rng(seed, 3)
    yaw = float(rng.choice([AWAY, TOWARDS]))
    stand = Stand(Order("person", 0, walking=True), rng.uniform(28, 36), LANE_M + rng.uniform(-0.7, 0.7), yaw, 1.3)
    return Challenge(_street(seed, (stand,)), goes_on=yaw == AWAY)


def _bicycle(seed: int) -> Challenge:
    rng = _rng(seed, 4)
    stand = Stand(
        Order("cyclist", 0), rng.uniform(16, 26), LANE_M + rng.uniform(-0.6, 0.3), AWAY, rng.uniform(3.0, 5.0)
    )
    return Challenge(_street(seed, (stand,)), goes_on=True)


def _stopped(seed: int) -> Challenge:
    rng = _rng(seed, 5)
    model = str(rng.choice(["small", "medium", "large", "saloon"]))
    stand = Stand(Order("car", 0, model=model), rng.uniform(32, 42), LANE_M + rng.uniform(-0.3, 0.1))
    return Challenge(_street(seed, (stand,)), goes_on=True)


def _braking(seed: int) -> Challenge:
    rng = _rng(seed, 6)
    stand = Stand(Order("car", 0), rng.uniform(14, 18), LANE_M, AWAY, SPEED_MPS)
    return Challenge(_street(seed, (stand,)), brakes_s=1.0, brakes_mps2=rng.uniform(2, 5), goes_on=True)


def _cargo(seed: int) -> Challenge:
    rng = _rng(seed, 7)
    size = rng.uniform(0.4, 0.7)
    order = Order("box", 0, model="crate", length_m=size, width_m=size, height_m=size)
    if rng.random() < 0.3:
        order = Order("tyre", 0, model="standing")
    stand = Stand(order, rng.uniform(28, 38), LANE_M + rng.uniform(-0.6, 0.6), rng.uniform(-60, 60))
    return Challenge(_street(seed, (stand,)))


def _fork(seed: int) -> Challenge:
    rng = _rng(seed, 8)
    road = Road(-7.0, 7.0, kerb_m=KERB_M, marks=(Mark("gore", 28.0, 0.0, 8.0, 1.1),))
    stand = Stand(Order("fork", 0, length_m=12.0), rng.uniform(36, 40), rng.uniform(-0.4, 0.4))
    return Challenge(_street(seed, (stand,), road), (0.0, 0.0), 62.0)


def _parked(seed: int) -> Challenge:
    rng = _rng(seed, 9)
    road = replace(STREET, marks=())
    models = rng.choice(["small", "medium", "large", "saloon"], 4)
    stands = tuple(
        Stand(Order("car", 0, model=str(model)), 15.0 + 6.5 * i + rng.uniform(-0.4, 0.4), rng.uniform(-3.4, -3.1))
        for i, model in enumerate(models)
    )
    return Challenge(_street(seed, stands, road), length_m=50.0)


def _empty(seed: int) -> Challenge:
    rng = _rng(seed, 10)
    marks = (
        Mark("manhole", rng.uniform(8, 40), LANE_M, 0.7, 0.7),
        Mark("patch", rng.uniform(15, 45), LANE_M, 4.0, 1.6),
    )
    zebra = replace(ZEBRA, along_m=rng.uniform(20, 40))
    road = replace(STREET, marks=(*marks, Mark("arrow", 15.0, LANE_M, 4.0, 0.9), zebra))
    return Challenge(_street(seed, (), road), length_m=50.0)


def _with(scene: Scene, *things: Thing) -> Scene:
    return replace(scene, things=scene.things + things)


def _shadows(seed: int) -> Challenge:
    rng = _rng(seed, 11)
    side = int(rng.choice([-1, 1]))
    road = Road(kerb_m=KERB_M)
    edge = road.left_m if side > 0 else road.right_m
    ahead = rng.uniform(12, 16)
    beside = (
        Order("wall", 0, width_m=14.0, height_m=rng.uniform(1.8, 2.6)),
        Order("railing", 0, length_m=14.0, height_m=1.2),
    )[rng.integers(2)]
    stand = Stand(beside, ahead, edge + 0.7 * side, LEFTWARDS if beside.type == "wall" else AWAY)
    trees = [
        on_road(tree((76, 112, 50), rng.uniform(5.5, 8.5), rng), road, x, edge + side * rng.uniform(2.5, 4.5))
        for x in np.arange(ahead + 2, 48, 7) + rng.uniform(-2, 2)
    ]
    scene = replace(
        _with(_street(seed, (stand,), road), *trees),
        towards_sun=to_sun(side * rng.uniform(60, 120), 18 + 14 * rng.random()),
    )
    return Challenge(scene, length_m=50.0)


def _bridge(seed: int) -> Challenge:
    rng = _rng(seed, 12)
    road = Road(kerb_m=KERB_M)
    over = bridge(rng.uniform(6, 12), road.left_m - road.right_m + 1.0, 4.5, has_piers=bool(rng.integers(2)))
    over = on_road(over, road, rng.uniform(18, 26), (road.left_m + road.right_m) / 2)
    scene = replace(_with(_street(seed, (), road), over), towards_sun=to_sun(rng.uniform(60, 300), rng.uniform(45, 65)))
    return Challenge(scene, length_m=50.0)


def _steam(seed: int) -> Challenge:
    rng = _rng(seed, 13)
    along, left = rng.uniform(20, 32), LANE_M + rng.uniform(-0.5, 0.5)
    cloud = steam(rng)
    cloud = replace(cloud, T_world_thing=pose(np.eye(3), [along + 0.35, left, 0.0]))
    road = Road(kerb_m=KERB_M, marks=(Mark("manhole", along, left, 0.7, 0.7),))
    return Challenge(replace(_street(seed, (), road), clouds=(cloud,)), length_m=50.0)


def _between(seed: int) -> Challenge:
    # Two standing cars, their rears in line: the car passes in the middle.
    rng = _rng(seed, 14)
    stands = []
    for number, side in enumerate((-1, 1), 1):
        order = Order("car", 0, model=str(rng.choice(["small", "medium", "large", "saloon"])))
        half = float(stood(Stand(order, 0.0, 0.0), number, STREET, seed).size_m[0]) / 2
        stands.append(Stand(order, 60.0, LANE_M + side * (PASSAGE_M / 2 + half)))
    return Challenge(
        _street(seed, tuple(stands), replace(STREET, marks=())), length_m=75.0, goes_on=True, speed_mps=50 * KMH
    )


def _signs(seed: int) -> Challenge:
    # A steel plate and a manhole in the lane, signs at the kerbs, and one that hangs over the road.
    rng = _rng(seed, 15)
    road = Road(kerb_m=KERB_M, marks=(Mark("manhole", rng.uniform(10, 16), LANE_M, 0.7, 0.7),))
    steel, blue = (118, 120, 124), (28, 70, 160)
    plate = Thing(0, "plate", "grey", (box((2.4, 1.6, 0.02), (0, 0, 0.01), steel, 0.04),))
    over = box((0.1, 5.0, 1.6), (0, 0, 5.3), blue, 0.05), box((0.2, 12.0, 0.25), (0.2, 0, 6.2), steel, 0.1)
    posts = tuple(box((0.25, 0.25, 6.2), (0.2, y, 3.1), steel, 0.1) for y in (-5.5, 5.5))
    middle = (road.left_m + road.right_m) / 2
    gantry = on_road(Thing(0, "gantry", "blue", over + posts), road, rng.uniform(30, 36), middle)
    stands = [
        Stand(Order("pole", 0, model=str(rng.choice(SIGNS))), rng.uniform(low, low + 4), left, TOWARDS)
        for low, left in ((12, road.right_m - 0.5), (22, road.left_m + 0.5), (34, road.right_m - 0.5))
    ]
    return Challenge(
        _with(_street(seed, tuple(stands), road), placed(plate, rng.uniform(18, 26), LANE_M), gantry), length_m=50.0
    )


def _bend(seed: int) -> Challenge:
    # A bend with a guard rail along its outer side, behind which, straight ahead, a car is parked.
    rng = _rng(seed, 16)
    side = int(rng.choice([-1, 1]))
    road = Road(kerb_m=KERB_M, curvature_per_m=side / rng.uniform(60, 150), curve_from_m=rng.uniform(14, 22))
    edge = road.right_m if side > 0 else road.left_m
    car = Stand(Order("car", 0), road.curve_from_m + rng.uniform(14, 22), edge - side * rng.uniform(2.5, 3.5))
    rails = [
        on_road(railing(0, "grey", STEEL, RAIL_M, 0.8, bars=False), road, x, edge - 0.6 * side)
        for x in np.arange(road.curve_from_m - 4, 70, RAIL_M)
    ]
    return Challenge(_with(_street(seed, (car,), road), *rails), length_m=60.0)


CHALLENGES: dict[str, Callable[[int], Challenge]] = {
    "paper": _paper,
    "standing": _standing,
    "crossing": _crossing,
    "walking": _walking,
    "bicycle": _bicycle,
    "stopped": _stopped,
    "braking": _braking,
    "cargo": _cargo,
    "fork": _fork,
    "parked": _parked,
    "empty": _empty,
    "shadows": _shadows,
    "bridge": _bridge,
    "steam": _steam,
    "signs": _signs,
    "between": _between,
    "bend": _bend,
}
"""What a drive can meet: seed -> Challenge."""

GRID_KMH = (10, 20, 30, 40, 50, 60)
FAR_S = 4.5
"""A target of the grid is so far ahead."""


def _target(kind: str, speed_kmh: int) -> Callable[[int], Challenge]:
    """Return a cell of the grid: one target in the middle of the lane, hit in the middle if nothing is done."""

    def challenge(seed: int) -> Challenge:
        v = speed_kmh * KMH
        ahead = max(25.0, FAR_S * v)
        stand = {
            "car standing": Stand(Order("car", 0), ahead, LANE_M),
            "car at 20 km/h": Stand(Order("car", 0), max(20.0, FAR_S * (v - 20 * KMH)), LANE_M, AWAY, 20 * KMH),
            "person crossing at 5 km/h": _crosser("person", ahead, v, 5 * KMH),
            "bicycle crossing at 15 km/h": _crosser("cyclist", ahead, v, 15 * KMH),
        }[kind]
        return Challenge(_street(seed, (stand,)), length_m=ahead + 25.0, goes_on=True, speed_mps=v)

    return challenge


def _crosser(kind: str, ahead_m: float, own_mps: float, speed_mps: float) -> Stand:
    away_m = speed_mps * (ahead_m - FRONT_M) / own_mps
    return Stand(Order(kind, 0, walking=kind == "person"), ahead_m, LANE_M - away_m, LEFTWARDS, speed_mps)


FRONT_M = 1.3
"""From the cameras to the front of the car."""
_TARGETS = ("car standing", "car at 20 km/h", "person crossing at 5 km/h", "bicycle crossing at 15 km/h")
GRID: dict[str, Callable[[int], Challenge]] = {
    f"grid {kind} {speed}": _target(kind, speed)
    for kind in _TARGETS
    for speed in GRID_KMH
    if kind != "car at 20 km/h" or speed > 20
}
"""Targets as in UN R152 and Euro NCAP, at 10 to 60 km/h."""
_KNOWN_KMH = {10: 0.0, 20: 0.0, 30: 0.0, 40: 0.0, 50: 25.0, 60: 35.0}
ALLOWED_KMH: dict[str, float | None] = {
    name: _KNOWN_KMH[int(name.rsplit(" ", 1)[1])] if "standing" in name or "person" in name else None for name in GRID
} | {"grid person crossing at 5 km/h 10": None}
"""Relative impact speed that UN R152 allows a car of class M1 in running order (people: 01 series).

From the informal working group's draft AEBS-08-07 for people, its second step, in which 50 and 60 km/h stand in
brackets; GRVA-04-10 says of the 01 series that the same is allowed for people and for cars. None where it is not known
here for sure, or nothing is required (people below 20 km/h).
"""
