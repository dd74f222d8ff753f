"""Our own `rig.yaml`: versioned, readable, every field checked, read back exactly."""

from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, cast, get_args

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import pose
from roadblock.geometry.uncertainty import range_sigma
from roadblock.io.rig.files import Asked, entry, parse_yaml, section
from roadblock.io.rig.numbers import digits, listed, number, numbers, size
from roadblock.values.calibration import RANGES_M
from roadblock.values.camera import POSE_PARAMETERS, Camera, Lens, RigCovariance, StereoRig
from roadblock.values.checks import FloatArray

VERSION = 1
_RIG_KEYS = ("roadblock_rig", "left", "right", "T_left_right", "T_vehicle_car", "calibration")
_CAMERA_KEYS = ("size_px", "fx_px", "fy_px", "cx_px", "cy_px", "lens", "distortion")
_POSE_KEYS = ("R", "t_m")
_CALIBRATION_KEYS = ("verdict", "covariance", "range_sigma_m")
_COVARIANCE_KEYS = ("names", "matrix")
FORCED = " # written by force: do not trust its ranges"
_LENGTHS = POSE_PARAMETERS[3:]


def read_native(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of one `rig.yaml`.

    Parameters
    ----------
    texts
        The text of the one file.
    asked
        `unit_m` scales the translations, and with them their covariance.

    Returns
    -------
    The rig; `range_sigma_m`, which follows from the covariance, is for people and not read.

    Raises
    ------
    RigError, ValueRefusedError
        If the version is another, a name is unknown or missing, or a value cannot be true.
    """
    document = parse_yaml(texts[0])
    version = entry(document, "roadblock_rig")
    if version != str(VERSION):
        raise RigError(f"roadblock_rig is version {version!r:.20}, but this program reads version {VERSION}: update it")
    _known(document, _RIG_KEYS, "")
    cameras = [_camera(section(document, side), f"{side}.") for side in ("left", "right")]
    mounting = document.get("T_vehicle_car")
    calibration = section(document, "calibration") if "calibration" in document else None
    return StereoRig(
        cameras[0],
        cameras[1],
        _pose("T_left_right", entry(document, "T_left_right"), asked.unit_m),
        T_vehicle_car=None if mounting is None else _pose("T_vehicle_car", mounting, asked.unit_m),
        covariance=None if calibration is None else _covariance(calibration, asked.unit_m),
        verdict=None if calibration is None else calibration.get("verdict"),
    )


def _known(mapping: Mapping[str, Any], allowed: tuple[str, ...], where: str) -> None:
    for key in mapping:
        if key not in allowed:
            near = get_close_matches(str(key), allowed, 1)
            hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(allowed)}"
            raise RigError(f"{where}{key} is no known name ({hint})"[:300])


def _camera(fields: dict[str, Any], where: str) -> Camera:
    _known(fields, _CAMERA_KEYS, where)
    size_px = size(f"{where}size_px", entry(fields, "size_px", where))
    fx, fy, cx, cy = (number(where + key, entry(fields, key, where)) for key in _CAMERA_KEYS[1:5])
    lens = entry(fields, "lens", where)
    if lens not in get_args(Lens):
        raise RigError(f"{where}lens must be one of {', '.join(get_args(Lens))}, but got {lens!r:.40}")
    given = fields.get("distortion", []) if lens == "pinhole" else entry(fields, "distortion", where)
    return Camera(size_px, fx, fy, cx, cy, cast(Lens, lens), numbers(f"{where}distortion", given, (-1,)))


def _pose(name: str, value: Any, unit_m: float) -> FloatArray:
    if isinstance(value, dict):
        _known(value, _POSE_KEYS, f"{name}.")
        R, t = (numbers(f"{name}.{k}", entry(value, k, f"{name}."), s) for k, s in (("R", (3, 3)), ("t_m", (3,))))
        return pose(R, unit_m * t)
    T = np.array(numbers(name, value, (4, 4)))
    T[:3, 3] *= unit_m
    return T


def _covariance(fields: dict[str, Any], unit_m: float) -> RigCovariance:
    where = "calibration.covariance."
    _known(fields, _CALIBRATION_KEYS, "calibration.")
    covariance = section(fields, "covariance", "calibration.")
    _known(covariance, _COVARIANCE_KEYS, where)
    names = entry(covariance, "names", where)
    if not (isinstance(names, list) and all(isinstance(name, str) for name in names)):
        raise RigError(f"{where}names must be a list of parameters' names, but got {names!r:.60}")
    matrix = numbers(f"{where}matrix", entry(covariance, "matrix", where), (len(names), len(names)))
    unit = np.array([unit_m if name in _LENGTHS else 1.0 for name in names])
    return RigCovariance(tuple(names), unit[:, None] * matrix * unit)


def write_native(rig: StereoRig) -> dict[str, str]:
    """Return the text of one `rig.yaml`; it holds every rig exactly."""
    lines = [
        "# A stereo rig: metres, pixels; pixel (0, 0) is the centre of the top-left one.",
        f"roadblock_rig: {VERSION}",
    ]
    for side, camera in (("left", rig.left), ("right", rig.right)):
        lines += [f"{side}:", f"  size_px: [{camera.size_px[0]}, {camera.size_px[1]}]"]
        lines += [f"  {key}: {digits(getattr(camera, key))}" for key in _CAMERA_KEYS[1:5]]
        lines += [f"  lens: {camera.lens}", f"  distortion: {listed(camera.distortion)}"]
    lines += ["# p_left = T_left_right p_right", *_matrix("T_left_right", rig.T_left_right)]
    if rig.T_vehicle_car is not None:
        lines += ["# p_vehicle = T_vehicle_car p_car", *_matrix("T_vehicle_car", rig.T_vehicle_car)]
    if rig.covariance is not None:
        lines += _calibration(rig, rig.covariance)
    return {"": "\n".join(lines) + "\n"}


def _calibration(rig: StereoRig, covariance: RigCovariance) -> list[str]:
    verdict = [] if rig.verdict is None else [f"  verdict: {rig.verdict}{FORCED * (rig.verdict == 'refused')}"]
    lines = [
        "# How sure it is: covariance of the parameters in their units, R_left_right <- exp([r]) R_left_right.",
        "calibration:",
        *verdict,
        "  covariance:",
        f"    names: [{', '.join(covariance.names)}]",
        "    matrix:",
        *(f"      - {listed(row)}" for row in covariance.matrix),
        "  # Standard deviation of the range, metres, by distance, over the left image (rows from the top; null where",
        "  # not both cameras see that point). It follows from the covariance and is not read back.",
        "  range_sigma_m:",
    ]
    for distance_m in RANGES_M:
        lines.append(f"    {distance_m:g}:")
        lines += [f"      - [{', '.join(map(_rounded, row))}]" for row in range_sigma(rig, distance_m)]
    return lines


def _rounded(value: float) -> str:
    return digits(float(f"{value:.3g}")) if np.isfinite(value) else "null"


def _matrix(name: str, T: FloatArray) -> list[str]:
    return [f"{name}:", *(f"  - {listed(row)}" for row in T)]
