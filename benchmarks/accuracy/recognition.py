"""Recognition: `python benchmarks/accuracy/recognition.py [DATA] [--streets N] [--pictures DIR] [--network FILE]`.

Simulated streets of `recognition_world.py`, families `UNSEEN`, seeds `DAY` (daylight) and `SHADE` (in the shadow of a
wall): neither was trained on; their results were looked at three times while widths, sigmas and colours were worked on.
A found obstacle is a true thing if `whose` of
`train_recognition.py` says so, their boxes overlap by half, and the thing is within `FAR_M`; the largest such obstacle
of each thing counts. F1 counts "unknown" as missed, and every obstacle within `FAR_M` that is called something else
than it is as false. Forks: recall of their noses, the nearest
obstacle of each; false is the share of all other obstacles that are called fork. Colours: silver may be gray
or white. Width: against the visible extent across the view; height: against the thing's own; contour: against the
visible pixels, filled from the leftmost to the rightmost of each row. Bicycles and railings, which are mostly holes,
are filled likewise.

Real: moving vehicles of kitti2015 (DATA, default $ROADBLOCK_DATA or ../shared/data), as the outside scorer defines
them, nearer than `REAL_FAR_M` and found (boxes overlap by half, range within 5 % and 1 m): the share called car or
truck, by `shape` and, with `--network`, by that network. Cost: median of the stage over rendered frames of
`COST_THINGS` obstacles.
"""

import argparse
import os
import sys
from collections import Counter
from pathlib import Path
from time import perf_counter
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from recognition_world import picture
from record import save
from train_recognition import whose

from roadblock.config import load_settings
from roadblock.eval.match import overlaps
from roadblock.io.sources import open_source
from roadblock.pipeline import Pipeline
from roadblock.stages.recognize import RecognizeSettings, make_recognizer
from roadblock.stages.recognize.types import CLASSES
from roadblock.stages.rectify import rectify
from roadblock.stages.triangulate import locate_all
from roadblock.values.frame import StereoPair
from roadblock.values.scene import Obstacle, Region

Mask = NDArray[np.bool_]
DAY, SHADE = 7000, 8000
FAR_M, NEAR_M, REAL_FAR_M = 30.0, 15.0, 35.0
KINDS = CLASSES[:-1]
SAME = {"grey": ("gray",), "silver": ("gray", "white")}
COST_THINGS = 16


def filled(mask: Mask) -> Mask:
    """Return the mask without holes between the leftmost and the rightmost pixel of each row."""
    return np.logical_or.accumulate(mask, 1) & np.logical_or.accumulate(mask[:, ::-1], 1)[:, ::-1]


def painted(obstacle: Obstacle, shape: tuple[int, ...]) -> Mask:
    """Return the pixels within an obstacle's contour."""
    canvas = np.zeros(shape, np.uint8)
    cv2.fillPoly(canvas, [np.asarray(obstacle.contour_px, np.int32)], 1)
    return canvas > 0


def look(pipeline: Pipeline, shot: dict[str, Any]) -> tuple[tuple[Region, ...], tuple[Obstacle, ...]]:
    """Return the regions and what was recognised of each, in one order."""
    pair = rectify(StereoPair(shot["left"], shot["right"]), pipeline.rectification, shot["rig"].left.size_px)
    found = pipeline.detect(pair)
    located = locate_all(found.regions, pipeline.rectification, found.ground, [None] * len(found.regions))
    return found.regions, make_recognizer(RecognizeSettings())(pair, found, found.regions, located)


