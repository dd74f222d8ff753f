"""The rows of `experiment range`, from readings that are made up."""

import numpy as np
import pytest

from roadblock.eval.ranges import anees, bound_px, normalized_error, rows


def reading(detector: str, error_m: float | None, nees: float | None = None) -> dict[str, object]:
    found_m = None if error_m is None else 10.2 + error_m
    sigma_m = None if error_m is None else 0.1
    common = {"detector": detector, "type": "box", "nominal_m": 10.0, "true_range_m": 10.2, "bound_m": 0.02}
    return common | {"range_m": found_m, "range_sigma_m": sigma_m, "nees": nees}


def test_a_row_says_what_the_readings_come_to() -> None:
    ours, other = rows([reading("ours", 0.05), reading("other", 0.4), reading("ours", -0.15), reading("ours", None)])
    assert (ours["detector"], ours["type"], ours["true_range_m"]) == ("ours", "box", 10.0)
    assert (ours["n"], ours["missed"]) == (3, 1)
    assert ours["bias_m"] == pytest.approx(-0.05)
    assert ours["median_abs_m"] == pytest.approx(0.1)
    assert (ours["coverage_68"], ours["coverage_95"]) == (0.5, 1.0)
    assert ours["bound_m"] == 0.02
    assert other["rms_m"] == pytest.approx(0.4)


def test_what_is_unknown_is_none() -> None:
    (row,) = rows([reading("ours", None) | {"bound_m": None}])
    assert row["missed"] == 1
    assert row["rms_m"] is None
    assert row["bound_m"] is None
    assert anees([reading("ours", 0.1)]) is None


def test_normalized_errors_are_three_on_average() -> None:
    rng = np.random.default_rng(0)
    root = np.array([[1.0, 0, 0], [0.4, 0.2, 0], [-1, 0.3, 2]])
    errors = rng.standard_normal((4000, 3)) @ root.T
    values = [normalized_error(error, root @ root.T) for error in errors]
    assert anees([reading("ours", 0.0, nees) for nees in values]) == pytest.approx(3, rel=0.05)


def test_the_bound_is_that_of_a_known_slope() -> None:
    """A ramp of 4 grey levels a pixel, without noise in it: sigma = sqrt(2) n / (4 sqrt(N)), noise taken off."""
    ramp = np.tile(4 * np.arange(40), (30, 1)).astype(np.uint8)
    mask = np.zeros(ramp.shape, bool)
    mask[5:15, 10:20] = True
    assert bound_px(ramp, mask, 0.5) == pytest.approx(np.sqrt(2) * 0.5 / np.sqrt(100 * (16 - 0.125)))
    assert bound_px(np.full((30, 40), 90, np.uint8), mask, 1.0) == np.inf
