"""The self-check: features, both witnesses of the turn, what the rig itself is sure of, and the monitor."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose
from roadblock.geometry.uncertainty import moved_rig
from roadblock.stages.selfcheck import RigMonitor, SelfcheckSettings, epipolar, monitor, proposed_rig
from roadblock.stages.selfcheck.epipolar import fit_turn
from roadblock.stages.selfcheck.expansion import Stretch, combined, fit_stretch
from roadblock.stages.selfcheck.features import follow, gray_pair, match_pair, spread_corners
from roadblock.stages.selfcheck.trust import apparent_turn, turn_covariance
from roadblock.stages.selfcheck.verdict import is_off, is_sure, measure, worded
from roadblock.values.camera import Camera, Rectification, RigCovariance, StereoRig, rig_parameters
from roadblock.values.drift import RigDrift
from roadblock.values.frame import RectifiedPair

TWINS = Rectification(517.3, 331.8, 187.9, 0.213, (641, 397))
TURN = np.radians([0.031, -0.047, 0.055])
SETTINGS = SelfcheckSettings()
UNTOLD = np.full((4, 4), np.nan)


def seen(points: np.ndarray, turn_rad: np.ndarray, r: Rectification = TWINS) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of points of the left rectified frame in both images, the right camera turned against its rig."""
    right = (points - (r.baseline_m, 0, 0)) @ Rotation.from_rotvec(turn_rad).as_matrix()
    return tuple(p[:, :2] / p[:, 2:] * r.f_px + (r.cx_px, r.cy_px) for p in (points, right))


def street(n: int, rng: np.random.Generator, r: Rectification = TWINS) -> np.ndarray:
    """Points (n, 3) anywhere in the image, as near as the road lets them be or further."""
    uv = rng.uniform(0.03, 0.97, (n, 2)) * r.size_px
    rays = np.c_[(uv - (r.cx_px, r.cy_px)) / r.f_px, np.ones(n)]
    nearest = np.minimum(1.4 / np.maximum(rays[:, 1], 0.02), 60)
    return rays * (nearest * rng.uniform(1.0, 1.8, n))[:, None]


