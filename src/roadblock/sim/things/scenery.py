"""Scenery: what has a disparity but no name."""

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.solids import Part, Rgb, Thing, box, capsule, cylinder, ellipsoid
from roadblock.sim.things.colors import shaded


def house(wall: Rgb, roof: Rgb, size_m: tuple[float, float, float]) -> Thing:
    """Return a house of (length, width, height to the eaves) metres; its ridge runs along x."""
    length, width, height = size_m
    slope = rotation_from_rotvec([np.pi / 4, 0.0, 0.0])
    edge = (width + 0.8) / np.sqrt(2)
    gable = Part("box", pose(slope, (0, 0, height)), np.array([length - 0.04, edge, edge]) / 2, roof, 0.2)
    return Thing(0, "house", "", (box(size_m, (0, 0, height / 2), wall, 0.08, "windows"), gable))


def tree(crown: Rgb, height_m: float, rng: np.random.Generator) -> Thing:
    """Return a tree, its crown of a few overlapping tufts."""
    trunk = capsule((0, 0, 0.2), (0, 0, 0.6 * height_m), 0.03 * height_m, (92, 72, 54), 0.3)
    tufts = []
    for _ in range(16):
        way = rng.normal(size=3)
        x, y, z = way / np.linalg.norm(way) * (0.2, 0.2, 0.17) * height_m
        half = rng.uniform(0.08, 0.15, 3) * height_m
        tufts.append(ellipsoid(half, (x, y, z + 0.7 * height_m), shaded(crown, rng.uniform(0.85, 1.15)), 0.45))
    return Thing(0, "tree", "green", (trunk, *tufts))


def bridge(length_m: float, inside_m: float, under_m: float, *, has_piers: bool) -> Thing:
    """Return a bridge over the road: a deck with parapets on walls, or on round piers.

    Parameters
    ----------
    length_m
        Of the deck along the road.
    inside_m, under_m
        Room between its walls or piers, and below its deck.
    has_piers
        Piers, not walls.
    """
    concrete: Rgb = (150, 148, 142)
    wide, thick, out = inside_m + 6.0, 0.9, (inside_m + 0.8) / 2
    parts = [box((length_m, wide, thick), (0, 0, under_m + thick / 2), concrete, 0.2)]
    parapet = shaded(concrete, 0.9)
    parts += [
        box((0.25, wide, 1.0), (x, 0, under_m + thick + 0.5), parapet, 0.2) for x in (-length_m / 2, length_m / 2)
    ]
    for y in (-out, out):
        if has_piers:
            parts += [
                cylinder((x, y, 0.0), (x, y, under_m), 0.4, shaded(concrete, 0.95), 0.2)
                for x in np.linspace(-length_m / 2 + 0.6, length_m / 2 - 0.6, 3)
            ]
        else:
            parts.append(box((length_m, 0.8, under_m), (0, y, under_m / 2), shaded(concrete, 0.95), 0.2))
    return Thing(0, "bridge", "grey", tuple(parts))
