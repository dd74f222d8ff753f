"""Two calibrations of one rig, against moves that are known by construction."""

from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import RigError
from roadblock.geometry.compare import RigChange, compare_rigs
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.uncertainty import moved_rig
from roadblock.values.camera import POSE_PARAMETERS, Camera, RigCovariance, StereoRig, rig_parameters
from roadblock.values.checks import FloatArray

SIZE = (97, 61)
BROWN = Camera(SIZE, 73.0, 66.0, 52.1, 27.4, "brown_conrady", [-0.31, 0.11, 2e-3, -3e-3, -0.01])
FISHEYE = Camera(SIZE, 51.0, 46.0, 43.3, 33.9, "kannala_brandt", [0.06, -0.03, 0.01, -0.002])
CROOKED = pose(rotation_from_rotvec([0.05, -0.08, 0.04]), [0.2, 0.015, -0.03])
F, B = 83.0, 0.2
PINHOLE = Camera(SIZE, F, F, 41.7, 34.2)
TWINS = StereoRig(PINHOLE, PINHOLE, pose(np.eye(3), [B, 0, 0]))


def sure(rig: StereoRig, scale: float = 0.1, seed: int = 3) -> StereoRig:
    """A full covariance with correlations; at scale 1: 0.2 px, 1e-3 of coefficients, 0.02 deg, 0.2 mm."""
    names = rig_parameters(rig.left, rig.right)
    units = {"px": 0.2, "ad": 3e-4, "_m": 2e-4}
    sigma = scale * np.array([units.get(name[-2:], 1e-3) for name in names])
    A = np.random.default_rng(seed).normal(size=(len(names), 2 * len(names))) / np.sqrt(2 * len(names))
    C = sigma[:, None] * (A @ A.T) * sigma
    return replace(rig, covariance=RigCovariance(names, (C + C.T) / 2))


def changed(rig: StereoRig, **by: float) -> StereoRig:
    names = rig_parameters(rig.left, rig.right)
    return moved_rig(rig, np.array([by.get(name.replace(".", "_"), 0.0) for name in names]))


def at(change: RigChange, distance_m: float) -> tuple[FloatArray, FloatArray]:
    (found,) = (each for each in change.at if each.distance_m == distance_m)
    return found.range_m, found.row_px


# --- what a move does -------------------------------------------------------------------------------------------------


def test_a_shifted_principal_point_by_hand() -> None:
    """The true right image lies 0.1 px further right than the used rig believes: disparities are 0.1 px too small."""
    change = compare_rigs(TWINS, changed(TWINS, right_cx_px=0.1, right_cy_px=0.25))
    seen = np.isfinite(change.disparity_px)
    assert 30 <= seen.sum() <= 35
    np.testing.assert_allclose(change.disparity_px[seen], -0.1, rtol=0, atol=1e-9)
    assert change.disparity_mean_px == pytest.approx(-0.1)
    for z in (5.0, 10.0, 20.0, 40.0):
        range_m, row_px = at(change, z)
        known = np.isfinite(range_m)
        np.testing.assert_allclose(range_m[known], F * B / (F * B / z - 0.1) - z, rtol=1e-9)
        np.testing.assert_allclose(row_px[known], -0.25, rtol=0, atol=1e-9)
    range_m, row_px = at(change, np.inf)
    assert np.isnan(range_m).all()
    np.testing.assert_allclose(row_px[seen], -0.25, rtol=0, atol=1e-9)


def test_what_is_seen_behind_infinity_has_no_finite_range() -> None:
    range_m, _ = at(compare_rigs(TWINS, changed(TWINS, right_cx_px=0.5)), 40.0)  # the disparity there is 0.415 px
    assert set(range_m[~np.isnan(range_m)]) == {np.inf}


def test_a_longer_baseline_shows_in_ranges_and_not_far_away() -> None:
    change = compare_rigs(TWINS, changed(TWINS, tx_m=0.002))
    range_m, row_px = at(change, 20.0)
    known = np.isfinite(range_m)
    np.testing.assert_allclose(range_m[known], 20 * B / 0.202 - 20, rtol=1e-9)  # 1 % too near
    np.testing.assert_allclose(row_px[known], 0, rtol=0, atol=1e-9)
    np.testing.assert_allclose(change.disparity_px[np.isfinite(change.disparity_px)], 0, rtol=0, atol=1e-6)


def test_the_change_of_each_parameter() -> None:
    rig = StereoRig(BROWN, FISHEYE, CROOKED)
    delta = np.arange(1, 24) * 1e-4
    change = compare_rigs(rig, moved_rig(rig, delta))
    assert change.names == rig_parameters(BROWN, FISHEYE)
    np.testing.assert_allclose(change.change, delta, rtol=0, atol=1e-13)
    assert np.isnan(change.sigma).all()


def test_a_rig_is_like_itself() -> None:
    rig = sure(StereoRig(BROWN, FISHEYE, CROOKED))
    change = compare_rigs(rig, rig)
    assert change.p == pytest.approx(1)
    np.testing.assert_array_equal(change.change, np.zeros(23))
    for each in change.at:
        assert np.isfinite(each.row_px).sum() > 15
        np.testing.assert_allclose(each.row_px[np.isfinite(each.row_px)], 0, rtol=0, atol=1e-9)


# --- whether chance explains it ---------------------------------------------------------------------------------------


