"""The page of a calibration: can the rig be trusted, how far off will ranges be, and what to do next.

One HTML file that fetches nothing and reads in light and dark.
"""

import math
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from roadblock.values.calibration import Calibration, LensTrial
from roadblock.values.checks import FloatArray
from roadblock.viz.calibration_plots import (
    Panel,
    coverage_panels,
    noise_panels,
    range_panels,
    residual_panels,
    shape_panels,
    view_panels,
)
from roadblock.viz.page import STYLE, details, library, look, svg, write_html

WHAT = "drawing the calibration's page"
WORDS = {
    "good": "Good: this calibration can be used.",
    "usable": "Usable, with care.",
    "refused": "Refused: this set of pictures cannot support the rig.",
}
MORE_STYLE = """
@media (max-width: 30rem) { th, td { padding: .3rem .4rem; } }
.verdict { border-radius: .5rem; padding: .8rem 1rem; background: var(--best); font-size: 1.15rem; }
.verdict.usable { background: var(--mind); } .verdict.refused { background: var(--bad); }
.panels { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 24rem), 1fr)); gap: 1rem 2rem;
          align-items: start; }
figure { margin: 0; min-width: 0; } figcaption { color: var(--soft); font-size: .9rem; }
.wide svg { min-width: 36rem; } :is(th, td).words { text-align: left; white-space: normal; min-width: 14rem; }
"""


def in_metres(length_m: float) -> str:
    """Return a length in words with its unit: "0.42 mm", "12 mm", "0.35 m"; "unknown" for NaN."""
    if not math.isfinite(length_m):
        return "unknown"
    value, unit = (1000 * length_m, "mm") if length_m < 0.0995 else (length_m, "m")
    return f"{value:.{max(0, 1 - math.floor(math.log10(value))) if value > 0 else 0}f} {unit}"


def range_sentence(calibration: Calibration) -> str:
    """Return how far off ranges will be, in one sentence: the median over the image, since corners can be far worse."""
    medians_m = {z_m: _median(field) for z_m, field in calibration.range_sigma_m.items()}
    parts = [f"{in_metres(sigma_m)} at {z_m:g} m" for z_m, sigma_m in medians_m.items() if math.isfinite(sigma_m)]
    if not parts:
        return "How far off ranges will be cannot be told."
    return (
        f"Because of this calibration alone, ranges will typically be off by {', '.join(parts)} (one standard "
        "deviation, median over the image)."
    )


def _median(field: FloatArray) -> float:
    known = field[np.isfinite(field)]
    return float(np.median(known)) if known.size else math.nan


def scale_sentence(calibration: Calibration) -> str:
    """Return what is known about the scale of the board."""
    board = calibration.board
    if math.isnan(board.square_sigma_m):
        return (
            "Nobody measured the board: its scale cannot be seen in pictures, and 0.1 % of it is 0.1 % of every range. "
            "Measure over many squares and pass --span."
        )
    share = board.square_sigma_m / board.square_m
    return (
        f"The board's step was measured as {1000 * board.square_m:.4g} mm, +- {share:.2%}: the same share of every "
        f"range ({in_metres(20 * share)} at 20 m), which the figures above include."
    )


def calibration_page(calibration: Calibration, record: Mapping[str, Any]) -> str:
    """Return the page.

    Parameters
    ----------
    calibration
        What was found.
    record
        The same as `calibration.json` has it (see docs/calibration.md): its parameters, what was left out, and what
        made it.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    """
    c = calibration
    with library(WHAT).rc_context(look()):
        plots = "".join(f"<h2>{title}</h2>{words}{_plots(panels)}" for title, words, panels in _sections(c) if panels)
    used, total = record["views_used"], record["views_total"]
    return f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>Calibration: {escape(c.verdict)}</title><style>{STYLE}{MORE_STYLE}</style></head><body>
