"""Mounting: GroundPlanes of a drive and the way between its RectifiedPairs in, `T_vehicle_car` out.

The road tells camera height, pitch and roll; a straight drive tells yaw. Where the cameras sit in the vehicle, forward
and to the left, no picture shows.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from roadblock.errors import CalibrationError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, rotvec_from_rotation
from roadblock.geometry.stereo import triangulate
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import GroundPlane, Health

HEIGHT_RANGE_M = (0.1, 5.0)
"""Between a small robot's cameras and those on a truck's roof; beyond it the unit is wrong."""

LARGEST_SCATTER = 0.15
"""Of the height, from frame to frame: more is no mounting, but several, or no road."""

FLAT_RISE_M, FLAT_AT_M = 0.1, 20.0
"""A road that rises or falls by more at that distance is not flat: the near plane takes a share of the bend."""

OUTLIER, LEAST_SCATTER = 5.0, 2e-3
"""Frames further from the median than so many robust standard deviations are left out; these count at least 2 mm or
2 mrad. Few frames that hang together look more alike than they are, so less than that is no reason."""

SHARED_PX = 0.1
"""What sub-pixel matching leaves in the disparities of a road, the same in every frame: no mean makes it smaller.
Measured on rendered drives: up to 0.06 px at f = 1033 px, 0.06 to 0.11 px at f = 387 px."""

STEP_M = 0.3
"""So far the cameras move before their way is measured: less is drowned by noise."""

STRAIGHT_PER_M = 0.005
"""Curvature (radius 200 m) up to which a step counts as straight."""

AXLE_M, AXLE_SIGMA_M = 1.5, 1.5
"""How far the cameras sit ahead of the rear axle: in a curve they move aside by curvature times this."""

FEWEST_STEPS = 3
"""Straight steps that tell a yaw and its scatter."""

CORNERS, CORNER_QUALITY, CORNER_GAP_PX = 1500, 0.005, 7
"""Features looked for in each left image."""

FEWEST_POINTS, FEWEST_SHARE = 30, 0.4
"""Features, and share of all tracked ones, that must move as one for a step to count."""

THERE_AND_BACK_PX, ROW_PX, REPROJECTION_PX, LEAST_DISPARITY_PX = 0.5, 1.0, 1.0, 1.0
"""Features that do not come back, leave their row in the right image, do not fit the motion, or are too far are
no help."""


class Measured(NamedTuple):
    """A number and its standard deviation; NaN where unknown."""

    value: float
    sigma: float


UNKNOWN = Measured(float("nan"), float("nan"))


class Seen(NamedTuple):
    """The road as one frame shows it: the frame's number in the recording, and the plane."""

    frame: int
    ground: GroundPlane


class Step(NamedTuple):
    """The way between two frames: the later one's number, and the car frame's pose then in the car frame before."""

    frame: int
    T_before_now: FloatArray


@dataclass(frozen=True, eq=False)
class Mounting:
    """How a rig sits over the road.

    Attributes
    ----------
    T_vehicle_car
        4x4 pose of the car frame in the vehicle frame (x along the direction of travel, z at right angles to the road,
        z = 0 on it), metres. An unknown yaw is taken as 0.
    height_m
        Of the point halfway between the cameras, at right angles to the road, metres.
    pitch_rad, roll_rad
        As in `GroundPlane`: > 0 when the cameras look down, and when their left side is up.
    yaw_rad
        > 0 when the cameras look to the left of the direction of travel; NaN where unknown.
    climb_rad
        Angle of the direction of travel over the road: 0 but for errors of the rig or of the road; NaN where unknown.
    used
        Frames whose road was used.
    left_out
        Reason -> number of frames with a road that were left out for it.
    steps, straight_steps
        Measured ways between frames, and those used for the yaw.
    """

    T_vehicle_car: FloatArray
    height_m: Measured
    pitch_rad: Measured
    roll_rad: Measured
    yaw_rad: Measured
    climb_rad: Measured
    used: int
    left_out: Counter[str]
    steps: int
    straight_steps: int


