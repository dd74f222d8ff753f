import math
from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import SettingsError, ValueRefusedError
from roadblock.geometry.pose import R_VEHICLE_CAR, inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import unproject
from roadblock.sim.conditions import CONDITIONS, DAY, Effects, combined
from roadblock.sim.sensor import Sensor
from roadblock.sim.weather import (
    AIRLIGHT,
    DROP_M,
    FALL_MPS,
    LAMP_RGB,
    SHUTTER_S,
    SKY_M,
    WATER,
    WET_ALBEDO,
    Sight,
    Weather,
    air,
    extinction_per_m,
    falling_drops,
    hang_drops,
    hanging_lamps,
    head_light,
    puddles,
    rain,
    soil,
    street_light,
    ways,
    weathered,
)
from roadblock.values.camera import Camera

CAMERA = Camera((97, 61), 83.0, 79.0, 44.3, 27.6)
HEIGHT_M = 1.3
UP = np.array([0.0, -1.0, 0.0])
NONE = np.zeros((0, 3))


def rng(*seed: int) -> np.random.Generator:
    return np.random.default_rng([1, *seed])


def street(camera: Camera = CAMERA, wall_m: float = 8.0, right_m: float = 0.1) -> Sight:
    """A flat grey road, and a wall with a texture across it, under the sky; the cameras look 1 deg down."""
    T_world_car = pose(R_VEHICLE_CAR, [3.0, 0.5, HEIGHT_M]) @ pose(rotation_from_rotvec([-0.02, 0, 0]), np.zeros(3))
    T_car_camera = pose(np.eye(3), [right_m, 0, 0])
    way = ways(camera) @ (T_world_car @ T_car_camera)[:3, :3].T
    eye = (T_world_car @ T_car_camera)[:3, 3]
    with np.errstate(all="ignore"):
        to_road = np.where(way[..., 2] < 0, -eye[2] / way[..., 2], np.inf)
        to_wall = (eye[0] + wall_m - eye[0]) / way[..., 0]
    wall = (to_wall < to_road) & (eye[2] + to_wall * way[..., 2] < 2.0)
    depth = np.where(wall, to_wall, to_road)
    world = eye + np.minimum(depth, SKY_M)[..., None] * way
    light = np.full((*depth.shape, 3), 0.2, np.float32)
    light[wall] = 0.5 + 0.3 * np.sin(4 * world[wall][:, 1:2] + 7 * world[wall][:, 2:3])
    light[np.isinf(depth)] = 0.9
    height = np.where(np.isinf(depth), np.inf, world[..., 2])
    road = np.isfinite(depth) & ~wall
    return Sight(light, depth, camera, T_car_camera, T_world_car, height, road)


def through(weather: Weather, sight: Sight | None = None, **more) -> np.ndarray:
    arguments = {"side": "left", "drops": NONE, "lens": rng()} | more
    return weathered(sight or street(), weather, **arguments)


def test_a_clear_day_changes_nothing():
    assert (through(Weather()) == street().light).all()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("daylight", (1.0, 1.0)),
        ("daylight", (1.0, 1.0, 1.1)),
        ("head_lamps", -1.0),
        ("street_lamps", math.inf),
        ("visibility_m", 0.0),
        ("visibility_m", math.nan),
        ("rain_mm_h", 301.0),
        ("wetness", 1.1),
        ("lens_drops", -1),
        ("lens_drops", 2.5),
        ("dirt", "much"),
        ("dirty_side", "top"),
    ],
)
def test_no_such_weather(name, value):
    with pytest.raises(ValueRefusedError, match=name):
        Weather(**{name: value})


def test_fog_is_koschmieders_law_along_the_ray():
    sight, weather = street(), Weather(visibility_m=25.0)
    light = through(weather)
    for v, u in ((50, 20), (33, 60), (5, 90)):
        distance = sight.depth_m[v, u] / unproject(CAMERA, [u, v])[2]
        left = 0.05 ** (distance / 25.0)
        assert light[v, u] == pytest.approx(sight.light[v, u] * left + AIRLIGHT * (1 - left), rel=1e-5)
    assert extinction_per_m(weather) * 25 == pytest.approx(-math.log(0.05))


