"""Rendered boards against formulas, OpenCV's detectors, and the projection of their points."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.geometry.projection import project
from roadblock.sim.board_rays import BLACK, WHITE
from roadblock.sim.boards import (
    SENSOR,
    board_truth,
    bowed_points,
    calibration_poses,
    render_board,
    spread_places,
)
from roadblock.sim.render import sub_pixel_places
from roadblock.sim.sensor import Sensor
from roadblock.values.board import Board
from roadblock.values.camera import Camera, StereoRig

CHESS = Board("chessboard", 7, 4, 0.025)
CHARUCO = Board("charuco", 7, 4, 0.025, dictionary="5X5_100", marker_share=0.75)
CIRCLES = Board("circles", 4, 7, 0.02)
EXACT = Sensor(gamma=1.0, bits=16, color=False)
"""No blur, no noise, no curve."""

LEFT = Camera((480, 270), 391.0, 386.0, 251.3, 122.6, "brown_conrady", [-0.21, 0.08, 0.0013, -0.0007, -0.01])
RIGHT = Camera((480, 270), 384.0, 388.0, 228.1, 141.2, "brown_conrady", [-0.19, 0.07, -0.0009, 0.0011, -0.01])
RIG = StereoRig(LEFT, RIGHT, pose(rotation_from_rotvec([0.012, -0.031, 0.017]), [0.103, 0.004, -0.006]))


def held(board: Board, rotvec, middle) -> np.ndarray:
    R = rotation_from_rotvec(rotvec)
    return pose(R, np.array(middle) - R @ (board.points_m.max(0) / 2))


TILTED = (0.35, -0.3, 0.2), (0.06, 0.01, 0.4)


def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def grey(image: np.ndarray) -> np.ndarray:
    return image / (65535.0 if image.dtype == np.uint16 else 255.0)


def test_a_pixel_gets_its_exact_share_of_black_and_white() -> None:
    camera = Camera((97, 61), 100.0, 100.0, 44.3, 33.6)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.1, 0.0, 0.0]))
    board = Board("chessboard", 5, 3, 0.1)
    T = pose(np.eye(3), [-0.2, -0.1, 1.0])  # one square is 10 px wide; the first point is at (24.3, 23.6)
    image = grey(render_board(rig, board, T, rng(), shade=0.0, sensor=EXACT, samples=1024).left)

    def shares(middles: np.ndarray, first: float, squares: int) -> tuple[np.ndarray, np.ndarray]:
        """Mean over each pixel's width of +1 in even and -1 in odd squares, 0 beyond; and of 1 in squares."""
        fine = middles[:, None] + (np.arange(4000) + 0.5) / 4000 - 0.5
        square = np.floor((fine - first) / 10) + 1
        inside = (square >= 0) & (square <= squares)
        return (inside * (1 - 2 * (square % 2))).mean(1), inside.mean(1)

    u, v = np.arange(8, 81), np.arange(6, 60)  # inside of the paper's edge
    (even_v, inside_v), (even_u, inside_u) = shares(v, 23.6, 3), shares(u, 24.3, 5)
    even, inside = np.outer(even_v, even_u), np.outer(inside_v, inside_u)
    expected = WHITE - (WHITE - BLACK) * (inside + even) / 2
    assert np.abs(image[6:60, 8:81] - expected).max() < 0.02 * (WHITE - BLACK)
    assert abs((image[6:60, 8:81] - expected).mean()) < 2e-4
    assert (expected < 0.1).any()
    assert ((expected > 0.2) & (expected < 0.6)).any()


def test_corners_lie_where_the_truth_says_in_both_cameras() -> None:
    pair = render_board(RIG, CHESS, held(CHESS, *TILTED), rng())
    truth = board_truth(RIG, CHESS, held(CHESS, *TILTED))
    for image, true in ((pair.left, truth.left_px), (pair.right, truth.right_px)):
        found, corners = cv2.findChessboardCorners(np.ascontiguousarray(image), (7, 4))
        assert found
        stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
        corners = cv2.cornerSubPix(np.ascontiguousarray(image), corners, (4, 4), (-1, -1), stop).reshape(-1, 2)
        nearest = np.linalg.norm(corners[:, None] - true, axis=-1)
        assert sorted(nearest.argmin(1)) == list(range(28))
        assert np.sqrt((nearest.min(1) ** 2).mean()) < 0.12  # what is left is OpenCV's


def test_charuco_markers_carry_the_numbers_of_opencv() -> None:
    T = held(CHARUCO, *TILTED)
    big = StereoRig(
        *(
            replace(c, size_px=(960, 540), fx_px=2 * c.fx_px, fy_px=2 * c.fy_px, cx_px=2 * c.cx_px, cy_px=2 * c.cy_px)
            for c in (LEFT, RIGHT)
        ),
        RIG.T_left_right,
    )
    image, true = render_board(big, CHARUCO, T, rng(), samples=32).left, board_truth(big, CHARUCO, T).left_px
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100)
    theirs = cv2.aruco.CharucoBoard((8, 5), 0.025, 0.75 * 0.025, dictionary)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(theirs).detectBoard(np.ascontiguousarray(image))
    assert set(np.ravel(ids)) == set(range(28))
    assert np.abs(np.reshape(corners, (-1, 2)) - true[np.ravel(ids)]).max() < 0.5


