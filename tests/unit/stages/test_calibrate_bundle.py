"""The solver: exact on noise-free views, as scipy's on noisy ones, honest about its sigma, unmoved by outliers."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_examples import LENSES as EXAMPLES
from calibration_examples import bow, example_pose, example_rig, example_views
from scipy.optimize import least_squares

from roadblock.errors import CalibrationError, RigError, ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, rotvec_from_rotation, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import right_from_left
from roadblock.geometry.uncertainty import calibration_jacobian, range_sigma, seen_points
from roadblock.stages.calibrate import adjust as engine
from roadblock.stages.calibrate.adjust import Bundle, adjust, camera_values, corners_of
from roadblock.stages.calibrate.bundle import RigSolution, solve_camera, solve_rig
from roadblock.stages.calibrate.fit import outlier_views
from roadblock.stages.calibrate.shape import shape_of
from roadblock.stages.calibrate.start import LENSES, board_poses, first_camera, is_line, knowledge, relative_pose
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import StereoRig

BOARD = Board("chessboard", 7, 5, 0.03)
SMALL = (320, 180)


def solved(views, rig: StereoRig, board=BOARD, lens="brown_conrady5", use=None) -> RigSolution:
    """Solve with the search for a start skipped, for speed."""
    left = solve_camera([view.left for view in views], board, rig.left.size_px, lens, rig.left)
    right = solve_camera([view.right for view in views], board, rig.left.size_px, lens, rig.right)
    return solve_rig(views, board, rig.left.size_px, lens, left, right, use=use)


def offset(solution: RigSolution, truth: StereoRig) -> np.ndarray:
    """Estimate minus truth in the order of `rig_parameters`."""
    rig = solution.rig
    return np.r_[
        camera_values(rig.left) - camera_values(truth.left),
        camera_values(rig.right) - camera_values(truth.right),
        rotvec_from_rotation(rig.T_left_right[:3, :3] @ truth.T_left_right[:3, :3].T),
        (rig.T_left_right - truth.T_left_right)[:3, 3],
    ]


def chi2_per_parameter(solution: RigSolution, truth: StereoRig) -> float:
    off = offset(solution, truth)
    sigma = np.sqrt(solution.rig.covariance.matrix.diagonal())
    correlation = solution.rig.covariance.matrix / np.outer(sigma, sigma)
    return float((off / sigma) @ np.linalg.solve(correlation, off / sigma) / len(off))


def range_shift(solution: RigSolution, truth: StereoRig) -> float:
    """Root mean square of the range error at 20 m, to first order."""
    points = seen_points(truth, 20.0).reshape(-1, 3)
    slope = calibration_jacobian(truth, points[~np.isnan(points[:, 0])])[:, 2]
    return float(np.sqrt(np.mean((slope @ offset(solution, truth)) ** 2)))


def changed(views, index: int, side: str, shift_px, corners=slice(None)):
    """Shift some corners of one view's sighting."""
    sighting = getattr(views[index], side)
    points = sighting.points_px.copy()
    points[corners] += shift_px
    views = list(views)
    views[index] = replace(views[index], **{side: replace(sighting, points_px=points)})
    return tuple(views)


@pytest.fixture(scope="module")
def rig() -> StereoRig:
    return example_rig(size_px=SMALL, fov=1.2)


@pytest.fixture(scope="module")
def views(rig):
    return example_views(rig, BOARD, np.random.default_rng(11), 16, 0.03, 2e-4, distance_m=(0.4, 1.0))


@pytest.fixture(scope="module")
def solution(rig, views) -> RigSolution:
    return solved(views, rig)


@pytest.mark.parametrize("lens", EXAMPLES)
def test_noise_free_views_give_the_true_rig_whatever_the_lens(lens):
    rig = example_rig(lens, size_px=SMALL, fov=1.8)
    views = example_views(rig, BOARD, np.random.default_rng(3), 14, 0.0, distance_m=(0.2, 0.7), told_px=0.01)
    left = solve_camera([view.left for view in views], BOARD, SMALL, lens)
    right = solve_camera([view.right for view in views], BOARD, SMALL, lens)
    found = solve_rig(views, BOARD, SMALL, lens, left, right)
    assert found.lens == lens
    assert range_shift(found, rig) < 1e-3
    assert np.nanmax(np.abs(found.residual_px)) < 1e-4
    np.testing.assert_allclose(found.rig.T_left_right, rig.T_left_right, atol=1e-6)
    np.testing.assert_allclose(found.board_heights_m, 0, atol=1e-7)


