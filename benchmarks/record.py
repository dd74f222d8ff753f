"""Results of benchmarks: JSON files with commit and machine, and the page BENCHMARK.md made from them."""

import json
import sys
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from roadblock.io.machine import machine_record, package_commit

RESULTS = Path(__file__).parent / "results"
PAGE = Path(__file__).parents[1] / "BENCHMARK.md"
HEAD = """# Benchmarks

Made by `python benchmarks/record.py` from `benchmarks/results/*.json`; do not edit. Each table names the command that
measured it, the commit and the machine. Times are only comparable within one table: all its rows were measured in
turns in one run.
"""


def save(
    name: str,
    command: str,
    columns: list[str] | None,
    rows: list[Any],
    notes: str = "",
    more: dict[str, Any] | None = None,
) -> None:
    """Write one benchmark's table and the page of all of them.

    Rows are lists of as many cells as there are columns, or dictionaries that name their own; `more` goes beside them.
    """
    record = {
        "command": command,
        "commit": package_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine_record(),
        "columns": columns or list(rows[0]),
        "rows": rows,
        "notes": notes,
    } | (more or {})
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(record, indent=1, allow_nan=False) + "\n")
    write_page()


def write_page() -> None:
    """Turn every result file into a section of the page."""
    sections = [HEAD]
    for path in sorted(RESULTS.glob("*.json")):
        r = json.loads(path.read_text())
        rows = [row.values() if isinstance(row, dict) else row for row in r["rows"]]
        table = [r["columns"], ["---"] * len(r["columns"]), *rows]
        sections.append(f"## {path.stem.replace('_', ' ')}\n")
        if r["notes"]:
            sections.append(r["notes"] + "\n")
        sections.append(
            "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in table) + "\n"
        )
        m = r["machine"]
        sections.append(
            f"`{r['command']}`, {r['date']}, commit {r['commit']}, {m['cpu']}, {m['cores']} cores, "
            f"Python {m['python']}, OpenCV {m['opencv']}, numpy {m['numpy']}.\n"
        )
    PAGE.write_text("\n".join(sections))


if __name__ == "__main__":
    sys.exit(write_page())
