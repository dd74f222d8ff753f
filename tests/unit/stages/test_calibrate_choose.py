import numpy as np
import pytest

from roadblock.stages.calibrate.choose import ENOUGH, choose_views
from roadblock.values.board import Board, BoardView, Sighting

SIZE_PX = (640, 480)
BOARD = Board("chessboard", 5, 4, 0.03)
GRID_PX = 20 * np.stack(np.meshgrid(np.arange(5), np.arange(4)), -1).reshape(-1, 2).astype(float)


def sighting(at_px, ids=None):
    ids = np.arange(20) if ids is None else np.array(ids)
    return Sighting(ids, GRID_PX[ids] + at_px, np.full(len(ids), 0.02))


def view(at_px, right_px=None, name="", ids=None):
    left = None if at_px is None else sighting(at_px, ids)
    return BoardView(name, left, None if right_px is None else sighting(right_px))


def choose(views, frames, **others):
    return choose_views(views, frames, BOARD, SIZE_PX, **others)


def spread(count, seed=5):
    return np.random.default_rng(seed).uniform((0, 0), (500, 380), (count, 2))


def test_moving_boards_are_passed_over():
    """25 places in twos; at every third one the board moves 3 px from frame to frame, in the right image only."""
    views, frames = [], []
    for k, at in enumerate(spread(75)):
        drift = 3.0 if k % 3 == 0 else 0.4
        views += [view(at, at, f"{k}a"), view(at, np.add(at, (drift, 0)), f"{k}b")]
        frames += [10 * k, 10 * k + 1]
    choice = choose(views, frames)
    # The median over both cameras' points: half of them moved by 0 (left), half by the drift (right).
    assert choice.moving == 50
    assert all(int(v.name[:-1]) % 3 for v in choice.views)
    assert choice.motion_px == pytest.approx(0.2)


def test_a_board_that_always_moves_is_taken_at_its_stillest():
    places = spread(2 * ENOUGH)
    views, frames = [], []
    for k, at in enumerate(places):
        views += [view(at), view(np.add(at, (2.0 + 0.1 * k, 0)))]
        frames += [10 * k, 10 * k + 1]
    choice = choose(views, frames)
    assert choice.moving == len(views) - ENOUGH
    assert choice.motion_px == pytest.approx(2.0 + 0.1 * (ENOUGH / 2 - 1))


def test_without_neighbours_nothing_speaks_against_a_view():
    places = spread(30)
    choice = choose([view(at) for at in places], list(range(0, 300, 10)))
    assert (choice.moving, np.isnan(choice.motion_px)) == (0, True)


def test_views_that_show_the_same_are_taken_once_in_their_order():
    # 1 % of the 800 px diagonal is 8 px.
    places = [(0, 0), (7.9, 0), (200, 0), (200, 7), (0, 8.1), (100, 300)]
    choice = choose([view(np.array(at), name=str(i)) for i, at in enumerate(places)], range(0, 60, 10))
    assert [v.name for v in choice.views] == ["0", "3", "4", "5"] or [v.name for v in choice.views] == (
        ["0", "2", "4", "5"]
    )
    assert choice.alike == 2


def test_the_farthest_come_first_when_only_some_may_stay():
    line = [view(np.array([x, 0.0]), name=str(x)) for x in range(0, 410, 10)]
    chosen = choose(line, range(0, 410, 10), most=5)
    assert [v.name for v in chosen.views] == ["0", "100", "200", "300", "400"]


def test_views_that_share_no_point_are_different():
    views = [view([0.0, 0], ids=[0, 1, 2]), view([0.0, 0], ids=[7, 8]), view(None, [0.0, 0])]
    assert len(choose(views, [0, 1, 2]).views) == 3


def test_no_views():
    choice = choose([], [])
    assert (choice.views, choice.moving, choice.alike) == ((), 0, 0)