def test_truth_lies_within_the_stated_covariance(solution, rig, views):
    assert 0.3 < chi2_per_parameter(solution, rig) < 2.2  # 24 parameters: 1 +- 0.29
    assert solution.inflation == 1.0
    np.testing.assert_allclose(solution.sigma_px, 0.03, rtol=0.08)
    np.testing.assert_allclose(solution.tau, 1.0, rtol=0.08)
    assert solution.left_out == ("",) * len(views)
    off = solution.board_heights_m - bow(BOARD, 2e-4)
    assert np.sqrt(np.mean((off / solution.board_heights_sigma_m) ** 2)) < 2.2
    assert np.ptp(solution.board_heights_m) > 5 * solution.board_heights_sigma_m.max()


def test_residuals_and_poses_are_those_of_the_found_rig(solution, views):
    heights = solution.board_heights_m[:, None] * (0, 0, 1)
    for view, (seen, T) in enumerate(zip(views, solution.T_left_board, strict=True)):
        points = transform(T, BOARD.points_m + heights)
        for side, (camera, there) in enumerate(
            ((solution.rig.left, points), (solution.rig.right, right_from_left(solution.rig, points)))
        ):
            sighting = (seen.left, seen.right)[side]
            ids = [] if sighting is None else sighting.ids
            expected = np.full((len(points), 2), np.nan)
            if sighting is not None:
                expected[ids] = sighting.points_px - project(camera, there)[ids]
            np.testing.assert_allclose(solution.residual_px[side, view], expected, atol=1e-9)
            assert (np.isnan(solution.weight[side, view]) == np.isnan(expected[:, 0])).all()


def test_views_of_one_camera_help_that_camera(rig, views):
    half = [replace(view, right=None) if i % 2 else view for i, view in enumerate(views)]
    only_pairs = solved([view for i, view in enumerate(half) if not i % 2], rig)
    with_singles = solved(half, rig)
    sigma = [np.sqrt(s.rig.covariance.matrix.diagonal())[:4] for s in (only_pairs, with_singles)]
    assert (sigma[1] < 0.93 * sigma[0]).all()
    assert with_singles.T_left_board[1] is not None


def test_views_of_the_right_camera_alone_have_a_pose_in_the_left_frame(rig, views, solution):
    single = (*views[:-1], replace(views[-1], left=None))
    found = solved(single, rig)
    np.testing.assert_allclose(found.T_left_board[-1], solution.T_left_board[-1], atol=5e-3)
    assert np.isnan(found.residual_px[0, -1]).all()
    assert np.isfinite(found.view_sigma_px[1, -1])


def test_the_engine_finds_what_scipy_finds(rig, views):
    few = [view for view in views if view.left is not None and view.right is not None][:5]
    corners = tuple(corners_of(seen, 35) for seen in ([v.left for v in few], [v.right for v in few]))
    problem = knowledge((rig.left, rig.right), BOARD, corners)
    boards = np.stack([board_poses(BOARD.points_m, unproject(rig.left, seen))[0] for seen in corners[0].points_px])
    start = Bundle((rig.left, rig.right), rig.T_left_right, boards, np.zeros(len(problem.shape.sigma_m)))
    shared = len(problem.sigma)
    found = adjust(problem, start, np.ones(shared, bool), np.ones(2))

    def parts(x):
        """Residuals shortened so that the sum of their squares is Cauchy's loss."""
        bundle = found.moved(x[:shared], x[shared:].reshape(5, 6))
        e = np.concatenate([error[~np.isnan(error[..., 0])] / 0.03 for error in engine.residuals(problem, bundle)])
        share = (e**2).sum(-1, keepdims=True) / 16
        return np.r_[(e * np.sqrt(np.log1p(share) / share)).ravel(), problem.off(bundle)]

    steps = np.r_[np.tile([1e-3, 1e-3, 1e-3, 1e-3, *np.full(5, 1e-5)], 2), np.full(shared - 18 + 30, 1e-6)]
    slope = [(parts(step) - parts(-step)) / (2 * step.sum()) for step in np.diag(steps)]
    whiten = np.linalg.inv(np.linalg.qr(np.stack(slope, -1), mode="r"))  # units in which sigma is 1
    off = np.random.default_rng(0).normal(0, 1, shared + 30)
    twin = least_squares(lambda y: parts(whiten @ y), off, max_nfev=6)
    np.testing.assert_allclose(twin.x, 0, atol=0.01)
    assert np.sum(parts(np.zeros(len(off))) ** 2) <= 2 * twin.cost * (1 + 1e-9)


