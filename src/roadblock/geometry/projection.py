"""Equations 1-5 for every lens: points of a camera frame to pixels and back.

One camera is split as in the paper: perspective (eqs. 4-5), the lens (which the paper's pinhole leaves out), and
the step from the physical image to pixels (eqs. 1-2).
"""

from functools import lru_cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.polynomial.polynomial import polyval
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
    (..., 2) pixels, not clipped to the image; NaN behind the camera (for Kannala-Brandt straight behind), from the
    fold of the lens on (see `fold_radius`), or where the point is NaN or infinitely far aside.
    """
    with np.errstate(all="ignore"):
        plane = _inside(_plane_from_point(camera, np.asarray(points, float)), fold_radius(camera))
        return _distort(camera, plane) * (camera.fx_px, camera.fy_px) + (camera.cx_px, camera.cy_px)


def unproject(camera: Camera, pixels: ArrayLike) -> FloatArray:
    """Return the ray behind each pixel, the inverse of `project` to 1e-9 px (eqs. 1-2, lens and eq. 4 inverted).

    Parameters
    ----------
    camera
        Intrinsics and lens.
    pixels
        (..., 2).

    Returns
    -------
    (..., 3) unit vectors in the camera frame; NaN where no ray inside the fold of the lens reaches that pixel.
    """
    with np.errstate(all="ignore"):
        m = (np.asarray(pixels, float) - (camera.cx_px, camera.cy_px)) / (camera.fx_px, camera.fy_px)
        return _ray_from_plane(camera, _undistort(camera, m))


def project_jacobian(camera: Camera, points: ArrayLike) -> FloatArray:
    """Return d(u, v) / d(x, y, z) of `project`, (..., 2, 3) in px/m; NaN where `project` is."""
    points = np.asarray(points, float)
    with np.errstate(all="ignore"):
        plane = _inside(_plane_from_point(camera, points), fold_radius(camera))
        a, b, c = _distort_slopes(camera, plane)
        focal = np.array([[camera.fx_px], [camera.fy_px]])
        return np.asarray(focal * (_matrix([[a, b], [b, c]]) @ _plane_jacobian(camera, points, plane)))


def parameter_jacobian(camera: Camera, points: ArrayLike) -> FloatArray:
    """Return d(u, v) / d(parameters) of `project`, (..., 2, 4 + k); NaN where it is.

    Columns as in `Camera.parameters`: fx, fy, cx, cy (pixels per pixel), then the k coefficients (pixels).
    """
    with np.errstate(all="ignore"):
        plane = _inside(_plane_from_point(camera, np.asarray(points, float)), fold_radius(camera))
        x, y = np.moveaxis(_distort(camera, plane), -1, 0)
        zero = 0 * x
        pinhole = _matrix([[x, zero, 1 + zero, zero], [zero, y, zero, 1 + zero]])
        focal = np.array([[camera.fx_px], [camera.fy_px]])
        return np.concatenate([pinhole, focal * _coefficient_slopes(camera, plane)], -1)


@lru_cache(maxsize=64)
def fold_radius(camera: Camera) -> float:
    """Return the radius on the lens's plane up to which different points have different pixels; infinity if all have.

    Beyond it a distortion polynomial folds back and would put things from outside the view into the image. In units
    of x/z, for Kannala-Brandt radians (at most pi).

    All three lenses are gradients of a potential, so they are one to one on a disc where their Jacobian is positive
    definite. With g the radial curve and |p| the size of the tangential terms, that holds in every direction while
    `g'(r) > 6 |p| r` and `g(r) / r > 10/3 |p| r`.
    """
    reach = np.pi if camera.lens == "kannala_brandt" else np.inf
    if camera.lens == "pinhole":
        return float(reach)
    num, den = _radial(camera.lens, camera.distortion)
    tilt = float(np.hypot(*camera.distortion[2:4])) if camera.lens == "brown_conrady" else 0.0
    r = Polynomial([0.0, 1.0])
    N, D = num(r * r), den(r * r)
    climbs = N * D + r * (N.deriv() * D - N * D.deriv()) - 6 * tilt * r * D * D
    return float(min(reach, *map(_turns_negative, (climbs, N - 10 / 3 * tilt * r * D, D))))


def _turns_negative(p: Polynomial) -> float:
    """Return the first r > 0 from which a polynomial with p(0) = 1 is negative; infinity if there is none."""
    # The roots are taken in 1/r: there the leading coefficient is 1, however small the last ones are.
    inverse = Polynomial(p.trim().coef[::-1]).roots()
    with np.errstate(all="ignore"):
        r = 1 / inverse.real[(np.abs(inverse.imag) <= 1e-9 * np.abs(inverse)) & (inverse.real > 0)]
        return float(min(r[p(r * (1 + 1e-7)) < 0], default=np.inf))


def _plane_from_point(camera: Camera, points: FloatArray) -> FloatArray:
    """Map points to the lens's own plane: x/z, y/z (eq. 4); for Kannala-Brandt theta times the direction."""
    x, y, z = np.moveaxis(points, -1, 0)
    scale = 1 / np.where(z > 0, z, np.nan)
    if camera.lens == "kannala_brandt":
        r = np.hypot(x, y)
        scale = np.where(r > 0, np.arctan2(r, z) / r, scale)
    return np.stack([x * scale, y * scale], -1)


