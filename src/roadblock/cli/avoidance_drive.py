"""One closed-loop drive: pictures (or a fast stand-in), decisions, a car that obeys with delay, and the judge."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from roadblock.config import Settings
from roadblock.geometry.pose import pose
from roadblock.pipeline import Pipeline
from roadblock.sim.car import Body, CarState, Obstruction, can_go_on, car_on, clearance_m, is_on
from roadblock.sim.challenges import CHALLENGES, GRID, Challenge
from roadblock.sim.observed import Noise, measured_step, observe
from roadblock.sim.render import render
from roadblock.sim.road import Road, place_on
from roadblock.stages.decide import Decider, DecideSettings
from roadblock.stages.rectify import plan_rectification
from roadblock.stages.track import Tracker
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.decision import Decision
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import FrameResult, GroundPlane

FRAME_S, STEP_S = 0.1, 0.05
FIRST_NS = 1_000_000_000
"""Moment of the first frame; 0 would be a single picture."""
ACTUATOR_S = 0.2
"""From a decision until brakes and wheels obey."""
GAINING_MPS2 = 1.5
"""How the driver speeds up."""
CREEP_MPS = 3.0
"""How fast a standing car goes round something."""
STANDS_MPS, STANDS_S = 0.1, 1.0
"""A car that stood so long is judged."""
LONGEST_S = 14.0
FREE_S, FREE_M = 4.0, 0.3
"""The road was free if the car, going on as it did, would have come so near to nothing for so long."""
NEAR_M = 1.0
"""What is further away is not looked at closely."""

SCENARIOS = CHALLENGES | GRID
ROAD = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.4)

Look = Callable[[Challenge, float, CarState], tuple[Decision, FrameResult | None, RectifiedPair | None]]
Film = Callable[[FrameResult, RectifiedPair], None]


def small_rig() -> StereoRig:
    """Return the paper's rig at half its resolution, without most of the sky."""
    camera = Camera((640, 260), 516.5, 516.5, 326.2, 80.3)
    return StereoRig(camera, camera, pose(np.eye(3), [0.205, 0.0, 0.0]))


class Ended(NamedTuple):
    """How a drive ended: an outcome, why, and how fast the car ran into something."""

    outcome: str
    reason: str
    impact_mps: float = 0.0


@dataclass
class Log:
    """What happened in a drive so far."""

    actions: list[str]
    nearest_m: float = float("inf")
    stood_s: float = 0.0
    false_reason: str = ""


def rendered(rig: StereoRig, seed: int, quality: str) -> Look:
    """Return eyes that take pictures with both cameras and run the whole pipeline on them."""
    pipeline = Pipeline(rig, Settings(decide=DecideSettings(enabled=True)))

    def look(challenge: Challenge, t_s: float, car: CarState) -> tuple[Decision, FrameResult, RectifiedPair]:
        things, clouds = challenge.things_at(t_s), challenge.clouds_at(t_s)
        scene = replace(challenge.scene, things=things, clouds=clouds, T_world_car=car.T_world_car)
        index = round(t_s / FRAME_S)
        t_ns = FIRST_NS + round(1e9 * t_s)
        picture = render(scene, rig, quality=quality, seed=1000 * seed + index, index=index, name=str(index), t_ns=t_ns)
        result, pair = pipeline.step(picture.pair)
        assert result.decision is not None  # noqa: S101
        return result.decision, result, pair

    return look


