"""Error analysis: rings, epipolar errors and reasons, against constructions."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibration_examples import FLAT, example_rig, example_views

from roadblock.stages.calibrate.analysis import (
    RINGS,
    camera_fit,
    epipolar_px,
    epipolar_rms_px,
    ring_means,
    rms_px,
    view_fits,
)
from roadblock.stages.calibrate.bundle import CameraSolution, RigSolution
from roadblock.values.board import BoardView, Sighting

RIG = example_rig(size_px=(640, 480))
POINTS = len(FLAT.points_m)


def camera_solution(views: tuple[BoardView, ...], left_out: tuple[str, ...], error_px: float = 0.1) -> CameraSolution:
    """Return a solution whose residuals all are `error_px` to the right."""
    residual = np.full((len(views), POINTS, 2), np.nan)
    for i, view in enumerate(views):
        if view.left:
            residual[i, view.left.ids] = (error_px, 0.0)
    weight = np.where(np.isnan(residual[..., 0]), np.nan, 1.0)
    return CameraSolution(
        RIG.left,
        "brown_conrady5",
        (np.eye(4),) * len(views),
        residual,
        weight,
        0.08,
        0.05,
        np.zeros(len(views)),
        left_out,
    )


def rig_solution(count: int, left_out: tuple[str, ...]) -> RigSolution:
    residual = np.arange(2.0 * count * POINTS * 2).reshape(2, count, POINTS, 2)
    return RigSolution(
        RIG, "brown_conrady5", np.zeros(POINTS), np.zeros(POINTS), (np.eye(4),) * count, residual,
        residual[..., 0] / residual.max(), (0.1, 0.1), np.zeros((2, count)), left_out, 1.0, np.eye(24), np.zeros(9),
        np.ones(2),
    )  # fmt: skip


def test_rings_tell_outwards_from_around() -> None:
    angle, radius = np.meshgrid(np.linspace(0, 2 * np.pi, 40, endpoint=False), np.linspace(12.5, 187.5, 8))
    places = np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 2)
    clockwise = np.stack([-np.sin(angle), np.cos(angle)], -1).reshape(-1, 2)  # from right to down: v points down
    residual = 0.3 * places / 100 + 0.2 * clockwise
    radial, tangential = ring_means(
        np.r_[places, [[200.0, 0]]], np.r_[residual, [[9, 9]]], np.r_[np.ones(len(places)), 0.0]
    )
    np.testing.assert_allclose(radial[:, 0], np.linspace(12.5, 187.5, RINGS))
    np.testing.assert_allclose(radial[:, 1], 0.3 * np.linspace(0.125, 1.875, RINGS))
    np.testing.assert_allclose(tangential[:, 1], 0.2)


def test_rings_ignore_what_is_unknown_and_leave_empty_ones_nan() -> None:
    places = np.array([[80.0, 0], [0, 0], [70, 0], [75, 0]])
    errors = np.array([[0.5, 0], [0.1, 0.1], [np.nan, 0], [7, 7]])
    radial, tangential = ring_means(places, errors, np.array([1.0, 1, 1, np.nan]))
    assert radial[0, 1] == 0  # the middle itself has no outside
    assert np.isnan(radial[1:-1, 1]).all()
    assert radial[-1, 1] == 0.5
    assert tangential[-1, 1] == 0


def test_camera_fit_is_made_of_used_views_alone() -> None:
    views = example_views(RIG, FLAT, np.random.default_rng(1), 4, 0.05)
    views = (*views, BoardView("none", None, views[0].right))
    solution = camera_solution(views, ("", "", "too bad", "", ""))
    solution.residual_px[2] *= 100
    fit = camera_fit([view.left for view in views], solution)
    assert fit.camera is RIG.left
    assert fit.rms_px == pytest.approx(0.1)
    assert (fit.sigma_px, fit.expected_sigma_px) == (0.08, 0.05)
    assert fit.radial_px.shape == fit.tangential_px.shape == (RINGS, 2)
    assert np.nanmax(np.abs(fit.radial_px[:, 1])) <= 0.1 + 1e-12


def test_rms_counts_lengths_as_opencv_does() -> None:
    assert rms_px(np.array([[3.0, 4], [0, 0], [np.nan, 1]])) == pytest.approx(np.sqrt(12.5))
    assert np.isnan(rms_px(np.full((2, 2), np.nan)))


def test_epipolar_errors_are_the_rows_of_opencv() -> None:
    view = example_views(RIG, FLAT, np.random.default_rng(2), 6, 0.0)[3]
    assert view.left
    assert view.right
    np.testing.assert_allclose(epipolar_px(RIG, view), 0, atol=1e-9)
    moved = replace(view, right=replace(view.right, points_px=view.right.points_px + np.array([0.3, -2.0])))
    T = np.linalg.inv(RIG.T_left_right)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        RIG.left.K, RIG.left.distortion, RIG.right.K, RIG.right.distortion, RIG.left.size_px, T[:3, :3], T[:3, 3:]
    )
    _, of_left, of_right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
    rows = [
        cv2.undistortPoints(points[:, None], camera.K, camera.distortion, R=R, P=P)[:, 0, 1]
        for points, camera, R, P in (
            (moved.left.points_px[of_left], RIG.left, R1, P1),  # type: ignore[union-attr]
            (moved.right.points_px[of_right], RIG.right, R2, P2),  # type: ignore[union-attr]
        )
    ]
    f = (RIG.left.fy_px + RIG.right.fy_px) / 2
    np.testing.assert_allclose(epipolar_px(RIG, moved), (rows[0] - rows[1]) * f / P1[1, 1], atol=0.01)
    assert epipolar_rms_px(RIG, [moved]) == pytest.approx(np.sqrt(np.mean(epipolar_px(RIG, moved) ** 2)))


def test_no_epipolar_error_without_pairs() -> None:
    view = example_views(RIG, FLAT, np.random.default_rng(3), 1, 0.0)[0]
    assert len(epipolar_px(RIG, replace(view, right=None))) == 0
    assert np.isnan(epipolar_rms_px(RIG, [replace(view, right=None)]))


def test_reasons_name_what_moved_what_is_no_pair_and_what_fits_no_camera() -> None:
    view = example_views(RIG, FLAT, np.random.default_rng(4), 1, 0.0)[0]
    assert view.left
    assert view.right
    moved = replace(view, right=replace(view.right, points_px=view.right.points_px + np.array([0.0, 3.2])))
    lost = Sighting(view.left.ids[:1], np.array([[1e5, 1e5]]), np.array([0.1]))
    views = (view, moved, moved, moved, replace(view, right=None), replace(view, left=lost))
    together = ("", "far off", "far off", "far off", "far off", "far off")
    fits = view_fits(
        views,
        camera_solution(views, ("", "", "bad alone", "", "", "")),
        camera_solution(views, ("",) * 6),
        rig_solution(6, together),
        np.array([True, True, True, False, False, True]),
    )
    reasons = [fit.left_out for fit in fits]
    assert reasons[0] == ""
    assert reasons[1].startswith("moved between left and right")
    assert "epipolar error 3.2 px, far off" in reasons[1]
    assert reasons[2] == "far off"
    assert reasons[3].startswith("left and right show different moments")
    assert reasons[4] == "far off"
    assert "epipolar error nan px" in reasons[5]
    solution = rig_solution(6, together)
    np.testing.assert_array_equal(fits[1].residual_right_px, solution.residual_px[1, 1])
    np.testing.assert_array_equal(fits[1].weight_left, solution.weight[0, 1])
