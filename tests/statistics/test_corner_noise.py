"""How near found corners are to the truth on rendered boards, and whether their own sigma says so."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadblock.sim.boards import SENSOR, board_truth, built_rig, calibration_poses, render_board
from roadblock.stages.calibrate.detect import find_board
from roadblock.values.board import Board

BOARD = Board("chessboard", 9, 6, 0.025)
RIG = built_rig(np.random.default_rng(8))
VIEWS = 4
STOP = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 100, 1e-4)

SENSORS = {"curved": SENSOR, "linear": replace(SENSOR, gamma=1.0, full_well_e=13_000)}
"""Both have two grey levels of noise at mid grey."""

BAR_PX = 0.012
"""A curved sensor widens the white side of a blurred edge: a model without its curve leaves 0.016 px."""


@pytest.fixture(scope="module", params=SENSORS)
def found(request) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Errors of our corners and of OpenCV's, (n, 2) pixels, and our sigmas (n,)."""
    ours, theirs, sigmas = [], [], []
    for i, T in enumerate(calibration_poses(RIG, BOARD, np.random.default_rng(9), VIEWS)):
        pair = render_board(RIG, BOARD, T, np.random.default_rng([10, i]), sensor=SENSORS[request.param])
        truth = board_truth(RIG, BOARD, T)
        for image, true_px in ((pair.left, truth.left_px), (pair.right, truth.right_px)):
            sighting = find_board(image, BOARD)
            assert sighting is not None
            ours.append(sighting.points_px - true_px[sighting.ids])
            sigmas.append(sighting.sigma_px)
            start = np.rint(true_px).astype(np.float32).reshape(-1, 1, 2)
            refined = cv2.cornerSubPix(np.ascontiguousarray(image), start, (5, 5), (-1, -1), STOP)
            theirs.append(refined.reshape(-1, 2) - true_px)
    return np.concatenate(ours), np.concatenate(theirs), np.concatenate(sigmas)


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt((errors**2).mean()))


def test_corners_reach_the_bar_and_leave_opencv_behind(found) -> None:
    ours, theirs, _ = found
    assert len(ours) > 0.95 * 2 * VIEWS * len(BOARD.points_m)
    assert rms(ours) <= BAR_PX
    assert rms(theirs) > 2 * rms(ours)


def test_no_corner_is_wrong(found) -> None:
    ours, *_ = found
    assert np.abs(ours).max() < 0.1


def test_corners_have_no_bias(found) -> None:
    ours, *_ = found
    sigma_of_mean = ours.std(0) / np.sqrt(len(ours))
    assert (np.abs(ours.mean(0)) < 4 * sigma_of_mean).all()


def test_their_own_sigma_tells_the_error(found) -> None:
    ours, _, sigmas = found
    typical = np.median(np.hypot(*ours.T) / sigmas) / np.sqrt(2 * np.log(2))
    assert 0.7 < typical < 1.4
