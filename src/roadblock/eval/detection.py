"""Average precision of found obstacles against named true things, by KITTI's and by nuScenes's rules."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from roadblock.eval.average_precision import Candidates, distance_average_precision, kitti_average_precision
from roadblock.eval.match import Record, boxes_of, overlaps
from roadblock.eval.plain import plain_record
from roadblock.eval.things import ANY, Judged, class_of, share_inside
from roadblock.geometry.boxes import footprint, polygon_overlap
from roadblock.values.checks import FloatArray

Frame = tuple[Sequence[Record], Sequence[Record], Sequence[Sequence[float]]]
"""Found obstacles, true things and doubts of one frame."""

LEVELS = {"easy": (40, 0, 0.15), "moderate": (25, 1, 0.30), "hard": (25, 2, 0.50)}
"""Least height in pixels, worst occlusion and truncation of the things that count."""
LEAST_OVERLAP = {"car": 0.7}
OTHER_OVERLAP = 0.5
ALIKE = {"car": "van", "person": "person_sitting"}
"""Things of the second type count neither way for the first class."""
DISTANCES_M = (0.5, 1.0, 2.0, 4.0)


def surety(obstacle: Record) -> float:
    """Return by how much an obstacle goes before others: its score, else its class's probability, else its nearness."""
    for key in ("score", "class_probability"):
        if obstacle.get(key) is not None:
            return float(obstacle[key])
    return 1 / (1 + float(obstacle["range_m"]))


def kitti_rows(frames: Sequence[Frame]) -> list[dict[str, Any]]:
    """Return AP over 40 recalls by class, in the image (`ap_2d`) and from above (`ap_bev`), for three levels.

    `any` takes all classes as one. `ap_bev` is None where no obstacle has a length.
    """
    names = {class_of(o.get("class")) for found, _, _ in frames for o in found}
    types = {str(t["type"]) for _, true, _ in frames for t in true}
    has_length = any(_outline(o) is not None for found, _, _ in frames for o in found)
    rows = []
    for name in (ANY, *sorted(types & names)):
        least = LEAST_OVERLAP.get(name, OTHER_OVERLAP)
        for level in LEVELS:
            row: dict[str, Any] = {"class": name, "level": level, "least_overlap": least}
            for key, overlap in (("ap_2d", _image_overlaps), ("ap_bev", _road_overlaps)):
                chosen = [_kitti_candidates(frame, name, level, overlap) for frame in frames]
                is_possible = key == "ap_2d" or has_length
                row[key] = kitti_average_precision(chosen, least) if is_possible else math.nan
            rows.append(plain_record(row))
    return rows


def _kitti_candidates(
    frame: Frame, name: str, level: str, overlap: Callable[[Sequence[Record], Sequence[Record]], FloatArray]
) -> Candidates:
    found, true, doubts = frame
    least_px, occluded, truncated = LEVELS[level]
    mine = [o for o in found if name in (ANY, class_of(o.get("class")))]
    things = [t for t in true if name == ANY or t["type"] in (name, ALIKE.get(name))]
    is_optional = [
        name not in (ANY, t["type"])
        or t["box_px"][3] - t["box_px"][1] < least_px
        or (t.get("occluded") or 0) > occluded
        or (t.get("truncated") or 0) > truncated
        for t in things
    ]
    return Candidates(
        np.array([surety(o) for o in mine], float),
        overlap(mine, things),
        np.array([o["box_px"][3] - o["box_px"][1] < least_px for o in mine], bool),
        np.array(is_optional, bool),
        np.array([max((share_inside(o["box_px"], box) for box in doubts), default=0.0) for o in mine], float),
    )


def _image_overlaps(found: Sequence[Record], true: Sequence[Record]) -> FloatArray:
    return overlaps(boxes_of(found, "found"), boxes_of(true, "true"))


def _road_overlaps(found: Sequence[Record], true: Sequence[Record]) -> FloatArray:
    outlines, true_outlines = [_outline(o) for o in found], [_true_outline(t) for t in true]
    rows = [[0.0 if a is None or b is None else polygon_overlap(a, b) for b in true_outlines] for a in outlines]
    return np.array(rows, float).reshape(len(found), len(true))


def _outline(obstacle: Record) -> FloatArray | None:
    """Return an obstacle's footprint: its length lies along x unless it says its heading; None without a length."""
    width_m, _, length_m = obstacle["size_m"]
    if length_m is None or width_m is None:
        return None
    yaw_rad = obstacle.get("heading_rad") or 0.0
    depth_m = length_m * abs(math.cos(yaw_rad)) + width_m * abs(math.sin(yaw_rad))
    x_m, y_m, _ = obstacle["position_m"]
    return footprint(np.array([x_m + depth_m / 2, y_m]), yaw_rad, length_m, width_m)


def _true_outline(thing: Record) -> FloatArray | None:
    if thing.get("center_m") is None or thing.get("yaw_rad") is None:
        return None
    width_m, _, length_m = thing["size_m"]
    return footprint(np.array(thing["center_m"], float), thing["yaw_rad"], length_m, width_m)


def distance_rows(frames: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return AP by class for each of the distances 0.5, 1, 2 and 4 m on the road, and their mean.

    Places are the middle of the nearest visible face, of obstacles and things alike: a camera does not see a thing's
    centre. What counts neither way in `eval.things` does not here.
    """
    names = {class_of(o.get("class")) for frame in frames for o, _ in frame.claims}
    types = {class_of(t["type"]) for frame in frames for t, _ in frame.things}
    rows = []
    for name in (ANY, *sorted(types & names)):
        chosen = [_distance_candidates(frame, name) for frame in frames]
        values = [distance_average_precision(chosen, limit_m) for limit_m in DISTANCES_M]
        row = {"class": name, **{f"ap_{limit:g}m": v for limit, v in zip(DISTANCES_M, values, strict=True)}}
        rows.append(plain_record({**row, "ap": float(np.mean(values))}))
    return rows


def _distance_candidates(frame: Judged, name: str) -> Candidates:
    mine = [o for o, _ in frame.claims if name in (ANY, class_of(o.get("class")))]
    things = [t for t, _ in frame.things if name in (ANY, class_of(t["type"]))]
    places, true_places = (
        np.array([r["position_m"][:2] for r in records], float).reshape(-1, 2) for records in (mine, things)
    )
    apart_m = np.linalg.norm(places[:, None] - true_places[None], axis=-1)
    nothing = np.zeros(len(mine))
    return Candidates(
        np.array([surety(o) for o in mine], float), apart_m, nothing > 0, np.zeros(len(things), bool), nothing
    )
