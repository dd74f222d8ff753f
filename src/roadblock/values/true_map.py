"""What is true of a picture, pixel by pixel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import locked, positive


@dataclass(frozen=True, eq=False)
class TrueMap:
    """True disparities of a rectified left image, and which of its pixels belong to which thing.

    Attributes
    ----------
    name
        Of the frame.
    d_px
        (h, w) disparity, pixels; NaN where nobody knows.
    ids
        (h, w) number of the thing, 0 for the rest.
    f_px, cx_px, cy_px, baseline_m
        The twin cameras.

    Raises
    ------
    ValueRefusedError
        If the maps differ in size, or focal length or baseline are not positive.
    """

    name: str
    d_px: NDArray[np.float32]
    ids: NDArray[np.uint16]
    f_px: float
    cx_px: float
    cy_px: float
    baseline_m: float

    def __post_init__(self) -> None:
        if self.d_px.ndim != 2 or self.d_px.shape != self.ids.shape:
            raise ValueRefusedError(
                f"the true maps of {self.name} must have one size, but are {self.d_px.shape} and {self.ids.shape}"
            )
        for name in ("d_px", "ids"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        for name in ("f_px", "baseline_m"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
