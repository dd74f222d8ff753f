"""Which found obstacle is which true thing. Plain records in, pairs out.

A found record needs `box_px` and `range_m` as in `obstacles.jsonl`, a true one the same two as in `truth.jsonl`;
whatever else they hold is let pass, so any system's output can be judged that can be written in these two fields.

The rules: a found obstacle may be a true thing when their boxes overlap by at least `least_overlap` (intersection over
union) and their ranges differ by less than `largest_share` of the true one. Of all ways to pair them one to one the
one with the highest sum of overlap x (1 - range difference / largest allowed) is taken. What is left of the truth was
missed.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from roadblock.errors import ValueRefusedError
from roadblock.geometry.boxes import shared_px2
from roadblock.values.checks import FloatArray, finite

Record = Mapping[str, Any]


@dataclass(frozen=True)
class MatchRules:
    """What may be the same thing.

    Attributes
    ----------
    least_overlap
        Least intersection over union of the boxes, above 0 and at most 1.
    largest_share
        The range differs by less than this share of the true range. It is wide on purpose: a wrong range shall be
        counted as an error, not as a miss.

    Raises
    ------
    ValueRefusedError
        If one is outside its limits.
    """

    least_overlap: float = 0.2
    largest_share: float = 0.5

    def __post_init__(self) -> None:
        if not 0 < self.least_overlap <= 1:
            raise ValueRefusedError(f"least_overlap must be > 0 and <= 1, but got {self.least_overlap}")
        if not 0 < self.largest_share < math.inf:
            raise ValueRefusedError(f"largest_share must be > 0 and finite, but got {self.largest_share}")


RULES = MatchRules()
"""The ones that every table of this project is made with."""


def pair_up(found: Sequence[Record], true: Sequence[Record], rules: MatchRules = RULES) -> list[int | None]:
    """Return for each true thing the index of the found obstacle that is it; None where it was missed.

    Parameters
    ----------
    found, true
        Records of one frame, see the head of this file.
    rules
        What may be the same thing.

    Raises
    ------
    ValueRefusedError
        If a record lacks a field, or a field is no box or no positive range.
    """
    pairs: list[int | None] = [None] * len(true)
    if not found or not true:
        return pairs
    boxes, boxes_true = boxes_of(found, "found"), boxes_of(true, "true")
    range_m, range_true_m = ranges(found, "found"), ranges(true, "true")
    overlap = overlaps(boxes_true, boxes)
    apart = np.abs(range_m - range_true_m[:, None]) / (rules.largest_share * range_true_m[:, None])
    score = np.where((overlap >= rules.least_overlap) & (apart < 1), overlap * (1 - apart), 0)
    for i, j in zip(*linear_sum_assignment(score, maximize=True), strict=True):
        if score[i, j] > 0:
            pairs[i] = int(j)
    return pairs


def overlaps(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (n, m) intersection over union of boxes (n, 4) and (m, 4), each u0, v0, u1, v1, half open."""
    common = shared_px2(a, b)
    area_a, area_b = (np.prod(box[:, 2:] - box[:, :2], axis=-1) for box in (a, b))
    return np.asarray(common / (area_a[:, None] + area_b - common))


def ranges(records: Sequence[Record], what: str) -> FloatArray:
    """Return (n,) `range_m` of records, metres.

    Raises
    ------
    ValueRefusedError
        If one is missing, no number, or not > 0.
    """
    values = [
        finite(f"range_m of {what} obstacle {i}", _field(r, "range_m", what, i), ()) for i, r in enumerate(records)
    ]
    bad = next((i for i, value in enumerate(values) if value <= 0), None)
    if bad is not None:
        raise ValueRefusedError(f"range_m of {what} obstacle {bad} must be > 0, but got {values[bad]:g}")
    return np.array(values, float)


def boxes_of(records: Sequence[Record], what: str) -> FloatArray:
    """Return (n, 4) `box_px` of records; `what` they are, "found" or "true", for messages.

    Raises
    ------
    ValueRefusedError
        If one is missing or no box.
    """
    boxes = [
        finite(f"box_px of {what} obstacle {i}", _field(r, "box_px", what, i), (4,)) for i, r in enumerate(records)
    ]
    for i, (u0, v0, u1, v1) in enumerate(boxes):
        if u0 >= u1 or v0 >= v1:
            raise ValueRefusedError(
                f"box_px of {what} obstacle {i} must be u0 < u1, v0 < v1, but got {boxes[i].tolist()}"
            )
    return np.array(boxes, float).reshape(-1, 4)


def _field(record: Record, name: str, what: str, index: int) -> Any:
    if name not in record:
        raise ValueRefusedError(f"{what} obstacle {index} has no {name}: see docs/results.md for the record")
    return record[name]
