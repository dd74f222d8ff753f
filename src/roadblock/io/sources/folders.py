"""Image files that are no known data set's: a folder per side, or a list of pairs."""

from dataclasses import replace
from pathlib import Path

from roadblock.errors import SourceError
from roadblock.io.sources.image import image_size
from roadblock.io.sources.pairing import FramePaths, pair_folders
from roadblock.io.sources.rigs import rig_beside
from roadblock.io.sources.source import ImagePairs, StereoSource
from roadblock.io.sources.text import check_increasing, read_lines, read_timestamps
from roadblock.values.camera import StereoRig

SIDES = (
    ("left", "right"),
    ("image_left", "image_right"),
    ("left_images", "right_images"),
    ("images_left", "images_right"),
    ("image_l", "image_r"),
    ("cam0", "cam1"),
    ("cam_left", "cam_right"),
    ("l", "r"),
)
"""What the folders of the left and the right camera may be called."""

SEPARATORS = {".txt": None, ".csv": ",", ".tsv": "\t"}
"""What stands between the columns of a list of pairs; None is any white space."""


def sides_of(path: Path, table: tuple[tuple[str, str], ...]) -> list[tuple[Path, Path]]:
    """All rows of `table` for which both folders exist in `path`."""
    both = [(path / left, path / right) for left, right in table]
    return [(left, right) for left, right in both if left.is_dir() and right.is_dir()]


def is_folder_pair(path: Path) -> bool:
    """Whether a folder holds one folder per side, named as in `SIDES`."""
    return bool(sides_of(path, SIDES))


def open_folder_pair(path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open a folder with one image folder per side; with a `timestamps.txt` it is a sequence.

    Raises
    ------
    SourceError
        If it holds several pairs of folders, an image lacks its partner, there is no rig, or the time stamps do not
        fit.
    """
    sides = sides_of(path, SIDES)
    if len(sides) != 1:
        names = " or ".join("+".join(row) for row in SIDES)
        raise SourceError(f"{path} must hold one of {names}, but holds {len(sides)} of them")
    frames = pair_folders(*sides[0])
    stamps = path / "timestamps.txt"
    if is_sequence := stamps.is_file():
        frames = stamp(frames, stamps)
    truth = path / "truth.jsonl"
    return ImagePairs(
        name=path.resolve().name,
        rig=rig or rig_beside(path, image_size(frames[0].left)),
        frames=frames,
        is_sequence=is_sequence,
        ground_truth=truth if truth.is_file() else None,
        gray=gray,
    )


def stamp(frames: tuple[FramePaths, ...], path: Path) -> tuple[FramePaths, ...]:
    """Give frames the time stamps of a file: in order where the counts match, else by the number each frame is named.

    Raises
    ------
    SourceError
        If the file cannot be read, the counts differ and a frame's name is no line number of it (from 0), or a stamp
        does not lie after the one before.
    """
    stamps = read_timestamps(path)
    if len(stamps) == len(frames):
        chosen = stamps
    elif all(frame.name.isdecimal() and int(frame.name) < len(stamps) for frame in frames):
        chosen = [stamps[int(frame.name)] for frame in frames]
    else:
        raise SourceError(
            f"{path} holds {len(stamps)} time stamps for {len(frames)} pairs, and the pairs' names are no line numbers "
            "of it: one line per pair is expected"
        )
    check_increasing(path, chosen)
    return tuple(replace(frame, t_ns=t_ns) for frame, t_ns in zip(frames, chosen, strict=True))


def is_list(path: Path) -> bool:
    """Whether a path is a text file that may list pairs, by its suffix."""
    return path.suffix.lower() in SEPARATORS and path.is_file()


def open_list(path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open a text file with `left right` or `left right t_ns` per line, relative to the file's own folder.

    Columns are parted by white space (.txt), commas (.csv) or tabs (.tsv); a first line `left,right[,t_ns]` is a
    header. With time stamps it is a sequence.

    Raises
    ------
    SourceError
        If the file cannot be read, lists nothing, a line has another number of columns or names a missing file, a stamp
        is no whole number or not after the one before, or there is no rig.
    """
    separator = SEPARATORS.get(path.suffix.lower())
    rows = [(n, [word.strip() for word in line.split(separator)]) for n, line in read_lines(path)]
    if rows and rows[0][1][:2] == ["left", "right"]:
        rows = rows[1:]
    if not rows:
        raise SourceError(f"{path} lists no pairs: one `left right` per line is expected")
    columns = len(rows[0][1])
    frames = tuple(_listed_frame(path, number, words, columns) for number, words in rows)
    if columns == 3:
        check_increasing(path, [frame.t_ns for frame in frames])
    return ImagePairs(
        name=path.stem,
        rig=rig or rig_beside(path.parent, image_size(frames[0].left)),
        frames=frames,
        is_sequence=columns == 3,
        gray=gray,
    )


def _listed_frame(path: Path, number: int, words: list[str], columns: int) -> FramePaths:
    if len(words) != columns or columns not in (2, 3):
        raise SourceError(
            f"{path} line {number} has {len(words)} columns, but every line must have the same 2 or 3: left right "
            "[t_ns]"
        )
    left, right = (path.parent / word for word in words[:2])
    for image in (left, right):
        if not image.is_file():
            raise SourceError(f"{path} line {number} names {image}, which is missing or no plain file: check the path")
    if columns == 2:
        return FramePaths(left, right, left.stem)
    if not (words[2].isdecimal() and words[2].isascii() and len(words[2]) <= 19):
        raise SourceError(f"{path} line {number}: t_ns is {words[2]!r:.40}, but must be whole nanoseconds")
    return FramePaths(left, right, left.stem, int(words[2]))
