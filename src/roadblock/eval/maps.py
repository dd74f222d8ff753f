"""Found obstacles, free space and ground against true depths of every pixel, frame by frame.

A thing is *found* by an obstacle whose box overlaps its own by at least half (intersection over union) and whose range
is right: within 0.5 m or 5 %. An obstacle is *supported* where enough true points stand at its range inside its box.
These are the definitions by which results on KITTI 2015 are scored in this project's tables; `docs/evaluation.md` has
them in words.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadblock.eval.accuracy import Reading, accuracy
from roadblock.eval.match import Record, boxes_of, overlaps
from roadblock.eval.plain import plain_record, share
from roadblock.eval.true_road import TrueFrame, TrueThing, tolerance, true_frame
from roadblock.values.checks import FloatArray
from roadblock.values.true_map import TrueMap

THING_BANDS_M = ((0, 20), (20, 35), (35, 50), (0, 50))
PRECISION_BANDS_M = ((0, 10), (10, 20), (20, 30), (30, 40), (0, 40))
FREE_BANDS_M = ((0, 10), (10, 20), (20, 40))
LEAST_PIXELS, LEAST_SHARE = 20, 0.07
"""A box with fewer true pixels, or a smaller share of them, is not judged: dark cars return no laser."""
CORRIDOR_M, CORRIDOR_TO_M = 1.5, 30.0


def judge_maps(found: Mapping[str, Record], truth: Iterable[TrueMap], offset_px: float = 0.0) -> dict[str, Any]:
    """Return what the frames come to.

    Parameters
    ----------
    found
        Lines of `obstacles.jsonl` by name; a frame that is missing counts as empty.
    truth
        Every one of its frames counts.
    offset_px
        Added to the true disparities, to study how far images and laser disagree.

    Returns
    -------
    `things`, their `readings`, `precision`, `free_space` and `ground`, plain values, None where unknown.

    Raises
    ------
    ValueRefusedError
        If an obstacle's box is none.
    """
    things: list[dict[str, Any]] = []
    claims: list[dict[str, Any]] = []
    columns: list[FloatArray] = []
    grounds: list[FloatArray] = []
    frames, duplicates, merging = 0, 0, 0
    for shown in truth:
        frames += 1
        true, record = true_frame(shown, offset_px), found.get(shown.name) or {}
        obstacles = [o for o in record.get("obstacles") or [] if o.get("range_m") is not None and o.get("box_px")]
        rows = judge_things(obstacles, true.things)
        things += rows
        merging += int((_covers(obstacles, true.things).sum(1) >= 2).sum())
        duplicates += count_duplicates(obstacles)
        claims += [judge_claim(o, true, shown) for o in obstacles if 0 < o["range_m"] <= 40]
        columns.append(judge_free_space(record.get("free_space") or {}, true))
        grounds += _ground(record.get("ground") or {}, true, shown.baseline_m)
    return {
        "frames": frames,
        "duplicates": duplicates,
        "merging_obstacles": merging,
        "things": [_thing_row(things, low, high) for low, high in THING_BANDS_M],
        "readings": [plain_record(vars(t["reading"])) for t in things],
        "precision": precision_rows(claims),
        "free_space": free_space_rows(np.concatenate(columns)) if columns else None,
        "ground": _ground_row(grounds),
    }


def _common_px2(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (n, m) areas that boxes (n, 4) and (m, 4) share."""
    low, high = np.maximum(a[:, None, :2], b[None, :, :2]), np.minimum(a[:, None, 2:], b[None, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0), -1))


def _areas_px2(boxes: FloatArray) -> FloatArray:
    return np.asarray(np.prod(boxes[:, 2:] - boxes[:, :2], -1))


def _covers(obstacles: Sequence[Record], things: Sequence[TrueThing]) -> NDArray[np.bool_]:
    """Return (n, m) whether an obstacle covers at least half of a thing's box."""
    boxes = np.array([t.box_px for t in things], float).reshape(-1, 4)
    return np.asarray(_common_px2(boxes_of(obstacles, "found"), boxes) >= 0.5 * _areas_px2(boxes))


def count_duplicates(obstacles: Sequence[Record]) -> int:
    """Return how many obstacles lie on an earlier one: boxes overlap by more than half, ranges within 10 %."""
    boxes, range_m = boxes_of(obstacles, "found"), np.array([o["range_m"] for o in obstacles], float)
    same = np.tril((overlaps(boxes, boxes) > 0.5) & (np.abs(range_m[:, None] - range_m) < 0.1 * range_m), -1)
    return int(same.any(1).sum())


