"""Worlds in which much cannot be seen: blank walls, burnt-out skies, lamps at night, fences, a covered lens."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from low_world import sun
from numpy.typing import NDArray

from roadblock.sim.conditions import CONDITIONS, Effects
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose, on_road, roadside
from roadblock.sim.scenes import AWAY, LEFTWARDS, STREET, TOWARDS, Stand, furnished
from roadblock.sim.solids import Part, Thing, box
from roadblock.sim.things import Order, street_lamp

KINDS = ("blank wall", "sky", "lamps at night", "picket fence", "covered tile")
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class World:
    """A scene, its conditions, and the tile on one lens: (side, u0, v0, u1, v1, grey level); None = clean lenses."""

    scene: Scene
    effects: Effects
    tile: tuple[int, int, int, int, int, float] | None = None


def scene_of(things: tuple[Thing, ...], road: Road, seed: int, rng: np.random.Generator) -> Scene:
    """Return a scene; the cameras are a little higher, lower and tilted each time."""
    pose = camera_pose(rng.uniform(1.3, 1.6), np.radians(rng.uniform(-0.5, 1.0)))
    return Scene(things, road, pose, sun(rng), seed)


def some(rng: np.random.Generator, nearest_m: float) -> list[Stand]:
    """Draw a car, a person and a cyclist on and beside the lane, all further ahead than `nearest_m`."""
    ahead = nearest_m + rng.uniform(0.5, 4, 3).cumsum()
    return [
        Stand(Order("person", 0, walking=True), ahead[0], rng.uniform(-2, 2), rng.choice((LEFTWARDS, TOWARDS))),
        Stand(Order("car", 0, color="silver"), ahead[1], rng.choice((-4.2, 3.6)), AWAY),
        Stand(Order("cyclist", 0), ahead[2], rng.uniform(-2, 2), AWAY),
    ]


def blank_wall(seed: int, rng: np.random.Generator) -> World:
    """Return a wall of smooth paint across the road, from edge to edge of the view or less."""
    road, away = Road(contrast=rng.uniform(0.1, 0.2)), rng.uniform(6, 22)
    grey = rng.uniform(60, 235)
    rgb = tuple(round(float(np.clip(grey + x, 0, 255))) for x in rng.uniform(-15, 15, 3))
    size = (0.3, rng.uniform(0.6, 2.0) * away, rng.uniform(2.2, 6.0))
    paint = Thing(1, "wall", "grey", (box(size, (0, 0, size[2] / 2), rgb, 0.0),))
    wall = on_road(paint, road, away, rng.uniform(-1, 3), np.radians(rng.uniform(-12, 12)))
    return World(scene_of((wall, *roadside(rng)), road, seed, rng), CONDITIONS["day"])


def sky(seed: int, rng: np.random.Generator) -> World:
    """Return a street under an exposure that burns the sky out, and white walls with it."""
    things = furnished(STREET, some(rng, rng.uniform(8, 14)), seed)
    scene = scene_of((*things, *roadside(rng)), STREET, seed, rng)
    day = CONDITIONS["day"]
    return World(scene, replace(day, sensor=replace(day.sensor, exposure=rng.uniform(1.5, 5.0))))


def night(seed: int, rng: np.random.Generator) -> World:
    """Return the street at night, lit by its lamps and the own head lamps."""
    lamps = [
        on_road(street_lamp((120, 124, 128)), STREET, x + rng.uniform(-3, 3), 7.8, -np.pi / 2) for x in (18, 44, 70)
    ]
    things = furnished(STREET, some(rng, rng.uniform(8, 14)), seed)
    return World(scene_of((*things, *lamps, *roadside(rng)), STREET, seed, rng), CONDITIONS["night"])


def fence(seed: int, rng: np.random.Generator) -> World:
    """Return a picket fence, all pickets alike, that crosses the road at a right angle, about 8 m ahead."""
    road, away = Road(contrast=rng.uniform(0.1, 0.2)), rng.uniform(6, 12)
    pitch, share, tall = rng.uniform(0.09, 0.2), rng.uniform(0.45, 0.7), rng.uniform(0.9, 1.4)
    contrast, half = rng.choice((0.0, 0.03, 0.1)), rng.uniform(0.3, 1.0) * away
    white = tuple(int(x) for x in rng.integers(150, 240) + rng.integers(-8, 8, 3))
    parts: list[Part] = []
    for y in np.arange(-half, half, pitch):
        parts += [box((0.02, share * pitch, tall - 0.05), (0, y, tall / 2 + 0.025), white, contrast)]
    parts += [box((0.04, 2 * half, 0.08), (0.03, 0, z * tall), white, contrast) for z in (0.25, 0.8)]
    thing = on_road(Thing(1, "fence", "white", tuple(parts)), road, away, rng.uniform(-1, 3))
    return World(scene_of((thing, *roadside(rng)), road, seed, rng), CONDITIONS["day"])


def tile(seed: int, rng: np.random.Generator) -> World:
    """Return a street seen through lenses one of which is partly covered."""
    things = furnished(STREET, some(rng, rng.uniform(7, 14)), seed)
    scene = scene_of((*things, *roadside(rng)), STREET, seed, rng)
    (w, h), side = rng.uniform((120, 100), (420, 300)).astype(int), int(rng.integers(2))
    u, v = int(rng.uniform(0, 1280 - w)), int(rng.uniform(250, 720 - h))
    return World(scene, CONDITIONS["day"], (side, u, v, u + w, v + h, rng.uniform(10, 200)))


MAKERS: dict[str, Callable[[int, np.random.Generator], World]] = dict(
    zip(KINDS, (blank_wall, sky, night, fence, tile), strict=True)
)


def world(kind: str, seed: int) -> World:
    """Return a world of a kind of `KINDS`."""
    return MAKERS[kind](seed, np.random.default_rng([seed, 71, KINDS.index(kind)]))
