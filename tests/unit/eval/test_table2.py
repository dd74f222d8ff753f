import json
import math

import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.accuracy import Reading
from roadblock.eval.table2 import TARGETS, compare, index_of, paper_records, reading_record, rows

PERSON, BICYCLE, FORK = TARGETS


def records(detector, target, errors_m, true_m=None):
    true_m = target.nominal_m if true_m is None else true_m
    return [
        reading_record(detector, target, seed, Reading(target.type, true_m, true_m + error_m, 0.11))
        for seed, error_m in enumerate(errors_m)
    ]


def test_the_paper_s_figures():
    assert [(t.type, t.nominal_m, t.proposed_m, t.traditional_1_m, t.traditional_2_m) for t in TARGETS] == [
        ("person", 5, 5.03, 5.24, 5.16),
        ("bicycle", 10, 10.02, 10.26, 10.19),
        ("fork", 20, 20.01, 20.51, 20.33),
    ]
    assert [record["type"] for record in paper_records()] == ["person", "bicycle", "fork"]


def test_rows_have_the_promised_keys_and_the_errors_put_in():
    table = rows(
        records("dense", PERSON, [0.1, -0.3, math.nan], 5.1)
        + records("bands", PERSON, [0.2], 5.1)
        + records("dense", FORK, [math.nan])
    )
    assert [(row["type"], row["detector"]) for row in table] == [
        ("person", "dense"),
        ("person", "bands"),
        ("fork", "dense"),
    ]
    row = table[0]
    promised = {"detector", "type", "true_range_m", "n", "bias_m", "rms_m", "median_abs_m", "p95_abs_m", "missed"}
    assert promised <= set(row)
    assert (row["n"], row["missed"], row["true_range_m"], row["nominal_m"]) == (3, 1, 5.1, 5.0)
    assert row["bias_m"] == pytest.approx(-0.1)
    assert row["rms_m"] == pytest.approx(math.sqrt(0.05), abs=1e-5)
    assert row["median_abs_m"] == pytest.approx(0.2)
    assert row["p95_abs_m"] == pytest.approx(0.29)
    assert (row["within_1_sigma"], row["within_2_sigma"]) == (0.5, 0.5)
    assert (table[2]["missed"], table[2]["bias_m"]) == (1, None)
    json.dumps(table, allow_nan=False)


def test_the_target_is_the_nearest_of_its_type():
    objects = [{"type": t, "range_m": z} for t, z in [("car", 5.0), ("person", 9.0), ("person", 5.3), ("person", 20)]]
    assert index_of(PERSON, objects) == 2
    with pytest.raises(ValueRefusedError, match="must show a fork at 20 m, but shows car, person"):
        index_of(FORK, objects)
    with pytest.raises(ValueRefusedError, match="shows nothing"):
        index_of(FORK, [])


def test_stereo_is_compared_with_mono_by_the_median():
    table = rows(
        records("dense", PERSON, [0.1, 0.1, 0.9])
        + records("bands", PERSON, [0.2, 0.2, 0.2])
        + records("mono_ground", PERSON, [0.5, 0.5, 0.5])
        + records("mono_area_oracle", PERSON, [0.4, -0.4, 0.4])
        + records("bands", BICYCLE, [0.1, math.nan])
        + records("mono_ground", BICYCLE, [0.3])
        + records("dense", FORK, [0.1])
    )
    person, bicycle, fork = compare(table)
    assert person == {
        "type": "person",
        "stereo": "dense",
        "stereo_median_abs_m": 0.1,
        "mono": "mono_area_oracle",
        "mono_median_abs_m": 0.4,
        "ratio": 0.25,
    }
    assert (bicycle["stereo"], bicycle["mono"], bicycle["ratio"]) == (None, "mono_ground", None)
    assert (fork["stereo"], fork["mono"], fork["ratio"]) == ("dense", None, None)


def test_a_faultless_mono_makes_no_ratio():
    (person, *_) = compare(rows(records("dense", PERSON, [0.1]) + records("mono_area", PERSON, [0.0])))
    assert (person["mono_median_abs_m"], person["ratio"]) == (0, None)
