"""What the HTML pages share: style, plots as SVG in the page's own colours, and writing them whole.

The only file that imports matplotlib (extra `report`), and only when a plot is asked for.
"""

import io
import os
import re
from contextlib import suppress
from html import escape
from pathlib import Path
from types import ModuleType
from typing import Any

from roadblock.errors import MissingExtraError, OutputError

INK_HEX = "#010203"
"""Stands for the page's own text colour while matplotlib draws."""

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --paper: #ffffff; --soft: #5b6673; --line: #d5dbe1; --best: #e3f3e8;
        --mind: #fdf3d8; --bad: #fbe3e0; }
@media (prefers-color-scheme: dark) {
  :root { --ink: #e4e8ed; --paper: #14171b; --soft: #9aa5b1; --line: #343b44; --best: #1d3a29; --mind: #40351a;
          --bad: #452220; }
}
body { color: var(--ink); background: var(--paper); font: 16px/1.5 system-ui, sans-serif; max-width: 64rem;
       margin: 0 auto; padding: 1.5rem; }
h1 { line-height: 1.2; } h2 { margin-top: 2.2rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; white-space: nowrap; }
th, td { padding: .3rem .8rem; text-align: right; border-bottom: 1px solid var(--line); }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
tr.best td { background: var(--best); } tr.paper td { color: var(--soft); font-style: italic; }
.soft { color: var(--soft); } svg { width: 100%; height: auto; color: var(--ink); } svg text { font-family: inherit; }
dt { float: left; clear: left; width: 9rem; color: var(--soft); } dd { margin-left: 9rem; overflow-wrap: anywhere; }
"""


def library(what: str) -> ModuleType:
    """Return matplotlib.

    Raises
    ------
    MissingExtraError
        If it is not installed; the message starts with `what`.
    """
    try:
        import matplotlib.figure
    except ImportError as error:
        raise MissingExtraError(what, "report") from error
    return matplotlib


def look() -> dict[str, Any]:
    """Return matplotlib's settings for a plot on a page."""
    ink = ("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color")
    return {
        **dict.fromkeys(ink, INK_HEX),
        "svg.fonttype": "none",
        "svg.hashsalt": "roadblock",
        "font.family": "sans-serif",
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.titlelocation": "left",
    }


def svg(figure: Any) -> str:
    """Return a matplotlib figure as an `<svg>` element; its text and lines have the surrounding text's colour."""
    text = io.StringIO()
    metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(text, format="svg", transparent=True, bbox_inches="tight", metadata=metadata)
    drawn = text.getvalue()
    # names of groups, which nothing refers to, would come again in the next plot of the page
    return re.sub(r'<g id="[^"]*"', "<g", drawn[drawn.index("<svg") :]).replace(INK_HEX, "currentColor")


def details(pairs: list[tuple[str, str]]) -> str:
    """Return a list of (name, value) as HTML; both are plain text."""
    return f"<dl>{''.join(f'<dt>{escape(name)}</dt><dd>{escape(value)}</dd>' for name, value in pairs)}</dl>"


def write_html(path: Path, text: str) -> None:
    """Write a page, whole or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink()
        raise OutputError(
            f"cannot write {path}: {error.strerror or error}; choose another folder with --out"
        ) from error
