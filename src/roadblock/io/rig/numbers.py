"""Numbers of rig files, checked, and the cameras and poses they make."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from roadblock.errors import RigError, ValueRefusedError
from roadblock.geometry.pose import pose
from roadblock.values.camera import COEFFICIENTS, Camera, Lens
from roadblock.values.checks import FloatArray, finite

ROUNDING = 1e-4
"""How far a rotation printed with few digits may be off orthonormal; beyond it, it is no rotation."""


def numbers(name: str, value: Any, shape: tuple[int, ...]) -> FloatArray:
    """Return text, numbers or nested lists of them as float64 of `shape`; -1 in `shape` stands for any length.

    Raises
    ------
    ValueRefusedError
        If something is no number, not finite, or the shape is another.
    """
    try:
        array = np.array(value).astype(np.float64)
    except (TypeError, ValueError) as error:
        raise ValueRefusedError(f"{name} must be numbers, but got {value!r:.60}") from error
    wanted = tuple(have if want < 0 else want for want, have in zip(shape, array.shape, strict=False))
    if len(shape) != array.ndim or array.shape != wanted:
        words = "x".join("n" if n < 0 else str(n) for n in shape) or "a single number"
        have = "x".join(map(str, array.shape)) or "a single number"
        raise ValueRefusedError(f"{name} must be {words} numbers, but got {have}: {value!r:.60}")
    return finite(name, array, wanted)


def number(name: str, value: Any) -> float:
    """Return one finite number.

    Raises
    ------
    ValueRefusedError
        If it is none.
    """
    return float(numbers(name, value, ()))


def size(name: str, value: ArrayLike | Sequence[Any]) -> tuple[int, int]:
    """Return (width, height), whole and at least 1.

    Raises
    ------
    ValueRefusedError
        If it is none.
    """
    pair = numbers(name, value, (2,))
    if (pair < 1).any() or (pair != np.floor(pair)).any():
        raise ValueRefusedError(f"{name} must be width and height, whole and >= 1, but got {pair.tolist()}")
    return int(pair[0]), int(pair[1])


def by(size_px: tuple[int, int]) -> str:
    """Return a size as people write it: 640x480."""
    return f"{size_px[0]}x{size_px[1]}"


def camera(size_px: tuple[int, int], K: FloatArray, lens: Lens, coefficients: ArrayLike, where: str = "") -> Camera:
    """Return the camera of a 3x3 matrix in pixels and its distortion.

    Brown-Conrady coefficients in OpenCV's order are taken as 4, 5, 8, or 12 and 14 whose surplus is 0; where all of
    them are 0 the lens is a pinhole.

    Raises
    ------
    RigError
        If K has skew or is no camera matrix, or the coefficients do not fit the lens.
    ValueRefusedError
        If a number cannot be true.
    """
    fx, skew, cx, zero, fy, cy = K[:2].ravel()
    if skew or zero or not np.array_equal(K[2], [0, 0, 1]):
        raise RigError(f"{where}the camera matrix must be [fx 0 cx; 0 fy cy; 0 0 1] (no skew), but got {K.tolist()}")
    lens, kept = _coefficients(lens, np.ravel(np.asarray(coefficients, float)), where)
    return Camera(size_px, fx, fy, cx, cy, lens, kept)


def _coefficients(lens: Lens, d: FloatArray, where: str) -> tuple[Lens, FloatArray]:
    if lens != "brown_conrady":
        if len(d) not in COEFFICIENTS[lens]:
            raise RigError(f"{where}lens {lens} takes {COEFFICIENTS[lens][0]} coefficients, but got {len(d)}")
        return lens, d
    if not d.any():
        return "pinhole", np.zeros(0)
    if len(d) not in (4, 5, 8, 12, 14):
        raise RigError(f"{where}Brown-Conrady lenses take 4, 5 or 8 coefficients, but got {len(d)}")
    if d[8:].any():
        raise RigError(f"{where}thin-prism and tilted-sensor coefficients are not supported: calibrate with 5 or 8")
    return lens, np.r_[d, 0.0] if len(d) == 4 else d[:8]


def rotation(name: str, R: FloatArray) -> FloatArray:
    """Return the rotation nearest to a 3x3 matrix that was printed with few digits.

    Raises
    ------
    ValueRefusedError
        If it is off a rotation by more than `ROUNDING`.
    """
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if off > ROUNDING:
        raise ValueRefusedError(
            f"{name} must be a rotation (orthonormal to {ROUNDING:g}), but R^T R is off identity by {off:.2g}"
        )
    if np.linalg.det(R) < 0:
        raise ValueRefusedError(f"{name} must be a rotation, but is a mirrored one (determinant -1)")
    U, _, Vt = np.linalg.svd(R)
    return np.asarray(U @ Vt)


def rigid(name: str, T: FloatArray, unit_m: float) -> FloatArray:
    """Return a 4x4 pose with its rotation made exact and its translation in metres.

    Raises
    ------
    ValueRefusedError
        If it is no pose.
    """
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        raise ValueRefusedError(f"{name} must end in the row 0 0 0 1, but got {T[3].tolist()}")
    return pose(rotation(name, T[:3, :3]), unit_m * T[:3, 3])


def digits(value: float) -> str:
    """Return a number so that every YAML reader gets it back exactly (`1e-05` would be text to YAML 1.1)."""
    text = repr(float(value))
    return text.replace("e", ".0e") if "e" in text and "." not in text else text


def listed(values: ArrayLike) -> str:
    """Return numbers (n,) as a YAML list in one line."""
    return "[" + ", ".join(digits(value) for value in np.ravel(np.asarray(values, float))) + "]"
