"""What stands or lies on and beside a road: railings, the fork, walls, signs, debris."""

from itertools import pairwise

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import (
    Part,
    Rgb,
    Thing,
    box,
    capsule,
    carried,
    cone,
    cylinder,
    ellipsoid,
    grounded,
    ring,
    scaled,
    xyz,
)
from roadblock.sim.things.colors import COLORS, CONCRETE, RUBBER, STEEL, shaded
from roadblock.values.checks import FloatArray

WHITE: Rgb = (230, 230, 226)


def crate(number: int, color: str, rgb: Rgb, size_m: tuple[float, float, float]) -> Thing:
    """Return a boarded box of (length, width, height) metres."""
    return Thing(number, "box", color, (box(size_m, (0, 0, size_m[2] / 2), rgb, 0.16, "crate"),))


def carton(number: int, color: str, rgb: Rgb, size_m: tuple[float, float, float]) -> Thing:
    """Return a cardboard box of (length, width, height) metres with a strip of tape over it."""
    length, width, height = size_m
    tape = box((length, 0.12 * width, height), (0, 0, height / 2 + 0.0005), shaded(rgb, 1.35), 0.05)
    body = box((length - 0.001, width, height), (0, 0, height / 2), rgb, 0.12)
    return Thing(number, "box", color, grounded((body, tape)))


def railing(
    number: int, color: str, rgb: Rgb, length_m: float = 6.0, height_m: float = 1.0, *, bars: bool = True
) -> Thing:
    """Return a railing along x, its middle over the origin.

    Parameters
    ----------
    number, color, rgb
        Its id; name and sRGB of its paint.
    length_m, height_m
        Its size over everything.
    bars
        Upright bars every 0.14 m between two rails (a street's), or two beams on posts (a country road's).
    """
    half = length_m / 2
    if not bars:
        return Thing(number, "railing", color, tuple(_beams(rgb, half, height_m)))
    radius, rod = 0.025, 0.009
    high, low = height_m - radius, 0.14
    posts = np.linspace(radius - half, half - radius, max(2, round(length_m / 2) + 1))
    rods = np.linspace(-half, half, max(2, round(length_m / 0.14) + 1))[1:-1]
    parts = [capsule((radius - half, 0, z), (half - radius, 0, z), radius, rgb, 0.12) for z in (low, high)]
    parts += [cylinder((x, 0, 0), (x, 0, high), radius, rgb, 0.12) for x in posts]
    parts += [cylinder((x, 0, low), (x, 0, high), rod, rgb, 0.12) for x in rods]
    return Thing(number, "railing", color, tuple(parts))


def _beams(rgb: Rgb, half: float, height_m: float) -> list[Part]:
    """Return posts and two rounded beams of sheet steel on both sides of them."""
    posts = np.linspace(0.06 - half, half - 0.06, max(2, round(2 * half / 2) + 1))
    parts = [box((0.12, 0.06, height_m - 0.03), (x, 0, (height_m - 0.03) / 2), rgb, 0.15) for x in posts]
    for below, radius in ((0.07, 0.07), (0.24, 0.07)):
        z = height_m - below
        parts += [capsule((radius - half, y, z), (half - radius, y, z), radius, rgb, 0.1) for y in (-0.07, 0.07)]
    return [*parts, box((2 * half - 0.14, 0.2, 0.05), (0, 0, height_m - 0.155), shaded(rgb, 0.8), 0.1)]


STRIPE_M = 0.004
"""Thickness of what is painted on a board."""

BAR_M = 0.12
"""Width of a chevron's bars."""

FORK_SPREAD_RAD = 0.16
"""Between the middle of a fork and each of its branches' edges."""

NOSE_M = 0.55
"""Radius of a fork's nose."""


def fork(number: int, color: str, rgb: Rgb, length_m: float = 10.0, height_m: float = 1.15) -> Thing:
    """Return the nose of a divider between two branches of a road, x along the road, its front at x = 0.

    A round kerb, on it a striped nose panel `height_m` high with a sign, behind it an island that widens, and a
    railing along each of its edges: the road is free left and right of it.

    Parameters
    ----------
    number, color, rgb
        Its id; name and sRGB of the panel's bright stripes.
    length_m
        From the nose to where island and railings end.
    height_m
        Of the nose panel.
    """
    parts = [*_island(length_m), *_nose(rgb, height_m), *_keep_sign(height_m)]
    run = length_m - NOSE_M - 0.7
    bars = railing(0, "", STEEL, run, 0.95).parts
    for side in (-1, 1):
        edge = _edge(side)
        # Half a metre inside the kerb's line, so that the railing stands on the island.
        rail = edge @ pose(np.eye(3), [0.7 + run / 2, -side * 0.2, 0.15])
        parts += carried(bars, rail)
    return Thing(number, "fork", color, tuple(parts))


