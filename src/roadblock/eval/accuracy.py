"""How well ranges were measured: frames and truth in, errors per type and range out.

Errors are found minus true forward distance to the nearest visible face (`range_m`: the 10th percentile over the
visible surface, on both sides), metres: positive = seen too far.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.eval.match import RULES, MatchRules, Record, pair_up, ranges
from roadblock.values.checks import FloatArray, numbers


@dataclass(frozen=True)
class Reading:
    """One true thing, and what a system made of it.

    Attributes
    ----------
    type
        Of the true thing.
    true_range_m
        Its range, metres.
    range_m
        As measured; NaN where it was missed.
    range_sigma_m
        The stated standard deviation; NaN where none was stated.
    """

    type: str
    true_range_m: float
    range_m: float = math.nan
    range_sigma_m: float = math.nan

    @property
    def error_m(self) -> float:
        """Measured minus true range, metres; NaN where it was missed."""
        return self.range_m - self.true_range_m


@dataclass(frozen=True)
class Accuracy:
    """What many readings come to. NaN where nothing was measured (or, of the last two, no sigma stated).

    Attributes
    ----------
    n
        True things.
    missed
        How many of them were not found; all below is over the others.
    bias_m, rms_m, median_abs_m, p95_abs_m
        Mean error, root of the mean square error, median and 95th percentile of the absolute error, metres.
    within_1_sigma, within_2_sigma
        Share of the readings with a stated sigma whose error is at most one or two of it (0.68 and 0.95 for an honest
        Gaussian).
    """

    n: int
    missed: int
    bias_m: float = math.nan
    rms_m: float = math.nan
    median_abs_m: float = math.nan
    p95_abs_m: float = math.nan
    within_1_sigma: float = math.nan
    within_2_sigma: float = math.nan


def read_frame(found: Sequence[Record], true: Sequence[Record], rules: MatchRules = RULES) -> list[Reading]:
    """Return one reading per true thing of a frame.

    Parameters
    ----------
    found
        `obstacles` of an `obstacles.jsonl` line (needs `box_px`, `range_m`; `range_sigma_m` may be missing or None).
    true
        `objects` of a `truth.jsonl` line (needs `box_px`, `range_m`, `type`).
    rules
        Which of them may be the same.

    Raises
    ------
    ValueRefusedError
        If a record lacks a field, or a field is no box, no positive range, or a sigma that is no number.
    """
    readings = []
    for thing, range_m, index in zip(true, ranges(true, "true"), pair_up(found, true, rules), strict=True):
        name = str(thing.get("type", "unknown"))
        if index is None:
            readings.append(Reading(name, float(range_m)))
        else:
            readings.append(Reading(name, float(range_m), float(found[index]["range_m"]), _sigma_m(found[index])))
    return readings


def _sigma_m(record: Record) -> float:
    sigma_m = record.get("range_sigma_m")
    return math.nan if sigma_m is None else float(numbers("range_sigma_m", sigma_m, ()))


def read_drive(found: Sequence[Record], true: Sequence[Record], rules: MatchRules = RULES) -> list[Reading]:
    """Return the readings of a whole drive.

    Parameters
    ----------
    found, true
        The lines of `obstacles.jsonl` and of `truth.jsonl`; frames belong together by `name`.
    rules
        Which obstacles may be the same.

    Raises
    ------
    ValueRefusedError
        If the two are not about the same frames, a name comes twice, or a record is none (see `read_frame`).
    """
    by_name = frames_by_name(found, "results")
    true_by_name = frames_by_name(true, "truth")
    odd = sorted(by_name.keys() ^ true_by_name.keys())
    if odd:
        where = "results but not in the truth" if odd[0] in by_name else "truth but not in the results"
        raise ValueRefusedError(f"frame {odd[0]!r} is in the {where}: judge the recording the truth belongs to")
    return [
        reading
        for name, frame in true_by_name.items()
        for reading in read_frame(by_name[name]["obstacles"], frame["objects"], rules)
    ]


def frames_by_name(frames: Sequence[Record], what: str) -> dict[str, Record]:
    """Return frames by their names; `what` they are, "results" or "truth", for messages.

    Raises
    ------
    ValueRefusedError
        If a frame has no name, or none of its content, or a name comes twice.
    """
    content = "obstacles" if what == "results" else "objects"
    for index, frame in enumerate(frames):
        if "name" not in frame or content not in frame:
            raise ValueRefusedError(f"frame {index} of the {what} must have a name and {content}, but has not")
    named = {str(frame["name"]): frame for frame in frames}
    if len(named) < len(frames):
        raise ValueRefusedError(
            f"{len(frames) - len(named)} frames of the {what} repeat a name: each must have its own"
        )
    return named


def accuracy(readings: Iterable[Reading]) -> Accuracy:
    """Return what readings come to."""
    table = np.array([(r.error_m, r.range_sigma_m) for r in readings]).reshape(-1, 2)
    found = np.isfinite(table[:, 0])
    error_m, sigma_m = table[found].T
    if not found.any():
        return Accuracy(len(table), len(table))
    size_m = np.abs(error_m)
    return Accuracy(
        n=len(table),
        missed=int((~found).sum()),
        bias_m=float(error_m.mean()),
        rms_m=float(np.sqrt(np.mean(error_m**2))),
        median_abs_m=float(np.median(size_m)),
        p95_abs_m=float(np.percentile(size_m, 95)),
        within_1_sigma=_share_within(size_m, sigma_m, 1),
        within_2_sigma=_share_within(size_m, sigma_m, 2),
    )


def _share_within(size_m: FloatArray, sigma_m: FloatArray, sigmas: float) -> float:
    stated = np.isfinite(sigma_m)
    return float(np.mean(size_m[stated] <= sigmas * sigma_m[stated])) if stated.any() else math.nan


def by_type_and_range(
    readings: Sequence[Reading], edges_m: Sequence[float]
) -> dict[tuple[str, float, float], Accuracy]:
    """Return accuracies by (type, from, to): true ranges from the one up to, not including, the other, metres.

    Parameters
    ----------
    readings
        In any order; those outside the edges are not counted.
    edges_m
        Ends of the bins, rising.

    Returns
    -------
    Sorted by type, then range; empty bins are left out.

    Raises
    ------
    ValueRefusedError
        If the edges are fewer than two or do not rise.
    """
    if len(edges_m) < 2 or not all(a < b for a, b in pairwise(edges_m)):
        raise ValueRefusedError(f"edges_m must be at least two rising ranges, but got {list(edges_m)}")
    bins: dict[tuple[str, float, float], list[Reading]] = {}
    for low, high in pairwise(edges_m):
        for reading in readings:
            if low <= reading.true_range_m < high:
                bins.setdefault((reading.type, low, high), []).append(reading)
    return {key: accuracy(bins[key]) for key in sorted(bins)}
