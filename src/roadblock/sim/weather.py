"""What stands between the world and the camera: darkness and lamps, water, fog, rain, dirt. Light in, light out.

All of it works on the light and the depth of one camera's pixels. What is in the world (lamps, reflections, fog,
falling drops) has its place in the car frame, so both cameras see it there; what lies on a lens is that camera's own.
"""

import math
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import pairwise
from typing import Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, transform
from roadblock.geometry.projection import project, unproject
from roadblock.sim.sensor import SIDES, Light, blur, in_range, whole
from roadblock.values.camera import Camera
from roadblock.values.checks import FloatArray, finite, locked

Weight = NDArray[np.float32]
"""(height, width) shares 0..1."""

DirtySide = Literal["left", "right"]

AIRLIGHT = np.array([0.62, 0.66, 0.70], np.float32)
"""What thick fog sends into the camera by day."""

CONTRAST_LEFT = 0.05
"""Of a black thing against the sky, at the visibility range (the meteorological optical range)."""

WATER = 1.33
"""Refractive index."""

WET_ALBEDO = 0.6
"""Share of its brightness that a soaked surface keeps: light that entered the water film is caught in it."""

STANDING_M = 0.03
"""What is this high over the road stands on it; anything lower is the road."""

HEAD_LAMP_M = (0.6, 0.75, 1.6)
"""The head lamps in the car frame: so far to both sides, below and ahead of the cameras."""

CUT_OFF_RAD = math.radians(-0.57)
"""Elevation of the edge of the low beam: 1 % down, as lamps are adjusted."""

STRAY = 0.1
"""What a low beam throws over its edge."""

STREET_LAMP_M = (28.0, 6.0, 0.13)
"""Of street lamps: the distance between those that hang over the middle of the road, their height, their radius."""

STREET_LAMP_LEFT_M = 1.7
STREET_LAMPS = 8
"""How many ahead are lit."""

LAMP_RGB = {"head": np.array([1.0, 0.95, 0.86], np.float32), "street": np.array([1.0, 0.80, 0.52], np.float32)}

LAMP_GLOW = 200.0
"""Brightness of a street lamp itself, as a multiple of a white road right under it."""

DROP_M = 0.0025
"""Diameter of the falling drops that are seen one by one."""

DROPS_PER_M3 = 25.0
"""Of them, per mm/h of rain."""

FALL_MPS = 6.5
SHUTTER_S = 0.008
"""How long a drop draws its streak."""

RAIN_LAYERS_M = (0.35, 0.8, 1.6, 4.0)
"""Distances between which drops are drawn with one sharpness; farther ones are a veil (fog)."""

STREAK_SAMPLES = 48
"""How many points draw a streak, at most; short ones get one for each pixel."""

WIDER_M = 0.25
"""How much wider than the view drops are strewn: they fly on, and the cameras stand apart."""

DEFOCUS_PX_M = 0.6
"""Blur of a drop 1 m away, pixels; inverse to its distance."""

DROP_SHINE = 1.5
"""Brightness of a drop against thick fog's."""

GLARE_PX, GLARE_SHARE = 2.0, 0.02
"""Core of the glare around a lamp, and how much of its light goes there."""

PUDDLE_SEED = 7
EMPTY = 0.02
"""Weight of the sky in a mirror."""

SPOTS = 16
DIRT = np.array([0.42, 0.36, 0.28], np.float32)
"""What dirt scatters into the lens, as a share of the mean light."""

SKY_M = 1e4
"""How far away the sky is taken to be."""


