"""Pictures of a calibration board: folders, globs, side-by-side pictures and videos, read one moment at a time."""

import glob
import re
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np

from roadblock.errors import SourceError
from roadblock.io.sources.folders import SIDES, sides_of
from roadblock.io.sources.image import IMAGE_SUFFIXES, Size, image_size, read_image
from roadblock.io.sources.pairing import by_frame, list_images, natural_key, only_images
from roadblock.io.sources.video import (
    VIDEO_SUFFIXES,
    Moment,
    count_frames,
    halves,
    is_video,
    matched,
    probe,
    two_videos,
)
from roadblock.values.frame import Image

MOST_FRAMES = 200
"""How many frames of a video are looked at."""


@dataclass(frozen=True, eq=False)
class BoardShot:
    """One moment of a calibration recording.

    Attributes
    ----------
    name
        Of the moment, as its file or frame is called.
    left, right
        (height, width) uint8 grey; None where that camera has no picture.
    index
        Number of the frame; in a video, neighbours in time have neighbouring numbers.
    """

    name: str
    left: Image | None
    right: Image | None
    index: int


class BoardImages(Protocol):
    """Pictures of a board; iterate them, as often as needed.

    Attributes
    ----------
    size_px
        (width, height) of every picture of both cameras.
    length
        How many moments an iteration gives; of a video about.
    is_video
        Whether the moments follow each other in time.
    warnings
        What the latest iteration passed over, one line each.
    """

    @property
    def size_px(self) -> Size: ...  # noqa: D102
    @property
    def length(self) -> int: ...  # noqa: D102
    @property
    def is_video(self) -> bool: ...  # noqa: D102
    @property
    def warnings(self) -> list[str]: ...  # noqa: D102
    def __iter__(self) -> Iterator[BoardShot]: ...


@dataclass(frozen=True)
class ShotPaths:
    """The files of one moment; `right` and `left` are one file where it holds both views side by side."""

    name: str
    left: Path | None
    right: Path | None


@dataclass(frozen=True, eq=False)
class BoardFiles:
    """`BoardImages` of image files."""

    size_px: Size
    shots: tuple[ShotPaths, ...]
    is_video: bool = False
    warnings: list[str] = field(default_factory=list)

    @property
    def length(self) -> int:
        """Number of moments."""
        return len(self.shots)

    def __iter__(self) -> Iterator[BoardShot]:
        """Read the pictures in order.

        Raises
        ------
        SourceError
            If a file cannot be read, is no whole image, or holds the very picture of its partner.
        """
        for index, shot in enumerate(self.shots):
            if shot.left is not None and shot.left == shot.right:
                both, half = _eight_bit(read_image(shot.left, gray=True)), self.size_px[0]
                yield _shot(str(shot.left), shot.name, both[:, :half].copy(), both[:, half:].copy(), index)
                continue
            left, right = (
                None if path is None else _eight_bit(read_image(path, gray=True)) for path in (shot.left, shot.right)
            )
            yield _shot(f"{shot.left} and {shot.right}", shot.name, left, right, index)


@dataclass(frozen=True, eq=False)
class BoardVideo:
    """`BoardImages` of one side-by-side video (`right` None) or of two videos, as `VideoSource` pairs them.

    Of every `every` frames two that follow each other are given, so that a moving board can be told from a still one.
    """

    size_px: Size
    left: Path
    right: Path | None
    frames: int
    every: int
    is_video: bool = True
    warnings: list[str] = field(default_factory=list)

    @property
    def length(self) -> int:
        """About how many moments an iteration gives."""
        return len([index for index in range(self.frames) if self._is_wanted(index)])

    def _is_wanted(self, index: int) -> bool:
        return index % self.every < 2

    def __iter__(self) -> Iterator[BoardShot]:
        """Read the chosen frames in order.

        Raises
        ------
        SourceError
            If not one whole frame or pair can be read, a frame has no time stamp, or both views are the very same.
        """
        self.warnings.clear()
        with closing(self._moments()) as moments:
            for index, (_, left, right) in enumerate(moments):
                if self._is_wanted(index):
                    what = " and ".join(str(path) for path in (self.left, self.right) if path)
                    yield _shot(what, f"frame {index}", _eight_bit(left), _eight_bit(right), index)

    def _moments(self) -> Generator[Moment]:
        if self.right is None:
            return halves(self.left, self.size_px[0], True, self.warnings)
        step_ns = min(probe(path).step_ns for path in (self.left, self.right))
        return matched(self.left, self.right, step_ns, True, self.warnings)


