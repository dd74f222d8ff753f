"""`match` against OpenCV called by hand: same numbers where OpenCV answers, plus the left strip it leaves out."""

import cv2
import numpy as np
import pytest

from roadblock.stages.match import MatchSettings, match
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair

WIDTH, HEIGHT, DISPARITIES = 301, 83, 64


def slanted_pair() -> tuple[np.ndarray, np.ndarray]:
    """A textured road: disparity grows from 4 px at the top to 40 px at the bottom."""
    noise = np.random.default_rng(4).normal(size=(HEIGHT, WIDTH + 60)).astype(np.float32)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.3)
    wall = 128 + wall * (50 / wall.std())
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float32), np.arange(HEIGHT, dtype=np.float32))
    right = cv2.remap(wall, u + 4 + 36 * v / (HEIGHT - 1), v, cv2.INTER_CUBIC)
    return tuple(np.clip(i, 0, 255).astype(np.uint8) for i in (wall[:, :WIDTH], right))  # type: ignore[return-value]


LEFT, RIGHT = slanted_pair()


def ours(settings: MatchSettings) -> np.ndarray:
    rectification = Rectification(150.0, 140.3, 40.2, 0.2, (WIDTH, HEIGHT))
    return match(RectifiedPair(LEFT, RIGHT, rectification), settings).d_px


def test_block_matching_agrees_with_opencv_to_the_bit_beyond_the_strip() -> None:
    theirs = cv2.StereoBM.create(DISPARITIES, 9)
    theirs.setUniquenessRatio(10)
    theirs.setSpeckleWindowSize(0)
    theirs.setDisp12MaxDiff(1)
    units = theirs.compute(LEFT, RIGHT)
    d = ours(MatchSettings(matcher="bm", disparities=DISPARITIES, block_px=9, speckle_px=0))
    beyond = np.s_[:, DISPARITIES + 5 : -5]
    both = (units[beyond] > 0) & np.isfinite(d[beyond])
    assert both.mean() > 0.5
    np.testing.assert_array_equal(d[beyond][both] * 16, units[beyond][both])
    assert ((units[beyond] > 0) == np.isfinite(d[beyond])).mean() > 0.98


@pytest.mark.parametrize(
    ("mode", "flag"),
    [
        ("3way", cv2.STEREO_SGBM_MODE_SGBM_3WAY),
        ("sgbm", cv2.STEREO_SGBM_MODE_SGBM),
        ("hh", cv2.STEREO_SGBM_MODE_HH),
        ("hh4", cv2.STEREO_SGBM_MODE_HH4),
    ],
)
def test_semi_global_matching_agrees_with_opencv_beyond_the_strip(mode: str, flag: int) -> None:
    theirs = cv2.StereoSGBM.create(0, DISPARITIES, 5, 8 * 25, 32 * 25, 1, 31, 7, 50, 1, flag)
    units = theirs.compute(LEFT, RIGHT)
    settings = MatchSettings.model_validate(
        {"mode": mode, "disparities": DISPARITIES, "block_px": 5, "uniqueness_percent": 7, "speckle_px": 50}
    )
    d = ours(settings)
    beyond = np.s_[:, DISPARITIES + 10 :]
    both = (units[beyond] > 0) & np.isfinite(d[beyond])
    assert both.mean() > 0.85
    # The paths come from further left here; hardly a pixel notices.
    assert (np.abs(d[beyond][both] - units[beyond][both] / 16) <= 1 / 16).mean() > 0.99
    assert (units[:, : DISPARITIES - 1] <= 0).all(), "OpenCV began to fill the strip: padding is needed no more"
    assert np.isfinite(d[:25, 16:DISPARITIES]).mean() > 0.8


def test_the_disparities_are_the_true_ones_below_a_sixteenth_on_average() -> None:
    truth = 4 + 36 * np.arange(HEIGHT)[:, None] / (HEIGHT - 1) * np.ones((1, WIDTH))
    error = ours(MatchSettings(disparities=DISPARITIES)) - truth
    # Row v of the right image shows column u + shift, so a column of the left one is found at u - shift.
    assert abs(np.nanmedian(error)) < 1 / 16
    assert np.nanmedian(np.abs(error)) < 0.2
