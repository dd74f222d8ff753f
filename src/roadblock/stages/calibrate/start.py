"""Calibrate: where to start. A camera from nothing but sightings, a board's pose from one sighting."""

import cv2
import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec, rotvec_from_rotation, transform
from roadblock.geometry.projection import project, unproject
from roadblock.stages.calibrate.adjust import Bundle, Corners, Problem, adjust
from roadblock.stages.calibrate.shape import shape_of
from roadblock.values.board import Board
from roadblock.values.camera import Camera, Lens
from roadblock.values.checks import FloatArray

LENSES: dict[str, tuple[Lens, int]] = {
    "brown_conrady5": ("brown_conrady", 5),
    "brown_conrady8": ("brown_conrady", 8),
    "kannala_brandt": ("kannala_brandt", 4),
}
"""Lens models by name, the simplest first: model and number of coefficients."""

FEWEST_POINTS = 6
FOCALS = tuple(0.25 * 1.33**i for i in range(12))
"""Focal lengths to try, over the image's longer side."""

BENDS = (0.0, -0.1, -0.2)
"""Barrel distortions to try: what k1 does at the image's corners."""

PINHOLE_AS_KANNALA_BRANDT = (1 / 3, 2 / 15, 17 / 315, 62 / 2835)
"""tan(theta) as a series: lets a fisheye start as an ordinary lens."""

BEND_SIGMA: dict[str, tuple[tuple[int, float], ...]] = {
    "brown_conrady": ((2, 0.5), (4, 0.25), (1, 0.05), (1, 0.05), (6, 0.1), (2, 0.5), (4, 0.25), (6, 0.1)),
    "kannala_brandt": ((2, 0.5), (4, 0.25), (6, 0.1), (8, 0.1)),
}
"""How large a lens's coefficients can be expected to be: the power of the radius each goes with, and one sigma of how
far it alone moves the image's corner, over the corner's distance from the middle."""

VIEWS_TO_TRY = 7
STARTS = 3
START_STEPS = 30


def board_poses(points_m: FloatArray, rays: FloatArray) -> list[FloatArray]:
    """Return the one or two poses `T_camera_board` of a flat board that fit a sighting, the better one first.

    A flat board seen from afar looks much the same tilted to either side. The view is turned to the board's middle
    first, so that a fisheye may see it anywhere.

    Parameters
    ----------
    points_m
        (n, 3) on the flat board.
    rays
        (n, 3) unit vectors in the camera's frame (see `unproject`); NaN where a point was not seen.
    """
    good = ~np.isnan(rays).any(-1)
    if good.sum() < FEWEST_POINTS or is_line(points_m[good]):
        return []
    z = rays[good].mean(0)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x = x / np.linalg.norm(x)
    R_camera_view = np.stack([x, np.cross(z, x), z], -1)
    seen = rays[good] @ R_camera_view
    if (seen[:, 2] < 0.1).any():
        return []
    plane = np.ascontiguousarray(seen[:, :2] / seen[:, 2:])
    _, turns, shifts, _ = cv2.solvePnPGeneric(points_m[good], plane, np.eye(3), np.zeros(4), flags=cv2.SOLVEPNP_IPPE)
    found = [
        pose(R_camera_view @ rotation_from_rotvec(r), R_camera_view @ t.ravel())
        for r, t in zip(turns, shifts, strict=True)
    ]
    return [T for T in found if np.isfinite(T).all()]


def is_line(points_m: FloatArray) -> bool:
    """Whether points lie on one line, or nearly."""
    spread = np.linalg.svd(points_m[:, :2] - points_m[:, :2].mean(0), compute_uv=False)
    return bool(spread[-1] < 1e-3 * spread[0])


def first_camera(corners: Corners, board: Board, size_px: tuple[int, int], lens: str) -> Camera:
    """Return a camera to start from: the best of a coarse grid of focal lengths and bends, refined.

    A strong lens may draw one start into a wrong valley, so the best ones of several focal lengths are refined.
    """
    some = corners.of(np.argsort(-corners.seen.sum(1), kind="stable")[:VIEWS_TO_TRY])
    trials = _trials(size_px, lens)
    misfits = [_misfit(camera, board.points_m, some.points_px) for camera in trials]
    best: dict[float, Camera] = {}
    for which in np.argsort(misfits, kind="stable"):
        best.setdefault(trials[which].fx_px, trials[which])
    refined = [_refined(camera, board, some) for camera in list(best.values())[:STARTS]]
    return min(refined, key=lambda camera: _misfit(camera, board.points_m, some.points_px))


