"""Checks that values make of themselves on construction. All cost O(1) in the image size."""

import math
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from roadblock.errors import ValueRefusedError

FloatArray = NDArray[np.float64]
Value = TypeVar("Value")

LARGEST_IMAGE_PX = 32766
"""Longest side of an image: what remapping can address."""


def locked(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view of `array`; the caller's own array stays as it is."""
    view = array.view()
    view.flags.writeable = False
    return view


def unchecked(kind: type[Value], **fields: Any) -> Value:
    """Return a value of fields that its maker has checked, those of many values at once; the others must have defaults.

    To check and lock each value alone costs as much as to measure it.
    """
    made = object.__new__(kind)
    object.__setattr__(made, "__dict__", fields)  # frozen, too
    return made


def numbers(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return `value` as a read-only float64 array of its own, of `shape` (-1: any length); NaN is allowed.

    Raises
    ------
    ValueRefusedError
        If it is not made of real numbers (text, booleans and None are none), or has another shape.
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.shape == shape:  # the usual case, at once
        own = value.copy()
        own.flags.writeable = False
        return own
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal length
        array = np.asarray(None)
    if array.dtype.kind not in "iuf":
        found = " ".join(repr(value).split())
        raise ValueRefusedError(f"{name} must be numbers of shape {shape}, but got {found:.60}")
    if array.shape != shape and (
        len(array.shape) != len(shape) or any(want not in (-1, n) for want, n in zip(shape, array.shape, strict=True))
    ):
        raise ValueRefusedError(f"{name} must have shape {shape}, but got {array.shape}")
    own = np.array(array, dtype=np.float64)
    own.flags.writeable = False
    return own


def finite(name: str, value: ArrayLike, shape: tuple[int, ...]) -> FloatArray:
    """Return `value` as `numbers` does, all finite.

    Raises
    ------
    ValueRefusedError
        If it is not numeric, has another shape, or holds NaN or infinity.
    """
    array = numbers(name, value, shape)
    if not np.isfinite(array).all():
        raise ValueRefusedError(f"{name} must be finite, but got {array.tolist()!r:.80}")
    return array


def positive(name: str, value: float) -> float:
    """Return `value` as a float if it is finite and > 0.

    Raises
    ------
    ValueRefusedError
        If it is not.
    """
    if type(value) is not float or not math.isfinite(value):
        value = float(finite(name, value, ()))
    if value <= 0:
        raise ValueRefusedError(f"{name} must be > 0, but got {value:g}")
    return value


def image_size(name: str, value: ArrayLike) -> tuple[int, int]:
    """Return (width, height) as two ints from 1 to `LARGEST_IMAGE_PX`.

    Raises
    ------
    ValueRefusedError
        If they are not.
    """
    size = finite(name, value, (2,))
    if (size < 1).any() or (size > LARGEST_IMAGE_PX).any() or (size != np.floor(size)).any():
        found = " x ".join(f"{n:g}" for n in size)
        raise ValueRefusedError(f"{name} must be two whole numbers from 1 to {LARGEST_IMAGE_PX}, but got {found}")
    return int(size[0]), int(size[1])


def rotation(name: str, value: ArrayLike) -> FloatArray:
    """Return a 3x3 rotation, orthonormal and right-handed to 1e-6.

    Raises
    ------
    ValueRefusedError
        If it is none.
    """
    R = finite(name, value, (3, 3))
    with np.errstate(all="ignore"):
        off = float(np.abs(R.T @ R - np.eye(3)).max())
    if not off <= 1e-6:
        raise ValueRefusedError(
            f"{name} must hold an orthonormal rotation (to 1e-6), but R^T R is off identity by {off:.2g}"
        )
    if np.linalg.det(R) < 0:
        raise ValueRefusedError(f"{name} must hold a rotation, but got a mirrored one (determinant -1)")
    return R


def rigid_transform(name: str, value: ArrayLike) -> FloatArray:
    """Return a 4x4 rigid transform: rotation orthonormal and right-handed to 1e-6, last row 0 0 0 1.

    Raises
    ------
    ValueRefusedError
        If it is none.
    """
    T = finite(name, value, (4, 4))
    rotation(name, T[:3, :3])
    if not np.array_equal(T[3], [0, 0, 0, 1]):
        raise ValueRefusedError(f"{name} must end in the row 0 0 0 1, but got {T[3].tolist()}")
    return T
