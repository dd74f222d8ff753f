"""Calibrate: error analysis. Solutions in; what each camera's residuals look like, and why views were left out, out."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.projection import unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.stages.calibrate.bundle import CameraSolution, RigSolution
from roadblock.values.board import BoardView, Sighting
from roadblock.values.calibration import CameraFit, ViewFit
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray

RINGS = 8
"""Rings around the principal point that residuals are averaged over."""


def camera_fit(sightings: Sequence[Sighting | None], solution: CameraSolution) -> CameraFit:
    """Return the error analysis of one camera calibrated alone, from the views that it was fitted to."""
    used = [i for i, (seen, why) in enumerate(zip(sightings, solution.left_out, strict=True)) if seen and not why]
    errors = [solution.residual_px[i][sightings[i].ids] for i in used]  # type: ignore[union-attr]
    weight = [solution.weight[i][sightings[i].ids] for i in used]  # type: ignore[union-attr]
    points = [sightings[i].points_px for i in used]  # type: ignore[union-attr]
    radial, tangential = ring_means(
        np.concatenate(points) - (solution.camera.cx_px, solution.camera.cy_px),
        np.concatenate(errors),
        np.concatenate(weight),
    )
    return CameraFit(
        solution.camera,
        rms_px(solution.residual_px[used]),
        solution.sigma_px,
        solution.expected_sigma_px,
        radial,
        tangential,
    )


def rms_px(residual_px: FloatArray) -> float:
    """Return the root mean square of the lengths of residuals (..., 2), as OpenCV's; NaN if none is known."""
    squares = (residual_px**2).sum(-1)
    return float(np.sqrt(np.mean(squares[~np.isnan(squares)]))) if (~np.isnan(squares)).any() else float("nan")


def ring_means(
    from_center_px: FloatArray, residual_px: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return (`RINGS`, 2) radius and weighted mean residual outwards, and the same around (clockwise), pixels.

    Parameters
    ----------
    from_center_px
        (n, 2) places relative to the principal point.
    residual_px, weight
        (n, 2) and (n,) of the points there; NaN where unknown.
    """
    known = ~np.isnan(residual_px).any(-1) & ~np.isnan(weight)
    radius = np.hypot(*from_center_px[known].T)
    outwards = from_center_px[known] / np.where(radius > 0, radius, 1.0)[:, None]
    around = np.stack([-outwards[:, 1], outwards[:, 0]], -1)
    edges = np.linspace(0, max(float(radius.max(initial=0.0)), 1.0), RINGS + 1)
    ring = np.clip(np.searchsorted(edges, radius, "right") - 1, 0, RINGS - 1)
    total = np.bincount(ring, weight[known], RINGS)
    means = []
    for direction in (outwards, around):
        along = (residual_px[known] * direction).sum(-1) * weight[known]
        with np.errstate(invalid="ignore"):
            means.append(np.stack([(edges[:-1] + edges[1:]) / 2, np.bincount(ring, along, RINGS) / total], -1))
    return means[0], means[1]


def epipolar_px(rig: StereoRig, view: BoardView) -> FloatArray:
    """Return (n,) row in the left minus row in the right rectified image, pixels, of the points both cameras saw.

    The rectified images' focal length is taken as the mean of the raw ones'; NaN where a lens does not reach.
    """
    if view.left is None or view.right is None:
        return np.zeros(0)
    _, of_left, of_right = np.intersect1d(view.left.ids, view.right.ids, return_indices=True)
    rows = []
    for camera, R, points_px in zip(
        (rig.left, rig.right),
        rectifying_rotations(rig.T_left_right),
        (view.left.points_px[of_left], view.right.points_px[of_right]),
        strict=True,
    ):
        rays = unproject(camera, points_px) @ R.T
        rows.append(rays[:, 1] / rays[:, 2] * (rig.left.fy_px + rig.right.fy_px) / 2)
    return np.asarray(rows[0] - rows[1])


def epipolar_rms_px(rig: StereoRig, views: Sequence[BoardView]) -> float:
    """Return the root mean square of `epipolar_px` over views; NaN if no view shows a point to both cameras."""
    rows = np.concatenate([np.zeros(0), *(epipolar_px(rig, view) for view in views)])
    rows = rows[~np.isnan(rows)]
    return float(np.sqrt(np.mean(rows**2))) if rows.size else float("nan")


def view_fits(
    views: Sequence[BoardView],
    left: CameraSolution,
    right: CameraSolution,
    solution: RigSolution,
    agrees: NDArray[np.bool_],
) -> tuple[ViewFit, ...]:
    """Return how every view fits the rig, and why those left out were.

    Parameters
    ----------
    views, left, right, solution
        What was seen, and what each camera alone and both together made of it.
    agrees
        (n,) whether the cameras seem to sit to each other as in most pairs, by each view's pair.
    """
    return tuple(
        ViewFit(
            view.name,
            solution.T_left_board[i],
            solution.residual_px[0, i],
            solution.residual_px[1, i],
            solution.weight[0, i],
            solution.weight[1, i],
            _reason(view, left.left_out[i] or right.left_out[i], solution.left_out[i], bool(agrees[i]), solution.rig),
        )
        for i, view in enumerate(views)
    )


def _reason(view: BoardView, alone: str, together: str, agrees: bool, rig: StereoRig) -> str:
    """Say why a view was left out; "" if it was not. One that each camera alone can use has moved in between."""
    if not together or alone or view.left is None or view.right is None:
        return together
    if not agrees:
        return f"left and right show different moments: the cameras would sit as in no other pair; {together}"
    rows = np.abs(epipolar_px(rig, view))
    error_px = np.median(rows[~np.isnan(rows)]) if (~np.isnan(rows)).any() else np.nan
    return f"moved between left and right, for each camera alone fits: epipolar error {error_px:.2g} px, {together}"
