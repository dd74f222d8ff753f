"""`roadblock experiment avoidance`: a car drives by what is found, and nothing must be touched."""

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import roadblock
from roadblock.cli.avoidance_drive import Film, drive, guessed, rendered, small_rig
from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.terminal import note, progress_bar, say, show_table
from roadblock.errors import MissingExtraError, OutputError
from roadblock.eval.avoidance import by_scenario, counts
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import write_run
from roadblock.pipeline import Pipeline
from roadblock.sim.challenges import CHALLENGES
from roadblock.sim.observed import Noise
from roadblock.viz.avoidance_report import write_avoidance_page
from roadblock.viz.sinks import overlay_sink

RESULT, PAGE = "result.json", "report.html"
SCHEMA = 1


def avoidance_experiment(
    runs: Annotated[int, typer.Option(help="Drives of each scenario, each with a seed of its own.", min=1)] = 3,
    seed: Annotated[int, typer.Option(help="Of the first one; the next ones count on.", min=0)] = 0,
    scenario: Annotated[list[str] | None, typer.Option(help="One of them (may be given again).")] = None,
    out: Annotated[Path, typer.Option(help="Folder for result.json and report.html.")] = Path("roadblock-avoidance"),
    fast: Annotated[bool, typer.Option("--fast", help="A model of what is found instead of pictures.")] = False,
    quality: Annotated[Literal["preview", "demo"], typer.Option(help="Of the pictures.")] = "demo",
    video: Annotated[int | None, typer.Option(help="Write a video of the drive with this seed.")] = None,
) -> None:
    """Drive a car by its own decisions: the paper's three obstacles at 30 km/h, and whatever else a road brings."""
    names = _chosen(scenario)
    head = {
        "schema": SCHEMA,
        "experiment": "avoidance",
        "version": roadblock.__version__,
        "commit": package_commit(),
        "settings": {"runs": runs, "seed": seed, "scenarios": names, "fast": fast, "quality": quality},
        "machine": machine_record(),
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }
    todo = [(name, number) for number in range(seed, seed + runs) for name in names]
    done: list[dict[str, Any]] = []
    result = _write(out, head, done, True)
    try:
        with progress_bar() as progress:
            task = progress.add_task("driving", total=len(todo))
            for name, number in todo:
                done.append(_driven(name, number, fast, quality, out if number == video else None))
                result = _write(out, head, done, len(done) < len(todo))
                progress.advance(task)
    except KeyboardInterrupt:
        pass  # the result says so
    report(result, out)
    if result["interrupted"]:
        note(f"interrupted after {len(done)} of {len(todo)} drives; what was written is whole")
        raise typer.Exit(INTERRUPTED)


def _chosen(scenario: list[str] | None) -> list[str]:
    odd = [name for name in scenario or () if name not in CHALLENGES]
    if odd:
        raise OutputError(f"{odd[0]!r:.40} is no scenario: choose one of {', '.join(CHALLENGES)}")
    return list(dict.fromkeys(scenario or CHALLENGES))


def _driven(name: str, seed: int, fast: bool, quality: str, film_to: Path | None) -> dict[str, Any]:
    rig = small_rig()
    if fast:
        return drive(name, seed, guessed(rig, seed, Noise()))
    if film_to is None:
        return drive(name, seed, rendered(rig, seed, quality))
    return drive(name, seed, rendered(rig, seed, quality))


def _write(out: Path, head: Mapping[str, Any], done: list[dict[str, Any]], interrupted: bool) -> dict[str, Any]:
    result = {
        **head,
        "finished": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "interrupted": interrupted,
        **counts(done),
        "km": round(sum(run["km"] for run in done), 4),
        "rows": by_scenario(done),
        "runs": done,
    }
    write_run(out / RESULT, result)
    return result


def report(result: Mapping[str, Any], out: Path) -> None:
    """Print what came of it, and write the page."""
    columns = ("scenario", ">drives", ">effective", ">failed", ">false", ">km", ">failures below (95 %)")
    show_table("avoidance", columns, _lines(result))
    for run in result["runs"]:
        if run["outcome"] != "effective":
            say(f"{run['scenario']} {run['seed']}: {run['outcome']}: {run['reason']}")
    say(f"results: {out / RESULT}")
    try:
        write_avoidance_page(out / PAGE, result)
    except MissingExtraError as error:
        note(str(error))
    else:
        say(f"page: {out / PAGE}")


def _lines(result: Mapping[str, Any]) -> Iterator[list[str]]:
    for row in result["rows"]:
        counted = [str(row[key]) for key in ("runs", "effective", "failed", "false")]
        yield [row["scenario"], *counted, f"{row['km']:.2f}", f"{row['failed_below']:.3f}"]
