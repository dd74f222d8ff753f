"""What the command line prints: errors, notes and tables."""

import math
from collections.abc import Iterable

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from roadblock.values.motion import Track
from roadblock.values.scene import FrameResult, Obstacle

out = Console()
err = Console(stderr=True)
NEAREST = 12
"""Rows of the table of obstacles."""


def _safe(text: str) -> str:
    """Return `text` with what steers a terminal, as a hostile file's name may hold it, replaced by '?'."""
    return "".join(sign if sign.isprintable() else "?" for sign in text)


def fail(message: str) -> None:
    """Print one line about what went wrong."""
    line = _safe(" ".join(message.split()))
    err.print(Text("error: ", style="bold red").append(line, style="default"), soft_wrap=True)


def note(message: str) -> None:
    """Print one line worth knowing."""
    err.print(Text("note: ", style="yellow").append(_safe(message), style="default"), soft_wrap=True)


def say(message: str) -> None:
    """Print one line of result; it may be as long as it needs."""
    out.print(Text(_safe(message)), soft_wrap=True)


def progress_bar(*columns: TextColumn) -> Progress:
    """Return a progress bar on stderr, with further columns at its end; nothing where stderr is no terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        *columns,
        console=err,
        transient=True,
        disable=not err.is_terminal,  # in a file or a pipe it would leave an empty line
    )


def show_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> None:
    """Print a table; a column whose name starts with `>` is aligned to the right."""
    table = Table(
        title=Text(_safe(title)),
        title_justify="left",
        header_style="bold",
        box=SIMPLE_HEAD,
        pad_edge=False,
        collapse_padding=True,
    )
    for column in columns:
        table.add_column(column.lstrip(">"), justify="right" if column.startswith(">") else "left")
    for row in rows:
        table.add_row(*(Text(_safe(cell)) for cell in row))
    out.print(table)


def show_nearest(title: str, found: Iterable[tuple[str, Obstacle]]) -> None:
    """Print the nearest obstacles of (frame name, obstacle) pairs."""
    nearest = sorted(found, key=lambda pair: pair[1].range_m)[:NEAREST]
    columns = ["what", ">range (m)", ">side (m)", ">width x\nheight (m)"]
    rows = [_describe(obstacle) for _, obstacle in nearest]
    if any(math.isfinite(obstacle.range_sigma_calib_m) for _, obstacle in nearest):
        columns.insert(2, ">calibration\n(m)")
        for row, (_, obstacle) in zip(rows, nearest, strict=True):
            row.insert(2, f"± {obstacle.range_sigma_calib_m:.2f}")
    if any(obstacle.track is not None for _, obstacle in nearest):
        columns += [">track", ">speed\n(m/s)", ">TTC (s)"]
        for row, (_, obstacle) in zip(rows, nearest, strict=True):
            row += _moves(obstacle.track)
    if len(names := {name for name, _ in nearest}) == 1:
        title += f", {names.pop()}"
    else:
        columns.insert(0, "frame")
        rows = [[name, *row] for (name, _), row in zip(nearest, rows, strict=True)]
    show_table(title, columns, rows)


def _describe(o: Obstacle) -> list[str]:
    side = o.position_m[1]
    width, height, _ = o.size_m
    return [
        " ".join(filter(None, (o.color, o.label if o.label != "unknown" else "obstacle"))),
        f"{o.range_m:.2f} ± {o.range_sigma_m:.2f}",
        f"{abs(side):.2f} {'left' if side > 0 else 'right'}",
        f"{width:.1f} x {height:.1f}",
    ]


def _moves(track: Track | None) -> list[str]:
    """Return number, speed and time to contact of a track."""
    if track is None:
        return ["", "", ""]
    speed, sigma = np.hypot(*track.velocity_mps), np.max(track.velocity_sigma_mps)
    text = "standing" if track.motion == "standing" else f"{speed:.1f} ± {sigma:.1f}"
    text += "" if track.is_over_ground else " (relative)"
    contact = f"{track.ttc_s:.1f} ± {track.ttc_sigma_s:.1f}" if math.isfinite(track.ttc_s) else ""
    return [str(track.id), text, contact]


def summarize(result: FrameResult) -> str:
    """Return one line about the last frame, for the progress bar."""
    action = "" if result.decision is None or result.decision.action == "none" else f", {result.decision.action}"
    if not result.obstacles:
        return f"no obstacle{action}"
    return f"{len(result.obstacles)} obstacles, nearest {result.obstacles[0].range_m:.1f} m{action}"


def frames(count: int) -> str:
    """Return "1 frame", "2 frames"."""
    return f"{count} frame{'' if count == 1 else 's'}"
