"""`roadblock evaluate`: results and truth in; tables, `evaluation.json` and a page out."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

import roadblock
from roadblock.cli.terminal import frames, note, say, show_table
from roadblock.errors import MissingExtraError, SettingsError
from roadblock.eval.evaluate import evaluate
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import RESULTS, read_results, write_run
from roadblock.io.truth import read_truth
from roadblock.viz.evaluation_report import write_evaluation_page

RESULT, PAGE = "evaluation.json", "evaluation.html"
SCHEMA = 1
ALL = "any"
ERRORS_IN_WORDS = "errors of the range in metres, shares within 1 and 2 sigma"
ERRORS = {
    "bias_m": ">bias", "rms_m": ">RMS", "median_abs_m": ">med.", "p95_abs_m": ">95 %", "within_1_sigma": ">1 s",
    "within_2_sigma": ">2 s",
}  # fmt: skip


def evaluate_command(
    results: Annotated[Path, typer.Argument(help="An obstacles.jsonl, or the folder that holds it.")],
    truth: Annotated[
        Path | None, typer.Option(help="The recording: with truth.jsonl, label_2/, or true maps of every pixel.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for evaluation.json and evaluation.html.")] = None,
    offset_px: Annotated[
        float, typer.Option(help="Added to true disparities: KITTI 2015's laser lies off its images by about -0.4.")
    ] = 0.0,
) -> None:
    """Judge found obstacles against all that is known to be true."""
    if truth is None:
        raise SettingsError("nothing to judge by: name the recording that holds the truth with --truth RECORDING")
    file = results / RESULTS if results.is_dir() else results
    known = read_truth(truth)
    found = read_results(file)
    result = {
        "schema": SCHEMA,
        "version": roadblock.__version__,
        "commit": package_commit(),
        "machine": machine_record(),
        "results": str(results),
        "truth": str(truth),
        "truth_kind": known.kind,
        "offset_px": offset_px,
        **evaluate(found, known.frames, known.maps, offset_px),
    }
    if out is not None:
        write_run(out / RESULT, result)
    report(result)
    for warning in known.warnings:
        note(warning)
    if out is not None:
        say(f"results: {out / RESULT}")
        try:
            write_evaluation_page(out / PAGE, result)
        except MissingExtraError as error:
            note(str(error))
        else:
            say(f"page: {out / PAGE}")


def report(result: Mapping[str, Any]) -> None:
    """Print the tables that say most; the rest is in the files."""
    counted = result["frames"]
    if counted["missing"]:
        note(f"without results, so counted as empty: {frames(counted['missing'])} of {counted['judged']}")
    if counted["without_truth"]:
        note(f"without truth, so not judged: {frames(counted['without_truth'])} of the results")
    for section, show in (("things", _show_things), ("tracks", _show_tracks), ("maps", _show_maps)):
        if result[section] is not None:
            show(result[section])


def _show_things(things: Mapping[str, Any]) -> None:
    chosen = [row for row in things["recall"] if row["type"] == ALL or row["to_m"] - row["from_m"] > 20]
    shares = {"n": ">n", "recall": ">found", "recall_right_range": ">right"}
    _show(f"named things: {ERRORS_IN_WORDS}", chosen, {"type": "what", "": ">at (m)", **shares, **ERRORS})
    columns = {"class": "called", "": ">at (m)", "n": ">n", "pieces": ">pieces", "unexplained": ">unexplained"}
    chosen = [row for row in things["precision"] if row["class"] == ALL or row["to_m"] - row["from_m"] > 20]
    _show("precision (what has no name in the truth is unexplained)", chosen, {**columns, "precision": ">precision"})
    named = things["confusion"]
    if named["right"] is not None:
        head = {"true": "true", **{name: f">{name}" for name in named["called"]}}
        rows = [
            {"true": kind, **dict(zip(named["called"], counts, strict=True))}
            for kind, counts in zip(named["classes"], named["counts"], strict=True)
        ]
        _show(f"called: {named['right']:.3f} right, macro F1 {named['macro_f1']:.3f}", rows, head)
    levels = {"class": "class", "level": "level", "ap_2d": ">AP 2D", "ap_bev": ">AP BEV"}
    _show("average precision, KITTI (40 recalls)", things["kitti_ap"], levels)
    limits = {f"ap_{limit}m": f">{limit} m" for limit in ("0.5", "1", "2", "4")}
    _show(
        "average precision by distance on the road", things["distance_ap"], {"class": "class", **limits, "ap": ">mean"}
    )


def _show_tracks(tracks: Mapping[str, Any]) -> None:
    columns = {"by": "alike by", "hota": ">HOTA", "deta": ">DetA", "assa": ">AssA", "mota": ">MOTA", "idf1": ">IDF1"}
    scores = [{"by": "box", **tracks["scores"]}, {"by": "place", **tracks["scores_place"]}]
    _show("tracks", scores, {**columns, "switches": ">switches"})
    velocity = {"motion": "it is", "": ">at (m)", "n": ">n", "rms_mps": ">RMS (m/s)", "median_mps": ">median"}
    _show("velocity over ground", tracks["velocity"], {**velocity, "told_right": ">told right"})
    ttc = [{**row, "from_m": row["from_s"], "to_m": row["to_s"]} for row in tracks["ttc"]]
    columns = {"": ">at (s)", "n": ">n", "unknown": ">unknown", "median": ">median |error| / true", "p95": ">95 %"}
    _show("time to contact", ttc, columns)
    if tracks["warnings"]["false_per_km"] is not None:
        say(f"false warnings: {tracks['warnings']['false']} in {tracks['warnings']['km']:.3f} km")


def _show_maps(maps: Mapping[str, Any]) -> None:
    things = [{**row, **row["range_error"], "n": row["n"]} for row in maps["things"]]
    shares = {"n": ">n", "found_share": ">found", "box_share": ">box"}
    _show(f"things, against true depths: {ERRORS_IN_WORDS}", things, {"": ">at (m)", **shares, **ERRORS})
    counts = {name: f">{name}" for name in ("supported", "unsupported", "hidden", "unknown")}
    rows = [row for row in maps["precision"] if row["class"] == ALL or row["to_m"] - row["from_m"] > 20]
    _show(
        "precision, against true depths", rows, {"class": "called", "": ">at (m)", **counts, "precision": ">precision"}
    )
    free = [*maps["free_space"]["bands"], {**maps["free_space"], "n": maps["free_space"]["columns"]}]
    free[-1] |= {"from_m": free[0]["from_m"], "to_m": free[-2]["to_m"]}
    columns = {
        "": ">at (m)",
        "n": ">columns",
        "observed": ">observed",
        "ok": ">right",
        "late": ">late",
        "near": ">near",
    }
    _show("free space", free, columns)
    if maps["ground"]:
        height_m, pitch_deg = maps["ground"]["height_m_median_abs"], maps["ground"]["pitch_deg_median_abs"]
        say(f"ground, median of |error|: height {height_m:.3f} m, pitch {pitch_deg:.3f} deg")


def _show(title: str, rows: Sequence[Mapping[str, Any]], columns: Mapping[str, str]) -> None:
    """Print records as a table: the columns by key; the key "" is the band."""
    if rows:
        cells = [[_band(row) if key == "" else _text(row.get(key)) for key in columns] for row in rows]
        show_table(title, columns.values(), cells)


def _band(row: Mapping[str, Any]) -> str:
    return f"{row['from_m']:g}-{row['to_m']:g}"


def _text(value: object) -> str:
    return "" if value is None else f"{value:.2f}" if isinstance(value, float) else str(value)
