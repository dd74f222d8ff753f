"""Families of shapes that things of every type come in; `recognition_world.py` says what they are for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Rgb, Thing, box, capsule, carried, cone, cylinder, ellipsoid, xyz
from roadblock.sim.things import (
    CARS,
    COLORS,
    Order,
    bicycle,
    build,
    car,
    cyclist,
    fork,
    house,
    person,
    railing,
    shaded,
    street_lamp,
    tree,
)
from roadblock.sim.things.vehicles import CarShape

Rng = np.random.Generator
Family = Callable[[Rng, str, Rgb], Thing]
GLASS: Rgb = (24, 30, 36)
STEEL: Rgb = (150, 154, 158)
CONCRETE: Rgb = (168, 164, 156)
BODY = tuple(COLORS)
"""Colours that bodies come in."""


def whole(rng: Rng, thing: Thing, spread: float = 0.1) -> Thing:
    """Return the thing up to so much larger or smaller."""
    factor = rng.uniform(1 - spread, 1 + spread)
    parts = [
        replace(p, T_thing_part=pose(p.T_thing_part[:3, :3], factor * p.T_thing_part[:3, 3]), half_m=factor * p.half_m)
        for p in thing.parts
    ]
    return Thing(1, thing.type, thing.color, tuple(parts))


def ordered(kind: str, **more: object) -> Family:
    """Return a family that is ordered from the catalogue."""

    def make(rng: Rng, color: str, _rgb: Rgb) -> Thing:
        drawn = {name: value(rng) if callable(value) else value for name, value in more.items()}
        return build(Order(kind, 1, **({"color": color, "seed": int(rng.integers(1 << 30))} | drawn)))  # type: ignore[arg-type]

    return make


def between(low: float, high: float) -> Callable[[Rng], float]:
    """Return a draw."""
    return lambda rng: float(rng.uniform(low, high))


def joined(kind: str, color: str, *parts: Part | tuple[Part, ...] | list[Part]) -> Thing:
    """Return a thing of parts and lists of parts."""
    flat = [q for p in parts for q in ((p,) if isinstance(p, Part) else p)]
    return Thing(1, kind, color, tuple(flat))


# --- persons and bicycles ---------------------------------------------------------------------------------------------


def walker(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person of any height, walking or standing."""
    trousers = shaded(rgb, 0.7) if rng.random() < 0.3 else (int(rng.integers(30, 110)),) * 3
    stride = float(rng.random()) if rng.random() < 0.6 else None
    return person(1, color, rgb, trousers, rng.uniform(1.0, 1.95), stride=stride, rng=rng)


