"""Calibrate: which way round boards are. Views and each camera's board poses in, views of one order of points out.

A board that looks alike turned may be numbered from its other end in any picture. The two cameras of a rig keep
their relative pose, so of all ways to number a pair of pictures the right one is that which gives the pose most pairs
share. The same vote finds pictures that are no pairs, mirrored ones and swapped cameras.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import BASELINE_RANGE_M
from roadblock.values.checks import FloatArray

AGREE_DEG = 10.0
"""Relative poses of two pairs agree up to this angle: cameras calibrated alone are off by a degree or two, a board
numbered from its other end by twice its tilt."""

AGREE_SHARE = 0.15
"""... and up to this share of the board's distance in their translation."""

SHARE_OF_PAIRS = 0.5
"""So many of the pairs must share one relative pose: otherwise there is none."""

Poses = Sequence[FloatArray | None]
"""`T_camera_board` per view, 4x4, metres; None where that camera did not see the board."""


@dataclass(frozen=True, eq=False)
class Pairing:
    """How the two cameras sit to each other, as far as each camera alone can tell.

    Attributes
    ----------
    views
        With one order of the points in both cameras and, as far as it can be told, in all views: each board's rows
        are taken to lie within half a turn's step (90 degrees) of how they lie in most pictures.
    turned
        How many pairs were numbered from different ends in left and right.
    T_left_right
        4x4, the median of the agreeing pairs, metres.
    agrees
        (n,) bool, whether each view's pair agrees with it; False for views without a pair.
    """

    views: tuple[BoardView, ...]
    turned: int
    T_left_right: FloatArray
    agrees: NDArray[np.bool_]


def pair_up(views: Sequence[BoardView], left: Poses, right: Poses, board: Board) -> Pairing:
    """Find the relative pose that most pairs share, and number all boards from one end.

    Parameters
    ----------
    views, board
        As they were found.
    left, right
        Each view's board as each camera alone sees it.

    Raises
    ------
    CalibrationError
        If there are no pairs, most of them share no relative pose, pictures are mirrored, or the cameras are swapped,
        one and the same, above or behind each other, or impossibly far apart.
    """
    turns = board_turns(board)
    T_left_right, turn, agrees = _vote(left, right, [inverse(T) for _, T in turns])
    _check_votes(agrees, left, right, board)
    _check_pose(T_left_right, board)
    numbered = [
        replace(view, right=_renumbered(view.right, turns[k][0])) if k else view
        for view, k in zip(views, turn, strict=True)
    ]
    return Pairing(_from_one_end(numbered, board), int(np.count_nonzero(turn)), T_left_right, agrees)


def board_turns(board: Board) -> list[tuple[NDArray[np.int64], FloatArray]]:
    """Return the turns of a board that no picture can tell, in steps of equal angle, the identity first.

    Each as the new id of every point, and the 4x4 transform of the board's frame that brings each point to the place
    of its new id. A chessboard of equal, even sides has four, other boards that look alike turned two.
    """
    points = board.points_m
    found = []
    for quarter in range(4) if board.looks_alike_turned else (0,):
        T = _about_center(rotation_from_rotvec([0, 0, quarter * np.pi / 2]), board)
        gaps, ids = cKDTree(points).query(points @ T[:3, :3].T + T[:3, 3])
        same_colours = quarter % 2 == 0 or board.columns % 2 == 0
        if same_colours and np.max(gaps) < 1e-3 * board.square_m:
            found.append((np.asarray(ids, np.int64), T))
    return found


def _about_center(R: FloatArray, board: Board) -> FloatArray:
    center = board.points_m.max(0) / 2
    return pose(R, center - R @ center)


def _renumbered(sighting: Sighting | None, ids: NDArray[np.int64]) -> Sighting | None:
    return None if sighting is None else replace(sighting, ids=ids[sighting.ids])


def _vote(
    left: Poses, right: Poses, changes: Sequence[FloatArray], lens_side: FloatArray | None = None
) -> tuple[FloatArray, NDArray[np.intp], NDArray[np.bool_]]:
    """Return the relative pose most pairs share, which change each right board needs for it, and which pairs agree."""
    T_left, T_right = (np.stack([np.full((4, 4), np.nan) if T is None else T for T in side]) for side in (left, right))
    flip = np.eye(4) if lens_side is None else lens_side
    relative = np.stack([T_left @ np.linalg.inv(flip @ T_right @ change) for change in changes], 1)
    R = relative[..., :3, :3].reshape(len(T_left), -1, 9)
    agree = 1 + 2 * np.cos(np.radians(AGREE_DEG))  # the trace of Ra^T Rb, that is the sum of their products
    flat = R.reshape(-1, 9)
    votes = (flat @ flat.T >= agree).reshape(-1, *R.shape[:2]).any(-1).sum(-1)
    # Boards that all lie alike agree either way round: then the cameras stand the same way up.
    upright = np.where(votes >= 0.9 * votes.max(), flat @ np.eye(3).ravel(), np.nan)
    best = flat[np.argmax(np.nan_to_num(upright, nan=-np.inf))]
    turn = np.argmax(np.nan_to_num(R @ best, nan=-np.inf), -1)
    mine = relative[np.arange(len(turn)), turn]
    agrees = mine[:, :3, :3].reshape(-1, 9) @ best >= agree
    distance = np.linalg.norm(T_left[:, :3, 3], axis=-1)
    t = np.median(mine[agrees, :3, 3], axis=0) if agrees.any() else np.zeros(3)
    agrees &= np.linalg.norm(mine[:, :3, 3] - t, axis=-1) <= AGREE_SHARE * distance
    R_mean = Rotation.from_matrix(mine[agrees, :3, :3]).mean().as_matrix() if agrees.any() else np.eye(3)
    return pose(R_mean, t), turn, agrees


