from pathlib import Path

import pytest

from roadblock.errors import SourceError
from roadblock.io.sources.pairing import list_images, natural_key, pair_folders


def sides(tmp_path: Path, lefts: list[str], rights: list[str]) -> tuple[Path, Path]:
    for side, names in (("left", lefts), ("right", rights)):
        (tmp_path / side).mkdir()
        for name in names:
            (tmp_path / side / name).touch()
    return tmp_path / "left", tmp_path / "right"


def test_natural_order() -> None:
    assert sorted(["f10", "f2", "f1b", "f1", "f1a", "10", "9"], key=natural_key) == (
        ["9", "10", "f1", "f1a", "f1b", "f2", "f10"]
    )


def test_by_name_in_natural_order_whatever_the_suffix(tmp_path: Path) -> None:
    frames = pair_folders(*sides(tmp_path, ["a10.png", "a9.PNG", ".hidden.png", "notes.txt"], ["a9.jpg", "a10.png"]))
    assert [(f.left.name, f.right.name, f.name) for f in frames] == (
        [("a9.PNG", "a9.jpg", "a9"), ("a10.png", "a10.png", "a10")]
    )


def test_by_last_number_where_no_name_is_shared(tmp_path: Path) -> None:
    frames = pair_folders(*sides(tmp_path, ["cam0_2.png", "cam0_10.png"], ["cam1_010.png", "cam1_02.png"]))
    assert [(f.left.name, f.right.name) for f in frames] == (
        [("cam0_2.png", "cam1_02.png"), ("cam0_10.png", "cam1_010.png")]
    )


@pytest.mark.parametrize(
    ("lefts", "rights", "words"),
    [
        (["1.png", "2.png"], ["1.png"], r"2\.png has no partner: left holds 2 images, right 1, paired by name"),
        (["1.png"], ["1.png", "3.png"], r"right.3\.png has no partner"),
        (["1.png", "2.png"], ["2.png", "3.png"], r"left.1\.png has no partner.*2 stay alone"),
        (["l1.png", "l2.png"], ["r1.png"], "paired by number"),
        (["a.png"], ["b.png"], "has no partner"),
        (["1.png", "1.jpg"], ["1.png"], "claim the same frame"),
        (["l1.png", "l01.png"], ["r1.png", "r2.png"], "claim the same frame"),
        ([], ["1.png"], "left holds no images"),
        (["1.png"], ["1.txt"], "right holds no images"),
    ],
)
def test_what_cannot_be_paired(tmp_path: Path, lefts: list[str], rights: list[str], words: str) -> None:
    with pytest.raises(SourceError, match=words):
        pair_folders(*sides(tmp_path, lefts, rights))


def test_folders_named_like_images_are_no_images(tmp_path: Path) -> None:
    (tmp_path / "a.png").mkdir()
    with pytest.raises(SourceError, match="holds no images"):
        list_images(tmp_path)
