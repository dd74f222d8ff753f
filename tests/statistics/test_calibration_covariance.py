"""What a calibration says of its own errors, against errors sampled: one set of views, solved again and again.

The bars (variances within 15 %, range sigmas within 20 %, 63 to 73 % inside of one sigma) are those of the 200
solutions of `benchmarks/accuracy/calibration.py --part sampled`; here they are widened by what chance does to fewer.
"""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.stats import chi2, norm

from roadblock.geometry.pose import inverse, rotvec_from_rotation, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.geometry.uncertainty import calibration_cov, seen_points
from roadblock.sim.boards import board_truth, built_rig, calibration_poses
from roadblock.stages.calibrate.bundle import solve_camera, solve_rig
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray

BOARD = Board("chessboard", 8, 5, 0.03)
RIG = built_rig(np.random.default_rng(4))
VIEWS, SOLUTIONS = 12, 28
NOISE_PX, TOLD_PX = 0.05, 0.1
"""Corners are said to be twice as noisy as they are: the solver has to find out."""

BOW_M = 2e-4
CHANCE = 1e-3
"""How often a right covariance may fail a comparison."""

RANGES_M = (5.0, 20.0, 40.0)


@dataclass(frozen=True)
class Samples:
    """Errors of the parameters (n, 24) and their predicted covariances; the same of ranges, (n, ranges, points)."""

    errors: FloatArray
    covs: FloatArray
    range_errors_m: FloatArray
    range_sigmas_m: FloatArray


@pytest.fixture(scope="module")
def samples() -> Samples:
    poses = calibration_poses(RIG, BOARD, np.random.default_rng(5), VIEWS)
    truths = [board_truth(RIG, BOARD, T, BOW_M) for T in poses]
    far = np.stack([seen_points(RIG, z, 3, 5).reshape(-1, 3) for z in RANGES_M])
    far = far[:, np.isfinite(far).all((0, 2))]
    rows = [solved(truths, far, np.random.default_rng([6, k])) for k in range(SOLUTIONS)]
    return Samples(*(np.stack(column) for column in zip(*rows, strict=True)))


def solved(truths, far: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, ...]:
    ids, told = np.arange(len(BOARD.points_m)), np.full(len(BOARD.points_m), TOLD_PX)
    pairs = [(truth.left_px, truth.right_px) for truth in truths]
    views = [
        BoardView(str(i), *(Sighting(ids, px + rng.normal(0, NOISE_PX, px.shape), told) for px in pair))
        for i, pair in enumerate(pairs)
    ]
    lens = BOARD, RIG.left.size_px, "brown_conrady5"
    alone = (
        solve_camera([view.left for view in views], *lens, RIG.left),
        solve_camera([view.right for view in views], *lens, RIG.right),
    )
    found = solve_rig(views, *lens, *alone).rig
    assert found.covariance is not None
    errors = np.stack([triangulated(found, points) - points[:, 2] for points in far])
    sigmas = np.sqrt(np.stack([calibration_cov(found, points)[:, 2, 2] for points in far]))
    return difference(found), found.covariance.matrix, errors, sigmas


def triangulated(rig: StereoRig, points_car: FloatArray) -> FloatArray:
    """Forward distances that a rig sees at the true pixels of points, from the angles between its rectified rays."""
    R_left, _ = rectifying_rotations(RIG.T_left_right)
    in_left = (points_car + np.array([RIG.baseline_m / 2, 0, 0])) @ R_left
    pixels = project(RIG.left, in_left), project(RIG.right, transform(inverse(RIG.T_left_right), in_left))
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    left, right = unproject(rig.left, pixels[0]) @ R_left.T, unproject(rig.right, pixels[1]) @ R_right.T
    return rig.baseline_m / (left[:, 0] / left[:, 2] - right[:, 0] / right[:, 2])


def difference(found: StereoRig) -> FloatArray:
    """Found minus true parameters in their order; the turn as `exp([r]) R`."""
    parts = [
        np.r_[a.fx_px - b.fx_px, a.fy_px - b.fy_px, a.cx_px - b.cx_px, a.cy_px - b.cy_px, a.distortion - b.distortion]
        for a, b in ((found.left, RIG.left), (found.right, RIG.right))
    ]
    turn = rotvec_from_rotation(found.T_left_right[:3, :3] @ RIG.T_left_right[:3, :3].T)
    return np.concatenate([*parts, turn, found.T_left_right[:3, 3] - RIG.T_left_right[:3, 3]])


def limits(freedom: int, bar: float, tests: int = 1) -> tuple[float, float]:
    """What the mean of `freedom` squares may be over its expectation, `bar` off and by chance as well."""
    low, high = chi2.ppf([CHANCE / 2 / tests, 1 - CHANCE / 2 / tests], freedom) / freedom
    return (1 - bar) * low, (1 + bar) * high


def eigen_ratios(samples: Samples, block: slice) -> FloatArray:
    """Sampled over predicted variances along the axes of the predicted covariance (of unit-free parameters)."""
    predicted = samples.covs[:, block, block].mean(0)
    scale = np.sqrt(predicted.diagonal())
    values, axes = np.linalg.eigh(predicted / np.outer(scale, scale))
    return np.asarray((samples.errors[:, block] / scale @ axes) ** 2).mean(0) / values


@pytest.mark.parametrize("block", [slice(0, 18), slice(18, 24)], ids=["intrinsics", "pose"])
def test_errors_have_the_predicted_covariance(samples: Samples, block: slice) -> None:
    ratios = eigen_ratios(samples, block)
    low, high = limits(SOLUTIONS * len(ratios), 0.15)
    assert low < ratios.mean() < high
    low, high = limits(SOLUTIONS, 0.15, tests=len(ratios))
    assert ratios.min() > low
    assert ratios.max() < high


def test_the_whole_covariance_hangs_together(samples: Samples) -> None:
    whitened = [e @ np.linalg.solve(C, e) for e, C in zip(samples.errors, samples.covs, strict=True)]
    low, high = limits(SOLUTIONS * 24, 0.15)
    assert low < np.mean(whitened) / 24 < high


@pytest.mark.parametrize("at", range(len(RANGES_M)))
def test_ranges_err_as_predicted(samples: Samples, at: int) -> None:
    errors, sigmas = samples.range_errors_m[:, at], samples.range_sigmas_m[:, at]
    low, high = np.sqrt(limits(SOLUTIONS, 0.0))  # the points of one solution hang together: one freedom each
    ratio = np.sqrt((errors**2).mean() / (sigmas**2).mean())
    assert 0.8 * low < ratio < 1.2 * high


@pytest.mark.parametrize("at", range(len(RANGES_M)))
def test_one_sigma_holds_two_thirds(samples: Samples, at: int) -> None:
    share = (np.abs(samples.range_errors_m[:, at]) < samples.range_sigmas_m[:, at]).mean()
    chance = norm.ppf(1 - CHANCE / 2) * np.sqrt(0.68 * 0.32 / SOLUTIONS)
    assert 0.63 - chance < share < 0.73 + chance


def test_noise_told_twice_too_high_is_found_out(samples: Samples) -> None:
    """With the corners' word taken for it, variances would be four times too large."""
    assert eigen_ratios(samples, slice(0, 24)).mean() > 0.5