def why_left_out(ground: GroundPlane | None, health: Health) -> str:
    """Return why a frame's road tells nothing about the mounting; "" where it does."""
    if ground is None:
        return "no road found"
    if health.state != "ok":
        return health.reasons[0].partition(":")[0] if health.reasons else health.state
    rise_m = ground.bend_per_m * FLAT_AT_M**2
    if abs(rise_m) > FLAT_RISE_M:
        return f"the road bends {'up' if rise_m > 0 else 'down'} ahead"
    return ""


def find_mounting(
    seen: Sequence[Seen],
    rectification: Rectification,
    steps: Sequence[Step] = (),
    *,
    in_time: bool = True,
    forward_m: float = 0.0,
    left_m: float = 0.0,
) -> Mounting:
    """Combine what the frames of a drive show of one mounting.

    Parameters
    ----------
    seen
        The road of each usable frame (see `why_left_out`), in order.
    rectification
        The twin cameras, for what matching errors that all frames share do to the road.
    steps
        The way between frames, from an `Odometer`; () for single pictures.
    in_time
        Whether the frames follow each other, so that neighbours are alike.
    forward_m, left_m
        Where the point halfway between the cameras sits in the vehicle frame.

    Returns
    -------
    The mounting. Its sigmas hold the scatter of the frames, their correlation in time, and `SHARED_PX`; not the errors
    of the rig itself. They are NaN for a single frame.

    Raises
    ------
    CalibrationError
        If there is no road, its height cannot be one of a vehicle's cameras, or differs too much from frame to frame.
    """
    if not seen:
        raise CalibrationError("no frame shows a flat road: record one in daylight, the cameras looking ahead")
    values = np.array([(s.ground.height_m, s.ground.pitch_rad, s.ground.roll_rad) for s in seen])
    kept = ~_is_outlier(values).any(1)
    number = np.array([s.frame for s in seen])[kept] if in_time else None
    _check_height(values[kept, 0])
    means = [mean_in_time(column, number) for column in values[kept].T]
    shared = _shared_sigmas(rectification, means[0].value, means[1].value)
    height, pitch, roll = (_widened(mean, sigma) for mean, sigma in zip(means, shared, strict=True))
    up = np.array([-np.tan(roll.value), -1.0, -np.tan(pitch.value)])
    up /= np.linalg.norm(up)
    way, climb, straight = _direction(steps, up)
    yaw, climb = _widened(way, shared[1]), _widened(climb, np.sqrt(2) * shared[1])  # features are matched as well
    R_level_car = np.stack(_level_axes(up))
    R_vehicle_level = rotation_from_rotvec([0.0, 0.0, np.nan_to_num(yaw.value)])
    return Mounting(
        pose(R_vehicle_level @ R_level_car, [forward_m, left_m, height.value]),
        *(height, pitch, roll, yaw, climb),
        used=int(kept.sum()),
        left_out=Counter({"far from all others": int((~kept).sum())} if not kept.all() else {}),
        steps=len(steps),
        straight_steps=straight,
    )


def _is_outlier(values: FloatArray) -> NDArray[np.bool_]:
    """Return which of `values` (n, k) lie far from the median of their column."""
    off = np.abs(values - np.median(values, 0))
    scatter = np.maximum(1.4826 * np.median(off, 0), LEAST_SCATTER)
    return np.asarray(off > OUTLIER * scatter) & (len(values) > 4)


def _shared_sigmas(r: Rectification, height_m: float, pitch_rad: float) -> tuple[float, float, float]:
    """Return what `SHARED_PX` does to height, pitch and roll: d = f B / h (v / f - tan pitch - ...) of a plane, moved.

    All disparities moved alike turn the plane; moved in proportion to themselves, by that much where the road is
    nearest, they raise it.
    """
    turned = SHARED_PX * height_m / (r.f_px * r.baseline_m)
    steepest = max((r.size_px[1] - r.cy_px) / r.f_px + np.tan(pitch_rad), 1 / r.f_px)
    return turned / steepest * height_m, turned, turned


def _widened(mean: Measured, sigma: float) -> Measured:
    return Measured(mean.value, float(np.hypot(mean.sigma, sigma)))


