"""A rig in words, for people to check against the thing itself."""

import numpy as np

from roadblock.geometry.pose import rotvec_from_rotation
from roadblock.geometry.projection import unproject
from roadblock.geometry.uncertainty import range_sigma
from roadblock.values.calibration import RANGES_M as CALIBRATION_RANGES_M
from roadblock.values.camera import Camera, StereoRig

RANGES_M = (10.0, 20.0, 40.0)
STEP_PX = 0.1
VERDICTS = {
    "good": "good",
    "usable": "usable, with reservations",
    "refused": "REFUSED, written by force: do not trust its ranges",
}


def describe_rig(rig: StereoRig) -> list[tuple[str, str]]:
    """Return rows (what, value with unit) that describe a rig.

    The range step is what 0.1 px of disparity are worth, `Z^2 / (f B) * 0.1 px` with f the left camera's `fx_px` (the
    rectified one may differ by a few percent). The range error from calibration is the root mean square of
    `range_sigma` over the left image, and its largest value there.
    """
    width, height = rig.left.size_px
    turn = np.degrees(rotvec_from_rotation(rig.T_left_right[:3, :3]))
    x, y, z = rig.T_left_right[:3, 3]
    rows = [("image size", f"{width} x {height} px")]
    for side, camera in (("left", rig.left), ("right", rig.right)):
        rows += [(f"{side} {what}", value) for what, value in _camera_rows(camera)]
    rows += [
        ("baseline", f"{rig.baseline_m:.5g} m"),
        ("right camera in the left one's frame", f"x {x:.5g}, y {y:.4g}, z {z:.4g} m"),
        (
            "rotation between the cameras",
            f"{np.linalg.norm(turn):.3f} deg (about x {turn[0]:.3f}, y {turn[1]:.3f}, z {turn[2]:.3f})",
        ),
    ]
    for range_m in RANGES_M:
        step_m = range_m**2 / (rig.left.fx_px * rig.baseline_m) * STEP_PX
        rows.append((f"range step per {STEP_PX} px at {range_m:g} m", f"{step_m:.3g} m"))
    rows += _calibration_rows(rig)
    rows.append(("images", "already rectified" if rig.is_rectified else "raw: will be rectified"))
    rows.append(("mounting", _mounting(rig)))
    return rows


def _camera_rows(camera: Camera) -> list[tuple[str, str]]:
    width, height = camera.size_px
    across = unproject(camera, [(-0.5, camera.cy_px), (width - 0.5, camera.cy_px)])
    down = unproject(camera, [(camera.cx_px, -0.5), (camera.cx_px, height - 0.5)])
    lens = camera.lens.replace("_", "-")
    if len(camera.distortion):
        lens += f" ({', '.join(f'{d:.4g}' for d in camera.distortion)})"
    return [
        ("focal lengths", f"fx {camera.fx_px:.3f}, fy {camera.fy_px:.3f} px"),
        ("principal point", f"({camera.cx_px:.3f}, {camera.cy_px:.3f}) px"),
        ("lens", lens),
        ("field of view", f"{_angle(across)} horizontal, {_angle(down)} vertical"),
    ]


def _calibration_rows(rig: StereoRig) -> list[tuple[str, str]]:
    rows = [("calibration", VERDICTS[rig.verdict])] if rig.verdict else []
    if rig.covariance is None:
        return [*rows, ("range error from calibration", "unknown: the file holds no covariance")]
    for distance_m in CALIBRATION_RANGES_M:
        sigma_m = range_sigma(rig, distance_m)
        known = sigma_m[np.isfinite(sigma_m)]
        value = "unknown: not both cameras see that far"
        if known.size:
            value = f"{np.sqrt(np.mean(known**2)):.2g} m (1 sigma; worst corner {known.max():.2g} m)"
        rows.append((f"range error from calibration at {distance_m:g} m", value))
    return rows


def _angle(rays: np.ndarray) -> str:
    """Angle between two rays, through the optical axis (so that more than 180 deg is possible)."""
    if np.isnan(rays).any():
        return "unknown (the lens model ends inside the image)"
    off_axis = np.arctan2(np.hypot(rays[:, 0], rays[:, 1]), rays[:, 2])
    return f"{np.degrees(off_axis.sum()):.1f} deg"


def _mounting(rig: StereoRig) -> str:
    if rig.T_vehicle_car is None:
        return "unknown: the vehicle frame starts halfway between the cameras"
    x, y, z = rig.T_vehicle_car[:3, 3]
    return f"{x:.3f} m forward, {y:.3f} m left, {z:.3f} m up in the vehicle frame"
