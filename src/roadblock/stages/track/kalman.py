"""Kalman filters of many obstacles at once, in the vehicle frame.

A state is (x, y, z, vx, vy): place of what (u, v, d) measures, and velocity along the ground; what stands on the road
stays at its height, but for a slow drift. All arrays hold one row an obstacle.
"""

import numpy as np

from roadblock.geometry.pose import inverse, transform
from roadblock.geometry.stereo import image_from_car, image_jacobian, triangulate, triangulate_jacobian
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray

SIZE = 5
SIDE_SHARE = 0.5
"""Expected velocity across, of that along the road, for something just born."""
CONTRADICTION = 9.2
"""99 % of a squared distance of two numbers."""
RISE_M2PS = 0.02
"""Variance a second of the height of what is measured: another part of it shows, the road bends."""


class Optics:
    """The measurement: from the vehicle frame to (u, v, d).

    Parameters
    ----------
    rectification
        The twin cameras.
    T_vehicle_car
        Where they are.
    """

    def __init__(self, rectification: Rectification, T_vehicle_car: FloatArray) -> None:
        self.rectification = rectification
        self.T_vehicle_car, self.T_car_vehicle = T_vehicle_car, inverse(T_vehicle_car)

    def see(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) u, v, d of points (n, 3) and their (n, 3, 3) derivatives; NaN behind the cameras."""
        car = transform(self.T_car_vehicle, points)
        J = image_jacobian(self.rectification, car) @ self.T_car_vehicle[:3, :3]
        return image_from_car(self.rectification, car), J

    def place(self, uvd: FloatArray, cov_px2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (n, 3) of (u, v, d) and their covariance (n, 3, 3)."""
        J = self.T_vehicle_car[:3, :3] @ triangulate_jacobian(self.rectification, uvd)
        return transform(self.T_vehicle_car, triangulate(self.rectification, uvd)), J @ cov_px2 @ J.swapaxes(1, 2)


def begin(place: FloatArray, cov_m2: FloatArray, speed_mps: float) -> tuple[FloatArray, FloatArray]:
    """Return states (n, 5) and covariances (n, 5, 5) of what was just born: of unknown velocity."""
    x = np.zeros((len(place), SIZE))
    x[:, :3] = place
    P = np.zeros((len(place), SIZE, SIZE))
    P[:, :3, :3] = cov_m2
    P[:, 3, 3], P[:, 4, 4] = speed_mps**2, (SIDE_SHARE * speed_mps) ** 2
    return x, P


def predict(
    x: FloatArray, P: FloatArray, dt_s: float, T_now_before: FloatArray, ego_cov: FloatArray, noise_m2ps3: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states and covariances after `dt_s`, seen from where the vehicle is then.

    Parameters
    ----------
    x, P
        (n, 5) and (n, 5, 5).
    dt_s
        Seconds; negative goes back in time.
    T_now_before
        How the vehicle moved meanwhile, vehicle frame.
    ego_cov
        (6, 6) its covariance, as in `EgoMotion`.
    noise_m2ps3
        (n,) density of the white noise that is the acceleration.
    """
    R = T_now_before[:3, :3]
    F = np.zeros((SIZE, SIZE))
    F[:3, :3], F[:3, 3:], F[3:, 3:] = R, R[:, :2] * dt_s, R[:2, :2]
    x = x @ F.T
    x[:, :3] += T_now_before[:3, 3]
    t = abs(dt_s)
    unit = np.diag([t**3 / 3, t**3 / 3, 0.0, t, t])
    unit[[0, 1, 3, 4], [3, 4, 0, 1]] = t**2 / 2 * np.sign(dt_s)
    Q = noise_m2ps3[:, None, None] * unit
    Q[:, 2, 2] = RISE_M2PS * t
    G = np.zeros((len(x), SIZE, 6))
    G[:, :3, 3:] = np.eye(3)
    px, py, pz, vx, vy = x.T
    G[:, 0, 1], G[:, 0, 2], G[:, 1, 0], G[:, 1, 2], G[:, 2, 0], G[:, 2, 1] = pz, -py, -pz, px, py, -px
    G[:, 3, 2], G[:, 4, 2] = -vy, vx
    return x, F @ P @ F.T + Q + G @ ego_cov @ G.swapaxes(1, 2)


def correct(
    x: FloatArray, P: FloatArray, innovation: FloatArray, J: FloatArray, noise_px2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states and covariances after measurements of all of them.

    Parameters
    ----------
    x, P
        (n, 5) and (n, 5, 5).
    innovation
        (n, 3) measured minus expected u, v, d.
    J
        (n, 3, 3) derivatives of u, v, d by the place.
    noise_px2
        (n, 3, 3) covariance of the measurements.
    """
    PH = P[:, :, :3] @ J.swapaxes(1, 2)
    S = J @ PH[:, :3] + noise_px2
    K = np.linalg.solve(S, PH.swapaxes(1, 2)).swapaxes(1, 2)
    x = x + (K @ innovation[..., None])[..., 0]
    P = P - K @ PH.swapaxes(1, 2)
    return x, (P + P.swapaxes(1, 2)) / 2


def correct_velocity(
    x: FloatArray, P: FloatArray, v_mps: FloatArray, cov_m2ps2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return states and covariances after their velocities (n, 2) were measured with covariance (n, 2, 2).

    Where a measured velocity contradicts that of the place, the place has wandered along something (the near end of a
    wall goes with the vehicle that looks at it): the measured one is taken for both.
    """
    off = v_mps - x[:, 3:]
    S = P[:, 3:, 3:] + cov_m2ps2
    squared = np.einsum("ni,ni->n", off, np.linalg.solve(S, off[..., None])[..., 0])
    K = np.linalg.solve(S, P[:, 3:, :]).swapaxes(1, 2)
    better, less = x + (K @ off[..., None])[..., 0], P - K @ P[:, 3:, :]
    wrong = squared > CONTRADICTION
    better[wrong] = x[wrong]
    better[wrong, 3:] = v_mps[wrong]
    less[wrong] = P[wrong]
    less[wrong, :3, 3:] = less[wrong, 3:, :3] = 0.0
    less[wrong, 3:, 3:] = cov_m2ps2[wrong]
    return better, (less + less.swapaxes(1, 2)) / 2