def test_rain_veils_by_carbonneaus_law():
    assert extinction_per_m(Weather(rain_mm_h=20.0)) * 1000 * 10 / math.log(10) == pytest.approx(1.076 * 20**0.67)


def test_fog_leaves_what_the_lens_does_not_see_dark():
    sight = street()
    depth, light = sight.depth_m.copy(), sight.light.copy()
    depth[0, 0], light[0, 0] = np.nan, 0.0
    fogged = through(Weather(visibility_m=10.0), replace(sight, depth_m=depth, light=light))
    assert (fogged[0, 0] == 0).all()
    assert np.isfinite(fogged).all()


def test_daylight_dims_and_tints():
    assert through(Weather(daylight=(0.1, 0.2, 0.4))) == pytest.approx(street().light * (0.1, 0.2, 0.4))


def test_head_light_is_inverse_square_below_its_edge():
    near, far = (head_light(np.array([0.0, 0.75 + 0.02 * z, 1.6 + z]), UP, False, 1.0) for z in (10.0, 30.0))
    assert 0.7 < near < 1.0
    assert near / far == pytest.approx(9.0, rel=0.05)


def test_head_light_is_cut_off_and_shines_ahead_only():
    low, high = (head_light(np.array([0.0, y, 21.6]), UP, False, 1.0) for y in (1.3, -0.3))
    assert low > 5 * high > 0
    assert head_light(np.array([0.0, 1.0, -5.0]), UP, False, 1.0) == 0


def test_what_lies_on_the_road_gets_the_cosine_of_the_light():
    point = np.array([0.0, HEIGHT_M, 9.6])
    flat, upright = (head_light(point, UP, lying, 1.0) for lying in (True, False))
    assert flat / upright == pytest.approx((HEIGHT_M - 0.75) / math.hypot(8.0, HEIGHT_M - 0.75, 0.6), rel=1e-5)


def test_street_light_falls_with_the_square_of_the_distance_and_the_cosine():
    lamp = np.array([[0.0, HEIGHT_M - 6, 20.0]])
    under = street_light(np.array([0.0, HEIGHT_M, 20.0]), UP, True, lamp, 0.3)
    aside = street_light(np.array([8.0, HEIGHT_M, 20.0]), UP, True, lamp, 0.3)
    assert under == pytest.approx(0.3)
    assert aside / under == pytest.approx(36 / 100 * 0.6**2)
    assert street_light(np.array([0.0, HEIGHT_M - 7, 20.0]), UP, False, lamp, 0.3) == 0


def test_hanging_lamps_stand_still_while_the_car_drives():
    T = street().T_world_car
    later = pose(np.eye(3), [5.0, 0, 0]) @ T
    assert transform(later, hanging_lamps(later)) == pytest.approx(transform(T, hanging_lamps(T)))
    assert transform(T, hanging_lamps(T))[:, 2] == pytest.approx(6.0)


def test_lamps_light_the_night():
    dark = Weather(daylight=(1e-4, 1e-4, 1e-4))
    lit = through(replace(dark, head_lamps=2e-3)) / street().light
    added = head_light(street().points_m(), street().up, street().is_road, 2e-3)
    assert lit[..., 0] == pytest.approx(1e-4 + added * LAMP_RGB["head"][0], rel=1e-3)


def test_a_street_lamp_is_seen_with_its_glare_unless_something_hides_it():
    sight = street()
    spot = np.array([40, 4])
    at = transform(sight.T_car_camera, ways(CAMERA)[spot[1], spot[0]] * 20.0)
    night = Weather(daylight=(0.0, 0.0, 0.0), street_lamps=1e-3)
    light = through(night, replace(sight, lamps_m=at[None]))
    assert light[4, 40].min() > 10 * light[4, 44].max() > 0
    assert light[4, 44].min() > light[4, 50].max()
    hidden = replace(sight, lamps_m=at[None], depth_m=np.minimum(sight.depth_m, 15.0))
    assert through(night, hidden)[4, 40].max() < 1e-2 * light[4, 40].min()
    behind = through(night, replace(sight, lamps_m=at[None] * (1, 1, -1)))
    assert behind[4, 40].max() < 1e-2 * light[4, 40].min()


def test_lamps_off_are_not_seen():
    sight = replace(street(), lamps_m=np.array([[0.0, -4.0, 20.0]]))
    assert (through(Weather(), sight) == sight.light).all()


