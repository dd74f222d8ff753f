"""`roadblock simulate-calibration`: pictures of a board as two cameras take them, to try `roadblock calibrate` on."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from roadblock.cli.calibrate import measured_board, parse_length
from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.simulate import RIG
from roadblock.cli.terminal import note, progress_bar, say
from roadblock.io.rig import write_rig
from roadblock.sim.board_set import TRUTH, record_boards
from roadblock.sim.boards import built_rig


def simulate_calibration(
    out: Annotated[Path, typer.Option(help="New folder for the pictures and their truth.")],
    views: Annotated[int, typer.Option(help="How many pairs.", min=1, max=1000)] = 25,
    board: Annotated[
        str, typer.Option(help="Inner corners: chessboard:9x6; charuco:8x6:5x5_100:0.75; circles:4x11.")
    ] = "chessboard:9x6",
    square: Annotated[str, typer.Option(help="Side of a square with its unit.")] = "25mm",
    bow: Annotated[
        str | None, typer.Option(help="How far the board's corners lie behind its middle, as 0.2mm; flat without it.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Of rig, poses, light and noise.", min=0)] = 0,
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of the paper's as hands would build it.")] = None,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Render pictures of a calibration board in front of a known rig."""
    known = measured_board(board, square, None, "0.5mm")
    cameras = built_rig(np.random.default_rng(seed)) if rig is None else open_rig(rig, rig_format, unit, size)
    taken = record_boards(cameras, known, out, views, seed, 0.0 if bow is None else parse_length("--bow", bow))
    done = 0
    try:
        with progress_bar() as progress:
            task = progress.add_task("rendering", total=views)
            for done in taken:
                progress.update(task, completed=done)
    except KeyboardInterrupt:
        note(f"interrupted after {done} of {views} pairs; {out} holds no whole set")
        raise typer.Exit(INTERRUPTED) from None
    write_rig(cameras, out / RIG)
    say(f"{views} pairs in {out}/left and {out}/right; the truth is {out / RIG} and {out / TRUTH}")
    say(f"try: roadblock calibrate {out}/left {out}/right --board {board} --square {square}")
