"""The verdict: one calibration, spoiled in one number at a time."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_examples import FLAT, example_rig

from roadblock.stages.calibrate.verdict import graded, judged
from roadblock.values.board import Board
from roadblock.values.calibration import Calibration, CameraFit, Coverage, ViewFit

RIG = example_rig(size_px=(640, 480))
MATCHING_M = 400 / (RIG.left.fx_px * RIG.baseline_m) * 0.1


def view(name: str, left_out: str = "", *, right: bool = True, wrong: int = 0, pose: bool = True) -> ViewFit:
    weight = np.r_[np.full(wrong, 0.1), np.full(54 - wrong, 1.0)]
    nothing = np.full(54, np.nan)
    residual = np.zeros((54, 2))
    return ViewFit(
        name, np.eye(4) if pose else None, residual, residual, weight, np.ones(54) if right else nothing, left_out
    )


def camera(sigma_px: float = 0.02, expected_sigma_px: float = 0.015) -> CameraFit:
    return CameraFit(RIG.left, 1.4 * sigma_px, sigma_px, expected_sigma_px, np.zeros((8, 2)), np.zeros((8, 2)))


def healthy(**changes: Any) -> Calibration:
    ranges = {z: np.full((5, 7), 0.3 * MATCHING_M * (z / 20) ** 2) for z in (5.0, 10.0, 20.0, 40.0)}
    coverage = Coverage(np.ones((6, 8)), np.ones((6, 8)), np.ones(12), np.zeros((12, 2)))
    found = Calibration(
        RIG, FLAT, np.zeros(54), np.zeros(54), tuple(view(f"{i:02d}") for i in range(12)), (camera(), camera()), (),
        0.03, (0.021, 0.022), 0.03, 1.0, ranges, coverage, "refused",
    )  # fmt: skip
    return replace(found, **changes)


def ranges(share: float) -> dict[float, np.ndarray]:
    sigma_m = np.full((5, 7), share * MATCHING_M)
    sigma_m[:, 0], sigma_m[:, 6] = np.nan, 100 * MATCHING_M  # unseen, and at the image's border
    return {20.0: sigma_m}


def covered(empty: int) -> Coverage:
    counts = np.ones((6, 8))
    for row, column in [(0, 0), (0, 3), (0, 5), (2, 0), (2, 5), (4, 0), (4, 3)][:empty]:
        counts[row : row + 2, column : column + 3 - (column == 3)] = 0
    return Coverage(np.ones((6, 8)), counts, np.ones(3), np.zeros((3, 2)), ("nothing at the top",))


def test_a_healthy_calibration_is_good_and_says_what_it_costs() -> None:
    calibration = judged(healthy())
    assert calibration.verdict == "good"
    (said,) = calibration.reasons
    assert said.startswith(f"at 20 m calibration leaves {0.3 * MATCHING_M:.2g} m of range error")
    assert said.endswith(f"matching to 0.1 px leaves {MATCHING_M:.2g} m")


VIEWS = [view(f"{i:02d}") for i in range(12)]
CASES: list[tuple[str, dict[str, Any], str]] = [
    ("usable", {"range_sigma_m": ranges(1.5)}, "leaves .* m of range error .*: take more views"),
    ("refused", {"range_sigma_m": ranges(6.0)}, "of range error"),
    ("refused", {"range_sigma_m": ranges(6.0), "coverage": covered(1)}, "of range error .*: nothing at the top"),
    ("refused", {"range_sigma_m": {20.0: np.full((5, 7), np.nan)}}, "range error at 20 m is unknown"),
    ("usable", {"views": tuple(VIEWS[:9])}, "only 9 pairs were used"),
    ("refused", {"views": tuple(VIEWS[:4])}, "only 4 pairs were used"),
    ("usable", {"views": (*VIEWS[:6], *(view(f"r{i}", right=False) for i in range(6)))}, "only 6 pairs were used"),
    ("usable", {"views": (*VIEWS, *(view(f"x{i}", "moved") for i in range(4)))}, "4 of 16 views disagree"),
    ("refused", {"views": (*VIEWS, *(view(f"x{i}", "moved") for i in range(6)))}, "6 of 18 views disagree"),
    ("good", {"views": (*VIEWS, *(view(f"x{i}", "few", pose=False) for i in range(6)))}, "calibration leaves"),
    ("good", {"views": (*VIEWS, view("bad", wrong=3))}, "3 of 1404 corners are wrong .* in view bad"),
    ("usable", {"views": (*VIEWS, view("bad", wrong=40))}, "40 of 1404 corners are wrong"),
    ("refused", {"views": tuple(view(f"w{i}", wrong=15) for i in range(12))}, "180 of 1296 corners are wrong"),
    ("usable", {"cameras_alone": (camera(0.06, 0.015), camera())}, "left camera's residuals .* are 4.0 times"),
    ("refused", {"cameras_alone": (camera(), camera(0.5, 0.015))}, "right camera's residuals .* are 33.3 times"),
    ("usable", {"sigma_px": (0.02, 0.05)}, "not taken at the same moment.*right camera alone fits to 0.02 px"),
    ("refused", {"sigma_px": (0.2, 0.2)}, "not taken at the same moment.*left camera alone fits to 0.02 px"),
    ("refused", {"sigma_px": (float("nan"), 0.02)}, "not taken at the same moment"),
    ("good", {"coverage": covered(2)}, "calibration leaves"),
    ("usable", {"coverage": covered(3)}, "3 of 9 areas of the right image show no point"),
    ("refused", {"coverage": covered(6)}, "6 of 9 areas of the right image show no point"),
    ("usable", {"inflation": 3.0}, "standard deviations were widened 3.0 times"),
    ("refused", {"inflation": 7.0}, "standard deviations were widened 7.0 times"),
    ("good", {"board": Board("chessboard", 9, 6, 0.25)}, "span 2000 x 1250 mm, which is unusual"),
    ("good", {"board": Board("chessboard", 9, 6, 0.0025)}, "span 20 x 12.5 mm, which is unusual"),
]


@pytest.mark.parametrize(("verdict", "changes", "said"), CASES)
def test_each_sign_of_trouble_is_named_and_weighed(verdict: str, changes: dict[str, Any], said: str) -> None:
    calibration = judged(healthy(**changes))
    assert calibration.verdict == verdict
    assert calibration.reasons
    first = calibration.reasons if verdict == "good" else calibration.reasons[:1]
    assert any(re.search(said, reason) for reason in first), calibration.reasons


def test_the_worst_decides_and_comes_first() -> None:
    calibration = judged(healthy(inflation=3.0, views=tuple(VIEWS[:4])))
    assert calibration.verdict == "refused"
    assert calibration.reasons[0].startswith("only 4 pairs")
    assert calibration.reasons[1].startswith("residuals within a view")
    assert len(calibration.reasons) == 3


def test_grades() -> None:
    assert [graded(x, (1, 5)) for x in (0.0, 1.0, 1.01, 5.0, 5.01, float("nan"))] == [
        "good", "good", "usable", "usable", "refused", "refused",
    ]  # fmt: skip
