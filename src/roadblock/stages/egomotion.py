"""Ego-motion: RectifiedPairs in, one after the other; how the cameras moved since the one before, out.

Corners of the earlier left image are measured by the Lucas-Kanade method in the earlier right one, in the later left
one and in the later right one, all at half resolution. What most of them agree on (RANSAC) is refined by robust
Gauss-Newton over (u, v, d), in which the noise of both measurements of a feature counts. Or the recording says how its
cameras moved (wheels, inertia, satellites); then the features only tell what else moves.
"""

from typing import Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, rotvec_from_rotation, skew, transform
from roadblock.geometry.stereo import image_from_car, image_jacobian, triangulate, triangulate_jacobian
from roadblock.kernels.features import Points, Search, follow, spread_corners
from roadblock.kernels.gray import half_images
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Gray, RectifiedPair
from roadblock.values.motion import EgoMotion, Flow

WINDOW_PX = 9
"""Of the Lucas-Kanade method, at half resolution."""
LEVELS, MORE_LEVELS, FEW_LEVELS = 4, 2, 1
"""Of the image pyramid: without a guess, with that of the motion before, and with that of the disparity before."""
TRIES, SETTLED_PX = 12, 0.01
"""The search for a feature ends after so many steps, or with a smaller one."""
BLOCK_PX, CELL_PX, CONTRAST = 3, 4, 1e-4
"""Corners: over what they are judged, the smallest cell that has one of its own, and their least strength."""
RETURNED_PX = 0.5
"""There and back again, a feature must end this near to where it started (half resolution)."""
ROW_PX = 1.0
"""So far from its row a feature may be found in the other camera (half resolution)."""
LEAST_D_PX = 1.0
"""What is further away than this says nothing about how far the cameras moved."""
AGREE_PX = 2.0
"""How far a feature may be from where RANSAC's motion puts it (full resolution)."""
DRAWS = 100
STEPS = 6
CAUCHY = 2.0
"""Residuals of this many sigmas count half."""
OUTLIER, MEDIAN_OF_3 = 16.3, 2.366
"""99.9 % and 50 % of a squared residual of three numbers."""
LENS_SHARE, LENS_RAD = 0.01, 2e-4
"""What lenses and rows that are slightly off do to a motion: share of its length (seen on KITTI), and turn."""
NEAREST_M = 0.1
CONVERGED = 1e-6
DRIFT_PX = 0.02
"""How much the disparities' offset may change within a frame."""
LARGEST_MPS2 = 15.0
"""No car on wheels speeds up or slows down faster."""
ACCELERATION_GAP_S = 0.5
"""Over longer gaps the velocity before tells nothing."""


