"""`roadblock experiment range`: how well ranges are measured, beside the bound and off-the-shelf matchers."""

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from numpy.typing import NDArray

import roadblock
from roadblock.cli.terminal import note, progress_bar, say, show_table
from roadblock.config import Settings
from roadblock.errors import MissingExtraError
from roadblock.eval.match import pair_up
from roadblock.eval.ranges import anees, bound_px, normalized_error, plain, rows
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import frame_record, write_run
from roadblock.pipeline import Pipeline
from roadblock.sim.lineup import CAMERA, GREY_NOISE, TARGETS, Target, lineup
from roadblock.sim.photograph import photograph
from roadblock.sim.render import Rendered
from roadblock.sim.scene import paper_rig
from roadblock.stages.match import MatchSettings, match
from roadblock.stages.refine import RefineSettings, refine
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import NEAREST_FACE_PERCENT, Region
from roadblock.viz.range_report import write_range_page

RESULT, PAGE = "result.json", "report.html"
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
) -> None:
    """Measure seven things at 5 to 60 m: bias, RMS, percentiles and coverage, beside the Cramer-Rao bound."""
    head = {
        "schema": SCHEMA,
        "experiment": "range",
        "version": roadblock.__version__,
        "commit": package_commit(),
        "settings": {"runs": runs, "seed": seed, "quality": quality, "ranges_m": list(RANGES_M)},
        "machine": machine_record(),
        "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }
    rig, readings, result = paper_rig(), [], {}
    with progress_bar() as progress:
        task = progress.add_task("measuring", total=runs)
        for done, run in enumerate(range(seed, seed + runs), 1):
            for range_m in RANGES_M:
                readings += measure(run, range_m, rig, quality)
            found = {"runs_done": done, "rows": rows(readings), "anees": anees(readings), "readings": readings}
            result = {**head, **found, "finished": datetime.now(UTC).isoformat(timespec="milliseconds")}
            write_run(out / RESULT, result)
            progress.advance(task)
    report(result, out)


def measure(seed: int, range_m: float, rig: StereoRig, quality: str) -> list[dict[str, Any]]:
    """Return the readings of all targets at one range."""
    pipeline, readings = Pipeline(rig, Settings()), []
    for scene, shown in lineup(seed, range_m, rig):
        picture = photograph(scene, rig, CAMERA, quality=quality, seed=scene.seed)
        result, pair = pipeline.step(picture.pair)
        maps = {name: match(pair, settings).d_px for name, settings in MATCHERS.items()}
        record, objects = frame_record(result), {thing.id: thing for thing in picture.objects}
        true = [{"box_px": thing.box_px, "range_m": thing.range_m} for thing in picture.objects]
        found = dict(zip(objects, pair_up(record["obstacles"], true), strict=True))
        for number, target in shown.items():
            common = {"type": target.name, "nominal_m": range_m, "seed": seed}
            readings += [common | r for r in with_exact_mask(picture, pair, number, target, maps)]
            if number not in objects:
                continue
            thing, index = objects[number], found[number]
            own = {"detector": pipeline.settings.detector, "true_range_m": plain(thing.range_m), "bound_m": None}
            own |= {"range_m": None, "range_sigma_m": None}
            if index is not None:
                obstacle = result.obstacles[index]
                own |= {"range_m": plain(obstacle.range_m), "range_sigma_m": plain(obstacle.range_sigma_m)}
                own["nees"] = normalized_error(obstacle.position_m - thing.position_m, obstacle.cov_match_m2)
            readings.append(common | own)
    return readings


def with_exact_mask(
    picture: Rendered, pair: RectifiedPair, number: int, target: Target, maps: Mapping[str, NDArray[np.float32]]
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
    refined = refine(pair, [region], RefineSettings(level="fast"))[0].refined
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
    columns = (
        "measured by",
        ">at",
        ">n",
        ">missed",
        ">bias (m)",
        ">RMS",
        ">median",
        ">95 %",
        ">bound",
        ">68 %",
        ">95 %",
    )
    for target in TARGETS:
        show_table(target.name, columns, _lines([row for row in result["rows"] if row["type"] == target.name]))
    say(f"ANEES (3-D, own segmentation): {result['anees']}")
    say(f"results: {out / RESULT}")
    try:
        write_range_page(out / PAGE, result)
    except MissingExtraError as error:
        note(str(error))
    else:
        say(f"page: {out / PAGE}")


def _lines(table: Sequence[Mapping[str, Any]]) -> Iterator[list[str]]:
    keys = ("bias_m", "rms_m", "median_abs_m", "p95_abs_m", "bound_m", "coverage_68", "coverage_95")
    for row in table:
        figures = ["" if row[key] is None else f"{row[key]:.3f}" for key in keys]
        yield [row["detector"], f"{row['true_range_m']:g} m", str(row["n"]), str(row["missed"]), *figures]
