"""What is true in a picture: of each named thing, and of the ground."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.pose import transform, vehicle_from_car
from roadblock.sim.road import height_m, normal
from roadblock.sim.scene import Scene
from roadblock.sim.solids import Thing
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.scene import NEAREST_FACE_PERCENT, GroundPlane

FACE_DEPTH_M = 0.1
"""What lies at most this much behind the nearest face's distance belongs to that face."""


@dataclass(frozen=True, eq=False)
class TrueObject:
    """One named thing, as far as the left camera sees it.

    Attributes
    ----------
    id, type, color
        As in `Thing`.
    position_m
        (3,) foot of its nearest visible face in the vehicle frame, metres: at `range_m` ahead, in the middle of
        that face's width, at the height of the thing's lowest point.
    range_m
        Forward distance of its nearest visible face: the 10th percentile over its visible pixels.
    mean_range_m
        The mean instead of the percentile.
    size_m
        (3,) width, height, length along its own axes.
    box_px
        (u0, v0, u1, v1), half open, around its visible pixels in the left image.
    visible_px
        How many pixel centres see it.
    """

    id: int
    type: str
    color: str
    position_m: FloatArray
    range_m: float
    mean_range_m: float
    size_m: FloatArray
    box_px: tuple[int, int, int, int]
    visible_px: int


def true_objects(
    scene: Scene, rig: StereoRig, pixels: NDArray[np.int64], ids: NDArray[np.int32], points_m: FloatArray
) -> tuple[TrueObject, ...]:
    """Return what is true of each named thing that is seen, nearest first.

    Parameters
    ----------
    scene, rig
        What was rendered, and with what.
    pixels, ids
        (n, 2) columns and rows of the left image's pixels that see a named thing, and (n,) its id.
    points_m
        (n, 3) what their centres see, car frame, metres.
    """
    named = [thing for thing in scene.things if thing.id]
    seen = [(thing, ids == thing.id) for thing in named]
    objects = [_true_object(scene, rig, thing, pixels[at], points_m[at]) for thing, at in seen if at.any()]
    return tuple(sorted(objects, key=lambda found: found.range_m))


def _true_object(
    scene: Scene, rig: StereoRig, thing: Thing, pixels: NDArray[np.int64], points_m: FloatArray
) -> TrueObject:
    x, z = points_m[:, 0], points_m[:, 2]
    nearest = float(np.percentile(z, NEAREST_FACE_PERCENT))
    face = x[z <= nearest + FACE_DEPTH_M]
    foot = _on_height(scene, (face.min() + face.max()) / 2, nearest, thing.lowest_m)
    (u0, v0), (u1, v1) = pixels.min(0).tolist(), pixels.max(0).tolist()
    return TrueObject(
        thing.id,
        thing.type,
        thing.color,
        transform(vehicle_from_car(rig.T_vehicle_car), foot),
        nearest,
        float(z.mean()),
        thing.size_m,
        (u0, v0, u1 + 1, v1 + 1),
        len(z),
    )


def _on_height(scene: Scene, x: float, z: float, height_m: float) -> FloatArray:
    """Return the car-frame point with these x and z that lies at a height of the world."""
    to_up = scene.T_world_car[2]
    return np.array([x, (height_m - to_up[3] - to_up[0] * x - to_up[2] * z) / to_up[1], z])


def true_ground(scene: Scene) -> GroundPlane:
    """Return the road in the car frame: the plane that touches it under the cameras, and half its curvature there."""
    x, y, z = scene.T_world_car[:3, 3]
    road = scene.road
    up = normal(road, x, y)
    bent = road.grade_from_m <= x < road.grade_from_m + road.grade_over_m
    ahead = scene.T_world_car[:2, 2] / np.linalg.norm(scene.T_world_car[:2, 2])
    bend = road.grade / road.grade_over_m / 2 * float(ahead[0]) ** 2 if bent else 0.0
    return GroundPlane(scene.T_world_car[:3, :3].T @ up, (z - height_m(road, x, y)) * up[2], bend)
