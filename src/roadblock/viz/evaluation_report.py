"""The page of `roadblock evaluate`: its `evaluation.json` as one HTML file that needs nothing else."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from roadblock.viz.page import INK_HEX, STYLE, details, library, look, svg, write_html
from roadblock.viz.report import DETECTOR_HEX, LINEAR_M

Record = Mapping[str, Any]
WHAT = "drawing the evaluation's page"
DOT_PX = 14


def draw_errors(readings: Sequence[Record]) -> str:
    """Return the errors of ranges over the true range, a colour per type; what was missed stands on the lower edge.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library(WHAT)
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(9, 3.4))
        axes = figure.subplots()
        axes.axhline(0, color=INK_HEX, linewidth=0.8)
        axes.set_yscale("symlog", linthresh=LINEAR_M)
        for k, kind in enumerate(sorted({r["type"] for r in readings})):
            mine = [r for r in readings if r["type"] == kind]
            color = DETECTOR_HEX[k % len(DETECTOR_HEX)]
            found = [(r["true_range_m"], r["range_m"] - r["true_range_m"]) for r in mine if r["range_m"] is not None]
            missed = [r["true_range_m"] for r in mine if r["range_m"] is None]
            axes.scatter(*np.array(found).reshape(-1, 2).T, s=DOT_PX, color=color, alpha=0.6, lw=0, label=kind)
            axes.plot(
                missed, [0.02] * len(missed), "x", color=color, markersize=4, transform=axes.get_xaxis_transform()
            )
        errors = [abs(r["range_m"] - r["true_range_m"]) for r in readings if r["range_m"] is not None]
        reach_m = 2 * max([0.5, *errors])
        axes.set(xlabel="true range (m)", ylabel="measured minus true (m)", ylim=(-reach_m, reach_m))
        axes.yaxis.set_major_formatter(lambda error_m, _: f"{error_m:+g}" if error_m else "0")
        axes.grid(axis="y", alpha=0.25, color=INK_HEX, linewidth=0.6)
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=6, frameon=False)
        return svg(figure)


def draw_bands(curves: Mapping[str, Sequence[Record]]) -> str:
    """Return shares by range band as steps, one line for each name; rows hold `from_m`, `to_m`, `share`, `n`.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library(WHAT)
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(9, 2.6))
        axes = figure.subplots()
        for k, ((name, rows), color) in enumerate(zip(curves.items(), DETECTOR_HEX, strict=False), 1):
            known = [row for row in rows if row["share"] is not None]
            for row in known:
                axes.plot([row["from_m"], row["to_m"]], [row["share"]] * 2, color=color, linewidth=2.5)
                at = row["from_m"] + k / (len(curves) + 1) * (row["to_m"] - row["from_m"])
                words = {"textcoords": "offset points", "fontsize": "small", "color": color, "ha": "center"}
                axes.annotate(str(row["n"]), (at, row["share"]), (0, 3), **words)
            axes.plot([], [], color=color, linewidth=2.5, label=name)
        axes.set(xlabel="range (m)", ylabel="share", ylim=(-0.03, 1.1))
        axes.grid(axis="y", alpha=0.25, color=INK_HEX, linewidth=0.6)
        axes.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=4, frameon=False)
        return svg(figure)


def draw_confusion(confusion: Record) -> str:
    """Return true classes against what they were called, each row's shares as tints, with the counts.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    matplotlib = library(WHAT)
    counts = np.array(confusion["counts"], float)
    shares = counts / np.maximum(counts.sum(1, keepdims=True), 1)
    with matplotlib.rc_context(look()):
        figure = matplotlib.figure.Figure(figsize=(0.9 * counts.shape[1] + 2, 0.42 * counts.shape[0] + 1))
        axes = figure.subplots()
        for (i, j), count in np.ndenumerate(counts):
            box = {"color": DETECTOR_HEX[0], "alpha": 0.75 * shares[i, j], "lw": 0}
            axes.add_patch(matplotlib.patches.Rectangle((j - 0.5, i - 0.5), 1, 1, **box))
            if count:
                axes.text(j, i, f"{count:.0f}", ha="center", va="center", fontsize="small")
        axes.set_xticks(range(counts.shape[1]), confusion["called"], rotation=30, ha="right")
        axes.set_yticks(range(counts.shape[0]), confusion["classes"])
        axes.set(xlim=(-0.5, counts.shape[1] - 0.5), ylim=(counts.shape[0] - 0.5, -0.5), xlabel="called", ylabel="true")
        return svg(figure)