def judged(shot: dict[str, Any], shaded: bool) -> list[dict[str, Any]]:
    """Return one row for each obstacle within `FAR_M`."""
    pipeline = Pipeline(shot["rig"])
    regions, obstacles = look(pipeline, shot)
    true = {thing["id"]: thing for thing in shot["true"]}
    rows: list[dict[str, Any]] = []
    for region, o in zip(regions, obstacles, strict=True):
        kind, number = whose(region, shot)
        row = {
            "true": kind,
            "said": o.label,
            "odds": o.class_odds,
            "shaded": shaded,
            "whole": False,
            "nose": False,
            "range_m": o.range_m,
        }
        if number:
            row |= compared(o, true[number], shot)
        if o.range_m <= FAR_M:
            rows.append(row | {"number": number})
    for number in {row["number"] for row in rows if row["number"]}:
        pieces = [row for row in rows if row["number"] == number]
        best, nearest = max(pieces, key=lambda row: row["overlap"]), min(pieces, key=lambda row: row["range_m"])
        best["whole"], nearest["nose"] = best["overlap"] >= 0.5, nearest["true"] == "fork"
    return rows


def compared(o: Obstacle, thing: dict[str, Any], shot: dict[str, Any]) -> dict[str, Any]:
    """Return how an obstacle differs from the thing it is."""
    mask = shot["ids"] == thing["id"]
    seen, drawn = filled(mask), painted(o, mask.shape)
    z_m = shot["depth_cm"][mask] / 100
    camera = shot["rig"].left
    x_m = (np.nonzero(mask)[1] - camera.cx_px) / camera.fx_px * z_m
    width_m, height_m = np.ptp(np.percentile(x_m, (0.5, 99.5))), thing["size_m"][1]
    cut = thing["box_px"][1] < 3 or thing["box_px"][0] < 3 or thing["box_px"][2] > mask.shape[1] - 3
    return {
        "overlap": float(overlaps(np.array([o.box_px], float), np.array([thing["box_px"]], float))[0, 0]),
        "color": thing["color"],
        "named": o.colors,
        "width_off_m": o.size_m[0] - width_m,
        "width_m": width_m,
        "height_off_m": np.nan if cut else o.size_m[1] - height_m,
        "height_m": height_m,
        "size_sigma_m": o.size_sigma_m,
        "iou": float((seen & drawn).sum() / (seen | drawn).sum()),
    }


def f1(rows: list[dict[str, Any]], kind: str) -> float:
    """Return the harmonic mean of precision (over all obstacles) and recall (over things found whole)."""
    wholes = [row for row in rows if row["whole"] and row["true"] == kind]
    recall = np.mean([row["said"] == kind for row in wholes]) if wholes else np.nan
    called = [row for row in rows if row["said"] == kind]
    precision = np.mean([row["true"] == kind for row in called]) if called else 0.0
    return float(2 * precision * recall / max(precision + recall, 1e-9))


def calibration_error(rows: list[dict[str, Any]]) -> float:
    """Return the expected calibration error of the most probable class, in ten bins."""
    top = [max(row["odds"].items(), key=lambda item: item[1]) for row in rows]
    p = np.array([item[1] for item in top])
    right = np.array([item[0] == row["true"] for item, row in zip(top, rows, strict=True)])
    bins = np.minimum((10 * p).astype(int), 9)
    return float(sum(abs(p[bins == b].mean() - right[bins == b].mean()) * (bins == b).mean() for b in np.unique(bins)))


def within(off_m: list[float], size_m: list[float]) -> str:
    """Return the median error, and how it compares with 5 cm or 5 %."""
    off, allowed = np.abs(off_m), np.maximum(0.05, 0.05 * np.array(size_m))
    known = np.isfinite(off)
    share = np.mean(off[known] <= allowed[known])
    relative = np.median(off[known] / allowed[known])
    return f"{np.median(off[known]):.3f} m, {relative:.2f} of what is allowed ({share:.2f} within)"


