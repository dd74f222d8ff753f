"""The judge of a drive, as the paper has it: effective, failed, or a false avoidance; and how sure the counts are."""

from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import beta, binomtest

OUTCOMES = ("effective", "failed", "false")
CONFIDENCE = 0.95

Run = Mapping[str, Any]


def upper_bound(bad: int, runs: int) -> float:
    """Return the share of bad runs that is exceeded with a probability of 5 % only (Clopper-Pearson, one-sided).

    0 of 299 gives 0.01; with no run at all it is 1.
    """
    return 1.0 if bad >= runs else float(beta.ppf(CONFIDENCE, bad + 1, runs - bad))


def counts(runs: Sequence[Run]) -> dict[str, int]:
    """Return how many runs had each outcome."""
    return {outcome: sum(run["outcome"] == outcome for run in runs) for outcome in OUTCOMES}


def between(bad: int, runs: int) -> list[float]:
    """Return the two 95 % bounds of the share of bad runs (Wilson); 0 and 1 with no run at all."""
    if runs == 0:
        return [0.0, 1.0]
    interval = binomtest(bad, runs).proportion_ci(CONFIDENCE, "wilson")
    return [float(interval.low), float(interval.high)]


def by_scenario(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one row per scenario, and one for all: runs, outcomes, kilometres, and the bounds of failures."""
    names = [*dict.fromkeys(run["scenario"] for run in runs)]
    groups = [(name, [run for run in runs if run["scenario"] == name]) for name in names]
    return [
        {
            "scenario": name,
            "runs": len(mine),
            **counts(mine),
            "km": sum(run["km"] for run in mine),
            "failed_below": upper_bound(counts(mine)["failed"], len(mine)),
            "failed_between": between(counts(mine)["failed"], len(mine)),
        }
        for name, mine in [*groups, ("all", list(runs))]
    ]


def grid_cells(runs: Sequence[Run], allowed_kmh: Mapping[str, float | None]) -> list[dict[str, Any]]:
    """Return one row per cell of a test grid: its target and speed, the worst impact of its runs, and what is allowed.

    Parameters
    ----------
    runs
        Any; those whose scenario is no cell are left out.
    allowed_kmh
        By scenario: the relative speed at which the regulation allows an impact; None where it is not known.
    """
    cells = []
    for name in dict.fromkeys(run["scenario"] for run in runs if run["scenario"] in allowed_kmh):
        worst = max(run["impact_mps"] for run in runs if run["scenario"] == name)
        target, speed = name.rsplit(" ", 1)
        cell = {"target": target.removeprefix("grid "), "speed_kmh": float(speed), "impact_kmh": round(3.6 * worst, 1)}
        cells.append({**cell, "allowed_kmh": allowed_kmh[name]})
    return cells
