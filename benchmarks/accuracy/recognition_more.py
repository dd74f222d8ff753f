"""More families of shapes to train recognition with, none of them one that is judged by."""

import numpy as np
from recognition_shapes import (
    CONCRETE,
    GLASS,
    STEEL,
    Rgb,
    Rng,
    cab,
    crown,
    drawn_car,
    joined,
    shaded,
    spread,
    tufts,
    walker,
    wheels,
    whole,
)

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Thing, box, capsule, carried, cone, cylinder, ellipsoid, ring
from roadblock.sim.things import bicycle, cyclist, person, railing
from roadblock.sim.things.vehicles import CarShape

RUBBER: Rgb = (36, 36, 38)
WHITE: Rgb = (230, 230, 226)


def at(parts: tuple[Part, ...] | list[Part], x: float, y: float, z: float = 0.0, turn: float = 0.0) -> tuple[Part, ...]:
    """Return the parts at another place, turned around the vertical."""
    return carried(parts, pose(rotation_from_rotvec([0, 0, turn]), [x, y, z]))


def tilted(part: Part, x_rad: float, y_rad: float = 0.0) -> Part:
    """Return a part turned around its middle."""
    R = rotation_from_rotvec([x_rad, y_rad, 0])
    return Part(
        part.shape, pose(R @ part.T_thing_part[:3, :3], part.T_thing_part[:3, 3]), part.half_m, part.rgb, part.contrast
    )


# --- persons and bicycles ---------------------------------------------------------------------------------------------


