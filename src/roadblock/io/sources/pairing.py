"""Which left image belongs to which right one: by file name, or by the number in it."""

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from roadblock.errors import SourceError
from roadblock.io.sources.image import IMAGE_SUFFIXES


@dataclass(frozen=True)
class FramePaths:
    """One moment on disk: both image files, the frame's name, and when the left image was exposed (ns)."""

    left: Path
    right: Path
    name: str
    t_ns: int = 0


def natural_key(name: str) -> tuple[tuple[int, str], ...]:
    """Key that sorts "frame2" before "frame10"."""
    return tuple((int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name))


def list_images(folder: Path) -> list[Path]:
    """Image files of a folder (by suffix; hidden ones left out), numbers in natural order.

    Raises
    ------
    SourceError
        If there is none.
    """
    if not (files := only_images(folder.iterdir())):
        raise SourceError(f"{folder} holds no images, but must hold {', '.join(IMAGE_SUFFIXES)} files")
    return files


def only_images(paths: Iterable[Path]) -> list[Path]:
    """Those of `paths` that are image files (by suffix; hidden ones left out), numbers in natural order."""
    files = [p for p in paths if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "." and p.is_file()]
    return sorted(files, key=lambda path: (natural_key(path.stem), path.name))


def _number(path: Path) -> str:
    """Last number in a file's name without leading zeros, or the whole stem where there is none."""
    numbers = re.findall(r"[0-9]+", path.stem)
    return str(int(numbers[-1])) if numbers else path.stem


def _by_key(files: list[Path], key: Callable[[Path], str]) -> dict[str, Path]:
    table: dict[str, Path] = {}
    for path in files:
        if (other := table.setdefault(key(path), path)) is not path:
            raise SourceError(f"{path} and {other.name} claim the same frame: remove one, or write a list of pairs")
    return table


def by_frame(lefts: list[Path], rights: list[Path]) -> tuple[dict[str, Path], dict[str, Path], str]:
    """Name the frame of each image: by its name, or by the last number in it where the sides share no name at all.

    Returns
    -------
    Frame -> left image, frame -> right image, and what they go by: "name" or "number".

    Raises
    ------
    SourceError
        If two images of one side claim one frame.
    """
    shared = {path.stem for path in lefts} & {path.stem for path in rights}
    key: Callable[[Path], str] = (lambda path: path.stem) if shared else _number
    return _by_key(lefts, key), _by_key(rights, key), "name" if shared else "number"


def pair_folders(left: Path, right: Path) -> tuple[FramePaths, ...]:
    """Pair the images of two folders by name; where the sides share no name at all, by the last number in it.

    Raises
    ------
    SourceError
        If a folder holds no images, two files claim one frame, or an image has no partner.
    """
    lefts, rights, how = by_frame(list_images(left), list_images(right))
    alone = [path for name, path in lefts.items() if name not in rights]
    alone += [path for name, path in rights.items() if name not in lefts]
    if alone:
        raise SourceError(
            f"{alone[0]} has no partner: {left.name} holds {len(lefts)} images, {right.name} {len(rights)}, paired by "
            f"{how}, and {len(alone)} stay alone; remove them, or write a list of pairs"
        )
    return tuple(FramePaths(path, rights[name], path.stem) for name, path in lefts.items())
