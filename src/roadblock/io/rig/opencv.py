"""OpenCV FileStorage YAML of stereo calibrations, as versions 4 and 5 write it, in one file or two.

OpenCV's convention is `x_right = R x_left + T`. The text is read as YAML and not by `cv2.FileStorage`, which ends the
process on deep nesting and lets NaN and missing values through; it is written by `cv2.FileStorage`.
"""

from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.io.rig.files import Asked, entry, parse_yaml
from roadblock.io.rig.numbers import camera, number, numbers, rigid, rotation, size
from roadblock.values.camera import Camera, Lens, StereoRig
from roadblock.values.checks import FloatArray

MATRIX_NAMES = (
    ("M1", "K1", "cameraMatrix1", "camera_matrix_1", "camera_matrix1", "K_LEFT"),
    ("M2", "K2", "cameraMatrix2", "camera_matrix_2", "camera_matrix2", "K_RIGHT"),
)
DISTORTION_NAMES = (
    ("D1", "distCoeffs1", "dist_coeffs_1", "dist_coeffs1", "D_LEFT", "D_LEFT_FE"),
    ("D2", "distCoeffs2", "dist_coeffs_2", "dist_coeffs2", "D_RIGHT", "D_RIGHT_FE"),
)
SIZE_NAMES = ("imageSize", "image_size", "size", "Size", "img_size")
LENS_NAMES: dict[str, Lens] = {
    "plumb_bob": "brown_conrady",
    "rational_polynomial": "brown_conrady",
    "equidistant": "kannala_brandt",
    "fisheye": "kannala_brandt",
}
_MODELS: dict[str, str] = {"pinhole": "plumb_bob", "brown_conrady": "plumb_bob", "kannala_brandt": "equidistant"}
ZED_UNIT_M = 1e-3


