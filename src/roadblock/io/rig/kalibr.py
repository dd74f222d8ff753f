"""Kalibr camchain YAML: `cam0`, `cam1`; `T_cn_cnm1` takes points of the camera before to this one."""

from typing import Any

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import inverse
from roadblock.io.rig.files import Asked, entry, parse_yaml, section
from roadblock.io.rig.numbers import camera, listed, numbers, rigid, size
from roadblock.values.camera import Camera, Lens, StereoRig

LENSES: dict[str, tuple[Lens, int]] = {"radtan": ("brown_conrady", 4), "equidistant": ("kannala_brandt", 4)}


def read_kalibr(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of a camchain whose `cam0` is the left camera and `cam1` the right one.

    Parameters
    ----------
    texts
        The text of the one file.
    asked
        `unit_m` scales the translation.

    Raises
    ------
    RigError, ValueRefusedError
        If there are not two cameras, a model is not supported, or a value cannot be true.
    """
    document = parse_yaml(texts[0])
    names = [name for name in document if name.startswith("cam")]
    if len(names) != 2:
        raise RigError(f"must hold two cameras, cam0 and cam1, but holds {', '.join(names)}: keep the stereo pair")
    cameras = [_camera(section(document, name), f"{name}.") for name in ("cam0", "cam1")]
    T = entry(section(document, "cam1"), "T_cn_cnm1", "cam1.")
    T_right_left = rigid("cam1.T_cn_cnm1", numbers("cam1.T_cn_cnm1", T, (4, 4)), asked.unit_m)
    return StereoRig(cameras[0], cameras[1], inverse(T_right_left))


def _camera(fields: dict[str, Any], where: str) -> Camera:
    model = entry(fields, "camera_model", where)
    if model != "pinhole":
        raise RigError(f"{where}camera_model {model!r:.40} is not supported: calibrate with pinhole")
    fu, fv, pu, pv = numbers(f"{where}intrinsics", entry(fields, "intrinsics", where), (4,))
    size_px = size(f"{where}resolution", entry(fields, "resolution", where))
    K = np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]])
    distortion = str(entry(fields, "distortion_model", where))
    if distortion == "none":
        return camera(size_px, K, "pinhole", (), where)
    if distortion not in LENSES:
        known = ", ".join((*LENSES, "none"))
        raise RigError(f"{where}distortion_model must be one of {known}, but got {distortion!r:.40}")
    lens, count = LENSES[distortion]
    d = numbers(f"{where}distortion_coeffs", entry(fields, "distortion_coeffs", where), (count,))
    return camera(size_px, K, lens, d, where)


def write_kalibr(rig: StereoRig) -> dict[str, str]:
    """Return the text of one camchain.

    Raises
    ------
    RigError
        If a lens has more than k1 k2 p1 p2, or the rig has a mounting: the format has no room for either.
    """
    if rig.T_vehicle_car is not None:
        raise RigError("kalibr files have no room for the mounting T_vehicle_car: write roadblock or opencv instead")
    lines = []
    for name, camera_, other in (("cam0", rig.left, 1), ("cam1", rig.right, 0)):
        model, d = _distortion(name, camera_)
        lines += [f"{name}:", f"  cam_overlaps: [{other}]", "  camera_model: pinhole"]
        focal_center = (camera_.fx_px, camera_.fy_px, camera_.cx_px, camera_.cy_px)
        lines += [f"  intrinsics: {listed(focal_center)}"]
        lines += [f"  distortion_model: {model}", f"  distortion_coeffs: {listed(d)}"]
        lines += [f"  resolution: [{camera_.size_px[0]}, {camera_.size_px[1]}]", f"  rostopic: /{name}/image_raw"]
    lines += ["  T_cn_cnm1:", *(f"  - {listed(row)}" for row in inverse(rig.T_left_right))]
    return {"": "\n".join(lines) + "\n"}


def _distortion(name: str, camera_: Camera) -> tuple[str, list[float]]:
    d = camera_.distortion.tolist()
    if camera_.lens == "brown_conrady" and any(d[4:]):
        raise RigError(
            f"kalibr's radtan has k1 k2 p1 p2 only, but {name}'s lens has more coefficients that are not 0: "
            "write roadblock, opencv or ros instead"
        )
    models = {"pinhole": "none", "brown_conrady": "radtan", "kannala_brandt": "equidistant"}
    return models[camera_.lens], d[:4]