def synthetic(streets: int, folder: Path) -> list[list[str]]:
    """Return the rows of the simulated streets."""
    rows = [row for k in range(streets) for row in judged(picture(DAY + k, True, False, folder), False)]
    rows += [row for k in range(0, streets, 2) for row in judged(picture(SHADE + k, True, True, folder), True)]
    wholes = [row for row in rows if row["whole"]]
    by_kind = {kind: f1(rows, kind) for kind in KINDS}
    alone = {kind: f1([r for r in rows if r["whole"]], kind) for kind in KINDS}
    forks = [row for row in rows if row["nose"]]
    others = [row for row in rows if row["true"] != "fork"]
    near = [row for row in wholes if row["range_m"] <= NEAR_M]
    confused = Counter((r["true"], r["said"]) for r in wholes if r["true"] != r["said"]).most_common(12)
    print("confused:", confused)
    named = [row for row in rows if row.get("color") and row["overlap"] >= 0.3 and row["true"] != "vegetation"]
    lines = [
        ["things found whole, obstacles judged", f"{len(wholes)}, {len(rows)}", ""],
        ["macro F1, all obstacles", f"{np.nanmean(list(by_kind.values())):.3f}", ">= .90"],
        ["macro F1, things found whole alone", f"{np.nanmean(list(alone.values())):.3f}", ""],
        *[[f"F1 {kind}: all, whole alone", f"{by_kind[kind]:.2f}, {alone[kind]:.2f}", ""] for kind in KINDS],
        ["forks: recall", f"{np.mean([r['said'] == 'fork' for r in forks]):.3f} of {len(forks)}", ">= .95"],
        ["forks: false", f"{np.mean([r['said'] == 'fork' for r in others]):.4f}", "<= .01"],
        ["called unknown, of things found whole", f"{np.mean([r['said'] == 'unknown' for r in wholes]):.3f}", ""],
        ["expected calibration error", f"{calibration_error(rows):.3f}", "<= .05"],
        ["width, <= 15 m, median error", within([r["width_off_m"] for r in near], [r["width_m"] for r in near]), "1"],
        [
            "height, <= 15 m, median error",
            within([r["height_off_m"] for r in near], [r["height_m"] for r in near]),
            "1",
        ],
        ["contour, median intersection over union", f"{np.median([r['iou'] for r in wholes]):.3f}", ">= .85"],
        ["the same, <= 15 m", f"{np.median([r['iou'] for r in near]):.3f}", ""],
    ]
    for shaded, where, bar in ((False, "daylight", ">= .95"), (True, "shadow", ">= .85")):
        mine = [(SAME.get(r["color"], (r["color"],)), r["named"]) for r in named if r["shaded"] == shaded]
        first, either = (np.mean([bool(set(s) & set(n[:last])) for s, n in mine]) for last in (1, 2))
        lines.append([f"colour right in {where}: first name, either", f"{first:.3f}, {either:.3f} of {len(mine)}", bar])
    for side, name in ((0, "width"), (1, "height")):
        ratio = np.array([abs(r[f"{name}_off_m"]) / r["size_sigma_m"][side] for r in wholes])
        ratio = ratio[np.isfinite(ratio)]
        lines.append(
            [f"{name} within 1 / 2 sigma", f"{np.mean(ratio <= 1):.2f} / {np.mean(ratio <= 2):.2f}", ".68 / .95"]
        )
    return [["simulated, unseen shapes", *line] for line in lines]


def vehicles(data: Path, options: list[str]) -> tuple[list[str], int]:
    """Return what the moving vehicles of kitti2015 that were found are called, and how many obstacles there are."""
    source, called, count = open_source(data), [], 0
    pipelines = {id(rig): Pipeline(rig, load_settings(None, options)) for rig in source.rigs or (source.rig,)}
    for pair in source:
        pipeline = pipelines[id(source.rigs[pair.index] if source.rigs else source.rig)]
        obstacles = pipeline.step(pair)[0].obstacles
        count += len(obstacles)
        number = pair.name.split("_")[0]
        masks = cv2.imread(str(next((data / "obj_map").glob(f"{number}*"))), cv2.IMREAD_UNCHANGED)
        disparity = cv2.imread(str(next((data / "disp_occ_0").glob(f"{number}*"))), cv2.IMREAD_UNCHANGED) / 256
        fb = pipeline.rectification.f_px * pipeline.rectification.baseline_m
        for mask in (masks == i for i in np.unique(masks) if i):
            d_px = disparity[mask & (disparity > 0)]
            if mask.sum() < 400 or len(d_px) < 20:
                continue
            range_m = fb / np.percentile(d_px, 90)
            v, u = np.nonzero(mask)
            box = np.array([[u.min(), v.min(), u.max() + 1, v.max() + 1]], float)
            near = [o for o in obstacles if abs(o.range_m - range_m) <= 1 + 0.05 * range_m]
            shared = overlaps(box, np.array([o.box_px for o in near], float))[0] if near else np.zeros(0)
            if range_m <= REAL_FAR_M and shared.max(initial=0) >= 0.5:
                best = near[int(shared.argmax())]
                called.append(best.label)
                if best.label not in ("car", "truck"):
                    print("kitti2015", number, f"{range_m:.1f} m", best.label, best.class_odds and best.probability)
    return called, count


