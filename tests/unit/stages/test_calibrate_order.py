"""The whole order: sets of views spoiled in one way each, of a crooked rig with known truth."""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from calibration_examples import FLAT, example_rig, example_sighting, example_views
from numpy.typing import ArrayLike
from pydantic import ValidationError

from roadblock.errors import CalibrationError, ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.geometry.stereo import right_from_left
from roadblock.geometry.uncertainty import calibration_jacobian, seen_points
from roadblock.stages.calibrate import bundle
from roadblock.stages.calibrate.calibrate import CalibrateSettings, calibrate
from roadblock.stages.calibrate.start import PINHOLE_AS_KANNALA_BRANDT, first_camera
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.calibration import Calibration, LensTrial
from roadblock.values.camera import Camera

RIG = example_rig(size_px=(640, 480))
SIZE = RIG.left.size_px
EVEN = Board("chessboard", 8, 6, 0.025)
ROOM = sys.modules["roadblock.stages.calibrate.calibrate"]
GIVEN = CalibrateSettings(lens="brown_conrady5")
CAMERAS = {
    "brown_conrady5": Camera(SIZE, 500, 500, 320, 240, "brown_conrady", np.zeros(5)),
    "brown_conrady8": Camera(SIZE, 500, 500, 320, 240, "brown_conrady", np.zeros(8)),
    "kannala_brandt": Camera(SIZE, 500, 500, 320, 240, "kannala_brandt", PINHOLE_AS_KANNALA_BRANDT),
}


def views_of(board: Board = FLAT, count: int = 14, seed: int = 1, noise_px: float = 0.05) -> list[BoardView]:
    return list(example_views(RIG, board, np.random.default_rng(seed), count, noise_px))


def pairs_of(views: Sequence[BoardView]) -> list[int]:
    return [i for i, view in enumerate(views) if view.left and view.right]


def moved(sighting: Sighting | None, shift_px: ArrayLike, which: slice = slice(None)) -> Sighting | None:
    """Return a sighting with some of its points elsewhere (but inside the image)."""
    if sighting is None:
        return None
    points = sighting.points_px.copy()
    points[which] += shift_px
    return replace(sighting, points_px=np.clip(points, 0, (639, 479)))


def run(views: Sequence[BoardView], board: Board = FLAT) -> Calibration:
    return calibrate(views, board, SIZE, GIVEN)


