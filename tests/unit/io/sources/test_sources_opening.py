import os
from pathlib import Path

import pytest

from roadblock.errors import SourceError
from roadblock.io.sources import SOURCES, opening
from roadblock.io.sources.opening import open_source


def refusal(spec: str | Path, kind: str | None = None) -> str:
    with pytest.raises(SourceError) as caught:
        open_source(spec, kind=kind)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_names_are_unique_and_say_what_they_are() -> None:
    names = [name for name, _, _ in SOURCES]
    assert len(set(names)) == len(names)
    assert "kitti-raw-gray" in names


def test_nothing_there(tmp_path: Path) -> None:
    assert "there is no" in refusal(tmp_path / "missing")
    assert "there is no" in refusal("left.mov.txt")


def test_unknown_kind(folder: Path) -> None:
    assert "did you mean kitti-raw-gray?" in refusal(folder, "kitti-raw-grey")
    assert "choose one of these (folder, list" in refusal(folder, "x")


def test_another_kind_than_it_is(folder: Path) -> None:
    assert "holds left, rig.yaml, right, which is not a kitti-raw-gray recording" in refusal(folder, "kitti-raw-gray")


def test_no_kind_of_recording(tmp_path: Path) -> None:
    assert "holds nothing, which is not any kind of recording" in refusal(tmp_path)
    (tmp_path / "a.xyz").touch()
    assert "is a .xyz file" in refusal(tmp_path / "a.xyz")
    (tmp_path / "noname").touch()
    assert "is a nameless file" in refusal(tmp_path / "noname")


def test_ambiguity_names_the_choices_and_kind_chooses(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = ("twin", SOURCES[0][1], SOURCES[0][2])
    monkeypatch.setattr(opening, "SOURCES", (*SOURCES, twin))
    assert "can be opened as folder, twin: choose with --kind NAME" in refusal(folder)
    assert open_source(folder, kind="twin").length == 3


def test_loops_and_long_names(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    refusal(tmp_path / "loop")
    (tmp_path / "left").symlink_to(tmp_path)
    (tmp_path / "right").symlink_to(tmp_path)
    assert "holds no images" in refusal(tmp_path)
    assert "cannot be read: File name too long" in refusal("x" * 5000)
    assert "there is no" in refusal("a\0b")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_folder_without_permission(folder: Path) -> None:
    (folder / "left").chmod(0)
    try:
        assert "Permission denied" in refusal(folder)
    finally:
        (folder / "left").chmod(0o755)


def test_errors_of_the_disk_are_ours(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: Path) -> bool:
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(opening, "SOURCES", (("folder", fail, SOURCES[0][2]),))
    assert f"{folder} cannot be read: Input/output error" in refusal(folder)
