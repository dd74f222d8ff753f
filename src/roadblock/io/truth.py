"""What is true of a recording: `truth.jsonl` of a simulated drive, KITTI's `label_2`, or maps of every pixel.

All give plain records or values, so that the judges need not know where the truth came from.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from roadblock.errors import RigError, SourceError
from roadblock.geometry.boxes import footprint, visible_face
from roadblock.geometry.pose import inverse, transform, vehicle_from_car
from roadblock.geometry.stereo import image_from_car
from roadblock.io.results import read_records
from roadblock.io.rig import read_rig
from roadblock.io.schema import Box, Record, Triple
from roadblock.io.sources.text import read_lines
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.scene import NEAREST_FACE_PERCENT
from roadblock.values.true_map import TrueMap

TRUTH, RIG, SCHEMA = "truth.jsonl", "rig.yaml", 1
MAPS = (("disp_occ_0", "obj_map"), ("disparity", "ids"))
"""Folders of disparities (256 steps a pixel, 0 = unknown) and of the things' numbers: KITTI 2015's, and ours."""
STEPS_PER_PX = 256
NEAREST_M = 0.1
"""What reaches nearer than this, or behind the cameras, is cut off there."""
KITTI_TYPES = {
    "Car": "car", "Van": "van", "Truck": "truck", "Pedestrian": "person", "Person_sitting": "person_sitting",
    "Cyclist": "cyclist", "Tram": "tram", "Misc": "misc",
}  # fmt: skip
DONT_CARE = "DontCare"


class TrueObjectRecord(Record):
    """One thing of a simulated frame; see docs/simulation.md."""

    id: int
    type: str
    box_px: Box
    range_m: Annotated[float, Field(gt=0)]
    position_m: Triple
    size_m: Triple
    visible_px: int
    center_m: Triple | None = None
    yaw_rad: float | None = None
    velocity_mps: Triple | None = None


class TrueEgoRecord(Record):
    """The vehicle itself."""

    T_world_vehicle: Annotated[list[Annotated[list[float], Field(min_length=4, max_length=4)]], Field(min_length=4)]
    speed_mps: float


class TrueFrameRecord(Record):
    """One line of `truth.jsonl`."""

    schema_: Literal[1] = Field(alias="schema")
    name: str
    t_ns: int
    objects: list[TrueObjectRecord]
    ego: TrueEgoRecord | None = None


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a recording.

    Attributes
    ----------
    path
        Where it came from.
    kind
        "simulated", "kitti labels", or None without named things.
    frames
        One record per frame with `name`, `t_ns`, `objects`, `doubts` (boxes where nobody knows) and `ego` (None where
        unknown). An object has `type`, `box_px`, `range_m` (to its nearest visible face), `position_m`, `size_m`
        (width, height, length along its own axes), `center_m`, `yaw_rad`; simulated ones also `id`, `visible_px` and
        `velocity_mps`, labelled ones `occluded`. `truncated` is the share of its outline that lies outside the picture:
        labelled, and found for simulated drives with a rectified rig and poses.
    maps
        Returns the true maps frame by frame; None where there are none.
    warnings
        What should be known about it.
    """

    path: Path
    kind: str | None
    frames: tuple[dict[str, Any], ...]
    maps: Callable[[], Iterator[TrueMap]] | None
    warnings: tuple[str, ...] = ()


def read_truth(path: Path | str) -> Truth:
    """Return all that a recording's folder, or a `truth.jsonl`, says is true.

    Raises
    ------
    SourceError
        If there is no truth, or it cannot be read.
    RigError, ValueRefusedError
        If the rig of a simulated drive cannot be read.
    """
    path = Path(path)
    file = path / TRUTH if path.is_dir() else path
    if file.is_file():
        records = read_records(file, TrueFrameRecord, SCHEMA, "truth")
        rig = read_rig(file.parent / RIG) if (file.parent / RIG).is_file() else None
        frames = tuple(record | {"objects": _with_cuts(record["objects"], rig), "doubts": []} for record in records)
        return Truth(path, "simulated", frames, _maps_of(path), _warnings(rig))
    labels, maps = path / "label_2", _maps_of(path)
    if not labels.is_dir() and maps is None:
        kinds = " or ".join(f"{disparity}/ with {ids}/" for disparity, ids in MAPS)
        raise SourceError(f"{path} holds no truth: expected {TRUTH}, label_2/, or maps ({kinds})")
    frames = tuple(_label_frame(path, file) for file in sorted(labels.glob("*.txt")))
    return Truth(path, "kitti labels" if labels.is_dir() else None, frames, maps)


def _with_cuts(objects: list[dict[str, Any]], rig: StereoRig | None) -> list[dict[str, Any]]:
    """Return things with the share of each that the picture cuts off, as KITTI's labels have it, where it is known."""
    if rig is None or not rig.is_rectified:
        return objects
    left, T_car_vehicle = rig.left, inverse(vehicle_from_car(rig.T_vehicle_car))
    twin = Rectification(left.fx_px, left.cx_px, left.cy_px, rig.baseline_m, left.size_px)
    return [
        thing if thing.get("center_m") is None else thing | {"truncated": _share_cut(thing, twin, T_car_vehicle)}
        for thing in objects
    ]


