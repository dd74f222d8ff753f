"""`roadblock detect`: a recording in; obstacles as a table, JSON lines and pictures out."""

from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.progress import TextColumn

from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import frames, note, progress_bar, say, show_nearest, show_table, summarize
from roadblock.config import Settings, load_settings
from roadblock.errors import MissingExtraError, SettingsError
from roadblock.io.results import OVERLAY, RESULTS, RUN, VIDEO, JsonlSink, prepare_folder, run_record, write_run
from roadblock.io.rig.native import write_native
from roadblock.io.sources import StereoSource, open_source
from roadblock.pipeline import Pipeline
from roadblock.values.camera import StereoRig
from roadblock.values.decision import Decision
from roadblock.values.scene import FrameResult, Obstacle
from roadblock.viz.sinks import OverlaySink, PictureSink, VideoSink

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells expect it."""


@dataclass
class Tally:
    """What a run has seen so far."""

    frames: int = 0
    interrupted: bool = True
    """Whether the source's end was not reached."""
    nearest: list[tuple[str, Obstacle]] = field(default_factory=list)
    troubles: Counter[str] = field(default_factory=Counter)
    decisions: list[tuple[str, Decision]] = field(default_factory=list)
    """The first frame of each warning, braking or swerve, and why."""
    action: str = "none"

    def add(self, result: FrameResult, is_sequence: bool) -> None:
        """Count one frame; of a sequence only the last frame's obstacles are kept."""
        self.frames += 1
        if is_sequence:
            self.nearest.clear()
        self.nearest += [(result.name, obstacle) for obstacle in result.obstacles]
        self.troubles.update(reason.partition(":")[0] for reason in result.health.reasons)
        before, self.action = self.action, "none" if result.decision is None else result.decision.action
        if result.decision is not None and self.action not in ("none", before):
            self.decisions.append((result.name, result.decision))


def detect(
    source: Annotated[str, typer.Argument(help="Folder, video, list of pairs, or LEFT,RIGHT for two videos.")],
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of what the recording brings.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for obstacles.jsonl, run.json and overlays.")] = None,
    detector: Annotated[str | None, typer.Option(help="Name of the detector.")] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as stage.key=value; may be repeated.")
    ] = None,
    settings: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    overlay: Annotated[bool, typer.Option("--overlay", help="Draw pictures, or a video of a sequence.")] = False,
    kind: Annotated[str | None, typer.Option(help="Kind of recording, where several fit.")] = None,
    gray: Annotated[bool, typer.Option("--gray", help="Use colour images as grey ones.")] = False,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Find every obstacle in a recording."""
    if overlay and out is None:
        raise SettingsError("--overlay needs a folder to draw into: add --out DIR")
    chosen = [f"detector={detector}"] if detector else []
    resolved = load_settings(settings, [*chosen, *(assignments or [])])
    cameras = None if rig is None else open_rig(rig, rig_format, unit, size)
    opened = open_source(source, rig=cameras, kind=kind, gray=gray)
    report(opened, run(opened, source, resolved, out, overlay), out)


def run(source: StereoSource, spec: str, settings: Settings, out: Path | None, overlay: bool) -> Tally:
    """Run the pipeline over a source and write what it finds to `out`.

    Interrupting ends the run early; what is written stays whole.
    """
    tally, started = Tally(), datetime.now(UTC)
    pipelines = {id(rig): Pipeline(rig, settings) for rig in dict.fromkeys(source.rigs or (source.rig,))}
    with ExitStack() as stack:
        results = None if out is None else stack.enter_context(JsonlSink(prepare_folder(out) / RESULTS))
        pictures = _overlay_sink(source, out, stack) if out is not None and overlay else None
        progress = stack.enter_context(progress_bar(TextColumn("{task.fields[found]}")))
        task = progress.add_task("detecting", total=source.length, found="")
        try:
            for pair in source:
                rig = source.rigs[pair.index] if source.rigs else source.rig
                pipeline = pipelines[id(rig)]
                if tally.frames == 0:  # so that no frame's time holds the compiling
                    progress.update(task, description="warming up (the first time compiles for a minute or two)")
                    Pipeline(rig, settings).step(pair)
                    progress.update(task, description="detecting")
                result, rectified = pipeline.step(pair)
                if results is not None:
                    results.write(result)
                tally.add(result, source.is_sequence)  # before the slow drawing: its line is written
                if pictures is not None:
                    pictures.write(rectified.left, result, pipeline.rectification)
                progress.update(task, advance=1, found=summarize(result))
            tally.interrupted = False
        except KeyboardInterrupt:
            pass  # the record and the report say so
        finally:
            if out is not None:
                write_run(out / RUN, _record(source, spec, settings, pipelines, started, tally))
    return tally


def report(source: StereoSource, tally: Tally, out: Path | None) -> None:
    """Print what was found, what was wrong, and where the files are; leave with 130 after Ctrl-C."""
    if tally.nearest:
        where = "in the last frame" if source.is_sequence else f"in {frames(tally.frames)}"
        show_nearest(f"{source.name}: the nearest obstacles {where}", tally.nearest)
    else:
        say(f"{source.name}: no obstacles in {frames(tally.frames)}")
    if tally.decisions:
        rows = [(name, told.action, told.reason) for name, told in tally.decisions]
        show_table(f"{source.name}: decisions", ("frame", "action", "why"), rows)
    for reason, count in tally.troubles.most_common():
        note(f"{reason} ({count} of {frames(tally.frames)})")
    if any(rig.verdict == "refused" for rig in source.rigs or (source.rig,)):
        note("the rig's calibration was refused and the file written by force: do not trust these ranges")
    for warning in source.warnings:
        note(warning)
    if tally.interrupted:
        note(f"interrupted after {frames(tally.frames)}; what was written is whole")
    if out is not None:
        say(f"results: {out}")
    if tally.interrupted:
        raise typer.Exit(INTERRUPTED)


def _overlay_sink(source: StereoSource, out: Path, stack: ExitStack) -> OverlaySink:
    """Open a video for a sequence, pictures for single frames and where the video library is missing."""
    if source.is_sequence:
        try:
            return stack.enter_context(VideoSink(out / VIDEO))
        except MissingExtraError as error:
            note(f"{error} - drawing pictures instead")
    return stack.enter_context(PictureSink(out / OVERLAY))


def _record(
    source: StereoSource,
    spec: str,
    settings: Settings,
    pipelines: dict[int, Pipeline],
    started: datetime,
    tally: Tally,
) -> dict[str, Any]:
    rigs = [rig_record(pipeline.rig) for pipeline in pipelines.values()]
    record = run_record(
        source={
            "name": source.name,
            "path": spec,
            "frames": source.length,
            "is_sequence": source.is_sequence,
            "warnings": source.warnings,
        },
        settings=settings.model_dump(mode="json"),
        rig=rigs[0] if len(rigs) == 1 else {"rigs": rigs},
        started=started,
        frames=tally.frames,
        interrupted=tally.interrupted,
    )
    names = ("network_sha256", "matcher_sha256")
    hashes = {name: [getattr(pipeline, name) for pipeline in pipelines.values()] for name in names}
    return record | {name: values[0] for name, values in hashes.items() if values and values[0]}


def rig_record(rig: StereoRig) -> dict[str, Any]:
    """Return a rig as the plain values of its `rig.yaml`."""
    record: dict[str, Any] = yaml.safe_load(write_native(rig)[""])
    return record
