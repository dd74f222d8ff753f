"""Ground: DisparityMap in, GroundPlane out. A robust plane with roll that may bend ahead.

A plane in the world is a plane in (u, v, d), where noise is even; so candidates are drawn and judged there, and
only the last fit is in metres.
"""

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, field_validator

from roadblock.geometry.stereo import triangulate
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

POLISHED = 10
"""The best drawn planes that are fitted before the winner is chosen."""


class GroundSettings(BaseModel):
    """What a road may look like."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    height_m: tuple[PositiveFloat, PositiveFloat] = Field((0.2, 4.0), description="Lowest and highest above the road.")
    pitch_deg: float = Field(15.0, gt=0, lt=60, description="Largest pitch, up or down.")
    roll_deg: float = Field(8.0, gt=0, lt=60, description="Largest roll, either side.")
    draws: int = Field(400, ge=10, le=5000, description="Planes tried.")
    near_m: float = Field(35.0, gt=0, description="The plane is fitted up to here, ...")
    far_m: float = Field(50.0, gt=0, description="... the bend up to here.")
    side_m: float = Field(6.0, gt=0, description="Sideways reach of the fit.")
    tolerance_px: float = Field(1.0, gt=0, description="Disparity noise of a point on the road.")
    tolerance_m: float = Field(0.10, gt=0, description="Unevenness of a road.")
    minimum_cells: int = Field(100, ge=10, description="Fewer cells than this are no road.")

    @field_validator("height_m")
    @classmethod
    def _rises(cls, limits: tuple[float, float]) -> tuple[float, float]:
        if limits[0] >= limits[1]:
            raise ValueError("the first must be below the second")
        return limits


def fit_ground(
    disparity: DisparityMap, rectification: Rectification, settings: GroundSettings, seed: int = 0
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

    Returns
    -------
    The plane, or None where no plane within the limits carries `minimum_cells`.
    """
    uvd = disparity.uvd_px[np.isfinite(disparity.d_px)]
    points = triangulate(rectification, uvd)
    low, high = settings.height_m
    slope = np.tan(np.radians(settings.pitch_deg))
    x, y, z = points.T
    candidate = (z < settings.far_m) & (np.abs(x) < settings.side_m) & (y > 0.5 * low) & (y < high + slope * z)
    uvd, points = _even_out(uvd[candidate], points[candidate], BIN_SHARE * settings.near_m, np.random.default_rng(seed))
    if len(points) < settings.minimum_cells:
        return None
    coarse = _draw_plane(uvd, points, rectification, settings, np.random.default_rng(seed))
    return None if coarse is None else _refine(points, coarse, settings)


