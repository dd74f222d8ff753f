"""ROS `camera_info` YAML, one file per camera: `left.yaml` and `right.yaml`.

Rectified points of both cameras have `X_rect = R_1 x_left = R_2 x_right + B e_x`, and the right camera's projection
matrix holds `P[0, 3] = -f B`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import pose
from roadblock.geometry.projection import unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.io.rig.files import Asked, entry, parse_yaml, section
from roadblock.io.rig.numbers import camera, listed, numbers, rotation, size
from roadblock.values.camera import Camera, Lens, StereoRig
from roadblock.values.checks import FloatArray

LENSES: dict[str, Lens] = {
    "plumb_bob": "brown_conrady",
    "rational_polynomial": "brown_conrady",
    "equidistant": "kannala_brandt",
}


@dataclass(frozen=True, eq=False)
class _Info:
    camera: Camera
    R_rect: FloatArray
    P: FloatArray


def read_ros(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the raw rig of a `camera_info` pair.

    Parameters
    ----------
    texts
        The left and the right camera's file, in this order.
    asked
        `unit_m` scales the baseline.

    Raises
    ------
    RigError, ValueRefusedError
        If there is one file only, a camera is not calibrated, the lens is another, the projection matrices belong to
        no side-by-side pair, or a value cannot be true.
    """
    if len(texts) != 2:
        raise RigError("holds one camera, but a rig needs two: give the right camera's file too, or their folder")
    left, right = (_info(parse_yaml(text), side) for text, side in zip(texts, ("left: ", "right: "), strict=True))
    if not np.allclose(left.P[:, :2], right.P[:, :2], rtol=1e-6) or abs(left.P[1, 2] - right.P[1, 2]) > 1e-6:
        raise RigError("both projection_matrix must have the same focal lengths and row of the centre, but differ")
    if left.P[1, 3] or right.P[1, 3]:
        raise RigError("projection_matrix has a vertical baseline: cameras above each other are not supported")
    B = asked.unit_m * (left.P[0, 3] - right.P[0, 3]) / right.P[0, 0]
    R_left_rect = left.R_rect.T
    return StereoRig(left.camera, right.camera, pose(R_left_rect @ right.R_rect, R_left_rect @ [B, 0, 0]))


def _info(document: dict[str, Any], where: str) -> _Info:
    size_px = size(
        f"{where}image_width, image_height", [entry(document, key, where) for key in ("image_width", "image_height")]
    )
    K = _matrix(document, "camera_matrix", (3, 3), where)
    if not K[0, 0]:
        raise RigError(f"{where}camera_matrix starts with 0, which says 'not calibrated': calibrate the cameras first")
    P = _matrix(document, "projection_matrix", (3, 4), where)
    if P[0, 0] <= 0 or P[1, 1] <= 0:
        raise RigError(f"{where}projection_matrix must have positive focal lengths, but got {P[0, 0]:g}, {P[1, 1]:g}")
    model = str(entry(document, "distortion_model", where))
    if model not in LENSES:
        raise RigError(f"{where}distortion_model must be one of {', '.join(LENSES)}, but got {model!r:.40}")
    d = _matrix(document, "distortion_coefficients", (-1,), where)
    R_name = f"{where}rectification_matrix"
    R = rotation(R_name, _matrix(document, "rectification_matrix", (3, 3), where))
    return _Info(camera(size_px, K, LENSES[model], d, where), R, P)


def _matrix(document: dict[str, Any], key: str, shape: tuple[int, ...], where: str) -> FloatArray:
    data = entry(section(document, key, where), "data", f"{where}{key}.")
    return numbers(f"{where}{key}.data", data, (int(np.prod(shape)),)).reshape(shape)


def write_ros(rig: StereoRig) -> dict[str, str]:
    """Return the texts of `left.yaml` and `right.yaml`, with the rectification of `rectifying_rotations`.

    Raises
    ------
    RigError
        If the rig has a mounting, which these files have no room for, or the cameras have no common view ahead.
    """
    if rig.T_vehicle_car is not None:
        raise RigError("ros files have no room for the mounting T_vehicle_car: write roadblock or opencv instead")
    rotations = rectifying_rotations(rig.T_left_right)
    cameras = (rig.left, rig.right)
    P = _projection(cameras, rotations)
    texts = {}
    for side, camera_, R, B in zip(("left", "right"), cameras, rotations, (0.0, rig.baseline_m), strict=True):
        shifted = P.copy()
        shifted[0, 3] = -P[0, 0] * B
        texts[f"{side}.yaml"] = _text(side, camera_, R, shifted)
    return texts


def _projection(cameras: tuple[Camera, Camera], rotations: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the twin cameras' 3x4 matrix: mean focal length, the raw image centres kept central on average."""
    f = float(np.mean([(c.fx_px, c.fy_px) for c in cameras]))
    centre = (np.array(cameras[0].size_px) - 1) / 2
    rays = [R @ unproject(c, centre) for c, R in zip(cameras, rotations, strict=True)]
    if not all(ray[2] > 0 for ray in rays):
        raise RigError("ros files need a common view ahead, but a lens sees nothing of it at the image's centre")
    cx, cy = centre - f * np.mean([ray[:2] / ray[2] for ray in rays], axis=0)
    return np.array([[f, 0, cx, 0], [0, f, cy, 0], [0, 0, 1, 0]])


def _text(side: str, camera_: Camera, R: FloatArray, P: FloatArray) -> str:
    d = camera_.distortion if len(camera_.distortion) else np.zeros(5)
    model = {4: "equidistant", 5: "plumb_bob", 8: "rational_polynomial"}[len(d)]
    lines = [f"image_width: {camera_.size_px[0]}", f"image_height: {camera_.size_px[1]}", f"camera_name: {side}"]
    lines += _rows("camera_matrix", camera_.K)
    lines += [f"distortion_model: {model}", *_rows("distortion_coefficients", d[None])]
    lines += [*_rows("rectification_matrix", R), *_rows("projection_matrix", P)]
    return "\n".join(lines) + "\n"


def _rows(name: str, matrix: FloatArray) -> list[str]:
    return [f"{name}:", f"  rows: {matrix.shape[0]}", f"  cols: {matrix.shape[1]}", f"  data: {listed(matrix)}"]
