"""Coverage: areas, distances and tilts by construction; the next view against a rig solved with it."""

from dataclasses import replace

import numpy as np
import pytest
from calibration_examples import FLAT, example_rig, example_sighting, example_views

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project
from roadblock.geometry.stereo import right_from_left
from roadblock.geometry.uncertainty import moved_rig, range_sigma
from roadblock.stages.calibrate import coverage as room
from roadblock.stages.calibrate.bundle import RigSolution, solve_camera, solve_rig
from roadblock.stages.calibrate.coverage import (
    best_next_view,
    check_tilts,
    coverage_of,
    empty_areas,
    missing_areas,
    missing_distances,
    missing_tilts,
    point_counts,
)
from roadblock.values.board import BoardView, Sighting
from roadblock.values.calibration import ViewFit
from roadblock.values.camera import rig_parameters

RIG = example_rig(size_px=(640, 480))
SIZE = RIG.left.size_px


def solved(views: tuple[BoardView, ...]) -> RigSolution:
    left = solve_camera([v.left for v in views], FLAT, SIZE, "brown_conrady5", RIG.left)
    right = solve_camera([v.right for v in views], FLAT, SIZE, "brown_conrady5", RIG.right)
    return solve_rig(views, FLAT, SIZE, "brown_conrady5", left, right)


@pytest.fixture(scope="module")
def right_half() -> tuple[tuple[BoardView, ...], RigSolution]:
    """Views whose boards are in the right half of the left image only."""
    views = example_views(RIG, FLAT, np.random.default_rng(21), 60, 0.05)
    views = tuple(
        v for v in views if v.left and v.right and v.left.points_px[:, 0].min() > 320 and len(v.right.ids) == 54
    )[:12]
    assert len(views) == 12
    return views, solved(views)


def at(*points: tuple[float, float]) -> Sighting:
    return Sighting(np.arange(len(points)), np.array(points), np.full(len(points), 0.1))


def test_points_are_counted_where_they_are() -> None:
    # Areas are 12.125 x 10.17 px; pixel (0, 0) reaches from -0.5 to 0.5.
    counts = point_counts(
        [at((0, 0), (11.5, 9.5)), None, at((96, 60)), at((11.7, 0), (0, 9.8), (-0.5, 60.5))], (97, 61)
    )
    assert counts.shape == (6, 8)
    expected = np.zeros((6, 8))
    expected[0, 0], expected[5, 7], expected[0, 1], expected[1, 0], expected[5, 0] = 2, 1, 1, 1, 1
    np.testing.assert_array_equal(counts, expected)


def test_empty_areas_are_named() -> None:
    counts = np.ones((6, 8))
    assert missing_areas(counts, "left") == []
    counts[:2, :3] = 0
    assert missing_areas(counts, "right") == ["no point in the upper left of the right image"]
    counts[2:4, 5:] = 0
    counts[4:, 3:5] = 0
    assert empty_areas(counts) == ["upper left", "right", "bottom"]
    assert missing_areas(counts, "left") == ["no point in the upper left, the right and the bottom of the left image"]


def test_a_small_part_is_named_by_what_was_seen() -> None:
    counts = np.zeros((6, 8))
    counts[2, 3] = 5
    counts[4, 0] = 1
    (said,) = missing_areas(counts, "left")
    assert said.startswith("points only in the middle and the lower left of the left image")


def test_equal_distances_are_named() -> None:
    assert missing_distances(np.array([0.5, 0.76])) == []
    assert missing_distances(np.zeros(0)) == []
    (said,) = missing_distances(np.array([0.5, 0.74]))
    assert said.startswith("all boards between 0.5 and 0.74 m away")


def test_boards_that_were_not_turned_are_named_by_axis() -> None:
    assert missing_tilts(np.array([[21.0, -3], [0, -22]])) == []
    (said,) = missing_tilts(np.array([[-25.0, 12], [3, -8]]))
    assert said.startswith("no board turned about the horizontal axis by more than 12 deg")
    assert len(missing_tilts(np.zeros((0, 2)))) == 2


def test_boards_that_all_face_the_image_are_refused() -> None:
    def turned(*degrees: float) -> np.ndarray:
        return pose(rotation_from_rotvec(np.radians(degrees)), [0.1, 0.2, 0.9])

    check_tilts([turned(0, 0, 80), None, turned(0, -5.5, 0)])
    with pytest.raises(CalibrationError, match=r"tilted by 4\.5 deg at most"):
        check_tilts([turned(0, 0, 80), None, turned(4.5, 0, 0), turned(0, -3, 0)])


