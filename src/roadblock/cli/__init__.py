"""The command line: the only place where all rooms meet. Errors become one line and exit code 2 here."""

import sys
from io import TextIOWrapper
from typing import Annotated

import typer

import roadblock
from roadblock.cli.calibrate import calibrate_command
from roadblock.cli.demo import demo
from roadblock.cli.detect import detect
from roadblock.cli.doctor import doctor
from roadblock.cli.evaluate import evaluate_command
from roadblock.cli.experiment import experiment_app
from roadblock.cli.mount import calibrate_mount
from roadblock.cli.rig import rig_app
from roadblock.cli.rigcheck import check
from roadblock.cli.simulate import simulate
from roadblock.cli.simulate_calibration import simulate_calibration
from roadblock.cli.terminal import fail, say
from roadblock.errors import RoadblockError

app = typer.Typer(
    help="Every obstacle on the road, from any two cameras.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
app.command()(detect)
app.command()(demo)
app.command()(simulate)
app.command("simulate-calibration")(simulate_calibration)
app.command("calibrate")(calibrate_command)
app.command("calibrate-mount")(calibrate_mount)
app.command("evaluate")(evaluate_command)
app.command()(doctor)
app.add_typer(experiment_app, name="experiment")
rig_app.command("check")(check)
app.add_typer(rig_app, name="rig")


def _show_version(asked: bool) -> None:
    if asked:
        say(f"roadblock {roadblock.__version__}")
        raise typer.Exit


@app.callback()
def roadblock_options(
    version: Annotated[
        bool, typer.Option("--version", help="Show the version and leave.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Every obstacle on the road, from any two cameras."""


def main() -> None:
    """Run the command line; a `RoadblockError` becomes one line on stderr and exit code 2."""
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")  # what the terminal cannot show must not end a run
    try:
        app()
    except RoadblockError as error:
        fail(str(error))
        sys.exit(2)
