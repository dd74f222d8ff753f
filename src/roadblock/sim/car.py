"""A car that drives through a scene: how it obeys, and what it touches, judged by the exact geometry."""

from collections.abc import Iterable
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.sim.road import Road, place_on, pose_on
from roadblock.sim.scene import camera_pose
from roadblock.sim.solids import Part, Thing
from roadblock.values.checks import FloatArray

BRAKE_MPS2, LATERAL_MPS2 = 6.0, 3.0
"""What tyres and passengers bear."""
TURN_M = 5.5
"""Radius of the smallest turning circle."""
HEIGHT_M, OVER_M = 1.5, 0.1
"""What is higher passes above the car; what is lower, under it."""
DIRECTIONS = 72
_ANGLES = 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
_WAYS = np.stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(DIRECTIONS)])
NEAR_M = 12.0
"""Things whose origin is further away than this and their own length are not looked at."""


@dataclass(frozen=True)
class Body:
    """A car's outline about its cameras, metres."""

    width_m: float = 1.7
    front_m: float = 1.3
    rear_m: float = 2.8


@dataclass(frozen=True)
class CarState:
    """Where the point between the cameras is on the road, where it heads (rad, > 0 = left), and how fast."""

    x_m: float
    y_m: float
    heading_rad: float
    speed_mps: float

    @property
    def T_world_car(self) -> FloatArray:
        """4x4 pose of the car frame on a level road."""
        T = pose(rotation_from_rotvec([0.0, 0.0, self.heading_rad]), [self.x_m, self.y_m, 0.0])
        return np.asarray(T @ camera_pose())

    def driven(self, acceleration_mps2: float, curvature_per_m: float, dt_s: float) -> "CarState":
        """Return the state after a moment, within what a car can do; it never drives backwards."""
        v = max(0.0, self.speed_mps + float(np.clip(acceleration_mps2, -BRAKE_MPS2, BRAKE_MPS2)) * dt_s)
        mean = (self.speed_mps + v) / 2
        most = min(1 / TURN_M, LATERAL_MPS2 / max(mean, 0.1) ** 2)
        turn = float(np.clip(curvature_per_m, -most, most)) * mean * dt_s
        middle = self.heading_rad + turn / 2
        return CarState(
            self.x_m + mean * dt_s * np.cos(middle),
            self.y_m + mean * dt_s * np.sin(middle),
            self.heading_rad + turn,
            v,
        )


class Obstruction:
    """A thing as its convex parts reach in `DIRECTIONS` on the road, without those above or below the car."""

    def __init__(self, thing: Thing) -> None:
        self.thing = thing
        self.at_m = thing.T_world_thing[:2, 3]
        self.size_m = float(max(thing.size_m[0], thing.size_m[2]))
        self.reach_m = np.array([_reach(thing, part) for part in thing.parts if _is_in_the_way(thing, part)])

    def shifted(self, way_m: FloatArray) -> "Obstruction":
        """Return it moved by (2,) metres."""
        other = copy(self)
        other.at_m = self.at_m + way_m
        other.reach_m = self.reach_m + way_m @ _WAYS[:2] if len(self.reach_m) else self.reach_m
        return other

    def clearance_m(self, car: CarState, body: Body) -> float:
        """Return how far the car is from it, metres; negative where they touch; infinity for what is far away."""
        if not len(self.reach_m) or np.hypot(*(self.at_m - (car.x_m, car.y_m))) > NEAR_M + self.size_m:
            return float("inf")
        ahead = np.cos(_ANGLES - car.heading_rad)
        aside = np.abs(np.sin(_ANGLES - car.heading_rad)) * body.width_m / 2
        reach = (
            car.x_m * _WAYS[0] + car.y_m * _WAYS[1] + np.where(ahead > 0, body.front_m, -body.rear_m) * ahead + aside
        )
        opposite = np.roll(self.reach_m, DIRECTIONS // 2, axis=1)
        return float((-opposite - reach).max(1).min())


def _is_in_the_way(thing: Thing, part: Part) -> bool:
    T = thing.T_world_thing @ part.T_thing_part
    up = T[:3, :3].T @ np.array([[0.0], [0.0], [1.0]])
    return bool(T[2, 3] - part.reach(-up)[0] < HEIGHT_M and T[2, 3] + part.reach(up)[0] > OVER_M)


def _reach(thing: Thing, part: Part) -> FloatArray:
    T = thing.T_world_thing @ part.T_thing_part
    return np.asarray(T[:3, 3] @ _WAYS + part.reach(T[:3, :3].T @ _WAYS))


def clearance_m(things: Iterable[Obstruction], car: CarState, body: Body) -> tuple[float, str]:
    """Return how far the car is from the nearest thing, and which that is."""
    found = [(thing.clearance_m(car, body), thing.thing.type) for thing in things]
    return min(found, default=(float("inf"), ""))


def car_on(road: Road, along_m: float, left_m: float, speed_mps: float) -> CarState:
    """Return a car that follows the road, by where on it its cameras are."""
    T = pose_on(road, along_m, left_m, upright=True)
    return CarState(T[0, 3], T[1, 3], float(np.arctan2(T[1, 0], T[0, 0])), speed_mps)


def is_on(road: Road, car: CarState, body: Body) -> bool:
    """Return whether a car is between the edges of the road, by where its cameras are."""
    _, left, _ = place_on(road, car.x_m, car.y_m)
    return road.right_m < left - body.width_m / 2 and left + body.width_m / 2 < road.left_m


def can_go_on(things: Iterable[Obstruction], car: CarState, body: Body, road: Road) -> bool:
    """Return whether a standing car can drive past all that is near, forwards, on the road.

    Parameters
    ----------
    things
        Where they are now.
    car, body
        The car.
    road
        What it must stay on.
    """
    near = [thing for thing in things if np.hypot(*(thing.at_m - (car.x_m, car.y_m))) < NEAR_M + thing.size_m]
    for side in (1, -1):
        for shift_m in np.arange(0.0, 6.1, 0.4):
            state, good = replace(car, speed_mps=2.0), True
            for step in range(70):
                s = 0.25 * step
                curvature = side / TURN_M if s < shift_m else -side / TURN_M if s < 2 * shift_m else 0.0
                state = state.driven(0.0, curvature, 0.125)
                if not is_on(road, state, body) or clearance_m(near, state, body)[0] <= 0:
                    good = False
                    break
            if good:
                return True
    return False
