"""`roadblock demo`: a synthetic street with exact truth, through the same `detect` as any recording."""

import json
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from roadblock.cli.detect import report, run
from roadblock.cli.terminal import err, say, show_table
from roadblock.config import Settings
from roadblock.errors import OutputError
from roadblock.eval.match import overlaps
from roadblock.io.results import OVERLAY, prepare_folder
from roadblock.io.rig import write_rig
from roadblock.io.sources import open_source
from roadblock.sim.drive import truth_record
from roadblock.sim.render import Rendered, render
from roadblock.sim.scene import demo_street, paper_rig
from roadblock.sim.truth import TrueObject
from roadblock.values.scene import Obstacle


def demo(
    out: Annotated[Path, typer.Option(help="Folder for the recording and the results.")] = Path("roadblock-demo"),
    seed: Annotated[int, typer.Option(help="Of textures, houses, trees and noise.", min=0, max=999_999)] = 0,
) -> None:
    """Render a street with known distances, find its obstacles, and compare."""
    prepare_folder(out / "results")
    with err.status("rendering the street (the first time compiles the renderer, about half a minute)"):
        street = render(demo_street(seed), paper_rig(), seed=seed, name="000000")
    recording = out / "recording"
    save(street, recording)
    source = open_source(recording)
    tally = run(source, str(recording), Settings(), out / "results", overlay=True)
    report(source, tally, out / "results")
    compare(street, [obstacle for _, obstacle in tally.nearest])
    say(f"picture: {out / 'results' / OVERLAY / '000000.png'}")


def save(street: Rendered, folder: Path) -> None:
    """Write images, rig and truth as a recording that `detect` opens.

    Raises
    ------
    OutputError
        If the folder cannot be written.
    """
    try:
        for side, image in (("left", street.pair.left), ("right", street.pair.right)):
            (folder / side).mkdir(parents=True, exist_ok=True)
            picture = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
            (folder / side / f"{street.pair.name}.png").write_bytes(picture.tobytes())
        (folder / "truth.jsonl").write_text(json.dumps(truth_record(street), allow_nan=False) + "\n", "utf-8")
    except OSError as error:
        raise OutputError(f"cannot write {folder}: {error.strerror or error}; choose another with --out") from error
    write_rig(paper_rig(), folder / "rig.yaml")


def compare(street: Rendered, found: list[Obstacle]) -> None:
    """Print truth beside measurement."""
    rows = []
    for true in street.objects:
        match = max(found, key=lambda o: overlap(o, true), default=None)
        if match is None or overlap(match, true) < 0.3:
            rows.append([f"{true.color} {true.type}", f"{true.range_m:.2f}", "missed", "", "", ""])
            continue
        error_m = match.range_m - true.range_m
        width, height, _ = true.size_m
        rows.append(
            [
                f"{true.color} {true.type}",
                f"{true.range_m:.2f}",
                f"{match.range_m:.2f} ± {match.range_sigma_m:.2f}",
                f"{error_m:+.2f}",
                f"{width:.1f} x {height:.1f}",
                f"{match.size_m[0]:.1f} x {match.size_m[1]:.1f}",
            ]
        )
    columns = ("what", ">range (m)", ">measured", ">error", ">width x height", ">measured")
    show_table("truth beside measurement", columns, rows)


def overlap(obstacle: Obstacle, true: TrueObject) -> float:
    """Return the intersection over union of both boxes."""
    return float(overlaps(np.array([obstacle.box_px], float), np.array([true.box_px], float))[0, 0])
