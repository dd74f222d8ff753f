from pathlib import Path

from roadblock.eval.avoidance import by_scenario
from roadblock.viz.avoidance_report import page, write_avoidance_page


def result(**changes: object) -> dict[str, object]:
    common = {"km": 0.05, "impact_mps": 0.0, "at_m": [40.0, -0.6]}
    runs = [
        {"scenario": "fork", "seed": 1, "outcome": "effective", "reason": "passed everything"} | common,
        {"scenario": "fork", "seed": 2, "outcome": "failed", "reason": "touched a <fork>"} | common,
    ]
    cell = {"target": "car standing", "speed_kmh": 50.0, "impact_kmh": 12.34, "allowed_kmh": None}
    made = {"settings": {"runs": 2, "fast": False}, "machine": {"cpu": "any"}, "commit": None, "interrupted": False}
    return {"rows": by_scenario(runs), "runs": runs, "km": 0.1, "grid": [cell]} | made | changes


def test_the_page_holds_table_plot_grid_and_reasons(tmp_path: Path) -> None:
    text = page(result())
    assert text.count("<svg") == 1
    assert "touched a &lt;fork&gt;" in text
    assert "<fork>" not in text
    assert "12.3" in text
    assert "not known" in text
    assert "rendered pictures" in text
    assert "interrupted" not in text
    write_avoidance_page(tmp_path / "page.html", result())
    assert (tmp_path / "page.html").read_text("utf-8") == text


def test_without_a_grid_or_failures_there_is_nothing_of_them() -> None:
    whole = result()
    good = [run for run in whole["runs"] if run["outcome"] == "effective"]  # type: ignore[attr-defined]
    text = page(result(runs=good, rows=by_scenario(good), grid=[], interrupted=True, settings={"fast": True}))
    assert "None." in text
    assert "Impact speeds" not in text
    assert "interrupted" in text
    assert "no pictures" in text