@pytest.mark.parametrize("side", [0, 1])
def test_slopes_are_those_of_the_residuals(rig, views, side):
    corners = tuple(corners_of(seen, 35) for seen in ([views[0].left], [views[0].right]))
    problem = knowledge((rig.left, rig.right), BOARD, corners)
    T = example_pose(rig, BOARD, np.random.default_rng(4), (0.6, 0.7))
    shape = np.random.default_rng(5).normal(0, 1e-3, problem.shape.basis.shape[1])
    bundle = Bundle((rig.left, rig.right), rig.T_left_right, T[None], shape)
    free = np.ones(len(problem.sigma), bool)
    by_shared, by_pose = engine.slopes(problem, bundle, side, free)
    for slope, count in ((by_shared, len(free)), (by_pose, 6)):
        for column in range(count):
            step = np.zeros(count)
            step[column] = 1e-6
            ends = []
            for sign in (1, -1):
                change = (
                    (sign * step, np.zeros((1, 6))) if count == len(free) else (np.zeros(len(free)), sign * step[None])
                )
                ends.append(engine.residuals(problem, bundle.moved(*change))[side])
            numeric = (ends[1] - ends[0]) / 2e-6
            np.testing.assert_allclose(
                slope[..., column][~np.isnan(numeric)],
                numeric[~np.isnan(numeric)],
                atol=2e-4 * np.nanmax(np.abs(numeric)) + 1e-4,
            )


def test_held_out_views_are_posed_but_do_not_count(rig, views):
    use = np.arange(len(views)) % 4 != 0
    held = solved(views, rig, use=use)
    broken = solved(changed(views, 0, "left", (3.0, -2.0)), rig, use=use)
    np.testing.assert_allclose(held.rig.T_left_right, broken.rig.T_left_right, atol=1e-7)
    assert [why == "not asked for" for why in held.left_out] == list(~use)
    assert np.nanmax(np.abs(held.residual_px[:, 0])) < 0.3
    assert np.nanmax(np.abs(broken.residual_px[:, 0])) > 0.5


def test_a_start_that_is_right_already_leads_to_the_same_solution(rig, views, solution):
    left = solve_camera([view.left for view in views], BOARD, SMALL, "brown_conrady5", solution.rig.left)
    right = solve_camera([view.right for view in views], BOARD, SMALL, "brown_conrady5")
    again = solve_rig(views, BOARD, SMALL, "brown_conrady5", left, right, start=solution)
    np.testing.assert_allclose(offset(again, solution.rig), 0, atol=1e-3)


def test_a_few_wrong_corners_do_not_spoil_the_rig(rig, views, solution):
    rng = np.random.default_rng(9)
    wrong = views
    for index in range(len(views)):
        if wrong[index].left is not None:
            wrong = changed(wrong, index, "left", rng.normal(0, 8, 2), corners=[index % 6])
    found = solved(wrong, rig)
    sigma = float(np.nanmedian(range_sigma(solution.rig, 20.0)))
    assert range_shift(found, solution.rig) < 0.6 * sigma
    assert found.left_out == ("",) * len(views)
    assert found.weight[0, 3, views[3].left.ids[3]] < 0.01


def test_a_board_that_moved_between_the_cameras_is_left_out_and_named(rig, views, solution):
    found = solved(changed(views, 5, "right", (2.0, 1.0)), rig)
    assert [i for i, why in enumerate(found.left_out) if why] == [5]
    assert "image" in found.left_out[5]
    assert "times those of the other views" in found.left_out[5]
    assert range_shift(found, solution.rig) < float(np.nanmedian(range_sigma(solution.rig, 20.0)))
    assert np.nanmax(np.abs(found.residual_px[:, 5])) > 0.5  # it has its best pose


