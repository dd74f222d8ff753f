"""The page of `experiment avoidance`: its `result.json` as one HTML file that needs nothing else."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from roadblock.viz.page import INK_HEX, STYLE, details, library, look, svg, write_html

Record = Mapping[str, Any]
OUTCOME_HEX = {"effective": "#3f9f63", "failed": "#c94f42", "false": "#d9822b"}


def draw_outcomes(result: Record) -> str:
    """Return where every drive ended, seen from above, and the share of failed ones with 95 % bounds by scenario.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library("drawing the experiment's page")
    rows, runs = result["rows"], result["runs"]
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(9, 3.4 + 0.28 * len(rows)))
        shares, places = figure.subplots(2, 1, height_ratios=(0.6 + 0.28 * len(rows), 2.4))
        figure.subplots_adjust(hspace=0.5)
        for at, row in enumerate(rows):
            low, high = row["failed_between"]
            shares.plot([low, high], [at, at], color=OUTCOME_HEX["failed"], linewidth=2)
            shares.plot([row["failed"] / max(row["runs"], 1)], [at], "o", color=INK_HEX, markersize=4)
        shares.set_yticks(range(len(rows)), [f"{row['scenario']} ({row['runs']})" for row in rows])
        shares.set(xlim=(0, 1), ylim=(len(rows) - 0.5, -0.5), xlabel="share of failed drives, 95 % bounds (Wilson)")
        for outcome, color in OUTCOME_HEX.items():
            mine = [run["at_m"] for run in runs if run["outcome"] == outcome]
            places.scatter(
                [x for x, _ in mine], [y for _, y in mine], s=14, color=color, label=outcome, alpha=0.7, lw=0
            )
        places.set(title="where drives ended", xlabel="along the road (m)", ylabel="to the left (m)")
        places.legend(frameon=False, ncols=3, loc="lower left", bbox_to_anchor=(0.35, 1.0))
        return svg(figure)


def page(result: Record) -> str:
    """Return the experiment as one HTML page; errors as `draw_outcomes`."""
    heads = ("scenario", "drives", "effective", "failed", "false", "km", "failed, 95 % bounds")
    table = _table(heads, [_row(row) for row in result["rows"]])
    bad = [run for run in result["runs"] if run["outcome"] != "effective"]
    told = [[run["scenario"], str(run["seed"]), run["outcome"], run["reason"]] for run in bad]
    reasons = _table(("scenario", "seed", "outcome", "why"), told) if told else "<p>None.</p>"
    grid = ""
    if result["grid"]:
        cells = [
            [cell["target"], f"{cell['speed_kmh']:g}", _kmh(cell["impact_kmh"]), _kmh(cell["allowed_kmh"])]
            for cell in result["grid"]
        ]
        grid = "<h2>Impact speeds</h2>" + _table(("target", "speed (km/h)", "impact (km/h)", "allowed (km/h)"), cells)
    how = "a model of what is found, no pictures" if result["settings"]["fast"] else "rendered pictures"
    made = [*result["settings"].items(), *result["machine"].items(), ("commit", result["commit"])]
    unfinished = " The experiment was interrupted." if result["interrupted"] else ""
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Avoidance, driven</title><style>{STYLE}</style></head><body>
<h1>Avoidance, driven</h1>
<p>{len(result["runs"])} simulated drives, {result["km"]:.2f} km, with {how}.{unfinished} What is driven, and what
counts as effective, failed and false, is told in docs/avoidance.md.</p>
{table}
<div class="scroll">{draw_outcomes(result)}</div>
{grid}
<h2>What went wrong</h2>
{reasons}
<h2>How it was made</h2>
{details([(str(key), str(value)) for key, value in made if not isinstance(value, dict)])}
</body></html>
"""


def write_avoidance_page(path: Path, result: Record) -> None:
    """Write the page, whole or not at all; errors as `write_html` and `draw_outcomes`."""
    write_html(path, page(result))


def _row(row: Record) -> list[str]:
    low, high = row["failed_between"]
    counted = [str(row[key]) for key in ("runs", "effective", "failed", "false")]
    return [row["scenario"], *counted, f"{row['km']:.2f}", f"{low:.1%} to {high:.1%}"]


def _kmh(speed: float | None) -> str:
    return "not known" if speed is None else f"{speed:.1f}"


def _table(heads: tuple[str, ...], rows: list[list[str]]) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escape(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'
