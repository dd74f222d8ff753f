"""`roadblock experiment range`: how well ranges are measured, beside the bound and off-the-shelf matchers."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

import roadblock
from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.resume import earlier, take
from roadblock.cli.terminal import note, say, show_table
from roadblock.config import Settings, load_settings
from roadblock.errors import MissingExtraError
from roadblock.eval.match import pair_up
from roadblock.eval.ranges import anees, bound_px, normalized_error, plain, rows
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import write_run
from roadblock.pipeline import Pipeline
from roadblock.sim.lineup import CAMERA, GREY_NOISE, TARGETS, Target, lineup
from roadblock.sim.photograph import photograph
from roadblock.sim.render import Rendered
from roadblock.sim.scene import paper_rig
from roadblock.stages.match import MatchSettings, match
from roadblock.stages.rectify import rectify
from roadblock.stages.refine import RefineSettings, refine
from roadblock.stages.triangulate import locate_all
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import NEAREST_FACE_PERCENT, GroundPlane, Region
from roadblock.viz.range_report import write_range_page

RESULT, PAGE, REFINED = "result.json", "report.html", "_refined"
SCHEMA = 1
RANGES_M = (5.0, 10.0, 20.0, 40.0, 60.0)
MATCHERS = {
    "sgbm_exact": MatchSettings(),
    "bm_exact": MatchSettings(matcher="bm", block_px=15),
}
"""Off-the-shelf matchers, whose median over the exact mask is a reading of the mean visible surface."""


def range_experiment(
    runs: Annotated[int, typer.Option(help="Line-ups at each range, each with a seed of its own.", min=1)] = 5,
    seed: Annotated[int, typer.Option(help="Of the first one; the next ones count on.", min=0)] = 0,
    out: Annotated[Path, typer.Option(help="Folder for result.json and report.html.")] = Path("roadblock-range"),
    quality: Annotated[Literal["demo", "evidence"], typer.Option(help="Of the pictures.")] = "demo",
    changes: Annotated[
        list[str] | None, typer.Option("--set", help="One setting, as stage.key=value; may be repeated.")
    ] = None,
) -> None:
    """Measure seven things at 5 to 60 m: bias, RMS, percentiles and coverage, beside the Cramer-Rao bound."""
    settings = load_settings(None, ["refine.level=fast", *(changes or [])])
    asked = {"runs": runs, "seed": seed, "quality": quality, "ranges_m": list(RANGES_M), "set": changes or []}
    head = {
        "schema": SCHEMA,
        "experiment": "range",
        "version": roadblock.__version__,
        "commit": package_commit(),
        "settings": asked,
    }
    readings = earlier(out / RESULT, head, rows)
    result = run(head, readings, settings, out / RESULT)
    report(result, out)
    if result["interrupted"]:
        note(f"interrupted after run {result['runs_done']} of {runs}; the same command goes on from there")
        raise typer.Exit(INTERRUPTED)


def run(
    head: Mapping[str, Any], readings: Sequence[Mapping[str, Any]], settings: Settings, path: Path
) -> dict[str, Any]:
    """Take the readings that are still missing, writing `result.json` after each line-up; Ctrl-C ends it early."""
    first, runs = head["settings"]["seed"], head["settings"]["runs"]
    rig, taken = paper_rig(), list(readings)
    todo = sorted(set(range(first, first + runs)) - {reading["seed"] for reading in taken})
    about = {"machine": machine_record(), "started": datetime.now(UTC).isoformat(timespec="milliseconds")}

    def write(interrupted: bool) -> dict[str, Any]:
        found: dict[str, Any] = {"runs_done": len({reading["seed"] for reading in taken}), "interrupted": interrupted}
        refined, detected = ([r for r in taken if r["detector"].endswith(REFINED) == way] for way in (True, False))
        found |= {"rows": rows(taken), "anees": anees(refined), "anees_as_detected": anees(detected), "readings": taken}
        result = {**head, **about, "finished": datetime.now(UTC).isoformat(timespec="milliseconds"), **found}
        write_run(path, result)
        return result

    def one(number: int) -> None:
        quality = head["settings"]["quality"]
        taken.extend([r for range_m in RANGES_M for r in measure(number, range_m, rig, settings, quality)])

    return take("measuring", todo, runs, one, write)


def measure(seed: int, range_m: float, rig: StereoRig, settings: Settings, quality: str) -> list[dict[str, Any]]:
    """Return the readings of all targets at one range."""
    pipeline, readings = Pipeline(rig, settings), []
    for scene, shown in lineup(seed, range_m, rig):
        picture = photograph(scene, rig, CAMERA, quality=quality, seed=scene.seed)
        pair = rectify(picture.pair, pipeline.rectification, rig.left.size_px)
        found = pipeline.detect(pair)
        refined = refine(pair, found.regions, settings.refine)
        ways = {settings.detector: found.regions, settings.detector + REFINED: refined}
        own = [r for way, regions in ways.items() for r in with_own_cut(picture, pair, found.ground, way, regions)]
        maps = {name: match(pair, wanted).d_px for name, wanted in MATCHERS.items()}
        for number, target in shown.items():
            common = {"type": target.name, "nominal_m": range_m, "seed": seed}
            readings += [common | r for r in with_exact_mask(picture, pair, number, target, maps, settings.refine)]
            readings += [common | r for thing, r in own if thing == number]
    return readings


def with_own_cut(
    picture: Rendered, pair: RectifiedPair, ground: GroundPlane | None, way: str, regions: Sequence[Region]
) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number of each thing in the picture, and what is read of it where the detector cut it out.

    Its nearest face, and the error of its place; where it was refined, its mean visible surface, too.
    """
    obstacles = locate_all(regions, pair.rectification, ground, [None] * len(regions))
    boxes = [{"box_px": o.box_px, "range_m": o.range_m} for o in obstacles]
    true = [{"box_px": thing.box_px, "range_m": thing.range_m} for thing in picture.objects]
    for thing, index in zip(picture.objects, pair_up(boxes, true), strict=True):
        nothing = {"range_m": None, "range_sigma_m": None, "bound_m": None}
        own: dict[str, Any] = nothing | {"detector": way, "true_range_m": plain(thing.range_m)}
        mean = nothing | {
            "detector": f"{way}_mean",
            "true_range_m": plain(float(picture.depth_m[picture.ids == thing.id].mean())),
        }
        if index is not None:
            obstacle, fit = obstacles[index], regions[index].refined
            own |= {"range_m": plain(obstacle.range_m), "range_sigma_m": plain(obstacle.range_sigma_m)}
            own["nees"] = normalized_error(obstacle.position_m - thing.position_m, obstacle.cov_match_m2)
            if fit is not None:
                z_m = float(distance_m(fit.mean_d_px, pair.rectification))
                mean |= {"range_m": plain(z_m), "range_sigma_m": plain(z_m / fit.mean_d_px * fit.sigma_mean_d_px)}
        yield thing.id, own
        if way.endswith(REFINED):
            yield thing.id, mean