def test_dots_lie_where_the_truth_says() -> None:
    T = held(CIRCLES, (0.1, -0.1, 0.1), (0.06, 0.01, 0.4))
    pair, truth = render_board(RIG, CIRCLES, T, rng()), board_truth(RIG, CIRCLES, T)
    for image, true in ((pair.left, truth.left_px), (pair.right, truth.right_px)):
        found, dots = cv2.findCirclesGrid(np.ascontiguousarray(image), (4, 7), flags=cv2.CALIB_CB_ASYMMETRIC_GRID)
        assert found
        distance = np.linalg.norm(dots.reshape(-1, 1, 2) - true, axis=-1)
        assert sorted(distance.argmin(1)) == list(range(28))
        assert distance.min(1).max() < 0.5


def test_bowed_paper_moves_its_points_and_its_picture_alike() -> None:
    T, bow_m = held(CHESS, *TILTED), 0.006
    points = bowed_points(CHESS, bow_m)
    radius = np.linalg.norm(points[:, :2] - (0.075, 0.0375), axis=1)
    assert points[:, 2] == pytest.approx(bow_m * (radius / radius.max()) ** 2)
    flat, bowed = board_truth(RIG, CHESS, T), board_truth(RIG, CHESS, T, bow_m)
    assert 2 < np.abs(bowed.right_px - flat.right_px).max() < 20
    assert bowed.left_px == pytest.approx(project(LEFT, points @ T[:3, :3].T + T[:3, 3]))
    image = np.ascontiguousarray(render_board(RIG, CHESS, T, rng(), bow_m=bow_m).right)
    start = bowed.right_px.astype(np.float32).reshape(-1, 1, 2)
    stop = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    found = cv2.cornerSubPix(image, start.copy(), (4, 4), (-1, -1), stop).reshape(-1, 2)
    assert np.sqrt(((found - bowed.right_px) ** 2).mean()) < 0.1


def test_points_outside_an_image_are_unknown() -> None:
    T = held(CHESS, (0.0, 0.0, 0.0), (-0.26, 0.0, 0.4))
    truth = board_truth(RIG, CHESS, T)
    seen = np.isfinite(truth.left_px).all(1)
    assert 0 < seen.sum() < 28
    assert np.isfinite(truth.left_px).any(1).sum() == seen.sum()
    assert (truth.left_px[seen] >= 0).all()
    assert not np.isfinite(truth.right_px).any()


def test_a_board_behind_the_camera_or_seen_from_its_back_is_not_there() -> None:
    behind = held(CHESS, (0.0, 0.0, 0.0), (0.0, 0.0, -0.4))
    back = held(CHESS, (0.0, math.pi, 0.0), (0.05, 0.0, 0.4))
    there = held(CHESS, (0.0, 0.0, 0.0), (0.05, 0.0, 0.4))
    soft = [
        np.abs(np.diff(grey(render_board(RIG, CHESS, T, rng(), sensor=EXACT).left))).max()
        for T in (behind, back, there)
    ]
    assert max(soft[:2]) < 0.02 < 0.5 < soft[2]


def test_what_a_lens_does_not_see_is_background() -> None:
    narrow = replace(LEFT, distortion=[-1.5, 0.0, 0.0, 0.0, 0.0])  # folds back inside of the image
    assert np.isnan(project(narrow, [0.6, 0.0, 1.0])).all()
    image = render_board(replace(RIG, left=narrow), CHESS, held(CHESS, *TILTED), rng(), sensor=EXACT).left
    assert np.isfinite(grey(image)).all()


def test_the_same_state_gives_the_same_bytes() -> None:
    T = held(CHESS, *TILTED)
    first, same = (render_board(RIG, CHESS, T, rng(), index=3, name="3") for _ in range(2))
    other = render_board(RIG, CHESS, T, np.random.default_rng(6))
    assert np.array_equal(first.left, same.left)
    assert np.array_equal(first.right, same.right)
    assert not np.array_equal(first.left, other.left)
    assert (first.index, first.name) == (3, "3")