def test_one_camera_leaves_out_its_own_wrong_views(rig, views):
    bent = np.zeros((len(views[2].left.ids), 2))
    bent[:, 0] = np.linspace(-2, 2, len(bent)) ** 2
    found = solve_camera([v.left for v in changed(views, 2, "left", bent)], BOARD, SMALL, "brown_conrady5")
    assert [i for i, why in enumerate(found.left_out) if why] == [2]
    assert "px in the image" in found.left_out[2]
    assert found.expected_sigma_px == 0.03
    assert found.sigma_px == pytest.approx(0.03, rel=0.1)
    assert found.view_sigma_px[2] > 5 * found.sigma_px


def test_at_most_a_third_of_the_views_is_left_out_the_worst_first():
    ratio = np.r_[np.linspace(1.0, 1.1, 6), 20.0, 30.0, 10.0][None]
    used = np.ones(9, bool)
    nothing = np.zeros((1, 9))
    assert np.flatnonzero(outlier_views(ratio, nothing, used, 9)).tolist() == [6, 7, 8]
    assert np.flatnonzero(outlier_views(ratio[:, 2:], nothing[:, 2:], used[2:], 7)).tolist() == [4, 5]
    used[7] = False
    assert np.flatnonzero(outlier_views(ratio, nothing, used, 9)).tolist() == [6, 8]
    assert not outlier_views(ratio, nothing, np.r_[np.ones(6, bool), np.zeros(3, bool)], 9).any()


def test_a_view_of_many_wrong_corners_is_out_though_most_are_right():
    share = np.array([[0.0, 0.4, 0.1, np.nan], [0.0, 0.0, 0.2, 0.0]])
    ratio = np.ones((2, 4))
    assert outlier_views(ratio, share, np.ones(4, bool), 4).tolist() == [False, True, False, False]


def test_noise_told_wrong_is_measured(rig):
    rng = np.random.default_rng(11)
    views = example_views(rig, BOARD, rng, 16, 0.03, 2e-4, distance_m=(0.4, 1.0), told_px=0.01)
    found = solved(views, rig)
    np.testing.assert_allclose(found.tau, 3.0, rtol=0.08)
    assert 0.3 < chi2_per_parameter(found, rig) < 2.2


def test_residuals_that_hang_together_inflate_the_covariance(rig, views):
    rng = np.random.default_rng(2)
    late = views
    for index, view in enumerate(views):  # the right camera fires at another time than the left
        if view.right is not None:
            late = changed(late, index, "right", rng.normal(0, 0.05, 2))
    found = solved(late, rig)
    assert found.inflation > 1.3
    assert chi2_per_parameter(found, rig) < 2.5


