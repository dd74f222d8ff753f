from pathlib import Path

from roadblock.viz.range_report import page, write_range_page


def result() -> dict[str, object]:
    row = {"type": "person", "n": 3, "missed": 1, "bias_m": 0.01, "rms_m": 0.02, "p95_abs_m": 0.05}
    row |= {"bound_m": 0.004, "coverage_68": 0.67, "coverage_95": None}
    rows = [
        row | {"detector": name, "true_range_m": z, "median_abs_m": z * scale}
        for name, scale in (("refined_mean", 0.001), ("<sgbm>", 0.01))
        for z in (5.0, 10.0)
    ]
    common = {"settings": {"runs": 3}, "machine": {"cpu": "any"}, "commit": None}
    return {"rows": rows, "runs_done": 3, "anees": 3.1, "anees_as_detected": 2.9} | common


def test_the_page_holds_plot_and_table(tmp_path: Path) -> None:
    text = page(result())
    assert text.count("<svg") == 1
    assert "refined_mean" in text
    assert "&lt;sgbm&gt;" in text
    assert "<sgbm>" not in text
    assert "&ndash;" in text
    assert "3.1" in text
    write_range_page(tmp_path / "page.html", result())
    assert (tmp_path / "page.html").read_text("utf-8") == text