def test_a_wet_road_darkens_what_it_does_not_mirror():
    sight = replace(street(), light=np.where(street().is_road[..., None], np.float32(0.2), np.float32(0)))
    light = through(Weather(wetness=1.0), sight)
    world = transform(sight.T_world_car, sight.points_m())
    v, u = 60, 30
    normal = sight.points_m()[v, u] - sight.T_car_camera[:3, 3]
    cosine = -(normal @ sight.up) / np.linalg.norm(normal)
    r0 = ((WATER - 1) / (WATER + 1)) ** 2
    fresnel, film = r0 + (1 - r0) * (1 - cosine) ** 5, puddles(world)[v, u]
    assert light[v, u] == pytest.approx(0.2 * (1 - film * (1 - WET_ALBEDO)) * (1 - film * fresnel), rel=1e-4)
    assert (light[~sight.is_road] == 0).all()


def test_a_wet_road_mirrors_the_wall_at_its_place():
    """What a road pixel mirrors is what the ray bounced off the road sees: the wall's own formula there."""
    camera = Camera((301, 201), 250.0, 245.0, 148.3, 80.6)
    sight = street(camera, wall_m=6.0)
    sight = replace(sight, light=np.where(sight.is_road[..., None], np.float32(0), sight.light))
    light = through(Weather(wetness=1.0), sight)
    T = sight.T_world_car @ sight.T_car_camera
    eye, way = T[:3, 3], ways(camera) @ T[:3, :3].T
    errors = []
    for v, u in ((150, 120), (140, 180), (130, 150)):
        onto = eye + way[v, u] * sight.depth_m[v, u]
        up = way[v, u] * (1, 1, -1)
        seen = onto + up * ((eye[0] + 6.0 - onto[0]) / up[0])
        expected = 0.5 + 0.3 * np.sin(4 * seen[1] + 7 * seen[2])
        cosine = -way[v, u, 2] / np.linalg.norm(way[v, u])
        r0 = ((WATER - 1) / (WATER + 1)) ** 2
        share = puddles(onto) * (r0 + (1 - r0) * (1 - cosine) ** 5)
        errors.append(light[v, u, 0] / share - expected)
    assert np.abs(errors).max() < 0.06


def test_puddles_lie_still_and_differ():
    world = np.stack([*np.meshgrid(np.arange(30.0), np.arange(20.0)), np.zeros((20, 30))], -1)
    assert (puddles(world) == puddles(world)).all()
    assert puddles(world).min() == pytest.approx(0.3)
    assert puddles(world).max() == 1.0


def test_fog_hides_a_far_wet_road():
    weather = Weather(wetness=1.0, visibility_m=1.0)
    assert through(weather)[35] == pytest.approx(np.broadcast_to(AIRLIGHT, (97, 3)), rel=1e-2)


def test_drops_fill_the_view_evenly():
    drops = falling_drops((CAMERA, CAMERA), 30.0, rng())
    assert drops[:, 2].min() >= 0.35
    assert drops[:, 2].max() <= 4.0
    inner = (drops[:, 2] < 2.0).mean()
    z = np.linspace(0.35, 4.0, 4001)
    room = (52.7 / 83 * z + 0.25) * (33.4 / 79 * z + 0.25)  # (97, 61) less the principal point, and a margin
    assert inner == pytest.approx(room[z < 2].sum() / room.sum(), rel=0.05)
    assert len(drops) == pytest.approx(4 * room.mean() * 3.65 * 25 * 30, rel=0.05)
    assert len(falling_drops((CAMERA, CAMERA), 0.0, rng())) == 0
    assert abs(drops[:, :2].mean(0)).max() < 0.1


def test_a_wide_lens_is_rained_on_as_well():
    wide = Camera((97, 61), 30.0, 30.0, 48.0, 30.0, "kannala_brandt", [0.1, 0, 0, 0])
    assert np.isfinite(falling_drops((wide, CAMERA), 1.0, rng())).all()


