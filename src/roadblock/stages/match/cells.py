"""Match on a grid of cells: two half-resolution grey images in, CellDisparities out. No map of full size anywhere."""

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from roadblock.errors import ValueRefusedError
from roadblock.kernels.compiled import cells as kernels
from roadblock.kernels.reference.cells import CELL_ROWS, TOP
from roadblock.values.frame import Gray

NOISIEST = 3
"""Noise counts up to here: what has more texture everywhere is textured, not noisy."""


class CellSettings(BaseModel):
    """How disparities of cells are found."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    cell_width_px: Literal[4, 8] = Field(4, description="Width of a cell in full-resolution px; the height is 4.")
    disparities: Literal[64, 128, 256] = Field(128, description="Search range in full-resolution px.")
    p1: int = Field(5, ge=0, le=127, description="Price of a change of disparity by 2 px from cell to cell.")
    p2: int = Field(20, ge=0, le=127, description="Price of a larger change.")
    tolerance: int = Field(2, ge=0, le=255, description="The right view may prefer another cell by this much.")
    margin: int = Field(12, ge=0, le=255, description="Cells whose winner beats the second best by less are unknown.")
    texture: int = Field(4, ge=0, le=255, description="Where this (4 = a grey level) is not reached, nothing is seen.")
    quiet: int = Field(5, ge=0, le=255, description="Images whose noise has more texture than this need ...")
    noise_margin: int = Field(8, ge=0, le=255, description="... so much more margin for each level above it.")
    dark: int = Field(60, ge=0, le=255, description="In images of a mean grey below this (nights) ...")
    noise_least_px: float = Field(3.3, ge=0, description="... less disparity than this for each level tells nothing.")
    speckle_px2: int = Field(200, ge=0, description="Islands of less area, in full-resolution px, are dropped.")
    speckle_step_px: float = Field(4.0, ge=0, description="A larger step of disparity ends an island.")
    smooth_step_px: float = Field(
        1.5, ge=0, description="Neighbours on one surface differ by no more, and share a mean."
    )


class CellDisparities(NamedTuple):
    """What the matcher knows of each cell. The arrays belong to the matcher, and live until its next call.

    Cell (r, c) covers rows ``r * cell_height_px`` and columns ``c * cell_width_px`` onwards of the rectified image.
    """

    d_px: NDArray[np.float32]
    """(rows, columns) disparity in full-resolution pixels; NaN unknown."""
    margin: NDArray[np.uint8]
    """(rows, columns) second-best less best summed cost; the second best is at least 4 px away."""
    texture: NDArray[np.uint8]
    """(rows, columns) four times the mean horizontal step, in grey levels of the half-resolution left image."""
    cell_width_px: int
    cell_height_px: int


class CellMatcher:
    """Semi-global matching on cells, with every buffer kept from call to call.

    Parameters
    ----------
    settings
        See `CellSettings`.
    """

    def __init__(self, settings: CellSettings) -> None:
        self.settings = settings
        self._shape = (-1, -1)

    def __call__(self, left: Gray, right: Gray) -> CellDisparities:
        """Match a pair.

        Parameters
        ----------
        left, right
            (rows, columns) rectified grey images at half resolution.

        Returns
        -------
        (rows // 2, columns // 2 or 4) cells; rows and columns left over are not matched.

        Raises
        ------
        ValueRefusedError
            If the images are not 2-D uint8 arrays of one shape, contiguous in memory.
        """
        for image in (left, right):
            # Kernels trust their inputs, so this is where a wrong one stops.
            if image.ndim != 2 or image.dtype != np.uint8 or image.shape != left.shape or not image.flags.c_contiguous:
                got = f"{left.dtype} {left.shape} and {right.dtype} {right.shape}"
                raise ValueRefusedError(f"cells need contiguous 8-bit grey images of one shape, but got {got}")
        settings, cell_columns = self.settings, self.settings.cell_width_px // 2
        if left.shape != self._shape:
            self._allocate(*left.shape)
        kernels.encode(left, self._left)
        kernels.encode(right, self._right)
        kernels.turn(self._right, self._turned)
        kernels.cost_cells(self._left, self._turned, cell_columns, self._costs)
        prices = settings.p1, settings.p2
        kernels.sum_paths(self._costs, *prices, self._sums)
        limits = settings.tolerance, settings.margin
        kernels.choose(self._costs, self._sums, *prices, cell_columns, *limits, self._d_px, self._margin)
        kernels.measure_texture(left, cell_columns, self._texture)
        noise = min(max(0, kernels.measure_noise(self._texture) - settings.quiet), NOISIEST)
        sure = min(settings.margin + settings.noise_margin * noise, TOP)
        kernels.drop_weak(self._texture, self._margin, settings.texture, sure, self._blocks, self._d_px)
        if noise > 0 and left[::8, ::8].mean() < settings.dark:
            self._d_px[self._d_px < settings.noise_least_px * noise] = np.nan
        kernels.drop_repeated(self._costs, self._texture, cell_columns, self._marks, self._d_px)
        smallest = -(-settings.speckle_px2 // (settings.cell_width_px * 4))
        kernels.drop_speckles(self._d_px, settings.speckle_step_px, smallest, self._labels)
        kernels.smooth(self._d_px, settings.smooth_step_px, self._smooth)
        return CellDisparities(self._smooth, self._margin, self._texture, settings.cell_width_px, 4)

    def _allocate(self, height: int, width: int) -> None:
        lanes = self.settings.disparities // 2
        rows, columns = height // CELL_ROWS, width // (self.settings.cell_width_px // 2)
        self._left = np.empty((height, width), np.uint8)
        self._right = np.empty_like(self._left)
        self._turned = np.empty((height, width + lanes), np.uint8)
        self._costs = np.empty((rows, columns, lanes), np.uint8)
        self._sums = np.empty_like(self._costs)
        self._d_px = np.empty((rows, columns), np.float32)
        self._smooth = np.empty_like(self._d_px)
        self._margin = np.empty((rows, columns), np.uint8)
        self._texture = np.empty_like(self._margin)
        self._blocks = np.empty((rows, columns), np.int16)
        self._marks = np.empty_like(self._margin)
        self._labels = np.empty((2, rows * columns), np.int32)
        self._shape = (height, width)


def warm(settings: CellSettings) -> None:
    """Compile every kernel that these settings need, or read them from numba's cache, on a pair of blank images."""
    blank = np.zeros((8, 64), np.uint8)
    CellMatcher(settings)(blank, blank)
