"""Roads for the test of low obstacles: with nothing on them that could be hit, and with low-contrast cubes."""

from dataclasses import dataclass, replace

import numpy as np

from roadblock.sim.conditions import CONDITIONS, Effects
from roadblock.sim.road import Line, Mark, Road
from roadblock.sim.scene import Scene, camera_pose, on_road, roadside
from roadblock.sim.scenes import SCENES, STREET
from roadblock.sim.solids import Thing
from roadblock.sim.things import carton, pole, tree

CUBE_M = 0.15
RANGES_M = (10.0, 20.0, 30.0)
ROADS = ("street", "kerb", "bend", "shadows", "wet", "marks")
FLAT = ("street", "shadows", "marks")
"""Roads that cubes are put on."""


@dataclass(frozen=True)
class World:
    """A scene, its conditions and its kind."""

    scene: Scene
    effects: Effects
    kind: str


def sun(rng: np.random.Generator, low: float = 30.0) -> np.ndarray:
    """Draw where the sun stands, `low` to 60 degrees high and not right ahead."""
    azimuth, elevation = np.radians(rng.uniform(60, 300)), np.radians(rng.uniform(low, 60))
    return np.array([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)])


def marks(rng: np.random.Generator) -> tuple[Mark, ...]:
    """Draw markings, patches and manholes all over the lane."""
    kinds = ("arrow", "gore", "patch", "patch", "manhole", "manhole", "manhole", "zebra")
    sizes = {"arrow": (4.0, 0.9), "gore": (8.0, 1.1), "patch": (3.0, 1.2), "manhole": (0.7, 0.7), "zebra": (3.0, 7.0)}
    return tuple(
        Mark(kind, rng.uniform(5, 34), 0.0 if kind == "zebra" else rng.uniform(-2.2, 2.2), *sizes[kind])
        for kind in kinds
    )


def beside(rng: np.random.Generator, road: Road) -> tuple[Thing, ...]:
    """Draw trees and poles close to the road, for their shadows."""
    things = []
    for ahead in (8.0, 14.0, 20.0, 27.0, 35.0):
        side = rng.choice((-1, 1))
        edge = (road.left_m if side > 0 else -road.right_m) + rng.uniform(1.0, 2.5)
        thing = tree((75, 115, 50), rng.uniform(4, 7), rng) if rng.random() < 0.5 else pole(0, "grey", (112, 114, 118))
        things.append(on_road(thing, road, ahead + rng.uniform(-2, 2), side * edge))
    return tuple(things)


def empty_road(seed: int) -> World:
    """Return a road with nothing on it: its kind goes by the seed, the rest is drawn."""
    return road(ROADS[seed % len(ROADS)], seed)


def road(kind: str, seed: int) -> World:
    """Return a road of a kind of `ROADS`."""
    rng = np.random.default_rng([seed, 51])
    effects = CONDITIONS["wet" if kind == "wet" else "day"]
    if kind in ("street", "wet"):
        return World(SCENES["empty"](seed), effects, kind)
    surface = {
        "kerb": replace(STREET, right_m=rng.uniform(-2.4, -1.2), lines=(Line(1.7, gap_m=4.5),)),
        "bend": Road(-2.6, 5.6, curvature_per_m=rng.choice((-1, 1)) / 90, curve_from_m=6.0, kerb_m=0.12),
        "shadows": Road(-3.1, 3.1, (Line(-2.9), Line(2.9)), contrast=rng.uniform(0.1, 0.25)),
        "marks": Road(contrast=rng.uniform(0.1, 0.25), marks=marks(rng), crown_per_m=0.002),
    }[kind]
    things = beside(rng, surface) if kind == "shadows" else roadside(rng)
    return World(Scene(things, surface, camera_pose(), sun(rng), seed), effects, kind)


def cubes(seed: int) -> World:
    """Return a flat road with two cubes at each of `RANGES_M`, hardly brighter or darker than the asphalt."""
    world = road(FLAT[seed % len(FLAT)], seed)
    rng = np.random.default_rng([seed, 52])
    things = []
    for number, ahead in enumerate(np.repeat(RANGES_M, 2)):
        left = rng.uniform(0.2, 2.1) * (1 if number % 2 else -1)
        grey = round(112 * rng.uniform(0.8, 1.2))
        cube = carton(number + 1, "grey", (grey, grey, grey + 4), (CUBE_M, CUBE_M, CUBE_M))
        things.append(on_road(cube, world.scene.road, ahead, left, rng.uniform(0, np.pi / 2)))
    return replace(world, scene=replace(world.scene, things=(*things, *world.scene.things)))
