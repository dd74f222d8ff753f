"""Calibrate: coverage. A solved rig and its views in; what they miss, and the next view that helps most, out."""

from collections.abc import Sequence
from itertools import product

import numpy as np

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import right_from_left
from roadblock.geometry.uncertainty import calibration_jacobian, seen_points
from roadblock.stages.calibrate.adjust import Bundle, Mask, corners_of, normal_equations
from roadblock.stages.calibrate.bundle import RigSolution
from roadblock.stages.calibrate.start import knowledge
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.calibration import Coverage, ViewFit
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray

ROWS, COLUMNS = 6, 8
"""Areas of an image in which points are counted."""

NAMES = (("upper left", "top", "upper right"), ("left", "middle", "right"), ("lower left", "bottom", "lower right"))
ROW_PARTS, COLUMN_PARTS = ((0, 2), (2, 4), (4, 6)), ((0, 3), (3, 5), (5, 8))
"""Which rows and columns of areas make up the 3x3 named ones; the outer ones are the wider."""

LEAST_TILT_DEG = 20.0
FLAT_DEG = 5.0
"""Boards turned by less than this all count as parallel to the image."""

LEAST_SPREAD = 1.5
"""Farthest over nearest board below which all count as equally far."""

JUDGED_AT_M = 20.0
SHARES = (0.5, 0.25, 0.125)
"""Widths of the board over that of the image at which the next view is tried."""

PLACES = ((0.2, "left"), (0.5, ""), (0.8, "right")), ((0.2, "upper"), (0.5, ""), (0.8, "lower"))
TILT_DEG = 35.0
TILTS = (
    ((0, 0), "facing the cameras"),
    ((1, 0), "turned with its left side nearer"),
    ((-1, 0), "turned with its right side nearer"),
    ((0, 1), "tilted with its lower side nearer"),
    ((0, -1), "tilted with its upper side nearer"),
)
LEAST_GAIN = 0.99
"""A next view that leaves more than this of the range error is not worth naming."""


def coverage_of(views: Sequence[BoardView], fits: Sequence[ViewFit], board: Board, solution: RigSolution) -> Coverage:
    """Return what the used ones of these views show and miss, and the next view that would help most.

    Parameters
    ----------
    views, fits
        Every view, and how it fits.
    board
        The board.
    solution
        The rig, and how much the views tell about it.
    """
    used = [(view, fit.T_left_board) for view, fit in zip(views, fits, strict=True) if not fit.left_out]
    size_px = solution.rig.left.size_px
    counts = [point_counts([getattr(view, side) for view, _ in used], size_px) for side in ("left", "right")]
    poses = np.array([T for _, T in used if T is not None]).reshape(-1, 4, 4)
    middle = np.r_[board.points_m.mean(0), 1.0]
    distances_m = np.linalg.norm((poses @ middle)[:, :3], axis=-1)
    tilts_deg = board_tilts_deg(poses)
    missing = [
        *missing_areas(counts[0], "left"),
        *missing_areas(counts[1], "right"),
        *missing_distances(distances_m),
        *missing_tilts(tilts_deg),
    ]
    next_view, gain = best_next_view(board, solution)
    return Coverage(counts[0], counts[1], distances_m, tilts_deg, tuple(missing), next_view, gain)


def board_tilts_deg(poses: FloatArray) -> FloatArray:
    """Return (n, 2) turns about the vertical and horizontal axis of `T_camera_board` (n, 4, 4), as in `Coverage`."""
    nx, ny, nz = np.moveaxis(poses[:, :3, 2], -1, 0)
    return np.asarray(np.degrees(np.stack([np.arctan2(-nx, nz), np.arctan2(ny, nz)], -1)))


def check_tilts(poses: Sequence[FloatArray | None]) -> None:
    """Check that not all boards are parallel to the image: then focal length and distance cannot be told apart.

    Raises
    ------
    CalibrationError
        If they are.
    """
    largest = np.abs(board_tilts_deg(np.array([T for T in poses if T is not None]))).max()
    if largest < FLAT_DEG:
        raise CalibrationError(
            f"all boards are parallel to the image (tilted by {largest:.1f} deg at most), which cannot tell the focal "
            "length from the distance: take some with the board tilted by 30 to 45 deg to every side"
        )


def point_counts(sightings: Sequence[Sighting | None], size_px: tuple[int, int]) -> FloatArray:
    """Return (`ROWS`, `COLUMNS`) how many points lie in each area of an image of `size_px` (width, height)."""
    points = np.concatenate([np.zeros((0, 2)), *(s.points_px for s in sightings if s is not None)])
    (width, height) = size_px
    counts, *_ = np.histogram2d(
        points[:, 1], points[:, 0], (ROWS, COLUMNS), ((-0.5, height - 0.5), (-0.5, width - 0.5))
    )
    return np.asarray(counts)


def empty_areas(counts: FloatArray) -> list[str]:
    """Return the names of those of 3x3 areas of an image that hold no point."""
    return [
        NAMES[row][column]
        for (row, (top, bottom)), (column, (left, right)) in product(enumerate(ROW_PARTS), enumerate(COLUMN_PARTS))
        if not counts[top:bottom, left:right].any()
    ]


