"""What is known of things over time, against a drive's truth: tracks, velocities, times to contact, warnings.

A true frame holds `objects` with `id`, `velocity_mps` (over ground, along the vehicle's axes) and `ego` with
`speed_mps` and `T_world_vehicle`; fields that a result does not have leave the figure that needs them empty.
"""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from roadblock.eval.match import Record, boxes_of, overlaps
from roadblock.eval.plain import plain_record, share
from roadblock.eval.things import Judged, counts, is_at_depth
from roadblock.eval.tracks import SeenFrame
from roadblock.values.checks import FloatArray

TOUCHES, COVERS = 0.1, 0.5
"""A track is of a thing whose box overlaps its own by the first at the same depth, or by the second at any; one of no
thing follows something without a name, and is not judged."""
STRUCTURES = frozenset(("railing", "wall", "fence", "hedge", "building", "vegetation"))
"""Types that go on along the road: where one ends and the next begins is the truth's choice, so that an identity means
nothing. As in the tracking tasks of KITTI and nuScenes, they and their tracks count neither way."""
UNLIKE_M = 2.0
"""Places this far apart have nothing in common, as in TrackEval."""
SETTLED_S = 1.0
"""Velocities and times to contact are judged from this age on."""
STANDS_MPS, MOVES_MPS = 0.1, 0.5
VELOCITY_BANDS_M = ((0, 20), (20, 40), (0, 40))
TTC_BANDS_S = ((0, 1.5), (1.5, 2.5), (2.5, 4), (4, 8), (0, 8))
LEAST_CLOSING_MPS = 0.5
WARNED = ("warn", "brake", "swerve")
"""Actions of a frame's `decision` that are a warning."""
THREAT_S, CORRIDOR_M = 6.0, 1.5
"""A thing that comes level within this time, this near to the middle of the vehicle's way, is worth a warning."""


def seen_frame(found: Sequence[Record], true: Sequence[Record], by_place: bool = False) -> SeenFrame:
    """Return a frame for the judges of tracks.

    Parameters
    ----------
    found, true
        Its obstacles and things; of these, tracks and things that count are judged.
    by_place
        They are alike by their places on the road, `1 - distance / 2 m`, instead of the overlap of their boxes.
    """
    tracks = [o for o in found if o.get("id") is not None]
    is_judged = np.array([counts(t) and t["type"] not in STRUCTURES for t in true], bool)
    similarity = overlaps(boxes_of(true, "true"), boxes_of(tracks, "found"))
    level = np.array([[is_at_depth(o, t) for o in tracks] for t in true], bool).reshape(similarity.shape)
    touching = np.where(level | (similarity >= COVERS), similarity, 0)
    best = touching[is_judged].max(0, initial=0)
    known = (best > TOUCHES) & (best >= touching[~is_judged].max(0, initial=0))
    if by_place:
        places, true_places = (
            np.array([r["position_m"][:2] for r in records], float).reshape(-1, 2) for records in (tracks, true)
        )
        apart_m = np.linalg.norm(true_places[:, None] - places[None], axis=-1)
        similarity = np.maximum(0, 1 - apart_m / UNLIKE_M)
    return SeenFrame(
        np.array([t["id"] for t, judged in zip(true, is_judged, strict=True) if judged], np.int64),
        np.array([o["id"] for o, is_known in zip(tracks, known, strict=True) if is_known], np.int64),
        similarity[np.ix_(is_judged, known)],
    )


