"""The paper's table 2: what it measured, and how our readings are laid beside it. Plain records in and out."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from roadblock.errors import ValueRefusedError
from roadblock.eval.accuracy import Accuracy, Reading, accuracy
from roadblock.eval.match import Record


@dataclass(frozen=True)
class Target:
    """One obstacle of the paper's experiment, and the paper's single readings of it.

    Attributes
    ----------
    type
        As in `truth.jsonl`.
    nominal_m
        Where it stands, metres.
    proposed_m, traditional_1_m, traditional_2_m
        What the paper read with its own and with two traditional algorithms, metres. Of the fork the table lost a
        column; these are the figures that fit the rest.
    """

    type: str
    nominal_m: float
    proposed_m: float
    traditional_1_m: float
    traditional_2_m: float


TARGETS = (
    Target("person", 5.0, 5.03, 5.24, 5.16),
    Target("bicycle", 10.0, 10.02, 10.26, 10.19),
    Target("fork", 20.0, 20.01, 20.51, 20.33),
)
MONO = "mono"
"""Names of detectors that use one camera begin like this; all others are stereo."""
DIGITS = 5


def index_of(target: Target, objects: Sequence[Record]) -> int:
    """Return which of a frame's true objects the target is: of its type, the one nearest to its nominal range.

    Raises
    ------
    ValueRefusedError
        If there is none of its type.
    """
    same = [i for i, thing in enumerate(objects) if thing["type"] == target.type]
    if not same:
        seen = ", ".join(sorted({str(thing["type"]) for thing in objects})) or "nothing"
        raise ValueRefusedError(f"the scene must show a {target.type} at {target.nominal_m:g} m, but shows {seen}")
    return min(same, key=lambda i: abs(float(objects[i]["range_m"]) - target.nominal_m))


def reading_record(detector: str, target: Target, seed: int, reading: Reading) -> dict[str, Any]:
    """Return one reading as plain JSON values, unknown as None."""
    return {
        "detector": detector,
        "type": target.type,
        "seed": seed,
        "true_range_m": _plain(reading.true_range_m),
        "range_m": _plain(reading.range_m),
        "range_sigma_m": _plain(reading.range_sigma_m),
    }


def rows(records: Sequence[Record]) -> list[dict[str, Any]]:
    """Return the table's rows, one per target and detector, from reading records.

    `true_range_m` is the mean of the true ranges, which differ a little from seed to seed; errors are taken reading by
    reading. `n` counts the runs, `missed` those of them where it was not found.
    """
    table = []
    for target in TARGETS:
        for detector in dict.fromkeys(record["detector"] for record in records):
            mine = [_reading(r) for r in records if (r["detector"], r["type"]) == (detector, target.type)]
            if mine:
                true_m = sum(reading.true_range_m for reading in mine) / len(mine)
                table.append(_row(str(detector), target, true_m, accuracy(mine)))
    return table


def _row(detector: str, target: Target, true_m: float, result: Accuracy) -> dict[str, Any]:
    figures = {name: _plain(value) if isinstance(value, float) else value for name, value in asdict(result).items()}
    return {
        "detector": detector,
        "type": target.type,
        "nominal_m": target.nominal_m,
        "true_range_m": _plain(true_m),
        **figures,
    }


def compare(table: Sequence[Record]) -> list[dict[str, Any]]:
    """Return per target the best stereo and the best mono detector by median |error|, and the ratio of the two.

    A detector that missed the target in half of the runs or more is out of it. None where there is none.
    """
    return [
        _compare(target, [row for row in table if row["type"] == target.type and 2 * row["missed"] < row["n"]])
        for target in TARGETS
    ]


def _compare(target: Target, mine: Sequence[Record]) -> dict[str, Any]:
    def median_m(row: Record) -> float:
        return float(row["median_abs_m"])

    stereo = min((row for row in mine if not row["detector"].startswith(MONO)), key=median_m, default=None)
    mono = min((row for row in mine if row["detector"].startswith(MONO)), key=median_m, default=None)
    ratio = None if stereo is None or mono is None or not median_m(mono) else median_m(stereo) / median_m(mono)
    return {
        "type": target.type,
        "stereo": stereo and stereo["detector"],
        "stereo_median_abs_m": stereo and stereo["median_abs_m"],
        "mono": mono and mono["detector"],
        "mono_median_abs_m": mono and mono["median_abs_m"],
        "ratio": ratio if ratio is None else round(ratio, 4),
    }


def paper_records() -> list[dict[str, Any]]:
    """Return the paper's table as plain JSON values."""
    return [asdict(target) for target in TARGETS]


def _reading(record: Record) -> Reading:
    values = (math.nan if record[key] is None else float(record[key]) for key in ("range_m", "range_sigma_m"))
    return Reading(str(record["type"]), float(record["true_range_m"]), *values)


def _plain(value: float) -> float | None:
    return round(value, DIGITS) if math.isfinite(value) else None