def page(result: Record) -> str:
    """Return an evaluation as one HTML page; errors as `draw_errors`."""
    frames = result["frames"]
    sections = [_things(result["things"]), _tracks(result["tracks"]), _maps(result["maps"])]
    made = {"results": result["results"], "truth": result["truth"], **result["machine"], "commit": result["commit"]}
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Results, judged</title><style>{STYLE}</style></head><body>
<h1>Results, judged</h1>
<p>{frames["judged"]} frames with truth, {frames["missing"]} of them without results;
{frames["without_truth"]} frames of the results have no truth. What each figure means is told in docs/evaluation.md.</p>
{"".join(sections)}
<h2>How it was made</h2>
{details([(str(key), str(value)) for key, value in made.items() if not isinstance(value, dict)])}
</body></html>
"""


def write_evaluation_page(path: Path, result: Record) -> None:
    """Write the page, whole or not at all; errors as `write_html` and `draw_errors`."""
    write_html(path, page(result))


def _things(things: Record | None) -> str:
    if things is None:
        return ""
    curves = {
        "recall": _curve(things["recall"], "type", "recall"),
        "with the right range": _curve(things["recall"], "type", "recall_right_range"),
        "precision": _curve(things["precision"], "class", "precision"),
    }
    text = "<h2>Named things</h2>" + _figure(draw_errors(things["readings"])) + _figure(draw_bands(curves))
    text += '<p class="soft">Numbers are counts. A cross is a thing that was missed.</p>'
    if things["confusion"]["right"] is not None:
        text += "<h3>What they were called</h3>" + _figure(draw_confusion(things["confusion"]))
    for head, key in (
        ("Recall and range errors", "recall"),
        ("Precision", "precision"),
        ("Sizes up to 15 m", "sizes"),
        ("Average precision, KITTI", "kitti_ap"),
        ("Average precision by distance on the road", "distance_ap"),
    ):
        text += f"<h3>{head}</h3>{table(things[key])}"
    return text


def _tracks(tracks: Record | None) -> str:
    if tracks is None:
        return ""
    text = f"<h2>Over time</h2>{table([{'by': 'box', **tracks['scores']}, {'by': 'place', **tracks['scores_place']}])}"
    for head, key in (("Velocities over ground", "velocity"), ("Times to contact", "ttc")):
        text += f"<h3>{head}</h3>{table(tracks[key])}"
    return f"{text}<h3>Warnings</h3>{table([tracks['warnings']])}"


def _maps(maps: Record | None) -> str:
    if maps is None:
        return ""
    curves = {
        "things found": _curve(maps["things"], "", "found_share"),
        "precision": _curve(maps["precision"], "class", "precision"),
        "free space right": _curve(maps["free_space"]["bands"], "", "ok"),
    }
    things = [{**{k: v for k, v in row.items() if k != "range_error"}, **_error(row)} for row in maps["things"]]
    free = [{"from_m": 0, "to_m": 40, **maps["free_space"]}, *maps["free_space"]["bands"]]
    text = "<h2>Against true depths</h2>" + _figure(draw_errors(maps["readings"])) + _figure(draw_bands(curves))
    text += f"<h3>Things</h3>{table(things)}<h3>Precision</h3>{table(maps['precision'])}"
    text += f"<h3>Free space</h3>{table([{k: v for k, v in row.items() if k != 'bands'} for row in free])}"
    return text + (f"<h3>Ground</h3>{table([maps['ground']])}" if maps["ground"] else "")


def _error(row: Record) -> dict[str, Any]:
    return {key: value for key, value in row["range_error"].items() if key not in ("n", "missed")}


def _figure(drawn: str) -> str:
    return f'<div class="scroll">{drawn}</div>'


def _curve(rows: Sequence[Record], group: str, share: str) -> list[dict[str, Any]]:
    """Return the share by range band of all types, without the bands that join others."""
    mine = [row for row in rows if not group or row[group] == "any"]
    starts = sorted({row["from_m"] for row in mine})
    single = [row for row in mine if not any(row["from_m"] < start < row["to_m"] for start in starts)]
    return [{"from_m": r["from_m"], "to_m": r["to_m"], "share": r[share], "n": _count(r)} for r in single]


def _count(row: Record) -> int:
    return int(row["n"] if "n" in row else row["supported"] + row["unsupported"] + row["hidden"])


def table(rows: Sequence[Record]) -> str:
    """Return records as an HTML table; the first one's keys are its head, and what a later one lacks is empty."""
    if not rows:
        return '<p class="soft">Nothing to judge.</p>'
    head = "".join(f"<th>{escape(key.replace('_', ' '))}</th>" for key in rows[0])
    body = "".join(f"<tr>{''.join(f'<td>{_cell(row.get(key))}</td>' for key in rows[0])}</tr>" for row in rows)
    return f'<div class="scroll"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _cell(value: object) -> str:
    if value is None:
        return "&ndash;"
    return escape(f"{value:.3f}" if isinstance(value, float) else str(value))
