"""Tracks of simulated measurements, whose truth is known in closed form."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from roadblock.geometry.pose import R_VEHICLE_CAR, inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.stereo import image_from_car
from roadblock.stages.track import Tracker, TrackSettings
from roadblock.values.camera import Rectification
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace, Obstacle

RECTIFICATION = Rectification(705.0, 601.0, 171.0, 0.52, (1240, 374))
MOUNT = pose(R_VEHICLE_CAR @ rotation_from_rotvec([0.03, -0.02, 0.01]), [1.7, 0.1, 1.4])
SIGMA_PX = np.array([2.0, 2.0, 0.12])
STEP_NS = 100_000_000
START_NS = 5 * 10**18


@dataclass
class Thing:
    """Moves over ground at a constant velocity; x, y and z of its nearest face at the start."""

    at: tuple[float, float]
    v: tuple[float, float] = (0.0, 0.0)
    hidden_s: tuple[float, float] = (-1.0, -1.0)
    size: tuple[float, float] = (1.7, 1.5)

    def place(self, t_s: float) -> np.ndarray:
        return np.array([self.at[0] + self.v[0] * t_s, self.at[1] + self.v[1] * t_s, 0.7])


@dataclass
class World:
    """A vehicle that drives a curve, and things; `odom` is where the vehicle begins."""

    things: list[Thing]
    speed: float = 8.0
    yaw_rate: float = 0.0
    seed: int = 7
    scale: float = 1.0
    rng: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)

    def vehicle(self, t_s: float) -> np.ndarray:
        """T_odom_vehicle."""
        w, v = self.yaw_rate, self.speed
        where = [v * t_s, 0, 0] if w == 0 else [v / w * np.sin(w * t_s), v / w * (1 - np.cos(w * t_s)), 0]
        return pose(rotation_from_rotvec([0, 0, w * t_s]), where)

    def truth(self, thing: Thing, t_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Place (3,) and velocity over ground (2,) in the vehicle's axes of that moment."""
        T = inverse(self.vehicle(t_s))
        return transform(T, thing.place(t_s)), (T[:3, :3] @ [*thing.v, 0])[:2]

    def seen(self, t_s: float) -> list[Obstacle]:
        return [self.obstacle(i, thing, t_s) for i, thing in enumerate(self.things) if self.shows(thing, t_s)]

    def shows(self, thing: Thing, t_s: float) -> bool:
        return not thing.hidden_s[0] <= t_s < thing.hidden_s[1]

    def obstacle(self, number: int, thing: Thing, t_s: float) -> Obstacle:
        place, _ = self.truth(thing, t_s)
        uvd = image_from_car(RECTIFICATION, transform(inverse(MOUNT), place))
        uvd = uvd + self.scale * SIGMA_PX * self.rng.standard_normal(3)
        return obstacle(uvd, thing.size, number)

    def ego(self, before_s: float, t_s: float) -> EgoMotion:
        T = inverse(self.vehicle(t_s)) @ self.vehicle(before_s)
        noise = np.array([1e-4] * 3 + [5e-3] * 3)
        off = noise * self.rng.standard_normal(6)
        T_car = inverse(MOUNT) @ T @ MOUNT
        T_car = pose(rotation_from_rotvec(off[:3]), off[3:]) @ T_car
        return EgoMotion(ns(before_s), ns(t_s), T_car, np.diag(noise**2))


def ns(t_s: float) -> int:
    return START_NS + round(t_s * 1e9)


def obstacle(uvd: np.ndarray, size: tuple[float, float], number: int = 0, sigma_px: np.ndarray = SIGMA_PX) -> Obstacle:
    """An obstacle as `triangulate` makes it, whose name is in its colour."""
    px_per_m = uvd[2] / RECTIFICATION.baseline_m
    w, h = size[0] * px_per_m / 2, size[1] * px_per_m / 2
    box = tuple(round(float(edge)) for edge in (uvd[0] - w, uvd[1] - h, uvd[0] + w, uvd[1] + h))
    from roadblock.geometry.stereo import triangulate

    place = transform(MOUNT, triangulate(RECTIFICATION, uvd))
    return Obstacle(
        position_m=[place[0], place[1], 0.0],
        range_m=float(RECTIFICATION.f_px * RECTIFICATION.baseline_m / uvd[2]),
        range_sigma_m=0.1,
        size_m=np.array([*size, np.nan]),
        uvd_px=uvd,
        cov_uvd_px2=np.diag(sigma_px**2),
        cov_match_m2=np.eye(3),
        box_px=box,
        contour_px=np.array([[box[0], box[1]], [box[2], box[1]], [box[2], box[3]]]),
        color=str(number),
    )


def drive(world: World, times_s, tracker: Tracker | None = None, with_ego: bool = True, seen=None):
    """Return (time, obstacles with tracks) of each frame."""
    tracker = tracker or Tracker(RECTIFICATION, MOUNT)
    frames, before = [], None
    for t_s in times_s:
        ego = world.ego(before, t_s) if with_ego and before is not None and t_s > before else None
        frames.append((t_s, tracker.update((seen or world.seen)(t_s), ns(t_s), ego)))
        before = t_s if before is None else max(before, t_s)
    return frames


def ids(frames) -> dict[str, set[int]]:
    """The numbers of the tracks that each thing had."""
    found: dict[str, set[int]] = {}
    for _, obstacles in frames:
        for o in obstacles:
            if o.track is not None:
                found.setdefault(o.color or "", set()).add(o.track.id)
    return found


def steps(seconds: float, step_s: float = 0.1) -> list[float]:
    return [round(i * step_s, 6) for i in range(round(seconds / step_s))]


STREET = [
    Thing((25.0, 2.5), (0.0, 0.0)),
    Thing((32.0, -3.0), (0.0, 1.4), size=(0.6, 1.7)),
    Thing((30.0, 0.2), (6.0, 0.0)),
    Thing((45.0, 5.0), (-9.0, 0.0)),
]


def test_each_thing_keeps_one_number() -> None:
    found = ids(drive(World(STREET), steps(2.0)))
    assert sorted(len(numbers) for numbers in found.values()) == [1, 1, 1, 1]
    assert len(set.union(*found.values())) == 4


def test_a_track_needs_two_frames_of_three() -> None:
    world = World([Thing((20.0, 0.0))], speed=0.0)
    tracker = Tracker(RECTIFICATION, MOUNT)
    seen = [tracker.update(world.seen(t), ns(t), None)[0].track for t in (0.0, 0.1)]
    assert seen[0] is None
    assert seen[1] is not None
    assert seen[1].id == 1
    assert seen[1].age_s == pytest.approx(0.1)
    ghost = Tracker(RECTIFICATION, MOUNT)
    ghost.update(world.seen(0.0), ns(0.0), None)
    ghost.update([], ns(0.1), None)
    ghost.update([], ns(0.2), None)
    assert ghost.update(world.seen(0.3), ns(0.3), None)[0].track is None


def test_velocity_after_a_second_at_20_m() -> None:
    errors = []
    for seed in range(60):
        thing = Thing((20.0 + 8.0, 2.0), (0.0, 1.5 if seed % 2 else 0.0))
        frames = drive(world := World([thing], seed=seed), steps(1.1))
        t_s, (o,) = frames[-1]
        errors.append(o.track.velocity_mps - world.truth(thing, t_s)[1])
        assert o.track.is_over_ground
    rms = np.sqrt(np.mean(np.square(errors), 0))
    print(rms)
    assert (rms <= 0.3).all()
