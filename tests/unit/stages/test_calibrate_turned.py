"""Which way round boards are: poses by OpenCV from sightings of a crooked rig, numbered at random."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibration_examples import FLAT, example_pose, example_rig, example_sighting

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import inverse, pose, transform
from roadblock.geometry.stereo import right_from_left
from roadblock.stages.calibrate.turned import Pairing, board_turns, pair_up
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray

EVEN = Board("chessboard", 6, 4, 0.03)
QUARTERS = Board("chessboard", 4, 4, 0.03)
DOTS = Board("circles", 4, 6, 0.02)
RIG = example_rig(size_px=(640, 480))


def seen_by_both(board: Board, rng: np.random.Generator, count: int, rig: StereoRig = RIG) -> list[BoardView]:
    """Return views that show the whole board to both cameras."""
    views: list[BoardView] = []
    while len(views) < count:
        points = transform(example_pose(rig, board, rng, (0.5, 1.2)), board.points_m)
        left = example_sighting(rig.left, points, rng, 0.05, False, 0.05)
        right = example_sighting(rig.right, right_from_left(rig, points), rng, 0.05, False, 0.05)
        if left and right:
            views.append(BoardView(f"{len(views):02d}", left, right))
    return views


def poses(sightings: list[Sighting | None], camera: Camera, board: Board) -> list[FloatArray | None]:
    """Return OpenCV's pose of each board."""
    found: list[FloatArray | None] = []
    for seen in sightings:
        if seen is None:
            found.append(None)
            continue
        _, r, t = cv2.solvePnP(
            board.points_m[seen.ids], seen.points_px, camera.K, camera.distortion, flags=cv2.SOLVEPNP_IPPE
        )
        found.append(pose(cv2.Rodrigues(r)[0], t))
    return found


def paired(views: list[BoardView], board: Board, left: Camera = RIG.left, right: Camera = RIG.right) -> Pairing:
    in_left, in_right = (poses([getattr(v, s) for v in views], c, board) for s, c in (("left", left), ("right", right)))
    return pair_up(views, in_left, in_right, board)


def other_way(sighting: Sighting, board: Board, quarters: int = 2) -> Sighting:
    """Number a board of `columns` x `rows` after turning it, by its rows and columns."""
    grid = np.rot90(np.arange(len(board.points_m)).reshape(board.rows, board.columns), quarters)
    return replace(sighting, ids=grid.ravel()[sighting.ids])


def mirrored(camera: Camera) -> Camera:
    """Return the camera of mirrored pictures."""
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(camera, cx_px=camera.size_px[0] - 1 - camera.cx_px, distortion=np.array([k1, k2, p1, -p2, k3]))


def in_mirror(sighting: Sighting, board: Board, *, upside_down: bool = False) -> Sighting:
    """Return what a detector finds in a mirrored picture: it numbers the mirrored board right-handed, too."""
    row, column = np.divmod(sighting.ids, board.columns)
    ids = (board.rows - 1 - row) * board.columns + column if upside_down else (row + 1) * board.columns - 1 - column
    return replace(sighting, ids=ids, points_px=sighting.points_px * (-1, 1) + (RIG.left.size_px[0] - 1, 0))


@pytest.mark.parametrize(("board", "count"), [(FLAT, 1), (EVEN, 2), (QUARTERS, 4), (DOTS, 2)])
def test_turns_bring_each_point_to_the_place_of_its_new_id(board: Board, count: int) -> None:
    turns = board_turns(board)
    assert len(turns) == count
    for step, (ids, T) in enumerate(turns):
        np.testing.assert_allclose(transform(T, board.points_m), board.points_m[ids], atol=1e-12)
        angle = np.arctan2(T[1, 0], T[0, 0])
        assert np.exp(1j * angle) == pytest.approx(np.exp(2j * np.pi * step / count))


def test_quarter_turns_of_odd_squares_change_colours() -> None:
    assert len(board_turns(Board("chessboard", 5, 5, 0.03))) == 2


@pytest.mark.parametrize("board", [FLAT, EVEN, DOTS])
def test_healthy_pairs_stay_as_they_are(board: Board) -> None:
    views = seen_by_both(board, np.random.default_rng(3), 12)
    pairing = paired(views, board)
    assert pairing.turned == 0
    assert pairing.agrees.all()
    assert all(a is b for a, b in zip(pairing.views, views, strict=True))
    np.testing.assert_allclose(pairing.T_left_right, RIG.T_left_right, atol=0.01)


