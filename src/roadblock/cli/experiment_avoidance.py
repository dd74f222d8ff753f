"""`roadblock experiment avoidance`: a car drives by what is found, and nothing must be touched."""

from collections.abc import Iterator, Mapping
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import roadblock
from roadblock.cli.avoidance_drive import SCENARIOS, Film, drive, guessed, rendered, small_rig
from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.resume import earlier, take
from roadblock.cli.terminal import note, say, show_table
from roadblock.errors import MissingExtraError, OutputError
from roadblock.eval.avoidance import by_scenario, counts, grid_cells
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import write_run
from roadblock.sim.challenges import ALLOWED_KMH, CHALLENGES, GRID
from roadblock.sim.observed import Noise
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import FrameResult
from roadblock.viz.avoidance_report import write_avoidance_page
from roadblock.viz.sinks import VideoSink

RESULT, PAGE = "result.json", "report.html"
SCHEMA = 1
"""Version of `result.json`."""


def avoidance_experiment(
    runs: Annotated[int, typer.Option(help="Drives of each scenario, each with a seed of its own.", min=1)] = 3,
    seed: Annotated[int, typer.Option(help="Of the first one; the next ones count on.", min=0)] = 0,
    scenario: Annotated[list[str] | None, typer.Option(help="One of them, or 'grid' (may be given again).")] = None,
    out: Annotated[Path, typer.Option(help="Folder for result.json and report.html.")] = Path("roadblock-avoidance"),
    fast: Annotated[bool, typer.Option("--fast", help="A model of what is found instead of pictures.")] = False,
    quality: Annotated[Literal["preview", "demo"], typer.Option(help="Of the pictures.")] = "demo",
    video: Annotated[int | None, typer.Option(help="Write videos of the drives with this seed.")] = None,
) -> None:
    """Drive a car by its own decisions: the paper's three obstacles at 30 km/h, and whatever else a road brings."""
    names = _chosen(scenario)
    head = {
        "schema": SCHEMA,
        "experiment": "avoidance",
        "version": roadblock.__version__,
        "commit": package_commit(),
        "settings": {"runs": runs, "seed": seed, "scenarios": names, "fast": fast, "quality": quality},
    }
    about = {"machine": machine_record(), "started": datetime.now(UTC).isoformat(timespec="milliseconds")}
    wanted = [(name, number) for number in range(seed, seed + runs) for name in names]
    done = [
        run
        for run in earlier(out / RESULT, head, by_scenario, "runs", ("runs", "scenarios"))
        if (run["scenario"], run["seed"]) in wanted
    ]
    have = {(run["scenario"], run["seed"]) for run in done}

    def one(part: tuple[str, int]) -> None:
        done.append(_driven(*part, fast, quality, out if part[1] == video else None))

    def write(interrupted: bool) -> dict[str, Any]:
        return _write(out, {**head, **about}, done, interrupted)

    result = take("driving", [part for part in wanted if part not in have], len(wanted), one, write)
    report(result, out)
    if result["interrupted"]:
        note(f"interrupted after {len(done)} of {len(wanted)} drives; the same command goes on from there")
        raise typer.Exit(INTERRUPTED)


def _chosen(scenario: list[str] | None) -> list[str]:
    names = [name for chosen in scenario or CHALLENGES for name in (GRID if chosen == "grid" else [chosen])]
    odd = [name for name in names if name not in SCENARIOS]
    if odd:
        raise OutputError(f"{odd[0]!r:.40} is no scenario: choose one of {', '.join(CHALLENGES)}, or grid")
    return list(dict.fromkeys(names))


def _driven(name: str, seed: int, fast: bool, quality: str, film_to: Path | None) -> dict[str, Any]:
    rig = small_rig()
    look = guessed(rig, seed, Noise()) if fast else rendered(rig, seed, quality)
    path = None if film_to is None or fast else film_to / f"{name.replace(' ', '-').replace('/', '')}-{seed}.mp4"
    with nullcontext() if path is None else VideoSink(path) as sink:
        return drive(name, seed, look, None if sink is None else _film(sink))


def _film(sink: VideoSink) -> Film:
    def film(result: FrameResult, pair: RectifiedPair) -> None:
        sink.write(pair.left, result, pair.rectification)

    return film


def _write(out: Path, head: Mapping[str, Any], done: list[dict[str, Any]], interrupted: bool) -> dict[str, Any]:
    result = {
        **head,
        "finished": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "interrupted": interrupted,
        **counts(done),
        "km": round(sum(run["km"] for run in done), 4),
        "rows": by_scenario(done),
        "grid": grid_cells(done, ALLOWED_KMH),
        "runs": done,
    }
    write_run(out / RESULT, result)
    return result


def report(result: Mapping[str, Any], out: Path) -> None:
    """Print what came of it, and write the page."""
    columns = ("scenario", ">drives", ">effective", ">failed", ">false", ">km", ">failures below (95 %)")
    show_table("avoidance", columns, _lines(result))
    if result["grid"]:
        told = ("target", ">speed (km/h)", ">impact (km/h)", ">allowed (km/h)")
        show_table("impact speeds", told, ([_cell(value) for value in cell.values()] for cell in result["grid"]))
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


def _cell(value: object) -> str:
    return "not known" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
