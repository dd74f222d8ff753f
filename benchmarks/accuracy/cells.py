"""Judge cell disparities on KITTI 2015: `python benchmarks/accuracy/cells.py [DATA] [--set key=value ...] [--save]`.

DATA (default: $ROADBLOCK_DATA or ../shared/data) holds kitti2015. A cell's truth is the median of the laser's
disparities in it, where there are at least two and they differ by at most 1 px. OpenCV's SGBM (HH4) is judged on the
same cells by its median in each. Settings were chosen on the even frames; the odd ones confirm them.
"""

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))
from record import save

from roadblock.stages.match import MatchSettings
from roadblock.stages.match.cells import CellMatcher, CellSettings
from roadblock.stages.match.opencv import in_pixels, match_sgbm

Floats = NDArray[np.float32]
Gray = NDArray[np.uint8]
LARGEST_SPREAD_PX = 1.0


def read_frames(folder: Path) -> Iterator[tuple[Gray, Gray, Floats]]:
    """Yield left and right image, and the truth in pixels (NaN unknown), of each frame."""
    for path in sorted((folder / "disp_occ_0").glob("*.png")):
        left, right = (
            cv2.imread(str(next((folder / view).glob(path.stem + "*"))), cv2.IMREAD_GRAYSCALE)
            for view in ("image_02", "image_03")
        )
        truth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED).astype(np.float32) / 256
        yield left, right, np.where(truth > 0, truth, np.float32(np.nan))


def in_cells(d_px: Floats, width: int, height: int = 4) -> Floats:
    """Return (rows, columns, width * height) pixels of each cell."""
    rows, columns = d_px.shape[0] // 2 // (height // 2), d_px.shape[1] // 2 // (width // 2)
    cut = d_px[: rows * height, : columns * width]
    return cut.reshape(rows, height, columns, width).swapaxes(1, 2).reshape(rows, columns, width * height)


def middle(pixels: Floats, fewest: int, spread: float = np.inf) -> Floats:
    """Return each cell's median; NaN with fewer known pixels, or a larger spread."""
    known = np.isfinite(pixels)
    lows, highs = np.where(known, pixels, np.inf).min(-1), np.where(known, pixels, -np.inf).max(-1)
    fine = (known.sum(-1) >= fewest) & (highs - lows <= spread)
    result = np.full(pixels.shape[:2], np.nan, np.float32)
    result[fine] = np.nanmedian(pixels[fine], axis=-1)
    return result


def halve(image: Gray) -> Gray:
    """Return the mean of each 2 x 2 pixels."""
    rows, columns = (n // 2 for n in image.shape)
    return cv2.resize(image[: 2 * rows, : 2 * columns], (columns, rows), interpolation=cv2.INTER_AREA)


def judge(errors: list[Floats]) -> list[str]:
    """Return density, shares off by more than 3 and 1 px, median and median deviation, over all cells with truth."""
    both = np.concatenate(errors)
    e = both[np.isfinite(both)]
    shift = float(np.median(e))
    figures = (len(e) / len(both), (abs(e) > 3).mean(), (abs(e - shift) > 1).mean())
    return [f"{f:.4f}" for f in figures] + [f"{shift:+.3f}", f"{np.median(abs(e - shift)):.3f}"]


def measure(folder: Path, options: dict[str, str]) -> list[list[str]]:
    """Return rows of (cell, frames, what, figures ...)."""
    hh4, rows = in_pixels(match_sgbm), []
    frames = list(read_frames(folder))
    dense = [hh4(left, right, MatchSettings()) for left, right, _ in frames] if "--alone" not in sys.argv else []
    for width in (8, 4):
        matcher = CellMatcher(CellSettings.model_validate({"cell_width_px": width, **options}))
        ours, theirs = [], []
        for i, (left, right, truth) in enumerate(frames):
            true = middle(in_cells(truth, width), 2, LARGEST_SPREAD_PX)
            judged = np.isfinite(true)
            d_px = matcher(halve(left), halve(right)).d_px
            ours.append((d_px - true)[judged])
            if dense:
                theirs.append((middle(in_cells(dense[i], width), width * 2) - true)[judged])
        for half, name in enumerate(("even", "odd")):
            for what, errors in (("cells", ours), ("SGBM HH4", theirs)):
                if errors:
                    rows.append([f"{width}x4", name, what, *judge(errors[half::2])])
    return rows


def main() -> None:
    """Measure, print, and save with --save."""
    arguments = sys.argv[1:]
    options = dict(a.split("=", 1) for a in arguments if "=" in a)
    folders = [a for a in arguments if "=" not in a and not a.startswith("--")]
    data = Path(folders[0] if folders else os.environ.get("ROADBLOCK_DATA", "../shared/data"))
    columns = [
        "cell",
        "frames",
        "what",
        "density",
        "off by > 3 px",
        "off by > 1 px",
        "median px",
        "median deviation px",
    ]
    rows = measure(data / "kitti2015", options)
    for row in rows:
        print(*(f"{cell:10}" for cell in row))
    if "--save" in arguments:
        notes = "The truth has an offset: `off by > 1 px` and the deviation are about the median difference."
        save("cells_kitti2015", "python benchmarks/accuracy/cells.py --save", columns, rows, notes)


if __name__ == "__main__":
    main()
