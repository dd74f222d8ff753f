"""Scene and rig in; the light that reaches both cameras, the stereo pair, and the exact truth out."""

import os
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, transform
from roadblock.geometry.projection import unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.sim import raycast
from roadblock.sim.outlines import candidates
from roadblock.sim.road import MARKS, Road, ground_of
from roadblock.sim.scene import Scene
from roadblock.sim.solids import Rgb, Thing
from roadblock.sim.steam import veiled
from roadblock.sim.truth import TrueObject, true_ground, true_objects
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, finite, locked
from roadblock.values.frame import DisparityMap, StereoPair
from roadblock.values.scene import GroundPlane

KINDS = {"box": 0, "ellipsoid": 1, "capsule": 2, "cylinder": 3, "cone": 3}
PATTERNS = {"plain": 0, "crate": 1, "windows": 2}

SEED_STRIDE = 10_000
"""Between the textures of one scene and those of the next seed."""

COARSEST_M = 0.4
"""Largest cell of a thing's texture."""

PATTERN_SEED = 20
"""Of the sub-pixel samples: part of the cameras, so the same in every picture."""

BAND_ROWS = 24
"""Rows a thread takes at a time."""

SHUTTER_ROWS = 8
"""Rows that a rolling shutter exposes at one moment."""

SHADOWS_M = 400.0
"""Shadows on a falling road are looked for down to its height there."""


@dataclass(frozen=True)
class Quality:
    """How many rays a pixel gets.

    Attributes
    ----------
    inner
        Where it sees one smooth surface; 1 = its centre alone.
    mixed
        Where outlines, shadows, markings or things thinner than a pixel meet in it.

    Raises
    ------
    ValueRefusedError
        If one is below 1.
    """

    inner: int
    mixed: int

    def __post_init__(self) -> None:
        if self.inner < 1 or self.mixed < 1:
            raise ValueRefusedError(f"a pixel must get at least one ray, but got {self.inner} and {self.mixed}")


QUALITIES = {"preview": Quality(1, 1), "demo": Quality(1, 8), "evidence": Quality(8, 128)}
"""By name: to look at the scene, to look at the pictures, to measure."""


@dataclass(frozen=True, eq=False)
class Sighted:
    """What one camera sees, before its optics and sensor.

    Attributes
    ----------
    light
        (height, width, 3) float32 linear RGB, averaged over each pixel's area. 1 = what white, level ground sends out
        in the default sun; the sky reaches 0.95, a white wall facing the sun 1.2. 0 where the lens sees nothing.
    depth_m
        (height, width) forward distance in the camera frame at the pixel centres; infinity at sky and hills, NaN where
        the lens sees nothing.
    ids
        (height, width) int32 id of the thing at each pixel centre; 0 = road, scenery or sky.
    T_car_camera
        4x4 pose of the camera in the car frame, metres.
    """

    light: NDArray[np.float32]
    depth_m: FloatArray
    ids: NDArray[np.int32]
    T_car_camera: FloatArray


@dataclass(frozen=True, eq=False)
class Seen:
    """What both cameras see, and what is true in it.

    Attributes
    ----------
    left, right
        Light, depth and ids of each camera.
    disparity
        At the left image's pixel centres, exact; NaN at sky and hills, which are infinitely far. None where the rig is
        not rectified: raw images have none.
    objects
        Every named thing of which the left camera sees at least one pixel centre, nearest first.
    ground
        The road in the car frame: the plane that touches it under the cameras, and its bend there.
    """

    left: Sighted
    right: Sighted
    disparity: DisparityMap | None
    objects: tuple[TrueObject, ...]
    ground: GroundPlane


@dataclass(frozen=True, eq=False)
class Rendered:
    """A picture and what is true in it.

    Attributes
    ----------
    pair
        RGB, 8 bit; raw images where the rig is not rectified.
    depth_m, ids
        Of the left camera, as in `Sighted`.
    disparity, objects, ground
        As in `Seen`.
    """

    pair: StereoPair
    depth_m: FloatArray
    ids: NDArray[np.int32]
    disparity: DisparityMap | None
    objects: tuple[TrueObject, ...]
    ground: GroundPlane


class _Moment(NamedTuple):
    """The world and one camera in it at one time, as the kernels take them."""

    world: raycast.World
    view: raycast.View
    candidates: raycast.Candidates