def _share_cut(thing: dict[str, Any], twin: Rectification, T_car_vehicle: FloatArray) -> float:
    width_m, height_m, length_m = thing["size_m"]
    outline = footprint(np.array(thing["center_m"]), thing["yaw_rad"], length_m, width_m)
    up_m = np.repeat([thing["center_m"][2] - height_m / 2, thing["center_m"][2] + height_m / 2], 4)
    corners = transform(T_car_vehicle, np.concatenate([np.tile(outline, (2, 1)), up_m[:, None]], 1))
    corners[:, 2] = np.maximum(corners[:, 2], NEAREST_M)
    uv = image_from_car(twin, corners)[:, :2]
    low, high = uv.min(0), uv.max(0)
    shown = np.clip(high, 0, twin.size_px) - np.clip(low, 0, twin.size_px)
    return float(1 - np.prod(shown) / np.prod(high - low))


def _warnings(rig: StereoRig | None) -> tuple[str, ...]:
    if rig is None or rig.is_rectified:
        return ()
    return (
        "the drive's images are not rectified: true boxes are in the raw left image, found ones in the rectified one, "
        "so that they overlap less than they should",
    )


def _maps_of(path: Path) -> Callable[[], Iterator[TrueMap]] | None:
    for disparity, ids in MAPS:
        if (path / disparity).is_dir() and (path / ids).is_dir():
            return lambda: _read_maps(path, disparity, ids)
    return None


def _read_maps(path: Path, disparity: str, ids: str) -> Iterator[TrueMap]:
    files = sorted((path / disparity).glob("*.png"))
    if not files:
        raise SourceError(f"{path / disparity} holds no .png files, but must hold true disparities")
    for file in files:
        steps, numbers = _image(file), _image(path / ids / file.name)
        d_px = np.where(steps > 0, steps.astype(np.float32) / STEPS_PER_PX, np.nan).astype(np.float32)
        yield TrueMap(file.stem, d_px, numbers.astype(np.uint16), *_twin(path, file.stem))


def _image(path: Path) -> NDArray[Any]:
    """Return a map of one channel."""
    data = path.read_bytes() if path.is_file() else b""
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data else None
    if image is None or image.ndim != 2:
        raise SourceError(f"{path} is missing or no picture of one channel: every true map needs one")
    return np.asarray(image)


def _twin(path: Path, name: str) -> tuple[float, float, float, float]:
    """Return focal length, centre and baseline of the rectified cameras of a frame."""
    if (path / RIG).is_file():
        rig = read_rig(path / RIG)
        if not rig.is_rectified:
            raise RigError(f"{path / RIG} is not rectified, but true disparities are")
        return rig.left.fx_px, rig.left.cx_px, rig.left.cy_px, rig.baseline_m
    left, right = _projections(path, name)
    return left[0, 0], left[0, 2], left[1, 2], (left[0, 3] - right[0, 3]) / left[0, 0]


def _projections(path: Path, name: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return P of the left and of the right colour camera: of the recording's `calib.txt`, or the frame's own."""
    files = [path / "calib.txt", *(path / folder / f"{name}.txt" for folder in ("calib", "calib_cam_to_cam"))]
    file = next((file for file in files if file.is_file()), None)
    if file is None:
        raise SourceError(f"{path} holds neither calib.txt nor calib/{name}.txt, which truth of KITTI needs")
    rows = {key: values.split() for _, line in read_lines(file) for key, _, values in [line.partition(":")]}
    try:
        left, right = (rows.get(f"P{i}") or rows[f"P_rect_{i:02d}"] for i in (2, 3))
        return np.array(left, float).reshape(3, 4), np.array(right, float).reshape(3, 4)
    except (KeyError, ValueError) as error:
        raise SourceError(f"{file} must hold P2 and P3, 12 numbers each, but has not ({error})") from error


def _label_frame(path: Path, file: Path) -> dict[str, Any]:
    left, right = _projections(path, file.stem)
    middle_m = -(left[0, 3] + right[0, 3]) / 2 / left[0, 0]  # between the cameras, in camera 0
    objects: list[dict[str, Any]] = []
    doubts: list[list[float]] = []
    for number, line in read_lines(file):
        kind, *words = line.split()
        try:
            values = [float(word) for word in words[:14]]
        except ValueError:
            values = []
        if len(values) != 14 or not np.isfinite(values).all() or kind not in (*KITTI_TYPES, DONT_CARE):
            raise SourceError(
                f"{file} line {number} is {line!r:.40}, but must be a type ({', '.join(KITTI_TYPES)}, {DONT_CARE}) "
                "and 14 numbers"
            )
        if kind == DONT_CARE:
            doubts.append(values[3:7])
        else:
            objects.append(_labelled(KITTI_TYPES[kind], values, middle_m))
    return {"name": file.stem, "t_ns": 0, "objects": objects, "doubts": doubts, "ego": None}


def _labelled(kind: str, values: list[float], middle_m: float) -> dict[str, Any]:
    """Return one label in the vehicle frame of a rig without mounting: x forward, y left, z up, from between the eyes.

    KITTI's place is the middle of the box's bottom, in camera 0 (x right, y down, z forward); its turn is about y down,
    0 = facing right.
    """
    truncated, occluded, _, u0, v0, u1, v1, height_m, width_m, length_m, x, y, z, turn_rad = values
    yaw_rad = float(np.arctan2(-np.cos(turn_rad), -np.sin(turn_rad)))
    center_m = [z, middle_m - x, height_m / 2 - y]
    range_m, side_m = visible_face(footprint(np.array(center_m), yaw_rad, length_m, width_m), NEAREST_FACE_PERCENT)
    is_ahead = bool(np.isfinite(range_m))
    return {
        "type": kind,
        "box_px": [u0, v0, u1 + 1, v1 + 1],
        "range_m": range_m if is_ahead else None,
        "position_m": [range_m, side_m, -y] if is_ahead else None,
        "size_m": [width_m, height_m, length_m],
        "center_m": center_m,
        "yaw_rad": yaw_rad,
        "occluded": int(occluded),
        "truncated": truncated,
    }
