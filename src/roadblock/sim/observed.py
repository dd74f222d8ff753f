"""A fast stand-in for cameras and detector: what would be found of a scene, with noise and misses.

Every part of a thing is taken for the upright box around it; nothing is rendered, and steam is not seen.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from roadblock.geometry.pose import inverse, rotation_from_rotvec, transform, vehicle_from_car
from roadblock.sim.car import HEIGHT_M, OVER_M, CarState
from roadblock.sim.road import Road, place_on
from roadblock.sim.solids import Part, Thing, corners_m
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace, Obstacle, RoadEdges

COLUMN_PX = 4.0
NEAREST_M = 1.5


class Noise(NamedTuple):
    """How a detector errs; the defaults are what rendered pictures showed (`benchmarks/accuracy/observed.py`).

    Attributes
    ----------
    d_px
        Standard deviation of an obstacle's disparity.
    column_px
        Of each column of free space, on top.
    edge_px
        Of each end of an obstacle's box, which is half of it too far out.
    found_m, missed_per_m, most_missed
        Up to where an obstacle is always found, how fast the probability grows behind that it is not (though its
        columns end), and how large it becomes.
    known_m, unknown
        Behind that, the share of columns of which nothing is known.
    reach_m, kerb_reach_m
        How far road and kerbs are seen.
    step_share, turn_rad
        Of the car's own motion: share of each step, and rotation.
    """

    d_px: float = 0.25
    column_px: float = 0.5
    edge_px: float = 4.0
    found_m: float = 6.0
    missed_per_m: float = 0.033
    most_missed: float = 0.6
    known_m: float = 15.0
    unknown: float = 0.06
    reach_m: float = 30.0
    kerb_reach_m: float = 10.0
    step_share: float = 0.007
    turn_rad: float = 1e-4


class Observed(NamedTuple):
    """What a detector would give: obstacles without tracks, and free space."""

    obstacles: tuple[Obstacle, ...]
    free_space: FreeSpace


def observe(
    things: tuple[Thing, ...], road: Road, car: CarState, twin: Rectification, rng: np.random.Generator, noise: Noise
) -> Observed:
    """Return what would be found from a car on a level road.

    Parameters
    ----------
    things
        Where they are.
    road
        Its kerbs are seen if it has any.
    car
        Where the cameras are.
    twin
        The cameras.
    rng
        Of noise and misses.
    noise
        How much of it.
    """
    u = np.arange(COLUMN_PX / 2, twin.size_px[0], COLUMN_PX)
    fb = twin.f_px * twin.baseline_m
    nearest = np.full(len(u), np.inf)
    found = []
    T_car_world = inverse(car.T_world_car)
    for thing in things:
        columns = _columns(thing, T_car_world, twin, u)
        z = float(columns.min(initial=np.inf))
        if not z < 1.5 * noise.reach_m:
            continue
        visible = np.flatnonzero((columns < nearest) & np.isfinite(columns))
        if len(visible) < 2:
            continue
        shared = rng.normal(0, noise.d_px)
        d = fb / columns + shared + rng.normal(0, noise.column_px, len(u))
        nearest = np.minimum(nearest, fb / np.maximum(d, 0.5))
        missed = np.clip(noise.missed_per_m * (z - noise.found_m), 0, noise.most_missed)
        if thing.id and rng.random() >= missed:
            edges = u[visible[[0, -1]]] + np.array([-1, 1]) * rng.normal(noise.edge_px / 2, noise.edge_px, 2)
            found.append(_obstacle(thing, np.sort(edges), fb / z + shared, twin, noise))
    blocked = nearest < noise.reach_m
    range_m = np.where(blocked, nearest, noise.reach_m)
    unknown = (range_m > noise.known_m) & (rng.random(len(u)) < noise.unknown)
    blocked, range_m = blocked & ~unknown, np.where(unknown, np.nan, range_m)
    return Observed(tuple(found), FreeSpace(u, range_m, blocked, _edges(road, car, twin, u, range_m, rng, noise)))


def _edges(
    road: Road,
    car: CarState,
    twin: Rectification,
    u: FloatArray,
    range_m: FloatArray,
    rng: np.random.Generator,
    noise: Noise,
) -> RoadEdges:
    """Return the kerbs, as far as they are seen."""
    z = np.full(len(u), np.nan)
    if road.kerb_m:
        along, left, turn = place_on(road, car.x_m, car.y_m)
        aside = -(u - twin.cx_px) / twin.f_px  # to the left, by metre ahead
        c, s = np.cos(car.heading_rad - turn), np.sin(car.heading_rad - turn)
        bend = road.curvature_per_m if along > road.curve_from_m else 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            ranges = [_crossed_m(side - left, s + aside * c, bend / 2) for side in (road.right_m, road.left_m)]
        first = np.min(np.where(np.array(ranges) > 0, ranges, np.inf), axis=0)
        fb = twin.f_px * twin.baseline_m
        first = fb / np.maximum(fb / first + rng.normal(0, noise.column_px, len(u)), 0.5)
        z = np.where((first < noise.kerb_reach_m) & (first < range_m), first, np.nan)
    is_kerb = np.isfinite(z)
    return RoadEdges(z, np.where(is_kerb, road.kerb_m, np.nan), is_kerb.astype(np.uint8))


def _crossed_m(left_m: float, slope: FloatArray, bend_per_m: float) -> FloatArray:
    """Return how far ahead lines of these slopes meet `left + bend x^2`; NaN or below 0 where they do not."""
    if not bend_per_m:
        return np.asarray(left_m / slope)
    root = np.sqrt(slope**2 - 4 * bend_per_m * left_m)
    nearer, farther = np.sort([(slope - root) / (2 * bend_per_m), (slope + root) / (2 * bend_per_m)], axis=0)
    return np.asarray(np.where(nearer > 0, nearer, farther))


def _columns(thing: Thing, T_car_world: FloatArray, twin: Rectification, u: FloatArray) -> FloatArray:
    """Return (n,) the forward distance of a thing in each column; infinity where it is not."""
    world = transform(thing.T_world_thing, _corners(thing.parts))
    p = transform(T_car_world, world)
    counts = (world[..., 2].min(1) < HEIGHT_M) & (world[..., 2].max(1) > OVER_M) & (p[..., 2].max(1) > NEAREST_M)
    found, p = np.full(len(u), np.inf), p[counts]
    if not len(p):
        return found
    inside = slice(None)
    if p[..., 2].min() > NEAREST_M:
        ends = (p[..., 0] + twin.baseline_m / 2) / p[..., 2] * twin.f_px + twin.cx_px
        inside = slice(*np.searchsorted(u, [ends.min(), ends.max()]))
    ahead = (u[inside] - twin.cx_px) / twin.f_px
    # Seen from above: where a column's plane crosses the lines between any two corners of a box.
    off = p[..., :1] + twin.baseline_m / 2 - ahead * p[..., 2:]
    begin, end = off[:, _PAIRS[0]], off[:, _PAIRS[1]]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = begin / (begin - end)
        z = p[:, _PAIRS[0], 2, None] + share * (p[:, _PAIRS[1], 2] - p[:, _PAIRS[0], 2])[..., None]
        top = p[..., 1].min(1)[:, None, None]
        seen = (begin * end <= 0) & (z > NEAREST_M) & (top < z * (twin.size_px[1] - twin.cy_px) / twin.f_px)
    found[inside] = np.where(seen, z, np.inf).min((0, 1))
    return found


_PAIRS = np.triu_indices(8, 1)


@lru_cache(maxsize=512)
def _corners(parts: tuple[Part, ...]) -> FloatArray:
    """Return (n, 8, 3) corners of the boxes around parts, in the axes of the thing."""
    return np.array([corners_m(part, np.eye(4)) for part in parts])


def _obstacle(thing: Thing, edges_px: FloatArray, d_px: float, twin: Rectification, noise: Noise) -> Obstacle:
    fb = twin.f_px * twin.baseline_m
    z = fb / max(d_px, 0.5)
    middle, width = edges_px.mean(), max(np.ptp(edges_px), 1.0)
    x = (middle - twin.cx_px) / twin.f_px * z - twin.baseline_m / 2
    height = float(thing.size_m[1])
    camera_m = 1.4
    foot, top = (twin.cy_px + twin.f_px * y / z for y in (camera_m, camera_m - height))
    sigma_m = z * z / fb * noise.d_px
    cov_px2 = np.diag([noise.edge_px**2 / 2, 4.0, noise.d_px**2])
    cov_m2 = np.diag([sigma_m**2, (noise.edge_px / twin.f_px * z) ** 2, 0.05**2])
    v0, v1 = round(top), max(round(foot), round(top) + 2)
    box = (round(edges_px.min()), v0, max(round(edges_px.max()), round(edges_px.min()) + 1), v1)
    return Obstacle(
        transform(vehicle_from_car(None), [x, camera_m, z]),
        z,
        sigma_m,
        np.array([width / twin.f_px * z, height, np.nan]),
        np.array([middle, (v0 + v1) / 2, fb / z]),
        cov_px2,
        cov_m2,
        box,
        np.zeros((0, 2), np.int32),
    )


def measured_step(
    before: CarState, now: CarState, before_t_ns: int, t_ns: int, rng: np.random.Generator, noise: Noise
) -> EgoMotion:
    """Return the car's own motion between two frames, with noise."""
    T = inverse(now.T_world_car) @ before.T_world_car
    T[:3, 3] *= 1 + rng.normal(0, noise.step_share)
    T[:3, :3] = T[:3, :3] @ rotation_from_rotvec(rng.normal(0, noise.turn_rad, 3))
    length = float(np.linalg.norm(T[:3, 3]))
    cov = np.diag([noise.turn_rad**2] * 3 + [(noise.step_share * length) ** 2 + 1e-6] * 3)
    return EgoMotion(before_t_ns, t_ns, T, cov)