def _shot(what: str, name: str, left: Image | None, right: Image | None, index: int) -> BoardShot:
    if left is not None and right is not None and np.array_equal(left, right):
        raise SourceError(f"{what} hold the very same picture left and right: give each camera its own pictures")
    return BoardShot(name, left, right, index)


def _eight_bit(image: Image) -> Image:
    """Return an image with 8 bits: deeper ones, which rarely use all their bits, scaled to their brightest pixel."""
    if image.dtype == np.uint8:
        return image
    return np.rint(image * (255 / max(int(image.max()), 1))).astype(np.uint8)


def open_board_images(left: str, right: str | None = None, every: int | None = None) -> BoardImages:
    """Open the pictures of a calibration.

    Parameters
    ----------
    left
        The left camera's pictures: a folder, a glob ("shots/left*.jpg"), an image or a video. Without `right` both
        cameras': a folder with `left` and `right` in it (as folders, videos, or in the names of its images), two videos
        as "LEFT,RIGHT", or pictures or a video with both views side by side, left first.
    right
        The right camera's.
    every
        Of a video, look at every n-th frame and the one after it; None: so that about `MOST_FRAMES` are looked at.

    Raises
    ------
    SourceError
        If nothing is there, it is no picture, sizes differ, nothing pairs, left and right are the same, or a single
        folder does not say whose its pictures are.
    MissingExtraError
        If it is a video and PyAV is not installed.
    """
    try:
        if right is None:
            return _open_both(left, every)
        videos = [is_video(Path(spec)) for spec in (left, right)]
        if all(videos):
            return _open_videos(Path(left), Path(right), every)
        if any(videos):
            raise SourceError(f"{left} and {right} are a video and no video: give two videos, or pictures of both")
        return _open_pairs(left, right, _files(left), _files(right))
    except OSError as error:
        raise SourceError(f"{error.filename or left} cannot be read: {error.strerror}; check the path") from error


def _files(spec: str) -> list[Path]:
    """Images of a folder, a glob, or a single one."""
    path = Path(spec)
    if path.is_dir():
        return list_images(path)
    if path.exists():
        if not (found := only_images([path])):
            expected = ", ".join((*IMAGE_SUFFIXES, *VIDEO_SUFFIXES))
            raise SourceError(f"{spec} is no picture and no video ({expected}): give the pictures of the board")
        return found
    if not glob.has_magic(spec):
        raise SourceError(f"there is no {spec!r}: give a folder, a quoted glob like 'shots/left*.jpg', or a video")
    if not (found := only_images(map(Path, glob.glob(spec)))):  # noqa: PTH207 - the pattern may be absolute
        raise SourceError(f"{spec} matches no images: check the pattern, and quote it")
    return found


def _side(path: Path) -> str:
    """Which camera a file's name speaks of: "left", "right", or "" for neither or both."""
    named = set(re.findall("left|right", path.stem.lower()))
    return named.pop() if len(named) == 1 else ""


