"""The paper's region matching: sub-pixel shifts, what each cost stands, and what stays unknown."""

from time import process_time

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from roadblock.kernels.reference.region import COSTS
from roadblock.stages.match import MatchSettings, match
from roadblock.stages.match.region import drop_islands, match_region
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair

WIDTH, HEIGHT = 211, 67


def settings(**changes: object) -> MatchSettings:
    return MatchSettings.model_validate({"matcher": "region", "disparities": 32, "block_px": 9, **changes})


def wave(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A texture that can be sampled anywhere exactly: a sum of sinusoids of 7 px and more."""
    rng = np.random.default_rng(11)
    total = np.zeros(np.broadcast(u, v).shape)
    for _ in range(40):
        a, b = rng.uniform(-0.9, 0.9), rng.uniform(-0.7, 0.7)
        total += np.sin(a * u + b * v + rng.uniform(0, 6.3))
    return total * 8


def shifted(d_px: float, noise: float = 0.0, gain: float = 1.0, offset: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """What is at u on the left is at u - d on the right."""
    v, u = np.mgrid[:HEIGHT, :WIDTH].astype(float)
    rng = np.random.default_rng(12)
    images = (128 + wave(u, v), (128 + wave(u + d_px, v)) * gain + offset)
    return tuple(np.clip(np.rint(i + rng.normal(0, noise, i.shape)), 0, 255).astype(np.uint8) for i in images)  # type: ignore[return-value]


@pytest.mark.parametrize("cost", COSTS)
@pytest.mark.parametrize("d_px", [3.0, 7.25, 12.5, 20.8])
def test_a_sub_pixel_shift_is_found(cost: str, d_px: float) -> None:
    d = match_region(*shifted(d_px, noise=1), settings(cost=cost))
    inside = d[6:-6, 28:-6]
    assert np.isfinite(inside).mean() > 0.97
    error = inside[np.isfinite(inside)] - d_px
    # A parabola does not fit the tip of every cost: it pulls towards whole pixels by 0.1 px at most, sad most of all.
    assert abs(np.median(error)) < (0.12 if cost in ("sad", "census") else 0.06)
    assert np.sqrt((error**2).mean()) < 0.2


def test_zncc_and_census_do_not_mind_gain_and_offset_but_sad_and_ssd_do() -> None:
    images = shifted(9, gain=0.75, offset=8)
    right = {cost: (np.abs(match_region(*images, settings(cost=cost))[6:-6, 28:-6] - 9) < 0.3).mean() for cost in COSTS}
    assert right["zncc"] > 0.97
    assert right["census"] > 0.97
    assert right["sad"] < right["zncc"] - 0.05
    assert right["ssd"] < right["zncc"] - 0.05
    only_gain = match_region(*shifted(9, gain=0.75), settings(cost="ncc"))[6:-6, 28:-6]
    assert (np.abs(only_gain - 9) < 0.3).mean() > 0.97


def test_small_windows_are_widened_to_five() -> None:
    images = shifted(5, noise=1)
    np.testing.assert_array_equal(
        match_region(*images, settings(block_px=3)), match_region(*images, settings(block_px=5))
    )


def test_the_ends_of_the_search_are_no_minima() -> None:
    for d_px in (0, 15):
        d = match_region(*shifted(d_px), settings(disparities=16, speckle_px=0))
        assert np.isfinite(d[6:-6, 28:-6]).mean() < 0.02


def test_a_repeated_pattern_is_not_unique() -> None:
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    stripes = (128 + 90 * np.sin(2 * np.pi * u / 8) + 0 * v).astype(np.uint8)
    assert np.isnan(match_region(stripes, stripes, settings())).mean() > 0.95


def test_more_uniqueness_leaves_less() -> None:
    images = shifted(9, noise=12)
    known = [np.isfinite(match_region(*images, settings(uniqueness_percent=p))).mean() for p in (0, 20, 60)]
    assert known[0] > known[1] > known[2]


def test_islands_are_dropped_by_size() -> None:
    d = np.full((20, 30), np.nan, np.float32)
    d[2:6, 2:6] = 7.25
    d[10:15, 10:15] = 9.5
    d[10:15, 15:20] = 12
    kept = drop_islands(d, 20)
    assert np.isnan(kept[2:6, 2:6]).all()
    np.testing.assert_array_equal(kept[10:15, 10:20], d[10:15, 10:20])
    assert np.isnan(drop_islands(d, 30)).all(), "a step of 2.5 px parts the two halves"
    np.testing.assert_array_equal(drop_islands(d, 0), d)
    assert d[3, 3] == 7.25, "the given map was changed"


def test_inputs_stay_and_the_stated_noise_is_the_settings_own() -> None:
    left, right = shifted(9)
    before = left.copy(), right.copy()
    pair = RectifiedPair(left, right, Rectification(150.0, 100.3, 30.2, 0.2, (WIDTH, HEIGHT)))
    disparity = match(pair, settings(sigma_px=0.31))
    assert disparity.sigma_px == 0.31
    np.testing.assert_array_equal(left, before[0])
    np.testing.assert_array_equal(right, before[1])


def test_a_picture_takes_no_more_than_a_few_seconds() -> None:
    noise = np.random.default_rng(1).integers(0, 256, (720, 1300), np.uint8)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.2)
    left, right = wall[:, :1280], wall[:, 20:]
    match_region(left[:40], right[:40], settings())
    start = process_time()
    match_region(left, right, settings(disparities=128))
    assert process_time() - start < 5


def test_an_unknown_cost_is_refused() -> None:
    with pytest.raises(ValidationError, match="'census'"):
        settings(cost="rank")


def test_islands_are_dropped_by_the_setting() -> None:
    images = shifted(9)
    assert np.isfinite(match_region(*images, settings())).any()
    assert np.isnan(match_region(*images, settings(speckle_px=WIDTH * HEIGHT))).all()


@pytest.mark.parametrize("cost", ["ncc", "zncc"])
def test_rounding_decides_between_no_equals(cost: str) -> None:
    """A pattern repeated with other gains correlates fully with each of its copies, up to the last bits."""
    pattern = np.tile(np.random.default_rng(0).integers(1, 9, (31, 8)), (1, 20))
    left, right = (
        (pattern * np.repeat(gains * 4, 8)).astype(np.uint8) for gains in ([3, 5, 7, 9, 11], [7, 3, 11, 5, 9])
    )
    d = match_region(left, right, settings(cost=cost, block_px=5, uniqueness_percent=0, speckle_px=0))
    # Windows that hold parts of two copies are another matter.
    inside = d[2:-2].reshape(27, 20, 8)[:, 4:, 2:6]
    assert np.isnan(inside).all()
