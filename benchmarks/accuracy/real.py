"""Judge the pipeline on real recordings: `python benchmarks/accuracy/real.py [DATA] [--set stage.key=value ...]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds kitti2015, kitti_road and kitti_raw_0926, and its sibling
folder `tools` the KITTI 2015 scorer. Each recording goes through `roadblock detect`, what it wrote is judged, and
the figures go to `benchmarks/results/real_recordings.json` and BENCHMARK.md. With `--set` nothing is saved.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.io.results import RESULTS, read_results
from roadblock.io.sources import open_source
from roadblock.stages.rectify import plan_rectification

Floats = NDArray[np.float64]
OFFSET_PX = -0.4
"""The laser truth of KITTI 2015 lies about so far off the images, for every matcher tried."""
DETECTORS = ("cells", "fast", "dense")


def detect(recording: Path, out: Path, options: list[str]) -> list[dict]:
    """Run the command line on a recording and return its records."""
    subprocess.run(["roadblock", "detect", str(recording), "--out", str(out), *options], check=True, stdout=2)
    return read_results(out / RESULTS)


def score_2015(data: Path, out: Path, detector: str) -> list[list[str]]:
    """Let the outside scorer judge the KITTI 2015 frames, against the truth as it is and with its offset taken off."""
    scorer = data.parent / "tools" / "score_kitti2015.py"
    command = [sys.executable, scorer, "--data", data / "kitti2015", "--obstacles", out / RESULTS, "--json"]
    s, off = (
        json.loads(subprocess.run([*command, *more], check=True, capture_output=True, text=True).stdout)
        for more in ((), ("--gt-offset-px", str(OFFSET_PX)))
    )
    v, p, f, g, r = s["vehicles"]["0-50"], s["precision"], s["free_space"], s["ground"], s["range"]["0-50"]
    by_offset = f"{v['found']:.3f}, {off['vehicles']['0-50']['found']:.3f}"
    rows = [
        [f"vehicles found (box and range), and with {OFFSET_PX} px", by_offset, ">= .88, .92"],
        ["box alone", f"{v['box']:.3f}", ">= .95"],
        [
            "precision, and without hidden ones",
            f"{p['precision']:.3f}, {p['precision_excl_hidden']:.3f}",
            ">= .95, .97",
        ],
        ["phantoms in the corridor, duplicates", f"{p['corridor_phantoms']}, {s['duplicates']}", "0, <= 2"],
        [
            "free space ok / late / near",
            f"{f['ok']:.3f} / {f['late']:.3f} / {f['near']:.3f}",
            ">= .65 / <= .09 / <= .04",
        ],
        ["ground height, median and worst", f"{g['dh_absmed']:.3f}, {g['dh_absmax']:.3f} m", "<= .02, .08 m"],
        [
            "pitch, median and worst",
            f"{g['dpitch_absmed_deg']:.3f}, {g['dpitch_absmax_deg']:.3f} deg",
            "<= .08, .3 deg",
        ],
        ["range, median of |error|", f"{r['median_abs']:.2f} m", ""],
        ["range within 1 / 2 sigma", f"{r['cov1']:.2f} / {r['cov2']:.2f}", ""],
    ]
    return [[f"kitti2015, `{detector}`", *row] for row in rows]


def calibration(path: Path) -> dict[str, Floats]:
    """Return the number rows of a KITTI calibration file by name."""
    rows = (line.partition(":") for line in path.read_text().splitlines() if ":" in line)
    return {key: np.array(text.split(), float) for key, _, text in rows if not text.strip()[:4].count("-") > 1}


def judge_road(data: Path, records: list[dict]) -> list[list[str]]:
    """Compare ground height and pitch with `Tr_cam_to_road`.

    That transform starts from camera 0 *before* rectification (the benchmark's own tools put R0_rect between), so the
    rectified road normal is R0_rect times the transposed second row.
    """
    errors = []
    for record in records:
        c = calibration(data / "kitti_road" / "calib" / f"{record['name']}.txt")
        T, P2, P3 = (c[key].reshape(3, 4) for key in ("Tr_cam_to_road", "P2", "P3"))
        down = c["R0_rect"].reshape(3, 3) @ T[1, :3]
        middle = np.array([-(P2[0, 3] + P3[0, 3]) / 2 / P2[0, 0], 0, 0])
        height_m, pitch_rad = -(down @ middle + T[1, 3]), np.arctan2(down[2], down[1])
        g = record["ground"]
        errors.append((g["height_m"] - height_m, np.degrees(g["pitch_rad"] - pitch_rad)))
    height, pitch = np.median(np.abs(errors), axis=0)
    return [
        ["kitti_road", "ground height, median of |error|", f"{height:.4f} m", "<= .03 m"],
        ["kitti_road", "ground pitch, median of |error|", f"{pitch:.3f} deg", "<= .3 deg"],
    ]


def judge_velodyne(data: Path, records: list[dict]) -> list[list[str]]:
    """Compare the first obstacle per image column with the Velodyne scans.

    Truth: the nearest range up to 40 m at which 3 points stand 0.3 to 2.5 m above the scan's own road plane within
    0.5 m or 5 % of each other, in a window of 9 columns.
    """
    folder = data / "kitti_raw_0926"
    r = plan_rectification(open_source(folder).rig)
    T = calibration(folder / "calib_velo_to_cam_2011_09_26.txt")
    by_name = {record["name"]: record for record in records}
    errors = []
    for scan in sorted((folder / "velodyne_points" / "data").iterdir()):
        points = np.fromfile(scan, np.float32).reshape(-1, 4)[:, :3] @ T["R"].reshape(3, 3).T + T["T"]
        points = points @ r.R_rect_left.T
        points = points[points[:, 2] > 1]
        u, v = (r.f_px * points[:, i] / points[:, 2] + c for i, c in ((0, r.cx_px), (1, r.cy_px)))
        height = height_over_road(points)
        standing = (height > 0.3) & (height < 2.5) & (v >= 0) & (v < r.size_px[1])
        free = by_name[scan.stem]["free_space"]
        for u_px, range_m in zip(free["u_px"], free["range_m"], strict=True):
            z = np.sort(points[standing & (np.abs(u - u_px) <= 4.5), 2])
            close = z[2:] - z[:-2] <= np.maximum(0.5, 0.05 * z[:-2]) if len(z) > 2 else np.zeros(0, bool)
            if close.any() and z[close.argmax()] < 40:
                errors.append(np.nan if range_m is None else range_m / z[close.argmax()] - 1)
    observed = np.isfinite(errors)
    e = np.array(errors)[observed]
    return [
        ["kitti_raw_0926", "first obstacle, median of |relative error|", f"{np.median(np.abs(e)):.4f}", "<= .03"],
        ["kitti_raw_0926", "its median (signed)", f"{np.median(e):+.4f}", ""],
        ["kitti_raw_0926", "columns judged, and share observed", f"{len(errors)}, {observed.mean():.3f}", ""],
    ]


def height_over_road(points: Floats) -> Floats:
    """Return heights of points (n, 3; x right, y down, z forward) over the plane most of the near low ones share."""
    x, y, z = points.T
    near = (z > 3) & (z < 25) & (np.abs(x) < 8) & (y > 0.8) & (y < 2.6)
    A = np.stack([np.ones_like(z), z, x], -1)
    draws = np.random.default_rng(0).choice(np.flatnonzero(near), (500, 3))
    draws = draws[np.abs(np.linalg.det(A[draws])) > 1e-3]
    planes = np.linalg.solve(A[draws], y[draws][..., None])[..., 0]
    planes = planes[(np.abs(planes[:, 1:]) < 0.08).all(1)]
    best = planes[np.argmax((np.abs(y[near] - planes @ A[near].T) < 0.05).sum(1))]
    for _ in range(3):
        on = near & (np.abs(y - A @ best) < 0.08)
        best = np.linalg.lstsq(A[on], y[on], rcond=None)[0]
    return A @ best - y


def main() -> None:
    """Run all, print, save."""
    given = [a for a in sys.argv[1:2] if not a.startswith("--")]
    options = sys.argv[1 + len(given) :]
    data = Path(given[0] if given else os.environ.get("ROADBLOCK_DATA", "../shared/data")).resolve()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, judge in (("kitti_road", judge_road), ("kitti_raw_0926", judge_velodyne)):
            rows += judge(data, detect(data / name, Path(folder) / name, options))
        for detector in reversed(DETECTORS):
            out = Path(folder) / detector
            detect(data / "kitti2015", out, ["--detector", detector, *options])
            rows = score_2015(data, out, detector) + rows
    for row in rows:
        print(*(f"{cell:45}" for cell in row))
    if not options:
        save(
            "real_recordings",
            "python benchmarks/accuracy/real.py",
            ["recording", "figure", "measured", "bar"],
            rows,
            "Default settings; `cells` where no detector is named.",
        )


if __name__ == "__main__":
    main()
