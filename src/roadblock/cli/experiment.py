"""`roadblock experiment`: the paper's experiment in the simulated world, every detector beside the paper's figures."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import cv2
import numpy as np
import typer
from numpy.typing import NDArray

import roadblock
from roadblock.cli.detect import INTERRUPTED, rig_record
from roadblock.cli.experiment_avoidance import avoidance_experiment
from roadblock.cli.experiment_range import range_experiment
from roadblock.cli.resume import earlier, take
from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import note, say, show_table
from roadblock.config import make_settings
from roadblock.detectors import DETECTORS
from roadblock.errors import MissingExtraError
from roadblock.eval.accuracy import Reading, read_frame
from roadblock.eval.table2 import TARGETS, Target, compare, index_of, paper_records, reading_record, rows
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import frame_record, write_run
from roadblock.pipeline import Pipeline
from roadblock.sim.drive import truth_record
from roadblock.sim.render import render
from roadblock.sim.scene import Scene, paper_rig
from roadblock.sim.scenes import SCENES
from roadblock.stages.mono.horizon import find_road
from roadblock.stages.mono.measure import contact_point, guess_kind, outline_area
from roadblock.stages.mono.ranging import range_from_area, range_from_contact
from roadblock.stages.mono.settings import BUILDS
from roadblock.stages.rectify import rectify
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.scene import GroundPlane
from roadblock.viz.report import write_page

RESULT, PAGE = "result.json", "report.html"
SCHEMA = 1
"""Version of `result.json`."""
SPEED_KMH = 30.0
METHODS: dict[str, dict[str, Any]] = {
    **{name: {"detector": name} for name in DETECTORS},
    "dense_bm": {"detector": "dense", "match": {"matcher": "bm", "block_px": 15}},
    "dense_region": {"detector": "dense", "match": {"matcher": "region", "block_px": 21}},
    "cells_refined": {"detector": "cells", "refine": {"level": "fast"}},
    "cells_shape": {"detector": "cells", "refine": {"level": "shape"}},
}
"""What measures, and its settings: every detector, `dense` with its other matchers, and `cells` refined twice."""
FRAME_S = 0.1
"""From picture to picture: the one nearest to the marks is taken up to half of it before or behind them."""
NOD_DEG = 0.2
"""Standard deviation of the pitch that driving adds."""
ORACLES = ("mono_ground_oracle", "mono_area_oracle")
RANGE = (
    "the forward distance from the point halfway between the cameras to the nearest visible face: the 10th "
    "percentile over the visible surface, in the truth as in every measurement"
)

experiment_app = typer.Typer(help="Repeat the paper's experiment in the simulated world.", no_args_is_help=True)


@experiment_app.callback()
def _experiment() -> None:
    """Repeat the paper's experiment in the simulated world."""


experiment_app.command("range")(range_experiment)
experiment_app.command("avoidance")(avoidance_experiment)