def guessed(rig: StereoRig, seed: int, noise: Noise) -> Look:
    """Return eyes that see what the fast model makes of the scene; tracker and decider are the real ones."""
    twin = plan_rectification(rig, Settings().rectify)
    tracker, decider = Tracker(twin, rig.T_vehicle_car), Decider(twin, rig.T_vehicle_car)
    rng = np.random.default_rng([seed, 31])
    before: list[tuple[CarState, int]] = []

    def look(challenge: Challenge, t_s: float, car: CarState) -> tuple[Decision, None, None]:
        t_ns = FIRST_NS + round(1e9 * t_s)
        things = tuple(replace(thing, gait=None) if thing.gait else thing for thing in challenge.scene.things)
        plain = replace(challenge, scene=replace(challenge.scene, things=things))
        seen = observe(plain.things_at(t_s), challenge.scene.road, car, twin, rng, noise)
        ego = measured_step(before[-1][0], car, before[-1][1], t_ns, rng, noise) if before else None
        before.append((car, t_ns))
        obstacles = tracker.update(seen.obstacles, t_ns, ego, seen.free_space)
        return decider.decide(obstacles, seen.free_space, ego, t_ns, ROAD), None, None

    return look


def drive(scenario: str, seed: int, look: Look, film: Film | None = None) -> dict[str, Any]:
    """Drive once, and judge.

    Parameters
    ----------
    scenario, seed
        Which drive of `SCENARIOS`.
    look
        The eyes.
    film
        Takes each frame's result and picture.

    Returns
    -------
    `scenario`, `seed`, `outcome`, `reason`, `impact_mps` (relative, along the road), `km`, `nearest_m` (to anything),
    `at_m` (where it ended, along and left), `speed_mps` (then), and `actions` (how many frames of each).
    """
    challenge, body = SCENARIOS[scenario](seed), Body()
    world = World(challenge)
    car = CarState(*challenge.start_m, 0.0, challenge.speed_mps)
    waiting: deque[Decision] = deque([Decision("none", "begin")] * round(ACTUATOR_S / STEP_S))
    log, ended, step = Log([]), None, 0
    while ended is None:
        t_s = step * STEP_S
        if step % round(FRAME_S / STEP_S) == 0:
            decision, result, pair = look(challenge, t_s, car)
            if film is not None and result is not None and pair is not None:
                film(result, pair)
            if decision.action in ("brake", "swerve") and not set(log.actions[-5:]) & {"brake", "swerve"}:
                log.false_reason = log.false_reason or _needless(world, t_s, car, body, decision)
            log.actions.append(decision.action)
        waiting.append(decision)
        car = _obeyed(car, waiting.popleft(), challenge.speed_mps, challenge.scene.road)
        step += 1
        log.stood_s = log.stood_s + STEP_S if car.speed_mps < STANDS_MPS else 0.0
        ended = _ended(world, step * STEP_S, car, body, log)
    return {
        "scenario": scenario,
        "seed": seed,
        "outcome": ended.outcome,
        "reason": ended.reason,
        "impact_mps": ended.impact_mps,
        "km": round(_gone_m(challenge, car) / 1000, 4),
        "nearest_m": round(log.nearest_m, 3) if np.isfinite(log.nearest_m) else None,
        "at_m": [round(float(car.x_m), 2), round(float(car.y_m), 2)],
        "speed_mps": round(car.speed_mps, 2),
        "actions": {name: log.actions.count(name) for name in sorted(set(log.actions))},
    }


def _gone_m(challenge: Challenge, car: CarState) -> float:
    return place_on(challenge.scene.road, car.x_m, car.y_m)[0] - challenge.start_m[0]


def _obeyed(car: CarState, decision: Decision, wanted_mps: float, road: Road) -> CarState:
    """Return the car a step later: the driver keeps speed and direction of the road, a decision goes before."""
    gain = min(GAINING_MPS2, (wanted_mps - car.speed_mps) / STEP_S)
    along, left, turn = place_on(road, car.x_m, car.y_m)
    bend = road.curvature_per_m / (1 - road.curvature_per_m * left) if along > road.curve_from_m else 0.0
    home = bend - (car.heading_rad - turn) / max(4.0, 0.8 * car.speed_mps)
    if decision.action == "brake":
        return car.driven(-decision.deceleration_mps2, decision.curvature_per_m or home, STEP_S)
    if decision.action == "swerve":
        slow = gain if car.speed_mps < CREEP_MPS else -decision.deceleration_mps2
        return car.driven(slow, decision.curvature_per_m, STEP_S)
    return car.driven(gain, home, STEP_S)


