"""Calibrate: bundle adjustment of cameras, their relative pose, every board's pose and the board's shape, robustly.

The problem is sparse in one simple way: a view's pose touches that view's points only. Eliminating the poses (Schur's
complement) leaves a dense system of the few dozen parameters that all views share. With views as the leading axis of
every array, 29 pairs of 54 corners take 0.09 s. `scipy.optimize.least_squares` with the same Jacobian takes 11 s by
its exact solver, which decomposes the whole matrix, and by its sparse one (lsmr) stalls: 28 % above the least cost and
half a pixel off in the focal length after 100 evaluations (2 s). It stays the slow twin that a test holds this to.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.projection import parameter_jacobian, project, project_jacobian
from roadblock.stages.calibrate.shape import Shape
from roadblock.values.board import Sighting
from roadblock.values.camera import Camera
from roadblock.values.checks import FloatArray

Mask = NDArray[np.bool_]

LOSS_WIDTH = 4.0
"""Residuals so many sigma long weigh half of short ones (Cauchy's loss): Gaussian noise loses 1.5 % of what it says."""

RAYLEIGH_MEDIAN = float(np.sqrt(2 * np.log(2)))
"""Median length of a residual whose two coordinates have sigma 1."""

STEPS = 100
DAMPING = 1e-4
MOST_DAMPING = 1e8
CONVERGED = 1e-6
"""A step that promises to lower the cost (in units of sigma^2) by less than this is the last."""

FAINT = 1e-9
"""What is known of a pose beforehand, 1/rad^2 and 1/m^2: it keeps a view without a single good corner solvable."""

LOST = 1e6
"""Length, in sigma, of the residual of a seen point that the model puts behind the camera or beyond its lens."""


@dataclass(frozen=True, eq=False)
class Corners:
    """What one camera saw: `points_px` (views, n, 2) and `sigma_px` (views, n), NaN where a point was not seen."""

    points_px: FloatArray
    sigma_px: FloatArray

    @property
    def seen(self) -> Mask:
        """(views, n) whether the camera saw that point."""
        return ~np.isnan(self.sigma_px)

    def of(self, views: Mask | NDArray[np.intp]) -> "Corners":
        """Return these views' corners."""
        return Corners(self.points_px[views], self.sigma_px[views])


def corners_of(sightings: Sequence[Sighting | None], count: int) -> Corners:
    """Return sightings of a board of `count` points as arrays."""
    points, sigma = np.full((len(sightings), count, 2), np.nan), np.full((len(sightings), count), np.nan)
    for view, sighting in enumerate(sightings):
        if sighting is not None:
            points[view, sighting.ids], sigma[view, sighting.ids] = sighting.points_px, sighting.sigma_px
    return Corners(points, sigma)


@dataclass(frozen=True, eq=False)
class Bundle:
    """All unknowns.

    The parameters that views share are, in this order: each camera's, the relative pose (6, see
    `values.camera.POSE_PARAMETERS`), the shape's coefficients.

    Attributes
    ----------
    cameras
        The left and the right camera, or a single one (then "left" is that one).
    T_left_right
        4x4, metres; means nothing with a single camera.
    T_left_board
        (views, 4, 4), metres.
    shape
        (k,) coefficients of the board's shape, metres.
    """

    cameras: tuple[Camera, ...]
    T_left_right: FloatArray
    T_left_board: FloatArray
    shape: FloatArray

    @property
    def ends(self) -> list[int]:
        """Where each camera's and the pose's share of the shared parameters end."""
        return [int(end) for end in np.cumsum([*(len(camera.parameters) for camera in self.cameras), 6])]

    def moved(self, shared: FloatArray, poses: FloatArray) -> "Bundle":
        """Return the bundle changed by steps of the shared parameters (c,) and of the poses (views, 6).

        Raises
        ------
        ValueRefusedError
            If there is no such camera.
        """
        *of_cameras, of_pose, of_shape = np.split(shared, self.ends)
        cameras = tuple(camera_of(c, camera_values(c) + d) for c, d in zip(self.cameras, of_cameras, strict=True))
        T = np.stack([moved_pose(T, step) for T, step in zip(self.T_left_board, poses, strict=True)])
        return Bundle(cameras, moved_pose(self.T_left_right, of_pose), T, self.shape + of_shape)


def camera_values(camera: Camera) -> FloatArray:
    """Return its parameters in the order of `Camera.parameters`."""
    return np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion])