def velocity_rows(frames: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return errors of velocities over ground of what stands and of what moves, by range band.

    `normalized` is the mean squared error in units of the stated variances (1 if they are honest), `told_right` the
    share whose `motion` says so.
    """
    pairs = [(t, o) for frame in frames for t, o in frame.things if o is not None and _has_velocity(t, o)]
    rows = []
    for what in ("standing", "moving"):
        for low, high in VELOCITY_BANDS_M:
            mine = [(t, o) for t, o in pairs if _motion(t) == what and low <= t["range_m"] < high]
            if mine:
                error = np.array([_velocity_error(t, o) for t, o in mine])
                sigma = np.array([o.get("velocity_sigma_mps") or (np.nan, np.nan) for _, o in mine], float)
                off = np.hypot(*error.T)
                ratio = (error / sigma) ** 2
                row: dict[str, Any] = {"motion": what, "from_m": low, "to_m": high, "n": len(mine)}
                row |= {"rms_mps": np.sqrt((off**2).mean()), "median_mps": np.median(off)}
                row |= {"p95_mps": np.percentile(off, 95)}
                row |= {"normalized": ratio[np.isfinite(ratio)].mean() if np.isfinite(ratio).any() else math.nan}
                rows.append(plain_record({**row, "told_right": np.mean([o.get("motion") == what for _, o in mine])}))
    return rows


def _has_velocity(thing: Record, obstacle: Record) -> bool:
    is_known = None not in (thing.get("velocity_mps"), obstacle.get("velocity_mps"))
    return is_known and obstacle.get("velocity_over_ground") is not False and _is_settled(obstacle)


def _is_settled(obstacle: Record) -> bool:
    return bool((obstacle.get("age_s") or 0.0) >= SETTLED_S)


def _motion(thing: Record) -> str:
    speed = math.hypot(*thing["velocity_mps"][:2])
    return "standing" if speed < STANDS_MPS else "moving" if speed > MOVES_MPS else ""


def _velocity_error(thing: Record, obstacle: Record) -> list[float]:
    true = true_velocity_mps(thing, obstacle.get("position_m"))
    return [o - t for o, t in zip(obstacle["velocity_mps"][:2], true, strict=True)]


def true_velocity_mps(thing: Record, at_m: Sequence[float] | None) -> tuple[float, float]:
    """Return how fast a place on a thing moves, forwards and to the left: the rear of what turns swings out."""
    vx, vy = thing["velocity_mps"][:2]
    turn, center = thing.get("yaw_rate_radps"), thing.get("center_m")
    if not turn or center is None or at_m is None:
        return vx, vy
    return vx - turn * (at_m[1] - center[1]), vy + turn * (at_m[0] - center[0])


def true_ttc_s(thing: Record, ego: Record | None) -> float:
    """Return when a thing's nearest face is level with the cameras if both go on straight; NaN where it never is."""
    if ego is None or thing.get("velocity_mps") is None or thing.get("range_m") is None:
        return math.nan
    closing_mps = ego["speed_mps"] - thing["velocity_mps"][0]
    return float(thing["range_m"] / closing_mps) if closing_mps >= LEAST_CLOSING_MPS else math.nan


def ttc_rows(frames: Sequence[Judged], egos: Sequence[Record | None]) -> list[dict[str, Any]]:
    """Return relative errors of times to contact by true time; `unknown` is the share that states none."""
    pairs = [
        (true_ttc_s(t, ego), o)
        for frame, ego in zip(frames, egos, strict=True)
        for t, o in frame.things
        if o is not None and _is_settled(o)
    ]
    rows = []
    for low, high in TTC_BANDS_S:
        mine = [(true, o) for true, o in pairs if low <= true < high]
        stated = np.array([(true, o["ttc_s"], o.get("ttc_sigma_s") or math.nan) for true, o in mine if _ttc(o)], float)
        if mine:
            true, said, sigma = stated.reshape(-1, 3).T
            relative, has_sigma = np.abs(said / true - 1), np.isfinite(sigma)
            row = {"from_s": low, "to_s": high, "n": len(mine), "unknown": 1 - share(len(stated), len(mine))}
            row |= {"median": _or_nan(np.median, relative), "p95": _or_nan(lambda e: np.percentile(e, 95), relative)}
            within = (np.abs(said - true) <= 2 * sigma)[has_sigma]
            rows.append(plain_record({**row, "within_2_sigma": _or_nan(np.mean, within)}))
    return rows


def _ttc(obstacle: Record) -> bool:
    return obstacle.get("ttc_s") is not None


def _or_nan(figure: Any, values: FloatArray | Any) -> float:
    return float(figure(values)) if len(values) else math.nan


def driven_km(egos: Sequence[Record | None]) -> float:
    """Return how far the vehicle went, kilometres; NaN where a pose is unknown."""
    places = [None if ego is None else np.array(ego["T_world_vehicle"], float)[:3, 3] for ego in egos]
    return sum(_apart_m(a, b) for a, b in pairwise(places)) / 1000


def _apart_m(a: FloatArray | None, b: FloatArray | None) -> float:
    return math.nan if a is None or b is None else float(np.linalg.norm(b - a))


def warning_record(found: Sequence[Record], true: Sequence[Record]) -> dict[str, Any]:
    """Return how often the results warn, and how often without a thing that is worth it.

    Parameters
    ----------
    found, true
        Frames of one drive in order. A frame of the results warns if its `decision` has one of the actions `WARNED`;
        frames one after the other that do are one warning.

    Returns
    -------
    `warnings`, `false` and `false_per_km`, None where the results decide nothing, and `km`.
    """
    km = driven_km([frame.get("ego") for frame in true])
    if not any(frame.get("decision") for frame in found):
        return plain_record({"warnings": None, "false": None, "false_per_km": None, "km": km})
    warns = [(frame.get("decision") or {}).get("action") in WARNED for frame in found]
    starts = [k for k, is_on in enumerate(warns) if is_on and not (k and warns[k - 1])]
    false = sum(not any(_threatens(t, true[k].get("ego")) for t in true[k]["objects"]) for k in starts)
    return plain_record({"warnings": len(starts), "false": false, "false_per_km": share(false, km), "km": km})


def _threatens(thing: Record, ego: Record | None) -> bool:
    ttc_s = true_ttc_s(thing, ego)
    if not ttc_s <= THREAT_S:
        return False
    aside_m = thing["position_m"][1] + ttc_s * thing["velocity_mps"][1]
    return bool(abs(aside_m) - max(thing["size_m"][0], thing["size_m"][2]) / 2 <= CORRIDOR_M)