def read_opencv(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of an OpenCV calibration, or of the ZED's own OpenCV file (whose T is in mm).

    Parameters
    ----------
    texts
        One text with everything, or two (intrinsics and extrinsics).
    asked
        `unit_m` scales T, `size_px` is needed where the file has no image size.

    Raises
    ------
    RigError, ValueRefusedError
        If a key is missing or named twice, the size is unknown, or a value cannot be true.
    """
    nodes = _merged(texts)
    size_px = _size(nodes, asked)
    cameras = [_camera(nodes, side, size_px) for side in (0, 1)]
    R_name, T_name = _one_of(nodes, ("R",)), _one_of(nodes, ("T",))
    R = _array(nodes, R_name)
    R = rotation_from_rotvec(R.ravel().copy()) if R.size == 3 else rotation("R", numbers("R", R, (3, 3)))
    unit_m = asked.unit_m * (ZED_UNIT_M if "K_LEFT" in nodes else 1.0)
    T = numbers("T", _array(nodes, T_name).ravel(), (3,))
    mounting = None
    if "T_vehicle_car" in nodes:
        mounting = rigid("T_vehicle_car", numbers("T_vehicle_car", _array(nodes, "T_vehicle_car"), (4, 4)), unit_m)
    return StereoRig(cameras[0], cameras[1], inverse(pose(R, unit_m * T)), T_vehicle_car=mounting)


def _merged(texts: tuple[str, ...]) -> dict[str, Any]:
    nodes: dict[str, Any] = {}
    for document in map(parse_yaml, texts):
        twice = sorted(nodes.keys() & document.keys())
        if twice:
            raise RigError(f"{twice[0]} is in both files: keep it in one")
        nodes |= document
    return nodes


def _one_of(nodes: Mapping[str, Any], names: tuple[str, ...]) -> str:
    found = [name for name in names if name in nodes]
    if len(found) > 1:
        raise RigError(f"holds {' and '.join(found)}, which mean the same: keep one")
    if not found:
        raise RigError(f"holds none of {', '.join(names)}; found: {', '.join(map(str, nodes))}"[:300])
    return found[0]


def _array(nodes: Mapping[str, Any], name: str) -> FloatArray:
    """Return a matrix node (`!!opencv-matrix`, `!!opencv-nd-matrix`) or a plain list."""
    node = nodes[name]
    if not isinstance(node, dict):
        return numbers(name, node, (-1,))
    data = numbers(f"{name}.data", entry(node, "data", f"{name}."), (-1,))
    if "sizes" in node:
        shape = tuple(numbers(f"{name}.sizes", node["sizes"], (-1,)).tolist())
    else:
        shape = tuple(number(f"{name}.{key}", entry(node, key, f"{name}.")) for key in ("rows", "cols"))
    if any(n < 0 or n % 1 for n in shape) or float(np.prod(shape)) != len(data):
        raise RigError(f"{name} must hold {' x '.join(f'{n:g}' for n in shape)} numbers, but has {len(data)}")
    return data.reshape([int(n) for n in shape])


def _size(nodes: Mapping[str, Any], asked: Asked) -> tuple[int, int]:
    found = [name for name in SIZE_NAMES if name in nodes]
    if found:
        return size(found[0], _array(nodes, found[0]).ravel())
    if "image_width" in nodes or "image_height" in nodes:
        return size("image_width, image_height", [entry(nodes, key) for key in ("image_width", "image_height")])
    if asked.size_px is None:
        raise RigError("says no image size (OpenCV's files often do not): give it with --size, like --size 640x480")
    return asked.size_px


def _camera(nodes: Mapping[str, Any], side: int, size_px: tuple[int, int]) -> Camera:
    K_name, D_name = _one_of(nodes, MATRIX_NAMES[side]), _one_of(nodes, DISTORTION_NAMES[side])
    K, d = numbers(K_name, _array(nodes, K_name), (3, 3)), _array(nodes, D_name).ravel()
    return camera(size_px, K, _lens(nodes, side, D_name, d), d, f"{K_name}, {D_name}: ")


def _lens(nodes: Mapping[str, Any], side: int, D_name: str, d: FloatArray) -> Lens:
    """Name the lens: a fisheye's four coefficients look just like k1 k2 p1 p2, so a file must say which it has."""
    model = nodes.get(f"distortion_model{side + 1}", nodes.get("distortion_model"))
    if model is not None:
        model = str(model)
        if model not in LENS_NAMES:
            raise RigError(f"distortion_model must be one of {', '.join(LENS_NAMES)}, but got {model!r:.40}")
        return LENS_NAMES[model]
    if D_name.endswith("_FE"):
        return "kannala_brandt"
    if len(d) == 4 and d.any():
        raise RigError(
            f"{D_name} has 4 coefficients, which may be k1 k2 p1 p2 or those of a fisheye: "
            "add the line 'distortion_model: plumb_bob' or 'distortion_model: equidistant'"
        )
    return "brown_conrady"


def write_opencv(rig: StereoRig) -> dict[str, str]:
    """Return the text of one FileStorage YAML file, in the dialect of the OpenCV that is installed.

    It holds every lens (named by `distortion_model1` and `2`) and the mounting (`T_vehicle_car`).
    """
    T_right_left = inverse(rig.T_left_right)
    storage = cv2.FileStorage("rig.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for name, value in zip(("image_width", "image_height"), rig.left.size_px, strict=True):
        storage.write(name, value)
    for number_, camera_ in ((1, rig.left), (2, rig.right)):
        d = camera_.distortion if len(camera_.distortion) else np.zeros(5)
        storage.write(f"M{number_}", camera_.K)
        storage.write(f"D{number_}", np.array(d).reshape(-1, 1))
        storage.write(f"distortion_model{number_}", _MODELS[camera_.lens])
    storage.write("R", T_right_left[:3, :3].copy())
    storage.write("T", T_right_left[:3, 3:].copy())
    if rig.T_vehicle_car is not None:
        storage.write("T_vehicle_car", rig.T_vehicle_car.copy())
    return {"": storage.releaseAndGetString()}
