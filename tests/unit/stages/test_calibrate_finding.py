"""Boards in pictures: what is asked for, what is found, and what is said when nothing is."""

import cv2
import numpy as np
import pytest
from board_examples import chessboard, corners_px, noisy, pose

from roadblock.errors import SettingsError, ValueRefusedError
from roadblock.stages.calibrate.advise import explain_missing
from roadblock.stages.calibrate.board import parse_board
from roadblock.stages.calibrate.corners import fit_corners
from roadblock.stages.calibrate.detect import find_board
from roadblock.values.camera import Camera

CAMERA = Camera((320, 240), 330.0, 318.0, 165.5, 112.25, "brown_conrady", np.array([-0.1, 0.05, 0.001, -0.002, 0.0]))
TILTED = pose((0.25, -0.35, 0.12), (0.3, -0.2, 13.0))
BOARD = parse_board("chessboard:7x6", 0.02)
EXACT = corners_px(CAMERA, TILTED, 7, 6)


CLEAN = chessboard(CAMERA, TILTED, 7, 6, blur_px=0.5)


def picture(rng):
    return noisy(CLEAN, 2.0, rng)


def charuco(board, scale=40):
    name = getattr(cv2.aruco, f"DICT_{board.dictionary}")
    size = board.columns + 1, board.rows + 1
    printed = cv2.aruco.CharucoBoard(size, 1.0, board.marker_share, cv2.aruco.getPredefinedDictionary(name))
    return printed.generateImage((size[0] * scale + 60, size[1] * scale + 60), marginSize=30)


def circles(columns, rows, step=14):
    image = np.full((rows * step + 60, 2 * columns * step + 60), 255, np.uint8)
    for row in range(rows):
        for column in range(columns):
            cv2.circle(image, (40 + (2 * column + row % 2) * step, 40 + row * step), 5, 0, -1, cv2.LINE_AA)
    return cv2.GaussianBlur(image, (3, 3), 0.7)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("chesboard:9x6", "did you mean chessboard"),
        ("paper:9x6", "no board is called 'paper'"),
        ("chessboard", "must be written as"),
        ("chessboard:9x6:4x4_50", "must be written as"),
        ("chessboard:nine", "must be followed by"),
        ("chessboard:2x6", "or more, but got 2x6"),
        ("charuco:8x6:9x9_50", "no marker dictionary"),
        ("charuco:14x12:4x4_50", "holds 50: name a larger one"),
        ("charuco:8x6:5x5_100:1.5", "1.5"),
        ("charuco:8x6:5x5_100:big", "big"),
    ],
)
def test_a_board_that_is_none_is_refused_in_words(text, reason):
    with pytest.raises(SettingsError, match=reason):
        parse_board(text, 0.025)


def test_what_is_asked_for_is_read():
    board = parse_board(" ChArUco:8x6:4x4_250:0.6 ", 0.03, 1e-5)
    assert (board.kind, board.columns, board.rows, board.square_m) == ("charuco", 8, 6, 0.03)
    assert (board.square_sigma_m, board.dictionary, board.marker_share) == (1e-5, "4X4_250", 0.6)
    assert parse_board("circles:4x11", 0.02).points_m[4].tolist() == [0.02, 0.02, 0.0]


def test_corners_are_found_to_the_noise_limit_and_their_sigma_is_true():
    rng = np.random.default_rng(3)
    errors, ratios = [], []
    for _ in range(6):
        seen = find_board(picture(rng), BOARD)
        assert seen is not None
        assert len(seen.ids) == 42
        error = seen.points_px - EXACT[seen.ids]
        errors.append(error)
        ratios.append(error / seen.sigma_px[:, None])
    assert np.sqrt(np.mean(np.square(errors))) < 0.02  # cornerSubPix: .03 to .05 on such squares of 20 px
    assert 0.8 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def test_the_first_corner_is_told_by_colour_so_a_turned_board_keeps_its_numbers():
    image = picture(np.random.default_rng(4))
    upright, turned = find_board(image, BOARD), find_board(np.ascontiguousarray(image[::-1, ::-1]), BOARD)
    back = np.array([319, 239]) - turned.points_px[np.argsort(turned.ids)]
    np.testing.assert_allclose(back, upright.points_px[np.argsort(upright.ids)], atol=0.02)


