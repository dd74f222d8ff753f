"""The cell matcher as a whole: a wall at a known disparity, what cannot be seen, and its buffers."""

import tracemalloc

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.stages.match.cells import CellMatcher, CellSettings, warm

SHAPE = (61, 203)


def wall(half_px: float, shape: tuple[int, int] = SHAPE, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """A textured wall at a disparity in half-resolution pixels: smooth noise, so that it can lie between pixels."""
    rng = np.random.default_rng(seed)
    phases, waves = rng.uniform(0, 2 * np.pi, (60, 1, 1)), rng.normal(0, 0.6, (60, 2, 1, 1))
    v, u = np.mgrid[: shape[0], : shape[1]]

    def picture(shift: float) -> np.ndarray:
        grey = np.cos(waves[:, 0] * v + waves[:, 1] * (u + shift) + phases).sum(0)
        return np.clip(128 + 12 * grey, 0, 255).astype(np.uint8)

    return picture(0), picture(half_px)


@pytest.mark.parametrize("width_px", [4, 8])
@pytest.mark.parametrize("half_px", [3.0, 10.25, 28.5])
def test_a_wall_is_found_where_it_is(half_px: float, width_px: int) -> None:
    cells = CellMatcher(CellSettings(cell_width_px=width_px, disparities=64))(*wall(half_px))
    assert cells.d_px.shape == cells.margin.shape == cells.texture.shape == (30, 203 // (width_px // 2))
    assert (cells.cell_width_px, cells.cell_height_px) == (width_px, 4)
    inner = cells.d_px[2:-2, int(2 * half_px) // width_px + 4 : -2]
    assert np.isfinite(inner).mean() > 0.95  # so smooth a pattern repeats in places
    assert abs(np.nanmedian(inner) - 2 * half_px) < 0.25
    assert (np.abs(inner - 2 * half_px) > 1).mean() < 0.02


@pytest.mark.parametrize(("light", "noise", "known"), [(1.0, 9, True), (0.25, 9, False)])
def test_in_a_dark_noisy_image_what_is_far_is_unknown(light: float, noise: float, known: bool) -> None:
    rng = np.random.default_rng(8)
    pair = [np.clip(light * image + noise * rng.normal(size=SHAPE), 0, 255).astype(np.uint8) for image in wall(2.0)]
    d_px = CellMatcher(CellSettings(disparities=64, quiet=5, noise_margin=0))(*pair).d_px
    assert (np.isfinite(d_px[2:-2, 6:-2]).mean() > 0.5) == known
    assert known or np.isnan(d_px).all()


def test_what_the_right_image_does_not_show_is_unknown() -> None:
    d_px = CellMatcher(CellSettings(disparities=64))(*wall(24)).d_px
    assert not (d_px > 4 * np.arange(d_px.shape[1])).any()
    assert np.isnan(d_px[:, :10]).mean() > 0.8


def test_blank_images_give_nothing() -> None:
    blank = np.full(SHAPE, 255, np.uint8)
    cells = CellMatcher(CellSettings())(blank, blank)
    assert np.isnan(cells.d_px).all()
    assert not cells.texture.any()


def test_a_fence_has_less_margin_than_a_wall() -> None:
    """Paths keep to one of the fence's disparities, so its margin is not 0; but no more than the prices of a jump."""
    fence = np.tile(np.array([30, 30, 30, 200, 200, 200], np.uint8), (SHAPE[0], 40))[:, : SHAPE[1]].copy()
    settings = CellSettings(disparities=64)
    inner = (slice(2, -2), slice(20, -2))
    of_fence, of_wall = (np.median(CellMatcher(settings)(*pair).margin[inner]) for pair in ((fence, fence), wall(10)))
    assert of_fence <= 2 * settings.p2
    assert of_wall > 1.5 * of_fence


def test_the_pickets_of_a_fence_are_unknown() -> None:
    """Between two walls of one disparity, which its own pattern contradicts nowhere: the paths would fill it in."""
    left, right = wall(10)
    fence = np.tile(np.array([30, 30, 30, 200, 200, 200], np.uint8), (40, 20))[:, :90]
    left[10:50, 60:150], right[10:50, 60:150] = fence, fence
    d_px = CellMatcher(CellSettings(disparities=64))(left, right).d_px
    assert np.isnan(d_px[7:23, 38:68]).mean() > 0.95
    assert np.isfinite(d_px[7:23, 82:]).mean() > 0.9


@pytest.mark.parametrize("level", [0, 90, 255])
def test_what_is_blank_is_unknown_however_cheap_it_is_to_fill_in(level: int) -> None:
    """A tile on one lens, or burnt-out sky, with the noise that a camera adds; 0 and 255 have none."""
    left, right = wall(10)
    noise = np.random.default_rng(4).normal(0, 0.0 if level in (0, 255) else 0.5, (2, 40, 90))
    for image, grain in zip((left, right), noise, strict=True):
        image[10:50, 60:150] = np.rint(level + grain)
    settings = CellSettings(disparities=64, margin=0)
    blank = CellMatcher(settings)(left, right).d_px[9:21, 36:70]
    assert np.isnan(blank).mean() > 0.99
    filled_in = CellMatcher(settings.model_copy(update={"texture": 0}))(left, right).d_px[9:21, 36:70]
    assert np.isfinite(filled_in).any()


def test_a_noisy_image_needs_more_margin() -> None:
    rng, (left, right) = np.random.default_rng(5), wall(10)
    grain = rng.normal(0, 3, (2, *left.shape))
    noisy = np.clip(np.rint(np.stack([left, right]) / 8.0 + grain), 0, 255).astype(np.uint8)
    settings = [CellSettings(disparities=64, noise_margin=extra) for extra in (0, 8, 40)]
    known = [np.isfinite(CellMatcher(s)(*noisy).d_px).mean() for s in settings]
    assert known[0] > known[1] > known[2]


def test_weak_and_small_things_can_be_dropped() -> None:
    pair = wall(10)
    assert np.isnan(CellMatcher(CellSettings(margin=255))(*pair).d_px).all()
    assert np.isnan(CellMatcher(CellSettings(speckle_px2=10**6))(*pair).d_px).all()


def test_buffers_are_kept_and_inputs_are_not_changed() -> None:
    matcher, pair = CellMatcher(CellSettings()), wall(5)
    before = [image.copy() for image in pair]
    first = matcher(*pair)
    expected = first.d_px.copy()
    tracemalloc.start()
    second = matcher(*pair)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert second.d_px is first.d_px
    assert peak < 20_000
    np.testing.assert_array_equal(second.d_px, expected)
    for image, kept in zip(pair, before, strict=True):
        np.testing.assert_array_equal(image, kept)
    assert matcher(*wall(5, (20, 90))).d_px.shape == (10, 45)
    np.testing.assert_array_equal(matcher(*pair).d_px, expected)


@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (1, 60), (2, 60), (60, 2)])
def test_tiny_images_are_cells_without_disparity(shape: tuple[int, int]) -> None:
    tiny = np.zeros(shape, np.uint8)
    d_px = CellMatcher(CellSettings())(tiny, tiny).d_px
    assert d_px.shape == (shape[0] // 2, shape[1] // 2)
    assert np.isnan(d_px).all()


@pytest.mark.parametrize(
    "right",
    [
        np.zeros((4, 9), np.uint8),
        np.zeros((4, 8), np.uint16),
        np.zeros((4, 8, 3), np.uint8),
        np.zeros((8, 4), np.uint8).T,
    ],
)
def test_other_images_are_refused(right: np.ndarray) -> None:
    with pytest.raises(ValueRefusedError, match="8-bit grey images of one shape"):
        CellMatcher(CellSettings())(np.zeros((4, 8), np.uint8), right)


def test_warming_compiles_without_images() -> None:
    warm(CellSettings(disparities=64))
