"""Found obstacles against named true things: recall, precision, ranges, sizes and types. Plain records in and out.

Frames come as pairs of what was found (`obstacles` of a line of `obstacles.jsonl`) and what is true: `objects` with
`type`, `box_px`, `range_m`, `size_m` and where known `yaw_rad`, `visible_px`, `occluded`, `truncated`; and `doubts`,
boxes where nobody knows what is there.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from roadblock.eval.accuracy import Reading, accuracy
from roadblock.eval.match import Record, pair_up
from roadblock.eval.plain import plain_record, share

EDGES_M = (0, 10, 20, 30, 40, 60)
"""Ends of the range bands; things from the last one on are not judged."""
BANDS_M = (*pairwise(EDGES_M), (EDGES_M[0], EDGES_M[-1]))
LEAST_VISIBLE_PX, LEAST_HEIGHT_PX = 400, 25
WORST_OCCLUDED, WORST_TRUNCATED = 2, 0.5
"""True things that are smaller, more hidden or more cut off than these count neither way."""
CLASSES = {
    "van": "car", "bus": "truck", "tram": "truck", "fence": "railing", "building": "wall", "hedge": "vegetation",
    "tree": "vegetation", "box": "debris", "cone": "debris", "stone": "debris", "tyre": "debris",
    "person_sitting": "person",
}  # fmt: skip
"""Names that mean, for a confusion, the same as another one."""
UNKNOWN, MISSED, ANY = "unknown", "missed", "any"
SIZES = ("width", "height", "length")
SIZE_TO_M, SIZE_SHARE = 0.05, 0.05
"""A size is right within 5 cm or 5 %."""


@dataclass(frozen=True)
class Judged:
    """One frame's things and obstacles, paired.

    Attributes
    ----------
    things
        Pairs of a true thing that counts and the obstacle that is it, None where it was missed.
    claims
        Obstacles that count, each with the true thing it is, or "piece" (of a thing that has another obstacle), or None
        where nothing named explains it.
    """

    things: tuple[tuple[Record, Record | None], ...]
    claims: tuple[tuple[Record, Record | str | None], ...]


def class_of(name: object) -> str:
    """Return the class that a name stands for."""
    return CLASSES.get(str(name), str(name))


def counts(thing: Record, reach_m: float = EDGES_M[-1]) -> bool:
    """Whether a true thing is near, large and open enough to be looked for."""
    _, v0, _, v1 = thing["box_px"]
    visible = thing.get("visible_px")
    return (
        thing.get("range_m") is not None
        and thing["range_m"] < reach_m
        and (v1 - v0 >= LEAST_HEIGHT_PX if visible is None else visible >= LEAST_VISIBLE_PX)
        and (thing.get("occluded") or 0) <= WORST_OCCLUDED
        and (thing.get("truncated") or 0) <= WORST_TRUNCATED
    )


def judge_frame(found: Sequence[Record], true: Sequence[Record], doubts: Sequence[Sequence[float]] = ()) -> Judged:
    """Return a frame's things and obstacles, paired by `eval.match`.

    An obstacle counts neither way where it is a thing that does not count, or lies half in a doubt. It is a piece where
    it lies half in a thing's box, within 1 m or 10 % of its range.

    Raises
    ------
    ValueRefusedError
        If a record is none (see `eval.match`).
    """
    located = [thing for thing in true if thing.get("range_m") is not None]
    near = [o for o in found if o["range_m"] < EDGES_M[-1]]
    pairs = pair_up(near, located)
    things = [(t, None if k is None else near[k]) for t, k in zip(located, pairs, strict=True) if counts(t)]
    taken = {k: t for t, k in zip(located, pairs, strict=True) if k is not None}
    claims: list[tuple[Record, Record | str | None]] = []
    for k, obstacle in enumerate(near):
        thing = taken.get(k)
        if thing is not None and counts(thing):
            claims.append((obstacle, thing))
        elif thing is None and all(share_inside(obstacle["box_px"], box) < 0.5 for box in doubts):
            claims.append((obstacle, "piece" if any(_is_piece(obstacle, t) for t in located) else None))
    return Judged(tuple(things), tuple(claims))


def share_inside(box: Sequence[float], other: Sequence[float]) -> float:
    """Return how much of a box lies in another one, 0..1."""
    width, height = min(box[2], other[2]) - max(box[0], other[0]), min(box[3], other[3]) - max(box[1], other[1])
    return max(width, 0) * max(height, 0) / ((box[2] - box[0]) * (box[3] - box[1]))


def _is_piece(obstacle: Record, thing: Record) -> bool:
    return share_inside(obstacle["box_px"], thing["box_px"]) >= 0.5 and is_at_depth(obstacle, thing)


def is_at_depth(obstacle: Record, thing: Record) -> bool:
    """Whether an obstacle's range is one that some part of a thing has, to 1 m or 10 %; never where that is unknown."""
    if thing.get("range_m") is None:
        return False
    depth_m = obstacle["range_m"] - thing["range_m"]
    near_m = max(1.0, 0.1 * thing["range_m"])
    return bool(-near_m <= depth_m <= near_m + _along(thing))