def render(
    scene: Scene,
    rig: StereoRig,
    *,
    quality: str | Quality = "demo",
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
    scene, rig, quality, threads
        As in `render_linear`.
    seed
        Of the noise.
    noise
        Its standard deviation at mid grey, grey levels: half its variance is the sensor's own, half grows with
        brightness (shot noise).
    index, name, t_ns
        As in `StereoPair`.

    Raises
    ------
    ValueRefusedError
        If `noise` is negative or not finite, or as `render_linear`.
    """
    if not 0 <= noise < np.inf:
        raise ValueRefusedError(f"noise must be >= 0 grey levels, but got {noise}")
    seen = render_linear(scene, rig, quality=quality, threads=threads)
    sides = [(seen.left.light, np.random.default_rng([seed, 0])), (seen.right.light, np.random.default_rng([seed, 1]))]
    with ThreadPoolExecutor(_workers(threads)) as pool:
        left, right = pool.map(lambda side: _encoded(side[0], noise, side[1]), sides)
    pair = StereoPair(left, right, index, name, t_ns)
    return Rendered(pair, seen.left.depth_m, seen.left.ids, seen.disparity, seen.objects, seen.ground)


def render_linear(
    scene: Scene,
    rig: StereoRig,
    *,
    quality: str | Quality = "demo",
    threads: int | None = None,
    row_delays_s: tuple[FloatArray, FloatArray] | None = None,
) -> Seen:
    """Return the light that reaches both cameras. The same arguments give the same bytes, whatever `threads` is.

    Parameters
    ----------
    scene, rig
        What is seen, and by what: rectified twins, or cameras with lenses and poses of their own, whose raw images come
        out. The car frame of `Scene.T_world_car` is that of the rectified rig (eq. 8).
    quality
        Rays per pixel, or one of `QUALITIES` by name.
    threads
        How many work at it; None = one per core.
    row_delays_s
        For the left and the right camera, (height,) how much later than the scene's moment each row is exposed:
        the time between the cameras, and the rolling shutter (in steps of `SHUTTER_ROWS` rows). None = all at once.

    Raises
    ------
    ValueRefusedError
        If there is no such quality, `threads` is below 1, or the delays are not one number for each row.
    """
    rays_per_pixel = _quality(quality)
    workers = _workers(threads)
    height = rig.left.size_px[1]
    delays = [finite("row_delays_s", d, (height,)) for d in row_delays_s or (np.zeros(height), np.zeros(height))]
    left, right = (
        _sighted(scene, rig, side, rays_per_pixel, workers, delay)
        for side, delay in zip(("left", "right"), delays, strict=True)
    )
    v, u = np.nonzero(left.ids)
    points = transform(left.T_car_camera, _forward(rig.left, u, v) * left.depth_m[v, u][:, None])
    disparity = None
    if rig.is_rectified:
        d_px = rig.left.fx_px * rig.baseline_m / left.depth_m
        disparity = DisparityMap(np.where(np.isinf(left.depth_m), np.nan, d_px).astype(np.float32), 0.0)
    objects = true_objects(scene, rig, np.stack([u, v], -1), left.ids[v, u], points)
    return Seen(left, right, disparity, objects, true_ground(scene))


def _workers(threads: int | None) -> int:
    if threads is not None and threads < 1:
        raise ValueRefusedError(f"threads must be >= 1, but got {threads}")
    return threads or os.cpu_count() or 1


def _quality(quality: str | Quality) -> Quality:
    if isinstance(quality, Quality):
        return quality
    if quality not in QUALITIES:
        raise ValueRefusedError(f"quality must be one of {', '.join(QUALITIES)}, but got {quality!r:.40}")
    return QUALITIES[quality]


def _encoded(light: NDArray[np.float32], noise: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Return grey levels, gamma 2.2, clipped at white, with noise."""
    grey = np.float32(255) * np.clip(light, 0, 1) ** np.float32(1 / 2.2)
    if noise > 0:
        sigma = np.float32(noise) * np.sqrt(np.float32(0.5) + grey / np.float32(256))
        grey += sigma * rng.standard_normal(grey.shape, np.float32)
    return np.asarray(np.clip(np.rint(grey), 0, 255), np.uint8)


def _sighted(scene: Scene, rig: StereoRig, side: str, quality: Quality, workers: int, delay_s: FloatArray) -> Sighted:
    camera = rig.left if side == "left" else rig.right
    T_car_camera = _camera_pose(rig, side)
    width, height = camera.size_px
    rays = _rays(camera)
    image = np.empty((height, width, 3), np.float32)
    depth, met = np.empty((height, width)), np.empty((height, width), np.int64)
    tags = np.empty((height + 2, width + 2), np.int64)
    of_part = [thing.id for thing in scene.things for _ in thing.parts]
    parts, bands = len(of_part), _bands(delay_s)
    moments = {t: _moment(scene.at(t) if t else scene, rig, camera, T_car_camera) for t in {t for *_, t in bands}}

    def look(first: int, last: int, t_s: float) -> None:
        # The rows around the image are looked at for their tags alone.
        first, last = (first or -1), (last if last < height else height + 1)
        lists = np.empty((4, parts), np.int64)
        raycast.glance(*moments[t_s][:2], rays, moments[t_s].candidates, first, last, lists, image, depth, met, tags)

    def average(first: int, last: int, t_s: float) -> None:
        lists, textures = np.empty((4, parts), np.int64), np.empty((2, parts + 1))
        raycast.refine(
            *moments[t_s][:2], rays, moments[t_s].candidates, tags, inner, mixed, first, last, lists, textures, image
        )

    inner, mixed = sub_pixel_places(height, quality.inner), sub_pixel_places(height, quality.mixed)
    _by_bands(bands, workers, look)
    if quality.mixed > 1 or quality.inner > 1:
        _by_bands(bands, workers, average)
    ids = np.array([*of_part, 0, 0, 0], np.int32)[met]
    if len(rays):
        depth = np.where(np.isinf(depth), np.inf, depth * rays[2:-2, 2:-2, 2])
    for cloud in scene.clouds:
        _veil(image, depth, camera, scene.T_world_car @ T_car_camera, cloud)
    return Sighted(locked(image), locked(depth), locked(ids), T_car_camera)


def _veil(
    light: NDArray[np.float32], depth_m: FloatArray, camera: Camera, T_world_camera: FloatArray, cloud: Thing
) -> None:
    """Put a cloud into the picture: as it is at the scene's moment, and before what the pixels' centres see."""
    width, height = camera.size_px
    v, u = np.divmod(np.arange(width * height), width)
    ways = _forward(camera, u, v).reshape(height, width, 3)
    length = np.linalg.norm(ways, axis=-1)
    far_m = np.nan_to_num(depth_m * length, nan=0.0, posinf=np.inf)
    veiled(light, far_m, ways / length[..., None] @ T_world_camera[:3, :3].T, T_world_camera[:3, 3], cloud)


def _by_bands(bands: Iterable[tuple[int, int, float]], workers: int, work: Callable[[int, int, float], None]) -> None:
    """Do `work` on bands of rows. The kernels let go of the interpreter, so plain threads do."""
    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(lambda band: work(*band), bands))


