import re
import shutil
from pathlib import Path

import numpy as np
import pytest

from roadblock.errors import RigError, SourceError
from roadblock.io.sources import open_source
from roadblock.io.sources.folders import SIDES
from roadblock.values.camera import StereoRig


def same_rig(a: StereoRig, b: StereoRig) -> bool:
    cameras = zip((a.left, a.right), (b.left, b.right), strict=True)
    return np.array_equal(a.T_left_right, b.T_left_right) and all(
        np.array_equal(c.K, d.K) and c.size_px == d.size_px for c, d in cameras
    )


def test_folder_pair(folder: Path, images, rig: StereoRig) -> None:
    source = open_source(folder)
    assert (source.name, source.length, source.is_sequence) == ("drive é", 3, False)
    assert source.ground_truth is None
    assert source.rigs is None
    assert source.warnings == []
    assert same_rig(source.rig, rig)
    for _ in range(2):  # it can be read again
        pairs = list(source)
        assert [(p.index, p.name, p.t_ns) for p in pairs] == [(0, "000", 0), (1, "001", 0), (2, "002", 0)]
        for i, pair in enumerate(pairs):
            np.testing.assert_array_equal(pair.left, images[2 * i])
            np.testing.assert_array_equal(pair.right, images[2 * i + 1])


def test_gray(folder: Path) -> None:
    assert next(iter(open_source(str(folder), gray=True))).left.shape == (61, 97)


def test_time_stamps_make_a_sequence_and_truth_is_found(folder: Path) -> None:
    (folder / "timestamps.txt").write_text("0.1\n0.2\n0.4\n")
    (folder / "truth.jsonl").touch()
    source = open_source(folder)
    assert source.is_sequence
    assert source.ground_truth == folder / "truth.jsonl"
    assert [pair.t_ns for pair in source] == [100_000_000, 200_000_000, 400_000_000]


def test_stamps_by_number_where_counts_differ(folder: Path) -> None:
    (folder / "timestamps.txt").write_text("0.1\n0.2\n0.4\n0.5\n")
    for side in ("left", "right"):
        (folder / side / "001.png").rename(folder / side / "003.png")
    assert [pair.t_ns for pair in open_source(folder)] == [100_000_000, 400_000_000, 500_000_000]


@pytest.mark.parametrize("stamps", ["0.1\n0.2\n", "", "0.1\n" * 3])
def test_stamps_that_do_not_fit(folder: Path, stamps: str) -> None:
    (folder / "timestamps.txt").write_text(stamps)
    with pytest.raises(SourceError, match=r"timestamps\.txt"):
        open_source(folder)


def test_stamps_chosen_by_number_must_increase(folder: Path) -> None:
    (folder / "timestamps.txt").write_text("0.1\n0.2\n0.3\n0.4\n")
    for side in ("left", "right"):
        shutil.copy(folder / side / "001.png", folder / side / "1.png")
    (folder / "timestamps.txt").write_text("0.1\n0.2\n0.3\n0.4\n0.5\n")
    with pytest.raises(SourceError, match="lies 0 ns after"):
        open_source(folder)


@pytest.mark.parametrize("sides", SIDES)
def test_every_pair_of_names(folder: Path, sides: tuple[str, str]) -> None:
    for old, new in zip(("left", "right"), sides, strict=True):
        (folder / old).rename(folder / new)
    assert open_source(folder).length == 3


def test_a_given_rig_overrides(folder: Path, rig: StereoRig) -> None:
    (folder / "rig.yaml").write_text("broken: [")
    assert open_source(folder, rig=rig).rig is rig
    with pytest.raises(RigError, match=r"rig\.yaml"):
        open_source(folder)


