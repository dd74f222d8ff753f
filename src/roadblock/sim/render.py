"""Scene and rig in; the stereo pair and its exact truth out."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import RigError, ValueRefusedError
from roadblock.geometry.pose import inverse, pose
from roadblock.sim import raycast
from roadblock.sim.scene import Scene
from roadblock.sim.solids import Part, Rgb, Thing, corners_m
from roadblock.sim.truth import TrueObject, true_ground, true_objects
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, locked
from roadblock.values.frame import DisparityMap, StereoPair
from roadblock.values.scene import GroundPlane

KINDS = {"box": 0, "ellipsoid": 1, "capsule": 2}
PATTERNS = {"plain": 0, "crate": 1, "windows": 2}

SEED_STRIDE = 10_000
"""Between the textures of one scene and those of the next seed."""

COARSEST_M = 0.4
"""Largest cell of a thing's texture."""

PATTERN_SEED = 20
"""Of the sub-pixel samples: part of the cameras, so the same in every picture."""

BAND_ROWS = 24
"""Rows a thread takes at a time."""

NEAR_M = 0.05
"""A part that comes nearer than this to a camera is looked for in every pixel."""


@dataclass(frozen=True, eq=False)
class Rendered:
    """A picture and what is true in it.

    Attributes
    ----------
    pair
        RGB, 8 bit.
    disparity
        At the left image's pixel centres, exact; NaN at sky and hills, which are infinitely far.
    ids
        (height, width) int32 id of the thing at each pixel centre of the left image; 0 = road, scenery or sky.
    objects
        Every named thing of which the left camera sees at least one pixel centre, nearest first.
    ground
        The road in the car frame.
    """

    pair: StereoPair
    disparity: DisparityMap
    ids: NDArray[np.int32]
    objects: tuple[TrueObject, ...]
    ground: GroundPlane


def render(
    scene: Scene,
    rig: StereoRig,
    *,
    samples: int = 4,
    seed: int = 0,
    noise: float = 1.5,
    threads: int | None = None,
    index: int = 0,
    name: str = "0",
    t_ns: int = 0,
) -> Rendered:
    """Take one picture with both cameras. The same arguments give the same bytes, whatever `threads` is.

    Parameters
    ----------
    scene, rig
        What is seen, and by what: a rectified rig.
    samples
        Rays per pixel and camera. 4 for looking at, 16 and more for measuring.
    seed
        Of the noise.
    noise
        Its standard deviation at mid grey, grey levels: half its variance is the sensor's own, half grows with
        brightness (shot noise).
    threads
        How many work at it; None = one per core.
    index, name, t_ns
        As in `StereoPair`.

    Raises
    ------
    RigError
        If the rig is not rectified.
    ValueRefusedError
        If `samples` or `threads` is below 1 or `noise` negative.
    """
    _check(rig, samples, noise, threads)
    world = _world(scene)
    views = [_view(scene, camera, side * rig.baseline_m / 2) for camera, side in ((rig.left, -1), (rig.right, 1))]
    width, height = rig.left.size_px
    workers = threads or os.cpu_count() or 1
    depth_m, met = np.empty((height, width)), np.empty((height, width), np.int64)
    _by_rows(height, workers, lambda a, b: raycast.measure(world, *views[0], a, b, depth_m, met))
    offsets = _offsets(height, samples)
    rng = np.random.default_rng(seed)
    left, right = (_picture(world, view, offsets, width, workers, noise, rng) for view in views)
    ids = _ids(scene, met)
    d_px = np.where(met == raycast.SKY, np.nan, rig.left.fx_px * rig.baseline_m / depth_m).astype(np.float32)
    return Rendered(
        StereoPair(left, right, index, name, t_ns),
        DisparityMap(d_px, 0.0),
        locked(ids),
        true_objects(scene, rig, depth_m, ids),
        true_ground(scene),
    )


def _check(rig: StereoRig, samples: int, noise: float, threads: int | None) -> None:
    if not rig.is_rectified:
        raise RigError("the renderer needs a rectified rig (parallel pinhole twins), but got another: rectify it first")
    if samples < 1 or (threads is not None and threads < 1):
        raise ValueRefusedError(f"samples and threads must be >= 1, but got {samples} and {threads}")
    if not 0 <= noise < np.inf:
        raise ValueRefusedError(f"noise must be >= 0 grey levels, but got {noise}")