def _edge(side: int) -> FloatArray:
    """Return the pose of an edge of the island: its origin where it leaves the nose, x along it."""
    R = rotation_from_rotvec([0.0, 0.0, side * FORK_SPREAD_RAD])
    return pose(R, [NOSE_M - NOSE_M * np.sin(FORK_SPREAD_RAD), side * NOSE_M * np.cos(FORK_SPREAD_RAD), 0.0])


def _island(length_m: float) -> list[Part]:
    """Return kerb stones and what they hold."""
    kerb = 0.15
    parts = [cylinder((NOSE_M, 0, 0), (NOSE_M, 0, kerb), NOSE_M, CONCRETE, 0.12)]
    run = (length_m - NOSE_M) / np.cos(FORK_SPREAD_RAD)
    for side in (-1, 1):
        parts += carried([box((run, 0.3, kerb), (run / 2, -side * 0.15, kerb / 2), CONCRETE, 0.12)], _edge(side))
    steps = np.linspace(NOSE_M, length_m, 9)
    for low, high in pairwise(steps):
        wide = 2 * (NOSE_M + (low - NOSE_M) * np.tan(FORK_SPREAD_RAD)) - 0.2
        centre = ((low + high) / 2, 0, (kerb - 0.02) / 2)
        parts += [box((high - low, wide, kerb - 0.02), centre, (104, 118, 74), 0.3)]
    return parts


def _nose(rgb: Rgb, height_m: float) -> list[Part]:
    """Return a board across the road with chevrons that point up, its stripes flush with x = 0; behind it a drum."""
    low, half, dark = 0.2, 0.45, COLORS["black"]
    middle = (low + height_m) / 2
    parts = [
        cylinder((NOSE_M, 0, 0), (NOSE_M, 0, height_m - 0.05), NOSE_M - 0.1, (214, 206, 60), 0.08),
        box((0.03, 2 * half, height_m - low), (STRIPE_M + 0.015, 0, middle), dark, 0.06),
    ]
    # Bars at 45 degrees; their inner ends overlap into a point, their outer ones stop within the board.
    reach = half - 0.05
    bar = reach * np.sqrt(2) + BAR_M / 2
    for z in np.arange(low + 0.06, height_m - half - 0.1, 0.27):
        for side in (-1, 1):
            R = rotation_from_rotvec([side * np.pi / 4, 0.0, 0.0])
            outer = np.array([STRIPE_M / 2, -side * reach, z + BAR_M / np.sqrt(2) / 2])
            centre = outer + R @ (0.0, side * bar / 2, 0.0)
            parts += [Part("box", pose(R, centre), np.array([STRIPE_M, bar, BAR_M]) / 2, rgb, 0.06)]
    return parts


def _keep_sign(height_m: float) -> list[Part]:
    """Return a blue disc with white arrows to both sides, on a post over the nose."""
    x, z = NOSE_M, height_m + 0.75
    parts = [
        cylinder((x, 0, height_m), (x, 0, z + 0.25), 0.035, STEEL, 0.1),
        cylinder((x - 0.06, 0, z), (x - 0.04, 0, z), 0.33, WHITE, 0.03),
        cylinder((x - 0.065, 0, z), (x - 0.045, 0, z), 0.31, (28, 72, 160), 0.03),
    ]
    for side in (-1, 1):
        tip, tail = (x - 0.062, side * 0.2, z - 0.14), (x - 0.062, 0.0, z + 0.14)
        parts += [capsule(tail, tip, 0.022, WHITE, 0.02)]
        parts += [capsule(tip, (x - 0.062, side * 0.2, z + 0.0), 0.022, WHITE, 0.02)]
        parts += [capsule(tip, (x - 0.062, side * 0.06, z - 0.14), 0.022, WHITE, 0.02)]
    return parts