def _refined(camera: Camera, board: Board, corners: Corners) -> Camera:
    """Return the camera adjusted to the views that it finds a pose for; as it is if there are none."""
    problem = knowledge((camera,), board, (corners,))
    found = [board_poses(board.points_m, rays) for rays in unproject(camera, corners.points_px)]
    posed = np.array([bool(poses) for poses in found])
    if not posed.any():
        return camera
    T = np.stack([poses[0] for poses in found if poses])
    bundle = Bundle((camera,), np.eye(4), T, np.zeros(len(problem.shape.sigma_m)))
    return adjust(problem.of(posed), bundle, np.isfinite(problem.sigma), steps=START_STEPS).cameras[0]


def _trials(size_px: tuple[int, int], lens: str) -> list[Camera]:
    width, height = size_px
    model, count = LENSES[lens]
    trials = []
    for focal in FOCALS:
        f = focal * max(size_px)
        reach = np.hypot(width, height) / 2 / f
        if model == "brown_conrady":
            lenses = [(bend / reach**2, *np.zeros(count - 1)) for bend in BENDS]
        else:
            lenses = [(0.0, 0.0, 0.0, 0.0), PINHOLE_AS_KANNALA_BRANDT]
        trials += [Camera(size_px, f, f, (width - 1) / 2, (height - 1) / 2, model, np.array(k)) for k in lenses]
    return trials


def _misfit(camera: Camera, points_m: FloatArray, points_px: FloatArray) -> float:
    """Return the median over views of the median distance, pixels; infinite for a view that has no pose."""
    errors = []
    for seen, rays in zip(points_px, unproject(camera, points_px), strict=True):
        known = ~np.isnan(seen[:, 0])
        poses = board_poses(points_m, rays)
        if poses:
            error = np.linalg.norm(project(camera, transform(poses[0], points_m[known])) - seen[known], axis=-1)
            errors.append(float(np.median(np.nan_to_num(error, nan=np.inf))))
        else:
            errors.append(np.inf)
    return float(np.median(errors))


def knowledge(cameras: tuple[Camera, ...], board: Board, corners: tuple[Corners, ...]) -> Problem:
    """Return the problem of these cameras, with weak knowledge of what a camera and a board can be.

    One sigma: focal lengths as large as they start; the principal point a quarter of the image from its middle; each
    coefficient as large as `BEND_SIGMA` says; the shape as `shape.Shape` says.
    """
    shape = shape_of(board)
    mean, sigma = [], []
    for camera in cameras:
        width, height = camera.size_px
        f = (camera.fx_px + camera.fy_px) / 2
        powers, shares = np.array(BEND_SIGMA[camera.lens][: len(camera.distortion)]).T
        reach = np.hypot(width, height) / 2 / f
        mean += [f, f, (width - 1) / 2, (height - 1) / 2, *np.zeros(len(powers))]
        sigma += [f, f, width / 4, height / 4, *(shares / reach**powers)]
    count = len(shape.sigma_m)
    return Problem(
        board.points_m,
        shape,
        corners,
        np.r_[mean, np.zeros(6 + count)],
        np.r_[sigma, np.full(6, np.inf), shape.sigma_m],
    )


def relative_pose(left: FloatArray, right: FloatArray) -> FloatArray:
    """Return `T_left_right` as the robust middle of what views say, from their `T_camera_board` (views, 4, 4)."""
    each = left @ np.linalg.inv(right)
    t = np.median(each[:, :3, 3], 0)
    R = each[np.argmin(np.linalg.norm(each[:, :3, 3] - t, axis=-1)), :3, :3]
    for _ in range(5):
        turns = [rotvec_from_rotation(T[:3, :3] @ R.T) for T in each]
        R = rotation_from_rotvec(np.median(turns, 0)) @ R
    return pose(R, t)
