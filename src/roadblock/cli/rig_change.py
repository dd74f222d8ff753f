"""Two calibrations of one rig in words: what lies between them, and whether chance explains it."""

import math

import numpy as np

from roadblock.cli.terminal import note, say, show_table
from roadblock.geometry.compare import RangeChange, RigChange, compare_rigs
from roadblock.values.camera import StereoRig
from roadblock.values.checks import FloatArray

MOVED_P = 1e-3
"""Chance below which a difference between two calibrations is called a move: one false alarm in a thousand."""

JUDGED_AT_M = 20.0
MOST_LENS_PARAMETERS = 4


def show_change(first: str, second: str, used: StereoRig, true: StereoRig) -> None:
    """Print what happens if the rig of file `first` is used and that of `second` is true, and a verdict.

    Raises
    ------
    RigError
        If the rigs cannot be compared.
    """
    change = compare_rigs(used, true)
    show_table(
        f"{first} used, {second} true",
        ("at", ">range off (m), median", ">worst", ">1 sigma", ">rows apart (px), median", ">worst"),
        map(_range_row, change.at),
    )
    show_table("what has changed", ("what", ">by", ">1 sigma", ">by / sigma"), map(_cells, _changes(change)))
    if len(change.names) == 6:
        note("the lens models differ: only the pose and what both do to the images are compared")
    missing = [file for file, rig in ((first, used), (second, true)) if rig.covariance is None]
    say(f"cannot be told: no covariance in {' and '.join(missing)}" if missing else verdict(change))


def verdict(change: RigChange) -> str:
    """Return in one line whether two calibrations differ by more than their errors."""
    p = "p < 1e-6" if change.p < 1e-6 else f"p = {change.p:.2g}"
    if change.p >= MOVED_P:
        return f"the same within their errors ({p})"
    range_m = next(at.range_m for at in change.at if at.distance_m == JUDGED_AT_M)
    return f"moved: ranges at {JUDGED_AT_M:g} m are off by {_median(range_m)} m, at worst {_worst(range_m)} m ({p})"


def _range_row(at: RangeChange) -> list[str]:
    where = "far away" if math.isinf(at.distance_m) else f"{at.distance_m:g} m"
    row_px = np.abs(at.row_px)
    unsigned = [text.lstrip("+") for text in (_median(at.range_sigma_m), _median(row_px), _worst(row_px))]
    return [where, _median(at.range_m), _worst(at.range_m), *unsigned]


def _median(values: FloatArray) -> str:
    known = values[~np.isnan(values)]
    return _signed(float(np.median(known))) if known.size else "-"


def _worst(values: FloatArray) -> str:
    known = values[~np.isnan(values)]
    return _signed(float(known[np.abs(known).argmax()])) if known.size else "-"


def _signed(value: float) -> str:
    return f"{round(value, 9) + 0.0:+.3g}"  # rounding errors of 1e-15 are no change


def _changes(change: RigChange) -> list[tuple[str, float, float]]:
    """Return name, change and sigma of the far disparity, the pose, and the lens parameters that changed most."""
    far_px = change.disparity_px[~np.isnan(change.disparity_px)]
    parameters = list(zip(change.names, change.change.tolist(), change.sigma.tolist(), strict=True))
    lens = [(name, by, sigma) for name, by, sigma in parameters[:-6] if sigma > 0]
    lens.sort(key=lambda each: -abs(each[1] / each[2]))
    return [
        ("disparity far away, mean (px)", change.disparity_mean_px, change.disparity_mean_sigma_px),
        ("disparity far away, largest (px)", float(far_px[np.abs(far_px).argmax()]), float("nan")),
        *((f"turn about {name[1]} (deg)", math.degrees(by), math.degrees(s)) for name, by, s in parameters[-6:-3]),
        *((f"shift along {name[1]} (mm)", 1e3 * by, 1e3 * s) for name, by, s in parameters[-3:]),
        *lens[:MOST_LENS_PARAMETERS],
    ]


def _cells(row: tuple[str, float, float]) -> list[str]:
    what, by, sigma = row
    return [what, _signed(by), *((f"{sigma:.3g}", f"{by / sigma:+.1f}") if sigma > 0 else ("-", "-"))]
