"""Greys, and what `match` adds to OpenCV; that every matcher finds a shift is in tests/contracts/test_matchers.py."""

import numpy as np
import pytest
from pydantic import ValidationError

from roadblock.kernels.gray import gray8
from roadblock.stages.match import MatchSettings, match, match_bm
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair

RNG = np.random.default_rng(3)


def test_eight_bit_grey_passes_as_it_is() -> None:
    left, right = (RNG.integers(0, 256, (9, 14), np.uint8) for _ in range(2))
    grays = gray8(left, right)
    np.testing.assert_array_equal(grays[0], left)
    np.testing.assert_array_equal(grays[1], right)


def test_colours_are_weighed_as_rgb() -> None:
    red, green, blue = (np.full((4, 5, 3), c, np.uint8) for c in ((200, 0, 0), (0, 200, 0), (0, 0, 200)))
    assert gray8(red, red)[0][0, 0] == pytest.approx(0.299 * 200, abs=1)
    assert gray8(green, green)[0][0, 0] == pytest.approx(0.587 * 200, abs=1)
    assert gray8(blue, blue)[0][0, 0] == pytest.approx(0.114 * 200, abs=1)


@pytest.mark.parametrize("channels", [(), (3,)])
def test_sixteen_bits_are_stretched_with_one_scale_for_both(channels: tuple[int, ...]) -> None:
    ramp = np.linspace(1000, 5000, 5000).astype(np.uint16).reshape(50, 100)
    if channels:
        ramp = np.repeat(ramp[..., None], 3, axis=2)
    left, right = gray8(ramp, (ramp + 500).astype(np.uint16))
    assert left.dtype == right.dtype == np.uint8
    assert left.min() == 0
    assert left.max() == 255
    inside = (left > 5) & (left < 200)
    # 0.1 % at either end are left out, so 255 levels are 3992 values wide.
    np.testing.assert_allclose(right[inside].astype(float) - left[inside], 500 * 255 / 3992, atol=1)


def test_sixteen_bits_without_contrast_are_even() -> None:
    flat = np.full((6, 7), 40_000, np.uint16)
    left, right = gray8(flat, flat)
    assert (left == left[0, 0]).all()
    assert (right == left).all()


def test_a_window_that_does_not_fit_matches_nothing() -> None:
    strip = RNG.integers(0, 256, (4, 90), np.uint8)
    assert (match_bm(strip, strip, MatchSettings(disparities=16)) < 0).all()
    block = RNG.integers(0, 256, (20, 90), np.uint8)
    assert (match_bm(block, block, MatchSettings(disparities=16, block_px=21)) < 0).all()


def test_the_noise_is_the_settings_own_and_inputs_are_untouched() -> None:
    image = RNG.integers(0, 256, (20, 40), np.uint8)
    before = image.copy()
    pair = RectifiedPair(image, image, Rectification(30.0, 20.0, 10.0, 0.2, (40, 20)))
    disparity = match(pair, MatchSettings(disparities=16, sigma_px=0.37))
    assert disparity.sigma_px == 0.37
    assert disparity.cell_px == 1
    assert disparity.d_px.shape == (20, 40)
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"block_px": 4}, "must be odd"),
        ({"matcher": "onnx", "both_ways": True}, "both_ways is for sgbm, bm and region"),
        ({"block_px": 23}, "less than or equal to 21"),
        ({"disparities": 100}, "multiple of 16"),
        ({"matcher": "none"}, "'bm' or 'onnx'"),
        ({"mode": "best"}, "'hh4'"),
        ({"sigma_px": float("nan")}, "finite"),
        ({"sigma_px": 0}, "greater than 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        MatchSettings.model_validate(bad)


@pytest.mark.parametrize("covered", ["left", "right"])
def test_a_covered_lens_matches_next_to_nothing(covered):
    rng = np.random.default_rng(4)
    seen, blank = rng.integers(0, 255, (120, 400), np.uint8), np.full((120, 400), 90, np.uint8)
    left, right = (blank, seen) if covered == "left" else (seen, blank)
    pair = RectifiedPair(left, right, Rectification(300.0, 199.5, 59.5, 0.2, (400, 120)))
    assert np.isfinite(match(pair, MatchSettings(disparities=64)).d_px).mean() < 0.02
