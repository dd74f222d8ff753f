"""The command line: the only place where all rooms meet. Errors become one line and exit code 2 here."""

import sys
from typing import Annotated

import click
import typer

import roadblock
from roadblock.cli.demo import demo
from roadblock.cli.detect import detect
from roadblock.cli.doctor import doctor
from roadblock.cli.rig import rig_app
from roadblock.cli.terminal import fail
from roadblock.errors import RoadblockError

app = typer.Typer(
    help="Every obstacle on the road, from any two cameras.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command()(detect)
app.command()(demo)
app.command()(doctor)
app.add_typer(rig_app, name="rig")

INTERRUPTED = 130
"""Exit code after Ctrl-C, as shells expect it."""


@app.callback()
def roadblock_options(
    version: Annotated[bool, typer.Option("--version", help="Show the version and leave.")] = False,
) -> None:
    """Every obstacle on the road, from any two cameras."""
    if version:
        click.echo(f"roadblock {roadblock.__version__}")
        raise typer.Exit


def main() -> None:
    """Run the command line; a `RoadblockError` becomes one line on stderr and exit code 2."""
    try:
        sys.exit(app(standalone_mode=False) or 0)
    except RoadblockError as error:
        fail(str(error))
        sys.exit(2)
    except click.ClickException as error:
        fail(error.format_message())
        sys.exit(2)
    except (KeyboardInterrupt, click.Abort):
        sys.exit(INTERRUPTED)