def pole(number: int, color: str, rgb: Rgb, height_m: float = 4.5, radius_m: float = 0.07) -> Thing:
    """Return a round post with a foot, a little thinner at its top."""
    foot = cylinder((0, 0, 0), (0, 0, 0.25), 1.5 * radius_m, shaded(rgb, 0.85), 0.15)
    return Thing(number, "pole", color, (foot, cone((0, 0, 0), (0, 0, height_m), radius_m, 0.75 * radius_m, rgb, 0.15)))


def street_lamp(rgb: Rgb, height_m: float = 6.0) -> Thing:
    """Return a street lamp, scenery; its arm reaches over +x."""
    post = cone((0, 0, 0), (0, 0, height_m), 0.09, 0.05, rgb, 0.1)
    arm = capsule((0, 0, height_m - 0.05), (1.2, 0, height_m + 0.15), 0.04, rgb, 0.1)
    head = box((0.6, 0.25, 0.1), (1.4, 0, height_m + 0.14), shaded(rgb, 0.8), 0.05)
    return Thing(0, "lamp", "grey", (post, arm, head))


def wall(
    number: int,
    color: str,
    rgb: Rgb,
    size_m: tuple[float, float, float] = (0.3, 4.0, 1.6),
    *,
    rng: np.random.Generator | None = None,
) -> Thing:
    """Return a wall of (length, width, height) metres under a course of flat stones; stones with `rng` stand out."""
    length, width, height = size_m
    cap = 0.08
    parts = [box((length - 0.06, width - 0.06, height - cap), (0, 0, (height - cap) / 2), rgb, 0.25)]
    parts += [box((length, width, cap), (0, 0, height - cap / 2), shaded(CONCRETE, 0.9), 0.15)]
    if rng is None:
        return Thing(number, "wall", color, tuple(parts))
    for _ in range(min(80, int(10 * width * height))):
        w, h, out = rng.uniform(0.18, 0.42), rng.uniform(0.1, 0.22), rng.uniform(0.005, 0.025)
        y, z = rng.uniform(w - width, width - w) / 2 * 0.96, rng.uniform(h / 2, height - cap - h / 2)
        parts += [box((length - 0.06 + 2 * out, w, h), (0, y, z), shaded(rgb, rng.uniform(0.75, 1.2)), 0.2)]
    return Thing(number, "wall", color, tuple(parts))


def hedge(
    number: int,
    color: str,
    rgb: Rgb,
    size_m: tuple[float, float, float] = (1.0, 4.0, 1.4),
    *,
    rng: np.random.Generator | None = None,
) -> Thing:
    """Return a hedge within (length, width, height) metres, lumpy; it fills these bounds to a few centimetres."""
    rng = rng or np.random.default_rng(0)
    length, width, height = size_m
    parts = [box((0.7 * length, width - 0.3, 0.75 * height), (0, 0, 0.375 * height), shaded(rgb, 0.6), 0.5)]
    for spacing, low, high in ((0.4, 0.2, 0.32), (0.28, 0.08, 0.16)):
        counts = [max(2, round(k / spacing)) for k in size_m]
        for place in np.ndindex(*counts):
            at = np.array(place) / (np.array(counts) - 1) * 2 - 1
            if (np.abs(at[:2]) < 1).all() and at[2] < 1:
                continue
            half = rng.uniform(low, high, 3)
            spread = np.array(size_m) / 2 - half
            lump = np.clip(at * spread + rng.uniform(-0.12, 0.12, 3), -spread, spread) + xyz(0, 0, height / 2)
            parts += [ellipsoid(half, lump, shaded(rgb, rng.uniform(0.7, 1.3)), 0.5)]
    return Thing(number, "hedge", color, tuple(parts))


def traffic_cone(number: int, color: str, rgb: Rgb, height_m: float = 0.75) -> Thing:
    """Return a traffic cone on a square foot, with two white bands."""
    base, foot = 0.52 * height_m, 0.05 * height_m
    low, high = 0.19 * height_m, 0.035 * height_m
    cuts = np.array([foot, 0.4, 0.58, 0.72, 0.86, 1.0]) * (1, *5 * (height_m,))
    parts = [box((base, base, foot), (0, 0, foot / 2), (44, 44, 46), 0.12)]
    for i, (a, b) in enumerate(pairwise(cuts)):
        wide, narrow = (low + (high - low) * (z - foot) / (height_m - foot) for z in (a, b))
        parts += [cone((0, 0, a), (0, 0, b), wide, narrow, WHITE if i % 2 else rgb, 0.06)]
    return Thing(number, "cone", color, tuple(parts))