def _along(thing: Record) -> float:
    """Return how long a thing is along the line of sight, at most."""
    width_m, _, length_m = thing["size_m"]
    return float(math.hypot(width_m, length_m))


def recall_rows(frames: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return, by type and range band, how many things were found and how well their ranges were measured.

    `recall` is the share that has an obstacle, `recall_right_range` that whose range is right within 0.5 m or 5 %.
    """
    pairs = [pair for frame in frames for pair in frame.things]
    rows = []
    for name in (ANY, *sorted({str(t["type"]) for t, _ in pairs})):
        for low, high in BANDS_M:
            mine = [(t, o) for t, o in pairs if name in (ANY, t["type"]) and low <= t["range_m"] < high]
            if mine:
                readings = [reading(t, o) for t, o in mine]
                right = sum(abs(r.error_m) <= max(0.5, 0.05 * r.true_range_m) for r in readings)
                row = {"type": name, "from_m": low, "to_m": high, "recall": share(_found(mine), len(mine))}
                row |= {"recall_right_range": share(right, len(mine))}
                rows.append(plain_record({**row, **vars(accuracy(readings))}))
    return rows


def _found(pairs: Sequence[tuple[Record, Record | None]]) -> int:
    return sum(o is not None for _, o in pairs)


def reading(thing: Record, obstacle: Record | None) -> Reading:
    """Return how a thing's range was measured, its sigma with the calibration's part; `obstacle` None if missed."""
    if obstacle is None:
        return Reading(str(thing["type"]), thing["range_m"])
    sigmas = [obstacle.get(key) for key in ("range_sigma_m", "range_sigma_calib_m")]
    sigma_m = math.nan if sigmas[0] is None else math.hypot(*(s or 0.0 for s in sigmas))
    return Reading(str(thing["type"]), thing["range_m"], obstacle["range_m"], sigma_m)


def precision_rows(frames: Sequence[Judged]) -> list[dict[str, Any]]:
    """Return, by class and range band, how many obstacles a named thing explains.

    Of `any`, an obstacle is explained that is a thing or a piece of one; things without a name in the truth (houses,
    trees) make it look worse than it is. Of a class, one that is a thing of this class; obstacles called unknown claim
    no class.
    """
    claims = [claim for frame in frames for claim in frame.claims]
    names = sorted({class_of(o.get("class")) for o, _ in claims} - {UNKNOWN})
    rows = []
    for name in (ANY, *names):
        for low, high in BANDS_M:
            called = [(o, t) for o, t in claims if name in (ANY, class_of(o.get("class")))]
            mine = [t for o, t in called if low <= o["range_m"] < high]
            if not mine:
                continue
            things, pieces = [t for t in mine if isinstance(t, Mapping)], mine.count("piece")
            right = [t for t in things if name in (ANY, class_of(t["type"]))]
            precision = share(len(right) + pieces, len(mine)) if name == ANY else share(len(right), len(mine) - pieces)
            row = {"class": name, "from_m": low, "to_m": high, "n": len(mine), "right": len(right), "pieces": pieces}
            rows.append(plain_record({**row, "unexplained": mine.count(None), "precision": precision}))
    return rows


def confusion(frames: Sequence[Judged]) -> dict[str, Any]:
    """Return how things were called: counts, and what they come to.

    Returns
    -------
    `classes` true and `called`, `counts` (a row per true class, a column per name called, the last one missed), `right`
    (share of the found things called right), `macro_f1` over the true classes, and `calibration_error`: how far the
    stated probabilities are from the shares that are right, in ten bins; None where nothing was called.
    """
    pairs = [pair for frame in frames for pair in frame.things]
    called = [(class_of(t["type"]), MISSED if o is None else class_of(o.get("class", UNKNOWN))) for t, o in pairs]
    table = Counter(called)
    classes = sorted({t for t, _ in called})
    names = [*sorted({c for _, c in called} - {MISSED, UNKNOWN}), UNKNOWN, MISSED]
    found = [(t, c) for t, c in called if c != MISSED]
    named = [pair for pair in found if pair[1] != UNKNOWN]
    scores = [_f1(named, found, name) for name in classes]
    sure = [
        (o["class_probability"], class_of(o["class"]) == class_of(t["type"]))
        for t, o in pairs
        if o is not None and o.get("class_probability") is not None and o["class"] != UNKNOWN
    ]
    return plain_record(
        {
            "classes": classes,
            "called": names,
            "counts": [[table[(row, column)] for column in names] for row in classes],
            "right": share(sum(t == c for t, c in named), len(found)) if named else math.nan,
            "macro_f1": float(np.mean(scores)) if named else math.nan,
            "calibration_error": _calibration_error(sure),
        }
    )


def _f1(named: Sequence[tuple[str, str]], found: Sequence[tuple[str, str]], name: str) -> float:
    right = sum(t == c == name for t, c in named)
    return 2 * right / max(sum(c == name for _, c in named) + sum(t == name for t, _ in found), 1)


def _calibration_error(stated: Sequence[tuple[float, bool]]) -> float:
    if not stated:
        return math.nan
    p, right = np.array(stated, float).T
    part = np.minimum((p * 10).astype(int), 9)
    return float(sum(abs((p - right)[part == k].sum()) for k in range(10)) / len(p))


def size_rows(frames: Sequence[Judged], to_m: float = 15.0) -> list[dict[str, Any]]:
    """Return errors of width, height and length by type, of things nearer than `to_m`.

    Width is the extent across the vehicle's x axis and length that along it, for obstacles and things alike.
    """
    pairs = [(t, o) for frame in frames for t, o in frame.things if o is not None and t["range_m"] < to_m]
    pairs = [(t, o) for t, o in pairs if t.get("yaw_rad") is not None]
    rows = []
    for name in (ANY, *sorted({str(t["type"]) for t, _ in pairs})) if pairs else ():
        for k, what in enumerate(SIZES):
            both = [(_extents_m(t)[k], o["size_m"][k]) for t, o in pairs if name in (ANY, t["type"])]
            known = np.array([pair for pair in both if pair[1] is not None], float).reshape(-1, 2)
            if len(known):
                true_m, error_m = known[:, 0], known[:, 1] - known[:, 0]
                row = {"type": name, "size": what, "n": len(known), "bias_m": error_m.mean()}
                row |= {"median_abs_m": np.median(np.abs(error_m)), "p95_abs_m": np.percentile(np.abs(error_m), 95)}
                right = np.mean(np.abs(error_m) <= np.maximum(SIZE_TO_M, SIZE_SHARE * true_m))
                rows.append(plain_record({**row, "right": right}))
    return rows


def _extents_m(thing: Record) -> tuple[float, float, float]:
    """Return extents across the vehicle's x axis, up, and along x."""
    width_m, height_m, length_m = thing["size_m"]
    c, s = abs(math.cos(thing["yaw_rad"])), abs(math.sin(thing["yaw_rad"]))
    return width_m * c + length_m * s, height_m, length_m * c + width_m * s