def in_skirt(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person in a skirt or a long coat."""
    tall = rng.uniform(1.5, 1.85)
    body = person(1, color, rgb, rgb, tall, stride=None, rng=rng)
    low = tall * rng.uniform(0.15, 0.35)
    return joined("person", color, body.parts, cone((0, 0, low), (0, 0, 0.6 * tall), 0.3, 0.17, rgb, 0.12))


def with_umbrella(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person under an umbrella of the same colour."""
    body = walker(rng, color, rgb)
    tall = body.size_m[1]
    stick = capsule((0.15, 0.2, 0.6 * tall), (0.1, 0.05, tall + 0.15), 0.012, STEEL)
    return joined("person", color, body.parts, stick, ellipsoid((0.5, 0.5, 0.13), (0.1, 0.05, tall + 0.17), rgb, 0.06))


def with_suitcase(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person with a case beside."""
    body = person(1, color, rgb, (60, 62, 70), rng.uniform(1.6, 1.9), stride=float(rng.random()), rng=rng)
    return joined("person", color, body.parts, box((0.28, 0.42, 0.62), (-0.3, 0.42, 0.33), shaded(rgb, 0.9), 0.1))


def rider(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist."""
    grey = int(rng.integers(30, 100))
    return whole(rng, cyclist(1, color, rgb, (grey, grey, grey + 8), rng=rng), 0.08)


def courier(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist with a box on the back."""
    body = cyclist(1, color, rgb, (50, 50, 58), rng=rng)
    return joined("cyclist", color, body.parts, box((0.38, 0.42, 0.45), (-0.33, 0, 1.42), rgb, 0.08))


def laden_bicycle(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a bicycle with bags and a child's seat."""
    body = bicycle(1, color, rgb, rng.uniform(0.9, 1.05), rng=rng)
    bags = [box((0.35, 0.12, 0.33), (-0.55, s * 0.17, 0.52), rgb, 0.1) for s in (-1, 1)]
    return joined("bicycle", color, body.parts, bags, box((0.22, 0.3, 0.45), (-0.6, 0, 1.0), shaded(rgb, 0.8), 0.1))


def cargo_bike(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist behind a crate."""
    body = cyclist(1, color, rgb, (40, 44, 60), rng=rng)
    crate = box((0.6, 0.55, 0.5), (0.95, 0, 0.55), rgb, 0.12)
    return joined(
        "cyclist", color, body.parts, crate, cylinder((1.3, -0.03, 0.28), (1.3, 0.03, 0.28), 0.28, (40, 40, 42))
    )


# --- vehicles ---------------------------------------------------------------------------------------------------------


def drawn_car(shape: CarShape, kind: str = "car") -> Family:
    """Return cars around a shape."""

    def make(rng: Rng, color: str, rgb: Rgb) -> Thing:
        x, y, z = rng.uniform(0.9, 1.1), rng.uniform(0.95, 1.05), rng.uniform(0.93, 1.1)
        scaled = CarShape(*np.array(shape) * (x, y, z, z, z, x, x, x, x, 1.0, x))
        CARS["drawn"] = scaled
        try:
            return replace(car(1, color, rgb, "drawn"), type=kind)
        finally:
            del CARS["drawn"]

    return make


PICKUP = CarShape(5.2, 1.9, 1.78, 1.05, 0.98, 1.3, 0.75, -0.35, -0.55, 0.38, 3.1)
MINIVAN = CarShape(4.6, 1.83, 1.82, 1.0, 0.9, 1.5, 0.75, -2.0, -2.22, 0.33, 2.8)


def bus(rng: Rng, color: str, rgb: Rgb, *, coach: bool = False) -> Thing:
    """Return a bus with a band of windows."""
    half, wide, high = rng.uniform(4.5, 6.2), rng.uniform(2.45, 2.55), rng.uniform(2.9, 3.2) + 0.5 * coach
    low = 1.3 + 0.5 * coach
    body = [
        box((2 * half, wide, high - 0.35), (0, 0, (high + 0.35) / 2), rgb, 0.04),
        box((2 * half - 0.4, wide + 0.02, high - low - 0.45), (0, 0, (high + low - 0.25) / 2), GLASS, 0.05),
        box((2 * half + 0.02, wide - 0.3, high - low - 0.1 - 0.3 * coach), (0, 0, (high + low - 0.3) / 2), GLASS, 0.05),
    ]
    for x in np.arange(-half + 1.2, half - 0.5, 1.5):
        body += [box((0.12, wide + 0.03, high - low), (x, 0, (high + low) / 2 - 0.2), rgb, 0.04)]
    if coach:
        body += [box((2 * half - 1.5, wide + 0.04, 0.5), (0, 0, 0.8), shaded(rgb, 0.7), 0.05)]
    return joined("truck", color, body, wheels(half, wide, (half - 2.2, 1.9 - half)))


def wheels(half: float, wide: float, axles: tuple[float, ...], radius: float = 0.48) -> list[Part]:
    """Return wheels at these places along."""
    return [
        cylinder((x, s * (wide / 2 - 0.3), radius), (x, s * (wide / 2 + 0.015), radius), radius, (36, 36, 38), 0.1)
        for x in axles
        for s in (-1, 1)
        if abs(x) < half
    ]


def cab(rng: Rng, half: float, wide: float, rgb: Rgb) -> list[Part]:
    """Return the cab of a truck at its front."""
    high = rng.uniform(2.4, 3.0)
    return [
        box((1.8, wide - 0.05, high - 0.5), (half - 0.9, 0, (high + 0.5) / 2), rgb, 0.03),
        box((0.05, wide - 0.4, 0.8), (half + 0.01, 0, high - 0.75), GLASS, 0.02),
        box((0.8, wide - 0.02, 0.7), (half - 0.8, 0, high - 0.75), GLASS, 0.02),
        box((0.06, wide - 0.5, 0.3), (half + 0.02, 0, 0.9), (48, 48, 50), 0.1),
    ]


def box_truck(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return the catalogue's truck, whose box has a colour of its own."""
    return replace(whole(rng, ordered("truck")(rng, color, rgb), 0.12), color="")


def tanker(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck with a tank."""
    half, wide = rng.uniform(3.8, 5.0), 2.45
    tank = capsule((1.0 - half, 0, 2.1), (half - 3.0, 0, 2.1), 1.1, rgb, 0.06)
    frame = box((2 * half - 0.4, 1.0, 0.3), (0, 0, 0.85), (48, 48, 50), 0.1)
    guard = box((0.1, wide - 0.1, 0.25), (0.05 - half, 0, 0.6), STEEL, 0.1)
    return joined(
        "truck", color, tank, frame, guard, cab(rng, half, wide, rgb), wheels(half, wide, (half - 1.2, 1.6 - half))
    )


def tipper(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck with an open bed."""
    half, wide = rng.uniform(3.2, 4.2), 2.5
    bed = box((2 * half - 2.1, wide, 1.3), (-1.0, 0, 1.75), rgb, 0.1)
    ribs = [
        box((0.1, wide + 0.06, 1.25), (x, 0, 1.75), shaded(rgb, 0.8), 0.05)
        for x in np.arange(0.1 - half, half - 2.2, 0.8)
    ]
    frame = box((2 * half - 0.4, 1.0, 0.3), (0, 0, 0.85), (48, 48, 50), 0.1)
    guard = box((0.1, wide - 0.1, 0.25), (0.05 - half, 0, 0.6), STEEL, 0.1)
    return joined(
        "truck", color, bed, ribs, frame, guard, cab(rng, half, wide, rgb), wheels(half, wide, (half - 1.2, 1.6 - half))
    )


# --- railings and poles -----------------------------------------------------------------------------------------------


def pickets(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fence of upright boards."""
    half, tall, pitch = rng.uniform(1.5, 4), rng.uniform(0.9, 1.4), rng.uniform(0.12, 0.2)
    slats = [box((0.6 * pitch, 0.02, tall), (x, 0, tall / 2), rgb, 0.1) for x in np.arange(-half, half, pitch)]
    rails = [box((2 * half, 0.04, 0.08), (0, 0.03, z * tall), rgb, 0.1) for z in (0.25, 0.8)]
    return joined("railing", color, slats, rails)


def guard_rail(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a single beam of two waves on posts."""
    half, high = rng.uniform(2.5, 7), rng.uniform(0.65, 0.85)
    beam = [capsule((-half, 0.05, high - z), (half, 0.05, high - z), 0.055, rgb, 0.1) for z in (0.055, 0.255)]
    beam += [box((2 * half, 0.03, 0.2), (0, 0.03, high - 0.155), rgb, 0.1)]
    posts = [
        box((0.12, 0.08, high - 0.05), (x, -0.06, high / 2 - 0.02), rgb, 0.1) for x in np.arange(0.2 - half, half, 2)
    ]
    return joined("railing", color, beam, posts)


def mesh(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fence of wire between posts."""
    half, tall = rng.uniform(1.5, 3.5), rng.uniform(1.0, 1.8)
    wires = [capsule((x, 0, 0.05), (x, 0, tall), 0.005, rgb) for x in np.arange(-half, half + 0.01, 0.1)]
    wires += [capsule((-half, 0, z), (half, 0, z), 0.006, rgb) for z in np.linspace(0.05, tall, 8)]
    posts = [cylinder((x, 0, 0), (x, 0, tall + 0.05), 0.03, rgb) for x in np.linspace(-half, half, 3)]
    return joined("railing", color, wires, posts)


def planks(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a paddock's fence: planks between posts."""
    half, tall = rng.uniform(2, 4.5), rng.uniform(0.9, 1.3)
    rails = [box((2 * half, 0.03, 0.12), (0, 0, z * tall), rgb, 0.15) for z in (0.3, 0.6, 0.92)]
    posts = [box((0.12, 0.12, tall), (x, 0.06, tall / 2), rgb, 0.15) for x in np.arange(0.1 - half, half, 1.8)]
    return joined("railing", color, rails, posts)


def lamp(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a street lamp."""
    return replace(street_lamp(rgb, rng.uniform(4.5, 7)), id=1, type="pole", color=color)


def traffic_light(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a post with a box of lights."""
    high = rng.uniform(2.6, 3.6)
    case = box((0.22, 0.28, 0.85), (0.1, 0, high - 0.45), (40, 42, 40), 0.05)
    return joined("pole", color, cylinder((0, 0, 0), (0, 0, high), 0.06, rgb), case)


def column(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a thick round column."""
    return joined("pole", color, cylinder((0, 0, 0), (0, 0, rng.uniform(2.2, 5)), rng.uniform(0.1, 0.17), rgb, 0.2))


# --- forks ------------------------------------------------------------------------------------------------------------


def usual_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return the catalogue's fork, of any length and height."""
    return fork(1, color, rgb, rng.uniform(5, 14), rng.uniform(0.95, 1.4))


def spread(parts: tuple[Part, ...] | list[Part], side: int, nose_m: float, angle: float) -> tuple[Part, ...]:
    """Return what runs along x, moved to a side of an island that widens by this angle."""
    return carried(parts, pose(rotation_from_rotvec([0, 0, side * angle]), [nose_m, side * nose_m * 0.8, 0]))


def cushion_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a row of barrels before two guard rails."""
    high, wide, run = rng.uniform(0.85, 1.05), rng.uniform(0.3, 0.42), rng.uniform(5, 10)
    drums = [
        cylinder((x, y, 0), (x, y, high), wide, rgb, 0.08)
        for x, y in ((wide, 0), (3 * wide, 0), (5 * wide, -wide), (5 * wide, wide))
    ]
    bands = [
        cylinder((x, y, z), (x, y, z + 0.16), wide + 0.006, (230, 230, 226), 0.05)
        for x, y in ((wide, 0), (3 * wide, 0))
        for z in (0.2, 0.55)
    ]
    rails = [
        spread(
            carried(railing(1, "", STEEL, run, 0.8, bars=False).parts, pose(np.eye(3), [run / 2, 0, 0])), s, 1.8, 0.14
        )
        for s in (-1, 1)
    ]
    return joined("fork", color, drums, bands, *rails)


def half_round_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a half round, striped shield before railings."""
    high, radius, run = rng.uniform(1.0, 1.5), rng.uniform(0.4, 0.6), rng.uniform(4, 9)
    rings = np.arange(0.1, high, 0.2)
    shield = [
        cylinder((radius, 0, z), (radius, 0, z + 0.2), radius, (232, 232, 226) if i % 2 else rgb, 0.05)
        for i, z in enumerate(rings)
    ]
    rails = [
        spread(carried(railing(1, "", STEEL, run, 1.0).parts, pose(np.eye(3), [run / 2, 0, 0])), s, 0.9, 0.15)
        for s in (-1, 1)
    ]
    return joined("fork", color, shield, *rails)


def concrete_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a board with an arrow plate before concrete walls that widen."""
    high, half, run = rng.uniform(1.0, 1.4), rng.uniform(0.42, 0.6), rng.uniform(4, 9)
    board = [box((0.05, 2 * half, high - 0.1), (0.05, 0, high / 2 + 0.05), rgb, 0.05)]
    for z in np.arange(0.25, high - 0.2, 0.3):
        for s in (-1, 1):
            R = rotation_from_rotvec([s * np.pi / 4, 0, 0])
            board += [
                Part(
                    "box", pose(R, [0.02, s * half * 0.45, z]), np.array([0.02, 0.55 * half, 0.06]), (24, 24, 26), 0.05
                )
            ]
    walls = [spread([box((run, 0.25, 0.8), (run / 2, 0, 0.4), CONCRETE, 0.15)], s, 0.6, 0.16) for s in (-1, 1)]
    return joined("fork", color, board, *walls)


def plated_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a large drum under a keep plate, before an island of guard rails."""
    radius, high, run = rng.uniform(0.45, 0.6), rng.uniform(0.9, 1.2), rng.uniform(5, 9)
    drum = [cylinder((radius, 0, 0), (radius, 0, high), radius, rgb, 0.08)]
    drum += [cylinder((radius, 0, high - 0.35), (radius, 0, high - 0.15), radius + 0.01, (235, 235, 230), 0.05)]
    plate = [cylinder((radius, 0, high), (radius, 0, high + 0.6), 0.03, STEEL)]
    plate += [box((0.03, 0.5, 0.6), (radius - 0.05, 0, high + 0.7), (28, 72, 160), 0.03)]
    rails = [
        spread(
            carried(railing(1, "", STEEL, run, 0.75, bars=False).parts, pose(np.eye(3), [run / 2, 0, 0])), s, 1.2, 0.17
        )
        for s in (-1, 1)
    ]
    return joined("fork", color, drum, plate, *rails)


# --- walls, plants, debris --------------------------------------------------------------------------------------------


def home(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a house."""
    wall = (int(rng.integers(150, 225)),) * 2 + (int(rng.integers(120, 200)),)
    size = (rng.uniform(5, 11), rng.uniform(5, 9), rng.uniform(3.5, 6))
    return replace(house(wall, (132, 76, 58), size), id=1, type="wall", color="")


def block(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a building with a flat roof."""
    size = (rng.uniform(4, 9), rng.uniform(4, 9), rng.uniform(3, 6))
    return joined(
        "wall",
        color,
        box(size, (0, 0, size[2] / 2), shaded(rgb, 1.1), 0.1, "windows"),
        box((size[0] + 0.3, size[1] + 0.3, 0.2), (0, 0, size[2]), CONCRETE, 0.1),
    )


def jersey(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a barrier of concrete, narrow at its top."""
    length, high = rng.uniform(3, 7), rng.uniform(0.8, 1.1)
    return joined(
        "wall",
        color,
        box((0.6, length, 0.3), (0, 0, 0.15), rgb, 0.15),
        box((0.3, length, high), (0, 0, high / 2), rgb, 0.15),
    )


def pillared(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a garden wall between pillars."""
    length, high = rng.uniform(3, 6), rng.uniform(1.2, 2.2)
    pillars = [
        box((0.45, 0.45, high + 0.2), (0, y, high / 2 + 0.1), shaded(rgb, 0.8), 0.2)
        for y in np.linspace(-length / 2, length / 2, 3)
    ]
    return joined("wall", color, box((0.25, length, high), (0, 0, high / 2), rgb, 0.2), pillars)


def crown(rng: Rng) -> Rgb:
    """Return a green."""
    return int(rng.integers(48, 100)), int(rng.integers(85, 135)), int(rng.integers(35, 70))


def leafy(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a tree."""
    return replace(tree(crown(rng), rng.uniform(3.0, 8), rng), id=1, type="vegetation")


def hedge_of(rng: Rng, color: str, _rgb: Rgb) -> Thing:
    """Return a hedge."""
    made = ordered("hedge", color="", length_m=between(0.7, 1.4), width_m=between(1.5, 6), height_m=between(0.9, 2.2))
    return replace(made(rng, color, (0, 0, 0)), type="vegetation")


def tufts(
    rng: Rng, count: int, half: tuple[float, float], reach: tuple[float, float, float], up: float, rgb: Rgb
) -> list[Part]:
    """Return ellipsoids around a point `up` over the road."""
    places = rng.normal(size=(count, 3))
    places *= np.array(reach) / np.linalg.norm(places, axis=1)[:, None]
    return [
        ellipsoid(rng.uniform(*half, 3), xyz(x, y, max(up + z, 0.2)), shaded(rgb, rng.uniform(0.7, 1.25)), 0.5)
        for x, y, z in places
    ]


def bush(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a round bush."""
    wide, high = rng.uniform(0.5, 1.3), rng.uniform(0.45, 0.9)
    return joined("vegetation", "green", tufts(rng, 40, (0.15, 0.35), (wide, wide, high), high, crown(rng)))


def conifer(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a fir: cones over each other, lumpy."""
    high, wide, rgb = rng.uniform(2.5, 6), rng.uniform(0.8, 1.4), shaded(crown(rng), 0.75)
    tiers = [
        cone((0, 0, z * high), (0, 0, (z + 0.3) * high), wide * (1 - z), 0.12, shaded(rgb, rng.uniform(0.8, 1.2)), 0.5)
        for z in (0.12, 0.3, 0.48, 0.65)
    ]
    return joined("vegetation", "green", tiers, cylinder((0, 0, 0), (0, 0, 0.3 * high), 0.12, (92, 72, 54), 0.3))


def birch(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a slim tree with a hanging crown."""
    high, rgb = rng.uniform(3.5, 6), crown(rng)
    trunk = capsule((0, 0, 0.05), (0, 0, 0.8 * high), 0.07, (205, 203, 196), 0.25)
    return joined(
        "vegetation", "green", trunk, tufts(rng, 30, (0.15, 0.4), (0.75, 0.75, 0.33 * high), 0.62 * high, rgb)
    )


def barrel(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a barrel, lying."""
    radius, half = rng.uniform(0.25, 0.35), rng.uniform(0.35, 0.5)
    return joined("debris", color, cylinder((0, -half, radius), (0, half, radius), radius, rgb, 0.15))


def sack(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a heap of bags."""
    bags = [
        ellipsoid(rng.uniform(0.22, 0.35, 3), xyz(*rng.uniform(-0.25, 0.25, 2), rng.uniform(0.22, 0.35)), rgb, 0.2)
        for _ in range(3)
    ]
    return joined("debris", color, bags)


# --- families for the judge alone -------------------------------------------------------------------------------------


def with_pram(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person behind a pram."""
    body = person(1, color, rgb, shaded(rgb, 0.6), rng.uniform(1.55, 1.85), stride=float(rng.random()), rng=rng)
    tub = [
        box((0.7, 0.42, 0.3), (0.85, 0, 0.7), shaded(rgb, 0.9), 0.08),
        ellipsoid((0.3, 0.22, 0.28), (0.7, 0, 0.85), rgb, 0.08),
    ]
    rims = [cylinder((x, y, 0.15), (x, y + 0.03, 0.15), 0.15, (40, 40, 42)) for x in (0.6, 1.1) for y in (-0.22, 0.2)]
    return joined("person", color, body.parts, tub, rims, capsule((0.3, 0, 1.0), (0.6, 0, 0.7), 0.02, STEEL))


def with_board(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person with a hat and a large folder under the arm."""
    body = walker(rng, color, rgb)
    tall = body.size_m[1]
    hat = [
        cylinder((0, 0, 0.955 * tall), (0, 0, 0.965 * tall), 0.22, rgb),
        cylinder((0, 0, 0.96 * tall), (0, 0, 1.03 * tall), 0.11, rgb),
    ]
    return joined("person", color, body.parts, hat, box((0.7, 0.04, 0.5), (0.05, 0.3, 0.55 * tall), rgb, 0.1))


def in_poncho(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist in a poncho."""
    body = cyclist(1, color, rgb, rgb, rng=rng)
    return joined("cyclist", color, body.parts, cone((-0.15, 0, 0.85), (-0.05, 0, 1.5), 0.48, 0.14, rgb, 0.08))


def folding_bicycle(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a small bicycle with a box at its front."""
    body = bicycle(1, color, rgb, rng.uniform(0.78, 0.9), rng=rng)
    return joined("bicycle", color, body.parts, box((0.3, 0.36, 0.26), (0.55, 0, 0.78), shaded(rgb, 0.9), 0.12))


MICRO = CarShape(2.75, 1.62, 1.54, 0.95, 0.85, 1.0, 0.55, -1.05, -1.25, 0.28, 1.85)
ESTATE = CarShape(4.75, 1.82, 1.48, 0.92, 0.7, 1.1, 0.4, -1.9, -2.25, 0.32, 2.8)


def post_van(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a van with an upright front."""
    half, wide, high = rng.uniform(2.2, 2.6), 1.95, rng.uniform(2.1, 2.5)
    body = [box((2 * half - 0.2, wide, high - 0.35), (0, 0, (high + 0.35) / 2), rgb, 0.04)]
    body += [
        box((0.06, wide - 0.25, 0.7), (half - 0.1, 0, high - 0.7), GLASS, 0.02),
        box((0.8, wide + 0.02, 0.6), (half - 0.7, 0, high - 0.7), GLASS, 0.02),
    ]
    body += [box((0.06, 0.6, 0.6), (0.1 - half, s * 0.4, high - 0.6), GLASS, 0.02) for s in (-1, 1)]
    body += [
        capsule((x, 0.15 - wide / 2, 0.45), (x, wide / 2 - 0.15, 0.45), 0.12, (48, 48, 50))
        for x in (half - 0.15, 0.15 - half)
    ]
    body += [box((0.06, 0.12, 0.4), (0.1 - half, s * (wide / 2 - 0.08), 1.0), (176, 20, 18)) for s in (-1, 1)]
    return joined("car", color, body, wheels(half, wide + 0.3, (half - 0.8, 0.9 - half), 0.33))


def flatbed(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck with crates on an open bed."""
    half, wide = rng.uniform(3.5, 4.5), 2.45
    bed = [box((2 * half - 2.0, wide, 0.15), (-1.0, 0, 1.1), (90, 80, 70), 0.15)]
    load = [
        box((1.6, 2.0, h), (x, 0, 1.2 + h / 2), rgb, 0.16, "crate")
        for x, h in zip(np.arange(1.0 - half, half - 2.6, 1.8), rng.uniform(0.9, 1.7, 6), strict=False)
    ]
    guard = box((0.1, wide - 0.1, 0.25), (0.05 - half, 0, 0.6), STEEL, 0.1)
    return joined(
        "truck", color, bed, load, guard, cab(rng, half, wide, rgb), wheels(half, wide, (half - 1.2, 1.6 - half))
    )


def semitrailer(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a long trailer behind a high cab, all of one colour."""
    half, wide, high = rng.uniform(5.5, 7.0), 2.5, rng.uniform(3.4, 3.9)
    hull = [box((2 * half - 2.6, wide, high - 1.2), (-1.3, 0, (high + 1.2) / 2), rgb, 0.06)]
    hull += [box((0.04, wide - 0.1, 0.05), (-half, 0, z), STEEL) for z in (1.3, high - 0.1)]
    hull += [box((0.05, 0.05, high - 1.3), (-half, y, (high + 1.2) / 2), STEEL) for y in (-1.1, 0, 1.1)]
    guard = [box((0.1, wide - 0.1, 0.2), (0.05 - half, 0, 0.55), (200, 40, 36), 0.1)]
    return joined(
        "truck",
        color,
        hull,
        guard,
        cab(rng, half, wide, rgb),
        wheels(half, wide, (half - 1.2, half - 3.4, 1.5 - half, 2.8 - half)),
    )


def lattice(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a railing of crossed bars."""
    half, tall = rng.uniform(1.5, 4), rng.uniform(0.9, 1.2)
    bars = [
        capsule((x, 0, 0.1), (x + s * tall, 0, tall), 0.014, rgb, 0.1)
        for x in np.arange(-half, half, 0.35)
        for s in (-1, 1)
        if abs(x + s * tall) <= half
    ]
    frame = [capsule((-half, 0, z), (half, 0, z), 0.025, rgb) for z in (0.1, tall)]
    posts = [capsule((x, 0, 0), (x, 0, tall), 0.03, rgb) for x in np.linspace(-half, half, max(2, round(half)))]
    return joined("railing", color, bars, frame, posts)


def site_fence(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return barriers of a building site: boards between feet."""
    half, tall = rng.uniform(1.5, 3.5), rng.uniform(0.95, 1.15)
    boards = [box((2 * half, 0.04, 0.2), (0, 0, z), rgb, 0.1) for z in (0.35, tall - 0.1)]
    boards += [
        box((0.2, 0.045, 0.2), (x, 0, z), (232, 232, 226), 0.05)
        for x in np.arange(0.3 - half, half, 0.6)
        for z in (0.35, tall - 0.1)
    ]
    feet = [box((0.06, 0.4, 0.06), (x, 0, 0.03), STEEL) for x in (0.1 - half, half - 0.1)]
    return joined(
        "railing",
        color,
        boards,
        feet,
        [box((0.05, 0.05, tall), (x, 0, tall / 2), rgb) for x in (0.1 - half, half - 0.1)],
    )


def two_plates(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a post with two plates over each other."""
    high = rng.uniform(2.6, 3.2)
    plates = [
        box((0.02, 0.5, 0.5), (0.05, 0, high - 0.3), rgb, 0.04),
        box((0.02, 0.55, 0.3), (0.05, 0, high - 0.8), (232, 232, 228), 0.04),
    ]
    return joined("pole", color, cylinder((0, 0, 0), (0, 0, high), 0.035, STEEL), plates)


def mast(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a mast with a cabinet and an arm."""
    high = rng.uniform(3.5, 6)
    parts = [cone((0, 0, 0), (0, 0, high), 0.11, 0.06, rgb, 0.1), box((0.3, 0.35, 0.5), (0.1, 0, 1.4), rgb, 0.06)]
    return joined(
        "pole",
        color,
        parts,
        capsule((0, 0, high - 0.1), (0, 1.0, high), 0.03, rgb),
        box((0.3, 0.15, 0.15), (0, 1.0, high - 0.1), STEEL),
    )


def attenuator_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a long box with slanting stripes before guard rails."""
    high, half, run = rng.uniform(0.85, 1.1), rng.uniform(0.38, 0.5), rng.uniform(5, 9)
    hull = [
        box((2.2, 2 * half, high - 0.1), (1.12, 0, high / 2 + 0.05), (70, 72, 76), 0.08),
        box((0.04, 2 * half, high - 0.15), (0.0, 0, high / 2 + 0.05), rgb, 0.05),
    ]
    for z in np.arange(0.25, high - 0.1, 0.28):
        R = rotation_from_rotvec([0.7, 0, 0])
        hull += [Part("box", pose(R, [-0.02, 0, z]), np.array([0.01, 0.9 * half, 0.05]), (24, 24, 26), 0.05)]
    rails = [
        spread(
            carried(railing(1, "", STEEL, run, 0.8, bars=False).parts, pose(np.eye(3), [run / 2, 0, 0])), s, 2.3, 0.13
        )
        for s in (-1, 1)
    ]
    return joined("fork", color, hull, *rails)


def planted_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork whose nose is a round shield under a sign, before a planted island between walls."""
    high, radius, run = rng.uniform(0.9, 1.2), rng.uniform(0.5, 0.65), rng.uniform(5, 9)
    shield = [cylinder((radius, 0, 0), (radius, 0, high), radius, rgb, 0.08)]
    shield += [box((0.02, 0.28, high - 0.3), (-0.005, 0, high / 2), (235, 235, 230), 0.05)]
    sign = [
        cylinder((radius, 0, high), (radius, 0, high + 0.9), 0.03, STEEL),
        cylinder((radius - 0.05, 0, high + 0.9), (radius - 0.02, 0, high + 0.9), 0.3, (28, 72, 160)),
    ]
    walls = [spread([box((run, 0.2, 0.55), (run / 2, 0, 0.28), CONCRETE, 0.15)], s, 1.0, 0.15) for s in (-1, 1)]
    green = carried(
        tufts(rng, 18, (0.2, 0.35), (run / 3, 0.3, 0.3), 0.6, crown(rng)), pose(np.eye(3), [run / 2 + 1.5, 0, 0])
    )
    return joined("fork", color, shield, sign, *walls, green)


def gabions(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a wall of stacked blocks."""
    across, up = int(rng.integers(3, 6)), int(rng.integers(1, 3))
    blocks = [
        box(
            (0.9, 0.98, 0.78),
            (rng.uniform(-0.03, 0.03), y - across / 2 + 0.5, z * 0.8 + 0.4),
            shaded(rgb, rng.uniform(0.8, 1.15)),
            0.3,
        )
        for y in range(across)
        for z in range(up)
    ]
    return joined("wall", color, blocks)


def shed(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a garage with a door and a leaning roof."""
    size = (rng.uniform(4, 6), rng.uniform(3, 6), rng.uniform(2.4, 3.2))
    door = box((0.06, 2.3, 2.0), (-size[0] / 2, 0, 1.0), shaded(rgb, 0.7), 0.08)
    return joined(
        "wall",
        color,
        box(size, (0, 0, size[2] / 2), rgb, 0.15),
        door,
        box((size[0] + 0.5, size[1] + 0.5, 0.15), (0, 0, size[2] + 0.1), (90, 70, 60), 0.2),
    )


def clipped_balls(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a row of clipped shrubs."""
    count, radius, rgb = int(rng.integers(2, 5)), rng.uniform(0.4, 0.7), crown(rng)
    balls = [
        carried(
            tufts(rng, 30, (0.12, 0.25), (0.8 * radius,) * 3, radius, rgb), pose(np.eye(3), [0, 1.7 * radius * i, 0])
        )
        for i in range(count)
    ]
    return joined("vegetation", "green", *balls)


def willow(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a tree whose crown hangs down to the ground."""
    high, rgb = rng.uniform(2.5, 4.5), crown(rng)
    strands = [
        ellipsoid((0.2, 0.2, 0.4 * high), (x, y, 0.5 * high), shaded(rgb, rng.uniform(0.7, 1.2)), 0.5)
        for x, y in rng.normal(0, 0.28 * high, (26, 2))
    ]
    return joined(
        "vegetation",
        "green",
        strands,
        tufts(rng, 25, (0.2, 0.5), (0.35 * high, 0.35 * high, 0.15 * high), 0.8 * high, rgb),
    )


def pallets(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return stacked pallets."""
    count = int(rng.integers(3, 6))
    boards = [box((1.0, 0.8, 0.03), (0, 0, 0.13 * i + 0.12), rgb, 0.15) for i in range(count)]
    blocks = [
        box((0.1, 0.8, 0.1), (x, 0, 0.13 * i + 0.05), shaded(rgb, 0.8), 0.15)
        for i in range(count)
        for x in (-0.45, 0, 0.45)
    ]
    return joined("debris", color, boards, blocks)


def case(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a large suitcase, standing."""
    x, y, z = rng.uniform(0.25, 0.35), rng.uniform(0.42, 0.6), rng.uniform(0.55, 0.8)
    ribs = [box((x + 0.02, 0.04, z - 0.06), (0, k * y / 4, z / 2), shaded(rgb, 0.75), 0.08) for k in (-1, 0, 1)]
    return joined(
        "debris",
        color,
        box((x, y, z), (0, 0, z / 2), rgb, 0.1),
        ribs,
        box((0.05, 0.2, 0.06), (0, 0, z + 0.02), (40, 40, 42)),
    )
