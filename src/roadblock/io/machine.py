"""What made a result: the machine, its libraries, and the commit of this package."""

import json
import os
import platform
import shutil
import subprocess
from contextlib import suppress
from importlib.metadata import distribution, version
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import roadblock


def machine_record() -> dict[str, Any]:
    """Return what a run's speed depends on: platform, processor, and the libraries that do the work."""
    return {
        "platform": platform.platform(),
        "python": platform.python_version(),
        "cpu": _cpu_name(Path("/proc/cpuinfo")),
        "cores": os.cpu_count(),
        "opencv": cv2.__version__,
        "numpy": np.__version__,
        "numba": version("numba"),
    }


def _cpu_name(cpuinfo: Path) -> str:
    """Return the processor's name as Linux tells it, elsewhere as Python does."""
    with suppress(OSError):
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def package_commit(package: Path = Path(roadblock.__file__).parent) -> str | None:
    """Return the git commit the package runs from, `-dirty` added where files were changed since; None if unknown.

    That is the checkout's where the package lies in its own, else what the installer noted.
    """
    if _git(package, "rev-parse", "--show-prefix") == "src/roadblock/":
        return _git(package, "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*")
    note = distribution("roadblock").read_text("direct_url.json")
    commit = json.loads(note).get("vcs_info", {}).get("commit_id") if note else None
    return str(commit) if commit else None


def _git(folder: Path, *arguments: str) -> str | None:
    """Return what git answers about `folder`; None where there is no git, no checkout, or no answer in time."""
    git = shutil.which("git")
    if git is None:
        return None
    try:
        answer = subprocess.run(  # noqa: S603
            [git, "-C", str(folder), *arguments], capture_output=True, text=True, timeout=5, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return answer.stdout.strip()
