"""A scene: a road, what stands on it, the light, and where the cameras are. The demo's is here as well."""

from dataclasses import dataclass, field, replace

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import R_VEHICLE_CAR, inverse, pose, rotation_from_rotvec
from roadblock.sim.road import Road, height_m, pose_on
from roadblock.sim.solids import Rgb, Thing, moved, placed
from roadblock.sim.things import crate, house, person, tree
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, finite, rigid_transform

UPRIGHT = ("person", "pole", "house", "tree", "lamp")
"""Types that stand upright on a slope; all others stand at right angles to it."""


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
    speed_mps
        How fast the cameras drive along the road.
    along_m
        How far along the road they are.
    conditions
        Names of what the day is like (rain, night, ...), for whoever takes the picture; () = a clear day.
    clouds
        Of steam, whose parts are puffs (`sim.steam`): seen, but nothing can touch them.

    Raises
    ------
    ValueRefusedError
        If two things share an id, the cameras are not above the road, the sun is below the horizon, or speed or way is
        not finite.
    """

    things: tuple[Thing, ...]
    road: Road
    T_world_car: FloatArray
    towards_sun: FloatArray = field(default_factory=lambda: np.array([-0.45, 0.55, 0.8]))
    seed: int = 0
    speed_mps: float = 0.0
    along_m: float = 0.0
    conditions: tuple[str, ...] = ()
    clouds: tuple[Thing, ...] = ()

    def __post_init__(self) -> None:
        named = [thing.id for thing in self.things if thing.id]
        if len(named) != len(set(named)):
            raise ValueRefusedError(f"every thing must have an id of its own, but got {sorted(named)}")
        object.__setattr__(self, "T_world_car", rigid_transform("T_world_car", self.T_world_car))
        x, y, z = self.T_world_car[:3, 3]
        above = z - height_m(self.road, x, y)
        if above <= 0:
            raise ValueRefusedError(f"the cameras must be above the road, but are at {above:g} m")
        sun = finite("towards_sun", self.towards_sun, (3,))
        if sun[2] <= 0:
            raise ValueRefusedError(f"the sun must be above the horizon, but got {sun.tolist()}")
        object.__setattr__(self, "towards_sun", finite("towards_sun", sun / np.linalg.norm(sun), (3,)))
        finite("speed_mps", self.speed_mps, ())
        finite("along_m", self.along_m, ())

    def at(self, t_s: float) -> "Scene":
        """Return the same world `t_s` seconds later.

        Everything has moved on; the cameras have followed the road, as high over it and as far beside its line as now.
        """
        along = self.along_m + self.speed_mps * t_s
        way = pose_on(self.road, along, 0.0) @ inverse(pose_on(self.road, self.along_m, 0.0))
        things, clouds = (tuple(moved(thing, t_s) for thing in some) for some in (self.things, self.clouds))
        return replace(self, things=things, clouds=clouds, T_world_car=way @ self.T_world_car, along_m=along)


def on_road(thing: Thing, road: Road, nearest_m: float, left_m: float, yaw_rad: float = 0.0) -> Thing:
    """Return the thing standing on a road, its nearest point `nearest_m` along it.

    Parameters
    ----------
    thing
        What to place; its own pose is forgotten.
    road
        Where to.
    nearest_m
        Where along the road it begins, metres. On a straight road this is exactly the smallest x of its surface.
    left_m
        How far to the left of the road's line its origin stands, metres.
    yaw_rad
        Its turn to the left of the road's direction, radians; 0 = facing away, like traffic ahead.
    """
    low = thing.bounds_m(pose(rotation_from_rotvec([0.0, 0.0, yaw_rad]), np.zeros(3)))[0]
    upright = thing.type in UPRIGHT
    T = pose_on(road, nearest_m - low[0], left_m, yaw_rad, upright=upright)
    return replace(thing, T_world_thing=T @ pose(np.eye(3), [0.0, 0.0, -low[2]]))


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
        placed(person(2, "blue", (38, 70, 170), (44, 62, 122), stride=0.02), 5.0, 1.35, facing + 0.25),
        placed(crate(3, "yellow", (226, 186, 30), (1.0, 1.2, 1.1)), 10.0, 4.35),
        placed(person(4, "green", (36, 130, 62), (44, 92, 56), 1.82, stride=0.9), 10.0, -1.1, facing - 0.35),
        placed(crate(5, "orange", (232, 116, 26), (1.4, 1.5, 1.3)), 20.0, 1.9),
        placed(person(6, "white", (226, 226, 222), (196, 196, 190), 1.7, stride=0.4), 20.0, 0.1, 0.3),
    )
    return Scene(things + roadside(np.random.default_rng(seed)), Road(), camera_pose(height_m, pitch_rad), seed=seed)


def roadside(rng: np.random.Generator) -> tuple[Thing, ...]:
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
