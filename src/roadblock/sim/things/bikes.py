"""Bicycles, alone and ridden. Thin tubes and thin wheels: one sees through them."""

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Rgb, Thing, box, capsule, carried, cylinder, ellipsoid, ring, scaled, xyz
from roadblock.sim.things.colors import RUBBER, STEEL
from roadblock.sim.things.people import Looks, arm, hand, head, leg, shoe, trunk
from roadblock.values.checks import FloatArray

LENGTH_M, HEIGHT_M = 1.73, 1.06
"""Of a bicycle for adults, over its tyres and up to its grips."""

WHEEL_M = 0.34
"""Radius over the tyre."""

SPOKES = 14
CRANK_M, CRANK_WAY_M = 0.17, 5.0
"""Length of a crank, and the way of one turn of it."""

REAR, FRONT = np.array([-0.525, 0.0, WHEEL_M]), np.array([0.525, 0.0, WHEEL_M])
BOTTOM = np.array([-0.09, 0.0, 0.30])
SEAT, SADDLE = np.array([-0.26, 0.0, 0.83]), np.array([-0.285, 0.0, 0.95])
HEAD_LOW, HEAD_HIGH = np.array([0.40, 0.0, 0.68]), np.array([0.34, 0.0, 0.86])
STEM, GRIPS_M = np.array([0.31, 0.0, 0.99]), 0.29


def bicycle(number: int, color: str, rgb: Rgb, size: float = 1.0, *, rng: np.random.Generator | None = None) -> Thing:
    """Return a bicycle without a rider, upright, facing x.

    Parameters
    ----------
    number, color, rgb
        Its id; name and sRGB of its frame.
    size
        1 = an adult's, `LENGTH_M` long and `HEIGHT_M` high; 0.7 = a child's.
    rng
        Draws how far wheels and cranks are turned, and whether there is a basket; None = always the same.
    """
    gone, basket = (0.0, False) if rng is None else (float(rng.uniform(0, CRANK_WAY_M)), bool(rng.integers(2)))

    def gait(gone_m: float) -> tuple[Part, ...]:
        return scaled(_frame(rgb, basket) + _rolling(gone + gone_m / size), size)

    return Thing(number, "bicycle", color, gait(0.0), gait=gait)


def cyclist(
    number: int,
    color: str,
    jacket: Rgb,
    trousers: Rgb,
    frame: Rgb = (40, 44, 52),
    *,
    rng: np.random.Generator | None = None,
) -> Thing:
    """Return a bicycle and who rides it, facing x.

    Parameters
    ----------
    number, color
        Its id; name of the clothes' colour.
    jacket, trousers, frame
        sRGB 0..255.
    rng
        Draws how far wheels and cranks are turned; None = always the same.
    """
    gone = 0.6 if rng is None else float(rng.uniform(0, CRANK_WAY_M))
    looks = Looks(jacket, trousers)

    def gait(gone_m: float) -> tuple[Part, ...]:
        parts = _frame(frame, basket=False) + _rolling(gone + gone_m)
        return (*parts, *_upper_body(looks), *_pedalling(gone + gone_m, looks))

    return Thing(number, "cyclist", color, gait(0.0), gait=gait)


def _frame(rgb: Rgb, basket: bool) -> tuple[Part, ...]:
    tubes = [(HEAD_HIGH, SEAT, 0.016), (HEAD_LOW, BOTTOM, 0.018), (SEAT, BOTTOM, 0.016), (HEAD_LOW, HEAD_HIGH, 0.02)]
    for side in (-0.05, 0.05):
        aside = np.array([0.0, side, 0.0])
        tubes += [(SEAT, REAR + aside, 0.009), (BOTTOM, REAR + aside, 0.011), (HEAD_LOW, FRONT + aside, 0.013)]
    grips = [STEM + xyz(-0.08, side * GRIPS_M, 0.054) for side in (-1, 1)]
    bar = [STEM + xyz(0.0, side * 0.08, 0.0) for side in (-1, 1)]
    parts = [capsule(a, b, radius, rgb, 0.08) for a, b, radius in tubes]
    parts += [capsule(HEAD_HIGH, STEM, 0.013, STEEL, 0.05), capsule(bar[0], bar[1], 0.013, STEEL, 0.05)]
    parts += [capsule(a, b, 0.014, STEEL, 0.05) for a, b in zip(bar, grips, strict=True)]
    parts += [capsule(b, b - (0.1, 0, 0), 0.016, RUBBER, 0.1) for b in grips]
    parts += [capsule(SEAT, SADDLE - (0, 0, 0.03), 0.013, STEEL, 0.05)]
    parts += [ellipsoid((0.09, 0.075, 0.03), SADDLE - (0.04, 0, 0.01), RUBBER, 0.15)]
    parts += [capsule(SADDLE, SADDLE + xyz(0.13, 0, 0), 0.025, RUBBER, 0.15)]
    parts += [box((0.03, 0.05, 0.05), HEAD_HIGH + xyz(0.06, 0, -0.04), (230, 230, 220), 0.02)]
    parts += [box((0.02, 0.05, 0.06), SEAT - (0.06, 0, 0.1), (170, 24, 20), 0.02)]
    return tuple(parts + (_basket() if basket else []))