def _ray_from_plane(camera: Camera, plane: FloatArray) -> FloatArray:
    x, y = np.moveaxis(plane, -1, 0)
    if camera.lens == "kannala_brandt":
        theta = np.hypot(x, y)
        s = np.sinc(theta / np.pi)
        return np.stack([x * s, y * s, np.cos(theta)], -1)
    length = np.hypot(np.hypot(x, y), 1)
    return np.stack([x / length, y / length, 1 / length], -1)


def _plane_jacobian(camera: Camera, points: FloatArray, plane: FloatArray) -> FloatArray:
    """Derive `_plane_from_point`, (..., 2, 3); NaN where the plane is."""
    x, y, z = np.moveaxis(points + 0 * plane[..., :1], -1, 0)
    if camera.lens != "kannala_brandt":
        return _matrix([[1 / z, 0 * z, -x / z / z], [0 * z, 1 / z, -y / z / z]])
    r, n2 = np.hypot(x, y), x * x + y * y + z * z
    on_axis = r < 1e-9 * z
    a = np.where(on_axis, 1 / z, np.arctan2(r, z) / r)
    b = np.where(on_axis, 0.0, (z / n2 - a) / r / r)
    return _matrix([[a + b * x * x, b * x * y, -x / n2], [b * x * y, a + b * y * y, -y / n2]])


def _matrix(rows: list[list[FloatArray]]) -> FloatArray:
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _radial(lens: Lens, k: FloatArray) -> tuple[Polynomial, Polynomial]:
    """Numerator and denominator of the radial factor: in r^2, for Kannala-Brandt in theta^2."""
    if lens == "kannala_brandt":
        return Polynomial([1.0, *k]), Polynomial([1.0])
    k1, k2, _, _, k3, k4, k5, k6 = np.r_[k, np.zeros(8 - len(k))]
    return Polynomial([1.0, k1, k2, k3]), Polynomial([1.0, k4, k5, k6])


def _distort(camera: Camera, plane: FloatArray) -> FloatArray:
    """Bend the lens's plane; meant for points inside the fold."""
    if camera.lens == "pinhole":
        return plane
    x, y = np.moveaxis(plane, -1, 0)
    r2 = x * x + y * y
    num, den = _radial(camera.lens, camera.distortion)
    f = polyval(r2, num.coef) / polyval(r2, den.coef)
    p1, p2 = camera.distortion[2:4] if camera.lens == "brown_conrady" else (0.0, 0.0)
    along = f + 2 * (p1 * y + p2 * x)
    return np.stack([x * along + p2 * r2, y * along + p1 * r2], -1)


