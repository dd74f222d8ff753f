"""Measure regions of Middlebury pairs: `python benchmarks/accuracy/middlebury.py [DATA]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds `middlebury/`. Every square of 32x32 px whose true disparity is
known, of one surface (it spans no more than 4 px) and that has texture (a root mean square slope of 4 grey levels) is a
region. It is measured by `stages.refine` from SGBM's disparities on cells of 4 px, and by SGBM's mean over the square;
where refinement keeps the detector's value, SGBM's mean stands for it. AdirondackE is the same with the right image
exposed otherwise.
"""

import os
import sys
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.stages.match import MatchSettings, match
from roadblock.stages.refine import RefineSettings, refine
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Region

PAIRS = {"Adirondack": ("Adirondack", 0.5), "AdirondackE": ("Adirondack", 0.5), "cones": ("cones", 0.0)}
"""Whose truth, and what is added to it: both truths are whole pixels, Adirondack's rounded down and cones' to the
nearest (every matcher lies +0.5 px off the one, and within 0.03 px of the other)."""
SIDE, CELL, SPAN_PX, SLOPE = 32, 4, 4.0, 4.0


def read(path: Path, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[np.float32]:
    """Return an image; an error where there is none."""
    image = cv2.imread(str(path), flags)
    if image is None:
        raise SystemExit(f"{path}: no image")
    return image


def squares(gray: NDArray[np.uint8], true: NDArray[np.float32]) -> list[tuple[int, int]]:
    """Return the corners (row, column) of the regions."""
    slope = np.gradient(gray.astype(float), axis=1) ** 2
    found = []
    for row in range(0, gray.shape[0] - SIDE + 1, SIDE):
        for column in range(0, gray.shape[1] - SIDE + 1, SIDE):
            here = np.s_[row : row + SIDE, column : column + SIDE]
            d = true[here]
            if np.isfinite(d).all() and np.ptp(d) <= SPAN_PX and np.sqrt(slope[here].mean()) >= SLOPE:
                found.append((row, column))
    return found


def measure(name: str, folder: Path) -> tuple[list[float], list[float], list[float], int]:
    """Return the errors of SGBM's means and of the refined ones, px, their normalised errors, and how many counted."""
    scene, more_px = PAIRS[name]
    left = read(folder / f"{scene}_left.png", cv2.IMREAD_GRAYSCALE)
    right = read(folder / f"{name}_right.png", cv2.IMREAD_GRAYSCALE)
    true, seen = read(folder / f"{scene}_gt.png").astype(np.float32), read(folder / f"{scene}_mask.png")
    true[(seen.reshape(*true.shape[:2], -1)[..., 0] != 255) | (true <= 0)] = np.nan
    true += more_px
    height, width = left.shape
    pair = RectifiedPair(left, right, Rectification(float(width), width / 2, height / 2, 0.2, (width, height)))
    sgbm = match(pair, MatchSettings()).d_px
    by_sgbm, by_refining, normalized, counted = [], [], [], 0
    for row, column in squares(left, true):
        here = np.s_[row : row + SIDE, column : column + SIDE]
        truth = 1 / np.mean(1 / true[here])
        if not np.isfinite(sgbm[here]).mean() > 0.5:
            continue
        mean = float(np.nanmean(sgbm[here]))
        cells = np.nanmedian(sgbm[here].reshape(SIDE // CELL, CELL, SIDE // CELL, CELL), axis=(1, 3))
        cells = np.where(np.isfinite(cells), cells, mean)
        v, u = np.mgrid[row : row + SIDE : CELL, column : column + SIDE : CELL] + (CELL - 1) / 2
        surface = np.stack([u, v, cells], -1).reshape(-1, 3).astype(float)
        box = (column, row, column + SIDE, row + SIDE)
        region = Region(box, np.zeros((0, 2), np.int32), surface, 0.5, np.full(3, np.nan))
        fit = refine(pair, [region], RefineSettings(level="fast"))[0].refined
        by_sgbm.append(mean - truth)
        by_refining.append((mean if fit is None else fit.mean_d_px) - truth)
        if fit is not None:
            counted += 1
            normalized.append((fit.mean_d_px - truth) / fit.sigma_mean_d_px)
    return by_sgbm, by_refining, normalized, counted


def main() -> None:
    """Measure, print, save."""
    data = Path(sys.argv[1] if len(sys.argv) > 1 else os.environ.get("ROADBLOCK_DATA", "../shared/data"))
    rows = []
    for name in PAIRS:
        by_sgbm, by_refining, normalized, counted = measure(name, data / "middlebury")
        medians = [float(np.median(np.abs(errors))) for errors in (by_sgbm, by_refining)]
        inside = [float((np.abs(normalized) <= k).mean()) for k in (1, 2)]
        rows.append(
            [name, len(by_sgbm), counted, *(f"{m:.4f}" for m in medians), f"{medians[1] / medians[0]:.2f}"]
            + [f"{float(np.median(e)):+.4f}" for e in (by_sgbm, by_refining)]
            + [f"{share:.2f}" for share in inside]
        )
        print(rows[-1])
    save(
        "middlebury",
        "python benchmarks/accuracy/middlebury.py DATA",
        ["pair", "regions", "refined", "SGBM median |error| px", "refined", "ratio", "SGBM bias", "refined bias",
         "within 1 sigma", "2 sigma"],
        rows,
        "Mean disparity of textured squares of 32x32 px. Bar: a ratio of a third; the truth is in whole pixels, whose "
        "rounding alone is worth some 0.05 px in such a mean.",
    )  # fmt: skip


if __name__ == "__main__":
    main()
