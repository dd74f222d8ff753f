"""What one moment brings: the image pair, raw and rectified, and the disparity map."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray, finite, locked, rigid_transform

Gray = NDArray[np.uint8]
Image = NDArray[Any]
"""(height, width) grey or (height, width, 3) RGB; uint8 or uint16."""

Window = tuple[slice, slice]
"""Which rows and columns of an image."""
WHOLE: Window = (slice(None), slice(None))


def check_pair(left: Image, right: Image, what: str) -> tuple[Image, Image]:
    """Return both images read-only if they are a pair: same shape and dtype, grey or RGB, 8 or 16 bit.

    Raises
    ------
    ValueRefusedError
        If they are not.
    """
    for side, image in (("left", left), ("right", right)):
        if image.dtype not in (np.uint8, np.uint16):
            raise ValueRefusedError(f"{what}: {side} image must be 8 or 16 bit, but got {image.dtype}")
        if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3) or image.size == 0:
            raise ValueRefusedError(f"{what}: {side} image must be grey or RGB, but has shape {image.shape}")
    if left.shape != right.shape or left.dtype != right.dtype:
        raise ValueRefusedError(
            f"{what}: left image is {left.shape} {left.dtype}, right is {right.shape} {right.dtype}, "
            "but both must be alike"
        )
    return locked(left), locked(right)


@dataclass(frozen=True, eq=False)
class StereoPair:
    """Two images of one moment, as the cameras gave them.

    Attributes
    ----------
    left, right
        `Image`s of one shape and dtype, RGB where coloured.
    index
        Position in the source, from 0.
    name
        The source's own name of the frame ("000002").
    t_ns
        Moment of exposure of the left image, ns since the epoch (or since the start of a video); 0 for single
        frames, whose moment is unknown.
    T_odom_left
        (4, 4) where the recording says the left camera was, in a frame that stays; None where it says nothing.

    Raises
    ------
    ValueRefusedError
        If the images are no pair (see `check_pair`), or the pose is no rigid transform.
    """

    left: Image
    right: Image
    index: int = 0
    name: str = "0"
    t_ns: int = 0
    T_odom_left: FloatArray | None = None

    def __post_init__(self) -> None:
        left, right = check_pair(self.left, self.right, f"frame {self.name}")
        object.__setattr__(self, "left", left)
        object.__setattr__(self, "right", right)
        if self.T_odom_left is not None:
            object.__setattr__(self, "T_odom_left", rigid_transform("T_odom_left", self.T_odom_left))


class RectifiedPair:
    """A pair whose rows are epipolar lines. A type of its own, so that raw images cannot reach a matcher.

    Attributes
    ----------
    left, right
        Rectified `Image`s, read-only.
    half
        (left, right) grey 8 bit images of half the size, whose pixels are means of 2x2 full ones; None if nobody
        made them. What looks at half the resolution only never pays for the full one: see `deferred`.
    raw
        (left, right) grey 8 bit images that the rectification's maps sample; None where nobody has them.
    rectification
        The twin cameras they belong to.
    index, name, t_ns
        As in `StereoPair`.

    Raises
    ------
    ValueRefusedError
        If the images are no pair, or not of the rectification's size.
    """

    def __init__(
        self, left: Image, right: Image, rectification: Rectification, index: int = 0, name: str = "0", t_ns: int = 0
    ) -> None:
        left, right = check_pair(left, right, f"frame {name}")
        width, height = rectification.size_px
        if left.shape[:2] != (height, width):
            raise ValueRefusedError(
                f"frame {name}: images are {left.shape[1]}x{left.shape[0]}, but the rig is for {width}x{height}"
            )
        self._part: Callable[[Window], Image] = lambda window: left[window]
        self._left, self._right = cache(lambda: left), cache(lambda: right)
        self._left_colors = cache(lambda width_px, height_px: _middles(self._part, width_px, height_px))
        self.half: tuple[Gray, Gray] | None = None
        self.raw: tuple[Gray, Gray] | None = None
        self.rectification, self.index, self.name, self.t_ns = rectification, index, name, t_ns

    @classmethod
    def deferred(
        cls,
        left: Callable[[Window], Image],
        right: Callable[[Window], Image],
        half: tuple[Gray, Gray],
        raw: tuple[Gray, Gray] | None,
        rectification: Rectification,
        index: int = 0,
        name: str = "0",
        t_ns: int = 0,
    ) -> Self:
        """Return a pair whose images are made by `left` and `right` when first looked at, as far as asked for."""
        pair = cls.__new__(cls)
        pair._part = left
        pair._left, pair._right = cache(lambda: locked(left(WHOLE))), cache(lambda: locked(right(WHOLE)))
        pair._left_colors = cache(lambda width_px, height_px: _middles(left, width_px, height_px))
        pair.half, pair.raw = half, raw
        pair.rectification, pair.index, pair.name, pair.t_ns = rectification, index, name, t_ns
        return pair

    @property
    def left(self) -> Image:
        """The rectified left image."""
        return self._left()

    def left_colors(self, cell_px: int, cell_height_px: int) -> Image | None:
        """Return (rows, columns, 3) pixels of `left`, one in the middle of each cell, without the cost of the others.

        Cells count from the image's corner; a last one that holds no middle is left out. None where `left` is grey.
        """
        return self._left_colors(cell_px, cell_height_px)

    @property
    def right(self) -> Image:
        """The rectified right image."""
        return self._right()


def _middles(part: Callable[[Window], Image], cell_px: int, cell_height_px: int) -> Image | None:
    """Return the pixels in the middle of cells; None where they are grey."""
    if part((slice(1), slice(1))).ndim == 2:
        return None
    window = slice(cell_height_px // 2, None, cell_height_px), slice(cell_px // 2, None, cell_px)
    return locked(np.ascontiguousarray(part(window)))


@dataclass(frozen=True, eq=False)
class DisparityMap:
    """Disparities of the rectified left image, on its pixels or on a grid of cells.

    Attributes
    ----------
    d_px
        (rows, columns) float32, `d = u_left - u_right >= 0` in full-resolution pixels; NaN where unknown.
    sigma_px
        One standard deviation of a single disparity, pixels.
    cell_px
        Width of the cell one value stands for; 1 for a dense map.
    cell_height_px
        Its height; 0 stands for a square cell. Cell (row, column) is centred on pixel
        `(cell_px * column + (cell_px - 1) / 2, cell_height_px * row + (cell_height_px - 1) / 2)`.

    Raises
    ------
    ValueRefusedError
        If `d_px` is no 2-D float32 array, `sigma_px` negative or not finite, or a cell's side no whole number >= 1.
    """

    d_px: NDArray[np.float32]
    sigma_px: float
    cell_px: int = 1
    cell_height_px: int = 0

    def __post_init__(self) -> None:
        if self.d_px.ndim != 2 or self.d_px.dtype != np.float32:
            raise ValueRefusedError(f"d_px must be a 2-D float32 array, but got {self.d_px.ndim}-D {self.d_px.dtype}")
        if finite("sigma_px", self.sigma_px, ()) < 0:
            raise ValueRefusedError(f"sigma_px must be >= 0, but got {self.sigma_px}")
        object.__setattr__(self, "cell_height_px", self.cell_height_px or self.cell_px)
        for name in ("cell_px", "cell_height_px"):
            side = getattr(self, name)
            if not (side >= 1 and side % 1 == 0):
                raise ValueRefusedError(f"{name} must be a whole number >= 1, but got {side}")
        object.__setattr__(self, "d_px", locked(self.d_px))

    @property
    def uvd_px(self) -> FloatArray:
        """(rows, columns, 3) column and row of each cell's centre and its disparity, pixels; NaN where unknown."""
        rows, columns = self.d_px.shape
        w, h = self.cell_px, self.cell_height_px
        u, v = np.meshgrid(np.arange(columns) * w + (w - 1) / 2, np.arange(rows) * h + (h - 1) / 2)
        return np.stack([u, v, self.d_px], -1)