def _bands(delay_s: FloatArray) -> list[tuple[int, int, float]]:
    """Return first row, one past the last, and moment of bands of rows."""
    rows = BAND_ROWS if np.ptp(delay_s) == 0 else SHUTTER_ROWS
    height = len(delay_s)
    starts = range(0, height, rows)
    return [(a, min(a + rows, height), float(delay_s[a : a + rows].mean())) for a in starts]


@lru_cache(maxsize=8)
def sub_pixel_places(height: int, samples: int) -> FloatArray:
    """Return (height, samples, 2) sub-pixel places, -0.5..0.5; for one sample the pixel's centre.

    Each row has its own shuffle (Owen's) of a (0, 2)-sequence (Sobol's), which fills every column, row and block of the
    pixel evenly, and random places in its cells.
    """
    if samples == 1:
        return np.asarray(locked(np.zeros((height, 1, 2))))
    bits = (samples - 1).bit_length()
    rng = np.random.default_rng(PATTERN_SEED)
    net = (qmc.Sobol(2, scramble=False).random_base2(bits)[:samples] * 2**bits).astype(np.int64)
    cells = np.zeros((height, samples, 2), np.int64)
    for bit in range(bits):
        # Whether a half is exchanged with the other is drawn anew inside each half of the half before.
        swap = rng.integers(0, 2, (height, 2**bit, 2))
        cells |= ((net >> (bits - 1 - bit) & 1) ^ np.take_along_axis(swap, net[None] >> (bits - bit), 1)) << (
            bits - 1 - bit
        )
    return np.asarray(locked((cells + rng.random(cells.shape)) / 2**bits - 0.5))