def _check_votes(agrees: NDArray[np.bool_], left: Poses, right: Poses, board: Board) -> None:
    pairs = sum(a is not None and b is not None for a, b in zip(left, right, strict=True))
    if not pairs:
        raise CalibrationError("no view shows the board to both cameras: hold it where both see it")
    count = int(agrees.sum())
    camera = np.diag([-1.0, 1.0, 1.0, 1.0])
    mirrors = [_about_center(R @ camera[:3, :3], board) for R in map(rotation_from_rotvec, _quarters())]
    T_left_right, _, mirrored = _vote(left, right, mirrors, camera)
    if mirrored.sum() > max(count, SHARE_OF_PAIRS * pairs):
        side = "right" if T_left_right[0, 3] > 0 else "left"  # mirroring the other one instead gives the mirrored pose
        raise CalibrationError(
            f"the {side} pictures look mirrored: {mirrored.sum()} of {pairs} pairs fit together once they are flipped, "
            f"{count} as they are; turn mirroring off in that camera or flip its pictures"
        )
    if count < SHARE_OF_PAIRS * pairs:
        raise CalibrationError(
            f"left and right do not belong together: only {count} of {pairs} pairs agree on how the cameras sit to "
            "each other; pair pictures that were taken at the same moment by one unchanged rig"
        )


def _quarters() -> FloatArray:
    return np.outer(np.arange(4) * np.pi / 2, [0.0, 0.0, 1.0])


def _check_pose(T_left_right: FloatArray, board: Board) -> None:
    x, y, z = T_left_right[:3, 3]
    baseline, (low, high) = float(np.hypot(np.hypot(x, y), z)), BASELINE_RANGE_M
    with_squares = f"with squares of {1e3 * board.square_m:g} mm"
    if baseline < low:
        raise CalibrationError(
            f"left and right look like the same camera: {with_squares} they come out {1e3 * baseline:.1f} mm apart; "
            "give the pictures of both cameras, and the length of a square with its unit"
        )
    if baseline > high:
        raise CalibrationError(
            f"the cameras come out {baseline:.1f} m apart {with_squares}, but on one vehicle they sit up to {high:g} m "
            "apart: give the length of a square with its unit, as 25mm"
        )
    if abs(x) < 0.5 * baseline:
        raise CalibrationError(
            f"the right camera comes out at x={x:.3g}, y={y:.3g}, z={z:.3g} m of the left one, but must sit beside it: "
            "rigs with one camera above or behind the other are not supported; if yours are beside each other, the "
            "views cannot tell: take some with the board tilted by 30 to 45 deg"
        )
    if x < 0:
        raise CalibrationError(
            f"the cameras look swapped: the right one comes out {-x:.3g} m to the left of the left one; exchange LEFT "
            "and RIGHT (or, if both cameras deliver mirrored pictures, turn mirroring off)"
        )


def _from_one_end(views: Sequence[BoardView], board: Board) -> tuple[BoardView, ...]:
    """Turn whole views so that their rows run as most of them do; one end of the board is then the same in all."""
    turns = board_turns(board)
    step = 2 * np.pi / len(turns)
    angles = np.array([_row_angle(view.left or view.right, board) for view in views])
    mean = np.angle(np.exp(1j * angles * len(turns)).sum()) / len(turns)
    k = np.rint((angles - mean) / step).astype(int) % len(turns)
    k = (k - np.bincount(k).argmax()) % len(turns)
    return tuple(
        BoardView(view.name, _renumbered(view.left, turns[i][0]), _renumbered(view.right, turns[i][0])) if i else view
        for view, i in zip(views, k, strict=True)
    )


def _row_angle(sighting: Sighting | None, board: Board) -> float:
    """Return which way the board's rows run in the picture, radians from its u axis towards v."""
    if sighting is None or len(sighting.ids) < 3:
        return 0.0
    on_board = board.points_m[sighting.ids, :2]
    slopes, *_ = np.linalg.lstsq(on_board - on_board.mean(0), sighting.points_px - sighting.points_px.mean(0))
    return float(np.arctan2(slopes[0, 1], slopes[0, 0]))
