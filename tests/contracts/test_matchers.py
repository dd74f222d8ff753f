"""What every entry of MATCHERS must do, through `match`."""

from typing import get_args

import cv2
import numpy as np
import pytest

from roadblock.stages.match import MATCHERS, MatchSettings, match
from roadblock.values.camera import Rectification
from roadblock.values.frame import DisparityMap, RectifiedPair

SIZE = (223, 71)
DISPARITIES = 48


@pytest.fixture(params=sorted(MATCHERS))
def settings(request: pytest.FixtureRequest) -> MatchSettings:
    return MatchSettings(matcher=request.param, disparities=DISPARITIES, block_px=7)


def texture(width: int, height: int, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.2)
    return np.clip(128 + smooth * (55 / smooth.std()), 0, 255).astype(np.uint8)


def pair(left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    height, width = left.shape[:2]
    return RectifiedPair(left, right, Rectification(150.0, 80.3, 40.2, 0.2, (width, height)))


def shifted(d_px: int, size: tuple[int, int] = SIZE, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A wall: what is in column u on the left is in column u - d on the right."""
    wall = texture(size[0] + d_px, size[1], seed)
    return wall[:, : size[0]].copy(), wall[:, d_px:].copy()


def check(disparity: DisparityMap, width: int) -> None:
    d = disparity.d_px
    known = d[np.isfinite(d)]
    assert not np.isinf(d).any()
    assert (known > 0).all()
    assert (known < DISPARITIES).all()
    columns = np.broadcast_to(np.arange(width), d.shape)[np.isfinite(d)]
    assert (known <= columns).all(), "points into the right image only where it has columns"


def test_the_table_holds_what_the_settings_offer() -> None:
    assert {*MATCHERS, "onnx"} == set(get_args(MatchSettings.model_fields["matcher"].annotation))


@pytest.mark.parametrize("d_px", [2, 9, 31])
def test_a_shifted_wall_has_its_shift_as_disparity(settings: MatchSettings, d_px: int) -> None:
    disparity = match(pair(*shifted(d_px)), settings)
    check(disparity, SIZE[0])
    inside = disparity.d_px[8:-8, d_px + 8 : -8]
    right = np.abs(inside - d_px) < 0.26
    assert right.mean() > 0.9
    assert (np.isfinite(inside) & ~right).mean() < 0.01


def test_far_things_are_found_in_the_left_strip(settings: MatchSettings) -> None:
    disparity = match(pair(*shifted(5)), settings)
    strip = disparity.d_px[8:-8, 14:DISPARITIES]
    assert (np.abs(strip - 5) < 0.26).mean() > 0.85


def test_what_only_the_left_camera_sees_is_unknown(settings: MatchSettings) -> None:
    disparity = match(pair(*shifted(20)), settings)
    check(disparity, SIZE[0])
    assert np.isnan(disparity.d_px[:, :8]).all()
    assert np.isfinite(disparity.d_px[:, :17]).mean() < 0.2


def test_a_step_has_two_disparities(settings: MatchSettings) -> None:
    far, near = texture(260, 71, 1), texture(80, 71, 2)
    left, right = far[:, :223].copy(), far[:, 4:227].copy()
    left[:, 100:180], right[:, 78:158] = near, near
    d = match(pair(left, right), settings).d_px
    assert np.nanmedian(d[10:-10, 120:170]) == pytest.approx(22, abs=0.26)
    assert np.nanmedian(d[10:-10, 20:70]) == pytest.approx(4, abs=0.26)
    assert np.nanmedian(d[10:-10, 195:215]) == pytest.approx(4, abs=0.26)


def test_nothing_is_matched_where_there_is_nothing_to_match(settings: MatchSettings) -> None:
    flat = np.full(SIZE[::-1], 127, np.uint8)
    assert np.isnan(match(pair(flat, flat), settings).d_px).mean() > 0.99


def test_unrelated_images_match_hardly_anywhere(settings: MatchSettings) -> None:
    disparity = match(pair(texture(*SIZE, 1), texture(*SIZE, 2)), settings)
    check(disparity, SIZE[0])
    assert np.isfinite(disparity.d_px).mean() < 0.35


def test_colour_and_sixteen_bits_give_what_grey_gives(settings: MatchSettings) -> None:
    left, right = shifted(9)
    grey = match(pair(left, right), settings).d_px
    rgb = match(pair(*(np.repeat(i[..., None], 3, 2) for i in (left, right))), settings).d_px
    np.testing.assert_array_equal(rgb, grey)
    deep = match(pair(*(i.astype(np.uint16) * 90 + 3000 for i in (left, right))), settings).d_px
    both = np.isfinite(deep) & np.isfinite(grey)
    assert both.mean() > 0.8
    assert np.abs(deep - grey)[both].max() < 0.5


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (16, 16), (5, 60), (60, 5), (DISPARITIES - 1, 40)])
def test_images_smaller_than_the_search_do_not_crash(settings: MatchSettings, size: tuple[int, int]) -> None:
    disparity = match(pair(*shifted(1, size)), settings)
    assert disparity.d_px.shape == size[::-1]
    check(disparity, size[0])


def test_the_same_pair_gives_the_same_map(settings: MatchSettings) -> None:
    given = pair(*shifted(9))
    np.testing.assert_array_equal(match(given, settings).d_px, match(given, settings).d_px)
