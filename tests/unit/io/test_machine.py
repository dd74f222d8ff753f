import json
import platform
import shutil
import subprocess
from pathlib import Path

import pytest

from roadblock.io import machine
from roadblock.io.machine import _cpu_name, package_commit

needs_git = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")


def make_checkout(root: Path, package: str) -> Path:
    """Return the folder `package` of a fresh repository with one commit."""
    folder = root / package
    folder.mkdir(parents=True)
    (folder / "a.py").write_text("")
    identity = ["-c", "user.name=a", "-c", "user.email=a@b"]
    for arguments in (["init", "-q"], ["add", "."], [*identity, "commit", "-q", "-m", "a", "--no-gpg-sign"]):
        subprocess.run(["git", "-C", str(root), *arguments], check=True)
    return folder


class Note:
    """Stands for the installed distribution and what its installer noted."""

    def __init__(self, text: str | None) -> None:
        self.text = text

    def read_text(self, name: str) -> str | None:
        assert name == "direct_url.json"
        return self.text


@needs_git
def test_commit_of_an_own_checkout(tmp_path):
    folder = make_checkout(tmp_path, "src/roadblock")
    head = subprocess.run(
        ["git", "-C", str(tmp_path), "rev-parse", "HEAD"], capture_output=True, text=True, check=True
    ).stdout.strip()
    assert package_commit(folder) == head
    (folder / "a.py").write_text("changed")
    assert package_commit(folder) == head + "-dirty"


@needs_git
def test_someone_elses_repository_around_the_package_is_not_ours(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "distribution", lambda name: Note(None))
    folder = make_checkout(tmp_path, "venv/lib/site-packages/roadblock")
    assert package_commit(folder) is None


@pytest.mark.parametrize(
    ("note", "commit"),
    [
        (None, None),
        (json.dumps({"url": "file:///x", "dir_info": {}}), None),
        (json.dumps({"url": "https://x", "vcs_info": {"vcs": "git", "commit_id": "abc123"}}), "abc123"),
    ],
)
def test_commit_an_installer_noted(tmp_path, monkeypatch, note, commit):
    monkeypatch.setattr(machine, "distribution", lambda name: Note(note))
    assert package_commit(tmp_path) == commit


def test_without_git_the_commit_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setattr(machine, "distribution", lambda name: Note(None))
    monkeypatch.setattr(machine.shutil, "which", lambda name: None)
    assert package_commit(tmp_path) is None


def test_cpu_name_as_linux_tells_it(tmp_path):
    cpuinfo = tmp_path / "cpuinfo"
    cpuinfo.write_text("processor\t: 0\nmodel name\t: A Fast One @ 3 GHz\n")
    assert _cpu_name(cpuinfo) == "A Fast One @ 3 GHz"
    cpuinfo.write_text("processor\t: 0\n")
    elsewhere = platform.processor() or platform.machine()
    assert _cpu_name(cpuinfo) == _cpu_name(tmp_path / "none") == elsewhere