def with_parcel(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person who carries a parcel before the body."""
    body = walker(rng, color, rgb)
    size = rng.uniform((0.25, 0.3, 0.2), (0.5, 0.8, 0.5))
    return joined("person", color, body.parts, box(size, (0.15 + size[0] / 2, 0, 0.62 * body.size_m[1]), rgb, 0.1))


def with_hand_truck(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person with a load on a hand truck, ahead or behind."""
    body, way = walker(rng, color, rgb), rng.choice((-1, 1))
    x, high = way * rng.uniform(0.55, 0.8), rng.uniform(0.5, 1.0)
    load = box((0.4, rng.uniform(0.35, 0.6), high), (x, 0, high / 2 + 0.15), shaded(rgb, rng.uniform(0.6, 1.2)), 0.12)
    frame = [capsule((x - way * 0.22, y, 0.15), (x - way * 0.35, y, 1.15), 0.018, STEEL) for y in (-0.18, 0.18)]
    rims = [cylinder((x - way * 0.2, y, 0.12), (x - way * 0.2, y + 0.04, 0.12), 0.12, RUBBER) for y in (-0.24, 0.2)]
    return joined("person", color, body.parts, load, frame, rims)


def with_basket_cart(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person who pushes a basket of wire on small wheels."""
    body = walker(rng, color, rgb)
    x0, x1, z0, z1, y = 0.5, rng.uniform(1.1, 1.35), 0.45, rng.uniform(0.9, 1.0), 0.27
    wires = [capsule((x, s * y, z0), (x, s * y, z1), 0.008, STEEL) for x in np.arange(x0, x1, 0.08) for s in (-1, 1)]
    wires += [capsule((x0, s * y, z), (x1, s * y, z), 0.01, STEEL) for z in np.linspace(z0, z1, 5) for s in (-1, 1)]
    wires += [capsule((x1, -y, z), (x1, y, z), 0.01, STEEL) for z in np.linspace(z0, z1, 5)]
    under = [capsule((x, s * y, 0.1), (x, s * y, z0), 0.015, STEEL) for x in (x0, x1) for s in (-1, 1)]
    goods = box((0.4, 0.4, 0.3), ((x0 + x1) / 2, 0, 0.62), shaded(rgb, 0.9), 0.16)
    return joined("person", color, body.parts, wires, under, goods)


def in_wheelchair(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person who sits in a wheelchair."""
    skin, dark = (200, 156, 128), shaded(rgb, rng.uniform(0.4, 0.9))
    body = [
        capsule((0, 0, 0.6), (-0.04, 0, 1.02), 0.17, rgb),
        ellipsoid((0.1, 0.09, 0.13), (0.02, 0, 1.33), skin),
        *(capsule((0, s * 0.1, 0.56), (0.45, s * 0.12, 0.56), 0.075, dark) for s in (-1, 1)),
        *(capsule((0.45, s * 0.12, 0.52), (0.5, s * 0.12, 0.12), 0.055, dark) for s in (-1, 1)),
        *(capsule((0, s * 0.22, 1.0), (0.25, s * 0.27, 0.72), 0.05, rgb) for s in (-1, 1)),
    ]
    chair = [box((0.45, 0.45, 0.05), (0.1, 0, 0.48), RUBBER), box((0.04, 0.45, 0.45), (-0.17, 0, 0.75), RUBBER)]
    rims = [part for s in (-1, 1) for part in ring((0, s * 0.3, 0.31), 0.31, 0.02, RUBBER)]
    return joined("person", color, body, chair, rims)


def sitting(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person who sits on a block or bends down."""
    dark, lean = shaded(rgb, rng.uniform(0.4, 0.9)), rng.uniform(0, 0.35)
    body = [
        capsule((0, 0, 0.55), (lean, 0, 1.0), 0.18, rgb),
        ellipsoid((0.1, 0.09, 0.13), (lean + 0.06, 0, 1.3), (190, 146, 118)),
        *(capsule((0, s * 0.1, 0.5), (0.42, s * 0.13, 0.52), 0.08, dark) for s in (-1, 1)),
        *(capsule((0.42, s * 0.13, 0.5), (0.42, s * 0.13, 0.08), 0.06, dark) for s in (-1, 1)),
    ]
    return joined("person", color, body, box((0.4, 0.5, 0.42), (-0.05, 0, 0.21), CONCRETE, 0.15))


def couple(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return two persons side by side, or a parent and a child."""
    first = walker(rng, color, rgb)
    second = person(1, color, rgb, shaded(rgb, 0.6), rng.uniform(0.95, 1.85), stride=float(rng.random()), rng=rng)
    return joined(
        "person",
        color,
        first.parts,
        at(second.parts, rng.uniform(-0.2, 0.2), rng.choice((-1, 1)) * rng.uniform(0.45, 0.6)),
    )


def with_dog(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person with a dog."""
    fur, size = (int(rng.integers(40, 180)),) * 3, rng.uniform(0.7, 1.2)
    dog = [
        capsule((-0.3 * size, 0, 0.45 * size), (0.25 * size, 0, 0.47 * size), 0.13 * size, fur),
        ellipsoid(np.array((0.15, 0.09, 0.1)) * size, np.array((0.45, 0, 0.65)) * size, fur),
        *(
            capsule((x * size, s * 0.08, 0.04), (x * size, s * 0.08, 0.4 * size), 0.04 * size, fur)
            for x in (-0.3, 0.25)
            for s in (-1, 1)
        ),
    ]
    return joined(
        "person", color, walker(rng, color, rgb).parts, at(dog, rng.uniform(0.3, 0.8), rng.uniform(-0.6, 0.6))
    )


def with_pole_over_shoulder(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a person with boards or a ladder over the shoulder and a wide rucksack."""
    body = walker(rng, color, rgb)
    tall, half = body.size_m[1], rng.uniform(0.6, 1.1)
    load = box((2 * half, 0.06, rng.uniform(0.06, 0.3)), (rng.uniform(-0.2, 0.2), 0.22, 0.84 * tall), STEEL, 0.12)
    sack = ellipsoid((0.2, 0.26, 0.32), (-0.25, 0, 0.68 * tall), shaded(rgb, 0.8), 0.12)
    return joined("person", color, body.parts, *([load, sack] if rng.random() < 0.5 else [sack]))


def racer(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist with a rucksack or a long tail of bags."""
    body = cyclist(1, color, rgb, shaded(rgb, 0.5), shaded(rgb, 1.1), rng=rng)
    sack = ellipsoid((0.17, 0.2, 0.27), (-0.3, 0, 1.28), shaded(rgb, 0.7), 0.1)
    return whole(rng, joined("cyclist", color, body.parts, sack), 0.12)


def tandem(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return two cyclists behind each other, so near that they look like one."""
    second = cyclist(1, color, shaded(rgb, 0.85), (50, 52, 64), rng=rng)
    front = cyclist(1, color, rgb, (60, 60, 66), rng=rng)
    return joined("cyclist", color, at(front.parts, 0.4, 0), at(second.parts, -0.5, 0))


def with_trailer(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist who pulls a trailer for children."""
    body = cyclist(1, color, rgb, (56, 56, 62), rng=rng)
    tent = [
        box((0.8, 0.7, 0.45), (-1.55, 0, 0.5), rgb, 0.1),
        box((0.5, 0.66, 0.3), (-1.65, 0, 0.82), shaded(rgb, 0.8), 0.1),
    ]
    rims = [cylinder((-1.6, y, 0.25), (-1.6, y + 0.04, 0.25), 0.25, RUBBER) for y in (-0.42, 0.38)]
    return joined("cyclist", color, body.parts, tent, rims)


def with_child_behind(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist with a child on a seat behind."""
    body = cyclist(1, color, rgb, (46, 46, 60), rng=rng)
    child = [
        capsule((-0.5, 0, 0.95), (-0.5, 0, 1.2), 0.13, shaded(rgb, 1.2)),
        ellipsoid((0.12, 0.11, 0.13), (-0.48, 0, 1.45), WHITE),
        box((0.06, 0.35, 0.6), (-0.68, 0, 1.05), RUBBER),
    ]
    return joined("cyclist", color, body.parts, child)


def parked_bicycles(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return two or three bicycles beside each other."""
    parts = [
        at(bicycle(1, color, shaded(rgb, rng.uniform(0.7, 1.2)), rng.uniform(0.85, 1.05), rng=rng).parts, x, 0.45 * i)
        for i, x in enumerate(rng.uniform(-0.25, 0.25, rng.integers(2, 4)))
    ]
    return joined("bicycle", color, *parts)


def laden_front(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a bicycle with a wide screen for the legs, or with bags over the front wheel."""
    body = bicycle(1, color, rgb, rng.uniform(0.85, 1.1), rng=rng)
    bags = [box((0.3, 0.1, 0.28), (0.55, s * 0.14, 0.4), shaded(rgb, 0.8), 0.1) for s in (-1, 1)]
    roll = capsule((-0.55, -0.25, 0.9), (-0.55, 0.25, 0.9), 0.1, shaded(rgb, rng.uniform(0.6, 1.2)))
    return joined("bicycle", color, body.parts, bags, roll)


def upright_rider(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cyclist in a wide jacket, upright, with a helmet."""
    body = cyclist(1, color, rgb, shaded(rgb, rng.uniform(0.4, 1)), rng=rng)
    jacket = ellipsoid((0.24, 0.27, 0.36), (-0.12, 0, 1.22), rgb, 0.1)
    return whole(rng, joined("cyclist", color, body.parts, jacket), 0.1)


# --- vehicles ---------------------------------------------------------------------------------------------------------

LOW = CarShape(4.3, 1.8, 1.28, 0.86, 0.64, 0.8, 0.1, -0.9, -1.75, 0.32, 2.5)
JEEP = CarShape(4.0, 1.8, 1.85, 1.12, 1.05, 0.75, 0.55, -1.75, -1.9, 0.39, 2.5)
TALL = CarShape(3.4, 1.6, 1.72, 0.95, 0.85, 1.25, 0.8, -1.35, -1.6, 0.28, 2.35)
STRETCHED = CarShape(5.2, 1.95, 1.5, 0.95, 0.75, 1.3, 0.5, -1.3, -2.1, 0.33, 3.1)


def any_car(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a car of any proportions."""
    length, high = rng.uniform(3.3, 5.1), rng.uniform(1.3, 1.95)
    belt, half = high * rng.uniform(0.56, 0.68), length / 2
    cowl = half * rng.uniform(0.35, 0.65)
    tail = -half * rng.uniform(0.6, 0.9)
    front, back = cowl - rng.uniform(0.3, 0.9), tail + rng.uniform(0.1, 0.8)
    wheel = rng.uniform(0.28, 0.38)
    shape = CarShape(
        length,
        rng.uniform(1.55, 1.98),
        high,
        belt,
        belt * rng.uniform(0.72, 0.97),
        cowl,
        front,
        back,
        tail,
        wheel,
        0.6 * length,
    )
    return drawn_car(shape)(rng, color, rgb)


def with_roof_load(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a car with a box, a sign or rails on its roof."""
    body = any_car(rng, color, rgb)
    high, long = body.size_m[1], rng.uniform(0.3, 1.6)
    load = box((long, rng.uniform(0.4, 1.0), rng.uniform(0.12, 0.35)), (-0.3, 0, high + 0.12), shaded(rgb, 0.8), 0.1)
    return joined("car", color, body.parts, load)


def panel_van(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a van with a slanting nose and a long closed body."""
    high, length = rng.uniform(1.9, 2.4), rng.uniform(4.4, 5.4)
    nose = length / 2
    shape = CarShape(
        length,
        rng.uniform(1.85, 2.0),
        high,
        0.62 * high,
        0.5 * high,
        nose - 0.7,
        nose - 1.5,
        0.2 - nose,
        0.05 - nose,
        0.34,
        0.6 * length,
    )
    body = drawn_car(shape)(rng, color, rgb)
    side = box((0.62 * length, shape.width_m + 0.01, 0.3 * high), (-0.16 * length, 0, 0.78 * high), rgb, 0.05)
    return joined("car", color, body.parts, side)


def with_caravan(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck's trailer with one axle, or a caravan, behind a van."""
    half, high = rng.uniform(2.2, 3.2), rng.uniform(2.5, 3.0)
    home = box((2 * half, 2.3, high - 0.5), (-half, 0, (high + 0.5) / 2), rgb, 0.06)
    panes = [box((1.1, 2.32, 0.5), (-half + x, 0, 0.65 * high), GLASS, 0.05) for x in (-0.8, 0.9)]
    panes += [box((2 * half + 0.02, 1.4, 0.5), (-half, 0, 0.65 * high), GLASS, 0.05)]
    return joined(
        "truck",
        color,
        home,
        panes,
        at(cab(rng, 0, 2.2, rgb), 3.2, 0),
        at(wheels(9, 2.3, (0.0, 2.2), 0.4), -half, 0),
        at(wheels(9, 2.2, (0.0,), 0.4), 2.4, 0),
    )


def refuse_truck(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck with a rounded body and a hopper at its back."""
    half, wide, high = rng.uniform(3.6, 4.6), 2.5, rng.uniform(3.0, 3.5)
    hull = [box((2 * half - 3.6, wide, high - 0.9), (-0.2, 0, (high + 0.9) / 2), rgb, 0.06)]
    hull += [cylinder((1.4 - half, -wide / 2, 1.9), (1.4 - half, wide / 2, 1.9), 1.0, shaded(rgb, 0.8), 0.08)]
    hull += [box((1.0, wide - 0.2, 1.2), (0.6 - half, 0, 1.5), (60, 62, 64), 0.1)]
    hull += [box((0.06, 0.2, 0.2), (0.1 - half, s, 2.2), (232, 140, 24)) for s in (-1, 1)]
    return joined(
        "truck",
        color,
        hull,
        cab(rng, half, wide, shaded(rgb, 1.1)),
        wheels(half, wide, (half - 1.2, 1.8 - half, 3.1 - half)),
    )


def mixer(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck with a drum for concrete."""
    half, wide = rng.uniform(3.8, 4.5), 2.5
    drum = [
        cone((1.2 - half, 0, 2.5), (-0.6, 0, 2.2), 0.7, 1.2, rgb, 0.1),
        cone((-0.6, 0, 2.2), (half - 2.2, 0, 1.9), 1.2, 0.8, shaded(rgb, 0.9), 0.1),
        cone((0.4 - half, 0, 2.9), (1.2 - half, 0, 2.5), 0.5, 0.6, STEEL, 0.1),
    ]
    frame = [
        box((2 * half - 0.4, 1.2, 0.4), (0, 0, 0.9), (48, 48, 50), 0.1),
        box((0.9, 2.2, 0.1), (0.8 - half, 0, 1.1), STEEL),
    ]
    guard = box((0.1, wide - 0.1, 0.25), (0.05 - half, 0, 0.6), STEEL, 0.1)
    return joined(
        "truck",
        color,
        drum,
        frame,
        guard,
        cab(rng, half, wide, rgb),
        wheels(half, wide, (half - 1.2, 1.6 - half, 2.9 - half)),
    )


def curtain_truck(rng: Rng, _color: str, rgb: Rgb) -> Thing:
    """Return a truck with a sheeted body of another colour than its cab and a lifting platform behind."""
    half, wide, high = rng.uniform(3.4, 5.0), 2.5, rng.uniform(2.8, 3.7)
    other: Rgb = tuple(int(c) for c in rng.integers(40, 230, 3))  # type: ignore[assignment]
    hull = [box((2 * half - 2.1, wide, high - 1.0), (-1.05, 0, (high + 1.0) / 2), other, 0.08)]
    hull += [
        box((0.05, wide + 0.02, high - 1.0), (x, 0, (high + 1.0) / 2), shaded(other, 0.75))
        for x in np.arange(0.3 - half, half - 2.2, 0.9)
    ]
    hull += [
        box((0.05, wide - 0.1, 1.2), (-half - 0.03, 0, 1.4), STEEL, 0.08),
        box((0.06, 0.06, high - 1.1), (-half, 0, (high + 1) / 2), STEEL),
    ]
    hull += [box((0.06, 0.3, 0.15), (-half - 0.03, s, 0.7), (176, 20, 18)) for s in (-1, 1)]
    return joined(
        "truck",
        "",
        hull,
        cab(rng, half, wide, rgb),
        wheels(half, wide, (half - 1.2, 1.6 - half, 2.8 - half)[: rng.integers(2, 4)]),
    )


def timber_truck(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a truck that carries pipes or trunks between stakes."""
    half, wide = rng.uniform(4.0, 5.5), 2.5
    logs = [
        cylinder((0.3 - half, y, z), (half - 2.4, y, z), 0.24, shaded((128, 96, 66), rng.uniform(0.8, 1.3)), 0.25)
        for z, row in ((1.4, 5), (1.85, 4), (2.3, 3))
        for y in (np.arange(row) - (row - 1) / 2) * 0.48
    ]
    stakes = [
        box((0.1, 0.1, 1.7), (x, s * 1.2, 2.0), STEEL) for x in np.linspace(0.8 - half, half - 2.8, 4) for s in (-1, 1)
    ]
    frame = box((2 * half - 0.4, 2.2, 0.25), (0, 0, 1.05), (48, 48, 50), 0.1)
    guard = box((0.1, wide - 0.1, 0.25), (0.05 - half, 0, 0.6), (200, 40, 36), 0.1)
    return joined(
        "truck",
        color,
        logs,
        stakes,
        frame,
        guard,
        cab(rng, half, wide, rgb),
        wheels(half, wide, (half - 1.2, 1.6 - half, 2.8 - half)),
    )


def digger(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a tractor: large wheels behind, a bonnet, a cabin."""
    parts = [
        box((2.0, 0.8, 0.8), (1.0, 0, 1.15), rgb, 0.08),
        box((1.5, 1.5, 1.5), (-0.7, 0, 2.0), GLASS, 0.05),
        box((1.6, 1.6, 0.15), (-0.7, 0, 2.8), rgb, 0.05),
        box((1.4, 1.3, 0.7), (-0.8, 0, 1.1), rgb, 0.08),
        *(box((0.08, 0.08, 1.4), (x, s * 0.75, 2.05), rgb) for x in (-1.4, 0.05) for s in (-1, 1)),
        *(cylinder((-0.9, s * 0.95, 0.85), (-0.9, s * 1.3, 0.85), 0.85, RUBBER, 0.1) for s in (-1, 1)),
        *(cylinder((1.4, s * 0.75, 0.5), (1.4, s * 1.05, 0.5), 0.5, RUBBER, 0.1) for s in (-1, 1)),
    ]
    return whole(rng, joined("truck", color, parts), 0.12)


# --- railings and poles -----------------------------------------------------------------------------------------------


def crowd_barrier(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return barriers of tube with thin upright bars, one after the other."""
    count, long, tall = int(rng.integers(1, 4)), rng.uniform(1.8, 2.4), rng.uniform(0.95, 1.15)
    parts: list[Part] = []
    for i in range(count):
        x0, x1 = (i - count / 2) * long, (i - count / 2 + 1) * long - 0.15
        parts += [capsule((x0, 0, z), (x1, 0, z), 0.022, rgb) for z in (0.2, tall)]
        parts += [capsule((x, 0, 0.2), (x, 0, tall), 0.022, rgb) for x in (x0, x1)]
        parts += [capsule((x, 0, 0.2), (x, 0, tall), 0.009, rgb) for x in np.arange(x0, x1, 0.13)]
        parts += [box((0.05, 0.6, 0.03), (x, 0, 0.02), rgb) for x in (x0 + 0.2, x1 - 0.2)]
    return joined("railing", color, parts)


def cables(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return ropes of steel or chains between short posts."""
    half, tall, step = rng.uniform(2, 6), rng.uniform(0.7, 1.1), rng.uniform(1.2, 2.2)
    ropes = [capsule((-half, 0, z * tall), (half, 0, z * tall), 0.018, STEEL, 0.2) for z in (0.45, 0.7, 0.93)]
    posts = [cylinder((x, 0, 0), (x, 0, tall), 0.05, rgb, 0.1) for x in np.arange(0.1 - half, half, step)]
    return joined("railing", color, ropes, posts)


def panes(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a railing of thin panels with gaps below and between."""
    count, long, tall = int(rng.integers(2, 6)), rng.uniform(0.8, 1.4), rng.uniform(0.95, 1.3)
    parts: list[Part] = []
    for i in range(count):
        x = (i - count / 2 + 0.5) * long
        parts += [
            box((long - 0.14, 0.02, tall - 0.25), (x, 0, tall / 2 + 0.08), shaded(rgb, rng.uniform(0.85, 1.1)), 0.12)
        ]
        parts += [capsule((x - long / 2, 0, 0), (x - long / 2, 0, tall + 0.04), 0.03, STEEL)]
    return joined(
        "railing",
        color,
        parts,
        capsule((-count * long / 2, 0, tall + 0.04), (count * long / 2, 0, tall + 0.04), 0.03, STEEL),
    )


def double_rail(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return guard rails of two beams over each other, one on each side of the posts."""
    half, high = rng.uniform(3, 8), rng.uniform(0.75, 1.1)
    beams = [
        box((2 * half, 0.06, 0.28), (0, s * 0.12, z), rgb, 0.1)
        for s in (-1, 1)
        for z in (high - 0.15, high - 0.6)
        if z > 0.25
    ]
    posts = [
        box((0.14, 0.1, high), (x, 0, high / 2), shaded(rgb, 0.7), 0.1)
        for x in np.arange(0.2 - half, half, rng.uniform(1.3, 2.6))
    ]
    return joined("railing", color, beams, posts)


def rails_of_any_kind(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fence of any mixture of posts, level rails and upright bars."""
    half, tall = rng.uniform(1.2, 5), rng.uniform(0.8, 1.9)
    thin, pitch = rng.uniform(0.008, 0.06), rng.uniform(0.1, 0.4)
    rails = [
        box((2 * half, 0.04, rng.uniform(0.03, 0.16)), (0, 0.02, z), rgb, 0.12)
        for z in np.linspace(0.15, tall, rng.integers(2, 5))
    ]
    bars = [
        box((thin, 0.02, tall - 0.1), (x, 0, tall / 2), shaded(rgb, 0.95), 0.12) for x in np.arange(-half, half, pitch)
    ]
    posts = [
        box((0.08, 0.08, tall + 0.05), (x, 0, tall / 2), shaded(rgb, 0.8), 0.12)
        for x in np.linspace(-half, half, rng.integers(2, 5))
    ]
    return joined("railing", color, rails, posts, *([bars] if rng.random() < 0.6 else []))


def bollard_lamp(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a short thick post with a head."""
    high = rng.uniform(0.9, 1.6)
    return joined(
        "pole",
        color,
        cylinder((0, 0, 0), (0, 0, high), 0.09, rgb, 0.1),
        cylinder((0, 0, high), (0, 0, high + 0.15), 0.13, WHITE),
    )


def signal_arm(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a post whose arm carries a box of lights or a board."""
    high, reach = rng.uniform(3, 5), rng.uniform(0.8, 2.2)
    case = box((0.25, 0.35, 0.8), (0.05, reach, high - 0.3), (40, 42, 40), 0.05)
    return joined(
        "pole",
        color,
        cylinder((0, 0, 0), (0, 0, high), 0.08, rgb, 0.1),
        capsule((0, 0, high - 0.05), (0, reach, high), 0.04, rgb),
        case,
    )


def timber_pole(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a square post of any thickness, with a small board."""
    high, half = rng.uniform(1.8, 5), rng.uniform(0.04, 0.12)
    board = box(
        (0.03, rng.uniform(0.3, 0.9), rng.uniform(0.15, 0.5)),
        (half + 0.02, 0, high * rng.uniform(0.6, 0.95)),
        WHITE,
        0.06,
    )
    return joined("pole", color, box((2 * half, 2 * half, high), (0, 0, high / 2), rgb, 0.2), board)


# --- forks ------------------------------------------------------------------------------------------------------------


def island(rng: Rng, start: float, angle: float) -> tuple[Part, ...]:
    """Return two sides that widen behind a nose: rails, walls, kerbs with plants, or rows of boards."""
    run, kind = rng.uniform(4, 10), rng.integers(4)
    if kind == 0:
        high = rng.uniform(0.7, 1.0)
        side = at(railing(1, "", STEEL, run, high, bars=bool(rng.integers(2))).parts, run / 2, 0)
    elif kind == 1:
        high = rng.uniform(0.5, 1.0)
        side = (box((run, rng.uniform(0.2, 0.5), high), (run / 2, 0, high / 2), CONCRETE, 0.15),)
    elif kind == 2:
        side = (
            box((run, 0.06, 0.3), (run / 2, 0, 0.65), STEEL, 0.1),
            *(box((0.12, 0.1, 0.7), (x, 0, 0.35), shaded(STEEL, 0.8)) for x in np.arange(0.2, run, 1.8)),
        )
    else:
        side = tuple(
            box((0.85, 0.4, 0.8), (x, 0, 0.4), WHITE if i % 2 else (186, 36, 34), 0.08)
            for i, x in enumerate(np.arange(0.45, run, 0.95))
        )
    return (*spread(side, -1, start, angle), *spread(side, 1, start, angle))


def any_fork(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a fork of any nose - round, square, a row of drums, tubes, none - before any sides, under any sign."""
    high, half, kind = rng.uniform(0.75, 1.5), rng.uniform(0.3, 0.7), rng.integers(5)
    light = (235, 235, 230) if rng.random() < 0.6 else (28, 28, 30)
    if kind == 0:
        nose = [
            cylinder((half, 0, z), (half, 0, z + 0.15), half, light if i % 2 else rgb, 0.06)
            for i, z in enumerate(np.arange(0, high, 0.15))
        ]
    elif kind == 1:
        deep = rng.uniform(0.1, 0.7)
        nose = [box((deep, 2 * half, high), (deep / 2, 0, high / 2), rgb, 0.08)]
        nose += [box((0.02, 0.2, high * 0.9), (-0.01, y, high / 2), light, 0.05) for y in (-half + 0.15, half - 0.15)]
    elif kind == 2:
        nose = [
            cylinder(
                (half + 2.2 * half * i, 0, 0), (half + 2.2 * half * i, 0, high), half, light if i % 2 else rgb, 0.08
            )
            for i in range(rng.integers(1, 4))
        ]
    elif kind == 3:
        nose = [
            cylinder((0.15, y, 0), (0.15, y, high), 0.12, light if i % 2 else rgb, 0.08)
            for i, y in enumerate(np.arange(-half, half + 0.01, 0.24))
        ]
    else:
        nose = [
            cylinder((half, 0, 0.5), (half, 0, 0.85), half, rgb, 0.08),
            box((0.1, 0.1, 0.85), (half, 0, 0.42), STEEL),
        ]
    sign = []
    if rng.random() < 0.5:
        top = high + rng.uniform(0.4, 1.2)
        sign = [cylinder((half + 0.1, 0, 0), (half + 0.1, 0, top), 0.035, STEEL)]
        plate = (28, 72, 160) if rng.random() < 0.6 else (226, 186, 30)
        if kind != 2 and rng.random() < 0.5:
            sign += [cylinder((half, 0, top), (half + 0.03, 0, top), 0.3, plate)]
        else:
            sign += [box((0.03, rng.uniform(0.4, 0.7), rng.uniform(0.4, 0.9)), (half, 0, top), plate, 0.05)]
    start = rng.uniform(0.3, 2.0)
    return joined("fork", color, nose, sign, island(rng, start, rng.uniform(0.09, 0.2)))


# --- walls, plants, debris --------------------------------------------------------------------------------------------


def container(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a container or a cabin without wheels."""
    size = (2.4, rng.uniform(3, 6.1), rng.uniform(2.4, 2.8))
    ribs = [
        box((size[0] + 0.04, 0.1, size[2] - 0.2), (0, y, size[2] / 2), shaded(rgb, 0.8))
        for y in np.arange(-size[1] / 2 + 0.2, size[1] / 2, 0.35)
    ]
    return joined("wall", color, box(size, (0, 0, size[2] / 2), rgb, 0.12), ribs)


def panelled(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a high wall of panels between steel posts."""
    count, wide, high = int(rng.integers(1, 4)), rng.uniform(1.8, 3), rng.uniform(1.6, 3.5)
    panels = [
        box(
            (0.12, wide - 0.1, high),
            (0, (i - (count - 1) / 2) * wide, high / 2),
            shaded(rgb, rng.uniform(0.85, 1.1)),
            0.25,
        )
        for i in range(count)
    ]
    posts = [box((0.18, 0.12, high + 0.1), (0, (i - count / 2) * wide, high / 2), STEEL) for i in range(count + 1)]
    return joined("wall", color, panels, posts)


def rough(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a wall of round stones under a slab."""
    length, high = rng.uniform(2, 6), rng.uniform(0.7, 1.8)
    stones = [
        ellipsoid(
            rng.uniform((0.15, 0.18, 0.13), (0.25, 0.32, 0.2)), (0, y, z), shaded(rgb, rng.uniform(0.75, 1.2)), 0.3
        )
        for z in np.arange(0.13, high, 0.26)
        for y in np.arange(-length / 2, length / 2, 0.42) + rng.uniform(0, 0.2)
    ]
    return joined(
        "wall",
        color,
        stones,
        box((0.3, length, high - 0.1), (0, 0, high / 2 - 0.05), shaded(rgb, 0.6), 0.3),
        box((0.5, length + 0.3, 0.12), (0, 0, high), CONCRETE, 0.15),
    )


def kiosk(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a house of any size with windows, a porch, or a stepped front."""
    size = rng.uniform((3, 3, 2.3), (8, 9, 5.5))
    parts = [box(size, (0, 0, size[2] / 2), rgb, 0.2)]
    for y in np.arange(-size[1] / 2 + 0.8, size[1] / 2 - 0.5, rng.uniform(1.2, 2.2)):
        parts += [box((size[0] + 0.06, 0.8, 1.0), (0, y, min(1.6, size[2] - 0.7)), GLASS, 0.05)]
    parts += [
        box(
            (1.0, size[1] * 0.5, size[2] * 0.55),
            (-size[0] / 2 - 0.4, size[1] * rng.uniform(-0.2, 0.2), size[2] * 0.275),
            shaded(rgb, 0.85),
            0.2,
        )
    ]
    return joined("wall", color, parts)


def low_wall(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a plain barrier of any length on a plinth."""
    length, high, deep = rng.uniform(1.2, 7), rng.uniform(0.6, 1.4), rng.uniform(0.2, 0.5)
    plinth = box((deep + 0.12, length, 0.2), (0, 0, 0.1), shaded(rgb, 0.75), 0.2)
    return joined("wall", color, box((deep, length, high), (0, 0, high / 2), rgb, 0.22), plinth)


def poplar(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a slender tree or a shrub, green from the ground up."""
    high, wide = rng.uniform(1.5, 6), rng.uniform(0.35, 0.9)
    return joined("vegetation", "green", tufts(rng, 45, (0.15, 0.35), (wide, wide, high / 2), high / 2, crown(rng)))


def thicket(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return bushes of several kinds beside each other."""
    parts = [
        at(tufts(rng, 22, (0.12, 0.35), (r, r, h), h, crown(rng)), rng.uniform(-0.4, 0.4), y)
        for y in np.arange(0, rng.uniform(0.5, 4), 0.9)
        for r, h in [(rng.uniform(0.35, 0.8), rng.uniform(0.35, 1.1))]
    ]
    return joined("vegetation", "green", *parts)


def grasses(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return tall grass or reed."""
    rgb, wide = crown(rng), rng.uniform(0.3, 1.5)
    blades = [
        capsule((x, y, 0), (x + dx, y + dy, z), 0.025, shaded(rgb, rng.uniform(0.8, 1.5)), 0.3)
        for x, y, dx, dy, z in zip(
            *rng.normal(0, [[0.25], [wide / 2], [0.15], [0.2]], (4, 80)), rng.uniform(0.5, 1.5, 80), strict=True
        )
    ]
    return joined("vegetation", "green", blades, tufts(rng, 15, (0.1, 0.3), (0.3, wide / 2, 0.15), 0.3, rgb))


def acacia(rng: Rng, _color: str, _rgb: Rgb) -> Thing:
    """Return a tree with several trunks and a wide, low crown."""
    high, rgb, reach = rng.uniform(2.5, 5), crown(rng), rng.uniform(1.0, 2.2)
    trunks = [
        capsule((0, 0, 0.05), (0.4 * reach * dx, 0.4 * reach * dy, 0.75 * high), 0.08, (98, 78, 58), 0.3)
        for dx, dy in rng.normal(0, 0.8, (3, 2))
    ]
    return joined(
        "vegetation", "green", trunks, tufts(rng, 45, (0.2, 0.5), (reach, reach, 0.25 * high), 0.8 * high, rgb)
    )


def dustbin(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a dustbin on wheels, upright or lying."""
    parts = [box((0.5, 0.45, 0.75), (0, 0, 0.45), rgb, 0.08), box((0.56, 0.5, 0.06), (0.02, 0, 0.86), shaded(rgb, 0.8))]
    parts += [cylinder((-0.22, y, 0.1), (-0.22, y + 0.04, 0.1), 0.1, RUBBER) for y in (-0.24, 0.2)]
    if rng.random() < 0.5:
        parts = list(carried(parts, pose(rotation_from_rotvec([0, np.pi / 2, 0]), [-0.45, 0, 0.28])))
    return whole(rng, joined("debris", color, parts), 0.12)


def heap(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a heap of boards, bricks or boxes of any size."""
    pieces = [
        tilted(
            box(
                rng.uniform((0.15, 0.1, 0.05), (0.7, 0.5, 0.3)),
                (*rng.uniform(-0.3, 0.3, 2), z),
                shaded(rgb, rng.uniform(0.75, 1.2)),
                0.15,
            ),
            *rng.normal(0, 0.25, 2),
        )
        for z in np.linspace(0.12, rng.uniform(0.35, 0.7), rng.integers(4, 9))
    ]
    return joined("debris", color, pieces)


def chair(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a chair or a small table."""
    half, seat, back = rng.uniform(0.2, 0.4), rng.uniform(0.42, 0.7), rng.random() < 0.6
    parts = [box((2 * half, 2 * half, 0.05), (0, 0, seat), rgb, 0.1)]
    parts += [
        box((0.05, 0.05, seat), (x * half * 0.9, y * half * 0.9, seat / 2), rgb) for x in (-1, 1) for y in (-1, 1)
    ]
    parts += [box((0.04, 2 * half, 0.4), (-half, 0, seat + 0.22), rgb, 0.1)] if back else []
    return joined("debris", color, parts)


def any_box(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return a cabinet of any proportions, turned over or under a lid."""
    size = rng.uniform((0.25, 0.3, 0.4), (0.8, 0.9, 0.85))
    lid = box((size[0] + 0.06, size[1] + 0.06, 0.08), (0, 0, size[2]), shaded(rgb, 1.15))
    body = box(size, (0, 0, size[2] / 2), rgb, 0.15)
    return joined("debris", color, body, *([lid] if rng.random() < 0.5 else []))


def stacked(rng: Rng, color: str, rgb: Rgb) -> Thing:
    """Return tyres, buckets or crates over each other."""
    count, wide, thick = int(rng.integers(2, 5)), rng.uniform(0.22, 0.35), rng.uniform(0.14, 0.25)
    if rng.random() < 0.5:
        return joined(
            "debris",
            color,
            [
                cylinder((0, 0, i * thick), (0, 0, (i + 0.92) * thick), wide, shaded(rgb, rng.uniform(0.85, 1.1)), 0.15)
                for i in range(count)
            ],
        )
    return joined(
        "debris",
        color,
        [
            box(
                (2 * wide, 2.2 * wide, thick * 0.9),
                (*rng.uniform(-0.05, 0.05, 2), (i + 0.5) * thick),
                shaded(rgb, rng.uniform(0.85, 1.1)),
                0.15,
            )
            for i in range(count)
        ],
    )
