"""`roadblock rig`: look at rig files, convert them, and compare two calibrations of one rig."""

import re
from pathlib import Path
from typing import Annotated

import typer

from roadblock.cli.rig_change import show_change
from roadblock.cli.terminal import note, say, show_table
from roadblock.errors import SettingsError
from roadblock.io.rig import READERS, WRITERS, describe_rig, read_rig, write_rig
from roadblock.values.camera import StereoRig

UNITS_M = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}

UnitOption = Annotated[
    str, typer.Option("--unit", help="Unit of the rig file's lengths: m, cm, mm, in, or a number with one (25mm).")
]
SizeOption = Annotated[
    str | None, typer.Option("--size", help="Image size, as 640x480, for rig files that do not tell it.")
]
FormatOption = Annotated[
    str | None, typer.Option("--format", help=f"Format of the rig file, if it is unclear: {', '.join(READERS)}.")
]
PairOption = Annotated[str | None, typer.Option("--pair", help="Numbers of the two cameras in a KITTI file, as 2,3.")]
RightOption = Annotated[
    Path | None, typer.Option("--right", help="Second file of a two-file format (ROS right.yaml, OpenCV extrinsics).")
]

rig_app = typer.Typer(help="Look at rig files, convert and compare them.", no_args_is_help=True)


@rig_app.command("show")
def show(
    file: Annotated[Path, typer.Argument(help="Rig file, or folder with a pair of them.")],
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
    right: RightOption = None,
    pair: PairOption = None,
) -> None:
    """Say in words what a rig file describes."""
    show_table(str(file), ("what", "value"), describe_rig(open_rig(file, rig_format, unit, size, right, pair)))


@rig_app.command("convert")
def convert(
    file: Annotated[Path, typer.Argument(help="Rig file, or folder with a pair of them.")],
    target: Annotated[Path, typer.Argument(help="File to write (for ros: the folder).")],
    to: Annotated[str, typer.Option(help=f"Format to write: {', '.join(WRITERS)}.")] = "roadblock",
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
    right: RightOption = None,
    pair: PairOption = None,
) -> None:
    """Read a rig of any known format and write it in another one."""
    rig = open_rig(file, rig_format, unit, size, right, pair)
    for path in write_rig(rig, target, to):
        say(f"wrote {path}")
    if rig.covariance is not None and to != "roadblock":
        note(f"{to} files have no room for the covariance: the range error from calibration is unknown there")


@rig_app.command("compare")
def compare(
    first: Annotated[Path, typer.Argument(metavar="A", help="Rig file, or folder with a pair of them.")],
    second: Annotated[Path, typer.Argument(metavar="B", help="Another calibration of the same rig.")],
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
    pair: PairOption = None,
) -> None:
    """Say how far off ranges are if A is used and B is true, and whether the rig has moved."""
    used, true = (open_rig(file, rig_format, unit, size, None, pair) for file in (first, second))
    show_change(str(first), str(second), used, true)


def open_rig(
    file: Path,
    rig_format: str | None = None,
    unit: str = "m",
    size: str | None = None,
    right: Path | None = None,
    pair: str | None = None,
) -> StereoRig:
    """Read a rig file as the options of the command line say."""
    return read_rig(
        file,
        format=rig_format,
        unit_m=parse_unit(unit),
        right=right,
        size_px=parse_size(size),
        pair=parse_pair(pair),
    )


def parse_unit(text: str) -> float:
    """Return metres per unit of "mm", "25mm" or "0.025"."""
    match = re.fullmatch(r"\s*([0-9]*\.?[0-9]+)?\s*([a-z]*)\s*", text)
    factor = UNITS_M.get(match[2] or "m") if match else None
    if match is None or factor is None or not text.strip() or float(match[1] or 1) == 0:
        raise SettingsError(f"a unit must be {', '.join(UNITS_M)}, or a number with one (25mm), but got {text!r}")
    return float(match[1] or 1) * factor


def parse_size(text: str | None) -> tuple[int, int] | None:
    """Return (width, height) of "640x480"."""
    if text is None:
        return None
    match = re.fullmatch(r"\s*([1-9]\d{0,5})\s*[xX]\s*([1-9]\d{0,5})\s*", text)
    if match is None:
        raise SettingsError(f"a size must look like 640x480, but got {text!r}")
    return int(match[1]), int(match[2])


def parse_pair(text: str | None) -> tuple[int, int] | None:
    """Return (left, right) of "2,3"."""
    if text is None:
        return None
    match = re.fullmatch(r"\s*(\d)\s*,\s*(\d)\s*", text)
    if match is None:
        raise SettingsError(f"a pair of cameras must look like 2,3, but got {text!r}")
    return int(match[1]), int(match[2])