class EgomotionSettings(BaseModel):
    """How the vehicle's own motion is measured."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    source: Literal["images", "recording"] = Field(
        "images", description="Who tells: the images, or the recording's own odometry."
    )
    features: int = Field(300, ge=30, le=5000, description="About how many corners are followed.")
    least_features: int = Field(20, ge=6, description="Fewer that agree say nothing.")
    least_share: float = Field(0.4, gt=0, le=1, description="Smallest share of the features that must agree.")
    sigma_px: float = Field(0.2, gt=0, description="Noise of a feature's u, v and d at full resolution.")
    offset_px: float = Field(0.2, gt=0, description="How far off all disparities may be (a turned camera).")
    longest_s: float = Field(1.0, gt=0, description="Over longer gaps nothing is measured.")


class _Motion(NamedTuple):
    """`T_now_before` of the car frame, how many pixels all disparities are too small, (7, 7) covariance of both."""

    T: FloatArray
    offset_px: float
    cov: FloatArray


class _Frame(NamedTuple):
    """What is kept of a frame: its images, its corners (n, 3) u, v, d at full resolution, and where it was taken."""

    t_ns: int
    left: Gray
    uvd: FloatArray
    T_odom_car: FloatArray | None


class Odometer:
    """Keeps the latest frame of a drive and measures how the cameras moved since.

    Parameters
    ----------
    rectification
        The twin cameras of all pairs.
    settings
        Evidence.
    """

    def __init__(self, rectification: Rectification, settings: EgomotionSettings | None = None) -> None:
        self.rectification = rectification
        self.settings = settings or EgomotionSettings()
        self._before: _Frame | None = None
        self._twist: FloatArray | None = None
        self._twist_t_ns = 0
        self._offset_px, self._offset_px2 = 0.0, self.settings.offset_px**2
        to_middle = pose(np.eye(3), np.array([rectification.baseline_m / 2, 0.0, 0.0]))
        self._T_left_car = pose(rectification.R_rect_left.T, np.zeros(3)) @ to_middle

    def __call__(self, pair: RectifiedPair, T_odom_left: FloatArray | None = None) -> EgoMotion | None:
        """Take the next pair in.

        Parameters
        ----------
        pair
            The images.
        T_odom_left
            As in `StereoPair`.

        Returns
        -------
        The motion, known or unknown with a reason. None where there is no motion to speak of: the first pair, and pairs
        whose time stamp is not after that of the pair before, which are passed over.
        """
        before = self._before
        if before is not None and before.t_ns - 1e9 * self.settings.longest_s <= pair.t_ns <= before.t_ns:
            return None
        left, right = half_images(pair)
        corners = spread_corners(left, self.settings.features, BLOCK_PX, CELL_PX, WINDOW_PX // 2 + 1, CONTRAST)
        T_odom_car = None if T_odom_left is None else T_odom_left @ self._T_left_car
        self._before = _Frame(pair.t_ns, left, _in_both(left, right, corners)[0], T_odom_car)
        if before is None or pair.t_ns <= before.t_ns:
            return None
        dt_s = (pair.t_ns - before.t_ns) / 1e9
        if dt_s > self.settings.longest_s:
            return EgoMotion.unknown(before.t_ns, pair.t_ns, f"no frame for {dt_s:.1f} s")
        then, now = self._followed(before, left, right, dt_s)
        if self.settings.source == "recording":
            found = self._recorded(before, self._before, then, now)
        else:
            found = self._measure(before, then, now, pair.t_ns)
        if isinstance(found, str):
            return EgoMotion.unknown(before.t_ns, pair.t_ns, found)
        return found

    def _followed(self, before: _Frame, left: Gray, right: Gray, dt_s: float) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) u, v, d of features in the frame before and in this one."""
        begin = ((before.uvd[:, :2] - 0.5) / 2).astype(np.float32)
        guess, levels = self._foreseen(before.uvd, begin, dt_s)
        there, good = _follow(before.left, left, begin, guess, levels)
        now, seen = _in_both(left, right, there[good], before.uvd[good, 2])
        return before.uvd[good][seen], now

    def _recorded(self, before: _Frame, latest: _Frame, then: FloatArray, now: FloatArray) -> EgoMotion | str:
        """Return the motion that the recording tells, as sure as a measured one can be, and what features add."""
        if before.T_odom_car is None or latest.T_odom_car is None:
            return "the recording does not say"
        T = inverse(latest.T_odom_car) @ before.T_odom_car
        self._move(T, (latest.t_ns - before.t_ns) / 1e9, latest.t_ns)
        offs = _compared(self.rectification, T, 0.0, then, now, self.settings.sigma_px)
        flow = Flow(now[offs.ahead], offs.residual[offs.ahead], offs.weight[offs.ahead])
        return EgoMotion(before.t_ns, latest.t_ns, T, _lens_error(T), flow=flow)

    def _move(self, T: FloatArray, dt_s: float, t_ns: int) -> None:
        """Remember how the vehicle moves."""
        self._twist, self._twist_t_ns = np.concatenate([rotvec_from_rotation(T[:3, :3]), T[:3, 3]]) / dt_s, t_ns

    def _measure(self, before: _Frame, then: FloatArray, now: FloatArray, t_ns: int) -> EgoMotion | str:
        s, dt_s = self.settings, (t_ns - before.t_ns) / 1e9
        if len(then) < s.least_features:
            return f"only {len(then)} features could be followed"
        T = _agreed(self.rectification, then, now)
        if T is None:
            return "no motion that the features agree on"
        start = _Motion(T, self._offset_px, np.diag([0.0] * 6 + [self._offset_px2 + DRIFT_PX**2]))
        motion, used, flow = _refined(self.rectification, start, then, now, s.sigma_px)
        count = int(used.sum())
        if count < max(s.least_features, s.least_share * len(then)):
            return f"only {count} of {len(then)} features agree on one motion"
        self._offset_px, self._offset_px2 = motion.offset_px, min(float(motion.cov[6, 6]), s.offset_px**2)
        T, cov = motion.T, motion.cov[:6, :6] + _lens_error(motion.T)
        jerked = self._jerked(T, cov, dt_s, t_ns)
        self._move(T, dt_s, t_ns)
        if jerked:
            return jerked
        return EgoMotion(before.t_ns, t_ns, T, cov, used=count, flow=flow)

    def _jerked(self, T: FloatArray, cov: FloatArray, dt_s: float, t_ns: int) -> str:
        """Return what is wrong with a motion that no vehicle makes after the one before; empty if nothing is."""
        gap_s = (t_ns - self._twist_t_ns) / 1e9
        if self._twist is None or gap_s > ACCELERATION_GAP_S:
            return ""
        change_mps2 = float(np.linalg.norm(T[:3, 3] / dt_s - self._twist[3:])) / gap_s
        slack_mps2 = 4 * float(np.sqrt(np.trace(cov[3:, 3:]))) / dt_s / gap_s
        if change_mps2 <= LARGEST_MPS2 + slack_mps2:
            return ""
        return f"it would be an acceleration of {change_mps2:.0f} m/s2"

    def _foreseen(self, uvd: FloatArray, points: Points, dt_s: float) -> tuple[Points, int]:
        """Return where points (n, 2) should be now if the vehicle moves on as it did, and levels to search."""
        if self._twist is None:
            return points.copy(), LEVELS
        T = pose(rotation_from_rotvec(self._twist[:3] * dt_s), self._twist[3:] * dt_s)
        there = image_from_car(self.rectification, transform(T, triangulate(self.rectification, uvd)))
        guess = ((there[:, :2] - 0.5) / 2).astype(np.float32)
        return np.where(np.isfinite(guess), guess, points), MORE_LEVELS