def test_a_drop_draws_its_streak_where_both_cameras_see_it():
    """Its ink is its area; its middle is where it is in the middle of the exposure; it hides behind near things."""
    camera = Camera((301, 201), 250.0, 245.0, 148.3, 80.6)
    weather, drop, speed = Weather(rain_mm_h=1.0), np.array([[0.03, -0.1, 1.2]]), 8.0
    way = FALL_MPS * np.array([0.0, 1.0, 0.0]) - (0, 0, speed)
    middle = drop[0] + way * SHUTTER_S / 2
    columns = []
    for right_m in (-0.1, 0.1):
        sight = street(camera, right_m=right_m)
        sight = replace(sight, T_world_car=pose(R_VEHICLE_CAR, [0, 0, HEIGHT_M]), light=np.zeros_like(sight.light))
        ink = rain(sight.light, sight, weather, drop, speed)[..., 0]
        v, u = np.mgrid[:201, :301]
        columns.append((ink * u).sum() / ink.sum())
        u_mid, v_mid = sight.pixels(middle)
        assert columns[-1] == pytest.approx(u_mid, abs=0.3)
        assert (ink * v).sum() / ink.sum() == pytest.approx(v_mid, abs=0.3)
        area = math.pi / 4 * (camera.fx_px * DROP_M / middle[2]) ** 2
        assert ink.sum() / (1.5 * AIRLIGHT[0]) == pytest.approx(area, rel=0.02)
        near = replace(sight, depth_m=np.full_like(sight.depth_m, 1.0))
        assert not rain(sight.light, near, weather, drop, speed).any()
    assert columns[0] - columns[1] == pytest.approx(camera.fx_px * 0.2 / middle[2], abs=0.2)


def test_rain_goes_through_everything_together():
    weather = Weather(rain_mm_h=40.0, wetness=0.5, lens_drops=5, head_lamps=0.1)
    drops = falling_drops((CAMERA, CAMERA), 40.0, rng(3))
    light = through(weather, drops=drops, speed_mps=10.0)
    assert np.isfinite(light).all()
    assert (light >= 0).all()
    assert light.dtype == np.float32
    assert (light == through(weather, drops=drops, speed_mps=10.0)).all()


def test_hanging_drops_change_their_places_alone():
    light = street().light
    wet = hang_drops(light, 3, rng())
    changed = (wet != light).any(-1).mean()
    assert 0 < changed < 0.2
    assert (hang_drops(light, 3, rng()) == wet).all()
    assert (light == street().light).all()


def test_dirt_dims_up_to_its_worst_and_on_its_own_side():
    white = replace(street(), light=np.ones_like(street().light))
    weather = Weather(dirt=0.8, dirty_side="right")
    assert (through(weather, white) == 1).all()
    dirty = through(weather, white, side="right")
    kept = 1 - 0.8 * (1 - 0.28)
    assert dirty[..., 2].min() == pytest.approx(kept, rel=0.01)
    assert dirty.max() <= 1
    assert (soil(white.light, 0.8, rng()) == dirty).all()


def test_air_without_fog_is_nothing():
    left, added = air(street(), Weather())
    assert (left == 1).all()
    assert (added == 0).all()


def test_pixels_are_the_inverse_of_points():
    sight = street()
    v, u = np.mgrid[:61, :97]
    assert sight.pixels(sight.points_m()) == pytest.approx(np.stack([u, v], -1), abs=1e-6)
    assert transform(inverse(sight.T_car_camera), sight.points_m())[30, 40, 2] == pytest.approx(sight.depth_m[30, 40])


def test_conditions_are_combined():
    assert combined(()) == combined(("day",)) == DAY
    both = combined(("night", "rain", "night")).weather
    night, wet = CONDITIONS["night"].weather, CONDITIONS["rain"].weather
    assert both.daylight == pytest.approx(np.multiply(night.daylight, wet.daylight))
    assert (both.street_lamps, both.rain_mm_h, both.wetness) == (night.street_lamps, wet.rain_mm_h, wet.wetness)
    assert combined(("fog",)) == CONDITIONS["fog"]
    assert combined(("dirty",)).weather.dirty_side == "left"


def test_the_plain_effects_are_none():
    assert Effects() == Effects(Sensor(), Weather())


@pytest.mark.parametrize(("name", "hint"), [("nihgt", "did you mean night"), ("x", "choose one of these")])
def test_no_such_condition(name, hint):
    with pytest.raises(SettingsError, match=hint):
        combined(("day", name))
