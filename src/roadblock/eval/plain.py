"""Figures as JSON has them: rounded, None where they are not finite."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

DIGITS = 5


def share(part: float, whole: float) -> float:
    """Return `part / whole`; NaN of nothing."""
    return float(part / whole) if whole else math.nan


def plain_record(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return a record in plain JSON values: rounded to 5 decimals, None where not finite, dataclasses as records."""
    return {key: _plain(value) for key, value in record.items()}


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return plain_record(dataclasses.asdict(value))
    if isinstance(value, Mapping):
        return plain_record(value)
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return round(float(value), DIGITS) + 0.0 if math.isfinite(value) else None
    return value