@pytest.mark.parametrize("board", [EVEN, DOTS, QUARTERS])
def test_turned_boards_are_numbered_from_one_end_again(board: Board) -> None:
    rng = np.random.default_rng(4)
    views = seen_by_both(board, rng, 20)
    steps = 4 // len(board_turns(board))
    turn_left, turn_right = steps * rng.integers(0, 4 // steps, (2, 20)) * (rng.random((2, 20)) < 0.4)
    spoiled = [
        BoardView(v.name, other_way(v.left, board, int(k)), other_way(v.right, board, int(m)))
        for v, k, m in zip(views, turn_left, turn_right, strict=True)
        if v.left and v.right
    ]
    pairing = paired(spoiled, board)
    assert pairing.turned == np.count_nonzero((turn_left - turn_right) % 4)
    np.testing.assert_allclose(pairing.T_left_right, RIG.T_left_right, atol=0.01)
    for healed, view in zip(pairing.views, views, strict=True):
        for side in ("left", "right"):
            np.testing.assert_array_equal(getattr(healed, side).ids, getattr(view, side).ids)


def test_views_of_one_camera_are_numbered_from_the_end_of_the_others() -> None:
    views = seen_by_both(EVEN, np.random.default_rng(5), 8)
    left, right = views[2].left, views[3].right
    assert left
    assert right
    spoiled = [*views[:2], BoardView("l", other_way(left, EVEN), None), BoardView("r", None, other_way(right, EVEN))]
    pairing = paired([*spoiled, *views[4:]], EVEN)
    assert pairing.agrees.tolist() == [True, True, False, False, True, True, True, True]
    assert pairing.turned == 0
    healed_left, healed_right = pairing.views[2].left, pairing.views[3].right
    assert healed_left
    assert healed_right
    np.testing.assert_array_equal(healed_left.ids, left.ids)
    np.testing.assert_array_equal(healed_right.ids, right.ids)


def test_boards_that_all_lie_alike_take_cameras_that_stand_the_same_way_up() -> None:
    views = [seen_by_both(EVEN, np.random.default_rng(6), 1)[0]] * 6
    turned = [replace(v, right=other_way(v.right, EVEN)) for v in views if v.right]
    pairing = paired(turned, EVEN)
    assert pairing.turned == 6
    np.testing.assert_allclose(pairing.T_left_right, RIG.T_left_right, atol=0.01)


def test_boards_that_are_all_numbered_from_the_other_end_stay_so() -> None:
    views = [
        replace(v, left=other_way(v.left, EVEN), right=other_way(v.right, EVEN))
        for v in seen_by_both(EVEN, np.random.default_rng(6), 6)
        if v.left and v.right
    ]
    pairing = paired(views, EVEN)
    assert all(a is b for a, b in zip(pairing.views, views, strict=True))


def test_most_pairs_outvote_one_that_looks_more_upright() -> None:
    views = seen_by_both(FLAT, np.random.default_rng(6), 6)
    T_left_right = pose(cv2.Rodrigues(np.array([0.1, -0.4, 0.2]))[0], [0.3, 0.01, 0.02])
    in_left = poses([v.left for v in views], RIG.left, FLAT)
    in_right = [inverse(T_left_right) @ T for T in in_left if T is not None]
    in_right[2] = inverse(pose(np.eye(3), [0.3, 0.0, 0.0])) @ in_left[2]
    pairing = pair_up(views, in_left, in_right, FLAT)
    assert np.flatnonzero(~pairing.agrees).tolist() == [2]
    np.testing.assert_allclose(pairing.T_left_right, T_left_right, atol=1e-9)


def test_a_sighting_of_two_points_keeps_its_numbers() -> None:
    views = seen_by_both(EVEN, np.random.default_rng(7), 6)
    few = Sighting(np.array([0, 1]), np.array([[300.0, 200], [320, 201]]), np.full(2, 0.1))
    in_left, in_right = (
        [*poses([getattr(v, s) for v in views], c, EVEN), None] for s, c in (("left", RIG.left), ("right", RIG.right))
    )
    pairing = pair_up([*views, BoardView("few", few, None)], in_left, in_right, EVEN)
    assert pairing.views[-1].left is few


def test_a_single_wrong_pair_is_told_from_the_others() -> None:
    views = seen_by_both(FLAT, np.random.default_rng(8), 10)
    views[4] = replace(views[4], right=views[7].right)
    assert np.flatnonzero(~paired(views, FLAT).agrees).tolist() == [4]


def test_a_pair_that_only_shifted_far_is_told_from_the_others() -> None:
    views = seen_by_both(FLAT, np.random.default_rng(8), 10)
    in_left, in_right = (
        poses([getattr(v, s) for v in views], c, FLAT) for s, c in (("left", RIG.left), ("right", RIG.right))
    )
    moved = in_right[3]
    assert moved is not None
    in_right[3] = moved + np.array([[0, 0, 0, 0.4], *np.zeros((3, 4))])
    assert np.flatnonzero(~pair_up(views, in_left, in_right, FLAT).agrees).tolist() == [3]


def test_pairs_of_different_moments_are_refused() -> None:
    views = seen_by_both(FLAT, np.random.default_rng(9), 12)
    shifted = [replace(v, right=views[i - 1].right) for i, v in enumerate(views)]
    with pytest.raises(CalibrationError, match=r"only \d of 12 pairs agree on how the cameras sit"):
        paired(shifted, FLAT)


@pytest.mark.parametrize("board", [EVEN, FLAT])
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("upside_down", [False, True])
def test_mirrored_pictures_of_one_camera_are_named(board: Board, side: str, upside_down: bool) -> None:
    views = [
        replace(v, **{side: in_mirror(getattr(v, side), board, upside_down=upside_down)})  # type: ignore[arg-type]
        for v in seen_by_both(board, np.random.default_rng(10), 12)
    ]
    cameras = {"left": RIG.left, "right": RIG.right}
    cameras[side] = mirrored(cameras[side])
    with pytest.raises(CalibrationError, match=f"the {side} pictures look mirrored: 12 of 12 pairs"):
        paired(views, board, **cameras)


def test_mirrored_pictures_of_both_cameras_look_swapped_and_the_line_says_so() -> None:
    views = [
        replace(v, left=in_mirror(v.left, FLAT), right=in_mirror(v.right, FLAT))
        for v in seen_by_both(FLAT, np.random.default_rng(11), 12)
        if v.left and v.right
    ]
    with pytest.raises(CalibrationError, match=r"0\.205 m to the left of the left one.*both cameras deliver mirrored"):
        paired(views, FLAT, mirrored(RIG.left), mirrored(RIG.right))


def test_swapped_cameras_are_named() -> None:
    swapped = [BoardView(v.name, v.right, v.left) for v in seen_by_both(FLAT, np.random.default_rng(12), 8)]
    with pytest.raises(CalibrationError, match=r"look swapped.*0\.205 m.*exchange LEFT and RIGHT"):
        paired(swapped, FLAT, RIG.right, RIG.left)


def test_one_camera_twice_is_named() -> None:
    twice = [replace(v, right=v.left) for v in seen_by_both(FLAT, np.random.default_rng(13), 8)]
    with pytest.raises(CalibrationError, match=r"same camera.* 0\.0 mm apart"):
        paired(twice, FLAT, RIG.left, RIG.left)


def test_an_impossible_baseline_asks_for_the_unit() -> None:
    wide = Board("chessboard", 9, 6, 0.5)  # 25 mm squares, told to be 500 mm wide
    views = seen_by_both(FLAT, np.random.default_rng(14), 8)
    with pytest.raises(CalibrationError, match=r"come out 4\.1 m apart with squares of 500 mm.* as 25mm"):
        paired(views, wide)


def test_a_camera_above_the_other_is_refused() -> None:
    above = StereoRig(RIG.left, RIG.right, pose(RIG.T_left_right[:3, :3], [0.12, 0.2, 0.01]))
    object.__setattr__(above, "T_left_right", pose(RIG.T_left_right[:3, :3], [0.02, 0.15, 0.01]))
    views = seen_by_both(FLAT, np.random.default_rng(15), 8, above)
    with pytest.raises(CalibrationError, match=r"y=0\.15, .* must sit beside it"):
        paired(views, FLAT)


def test_no_pairs_are_refused() -> None:
    views = [replace(v, right=None) for v in seen_by_both(FLAT, np.random.default_rng(16), 4)]
    with pytest.raises(CalibrationError, match="no view shows the board to both cameras"):
        paired(views, FLAT)


def test_inverse_of_the_pose_puts_the_right_board_into_the_left_frame() -> None:
    views = seen_by_both(FLAT, np.random.default_rng(17), 5)
    in_left, in_right = (
        poses([getattr(v, s) for v in views], c, FLAT) for s, c in (("left", RIG.left), ("right", RIG.right))
    )
    found = pair_up(views, in_left, in_right, FLAT).T_left_right
    first_left, first_right = in_left[0], in_right[0]
    assert first_left is not None
    assert first_right is not None
    np.testing.assert_allclose(found, first_left @ inverse(first_right), atol=0.02)
