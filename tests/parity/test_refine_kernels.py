"""The compiled refinement against its readable definition, on a small crooked picture."""

import numpy as np
import pytest

from roadblock.kernels.compiled import refine as refine_compiled
from roadblock.kernels.reference import refine as refine_reference
from roadblock.kernels.reference.refine import FIGURES, Model, interpolation

MODEL = Model(300.0, 60.0, 1.5, 0.97)


def picture(seed: int, height: int = 61, width: int = 97) -> tuple[np.ndarray, np.ndarray]:
    """A textured thing at 8.3 px before a wall at 3 px; noise, gain and offset between the images."""
    rng = np.random.default_rng(seed)
    v, u = np.mgrid[:height, :width].astype(float)
    waves = [(rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0, 6.3)) for _ in range(24)]

    def look(shift_px: float, sign: float) -> np.ndarray:
        return sum((5 * np.cos(sign * a * (u + shift_px) + b * v + c) for a, b, c in waves), np.full(u.shape, 120.0))

    thing = (u > 35) & (u < 75) & (v > 10)
    moved = (u > 35 - 8.3) & (u < 75 - 8.3) & (v > 10)
    left = np.where(thing, look(0, 1), look(0, -1))
    right = np.where(moved, look(8.3, 1), look(3, -1))
    levels = (left + rng.normal(0, 1.5, u.shape), 1.03 * right - 2 + rng.normal(0, 1.5, u.shape))
    return tuple(np.clip(np.rint(level), 0, 255).astype(np.uint8) for level in levels)  # type: ignore[return-value]


def cells(u0: int, v0: int, columns: int, rows: int, cell: tuple[int, int], d_px: float) -> np.ndarray:
    u = u0 + cell[0] * np.arange(columns) + (cell[0] - 1) / 2
    v = v0 + cell[1] * np.arange(rows) + (cell[1] - 1) / 2
    uvd = np.stack([*np.meshgrid(u, v), np.full((rows, columns), d_px)], -1)
    return uvd.reshape(-1, 3)


REGIONS = [
    cells(34, 8, 11, 13, (4, 4), 9.4),  # the thing, with background around it
    cells(40, 12, 3, 9, (8, 4), 7.1),  # some of it, coarse cells
    cells(0, 0, 5, 5, (4, 4), 3.2),  # at the border: nothing of it is in the right image's taps
    cells(93, 57, 1, 1, (4, 4), 3.2),  # a corner, too small
    cells(45, 20, 20, 30, (1, 1), 8.0)[::2],  # every second pixel
]


@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_kernel_measures_what_the_definition_does(seed: int) -> None:
    left, right = picture(seed)
    first = np.cumsum([0, *map(len, REGIONS)])
    arguments = (left, right, first, np.concatenate(REGIONS))
    expected = refine_reference.refine_regions(*arguments, MODEL)
    assert np.isfinite(expected[:2]).all()
    assert expected[0, 0] == pytest.approx(8.3, abs=0.3), "nothing was measured"
    found = refine_compiled.refine_regions(*arguments, MODEL)
    for column, name in enumerate(FIGURES):
        np.testing.assert_allclose(found[:, column], expected[:, column], rtol=2e-3, atol=2e-3, err_msg=name)


def test_a_large_region_leaves_out_rows_alike(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    left = rng.integers(90, 160, (140, 180)).astype(np.uint8)
    right = np.roll(left, -7, 1)
    arguments = (left, right, np.array([0, 120 * 130]), cells(40, 5, 120, 130, (1, 1), 7.4))
    expected = refine_reference.refine_regions(*arguments, MODEL)
    assert expected[0, 0] == pytest.approx(7.0, abs=0.01)
    np.testing.assert_allclose(refine_compiled.refine_regions(*arguments, MODEL), expected, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("shape", [(97, 130), (40, 61), (9, 9)])
def test_the_images_are_surveyed_alike(shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    left = np.clip(rng.normal(120, 3, shape) + 60 * np.sin(np.arange(shape[1]) / 9), 0, 255).astype(np.uint8)
    right = (left * 0.9).astype(np.uint8)
    assert refine_compiled.survey(left, right) == pytest.approx(refine_reference.survey(left, right))


def test_interpolation_is_exact_on_whole_pixels_and_close_between() -> None:
    weights = interpolation()
    np.testing.assert_allclose(weights.sum(1), 1, atol=1e-6)
    np.testing.assert_allclose(weights[0], np.eye(8)[3], atol=1e-6)
    np.testing.assert_allclose(weights[-1], np.eye(8)[4], atol=1e-6)
    places = np.arange(-3, 5)
    for phase in (32, 128, 200):
        made = weights[phase] @ np.cos(0.8 * places)
        assert made == pytest.approx(np.cos(0.8 * phase / 256), abs=0.004)
