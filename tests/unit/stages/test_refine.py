"""Refinement of regions whose shift is known by construction."""

from dataclasses import replace

import numpy as np
import pytest
from stage_examples import TWIN

from roadblock.config import load_settings
from roadblock.errors import ValueRefusedError
from roadblock.kernels.compiled.refine import survey
from roadblock.kernels.reference.refine import cell_size
from roadblock.stages.rectify import rectify
from roadblock.stages.refine import RefineSettings, refine
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair, StereoPair
from roadblock.values.scene import Refinement, Region

HEIGHT, WIDTH = TWIN.size_px[1], TWIN.size_px[0]


def waves(u: np.ndarray, v: np.ndarray, seed: int, down: float = 0.9) -> np.ndarray:
    """Return a sum of waves, at most so steep downwards: a band-limited texture, exact at any place."""
    drawn = np.random.default_rng(seed).uniform((-0.9, -down, 0), (0.9, down, 2 * np.pi), (40, 3))
    return 120 + sum((5 * np.cos(a * u + b * v + c) for a, b, c in drawn), np.zeros_like(u))


def texture(shift_px: float, seed: int = 0) -> np.ndarray:
    """Return a texture that moves to the left by `shift_px`."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    return waves(u + shift_px, v, seed)


def pair(d_px: float, gain: float = 1.0, offset: float = 0.0, noise: float = 1.0, seed: int = 0) -> RectifiedPair:
    rng = np.random.default_rng(seed + 1)
    left, right = texture(0.0, seed), gain * texture(d_px, seed) + offset
    images = [
        np.clip(np.rint(i + noise * rng.standard_normal(i.shape)), 0, 255).astype(np.uint8) for i in (left, right)
    ]
    return RectifiedPair(images[0], images[1], TWIN)


def region(d_px: float, sigma_px: float = 0.8, cell: int = 4) -> Region:
    """Return 10 x 8 cells about the middle of the image."""
    u, v = np.meshgrid(36 + cell * np.arange(10) + (cell - 1) / 2, 16 + cell * np.arange(8) + (cell - 1) / 2)
    uvd = np.stack([u.ravel(), v.ravel(), np.full(u.size, d_px)], -1)
    return Region((36, 16, 76, 48), np.zeros((0, 2), np.int32), uvd, sigma_px, np.full(3, np.nan))


@pytest.mark.parametrize("d_px", [4.0, 6.37, 9.81, 14.5])
@pytest.mark.parametrize("off_px", [-1.7, 0.3, 1.9])
def test_the_shift_is_found_whatever_the_start(d_px: float, off_px: float) -> None:
    (found,) = refine(pair(d_px, 1.03, 2.0), [region(d_px + off_px)], RefineSettings(level="fast"))
    assert found.refined is not None
    assert found.refined.mean_d_px == pytest.approx(d_px, abs=0.03)
    assert abs(found.refined.mean_d_px - d_px) < 4 * found.refined.sigma_mean_d_px
    assert found.refined.moved_px == pytest.approx(-off_px, abs=0.03)


def test_off_is_off_and_nothing_is_nothing() -> None:
    regions = (region(6.0),)
    assert refine(pair(6.0), regions, RefineSettings(level="off")) == regions
    assert refine(pair(6.0), (), RefineSettings(level="fast")) == ()
    assert load_settings(assignments=["refine.level=off"]).refine.level == "off"


def test_what_the_detector_said_stays() -> None:
    before = region(6.5)
    (after,) = refine(pair(6.0), [before], RefineSettings(level="fast"))
    np.testing.assert_array_equal(after.surface_uvd_px, before.surface_uvd_px)
    assert (after.box_px, after.sigma_d_px) == (before.box_px, before.sigma_d_px)
    assert before.refined is None


def test_colour_and_sixteen_bit_are_measured_as_grey() -> None:
    grey = pair(6.3)
    colour = RectifiedPair(*(np.repeat(i[..., None], 3, -1) for i in (grey.left, grey.right)), TWIN)
    deep = RectifiedPair(*(i.astype(np.uint16) * 257 for i in (grey.left, grey.right)), TWIN)
    results = [refine(p, [region(6.0)], RefineSettings(level="fast"))[0].refined for p in (grey, colour, deep)]
    assert all(found is not None for found in results)
    assert [found.mean_d_px for found in results if found] == pytest.approx([results[0].mean_d_px] * 3, abs=1e-3)  # type: ignore[union-attr]


def test_without_texture_the_detector_s_value_is_kept() -> None:
    rng = np.random.default_rng(3)
    flat = [np.clip(120 + rng.standard_normal((HEIGHT, WIDTH)).round(), 0, 255).astype(np.uint8) for _ in range(2)]
    (found,) = refine(RectifiedPair(*flat, TWIN), [region(6.0, 0.05)], RefineSettings(level="fast"))
    assert found.refined is None


def test_two_different_things_are_not_fitted() -> None:
    other = RectifiedPair(pair(6.0).left, pair(6.0, seed=5).right, TWIN)
    (found,) = refine(other, [region(6.0, 0.05)], RefineSettings(level="fast"))
    assert found.refined is None


def test_cells_are_as_wide_as_their_steps() -> None:
    assert cell_size(region(5.0, cell=3).surface_uvd_px) == (3, 3)
    assert cell_size(np.array([[3.5, 9.5, 1.0]])) == (1, 1)
    assert cell_size(np.array([[3.5, 9.5, 1.0], [11.5, 9.5, 1.0]])) == (8, 8)


def test_noise_is_measured_beside_texture() -> None:
    rng = np.random.default_rng(0)
    image = texture(0.0)
    image[:, :40] = 100
    noisy = np.clip(np.rint(image + 2.0 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)
    noise, gain = survey(noisy, (noisy // 2).astype(np.uint8))
    assert noise == pytest.approx(2.0, rel=0.3)
    assert gain == 1.4  # which is as far as it goes
    assert survey(*[np.zeros((40, 40), np.uint8)] * 2) == (1.0, 1.0)


@pytest.mark.parametrize("off_px", [-1.2, 0.8])
def test_what_has_no_texture_of_its_own_is_not_measured_by_what_is_around_it(off_px: float) -> None:
    """The only texture in the region is that of the background, at another disparity."""
    scene = pair(6.0)
    left, right = scene.left.copy(), scene.right.copy()
    noise = np.random.default_rng(4).normal(0, 1, (2, 32, 36))
    left[16:48, 38:74] = np.clip(np.rint(120 + noise[0]), 0, 255)
    right[16:48, 30:66] = np.clip(np.rint(120 + noise[1]), 0, 255)  # 8 px
    (found,) = refine(RectifiedPair(left, right, TWIN), [region(8.0 + off_px, 1.0)], RefineSettings(level="fast"))
    if found.refined is not None:
        assert abs(found.refined.mean_d_px - 8.0) < 3 * found.refined.sigma_mean_d_px


def test_a_refinement_without_a_sigma_is_refused() -> None:
    good = Refinement(5.0, 0.02, 5.1, 0.03, 0.4, 2.0, 0.9)
    with pytest.raises(ValueRefusedError, match="sigma_nearest_d_px"):
        replace(good, sigma_nearest_d_px=0.0)


def test_shape_follows_a_large_wavy_surface_more_finely() -> None:
    height, width, rng = 300, 420, np.random.default_rng(3)
    v, u = np.mgrid[:height, :width].astype(float)
    true_px = 12 + 1.5 * np.sin(2 * np.pi * v / 96)
    images = []
    for shift_px in (np.zeros_like(v), true_px):
        image = waves(u + shift_px, v, 4, down=0.3)
        images.append(np.clip(np.rint(image + rng.standard_normal(u.shape)), 0, 255).astype(np.uint8))
    wavy = RectifiedPair(*images, Rectification(300.0, 209.5, 149.5, 0.2, (width, height)))
    columns, rows = 60 + 4 * np.arange(75) + 1.5, 24 + 4 * np.arange(60) + 1.5
    surface = np.stack([*np.meshgrid(columns, rows), np.full((60, 75), 12.2)], -1).reshape(-1, 3)
    whole = Region((60, 24, 360, 264), np.zeros((0, 2), np.int32), surface, 0.8, np.full(3, np.nan))
    seen = true_px[24:264, 60:360]
    errors = {}
    for level in ("fast", "shape"):
        fit = refine(wavy, [whole], RefineSettings(level=level))[0].refined
        assert fit is not None
        errors[level] = abs(fit.nearest_d_px - np.percentile(seen, 90))
        assert abs(fit.mean_d_px - 1 / np.mean(1 / seen)) < 0.05
    assert errors["shape"] < 0.15
    assert errors["shape"] < errors["fast"] / 2


def seen_by_lenses(down_px: float, pixels: tuple[np.ndarray, np.ndarray], d_px: float, seed: int) -> np.ndarray:
    """Return what a camera sees of the texture whose raw pixels are rectified places `pixels`."""
    u, v = pixels
    return waves(u + d_px, v - down_px, seed)


@pytest.mark.parametrize("down_px", [0.0, 0.12, -0.15])
def test_shape_looks_at_raw_images_and_finds_rows_that_are_off(down_px: float) -> None:
    """Raw images a fifth larger than the rectified ones; the right camera sees all lower than the rig says."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    maps = (1.2 * u + 0.3, 1.2 * v + 0.4)
    bent = replace(TWIN, maps_left=maps, maps_right=maps)
    raw_v, raw_u = np.mgrid[: int(1.2 * HEIGHT) + 2, : int(1.2 * WIDTH) + 2].astype(float)
    pixels = ((raw_u - 0.3) / 1.2, (raw_v - 0.4) / 1.2)
    off_px, found_down_px = [], []
    for seed in range(6):
        noise = np.random.default_rng(seed + 50).standard_normal((2, *raw_u.shape))
        light = [seen_by_lenses(*about, seed) for about in ((0.0, pixels, 0.0), (down_px, pixels, 6.3))]
        raw = [np.clip(np.rint(i + n), 0, 255).astype(np.uint8) for i, n in zip(light, noise, strict=True)]
        seen = rectify(StereoPair(raw[0], raw[1]), bent, raw[0].shape[::-1])
        fit = refine(seen, [region(6.0)], RefineSettings(level="shape"))[0].refined
        assert fit is not None
        off_px.append(fit.mean_d_px - 6.3)
        found_down_px.append(fit.down_px)
    assert np.mean(found_down_px) == pytest.approx(down_px, abs=0.02)
    assert np.sqrt(np.mean(np.square(off_px))) < 0.015


def test_what_lies_at_the_border_is_looked_at_as_far_as_it_is_seen() -> None:
    """And where a map leads out of the raw image, nothing is."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    nowhere = (u - 1e4, v - 1e4)
    grey = pair(6.0)
    for maps, count in (((u, v), 1), (nowhere, 0)):
        bent = replace(TWIN, maps_left=maps, maps_right=maps)
        seen = rectify(StereoPair(grey.left, grey.right), bent, TWIN.size_px)
        corner = replace(region(6.0), surface_uvd_px=region(6.0).surface_uvd_px - [36, 16, 0])
        found = refine(seen, [corner], RefineSettings(level="shape"))
        assert len(found) == 1
        assert sum(each.refined is not None for each in found) <= count