def real(data: Path, network: Path | None) -> list[list[str]]:
    """Return the rows of the real vehicles."""
    lines = []
    called, count = vehicles(data, [])
    share = np.mean([name in ("car", "truck") for name in called])
    lines.append(["kitti2015", "`shape`: vehicles called car or truck", f"{share:.3f} of {len(called)}", ">= .85"])
    if network is not None:
        called, after = vehicles(data, ["recognize.recognizer=onnx", f"recognize.network={network}"])
        share = np.mean([name in ("car", "truck") for name in called])
        lines.append(["kitti2015", "`onnx`, YOLOX nano: the same", f"{share:.3f} of {len(called)}", ">= .95"])
        lines.append(["kitti2015", "stereo obstacles lost by the network", f"{count - after} of {count}", "0"])
    return lines


def cost(folder: Path) -> list[list[str]]:
    """Return what `shape` costs for `COST_THINGS` obstacles, beside the whole step."""
    cv2.setNumThreads(1)
    shot = max((picture(DAY + k, True, False, folder) for k in range(8)), key=lambda s: len(s["true"]))
    pipeline = Pipeline(shot["rig"])
    pair = rectify(StereoPair(shot["left"], shot["right"]), pipeline.rectification, shot["rig"].left.size_px)
    found = pipeline.detect(pair)
    regions = (found.regions * COST_THINGS)[:COST_THINGS]
    located = locate_all(regions, pipeline.rectification, found.ground, [None] * len(regions))
    recognize = make_recognizer(RecognizeSettings())
    recognize(pair, found, regions, located)
    stage, step = [], []
    for _ in range(60):
        begin = perf_counter()
        recognize(pair, found, regions, located)
        stage.append(1e3 * (perf_counter() - begin))
        step.append(pipeline.step(StereoPair(shot["left"], shot["right"]))[0].timings_ms["total"])
    least, whole = np.min(stage), np.min(step)
    text = f"{np.median(stage):.2f} ms (least {least:.2f}), {least / whole:.3f} of the step"
    return [["cost", f"`shape`, {COST_THINGS} obstacles, one thread", text, "<= .3 ms"]]


def main() -> None:
    """Run all, print, save."""
    parser = argparse.ArgumentParser()
    parser.add_argument("data", nargs="?", type=Path, default=Path(os.environ.get("ROADBLOCK_DATA", "../shared/data")))
    parser.add_argument("--streets", type=int, default=70)
    parser.add_argument("--pictures", type=Path, default=Path("pictures"))
    parser.add_argument("--network", type=Path)
    options = parser.parse_args()
    options.pictures.mkdir(exist_ok=True)
    rows = synthetic(options.streets, options.pictures) + cost(options.pictures)
    if (options.data / "kitti2015").is_dir():
        rows += real(options.data / "kitti2015", options.network)
    for row in rows:
        print(*(f"{cell:45}" for cell in row))
    notes = "Default settings. Nothing of these streets, shapes or recordings was used for training."
    command = f"python benchmarks/accuracy/recognition.py --streets {options.streets}"
    save("recognition", command, ["world", "figure", "measured", "bar"], rows, notes)


if __name__ == "__main__":
    main()