def _open_both(spec: str, every: int | None) -> BoardImages:
    """Open what holds the pictures of both cameras."""
    path = Path(spec)
    if videos := two_videos(path):
        return _open_videos(*videos, every)
    if is_video(path):
        return _open_videos(path, None, every)
    if path.is_dir() and (folders := sides_of(path, SIDES)):
        if len(folders) > 1:
            raise SourceError(f"{spec} holds several pairs of folders: give the folder of each camera")
        a, b = folders[0]
        return _open_pairs(str(a), str(b), list_images(a), list_images(b))
    files = _files(spec)
    sides = {side: [file for file in files if _side(file) == side] for side in ("left", "right", "")}
    if sides["left"] and sides["right"]:
        if sides[""]:
            raise SourceError(
                f"{spec} holds images of left, of right, and others ({sides[''][0].name}): give the left and the "
                "right ones as quoted globs"
            )
        return _open_pairs(f"{spec} (left)", f"{spec} (right)", sides["left"], sides["right"])
    if alone := next((side for side in ("left", "right") if len(sides[side]) == len(files)), ""):
        raise SourceError(
            f"{spec} holds {alone} images only ({files[0].name} ...): give the pictures of both cameras, LEFT and RIGHT"
        )
    return _open_side_by_side(spec, files)


def _open_pairs(left: str, right: str, lefts: list[Path], rights: list[Path]) -> BoardFiles:
    if same := {path.resolve() for path in lefts} & {path.resolve() for path in rights}:
        raise SourceError(
            f"{left} and {right} both hold {min(same).name}: give each camera its own pictures (as quoted globs where "
            "one folder holds both)"
        )
    left_of, right_of, how = by_frame(lefts, rights)
    if not left_of.keys() & right_of.keys():
        raise SourceError(
            f"no image of {left} ({lefts[0].name} ...) has a partner in {right} ({rights[0].name} ...), paired by "
            f"{how}: give both pictures of a moment the same name or number"
        )
    sizes = [_common_size(side) for side in (lefts, rights)]
    if sizes[0] != sizes[1]:
        raise SourceError(
            f"{left} holds {_by(sizes[0])} images, {right} {_by(sizes[1])} ones: take both cameras' pictures at one "
            "resolution, the one they will record at"
        )
    frames = sorted(left_of.keys() | right_of.keys(), key=natural_key)
    shots = [(left_of.get(frame), right_of.get(frame)) for frame in frames]
    return BoardFiles(sizes[0], tuple(ShotPaths((a or b or Path()).stem, a, b) for a, b in shots))


def _open_side_by_side(spec: str, files: list[Path]) -> BoardFiles:
    size_px = _half(spec, _common_size(files))
    return BoardFiles(size_px, tuple(ShotPaths(file.stem, file, file) for file in files))


def _common_size(files: list[Path]) -> Size:
    first, *rest = ((path, image_size(path)) for path in files)
    for path, size_px in rest:
        if size_px != first[1]:
            raise SourceError(
                f"{path} is {_by(size_px)}, but {first[0].name} is {_by(first[1])}: all pictures of a camera must have "
                "one size; leave out those of another resolution"
            )
    return first[1]


def _half(what: str, size_px: Size) -> Size:
    """Size of one view of a picture with both side by side."""
    width, height = size_px
    if width % 2 or width // 2 < height:
        raise SourceError(
            f"{what} is {_by(size_px)}, which is not two views side by side: give the pictures of both cameras, LEFT "
            "and RIGHT"
        )
    return width // 2, height


def _open_videos(left: Path, right: Path | None, every: int | None) -> BoardVideo:
    sizes = [probe(path).size_px for path in (left, right) if path]
    if right is None:
        size_px = _half(str(left), sizes[0])
    elif left.resolve() == right.resolve():
        raise SourceError(f"{left} is given for both cameras: give each camera its own video")
    elif sizes[0] != sizes[1]:
        raise SourceError(
            f"{left} is {_by(sizes[0])}, {right} {_by(sizes[1])}: film with both cameras at one resolution, the one "
            "they will record at"
        )
    else:
        size_px = sizes[0]
    frames = count_frames(left)
    return BoardVideo(size_px, left, right, frames, every or max(1, -(-2 * frames // MOST_FRAMES)))


def _by(size_px: Size) -> str:
    return f"{size_px[0]}x{size_px[1]}"
