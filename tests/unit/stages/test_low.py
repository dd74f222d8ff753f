"""Low obstacles on a road whose texture is a formula: pictures exact to rounding, with a little noise."""

import numpy as np
import pytest
from pydantic import ValidationError

from roadblock.stages.low import MIRRORS, STRAYS, Hit, LowFinder, LowSettings, drop_covered, regions_of
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import GroundPlane, Region

TWIN = Rectification(f_px=610.0, cx_px=247.3, cy_px=61.6, baseline_m=0.31, size_px=(480, 230))
ROAD = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.3)
FB = TWIN.f_px * TWIN.baseline_m


def texture(rng: np.random.Generator, rows: int) -> tuple[np.ndarray, ...]:
    """Draw waves no shorter than 5 px for every row."""
    return rng.uniform(0.05, 1.2, (rows, 12)), rng.uniform(0, 2 * np.pi, (rows, 12)), rng.normal(0, 5, (rows, 12))


def at(waves: tuple[np.ndarray, ...], x: np.ndarray) -> np.ndarray:
    k, phase, size = (w[:, None, :] for w in waves)
    return 110 + (size * np.sin(k * x[..., None] + phase)).sum(-1)


def pair(
    *boxes: tuple[float, float, float], seed: int = 1, paint: bool = False, kerb: bool = False, texture_size: float = 1
) -> RectifiedPair:
    """Render boxes (range, x of the left side, size) that face the cameras; their textures are their own."""
    rng = np.random.default_rng(seed)
    width, height = TWIN.size_px
    v, u = np.mgrid[0.0:height, 0:width]
    d = np.maximum((v - TWIN.cy_px) / ROAD.height_m * TWIN.baseline_m, 0)
    waves = texture(rng, height)
    waves = (*waves[:2], texture_size * waves[2])
    images = [at(waves, u), at(waves, u + d)]
    if paint:
        for image, shift in zip(images, (0, d), strict=True):
            image[(v > 110) & (v < 140) & (np.abs(u + shift - 250) < 14)] += 60
    for range_m, x_m, size_m in boxes:
        own, d_box = texture(rng, height), FB / range_m
        scale = TWIN.f_px / range_m
        u0 = TWIN.cx_px + (x_m + TWIN.baseline_m / 2) * scale
        v1 = TWIN.cy_px + ROAD.height_m * scale
        for image, shift in zip(images, (0, d_box), strict=True):
            x = u + shift
            inside = (x >= u0) & (x < u0 + size_m * scale) & (v < v1) & (v >= v1 - size_m * scale)
            image[inside] = at(own, x)[inside]
    if kerb:
        # The road's right half, from 1 m on, lies 0.12 m higher.
        raised = np.maximum((v - TWIN.cy_px) / (ROAD.height_m - 0.12) * TWIN.baseline_m, 0)
        high = texture(rng, height)
        edge = TWIN.cx_px + (1.0 + TWIN.baseline_m / 2) * raised * TWIN.f_px / FB
        for image, shift in zip(images, (0, raised), strict=True):
            image[(u + shift >= edge) & (raised > 0)] = at(high, u + shift)[(u + shift >= edge) & (raised > 0)]
    noisy = [np.clip(i + rng.normal(0, 1.0, i.shape), 0, 255).round().astype(np.uint8) for i in images]
    return RectifiedPair(noisy[0], noisy[1], TWIN)


def test_boxes_are_found_where_they_stand() -> None:
    found, doubt = LowFinder()(pair((8.0, -0.6, 0.15), (14.0, 0.7, 0.2)), ROAD)
    assert doubt is None
    assert len(found) == 2
    for region, (range_m, x_m, size_m) in zip(
        sorted(found, key=lambda r: -r.box_px[3]), ((8.0, -0.6, 0.15), (14.0, 0.7, 0.2)), strict=True
    ):
        u0, _, u1, v1 = region.box_px
        scale = TWIN.f_px / range_m
        middle = TWIN.cx_px + (x_m + size_m / 2 + TWIN.baseline_m / 2) * scale
        assert abs((u0 + u1) / 2 - middle) < 4
        assert abs(v1 - (TWIN.cy_px + ROAD.height_m * scale)) < 4
        assert np.median(region.surface_uvd_px[:, 2]) == pytest.approx(FB / range_m, abs=1.0)
        assert np.isnan(region.color_rgb).all()


@pytest.mark.parametrize("plane", [ROAD, GroundPlane(np.array([0.0, -1.0, 0.0]), 1.32)])
@pytest.mark.parametrize("kind", ["bare", "paint", "kerb", "smooth"])
def test_a_road_is_no_obstacle(kind: str, plane: GroundPlane) -> None:
    shot = pair(paint=kind == "paint", kerb=kind == "kerb", texture_size=0.0 if kind == "smooth" else 1.0)
    assert LowFinder()(shot, plane) == ((), None)