@dataclass(frozen=True)
class Weather:
    """What the day is like, and what is on the lenses. Each effect is off by default.

    Attributes
    ----------
    daylight
        Share of full daylight that is left, in red, green and blue.
    head_lamps
        Light of the own low beam on a white wall 10 m ahead, as a share of full sun; 0 = off.
    street_lamps
        Light of a street lamp on the road right under it, likewise; 0 = none.
    visibility_m
        Meteorological optical range of fog: where 5 % of the contrast is left. Infinity = clear.
    rain_mm_h
        Falling rain: streaks near by, a veil farther off.
    wetness
        0 = dry, 1 = a film of water all over the road, which darkens and mirrors.
    lens_drops
        How many drops of water hang on each lens.
    dirt
        How much light the worst spot on a dirty lens keeps back, 0..1.
    dirty_side
        Which lens is dirty.

    Raises
    ------
    ValueRefusedError
        If a number is outside of what it can be, or there is no such side.
    """

    daylight: tuple[float, float, float] = (1.0, 1.0, 1.0)
    head_lamps: float = 0.0
    street_lamps: float = 0.0
    visibility_m: float = math.inf
    rain_mm_h: float = 0.0
    wetness: float = 0.0
    lens_drops: int = 0
    dirt: float = 0.0
    dirty_side: DirtySide = "left"

    def __post_init__(self) -> None:
        ranges = {
            "head_lamps": (0.0, 10.0),
            "street_lamps": (0.0, 10.0),
            "visibility_m": (1.0, math.inf),
            "rain_mm_h": (0.0, 300.0),
            "wetness": (0.0, 1.0),
            "dirt": (0.0, 1.0),
        }
        for name, (low, high) in ranges.items():
            in_range(name, getattr(self, name), low, high)
        whole("lens_drops", self.lens_drops, 0, 1000)
        daylight = finite("daylight", self.daylight, (3,)).tolist()
        for share in daylight:
            in_range("daylight", share, 0.0, 1.0)
        object.__setattr__(self, "daylight", tuple(daylight))
        if self.dirty_side not in SIDES:
            raise ValueRefusedError(f"dirty_side must be one of {', '.join(SIDES)}, but got {self.dirty_side!r:.40}")


@dataclass(frozen=True, eq=False)
class Sight:
    """One camera's view of a clear day, before any weather.

    Attributes
    ----------
    light
        (height, width, 3) linear RGB.
    depth_m
        (height, width) forward distance in the camera frame at the pixel centres; infinity at the sky.
    camera
        It.
    T_car_camera
        4x4 pose of the camera in the car frame, metres.
    T_world_car
        4x4 pose of the car frame in the world (x forward, y left, z up), metres.
    height_m
        (height, width) how high over the road each pixel's point is; infinity at the sky.
    is_road
        (height, width) whether it is asphalt, which can be wet.
    lamps_m
        (n, 3) street lamps, in the car frame.
    """

    light: Light
    depth_m: FloatArray
    camera: Camera
    T_car_camera: FloatArray
    T_world_car: FloatArray
    height_m: FloatArray
    is_road: NDArray[np.bool_]
    lamps_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def up(self) -> FloatArray:
        """(3,) unit vector upwards, in the car frame."""
        return self.T_world_car[2, :3]

    def points_m(self) -> FloatArray:
        """Return (height, width, 3) car-frame points that the pixels see, metres; the sky is `SKY_M` away."""
        return transform(self.T_car_camera, ways(self.camera) * np.minimum(self.depth_m, SKY_M)[..., None])

    def pixels(self, points: FloatArray) -> FloatArray:
        """Return (..., 2) pixels of car-frame points (..., 3); NaN behind the camera."""
        return project(self.camera, transform(inverse(self.T_car_camera), points))


@lru_cache(maxsize=4)
def ways(camera: Camera) -> FloatArray:
    """Return (height, width, 3) ways of the pixels' rays in the camera frame, one metre forward each; read-only.

    NaN where the lens model sees nothing or not forward.
    """
    width, height = camera.size_px
    rays = unproject(camera, np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1))
    return locked(rays / np.where(rays[..., 2:] > 0, rays[..., 2:], np.nan))


def weathered(
    sight: Sight,
    weather: Weather,
    *,
    side: DirtySide,
    drops: FloatArray,
    lens: np.random.Generator,
    speed_mps: float = 0.0,
) -> Light:
    """Return the light that enters one camera's lens.

    Parameters
    ----------
    sight
        What it sees on a clear day.
    weather
        What is to be done to it.
    side
        Which camera it is.
    drops
        (n, 3) where rain drops are when the shutter opens, car frame: the same for both cameras (`falling_drops`).
    lens
        Random generator of what is on this lens: of the same state for every frame of a drive.
    speed_mps
        Own speed, at which drops come nearer.
    """
    shaded, shining = darken(sight, weather)
    through, veil = air(shaded, weather)
    light = shaded.light * through + veil
    if weather.wetness > 0:
        light = wet(shaded, weather.wetness, through, veil)
    light = np.asarray(light + shining, np.float32)
    if weather.rain_mm_h > 0:
        light = rain(light, shaded, weather, drops, speed_mps)
    if weather.lens_drops > 0:
        light = hang_drops(light, weather.lens_drops, lens)
    if weather.dirt > 0 and side == weather.dirty_side:
        light = soil(light, weather.dirt, lens)
    return light