def _basket() -> list[Part]:
    """Return a wire basket before the handlebar."""
    low, high = HEAD_HIGH + xyz(0.08, 0, -0.08), HEAD_HIGH + xyz(0.30, 0, 0.14)
    x, z = (low[0], high[0]), (low[2], high[2])
    wires = [((a, -0.16, h), (a, 0.16, h)) for a in x for h in np.linspace(*z, 4)]
    wires += [((x[0], s, h), (x[1], s, h)) for s in (-0.16, 0.16) for h in np.linspace(*z, 4)]
    wires += [((a, s, z[0]), (a, s, z[1])) for a in x for s in np.linspace(-0.16, 0.16, 5)]
    return [capsule(a, b, 0.004, STEEL, 0.05) for a, b in wires]


def _rolling(gone_m: float) -> tuple[Part, ...]:
    """Return wheels and cranks after so many metres."""
    turn = gone_m / WHEEL_M
    parts: list[Part] = []
    for hub in (REAR, FRONT):
        parts += ring(hub, WHEEL_M, 0.018, RUBBER, 0.1)
        parts += ring(hub, WHEEL_M - 0.03, 0.009, STEEL, 0.05)
        parts += [cylinder(hub - (0, 0.045, 0), hub + xyz(0, 0.045, 0), 0.022, STEEL, 0.05)]
        for angle in turn + 2 * np.pi * np.arange(SPOKES) / SPOKES:
            way = np.array([np.sin(angle), 0.0, np.cos(angle)])
            parts += [capsule(hub + 0.02 * way, hub + (WHEEL_M - 0.04) * way, 0.0012, STEEL, 0.0)]
    parts += ring(BOTTOM - (0, 0.05, 0), 0.095, 0.006, STEEL, 0.05, 16)
    for side in (-1, 1):
        crank, pedal = BOTTOM + xyz(0, side * 0.07, 0), _pedal(gone_m, side)
        parts += [capsule(crank, pedal - (0, side * 0.03, 0), 0.011, STEEL, 0.05)]
        parts += [box((0.09, 0.08, 0.025), pedal + xyz(0, side * 0.02, 0), RUBBER, 0.1)]
    parts += [cylinder(BOTTOM - (0, 0.07, 0), BOTTOM + xyz(0, 0.07, 0), 0.02, STEEL, 0.05)]
    return tuple(parts)


def _pedal(gone_m: float, side: int) -> FloatArray:
    angle = 2 * np.pi * gone_m / CRANK_WAY_M + (np.pi if side < 0 else 0.0)
    return BOTTOM + xyz(CRANK_M * np.sin(angle), side * 0.1, CRANK_M * np.cos(angle))


LEAN_RAD = 0.42
HIPS = SADDLE + xyz(-0.02, 0.0, 0.10)


def _leaning() -> FloatArray:
    """Return the pose of an upright adult whose hips are moved onto the saddle and who leans forward."""
    R = rotation_from_rotvec([0.0, LEAN_RAD, 0.0])
    return pose(R, HIPS - R @ (0.0, 0.0, 0.92))


def _upper_body(looks: Looks) -> tuple[Part, ...]:
    T = _leaning()
    shoulder = (T @ (0.0, 0.0, 1.4, 1.0))[:3]
    limbs: list[Part] = []
    for side in (-1, 1):
        begin, wrist = shoulder + xyz(0, side * 0.19, 0), STEM + xyz(-0.13, side * (GRIPS_M - 0.01), 0.09)
        elbow = bent(begin, wrist, 0.29, 0.27, np.array([-0.4, side * 0.6, -1.0]))
        limbs += [*arm(begin, elbow, wrist, looks), hand(wrist + xyz(0.05, 0, -0.03), looks)]
    neck = (T @ (0.0, 0.0, 1.5, 1.0))[:3]
    return (*carried(trunk(looks), T), *carried(head(looks), pose(np.eye(3), neck)), *limbs)


def _pedalling(gone_m: float, looks: Looks) -> tuple[Part, ...]:
    parts: list[Part] = []
    for side in (-1, 1):
        hip, ankle = HIPS + xyz(0, side * 0.09, -0.02), _pedal(gone_m, side) + xyz(-0.06, 0, 0.1)
        knee = bent(hip, ankle, 0.43, 0.42, np.array([1.0, 0.0, 0.3]))
        parts += [*leg(hip, knee, ankle, looks), shoe(ankle, -0.1, looks)]
    return tuple(parts)


def bent(begin: FloatArray, end: FloatArray, first_m: float, second_m: float, towards: FloatArray) -> FloatArray:
    """Return the joint between two limbs of these lengths from begin to end, bent towards a direction.

    Limbs that are too short for the way are stretched.
    """
    way = end - begin
    length = float(np.linalg.norm(way))
    along = (first_m**2 - second_m**2 + length**2) / (2 * length)
    aside = towards - (towards @ way) / length**2 * way
    off = np.sqrt(max(first_m**2 - along**2, 0.0))
    return np.asarray(begin + along / length * way + off / np.linalg.norm(aside) * aside)
