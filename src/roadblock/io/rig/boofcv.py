"""BoofCV `stereo.yaml`: `rightToLeft` takes points of the right camera to the left one. Reading only.

Lengths are in the unit of the calibration target, often millimetres.
"""

from typing import Any

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import pose
from roadblock.io.rig.files import Asked, entry, parse_yaml, section
from roadblock.io.rig.numbers import camera, number, numbers, rotation, size
from roadblock.values.camera import Camera, StereoRig

MODELS = ("pinhole", "pinhole_radial_tangential")


def read_boofcv(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of a BoofCV stereo calibration.

    Parameters
    ----------
    texts
        The text of the one file.
    asked
        `unit_m` is the metres per unit of the calibration target.

    Raises
    ------
    RigError, ValueRefusedError
        If a lens is not supported, a value is missing or cannot be true.
    """
    document = parse_yaml(texts[0])
    cameras = [_camera(section(document, side), f"{side}.") for side in ("left", "right")]
    motion = section(document, "rightToLeft")
    R = numbers("rightToLeft.rotation", entry(motion, "rotation", "rightToLeft."), (9,)).reshape(3, 3)
    t = [number(f"rightToLeft.{axis}", entry(motion, axis, "rightToLeft.")) for axis in "xyz"]
    return StereoRig(cameras[0], cameras[1], pose(rotation("rightToLeft.rotation", R), asked.unit_m * np.array(t)))


def _camera(fields: dict[str, Any], where: str) -> Camera:
    model = entry(fields, "model", where)
    if model not in MODELS:
        raise RigError(f"{where}model must be {' or '.join(MODELS)}, but got {model!r:.40}")
    pinhole = section(fields, "pinhole", where)
    value = {
        key: number(f"{where}pinhole.{key}", entry(pinhole, key, f"{where}pinhole."))
        for key in ("fx", "fy", "cx", "cy", "skew", "width", "height")
    }
    K = np.array([[value["fx"], value["skew"], value["cx"]], [0, value["fy"], value["cy"]], [0, 0, 1]])
    size_px = size(f"{where}pinhole.width, height", (value["width"], value["height"]))
    d = _distortion(fields, where) if model == "pinhole_radial_tangential" else np.zeros(0)
    return camera(size_px, K, "brown_conrady", d, where)


def _distortion(fields: dict[str, Any], where: str) -> np.ndarray:
    """Return k1 k2 p1 p2 k3 of a list of one to three radial terms and t1, t2."""
    lens = section(fields, "radial_tangential", where)
    where = f"{where}radial_tangential."
    radial = numbers(f"{where}radial", entry(lens, "radial", where), (-1,))
    if len(radial) > 3:
        raise RigError(f"{where}radial may have up to 3 coefficients, but has {len(radial)}")
    k1, k2, k3 = np.r_[radial, np.zeros(3 - len(radial))]
    t1, t2 = (number(where + key, entry(lens, key, where)) for key in ("t1", "t2"))
    return np.array([k1, k2, t1, t2, k3])