def test_a_grid_that_is_no_chessboard_is_not_taken_for_one(monkeypatch):
    """What OpenCV takes for corners: true ones, half a square beside them, and one column much too near to the next."""
    image, grid = picture(np.random.default_rng(4)), EXACT.reshape(6, 7, 2)
    beside, crowded = grid.copy(), grid.copy()
    beside[:, :-1] = (grid[:, 1:] + grid[:, :-1]) / 2
    beside[:, -1] = 1.5 * grid[:, -1] - 0.5 * grid[:, -2]
    crowded[:, 3] = 0.3 * grid[:, 3] + 0.7 * grid[:, 4]
    found = []
    for corners in (grid, beside, crowded):
        told = True, corners.reshape(-1, 1, 2).astype(np.float32)
        monkeypatch.setattr(cv2, "findChessboardCornersSB", lambda *_, told=told, **__: told)
        found.append(find_board(image, BOARD) is not None)
    assert found == [True, False, False]


def test_colour_pictures_are_read_by_their_luminance():
    image = picture(np.random.default_rng(5))
    seen = find_board(np.repeat(image[..., None], 3, -1), BOARD)
    np.testing.assert_allclose(seen.points_px, find_board(image, BOARD).points_px, atol=0.01)


def test_a_disturbed_corner_is_dropped_and_the_others_stay():
    image = picture(np.random.default_rng(6))
    u, v = np.rint(EXACT[16]).astype(int)
    image[v - 2 : v + 9, u - 1 : u + 12] = 120  # a finger over it
    fits = fit_corners(image, EXACT.reshape(6, 7, 2))
    others = np.arange(42) != 16
    assert not fits.usable[16] or fits.sigma_px[16] > 3 * np.median(fits.sigma_px)
    assert np.sqrt(np.mean((fits.points_px - EXACT)[others & fits.usable] ** 2)) < 0.03
    assert (others & fits.usable).sum() >= 36


def test_charuco_corners_keep_their_numbers_when_part_of_the_board_is_hidden():
    board = parse_board("charuco:6x4:4x4_50", 0.03)
    image = charuco(board)
    whole = find_board(image, board)
    assert len(whole.ids) == 24
    exact = 30 + 40 * (board.points_m[:, :2] / 0.03 + 1) - 0.5
    np.testing.assert_allclose(whole.points_px, exact[whole.ids], atol=0.1)
    image[:, :150] = 255
    part = find_board(image, board)
    assert 8 <= len(part.ids) < 24
    np.testing.assert_allclose(part.points_px, exact[part.ids], atol=0.15)


def test_circles_are_found_where_they_are():
    board = parse_board("circles:4x7", 0.014)
    seen = find_board(circles(4, 7), board)
    exact = 40 + 14 * board.points_m[:, :2] / 0.014
    # The grid looks alike turned: it may be numbered from its other end.
    ways = [exact, exact[::-1]]
    assert min(np.abs(seen.points_px - way[seen.ids]).max() for way in ways) < 0.1
    assert find_board(255 - circles(4, 7), board) is not None


@pytest.mark.parametrize("image", [np.zeros((40, 60), np.uint8), np.full((1, 1), 7, np.uint8)])
@pytest.mark.parametrize("text", ["chessboard:7x6", "charuco:6x4", "circles:4x7"])
def test_pictures_without_a_board_show_none(image, text):
    assert find_board(image, parse_board(text, 0.02)) is None


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros((4, 4, 2), np.uint8), np.zeros((0, 4), np.uint8)])
def test_what_is_no_picture_is_refused(image):
    with pytest.raises(ValueRefusedError, match="must be"):
        find_board(image, BOARD)


def test_what_the_pictures_show_instead_is_said():
    image = picture(np.random.default_rng(8))
    assert "--board chessboard:7x6" in explain_missing([image], parse_board("chessboard:9x6", 0.02))
    board = parse_board("charuco:6x4:4x4_50", 0.03)
    assert "mirrored" in explain_missing([np.ascontiguousarray(charuco(board)[:, ::-1])], board)
    assert "--board charuco:6x4" in explain_missing([charuco(board)], parse_board("charuco:8x6:5x5_100", 0.03))
    assert "--board circles:4x7" in explain_missing([circles(4, 7)], parse_board("circles:4x11", 0.02))
    assert explain_missing([], BOARD) == ""
    assert explain_missing([np.zeros((40, 60), np.uint8)], BOARD) == ""
