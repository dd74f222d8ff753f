"""Calibrate: the lens model, by evidence: how well each one predicts views that it was not fitted to.

More coefficients always fit better. Whether they know the lens better shows only in views that were left out of the
fit: their boards' poses are found anew with everything else fixed, by both cameras at once, so that a wrong lens has
nowhere to hide.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadblock.geometry.projection import unproject
from roadblock.geometry.uncertainty import range_sigma
from roadblock.stages.calibrate.adjust import Mask
from roadblock.stages.calibrate.bundle import CameraSolution, RigSolution, solve_camera, solve_rig
from roadblock.stages.calibrate.start import LENSES
from roadblock.values.board import Board, BoardView
from roadblock.values.calibration import LensTrial
from roadblock.values.camera import Camera
from roadblock.values.checks import FloatArray

TRIALS = ("brown_conrady5", "kannala_brandt", "brown_conrady8")
"""In order of preference: the usual one, then the fewest parameters first."""

FOLDS = 4
FEWEST_PAIRS = 8
"""With fewer, what is left for a fit says little about the lens."""

CAP = 4.0
"""Residuals of held-out views count as at most so many sigma."""

EXPLODES = 3.0
"""A lens that leaves ranges so many times as uncertain as the surest one is not supported by the views."""

MOST_LOST = 0.01
"""Share of the image over which a lens may fold back: the far corners, which no board reaches."""

OVERRULED = 1.2
"""If all lenses that are not refused predict so much worse (mean square), a refused one is still the better one."""

NEGLIGIBLE = 0.02
"""Differences of the mean square by less than this share, 1 % of the residuals' length, are none."""

JUDGED_AT_M = 20.0

Progress = Callable[[int, int], None]
"""Called with how many lenses were tried, and how many there are."""


@dataclass(frozen=True, eq=False)
class _Trial:
    lens: str
    alone: tuple[CameraSolution, CameraSolution]
    full: RigSolution
    folds: tuple[RigSolution, ...] = ()

    @property
    def held_out_px(self) -> FloatArray:
        """(2, views, n, 2) residuals of each view in the fold that did not fit it; NaN where there is none."""
        out = np.full_like(self.full.residual_px, np.nan)
        for fold, solution in enumerate(self.folds):
            out[:, fold :: len(self.folds)] = solution.residual_px[:, fold :: len(self.folds)]
        return out


def choose_lens(
    views: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    progress: Progress | None = None,
    use: Mask | None = None,
) -> tuple[str, tuple[LensTrial, ...]]:
    """Choose the lens model that predicts held-out views best, or a simpler one that does so nearly as well.

    Nearly: within one standard error of the difference, which follows from how the views differ in it. A lens that
    folds inside the image, or that the views leave so open that ranges become uncertain, is refused, unless all
    others are plainly wrong.

    Parameters
    ----------
    views, board, size_px
        As in `solve_rig`.
    progress
        Told after every lens.
    use
        (views,) which ones to look at; all if None.

    Returns
    -------
    One of `LENSES`, and the evidence for each; with few views the usual lens, and its trial alone.

    Raises
    ------
    CalibrationError
        If there are too few views for any rig.
    RigError
        If what comes out is no rig: swapped cameras, an impossible baseline.
    """
    views = [view for i, view in enumerate(views) if use is None or use[i]]
    views.sort(key=lambda view: view.left is None or view.right is None)  # pairs first: every fold gets its share
    pairs = sum(view.left is not None and view.right is not None for view in views)
    if pairs < FEWEST_PAIRS:
        trial = _trial(TRIALS[0], views, board, size_px, 0)
        words = f"the usual lens; {pairs} pairs are too few to compare lenses ({FEWEST_PAIRS} or more are needed)"
        return TRIALS[0], (_evidence(trial, np.nan, words),)
    trials: list[_Trial] = []
    for name in TRIALS:
        trials.append(_trial(name, views, board, size_px, FOLDS, trials[0].alone if trials else None))
        if progress is not None:
            progress(len(trials), len(TRIALS))
    return _decide(trials)


def _trial(
    lens: str,
    views: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    folds: int,
    before: tuple[CameraSolution, CameraSolution] | None = None,
) -> _Trial:
    starts = [_start(solution.camera, lens) for solution in before] if before else [None, None]
    left = solve_camera([view.left for view in views], board, size_px, lens, starts[0])
    right = solve_camera([view.right for view in views], board, size_px, lens, starts[1])
    full = solve_rig(views, board, size_px, lens, left, right)
    fold = np.arange(len(views)) % max(folds, 1)
    parts = [solve_rig(views, board, size_px, lens, left, right, use=fold != part, start=full) for part in range(folds)]
    return _Trial(lens, (left, right), full, tuple(parts))


