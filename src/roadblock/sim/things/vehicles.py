"""Cars, vans and trucks: bodies on wheels, glass between pillars, lamps and bumpers."""

from typing import NamedTuple

import numpy as np

from roadblock.sim.solids import Part, Rgb, Thing, box, capsule, cylinder, ellipsoid, slab, xyz
from roadblock.sim.things.colors import GLASS, RUBBER, STEEL, shaded

PLASTIC: Rgb = (48, 48, 50)
WHITE_LAMP: Rgb = (236, 236, 226)
RED_LAMP: Rgb = (176, 20, 18)
AMBER_LAMP: Rgb = (232, 140, 24)
ARCH: Rgb = (16, 16, 17)
PLATE: Rgb = (232, 230, 214)
GAP_M = 0.2
"""Between body and road."""


class CarShape(NamedTuple):
    """A car seen from its side; x from its middle, metres.

    The greenhouse is the quadrangle (cowl, belt), (roof_front, height), (roof_back, height), (tail, belt).
    """

    length_m: float
    width_m: float
    height_m: float
    belt_m: float
    nose_m: float
    cowl: float
    roof_front: float
    roof_back: float
    tail: float
    wheel_m: float
    wheelbase_m: float


CARS = {
    "small": CarShape(3.60, 1.62, 1.50, 0.92, 0.72, 0.95, 0.35, -1.15, -1.66, 0.28, 2.35),
    "medium": CarShape(4.35, 1.80, 1.46, 0.92, 0.70, 1.05, 0.30, -1.40, -2.05, 0.31, 2.62),
    "saloon": CarShape(4.70, 1.84, 1.44, 0.93, 0.70, 1.15, 0.40, -0.95, -1.65, 0.32, 2.80),
    "large": CarShape(4.75, 1.92, 1.70, 1.08, 0.92, 1.25, 0.55, -1.75, -2.25, 0.36, 2.82),
}
"""Sizes of `car`; the widths are without mirrors."""


def car(number: int, color: str, rgb: Rgb, size: str = "medium", *, rng: np.random.Generator | None = None) -> Thing:
    """Return a car facing x, its middle over the origin.

    Parameters
    ----------
    number, color, rgb
        Its id; name and sRGB of its paint.
    size
        One of `CARS`.
    rng
        Makes length, width and height up to 3 % larger or smaller; None = as in the table.
    """
    shape = CARS[size]
    if rng is not None:
        x, y, z = rng.uniform(0.97, 1.03, 3)
        shape = CarShape(*np.array(shape) * (x, y, z, z, z, x, x, x, x, 1.0, x))
    return Thing(
        number,
        "car",
        color,
        tuple(
            _body(shape, rgb)
            + _greenhouse(shape, rgb)
            + _car_ends(shape, rgb)
            + _wheels(shape.width_m, shape.wheel_m, (shape.wheelbase_m / 2 + 0.05, 0.05 - shape.wheelbase_m / 2))
        ),
    )


def _body(shape: CarShape, rgb: Rgb) -> list[Part]:
    """Return everything below the windows."""
    half, width = shape.length_m / 2, shape.width_m
    belt, nose = shape.belt_m, shape.nose_m
    lower = GAP_M + 0.06
    shoulder = (width - 0.1) / 2
    back = -half + 0.1
    sides: list[Part] = []
    for y in (-shoulder, shoulder):
        sides += [capsule((back, y, belt - 0.07), (shape.cowl, y, belt - 0.07), 0.05, rgb, 0.03)]
        sides += [capsule((shape.cowl, y, belt - 0.07), (half - 0.22, y, nose - 0.04), 0.05, rgb, 0.03)]
    return [
        box((2 * half - 0.16, width, nose - 0.12 - lower), (0, 0, (nose - 0.12 + lower) / 2), rgb, 0.03),
        box((shape.cowl - back, width, 0.3), ((shape.cowl + back) / 2, 0, belt - 0.22), rgb, 0.03),
        box((shape.cowl - back, width - 0.1, 0.3), ((shape.cowl + back) / 2, 0, belt - 0.16), rgb, 0.03),
        slab((shape.cowl - 0.02, belt - 0.005), (half - 0.2, nose), 0.3, width - 0.1, rgb, 0.03),
        slab((shape.cowl - 0.02, belt - 0.075), (half - 0.12, nose - 0.06), 0.2, width, rgb, 0.03),
        box((2 * half - 0.5, width - 0.16, 0.14), (0, 0, GAP_M + 0.07), PLASTIC, 0.1),
        *sides,
    ]