def _distort_slopes(camera: Camera, plane: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the three different entries a, b, c of the Jacobian [[a, b], [b, c]] of `_distort`."""
    x, y = np.moveaxis(plane, -1, 0)
    if camera.lens == "pinhole":
        return np.ones_like(x), np.zeros_like(x), np.ones_like(x)
    r2 = x * x + y * y
    num, den = _radial(camera.lens, camera.distortion)
    below = polyval(r2, den.coef)
    f = polyval(r2, num.coef) / below
    df = 2 * (polyval(r2, num.deriv().coef) - f * polyval(r2, den.deriv().coef)) / below
    p1, p2 = camera.distortion[2:4] if camera.lens == "brown_conrady" else (0.0, 0.0)
    a = f + df * x * x + 2 * p1 * y + 6 * p2 * x
    c = f + df * y * y + 6 * p1 * y + 2 * p2 * x
    return a, df * x * y + 2 * (p1 * x + p2 * y), c


def _coefficient_slopes(camera: Camera, plane: FloatArray) -> FloatArray:
    """Derive `_distort` by the coefficients, (..., 2, k)."""
    count = len(camera.distortion)
    if count == 0:
        return np.zeros((*plane.shape, 0))
    x, y = np.moveaxis(plane, -1, 0)
    r2 = x * x + y * y
    num, den = _radial(camera.lens, camera.distortion)
    below = polyval(r2, den.coef)
    powers = r2[..., None] ** np.arange(1, 5 if camera.lens == "kannala_brandt" else 4) / below[..., None]
    radial = plane[..., None] * powers[..., None, :]
    if camera.lens == "kannala_brandt":
        return np.asarray(radial)
    tilts = _matrix([[2 * x * y, r2 + 2 * x * x], [r2 + 2 * y * y, 2 * x * y]])
    f = polyval(r2, num.coef) / below
    slopes = np.concatenate([radial[..., :2], tilts, radial[..., 2:], -f[..., None, None] * radial], -1)
    return np.asarray(slopes[..., :count])


def _undistort(camera: Camera, m: FloatArray) -> FloatArray:
    """Invert `_distort` by Newton's method; NaN where it finds no root inside the fold."""
    if camera.lens == "pinhole":
        return _inside(m, np.inf)
    reach = fold_radius(camera)
    goal = m.reshape(-1, 2)
    plane = _start(camera, goal, reach)
    size = 1 + np.abs(goal).max(-1, initial=0.0)
    todo = np.arange(len(goal))
    for _ in range(ITERATIONS):
        here = plane[todo]
        du, dv = np.moveaxis(_distort(camera, here) - goal[todo], -1, 0)
        a, b, c = _distort_slopes(camera, here)
        step = np.stack([c * du - b * dv, a * dv - b * du], -1) / (a * c - b * b)[:, None]
        plane[todo] = _pull_inside(here - step, reach)
        todo = todo[np.maximum(np.abs(du), np.abs(dv)) > 1e-14 * size[todo]]
        if not todo.size:
            break
    error = np.abs(_distort(camera, plane) - goal).max(-1, initial=0.0)
    return np.where((error < 1e-13 * size)[:, None], plane, np.nan).reshape(m.shape)


def _start(camera: Camera, goal: FloatArray, reach: float) -> FloatArray:
    """Start Newton on the radial curve alone, looked up in a table: it is monotonic inside the fold."""
    num, den = _radial(camera.lens, camera.distortion)
    length = np.hypot(goal[:, 0], goal[:, 1])
    t = np.linspace(0, 1 - 1e-9, 1024)
    end = min(reach, 1000.0)
    r = end * t / (1 + end * (1 - t))  # even steps to a near fold, ever longer ones to a far one
    curve = r * num(r * r) / den(r * r)
    rising = np.maximum.accumulate(np.where(np.isfinite(curve), curve, 0.0))
    found = np.interp(length, rising, r)
    return goal * (found / np.where(length > 0, length, 1.0))[:, None]


def _inside(plane: FloatArray, reach: float) -> FloatArray:
    return np.where((np.hypot(plane[..., 0], plane[..., 1]) < reach)[..., None], plane, np.nan)


def _pull_inside(plane: FloatArray, reach: float) -> FloatArray:
    length = np.hypot(plane[:, 0], plane[:, 1])[:, None]
    return np.where(length < reach, plane, plane * (reach * (1 - 1e-9) / length))
