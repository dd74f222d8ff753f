"""Checks that values make of themselves on construction. All cost O(1) in the image size."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadblock.errors import ValueRefusedError

FloatArray = NDArray[np.float64]


def locked(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of `array`; the caller's own array stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


def finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return `value` as a read-only float64 array of `shape`, all finite.

    Raises
    ------
    ValueRefusedError
        If it is not numeric, has another shape, or holds NaN or infinity.
    """
    try:
        array = np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueRefusedError(f"{name} must be numbers of shape {shape}, but got {value!r:.60}") from error
    if array.shape != shape:
        raise ValueRefusedError(f"{name} must have shape {shape}, but got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueRefusedError(f"{name} must be finite, but got {array.tolist()!r:.80}")
    return locked(array)


def positive(name: str, value: float) -> float:
    """Return `value` as a float if it is finite and > 0.

    Raises
    ------
    ValueRefusedError
        If it is not.
    """
    number = float(finite(name, value, ()))
    if number <= 0:
        raise ValueRefusedError(f"{name} must be > 0, but got {number:g}")
    return number


def rigid_transform(name: str, value: ArrayLike) -> FloatArray:
    """Return a 4x4 rigid transform: rotation orthonormal and right-handed to 1e-6, last row 0 0 0 1.

    Raises
    ------
    ValueRefusedError
        If it is none.
    """
    T = finite(name, value, (4, 4))
    R = T[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if off > 1e-6:
        raise ValueRefusedError(
            f"{name} must hold an orthonormal rotation (to 1e-6), but R^T R is off identity by {off:.2g}"
        )
    if np.linalg.det(R) < 0:
        raise ValueRefusedError(f"{name} must hold a rotation, but got a mirrored one (determinant -1)")
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        raise ValueRefusedError(f"{name} must end in the row 0 0 0 1, but got {T[3].tolist()}")
    return T
