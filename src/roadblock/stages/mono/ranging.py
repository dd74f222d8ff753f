"""Ranges from one camera, and the closed formulas of how far each assumption moves them.

Pinhole algebra of the rectified left camera: a ray is r = ((u - cx) / f, (v - cy) / f, 1), the road n . p + h = 0.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from roadblock.errors import ValueRefusedError
from roadblock.stages.mono.settings import Build
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray, positive
from roadblock.values.scene import GroundPlane

NEAREST_M, FARTHEST_M = 0.5, 500.0
"""Between these a cuboid is looked for."""


@dataclass(frozen=True)
class Sensitivity:
    """First derivatives of a range.

    Attributes
    ----------
    per_measured
        By what was measured: metres per pixel of contact row, or per square pixel of area.
    per_rad
        By the camera's pitch, metres per radian (pitch > 0 = down).
    per_size
        By the relative error of the known size (camera height, or the thing's three dimensions): metres per 1.
    """

    per_measured: float
    per_rad: float
    per_size: float

    def sigma_m(self, measured: float, pitch_rad: float, size: float) -> float:
        """Return the standard deviation of the range, metres, for independent errors of these sigmas."""
        return float(np.linalg.norm([self.per_measured * measured, self.per_rad * pitch_rad, self.per_size * size]))


def left_height_m(rectification: Rectification, ground: GroundPlane) -> float:
    """Return the height of the left camera above the road; the plane itself is told in the car frame (eq. 8)."""
    return float(ground.height_of(np.array([-rectification.baseline_m / 2, 0.0, 0.0])))


def road_range(uv_px: FloatArray, rectification: Rectification, ground: GroundPlane) -> FloatArray:
    """Return the forward distance (...) of the road at pixels (..., 2), metres; NaN on and above the horizon.

    Z = -h / (n . r), exact for any pitch and roll. With roll 0 it is f * h / (cos(pitch) * (v - v_horizon)). The
    ground's bend is not used: one camera does not see it.
    """
    r = rectification
    rays = (np.asarray(uv_px, float) - (r.cx_px, r.cy_px)) / r.f_px
    slope = -(rays @ ground.normal[:2] + ground.normal[2])
    return np.asarray(left_height_m(r, ground) / np.where(slope > 1e-9, slope, np.nan))


def range_from_contact(u_px: float, v_px: float, rectification: Rectification, ground: GroundPlane) -> float:
    """Return the forward distance of a thing that meets the road at this pixel (traditional algorithm 1).

    Parameters
    ----------
    u_px, v_px
        Where it meets the road, rectified left image.
    rectification
        The camera.
    ground
        The road: known height, found horizon.

    Returns
    -------
    Metres; NaN on and above the horizon, where no road is.
    """
    return float(road_range(np.array([u_px, v_px]), rectification, ground))


def contact_sensitivity(u_px: float, v_px: float, rectification: Rectification, ground: GroundPlane) -> Sensitivity:
    """Return how `range_from_contact` moves; all NaN where it is.

    dZ/dv = Z^2 n_y / (f h), dZ/dpitch = Z^2 / h * (0, -n_z, n_y) . r, dZ / d(ln h) = Z. On a level camera this is
    -Z^2 / (f h), -Z^2 / h and Z.
    """
    r, n = rectification, ground.normal
    z = range_from_contact(u_px, v_px, r, ground)
    h = left_height_m(r, ground)
    turned = -n[2] * (v_px - r.cy_px) / r.f_px + n[1]
    return Sensitivity(float(z * z * n[1] / (r.f_px * h)), float(z * z / h * turned), z)


def first_range_from_area(area_px: float, area_m2: float, fx_px: float, fy_px: float) -> float:
    """Return sqrt(fx * fy * A / S): the distance at which a panel of A square metres covers S square pixels."""
    return float(np.sqrt(fx_px * fy_px * positive("area_m2", area_m2) / positive("area_px", area_px)))


def range_from_area(
    area_px: float,
    u_px: float,
    build: Build,
    rectification: Rectification,
    ground: GroundPlane,
    yaw_rad: float = 0.0,
) -> float:
    """Return the distance at which a thing's cuboid on the road has the silhouette seen (traditional algorithm 2).

    Parameters
    ----------
    area_px
        Of the thing's outline, holes filled, square pixels.
    u_px
        Column of its middle.
    build
        What it measures.
    rectification
        The camera.
    ground
        The road it stands on.
    yaw_rad
        How far the thing is turned from looking along the road; pi/2 = seen from its side.

    Returns
    -------
    Forward distance of the foot of the cuboid's nearest corner, metres; NaN where none from 0.5 to 500 m fits.

    Raises
    ------
    ValueRefusedError
        If the area is not positive, or the build has no front or a fill outside (0, 1].
    """
    _check(area_px, build)

    def excess(z: float) -> float:
        area, _ = _silhouette(z, u_px, build, rectification, ground, yaw_rad)
        return build.fill * area - area_px

    near = _nearest_whole(u_px, build, rectification, ground, yaw_rad)
    if not excess(near) > 0 > excess(FARTHEST_M):
        return float("nan")
    return float(scipy.optimize.brentq(excess, near, FARTHEST_M, xtol=1e-9))


def area_sensitivity(
    area_px: float,
    u_px: float,
    build: Build,
    rectification: Rectification,
    ground: GroundPlane,
    yaw_rad: float = 0.0,
) -> Sensitivity:
    """Return how `range_from_area` moves; all NaN where it is.

    With S(Z, pitch, size) the silhouette: dZ/dS = 1 / S_Z, dZ/dpitch = -S_pitch / S_Z, dZ/d(ln size) = -S_size / S_Z,
    the partial derivatives by the shoelace formula over the projected corners. For a panel seen squarely these are
    -Z / (2 S), 0 and Z.

    Raises
    ------
    ValueRefusedError
        As `range_from_area`.
    """
    z = range_from_area(area_px, u_px, build, rectification, ground, yaw_rad)
    if np.isnan(z):
        return Sensitivity(z, z, z)
    _, (by_z, by_pitch, by_size) = _silhouette(z, u_px, build, rectification, ground, yaw_rad)
    return Sensitivity(float(1 / (build.fill * by_z)), float(-by_pitch / by_z), float(-by_size / by_z))


def _check(area_px: float, build: Build) -> None:
    positive("area_px", area_px)
    for name in ("width_m", "height_m", "length_m", "fill"):
        positive(name, getattr(build, name))
    if build.fill > 1:
        raise ValueRefusedError(f"fill must be at most 1, but got {build.fill:g}")


def _nearest_whole(u_px: float, build: Build, r: Rectification, ground: GroundPlane, yaw_rad: float) -> float:
    """Return the least distance at which all corners are well in front of the camera, metres."""
    return float(max(NEAREST_M, NEAREST_M - _corners(NEAREST_M, u_px, build, r, ground, yaw_rad)[0][:, 2].min() + 0.1))


def _corners(
    z: float, u_px: float, build: Build, r: Rectification, ground: GroundPlane, yaw_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Return the cuboid's corners (8, 3) in the left camera's frame, and their derivatives (3, 8, 3).

    These are by z, by pitch and by the logarithm of the size.
    """
    n, h = ground.normal, left_height_m(r, ground)
    right = np.array([1.0, 0.0, 0.0]) - n[0] * n
    right /= np.linalg.norm(right)
    ahead = np.cross(n, right)
    w, length = build.width_m / 2, build.length_m / 2
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    feet = np.array([[x * c - y * s, x * s + y * c] for x in (-w, w) for y in (-length, length)])
    feet[:, 1] -= feet[:, 1].min()
    base = feet[:, :1] * right + feet[:, 1:] * ahead
    offset = np.concatenate([base, base + build.height_m * n])
    slope = (u_px - r.cx_px) / r.f_px
    down = -(n[0] * slope + n[2]) / n[1]
    foot = np.array([slope * z, down * z - h / n[1], z])
    by_z = np.tile([slope, down, 1.0], (8, 1))
    # Pitch turns the road about the camera's x axis; the foot keeps its column and its distance.
    by_pitch = np.stack([0 * offset[:, 0], foot[1] * n[2] / n[1] - z - offset[:, 2], offset[:, 1]], -1)
    return foot + offset, np.stack([by_z, by_pitch, offset])


def _silhouette(
    z: float, u_px: float, build: Build, r: Rectification, ground: GroundPlane, yaw_rad: float
) -> tuple[float, FloatArray]:
    """Return the area of the cuboid's projection, square pixels, and its derivatives (3,) as in `_corners`."""
    corners, turns = _corners(z, u_px, build, r, ground, yaw_rad)
    depth = corners[:, 2:]
    pixels = r.f_px * corners[:, :2] / depth
    moves = (r.f_px * turns[..., :2] - pixels * turns[..., 2:]) / depth
    order = scipy.spatial.ConvexHull(pixels).vertices
    p, dp = pixels[order], moves[:, order]
    after, before = np.roll(p, -1, 0), np.roll(p, 1, 0)
    area = 0.5 * float(np.sum(p[:, 0] * after[:, 1] - p[:, 1] * after[:, 0]))
    # Shoelace: each vertex moves the area by half the cross product with the line between its neighbours.
    line = after - before
    return area, 0.5 * np.asarray((dp[..., 0] * line[:, 1] - dp[..., 1] * line[:, 0]).sum(-1))