def test_noise_is_about_two_grey_levels_in_black_and_white() -> None:
    board = Board("chessboard", 2, 2, 0.1)
    T = held(board, (0.0, 0.0, 0.0), (0.0, 0.0, 0.5))
    image = render_board(RIG, board, T, rng(), shade=0.0, sensor=replace(SENSOR, exposure=None)).left.astype(float)
    clean = render_board(
        RIG, board, T, rng(), shade=0.0, sensor=replace(SENSOR, full_well_e=math.inf, read_noise=0.0)
    ).left
    for level in (WHITE, BLACK):
        flat = np.abs(clean - 255 * level ** (1 / 2.2)) <= 0.5
        assert flat.sum() > 2000
        assert 1.8 < (image - clean)[flat].std() < 2.3


def test_light_on_the_board_is_uneven() -> None:
    T = held(CHESS, (0.0, 0.0, 0.0), (0.05, 0.0, 0.4))
    for shade in (0.0, 0.3):
        image = grey(render_board(RIG, CHESS, T, rng(), shade=shade, sensor=EXACT).left)
        corners = board_truth(RIG, CHESS, T).left_px[[0, 6, 21, 27]]
        paper = [image[int(v) - 8 : int(v) + 8, int(u) - 8 : int(u) + 8].max() for u, v in corners]
        assert (np.ptp(paper) > 0.05) == (shade > 0)


@pytest.mark.parametrize("turned", [(1.45, 0.3, 0.0), (-0.2, 1.5, 0.1), (1.0, -1.2, 0.2), (0.0, -1.52, 0.0)])
def test_light_is_never_negative_on_a_board_seen_edge_on(turned: tuple[float, float, float]) -> None:
    """Of which the square root would be NaN, as a warning says."""
    for seed in range(3):
        state = np.random.default_rng(seed)
        render_board(RIG, CHESS, held(CHESS, turned, (0.02, -0.01, 0.15)), state, shade=0.5, samples=16)


@pytest.mark.parametrize("board", [CHESS, CIRCLES])
def test_poses_are_varied_and_both_cameras_see_the_whole_board(board: Board) -> None:
    poses = calibration_poses(RIG, board, rng(), 40)
    truths = [board_truth(RIG, board, T) for T in poses]
    assert all(np.isfinite(t.left_px).all() and np.isfinite(t.right_px).all() for t in truths)
    for camera, pixels in ((LEFT, [t.left_px for t in truths]), (RIGHT, [t.right_px for t in truths])):
        areas = np.floor(np.concatenate(pixels) / camera.size_px * 3).astype(int)
        assert len(np.unique(areas, axis=0)) == 9
    middles = [T @ [*(board.points_m.max(0) / 2), 1.0] for T in poses]
    tilts, depths = [], []
    for i, (T, middle) in enumerate(zip(poses, middles, strict=True)):
        views = [T, inverse(RIG.T_left_right) @ T], [middle, inverse(RIG.T_left_right) @ middle]
        angles = [
            math.degrees(math.acos(V[:3, 2] @ m[:3] / np.linalg.norm(m[:3]))) for V, m in zip(*views, strict=True)
        ]
        tilts.append(min(angles))  # of the camera it was held before, or less
        depths.append(middle[2])
        assert min(angles) <= 45, i
    assert max(tilts) > 35
    assert min(tilts) < 12
    assert max(depths) > 2 * min(depths)
    assert all(np.array_equal(a, b) for a, b in zip(poses[:9], calibration_poses(RIG, board, rng(), 9), strict=True))


def test_cameras_without_a_common_view_are_refused() -> None:
    apart = StereoRig(LEFT, RIGHT, pose(rotation_from_rotvec([0.0, 0.9, 0.0]), [2.0, 0.0, 0.0]))
    with pytest.raises(ValueRefusedError, match="whole board"):
        calibration_poses(apart, CHESS, rng(), 2)


@pytest.mark.parametrize("count", [0, 2.5, True])
def test_a_count_must_be_whole(count) -> None:
    with pytest.raises(ValueRefusedError, match="count"):
        calibration_poses(RIG, CHESS, rng(), count)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"samples": 0}, "samples"),
        ({"shade": -0.1}, "shade"),
        ({"bow_m": 0.0076}, "bow_m"),
        ({"bow_m": math.nan}, "bow_m"),
        ({"T_left_board": np.diag([1.0, 1.0, -1.0, 1.0])}, "T_left_board"),
    ],
)
def test_what_cannot_be_is_refused(change, word) -> None:
    arguments = {"T_left_board": held(CHESS, *TILTED)} | change
    with pytest.raises(ValueRefusedError, match=word):
        render_board(RIG, CHESS, rng=rng(), **arguments)


def test_rays_are_spread_as_blur_and_pixel_together():
    """Variances add, and so do fourth cumulants: 0 of a Gaussian, -1/120 of a pixel."""
    places = sub_pixel_places(8, 4096)
    assert spread_places(places, 0.0) is places
    spread = spread_places(places, 0.45)
    variance = 0.45**2 + 1 / 12
    assert spread.var() == pytest.approx(variance, rel=0.005)
    assert (spread**4).mean() == pytest.approx(3 * variance**2 - 1 / 120, rel=0.02)