def _check_height(heights_m: FloatArray) -> None:
    height, scatter = float(heights_m.mean()), float(heights_m.std())
    low, high = HEIGHT_RANGE_M
    if not low <= height <= high:
        raise CalibrationError(
            f"the cameras would be {height:.3g} m over the road, but a vehicle's are {low:g} to {high:g} m: "
            "probably the rig's baseline has another unit; say which with --unit"
        )
    if scatter > LARGEST_SCATTER * height:
        raise CalibrationError(
            f"the road lies {heights_m.min():.2f} to {heights_m.max():.2f} m below the cameras, other in each frame: "
            "this is no flat road, or the cameras moved; use a part of the drive with free road ahead"
        )


def mean_in_time(values: FloatArray, frames: NDArray[np.int64] | None = None) -> Measured:
    """Return the mean of values that may hang together in time, with the mean's standard deviation.

    Parameters
    ----------
    values
        (n,).
    frames
        (n,) increasing frame numbers; None where the values are independent.

    Returns
    -------
    The sigma counts n (1 - rho) / (1 + rho) independent values for the correlation rho of neighbours (a first-order
    autoregression; Kendall's correction of its bias in short series added), and is widened as Student's t is, so that
    +- sigma holds 68 % for few values as well. It is NaN for a single value; both are NaN for none.
    """
    n = len(values)
    if n < 2:
        return Measured(float(values[0]), float("nan")) if n else UNKNOWN
    off = values - values.mean()
    variance = float(off @ off) / (n - 1)
    rho = 0.0
    if frames is not None and variance > 0:
        follows = np.flatnonzero(np.diff(frames) == np.diff(frames).min())
        seen = float((off[follows] * off[follows + 1]).mean()) / variance
        rho = float(np.clip(seen + (1 + 4 * max(seen, 0.0)) / n, 0.0, (n - 1) / (n + 1)))
    independent = n * (1 - rho) / (1 + rho)
    widened = student.ppf(0.8413, max(independent - 1, 1.0))
    return Measured(float(values.mean()), float(np.sqrt(variance / independent) * widened))


