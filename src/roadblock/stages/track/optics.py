"""The measurement: between the vehicle frame and (u, v, d)."""

import numpy as np

from roadblock.geometry.pose import inverse, transform
from roadblock.geometry.stereo import triangulate, triangulate_jacobian
from roadblock.kernels.compiled.track import expect
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray


class Optics:
    """What kernels need of the cameras.

    Parameters
    ----------
    rectification
        The twin cameras.
    T_vehicle_car
        Where they are.

    Attributes
    ----------
    twin
        (4,) f, cx, cy in px, and baseline in m.
    ahead
        (4,) the cameras' forward axis in the vehicle frame; with its last number, a point's forward distance.
    eye
        (3,) where the left camera is in the vehicle frame.
    fb
        Focal length times baseline, px m.
    """

    def __init__(self, rectification: Rectification, T_vehicle_car: FloatArray) -> None:
        r = self.rectification = rectification
        self.T_vehicle_car, self.T_car_vehicle = np.array(T_vehicle_car, float), inverse(T_vehicle_car)
        self.twin = r.numbers
        self.ahead = self.T_car_vehicle[2].copy()
        self.eye = transform(self.T_vehicle_car, [-r.baseline_m / 2, 0.0, 0.0])
        self.fb = r.f_px * r.baseline_m

    def see(self, x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (n, 3) u, v, d of states (n, 5), (n, 3, 3) their derivatives by the place, and their covariance."""
        return expect(x, P, self.twin, self.T_car_vehicle)

    def place(self, uvd: FloatArray, cov_px2: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points (n, 3) of (u, v, d) and their covariance (n, 3, 3)."""
        J = self.T_vehicle_car[:3, :3] @ triangulate_jacobian(self.rectification, uvd)
        return transform(self.T_vehicle_car, triangulate(self.rectification, uvd)), J @ cov_px2 @ J.swapaxes(1, 2)