def darken(sight: Sight, weather: Weather) -> tuple[Sight, Light]:
    """Return the sight with the light that is left and that of the lamps, and the glare of the lamps in the lens.

    What a pixel sends back by day stands for how much of the lamps' light it sends back: the shadows of the day stay.
    A surface's slant is known for the road only; all else is lit as if it faced the lamp.
    """
    day = np.array(weather.daylight, np.float32)
    lamps = sight.lamps_m if weather.street_lamps > 0 else np.zeros((0, 3))
    if weather.head_lamps == 0 and len(lamps) == 0:
        same = weather.daylight == (1.0, 1.0, 1.0)
        return (sight if same else replace(sight, light=sight.light * day)), np.zeros_like(sight.light)
    points, lying = sight.points_m().astype(np.float32), sight.height_m < STANDING_M
    shine = day + LAMP_RGB["head"] * head_light(points, sight.up, lying, weather.head_lamps)[..., None]
    shine = shine + LAMP_RGB["street"] * street_light(points, sight.up, lying, lamps, weather.street_lamps)[..., None]
    return _with_lamps(replace(sight, light=np.asarray(sight.light * shine, np.float32)), weather, lamps)


def _with_lamps(sight: Sight, weather: Weather, lamps: FloatArray) -> tuple[Sight, Light]:
    """Draw the lamps themselves, as discs that hide what is behind them, and their glare."""
    light, depth, glare = sight.light.copy(), sight.depth_m.copy(), np.zeros_like(sight.light)
    width, height = sight.camera.size_px
    for lamp in lamps:
        u, v = sight.pixels(lamp)
        if not (0 <= u <= width - 1 and 0 <= v <= height - 1):
            continue
        far = float(transform(inverse(sight.T_car_camera), lamp)[2])
        if sight.depth_m[round(v), round(u)] < far:
            continue
        apart = np.hypot(np.arange(width) - u, (np.arange(height) - v)[:, None]).astype(np.float32)
        radius = STREET_LAMP_M[2] * sight.camera.fx_px / far
        bright = np.float32(LAMP_GLOW * weather.street_lamps) * LAMP_RGB["street"]
        cover = np.clip(radius - apart + np.float32(0.5), 0, 1)[..., None]
        light += cover * (bright - light)
        depth[cover[..., 0] > 0] = far
        through = math.exp(-extinction_per_m(weather) * far)
        spread = np.float32(GLARE_SHARE * through * math.pi * radius**2) / (apart + np.float32(GLARE_PX)) ** 2
        glare += spread[..., None] * bright
    return replace(sight, light=light, depth_m=depth), glare


def head_light(points: NDArray[Any], up: FloatArray, lying: NDArray[np.bool_] | bool, strength: float) -> Weight:
    """Return (...) the light of the own low beam on surfaces at car-frame points (..., 3).

    Two lamps of inverse-square light; wide, and cut off at `CUT_OFF_RAD`. Surfaces that lie on the road get the cosine
    of it, all others face the lamp. `strength` is what both together give on a white wall 10 m ahead, right below the
    edge.
    """
    aside, below, ahead = HEAD_LAMP_M
    total = np.zeros(points.shape[:-1])
    for side in (-aside, aside):
        d = points - (side, below, ahead)
        r = np.maximum(np.linalg.norm(d, axis=-1), 0.1)
        rise = (d @ up) / r
        wide = np.exp(-0.5 * (np.arctan2(d[..., 0], np.maximum(d[..., 2], 1e-3)) / 0.30) ** 2) * (d[..., 2] > 0)
        under = 1 / (1 + np.exp(np.clip((rise - CUT_OFF_RAD) / 0.006, -60, 60)))
        tall = under * np.exp(-np.abs(rise - CUT_OFF_RAD) / 0.12) + STRAY * np.exp(-np.abs(rise) / 0.15)
        total += (10.0 / r) ** 2 / 2 * wide * tall * np.where(lying, np.maximum(-rise, 0.0), 1.0)
    return np.asarray(strength * np.nan_to_num(total), np.float32)