def test_coverage_counts_used_views_alone_and_measures_their_boards(
    right_half: tuple[tuple[BoardView, ...], RigSolution], monkeypatch: pytest.MonkeyPatch
) -> None:
    views, solution = right_half
    monkeypatch.setattr(room, "best_next_view", lambda *_: ("x", 0.5))
    middle = FLAT.points_m.max(0) / 2
    R_left_nearer = rotation_from_rotvec(np.radians([0, -30, 0]))  # x of the board away from the camera
    R_lower_nearer = rotation_from_rotvec(np.radians([-20, 0, 0]))
    assert (R_left_nearer @ [1, 0, 0])[2] > 0
    assert (R_lower_nearer @ [0, 1, 0])[2] < 0
    unknown = np.full((54, 2), np.nan), np.full((54, 2), np.nan), np.full(54, np.nan), np.full(54, np.nan)
    poses = [pose(R, np.array([0.3, -0.4, z]) - R @ middle) for R, z in ((R_left_nearer, 1.2), (R_lower_nearer, 0.0))]
    fits = [ViewFit("a", poses[0], *unknown), ViewFit("b", poses[1], *unknown), ViewFit("c", poses[0], *unknown, "bad")]
    coverage = coverage_of(views[:3], fits, FLAT, solution)
    np.testing.assert_allclose(coverage.distances_m, [1.3, 0.5])
    np.testing.assert_allclose(coverage.tilts_deg, [[30, 0], [0, 20]], atol=1e-9)
    assert coverage.left_counts.sum() == sum(len(v.left.ids) for v in views[:2] if v.left)
    assert coverage.right_counts.sum() == 108
    assert any("left image" in said for said in coverage.missing)
    assert (coverage.next_view, coverage.next_gain) == ("x", 0.5)


def test_the_next_view_is_where_none_was_and_keeps_its_promise(
    right_half: tuple[tuple[BoardView, ...], RigSolution],
) -> None:
    views, solution = right_half
    words, gain = best_next_view(FLAT, solution)
    assert "left of the left image" in words
    T = next(T for said, T in room._candidates(solution.rig, FLAT) if words == f"hold the board {said}")
    points = transform(T, FLAT.points_m)
    rng = np.random.default_rng(22)
    left = example_sighting(RIG.left, points, rng, 0.05, True, 0.05)
    right = example_sighting(RIG.right, right_from_left(RIG, points), rng, 0.05, True, 0.05)
    more = solved((*views, BoardView("next", left, right)))
    assert solution.inflation == more.inflation == 1.0
    before, after = (np.sqrt(np.nanmean(range_sigma(s.rig, 20.0) ** 2)) for s in (solution, more))
    assert gain == pytest.approx(after / before, rel=0.15)
    assert gain < 0.8


def test_a_view_tells_what_finite_differences_say_its_own_pose_eliminated(
    right_half: tuple[tuple[BoardView, ...], RigSolution],
) -> None:
    _, solution = right_half
    rig, count = RIG, len(rig_parameters(RIG.left, RIG.right))
    told = room._information(
        np.stack([T := room._candidates(rig, FLAT)[7][1]]), FLAT,
        replace(solution, rig=rig, shape=0 * solution.shape, sigma_px=(0.05, 0.02)),
    )[0]  # fmt: skip
    steps = np.r_[np.full(count - 6, 1e-4), np.full(6, 1e-6), np.full(6, 1e-6)]

    def pixels(step: np.ndarray) -> np.ndarray:
        moved = moved_rig(rig, step[:count])
        T_moved = pose(rotation_from_rotvec(step[count : count + 3]) @ T[:3, :3], T[:3, 3] + step[count + 3 :])
        in_left = transform(T_moved, FLAT.points_m)
        left, right = project(moved.left, in_left), project(moved.right, right_from_left(moved, in_left))
        return np.r_[left.ravel() / 0.05, right.ravel() / 0.02]

    J = np.stack(
        [(pixels(e * h) - pixels(-e * h)) / (2 * h) for e, h in zip(np.eye(count + 6), steps, strict=True)], -1
    )
    H = J.T @ J
    expected = H[:count, :count] - H[:count, count:] @ np.linalg.solve(H[count:, count:], H[count:, :count])
    scale = np.sqrt(np.outer(expected.diagonal(), expected.diagonal()))
    np.testing.assert_allclose(told[:count, :count] / scale, expected / scale, atol=1e-4)


def test_candidates_are_whole_in_both_images_and_turned_as_said() -> None:
    for words, T in room._candidates(RIG, FLAT):
        points = transform(T, FLAT.points_m)
        first, last, below = points[0], points[8], points[-9]
        if "left side nearer" in words:
            assert first[2] < last[2]
        if "right side nearer" in words:
            assert first[2] > last[2]
        if "upper side nearer" in words:
            assert first[2] < below[2]
        if "lower side nearer" in words:
            assert first[2] > below[2]
        for camera, inside in ((RIG.left, points), (RIG.right, right_from_left(RIG, points))):
            seen = example_sighting(camera, inside, np.random.default_rng(0), 0.0, False, 0.1)
            assert seen is not None
        u, v = (points.mean(0)[:2] / points.mean(0)[2]) * (RIG.left.fx_px, RIG.left.fy_px)
        if "upper" in words.split(",")[0]:
            assert v < 0
        if "right of" in words:
            assert u > 0


def test_no_next_view_where_none_is_seen_by_both_or_none_helps(
    right_half: tuple[tuple[BoardView, ...], RigSolution],
) -> None:
    _, solution = right_half
    T = np.array(RIG.T_left_right)
    T[0, 3] = 2.9
    words, gain = best_next_view(FLAT, replace(solution, rig=replace(RIG, T_left_right=T)))
    assert words == ""
    assert np.isnan(gain)
    sure = replace(solution, information=1e9 * solution.information)
    words, gain = best_next_view(FLAT, sure)
    assert words == ""
    assert 0.99 < gain <= 1.0
