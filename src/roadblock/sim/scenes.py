"""Ready scenes by name. A seed draws looks, small moves, textures and sky; what a scene is about stays."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from roadblock.sim.road import Line, Mark, Road
from roadblock.sim.scene import Scene, camera_pose, demo_street, on_road, roadside
from roadblock.sim.solids import Thing, going
from roadblock.sim.things import Order, build, street_lamp, tree
from roadblock.values.checks import FloatArray

KMH = 1 / 3.6
"""m/s."""

AWAY, TOWARDS, LEFTWARDS, RIGHTWARDS = 0.0, 180.0, 90.0, -90.0
"""Which way something faces, degrees to the left of the road's direction."""


class Stand(NamedTuple):
    """Something ordered, and where it stands.

    Attributes
    ----------
    order
        What; its number is given by its place in the scene.
    nearest_m, left_m, yaw_deg
        As in `on_road`, but degrees.
    speed_mps
        How fast it goes where it faces; along a bent road if it faces along it.
    """

    order: Order
    nearest_m: float
    left_m: float
    yaw_deg: float = AWAY
    speed_mps: float = 0.0


def stood(stand: Stand, number: int, road: Road, seed: int) -> Thing:
    """Return the ordered thing on its place; `seed` and number are added to its own seed.

    Raises
    ------
    ValueRefusedError
        As `build`.
    """
    drawn = replace(stand.order, number=number, seed=stand.order.seed + 1000 * seed + number)
    yaw = np.radians(stand.yaw_deg)
    thing = on_road(build(drawn), road, stand.nearest_m, stand.left_m, yaw)
    curvature = road.curvature_per_m if stand.nearest_m >= road.curve_from_m else 0.0
    return going(thing, stand.speed_mps, float(stand.speed_mps * np.cos(yaw) * curvature))


def furnished(road: Road, stands: Iterable[Stand], seed: int) -> tuple[Thing, ...]:
    """Return the ordered things on their places, numbered from 1 (see `stood`)."""
    return tuple(stood(stand, number, road, seed) for number, stand in enumerate(stands, 1))


def _varied(stands: Iterable[Stand], rng: np.random.Generator) -> list[Stand]:
    """Return the stands a little aside, along and turned."""
    varied = []
    for stand in stands:
        ahead, left, turn = rng.uniform(-1, 1, 3) * (0.4, 0.15, 5.0)
        moved = (stand.nearest_m + ahead, stand.left_m + left, stand.yaw_deg + turn)
        varied.append(stand._replace(nearest_m=moved[0], left_m=moved[1], yaw_deg=moved[2]))
    return varied


def to_sun(azimuth_deg: float, elevation_deg: float) -> FloatArray:
    """Return the (3,) unit vector to the sun in the world; its azimuth is to the left of the road's direction."""
    azimuth, elevation = np.radians([azimuth_deg, elevation_deg])
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def _scene(
    seed: int,
    stands: Iterable[Stand],
    road: Road,
    speed_mps: float,
    scenery: tuple[Thing, ...] = (),
    conditions: tuple[str, ...] = (),
) -> Scene:
    """Return a scene, its sun drawn from the seed: mid-morning to mid-afternoon, not right ahead."""
    rng = np.random.default_rng([seed, 7])
    sun = to_sun(rng.uniform(60, 300), rng.uniform(30, 60))
    things = furnished(road, _varied(stands, rng), seed) + scenery
    return Scene(things, road, camera_pose(), sun, seed, speed_mps, conditions=conditions)