def _start(camera: Camera, lens: str) -> Camera | None:
    """Return a camera of the same model with more coefficients, 0; None where models differ."""
    model, count = LENSES[lens]
    if model != camera.lens:
        return None
    return replace(camera, distortion=np.r_[camera.distortion, np.zeros(count - len(camera.distortion))])


def _decide(trials: Sequence[_Trial]) -> tuple[str, tuple[LensTrial, ...]]:
    """Return the simplest lens that predicts held-out views as well as the best one, and what is said of each."""
    cap_px = CAP * min(max(trial.full.sigma_px) for trial in trials)
    losses = np.stack([_view_losses(trial, cap_px) for trial in trials])
    losses = losses[:, ~np.isnan(losses).any(0)]
    scores = losses.mean(1)
    refused = [_refused(trial, trials) for trial in trials]
    sound = [score for score, why in zip(scores, refused, strict=True) if not why]
    if min(sound, default=np.inf) > OVERRULED * scores.min():
        refused = [""] * len(trials)
    allowed = [i for i, why in enumerate(refused) if not why]
    best = min(allowed, key=lambda i: scores[i])
    errors = (losses - losses[best]).std(1, ddof=1) / np.sqrt(losses.shape[1])
    slack = np.maximum(errors, NEGLIGIBLE * scores[best])
    chosen = next(i for i in allowed if scores[i] - scores[best] <= slack[i])
    words = [why or _words(i, chosen, scores) for i, why in enumerate(refused)]
    told = [_evidence(trial, score, said) for trial, score, said in zip(trials, scores, words, strict=True)]
    return trials[chosen].lens, tuple(told)


def _words(lens: int, chosen: int, scores: FloatArray) -> str:
    if lens == chosen:
        best = scores[lens] <= scores.min()
        return "chosen: it predicts held-out views best" if best else "chosen: as good as the best, and simpler"
    if scores[lens] > scores[chosen]:
        return "predicts held-out views worse than the chosen one"
    return "predicts held-out views no better than chance explains"


def _view_losses(trial: _Trial, cap_px: float) -> FloatArray:
    """Return (views,) mean squared length of held-out residuals, large ones counted as `cap_px`; px^2, NaN where none.

    Views that no fit could use say nothing about the lens.
    """
    square = (trial.held_out_px**2).sum(-1)
    count = (~np.isnan(square)).sum((0, 2))
    total = np.nansum(np.minimum(square, cap_px**2), (0, 2))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def _refused(trial: _Trial, trials: Sequence[_Trial]) -> str:
    rig = trial.full.rig
    for side, camera in (("left", rig.left), ("right", rig.right)):
        lost = np.isnan(unproject(camera, _grid(camera.size_px))[:, 0]).mean()
        if lost > MOST_LOST:
            return f"refused: it folds back over {100 * lost:.0f} % of the {side} image"
    sigma, surest = _open(trial), min(_open(other) for other in trials)
    if not sigma <= EXPLODES * surest:
        return f"refused: the views leave it open, ranges are {sigma / surest:.1f} times as uncertain as with another"
    return ""


def _open(trial: _Trial) -> float:
    """Return the predicted range sigma, metres, as if residuals did not hang together; infinity where none is known."""
    sigma = range_sigma(trial.full.rig, JUDGED_AT_M) / trial.full.inflation
    known = sigma[~np.isnan(sigma)]
    return float(np.median(known)) if known.size else np.inf


def _grid(size_px: tuple[int, int]) -> FloatArray:
    """Return pixels all over the image, its corners too, (n, 2)."""
    u, v = np.meshgrid(np.linspace(0, size_px[0] - 1, 41), np.linspace(0, size_px[1] - 1, 41))
    return np.stack([u.ravel(), v.ravel()], -1)


def _evidence(trial: _Trial, score: float, words: str) -> LensTrial:
    fitted = [trial.full.residual_px[:, view] for view, why in enumerate(trial.full.left_out) if not why]
    cap_px = CAP * max(trial.full.sigma_px)
    square = np.minimum((np.stack(fitted) ** 2).sum(-1), cap_px**2)
    parameters = 2 * (4 + LENSES[trial.lens][1])
    return LensTrial(trial.lens, parameters, float(np.sqrt(np.nanmean(square))), float(np.sqrt(score)), words)
