"""The page of the paper's experiment: its `result.json` as one HTML file that needs nothing else."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from roadblock.viz.page import INK_HEX, STYLE, details, library, look, svg, write_html

Record = Mapping[str, Any]

DETECTOR_HEX = ("#2f8fd8", "#d9822b", "#3f9f63", "#c05a9b", "#8a78d6", "#a08a3c", "#4aa6a6", "#b8584f")
PAPER_MARKS = (
    ("proposed_m", "paper, proposed", "D"),
    ("traditional_1_m", "paper, traditional 1", "v"),
    ("traditional_2_m", "paper, traditional 2", "^"),
)
LINEAR_M = 0.1
"""The error axis is linear up to here and logarithmic beyond: errors of centimetres and metres share it."""


def draw_errors(result: Record) -> str:
    """Return the errors of every detector, one panel per target, the paper's single readings beside them.

    Parameters
    ----------
    result
        Plain values as in `result.json`: `readings` and `paper` (see docs/experiments.md).

    Returns
    -------
    An `<svg>` element; its text and lines have the surrounding text's colour.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library("drawing the experiment's page")
    detectors = list(dict.fromkeys(reading["detector"] for reading in result["readings"]))
    targets = result["paper"]
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(9, len(targets) * (0.9 + 0.32 * len(detectors))))
        panels = figure.subplots(len(targets), 1, squeeze=False, sharex=True)[:, 0]
        figure.subplots_adjust(hspace=0.45)
        for axes, target in zip(panels, targets, strict=True):
            _draw_panel(axes, target, detectors, result["readings"])
        panels[-1].set_xlabel("error of the range (m): measured minus true")
        panels[0].legend(loc="lower left", bbox_to_anchor=(0, 1.15), ncols=3, frameon=False)
        return svg(figure)


def _draw_panel(axes: Any, target: Record, detectors: Sequence[str], readings: Sequence[Record]) -> None:
    rng = np.random.default_rng(0)
    axes.set_xscale("symlog", linthresh=LINEAR_M)
    axes.xaxis.set_major_formatter(lambda error_m, _: f"{error_m:+g}" if error_m else "0")
    axes.axvline(0, color=INK_HEX, linewidth=0.8)
    for row, detector in enumerate(detectors):
        mine = [r for r in readings if (r["detector"], r["type"]) == (detector, target["type"])]
        errors_m = [r["range_m"] - r["true_range_m"] for r in mine if r["range_m"] is not None]
        color = DETECTOR_HEX[row % len(DETECTOR_HEX)]
        if errors_m:
            lines = {"color": color, "linewidth": 1.4}
            parts = ("boxprops", "whiskerprops", "capprops", "medianprops")
            axes.boxplot(
                errors_m, positions=[row], orientation="horizontal", widths=0.62, whis=(5, 95), showfliers=False,
                manage_ticks=False, **dict.fromkeys(parts, lines),
            )  # fmt: skip
            axes.scatter(errors_m, row + rng.uniform(-0.2, 0.2, len(errors_m)), s=7, color=color, alpha=0.55, lw=0)
        missed = len(mine) - len(errors_m)
        if missed:
            axes.annotate(
                f"{missed} missed", (1.01, row), xycoords=("axes fraction", "data"), va="center", fontsize="small"
            )
    for key, label, marker in PAPER_MARKS:
        error_m = target[key] - target["nominal_m"]
        axes.plot(error_m, len(detectors), marker, color=INK_HEX, markerfacecolor="none", label=label, clip_on=False)
    axes.set_yticks(range(len(detectors) + 1), [*detectors, "paper"])
    axes.set_ylim(len(detectors) + 0.6, -0.6)
    axes.set_title(f"{target['type']} at {target['nominal_m']:g} m")
    axes.grid(axis="x", alpha=0.25, color=INK_HEX, linewidth=0.6)


