"""Put a result of `roadblock experiment table2` on BENCHMARK.md: `python benchmarks/accuracy/table2.py RESULT.json`."""

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

FIGURES = ("bias_m", "rms_m", "median_abs_m", "p95_abs_m")


def main() -> None:
    """Read, save."""
    result = json.loads(Path(sys.argv[1]).read_text())
    rows = [
        [f"{row['type']} {row['nominal_m']:g} m", row["detector"], row["n"], row["missed"]]
        + ["" if row[key] is None else f"{row[key]:.3f}" for key in FIGURES]
        for row in result["rows"]
    ]
    ratios = ", ".join(f"{c['type']} {c['ratio']:.2f} ({c['stereo']} / {c['mono']})" for c in result["comparison"])
    s = result["settings"]
    save(
        "table2",
        f"roadblock experiment table2 --runs {s['runs']} --seed {s['seed']} --quality {s['quality']}",
        ["obstacle", "measured by", "runs", "missed", "bias m", "RMS m", "median |error| m", "95 % m"],
        rows,
        f"Best stereo over best mono, median |error|: {ratios}. Bar: 0.5. Measured at commit {result['commit']}.",
    )


if __name__ == "__main__":
    main()
