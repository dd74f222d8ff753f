"""Ground: DisparityMap in, GroundPlane out. A robust plane with roll that may bend ahead.

A plane in the world is a plane in (u, v, d), where noise is even; so candidates are drawn and judged there, and
only the last fit is in metres.
"""

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, field_validator

from roadblock.kernels.compiled import road as kernels
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import DisparityMap
from roadblock.values.scene import GroundPlane

# Lengths inside the fit are shares of the settings' lengths: a scene, its rig and the settings, all scaled together,
# give the scaled road.
SIDE_SHARE = 2 / 3
"""Of `side_m`, half a road's width: what lies further aside is less likely the road the vehicle stands on."""

BIN_SHARE = 2 / 35
"""Of `near_m`: the steps ahead in which points are evened out."""

FADE_SHARE = 4 / 7
"""Of `near_m`: points this far ahead count half."""

MOMENT_NS = 1_000_000_000
"""Roads further apart in time are strangers."""


class GroundSettings(BaseModel):
    """What a road may look like."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    height_m: tuple[PositiveFloat, PositiveFloat] = Field((0.2, 4.0), description="Lowest and highest above the road.")
    pitch_deg: float = Field(15.0, gt=0, lt=60, description="Largest pitch, up or down.")
    roll_deg: float = Field(8.0, gt=0, lt=60, description="Largest roll, either side.")
    draws: int = Field(400, ge=10, le=5000, description="Planes tried.")
    near_m: float = Field(25.0, gt=0, description="The plane is fitted up to here, ...")
    far_m: float = Field(50.0, gt=0, description="... the bend up to here.")
    side_m: float = Field(6.0, gt=0, description="Sideways reach of the fit.")
    tolerance_px: float = Field(0.7, gt=0, description="Disparity noise of a point on the road.")
    tolerance_m: float = Field(0.10, gt=0, description="Unevenness of a road.")
    minimum_cells: int = Field(100, ge=10, description="Fewer cells than this are no road.")

    @field_validator("height_m")
    @classmethod
    def _rises(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the first must be below the second")
        return limits


def fit_ground(
    disparity: DisparityMap,
    rectification: Rectification,
    settings: GroundSettings,
    seed: int = 0,
    before: GroundPlane | None = None,
) -> GroundPlane | None:
    """Find the road.

    Parameters
    ----------
    disparity
        On cells or pixels.
    rectification
        The twin cameras.
    settings
        Limits of what a road is.
    seed
        Of the random draws.
    before
        The road a moment ago, which is tried beside the drawn planes; None if unknown.

    Returns
    -------
    The plane, or None where no plane within the limits carries `minimum_cells`.
    """
    r, s = rectification, settings
    slopes = np.tan(np.radians([s.pitch_deg, s.roll_deg]))
    road = np.empty(6)
    found = kernels.find_road(
        disparity.d_px,
        disparity.cell_px,
        disparity.cell_height_px,
        r.numbers,
        np.array([s.far_m, s.side_m, *s.height_m, slopes[0], BIN_SHARE * s.near_m]),
        np.array([*s.height_m, *slopes]),
        np.array([r.f_px * r.baseline_m, s.near_m, SIDE_SHARE * s.side_m, FADE_SHARE * s.near_m]),
        np.array([s.tolerance_px, s.tolerance_m]),
        s.draws,
        s.minimum_cells,
        seed,
        _slopes(before),
        road,
    )
    if not found:
        return None
    h, along, across, bend, inlier_share, range_m = road.tolist()
    length = float(np.sqrt(1 + along * along + across * across))
    return GroundPlane(
        normal=np.array([across, -1.0, along]) / length,
        height_m=h / length,
        bend_per_m=bend / length,
        inlier_share=inlier_share,
        range_m=range_m,
    )


class RoadFinder:
    """`fit_ground`, frame after frame: the road of a moment ago is tried as well.

    Parameters
    ----------
    settings
        Limits of what a road is.
    """

    def __init__(self, settings: GroundSettings) -> None:
        self.settings = settings
        self._before: GroundPlane | None = None
        self._t_ns = 0

    def __call__(self, disparity: DisparityMap, rectification: Rectification, t_ns: int) -> GroundPlane | None:
        """Find the road of one frame; `t_ns` says whether the last one was a moment ago (0: single frames)."""
        is_next = 0 < t_ns - self._t_ns <= MOMENT_NS
        ground = fit_ground(disparity, rectification, self.settings, before=self._before if is_next else None)
        self._before, self._t_ns = ground, t_ns
        return ground


def _slopes(ground: GroundPlane | None) -> FloatArray:
    """Return (h, s, t) of y = h + s*z + t*x; NaN without a road."""
    if ground is None:
        return np.full(3, np.nan)
    across, down, along = ground.normal
    return np.asarray(np.array([ground.height_m, along, across]) / -down)