def uvd(points: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    left, right = seen(points, turn_rad)
    return np.c_[left, left[:, 0] - right[:, 0]]


def share_within_a_sigma(z: np.ndarray) -> None:
    """68 % of all draws lie within their sigma, to three standard deviations of the count."""
    slack = 3 * np.sqrt(0.683 * 0.317 / len(z))
    np.testing.assert_allclose((np.abs(z) < 1).mean(0), 0.683, atol=slack)


# --- vertical disparities ---------------------------------------------------------------------------------------------


def test_a_turn_is_found_with_its_sign() -> None:
    left, right = seen(street(500, np.random.default_rng(0)), TURN)
    found = fit_turn(right, right[:, 1] - left[:, 1], TWINS)
    np.testing.assert_allclose(found.turn_rad, TURN, atol=2e-6)  # its square is left out


@pytest.mark.parametrize("shared_px", [0.0, 0.1])
def test_the_sigma_of_the_turn_covers(monkeypatch: pytest.MonkeyPatch, shared_px: float) -> None:
    """With noise, 20 % outliers, and errors that whole areas of the image have in common."""
    monkeypatch.setattr(epipolar, "MATCH_BIAS_PX", 0.0)
    rng, z = np.random.default_rng(1), []
    for _ in range(250):
        left, right = seen(street(400, rng), TURN)
        dv = right[:, 1] - left[:, 1] + rng.normal(0, 0.15, 400)
        dv += rng.normal(0, shared_px, 48)[epipolar.cell_of(right, TWINS)]
        dv[:80] += rng.uniform(-6, 6, 80)
        found = fit_turn(right, dv, TWINS)
        z.append((found.turn_rad - TURN) / np.sqrt(found.cov_rad2.diagonal()))
    share_within_a_sigma(np.array(z))


def test_the_bias_of_matching_is_never_forgotten() -> None:
    left, right = seen(street(500, np.random.default_rng(0)), TURN)
    sigma = np.sqrt(fit_turn(right, right[:, 1] - left[:, 1], TWINS).cov_rad2.diagonal())
    assert (sigma >= 0.015 / TWINS.f_px).all()


def test_features_in_one_corner_tell_nothing() -> None:
    left, right = seen(street(4000, np.random.default_rng(0)), TURN)
    corner = (right < (160, 130)).all(1)
    found = fit_turn(right[corner], (right - left)[corner, 1], TWINS)
    assert np.isnan(found.turn_rad).all()
    assert np.isnan(found.cov_rad2).all()


def test_neither_do_features_that_agree_in_one_corner_only() -> None:
    rng = np.random.default_rng(0)
    left, right = seen(street(900, rng), TURN)
    dv = right[:, 1] - left[:, 1]
    corner = (right < (230, 190)).all(1)
    keep = corner | (np.cumsum(~corner) <= corner.sum() * 0.9)
    dv[~corner] += rng.choice([-1, 1], (~corner).sum()) * rng.uniform(50, 90, (~corner).sum())
    assert np.isnan(fit_turn(right[keep], dv[keep], TWINS).turn_rad).all()


# --- image expansion --------------------------------------------------------------------------------------------------

YAW = np.array([0, TURN[1], 0])
DRIVE = (Rotation.from_rotvec([0.002, -0.011, 0.003]).as_matrix(), np.array([0.08, -0.03, -3.1]))


def driven(n: int, rng: np.random.Generator, noise_px: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The same points before and after a drive, u v d, with noise."""
    points = street(n, rng)
    points = points[points[:, 2] > 5]
    first, second = uvd(points, YAW), uvd(points @ DRIVE[0].T + DRIVE[1], YAW)
    first[:, 2] += noise_px * rng.normal(0, 0.15, len(points))
    second += noise_px * rng.normal(0, (0.2, 0.2, 0.15), (len(points), 3))
    return first, second


def test_a_yaw_is_found_by_expansion_whatever_the_drive() -> None:
    found = fit_stretch(*driven(400, np.random.default_rng(2), 0.0), TWINS)
    assert found is not None
    assert found.yaw_rad == pytest.approx(YAW[1], abs=1e-6)
    np.testing.assert_allclose(found.moved_m, DRIVE[1], atol=2e-3)
    assert found.turned_rad == pytest.approx(np.linalg.norm([0.002, -0.011, 0.003]), rel=1e-3)
    assert found.share == 1


def test_the_sigma_of_expansion_covers() -> None:
    """With noise and 20 % of the features on other ways."""
    rng, z = np.random.default_rng(3), []
    for _ in range(200):
        first, second = driven(180, rng)
        other = rng.random(len(first)) < 0.2
        second[other] += rng.uniform(-30, 30, (other.sum(), 3))
        found = fit_stretch(first, second, TWINS)
        assert found is not None
        z.append((found.yaw_rad - YAW[1]) / found.sigma_rad)
    share_within_a_sigma(np.array(z))


def test_no_motion_in_common_says_nothing() -> None:
    rng = np.random.default_rng(4)
    first, second = driven(300, rng)
    second[:, :2] += rng.uniform(-60, 60, (len(second), 2))
    assert fit_stretch(first, second, TWINS) is None


def test_things_at_infinity_say_nothing() -> None:
    first, second = driven(300, np.random.default_rng(5))
    first[:, 2] = second[:, 2] = 0.5
    first[:, :2] = second[:, :2]
    found = fit_stretch(first, second, TWINS)
    assert found is not None
    assert found.sigma_rad * TWINS.f_px > monitor.TELLING_PX


def test_a_standing_car_says_nothing_of_the_yaw() -> None:
    first, _ = driven(300, np.random.default_rng(6))
    found = fit_stretch(first, first + np.random.default_rng(7).normal(0, 0.1, first.shape), TWINS)
    assert found is not None
    assert found.sigma_rad * TWINS.f_px > monitor.TELLING_PX


def test_stretches_are_weighed_and_their_scatter_counts() -> None:
    def stretch(yaw: float, sigma: float) -> Stretch:
        return Stretch(yaw, sigma, 0.0, np.zeros(3), 1.0)

    mean, sigma = combined([stretch(1.0, 1.0), stretch(4.0, 2.0)])
    assert mean == pytest.approx((1 + 4 / 4) / 1.25)
    assert sigma == pytest.approx(np.sqrt((0.6**2 + 2.4**2 / 4) / 1.25))  # chi square 1.8 over 1 degree of freedom
    assert combined([stretch(1.0, 1.0)] * 4) == (1.0, 0.5)


# --- features ---------------------------------------------------------------------------------------------------------


def textured(rng: np.random.Generator, shape: tuple[int, int] = (270, 390)) -> np.ndarray:
    """A seamless texture without details finer than the pixels can show."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(shape[0]), np.fft.fftfreq(shape[1]), indexing="ij"))
    image = np.fft.ifft2(np.fft.fft2(rng.normal(0, 1, shape)) * np.exp(-((frequency / 0.12) ** 2) / 2)).real
    return 120 + 35 * image / image.std()


def shifted(image: np.ndarray, du: float, dv: float) -> np.ndarray:
    """The image moved right and down, exactly: by the phases of its Fourier transform."""
    phase = np.add.outer(np.fft.fftfreq(image.shape[0]) * dv, np.fft.fftfreq(image.shape[1]) * du)
    return np.fft.ifft2(np.fft.fft2(image) * np.exp(-2j * np.pi * phase)).real


def photo(image: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return np.clip(np.rint(image + rng.normal(0, 1.5, image.shape)), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("dv", [-0.5, -0.2, 0.0, 0.1, 0.3, 2.25])
def test_rows_are_matched_without_bias(dv: float) -> None:
    rng = np.random.default_rng(8)
    scene = textured(rng)
    left, right = photo(scene, rng), photo(shifted(scene, -11.3, dv), rng)
    corners = spread_corners(left, SETTINGS)
    found, good = match_pair(left, right, corners, SETTINGS)
    assert good.mean() > 0.6
    error = (found - corners)[good] - (-11.3, dv)
    assert abs(error.mean(0)).max() < 0.02
    assert error.std(0).max() < 0.1


def test_corners_are_spread_one_a_cell() -> None:
    corners = spread_corners(photo(textured(np.random.default_rng(9)), np.random.default_rng(9)), SETTINGS)
    cell = round((270 * 390 / SETTINGS.features) ** 0.5)
    cells = np.unique(corners // cell, axis=0)
    assert len(cells) == len(corners) > 0.7 * SETTINGS.features
    assert corners.min() > SETTINGS.window_px // 2
    assert (corners < (390 - 8, 270 - 8)).all()


def test_a_blank_image_has_no_corners() -> None:
    blank = np.full((90, 120), 77, np.uint8)
    corners = spread_corners(blank, SETTINGS)
    assert corners.shape == (0, 2)
    found, good = follow(blank, blank, corners, SETTINGS)
    assert len(found) == len(good) == 0


def test_what_is_too_far_off_its_row_is_no_match() -> None:
    rng = np.random.default_rng(10)
    scene = textured(rng)
    left, right = photo(scene, rng), photo(shifted(scene, -5, 12.0), rng)
    assert not match_pair(left, right, spread_corners(left, SETTINGS), SETTINGS)[1].any()


def test_a_known_disparity_finds_what_is_far_aside() -> None:
    rng = np.random.default_rng(11)
    scene = textured(rng)
    left, right = photo(scene, rng), photo(shifted(scene, -90.0, 0.0), rng)
    corners = spread_corners(left, SETTINGS)
    corners = corners[corners[:, 0] > 120]
    known = match_pair(left, right, corners, SETTINGS, np.full(len(corners), 89.0, np.float32))[1]
    assert known.mean() > 0.9 > match_pair(left, right, corners, SETTINGS)[1].mean()


def test_any_kind_of_image_becomes_the_same_grey() -> None:
    rng = np.random.default_rng(12)
    r = Rectification(100.0, 48.0, 30.0, 0.2, (97, 61))
    gray = rng.integers(0, 256, (2, 61, 97), np.uint8)
    gray[0, 0, 0] = 255
    grey, deep = (gray_pair(RectifiedPair(*images, r)) for images in (gray, gray.astype(np.uint16) * 16))
    rgb = gray_pair(RectifiedPair(*(np.stack([g] * 3, -1) for g in gray), r))
    for i in range(2):
        np.testing.assert_array_equal(grey[i], gray[i])
        np.testing.assert_array_equal(deep[i], gray[i])
        np.testing.assert_array_equal(rgb[i], gray[i])


# --- what the rig itself is sure of -----------------------------------------------------------------------------------


def crooked_rig() -> StereoRig:
    left = Camera((641, 397), 517.0, 509.0, 331.8, 187.9, "brown_conrady", np.array([-0.2, 0.05, 2e-3, -1e-3, 0.0]))
    right = Camera((641, 397), 511.0, 519.0, 308.1, 203.2, "brown_conrady", np.array([-0.18, 0.04, -1e-3, 7e-4, 0.0]))
    turn = Rotation.from_rotvec((0.021, -0.034, 0.017)).as_matrix()
    return StereoRig(left, right, pose(turn, (0.205, 0.0113, -0.0071)))


def moved(rig: StereoRig, **by: float) -> StereoRig:
    names = [name.replace(".", "_") for name in rig_parameters(rig.left, rig.right)]
    delta = np.zeros(len(names))
    for name, value in by.items():
        delta[names.index(name)] = value
    return moved_rig(rig, delta)


def test_a_turned_camera_looks_turned_to_both_witnesses() -> None:
    rig = crooked_rig()
    assert np.abs(apparent_turn(rig, rig)).max() < 1e-9
    pitch, yaw, roll, epipolar_yaw = apparent_turn(rig, moved(rig, ry_rad=3e-4))
    assert (yaw, epipolar_yaw) == pytest.approx((3e-4, 3e-4), rel=0.02)
    assert abs(pitch) < 2e-5
    assert abs(roll) < 2e-5


def test_a_shifted_principal_point_looks_turned_to_one_witness_only() -> None:
    """As in the KITTI calibrations: compensated by a yaw it leaves disparities alone, but not their rows."""
    bent = crooked_rig()
    left, right = (replace(camera, lens="pinhole", distortion=np.zeros(0)) for camera in (bent.left, bent.right))
    rig = replace(bent, left=left, right=right)
    f = rig.right.fx_px
    shifted_center = apparent_turn(rig, moved(rig, right_cx_px=1.0))
    assert shifted_center[1] == pytest.approx(-1 / f, rel=0.15)
    assert abs(shifted_center[3]) < 0.15 / f
    compensated = apparent_turn(rig, moved(rig, right_cx_px=1.0, ry_rad=1 / f))
    assert abs(compensated[1]) < 0.15 / f
    assert compensated[3] == pytest.approx(1 / f, rel=0.15)


def sure_rig() -> StereoRig:
    """A rig with a covariance: small, correlated, and one parameter held fixed."""
    rig = crooked_rig()
    names = rig_parameters(rig.left, rig.right)
    scales = {"x_px": 0.2, "y_px": 0.15, "rad": 2e-4, "_m": 1e-4}
    sigma = np.array([next((s for end, s in scales.items() if name.endswith(end)), 2e-4) for name in names])
    mixed = np.random.default_rng(13).normal(size=(len(names), 2 * len(names)))
    correlation = mixed @ mixed.T / (2 * len(names))
    sigma[4] = 0
    return replace(rig, covariance=RigCovariance(names, correlation * np.outer(sigma, sigma)))


def test_what_the_rig_is_sure_of_is_what_sampling_says() -> None:
    rig = sure_rig()
    assert rig.covariance is not None
    root = np.linalg.cholesky(rig.covariance.matrix + 1e-24 * np.eye(len(rig.covariance.names)))
    rng = np.random.default_rng(14)
    draws = [apparent_turn(rig, moved_rig(rig, root @ rng.normal(size=len(root)))) for _ in range(100)]
    ratio = np.diag(np.cov(np.array(draws).T)) / turn_covariance(rig).diagonal()
    assert ((ratio > 0.6) & (ratio < 1.6)).all()
    assert np.isnan(turn_covariance(crooked_rig())).all()


def evidence(turn_deg: np.ndarray, sigma_deg: float = 1e-3, rig_cov: np.ndarray = UNTOLD, motions: int = 4) -> RigDrift:
    """What the monitor would measure."""
    turn, sigma = np.radians(turn_deg), np.radians(sigma_deg)
    stretches = [Stretch(turn[1], 2 * sigma, 0.0, np.zeros(3), 1.0)] * motions
    by_rows = epipolar.Turn(turn, np.eye(3) * sigma**2, 9000)
    return measure(by_rows, stretches, rig_cov, 30, TWINS)


def test_the_proposed_rig_is_the_true_one() -> None:
    rig = crooked_rig()
    true = replace(
        rig, T_left_right=pose(Rotation.from_rotvec((2e-4, -5e-4, 4e-4)).as_matrix(), (0, 0, 0)) @ rig.T_left_right
    )
    true = replace(true, T_left_right=pose(true.T_left_right[:3, :3], rig.T_left_right[:3, 3]))
    turn = apparent_turn(rig, true)[:3]
    proposed = proposed_rig(rig, evidence(np.degrees(turn)))
    between = Rotation.from_matrix(proposed.T_left_right[:3, :3].T @ true.T_left_right[:3, :3])
    assert between.magnitude() < 2e-6
    np.testing.assert_array_equal(proposed.T_left_right[:3, 3], rig.T_left_right[:3, 3])
    assert proposed.covariance is None


def test_the_proposal_keeps_what_is_unknown_and_adds_its_own_sigma() -> None:
    rig = sure_rig()
    assert rig.covariance is not None
    drift = evidence(np.array([0.02, 0.03, -0.01]), 0.004, motions=0)
    assert np.isnan(drift.yaw_deg)
    assert np.abs(apparent_turn(rig, proposed_rig(rig, drift))[:3] - np.radians([0.02, 0, -0.01])).max() < 2e-6
    known = proposed_rig(rig, evidence(np.array([0.02, 0.03, -0.01]), 0.004))
    assert known.covariance is not None
    grown = known.covariance.matrix - rig.covariance.matrix
    assert not grown[:-6].any()
    assert not grown[-3:].any()
    eigenvalues = np.linalg.eigvalsh(grown[-6:-3, -6:-3])
    np.testing.assert_allclose(np.degrees(np.sqrt(eigenvalues[[0, 1]])), 0.004, rtol=0.01)


# --- the verdict ------------------------------------------------------------------------------------------------------


def test_the_yaw_is_from_expansion_or_unknown() -> None:
    drift = evidence(np.array([0.0, 0.05, 0.0]))
    assert drift.yaw_deg == pytest.approx(0.05)
    assert drift.yaw_sigma_deg == pytest.approx(np.hypot(1e-3, np.degrees(0.025 / TWINS.f_px)))
    assert np.isnan(evidence(np.array([0.0, 0.05, 0.0]), motions=2).yaw_deg)


def test_vertical_disparities_tell_the_yaw_where_the_lenses_are_sure() -> None:
    sure = np.diag(np.radians([1e-3, 2e-3, 1e-3, 3e-3]) ** 2)
    drift = evidence(np.array([0.0, 0.05, 0.0]), 0.004, sure, motions=0)
    assert drift.yaw_deg == pytest.approx(0.05)
    assert drift.yaw_sigma_deg == pytest.approx(0.005)
    np.testing.assert_allclose(np.sqrt(drift.rig_cov_deg2.diagonal()), [1e-3, 2e-3, 1e-3])


def test_off_is_notable_and_beyond_both_sigmas() -> None:
    turned = np.array([0.03, 0.03, 0.03])  # 0.27, 0.27, 0.17 px
    assert is_off(evidence(turned), SETTINGS).all()
    assert not is_off(evidence(turned), SelfcheckSettings(notable_px=0.3)).any()
    assert not is_off(evidence(turned, 0.01), SETTINGS).any()
    doubtful = np.diag(np.radians([0.02, 0.001, 0.001, 0.1]) ** 2)
    assert is_off(evidence(turned, 1e-3, doubtful), SETTINGS).tolist() == [False, True, True]
    assert is_off(evidence(turned, motions=0), SETTINGS).tolist() == [True, False, True]


def test_words() -> None:
    drift = worded(evidence(np.array([0.03, -0.05, 0.0])), True, SETTINGS)
    assert drift.state == "moved"
    assert drift.reason.startswith(
        "the right camera looks 0.030 ± 0.001 deg further up, looks 0.050 ± 0.003 deg further to the left than the rig "
        "says: disparities are -0.45 px off, ranges +1.79 m at 20 m"
    )
    rolled = worded(evidence(np.array([0.0, 0.0, -0.05])), True, SETTINGS)
    assert rolled.reason.startswith("the right camera is turned 0.050 ± 0.001 deg counterclockwise against the rig")
    faded = worded(evidence(np.zeros(3)), True, SETTINGS)
    assert (faded.state, faded.reason) == ("moved", "the right camera has moved")
    fine = worded(evidence(np.zeros(3)), False, SETTINGS)
    assert (fine.state, fine.reason) == ("ok", "the cameras stand as the rig says")
    standing = worded(evidence(np.zeros(3), motions=1), False, SETTINGS)
    assert (standing.state, standing.reason) == (
        "unknown",
        "the yaw shows only while driving: 1 of 3 stretches seen",
    )
    vague = worded(evidence(np.zeros(3), 0.02), False, SETTINGS)
    assert (vague.state, vague.reason) == ("unknown", "offsets are known to 0.18 px only, not to 0.1 px")
    blind = worded(measure(epipolar.UNKNOWN, [], UNTOLD, 0, TWINS), False, SETTINGS)
    assert (blind.state, blind.reason[:20]) == ("unknown", "too few features in ")


def test_a_yaw_that_expansion_rules_out_is_laid_on_the_lenses() -> None:
    by_rows = epipolar.Turn(np.radians([0.0, -0.5, 0.0]), np.eye(3) * np.radians(0.01) ** 2, 9000)
    drift = measure(by_rows, [Stretch(0.0, 1e-5, 0.0, np.zeros(3), 1.0)] * 4, UNTOLD, 30, TWINS)
    assert abs(drift.yaw_deg) < 1e-9
    assert (
        "-0.500 deg, which image expansion rules out: the lens calibration is off"
        in worded(drift, False, SETTINGS).reason
    )


# --- the monitor ------------------------------------------------------------------------------------------------------


IDS: dict[bytes, int] = {}
"""Which point is seen at a position: a bumped rig's world goes on where the healthy one was."""


class World(NamedTuple):
    """A drive through static points, in place of images."""

    points: np.ndarray
    turn_rad: np.ndarray
    speed_m: float
    rng: np.random.Generator
    share: float
    ids: dict[bytes, int]

    def at(self, index: int) -> tuple[np.ndarray, np.ndarray]:
        return seen(self.points - (0, 0, self.speed_m * index), self.turn_rad)

    def noted(self, uv: np.ndarray, ids: np.ndarray) -> np.ndarray:
        uv = uv.astype(np.float32)
        self.ids.update({row.tobytes(): int(i) for row, i in zip(uv, ids, strict=True)})
        return uv

    def spread(self, index: int, _: object) -> np.ndarray:
        left, _right = self.at(index)
        depth = self.points[:, 2] - self.speed_m * index
        inside = ((left > 5) & (left < np.array(TWINS.size_px) - 5)).all(1) & (depth > 3)
        chosen = self.rng.permutation(np.flatnonzero(inside))[: int(170 * self.share)]
        return self.noted(left[chosen], chosen)

    def follow(self, _: int, index: int, points: np.ndarray, *__: object) -> tuple[np.ndarray, np.ndarray]:
        ids = np.array([self.ids[row.tobytes()] for row in points])
        depth = self.points[ids, 2] - self.speed_m * index
        left = self.at(index)[0][ids]
        good = (depth > 3) & ((left > 0) & (left < TWINS.size_px)).all(1) & (self.rng.random(len(ids)) > 0.05)
        return self.noted(left + self.rng.normal(0, 0.05, left.shape), ids), good

    def match(self, _: int, index: int, points: np.ndarray, *__: object) -> tuple[np.ndarray, np.ndarray]:
        ids = np.array([self.ids[row.tobytes()] for row in points], int)
        right = self.at(index)[1][ids] + self.rng.normal(0, 0.1, (len(ids), 2))
        lost = self.rng.random(len(ids)) < 0.05
        right[lost] += self.rng.uniform(-5, 5, (lost.sum(), 2))
        return right.astype(np.float32), np.ones(len(ids), bool)


def world(turn_deg: tuple[float, float, float], seed: int, speed_m: float = 0.8, share: float = 1.0) -> World:
    rng = np.random.default_rng(seed)
    near = street(900, rng)
    ahead = [near + np.array([0, 0, 12.0 * k]) for k in range(24)]
    return World(np.concatenate(ahead), np.radians(turn_deg), speed_m, rng, share, IDS)


def drive(
    monkeypatch: pytest.MonkeyPatch, scene: World, frames: int, watch: RigMonitor | None = None, start: int = 0
) -> list[RigDrift]:
    monkeypatch.setattr(monitor, "gray_pair", lambda pair: (pair.index, pair.index))
    monkeypatch.setattr(monitor, "spread_corners", scene.spread)
    monkeypatch.setattr(monitor, "follow", scene.follow)
    monkeypatch.setattr(monitor, "match_pair", scene.match)
    watch = watch or RigMonitor(crooked_rig())
    blank = np.zeros((397, 641), np.uint8)
    return [watch.update(RectifiedPair(blank, blank, TWINS, index)) for index in range(start, start + frames)]


def test_a_healthy_drive_raises_no_alarm(monkeypatch: pytest.MonkeyPatch) -> None:
    drifts = [d for seed in range(4) for d in drive(monkeypatch, world((0, 0, 0), seed), 40)]
    states = [d.state for d in drifts]
    assert "moved" not in states
    assert states.count("ok") > 60
    last = drifts[-1]
    assert (np.abs(last.turn_deg) < 4 * last.sigma_deg).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_fortieth_of_a_degree_is_found(monkeypatch: pytest.MonkeyPatch, seed: int) -> None:
    drifts = drive(monkeypatch, world((0, 0.04 * (-1) ** seed, 0), seed), 40)
    assert drifts[-1].state == "moved"
    assert drifts[-1].yaw_deg == pytest.approx(0.04 * (-1) ** seed, abs=4 * drifts[-1].yaw_sigma_deg)
    assert abs(drifts[-1].yaw_deg) > 3 * drifts[-1].yaw_sigma_deg


def test_an_alarm_waits_and_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = RigMonitor(crooked_rig(), SelfcheckSettings(frames=8, confirm=4))
    bumped = [d.state for d in drive(monkeypatch, world((0.1, 0, 0), 0), 12, watch)]
    assert bumped.index("moved") == 3
    repaired = [d.state for d in drive(monkeypatch, world((0, 0, 0), 0), 60, watch, 12)]
    assert repaired[0] == "moved"
    assert repaired[-1] == "ok"


def test_an_alarm_outlives_the_dark(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = RigMonitor(crooked_rig(), SelfcheckSettings(frames=8))
    drive(monkeypatch, world((0.1, 0, 0), 0), 12, watch)
    dark = drive(monkeypatch, world((0.1, 0, 0), 0, share=0.2), 12, watch, 12)
    assert np.isnan(dark[-1].turn_deg[0])
    assert (dark[-1].frames, dark[-1].state) == (0, "moved")
    assert dark[-1].reason == "the right camera has moved"


def test_the_dark_is_not_ok(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = RigMonitor(crooked_rig(), SelfcheckSettings(frames=8))
    assert drive(monkeypatch, world((0, 0, 0), 0), 20, watch)[-1].state == "ok"
    assert drive(monkeypatch, world((0, 0, 0), 0, share=0.2), 20, watch, 20)[-1].state == "unknown"


def test_few_features_are_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    drifts = drive(monkeypatch, world((0, 0.2, 0), 0, share=0.3), 20)
    assert {d.state for d in drifts} == {"unknown"}
    assert drifts[-1].frames == 0
    assert "too few features" in drifts[-1].reason


def test_a_standing_car_knows_no_yaw(monkeypatch: pytest.MonkeyPatch) -> None:
    drifts = drive(monkeypatch, world((0, 0.05, 0), 0, speed_m=0.0), 40)
    assert {d.state for d in drifts} == {"unknown"}
    assert "only while driving" in drifts[-1].reason


def test_features_on_one_side_know_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    everywhere = world((0, 0, 0), 0)
    left = everywhere.points[:, 0] < -0.45 * everywhere.points[:, 2]
    drifts = drive(monkeypatch, everywhere._replace(points=everywhere.points[left]), 12)
    assert drifts[-1].frames > 0
    assert drifts[-1].motions == 0
    assert np.isnan(drifts[-1].turn_deg).all()


def test_single_frames_are_not_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = RigMonitor(crooked_rig(), is_sequence=False)
    drifts = drive(monkeypatch, world((0, 0, 0), 0), 12, watch)
    assert drifts[-1].motions == 0
    assert drifts[-1].frames == 12


def test_turning_stretches_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = SelfcheckSettings(turning_deg=1e-6)
    drifts = drive(monkeypatch, world((0, 0, 0), 0), 20, RigMonitor(crooked_rig(), settings))
    assert drifts[-1].motions == 0


@pytest.mark.parametrize(("growth", "counts"), [(0.03, False), (0.3, True)])
def test_what_grows_fast_is_left_out(monkeypatch: pytest.MonkeyPatch, growth: float, counts: bool) -> None:
    """Everything stands between 9 and 16 m: it grows by 0.05 to 0.1 a frame."""
    used: list[int] = []
    monkeypatch.setattr(monitor, "fit_stretch", lambda first, *_: used.append(len(first)))
    scene = world((0, 0, 0), 0)
    depth = np.random.default_rng(16).uniform(9, 16, (len(scene.points), 1))
    scene = scene._replace(points=scene.points / scene.points[:, 2:] * depth)
    drive(monkeypatch, scene, 3, RigMonitor(crooked_rig(), SelfcheckSettings(growth=growth, closing=0.05)))
    assert bool(used) is counts


@pytest.mark.parametrize(("kept_share", "ends"), [(0.9, True), (0.01, False)])
def test_a_stretch_ends_where_too_few_are_left(monkeypatch: pytest.MonkeyPatch, kept_share: float, ends: bool) -> None:
    settings = SelfcheckSettings(closing=1.9, kept_share=kept_share)
    drifts = drive(monkeypatch, world((0, 0, 0), 0), 12, RigMonitor(crooked_rig(), settings))
    assert (drifts[-1].motions > 0) is ends


def test_another_rectification_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    watch = RigMonitor(crooked_rig())
    drive(monkeypatch, world((0, 0, 0), 0), 1, watch)
    blank = np.zeros((397, 641), np.uint8)
    with pytest.raises(ValueRefusedError, match=r"^frame 0 is rectified otherwise than the frames before: give each"):
        watch.update(RectifiedPair(blank, blank, replace(TWINS), 1))


def test_dark_images_are_unknown() -> None:
    watch = RigMonitor(crooked_rig())
    dark = np.random.default_rng(15).integers(0, 3, (2, 397, 641), np.uint8)
    drift = [watch.update(RectifiedPair(*dark, TWINS, index)) for index in range(3)][-1]
    assert drift.state == "unknown"
    assert not is_sure(drift, SETTINGS)
