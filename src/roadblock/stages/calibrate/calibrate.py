"""Calibrate: views of a board in, a rig with a known range error out: the order of the paper's sections 2.1 and 3.2."""

from collections.abc import Callable, Sequence
from itertools import count, product

import numpy as np

from roadblock.errors import CalibrationError
from roadblock.geometry.uncertainty import range_sigma
from roadblock.stages.calibrate.analysis import camera_fit, epipolar_rms_px, rms_px, view_fits
from roadblock.stages.calibrate.bundle import CameraSolution, RigSolution, solve_camera, solve_rig
from roadblock.stages.calibrate.coverage import check_tilts, coverage_of
from roadblock.stages.calibrate.lens import TRIALS, choose_lens
from roadblock.stages.calibrate.settings import CalibrateSettings
from roadblock.stages.calibrate.turned import pair_up
from roadblock.stages.calibrate.verdict import WRONG_WEIGHT, judged
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.calibration import RANGES_M, Calibration, LensTrial
from roadblock.values.camera import Camera
from roadblock.values.checks import image_size

__all__ = ["CalibrateSettings", "calibrate"]

Progress = Callable[[str, int, int], None]
"""Called with what is done next, how many steps are done, and how many there are."""

STEPS = 5
"""Without those that choose a lens."""

SIDES = ("left", "right")
FIRST_LENSES = ("brown_conrady5", "kannala_brandt")
"""An ordinary lens and a fisheye: one of them fits well enough to tell which way round boards are."""

CLEARLY = 0.8
"""Residuals of the fisheye over those of the ordinary lens below which it is taken for a start."""

Cameras = tuple[CameraSolution, CameraSolution]


def calibrate(
    views: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    settings: CalibrateSettings | None = None,
    progress: Progress | None = None,
) -> Calibration:
    """Calibrate a rig from views of a board.

    Parameters
    ----------
    views
        The board as it was found; views of one camera alone help that camera.
    board
        The board.
    size_px
        (width, height) of all images.
    settings
        How.
    progress
        Told what is done next.

    Returns
    -------
    The rig with its evidence. One that the views cannot support, but that can be had, comes with the verdict "refused".

    Raises
    ------
    CalibrationError
        If no rig can be had: too few views, left and right do not belong together, mirrored or swapped pictures,
        boards that were never tilted, points outside the images.
    RigError
        If what comes out is no rig after all.
    ValueRefusedError
        If `size_px` is no image size.
    """
    settings = settings or CalibrateSettings()
    tell = _teller(progress, STEPS + (1 + len(TRIALS)) * (settings.lens == "auto"))
    views = [view for view in views if view.left is not None or view.right is not None]
    _check_views(views, board, image_size("size_px", size_px))

    tell("each camera alone")
    alone = _each_alone(views, board, size_px, settings.lens)
    check_tilts([*alone[0].T_camera_board, *alone[1].T_camera_board])
    tell("which way round the boards are")
    pairing = pair_up(views, alone[0].T_camera_board, alone[1].T_camera_board, board)
    alone = _again_where_turned(views, pairing.views, board, size_px, alone)
    views = pairing.views
    lens, trials = _lens(views, board, size_px, settings.lens, tell)
    alone = _with_lens(views, board, size_px, lens, alone)
    tell("both cameras and all boards together")
    solution = solve_rig(views, board, size_px, lens, *alone)
    tell("what the views miss")
    fits = view_fits(views, *alone, solution, pairing.agrees)
    coverage = coverage_of(views, fits, board, solution)
    tell("how far ranges will be off")
    used = [not fit.left_out for fit in fits]
    return judged(
        Calibration(
            rig=solution.rig,
            board=board,
            board_heights_m=solution.board_heights_m,
            board_heights_sigma_m=solution.board_heights_sigma_m,
            views=fits,
            cameras_alone=(
                camera_fit([view.left for view in views], alone[0]),
                camera_fit([view.right for view in views], alone[1]),
            ),
            lens_trials=trials or _given(solution),
            rms_px=rms_px(solution.residual_px[:, used]),
            sigma_px=solution.sigma_px,
            epipolar_rms_px=epipolar_rms_px(solution.rig, [v for v, use in zip(views, used, strict=True) if use]),
            inflation=solution.inflation,
            range_sigma_m={z_m: range_sigma(solution.rig, z_m) for z_m in RANGES_M},
            coverage=coverage,
            verdict="refused",
        )
    )


