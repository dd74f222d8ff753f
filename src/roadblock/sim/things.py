"""Things with their real outlines and sizes: crates, persons, houses, trees."""

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Rgb, Thing, box, capsule, ellipsoid

SKIN, HAIR, SHOE = (214, 160, 130), (62, 44, 34), (48, 42, 40)
ADULT_M = 1.75
"""Height the figure below is drawn for."""


def crate(number: int, color: str, rgb: Rgb, size_m: tuple[float, float, float]) -> Thing:
    """Return a boarded box of (length, width, height) metres."""
    return Thing(number, "box", color, (box(size_m, (0, 0, size_m[2] / 2), rgb, 0.16, "crate"),))


def person(number: int, color: str, jacket: Rgb, trousers: Rgb, height_m: float = ADULT_M) -> Thing:
    """Return a person in mid-step, facing x.

    Parameters
    ----------
    number
        Its id.
    color
        Name of the clothes' colour.
    jacket, trousers
        sRGB 0..255.
    height_m
        Top of the head over the ground, metres; everything scales with it.
    """
    parts = [*_trunk(jacket, trousers), *_head()]
    for side, step in ((1, 0.16), (-1, -0.14)):
        parts += _leg(side, step, trousers) + _arm(side, -0.9 * step, jacket)
    scale = height_m / ADULT_M
    scaled = tuple(
        Part(p.shape, pose(p.T_thing_part[:3, :3], p.T_thing_part[:3, 3] * scale), p.half_m * scale, p.rgb, p.contrast)
        for p in parts
    )
    return Thing(number, "person", color, scaled)


def _trunk(jacket: Rgb, trousers: Rgb) -> list[Part]:
    return [
        ellipsoid((0.115, 0.165, 0.13), (0, 0, 0.92), trousers, 0.2),
        ellipsoid((0.115, 0.160, 0.25), (0, 0, 1.12), jacket, 0.25),
        ellipsoid((0.120, 0.185, 0.20), (0, 0, 1.28), jacket, 0.25),
        capsule((0, -0.145, 1.405), (0, 0.145, 1.405), 0.062, jacket, 0.25),
    ]


def _head() -> list[Part]:
    return [
        capsule((0, 0, 1.42), (0.01, 0, 1.54), 0.05, SKIN, 0.08),
        ellipsoid((0.092, 0.073, 0.112), (0.015, 0, 1.63), SKIN, 0.08),
        ellipsoid((0.098, 0.082, 0.095), (-0.015, 0, 1.655), HAIR, 0.2),
    ]


def _leg(side: int, step_m: float, trousers: Rgb) -> list[Part]:
    hip, knee, ankle = (0, side * 0.09, 0.88), (0.6 * step_m + 0.03, side * 0.1, 0.48), (step_m, side * 0.105, 0.09)
    return [
        capsule(hip, knee, 0.068, trousers, 0.2),
        capsule(knee, ankle, 0.05, trousers, 0.2),
        ellipsoid((0.13, 0.048, 0.045), (step_m + 0.05, side * 0.11, 0.045), SHOE, 0.1),
    ]


def _arm(side: int, swing_m: float, jacket: Rgb) -> list[Part]:
    shoulder, elbow = (0, side * 0.19, 1.4), (0.5 * swing_m - 0.02, side * 0.255, 1.13)
    wrist = (swing_m + 0.05, side * 0.27, 0.88)
    return [
        capsule(shoulder, elbow, 0.047, jacket, 0.25),
        capsule(elbow, wrist, 0.038, jacket, 0.25),
        ellipsoid((0.035, 0.025, 0.07), (swing_m + 0.06, side * 0.272, 0.815), SKIN, 0.08),
    ]


def house(wall: Rgb, roof: Rgb, size_m: tuple[float, float, float]) -> Thing:
    """Return a house, scenery, of (length, width, height to the eaves) metres; its ridge runs along x."""
    length, width, height = size_m
    slope = rotation_from_rotvec([np.pi / 4, 0.0, 0.0])
    edge = (width + 0.8) / np.sqrt(2)
    gable = Part("box", pose(slope, (0, 0, height)), np.array([length - 0.04, edge, edge]) / 2, roof, 0.2)
    return Thing(0, "house", "", (box(size_m, (0, 0, height / 2), wall, 0.08, "windows"), gable))


def tree(crown: Rgb, height_m: float, rng: np.random.Generator) -> Thing:
    """Return a tree, scenery, its crown of a few overlapping tufts."""
    trunk = capsule((0, 0, 0.2), (0, 0, 0.6 * height_m), 0.03 * height_m, (92, 72, 54), 0.3)
    tufts = []
    for _ in range(16):
        way = rng.normal(size=3)
        x, y, z = way / np.linalg.norm(way) * (0.2, 0.2, 0.17) * height_m
        half = rng.uniform(0.08, 0.15, 3) * height_m
        shade = rng.uniform(0.85, 1.15)
        rgb = (int(crown[0] * shade), int(crown[1] * shade), int(crown[2] * shade))
        tufts.append(ellipsoid(half, (x, y, z + 0.7 * height_m), rgb, 0.45))
    return Thing(0, "tree", "green", (trunk, *tufts))