def test_other_rig_files(folder: Path, rig: StereoRig, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    monkeypatch.setattr("roadblock.io.sources.rigs.read_rig", lambda *a, **k: asked.append((a, k)) or rig)
    (folder / "left.yaml").touch()
    open_source(folder)
    assert asked.pop() == ((folder / "rig.yaml",), {})
    (folder / "rig.yaml").unlink()
    open_source(folder)
    assert asked.pop() == ((folder / "left.yaml",), {"right": folder / "right.yaml", "size_px": (97, 61)})
    (folder / "left.yaml").rename(folder / "camchain-street.yaml")
    open_source(folder)
    assert asked.pop() == ((folder / "camchain-street.yaml",), {"right": None, "size_px": (97, 61)})
    (folder / "SN123.conf").touch()
    with pytest.raises(SourceError, match=r"several rig files \(SN123\.conf, camchain-street\.yaml\)"):
        open_source(folder)


def test_no_rig(folder: Path) -> None:
    (folder / "rig.yaml").unlink()
    with pytest.raises(SourceError, match=r"holds no rig file .*--rig FILE"):
        open_source(folder)


def test_two_pairs_of_folders(folder: Path) -> None:
    shutil.copytree(folder / "left", folder / "cam0")
    shutil.copytree(folder / "right", folder / "cam1")
    with pytest.raises(SourceError, match=r"left\+right or .* but holds 2 of them"):
        open_source(folder)


def test_wrong_images_are_named_when_met(folder: Path, images, put) -> None:
    cases = {
        "is 96x61, but its rig is for 97x61": images[0][:, 1:],
        "is 8 bit grey, but its partner .* is 8 bit colour": images[0][..., 0],
        "is 16 bit colour, but its partner": images[0].astype(np.uint16),
    }
    for words, image in cases.items():
        put(folder / "left" / "001.png", image)
        pairs = iter(open_source(folder))
        next(pairs)
        with pytest.raises(SourceError, match=re.escape(str(folder / "left" / "001.png")) + " " + words):
            next(pairs)
    put(folder / "left" / "001.png", images[0])
    put(folder / "right" / "001.png", images[0][1:])
    with pytest.raises(SourceError, match=r"right.001\.png is 97x60, but its rig is for 97x61"):
        list(open_source(folder))


@pytest.mark.parametrize(("suffix", "comma"), [(".txt", " "), (".csv", ","), (".tsv", "\t")])
def test_list(folder: Path, rig: StereoRig, images, suffix: str, comma: str) -> None:
    rows = ["# day one", "", *(comma.join((f"left/00{i}.png", f"right/00{i}.png")) for i in (2, 0))]
    (folder / f"pairs{suffix}").write_text("\n".join(rows))
    source = open_source(folder / f"pairs{suffix}")
    assert (source.name, source.length, source.is_sequence) == ("pairs", 2, False)
    assert same_rig(source.rig, rig)
    assert [pair.name for pair in source] == ["002", "000"]
    np.testing.assert_array_equal(next(iter(source)).left, images[4])


def test_list_with_header_and_stamps_is_a_sequence(folder: Path) -> None:
    text = "\ufeffleft,right,t_ns\nleft/000.png, right/000.png, 5\nleft/001.png, right/001.png, 100000005\n"
    (folder / "pairs.csv").write_text(text, encoding="utf-8")
    source = open_source(folder / "pairs.csv")
    assert source.is_sequence
    assert [pair.t_ns for pair in source] == [5, 100_000_005]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# nothing\n", "lists no pairs"),
        ("left/000.png\n", "line 1 has 1 columns"),
        ("a b c d\n", "line 1 has 4 columns"),
        ("left/000.png right/000.png\nleft/001.png right/001.png 5\n", "line 2 has 3 columns"),
        ("left/000.png right/007.png\n", r"line 1 names .*007\.png, which is missing"),
        ("left right/000.png\n", "line 1 names .*left, which is missing or no plain file"),
        ("left/000.png right/000.png 0.5\n", "line 1: t_ns is '0.5'"),
        ("left/000.png right/000.png -5\n", "line 1: t_ns"),
        (f"left/000.png right/000.png {'9' * 20}\n", "line 1: t_ns"),
        ("left/000.png right/000.png 5\nleft/001.png right/001.png 5\n", "lies 0 ns after"),
    ],
)
def test_bad_lists(folder: Path, text: str, words: str) -> None:
    (folder / "pairs.txt").write_text(text)
    with pytest.raises(SourceError, match=words):
        open_source(folder / "pairs.txt")
