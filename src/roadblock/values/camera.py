"""Cameras, the stereo rig, and its rectification: the geometry that does not change from frame to frame."""

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import RigError, ValueRefusedError
from roadblock.values.checks import FloatArray, finite, image_size, locked, positive, rigid_transform, rotation

Verdict = Literal["good", "usable", "refused"]
"""Of a calibration."""

Lens = Literal["pinhole", "brown_conrady", "kannala_brandt"]
COEFFICIENTS: dict[str, tuple[int, ...]] = {"pinhole": (0,), "brown_conrady": (5, 8), "kannala_brandt": (4,)}
"""How many distortion coefficients each lens model takes, in OpenCV's order
(Brown-Conrady k1 k2 p1 p2 k3 [k4 k5 k6], Kannala-Brandt k1 k2 k3 k4)."""

COEFFICIENT_NAMES: dict[tuple[str, int], tuple[str, ...]] = {
    ("pinhole", 0): (),
    ("brown_conrady", 5): ("k1", "k2", "p1", "p2", "k3"),
    ("brown_conrady", 8): ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
    ("kannala_brandt", 4): ("k1", "k2", "k3", "k4"),
}

LARGEST_COEFFICIENT = 1e30
"""No lens comes near it; beyond it the lens functions would overflow."""

BASELINE_RANGE_M = (0.005, 3.0)
"""What a pair of cameras on one vehicle can have; beyond it the unit is wrong."""