def _even_out(
    uvd: FloatArray, points: FloatArray, step_m: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Keep at most 300 points of every step ahead, so that the near road does not outvote the far one."""
    order = rng.permutation(len(points))
    bins = (points[order, 2] / step_m).astype(int)
    rank = np.zeros(len(bins), int)
    by_bin = np.argsort(bins, kind="stable")
    starts = np.r_[True, np.diff(bins[by_bin]) > 0]
    first = np.maximum.accumulate(np.where(starts, np.arange(len(bins)), 0))
    rank[by_bin] = np.arange(len(bins)) - first
    keep = order[rank < 300]
    return uvd[keep], points[keep]


def _draw_plane(
    uvd: FloatArray, points: FloatArray, r: Rectification, settings: GroundSettings, rng: np.random.Generator
) -> FloatArray | None:
    """Return (h, s, t) of y = h + s*z + t*x: the drawn plane with most support and least below it; None if none."""
    near = points[:, 2] < settings.near_m
    p, m = points[near], uvd[near]
    if len(p) < settings.minimum_cells:
        return None
    triples = p[rng.integers(len(p), size=(settings.draws, 3))]
    A = np.stack([np.ones(triples.shape[:2]), triples[..., 2], triples[..., 0]], -1)
    usable = np.abs(np.linalg.det(A)) > 1e-6 * settings.near_m**2
    planes = np.linalg.solve(A[usable], triples[usable][..., 1:2])[..., 0]
    planes = planes[_is_allowed(planes, settings)]
    if not len(planes):
        return None
    score, _ = _support(planes, p, m, r, settings)
    best = planes[np.argsort(score)[-POLISHED:]]
    for _ in range(3):
        best = np.array(
            [
                _least_squares(p, on, plane, settings)
                for plane, on in zip(best, _support(best, p, m, r, settings)[1], strict=True)
            ]
        )
    score, on = _support(best, p, m, r, settings)
    winner = int(np.argmax(score))
    return best[winner] if on[winner].sum() >= settings.minimum_cells else None


def _is_allowed(planes: FloatArray, settings: GroundSettings) -> NDArray[np.bool_]:
    low, high = settings.height_m
    slopes = np.tan(np.radians([settings.pitch_deg, settings.roll_deg]))
    return np.asarray((planes[:, 0] > low) & (planes[:, 0] < high) & (np.abs(planes[:, 1:]) < slopes).all(1))


def _support(
    planes: FloatArray, p: FloatArray, m: FloatArray, r: Rectification, settings: GroundSettings
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return each plane's score, and which points lie on it: the weight on it less twice the weight below it."""
    # d of the plane at each point's pixel, from y = h + s*z + t*x: noise is even in d.
    ray_y, ray_x = p[:, 1] / p[:, 2], p[:, 0] / p[:, 2]
    d_plane = (ray_y - planes[:, 1:2] - planes[:, 2:3] * ray_x) * (r.f_px * r.baseline_m / planes[:, :1])
    nearer_px = m[:, 2] - d_plane
    weight = 1 / (1 + (p[:, 0] / (SIDE_SHARE * settings.side_m)) ** 2)
    on = np.abs(nearer_px) < settings.tolerance_px
    return on @ weight - 2.0 * (nearer_px < -3 * settings.tolerance_px) @ weight, on


def _least_squares(p: FloatArray, on: NDArray[np.bool_], plane: FloatArray, settings: GroundSettings) -> FloatArray:
    """Fit (h, s, t) to the points that are on; the old plane where they are too few."""
    if on.sum() < 10:
        return plane
    x, y, z = p[on].T
    # The road in front counts most, and near points more than far ones, whose noise grows with range.
    w = 1 / np.sqrt(1 + (x / (SIDE_SHARE * settings.side_m)) ** 2) / (1 + z / (FADE_SHARE * settings.near_m))
    A = np.stack([np.ones_like(z), z, x], -1)
    return np.asarray(np.linalg.lstsq(A * w[:, None], y * w, rcond=None)[0])


def _refine(points: FloatArray, plane: FloatArray, settings: GroundSettings) -> GroundPlane | None:
    """Fit in metres by shrinking least squares: the near plane first, then outwards with a bend."""
    x, y, z = points.T
    A = np.stack([np.ones_like(z), z, x, z * z], -1)
    near = z < settings.near_m
    for tolerance in (2.0, 1.0, 0.6, 0.6):
        on = near & (np.abs(y - A[:, :3] @ plane) < tolerance * settings.tolerance_m)
        if on.sum() < settings.minimum_cells:
            return None
        plane = _least_squares(points, on, plane, settings)
    if not _is_allowed(plane[None], settings)[0]:
        return None
    bent = _bend(A, y, np.r_[plane, 0.0], settings)
    on = np.abs(y - A @ bent) < settings.tolerance_m
    h, s, t = plane
    length = float(np.sqrt(1 + s * s + t * t))
    return GroundPlane(
        normal=np.array([t, -1.0, s]) / length,
        height_m=h / length,
        bend_per_m=-float(bent[3]) / length,
        inlier_share=float(on.mean()),
        range_m=float(np.percentile(z[on], 99)),
    )


def _bend(A: FloatArray, y: FloatArray, start: FloatArray, settings: GroundSettings) -> FloatArray:
    """Grow the fit outwards from the near plane, letting it curve; a prior holds the curve near zero."""
    z, x = A[:, 1], A[:, 2]
    bent = start
    prior = np.diag([0.0, 0.0, 0.0, 860 * settings.near_m])
    fixed = np.diag([35e3 / settings.near_m, 1e3, 1e3, 0.0])
    for reach in np.linspace(settings.near_m, settings.far_m, 5):
        slack = settings.tolerance_m * 0.6 + 0.003 * z
        on = (np.abs(y - A @ bent) < slack) & (z < reach) & (np.abs(x) < 0.8 * settings.side_m)
        w = 1 / slack[on]
        rows = np.r_[A[on] * w[:, None], prior, fixed]
        bent = np.linalg.lstsq(rows, np.r_[y[on] * w, np.zeros(4), fixed @ start], rcond=None)[0]
    return bent