def missing_areas(counts: FloatArray, side: str) -> list[str]:
    """Say where an image shows no points."""
    empty = empty_areas(counts)
    if not empty:
        return []
    if len(empty) > 4:
        seen = [name for row in NAMES for name in row if name not in empty]
        return [f"points only in the {_listed(seen)} of the {side} image: hold the board everywhere in it"]
    return [f"no point in the {_listed(empty)} of the {side} image"]


def missing_distances(distances_m: FloatArray) -> list[str]:
    """Say if all boards are about equally far away."""
    if not len(distances_m) or distances_m.max() >= LEAST_SPREAD * distances_m.min():
        return []
    near, far = distances_m.min(), distances_m.max()
    return [f"all boards between {near:.2g} and {far:.2g} m away: add some at half or at twice that distance"]


def missing_tilts(tilts_deg: FloatArray) -> list[str]:
    """Say about which axes no board was turned far."""
    axes = zip(("vertical", "horizontal"), np.abs(tilts_deg).max(0, initial=0.0), strict=True)
    return [
        f"no board turned about the {axis} axis by more than {largest:.0f} deg: turn some by 30 to 45 deg"
        for axis, largest in axes
        if largest < LEAST_TILT_DEG
    ]


def _listed(names: Sequence[str]) -> str:
    return " and the ".join([*([", the ".join(names[:-1])] if names[1:] else []), names[-1]])


def best_next_view(board: Board, solution: RigSolution) -> tuple[str, float]:
    """Return the view that would lower the range error at 20 m most, in words, and what it would leave of it.

    Each candidate adds its information about the rig and the board's shape, its own pose eliminated, to that of the
    views at hand.

    Returns
    -------
    "" and NaN if no view fits into both images or the rig sees nothing at 20 m; "" and the best share if that is not
    worth naming.
    """
    rig = solution.rig
    points = seen_points(rig, JUDGED_AT_M).reshape(-1, 3)
    by_rig = calibration_jacobian(rig, points)[:, 2]
    by_rig = by_rig[~np.isnan(by_rig).any(-1)]
    candidates = _candidates(rig, board)
    if not candidates or not len(by_rig):
        return "", float("nan")
    told = _information(np.stack([T for _, T in candidates]), board, solution)
    before = _range_variance(solution.information, by_rig)
    after = [_range_variance(solution.information + each, by_rig) for each in told]
    best = int(np.argmin(after))
    gain = float(np.sqrt(after[best] / before))
    return (f"hold the board {candidates[best][0]}" if gain < LEAST_GAIN else ""), gain


def _candidates(rig: StereoRig, board: Board) -> list[tuple[str, FloatArray]]:
    """Return views, in words and as `T_left_board`, that both cameras see whole."""
    places = [
        (f"{down} {across}".strip() or "middle", np.array([u, v]) * rig.left.size_px)
        for (u, across), (v, down) in product(*PLACES)
    ]
    rays = unproject(rig.left, np.stack([pixel for _, pixel in places]))
    tried = []
    for share, ((place, _), ray), ((side, top), tilt) in product(SHARES, zip(places, rays, strict=True), TILTS):
        z_m = rig.left.fx_px * max(board.size_m) / (share * rig.left.size_px[0])
        R = rotation_from_rotvec(np.radians(TILT_DEG) * np.array([-top, -side, 0.0]))
        T = pose(R, ray / ray[2] * z_m - R @ (board.points_m.max(0) / 2))
        tried.append((f"at the {place} of the left image, {z_m:.2g} m away, {tilt}", T))
    points = np.stack([transform(T, board.points_m) for _, T in tried])
    whole = _whole(rig.left, points) & _whole(rig.right, right_from_left(rig, points))
    return [candidate for candidate, seen in zip(tried, whole, strict=True) if seen]


def _whole(camera: Camera, points: FloatArray) -> Mask:
    """Return which boards (boards, n, 3) lie in the image with all their points."""
    pixels = project(camera, points)
    return np.asarray(((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1.0)).all((1, 2)))


def _information(poses: FloatArray, board: Board, solution: RigSolution) -> FloatArray:
    """Return (views, c, c) what boards at these poses would tell, seen as well as the ones at hand."""
    cameras = (solution.rig.left, solution.rig.right)
    nothing = corners_of([None] * len(poses), len(board.points_m))
    problem = knowledge(cameras, board, (nothing, nothing))
    bundle = Bundle(cameras, solution.rig.T_left_right, poses, solution.shape)
    shape = (len(poses), len(board.points_m))
    weight = [np.full(shape, 1 / sigma**2) for sigma in solution.sigma_px]
    errors = [np.zeros((*shape, 2))] * 2
    view = normal_equations(problem, bundle, errors, weight, np.ones(len(problem.sigma), bool))
    return np.asarray(view.shared - view.across @ np.linalg.inv(view.poses) @ view.across.swapaxes(1, 2))


def _range_variance(information: FloatArray, by_rig: FloatArray) -> float:
    """Return the mean variance of ranges whose slopes by the rig's parameters are (points, p)."""
    scale = 1 / np.sqrt(information.diagonal())
    slopes = np.zeros((len(by_rig), len(information)))
    slopes[:, : by_rig.shape[1]] = by_rig
    slopes = slopes * scale
    solved = np.linalg.solve(information * np.outer(scale, scale), slopes.T)
    return float(np.mean((slopes.T * solved).sum(0)))
