"""`roadblock doctor`: whether this installation, and a rig file, are sound."""

import importlib.metadata
import importlib.util
import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Annotated

import cv2
import numba
import numpy as np
import typer

import roadblock
from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import progress_bar, show_table
from roadblock.config import load_settings
from roadblock.errors import RoadblockError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.io.machine import package_commit
from roadblock.io.rig import describe_rig
from roadblock.pipeline import Pipeline
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.frame import StereoPair

THREADING = {
    "tbb": "numba.np.ufunc.tbbpool",
    "omp": "numba.np.ufunc.omppool",
    "workqueue": "numba.np.ufunc.workqueue",
}
"""Threading layers and the modules that carry them."""
WARMED = ("cells", "fast")
"""Detectors whose kernels are compiled ahead."""
DISPARITIES = (64, 128, 256)
EXTRAS = ("refine.level=fast", "low.enabled=true")
"""What is off by default and has kernels."""
Row = tuple[str, str, str]
"""(ok, missing or FAIL; what; finding)."""


def doctor(
    rig: Annotated[Path | None, typer.Option(help="Rig file to look at as well.")] = None,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
    warm: Annotated[
        bool, typer.Option("--warm", help="Compile all kernels ahead; takes a minute or two once.")
    ] = False,
) -> None:
    """Check the installation, and a rig file if one is given; exit code 2 if something is broken."""
    rows = [*_installation(), *_opencv(), *_numba(), *_extras()]
    if warm:
        rows += _warm()
    if rig is not None:
        rows += _rig(rig, unit, size, rig_format)
    show_table("roadblock doctor", ("", "what", "finding"), rows)
    if any(state == "FAIL" for state, _, _ in rows):
        raise typer.Exit(2)


def _installation() -> Iterator[Row]:
    enough = sys.version_info >= (3, 11)
    yield "ok" if enough else "FAIL", "Python", f"{platform.python_version()} on {platform.platform(terse=True)}"
    yield "ok", "roadblock", f"{roadblock.__version__}, commit {package_commit() or 'unknown'}"


def _opencv() -> Iterator[Row]:
    yield "ok", "OpenCV", f"{cv2.__version__}, {cv2.getNumThreads()} threads"
    wheels = sorted(set(importlib.metadata.packages_distributions().get("cv2", [])))
    if len(wheels) > 1:
        remove = " ".join(name for name in wheels if name != "opencv-contrib-python-headless")
        yield (
            "FAIL",
            "OpenCV packages",
            f"{len(wheels)} in one environment overwrite each other: pip uninstall -y {remove}; "
            "pip install --force-reinstall opencv-contrib-python-headless",
        )
    else:
        yield "ok", "OpenCV packages", ", ".join(wheels) or "installed without package record"


def _numba() -> Iterator[Row]:
    folder = Path(os.environ.get("NUMBA_CACHE_DIR") or Path(roadblock.__file__).parent)
    layers = [name for name, module in THREADING.items() if importlib.util.find_spec(module)]
    chosen = os.environ.get("NUMBA_THREADING_LAYER", "default")
    yield "ok", "numba", f"{numba.__version__}, {numba.get_num_threads()} threads"
    yield "ok", "numba threading", f"{chosen}; this installation has {', '.join(layers)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)  # as numba would
        with tempfile.TemporaryFile(dir=folder):
            yield "ok", "numba cache", f"kept in {folder}"
    except OSError:
        yield (
            "missing",
            "numba cache",
            f"{folder} cannot be written: set NUMBA_CACHE_DIR to a folder of yours, or numba falls back to one of its "
            "own or compiles anew at each start",
        )


def _warm() -> Iterator[Row]:
    """Step with every detector and search range that has kernels of its own; numba keeps what it compiled."""
    start = perf_counter()
    chosen = [(name, disparities) for name in WARMED for disparities in DISPARITIES]
    rig, pairs = _small_street()
    with progress_bar() as bar:
        for name, disparities in bar.track(chosen, description="compiling"):
            options = [f"detector={name}", f"cells.disparities={disparities}", *EXTRAS]
            pipeline = Pipeline(rig, load_settings(None, options))
            for i, pair in enumerate(pairs, 1):
                pipeline.step(replace(pair, t_ns=i * 100_000_000))  # as a drive, so that it is tracked
    yield "ok", "kernels", f"compiled, or found compiled, in {perf_counter() - start:.1f} s"


def _small_street() -> tuple[StereoRig, list[StereoPair]]:
    """Return a rig, and a grey, a coloured and a 16-bit pair of noise that is shifted like a road with a wall on it."""
    height, width = 120, 320
    camera = Camera((width, height), 200.0, 200.0, 160.0, 40.0)
    turned = rotation_from_rotvec([0.0, 1e-6, 0.0])  # so that rectification has something to do
    noise = np.random.default_rng(0).integers(0, 256, (height, width), np.uint8)
    noise = cv2.GaussianBlur(noise, (0, 0), 1.5)
    shifts = np.maximum(np.arange(height) - 40, 0) * 0.3  # of a road 1.4 m below cameras 0.4 m apart
    d_px = np.repeat(shifts[:, None], width, 1)
    d_px[30:90, 120:220] = shifts[90]
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    left = cv2.remap(noise, u - d_px.astype(np.float32), v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    pairs = [StereoPair(left, noise)]
    left, right = (cv2.cvtColor(image, cv2.COLOR_GRAY2RGB) for image in (left, noise))
    pairs += [StereoPair(left, right), StereoPair(left.astype(np.uint16) * 257, right.astype(np.uint16) * 257)]
    return StereoRig(camera, camera, pose(turned, [0.42, 0.0, 0.0])), pairs


def _extras() -> Iterator[Row]:
    package = importlib.metadata.metadata("roadblock")
    requires = package.get_all("Requires-Dist") or []
    for extra in package.get_all("Provides-Extra") or []:
        marker = re.compile(rf"""extra\s*==\s*['"]{re.escape(extra)}['"]""")
        wanted = [re.split(r"[\s<>=!~;\[(]", text)[0] for text in requires if marker.search(text)]
        absent = [name for name in wanted if not _is_installed(name)]
        if absent:
            yield "missing", f"extra {extra}", f"{', '.join(absent)}; install with: pip install 'roadblock[{extra}]'"
        else:
            yield "ok", f"extra {extra}", ", ".join(wanted)


def _is_installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _rig(file: Path, unit: str, size: str | None, rig_format: str | None) -> Iterator[Row]:
    try:
        rows = describe_rig(open_rig(file, rig_format, unit, size))
    except RoadblockError as error:
        yield "FAIL", "rig", str(error)
        return
    yield "ok", "rig", f"{file} is sound"
    yield from (("ok", f"  {what}", value) for what, value in rows)
