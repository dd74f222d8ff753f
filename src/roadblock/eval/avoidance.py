"""The judge of a drive, as the paper has it: effective, failed, or a false avoidance; and how sure the counts are."""

from collections.abc import Mapping, Sequence
from typing import Any

from scipy.stats import beta

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


def by_scenario(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """Return one row per scenario, and one for all: runs, outcomes, kilometres, and the bound of failures."""
    names = [*dict.fromkeys(run["scenario"] for run in runs)]
    groups = [(name, [run for run in runs if run["scenario"] == name]) for name in names]
    return [
        {
            "scenario": name,
            "runs": len(mine),
            **counts(mine),
            "km": sum(run["km"] for run in mine),
            "failed_below": upper_bound(counts(mine)["failed"], len(mine)),
        }
        for name, mine in [*groups, ("all", list(runs))]
    ]
