"""Put a result of `roadblock experiment range` on BENCHMARK.md: `python benchmarks/accuracy/ranges.py RESULT.json`."""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save


def main() -> None:
    """Read, save."""
    result = json.loads(Path(sys.argv[1]).read_text())
    rows = []
    for row in result["rows"]:
        lengths = ["" if row[key] is None else f"{row[key]:.3f}" for key in ("median_abs_m", "p95_abs_m", "bound_m")]
        ratio = row["median_abs_m"] / (0.6745 * row["bound_m"]) if row["bound_m"] and row["median_abs_m"] else None
        shares = ["" if row[key] is None else f"{row[key]:.2f}" for key in ("coverage_68", "coverage_95")]
        found = [row["type"], f"{row['true_range_m']:g} m", row["detector"], row["n"], row["missed"]]
        rows.append([*found, *lengths, "" if ratio is None else f"{ratio:.1f}", *shares])
    s = result["settings"]
    save(
        "ranges",
        f"roadblock experiment range --runs {s['runs']} --seed {s['seed']} --quality {s['quality']}",
        ["obstacle", "at", "measured by", "n", "missed", "median |error| m", "95 % m", "bound m", "median over bound's",
         "within 1 sigma", "2 sigma"],
        rows,
        f"{result['runs_done']} of {s['runs']} line-ups done. ANEES, refined {result['anees']}, as detected "
        f"{result['anees_as_detected']}. Measured at commit {result['commit']}; docs/experiments.md "
        "says what each row is.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