def test_the_covariance_of_scale_stretches_the_translation(rig, views, solution):
    measured = replace(BOARD, square_sigma_m=0.01 * BOARD.square_m)
    found = solved(views, rig, board=measured)
    t = solution.rig.T_left_right[:3, 3]
    difference = found.rig.covariance.matrix - solution.rig.covariance.matrix
    np.testing.assert_allclose(difference[-3:, -3:], 1e-4 * np.outer(t, t), rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(difference[:-3], 0, atol=1e-12)


def test_a_rig_that_sees_nothing_together_far_away_is_judged_all_the_same(rig, views, monkeypatch):
    monkeypatch.setattr("roadblock.stages.calibrate.covariance.JUDGED_AT_M", -1.0)
    rng = np.random.default_rng(2)
    late = views
    for index, view in enumerate(views):
        if view.right is not None:
            late = changed(late, index, "right", rng.normal(0, 0.05, 2))
    assert solved(late, rig).inflation > 1.3


def test_corners_behind_the_lens_count_as_lost_and_do_not_stop_the_engine(rig, views):
    corners = (corners_of([v.left for v in views[:4]], 35),)
    problem = knowledge((rig.left,), BOARD, corners)
    poses = np.stack([board_poses(BOARD.points_m, unproject(rig.left, p))[0] for p in corners[0].points_px])
    poses[0] = pose(np.eye(3), [0, 0, -1.0])
    start = Bundle((rig.left,), np.eye(4), poses, np.zeros(len(problem.shape.sigma_m)))
    lengths = engine.lengths(problem, engine.residuals(problem, start))
    assert (lengths[0][0][corners[0].seen[0]] == engine.LOST).all()
    found = adjust(problem, start, np.isfinite(problem.sigma))
    np.testing.assert_allclose(found.T_left_board[0], poses[0], atol=1e-9)
    assert np.nanmedian(engine.lengths(problem, engine.residuals(problem, found))[0][1:]) < 3


def test_the_engine_gives_up_where_no_step_helps(rig, views, monkeypatch):
    corners = (corners_of([views[0].left], 35),)
    problem = knowledge((rig.left,), BOARD, corners)
    poses = np.stack(board_poses(BOARD.points_m, unproject(rig.left, corners[0].points_px[0]))[:1])
    start = Bundle((rig.left,), np.eye(4), poses, np.zeros(len(problem.shape.sigma_m)))

    def fails(*_):
        raise np.linalg.LinAlgError

    monkeypatch.setattr(engine, "solve", fails)
    assert adjust(problem, start, np.isfinite(problem.sigma)) is start


def test_a_start_is_had_even_where_no_trial_finds_a_pose(rig, views):
    row = views[0].left.ids[:7]
    line = corners_of([Sighting(row, views[0].left.points_px[:7], np.full(7, 0.1))], 35)
    assert first_camera(line, BOARD, SMALL, "brown_conrady5").size_px == SMALL


@pytest.mark.parametrize("name", LENSES)
def test_the_first_guess_is_near(name):
    rig = example_rig(name, fov=1.3)
    views = example_views(rig, BOARD, np.random.default_rng(8), 8, 0.05, distance_m=(0.3, 0.8))
    seen = corners_of([view.left for view in views if view.left is not None], 35)
    guess = first_camera(seen, BOARD, rig.left.size_px, name)
    assert guess.fx_px == pytest.approx(rig.left.fx_px, rel=0.25)


def test_a_board_seen_from_afar_has_two_poses_the_right_one_first(rig):
    T = example_pose(rig, BOARD, np.random.default_rng(21), (0.5, 0.6))
    rays = transform(T, BOARD.points_m)
    found = board_poses(BOARD.points_m, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    assert len(found) == 2
    np.testing.assert_allclose(found[0], T, atol=1e-6)


def test_a_fisheye_sees_a_board_beside_itself():
    T = pose(rotation_from_rotvec([0.1, np.pi / 2, 0.0]), [0.6, 0.0, 0.05])
    rays = transform(T, BOARD.points_m)
    assert (rays[:, 2] < 0).any()
    np.testing.assert_allclose(board_poses(BOARD.points_m, rays)[0], T, atol=1e-6)
    straight_down = transform(pose(rotation_from_rotvec([-np.pi / 2, 0.0, 0.0]), [0.0, 0.6, 0.0]), BOARD.points_m)
    assert board_poses(BOARD.points_m, straight_down)


def test_no_pose_without_enough_points_or_of_a_line_or_of_rays_all_around():
    rays = transform(pose(np.eye(3), [0, 0, 1.0]), BOARD.points_m)
    few = rays.copy()
    few[5:] = np.nan
    assert board_poses(BOARD.points_m, few) == []
    line = rays.copy()
    line[7:] = np.nan
    assert board_poses(BOARD.points_m, line) == []
    around = rays.copy()
    around[::7] = (0, 0, -1.0)
    assert board_poses(BOARD.points_m, around) == []


def test_relative_pose_is_the_robust_middle(rig):
    rng = np.random.default_rng(6)
    T_left_board = np.stack([example_pose(rig, BOARD, rng, (0.5, 1.0)) for _ in range(7)])
    T_right_board = np.linalg.inv(rig.T_left_right) @ T_left_board
    T_right_board[3] = T_right_board[4]
    np.testing.assert_allclose(relative_pose(T_left_board, T_right_board), rig.T_left_right, atol=1e-9)


@pytest.mark.parametrize(("columns", "rows"), [(11, 8), (3, 3), (2, 2), (4, 2)])
def test_shapes_are_orthogonal_to_planes_and_each_other(columns, rows):
    board = Board("chessboard", columns, rows, 0.03)
    shape = shape_of(board)
    points = board.points_m
    plane = np.stack([np.ones(len(points)), points[:, 0], points[:, 1]])
    np.testing.assert_allclose(plane @ shape.basis, 0, atol=1e-9)
    count = {(11, 8): 12, (3, 3): 6, (2, 2): 1, (4, 2): 5}[columns, rows]
    np.testing.assert_allclose(shape.basis.T @ shape.basis / len(points), np.eye(count), atol=1e-9)
    assert shape.sigma_m[0] == pytest.approx(0.005 * max(board.size_m))


def test_what_lies_on_a_line():
    assert is_line(np.array([[0.0, 0, 0], [1, 1, 0], [3, 3, 0]]))
    assert not is_line(np.array([[0.0, 0, 0], [1, 1, 0], [3, 2.5, 0]]))


def sighting_of(ids, rng) -> Sighting:
    return Sighting(np.array(ids), rng.uniform(10, 90, (len(ids), 2)), np.full(len(ids), 0.1))


def test_too_few_views_are_refused_with_a_reason(views):
    rng = np.random.default_rng(0)
    few = [views[0].left, views[1].left, sighting_of(range(4), rng), sighting_of(range(7), rng), None]
    with pytest.raises(CalibrationError, match=r"2 of 5 views .*only 4 points .*take more"):
        solve_camera(few, BOARD, SMALL, "brown_conrady5")
    with pytest.raises(CalibrationError, match="0 of 0 views"):
        solve_camera([], BOARD, SMALL, "brown_conrady5")


def test_views_that_cannot_be_used_say_why(views):
    rng = np.random.default_rng(0)
    seen = [*(view.left for view in views[:8]), sighting_of(range(4), rng), sighting_of(range(7), rng), None]
    found = solve_camera(seen, BOARD, SMALL, "brown_conrady5")
    assert [why.split(",")[0] for why in found.left_out[-3:]] == [
        "only 4 points of the board were seen",
        "the points that were seen lie on one line",
        "the board was not seen",
    ]
    assert found.T_camera_board[-3:] == (None, None, None)
    assert np.isnan(found.residual_px[-3:]).all()


def test_views_that_no_pose_fits_are_refused(views, rig):
    narrow = replace(rig.left, distortion=[-60.0, 0, 0, 0, 0])  # folds so early that it sees a tenth of the image
    with pytest.raises(CalibrationError, match="no pose of the board fits"):
        solve_camera([view.left for view in views], BOARD, SMALL, "brown_conrady5", narrow)


def test_a_view_that_neither_camera_can_use_says_so(rig, views):
    empty = BoardView("empty", None, None)
    assert solved((*views, empty), rig).left_out[-1] == "no pose of the board fits"


def test_views_of_one_camera_make_no_rig(rig, views):
    single = [replace(view, left=None) if i % 2 else replace(view, right=None) for i, view in enumerate(views)]
    with pytest.raises(CalibrationError, match="0 views show enough of the board to both cameras"):
        solved(single, rig)


def test_cameras_solved_with_another_lens_or_size_are_refused(rig, views, solution):
    left = solve_camera([view.left for view in views], BOARD, SMALL, "brown_conrady5", solution.rig.left)
    with pytest.raises(CalibrationError, match=r"must have the lens kannala_brandt .* brown_conrady5"):
        solve_rig(views, BOARD, SMALL, "kannala_brandt", left, left)
    with pytest.raises(CalibrationError, match="images of 640x480"):
        solve_rig(views, BOARD, (640, 480), "brown_conrady5", left, left)


def test_swapped_cameras_are_no_rig(rig, views):
    swapped = [BoardView(view.name, view.right, view.left) for view in views]
    with pytest.raises(RigError, match="swapped"):
        solved(swapped, rig)


def test_a_step_to_no_camera_is_refused(rig):
    bundle = Bundle((rig.left,), np.eye(4), np.eye(4)[None], np.zeros(0))
    with pytest.raises(ValueRefusedError, match="fx_px"):
        bundle.moved(np.r_[-1e4, np.zeros(14)], np.zeros((1, 6)))