def test_a_wrong_plane_is_put_right_by_the_road() -> None:
    tilt = np.radians(0.15)
    plane = GroundPlane(np.array([0.0, -np.cos(tilt), np.sin(tilt)]), 1.27)
    assert len(LowFinder()(pair((9.0, 0.2, 0.2)), plane)[0]) == 1


def test_without_a_road_nothing_is_said() -> None:
    assert LowFinder()(pair((8.0, -0.6, 0.15)), None) == ((), None)


def test_a_road_out_of_sight_says_nothing() -> None:
    assert LowFinder(LowSettings(reach_m=(0.5, 0.9)))(pair(), ROAD) == ((), None)


def hit_at(range_m: float, x_m: float, is_sure: bool, bands: list) -> Hit:
    """Return a hit of the finest band that has this range."""
    number = len(bands) - 1
    foot = int(np.abs(bands[number].z_m - range_m).argmin())
    assert bands[number].z_m[foot] == pytest.approx(range_m, rel=0.05)
    return Hit(number, foot, round(TWIN.cx_px + x_m * TWIN.f_px / range_m), 4, 4, 9.0, is_sure)


def test_a_thing_is_told_from_what_goes_on_and_from_images_in_a_wet_road() -> None:
    bands = LowFinder().bands(TWIN, ROAD)
    grey = pair().left
    far_m = 29.0

    def told(*hits: Hit) -> tuple[int, str | None]:
        regions, doubt = regions_of(bands, list(hits), grey, TWIN, far_m)
        return len(regions), doubt

    thing = hit_at(21.0, 2.2, True, bands)
    assert told(thing) == (1, None)
    assert told(hit_at(30.0, 2.2, True, bands)) == (0, None)
    kerb = [hit_at(z, -1.2 + 0.1 * (z - 20), z < 22, bands) for z in (20.0, 22.5, 25.0, 27.0, 28.5)]
    assert told(*kerb) == (0, None)
    assert told(thing, *kerb) == (1, None)
    assert told(*kerb[:4]) == (1, None)
    crooked = [hit_at(z, x, z < 22, bands) for z, x in ((20.0, -1.2), (22.5, 0.2), (25.0, -1.2), (27.0, 0.6))]
    assert told(*crooked, hit_at(28.5, -1.0, False, bands)) == (1, None)
    strays = [hit_at(20.0 + 1.5 * k, 1.9 * (-1) ** k, False, bands) for k in range(STRAYS)]
    assert told(*strays) == (0, MIRRORS)
    assert told(thing, *strays[:-1])[1] is None


def test_colour_and_sixteen_bits_are_taken() -> None:
    grey = pair((8.0, -0.6, 0.2))
    colored = [np.repeat(i[..., None], 3, 2) for i in (grey.left, grey.right)]
    deep = [i.astype(np.uint16) * 257 for i in (grey.left, grey.right)]
    finder = LowFinder()
    (one,), (two,), (three,) = (
        finder(shot, ROAD)[0] for shot in (grey, RectifiedPair(*colored, TWIN), RectifiedPair(*deep, TWIN))
    )
    assert one.box_px == two.box_px == three.box_px
    assert 80 < two.color_rgb.mean() < 140


def test_scratch_is_kept() -> None:
    finder = LowFinder()
    finder(pair(), ROAD)
    kept = dict(finder.scratch)
    finder(pair(seed=2), ROAD)
    assert kept
    assert all(finder.scratch[c] is image for c, image in kept.items())


def region(box: tuple[int, int, int, int], d: float) -> Region:
    u0, v0, u1, v1 = box
    contour = np.array([[u0, v0], [u1, v0], [u1, v1]], np.int32)
    return Region(box, contour, np.array([[u0, v0, d]], float), 0.2, np.full(3, np.nan))


def test_what_an_ordinary_region_explains_is_dropped() -> None:
    car = region((100, 50, 160, 100), 20.0)
    inside, hidden, free = (
        region((120, 80, 130, 100), 19.0),
        region((90, 80, 100, 95), 8.0),
        region((30, 80, 40, 95), 8.0),
    )
    assert drop_covered((inside, hidden, free), (car,)) == (free,)
    assert drop_covered((inside,), ()) == (inside,)


def test_settings_refuse_what_makes_no_sense() -> None:
    with pytest.raises(ValidationError, match="evidence"):
        LowSettings(evidence=0)