class World:
    """A challenge as its judge sees it: what stands, and what moves."""

    def __init__(self, challenge: Challenge) -> None:
        self.challenge = challenge
        things = [(Obstruction(thing), thing) for thing in challenge.scene.things]
        self.still = [o for o, thing in things if not thing.velocity_mps.any()]
        self.moving = [(o, thing) for o, thing in things if thing.velocity_mps.any()]

    def about(self, t_s: float) -> list[Obstruction]:
        """Return all things after so many seconds; of what walks or pedals, as it held its limbs in the beginning."""
        return [*self.still, *(o.shifted(self.challenge.way_m(thing, t_s)) for o, thing in self.moving)]

    def exact(self, t_s: float, car: CarState, body: Body) -> list[Obstruction]:
        """Return all things after so many seconds, exactly as they are where that may matter."""
        about = self.about(t_s)[len(self.still) :]
        moving = [
            Obstruction(self.challenge.thing_at(thing, t_s)) if o.clearance_m(car, body) < NEAR_M else o
            for o, (_, thing) in zip(about, self.moving, strict=True)
        ]
        return [*self.still, *moving]


def _needless(world: World, t_s: float, car: CarState, body: Body, decision: Decision) -> str:
    """Return why an action was a false one; empty if something stood or came in the way."""
    road = world.challenge.scene.road
    along, left, _ = place_on(road, car.x_m, car.y_m)
    for ahead_s in np.arange(0, FREE_S, 0.1):
        there = car_on(road, along + ahead_s * world.challenge.speed_mps, left, car.speed_mps)
        if clearance_m(world.about(t_s + ahead_s), there, body)[0] < FREE_M:
            return ""
    return f"{decision.action} on a free road after {t_s:.1f} s: {decision.reason}"


def _ended(world: World, t_s: float, car: CarState, body: Body, log: Log) -> Ended | None:
    """Return how the drive ended, if it did."""
    challenge = world.challenge
    things, road = world.exact(t_s, car, body), challenge.scene.road
    gap_m, what = clearance_m(things, car, body)
    log.nearest_m = min(log.nearest_m, gap_m)
    if gap_m <= 0:
        return _touched(challenge, what, t_s, car)
    if not is_on(road, car, body):
        return Ended("failed", f"left the road after {t_s:.1f} s")
    good = Ended("false", log.false_reason) if log.false_reason else None
    if log.stood_s >= STANDS_S:
        if challenge.goes_on or can_go_on(world.still, car, body, road):
            return good or Ended("effective", f"stands {gap_m:.1f} m before a {what} and can go on")
        return Ended("failed", f"stands {gap_m:.1f} m before a {what} and cannot go on")
    named = [thing for thing in things if thing.thing.id]
    past = bool(named) and all(t.at_m[0] + t.size_m < car.x_m - body.rear_m for t in named)
    if past or _gone_m(challenge, car) >= challenge.length_m:
        return good or Ended("effective", "passed everything" if past else "reached the end")
    if t_s >= LONGEST_S:
        return good or Ended("effective", "still driving when time was up")
    return None


def _touched(challenge: Challenge, what: str, t_s: float, car: CarState) -> Ended:
    """Return that the car ran into something; what walks into a standing car was not run into."""
    moving = [thing for thing in challenge.things_at(t_s) if thing.type == what and thing.velocity_mps.any()]
    if moving and car.speed_mps < STANDS_MPS:
        return Ended("effective", f"stood when a {what} came up to it after {t_s:.1f} s")
    impact_mps = car.speed_mps - max((float(thing.velocity_mps[0]) for thing in moving), default=0.0)
    reason = f"touched a {what} at {car.speed_mps:.1f} m/s after {t_s:.1f} s"
    return Ended("failed", reason, round(max(impact_mps, 0.0), 2))