def camera_of(like: Camera, values: FloatArray) -> Camera:
    """Return a camera with these parameters, otherwise `like` another; ValueRefusedError where there is none."""
    fx, fy, cx, cy = map(float, values[:4])
    return replace(like, fx_px=fx, fy_px=fy, cx_px=cx, cy_px=cy, distortion=values[4:])


def moved_pose(T: FloatArray, step: FloatArray) -> FloatArray:
    """Return a pose turned by `R <- exp([r]) R` and shifted, `step` = (r, dt)."""
    return pose(rotation_from_rotvec(step[:3]) @ T[:3, :3], T[:3, 3] + step[3:])


@dataclass(frozen=True, eq=False)
class Problem:
    """What was seen, and what is known beforehand.

    Attributes
    ----------
    points_m
        (n, 3) of the flat board.
    shape
        What shapes it may have.
    corners
        Of each camera.
    mean, sigma
        (c,) weak knowledge of the shared parameters, which keeps what no view shows from running away; infinite sigma
        where there is none.
    """

    points_m: FloatArray
    shape: Shape
    corners: tuple[Corners, ...]
    mean: FloatArray
    sigma: FloatArray

    def of(self, views: Mask | NDArray[np.intp]) -> "Problem":
        """Return the same with these views alone."""
        return replace(self, corners=tuple(corners.of(views) for corners in self.corners))

    def off(self, bundle: Bundle) -> FloatArray:
        """Return (c,) how far the shared parameters lie from what is known beforehand, in sigma."""
        values = np.r_[*map(camera_values, bundle.cameras), np.zeros(6), bundle.shape]
        return np.asarray((values - self.mean) / self.sigma)


@dataclass(frozen=True, eq=False)
class Normal:
    """What each view says, linearized: blocks of the normal equations, and the slopes they have to meet.

    `shared` (views, c, c), `across` (views, c, 6) between shared parameters and the view's pose, `poses` (views, 6, 6);
    `shared_slope` (views, c) and `poses_slope` (views, 6).
    """

    shared: FloatArray
    across: FloatArray
    poses: FloatArray
    shared_slope: FloatArray
    poses_slope: FloatArray


def residuals(problem: Problem, bundle: Bundle) -> tuple[FloatArray, ...]:
    """Return per camera (views, n, 2) measured minus predicted, pixels; NaN where unseen or not predicted."""
    in_cameras = _points(problem, bundle)
    return tuple(
        corners.points_px - project(camera, points)
        for camera, points, corners in zip(bundle.cameras, in_cameras, problem.corners, strict=True)
    )


def lengths(problem: Problem, errors_px: Sequence[FloatArray]) -> tuple[FloatArray, ...]:
    """Return per camera (views, n) lengths of residuals in sigma; NaN where unseen, `LOST` where not predicted."""
    out = []
    for corners, error in zip(problem.corners, errors_px, strict=True):
        r = np.hypot(error[..., 0], error[..., 1]) / corners.sigma_px
        out.append(np.where(corners.seen & np.isnan(r), LOST, r))
    return tuple(out)


def noise_factors(problem: Problem, errors_px: Sequence[FloatArray], parameters: int) -> FloatArray:
    """Return per camera by how much its noise exceeds what its corners were said to have, robustly; 1 if it saw none.

    `parameters` fitted to the residuals made them smaller than the noise; this is put right.
    """
    numbers = 2 * sum(int(corners.seen.sum()) for corners in problem.corners)
    spare = np.sqrt(numbers / max(numbers - parameters, 1))
    medians = [
        np.median(r[~np.isnan(r)]) if (~np.isnan(r)).any() else RAYLEIGH_MEDIAN for r in lengths(problem, errors_px)
    ]
    return np.asarray(np.maximum(spare * np.array(medians) / RAYLEIGH_MEDIAN, 1e-6))


def weights(r: FloatArray) -> FloatArray:
    """Return the weight 0..1 of residuals `r` sigma long; NaN stays NaN."""
    return np.asarray(1 / (1 + (r / LOSS_WIDTH) ** 2))


