"""The paper's method step by step, on blocks drawn with exact sub-pixel edges."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pydantic import ValidationError

from roadblock.errors import ValueRefusedError
from roadblock.stages.bands import (
    BandsSettings,
    band_interval_px,
    find_targets,
    horizon_row,
    lies_flat,
    match_segments,
    measure_target,
    measure_targets,
    merged,
    project_band,
    segment,
    separate,
)
from roadblock.stages.bands.measure import LEAST_SIGMA_PX, measured, without_strays
from roadblock.stages.bands.segmentation import valleys, watershed
from roadblock.values.camera import Rectification

WIDTH, HEIGHT, HORIZON = 331, 197, 61.3
R = Rectification(302.7, 171.4, HORIZON, 0.213, (WIDTH, HEIGHT))
ROAD = 170.0
AT_REST = BandsSettings(relative_speed_mps=0)


def columns_inside(u0: float, u1: float) -> np.ndarray:
    """How much of each column lies between two edges; pixel u reaches from u - 0.5 to u + 0.5."""
    u = np.arange(WIDTH)
    return np.clip(np.minimum(u + 0.5, u1) - np.maximum(u - 0.5, u0), 0, 1)


def road() -> np.ndarray:
    """A road with a bright sky over it."""
    image = np.full((HEIGHT, WIDTH), ROAD)
    image[: int(HORIZON) + 1] = 240
    return image


def block(image: np.ndarray, u0: float, u1: float, v0: int, v1: int, grey: float) -> None:
    share = columns_inside(u0, u1)
    image[v0:v1] += share * (grey - image[v0:v1])


def gray(image: np.ndarray) -> np.ndarray:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def noisy(image: np.ndarray, seed: int, sigma: float = 4.0) -> np.ndarray:
    return gray(image + np.random.default_rng(seed).normal(0, sigma, image.shape))


def uvd(d: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.column_stack([np.full(len(d), 50.0), rows, d])


# Segmentation


def test_the_horizon_moves_with_the_pitch() -> None:
    assert horizon_row(61.3, 302.7, BandsSettings()) == 61.3
    # Looking down by 2 degrees lifts the horizon by f tan 2 = 10.57 px.
    assert horizon_row(61.3, 302.7, BandsSettings(pitch_deg=2)) == pytest.approx(61.3 - 10.570, abs=1e-3)


@pytest.mark.parametrize(
    ("grey", "bright", "found"), [(60, False, True), (60, True, False), (245, True, True), (245, False, False)]
)
@pytest.mark.parametrize("threshold", ["spread", "otsu"])
@pytest.mark.parametrize("background", ["road", "local"])
def test_a_block_of_another_grey_is_cut_out(
    grey: float, bright: bool, found: bool, threshold: str, background: str
) -> None:
    image = road()
    block(image, 99.5, 139.5, 90, 150, grey)
    settings = BandsSettings.model_validate({"threshold": threshold, "background": background})
    share = segment(noisy(image, 1), HORIZON, bright, settings)
    cut = share >= 0.5
    assert share.dtype == np.float32
    assert cut[90:150, 100:140].mean() > 0.99 if found else not cut.any()
    # The threshold is low, so blurred edges lie up to one pixel further out, in both images alike.
    assert cut[89:151, 99:141].sum() == cut.sum()
    assert share.min() >= 0
    assert share.max() <= 1


def test_nothing_is_cut_out_above_the_horizon_or_where_hardly_any_road_is_seen() -> None:
    image = road()
    block(image, 99.5, 139.5, 20, 150, 50)
    assert not segment(gray(image), HORIZON, False, BandsSettings())[:62].any()
    for horizon_px in (HEIGHT - 2.0, HEIGHT + 50.0):
        assert not segment(gray(image), horizon_px, False, BandsSettings()).any()
    assert segment(gray(image), -30.0, False, BandsSettings()).any()
    assert not segment(gray(image)[:, :3], HORIZON, False, BandsSettings()).any()


def test_a_rough_road_raises_the_threshold() -> None:
    image = road()
    block(image, 99.5, 139.5, 90, 150, ROAD - 30)
    sharp = BandsSettings(blur_px=0, contrast=5)
    assert (segment(noisy(image, 2, 4), HORIZON, False, sharp)[90:150, 100:140] >= 0.5).mean() > 0.99
    # Its spread of 30 makes the threshold 75 grey levels.
    assert (segment(noisy(image, 2, 30), HORIZON, False, sharp)[90:150, 100:140] >= 0.5).mean() < 0.1


def test_a_road_that_changes_its_grey_along_it_stays_background() -> None:
    image = road()
    image[62:] += np.linspace(25, -25, HEIGHT - 62)[:, None]
    block(image, 99.5, 139.5, 90, 150, 60)
    targets = find_targets(noisy(image, 3), HORIZON, BandsSettings())
    assert targets.labels.max() == 1


def test_a_picture_without_any_grey_near_the_roads_own_has_a_background_all_the_same() -> None:
    image = road()
    image[62:120] = 20
    assert segment(gray(image), HORIZON, False, BandsSettings())[70:110].min() == 1


def test_dark_and_bright_targets_that_touch_are_two() -> None:
    image = road()
    block(image, 99.5, 139.5, 90, 150, 60)
    block(image, 139.5, 199.5, 100, 140, 250)
    both = find_targets(gray(image), HORIZON, BandsSettings())
    assert both.labels.max() == 2
    assert both.labels[120, 120] != both.labels[120, 170]
    for polarity, u in (("dark", 120), ("bright", 170)):
        one = find_targets(gray(image), HORIZON, BandsSettings(polarity=polarity))
        assert one.labels.max() == 1
        assert one.labels[120, u] == 1


# Separation


def test_valleys_are_cut_and_tails_cut_off() -> None:
    two = np.array([30, 40, 42, 40, 12, 9, 12, 38, 41, 39])
    assert valleys(two, 0.35) == [5]
    assert valleys(two, 0.1) == []
    tail = np.array([3, 3, 30, 40, 40, 31, 4, 4, 4])
    assert valleys(tail, 0.35) == [2, 6]
    assert valleys(np.array([5, 5, 5]), 0.35) == []


@pytest.mark.parametrize("separation", ["valleys", "watershed"])
def test_fused_targets_become_two(separation: str) -> None:
    v, u = np.mgrid[:90, :150]
    mask = (np.hypot(v - 40, u - 45) < 25) | (np.hypot(v - 44, u - 100) < 27)
    mask |= (abs(v - 42) < 4) & (abs(u - 72) < 12)
    labels = separate(mask, BandsSettings.model_validate({"separation": separation}))
    assert labels.max() == 2
    assert labels[40, 45] != labels[44, 100]
    assert ((labels > 0) == mask).mean() > 0.999
    assert separate(mask, BandsSettings(separation="none")).max() == 1


def test_watershed_keeps_a_round_block_whole() -> None:
    v, u = np.mgrid[:61, :61]
    disc = np.hypot(v - 30, u - 30) < 22
    (whole,) = watershed(disc)
    assert_array_equal(whole, disc)


def test_specks_are_no_targets() -> None:
    mask = np.zeros((40, 60), bool)
    mask[5:10, 5:16] = True
    assert separate(mask, BandsSettings(area_px=55)).max() == 1
    assert separate(mask, BandsSettings(area_px=56)).max() == 0


# Bands and projection


def test_the_interval_shrinks_with_speed_and_with_low_targets() -> None:
    """By hand: 240 px in 12 bands are 20 px at rest, 10 px at the halving speed, whichever way."""
    settings = BandsSettings(bands=12, halving_speed_mps=7, relative_speed_mps=0)
    assert band_interval_px(240, settings) == 20
    for speed in (7, -7):
        assert band_interval_px(240, settings.model_copy(update={"relative_speed_mps": speed})) == 10
    assert band_interval_px(60, settings) == 5
    assert band_interval_px(1, settings) == settings.interval_px[0]
    assert band_interval_px(5000, settings) == settings.interval_px[1]


def test_a_block_projects_to_a_segment_with_its_exact_ends() -> None:
    share = np.tile(columns_inside(40.25, 90.75), (6, 1))
    # Column 40 is covered by a quarter; one half is crossed a third of the way to column 41.
    assert_allclose(project_band(share), [[40 + (0.5 - 0.25) / 0.75, 91 - 1 / 3]])


def test_a_slanted_edge_projects_to_its_middle() -> None:
    mask = np.zeros((5, 40), bool)
    for row in range(5):
        mask[row, 10 + row : 30 + row] = True
    # Between columns 11 (2 of 5 rows) and 12 (3 of 5); and likewise to the right.
    assert_allclose(project_band(mask), [[11.5, 31.5]])


def test_segments_without_an_end_in_the_image_are_left_out() -> None:
    mask = np.zeros((3, 50), bool)
    mask[:, :8] = mask[:, 20:30] = mask[:, 44:] = True
    assert_allclose(project_band(mask), [[19.5, 29.5]])
    assert project_band(np.ones((3, 9))).shape == (0, 2)
    assert project_band(np.zeros((3, 9))).shape == (0, 2)


# Matching


def test_segments_match_the_closest_length_from_left_to_right() -> None:
    left = np.array([[50.0, 60.0], [80.0, 110.0], [140.0, 152.0]])
    right = np.array([[20.0, 23.0], [44.0, 54.5], [70.0, 99.0], [130.0, 142.0]])
    assert_array_equal(match_segments(left, right, BandsSettings()), [[0, 1], [1, 2], [2, 3]])


def test_the_order_is_kept_even_where_lengths_would_cross() -> None:
    left = np.array([[100.0, 120.0], [130.0, 170.0]])
    right = np.array([[80.0, 120.0], [122.0, 142.0]])
    assert_array_equal(match_segments(left, right, BandsSettings()), [[1, 0]])


@pytest.mark.parametrize("behind", [(103.0, 123.0), (79.0, 99.0)])
def test_disparities_must_be_possible(behind: tuple[float, float]) -> None:
    """One to the right of its partner, one further away than the largest disparity."""
    settings = BandsSettings(disparity_px=20)
    assert match_segments(np.array([[100.0, 120.0]]), np.array([behind]), settings).shape == (0, 2)
    assert_array_equal(match_segments(np.array([[100.0, 120.0]]), np.array([[90.0, 110.0]]), settings), [[0, 0]])


def test_lengths_that_differ_too_much_do_not_match() -> None:
    """20 px against x may differ by 2 + (5 + x / 4) / 2 px on average: up to 28.0 px, as 28 - 20 = 2 + 2.5 + 3.5."""
    left = np.array([[100.0, 120.0]])
    for length, pairs in ((27.9, 1), (28.1, 0)):
        assert len(match_segments(left, np.array([[80.0, 80.0 + length]]), BandsSettings())) == pairs


def test_nothing_matches_nothing() -> None:
    none, some = np.zeros((0, 2)), np.array([[10.0, 20.0]])
    for left, right in ((none, none), (some, none), (none, some)):
        assert match_segments(left, right, BandsSettings()).shape == (0, 2)


def test_matching_is_the_best_of_all_that_keep_the_order() -> None:
    """Against all possible matchings, tried one by one."""
    from itertools import combinations

    rng = np.random.default_rng(5)
    settings = BandsSettings()
    for _ in range(30):
        left, right = (
            np.sort(rng.uniform(0, 250, 2 * n)).reshape(-1, 2) + shift
            for n, shift in zip(rng.integers(1, 5, 2), (30, 0), strict=True)
        )
        len_l, len_r = np.diff(left)[:, 0], np.diff(right)[:, 0]
        alone = [0.5 * (2 + 0.25 * x) for x in (len_l, len_r)]

        def cost(pairs: list[tuple[int, int]], left=left, right=right, alone=alone, len_l=len_l, len_r=len_r) -> float:
            total = alone[0].sum() + alone[1].sum()
            for i, j in pairs:
                gap, d = abs(len_l[i] - len_r[j]), left[i] - right[j]
                if gap > alone[0][i] + alone[1][j] or (d < 0).any() or (d > settings.disparity_px).any():
                    return np.inf
                total += gap - alone[0][i] - alone[1][j]
            return total

        matchings = [
            list(zip(a, b, strict=True))
            for k in range(min(len(left), len(right)) + 1)
            for a in combinations(range(len(left)), k)
            for b in combinations(range(len(right)), k)
        ]
        found = [(int(i), int(j)) for i, j in match_segments(left, right, settings)]
        assert cost(found) == pytest.approx(min(map(cost, matchings)))


# Measuring


@pytest.mark.parametrize("d_px", [4.0, 9.37, 23.81])
def test_a_sub_pixel_shift_is_measured_from_shares(d_px: float) -> None:
    left, right = (np.zeros((HEIGHT, WIDTH)) for _ in range(2))
    left[90:150] = columns_inside(141.4, 203.2)
    right[90:150] = columns_inside(141.4 - d_px, 203.2 - d_px)
    ends = measure_target(left, right, R, AT_REST)
    # 60 rows are 12 bands of 5; both ends of each.
    assert ends.uvd_px.shape == (24, 3)
    # A column covered to a share a ends at a, but one half is crossed at up to 0.086 px from there.
    assert_allclose(ends.uvd_px[:, 2], d_px, atol=2 * 0.086)
    assert_allclose(ends.uvd_px[::2, 0], 141.4, atol=0.086)
    assert_allclose(ends.uvd_px[1::2, 0], 203.2, atol=0.086)
    assert_allclose(np.unique(ends.uvd_px[:, 1]), np.arange(92, 150, 5))


def test_end_points_are_triangulated_by_equation_8() -> None:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[90:150, 140:200] = True
    ends = measure_target(mask, np.roll(mask, -12, axis=1), R, AT_REST)
    z = 302.7 * 0.213 / 12
    u, v = 139.5, 92.0
    by_hand = [(u - 171.4) * z / 302.7 - 0.213 / 2, (v - HORIZON) * z / 302.7, z]
    assert_allclose(ends.points_m[0], by_hand, rtol=1e-12)
    assert_allclose(ends.points_m[:, 2], z)
    assert ends.sigma_d_px == LEAST_SIGMA_PX


def test_a_target_seen_by_one_camera_has_no_ends() -> None:
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[90:150, 140:200] = True
    for left, right in ((mask, ~mask & False), (mask & False, mask)):
        ends = measure_target(left, right, R, AT_REST)
        assert ends.uvd_px.shape == ends.points_m.shape == (0, 3)
        assert np.isnan(ends.sigma_d_px)


@pytest.mark.parametrize(
    ("left", "right", "says"),
    [
        (np.zeros((4, 5)), np.zeros((4, 6)), r"one shape.*\(4, 5\) and \(4, 6\)"),
        (np.zeros((0, 5)), np.zeros((0, 5)), r"one shape.*\(0, 5\)"),
        (np.zeros((4, 5, 1)), np.zeros((4, 5, 1)), "images of one shape"),
        (np.zeros((4, 5)), np.full((4, 5), 255, np.uint8), r"0\.\.1.*255"),
        (np.full((4, 5), -0.1), np.zeros((4, 5)), r"0\.\.1.*-0\.1"),
        (np.full((4, 5), np.nan), np.zeros((4, 5)), r"0\.\.1.*nan"),
    ],
)
def test_masks_that_are_none_are_refused(left: np.ndarray, right: np.ndarray, says: str) -> None:
    with pytest.raises(ValueRefusedError, match=says):
        measure_target(left, right, R, BandsSettings())


@pytest.mark.parametrize("gain", [1.0, 0.85])
def test_two_blocks_of_a_drawn_pair_have_their_own_disparities(gain: float) -> None:
    left, right = road(), road()
    for u0, u1, v0, v1, d, grey in ((60.3, 100.8, 80, 120, 6.43, 70), (180.1, 262.6, 100, 180, 21.77, 90)):
        block(left, u0, u1, v0, v1, grey)
        block(right, u0 - d, u1 - d, v0, v1, grey)
    a, b = (find_targets(noisy(i, seed, 2), HORIZON, BandsSettings()) for i, seed in ((left, 1), (gain * right, 2)))
    far, near = sorted(measure_targets(a, b, R, BandsSettings()), key=lambda ends: float(np.median(ends.uvd_px[:, 2])))
    assert np.median(far.uvd_px[:, 2]) == pytest.approx(6.43, abs=0.06)
    assert np.median(near.uvd_px[:, 2]) == pytest.approx(21.77, abs=0.06)
    assert np.median(near.points_m[:, 2]) == pytest.approx(302.7 * 0.213 / 21.77, rel=0.004)


def test_more_spread_is_more_sigma() -> None:
    rng = np.random.default_rng(6)
    rows = np.arange(40) // 2 * 5.0 + 90
    stated = [measured(uvd(20 + s * rng.normal(size=40), rows), R).sigma_d_px for s in (0.1, 0.3, 0.9)]
    assert_allclose(stated, [0.1, 0.3, 0.9], rtol=0.5)
    assert stated == sorted(stated)


def test_noise_of_single_ends_is_no_depth_but_a_slant_is() -> None:
    rows = np.arange(40) // 2 * 5.0 + 90
    noise = 20 + np.random.default_rng(7).normal(0, 0.5, 40)
    assert np.std(measured(uvd(noise, rows), R).uvd_px[:, 2]) < 0.2
    slanted = 20 + 0.04 * (rows - rows.mean())
    kept = measured(uvd(slanted, rows), R).uvd_px[:, 2]
    assert_allclose(kept, slanted, atol=0.05)
    few = np.array([19.0, 21.0, 20.0, 20.5])
    assert_array_equal(measured(uvd(few, np.arange(4.0)), R).uvd_px[:, 2], few)


def test_strays_go_with_both_ends_of_their_segment() -> None:
    d = np.r_[np.full(10, 20.0), 20.0, 31.0, np.full(4, 20.2)]
    kept = without_strays(uvd(d, np.arange(16.0)))
    assert_array_equal(kept[:, 1], np.delete(np.arange(16.0), [10, 11]))


def test_strays_are_strays_of_their_own_side() -> None:
    d = np.tile([23.0, 18.0], 8)
    d[10] = 30.0
    kept = without_strays(uvd(d, np.arange(16.0)))
    assert_array_equal(kept[:, 1], np.delete(np.arange(16.0), [10, 11]))
    assert_array_equal(kept[:, 2], np.tile([23.0, 18.0], 7))


def test_pieces_merge_to_one_that_is_no_better_known() -> None:
    rows = np.arange(8.0) + 90
    one, other = measured(uvd(np.full(8, 20.0), rows), R), measured(uvd(20 + np.tile([-1.0, 1.0], 4), rows), R)
    whole = merged([one, other])
    assert len(whole.uvd_px) == len(whole.points_m) == 16
    assert whole.sigma_d_px == other.sigma_d_px > one.sigma_d_px


def test_paint_lies_flat_and_a_post_does_not() -> None:
    rows = np.repeat(np.arange(100.0, 180, 5), 2)
    # On a road 1.4 m below the cameras, d = (v - horizon) * B / h.
    assert lies_flat(uvd((rows - HORIZON) * 0.213 / 1.4, rows), HORIZON)
    assert not lies_flat(uvd(np.full(len(rows), 14.0), rows), HORIZON)
    assert not lies_flat(uvd((rows - HORIZON) * 0.213 / 1.4, rows), 120.0), "above the horizon nothing is road"
    assert not lies_flat(np.zeros((0, 3)), HORIZON)
    rows, aside = rows[:8], np.tile([0.0, -4.0], 4)
    assert lies_flat(uvd((rows - HORIZON) * 0.213 / 1.4 + aside, rows), HORIZON), "one edge matched beside it"
    assert not lies_flat(uvd(14 + aside, rows), HORIZON), "a box over its corner"


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"interval_px": (9, 3)}, "must not be above"),
        ({"interval_px": (0, 3)}, "greater than 0"),
        ({"background": "sky"}, "'road' or 'local'"),
        ({"valley_share": 1}, "less than 1"),
        ({"relative_speed_mps": float("inf")}, "finite"),
        ({"camera_height_m": 0}, "greater than 0"),
        ({"pitch": 1}, "Extra"),
    ],
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        BandsSettings.model_validate(bad)


def test_one_interval_for_all_targets_may_be_set() -> None:
    assert band_interval_px(500, BandsSettings(interval_px=(3, 3))) == 3


def test_a_small_dark_hole_in_a_bright_target_takes_no_number_away() -> None:
    image = road()
    block(image, 99.5, 139.5, 90, 150, 250)
    block(image, 117.5, 121.5, 118, 122, 60)
    labels = find_targets(gray(image), HORIZON, BandsSettings(blur_px=0, area_px=5)).labels
    assert_array_equal(np.unique(labels), np.arange(labels.max() + 1))
    assert labels.max() == 2
