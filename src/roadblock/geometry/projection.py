"""Equations 1-5 for every lens: points of a camera frame to pixels and back.

One camera is split as in the paper: perspective (eqs. 4-5), the lens (which the paper's pinhole leaves out), and
the step from the physical image to pixels (eqs. 1-2).
"""

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from roadblock.values.camera import Camera, Lens
from roadblock.values.checks import FloatArray, positive

ITERATIONS = 60
"""Newton steps before an undistortion is given up; healthy ones need 4 to 8."""


def camera_from_sensor(
    size_px: tuple[int, int], focal_m: float, pitch_m: tuple[float, float], center_px: tuple[float, float]
) -> Camera:
    """Return the pinhole camera of a lens and a sensor, eqs. 1-2: `q = x / dx + q0`, `p = y / dy + p0`.

    Parameters
    ----------
    size_px
        (width, height).
    focal_m
        f, metres.
    pitch_m
        dx, dy: size of one pixel, metres.
    center_px
        q0, p0: principal point, pixels.

    Raises
    ------
    ValueRefusedError
        If a length is not positive.
    """
    dx, dy = (positive("pitch_m", p) for p in pitch_m)
    return Camera(size_px, focal_m / dx, focal_m / dy, *center_px)


def project(camera: Camera, points: ArrayLike) -> FloatArray:
    """Project camera-frame points onto the image (eqs. 4-5, lens, eqs. 1-2).

    Parameters
    ----------
    camera
        Intrinsics and lens.
    points
        (..., 3) in the camera frame (x right, y down, z forward), metres.

    Returns
    -------
    (..., 2) pixels, not clipped to the image; NaN behind the camera, beyond the fold of a Brown-Conrady lens, or
    where the point is NaN.
    """
    points = np.asarray(points, float)
    m = _distort(camera, _plane_from_point(camera, points))
    return m * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)