def with_exact_mask(
    picture: Rendered,
    pair: RectifiedPair,
    number: int,
    target: Target,
    maps: Mapping[str, NDArray[np.float32]],
    settings: RefineSettings,
) -> Iterator[dict[str, Any]]:
    """Yield what is read where the target's pixels are known exactly.

    `refined_mean` and the matchers measure the mean visible surface, `refined_nearest` the nearest face.
    """
    mask = picture.ids == number
    if target.face_m is not None and mask.any():
        mask = mask & (picture.depth_m < np.percentile(picture.depth_m[mask], NEAREST_FACE_PERCENT) + target.face_m)
    if mask.sum() < 2:
        return
    depth_m, r = picture.depth_m[mask], pair.rectification
    mean_m, nearest_m = float(depth_m.mean()), float(np.percentile(depth_m, NEAREST_FACE_PERCENT))
    per_px = mean_m**2 / (r.f_px * r.baseline_m)
    bound_m = plain(per_px * bound_px(pair.left, mask, GREY_NOISE))
    true_mean = {"true_range_m": plain(mean_m), "bound_m": bound_m}
    for name, d_px in maps.items():
        median_px = np.nanmedian(d_px[mask]) if np.isfinite(d_px[mask]).any() else np.nan
        yield {"detector": name, "range_m": plain(float(distance_m(median_px, r))), "range_sigma_m": None} | true_mean
    region = exact_region(mask, maps["sgbm_exact"], r.f_px * r.baseline_m / nearest_m)
    refined = refine(pair, [region], settings)[0].refined
    for name, true_m in (("refined_mean", mean_m), ("refined_nearest", nearest_m)):
        measured_px, sigma_px = np.nan, np.nan
        if refined is not None and name == "refined_mean":
            measured_px, sigma_px = refined.mean_d_px, refined.sigma_mean_d_px
        elif refined is not None:
            measured_px, sigma_px = refined.nearest_d_px, refined.sigma_nearest_d_px
        z_m = float(distance_m(measured_px, r))
        reading = {"detector": name, "range_m": plain(z_m), "range_sigma_m": plain(z_m / measured_px * sigma_px)}
        yield reading | {"true_range_m": plain(true_m), "bound_m": bound_m}


