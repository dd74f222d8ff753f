import math

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.sim.sensor import (
    LONGEST_EXPOSURE,
    METER_RANGE,
    MIDDLE_GREY,
    Sensor,
    blur,
    expose,
    luminance,
    meter,
    row_delays,
    through_lens,
    vignette,
)
from roadblock.values.camera import Camera

CAMERA = Camera((97, 61), 83.0, 79.0, 44.3, 33.6)
SIZE = (61, 97)


def flat(value: float, shape: tuple[int, ...] = (400, 500, 3)) -> np.ndarray:
    return np.full(shape, value, np.float32)


def scene(rng: np.random.Generator) -> np.ndarray:
    return rng.uniform(0.02, 0.9, (*SIZE, 3)).astype(np.float32)


def shot(light: np.ndarray, sensor: Sensor, side: str = "left", seed: int = 0, exposure: float = 1.0) -> np.ndarray:
    return expose(light, sensor, side, exposure, np.random.default_rng(seed))


def test_every_effect_is_off_by_default():
    light = scene(np.random.default_rng(1))
    assert through_lens(light, CAMERA, Sensor()) is light
    expected = np.rint(255 * light.astype(float) ** (1 / 2.2))
    for side in ("left", "right"):
        assert np.abs(shot(light, Sensor(), side).astype(float) - expected).max() <= 1  # rounding of float32 alone
        assert (shot(light, Sensor(), side, seed=1) == shot(light, Sensor(), side, seed=2)).all()
    assert not row_delays(Sensor(), "right", 61).any()


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("exposure", 0.0),
        ("exposure", math.nan),
        ("psf_px", -0.1),
        ("psf_px", 51.0),
        ("vignetting", -1.0),
        ("full_well_e", 0.5),
        ("full_well_e", math.nan),
        ("read_noise", -1.0),
        ("read_noise", "much"),
        ("gain", (1.0, 0.0)),
        ("gain", (1.0,)),
        ("gain", (math.nan, 1.0)),
        ("offset", (0.0, 300.0)),
        ("offset", None),
        ("gamma", 0.0),
        ("bits", 12),
        ("right_delay_s", 2.0),
        ("rolling_shutter_s", math.inf),
        ("rolling_shutter_s", True),
    ],
)
def test_what_no_camera_can_be_is_refused(name, value):
    with pytest.raises(ValueRefusedError, match=name):
        Sensor(**{name: value})


def test_metering_brings_the_geometric_mean_to_middle_grey():
    light = scene(np.random.default_rng(2))
    exposure = meter(light)
    assert np.exp(np.log(luminance(light) * exposure).mean()) == pytest.approx(MIDDLE_GREY, rel=1e-5)
    assert meter(luminance(light)) == pytest.approx(exposure)


def test_metering_has_limits():
    assert (meter(flat(1e-9)), meter(flat(100.0))) == METER_RANGE[::-1]


def test_luminance_keeps_white_and_likes_green_best():
    assert luminance(flat(0.5, (2, 3, 3))) == pytest.approx(0.5)
    red, green, blue = luminance(np.eye(3, dtype=np.float32)[None])[0]
    assert green > red > blue


@pytest.mark.parametrize("sigma_px", [0.3, 0.45, 1.0, 2.7])
def test_point_spread_has_its_width_keeps_its_place_and_its_energy(sigma_px):
    light = np.zeros((61, 97, 3), np.float32)
    light[29, 40] = (1.0, 0.5, 0.25)
    spread = blur(light, sigma_px).astype(float)
    total = spread.sum((0, 1))
    assert total == pytest.approx([1.0, 0.5, 0.25], rel=1e-6)
    v, u = np.mgrid[:61, :97]
    centre = np.array([(u * spread[..., 0]).sum(), (v * spread[..., 0]).sum()]) / total[0]
    assert centre == pytest.approx([40, 29], abs=1e-6)
    variance = ((u - 40) ** 2 * spread[..., 0]).sum() / total[0]
    assert variance == pytest.approx(sigma_px**2, rel=1e-4)


def test_point_spread_shifts_nothing():
    """A blurred sine stays in phase to 1e-6 px."""
    period = 97 / 8
    u = np.arange(3 * 97)
    wave = np.tile(np.sin(2 * np.pi * u / period), (5, 1)).astype(np.float32)[..., None].repeat(3, 2)
    middle = blur(wave, 1.3)[2, 97:194, 0].astype(float)
    phase = np.angle((middle * np.exp(-2j * np.pi * u[97:194] / period)).sum() * 1j)
    assert abs(phase) * period / (2 * np.pi) < 1e-6


def test_point_spread_keeps_energy_at_the_borders():
    light = np.zeros((9, 11), np.float32)
    light[0, 0] = light[8, 4] = 1.0
    assert blur(light, 1.7).sum() == pytest.approx(2.0, rel=1e-6)


def test_vignetting_is_a_power_of_the_cosine():
    share = vignette(CAMERA, 4.0)
    u, v = 90, 5
    x, y = (u - CAMERA.cx_px) / CAMERA.fx_px, (v - CAMERA.cy_px) / CAMERA.fy_px
    assert share[v, u] == pytest.approx((1 + x * x + y * y) ** -2, rel=1e-6)
    assert share.max() == share[34, 44] == pytest.approx(1.0, abs=1e-4)
    light = flat(0.5, (*SIZE, 3))
    assert through_lens(light, CAMERA, Sensor(vignetting=4.0))[v, u] == pytest.approx(0.5 * share[v, u])


