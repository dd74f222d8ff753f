"""A scene is driven through and recorded: image pairs, time stamps and exact truth on disk, frame by frame.

An interrupted recording goes on where it stopped, and ends up with the same bytes.
"""

import dataclasses
import errno
import hashlib
import json
import math
import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import roadblock
from roadblock.errors import OutputError, ValueRefusedError
from roadblock.geometry.pose import inverse, transform, vehicle_from_car
from roadblock.sim.conditions import Effects
from roadblock.sim.photograph import photograph
from roadblock.sim.render import QUALITIES, Rendered
from roadblock.sim.scene import Scene
from roadblock.sim.sensor import in_range, whole
from roadblock.sim.solids import Thing
from roadblock.sim.truth import TrueObject
from roadblock.values.camera import StereoRig
from roadblock.values.frame import Image

TRUTH_SCHEMA = 1
"""Version of the record."""

PLAN, TRUTH, STAMPS = "simulate.json", "truth.jsonl", "timestamps.txt"
"""What made the drive, the truth of each frame, and when each was taken (ns since the start)."""

FOLDERS = ("left", "right", "disparity", "ids")
DISPARITY_STEPS = 256
"""Steps per pixel of the disparity maps; 0 = unknown."""

PREVIEW_S = 1.0
"""Scenes that look alike now and so much later are one scene."""


@dataclass(frozen=True)
class DriveSettings:
    """How a scene is recorded.

    Attributes
    ----------
    frames
        How many pairs.
    fps
        Pairs per second.
    seed
        Of noise, rain, and what is on the lenses.
    quality
        Of the rendering, a name of `QUALITIES`.
    effects
        Cameras and weather.
    maps
        Whether the ids and disparities of every left pixel are written as well.

    Raises
    ------
    ValueRefusedError
        If a number is outside of what it can be.
    """

    frames: int = 30
    fps: float = 10.0
    seed: int = 0
    quality: str = "demo"
    effects: Effects = field(default_factory=Effects)
    maps: bool = False

    def __post_init__(self) -> None:
        whole("frames", self.frames, 1, 1_000_000)
        whole("seed", self.seed, 0, 2**63)
        in_range("fps", self.fps, 1e-3, 1e3)
        if self.quality not in QUALITIES:
            raise ValueRefusedError(f"quality must be one of {', '.join(QUALITIES)}, but got {self.quality!r:.40}")

    def t_ns(self, index: int) -> int:
        """Return when a frame is taken, ns since the start."""
        return round(index * 1e9 / self.fps)


def simulate(scene: Scene, rig: StereoRig, settings: DriveSettings, out: Path) -> Iterator[int]:
    """Record a drive into a folder; yield the number of frames that are there, first before any is taken.

    The folder then holds `left/` and `right/` (PNG), `timestamps.txt`, `truth.jsonl`, `simulate.json`, and with maps
    `ids/` and, if the rig is rectified, `disparity/` (16 bit PNG): a recording but for its rig file, which whoever
    calls writes beside it. Each frame is there whole or not at all. The same arguments give the same bytes, interrupted
    or not.

    Parameters
    ----------
    scene
        The world at the first frame.
    rig
        The cameras.
    settings
        How it is recorded.
    out
        The folder; made if need be. What it holds of the same drive is kept.

    Raises
    ------
    OutputError
        If the folder holds another drive or something else, or cannot be written.
    """
    done = _resume(out, _plan(scene, rig, settings), settings, _folders(settings, rig))
    return _record(scene, rig, settings, out, done)


def _record(scene: Scene, rig: StereoRig, settings: DriveSettings, out: Path, done: int) -> Iterator[int]:
    yield done
    for index in range(done, settings.frames):
        t_ns = settings.t_ns(index)
        now = scene.at(t_ns / 1e9)
        taken = photograph(
            now,
            rig,
            settings.effects,
            quality=settings.quality,
            seed=settings.seed,
            index=index,
            name=f"{index:06d}",
            t_ns=t_ns,
        )
        _write_frame(out, taken, truth_record(taken, now, rig), settings.maps)
        yield index + 1