def distance_m(d_px: float, r: Rectification) -> float:
    """Return the forward distance of a disparity, metres; NaN where it is NaN."""
    return r.f_px * r.baseline_m / d_px


def exact_region(mask: NDArray[np.bool_], d_px: NDArray[np.float32], true_px: float) -> Region:
    """Return the pixels of a mask as a region, with the coarse disparities of a matcher.

    Where the matcher knows nothing of a pixel, or is far off the others, its median stands; and where that itself is
    wrong by more than 3 px (it saw only the background), the truth, off by half a pixel.
    """
    coarse = np.where(mask, d_px, np.nan)
    known = coarse[np.isfinite(coarse)]
    median = float(np.median(known)) if len(known) else np.nan
    if not abs(median - true_px) <= 3:
        median = true_px + 0.5
    with np.errstate(invalid="ignore"):
        usable = (coarse > 0.65 * median - 1) & (coarse < 1.2 * median + 1)
    v, u = np.nonzero(mask)
    surface: FloatArray = np.stack([u, v, np.where(usable, coarse, median)[v, u]], -1).astype(float)
    box = (int(u.min()), int(v.min()), int(u.max()) + 1, int(v.max()) + 1)
    return Region(box, np.zeros((0, 2), np.int32), surface, 1.0, np.full(3, np.nan))


def report(result: Mapping[str, Any], out: Path) -> None:
    """Print one table per target, and write the page."""
    columns = ("measured by", ">at", ">n", ">missed", ">median (m)", ">95 %", ">bound", ">1 sigma", ">2 sigma")
    for target in TARGETS:
        show_table(target.name, columns, _lines([row for row in result["rows"] if row["type"] == target.name]))
    say(f"ANEES (3-D, own segmentation; 3 is honest): {result['anees']}, as detected {result['anees_as_detected']}")
    say(f"results: {out / RESULT}")
    try:
        write_range_page(out / PAGE, result)
    except MissingExtraError as error:
        note(str(error))
    else:
        say(f"page: {out / PAGE}")


def _lines(table: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    lengths, shares = ("median_abs_m", "p95_abs_m", "bound_m"), ("coverage_68", "coverage_95")
    for row in table:
        figures = ["" if row[key] is None else f"{row[key]:.3f}" for key in lengths]
        figures += ["" if row[key] is None else f"{row[key]:.0%}" for key in shares]
        yield [row["detector"], f"{row['true_range_m']:g} m", str(row["n"]), str(row["missed"]), *figures]
