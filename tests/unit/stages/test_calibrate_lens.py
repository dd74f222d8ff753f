"""The lens by evidence: held-out views decide, simpler lenses win ties, lenses that nothing supports are refused."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_examples import example_rig, example_views

from roadblock.errors import CalibrationError
from roadblock.stages.calibrate import lens as room
from roadblock.stages.calibrate.bundle import solve_camera, solve_rig
from roadblock.stages.calibrate.lens import TRIALS, choose_lens
from roadblock.stages.calibrate.start import LENSES
from roadblock.values.board import Board
from roadblock.values.camera import Camera, RigCovariance

BOARD = Board("chessboard", 6, 5, 0.035)
SMALL = (320, 180)


def example(lens: str, fov: float, count: int = 12, noise_px: float = 0.02, nearest_m: float = 0.25):
    rig = example_rig(lens, size_px=SMALL, fov=fov)
    rng = np.random.default_rng(4)
    return rig, example_views(rig, BOARD, rng, count, noise_px, 1e-4, distance_m=(nearest_m, 2.2 * nearest_m))


@pytest.fixture(scope="module")
def ordinary():
    return example("brown_conrady5", 1.2, nearest_m=0.4)


@pytest.fixture(scope="module")
def solution(ordinary):
    rig, views = ordinary
    left = solve_camera([view.left for view in views], BOARD, SMALL, "brown_conrady5", rig.left)
    right = solve_camera([view.right for view in views], BOARD, SMALL, "brown_conrady5", rig.right)
    return left, right, solve_rig(views, BOARD, SMALL, "brown_conrady5", left, right)


def test_the_usual_lens_is_kept_where_it_is_the_true_one(ordinary):
    told = []
    lens, trials = choose_lens(ordinary[1], BOARD, SMALL, lambda done, total: told.append((done, total)))
    assert lens == "brown_conrady5"
    assert told == [(1, 3), (2, 3), (3, 3)]
    assert [trial.lens for trial in trials] == list(TRIALS)
    assert [trial.parameters for trial in trials] == [18, 16, 24]
    assert [trial.verdict.startswith("chosen") for trial in trials] == [True, False, False]
    richest = trials[2]
    assert richest.fitted_rms_px <= trials[0].fitted_rms_px + 1e-5  # by fit alone it would have won
    assert trials[0].held_out_rms_px == pytest.approx(0.02 * np.sqrt(2), rel=0.15)


def test_a_fisheye_is_recognized():
    lens, trials = choose_lens(example("kannala_brandt", 2.5, count=9)[1], BOARD, SMALL)
    assert lens == "kannala_brandt"
    assert trials[0].held_out_rms_px > 1.3 * trials[1].held_out_rms_px


def test_with_few_pairs_the_usual_lens_is_not_questioned(ordinary):
    views = ordinary[1]
    use = np.arange(len(views)) < room.FEWEST_PAIRS - 1
    lens, (trial,) = choose_lens(views, BOARD, SMALL, use=use)
    assert lens == trial.lens == "brown_conrady5"
    assert f"{use.sum()} pairs are too few" in trial.verdict
    assert np.isnan(trial.held_out_rms_px)
    assert trial.fitted_rms_px < 0.05


def test_too_few_views_for_any_lens(ordinary):
    with pytest.raises(CalibrationError, match="2 of 2 views"):
        choose_lens(ordinary[1][:2], BOARD, SMALL)


def fabricated(solution, lens: str, losses_px, *, camera: Camera | None = None, sigma: float = 1.0) -> room._Trial:
    """Return a trial whose held-out residuals are given per view, of one solution in two folds."""
    left, right, full = solution
    residual = np.full_like(full.residual_px, np.nan)
    residual[:, :, :9, 0], residual[:, :, :9, 1] = np.asarray(losses_px)[None, :, None], 0.0
    rig = full.rig if camera is None else replace(full.rig, right=camera, covariance=None)
    if rig.covariance is not None:
        rig = replace(rig, covariance=RigCovariance(rig.covariance.names, rig.covariance.matrix * sigma**2))
    full = replace(full, rig=rig, lens=lens)
    return room._Trial(lens, (left, right), full, (replace(full, residual_px=residual),) * 2)


def views_of(solution) -> np.ndarray:
    return np.linspace(0.02, 0.04, solution[2].residual_px.shape[1])


def test_ties_go_to_the_preferred_lens_and_clear_gains_do_not(solution):
    base = views_of(solution)
    jitter = 1.02 + 0.2 * (-1.0) ** np.arange(len(base))
    tie = [fabricated(solution, name, base * f) for name, f in zip(TRIALS, (jitter, 1.0, 2.0), strict=True)]
    lens, told = room._decide(tie)
    assert lens == "brown_conrady5"
    assert [t.verdict for t in told] == [
        "chosen: as good as the best, and simpler",
        "predicts held-out views no better than chance explains",
        "predicts held-out views worse than the chosen one",
    ]
    clear = [fabricated(solution, name, base * f) for name, f in zip(TRIALS, (1.1, 1.2, 1.0), strict=True)]
    lens, told = room._decide(clear)
    assert lens == "brown_conrady8"
    assert told[2].verdict == "chosen: it predicts held-out views best"
    assert told[2].held_out_rms_px == pytest.approx(np.sqrt(np.mean(base**2)))


def test_a_difference_that_is_sure_but_negligible_is_none(solution):
    base = views_of(solution)
    trials = [fabricated(solution, name, base * f) for name, f in zip(TRIALS, (1.008, 1.2, 1.0), strict=True)]
    assert room._decide(trials)[0] == "brown_conrady5"


def test_one_view_gone_wrong_does_not_decide(solution):
    base = views_of(solution)
    spoiled = base.copy()
    spoiled[3] = 1000.0
    trials = [
        fabricated(solution, name, losses) for name, losses in zip(TRIALS, (spoiled, 2 * base, 2 * base), strict=True)
    ]
    assert room._decide(trials)[0] == "brown_conrady5"


def test_a_lens_that_folds_inside_the_image_is_refused_unless_all_others_are_wrong(solution):
    base = views_of(solution)
    folded = replace(solution[2].rig.right, distortion=[-0.9, 0, 0, 0, 0])
    for others, expected in ((1.05, "kannala_brandt"), (1.5, "brown_conrady5")):
        first = fabricated(solution, TRIALS[0], base, camera=folded)
        rest = [fabricated(solution, name, base * others) for name in TRIALS[1:]]
        lens, told = room._decide([first, *rest])
        assert lens == expected
        assert ("folds back over" in told[0].verdict and "right image" in told[0].verdict) == (others == 1.05)


def test_a_lens_that_the_views_leave_open_is_refused(solution):
    base = views_of(solution)
    first = fabricated(solution, TRIALS[0], base, sigma=4.0)
    rest = [fabricated(solution, name, base * f) for name, f in zip(TRIALS[1:], (1.02, 1.2), strict=True)]
    lens, told = room._decide([first, *rest])
    assert lens == "kannala_brandt"
    assert "4.0 times as uncertain" in told[0].verdict


def test_if_all_are_refused_the_best_is_taken(solution):
    base = views_of(solution)
    folded = replace(solution[2].rig.right, distortion=[-0.9, 0, 0, 0, 0])
    trials = [fabricated(solution, n, base * f, camera=folded) for n, f in zip(TRIALS, (2.0, 1.0, 1.5), strict=True)]
    assert room._decide(trials)[0] == "kannala_brandt"


def test_views_that_no_fit_could_hold_out_say_nothing(solution):
    base = views_of(solution)
    base[2] = np.nan
    trials = [fabricated(solution, name, base) for name in TRIALS]
    assert room._decide(trials)[1][0].held_out_rms_px == pytest.approx(np.sqrt(np.nanmean(base**2)))


def test_a_start_is_only_handed_on_within_a_model(ordinary):
    camera = ordinary[0].left
    longer = room._start(camera, "brown_conrady8")
    np.testing.assert_allclose(longer.distortion, [*camera.distortion, 0, 0, 0])
    assert room._start(camera, "kannala_brandt") is None
    assert set(TRIALS) == set(LENSES)