def judge_things(obstacles: Sequence[Record], things: Sequence[TrueThing]) -> list[dict[str, Any]]:
    """Return one row per thing of a frame: found (box and range), box, range, split, merged, overlap, and the reading.

    A thing is *split* where two obstacles lie at least half inside its box, fill a tenth of it and have its depth; it
    is *merged* where an obstacle covers half of it and half of another one.
    """
    if not things:
        return []
    boxes, true_boxes = boxes_of(obstacles, "found"), np.array([t.box_px for t in things], float)
    range_m = np.array([o["range_m"] for o in obstacles], float)
    overlap, common, covers = overlaps(boxes, true_boxes), _common_px2(boxes, true_boxes), _covers(obstacles, things)
    rows = []
    for k, thing in enumerate(things):
        is_right = np.abs(range_m - thing.range_m) <= tolerance(thing.range_m, 0.5, 0.05)
        hits = np.flatnonzero(overlap[:, k] >= 0.5).tolist()
        best = max(hits, key=lambda i: (is_right[i], overlap[i, k]), default=None)
        lies_inside = common[:, k] >= np.maximum(0.5 * _areas_px2(boxes), 0.1 * _areas_px2(true_boxes)[k])
        near_m = thing.range_m - tolerance(thing.range_m, 1, 0.1)
        pieces = lies_inside & (range_m >= near_m) & (range_m <= thing.far_m + tolerance(thing.far_m, 1, 0.1))
        sigma = None if best is None else obstacles[best].get("range_sigma_m")
        measured = (math.nan, math.nan) if best is None else (float(range_m[best]), sigma or math.nan)
        rows.append(
            {
                "median_m": thing.median_m,
                "found": best is not None and bool(is_right[best]),
                "box": best is not None,
                "range": bool((covers[:, k] & is_right).any()),
                "split": int(pieces.sum()) >= 2,
                "merged": bool((covers[:, k] & (covers.sum(1) >= 2)).any()),
                "overlap": float(overlap[:, k].max(initial=0)),
                "reading": Reading("thing", thing.range_m, *measured),
            }
        )
    return rows


def _thing_row(things: Sequence[dict[str, Any]], low: int, high: int) -> dict[str, Any]:
    mine = [t for t in things if low <= t["median_m"] < high or t["median_m"] == high == THING_BANDS_M[-1][1]]
    counts = {key: sum(t[key] for t in mine) for key in ("found", "box", "range", "split", "merged")}
    shares = {f"{key}_share": share(counts[key], len(mine)) for key in ("found", "box", "range")}
    overlap = float(np.mean([t["overlap"] for t in mine])) if mine else math.nan
    row = {"from_m": low, "to_m": high, "n": len(mine), **shares, "split": counts["split"], "merged": counts["merged"]}
    return plain_record({**row, "mean_overlap": overlap, "range_error": accuracy(t["reading"] for t in mine)})


def judge_claim(obstacle: Record, true: TrueFrame, shown: TrueMap) -> dict[str, Any]:
    """Return whether true points support an obstacle: supported, hidden, unsupported or unknown, and phantoms.

    Supported: at least 6, and 10 %, of the points in its box stand (0.25 to 4 m high) within 1 m or 10 % of its range;
    or, of what is long in depth, at least 20, and 30 %, stand and their 10th percentile is there. Hidden: it is not,
    but at least 60 % of the points are something nearer. A phantom: it is neither, ahead in the corridor, and road is
    seen where it should stand.
    """
    range_m = obstacle["range_m"]
    near_m = float(tolerance(range_m, 1, 0.1))
    h, w = true.z_m.shape
    u0, v0, u1, v1 = (round(edge) for edge in obstacle["box_px"])
    columns = slice(max(0, u0), max(0, min(w, u1)))
    inside = (slice(max(0, v0), max(0, min(h, v1))), columns)
    z, height = true.z_m[inside], true.height_m[inside]
    known = z > 0
    n = int(known.sum())
    state = "unknown"
    if true.road is not None and n >= LEAST_PIXELS and n >= LEAST_SHARE * max(1, z.size):
        standing = known & (height > 0.25) & (height < 4)
        there = int((standing & (np.abs(z - range_m) <= near_m)).sum())
        long = standing.sum() >= max(20, 0.3 * n) and abs(np.percentile(z[standing], 10) - range_m) <= near_m
        nearer = int((known & (height > 0.25) & (z < range_m - near_m)).sum())
        state = "supported" if there >= max(6, 0.1 * n) or long else "hidden" if nearer >= 0.6 * n else "unsupported"
    z, height = true.z_m[:, columns], true.height_m[:, columns]
    road = int(((z > 0) & (np.abs(height) < 0.2) & (np.abs(z - range_m) <= near_m)).sum())
    place = obstacle.get("position_m")
    aside_m = (shown.cx_px - (u0 + u1) / 2) / shown.f_px * range_m + shown.baseline_m / 2
    aside_m = place[1] if place else aside_m
    ahead = abs(aside_m) < CORRIDOR_M and range_m < CORRIDOR_TO_M and road >= 10
    return {
        "range_m": range_m,
        "class": str(obstacle.get("class", "unknown")),
        "state": state,
        "phantom": ahead and state in ("hidden", "unsupported"),
    }


