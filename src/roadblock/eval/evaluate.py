"""All judges together: what a system found in a recording against all that is known to be true of it."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict
from typing import Any

from roadblock.errors import ValueRefusedError
from roadblock.eval.accuracy import frames_by_name
from roadblock.eval.detection import distance_rows, kitti_rows
from roadblock.eval.maps import judge_maps
from roadblock.eval.match import Record
from roadblock.eval.motion import seen_frame, ttc_rows, velocity_rows, warning_record
from roadblock.eval.plain import plain_record
from roadblock.eval.things import Judged, confusion, judge_frame, precision_rows, reading, recall_rows, size_rows
from roadblock.eval.tracks import judge_tracks
from roadblock.values.true_map import TrueMap


def evaluate(
    found: Sequence[Record],
    true: Sequence[Record],
    maps: Callable[[], Iterable[TrueMap]] | None = None,
    offset_px: float = 0.0,
) -> dict[str, Any]:
    """Return what a system's results come to.

    Parameters
    ----------
    found
        Lines of an `obstacles.jsonl`.
    true
        Frames of named things, see `roadblock.io.truth.Truth`; may be empty.
    maps
        Returns true maps frame by frame.
    offset_px
        Added to their disparities.

    Returns
    -------
    `frames` (judged, missing in the results, not in the truth), and the sections `things`, `tracks` and `maps`, None
    where there is no truth for them. A missing frame counts as empty.

    Raises
    ------
    ValueRefusedError
        If results and truth share no frame, a name comes twice, or a record is none (see `eval.match`).
    """
    by_name = frames_by_name(found, "results")
    frames_by_name(true, "truth")
    names = [str(frame["name"]) for frame in true]
    shown = None
    if maps is not None:
        taken: list[str] = []
        shown = judge_maps(by_name, _noting(maps(), taken), offset_px)
        names = list(dict.fromkeys([*names, *taken]))
    if not by_name.keys() & set(names):
        raise ValueRefusedError(
            f"none of the {len(by_name)} frames of the results is one of the {len(names)} of the truth: "
            "judge the recording that the truth belongs to"
        )
    empty: Record = {"obstacles": []}
    pairs = [(by_name.get(str(frame["name"]), empty), frame) for frame in true]
    judged = [judge_frame(f["obstacles"], t["objects"], t.get("doubts") or ()) for f, t in pairs]
    return {
        "frames": {
            "judged": len(names),
            "missing": len(set(names) - by_name.keys()),
            "without_truth": len(by_name.keys() - set(names)),
        },
        "things": _things(pairs, judged) if true else None,
        "tracks": _tracks(pairs, judged),
        "maps": shown,
    }


def _noting(maps: Iterable[TrueMap], names: list[str]) -> Iterable[TrueMap]:
    for shown in maps:
        names.append(shown.name)
        yield shown


def _things(pairs: Sequence[tuple[Record, Record]], judged: Sequence[Judged]) -> dict[str, Any]:
    frames = [(f["obstacles"], t["objects"], t.get("doubts") or ()) for f, t in pairs]
    return {
        "recall": recall_rows(judged),
        "precision": precision_rows(judged),
        "confusion": confusion(judged),
        "sizes": size_rows(judged),
        "kitti_ap": kitti_rows(frames),
        "distance_ap": distance_rows(judged),
        "readings": [plain_record(vars(reading(t, o))) for frame in judged for t, o in frame.things],
    }


def _tracks(pairs: Sequence[tuple[Record, Record]], judged: Sequence[Judged]) -> dict[str, Any] | None:
    """Judge what is known over time, where true things have numbers and some obstacle has one."""
    has_ids = all("id" in t for _, frame in pairs for t in frame["objects"])
    if not has_ids or all(o.get("id") is None for frame, _ in pairs for o in frame["obstacles"]):
        return None
    boxes, places = (
        judge_tracks([seen_frame(f["obstacles"], t["objects"], by_place) for f, t in pairs])
        for by_place in (False, True)
    )
    return {
        "scores": plain_record(asdict(boxes)),
        "scores_place": plain_record(asdict(places)),
        "velocity": velocity_rows(judged),
        "ttc": ttc_rows(judged, [t.get("ego") for _, t in pairs]),
        "warnings": warning_record([f for f, _ in pairs], [t for _, t in pairs]),
    }