def _plan(scene: Scene, rig: StereoRig, settings: DriveSettings) -> dict[str, Any]:
    """Return what a drive is made of, as plain JSON values."""
    worlds = [plain(scene), plain(scene.at(PREVIEW_S))]
    return {
        "schema": TRUTH_SCHEMA,
        "version": roadblock.__version__,
        **plain(settings),
        "scene_sha256": _digest(worlds),
        "rig_sha256": _digest(plain(rig)),
    }


def plain(value: object) -> Any:
    """Return a value as plain JSON values: dataclasses as dicts, arrays as lists, infinity as text, code as None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return None if callable(value) else value


def _digest(value: object) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _resume(out: Path, plan: dict[str, Any], settings: DriveSettings, folders: tuple[str, ...]) -> int:
    """Make the folder ready and return how many whole frames of this very drive it holds."""
    try:
        out.mkdir(parents=True, exist_ok=True)
        if (out / PLAN).exists():
            _check_plan(out, plan)
        elif others := [name for name in (*FOLDERS, TRUTH, STAMPS) if os.path.lexists(out / name)]:
            raise OutputError(
                f"{out} holds {others[0]} of something else than a drive (no {PLAN} beside it): "
                "choose another folder with --out"
            )
        else:
            _write_whole(out / PLAN, (json.dumps(plan, indent=2, allow_nan=False) + "\n").encode())
        _write_whole(out / STAMPS, "".join(f"{settings.t_ns(i)}\n" for i in range(settings.frames)).encode())
        return _keep_whole_frames(out, folders, settings.frames)
    except OSError as error:
        raise OutputError(_cannot_write(out, error)) from error


def _check_plan(out: Path, plan: dict[str, Any]) -> None:
    try:
        found = json.loads((out / PLAN).read_bytes())
        if not isinstance(found, dict):
            raise TypeError
    except (ValueError, TypeError, RecursionError) as error:
        raise OutputError(f"{out / PLAN} is no record of a drive: choose another folder with --out") from error
    differing = [key for key in plan if key not in found or found[key] != plan[key]]
    if differing:
        what = ", ".join(_difference(key, found.get(key), plan[key]) for key in differing)
        raise OutputError(
            f"{out} holds a drive with other settings ({what}): ask for the same, or choose another folder with --out"
        )


def _difference(key: str, found: object, asked: object) -> str:
    """Say in short what differs."""
    if key.endswith("_sha256"):
        return f"another {key.removesuffix('_sha256')}"
    if isinstance(asked, dict):
        return f"other {key}"
    return f"{key} {found!s:.20}, asked for {asked!s:.20}"


def _folders(settings: DriveSettings, rig: StereoRig) -> tuple[str, ...]:
    """Return where images go; raw images have no disparities."""
    maps = ("disparity", "ids") if rig.is_rectified else ("ids",)
    return ("left", "right", *(maps if settings.maps else ()))


def _keep_whole_frames(out: Path, folders: tuple[str, ...], frames: int) -> int:
    """Cut off what an interruption left unfinished; return the number of whole frames."""
    for name in folders:
        (out / name).mkdir(exist_ok=True)
    lines = (out / TRUTH).read_bytes().split(b"\n")[:-1] if (out / TRUTH).exists() else []
    done = 0
    while done < min(len(lines), frames) and all((out / f / f"{done:06d}.png").is_file() for f in folders):
        done += 1
    _write_whole(out / TRUTH, b"".join(line + b"\n" for line in lines[:done]))
    for name in folders:
        for path in (out / name).glob("*.png*"):
            if not (path.suffix == ".png" and path.stem.isdecimal() and int(path.stem) < done):
                path.unlink()
    return done


def _write_frame(out: Path, taken: Rendered, truth: dict[str, Any], maps: bool) -> None:
    """Write one frame, whole or not at all: its truth last."""
    images: dict[str, Image] = {"left": taken.pair.left, "right": taken.pair.right}
    if maps:
        images["ids"] = taken.ids.astype(np.uint16)
        if taken.disparity is not None:
            images["disparity"] = coded_disparity(taken.disparity.d_px)
    paths = {folder: out / folder / f"{taken.pair.name}.png" for folder in images}
    line = json.dumps(truth, allow_nan=False, separators=(",", ":")).encode() + b"\n"
    try:
        with (out / TRUTH).open("ab", buffering=0) as file:
            end = file.tell()
            try:
                for folder, image in images.items():
                    paths[folder].with_suffix(".png.part").write_bytes(_png(image))
                for path in paths.values():
                    path.with_suffix(".png.part").replace(path)
                if file.write(line) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            except BaseException:
                file.truncate(end)
                for path in paths.values():
                    path.unlink(missing_ok=True)
                    path.with_suffix(".png.part").unlink(missing_ok=True)
                raise
    except OSError as error:
        raise OutputError(_cannot_write(out, error)) from error


def coded_disparity(d_px: NDArray[np.float32]) -> NDArray[np.uint16]:
    """Return disparities (NaN = unknown) in steps of 1/256 px, 0 = unknown."""
    steps = np.clip(np.rint(np.nan_to_num(d_px, nan=0.0) * DISPARITY_STEPS), 0, 65535)
    return np.asarray(np.where(np.isnan(d_px), 0, np.maximum(steps, 1)), np.uint16)


def _png(image: Image) -> bytes:
    done, data = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image)
    assert done, "a grey or RGB image of 8 or 16 bit can always be written as PNG"  # noqa: S101
    return data.tobytes()


def _write_whole(path: Path, data: bytes) -> None:
    beside = path.with_name(f".{path.name}.part")
    try:
        beside.write_bytes(data)
        beside.replace(path)
    except OSError:
        with suppress(OSError):
            beside.unlink()
        raise


def _cannot_write(path: Path, error: OSError) -> str:
    return f"cannot write {error.filename or path}: {error.strerror or error}; choose another folder, or free this one"


def truth_record(rendered: Rendered, scene: Scene | None = None, rig: StereoRig | None = None) -> dict[str, Any]:
    """Return the truth of one picture as plain JSON values; unknown is None, never NaN.

    Parameters
    ----------
    rendered
        The picture.
    scene, rig
        What it shows at its moment, and through what: for poses and motion, which are None without them.
    """
    pair, ground = rendered.pair, rendered.ground
    return {
        "schema": TRUTH_SCHEMA,
        "frame": pair.index,
        "name": pair.name,
        "t_ns": pair.t_ns,
        "objects": [_object_record(true) | _motion_record(true, scene, rig) for true in rendered.objects],
        # Adding zero turns a level road's -0.0 into 0.0.
        "ground": {
            "height_m": ground.height_m,
            "pitch_rad": ground.pitch_rad + 0.0,
            "roll_rad": ground.roll_rad + 0.0,
        },
        "ego": None if scene is None or rig is None else _ego_record(scene, rig),
    }


def _object_record(true: TrueObject) -> dict[str, Any]:
    return {
        "id": true.id,
        "type": true.type,
        "color": true.color or None,
        "position_m": true.position_m.tolist(),
        "range_m": true.range_m,
        "mean_range_m": true.mean_range_m,
        "size_m": true.size_m.tolist(),
        "box_px": list(true.box_px),
        "visible_px": true.visible_px,
    }


def _motion_record(true: TrueObject, scene: Scene | None, rig: StereoRig | None) -> dict[str, Any]:
    if scene is None or rig is None:
        return {"center_m": None, "yaw_rad": None, "velocity_mps": None, "yaw_rate_radps": None}
    thing: Thing = next(thing for thing in scene.things if thing.id == true.id)
    T_vehicle_world = inverse(_vehicle_pose(scene, rig))
    T = T_vehicle_world @ thing.T_world_thing
    return {
        "center_m": transform(T, thing.bounds_m(np.eye(4)).mean(0)).tolist(),
        "yaw_rad": float(np.arctan2(T[1, 0], T[0, 0])),
        "velocity_mps": (T_vehicle_world[:3, :3] @ thing.velocity_mps + 0.0).tolist(),
        "yaw_rate_radps": float(thing.yaw_rate_radps) + 0.0,
    }


def _ego_record(scene: Scene, rig: StereoRig) -> dict[str, Any]:
    return {"T_world_vehicle": (_vehicle_pose(scene, rig) + 0.0).tolist(), "speed_mps": float(scene.speed_mps)}


def _vehicle_pose(scene: Scene, rig: StereoRig) -> NDArray[np.float64]:
    """Return `T_world_vehicle`."""
    return np.asarray(scene.T_world_car @ inverse(vehicle_from_car(rig.T_vehicle_car)))
