"""Scenes: a road, what stands on it, the light, and where the cameras are. The ready ones are here as well."""

from dataclasses import dataclass, field

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import R_VEHICLE_CAR, pose, rotation_from_rotvec
from roadblock.sim.solids import Rgb, Thing, placed
from roadblock.sim.things import crate, house, person, tree
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, finite, rigid_transform


@dataclass(frozen=True)
class Line:
    """A painted line along the road.

    Attributes
    ----------
    left_m
        y of its middle, metres.
    width_m
        Its width.
    dash_m, gap_m
        Lengths of dash and gap; gap 0 = unbroken.
    """

    left_m: float
    width_m: float = 0.14
    dash_m: float = 3.0
    gap_m: float = 0.0


@dataclass(frozen=True)
class Road:
    """The flat ground z = 0: asphalt from `right_m` to `left_m` (y, metres) along x, kerb stones, verges beyond.

    `contrast` is the standard deviation of the asphalt's texture, as a share of its brightness.
    """

    right_m: float = -3.1
    left_m: float = 5.6
    lines: tuple[Line, ...] = (Line(-2.85), Line(1.7, gap_m=4.5), Line(5.35))
    contrast: float = 0.17
    asphalt: Rgb = (112, 112, 116)
    verge: Rgb = (98, 128, 58)


@dataclass(frozen=True, eq=False)
class Scene:
    """One moment of the world.

    Attributes
    ----------
    things
        What stands in it.
    road
        What it stands on.
    T_world_car
        4x4 pose of the car frame (x right, y down, z forward, halfway between the cameras) in the world, metres.
    towards_sun
        (3,) direction in the world; made a unit vector.
    seed
        Of all textures, the sky and the hills.

    Raises
    ------
    ValueRefusedError
        If two things share an id, the cameras are not above the road, or the sun is below the horizon.
    """

    things: tuple[Thing, ...]
    road: Road
    T_world_car: FloatArray
    towards_sun: FloatArray = field(default_factory=lambda: np.array([-0.45, 0.55, 0.8]))
    seed: int = 0

    def __post_init__(self) -> None:
        named = [thing.id for thing in self.things if thing.id]
        if len(named) != len(set(named)):
            raise ValueRefusedError(f"every thing must have an id of its own, but got {sorted(named)}")
        object.__setattr__(self, "T_world_car", rigid_transform("T_world_car", self.T_world_car))
        if self.T_world_car[2, 3] <= 0:
            raise ValueRefusedError(f"the cameras must be above the road, but are at {self.T_world_car[2, 3]:g} m")
        sun = finite("towards_sun", self.towards_sun, (3,))
        if sun[2] <= 0:
            raise ValueRefusedError(f"the sun must be above the horizon, but got {sun.tolist()}")
        object.__setattr__(self, "towards_sun", finite("towards_sun", sun / np.linalg.norm(sun), (3,)))


def camera_pose(height_m: float = 1.4, pitch_rad: float = 0.0, roll_rad: float = 0.0) -> FloatArray:
    """Return `T_world_car` of cameras over the world's origin.

    Parameters
    ----------
    height_m
        Of the point halfway between the cameras, above the road.
    pitch_rad
        How far they look down (> 0 = down).
    roll_rad
        How far their left side is up (> 0 = left up).
    """
    level = pose(R_VEHICLE_CAR, [0.0, 0.0, height_m])
    down, left_up = rotation_from_rotvec([-pitch_rad, 0.0, 0.0]), rotation_from_rotvec([0.0, 0.0, roll_rad])
    return level @ pose(down @ left_up, np.zeros(3))


def paper_rig() -> StereoRig:
    """Return the paper's rig: parallel cameras 0.205 m apart, f = 1033 px, 1280x720.

    The principal point is not the middle of the image, as in no real camera.
    """
    camera = Camera((1280, 720), 1033.0, 1033.0, 652.3, 347.6)
    return StereoRig(camera, camera, pose(np.eye(3), [0.205, 0.0, 0.0]))


def demo_street(seed: int = 0, *, height_m: float = 1.4, pitch_rad: float = 0.0) -> Scene:
    """Return the demo: a box and a person each at 5, 10 and 20 m, side by side on a street.

    Parameters
    ----------
    seed
        Of textures, sky, houses and trees; the six named things always stand at the same places.
    height_m, pitch_rad
        As in `camera_pose`.

    Notes
    -----
    The nearest surface of each lies exactly 5, 10 or 20 m ahead of the point halfway between the cameras (with
    pitch 0). With `paper_rig` both cameras see all six whole and nothing hides another.
    """
    facing = np.pi
    things = (
        placed(crate(1, "red", (190, 38, 34), (0.7, 0.9, 0.8)), 5.0, -1.75),
        placed(person(2, "blue", (38, 70, 170), (44, 62, 122)), 5.0, 1.35, facing + 0.25),
        placed(crate(3, "yellow", (226, 186, 30), (1.0, 1.2, 1.1)), 10.0, 4.35),
        placed(person(4, "green", (36, 130, 62), (44, 92, 56), 1.82), 10.0, -1.1, facing - 0.35),
        placed(crate(5, "orange", (232, 116, 26), (1.4, 1.5, 1.3)), 20.0, 1.9),
        placed(person(6, "white", (226, 226, 222), (196, 196, 190), 1.7), 20.0, 0.1, 0.3),
    )
    return Scene(things + _roadside(np.random.default_rng(seed)), Road(), camera_pose(height_m, pitch_rad), seed=seed)


def _roadside(rng: np.random.Generator) -> tuple[Thing, ...]:
    """Draw houses and trees well behind the last named thing."""
    walls: tuple[Rgb, ...] = ((206, 190, 160), (188, 140, 112), (222, 216, 204), (172, 178, 186))
    roofs: tuple[Rgb, ...] = ((142, 70, 52), (96, 84, 82), (122, 62, 50))
    things = []
    for side, ahead in ((1, 38.0), (1, 62.0), (1, 92.0), (-1, 44.0), (-1, 70.0), (-1, 104.0)):
        size = (rng.uniform(9, 13), rng.uniform(7, 9), rng.uniform(4.2, 6.0))
        home = house(walls[rng.integers(len(walls))], roofs[rng.integers(len(roofs))], size)
        things.append(placed(home, ahead, side * rng.uniform(12.5, 14.5) + 1.3, side * rng.uniform(0.9, 1.4)))
    for side, ahead in ((1, 27.0), (1, 54.0), (1, 80.0), (-1, 31.0), (-1, 58.0), (-1, 90.0)):
        crown = (int(rng.integers(62, 90)), int(rng.integers(100, 126)), int(rng.integers(40, 62)))
        leaves = tree(crown, rng.uniform(5.5, 8.5), rng)
        things.append(placed(leaves, ahead, side * rng.uniform(8.0, 9.5) + 1.3))
    return tuple(things)