<h1>Calibration of a stereo rig</h1>
<p class="verdict {c.verdict}"><strong>{WORDS[c.verdict]}</strong> {_unbroken(range_sentence(c))}</p>
{_listed(c.reasons)}
{_ranges_table(c)}
{_next_view(c)}
<p><strong>Scale.</strong> {escape(scale_sentence(c))}</p>
<p class="soft">{used} of {total} views used; baseline {1000 * c.rig.baseline_m:.3f} mm; residuals
{c.rms_px:.3f} px RMS; rows {c.epipolar_rms_px:.3f} px RMS apart after rectification; lens {escape(record["lens"])}.
RMS alone says little about ranges: the table above is what counts.</p>
{_left_out(record)}
{plots}
{_lens_table(c)}
<h2>Parameters</h2>
{_parameter_table(record)}
<h2>How it was made</h2>
{details(_provenance(record))}
</body></html>
"""


def write_calibration_page(path: Path, calibration: Calibration, record: Mapping[str, Any]) -> None:
    """Write the page, whole or not at all.

    Raises
    ------
    MissingExtraError
        If matplotlib is not installed.
    OutputError
        If the file cannot be written.
    """
    write_html(path, calibration_page(calibration, record))


def _sections(c: Calibration) -> list[tuple[str, str, list[Panel]]]:
    """Return title, words (HTML) and panels of each section."""
    missing = _listed(c.coverage.missing)
    return [
        (
            "Predicted range error over the image",
            _soft(
                "One standard deviation at each place of the left image; a dash where the right camera does not see."
            ),
            range_panels(c),
        ),
        (
            "Residuals",
            _soft("Measured minus predicted, enlarged. A pattern that hangs together means that the model is wrong."),
            residual_panels(c),
        ),
        (
            "Are the errors just noise?",
            _soft("They should fill the dashed curve, and show no trend with the distance from the centre."),
            noise_panels(c),
        ),
        ("View by view", "", view_panels(c)),
        ("Coverage", missing, coverage_panels(c)),
        ("Rows after rectification, and the board's shape", "", shape_panels(c)),
    ]


def _plots(panels: Sequence[Panel]) -> str:
    if len(panels) == 1:
        return _plot(panels[0], "wide scroll", 8.5)
    return f'<div class="panels">{"".join(_plot(panel, "", 4.6) for panel in panels)}</div>'


def _plot(panel: Panel, kind: str, width: float) -> str:
    figure = library(WHAT).figure.Figure(figsize=(width, panel.height))
    panel.draw(figure.subplots())
    return f'<figure class="{kind}">{svg(figure)}<figcaption>{escape(panel.caption)}</figcaption></figure>'


def _soft(words: str) -> str:
    return f'<p class="soft">{words}</p>'


def _unbroken(words: str) -> str:
    """Keep lengths and their units on one line."""
    return words.replace(" mm", "&nbsp;mm").replace(" m,", "&nbsp;m,").replace(" m ", "&nbsp;m ")


def _listed(sentences: Sequence[str]) -> str:
    items = "".join(f"<li>{escape(sentence[:1].upper() + sentence[1:])}</li>" for sentence in sentences)
    return f"<ul>{items}</ul>" if items else ""


def _ranges_table(c: Calibration) -> str:
    rows = "".join(
        f"<tr><td>{z_m:g} m</td>{_spread(c.range_sigma_m[z_m])}<td>{in_metres(sigma_m)}</td></tr>"
        for z_m, sigma_m in c.range_rms_m.items()
    )
    return (
        '<div class="scroll"><table><thead><tr><th>range</th><th>off by (median)</th><th>at worst</th><th>RMS</th></tr>'
        f"</thead><tbody>{rows}</tbody></table></div>"
    )


def _spread(field: FloatArray) -> str:
    worst_m = float(np.nanmax(field)) if np.isfinite(field).any() else math.nan
    return f"<td>{in_metres(_median(field))}</td><td>{in_metres(worst_m)}</td>"


def _next_view(c: Calibration) -> str:
    if not c.coverage.next_view:
        return ""
    gain = c.coverage.next_gain
    then = f" It would bring the range error at 20 m to {gain:.0%} of what it is now." if math.isfinite(gain) else ""
    advice = c.coverage.next_view.rstrip(".")
    return f"<p><strong>Next picture.</strong> {escape(advice[:1].upper() + advice[1:])}.{then}</p>"


def _left_out(record: Mapping[str, Any]) -> str:
    if not record["left_out"]:
        return ""
    rows = "".join(
        f'<tr><td>{escape(row["view"])}</td><td class="words">{escape(row["reason"])}</td></tr>'
        for row in record["left_out"]
    )
    return (
        '<h2>Left out</h2><div class="scroll"><table><thead><tr><th>view</th><th class="words">why</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
    )


def _lens_table(c: Calibration) -> str:
    if not c.lens_trials:
        return ""
    rows = "".join(
        f"<tr class='{_mark(trial)}'><td>{escape(trial.lens)}</td>"
        f"<td>{trial.parameters}</td><td>{_figure(trial.fitted_rms_px)}</td><td>{_figure(trial.held_out_rms_px)}</td>"
        f'<td class="words">{escape(trial.verdict)}</td></tr>'
        for trial in c.lens_trials
    )
    heads = ("lens", "parameters", "RMS of fitted views (px)", "of views held out (px)")
    return (
        "<h2>Lens models tried</h2>"
        f'<div class="scroll"><table><thead><tr>{"".join(f"<th>{head}</th>" for head in heads)}'
        f'<th class="words">verdict</th></tr></thead><tbody>{rows}</tbody></table></div>'
    )


def _mark(trial: LensTrial) -> str:
    return "best" if trial.verdict.startswith("chosen") else ""


def _figure(value: float) -> str:
    return f"{value:.4f}" if math.isfinite(value) else "&ndash;"


def _parameter_table(record: Mapping[str, Any]) -> str:
    rows = "".join(
        f"<tr><td>{escape(row['name'])}</td><td>{row['value']:.6g}</td><td>{row['sigma']:.2g}</td></tr>"
        for row in record["parameters"]
    )
    return (
        '<div class="scroll"><table><thead><tr><th>parameter</th><th>value</th><th>one sigma</th></tr></thead>'
        f"<tbody>{rows}</tbody></table></div>"
        '<p class="soft">Lengths in metres, angles in radians (a rotation vector), all else in pixels; lens '
        "coefficients have no unit. Their errors hang together: single sigmas do not say what a range is worth.</p>"
    )


def _provenance(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    pairs = [
        ("version", f"{record['version']}, commit {record['commit'] or 'unknown'}"),
        ("finished", str(record["finished"])),
    ]
    groups = (record["source"], record["settings"], record["machine"])
    return pairs + [(str(key), str(value)) for group in groups for key, value in group.items()]