def page(result: Record) -> str:
    """Return the experiment as one HTML page: it fetches nothing, and reads well in light and dark.

    Parameters
    ----------
    result
        Plain values as in `result.json` (see docs/experiments.md).

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    settings = result["settings"]
    tables = "".join(_target(target, result) for target in result["paper"])
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Table 2 of the paper, measured</title><style>{STYLE}</style></head><body>
<h1>Table 2 of the paper, measured</h1>
<p>Range of a person at 5 m, a bicycle at 10 m and a fork of the road at 20 m from a camera pair at
{settings["speed_kmh"]:g} km/h in daylight: {result["runs_done"]} independent simulated
run{"" if result["runs_done"] == 1 else "s"} per detector, errors against exact truth.{_unfinished(result)}</p>
<p class="soft">Range is {escape(settings["range"])}. The paper gives one reading per obstacle and algorithm; one
reading says nothing about a distribution, so its figures stand beside ours without a verdict.</p>
<h2>In short</h2>
<ul>{"".join(f"<li>{_verdict(row)}</li>" for row in result["comparison"])}</ul>
<h2>Errors</h2>
<div class="scroll">{draw_errors(result)}</div>
<p class="soft">One dot per run; box: middle half; whiskers: 5th to 95th percentile. The axis is linear up to
&plusmn;{LINEAR_M:g} m and logarithmic beyond.</p>
{tables}
<h2>How it was made</h2>
{details(_provenance(result))}
</body></html>
"""


def write_page(path: Path, result: Record) -> None:
    """Write the page of a `result.json`, whole or not at all.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    OutputError
        If the file cannot be written.
    """
    write_html(path, page(result))


def _unfinished(result: Record) -> str:
    asked = result["settings"]["runs"]
    return f" <strong>Interrupted: {asked} were asked for.</strong>" if result["runs_done"] < asked else ""


def _verdict(row: Record) -> str:
    what = f"<strong>{escape(row['type'])}</strong>: "
    if row["stereo"] is None:
        return what + "no stereo detector found it in more than half of the runs."
    best = f"best stereo detector {escape(row['stereo'])}, median |error| {row['stereo_median_abs_m']:.3f} m"
    if row["ratio"] is None:
        return f"{what}{best}; no mono algorithm to compare with."
    return f"{what}{best}; best mono {escape(row['mono'])}, {row['mono_median_abs_m']:.3f} m; ratio {row['ratio']:.2f}."


COLUMNS = (
    ("bias", "bias_m", "+.3f"), ("RMS", "rms_m", ".3f"), ("median |error|", "median_abs_m", ".3f"),
    ("95th pct.", "p95_abs_m", ".3f"), ("within 1 &sigma;", "within_1_sigma", ".0%"),
    ("within 2 &sigma;", "within_2_sigma", ".0%"),
)  # fmt: skip


def _target(target: Record, result: Record) -> str:
    rows = [row for row in result["rows"] if row["type"] == target["type"]]
    known = [row["median_abs_m"] for row in rows if row["median_abs_m"] is not None]
    body = "".join(_row(row, row["median_abs_m"] is not None and row["median_abs_m"] == min(known)) for row in rows)
    for key, label, _ in PAPER_MARKS:
        error_m = target[key] - target["nominal_m"]
        cells = ["1", "0", f"{error_m:+.2f}", "", f"{abs(error_m):.2f}", "", "", ""]
        name = f"{label}: {target[key]:.2f} m"
        body += f'<tr class="paper"><td>{name}</td>{"".join(f"<td>{cell}</td>" for cell in cells)}</tr>'
    heads = ("detector", "runs", "missed", *(head for head, _, _ in COLUMNS))
    return (
        f"<h2>{escape(target['type'].capitalize())} at {target['nominal_m']:g} m</h2>"
        f'<div class="scroll"><table><thead><tr>{"".join(f"<th>{head}</th>" for head in heads)}</tr></thead>'
        f"<tbody>{body}</tbody></table></div>"
    )


def _row(row: Record, is_best: bool) -> str:
    cells = [str(row["n"]), str(row["missed"])]
    cells += ["&ndash;" if row[key] is None else format(row[key], form) for _, key, form in COLUMNS]
    opening = '<tr class="best">' if is_best else "<tr>"
    return f"{opening}<td>{escape(row['detector'])}</td>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _provenance(result: Record) -> list[tuple[str, str]]:
    groups = {"settings": result["settings"], "machine": result["machine"]}
    pairs = [
        ("version", f"{result['version']}, commit {result['commit'] or 'unknown'}"),
        ("finished", result["finished"]),
    ]
    return pairs + [
        (str(key), str(value))
        for group in groups.values()
        for key, value in group.items()
        if not isinstance(value, dict)
    ]