def view_costs(r: Sequence[FloatArray], factors: FloatArray) -> FloatArray:
    """Return (views,) Cauchy's loss of each view's residuals `r` (see `lengths`), in sigma^2."""
    each = [LOSS_WIDTH**2 * np.log1p((of / factor / LOSS_WIDTH) ** 2) for of, factor in zip(r, factors, strict=True)]
    return np.asarray(sum(np.nansum(loss, 1) for loss in each))


def adjust(
    problem: Problem, bundle: Bundle, free: Mask, factors: FloatArray | None = None, steps: int = STEPS
) -> Bundle:
    """Find the bundle that fits best, by Levenberg and Marquardt's method on reweighted residuals.

    Parameters
    ----------
    problem
        What was seen.
    bundle
        Where to start.
    free
        (c,) which shared parameters are unknown; the others stay. Poses are always unknown.
    factors
        Noise of each camera over what its corners were said to have; estimated on the way if None.
    steps
        At most so many.

    Returns
    -------
    The best bundle found; the start, where the problem is too odd to find any better one.
    """
    damping = DAMPING
    unknowns = int(free.sum()) + 6 * len(bundle.T_left_board)
    errors = residuals(problem, bundle)
    for _ in range(steps):
        scale = noise_factors(problem, errors, unknowns) if factors is None else factors
        equations = normal_equations(problem, bundle, errors, inverse_variances(problem, errors, scale), free)
        cost = _cost(problem, bundle, errors, scale, free)
        gain = 0.0
        while damping < MOST_DAMPING:
            moved, promise = _step(problem, bundle, equations, free, damping)
            moved_errors = residuals(problem, moved)
            if promise > 0 and _cost(problem, moved, moved_errors, scale, free) <= cost:
                bundle, errors, gain, damping = moved, moved_errors, promise, damping / 10
                break
            damping = max(10 * damping, DAMPING)
        if gain < CONVERGED:
            break
    return bundle


def _step(problem: Problem, bundle: Bundle, equations: Normal, free: Mask, damping: float) -> tuple[Bundle, float]:
    """Return the bundle after a step and the gain it promises; as it is, and 0, where the step leads nowhere."""
    shared = np.zeros(len(free))
    off, sigma = problem.off(bundle)[free], problem.sigma[free]
    try:
        shared[free], poses = solve(equations, sigma, off, damping)
        moved = bundle.moved(shared, poses)
    except (LinAlgError, ValueRefusedError):
        return bundle, 0.0
    slope = equations.shared_slope.sum(0) - off / sigma
    return moved, float(slope @ shared[free] + np.sum(equations.poses_slope * poses))


def _cost(problem: Problem, bundle: Bundle, errors_px: Sequence[FloatArray], factors: FloatArray, free: Mask) -> float:
    off = problem.off(bundle)[free]
    return float(view_costs(lengths(problem, errors_px), factors).sum() + off @ off)


def inverse_variances(problem: Problem, errors_px: Sequence[FloatArray], factors: FloatArray) -> tuple[FloatArray, ...]:
    """Return per camera (views, n) robust weights of residuals, 1/px^2; 0 where unseen."""
    return tuple(
        np.nan_to_num(weights(r / factor) / (corners.sigma_px * factor) ** 2)
        for r, factor, corners in zip(lengths(problem, errors_px), factors, problem.corners, strict=True)
    )


def normal_equations(
    problem: Problem, bundle: Bundle, errors_px: Sequence[FloatArray], weight: Sequence[FloatArray], free: Mask
) -> Normal:
    """Return what each view says about the free shared parameters and its pose, for weights (views, n) in 1/px^2."""
    views, count = len(bundle.T_left_board), int(free.sum())
    out = Normal(
        np.zeros((views, count, count)),
        np.zeros((views, count, 6)),
        np.tile(FAINT * np.eye(6), (views, 1, 1)),
        np.zeros((views, count)),
        np.zeros((views, 6)),
    )
    for side, (error, w) in enumerate(zip(errors_px, weight, strict=True)):
        by_shared, by_pose = slopes(problem, bundle, side, free)
        bad = np.isnan(error).any(-1) | ~(w > 0)
        root = np.sqrt(np.where(bad, 0.0, w))[..., None]
        rows = views, 2 * error.shape[1]
        e = (np.where(bad[..., None], 0.0, error) * root).reshape(*rows, 1)
        for slope in (by_shared, by_pose):
            slope[bad] = 0.0
            slope *= root[..., None]
        A, P = by_shared.reshape(*rows, count), by_pose.reshape(*rows, 6)
        A_T, P_T = A.swapaxes(1, 2), P.swapaxes(1, 2)
        for total, part in zip(
            (out.shared, out.across, out.poses, out.shared_slope, out.poses_slope),
            (A_T @ A, A_T @ P, P_T @ P, (A_T @ e)[..., 0], (P_T @ e)[..., 0]),
            strict=True,
        ):
            total += part
    return out


