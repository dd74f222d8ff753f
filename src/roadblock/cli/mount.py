"""`roadblock calibrate-mount`: a picture of flat road or a short drive in; how the rig sits over the road out."""

import math
import re
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import typer

from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.rig import UNITS_M, FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import frames, note, progress_bar, say, show_table
from roadblock.config import Settings, load_settings
from roadblock.errors import CalibrationError, SettingsError, SourceError
from roadblock.io.rig import write_rig
from roadblock.io.sources import StereoSource, open_source
from roadblock.pipeline import Pipeline
from roadblock.stages.mount import STEP_M, Measured, Mounting, Odometer, Seen, Step, find_mounting, why_left_out

LARGEST_OFFSET_M = 20.0
"""No vehicle is longer."""

LEAST_CLIMB_DEG = 0.5
"""Less between the direction of travel and the road says nothing about the rig."""


@dataclass
class Drive:
    """What a recording has shown of its mounting."""

    frames: int = 0
    lost: int = 0
    seen: list[Seen] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    left_out: Counter[str] = field(default_factory=Counter)


def calibrate_mount(
    source: Annotated[str, typer.Argument(help="Folder, video, list of pairs, or LEFT,RIGHT for two videos.")],
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of what the recording brings.")] = None,
    out: Annotated[Path | None, typer.Option("-o", "--out", help="File for the rig with its mounting.")] = None,
    forward: Annotated[
        str, typer.Option(help="How far ahead of the vehicle's origin the cameras sit, as 1.2m or 120cm.")
    ] = "0m",
    left: Annotated[str, typer.Option(help="How far to its left, as 0.1m.")] = "0m",
    assignments: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as stage.key=value; may be repeated.")
    ] = None,
    settings: Annotated[Path | None, typer.Option(help="TOML file of settings.")] = None,
    kind: Annotated[str | None, typer.Option(help="Kind of recording, where several fit.")] = None,
    gray: Annotated[bool, typer.Option("--gray", help="Use colour images as grey ones.")] = False,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Find camera height, pitch, roll and yaw over the road from a short drive."""
    forward_m, left_m = parse_offset("--forward", forward), parse_offset("--left", left)
    resolved = load_settings(settings, assignments or [])
    cameras = None if rig is None else open_rig(rig, rig_format, unit, size)
    opened = open_source(source, rig=cameras, kind=kind, gray=gray)
    _check_one_rig(opened)
    pipeline = Pipeline(opened.rig, resolved)
    drive = watch(opened, pipeline)
    if not drive.seen:
        raise CalibrationError(f"{opened.name}: {_no_road(drive, resolved)}")
    mounting = find_mounting(
        drive.seen,
        pipeline.rectification,
        drive.steps,
        in_time=opened.is_sequence,
        forward_m=forward_m,
        left_m=left_m,
    )
    report(opened, drive, mounting)
    if out is not None:
        for path in write_rig(replace(opened.rig, T_vehicle_car=mounting.T_vehicle_car), out):
            say(f"wrote {path}")


def _check_one_rig(source: StereoSource) -> None:
    count = len(set(map(id, source.rigs or ())))
    if count > 1:
        raise SourceError(
            f"{source.name} holds frames of {count} rigs, but a mounting is of one: "
            "give a recording of one rig, or its rig with --rig FILE"
        )


def watch(source: StereoSource, pipeline: Pipeline) -> Drive:
    """Collect the road of each frame and the way between them, under a progress bar; leave with 130 after Ctrl-C.

    Raises
    ------
    SourceError
        If there are no frames.
    """
    drive, odometer = Drive(), Odometer()
    try:
        with progress_bar() as progress:
            task = progress.add_task("looking at the road", total=source.length)
            for pair in source:
                result, rectified = pipeline.step(pair)
                drive.frames += 1
                reason = why_left_out(result.ground, result.health)
                if reason or result.ground is None:
                    drive.left_out[reason] += 1
                else:
                    drive.seen.append(Seen(pair.index, result.ground))
                step = odometer.add(rectified) if source.is_sequence else None
                drive.steps += [] if step is None else [step]
                progress.update(task, advance=1)
    except KeyboardInterrupt:
        note(f"interrupted after {frames(drive.frames)}; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    if not drive.frames:
        raise SourceError(f"{source.name} holds no frames: give a picture of flat road, or a short drive")
    drive.lost = odometer.lost
    return drive


def report(source: StereoSource, drive: Drive, mounting: Mounting) -> None:
    """Print the mounting, what it rests on, and what is in doubt."""
    rows = [
        ["height over the road", *_metres(mounting.height_m), "from between the cameras"],
        ["pitch", *_degrees(mounting.pitch_rad), "> 0: they look down"],
        ["roll", *_degrees(mounting.roll_rad), "> 0: their left side is up"],
        ["yaw", *_degrees(mounting.yaw_rad), "> 0: they look left"],
    ]
    show_table(f"{source.name}: how the cameras sit over the road", ("what", ">value", ">sigma", "meaning"), rows)
    say(f"{mounting.used} of {frames(drive.frames)} used, {mounting.straight_steps} of {mounting.steps} steps straight")
    for reason, count in (drive.left_out + mounting.left_out).most_common():
        note(f"left out: {reason} ({count} of {frames(drive.frames)})")
    if math.isnan(mounting.yaw_rad.value):
        note(f"yaw unknown, taken as straight: {_why_no_yaw(source, drive, mounting)}")
    elif doubt := _doubt(mounting.climb_rad):
        note(doubt)
    if mounting.used == 1:
        note("a single frame does not tell how sure it is: record a short drive")
    if source.rig.T_vehicle_car is not None:
        note("the rig had a mounting already: this one replaces it")
    for warning in source.warnings:
        note(warning)


def _metres(measured: Measured) -> list[str]:
    value, sigma = measured
    return [f"{value:.3f} m", "unknown" if math.isnan(sigma) else f"{sigma:.3f} m"]


def _degrees(measured: Measured) -> list[str]:
    value, sigma = map(math.degrees, measured)
    return [
        "unknown" if math.isnan(value) else f"{value + 0.0:+.2f} deg",
        "unknown" if math.isnan(sigma) else f"{sigma:.2f} deg",
    ]


def _why_no_yaw(source: StereoSource, drive: Drive, mounting: Mounting) -> str:
    if not source.is_sequence:
        return "single pictures do not show the direction of travel; record a straight drive with its time stamps"
    if drive.frames < 2:
        return "one frame does not show the direction of travel; record a straight drive"
    if not mounting.steps:
        lost = f", and {drive.lost} times nothing could be followed" if drive.lost else ""
        return f"the cameras nowhere moved {STEP_M:g} m between frames that show the same{lost}"
    return f"{mounting.straight_steps} of {mounting.steps} steps were straight; record a longer straight drive"


def _doubt(climb_rad: Measured) -> str:
    """Say where the direction of travel leaves the road: then the rig or the road is not what it seems."""
    value, sigma = map(math.degrees, climb_rad)
    if abs(value) < max(LEAST_CLIMB_DEG, 3 * sigma):
        return ""
    return (
        f"the cameras travel {abs(value):.1f} deg {'out of' if value > 0 else 'into'} the road they see, but must "
        "travel along it: check the rig's calibration, or drive on flat road"
    )


def _no_road(drive: Drive, settings: Settings) -> str:
    low, high = settings.ground.height_m
    reasons = ", ".join(f"{reason} ({count})" for reason, count in drive.left_out.most_common())
    return (
        f"none of {frames(drive.frames)} shows flat road {low:g} to {high:g} m below the cameras: {reasons}; "
        "check the rig's unit, or record free road in daylight"
    )


def parse_offset(option: str, text: str) -> float:
    """Return metres of "1.2m", "-35cm" or "0.5".

    Raises
    ------
    SettingsError
        If it is no length, or longer than a vehicle.
    """
    match = re.fullmatch(r"\s*([-+]?[0-9]*\.?[0-9]+)\s*([a-z]*)\s*", text)
    factor = UNITS_M.get(match[2] or "m") if match else None
    if match is None or factor is None:
        raise SettingsError(f"{option} must be a length as 1.2m or -35cm, but got {text!r:.40}")
    if abs(length := float(match[1]) * factor) > LARGEST_OFFSET_M:
        raise SettingsError(f"{option} must be at most {LARGEST_OFFSET_M:g} m, but got {length:g} m: another unit?")
    return length
