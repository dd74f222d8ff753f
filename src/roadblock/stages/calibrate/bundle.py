"""Calibrate: the solver. Sightings of a board in; each camera alone, then the rig of both by one bundle adjustment out.

Everything is estimated at once and nothing is held: both cameras' intrinsics, their relative pose, the boards' poses
and the board's own shape. Fixing intrinsics that were found camera by camera costs ten times the range error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from roadblock.errors import CalibrationError
from roadblock.geometry.projection import unproject
from roadblock.stages.calibrate.adjust import Bundle, Corners, Mask, Problem, adjust, corners_of
from roadblock.stages.calibrate.covariance import covariance, evidence, inflation
from roadblock.stages.calibrate.fit import Fit, best_poses, fit_views
from roadblock.stages.calibrate.start import (
    FEWEST_POINTS,
    board_poses,
    first_camera,
    is_line,
    knowledge,
    relative_pose,
)
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters
from roadblock.values.checks import FloatArray

FEWEST_VIEWS = 3


@dataclass(frozen=True, eq=False)
class CameraSolution:
    """One camera calibrated alone.

    Attributes
    ----------
    camera
        As found.
    lens
        Its name in `start.LENSES`.
    T_camera_board
        Of each view, 4x4, metres; None where no pose was found.
    residual_px
        (views, n, 2) measured minus predicted, pixels; NaN where a point was not seen or there is no pose. Views that
        were left out have their best pose.
    weight
        (views, n) robust weight 0..1; NaN where unseen.
    sigma_px, expected_sigma_px
        Robust standard deviation of one coordinate of the used views' residuals, and what the corners themselves
        expected (their median), pixels.
    view_sigma_px
        (views,) the robust standard deviation of each view's residuals, pixels; NaN without a pose.
    left_out
        Of each view why it was not used, in words; "" if it was.
    """

    camera: Camera
    lens: str
    T_camera_board: tuple[FloatArray | None, ...]
    residual_px: FloatArray
    weight: FloatArray
    sigma_px: float
    expected_sigma_px: float
    view_sigma_px: FloatArray
    left_out: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class RigSolution:
    """Both cameras calibrated together.

    Attributes
    ----------
    rig
        With its covariance, inflation and the board's scale included.
    lens
        Its name in `start.LENSES`.
    board_heights_m, board_heights_sigma_m
        (n,) how far each point lies behind (> 0) the board's plane, and its standard deviation, metres.
    T_left_board
        Of each view, 4x4, metres; None where no pose was found.
    residual_px
        (2, views, n, 2) left and right, measured minus predicted, pixels; NaN where unseen or without a pose. Views
        that were left out have their best pose.
    weight
        (2, views, n) robust weight 0..1; NaN where unseen.
    sigma_px
        Robust standard deviation of one coordinate of the used views' residuals, (left, right), pixels.
    view_sigma_px
        (2, views) the same of each view; NaN where unseen or without a pose.
    left_out
        Of each view why it was not used, in words; "" if it was.
    inflation
        Factor on the standard deviations because residuals within a view hang together.
    information
        (c, c) inverse covariance, before inflation and scale, of the rig's parameters and then the shape's
        coefficients, poses eliminated.
    shape
        (k,) those coefficients, metres.
    tau
        (2,) effective noise of each camera's corners over what they were said to have.
    """

    rig: StereoRig
    lens: str
    board_heights_m: FloatArray
    board_heights_sigma_m: FloatArray
    T_left_board: tuple[FloatArray | None, ...]
    residual_px: FloatArray
    weight: FloatArray
    sigma_px: tuple[float, float]
    view_sigma_px: FloatArray
    left_out: tuple[str, ...]
    inflation: float
    information: FloatArray
    shape: FloatArray
    tau: FloatArray


def solve_camera(
    sightings: Sequence[Sighting | None],
    board: Board,
    size_px: tuple[int, int],
    lens: str,
    start: Camera | None = None,
) -> CameraSolution:
    """Calibrate one camera alone: the paper's first step.

    Parameters
    ----------
    sightings
        Of each view, None where the camera did not see the board.
    board
        The board.
    size_px
        (width, height) of the images.
    lens
        One of `start.LENSES`.
    start
        A camera of that lens that is nearly right already; searched for if None.

    Raises
    ------
    CalibrationError
        If fewer than 3 views show enough of the board.
    """
    corners = corners_of(sightings, len(board.points_m))
    reasons = [_unusable(seen, board) for seen in corners.seen]
    usable = np.array([not reason for reason in reasons], bool)
    _check_count(usable, reasons)
    camera = start or first_camera(corners.of(usable), board, size_px, lens)
    first, _ = _two_poses(camera, board, corners)
    reasons = [
        reason or "no pose of the board fits" * bool(np.isnan(T[0, 0]))
        for reason, T in zip(reasons, first, strict=True)
    ]
    usable = np.array([not reason for reason in reasons], bool)
    _check_count(usable, reasons)
    problem = knowledge((camera,), board, (_only(corners, usable),))
    free = np.isfinite(problem.sigma)
    flat = np.zeros(len(problem.shape.sigma_m))
    near = adjust(problem.of(usable), Bundle((camera,), np.eye(4), first[usable], flat), free)
    poses = np.full_like(first, np.nan)
    poses[usable] = near.T_left_board
    others = _two_poses(near.cameras[0], board, corners)
    bundle = best_poses(problem, replace(near, T_left_board=poses), usable, others)
    fit = fit_views(problem, bundle, free, usable)
    return CameraSolution(
        camera=fit.bundle.cameras[0],
        lens=lens,
        T_camera_board=_poses(fit),
        residual_px=fit.residual_px[0],
        weight=fit.weight[0],
        sigma_px=float(fit.sigma_px[0]),
        expected_sigma_px=float(np.nanmedian(corners.sigma_px[fit.used])),
        view_sigma_px=fit.view_sigma_px[0],
        left_out=_reasons(fit, reasons),
    )


def solve_rig(
    views: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    lens: str,
    left: CameraSolution,
    right: CameraSolution,
    *,
    use: Mask | None = None,
    start: RigSolution | None = None,
) -> RigSolution:
    """Calibrate both cameras, their relative pose and the board's shape together.

    Parameters
    ----------
    views
        The board as each camera saw it; views of one camera alone help that camera.
    board, size_px, lens
        As in `solve_camera`.
    left, right
        Each camera alone, from the same views with the same lens.
    use
        (views,) which ones may be fitted; the others get their best pose only, as held-out evidence. All if None.
    start
        A solution that is nearly right already, of the same views and lens.

    Raises
    ------
    CalibrationError
        If fewer than 3 views show enough of the board to both cameras, or the cameras alone are not of that lens and
        size.
    RigError
        If what comes out is no rig: swapped cameras, an impossible baseline.
    """
    if {left.lens, right.lens} != {lens} or {left.camera.size_px, right.camera.size_px} != {tuple(size_px)}:
        raise CalibrationError(
            f"each camera alone must have the lens {lens} and images of {size_px[0]}x{size_px[1]}, but they have "
            f"{left.lens} {left.camera.size_px} and {right.lens} {right.camera.size_px}: solve them again"
        )
    in_left, in_right = _stack(left.T_camera_board), _stack(right.T_camera_board)
    by_left, by_right = ~np.isnan(in_left[:, 0, 0]), ~np.isnan(in_right[:, 0, 0])
    wanted = np.ones(len(views), bool) if use is None else use
    pairs = by_left & by_right & wanted
    if pairs.sum() < FEWEST_VIEWS:
        raise CalibrationError(
            f"{pairs.sum()} views show enough of the board to both cameras, but {FEWEST_VIEWS} or more are needed: "
            "hold the board where both see it"
        )
    count = len(board.points_m)
    seen_left, seen_right = corners_of([v.left for v in views], count), corners_of([v.right for v in views], count)
    corners = _only(seen_left, by_left), _only(seen_right, by_right)
    cameras = (left.camera, right.camera) if start is None else (start.rig.left, start.rig.right)
    problem = knowledge(cameras, board, corners)
    if start is None:
        good = pairs & [not (a or b) for a, b in zip(left.left_out, right.left_out, strict=True)]
        some = good if good.any() else pairs
        T_left_right, shape = relative_pose(in_left[some], in_right[some]), np.zeros(len(problem.shape.sigma_m))
        known = np.full_like(in_left, np.nan)
    else:
        T_left_right, shape, known = start.rig.T_left_right, start.shape, _stack(start.T_left_board)
    via_right = T_left_right @ in_right
    own = np.where(np.isnan(known), np.where(np.isnan(in_left), via_right, in_left), known)
    bundle = Bundle(cameras, T_left_right, own, shape)
    if start is None:
        bundle = best_poses(problem, bundle, by_left | by_right, (in_left, via_right))
    fit = fit_views(problem, bundle, np.ones(len(problem.sigma), bool), (by_left | by_right) & wanted)
    reasons = ["not asked for" * bool(not asked) for asked in wanted]
    return _rig_solution(problem, board, lens, fit, reasons)


def _rig_solution(problem: Problem, board: Board, lens: str, fit: Fit, reasons: Sequence[str]) -> RigSolution:
    left, right = fit.bundle.cameras
    rig = StereoRig(left, right, fit.bundle.T_left_right)
    told = evidence(problem.of(fit.used), fit.used_bundle, np.ones(len(problem.sigma), bool))
    factor = inflation(told, rig)
    cov = factor**2 * covariance(told.total)
    count, basis = fit.bundle.ends[-1], problem.shape.basis
    of_rig = cov[:count, :count].copy()
    if np.isfinite(board.square_sigma_m):  # no image shows the scale: it stretches the translation
        stretch = board.square_sigma_m / board.square_m * rig.T_left_right[:3, 3]
        of_rig[-3:, -3:] += np.outer(stretch, stretch)
    return RigSolution(
        rig=replace(rig, covariance=RigCovariance(rig_parameters(left, right), of_rig)),
        lens=lens,
        board_heights_m=basis @ fit.bundle.shape,
        board_heights_sigma_m=np.sqrt(np.einsum("nk,kl,nl->n", basis, cov[count:, count:], basis)),
        T_left_board=_poses(fit),
        residual_px=fit.residual_px,
        weight=fit.weight,
        sigma_px=(float(fit.sigma_px[0]), float(fit.sigma_px[1])),
        view_sigma_px=fit.view_sigma_px,
        left_out=_reasons(fit, reasons),
        inflation=factor,
        information=told.total,
        shape=fit.bundle.shape,
        tau=told.tau,
    )


def _unusable(seen: Mask, board: Board) -> str:
    """Say why a camera cannot use a view; "" if it can."""
    if not seen.any():
        return "the board was not seen"
    if seen.sum() < FEWEST_POINTS:
        return f"only {seen.sum()} points of the board were seen, {FEWEST_POINTS} or more are needed"
    return "the points that were seen lie on one line" if is_line(board.points_m[seen]) else ""


def _check_count(usable: Mask, reasons: Sequence[str]) -> None:
    if usable.sum() < FEWEST_VIEWS:
        why = next((f" (one of the others: {reason})" for reason in reasons if reason), "")
        raise CalibrationError(
            f"{usable.sum()} of {len(usable)} views show enough of the board{why}, but {FEWEST_VIEWS} or more are "
            "needed: take more pictures"
        )


def _reasons(fit: Fit, reasons: Sequence[str]) -> tuple[str, ...]:
    """Say of each view why it was not used; `reasons` are those known before."""
    said = []
    for view, reason in enumerate(reasons):
        if reason or fit.used[view]:
            said.append(reason)
        elif np.isnan(fit.view_ratio[:, view]).all():
            said.append("no pose of the board fits")
        else:
            side = int(np.nanargmax(fit.view_ratio[:, view]))
            image = ("left image", "right image")[side] if len(fit.sigma_px) == 2 else "image"
            size, ratio = fit.view_sigma_px[side, view], fit.view_ratio[side, view]
            said.append(f"residuals of {size:.2g} px in the {image}, {ratio:.1f} times those of the other views")
    return tuple(said)


def _two_poses(camera: Camera, board: Board, corners: Corners) -> tuple[FloatArray, FloatArray]:
    """Return the better and the other pose of every view, (views, 4, 4); NaN where there is none."""
    found = np.full((2, len(corners.points_px), 4, 4), np.nan)
    for view, rays in enumerate(unproject(camera, corners.points_px)):
        for which, T in enumerate(board_poses(board.points_m, rays)):
            found[which, view] = T
    return found[0], found[1]


def _poses(fit: Fit) -> tuple[FloatArray | None, ...]:
    return tuple(None if np.isnan(T[0, 0]) else T for T in fit.bundle.T_left_board)


def _stack(poses: Sequence[FloatArray | None]) -> FloatArray:
    return np.stack([np.full((4, 4), np.nan) if T is None else T for T in poses])


def _only(corners: Corners, views: Mask) -> Corners:
    """Return the corners with nothing seen outside these views."""
    blank = np.where(views[:, None], 0.0, np.nan)
    return Corners(corners.points_px + blank[..., None], corners.sigma_px + blank)