def _picture(
    world: raycast.World,
    view: tuple[raycast.View, NDArray[np.int64]],
    offsets: FloatArray,
    width: int,
    workers: int,
    noise: float,
    rng: np.random.Generator,
) -> NDArray[np.uint8]:
    image = np.empty((len(offsets), width, 3), np.float32)
    _by_rows(len(offsets), workers, lambda a, b: raycast.paint(world, *view, offsets, a, b, image))
    if noise > 0:
        sigma = np.float32(noise) * np.sqrt(np.float32(0.5) + image / np.float32(256))
        image += sigma * rng.standard_normal(image.shape, np.float32)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def _by_rows(height: int, workers: int, work: Callable[[int, int], None]) -> None:
    """Do `work(first, last)` on bands of rows. The kernels let go of the interpreter, so plain threads do."""
    bands = range(0, height, BAND_ROWS)
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(work, bands, (min(first + BAND_ROWS, height) for first in bands)))


def _offsets(height: int, samples: int) -> FloatArray:
    """Return (height, samples, 2) sub-pixel positions, -0.5..0.5: one in each column and row of a samples^2 grid."""
    if samples == 1:
        return np.zeros((height, 1, 2))
    rng = np.random.default_rng(PATTERN_SEED)
    strata = np.tile(np.arange(samples, dtype=float), (height, 2, 1))
    places = rng.permuted(strata, axis=2) + rng.random((height, 2, samples))
    return np.ascontiguousarray(np.moveaxis(places / samples - 0.5, 1, 2))


def _ids(scene: Scene, met: NDArray[np.int64]) -> NDArray[np.int32]:
    of_part = [thing.id for thing in scene.things for _ in thing.parts]
    return np.array([*of_part, 0, 0], np.int32)[met]


def _linear(rgb: Rgb) -> list[float]:
    return [float((level / 255) ** 2.2) for level in rgb]


def _world(scene: Scene) -> raycast.World:
    parts = [(thing, part) for thing in scene.things for part in thing.parts]
    ends = list(accumulate(len(thing.parts) for thing in scene.things))
    spans = zip(scene.things, [0, *ends], ends, strict=False)
    road = scene.road
    return raycast.World(
        part=np.array([_part(thing, part, scene.seed, i) for i, (thing, part) in enumerate(parts)]).reshape(-1, 24),
        ball=np.array([[*_ball(thing), first, last] for thing, first, last in spans]).reshape(-1, 6),
        line=np.array([[at.left_m, at.width_m, at.dash_m, at.gap_m] for at in road.lines]).reshape(-1, 4),
        sun=tuple(scene.towards_sun.tolist()),
        road=(road.right_m, road.left_m, road.contrast, *_linear(road.asphalt), *_linear(road.verge)),
        seed=SEED_STRIDE * scene.seed,
    )


def _part(thing: Thing, part: Part, seed: int, index: int) -> list[float]:
    T = thing.T_world_thing @ part.T_thing_part
    reach = part.reach(np.eye(3))
    place = [*T[:3, 3], *T[:3, :3].ravel(), *part.half_m, reach @ reach]
    texture = [part.contrast, COARSEST_M, PATTERNS[part.pattern], SEED_STRIDE * seed + 10 * index]
    return [*place, KINDS[part.shape], *_linear(part.rgb), *texture]


def _ball(thing: Thing) -> FloatArray:
    low, high = thing.bounds_m(thing.T_world_thing)
    return np.append((low + high) / 2, np.linalg.norm(high - low) / 2)


def _view(scene: Scene, camera: Camera, right_m: float) -> tuple[raycast.View, NDArray[np.int64]]:
    """Return a camera `right_m` right of the car frame's origin, and the pixel boxes of all parts in it."""
    T = scene.T_world_car @ pose(np.eye(3), [right_m, 0.0, 0.0])
    from_world = inverse(T)
    boxes = [
        _pixel_box(camera, corners_m(part, from_world @ thing.T_world_thing))
        for thing in scene.things
        for part in thing.parts
    ]
    view = raycast.View(
        eye=tuple(T[:3, 3].tolist()),
        middle=tuple(scene.T_world_car[:3, 3].tolist()),
        axes=tuple(T[:3, :3].ravel().tolist()),
        f_px=camera.fx_px,
        cx_px=camera.cx_px,
        cy_px=camera.cy_px,
    )
    return view, np.array(boxes, np.int64).reshape(-1, 4)


def _pixel_box(camera: Camera, corners: FloatArray) -> tuple[int, int, int, int]:
    """Return the half-open box of pixels that may see a part with these corners in the camera frame."""
    width, height = camera.size_px
    if corners[:, 2].max() < 0:
        return 0, 0, 0, 0
    if corners[:, 2].min() < NEAR_M:
        return 0, 0, width, height
    uv = corners[:, :2] / corners[:, 2:] * camera.fx_px + (camera.cx_px, camera.cy_px)
    low, high = np.floor(uv.min(0) - 0.5), np.ceil(uv.max(0) + 0.5) + 1
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])