@pytest.fixture(scope="module", autouse=True)
def near() -> Iterator[pytest.MonkeyPatch]:
    """Let every search for a camera start near the truth: the search has its own tests, and takes most of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bundle, "first_camera", lambda _, __, size_px, lens: CAMERAS[lens])
        yield patch


@pytest.fixture
def searching(near: pytest.MonkeyPatch) -> Iterator[None]:
    """Search for cameras after all."""
    with near.context() as patch:
        patch.setattr(bundle, "first_camera", first_camera)
        yield


@pytest.fixture(scope="module")
def healthy() -> Calibration:
    return run(views_of())


def test_healthy_views_give_a_good_rig_and_all_its_evidence(healthy: Calibration) -> None:
    assert healthy.verdict == "good", healthy.reasons
    assert [view.name for view in healthy.used] == [f"{i:02d}" for i in range(14)]
    assert healthy.rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.05)
    assert healthy.sigma_px == pytest.approx((0.05, 0.05), rel=0.1)
    assert healthy.epipolar_rms_px == pytest.approx(0.05 * np.sqrt(2), rel=0.1)
    assert [fit.sigma_px for fit in healthy.cameras_alone] == pytest.approx([0.05, 0.05], rel=0.1)
    assert set(healthy.range_sigma_m) == {5.0, 10.0, 20.0, 40.0}
    (trial,) = healthy.lens_trials
    assert (trial.lens, trial.parameters, trial.verdict) == ("brown_conrady5", 18, "given")
    assert trial.fitted_rms_px == pytest.approx(healthy.rms_px, rel=0.01)
    assert np.isnan(trial.held_out_rms_px)
    assert healthy.coverage.left_counts.sum() == sum(len(v.left.ids) for v in views_of() if v.left)
    assert healthy.coverage.next_view.startswith("hold the board at the")


def test_ranges_of_the_rig_are_off_by_no_more_than_it_says(healthy: Calibration) -> None:
    """Points 20 m ahead, seen by the true rig and measured by the calibrated one."""
    points = seen_points(RIG, 20.0).reshape(-1, 3)
    points = points[~np.isnan(points).any(-1)]
    delta = np.concatenate(
        [
            np.r_[
                a.fx_px - b.fx_px, a.fy_px - b.fy_px, a.cx_px - b.cx_px, a.cy_px - b.cy_px, a.distortion - b.distortion
            ]
            for a, b in ((healthy.rig.left, RIG.left), (healthy.rig.right, RIG.right))
        ]
    )
    turn = healthy.rig.T_left_right[:3, :3] @ RIG.T_left_right[:3, :3].T
    small = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2
    delta = np.r_[delta, small, healthy.rig.T_left_right[:3, 3] - RIG.T_left_right[:3, 3]]
    slopes = calibration_jacobian(RIG, points)[:, 2]
    covariance = healthy.rig.covariance
    assert covariance is not None
    sigma_m = np.sqrt(np.einsum("ni,ij,nj->n", slopes, covariance.matrix, slopes))
    off = np.abs(slopes @ delta) / sigma_m
    assert off.max() < 4
    assert off.max() > 0.05


def test_progress_counts_up_to_the_last_step() -> None:
    told: list[tuple[str, int, int]] = []
    calibrate(views_of(count=9), FLAT, SIZE, GIVEN, lambda *step: told.append(step))
    assert [done for _, done, _ in told] == list(range(5))
    assert {total for _, _, total in told} == {5}
    assert told[0][0] == "each camera alone"


def test_a_lens_is_chosen_where_none_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    evidence = (LensTrial("brown_conrady8", 24, 0.1, 0.1, "chosen"),)

    def choose(*given: Any) -> tuple[str, tuple[LensTrial, ...]]:
        views, board, size_px, progress = given
        assert (len(views), board, size_px) == (9, FLAT, SIZE)
        for done in (1, 2, 3):
            progress(done, 3)
        return "brown_conrady8", evidence

    told: list[tuple[str, int, int]] = []
    monkeypatch.setattr(ROOM, "choose_lens", choose)
    calibration = calibrate(views_of(count=9), FLAT, SIZE, progress=lambda *step: told.append(step))
    assert calibration.lens_trials is evidence
    assert [len(fit.camera.distortion) for fit in calibration.cameras_alone] == [8, 8]
    assert len(calibration.rig.right.distortion) == 8
    assert [done for _, done, _ in told] == list(range(9))
    assert {total for _, _, total in told} == {9}
    assert "lens models: 2 of 3 tried" in [what for what, _, _ in told]


def test_a_fisheye_starts_as_one(searching: None) -> None:
    rig = example_rig("kannala_brandt", size_px=(640, 480), fov=2.6)
    views = example_views(rig, EVEN, np.random.default_rng(3), 6, 0.05, distance_m=(0.12, 0.3))
    assert [a.lens for a in ROOM._each_alone(views, EVEN, SIZE, "auto")] == ["kannala_brandt"] * 2


@pytest.mark.parametrize("shift_px", [(0.0, 3.0), (3.0, 0.0)])
def test_a_view_that_moved_between_the_cameras_is_named_and_left_out(
    healthy: Calibration, shift_px: tuple[float, float]
) -> None:
    views = views_of()
    views[4] = replace(views[4], right=moved(views[4].right, shift_px))
    calibration = run(views)
    assert calibration.verdict == "good"
    (left_out,) = [view for view in calibration.views if view.left_out]
    assert left_out.name == "04"
    assert left_out.left_out.startswith("moved between left and right, for each camera alone fits: epipolar error")
    assert calibration.rig.T_left_right[0, 3] == pytest.approx(healthy.rig.T_left_right[0, 3], abs=1e-4)
    # The rows of a left-out view are not counted, its residuals are there.
    assert calibration.epipolar_rms_px < 0.1
    assert np.nanmax(np.abs(left_out.residual_right_px)) > 0.3


def test_a_view_that_fits_no_camera_is_named_and_left_out() -> None:
    views = views_of()
    rng = np.random.default_rng(2)
    views[4] = replace(views[4], left=moved(views[4].left, rng.normal(0, 1.0, (54, 2))))
    (left_out,) = [view for view in run(views).views if view.left_out]
    assert left_out.name == "04"
    assert "in the left image" in left_out.left_out
    assert "moved" not in left_out.left_out


def test_views_with_a_few_wrong_corners_stay_and_are_named(healthy: Calibration) -> None:
    views = views_of()
    for i, many in ((4, 3), (7, 6)):
        views[i] = replace(views[i], right=moved(views[i].right, (4.0, -4.0), slice(0, many)))
    calibration = run(views)
    assert len(calibration.used) == 14
    assert calibration.rms_px > 3 * healthy.rms_px
    assert any(
        said.startswith("9 of ") and "corners are wrong" in said and said.endswith("view 07")
        for said in calibration.reasons
    )
    assert calibration.verdict == "good"
    near = np.abs(calibration.rig.T_left_right - healthy.rig.T_left_right)
    assert near[:3, 3].max() < 1e-4
    assert near[:3, :3].max() < 2e-4


def test_a_rig_that_changed_halfway_is_refused() -> None:
    views = [replace(v, right=moved(v.right, (0.0, 0.7))) if i % 2 else v for i, v in enumerate(views_of())]
    calibration = run(views)
    assert calibration.verdict == "refused"
    assert any("or the rig changed in between" in said for said in calibration.reasons)


def test_cameras_that_were_not_synchronised_are_refused() -> None:
    rng = np.random.default_rng(5)
    calibration = run([replace(v, right=moved(v.right, rng.normal(0, 1, 2))) for v in views_of()])
    assert calibration.verdict == "refused"
    assert any("not taken at the same moment" in said for said in calibration.reasons)


def test_some_wrong_pairs_are_left_out_and_most_wrong_ones_are_refused() -> None:
    views = views_of()
    pairs = pairs_of(views)
    some = views.copy()
    for a, b in ((pairs[0], pairs[1]), (pairs[2], pairs[3])):
        some[a] = replace(views[a], right=views[b].right)
    left_out = {view.name: view.left_out for view in run(some).views if view.left_out}
    assert sorted(left_out) == sorted(views[i].name for i in (pairs[0], pairs[2]))
    assert all(said.startswith("left and right show different moments") for said in left_out.values())
    shifted = [replace(v, right=views[i - 1].right) for i, v in enumerate(views)]
    with pytest.raises(CalibrationError, match="left and right do not belong together"):
        run(shifted)


def test_boards_numbered_from_either_end_give_the_same_rig() -> None:
    views = views_of(EVEN, 14, seed=6)
    rng = np.random.default_rng(7)

    def other_way(sighting: Sighting | None) -> Sighting | None:
        return sighting and replace(sighting, ids=(47 - sighting.ids) if rng.random() < 0.4 else sighting.ids)

    turned = [BoardView(v.name, other_way(v.left), other_way(v.right)) for v in views]
    right_way, healed = run(views, EVEN), run(turned, EVEN)
    assert healed.verdict == right_way.verdict
    assert len(healed.used) == 14
    np.testing.assert_allclose(healed.rig.T_left_right, right_way.rig.T_left_right, atol=1e-7)
    np.testing.assert_allclose(np.abs(healed.board_heights_m), np.abs(right_way.board_heights_m), atol=1e-3)


def test_swapped_cameras_are_refused() -> None:
    with pytest.raises(CalibrationError, match="the cameras look swapped"):
        run([BoardView(v.name, v.right, v.left) for v in views_of()])


@pytest.mark.parametrize("side", ["left", "right"])
def test_mirrored_pictures_are_refused(side: str) -> None:
    def in_mirror(sighting: Sighting | None) -> Sighting | None:
        if sighting is None:
            return None
        row, column = np.divmod(sighting.ids, 9)
        return replace(sighting, ids=9 * row + 8 - column, points_px=(639, 0) + (-1, 1) * sighting.points_px)

    views = [replace(v, **{side: in_mirror(getattr(v, side))}) for v in views_of()]  # type: ignore[arg-type]
    with pytest.raises(CalibrationError, match=f"the {side} pictures look mirrored"):
        run(views)


def test_one_camera_twice_is_refused() -> None:
    with pytest.raises(CalibrationError, match="left and right look like the same camera"):
        run([replace(v, right=v.left) for v in views_of(count=12) if v.left])


def test_too_few_views_are_refused_by_name() -> None:
    with pytest.raises(CalibrationError, match=r"^left camera: 2 of 2 views"):
        run(views_of()[:2])
    with pytest.raises(CalibrationError, match=r"^left camera: 0 of 0 views"):
        run([BoardView("nothing", None, None)])
    with pytest.raises(CalibrationError, match=r"^right camera: 0 of \d+ views"):
        run([replace(v, right=None) for v in views_of()])
    with pytest.raises(CalibrationError, match=r"no view shows the board to both cameras"):
        run([replace(v, **{("left", "right")[i % 2]: None}) for i, v in enumerate(views_of())])  # type: ignore[arg-type]


def test_four_views_give_a_rig_that_is_refused() -> None:
    calibration = run(views_of()[:4])
    assert calibration.verdict == "refused"
    assert any("only 4 pairs were used" in said for said in calibration.reasons)


def test_views_without_any_board_do_not_count_and_views_of_one_camera_do() -> None:
    views = views_of(count=9)
    views[3] = replace(views[3], right=None)
    calibration = run([*views, BoardView("none", None, None)])
    assert [view.name for view in calibration.views] == [f"{i:02d}" for i in range(9)]
    assert calibration.views[3].left_out == ""
    assert np.isnan(calibration.views[3].residual_right_px).all()


def boards_at(tilt_deg: float, middle: tuple[float, float], distance_m: tuple[float, float]) -> list[BoardView]:
    """Return 16 views of boards tilted up to `tilt_deg`, within the given share of the image and distances."""
    rng = np.random.default_rng(8)
    views = []
    for i in range(16):
        u, v = rng.uniform(*middle, 2) * SIZE
        z = rng.uniform(*distance_m)
        center = z * np.array([(u - RIG.left.cx_px) / RIG.left.fx_px, (v - RIG.left.cy_px) / RIG.left.fy_px, 1.0])
        R = rotation_from_rotvec(np.radians([*rng.uniform(-tilt_deg, tilt_deg, 2), 0.0]))
        points = transform(pose(R, center - R @ FLAT.points_m.mean(0)), FLAT.points_m)
        left = example_sighting(RIG.left, points, rng, 0.05, True, 0.05)
        right = example_sighting(RIG.right, right_from_left(RIG, points), rng, 0.05, True, 0.05)
        views.append(BoardView(f"{i:02d}", left, right))
    return views


def test_parallel_boards_are_refused() -> None:
    with pytest.raises(
        CalibrationError, match=r"all boards are parallel to the image .* take some with the board tilted"
    ):
        run(boards_at(1.0, (0.2, 0.85), (0.5, 1.4)))


def test_boards_in_a_tiny_part_of_the_image_are_refused_with_what_is_missing() -> None:
    calibration = run(boards_at(40.0, (0.48, 0.58), (1.3, 1.4)))
    assert calibration.verdict == "refused"
    assert any("points only in the middle" in said for said in calibration.reasons)
    assert any("all boards between 1.3 and 1.4 m away" in said for said in calibration.coverage.missing)


def test_squares_in_the_wrong_unit_are_pointed_out() -> None:
    wide = Board("chessboard", 9, 6, 0.25)
    calibration = run(views_of(count=12), wide)
    assert any("span 2000 x 1250 mm, which is unusual" in said for said in calibration.reasons)
    assert calibration.rig.baseline_m == pytest.approx(10 * RIG.baseline_m, rel=0.01)
    with pytest.raises(CalibrationError, match=r"come out 4\.1 m apart with squares of 500 mm"):
        run(views_of(count=12), Board("chessboard", 9, 6, 0.5))


def test_points_outside_of_the_images_are_refused() -> None:
    views = views_of()
    with pytest.raises(CalibrationError, match=r"view \d\d has a point at .* outside of images of 320x240"):
        calibrate(views, FLAT, (320, 240), GIVEN)
    with pytest.raises(CalibrationError, match="view 00 shows point 53 of a board of 20"):
        calibrate(views, Board("chessboard", 5, 4, 0.025), SIZE, GIVEN)
    with pytest.raises(ValueRefusedError, match="size_px"):
        calibrate(views, FLAT, (0, 240), GIVEN)


def test_settings_refuse_what_they_do_not_know() -> None:
    with pytest.raises(ValidationError, match="lens"):
        CalibrateSettings(lens="pinhole")  # type: ignore[arg-type]
    with pytest.raises(ValidationError, match="extra"):
        CalibrateSettings(focal=3)  # type: ignore[call-arg]
