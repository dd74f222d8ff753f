"""Ranges against truth and against the Cramer-Rao bound: single readings in, the rows of `experiment range` out."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadblock.eval.accuracy import Reading, accuracy
from roadblock.eval.match import Record
from roadblock.values.checks import FloatArray

DIGITS = 5
GRADIENT_NOISE = 0.5
"""What noise of variance 1 adds to the square of a central difference."""


def bound_px(left: NDArray[np.uint8], mask: NDArray[np.bool_], noise: float) -> float:
    """Return the Cramer-Rao bound of the disparity of a flat region whose pixels are all its own, pixels.

    `sqrt(2) noise / sqrt(sum g^2)`: both images are noisy; the noise's share of the gradients' energy is taken off.

    Parameters
    ----------
    left
        (height, width) the left image, as recorded.
    mask
        The region.
    noise
        Standard deviation of a grey level.
    """
    slope = np.gradient(left.astype(float), axis=1)[mask]
    energy = float((slope**2).sum()) - GRADIENT_NOISE * noise**2 * len(slope)
    return math.sqrt(2) * noise / math.sqrt(energy) if energy > 0 else math.inf


def normalized_error(error_m: FloatArray, cov_m2: FloatArray) -> float:
    """Return the squared error of a place (3,) in units of its covariance (3, 3): 3 on average if that is honest."""
    return float(error_m @ np.linalg.solve(cov_m2, error_m))


def rows(readings: Sequence[Record]) -> list[dict[str, Any]]:
    """Return one row per detector, type and nominal range, from readings.

    Parameters
    ----------
    readings
        With `detector`, `type`, `nominal_m`, `true_range_m`, `range_m`, `range_sigma_m` and `bound_m`; the last three
        may be None.

    Returns
    -------
    In the order in which the groups first appear; unknown is None.
    """
    table = []
    for detector, kind, nominal_m in dict.fromkeys((r["detector"], r["type"], r["nominal_m"]) for r in readings):
        mine = [r for r in readings if (r["detector"], r["type"], r["nominal_m"]) == (detector, kind, nominal_m)]
        result = asdict(accuracy([_reading(r) for r in mine]))
        result["coverage_68"], result["coverage_95"] = result.pop("within_1_sigma"), result.pop("within_2_sigma")
        result["bound_m"] = float(np.median([_number(r["bound_m"]) for r in mine]))
        table.append(
            {"detector": detector, "type": kind, "true_range_m": nominal_m}
            | {key: plain(value) if isinstance(value, float) else value for key, value in result.items()}
        )
    return table


def anees(readings: Sequence[Record]) -> float | None:
    """Return the mean of the readings' `nees`, those that have one; None where none has."""
    values = [r["nees"] for r in readings if r.get("nees") is not None]
    return plain(float(np.mean(values))) if values else None


def plain(value: float) -> float | None:
    """Return a number as JSON has it: rounded, None where it is not finite."""
    return round(value, DIGITS) if math.isfinite(value) else None


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _reading(r: Record) -> Reading:
    return Reading(str(r["type"]), float(r["true_range_m"]), _number(r["range_m"]), _number(r["range_sigma_m"]))