def test_a_lens_that_sees_nothing_in_the_corner_leaves_it_dark():
    lens = Camera((97, 61), 40.0, 40.0, 48.0, 30.0, "brown_conrady", [-0.5, 0, 0, 0, 0])
    share = vignette(lens, 2.0)
    assert share[0, 0] == 0
    assert share[30, 48] == pytest.approx(1.0)


def test_the_lens_spreads_what_it_lets_through():
    light = scene(np.random.default_rng(3))
    sensor = Sensor(vignetting=2.0, psf_px=0.8)
    expected = blur(light * vignette(CAMERA, 2.0)[..., None], 0.8)
    assert through_lens(light, CAMERA, sensor) == pytest.approx(expected)


@pytest.mark.parametrize("level", [0.05, 0.2, 0.6])
def test_noise_has_the_mean_and_variance_of_its_formula(level):
    well, read, gamma = 4000.0, 1.5, 2.2
    image = shot(flat(level), Sensor(full_well_e=well, read_noise=read, gamma=gamma, bits=16)) / 257
    slope = 255 / gamma * level ** (1 / gamma - 1)
    variance = slope**2 * level / well + read**2
    bend = slope * (1 / gamma - 1) / level / 2 * level / well  # half the second derivative times the variance
    n = image.size
    assert image.mean() == pytest.approx(255 * level ** (1 / gamma) + bend, abs=4 * math.sqrt(variance / n))
    assert image.var() == pytest.approx(variance, rel=4 * math.sqrt(2 / n) + 0.01)


def test_few_electrons_keep_their_mean():
    image = shot(flat(0.5), Sensor(full_well_e=8.0, gamma=1.0, bits=16)) / 65535
    # Whatever would be over the top is clipped, so the sensor is exposed far below it.
    dark = shot(flat(0.5), Sensor(full_well_e=80.0, gamma=1.0, bits=16), exposure=0.1) / 65535
    assert dark.mean() == pytest.approx(0.05, rel=0.01)
    assert dark.var() == pytest.approx((0.05 * 80 + 1 / 8) / 80**2, rel=0.03)
    assert image.std() > 0.1


def test_beyond_the_longest_exposure_only_gain_rises():
    faint = [
        shot(flat(0.3 / e), Sensor(full_well_e=2000.0, gamma=1.0, bits=16), exposure=e).std()
        for e in (1.0, LONGEST_EXPOSURE, 4 * LONGEST_EXPOSURE)
    ]
    assert faint[1] == pytest.approx(faint[0], rel=0.02)
    assert faint[2] == pytest.approx(2 * faint[0], rel=0.02)


def test_both_cameras_have_their_own_noise_and_the_same_seed_the_same_bytes():
    sensor = Sensor(full_well_e=5000.0, read_noise=1.0)
    light = flat(0.3, (100, 120, 3))
    left, right = (shot(light, sensor, "left", [7, i]).astype(float) for i in (0, 1))
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.02
    assert (shot(light, sensor, "left", [7, 0]) == left).all()


def test_gain_and_offset_belong_to_one_camera():
    light = scene(np.random.default_rng(4)) * np.float32(0.5)
    sensor = Sensor(gain=(1.0, 1.25), offset=(-2.0, 3.0), bits=16)
    left, right = (shot(light, sensor, side) / 257 for side in ("left", "right"))
    assert left == pytest.approx(np.maximum(255 * light ** (1 / 2.2) - 2, 0), abs=0.01)
    assert right == pytest.approx(255 * (1.25 * light) ** (1 / 2.2) + 3, abs=0.01)


def test_a_full_sensor_is_full_whatever_its_gain():
    assert (shot(flat(7.0, (3, 4, 3)), Sensor(gain=(1.0, 0.5), gamma=1.0), "right") == 128).all()
    assert (shot(flat(7.0, (3, 4, 3)), Sensor(offset=(9.0, 0.0))) == 255).all()


def test_depth_and_colour_of_the_image():
    light = scene(np.random.default_rng(5))
    assert (shot(light, Sensor()).dtype, shot(light, Sensor()).shape) == (np.uint8, (*SIZE, 3))
    deep = shot(light, Sensor(bits=16, color=False))
    assert (deep.dtype, deep.shape) == (np.uint16, SIZE)
    assert deep / 65535 == pytest.approx(luminance(light) ** (1 / 2.2), abs=1e-4)
    assert np.abs(shot(light, Sensor(bits=16)) / 257 - shot(light, Sensor())).max() <= 0.51


def test_rows_are_exposed_one_after_the_other_around_the_frames_moment():
    sensor = Sensor(rolling_shutter_s=0.02, right_delay_s=0.003)
    left, right = row_delays(sensor, "left", 61), row_delays(sensor, "right", 61)
    assert left[30] == 0
    assert (left[0], left[-1]) == pytest.approx((-0.01, 0.01))
    assert right - left == pytest.approx(np.full(61, 0.003))
    assert row_delays(sensor, "left", 1).tolist() == [0.0]