def paper(seed: int = 0) -> Scene:
    """Return the paper's experiment (table 2): person, bicycle and fork at 5, 10 and 20 m, at 30 km/h in daylight.

    Their nearest points lie exactly there; with `paper_rig` nothing hides anything, and all is seen whole. The seed
    draws looks, the side the person faces, sun, sky and textures.
    """
    rng = np.random.default_rng([seed, 5])
    stands = (
        Stand(Order("person", 0, color="blue"), 5.0, rng.uniform(1.15, 1.35), TOWARDS + rng.uniform(-40, 40)),
        Stand(Order("bicycle", 0, color="red"), 10.0, rng.uniform(-2.5, -2.2), LEFTWARDS + rng.uniform(-8, 8)),
        Stand(Order("fork", 0, color="yellow"), 20.0, 0.0),
    )
    lines = (Line(-4.5), Line(4.5), Line(0.0, gap_m=4.5))
    road = Road(-4.8, 4.8, lines, marks=(Mark("gore", 11.0, 0.0, 9.0, 1.1),))
    scene = _scene(seed, (), road, 30 * KMH, _avenue(rng, road))
    return replace(scene, things=furnished(road, stands, seed) + scene.things)


def _avenue(rng: np.random.Generator, road: Road) -> tuple[Thing, ...]:
    """Draw trees in two rows well beside and behind what a scene is about."""
    trees = []
    for side, edge in ((1, road.left_m), (-1, road.right_m)):
        for ahead in (36.0, 52.0, 70.0, 95.0):
            crown = (int(rng.integers(62, 90)), int(rng.integers(100, 126)), int(rng.integers(40, 62)))
            left = edge + side * rng.uniform(2.5, 5.0)
            trees.append(on_road(tree(crown, rng.uniform(5.5, 8.5), rng), road, ahead + rng.uniform(-3, 3), left))
    return tuple(trees)


STREET = Road(
    -5.3,
    5.6,
    (Line(-3.1, 0.1, 1.0, 1.0), Line(1.7, gap_m=4.5), Line(5.35)),
    kerb_m=0.12,
    marks=(
        Mark("manhole", 7.0, 0.4, 0.7, 0.7),
        Mark("patch", 11.0, -1.2, 4.0, 1.6),
        Mark("manhole", 21.0, 2.9, 0.7, 0.7),
    ),
)
"""A lane of parked cars, one lane each way, kerbs."""

CITY = (
    Stand(Order("car", 0, color="blue", model="large"), 8.0, -4.2),
    Stand(Order("car", 0, color="white", model="small"), 14.0, -4.2),
    Stand(Order("van", 0, color="white"), 20.0, -4.2),
    Stand(Order("car", 0, color="red", model="saloon"), 26.0, -0.7, AWAY, 30 * KMH),
    Stand(Order("cyclist", 0, color="orange"), 13.0, -2.2, AWAY, 5.0),
    Stand(Order("car", 0, color="silver"), 30.0, 3.5, TOWARDS, 40 * KMH),
    Stand(Order("person", 0, color="green", walking=True), 13.5, 6.9, TOWARDS, 1.4),
    Stand(Order("person", 0, model="child", color="yellow", walking=True), 14.2, 6.2, TOWARDS, 1.4),
    Stand(Order("bicycle", 0, color="green"), 12.5, -6.6, 80.0),
    Stand(Order("pole", 0, model="round", color="red"), 16.0, -6.2, TOWARDS),
    Stand(Order("person", 0, color="purple"), 18.0, -6.4, LEFTWARDS),
)

COUNTRY = (
    Stand(Order("railing", 0, model="beams", length_m=16.0), 9.0, -4.0),
    Stand(Order("hedge", 0, length_m=12.0, width_m=1.1, height_m=1.5), 10.0, 6.9),
    Stand(Order("truck", 0, color="green"), 32.0, 3.5, TOWARDS, 60 * KMH),
    Stand(Order("cyclist", 0, color="red"), 16.0, -1.9, AWAY, 6.0),
    Stand(Order("pole", 0, model="triangle", color="red"), 13.0, -4.6, TOWARDS),
    Stand(Order("wall", 0, width_m=5.0, height_m=1.2), 34.0, -7.5),
    Stand(Order("pole", 0, height_m=5.5), 24.0, 6.2),
)

