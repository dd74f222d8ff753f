"""ZED factory calibrations `SN<serial>.conf` (INI, several resolutions, millimetres). Reading only."""

from configparser import ConfigParser, Error, SectionProxy

import numpy as np

from roadblock.errors import RigError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.io.rig.files import Asked
from roadblock.io.rig.numbers import by, camera, number
from roadblock.values.camera import Camera, Lens, StereoRig
from roadblock.values.checks import FloatArray

SIZES_PX = {
    "2K": (2208, 1242),
    "FHD1200": (1920, 1200),
    "FHD": (1920, 1080),
    "HD": (1280, 720),
    "SVGA": (960, 600),
    "VGA": (672, 376),
}
DERIVED = {"FHD": ("FHD1200", 1.0, 60.0), "SVGA": ("FHD1200", 0.5, 0.0)}
"""Resolution -> the one it is cut or shrunk from, its scale, and the rows cut off above."""

UNIT_M = 1e-3
_BROWN, _FISHEYE = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), ("k1", "k2", "k3", "k4")


def read_zed(texts: tuple[str, ...], asked: Asked) -> StereoRig:
    """Return the rig of one resolution of a ZED's file: `x_right = R x_left + T` with `T = (-Baseline, TY, TZ)` mm.

    Parameters
    ----------
    texts
        The text of the one file.
    asked
        `size_px` chooses the resolution where there are several; `unit_m` scales lengths on top of the millimetre.

    Raises
    ------
    RigError, ValueRefusedError
        If it is no INI file, the resolution stays open or is not there, or a value is missing or cannot be true.
    """
    ini = ConfigParser(interpolation=None)
    try:
        ini.read_string(texts[0])
    except Error as error:
        raise RigError(f"is not a valid INI file: {' '.join(str(error).split())}"[:200]) from error
    resolution = _resolution(ini, asked)
    cameras = [_camera(ini, side, resolution) for side in ("LEFT", "RIGHT")]
    stereo = _section(ini, "STEREO")
    T = [-_value(stereo, "Baseline"), _either(stereo, "TY", resolution), _either(stereo, "TZ", resolution)]
    R = rotation_from_rotvec([_either(stereo, key, resolution) for key in ("RX", "CV", "RZ")])
    return StereoRig(cameras[0], cameras[1], inverse(pose(R, UNIT_M * asked.unit_m * np.array(T))))


def _resolution(ini: ConfigParser, asked: Asked) -> str:
    there = [name for name in SIZES_PX if ini.has_section(f"LEFT_CAM_{name}")]
    derived = [name for name, (source, *_) in DERIVED.items() if source in there and name not in there]
    words = ", ".join(f"{name} {by(SIZES_PX[name])}" for name in (*there, *derived)) or "none"
    if asked.size_px is not None:
        found = [name for name in (*there, *derived) if SIZES_PX[name] == asked.size_px]
        if not found:
            raise RigError(f"has no calibration for images of {by(asked.size_px)}; there is {words}")
        return found[0]
    if len(there) != 1:
        raise RigError(f"must be told the resolution with --size; there is {words}")
    return there[0]


def _camera(ini: ConfigParser, side: str, resolution: str) -> Camera:
    source, scale, cut = (resolution, 1.0, 0.0)
    if not ini.has_section(f"{side}_CAM_{resolution}") and resolution in DERIVED:
        source, scale, cut = DERIVED[resolution]
    name = f"{side}_CAM_{source}"
    fields = _section(ini, name)
    fx, fy, cx, cy = (scale * _value(fields, key) for key in ("fx", "fy", "cx", "cy"))
    K = np.array([[fx, 0, cx], [0, fy, cy - cut], [0, 0, 1]])
    lens, d = _distortion(ini[f"{side}_DISTO"] if ini.has_section(f"{side}_DISTO") else fields)
    return camera(SIZES_PX[resolution], K, lens, d, f"[{name}] ")


def _distortion(fields: SectionProxy) -> tuple[Lens, FloatArray]:
    """Return the lens and its coefficients: a fisheye's section has k1..k4 and neither p1 nor p2."""
    if "k4" in fields and "p1" not in fields and "p2" not in fields:
        return "kannala_brandt", np.array([_value(fields, key) for key in _FISHEYE])
    names = _BROWN if "k4" in fields else _BROWN[:5]
    return "brown_conrady", np.array([_value(fields, key) for key in names])


def _section(ini: ConfigParser, name: str) -> SectionProxy:
    if not ini.has_section(name):
        raise RigError(f"section [{name}] is missing (found: {', '.join(ini.sections()) or 'none'})"[:300])
    return ini[name]


def _value(fields: SectionProxy, key: str) -> float:
    if key not in fields:
        raise RigError(f"[{fields.name}] {key} is missing (found: {', '.join(fields)})"[:300])
    return number(f"[{fields.name}] {key}", fields[key])


def _either(stereo: SectionProxy, key: str, resolution: str) -> float:
    """Return `KEY_<RES>` (also of the resolution it is derived from), else the `KEY` that is for all."""
    source = DERIVED[resolution][0] if resolution in DERIVED else resolution
    names = (f"{key}_{resolution}", f"{key}_{source}", key)
    return _value(stereo, next((name for name in names if name in stereo), names[0]))