def unproject(camera: Camera, pixels: ArrayLike) -> FloatArray:
    """Return the ray behind each pixel, the inverse of `project` to 1e-9 px.

    Parameters
    ----------
    camera
        Intrinsics and lens.
    pixels
        (..., 2).

    Returns
    -------
    (..., 3) unit vectors in the camera frame; NaN where no ray of the lens reaches that pixel.
    """
    pixels = np.asarray(pixels, float)
    m = (pixels - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
    return _ray_from_plane(camera, _undistort(camera, m))


def project_jacobian(camera: Camera, points: ArrayLike) -> FloatArray:
    """Return d(u, v) / d(x, y, z) of `project`, (..., 2, 3) in px/m; NaN where `project` is."""
    points = np.asarray(points, float)
    x, y, z = np.moveaxis(points, -1, 0)
    plane = _plane_from_point(camera, points)
    zero = np.zeros_like(z)
    if camera.lens == "kannala_brandt":
        J_plane = _angle_jacobian(x, y, z)
    else:
        J_plane = _matrix([[1 / z, zero, -x / z**2], [zero, 1 / z, -y / z**2]])
    focal = np.array([[camera.fx_px], [camera.fy_px]])
    return np.asarray(focal * (_distort_jacobian(camera, plane) @ J_plane))


def _plane_from_point(camera: Camera, points: FloatArray) -> FloatArray:
    """Map points to the lens's own plane: x/z, y/z (eq. 4); for Kannala-Brandt theta times the direction."""
    x, y, z = np.moveaxis(points, -1, 0)
    with np.errstate(divide="ignore", invalid="ignore"):
        if camera.lens == "kannala_brandt":
            r = np.hypot(x, y)
            scale = np.where(r > 0, np.arctan2(r, z) / np.where(r > 0, r, 1), 1 / np.where(z > 0, z, np.nan))
        else:
            scale = np.where(z > 0, 1 / z, np.nan)
        return np.stack([x * scale, y * scale], -1)


def _ray_from_plane(camera: Camera, plane: FloatArray) -> FloatArray:
    x, y = np.moveaxis(plane, -1, 0)
    if camera.lens == "kannala_brandt":
        theta = np.hypot(x, y)
        s = np.sinc(theta / np.pi)
        return np.stack([x * s, y * s, np.cos(theta)], -1)
    ray = np.stack([x, y, np.ones_like(x)], -1)
    return np.asarray(ray / np.linalg.norm(ray, axis=-1, keepdims=True))


def _angle_jacobian(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """d(theta x/r, theta y/r) / d(x, y, z); on the axis it is 1/z."""
    r2, n2 = x * x + y * y, x * x + y * y + z * z
    r = np.sqrt(r2)
    on_axis = r < 1e-9 * np.abs(z)
    safe = np.where(on_axis, 1.0, r)
    theta = np.arctan2(r, z)
    a = np.where(on_axis, 1 / z, theta / safe)
    b = np.where(on_axis, 0.0, (z / n2 - theta / safe) / safe**2)
    c = -1 / n2
    return _matrix([[a + b * x * x, b * x * y, c * x], [b * x * y, a + b * y * y, c * y]])


def _matrix(rows: list[list[FloatArray]]) -> FloatArray:
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _radial(lens: Lens, k: FloatArray) -> tuple[Polynomial, Polynomial]:
    """Numerator and denominator of the radial factor: in r^2, for Kannala-Brandt in theta^2."""
    if lens == "kannala_brandt":
        return Polynomial([1.0, *k]), Polynomial([1.0])
    k1, k2, _, _, k3, k4, k5, k6 = np.r_[k, np.zeros(8 - len(k))]
    return Polynomial([1.0, k1, k2, k3]), Polynomial([1.0, k4, k5, k6])


def fold_radius(camera: Camera) -> float:
    """Return the radius on the lens's plane where its radial curve stops growing (infinity if it never does).

    Beyond it a distortion polynomial folds back and would put things from outside the view into the image. In units
    of x/z, for Kannala-Brandt radians.
    """
    reach = np.pi if camera.lens == "kannala_brandt" else np.inf
    if camera.lens == "pinhole":
        return float(reach)
    num, den = _radial(camera.lens, camera.distortion)
    s = Polynomial([0.0, 1.0])
    slope = num * den + 2 * s * (num.deriv() * den - num * den.deriv())
    roots = np.r_[slope.trim(1e-300).roots(), den.trim(1e-300).roots()]
    folds = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real
    return float(min([reach, *np.sqrt(folds)]))


def _distort(camera: Camera, plane: FloatArray) -> FloatArray:
    if camera.lens == "pinhole":
        return plane
    x, y = np.moveaxis(plane, -1, 0)
    r2 = x * x + y * y
    num, den = _radial(camera.lens, camera.distortion)
    factor = np.where(np.sqrt(r2) < fold_radius(camera), num(r2) / den(r2), np.nan)
    out = plane * factor[..., None]
    if camera.lens == "brown_conrady":
        p1, p2 = camera.distortion[2:4]
        out = out + np.stack([2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], -1)
    return np.asarray(out)


def _distort_jacobian(camera: Camera, plane: FloatArray) -> FloatArray:
    x, y = np.moveaxis(plane, -1, 0)
    if camera.lens == "pinhole":
        return np.broadcast_to(np.eye(2), (*x.shape, 2, 2))
    r2 = x * x + y * y
    num, den = _radial(camera.lens, camera.distortion)
    inside = np.sqrt(r2) < fold_radius(camera)
    f = np.where(inside, num(r2) / den(r2), np.nan)
    df = 2 * (num.deriv()(r2) * den(r2) - num(r2) * den.deriv()(r2)) / den(r2) ** 2
    J = _matrix([[f + df * x * x, df * x * y], [df * x * y, f + df * y * y]])
    if camera.lens == "brown_conrady":
        p1, p2 = camera.distortion[2:4]
        cross = 2 * p1 * x + 2 * p2 * y
        J = J + _matrix([[2 * p1 * y + 6 * p2 * x, cross], [cross, 6 * p1 * y + 2 * p2 * x]])
    return J


def _undistort(camera: Camera, m: FloatArray) -> FloatArray:
    """Invert `_distort` by Newton's method; NaN where it finds no root inside the fold."""
    if camera.lens == "pinhole":
        return m
    reach = fold_radius(camera)
    plane = _start(camera, m, reach)
    residual = np.full(m.shape, np.inf)
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        for _ in range(ITERATIONS):
            residual = _distort(camera, plane) - m
            J = _distort_jacobian(camera, plane)
            det = J[..., 0, 0] * J[..., 1, 1] - J[..., 0, 1] * J[..., 1, 0]
            adjugate = _matrix([[J[..., 1, 1], -J[..., 0, 1]], [-J[..., 1, 0], J[..., 0, 0]]])
            plane = _pull_inside(plane - (adjugate @ residual[..., None])[..., 0] / det[..., None], reach)
            if not (np.abs(residual) > 1e-15).any():
                break
        error = np.abs(_distort(camera, plane) - m).max(-1)
    return np.asarray(np.where((error < 1e-12 * (1 + np.abs(m).max(-1)))[..., None], plane, np.nan))


def _start(camera: Camera, m: FloatArray, reach: float) -> FloatArray:
    """Start Newton on the radial curve alone, looked up in a table: it is monotonic inside the fold."""
    num, den = _radial(camera.lens, camera.distortion)
    length = np.linalg.norm(m, axis=-1)
    limit = reach if np.isfinite(reach) else 4 * (1 + float(np.nanmax(length, initial=0.0)))
    r = np.linspace(0, limit * (1 - 1e-9), 512)
    curve = r * num(r * r) / den(r * r)
    rising = np.maximum.accumulate(np.where(np.isfinite(curve), curve, 0.0))
    found = np.interp(length, rising, r)
    return np.asarray(m * (found / np.where(length > 0, length, 1.0))[..., None])


def _pull_inside(plane: FloatArray, reach: float) -> FloatArray:
    length = np.linalg.norm(plane, axis=-1, keepdims=True)
    limit = reach * (1 - 1e-9) if np.isfinite(reach) else np.inf
    return np.where(length > limit, plane * (limit / length), plane)