FORK = (
    Stand(Order("fork", 0, length_m=14.0), 18.0, 0.0),
    Stand(Order("cone", 0), 12.0, 1.2),
    Stand(Order("cone", 0), 12.5, -1.2),
    Stand(Order("car", 0, color="black", model="saloon"), 27.0, 4.4, 9.0, 50 * KMH),
    Stand(Order("van", 0, color="orange"), 31.0, -4.8, -9.0, 50 * KMH),
    Stand(Order("railing", 0, model="beams", length_m=14.0), 12.0, -7.4),
)

DEBRIS = (
    Stand(Order("box", 0, length_m=0.3, width_m=0.35, height_m=0.25), 7.0, -0.6, 20.0),
    Stand(Order("stone", 0, length_m=0.12), 6.0, 0.7),
    Stand(Order("stone", 0, length_m=0.3), 11.0, 0.8),
    Stand(Order("tyre", 0), 14.0, -1.1, 30.0),
    Stand(Order("box", 0, length_m=0.2, width_m=0.15, height_m=0.1), 9.0, -1.6, 50.0),
    Stand(Order("tyre", 0, model="standing"), 19.0, 0.2, 70.0),
    Stand(Order("stone", 0, length_m=0.05), 5.0, -0.3),
    Stand(Order("box", 0, model="crate", color="brown", length_m=0.3, width_m=0.3, height_m=0.3), 24.0, -0.5, 10.0),
    Stand(Order("cone", 0, height_m=0.5), 17.0, 2.2),
)

CROSSING = (
    Stand(Order("person", 0, color="red", walking=True), 13.0, -1.8, LEFTWARDS, 1.4),
    Stand(Order("person", 0, color="blue", model="child", walking=True), 13.8, -2.4, LEFTWARDS, 1.4),
    Stand(Order("person", 0, color="green"), 13.0, 6.3, RIGHTWARDS),
    Stand(Order("cyclist", 0, color="yellow"), 22.0, 2.6, RIGHTWARDS, 3.0),
    Stand(Order("car", 0, color="silver"), 19.0, 3.6, TOWARDS),
    Stand(Order("pole", 0, model="square", color="blue"), 11.5, -6.2, TOWARDS),
)

PARKED = (
    Stand(Order("car", 0, color="red", model="small"), 5.5, -4.2),
    Stand(Order("car", 0, color="silver"), 10.5, -4.2),
    Stand(Order("person", 0, color="yellow", model="child", walking=True), 15.4, -3.3, LEFTWARDS, 1.5),
    Stand(Order("car", 0, color="black", model="saloon"), 17.0, -4.2),
    Stand(Order("van", 0, color="blue"), 23.0, -4.2),
    Stand(Order("car", 0, color="white", model="large"), 9.0, 4.5, TOWARDS),
    Stand(Order("car", 0, color="green", model="small"), 15.0, 4.5, TOWARDS),
    Stand(Order("truck", 0, color="orange"), 21.0, 4.3, TOWARDS),
)

RAILING = (
    Stand(Order("railing", 0, color="silver", length_m=8.0), 6.0, -3.9),
    Stand(Order("railing", 0, color="green", length_m=10.0, height_m=1.2), 16.0, -3.9),
    Stand(Order("railing", 0, model="beams", length_m=20.0), 7.0, 6.4),
    Stand(Order("railing", 0, color="red", length_m=3.0), 22.0, 1.0, LEFTWARDS),
    Stand(Order("person", 0, color="blue"), 14.0, -5.2, LEFTWARDS),
)

HILL = (
    Stand(Order("car", 0, color="red"), 38.0, -0.7, AWAY, 30 * KMH),
    Stand(Order("person", 0, color="green"), 24.0, -3.8, TOWARDS),
    Stand(Order("truck", 0, color="blue"), 55.0, 3.6, TOWARDS, 30 * KMH),
    Stand(Order("cyclist", 0, color="yellow"), 17.0, -2.0, AWAY, 3.0),
    Stand(Order("hedge", 0, length_m=10.0, width_m=1.0), 20.0, 7.0),
)