def _greenhouse(shape: CarShape, rgb: Rgb) -> list[Part]:
    """Return glass, pillars and roof."""
    top, belt = shape.height_m - 0.05, shape.belt_m - 0.03
    low, high = shape.width_m / 2 - 0.14, shape.width_m / 2 - 0.22
    front, back = (shape.cowl, belt), (shape.tail, belt)
    wide = 2 * high + 0.02
    parts = [
        slab((shape.roof_front, top), front, 0.42, wide, GLASS, 0.02),
        slab(back, (shape.roof_back, top), 0.3, wide, GLASS, 0.02),
        slab((shape.roof_back, top), (shape.roof_front, top), top - belt, wide, GLASS, 0.02),
        slab((shape.roof_back, top + 0.05), (shape.roof_front, top + 0.05), 0.07, 2 * high, rgb, 0.03),
    ]
    middle = 0.45 * shape.roof_front + 0.55 * shape.roof_back + 0.15
    posts = [(shape.cowl, shape.roof_front, 0.035), (middle, middle, 0.04), (shape.tail, shape.roof_back, 0.06)]
    for side in (-1, 1):
        rail = [(x, side * high, top) for x in (shape.roof_back, shape.roof_front)]
        parts += [capsule(rail[0], rail[1], 0.05, rgb, 0.03)]
        parts += [capsule((a, side * low, belt), (b, side * high, top - 0.02), r, rgb, 0.03) for a, b, r in posts]
        mirror = (shape.cowl - 0.28, side * (shape.width_m / 2 + 0.06), belt + 0.09)
        parts += [ellipsoid((0.07, 0.11, 0.075), mirror, rgb, 0.03)]
    for x in (shape.roof_back, shape.roof_front):
        parts += [capsule((x, -high, top), (x, high, top), 0.05, rgb, 0.03)]
    return parts


def _car_ends(shape: CarShape, rgb: Rgb) -> list[Part]:
    """Return bumpers, lamps, grille and number plates."""
    half, y, nose, belt = shape.length_m / 2, shape.width_m / 2, shape.nose_m, shape.belt_m
    parts = []
    for x, inward in ((half, -1), (-half, 1)):
        for z, paint in ((0.36, PLASTIC), (0.5, rgb)):
            at = x + inward * 0.12
            parts += [capsule((at, -y + 0.12, z), (at, y - 0.12, z), 0.12, paint, 0.04)]
        parts += [box((0.02, 0.52, 0.11), (x + inward * 0.012, 0, 0.45), PLATE, 0.02)]
        parts += [box((0.024, 0.06, 0.07), (x + inward * 0.0121, k, 0.45), PLASTIC, 0.0) for k in (-0.16, -0.04, 0.1)]
    parts += [box((0.06, 0.9, 0.12), (half - 0.09, 0, nose - 0.15), PLASTIC, 0.15)]
    # The tail: a flat panel up to the belt with lamps at its corners.
    parts += [box((0.1, 2 * y - 0.1, belt - 0.5), (-half + 0.13, 0, (belt + 0.46) / 2), rgb, 0.03)]
    for side in (-1, 1):
        parts += [ellipsoid((0.16, 0.2, 0.085), (half - 0.2, side * (y - 0.2), nose - 0.13), WHITE_LAMP, 0.05)]
        parts += [box((0.1, 0.22, 0.2), (-half + 0.11, side * (y - 0.17), belt - 0.16), RED_LAMP, 0.05)]
        parts += [box((0.1, 0.2, 0.05), (-half + 0.105, side * (y - 0.17), belt - 0.16), AMBER_LAMP, 0.05)]
    return parts