@experiment_app.command("table2")
def table2(
    runs: Annotated[int, typer.Option(help="Independent pictures, each with a seed of its own.", min=1)] = 20,
    seed: Annotated[int, typer.Option(help="Of the first picture; the next one counts on.", min=0)] = 0,
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of the paper's rig.")] = None,
    calibrated: Annotated[
        Path | None, typer.Option(help="Rig file that the detectors go by, as calibrating that rig gave it.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for result.json and report.html.")] = Path("roadblock-table2"),
    quality: Annotated[Literal["demo", "evidence"], typer.Option(help="Of the pictures.")] = "demo",
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Measure a person at 5 m, a bicycle at 10 m and a fork at 20 m with every detector, as the paper's table 2."""
    cameras = paper_rig() if rig is None else open_rig(rig, rig_format, unit, size)
    believed = cameras if calibrated is None else open_rig(calibrated, rig_format, unit, size)
    asked = {
        "runs": runs,
        "seed": seed,
        "quality": quality,
        "speed_kmh": SPEED_KMH,
        "range": RANGE,
        "detectors": list(METHODS),
        "rig": rig_record(cameras),
        "calibrated": rig_record(believed),
    }
    head = {
        "schema": SCHEMA,
        "experiment": "table2",
        "version": roadblock.__version__,
        "commit": package_commit(),
        "settings": asked,
    }
    readings = earlier(out / RESULT, head, rows)
    done = run(head, readings, (cameras, believed), out / RESULT)
    report(done, out)
    if done["interrupted"]:
        note(f"interrupted after run {done['runs_done']} of {runs}; the same command goes on from there")
        raise typer.Exit(INTERRUPTED)


def run(
    head: Mapping[str, Any], readings: Sequence[Mapping[str, Any]], rigs: tuple[StereoRig, StereoRig], path: Path
) -> dict[str, Any]:
    """Take the readings that are still missing, writing `result.json` after each picture; Ctrl-C ends it early.

    Parameters
    ----------
    head
        The first fields of the result.
    readings
        From an earlier, interrupted run.
    rigs
        The cameras that take the pictures, and what the detectors take them for.
    path
        The file.

    Returns
    -------
    The result as written last.
    """
    first, runs = head["settings"]["seed"], head["settings"]["runs"]
    all_readings = list(readings)
    todo = sorted(set(range(first, first + runs)) - {reading["seed"] for reading in readings})
    started, machine = datetime.now(UTC), machine_record()

    def one(seed: int) -> None:
        all_readings.extend(measure(seed, rigs, head["settings"]["quality"]))

    def write(interrupted: bool) -> dict[str, Any]:
        result = _result(head, all_readings, machine, started, interrupted)
        write_run(path, result)
        return result

    return take("measuring", todo, runs, one, write)


def _result(
    head: Mapping[str, Any],
    readings: Sequence[Mapping[str, Any]],
    machine: Mapping[str, Any],
    started: datetime,
    interrupted: bool,
) -> dict[str, Any]:
    table = rows(readings)
    return {
        **head,
        "machine": machine,
        "started": started.isoformat(timespec="milliseconds"),
        "finished": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "runs_done": len({reading["seed"] for reading in readings}),
        "interrupted": interrupted,
        "rows": table,
        "comparison": compare(table),
        "paper": paper_records(),
        "readings": list(readings),
    }


def measure(seed: int, rigs: tuple[StereoRig, StereoRig], quality: str) -> list[dict[str, Any]]:
    """Return the readings of one picture of the paper's scene: every detector, every target."""
    true, rig = rigs
    picture = render(moment(seed), true, quality=quality, seed=seed, name=str(seed))
    plain = Pipeline(rig)
    rectification, pair = plain.rectification, rectify(picture.pair, plain.rectification, rig.left.size_px)
    ids = _rectified(picture.ids, rectification)
    objects = [thing | {"box_px": _box(ids == thing["id"])} for thing in truth_record(picture)["objects"]]
    places = [(target, index_of(target, objects)) for target in TARGETS]
    # Everyone knows what the paper's vehicle knew: how high its cameras are.
    height_m = picture.ground.height_m
    known = {"mono": {"height_m": height_m}, "bands": {"camera_height_m": height_m}}
    readings = []
    for detector, method in METHODS.items():
        settings = make_settings({**method, **known})
        result, _ = Pipeline(rig, settings).step(picture.pair)
        read = read_frame(frame_record(result)["obstacles"], objects)
        readings += [reading_record(detector, target, seed, read[index]) for target, index in places]
    ground = find_road(pair.left, rectification, make_settings(known).mono)
    for target, index in places:
        mask, true_m = ids == objects[index]["id"], objects[index]["range_m"]
        for detector, range_m in oracles(mask, target.type, rectification, ground).items():
            readings.append(reading_record(detector, target, seed, Reading(target.type, true_m, range_m)))
    return readings


def moment(seed: int) -> Scene:
    """Return the paper's scene as one picture of a drive sees it.

    At 30 km/h and ten pictures a second, the one nearest to the marks at 5, 10 and 20 m is taken up to 0.42 m before or
    behind them; and the vehicle nods a little. So runs are independent, and fall between whole pixels anywhere.
    """
    rng = np.random.default_rng([seed, 11])
    scene = SCENES["paper"](seed).at(rng.uniform(-FRAME_S / 2, FRAME_S / 2))
    nod = rotation_from_rotvec([np.radians(rng.normal(0, NOD_DEG)), 0, 0])
    return replace(scene, T_world_car=scene.T_world_car @ pose(nod, np.zeros(3)))


def _rectified(ids: NDArray[np.int32], rectification: Rectification) -> NDArray[np.int16]:
    """Return the id map as the rectified left camera sees it, so that its boxes are those the detectors find."""
    small = ids.astype(np.int16)
    if rectification.maps_left is None:
        return small
    return np.asarray(cv2.remap(small, *rectification.maps_left, cv2.INTER_NEAREST), np.int16)


def _box(mask: NDArray[np.bool_]) -> list[int]:
    rows_seen, columns_seen = np.flatnonzero(mask.any(1)), np.flatnonzero(mask.any(0))
    return [int(columns_seen[0]), int(rows_seen[0]), int(columns_seen[-1]) + 1, int(rows_seen[-1]) + 1]


def oracles(
    mask: NDArray[np.bool_], kind: str, rectification: Rectification, ground: GroundPlane | None
) -> dict[str, float]:
    """Return the ranges that both traditional algorithms make of the exact mask and type, metres.

    Parameters
    ----------
    mask, kind
        What is there.
    rectification
        The camera.
    ground
        The road as they find it: height known, horizon from the picture. None: found none; then the ranges are NaN.
    """
    if ground is None:
        return dict.fromkeys(ORACLES, math.nan)
    area_px, _, middle_px = outline_area(mask)
    _, yaw_rad = guess_kind(mask, rectification, ground, kind)
    ranges_m = (
        range_from_contact(*contact_point(mask), rectification, ground),
        range_from_area(area_px, middle_px, BUILDS[kind], rectification, ground, yaw_rad),
    )
    return dict(zip(ORACLES, ranges_m, strict=True))


def report(result: Mapping[str, Any], out: Path) -> None:
    """Print one table per target beside the paper's figures, and write the page."""
    columns = ("measured by", ">runs", ">missed", ">bias (m)", ">RMS", ">median |error|", ">95 %")
    for target in TARGETS:
        where = f"{target.type} at {target.nominal_m:g} m"
        read = f"{target.proposed_m:.2f}, traditional {target.traditional_1_m:.2f} and {target.traditional_2_m:.2f} m"
        show_table(f"{where} (the paper read: proposed {read})", columns, _lines(target, result["rows"]))
    say(f"results: {out / RESULT}")
    try:
        write_page(out / PAGE, result)
    except MissingExtraError as error:
        note(str(error))
    else:
        say(f"page: {out / PAGE}")


def _lines(target: Target, table: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    for row in table:
        if row["type"] == target.type:
            figures = [row[key] for key in ("bias_m", "rms_m", "median_abs_m", "p95_abs_m")]
            cells = ["" if value is None else f"{value:.3f}" for value in figures]
            cells[0] = cells[0] and f"{figures[0]:+.3f}"
            yield [row["detector"], str(row["n"]), str(row["missed"]), *cells]
    for name, range_m in (
        ("paper: proposed", target.proposed_m),
        ("paper: trad. 1", target.traditional_1_m),
        ("paper: trad. 2", target.traditional_2_m),
    ):
        error_m = range_m - target.nominal_m
        yield [name, "1", "0", f"{error_m:+.2f}", "", f"{abs(error_m):.2f}", ""]