CURVE = (
    Stand(Order("car", 0, color="silver", model="saloon"), 22.0, -0.7, AWAY, 30 * KMH),
    Stand(Order("car", 0, color="blue", model="large"), 30.0, 3.5, TOWARDS, 30 * KMH),
    Stand(Order("railing", 0, model="beams", length_m=6.0), 14.0, -3.9),
    Stand(Order("railing", 0, model="beams", length_m=6.0), 20.2, -3.9),
    Stand(Order("railing", 0, model="beams", length_m=6.0), 26.4, -3.9),
    Stand(Order("pole", 0, model="triangle", color="red"), 12.0, -4.6, TOWARDS),
    Stand(Order("bicycle", 0, color="red"), 18.0, -2.5, 60.0),
)

ZEBRA = Mark("zebra", 12.5, 0.15, 3.0, 10.9)


def _city(seed: int, conditions: tuple[str, ...] = ()) -> Scene:
    lamps = [on_road(street_lamp((120, 124, 128)), STREET, x, 7.8, -np.pi / 2) for x in (18.0, 44.0, 70.0)]
    scenery = (*lamps, *roadside(np.random.default_rng(seed)))
    return _scene(seed, CITY, STREET, 30 * KMH, scenery, conditions)


def _country(seed: int, conditions: tuple[str, ...] = ()) -> Scene:
    road = Road(crown_per_m=0.003)
    return _scene(seed, COUNTRY, road, 60 * KMH, _avenue(np.random.default_rng(seed), road), conditions)


def _fork(seed: int) -> Scene:
    lines = (Line(-6.7), Line(6.7), Line(0.0, gap_m=4.5))
    road = Road(-7.0, 7.0, lines, marks=(Mark("gore", 8.0, 0.0, 10.0, 1.1), Mark("arrow", 5.0, -3.4, 4.0, 0.9)))
    return _scene(seed, FORK, road, 50 * KMH, _avenue(np.random.default_rng(seed), road))


def _debris(seed: int) -> Scene:
    road = Road(marks=(Mark("patch", 9.5, -0.8, 5.0, 1.4), Mark("manhole", 6.5, 1.3, 0.7, 0.7)))
    return _scene(seed, DEBRIS, road, 40 * KMH, roadside(np.random.default_rng(seed)))


def _crossing(seed: int) -> Scene:
    road = replace(STREET, marks=(*STREET.marks[:1], ZEBRA))
    return _scene(seed, CROSSING, road, 20 * KMH, roadside(np.random.default_rng(seed)))


def _parked(seed: int) -> Scene:
    return _scene(seed, PARKED, STREET, 30 * KMH, roadside(np.random.default_rng(seed)))


def _railing(seed: int) -> Scene:
    return _scene(seed, RAILING, Road(), 30 * KMH, roadside(np.random.default_rng(seed)))


def _empty(seed: int) -> Scene:
    return _scene(
        seed, (), replace(STREET, marks=(*STREET.marks, Mark("arrow", 15.0, -0.7, 4.0, 0.9), ZEBRA)), 30 * KMH
    )


def _hill(seed: int) -> Scene:
    road = Road(grade=0.09, grade_from_m=12.0, grade_over_m=25.0)
    return _scene(seed, HILL, road, 30 * KMH, _avenue(np.random.default_rng(seed), road))


def _curve(seed: int) -> Scene:
    road = Road(curvature_per_m=1 / 70, curve_from_m=8.0, bank=-0.02)
    return _scene(seed, CURVE, road, 30 * KMH, _avenue(np.random.default_rng(seed), road))


SCENES: dict[str, Callable[[int], Scene]] = {
    "demo": demo_street,
    "paper": paper,
    "city": _city,
    "country": _country,
    "fork": _fork,
    "debris": _debris,
    "crossing": _crossing,
    "parked": _parked,
    "railing": _railing,
    "empty": _empty,
    "hill": _hill,
    "curve": _curve,
    "dusk": lambda seed: _country(seed, ("dusk",)),
    "night": lambda seed: _city(seed, ("night",)),
    "rain": lambda seed: _city(seed, ("rain",)),
    "fog": lambda seed: _country(seed, ("fog",)),
}
"""Ready scenes: seed -> Scene."""
