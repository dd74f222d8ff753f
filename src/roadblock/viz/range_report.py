"""The page of `experiment range`: its `result.json` as one HTML file that needs nothing else."""

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from roadblock.viz.page import INK_HEX, STYLE, details, library, look, svg, write_html
from roadblock.viz.report import DETECTOR_HEX

Record = Mapping[str, Any]
COLUMNS = (
    ("bias", "bias_m", "+.4f"), ("RMS", "rms_m", ".4f"), ("median |error|", "median_abs_m", ".4f"),
    ("95th pct.", "p95_abs_m", ".4f"), ("bound", "bound_m", ".4f"), ("within 1 &sigma;", "coverage_68", ".0%"),
    ("within 2 &sigma;", "coverage_95", ".0%"),
)  # fmt: skip


def draw_ranges(result: Record) -> str:
    """Return the median error over the range, one panel per type, a line per detector and one for the bound.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library("drawing the experiment's page")
    rows = result["rows"]
    kinds, detectors = (list(dict.fromkeys(row[key] for row in rows)) for key in ("type", "detector"))
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(9, 2.6 * ((len(kinds) + 1) // 2)))
        panels = figure.subplots((len(kinds) + 1) // 2, 2, squeeze=False).ravel()
        figure.subplots_adjust(hspace=0.5, wspace=0.25)
        for axes, kind in zip(panels, kinds, strict=False):
            for name, color in zip(detectors, DETECTOR_HEX, strict=False):
                mine = [r for r in rows if (r["type"], r["detector"]) == (kind, name) and r["median_abs_m"]]
                places = [row["true_range_m"] for row in mine]
                axes.plot(places, [row["median_abs_m"] for row in mine], "o-", color=color, label=name, markersize=3)
            known = {row["true_range_m"]: row["bound_m"] for row in rows if row["type"] == kind and row["bound_m"]}
            axes.plot(list(known), list(known.values()), "--", color=INK_HEX, label="bound", linewidth=1)
            axes.set(xscale="log", yscale="log", title=kind, xlabel="range (m)", ylabel="median |error| (m)")
        for axes in panels[len(kinds) :]:
            axes.axis("off")
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1.2), ncols=4, frameon=False)
        return svg(figure)


def page(result: Record) -> str:
    """Return the experiment as one HTML page; errors as `draw_ranges`."""
    heads = ("detector", "range", "n", "missed", *(head for head, _, _ in COLUMNS))
    head = "".join(f"<th>{name}</th>" for name in heads)
    tables = ""
    for kind in dict.fromkeys(row["type"] for row in result["rows"]):
        body = "".join(_row(row) for row in result["rows"] if row["type"] == kind)
        tables += f'<h2>{escape(kind)}</h2><div class="scroll"><table><thead><tr>{head}</tr></thead>'
        tables += f"<tbody>{body}</tbody></table></div>"
    made = [*result["settings"].items(), *result["machine"].items(), ("commit", result["commit"])]
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Ranges, measured</title><style>{STYLE}</style></head><body>
<h1>Ranges, measured</h1>
<p>{result["runs_done"]} simulated line-ups at each range. ANEES (3-D, own
segmentation): {result["anees"]}, as detected {result["anees_as_detected"]}.
What each detector is, and what is counted, is told in docs/experiments.md.</p>
<div class="scroll">{draw_ranges(result)}</div>
{tables}
<h2>How it was made</h2>
{details([(str(key), str(value)) for key, value in made if not isinstance(value, dict)])}
</body></html>
"""


def write_range_page(path: Path, result: Record) -> None:
    """Write the page, whole or not at all; errors as `write_html` and `draw_ranges`."""
    write_html(path, page(result))


def _row(row: Record) -> str:
    cells = [f"{row['true_range_m']:g} m", str(row["n"]), str(row["missed"])]
    cells += ["&ndash;" if row[key] is None else format(row[key], form) for _, key, form in COLUMNS]
    return f"<tr><td>{escape(row['detector'])}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
