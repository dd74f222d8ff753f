"""Which left image belongs to which right one: by file name, or by the number in it."""

import re
from collections.abc import Callable
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
    files = [p for p in folder.iterdir() if p.suffix.lower() in IMAGE_SUFFIXES and p.name[0] != "." and p.is_file()]
    if not files:
        raise SourceError(f"{folder} holds no images, but must hold {', '.join(IMAGE_SUFFIXES)} files")
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


def pair_folders(left: Path, right: Path) -> tuple[FramePaths, ...]:
    """Pair the images of two folders by name; where the sides share no name at all, by the last number in it.

    Raises
    ------
    SourceError
        If a folder holds no images, two files claim one frame, or an image has no partner.
    """
    files = list_images(left), list_images(right)
    shared = {path.stem for path in files[0]} & {path.stem for path in files[1]}
    key: Callable[[Path], str] = (lambda path: path.stem) if shared else _number
    lefts, rights = (_by_key(side, key) for side in files)
    alone = [path for name, path in lefts.items() if name not in rights]
    alone += [path for name, path in rights.items() if name not in lefts]
    if alone:
        raise SourceError(
            f"{alone[0]} has no partner: {left.name} holds {len(lefts)} images, {right.name} {len(rights)}, paired by "
            f"{'name' if shared else 'number'}, and {len(alone)} stay alone; remove them, or write a list of pairs"
        )
    return tuple(FramePaths(path, rights[name], path.stem) for name, path in lefts.items())
