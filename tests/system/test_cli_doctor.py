"""`roadblock doctor`: what is broken, and how to mend it."""

import importlib.metadata
import os
import platform
import sys
from email.message import Message
from pathlib import Path

import cv2
import numba
import pytest

import roadblock as package
from roadblock.config import load_settings
from roadblock.io.sources import open_source
from roadblock.pipeline import Pipeline


def findings(printed: str) -> str:
    """The table as one text, whatever the width it was wrapped to."""
    return " ".join(printed.split())


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("roadblock.cli.terminal.out._width", 400)


def test_a_sound_installation(roadblock) -> None:
    ran = roadblock("doctor")
    assert (ran.code, ran.err) == (0, "")
    for found in (platform.python_version(), package.__version__, cv2.__version__):
        assert found in ran.out
    assert "FAIL" not in ran.out


def test_a_sound_rig(roadblock, street: Path) -> None:
    ran = roadblock("doctor", "--rig", street / "rig.yaml")
    assert ran.code == 0
    assert "rig.yaml is sound" in findings(ran.out)
    assert "480 x 270 px" in ran.out


@pytest.mark.parametrize("options", [["--size", "640x480"], ["--format", "zed"], ["--unit", "mm"]])
def test_a_rig_that_cannot_be_trusted(roadblock, street: Path, options: list[str]) -> None:
    ran = roadblock("doctor", "--rig", street / "rig.yaml", *options)
    assert ran.code == 2
    row = next(line for line in ran.out.splitlines() if "FAIL" in line)
    assert "rig.yaml: " in row
    assert "Traceback" not in ran.out + ran.err


def test_two_opencv_packages(roadblock, monkeypatch) -> None:
    wheels = ["opencv-python", "opencv-contrib-python-headless", "opencv-python"]
    monkeypatch.setattr(importlib.metadata, "packages_distributions", lambda: {"cv2": wheels})
    ran = roadblock("doctor")
    assert ran.code == 2
    assert "2 in one environment overwrite each other: pip uninstall -y opencv-python; pip install" in findings(ran.out)


def test_opencv_without_package_record(roadblock, monkeypatch) -> None:
    monkeypatch.setattr(importlib.metadata, "packages_distributions", dict)
    ran = roadblock("doctor")
    assert ran.code == 0
    assert "installed without package record" in ran.out


def test_an_old_python(roadblock, monkeypatch) -> None:
    monkeypatch.setattr(sys, "version_info", (3, 10, 9, "final", 0))
    ran = roadblock("doctor")
    assert ran.code == 2
    assert next(line for line in ran.out.splitlines() if "FAIL" in line).split()[1] == "Python"


def test_a_cache_that_cannot_be_written(roadblock, monkeypatch, work: Path) -> None:
    (work / "file").write_text("")
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(work / "file" / "cache"))
    ran = roadblock("doctor")
    assert ran.code == 0
    assert "cannot be written: set NUMBA_CACHE_DIR to a folder of yours" in findings(ran.out)


def test_a_cache_of_ones_own(roadblock, monkeypatch, work: Path) -> None:
    """Numba makes the folder when it needs it."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(work / "new" / "cache"))
    ran = roadblock("doctor")
    assert f"kept in {work / 'new' / 'cache'}" in ran.out
    cache = next(line for line in ran.out.splitlines() if "numba cache" in line)
    assert cache.split()[0] == "ok"


def test_a_missing_extra(roadblock, monkeypatch) -> None:
    """Told by the package's own record, so that a new extra needs no new code here."""
    record = Message()
    for name, value in (
        ("Requires-Dist", "numpy>=1.26"),
        ("Requires-Dist", "numpy<3 ; extra == 'fast'"),
        ("Requires-Dist", 'nowhere-to-be-found>=2; extra == "night"'),
        ("Requires-Dist", 'also.missing[x] ; (python_version > "3") and extra == "night"'),
        ("Provides-Extra", "fast"),
        ("Provides-Extra", "night"),
    ):
        record[name] = value
    monkeypatch.setattr(importlib.metadata, "metadata", lambda _: record)
    ran = roadblock("doctor")
    assert ran.code == 0
    assert "extra fast numpy" in findings(ran.out)
    expected = "missing extra night nowhere-to-be-found, also.missing; install with: pip install 'roadblock[night]'"
    assert expected in findings(ran.out)


def test_a_package_without_extras(roadblock, monkeypatch) -> None:
    monkeypatch.setattr(importlib.metadata, "metadata", lambda _: Message())
    ran = roadblock("doctor")
    assert ran.code == 0
    assert "extra" not in ran.out


def test_the_threading_layer_that_is_chosen(roadblock, monkeypatch) -> None:
    monkeypatch.setitem(os.environ, "NUMBA_THREADING_LAYER", "workqueue")
    assert "workqueue" in roadblock("doctor").out


def signatures() -> int:
    """How many versions of kernels are compiled or loaded in this process."""
    modules = [module for name, module in sys.modules.items() if name.startswith("roadblock.kernels")]
    kernels = {
        value
        for module in modules
        for value in vars(module).values()
        if isinstance(value, numba.core.dispatcher.Dispatcher)
    }
    return sum(len(kernel.signatures) for kernel in kernels)


def test_warm_kernels_leave_nothing_to_compile(roadblock, monkeypatch, street: Path) -> None:
    monkeypatch.setattr(sys.modules["roadblock.cli.doctor"], "DISPARITIES", (128,))
    ran = roadblock("doctor", "--warm")
    assert ran.code == 0
    assert "kernels compiled, or found compiled, in" in findings(ran.out)
    warm = signatures()
    assert warm > 20
    recording, options = open_source(street), ("refine.level=fast", "low.enabled=true")
    for detector in ("cells", "fast"):
        pipeline = Pipeline(recording.rig, load_settings(None, [f"detector={detector}", *options]))
        for pair in recording:
            result, _ = pipeline.step(pair)
            assert result.obstacles
    assert signatures() == warm
