import numpy as np
import pytest
from scipy import ndimage

from roadblock.stages.match import MatchSettings, match
from roadblock.stages.match.views import balance, match_both_ways
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair

NAN = np.float32("nan")


def texture(shape=(61, 97), seed=0, mean=100.0, contrast=30.0):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=shape), 1.2)
    return np.clip(np.rint(mean + contrast * noise / noise.std()), 0, 255).astype(np.uint8)


def test_balance_takes_back_a_gain_and_an_offset():
    image = texture()
    dim = np.rint(0.7 * image + 12).astype(np.uint8)
    left, right = balance(image, dim)
    assert np.abs(left.astype(float) - right).max() <= 1.5
    # Each takes half of the way: the contrast is the geometric mean of both.
    assert left.std() == pytest.approx(np.sqrt(image.std() * dim.std()), rel=0.02)
    assert left.mean() == pytest.approx((image.mean() + dim.mean()) / 2, abs=1)


def test_what_is_cut_off_says_nothing_about_gain():
    image = texture(mean=170, contrast=40)
    bright = np.clip(np.rint(1.25 * image), 0, 255).astype(np.uint8)
    left, right = balance(image, bright)
    kept = (image > 80) & (bright < 245)
    assert np.median(left[kept].astype(float) - right[kept]) == pytest.approx(0, abs=1)


@pytest.mark.parametrize(
    "other", [texture(), np.rint(1.02 * texture()).astype(np.uint8), np.full((61, 97), 90, np.uint8)]
)
def test_balance_leaves_alike_and_blank_images_as_they_are(other):
    image = texture()
    assert all(a is b for a, b in zip(balance(image, other), (image, other), strict=True))


def test_balance_leaves_images_that_are_all_cut_off():
    white = np.full((61, 97), 255, np.uint8)
    assert balance(white, texture())[0] is white


def test_both_ways_is_the_mean_of_what_agrees():
    """A matcher made by hand: what it says of the left image, and of the mirrored right one."""
    said = {
        0: np.array([[0, 2, 2, 3, NAN, 1, 4]], np.float32),  # of the left image
        1: np.array([[NAN, 2.5, 9, 1.4, 0.6, 1.5, 0.5]], np.float32)[:, ::-1],  # of the right one, mirrored
    }
    images = [np.full((1, 7), i, np.uint8) for i in (0, 1)]
    d_px = match_both_ways(lambda first, *_: said[int(first[0, 0])], *images, MatchSettings())
    # Columns 0..6 look at the right image's 0, -1 (held at 0), 0, 0, -, 4, 2.
    np.testing.assert_allclose(d_px, [[NAN, NAN, NAN, NAN, NAN, 0.8, NAN]], atol=1e-6)
    assert d_px.dtype == np.float32


@pytest.mark.parametrize("matcher", ["sgbm", "bm", "region"])
def test_a_mirrored_pair_gives_the_mirrored_map(matcher):
    """By construction: seen from the right image, the same two maps are averaged."""
    settings = MatchSettings(matcher=matcher, disparities=16, block_px=5, speckle_px=0, both_ways=True)
    right = texture((61, 130), 3)
    left = ndimage.shift(right.astype(float), (0, 5.4), order=3, mode="nearest").clip(0, 255).astype(np.uint8)
    rectification = Rectification(100.0, 60.0, 30.0, 0.2, (130, 61))
    plain = match(RectifiedPair(left, right, rectification), settings).d_px
    mirrored = match(
        RectifiedPair(*(np.ascontiguousarray(i[:, ::-1]) for i in (right, left)), rectification), settings
    ).d_px[:, ::-1]
    rows, columns = np.nonzero(np.isfinite(plain))
    seen_at = np.rint(columns - plain[rows, columns]).astype(int)
    twin = mirrored[rows, seen_at]
    known = np.isfinite(twin)
    assert known.mean() > 0.8
    assert np.median(np.abs(twin[known] - plain[rows, columns][known])) <= 0.01


def test_one_way_is_the_matcher_itself():
    settings = MatchSettings(disparities=16, both_ways=False)
    right = texture((61, 130), 3)
    left = np.roll(right, 5, axis=1)
    pair = RectifiedPair(left, right, Rectification(100.0, 60.0, 30.0, 0.2, (130, 61)))
    one, both = (match(pair, settings.model_copy(update={"both_ways": way})).d_px for way in (False, True))
    assert np.isfinite(one).sum() > np.isfinite(both).sum()
    assert np.nanmedian(one) == np.nanmedian(both) == 5
