"""Where the world meets the weather and the cameras: a scene in; the pair as recorded, and its truth, out."""

from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np

from roadblock.geometry.pose import inverse, transform
from roadblock.sim import raycast
from roadblock.sim.conditions import Effects
from roadblock.sim.render import Rendered, Sighted, render_linear
from roadblock.sim.road import ground_of
from roadblock.sim.scene import Scene
from roadblock.sim.sensor import SIDES, Light, Side, expose, meter, row_delays, through_lens
from roadblock.sim.weather import SKY_M, Sight, Weather, falling_drops, hanging_lamps, ways, weathered
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, StereoPair

RAIN, LENS, NOISE = 1, 2, 3
"""Random streams of a drive: falling drops (one per frame, the same for both cameras), what is on a lens (one per
camera), noise (one per frame and camera)."""

CLEAR = Weather()

LAMP = "lamp"
"""Type of things whose last part is a street lamp's head."""

UNDER_HEAD_M = 0.1
"""So far under the head's middle it shines."""

ON_ROAD_M = 0.005
"""What lies on the road is so near to its surface."""


def photograph(
    scene: Scene,
    rig: StereoRig,
    effects: Effects,
    *,
    quality: str = "demo",
    seed: int = 0,
    index: int = 0,
    name: str = "0",
    t_ns: int = 0,
) -> Rendered:
    """Take one pair as a pair of real cameras would. The same arguments give the same bytes.

    The truth is that of the scene's moment: when the middle row of the left image is exposed.

    Parameters
    ----------
    scene, rig, quality
        As in `render_linear`.
    effects
        Cameras and weather.
    seed
        Of all that is random; what is on the lenses stays the same for every `index`.
    index, name, t_ns
        As in `StereoPair`.

    Raises
    ------
    ValueRefusedError
        If there is no such quality.
    """
    sensor, weather = effects.sensor, effects.weather
    height = rig.left.size_px[1]
    delays = row_delays(sensor, "left", height), row_delays(sensor, "right", height)
    still = not any(delay.any() for delay in delays)
    seen = render_linear(scene, rig, quality=quality, row_delays_s=None if still else delays)
    drops = falling_drops((rig.left, rig.right), weather.rain_mm_h, np.random.default_rng([seed, RAIN, index]))

    def entering(side: Side) -> Light:
        sighted = seen.left if side == "left" else seen.right
        if weather == CLEAR:
            return sighted.light
        lens = np.random.default_rng([seed, LENS, SIDES.index(side)])
        sight = _sight(scene, rig, side, sighted)
        return weathered(sight, weather, side=side, drops=drops, lens=lens, speed_mps=scene.speed_mps)

    with ThreadPoolExecutor(2) as pool:
        lights = dict(zip(SIDES, pool.map(entering, SIDES), strict=True))
        exposure = meter(lights["left"]) if sensor.exposure is None else sensor.exposure

        def image(side: Side) -> Image:
            camera = rig.left if side == "left" else rig.right
            noise = np.random.default_rng([seed, NOISE, index, SIDES.index(side)])
            return expose(through_lens(lights[side], camera, sensor), sensor, side, exposure, noise)

        left, right = pool.map(image, SIDES)
    pair = StereoPair(left, right, index, name, t_ns)
    return Rendered(pair, seen.left.depth_m, seen.left.ids, seen.disparity, seen.objects, seen.ground)


def _sight(scene: Scene, rig: StereoRig, side: Side, sighted: Sighted) -> Sight:
    """Return what the weather needs to know of one camera's view."""
    camera = rig.left if side == "left" else rig.right
    in_camera = ways(camera) * np.minimum(sighted.depth_m, SKY_M)[..., None]
    world = transform(scene.T_world_car @ sighted.T_car_camera, in_camera)
    height_m, left_m = np.empty(sighted.depth_m.shape), np.empty(sighted.depth_m.shape)
    survey(ground_of(scene.road), world, height_m, left_m)
    height_m[np.isinf(sighted.depth_m)] = np.inf
    between = (left_m > scene.road.right_m) & (left_m < scene.road.left_m)
    is_road = between & (np.abs(height_m) < ON_ROAD_M) & (sighted.ids == 0)
    return Sight(
        sighted.light,
        sighted.depth_m,
        camera,
        sighted.T_car_camera,
        scene.T_world_car,
        height_m,
        is_road,
        street_lamps(scene),
    )


def street_lamps(scene: Scene) -> FloatArray:
    """Return (n, 3) where street lamps shine, in the car frame: those of the scene, or some that hang over the road."""
    heads = [
        (thing.T_world_thing @ thing.parts[-1].T_thing_part)[:3, 3] for thing in scene.things if thing.type == LAMP
    ]
    if not heads:
        return hanging_lamps(scene.T_world_car)
    return transform(inverse(scene.T_world_car), np.array(heads) - (0.0, 0.0, UNDER_HEAD_M))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def survey(ground: raycast.Ground, world: FloatArray, height_m: FloatArray, left_m: FloatArray) -> None:
    """Fill in how high over the road, and how far to the left of its line, points of the world (..., 3) are."""
    for row in range(world.shape[0]):
        for column in range(world.shape[1]):
            x, y, z = world[row, column]
            height_m[row, column] = z - raycast.ground_height(ground, x, y)
            left_m[row, column] = raycast.on_road(ground, x, y)[1]