def _wheels(width_m: float, radius_m: float, axles: tuple[float, ...]) -> list[Part]:
    """Return a pair of wheels for each axle's x, flush with a body of this width, and their arches."""
    parts = []
    for x in axles:
        for side in (-1, 1):
            outer, inner = side * width_m / 2, side * (width_m / 2 - 0.2)
            hub = np.array([x, 0.0, radius_m])
            parts += [
                cylinder(
                    hub + xyz(0, inner, 0.04), hub + xyz(0, outer + side * 0.003, 0.04), radius_m + 0.035, ARCH, 0.0
                ),
                cylinder(hub + xyz(0, inner, 0), hub + xyz(0, outer + side * 0.008, 0), radius_m, RUBBER, 0.12),
                cylinder(
                    hub + xyz(0, inner, 0), hub + xyz(0, outer + side * 0.012, 0), 0.62 * radius_m, (70, 72, 76), 0.05
                ),
            ]
            for angle in 0.3 + 2 * np.pi * np.arange(5) / 5:
                rim = hub + xyz(0.56 * radius_m * np.sin(angle), outer + side * 0.006, 0.56 * radius_m * np.cos(angle))
                parts += [capsule(hub + xyz(0, outer + side * 0.006, 0), rim, 0.024, STEEL, 0.05)]
    return parts


def van(number: int, color: str, rgb: Rgb, *, rng: np.random.Generator | None = None) -> Thing:
    """Return a van facing x: 5.2 x 2.0 x 2.3 m (length x width x height, without mirrors; up to 3 % off with `rng`)."""
    x, y, z = np.ones(3) if rng is None else rng.uniform(0.97, 1.03, 3)
    half, wide, high, belt = 2.6 * x, 2.0 * y, 2.3 * z, 1.25 * z
    roof = half - 1.35
    cowl = half - 0.75
    parts = [
        box((half + roof - 0.02, wide, high - 0.45), ((roof - half + 0.02) / 2, 0, (high + 0.45) / 2), rgb, 0.03),
        slab((roof - 0.05, high - 0.1), (cowl, belt), 0.5, wide - 0.06, rgb, 0.03),
        box((cowl + half - 0.1, wide, belt - 0.36), ((cowl - half + 0.1) / 2, 0, (belt + 0.34) / 2), rgb, 0.03),
        slab((cowl - 0.1, belt), (half - 0.1, belt - 0.28), 0.7, wide - 0.04, rgb, 0.03),
        box((2 * half - 0.3, wide - 0.2, 0.2), (0, 0, 0.32), PLASTIC, 0.1),
        slab((roof + 0.07, high - 0.2), (cowl - 0.04, belt + 0.06), 0.1, wide - 0.3, GLASS, 0.02, 0.0),
        *_van_ends(half, wide, high, belt, roof),
        *_wheels(wide, 0.34, (half - 0.95, 1.0 - half)),
    ]
    return Thing(number, "van", color, tuple(parts))


def _van_ends(half: float, wide: float, high: float, belt: float, roof: float) -> list[Part]:
    """Return glass, lamps, bumpers and mirrors of a van."""
    y = wide / 2
    parts: list[Part] = [
        box((0.03, 0.015, high - 0.5), (0.015 - half, 0, high / 2 + 0.15), PLASTIC, 0.0),
        box((0.02, 0.52, 0.11), (0.01 - half, 0.0, 0.75), PLATE, 0.02),
        box((0.02, 0.52, 0.11), (half - 0.01, 0.0, 0.5), PLATE, 0.02),
        box((0.04, 1.1, 0.18), (half - 0.06, 0, 0.78), PLASTIC, 0.15),
    ]
    for x in (half - 0.13, 0.1 - half):
        parts += [capsule((x, 0.13 - y, 0.48), (x, y - 0.13, 0.48), 0.13 if x > 0 else 0.1, PLASTIC, 0.08)]
    for side in (-1, 1):
        parts += [box((0.9, 0.02, 0.55), (roof - 0.25, side * y, belt + 0.33), GLASS, 0.02)]
        parts += [box((0.02, 0.6, 0.6), (0.012 - half, side * 0.45, high - 0.55), GLASS, 0.02)]
        parts += [box((0.06, 0.12, 0.6), (0.03 - half, side * (y - 0.07), 1.1), RED_LAMP, 0.05)]
        parts += [ellipsoid((0.2, 0.18, 0.12), (half - 0.2, side * (y - 0.22), 0.82), WHITE_LAMP, 0.05)]
        parts += [box((0.06, 0.16, 0.26), (roof + 0.35, side * (y + 0.1), belt + 0.2), PLASTIC, 0.08)]
    return parts