def hanging_lamps(T_world_car: FloatArray) -> FloatArray:
    """Return (n, 3) lamps near by and ahead, in the car frame: they hang along the world's x axis and stand still."""
    apart, high, _ = STREET_LAMP_M
    first = math.floor(T_world_car[0, 3] / apart)
    lamps = [((first + k) * apart, STREET_LAMP_LEFT_M, high) for k in range(STREET_LAMPS)]
    return transform(inverse(T_world_car), lamps)


def street_light(
    points: NDArray[Any], up: FloatArray, lying: NDArray[np.bool_] | bool, lamps: FloatArray, strength: float
) -> Weight:
    """Return (...) the light of street lamps (n, 3) on surfaces at car-frame points (..., 3).

    Inverse-square, downwards by the cosine, and by the cosine again on what lies on the road; `strength` is what one
    lamp gives on the road right under it.
    """
    total = np.zeros(points.shape[:-1])
    for lamp in lamps:
        d = points - lamp
        r = np.maximum(np.linalg.norm(d, axis=-1), 0.5)
        down = np.maximum(-(d @ up) / r, 0.0)
        total += (STREET_LAMP_M[1] / r) ** 2 * down * np.where(lying, down, 1.0)
    return np.asarray(strength * np.nan_to_num(total), np.float32)


def extinction_per_m(weather: Weather) -> float:
    """Return how fast the air takes light away, per metre: by the visibility, and by rain.

    Rain of R mm/h takes 1.076 R^0.67 dB/km (Carbonneau).
    """
    of_fog = -math.log(CONTRAST_LEFT) / weather.visibility_m
    of_rain_db_per_km = 1.076 * math.pow(weather.rain_mm_h, 0.67)
    return of_fog + of_rain_db_per_km * math.log(10) / 10_000


def air(sight: Sight, weather: Weather) -> tuple[Light, Light]:
    """Return what the air leaves of the light from each pixel's point, and what it adds.

    Both are broadcastable to (height, width, 3). By Koschmieder: `L = L0 t + A (1 - t)` with
    `t = exp(-extinction * distance)`, the distance along the pixel's ray. Where a pixel's centre sees another depth
    than its rim does, the rim gets the centre's fog.
    """
    extinction = extinction_per_m(weather)
    if extinction == 0:
        return np.ones((1, 1, 3), np.float32), np.zeros((1, 1, 3), np.float32)
    along = np.linalg.norm(ways(sight.camera), axis=-1) * sight.depth_m
    through = np.nan_to_num(np.exp(-extinction * along), nan=1.0).astype(np.float32)[..., None]
    return through, AIRLIGHT * np.array(weather.daylight, np.float32) * (1 - through)


def wet(sight: Sight, wetness: float, through: Light, veil: Light) -> Light:
    """Return the light with a wet road: darker, and mirroring what stands on it by Fresnel's law.

    Approximate. Each pixel's point is mirrored at the level of the road below it and put where the camera would see it,
    so reflections have the disparity of their mirrored world; but only what the camera itself sees can be mirrored (no
    undersides), to a pixel, blurred upright as by a rough road. Puddles come and go in patches that lie still in the
    world. `through` and `veil` are what the air leaves and adds (`air`).
    """
    points = sight.points_m()
    sightline = points - sight.T_car_camera[:3, 3]
    cosine = np.clip(-(sightline @ sight.up) / np.linalg.norm(sightline, axis=-1), 0, 1)
    at_normal = ((WATER - 1) / (WATER + 1)) ** 2
    fresnel = at_normal + (1 - at_normal) * (1 - cosine) ** 5  # Schlick
    film = np.where(sight.is_road, wetness * puddles(transform(sight.T_world_car, points)), 0.0)
    share = np.where(sight.is_road, film * fresnel, 0.0).astype(np.float32)[..., None]
    kept = (1 - film * (1 - WET_ALBEDO)).astype(np.float32)[..., None]
    mirrored = _mirrored(replace(sight, light=np.asarray(sight.light * through + veil, np.float32)), points)
    # The mirrored light has come through all of the air on its way; of that, the veil before the road is there already.
    return np.asarray(sight.light * kept * (1 - share) * through + veil + share * (mirrored - veil), np.float32)


