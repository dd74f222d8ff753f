"""`roadblock rig check`: a drive in; whether the rig is still as its file says, and on request the rig it proposes."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import note, progress_bar, say, show_table
from roadblock.errors import SourceError
from roadblock.io.rig import write_rig
from roadblock.io.sources import StereoSource, open_source
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.stages.selfcheck import (
    RANGE_M,
    RigMonitor,
    SelfcheckSettings,
    offset_sigmas_px,
    offsets_px,
    proposed_rig,
)
from roadblock.values.camera import StereoRig
from roadblock.values.drift import RigDrift

FRAMES = SelfcheckSettings().frames


def check(
    source: Annotated[str, typer.Argument(help="Folder, video, list of pairs, or LEFT,RIGHT for two videos.")],
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of what the recording brings.")] = None,
    frames: Annotated[
        int, typer.Option(help="Latest pairs whose vertical disparities count.", min=1, max=1000)
    ] = FRAMES,
    out: Annotated[
        Path | None, typer.Option("--out", "-o", help="Where to write the proposed rig, if it moved.")
    ] = None,
    kind: Annotated[str | None, typer.Option(help="Kind of recording, where several fit.")] = None,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Re-estimate from a drive how the right camera is turned; propose another rig, apply nothing."""
    cameras = None if rig is None else open_rig(rig, rig_format, unit, size)
    opened = open_source(source, rig=cameras, kind=kind, gray=True)
    if opened.rigs and any(one is not opened.rig for one in opened.rigs):
        raise SourceError(
            f"{source} holds frames of several rigs, but one rig is checked at a time: name it with --rig"
        )
    drift, moved_at = watch(opened, frames)
    report(opened.name, drift, moved_at)
    for warning in opened.warnings:
        note(warning)
    if out is not None:
        propose(opened.rig, drift, out)


def watch(source: StereoSource, frames: int) -> tuple[RigDrift, str]:
    """Return what the monitor says in the end, and the name of the frame from which on it says "moved", or "".

    Raises
    ------
    SourceError
        If there is no pair.
    """
    rectification = plan_rectification(source.rig)
    monitor = RigMonitor(source.rig, SelfcheckSettings(frames=frames), source.is_sequence)
    drift, moved_at = None, ""
    with progress_bar() as progress:
        task = progress.add_task("checking", total=source.length)
        for pair in source:
            drift = monitor.update(rectify(pair, rectification, source.rig.left.size_px))
            moved_at = (moved_at or pair.name) if drift.state == "moved" else ""
            progress.update(task, advance=1)
    if drift is None:
        raise SourceError(f"{source.name} holds no pair that can be read: nothing to check the rig with")
    return drift, moved_at


def report(name: str, drift: RigDrift, moved_at: str) -> None:
    """Print the verdict and the figures behind it."""
    what = ("pitch: rows in the middle", "yaw: disparities", "roll: rows at the left edge")
    turned = zip(drift.turn_deg, drift.sigma_deg, strict=True)
    moved = zip(offsets_px(drift), offset_sigmas_px(drift), strict=True)
    rows = ([w, _number(*deg, 4), _number(*px, 2)] for w, deg, px in zip(what, turned, moved, strict=True))
    show_table(name, ("right camera against the rig", ">deg", ">px"), rows)
    say(f"{drift.frames} frames, {drift.features:.0f} features each, {drift.motions} stretches of driving")
    say(f"{drift.state}: {drift.reason}" + (f" (from frame {moved_at} on)" if moved_at else ""))


def _number(value: float, sigma: float, digits: int) -> str:
    return "unknown" if np.isnan(sigma) else f"{value:+.{digits}f} ± {sigma:.{digits}f}"


def propose(rig: StereoRig, drift: RigDrift, out: Path) -> None:
    """Write the proposed rig if the rig has moved, and say what it changes."""
    if drift.state != "moved":
        note(f"nothing to propose: the rig is {drift.state}; {out} was not written")
        return
    write_rig(proposed_rig(rig, drift), out)
    rows_px, disparity_px, _ = offsets_px(drift)
    say(f"wrote {out}: rows change by {-rows_px:+.2f} px in the middle; nothing was applied")
    if np.isfinite(disparity_px):
        shown_m = RANGE_M + drift.range_error_m(RANGE_M)
        say(
            f"disparities change by {-disparity_px:+.2f} px: "
            f"what it shows at {RANGE_M:.0f} m, the rig in use shows at {shown_m:.2f} m"
        )