def _level_axes(up: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return forward, left and up along the road, in the car frame: forward is where the cameras look."""
    forward = np.array([0.0, 0.0, 1.0]) - up[2] * up
    forward /= np.linalg.norm(forward)
    return forward, np.cross(up, forward), up


def _direction(steps: Sequence[Step], up: FloatArray) -> tuple[Measured, Measured, int]:
    """Return yaw and climb of the direction of travel, and how many straight steps told them."""
    forward, left, _ = _level_axes(up)
    rows = []
    for frame, T_before_now in steps:
        T = T_before_now if T_before_now[:3, 3] @ forward > 0 else inverse(T_before_now)  # backwards is forwards
        rotvec, length = rotvec_from_rotation(T[:3, :3]), float(np.linalg.norm(T[:3, 3]))
        # The chord of an arc lies along the heading half way.
        way = rotation_from_rotvec(-rotvec / 2) @ T[:3, 3] / length
        aside = np.arctan2(way @ left, way @ forward)
        rows.append((frame, -aside, np.arcsin(np.clip(way @ up, -1, 1)), rotvec @ up / length))
    frame_of, yaw, climb, curvature = np.array(rows).reshape(-1, 4).T
    straight = np.abs(curvature) <= STRAIGHT_PER_M
    yaw += AXLE_M * curvature
    kept = np.flatnonzero(straight)
    if len(kept):
        kept = kept[~_is_outlier(np.stack([yaw, climb], -1)[kept]).any(1)]
    if len(kept) < FEWEST_STEPS:
        return UNKNOWN, UNKNOWN, int(straight.sum())
    frames = frame_of[kept].astype(np.int64)
    found = mean_in_time(yaw[kept], frames)
    slipped = _widened(found, AXLE_SIGMA_M * float(curvature[kept].mean()))
    return slipped, mean_in_time(climb[kept], frames), len(kept)


@dataclass
class Odometer:
    """Measures the way from frame to frame; remembers the pair where the last step began.

    Attributes
    ----------
    lost
        How often the view changed so much that nothing could be followed.
    """

    lost: int = 0
    _before: RectifiedPair | None = field(default=None, repr=False)

    def add(self, pair: RectifiedPair) -> Step | None:
        """Take the next pair; return the way since the last step began where it is `STEP_M` long, else None."""
        before, self._before = self._before, self._before or pair
        if before is None:
            return None
        T = travel(before, pair)
        if T is None:
            self.lost += 1
            self._before = pair
            return None
        if np.linalg.norm(T[:3, 3]) < STEP_M:
            return None
        self._before = pair
        return Step(pair.index, T)


def travel(before: RectifiedPair, now: RectifiedPair) -> FloatArray | None:
    """Return how the cameras moved: the car frame's pose now in the car frame before, 4x4, metres.

    Features of the left image are followed into its right partner, which gives their places, and into the left image
    now; the pose that most of them agree on explains these (perspective-n-point within RANSAC, then least squares).

    Returns
    -------
    None where too few features can be followed, or agree.
    """
    r = before.rectification
    left, right, later = (_gray8(image) for image in (before.left, before.right, now.left))
    corners: Any = cv2.goodFeaturesToTrack(left, CORNERS, CORNER_QUALITY, CORNER_GAP_PX)
    if corners is None:
        return None
    start: NDArray[np.float32] = np.asarray(corners, np.float32).reshape(-1, 2)
    partner, end = _follow(left, right, start, levels=5), _follow(left, later, start, levels=4)
    d_px, row_px = (start - partner).T
    with np.errstate(invalid="ignore"):
        usable = (d_px > LEAST_DISPARITY_PX) & (np.abs(row_px) < ROW_PX) & np.isfinite(end).all(1)
    points = triangulate(r, np.c_[start, d_px][usable])
    return _solve(points, end[usable], r)


def _solve(points: FloatArray, pixels: FloatArray, r: Rectification) -> FloatArray | None:
    """Return the pose in which the left camera sees car-frame points (n, 3) at pixels (n, 2); None without one."""
    if len(points) < FEWEST_POINTS:
        return None
    T_left_car = pose(np.eye(3), [r.baseline_m / 2, 0.0, 0.0])
    K = np.array([[r.f_px, 0, r.cx_px], [0, r.f_px, r.cy_px], [0, 0, 1]])
    in_left = points + T_left_car[:3, 3]
    done, rotvec, t, inliers = cv2.solvePnPRansac(
        in_left, pixels, K, None, iterationsCount=300, reprojectionError=REPROJECTION_PX, confidence=0.999
    )
    if not done or len(inliers) < max(FEWEST_POINTS, FEWEST_SHARE * len(points)):
        return None
    on = inliers.ravel()
    rotvec, t = cv2.solvePnPRefineLM(in_left[on], pixels[on], K, None, rotvec, t)
    T_now_before = pose(rotation_from_rotvec(rotvec), t)
    return inverse(T_left_car) @ inverse(T_now_before) @ T_left_car


def _follow(a: NDArray[np.uint8], b: NDArray[np.uint8], start: NDArray[np.float32], levels: int) -> FloatArray:
    """Return where pixels (n, 2) of image a are in b; NaN where the way back leads elsewhere."""
    found, there, _ = cv2.calcOpticalFlowPyrLK(a, b, start, start.copy(), maxLevel=levels)
    back, again, _ = cv2.calcOpticalFlowPyrLK(b, a, found, start.copy(), maxLevel=levels)
    same = np.linalg.norm(np.asarray(back) - start, axis=1) < THERE_AND_BACK_PX
    sure = same & (np.ravel(there) == 1) & (np.ravel(again) == 1)
    return np.where(sure[:, None], found, np.nan).astype(np.float64)


def _gray8(image: Image) -> NDArray[np.uint8]:
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    if gray.dtype == np.uint16:
        gray = gray.astype(np.float32) * (255 / max(int(gray.max()), 1))
    return np.ascontiguousarray(gray, np.uint8)