def _teller(progress: Progress | None, steps: int) -> Callable[[str], None]:
    """Return a function that names the next step and counts those before it."""
    done = count()
    return lambda what: None if progress is None else progress(what, next(done), steps)


def _check_views(views: Sequence[BoardView], board: Board, size_px: tuple[int, int]) -> None:
    for view, side in product(views, ("left", "right")):
        sighting: Sighting | None = getattr(view, side)
        if sighting is None:
            continue
        if sighting.ids.max(initial=0) >= len(board.points_m):
            raise CalibrationError(
                f"view {view.name} shows point {sighting.ids.max()} of a board of {len(board.points_m)}: "
                "it was searched for another board"
            )
        outside = ((sighting.points_px < -0.5) | (sighting.points_px > np.array(size_px) - 0.5)).any(-1)
        if outside.any():
            u, v = sighting.points_px[outside][0]
            raise CalibrationError(
                f"view {view.name} has a point at ({u:.0f}, {v:.0f}), outside of images of {size_px[0]}x{size_px[1]}: "
                "all pictures of both cameras must have one size"
            )


def _each_alone(views: Sequence[BoardView], board: Board, size_px: tuple[int, int], lens: str) -> Cameras:
    """Solve each camera alone; if any lens may be, with the one of `FIRST_LENSES` that will do."""
    first, *others = [
        (_alone(views, "left", board, size_px, name), _alone(views, "right", board, size_px, name))
        for name in (FIRST_LENSES if lens == "auto" else (lens,))
    ]
    enough = CLEARLY * (first[0].sigma_px + first[1].sigma_px)
    return next((cameras for cameras in others if cameras[0].sigma_px + cameras[1].sigma_px < enough), first)


def _alone(
    views: Sequence[BoardView],
    side: str,
    board: Board,
    size_px: tuple[int, int],
    lens: str,
    start: Camera | None = None,
) -> CameraSolution:
    try:
        return solve_camera([getattr(view, side) for view in views], board, size_px, lens, start)
    except CalibrationError as error:
        raise CalibrationError(f"{side} camera: {error}") from None


def _again_where_turned(
    before: Sequence[BoardView],
    after: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    alone: Cameras,
) -> Cameras:
    """Solve those cameras again some of whose boards were numbered anew."""
    left, right = (
        solution
        if all(getattr(a, side) is getattr(b, side) for a, b in zip(before, after, strict=True))
        else _alone(after, side, board, size_px, solution.lens, solution.camera)
        for side, solution in zip(SIDES, alone, strict=True)
    )
    return left, right


def _lens(
    views: Sequence[BoardView],
    board: Board,
    size_px: tuple[int, int],
    lens: str,
    tell: Callable[[str], None],
) -> tuple[str, tuple[LensTrial, ...]]:
    """Return the lens to use and the evidence for it; none where it was given."""
    if lens != "auto":
        return lens, ()
    tell("lens models")
    return choose_lens(views, board, size_px, lambda done, total: tell(f"lens models: {done} of {total} tried"))


def _with_lens(
    views: Sequence[BoardView], board: Board, size_px: tuple[int, int], lens: str, alone: Cameras
) -> Cameras:
    """Return each camera alone with this lens."""
    if alone[0].lens == lens:
        return alone
    return _alone(views, "left", board, size_px, lens), _alone(views, "right", board, size_px, lens)


def _given(solution: RigSolution) -> tuple[LensTrial, ...]:
    """Return what there is to say about a lens that was not chosen: how well it fits, wrong corners apart."""
    used = np.array([not why for why in solution.left_out])
    right = np.where(solution.weight[:, used] < WRONG_WEIGHT, np.nan, 1.0)
    fitted_px = rms_px(solution.residual_px[:, used] * right[..., None])
    count = sum(len(camera.parameters) for camera in (solution.rig.left, solution.rig.right))
    return (LensTrial(solution.lens, count, fitted_px, float("nan"), "given"),)