def precision_rows(claims: Sequence[Record]) -> list[dict[str, Any]]:
    """Return precision by class and range band; `any` is all classes."""
    rows = []
    for name in ("any", *sorted({c["class"] for c in claims})):
        for low, high in PRECISION_BANDS_M:
            mine = [c for c in claims if name in ("any", c["class"]) and low < c["range_m"] <= high]
            states = [c["state"] for c in mine]
            right, hidden, wrong, unknown = (states.count(s) for s in ("supported", "hidden", "unsupported", "unknown"))
            row = {"class": name, "from_m": low, "to_m": high, "supported": right, "unsupported": wrong}
            row |= {"hidden": hidden, "unknown": unknown, "precision": share(right, right + wrong + hidden)}
            row |= {"precision_excl_hidden": share(right, right + wrong)}
            rows.append(plain_record({**row, "corridor_phantoms": sum(c["phantom"] for c in mine)}))
    return rows


def judge_free_space(free: Record, true: TrueFrame) -> FloatArray:
    """Return (n, 3) per judged column: true range (NaN where only road is seen), reported one, and 1 where too near.

    Too near: nothing stands within a window of 17 columns where the road is said to end, and road is seen beyond.
    """
    u = np.array(free.get("u_px") or [], float)
    reported = np.array([math.nan if r is None else r for r in free.get("range_m") or []], float)
    reach = max(6.0, float(np.median(np.diff(u)))) if len(u) > 1 else 6.0
    rows = []
    for column, first, ground in zip(true.columns.tolist(), true.first_m, true.ground_m, strict=True):
        if math.isnan(first) and not ground >= 10:
            continue
        nearest = int(np.argmin(np.abs(u - column))) if len(u) else 0
        said = float(reported[nearest]) if len(u) and abs(u[nearest] - column) <= reach else math.nan
        limit = ground if math.isnan(first) else first
        is_near = said < limit - tolerance(limit, 1, 0.1) and _is_road_there(true, column, said)
        rows.append((first, said, is_near))
    return np.array(rows, float).reshape(-1, 3)


def _is_road_there(true: TrueFrame, column: int, said_m: float) -> bool:
    """Whether nothing stands at a range near a column, and road is seen beyond."""
    wide = slice(max(0, column - 8), column + 9)
    z, height = true.z_m[:, wide], true.height_m[:, wide]
    there = (z > 0) & (height > 0.15) & (height < 4) & (np.abs(z - said_m) <= tolerance(said_m, 1, 0.1))
    z, height = (a[:, column - 2 : column + 3] for a in (true.z_m, true.height_m))
    beyond = (np.abs(height) < 0.2) & (z > said_m + tolerance(said_m, 0.5, 0.05))
    return not there.any() and bool(beyond.sum() >= 3)


def free_space_rows(columns: FloatArray) -> dict[str, Any]:
    """Return shares of right, late and too near columns; `bands` by true range."""
    first, said, near = columns.T
    both = np.isfinite(first) & np.isfinite(said)
    error = said - first
    is_ok = both & (np.abs(error) <= tolerance(first, 0.5, 0.05))
    is_late = both & (error > tolerance(first, 1, 0.1))
    columns_true = int(np.isfinite(first).sum())
    bands = []
    for low, high in FREE_BANDS_M:
        mine = both & (first >= low) & (first < high)
        row = {"from_m": low, "to_m": high, "n": int(mine.sum())}
        bands.append(row | {"ok": share(is_ok[mine].sum(), mine.sum()), "late": share(is_late[mine].sum(), mine.sum())})
    relative = float(np.median(np.abs(error[both]) / first[both])) if both.any() else math.nan
    return plain_record(
        {
            "columns": columns_true,
            "observed": share(both.sum(), columns_true),
            "median_relative_error": relative,
            "ok": share(is_ok.sum(), both.sum()),
            "ok_of_all": share(is_ok.sum(), columns_true),
            "late": share(is_late.sum(), both.sum()),
            "near": share(near[np.isfinite(said)].sum(), np.isfinite(said).sum()),
            "bands": bands,
        }
    )


def _ground(said: Record, true: TrueFrame, baseline_m: float) -> list[FloatArray]:
    """Return errors of height, pitch and roll, or nothing where one of the two is unknown."""
    if true.road is None or said.get("height_m") is None:
        return []
    return [np.array([(said.get(key) or 0.0) - value for key, value in true.road.pose(baseline_m).items()])]


def _ground_row(errors: Sequence[FloatArray]) -> dict[str, Any] | None:
    if not errors:
        return None
    e = np.array(errors)
    e[:, 1:] = np.degrees(e[:, 1:])
    row: dict[str, Any] = {"n": len(e)}
    for k, name in enumerate(("height_m", "pitch_deg", "roll_deg")):
        row |= {f"{name}_bias": np.median(e[:, k]), f"{name}_median_abs": np.median(np.abs(e[:, k]))}
        row |= {f"{name}_worst": np.abs(e[:, k]).max()}
    return plain_record(row)