def tyre(number: int, color: str = "black", rgb: Rgb = RUBBER, radius_m: float = 0.32, *, lying: bool = True) -> Thing:
    """Return a tyre, lying or standing on the road (then one sees through it along y)."""
    tube = 0.3 * radius_m
    parts: list[Part] = []
    for y in (-0.28, 0.0, 0.28):
        parts += ring((0, y * radius_m, 0), radius_m, tube, rgb, 0.15)
    if lying:
        parts = list(carried(parts, pose(rotation_from_rotvec([np.pi / 2, 0.0, 0.0]), np.zeros(3))))
    return Thing(number, "tyre", color, grounded(parts))


def stone(number: int, color: str, rgb: Rgb, size_m: float = 0.2, *, rng: np.random.Generator | None = None) -> Thing:
    """Return a stone whose longest side is `size_m`, drawn from `rng`."""
    rng = rng or np.random.default_rng(0)
    lumps: list[Part] = []
    for _ in range(9):
        way = rng.normal(size=3)
        half = rng.uniform(0.55, 0.8, 3) * (1.0, 0.85, 0.65)
        T = pose(rotation_from_rotvec(rng.normal(size=3)), 0.32 * way / np.linalg.norm(way) * (1.0, 0.8, 0.55))
        lumps += carried([ellipsoid(half, (0, 0, 0), shaded(rgb, rng.uniform(0.85, 1.15)), 0.35)], T)
    longest = max(Thing(0, "stone", color, tuple(lumps)).size_m)
    return Thing(number, "stone", color, grounded(scaled(lumps, size_m / longest)))


def sign(number: int, color: str, rgb: Rgb, model: str = "round", height_m: float = 2.6) -> Thing:
    """Return a traffic sign that faces x, on its post; to whoever names things it is a pole.

    Parameters
    ----------
    number, color, rgb
        Its id; name and sRGB of its border.
    model
        "round", "triangle" or "square".
    height_m
        Its upper edge.
    """
    z, half = height_m - 0.32, 0.32
    post = cylinder((-0.06, 0, 0), (-0.06, 0, height_m - 0.05), 0.03, STEEL, 0.1)
    return Thing(number, "pole", color, (post, *_PLATES[model](z, half, rgb)))


def _round_plate(z: float, half: float, rgb: Rgb) -> list[Part]:
    rim = cylinder((-0.02, 0, z), (-0.004, 0, z), half, rgb, 0.03)
    face = cylinder((-0.02, 0, z), (0, 0, z), 0.76 * half, WHITE, 0.03)
    return [rim, face, box((0.002, 1.1 * half, 0.28 * half), (0, 0, z), COLORS["black"], 0.02)]


def _square_plate(z: float, half: float, rgb: Rgb) -> list[Part]:
    arrow = [capsule((0, 0, z - 0.6 * half), (0, 0, z + 0.6 * half), 0.02, WHITE, 0.02)]
    arrow += [capsule((0, side * 0.12, z + 0.2 * half), (0, 0, z + 0.6 * half), 0.02, WHITE, 0.02) for side in (-1, 1)]
    return [box((0.016, 2 * half, 2 * half), (-0.012, 0, z), rgb, 0.03), *arrow]


def _triangle_plate(z: float, half: float, rgb: Rgb) -> list[Part]:
    """Return a triangle on its base: a border of three rounded bars around courses that narrow upwards."""
    radius = 0.03
    low, high, wide = z - half + radius, z + half - radius, 1.1 * half
    corners = [(-0.03, -wide, low), (-0.03, wide, low), (-0.03, 0.0, high)]
    parts = [capsule(a, b, radius, rgb, 0.03) for a, b in zip(corners, corners[1:] + corners[:1], strict=True)]
    cuts = np.linspace(low, high, 25)
    for a, b in pairwise(cuts):
        reach = 2 * wide * (high - (a + b) / 2) / (high - low)
        parts += [box((0.02, reach, b - a), (-0.03, 0, (a + b) / 2), WHITE, 0.03)]
    return [*parts, capsule((-0.02, 0, z - 0.25 * half), (-0.02, 0, z + 0.2 * half), 0.02, COLORS["black"], 0.02)]


_PLATES = {"round": _round_plate, "triangle": _triangle_plate, "square": _square_plate}
SIGNS = tuple(_PLATES)