def puddles(world: FloatArray) -> Weight:
    """Return (...) how wet the road is, 0.3..1, at world points (..., 3)."""
    rng = np.random.default_rng(PUDDLE_SEED)
    total = np.zeros(world.shape[:-1])
    for wave_m in (0.9, 1.4, 2.1, 3.3, 5.0, 8.0):
        angle, phase = rng.uniform(0, 2 * np.pi, 2)
        total += np.sin((world[..., 0] * np.cos(angle) + world[..., 1] * np.sin(angle)) * (2 * np.pi / wave_m) + phase)
    return np.asarray(np.clip(0.75 + 0.2 * total, 0.3, 1.0), np.float32)


def _mirrored(sight: Sight, points: FloatArray) -> Light:
    """Return what a perfect, slightly rough mirror in place of the road would show."""
    width, height = sight.camera.size_px
    stands = (sight.height_m >= STANDING_M) & ~sight.is_road
    source = points[stands]
    over = np.where(np.isfinite(sight.height_m), sight.height_m, transform(sight.T_world_car, points)[..., 2])[stands]
    uv = sight.pixels(source - 2 * over[:, None] * sight.up)
    at = np.rint(np.nan_to_num(uv, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(np.int64)
    seen = ((at >= 0) & (at < (width, height))).all(1)
    far_first = np.argsort(-source[seen, 2], kind="stable")  # so that near things are painted over far ones
    u, v = at[seen][far_first].T
    image, known = np.zeros_like(sight.light), np.zeros((height, width), np.float32)
    image[v, u], known[v, u] = sight.light[stands][seen][far_first], 1.0
    amount = _upright(known)[..., None]
    sky = sight.light[:1].mean((0, 1))  # where nothing that the camera sees is mirrored, the sky will be
    return np.asarray((_upright(image) + EMPTY * sky) / (amount + EMPTY), np.float32)


def _upright(image: Light) -> Light:
    """Blur as a rough road does: much up and down, little aside."""
    narrow, tall = (cv2.getGaussianKernel(size, -1) for size in (3, 15))
    return np.asarray(cv2.sepFilter2D(image, -1, narrow, tall, borderType=cv2.BORDER_REPLICATE), np.float32)


def falling_drops(cameras: tuple[Camera, Camera], rain_mm_h: float, rng: np.random.Generator) -> FloatArray:
    """Return (n, 3) where the nearer drops are, in the car frame, metres: evenly in the space both cameras see."""
    near, far = RAIN_LAYERS_M[0], RAIN_LAYERS_M[-1]
    reach = np.zeros(2)
    for camera in cameras:
        width, height = camera.size_px
        corners = unproject(camera, [[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]])
        reach = np.maximum(reach, np.nan_to_num(np.abs(corners[:, :2] / corners[:, 2:]), nan=2.0).max(0))
    reach = np.minimum(reach, 3.0) + WIDER_M / near
    volume = 4 * reach[0] * reach[1] * (far**3 - near**3) / 3
    count = rng.poisson(DROPS_PER_M3 * rain_mm_h * volume)
    z = np.cbrt(rng.uniform(near**3, far**3, count))
    aside = rng.uniform(-1, 1, (count, 2)) * reach * z[:, None]
    seen = (np.abs(aside) < (reach - WIDER_M / near) * z[:, None] + WIDER_M).all(1)
    return np.asarray(np.column_stack([aside, z])[seen])


def rain(light: Light, sight: Sight, weather: Weather, drops: FloatArray, speed_mps: float) -> Light:
    """Return light with the streaks of falling drops: each hides what is behind it as long as it passes, and shines."""
    way = -FALL_MPS * sight.up - (0.0, 0.0, speed_mps)
    day = AIRLIGHT * np.array(weather.daylight, np.float32)
    for near, far in reversed(list(pairwise(RAIN_LAYERS_M))):
        layer = drops[(drops[:, 2] >= near) & (drops[:, 2] < far)]
        spread_px = 0.25 * DROP_M * sight.camera.fx_px / near + DEFOCUS_PX_M / near
        length_px = float(np.linalg.norm(way)) * SHUTTER_S * sight.camera.fx_px / near
        samples = min(STREAK_SAMPLES, math.ceil(length_px) + 1)
        times = (np.arange(samples) + 0.5) / samples * SHUTTER_S
        cover = np.minimum(blur(_ink(sight, layer[:, None] + times[:, None] * way), spread_px), 0.8)[..., None]
        lamps = head_light(layer, sight.up, False, weather.head_lamps).sum() / max(1, len(layer))
        shine = np.asarray(DROP_SHINE * day + lamps * LAMP_RGB["head"], np.float32)
        light = light + cover * (shine - light)
    return light


def _ink(sight: Sight, path: FloatArray) -> Weight:
    """Return how much of each pixel drops on their paths (n, samples, 3) hide: their area shared among the samples."""
    width, height = sight.camera.size_px
    uv = sight.pixels(path).reshape(-1, 2)
    z = transform(inverse(sight.T_car_camera), path)[..., 2].ravel()
    seen = (uv > 0).all(1) & (uv < (width - 1, height - 1)).all(1)
    uv, z = uv[seen], z[seen]
    before = z < sight.depth_m[np.rint(uv[:, 1]).astype(int), np.rint(uv[:, 0]).astype(int)]
    uv, z = uv[before], z[before]
    area = np.pi / 4 * (sight.camera.fx_px * DROP_M / z) ** 2 / path.shape[1]
    (u, v), (right, down) = np.floor(uv).astype(int).T, np.mod(uv, 1.0).T
    ink = np.zeros(width * height)
    for du, dv, share in (
        (0, 0, (1 - right) * (1 - down)),
        (1, 0, right * (1 - down)),
        (0, 1, (1 - right) * down),
        (1, 1, right * down),
    ):
        ink += np.bincount((v + dv) * width + u + du, area * share, width * height)
    return ink.reshape(height, width).astype(np.float32)


def hang_drops(light: Light, count: int, lens: np.random.Generator) -> Light:
    """Return light through a lens with hanging drops: each shows the view upside down, small, and out of focus."""
    height, width = light.shape[:2]
    small = cv2.resize(light, (max(1, width // 4), max(1, height // 4)), interpolation=cv2.INTER_AREA)
    soft = blur(np.asarray(small, np.float32), 2.0)
    result = light.copy()
    for _ in range(count):
        centre, radius = lens.uniform((0, 0), (width, height)), width * 0.011 * math.exp(lens.normal(0, 0.4))
        tall = lens.uniform(1.0, 1.3)
        low = np.maximum(np.floor(centre - 1.4 * radius * tall), 0).astype(int)
        high = np.minimum(np.ceil(centre + 1.4 * radius * tall) + 1, (width, height)).astype(int)
        x, y = np.meshgrid(np.arange(low[0], high[0]) - centre[0], np.arange(low[1], high[1]) - centre[1])
        r = np.hypot(x, y / tall) / radius
        view = (centre - 9.0 * np.stack([x, y], -1)).astype(np.float32) / 4
        seen = cv2.remap(soft, view[..., 0], view[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        cover = _smooth(1.3 - r, 0.0, 0.6)[..., None]
        shade = (1.05 - 0.45 * np.minimum(r, 1.0) ** 2).astype(np.float32)[..., None]
        window = result[low[1] : high[1], low[0] : high[0]]
        window += cover * (seen * shade - window)
    return result


def soil(light: Light, worst: float, lens: np.random.Generator) -> Light:
    """Return light through a lens with soft spots of dirt, which keep back up to `worst` of it and scatter a little."""
    height, width = light.shape[:2]
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    thick = np.zeros((height, width))
    for _ in range(SPOTS):
        (u, v), radius = lens.uniform((0, 0), (width, height)), width * 0.03 * math.exp(lens.normal(0, 0.6))
        turn, flat, weight = lens.uniform(0, np.pi), lens.uniform(0.5, 1.0), lens.uniform(0.35, 1.0)
        along = (x - u) * math.cos(turn) + (y - v) * math.sin(turn)
        across = ((y - v) * math.cos(turn) - (x - u) * math.sin(turn)) / flat
        thick = np.maximum(thick, weight * np.exp(-(((along**2 + across**2) / radius**2) ** 2)))
    cover = (worst * thick / thick.max()).astype(np.float32)[..., None]
    return np.asarray(light * (1 - cover) + DIRT * light.mean((0, 1)) * cover, np.float32)


def _smooth(x: FloatArray, low: float, high: float) -> Weight:
    """Return 0 below `low`, 1 above `high`, and a smooth step between."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return np.asarray(t * t * (3 - 2 * t), np.float32)