@dataclass(frozen=True, eq=False)
class Camera:
    """One camera: intrinsics and lens.

    Attributes
    ----------
    size_px
        (width, height) of the image the intrinsics belong to.
    fx_px, fy_px, cx_px, cy_px
        Focal lengths and principal point in pixels (f/dx, f/dy, q0, p0 of the paper's eqs. 1-2);
        (0, 0) is the centre of the top-left pixel.
    lens
        Lens model: "pinhole", "brown_conrady" or "kannala_brandt".
    distortion
        Its 0, 5 or 8, or 4 coefficients (see `COEFFICIENTS`), float64, read-only.

    Raises
    ------
    ValueRefusedError
        If a number is not finite, a length not positive, the size not whole or beyond what images can have, or the
        coefficients do not fit the lens.
    """

    size_px: tuple[int, int]
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    lens: Lens = "pinhole"
    distortion: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        object.__setattr__(self, "size_px", image_size("size_px", self.size_px))
        for name in ("fx_px", "fy_px"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("cx_px", "cy_px"):
            object.__setattr__(self, name, float(finite(name, getattr(self, name), ())))
        if self.lens not in get_args(Lens):
            raise ValueRefusedError(f"lens must be one of {', '.join(get_args(Lens))}, but got {self.lens!r}")
        k = finite("distortion", self.distortion, (-1,))
        count = len(k)
        if count not in COEFFICIENTS[self.lens]:
            allowed = " or ".join(map(str, COEFFICIENTS[self.lens]))
            raise ValueRefusedError(f"lens {self.lens} takes {allowed} coefficients, but got {count}")
        if (np.abs(k) > LARGEST_COEFFICIENT).any():
            raise ValueRefusedError(
                f"distortion must stay below {LARGEST_COEFFICIENT:g}, but got {np.abs(k).max():g}: calibrate again"
            )
        object.__setattr__(self, "distortion", k)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of its parameters in order: focal lengths, principal point, coefficients."""
        return ("fx_px", "fy_px", "cx_px", "cy_px", *COEFFICIENT_NAMES[self.lens, len(self.distortion)])

    @property
    def K(self) -> FloatArray:
        """Camera matrix, 3x3 (the paper's eqs. 2 and 5 multiplied out), in pixels."""
        return np.array([[self.fx_px, 0, self.cx_px], [0, self.fy_px, self.cy_px], [0, 0, 1]])


POSE_PARAMETERS = ("rx_rad", "ry_rad", "rz_rad", "tx_m", "ty_m", "tz_m")
"""The relative pose's parameters: a small turn `R_left_right <- exp([r]) R_left_right`, and the translation."""


def rig_parameters(left: Camera, right: Camera) -> tuple[str, ...]:
    """Return the names of a rig's parameters in their order: "left.fx_px", ..., "right.k1", ..., "tz_m"."""
    names = [f"{side}.{name}" for side, camera in (("left", left), ("right", right)) for name in camera.parameters]
    return (*names, *POSE_PARAMETERS)


LARGEST_ROUNDING = 1e-8
"""How far rounding may push a covariance's correlations off symmetry, and their eigenvalues below 0."""


@dataclass(frozen=True, eq=False)
class RigCovariance:
    """How sure a calibration is of the rig's parameters.

    Attributes
    ----------
    names
        As `rig_parameters` gives them.
    matrix
        (p, p) covariance, each entry in the units of its two names; rows of parameters that were held fixed are 0.

    Raises
    ------
    ValueRefusedError
        If the matrix is not of that size, not finite, not symmetric, or gives some direction a negative variance.
    """

    names: tuple[str, ...]
    matrix: FloatArray

    def __post_init__(self) -> None:
        count = len(self.names)
        matrix = finite("covariance", self.matrix, (count, count))
        sigma = np.sqrt(np.abs(matrix.diagonal()))
        with np.errstate(all="ignore"):
            correlation = np.where(matrix == 0, 0.0, matrix / np.outer(sigma, sigma))
            skew = np.abs(correlation - correlation.T) > LARGEST_ROUNDING
        if (matrix.diagonal() < 0).any() or skew.any():
            raise ValueRefusedError("covariance must be symmetric with variances >= 0: calibrate again")
        largest = np.abs(correlation).max(initial=0.0)
        if largest > 1 + LARGEST_ROUNDING or np.linalg.eigvalsh(correlation).min(initial=0.0) < -LARGEST_ROUNDING:
            raise ValueRefusedError("covariance must be positive semi-definite, but is not: calibrate again")
        object.__setattr__(self, "matrix", matrix)


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two cameras and how they sit to each other.

    Attributes
    ----------
    left, right
        The cameras, as seen by someone sitting in the vehicle.
    T_left_right
        4x4 pose of the right camera in the left camera's frame, metres: `p_left = T_left_right @ p_right`
        (the paper's eqs. 6-7, with R_s and T_s as its blocks).
    T_vehicle_car
        4x4 pose of the car frame (eq. 8) in the vehicle frame, metres, or None where no mounting is known:
        then the vehicle frame is the car frame re-axed (x forward, y left, z up).
    covariance
        How sure the calibration is of it; None where nobody said.
    verdict
        What the calibration said of itself; a "refused" one was written by force. None where nobody said.

    Raises
    ------
    RigError
        If the cameras are swapped, stand one above the other, differ in size, or the baseline cannot be
        one of a vehicle.
    ValueRefusedError
        If a transform is no rigid transform, the covariance one of other parameters, or the verdict none.
    """

    left: Camera
    right: Camera
    T_left_right: FloatArray
    T_vehicle_car: FloatArray | None = None
    covariance: RigCovariance | None = None
    verdict: Verdict | None = None

    def __post_init__(self) -> None:
        if self.verdict is not None and self.verdict not in get_args(Verdict):
            raise ValueRefusedError(
                f"verdict must be one of {', '.join(get_args(Verdict))}, but got {self.verdict!r:.40}"
            )
        if self.covariance is not None:
            _check_names(self.covariance.names, rig_parameters(self.left, self.right))
        T = rigid_transform("T_left_right", self.T_left_right)
        object.__setattr__(self, "T_left_right", T)
        if self.T_vehicle_car is not None:
            object.__setattr__(self, "T_vehicle_car", rigid_transform("T_vehicle_car", self.T_vehicle_car))
        if self.left.size_px != self.right.size_px:
            raise RigError(
                f"both cameras must have one image size, but left is {self.left.size_px} and right "
                f"{self.right.size_px}: calibrate both at the same resolution"
            )
        low, high = BASELINE_RANGE_M
        if not low <= self.baseline_m <= high:
            raise RigError(
                f"baseline is {self.baseline_m:.6g} m, but a vehicle's lies between {low} and {high} m: "
                "probably another unit than metres; say which with --unit (mm, cm, or metres per unit)"
            )
        x, y, _ = T[:3, 3]
        if abs(x) < 0.5 * self.baseline_m:
            raise RigError(
                f"the right camera sits at x={x:.3g}, y={y:.3g} m of the left one, but must sit beside it: "
                "rigs with one camera above or behind the other are not supported"
            )
        if x < 0:
            raise RigError(
                f"the right camera sits {-x:.3g} m to the LEFT of the left one: the cameras are swapped, or "
                "the baseline's sign is; exchange left and right (nothing was flipped)"
            )
        if T[2, 2] < 0.5:
            raise RigError("the cameras look more than 60 deg apart: they see no common scene")

    @property
    def baseline_m(self) -> float:
        """Distance between the optical centres, metres."""
        return math.hypot(*self.T_left_right[:3, 3])

    @property
    def is_rectified(self) -> bool:
        """Whether both cameras are already pinhole twins, row-aligned and parallel."""
        a, b = self.left, self.right
        same = (a.fx_px, a.fx_px, a.cx_px, a.cy_px) == (a.fy_px, b.fx_px, b.cx_px, b.cy_px)
        parallel = np.array_equal(self.T_left_right[:3, :3], np.eye(3))
        beside = not self.T_left_right[1:3, 3].any()
        return same and b.fy_px == b.fx_px and parallel and beside and a.lens == b.lens == "pinhole"


def _check_names(names: tuple[str, ...], expected: tuple[str, ...]) -> None:
    if names == expected:
        return
    both = zip((*names, "nothing"), (*expected, "nothing"), strict=False)
    i, (found, wanted) = next((i, pair) for i, pair in enumerate(both) if pair[0] != pair[1])
    raise ValueRefusedError(
        f"covariance must be of these cameras' {len(expected)} parameters, but number {i + 1} is {found:.40} where "
        f"{wanted} is expected: take the covariance of the same calibration"
    )


@dataclass(frozen=True, eq=False)
class Rectification:
    """The twin pinhole cameras behind a rectified pair, and the maps that make it.

    Attributes
    ----------
    f_px, cx_px, cy_px
        Focal length and principal point of both rectified cameras, pixels.
    baseline_m
        Their distance, metres.
    size_px
        (width, height) of the rectified images.
    R_rect_left, R_rect_right
        3x3 rotations, camera frame -> rectified frame.
    maps_left, maps_right
        (map_u, map_v) float32 of the rectified size, raw pixel positions to sample, NaN-free (far outside
        the image where the lens sees nothing); None where the images are already rectified.
    half_maps
        (left's map_u, map_v, right's map_u, map_v) likewise, straight to half the size (rounded down), whose pixel
        (u, v) sits on (2u + 0.5, 2v + 0.5); None where there are no maps.

    Raises
    ------
    ValueRefusedError
        If a number is not finite, a length not positive, a rotation none, or a map of another size or type.
    """

    f_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    size_px: tuple[int, int]
    R_rect_left: FloatArray = field(default_factory=lambda: np.eye(3))
    R_rect_right: FloatArray = field(default_factory=lambda: np.eye(3))
    maps_left: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
    maps_right: tuple[NDArray[np.float32], NDArray[np.float32]] | None = None
    half_maps: tuple[NDArray[np.float32], ...] | None = field(init=False, default=None)

    @property
    def numbers(self) -> FloatArray:
        """(4,) focal length and principal point, pixels, and baseline, metres: what kernels need of the cameras."""
        return np.array([self.f_px, self.cx_px, self.cy_px, self.baseline_m])

    def __post_init__(self) -> None:
        for name in ("f_px", "baseline_m"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        for name in ("cx_px", "cy_px"):
            object.__setattr__(self, name, float(finite(name, getattr(self, name), ())))
        object.__setattr__(self, "size_px", image_size("size_px", self.size_px))
        for name in ("R_rect_left", "R_rect_right"):
            object.__setattr__(self, name, rotation(name, getattr(self, name)))
        for name in ("maps_left", "maps_right"):
            maps = getattr(self, name)
            if maps is not None:
                if [(m.shape, m.dtype) for m in maps] != 2 * [(self.size_px[::-1], np.float32)]:
                    raise ValueRefusedError(
                        f"{name} must be two float32 arrays of shape {self.size_px[::-1]}, but got "
                        + ", ".join(f"{m.dtype} {m.shape}" for m in maps)
                    )
                object.__setattr__(self, name, tuple(map(locked, maps)))
        if self.maps_left is not None and self.maps_right is not None:
            object.__setattr__(self, "half_maps", tuple(_halved(m) for m in (*self.maps_left, *self.maps_right)))


def _halved(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the means of 2x2 blocks."""
    rows, columns = (n // 2 for n in values.shape)
    blocks = values[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2)
    return np.asarray(locked(blocks.mean(axis=(1, 3), dtype=np.float32)))
