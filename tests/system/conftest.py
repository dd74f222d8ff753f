"""What the tests of the command line share: a small synthetic recording, and a way to run commands."""

import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from synthetic import record_boards, record_street

from roadblock.cli import main


class Ran(NamedTuple):
    """What a command left: its exit code and all that it, and the libraries under it, printed."""

    code: int
    out: str
    err: str


Run = Callable[..., Ran]


@pytest.fixture
def roadblock(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command line in this process."""

    def run(*arguments: object) -> Ran:
        capfd.readouterr()
        monkeypatch.setattr(sys, "argv", ["roadblock", *map(str, arguments)])
        with pytest.raises(SystemExit) as left:
            main()
        return Ran(int(left.value.code or 0), *capfd.readouterr())

    return run


@pytest.fixture(scope="session")
def street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two single frames of 480x270; read only."""
    return record_street(tmp_path_factory.mktemp("street") / "recording", 480, 2)


@pytest.fixture(scope="session")
def small_street(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three single frames of 160x90; read only."""
    return record_street(tmp_path_factory.mktemp("small") / "recording", 160, 3)


@pytest.fixture(scope="session")
def boards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Fourteen pictures of a 7x5 chessboard from each camera, 320x240, in `left` and `right`; read only."""
    return record_boards(tmp_path_factory.mktemp("boards"), 14, 5)


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to work in; paths in messages are relative to it."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def recording(work: Path, street: Path) -> Path:
    """`recording` in the working folder, to be changed at will."""
    return Path(shutil.copytree(street, work / "recording")).relative_to(work)


@pytest.fixture
def sequence(recording: Path) -> Path:
    """The same as a sequence of four frames, 0.1 s apart."""
    for side in ("left", "right"):
        for index in (2, 3):
            shutil.copy(recording / side / f"{index - 2:06d}.png", recording / side / f"{index:06d}.png")
    (recording / "timestamps.txt").write_text("0.0\n0.1\n0.2\n0.3\n")
    return recording