def _in_both(
    left: Gray, right: Gray, points: Points, d_px: FloatArray | None = None
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return (m, 3) u, v, d at full resolution of the points (n, 2) that were found in the right image, and which.

    `d_px` (n,), where known, is about how large their disparities are.
    """
    guess = points.copy()
    if d_px is not None:
        guess[:, 0] -= d_px.astype(np.float32) / 2
    there, good = _follow(left, right, points, guess, LEVELS if d_px is None else FEW_LEVELS)
    d = points[:, 0] - there[:, 0]
    good &= (np.abs(points[:, 1] - there[:, 1]) < ROW_PX) & (2 * d > LEAST_D_PX)
    # A half-resolution pixel is the mean of 2x2 full ones.
    full = np.stack([2 * points[:, 0] + 0.5, 2 * points[:, 1] + 0.5, 2 * d], -1).astype(float)
    return full[good], good


def _follow(here: Gray, there: Gray, points: Points, guess: Points, levels: int) -> tuple[Points, NDArray[np.bool_]]:
    """Return where points (n, 2) of one image are in another, and which of them can be trusted."""
    return follow(here, there, points, guess, Search(WINDOW_PX, levels, 0, TRIES, SETTLED_PX, RETURNED_PX))


def _agreed(rectification: Rectification, then: FloatArray, now: FloatArray) -> FloatArray | None:
    """Return the motion `T_now_before` of the car frame that most features agree on, by RANSAC; None if none is found.

    Parameters
    ----------
    rectification
        The twin cameras.
    then, now
        (n, 3) u, v, d of the features in both frames.
    """
    r = rectification
    K = np.array([[r.f_px, 0, r.cx_px], [0, r.f_px, r.cy_px], [0, 0, 1]])
    to_left = np.array([r.baseline_m / 2, 0.0, 0.0])
    points = triangulate(r, then) + to_left
    ok, rotvec, t, _ = cv2.solvePnPRansac(
        points, now[:, :2], K, None, iterationsCount=DRAWS, reprojectionError=AGREE_PX, flags=cv2.SOLVEPNP_P3P
    )
    if not ok or not (np.isfinite(rotvec).all() and np.isfinite(t).all()):
        return None
    shift = pose(np.eye(3), to_left)
    return inverse(shift) @ pose(rotation_from_rotvec(rotvec), t) @ shift


def _refined(
    rectification: Rectification, start: _Motion, then: FloatArray, now: FloatArray, sigma_px: float
) -> tuple[_Motion, NDArray[np.bool_], Flow]:
    """Return the motion after robust Gauss-Newton, which features agree with it, and how far off each is.

    Parameters
    ----------
    rectification
        The twin cameras.
    start
        A first motion; what is known of the disparities' offset beforehand.
    then, now
        (n, 3) u, v, d of the features in both frames.
    sigma_px
        Noise of each of these numbers.
    """
    T, offset_px = start.T, start.offset_px
    shape_then, shape_now = (_yaw_shape(rectification, uvd) for uvd in (then, now))
    prior = np.zeros((7, 7))
    prior[6, 6] = 1 / start.cov[6, 6]
    for _ in range(STEPS):
        at = _compared(rectification, T, offset_px, then, now, sigma_px)
        trust = at.ahead / (1 + at.squared / CAUCHY**2)
        by_offset = at.carried @ shape_then[..., None] - shape_now[..., None]
        J = np.concatenate([at.J @ -skew(at.moved), at.J, by_offset], 2)
        JW = J.swapaxes(1, 2) @ (at.weight * trust[:, None, None])
        normal = (JW @ J).sum(0) + prior
        pull = (JW @ at.residual[..., None]).sum(0)[:, 0] + prior[6] * (start.offset_px - offset_px)
        step = np.linalg.lstsq(normal, pull, rcond=None)[0]
        T, offset_px = pose(rotation_from_rotvec(step[:3]), step[3:6]) @ T, offset_px + float(step[6])
        if np.abs(step).max() < CONVERGED:
            break
    used = at.ahead & (at.squared < OUTLIER)
    # What the features scatter more than they should, the motion is less sure.
    excess = max(1.0, float(np.median(at.squared[used])) / MEDIAN_OF_3) if used.any() else 1.0
    ahead = at.ahead
    flow = Flow((now + offset_px * shape_now)[ahead], at.residual[ahead], at.weight[ahead])
    return _Motion(T, offset_px, np.linalg.pinv(normal) * excess), used, flow


class _Compared(NamedTuple):
    """Features (n) against a motion.

    Attributes
    ----------
    moved, ahead
        (n, 3) where they should be, car frame; (n,) whether that is before the cameras.
    J, carried
        (n, 3, 3) derivatives of their u, v, d by where they should be, and by their u, v, d before.
    weight, residual, squared
        (n, 3, 3) information, (n, 3) how far off they are, pixels, and (n,) the square of that in sigmas.
    """

    moved: FloatArray
    ahead: NDArray[np.bool_]
    J: FloatArray
    carried: FloatArray
    weight: FloatArray
    residual: FloatArray
    squared: FloatArray


def _compared(
    rectification: Rectification,
    T: FloatArray,
    offset_px: float,
    then: FloatArray,
    now: FloatArray,
    sigma_px: float,
) -> _Compared:
    """Compare features with the motion `T` if all disparities are too small by `offset_px`; see `_refined`."""
    shifted = then + offset_px * _yaw_shape(rectification, then)
    moved = triangulate(rectification, shifted) @ T[:3, :3].T + T[:3, 3]
    ahead = moved[:, 2] > NEAREST_M
    moved = np.where(ahead[:, None], moved, [0.0, 0.0, 1.0])
    J = image_jacobian(rectification, moved)
    carried = J @ (T[:3, :3] @ triangulate_jacobian(rectification, shifted))
    weight = np.linalg.inv(sigma_px**2 * (np.eye(3) + carried @ carried.swapaxes(1, 2)))
    residual = now - image_from_car(rectification, moved) + offset_px * _yaw_shape(rectification, now)
    squared = np.einsum("ni,nij,nj->n", residual, weight, residual)
    return _Compared(moved, ahead, J, carried, np.asarray(weight, float), residual, squared)


def _lens_error(T: FloatArray) -> FloatArray:
    """Return the (6, 6) covariance of what no number of features averages away."""
    sigma_m = LENS_SHARE * float(np.linalg.norm(T[:3, 3]))
    return np.diag([LENS_RAD**2] * 3 + [sigma_m**2] * 3)


def _yaw_shape(rectification: Rectification, uvd: FloatArray) -> FloatArray:
    """Return (n, 3) d(u, v, d) by the disparity's offset in the middle, if the right camera is turned about its y."""
    shape = np.zeros_like(uvd)
    shape[:, 2] = 1 + ((uvd[:, 0] - rectification.cx_px) / rectification.f_px) ** 2
    return shape
