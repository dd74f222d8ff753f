"""Calibrate: whether a calibration can be trusted, and why (not), in words.

What counts is the predicted range error, against what matching alone would leave. The covariance behind it is right
only if the model is, so signs of a wrong model count, too. Each check speaks for itself; the worst decides.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from roadblock.stages.calibrate.coverage import empty_areas
from roadblock.values.calibration import Calibration
from roadblock.values.camera import Verdict

Finding = tuple[Verdict, str]
SIDES = ("left", "right")

JUDGED_AT_M = 20.0
MATCHING_PX = 0.1
"""Disparity noise of good matching, what calibration is held against."""

RANGE_SHARE = (1.0, 5.0)
"""Range error of calibration over that of matching: up to the first, calibration does not dominate; beyond the second,
half a pixel of disparity, even a coarse matcher would be better than its rig."""

MISFIT = (3.0, 20.0)
"""Residuals over what the corner fits expect. The covariance is made of the residuals, not of what was expected, so a
misfit is honestly paid for as long as the model's error looks like noise."""

TOGETHER = (2.0, 5.0)
"""Residuals of both cameras together over those of each alone."""

FEWEST_PAIRS = (10, 5)
"""From so many pairs on their scatter tells how sure the result is; with fewer than the second it tells nothing."""

LEFT_OUT = (0.2, 0.3)
"""Share of the views that disagree with the others."""

WRONG_CORNERS = (0.02, 0.1)
"""Share of the corners of used views that the robust fit discarded."""

WRONG_WEIGHT = 0.3
"""Weight of a corner that is about 6 standard deviations off."""

EMPTY_AREAS = (2, 5)
"""Of 3x3 areas of an image those without points; there the lens is extrapolated."""

INFLATION = (2.0, 5.0)
BOARD_M = (0.05, 1.5)
"""What a board's longer side usually measures."""


def judged(calibration: Calibration) -> Calibration:
    """Return a calibration with its verdict and the reasons; the range error is always among them."""
    findings = [finding for check in CHECKS for finding in check(calibration)]
    worst = max((verdict for verdict, _ in findings), key=LEVELS.index)
    ordered = sorted(findings, key=lambda finding: -LEVELS.index(finding[0]))
    return replace(calibration, verdict=worst, reasons=tuple(sentence for _, sentence in ordered))


LEVELS: tuple[Verdict, ...] = ("good", "usable", "refused")


def graded(value: float, limits: tuple[float, float]) -> Verdict:
    """Return "good" up to the first limit, "usable" up to the second, else "refused"; NaN is refused."""
    return LEVELS[(not value <= limits[0]) + (not value <= limits[1])]


def _range_error(c: Calibration) -> Iterator[Finding]:
    sigma_m = c.range_sigma_m[JUDGED_AT_M]
    if np.isnan(sigma_m).all():
        yield "refused", f"the range error at {JUDGED_AT_M:g} m is unknown: the cameras share no view that far away"
        return
    matching_m = JUDGED_AT_M**2 / (c.rig.left.fx_px * c.rig.baseline_m) * MATCHING_PX
    # Not the mean: the image's corners, where few boards come, would drown all the rest.
    middle_m = float(np.nanmedian(sigma_m))
    level = graded(middle_m / matching_m, RANGE_SHARE)
    said = f"at {JUDGED_AT_M:g} m calibration leaves {middle_m:.2g} m of range error (1 sigma, median over the image), "
    said += f"matching to {MATCHING_PX:g} px leaves {matching_m:.2g} m"
    yield level, said if level == "good" else f"{said}: {'; '.join(c.coverage.missing) or 'take more views'}"


def _misfit(c: Calibration) -> Iterator[Finding]:
    for side, alone in zip(SIDES, c.cameras_alone, strict=True):
        share = alone.sigma_px / alone.expected_sigma_px
        level = graded(share, MISFIT)
        if level != "good":
            yield (
                level,
                f"the {side} camera's residuals ({alone.sigma_px:.2g} px) are {share:.1f} times what its corner fits "
                f"expect ({alone.expected_sigma_px:.2g} px): blur, a board that bends, or a lens beyond the model",
            )


def _moments(c: Calibration) -> Iterator[Finding]:
    for side, sigma_px, alone in zip(SIDES, c.sigma_px, c.cameras_alone, strict=True):
        level = graded(sigma_px / alone.sigma_px, TOGETHER)
        if level != "good":
            yield (
                level,
                "left and right were not taken at the same moment, or the rig changed in between: the "
                f"{side} camera alone fits to {alone.sigma_px:.2g} px, with the other one only to {sigma_px:.2g} px; "
                "hold the board still, or synchronise the cameras",
            )
            return


def _views(c: Calibration) -> Iterator[Finding]:
    pairs = sum(bool((v.weight_left >= 0).any() and (v.weight_right >= 0).any()) for v in c.used)
    level = graded(-pairs, (-FEWEST_PAIRS[0], -FEWEST_PAIRS[1]))
    if level != "good":
        yield level, f"only {pairs} pairs were used: take {2 * FEWEST_PAIRS[0]} or more"
    disagree = sum(bool(v.left_out) and v.T_left_board is not None for v in c.views)
    level = graded(disagree / len(c.views), LEFT_OUT)
    if level != "good":
        yield (
            level,
            f"{disagree} of {len(c.views)} views disagree with the others and were left out: see each one's reason",
        )


def _corners(c: Calibration) -> Iterator[Finding]:
    wrong = {v.name: int((np.r_[v.weight_left, v.weight_right] < WRONG_WEIGHT).sum()) for v in c.used}
    seen = sum(int((np.r_[v.weight_left, v.weight_right] >= 0).sum()) for v in c.used)
    count = sum(wrong.values())
    if count:
        most = max(wrong, key=wrong.__getitem__)
        said = f"{count} of {seen} corners are wrong and were discarded, most of them in view {most}"
        yield graded(count / seen, WRONG_CORNERS), said


def _coverage(c: Calibration) -> Iterator[Finding]:
    for side, counts in zip(SIDES, (c.coverage.left_counts, c.coverage.right_counts), strict=True):
        empty = len(empty_areas(counts))
        level = graded(empty, EMPTY_AREAS)
        if level != "good":
            yield level, f"{empty} of 9 areas of the {side} image show no point: there the lens is only extrapolated"


def _inflation(c: Calibration) -> Iterator[Finding]:
    level = graded(c.inflation, INFLATION)
    if level != "good":
        yield (
            level,
            f"residuals within a view hang together: standard deviations were widened {c.inflation:.1f} times: "
            "the model (lens, board, moment) is not quite right",
        )


def _board(c: Calibration) -> Iterator[Finding]:
    width, height = c.board.size_m
    low, high = BOARD_M
    if not low <= max(width, height) <= high:
        yield (
            "good",
            f"the board's points span {1e3 * width:g} x {1e3 * height:g} mm, which is unusual; if its squares are not "
            f"{1e3 * c.board.square_m:g} mm wide, all ranges are wrong by that factor",
        )


CHECKS: tuple[Callable[[Calibration], Iterator[Finding]], ...] = (
    _range_error,
    _views,
    _corners,
    _misfit,
    _moments,
    _coverage,
    _inflation,
    _board,
)