def solve(equations: Normal, sigma: FloatArray, off: FloatArray, damping: float) -> tuple[FloatArray, FloatArray]:
    """Return the steps of the shared parameters (c,) and of the poses (views, 6).

    `sigma` and `off` (c,) are what is known beforehand, see `Problem`. LinAlgError where there is no solution.
    """
    shared = equations.shared.sum(0) + np.diag(1 / sigma**2)
    shared += damping * np.diag(shared.diagonal())
    gain = equations.across @ np.linalg.inv(equations.poses * (1 + damping * np.eye(6)))
    reduced = shared - np.tensordot(gain, equations.across, ((0, 2), (0, 2)))
    slope = equations.shared_slope.sum(0) - off / sigma - np.einsum("vcp,vp->c", gain, equations.poses_slope)
    scale = 1 / np.sqrt(shared.diagonal())
    step = scale * cho_solve(cho_factor(reduced * np.outer(scale, scale)), scale * slope) if len(slope) else slope
    rest = equations.poses_slope - np.einsum("vcp,c->vp", equations.across, step)
    damped = equations.poses * (1 + damping * np.eye(6))
    return step, np.linalg.solve(damped, rest[..., None])[..., 0]


def slopes(problem: Problem, bundle: Bundle, side: int, free: Mask) -> tuple[FloatArray, FloatArray]:
    """Return what one camera's pixels do when unknowns change.

    Returns
    -------
    (views, n, 2, c) by the free shared parameters and (views, n, 2, 6) by the view's pose (turn, shift), px per unit;
    NaN where a point is not predicted.
    """
    camera, R_board = bundle.cameras[side], bundle.T_left_board[:, :3, :3]
    points = _points(problem, bundle)[side]
    by_point = project_jacobian(camera, points)
    lever = _board_points(problem, bundle) @ R_board.swapaxes(1, 2)
    by_shared = np.zeros((*by_point.shape[:-1], bundle.ends[-1] + len(bundle.shape)))
    first = 0 if side == 0 else bundle.ends[0]
    by_shared[..., first : bundle.ends[side]] = parameter_jacobian(camera, points)
    if side == 1:
        by_point = by_point @ bundle.T_left_right[:3, :3].T
        arm = lever + bundle.T_left_board[:, None, :3, 3] - bundle.T_left_right[:3, 3]
        by_shared[..., bundle.ends[1] : bundle.ends[2]] = np.concatenate(
            [np.cross(by_point, arm[..., None, :]), -by_point], -1
        )
    upright = (by_point @ R_board[:, None, :, 2:])[..., 0]
    by_shared[..., bundle.ends[-1] :] = upright[..., None] * problem.shape.basis[:, None]
    by_shared = by_shared if free.all() else by_shared[..., free]
    return by_shared, np.concatenate([np.cross(lever[..., None, :], by_point), by_point], -1)


def _board_points(problem: Problem, bundle: Bundle) -> FloatArray:
    heights = problem.shape.basis @ bundle.shape
    return np.asarray(problem.points_m + heights[:, None] * (0.0, 0.0, 1.0))


def _points(problem: Problem, bundle: Bundle) -> list[FloatArray]:
    """Return the board's points in each camera's frame, (views, n, 3)."""
    T = bundle.T_left_board
    in_left = _board_points(problem, bundle) @ T[:, :3, :3].swapaxes(1, 2) + T[:, None, :3, 3]
    R, t = bundle.T_left_right[:3, :3], bundle.T_left_right[:3, 3]
    return [in_left, (in_left - t) @ R][: len(bundle.cameras)]