def truck(number: int, color: str, rgb: Rgb, *, rng: np.random.Generator | None = None) -> Thing:
    """Return a box truck facing x: 8.2 x 2.5 x 3.5 m (length x width x height, without mirrors).

    With `rng` it is up to 3 % off, and the box has a colour of its own.
    """
    x, y, z = np.ones(3) if rng is None else rng.uniform(0.97, 1.03, 3)
    cargo = shaded((214, 214, 208), 1.0 if rng is None else float(rng.uniform(0.6, 1.1)))
    half, wide, high = 4.1 * x, 2.5 * y, 3.5 * z
    cab = half - 1.75
    parts = [
        box((half + cab - 0.28, wide, high - 1.15), ((cab - 0.22 - half) / 2, 0, (high + 1.15) / 2), cargo, 0.06),
        box((1.65, wide - 0.1, 1.0), (half - 0.9, 0, 1.05), rgb, 0.03),
        box((1.6, wide - 0.16, 1.35), (half - 0.95, 0, 2.2), rgb, 0.03),
        box((2 * half - 0.5, 0.9, 0.25), (0, 0, 0.88), PLASTIC, 0.15),
        box((0.04, wide - 0.4, 0.8), (half - 0.15, 0, 2.25), GLASS, 0.02),
        box((0.06, 1.5, 0.3), (half - 0.08, 0, 0.95), PLASTIC, 0.15),
        *_truck_ends(half, wide, high, cab),
        *_truck_wheels(wide, (half - 1.25, 1.9 - half)),
    ]
    return Thing(number, "truck", color, tuple(parts))


def _truck_ends(half: float, wide: float, high: float, cab: float) -> list[Part]:
    """Return doors, lamps, guards and mirrors of a truck."""
    y = wide / 2
    edge, low = shaded(STEEL, 0.8), (high + 1.15) / 2
    parts: list[Part] = [
        capsule((half - 0.15, 0.15 - y, 0.6), (half - 0.15, y - 0.15, 0.6), 0.15, PLASTIC, 0.08),
        box((0.06, wide - 0.2, 0.12), (0.1 - half, 0, 0.5), PLASTIC, 0.08),
        box((0.05, 0.03, high - 1.25), (0.03 - half, 0, low), PLASTIC, 0.0),
        box((0.03, 0.52, 0.11), (0.06 - half, 0, 0.68), PLATE, 0.02),
    ]
    for side in (-1, 1):
        parts += [box((0.06, 0.1, high - 1.15), (0.05 - half, side * (y - 0.05), low), edge, 0.05)]
        parts += [
            capsule((0.018 - half, side * k, 1.2), (0.018 - half, side * k, high - 0.1), 0.018, STEEL, 0.05)
            for k in (0.25, 0.7)
        ]
        parts += [box((0.06, 0.4, 0.14), (0.06 - half, side * (y - 0.3), 0.72), RED_LAMP, 0.05)]
        parts += [box((0.08, 0.08, 0.4), (0.14 - half, side * 0.6, 0.7), PLASTIC, 0.08)]
        parts += [box((0.08, 0.4, 0.2), (half - 0.06, side * (y - 0.35), 0.85), WHITE_LAMP, 0.05)]
        parts += [box((0.8, 0.03, 0.7), (half - 0.85, side * (y - 0.07), 2.3), GLASS, 0.02)]
        parts += [box((0.08, 0.2, 0.5), (half - 0.1, side * (y + 0.14), 2.35), PLASTIC, 0.08)]
        parts += [capsule((half - 0.14, side * (y - 0.1), 2.55), (half - 0.1, side * (y + 0.14), 2.55), 0.02, PLASTIC)]
        parts += [box((1.6, 0.05, 0.35), (cab - 2.2, side * (y - 0.08), 0.7), STEEL, 0.08)]
    for k in (-0.6, 0.6):
        parts += [box((0.06, wide - 0.02, 0.08), (0.05 - half, 0, low + k * (high - 1.25) / 1.2), edge, 0.05)]
    return parts


def _truck_wheels(wide: float, axles: tuple[float, ...]) -> list[Part]:
    parts = []
    for x in axles:
        for side in (-1, 1):
            hub = np.array([x, side * (wide / 2 - 0.05), 0.5])
            inward = np.array([0.0, -side * (0.32 if x > 0 else 0.6), 0.0])
            parts += [
                cylinder(hub + inward, hub, 0.5, RUBBER, 0.12),
                cylinder(hub + inward, hub + xyz(0, side * 0.005, 0), 0.29, (150, 150, 148), 0.08),
                cylinder(hub, hub + xyz(0, side * 0.04, 0), 0.12, STEEL, 0.1),
            ]
    return parts