def test_without_a_move_every_probability_is_equally_likely() -> None:
    rig = sure(StereoRig(BROWN, FISHEYE, CROOKED))
    assert rig.covariance is not None
    rng = np.random.default_rng(8)
    draws = rng.multivariate_normal(np.zeros(len(rig.covariance.names)), rig.covariance.matrix, (40, 2), method="eigh")
    changes = [compare_rigs(moved_rig(rig, a), moved_rig(rig, b), 3, 5) for a, b in draws]
    p = np.sort([change.p for change in changes])
    # Kolmogorov and Smirnov's distance of 40 numbers exceeds 0.25 in 1 % of cases. Twice the smaller of two
    # probabilities is not quite uniform: its share below p is p - p^2 / 4 if they are independent.
    assert np.abs(p - p**2 / 4 - (np.arange(40) + 0.5) / 40)[p < 1].max() < 0.25
    for z in (
        [change.disparity_mean_px / change.disparity_mean_sigma_px for change in changes],
        [change.change[-5] / change.sigma[-5] for change in changes],  # the turn about y
        [np.nanmean(change.at[0].range_m / change.at[0].range_sigma_m) for change in changes],
    ):
        assert abs(np.mean(z)) < 0.5
        assert 0.7 < np.std(z) < 1.35


def test_a_move_beyond_the_errors_is_seen() -> None:
    rig = sure(StereoRig(BROWN, FISHEYE, CROOKED))
    change = compare_rigs(rig, changed(rig, ry_rad=np.radians(0.05)))
    assert change.p < 1e-6
    sigma = change.sigma[change.names.index("ry_rad")]
    assert sigma == pytest.approx(np.sqrt(2 * rig.covariance.matrix[-5, -5]))  # type: ignore[union-attr]
    assert np.radians(0.05) > 5 * sigma


@pytest.mark.parametrize("moved", ["ry_rad", "rx_rad", "right_k1", "left_fx_px", "tx_m"])
def test_each_kind_of_move_is_seen(moved: str) -> None:
    rig = sure(StereoRig(BROWN, FISHEYE, CROOKED), 0.01)
    step = {"right_k1": 0.003, "left_fx_px": 0.3}.get(moved, 0.002)
    assert compare_rigs(rig, changed(rig, **{moved: step})).p < 1e-6


def test_parameters_that_both_hold_fixed_cannot_explain_a_difference() -> None:
    names = rig_parameters(BROWN, FISHEYE)
    exact = replace(StereoRig(BROWN, FISHEYE, CROOKED), covariance=RigCovariance(names, np.zeros((23, 23))))
    assert compare_rigs(exact, exact).p == 1
    assert compare_rigs(exact, changed(exact, ry_rad=1e-6)).p == 1  # 0.0001 px
    assert compare_rigs(exact, changed(exact, ry_rad=1e-3)).p == 0
    partly = np.zeros((23, 23))
    partly[10, 10] = 1.0  # right.fy_px
    vague = replace(exact, covariance=RigCovariance(names, partly))
    assert compare_rigs(vague, changed(vague, right_fy_px=1.0)).p > 0.3
    assert compare_rigs(vague, changed(vague, ry_rad=1e-3)).p < 1e-6


@pytest.mark.parametrize("which", [0, 1])
def test_nothing_can_be_told_without_both_covariances(which: int) -> None:
    rigs = [sure(TWINS), sure(TWINS)]
    rigs[which] = TWINS
    change = compare_rigs(*rigs)
    assert np.isnan([change.p, change.disparity_mean_sigma_px, *change.sigma]).all()
    assert all(np.isnan(each.range_sigma_m).all() for each in change.at)


# --- other lenses, other sizes ----------------------------------------------------------------------------------------


def test_other_lens_models_are_compared_by_their_images() -> None:
    rational = Camera(SIZE, 73.0, 66.0, 52.1, 27.4, "brown_conrady", [*BROWN.distortion, 0.0, 0.0, 0.0])
    a = sure(StereoRig(BROWN, BROWN, CROOKED), 0.02)
    b = sure(StereoRig(rational, rational, CROOKED), 0.02, 4)
    same = compare_rigs(a, b)
    assert same.names == POSE_PARAMETERS
    assert same.p == pytest.approx(1, abs=1e-3)
    np.testing.assert_array_equal(same.change, np.zeros(6))
    np.testing.assert_allclose(
        same.sigma**2,
        (np.diag(a.covariance.matrix)[-6:] + np.diag(b.covariance.matrix)[-6:]),  # type: ignore[union-attr]
    )
    turned = compare_rigs(a, changed(b, rx_rad=0.01))
    assert turned.p < 1e-6
    assert np.nanmedian(turned.at[-1].row_px) == pytest.approx(-0.73, rel=0.2)  # 0.01 rad of 73 px


def test_rigs_of_two_image_sizes_are_refused() -> None:
    half = Camera((48, 30), 35.0, 35.0, 20.0, 15.0)
    with pytest.raises(RigError, match="at one image size, but these are for 97x61 and 48x30: calibrate both at one"):
        compare_rigs(TWINS, StereoRig(half, half, TWINS.T_left_right))


def test_rigs_that_share_no_view_are_refused() -> None:
    narrow = Camera(SIZE, 800.0, 800.0, 48.0, 30.0)
    away = StereoRig(narrow, narrow, pose(rotation_from_rotvec([0, 0.5, 0]), [0.2, 0, 0]))
    with pytest.raises(RigError, match="the two rigs see nothing in common"):
        compare_rigs(away, away)