def _camera_pose(rig: StereoRig, side: str) -> FloatArray:
    """Return the pose of a camera in the car frame: that of its rectified twin, turned back."""
    sign = -1 if side == "left" else 1
    rotations = rectifying_rotations(rig.T_left_right)
    R = np.eye(3) if rig.is_rectified else rotations[side == "right"]
    return pose(R, [sign * rig.baseline_m / 2, 0.0, 0.0])


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> FloatArray:
    """Return (height + 4, width + 4, 3) unit rays of the pixels and two more on each side; none for a pinhole."""
    if camera.lens == "pinhole":
        return np.zeros((0, 0, 3))
    width, height = camera.size_px
    return np.asarray(locked(unproject(camera, _pixels(np.arange(-2, width + 2), np.arange(-2, height + 2)))))


def _pixels(u: NDArray[np.int64], v: NDArray[np.int64]) -> FloatArray:
    return np.stack(np.meshgrid(u, v), -1).astype(float)


def _forward(camera: Camera, u: NDArray[np.int64], v: NDArray[np.int64]) -> FloatArray:
    """Return (n, 3) directions of pixels in the camera frame, one metre forward each."""
    if camera.lens == "pinhole":
        x, y = (u - camera.cx_px) / camera.fx_px, (v - camera.cy_px) / camera.fy_px
        return np.stack([x, y, np.ones(len(u))], -1)
    rays = _rays(camera)[v + 2, u + 2]
    return np.asarray(rays / rays[:, 2:])


def _moment(scene: Scene, rig: StereoRig, camera: Camera, T_car_camera: FloatArray) -> _Moment:
    T = scene.T_world_car @ T_car_camera
    solids = [_solids(thing) for thing in scene.things]
    rows = np.concatenate([np.zeros((0, 24)), *(rows for rows, _ in solids)])
    reach = np.concatenate([np.zeros((0, 3)), *(reach for _, reach in solids)])
    rows[:, 23] = SEED_STRIDE * scene.seed + 10 * np.arange(len(rows))
    world = _world(scene, rows)
    lowest = world.ground.low + min(0.0, raycast.profile(world.ground, SHADOWS_M)[0])
    pinhole = camera.lens == "pinhole"
    view = raycast.View(
        eye=tuple(T[:3, 3].tolist()),
        axes=tuple(T[:3, :3].ravel().tolist()),
        middle=tuple(scene.T_world_car[:3, 3].tolist()),
        ahead=tuple(scene.T_world_car[:3, 2].tolist()),
        f_px=rig.left.fx_px,
        round=rig.left.lens == "kannala_brandt",
        lens=(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px) if pinhole else (0.0, 0.0, 0.0, 0.0),
    )
    return _Moment(world, view, candidates(rows, reach, camera, inverse(T), scene.towards_sun, lowest))


def _world(scene: Scene, rows: FloatArray) -> raycast.World:
    road: Road = scene.road
    marks = [(MARKS[m.kind], m.along_m, m.left_m, m.length_m, m.width_m) for m in road.marks]
    return raycast.World(
        part=rows,
        line=np.array([[at.left_m, at.width_m, at.dash_m, at.gap_m] for at in road.lines], float).reshape(-1, 4),
        mark=np.array(marks, float).reshape(-1, 5),
        sun=tuple(scene.towards_sun.tolist()),
        paint=(float(road.contrast), *_linear(road.asphalt), *_linear(road.verge)),
        ground=ground_of(road),
        seed=SEED_STRIDE * scene.seed,
    )


def _linear(rgb: Rgb) -> list[float]:
    return [float((level / 255) ** 2.2) for level in rgb]


@lru_cache(maxsize=1024)
def _solids(thing: Thing) -> tuple[FloatArray, FloatArray]:
    """Return the parts of a thing as in `World.part`, without the texture seeds, and (n, 3) their own half sizes."""
    T = thing.T_world_thing @ np.array([part.T_thing_part for part in thing.parts])
    reach = np.array([part.reach(np.eye(3)) for part in thing.parts])
    look = [
        [KINDS[part.shape], *_linear(part.rgb), part.contrast, COARSEST_M, PATTERNS[part.pattern], 0.0]
        for part in thing.parts
    ]
    half = [part.half_m for part in thing.parts]
    rows = np.concatenate(
        [T[:, :3, 3], T[:, :3, :3].reshape(-1, 9), half, (reach**2).sum(1, keepdims=True), look], axis=1
    )
    return locked(rows), locked(reach)
