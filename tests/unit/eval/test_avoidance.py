import pytest

from roadblock.eval.avoidance import between, by_scenario, counts, grid_cells, upper_bound


def run(scenario: str, outcome: str, impact_mps: float = 0.0) -> dict[str, object]:
    return {"scenario": scenario, "outcome": outcome, "km": 0.05, "impact_mps": impact_mps}


def test_none_of_299_is_less_than_a_hundredth() -> None:
    assert upper_bound(0, 299) == pytest.approx(0.01, abs=5e-5)  # the rule of three: 3 / 299
    assert upper_bound(0, 0) == 1.0
    assert upper_bound(3, 3) == 1.0


def test_wilson_bounds_hold_the_share() -> None:
    low, high = between(5, 50)
    assert (low, high) == pytest.approx((0.0435, 0.2136), abs=1e-3)  # by hand, z = 1.96
    assert between(0, 0) == [0.0, 1.0]


def test_outcomes_are_counted_by_scenario_and_over_all() -> None:
    runs = [run("fork", "effective"), run("fork", "failed"), run("empty", "false")]
    assert counts(runs) == {"effective": 1, "failed": 1, "false": 1}
    fork, empty, everything = by_scenario(runs)
    assert (fork["scenario"], fork["runs"], fork["failed"]) == ("fork", 2, 1)
    assert (empty["false"], empty["failed_between"][0]) == (1, pytest.approx(0.0, abs=1e-12))
    assert everything["scenario"] == "all"
    assert everything["km"] == pytest.approx(0.15)


def test_a_cell_of_the_grid_shows_its_worst_impact() -> None:
    runs = [run("grid car standing 60", "failed", v) for v in (5.0, 10.0)] + [run("fork", "failed", 3.0)]
    (cell,) = grid_cells(runs, {"grid car standing 60": 35.0})
    assert cell == {"target": "car standing", "speed_kmh": 60.0, "impact_kmh": 36.0, "allowed_kmh": 35.0}
