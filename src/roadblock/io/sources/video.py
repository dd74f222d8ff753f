"""Videos: one file with both views side by side, or one file per camera. The only room that knows PyAV."""

from collections.abc import Generator, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import Any

from roadblock.errors import MissingExtraError, SourceError
from roadblock.io.sources.image import MAX_PIXELS, Size
from roadblock.io.sources.rigs import rig_beside
from roadblock.io.sources.source import StereoSource, check_size
from roadblock.values.camera import StereoRig
from roadblock.values.frame import Image, StereoPair

VIDEO_SUFFIXES = (".mp4", ".mkv", ".avi", ".mov", ".m4v", ".webm", ".mpg", ".mpeg", ".ts", ".wmv")
NS = 10**9

Moment = tuple[int, Image, Image]
"""t_ns, left, right."""


def _import_av() -> ModuleType:
    try:
        import av
    except ImportError as error:
        raise MissingExtraError("reading a video", "video") from error
    return av


def is_video(path: Path) -> bool:
    """Whether a path is a video file, by its suffix."""
    return path.suffix.lower() in VIDEO_SUFFIXES and "," not in str(path) and path.is_file()


def two_videos(path: Path) -> tuple[Path, Path] | None:
    """Left and right video of a folder that holds `left.EXT` and `right.EXT`, or of "left.mp4,right.mp4"; else None.

    Raises
    ------
    SourceError
        If the folder holds several left or right videos.
    """
    if path.is_dir():
        sides = [sorted(p for p in path.glob(f"{side}.*") if is_video(p)) for side in ("left", "right")]
        if not all(sides):
            return None
        if max(map(len, sides)) > 1:
            names = ", ".join(p.name for side in sides for p in side)
            raise SourceError(f"{path} holds {names}, but must hold one video per side: give LEFT,RIGHT instead")
        return sides[0][0], sides[1][0]
    left, comma, right = str(path).partition(",")
    both = Path(left), Path(right)
    return both if comma and all(p.suffix.lower() in VIDEO_SUFFIXES for p in both) else None


@dataclass(frozen=True)
class VideoInfo:
    """What a video's header says: frame size, time from frame to frame (ns), number of frames or None."""

    size_px: Size
    step_ns: Fraction
    length: int | None


def probe(path: Path) -> VideoInfo:
    """Read a video's header.

    Raises
    ------
    SourceError
        If the file cannot be read, holds no video, or declares an impossible size or no frame rate.
    MissingExtraError
        If PyAV is not installed.
    """
    av = _import_av()
    if not path.is_file():
        raise SourceError(f"{path} is missing or no plain file, but must be a video: check the path")
    try:
        with av.open(str(path.resolve()), options={"protocol_whitelist": "file"}) as container:
            stream = next(iter(container.streams.video), None)
            if stream is None or not stream.codec_context or not stream.codec_context.width:
                raise SourceError(f"{path} holds no video that can be decoded: check the file")
            size = stream.codec_context.width, stream.codec_context.height
            rate = stream.guessed_rate or stream.average_rate
            seconds = Fraction(container.duration or 0, av.time_base)
            frames = stream.frames
    except (av.error.FFmpegError, OSError) as error:
        raise SourceError(f"{path} cannot be opened as a video ({error.strerror}): it is cut short or none") from error
    if size[0] * size[1] > MAX_PIXELS or not rate:
        raise SourceError(
            f"{path} declares {size[0]}x{size[1]} pixels at {rate} frames/s, but a video must have a frame rate and at "
            f"most {MAX_PIXELS} pixels: convert it"
        )
    return VideoInfo(size, NS / Fraction(rate), frames if frames and frames == round(seconds * rate) else None)


def _pixels(frame: Any, gray: bool) -> str:
    """PyAV's name for the array to make of a frame: grey or RGB, 8 or 16 bit."""
    parts = frame.format.components
    deep = max(part.bits for part in parts) > 8
    if gray or frame.format.name.startswith("gray"):
        return "gray16le" if deep else "gray"
    return "rgb48le" if deep else "rgb24"


def decode(path: Path, gray: bool, warnings: list[str]) -> Generator[tuple[int, Image]]:
    """Read whole frames with their exact time stamps (ns, rounded once, from the container's own clock).

    Broken frames are left out, a video that breaks off ends there; both put a line into `warnings`.

    Raises
    ------
    SourceError
        If not one whole frame can be read, or a frame has no time stamp after the one before.
    """
    av = _import_av()
    count, broken, last_ns, reason = 0, 0, None, ""
    try:
        with av.open(str(path.resolve()), options={"protocol_whitelist": "file"}) as container:
            stream = container.streams.video[0]
            for frame in container.decode(stream):
                if frame.is_corrupt:
                    broken += 1
                    continue
                t_ns = None if frame.pts is None else round(frame.pts * frame.time_base * NS)
                if t_ns is None or (last_ns is not None and t_ns <= last_ns):
                    raise SourceError(
                        f"{path} frame {count} has no time stamp later than the frame before: put the video into a "
                        "container with time stamps (mp4, mkv)"
                    )
                yield t_ns, frame.to_ndarray(format=_pixels(frame, gray))
                count, last_ns = count + 1, t_ns
            reason = _cut_short(container, last_ns)
    except (av.error.FFmpegError, OSError) as error:
        reason = str(error.strerror)
    if not count:
        raise SourceError(f"{path} holds no whole frame ({reason or 'empty'}): copy it again")
    if broken:
        warnings.append(f"{path}: left out {broken} broken frames")
    if reason:
        warnings.append(f"{path} breaks off after {count} whole frames: {reason}")


def _cut_short(container: Any, last_ns: int | None) -> str:
    """Why a video that ended without an error is not whole, or "" where it is."""
    stream = container.streams.video[0]
    if last_ns is None or len(container.streams) > 1 or container.duration is None:
        return ""
    # Matroska counts its duration from zero, MP4 from the first frame: what holds for both is the less strict
    end_s, last_s = Fraction(container.duration, 10**6), Fraction(last_ns, NS)
    if end_s - last_s <= Fraction(5, 2) / (stream.guessed_rate or stream.average_rate):
        return ""
    return f"its last frame is at {float(last_s):.2f} s, but it declares {float(end_s):.2f} s"


def count_frames(path: Path) -> int:
    """Return about how many frames a video holds, without decoding them; 0 where it cannot be read.

    Raises
    ------
    MissingExtraError
        If PyAV is not installed.
    """
    av = _import_av()
    count = 0
    with (
        suppress(av.error.FFmpegError, OSError),
        av.open(str(path.resolve()), options={"protocol_whitelist": "file"}) as container,
    ):
        for packet in container.demux(video=0):
            count += packet.size > 0
    return count


def halves(path: Path, half_px: int, gray: bool, warnings: list[str]) -> Generator[Moment]:
    """Read a side-by-side video: its left `half_px` columns are the left camera's.

    Raises
    ------
    SourceError
        As `decode`.
    """
    with closing(decode(path, gray, warnings)) as frames:
        for t_ns, image in frames:
            yield t_ns, image[:, :half_px].copy(), image[:, half_px:].copy()


def matched(left: Path, right: Path, step_ns: Fraction, gray: bool, warnings: list[str]) -> Generator[Moment]:
    """Read two videos; frames less than half of `step_ns` apart belong together, others are left out and counted.

    Raises
    ------
    SourceError
        As `decode`, or if not one frame has a partner.
    """
    alone, pairs = [0, 0], 0
    sides = [decode(path, gray, warnings) for path in (left, right)]
    with closing(sides[0]), closing(sides[1]):
        now = [next(side, None) for side in sides]
        while now[0] and now[1]:
            gap_ns = now[1][0] - now[0][0]
            if together := 2 * abs(gap_ns) < step_ns:
                pairs += 1
                yield now[0][0], now[0][1], now[1][1]
            for i, late in enumerate((gap_ns > 0, gap_ns < 0)):
                if together or late:
                    alone[i] += not together
                    now[i] = next(sides[i], None)
        for i, side in enumerate(sides):
            alone[i] += (now[i] is not None) + sum(1 for _ in side)
    if not pairs:
        raise SourceError(f"{left} and {right} share no moment: start both cameras on one clock")
    if any(alone):
        warnings.append(f"left out {alone[0]} left and {alone[1]} right frames that have no partner in time")


@dataclass(frozen=True, eq=False)
class VideoSource:
    """A `StereoSource` of one side-by-side video (`right` None: the left half is the left camera) or of two videos.

    Two videos are paired by time stamp: frames less than half a frame apart belong together, a frame without partner
    is left out and counted in `warnings`, so that a dropped frame never shifts what follows.

    Attributes
    ----------
    left, right
        The files.
    gray
        Whether colour is turned into grey.
    step_ns
        Time from frame to frame.
    name, rig, rigs, ground_truth, length, is_sequence, warnings
        As in `StereoSource`.
    """

    name: str
    rig: StereoRig
    left: Path
    right: Path | None
    step_ns: Fraction
    length: int | None = None
    gray: bool = False
    rigs: None = None
    ground_truth: None = None
    is_sequence: bool = True
    warnings: list[str] = field(default_factory=list)

    def __iter__(self) -> Iterator[StereoPair]:
        """Read the pairs in order.

        Raises
        ------
        SourceError
            If not one whole frame or pair can be read, a frame has no time stamp, or its size is not the rig's.
        """
        self.warnings.clear()
        if self.right is None:
            moments = halves(self.left, self.rig.left.size_px[0], self.gray, self.warnings)
        else:
            moments = matched(self.left, self.right, self.step_ns, self.gray, self.warnings)
        with closing(moments):
            for index, (t_ns, left, right) in enumerate(moments):
                for side, image in (("left", left), ("right", right)):
                    check_size(f"{self.name} frame {index} {side}", image, self.rig.left.size_px)
                yield StereoPair(left, right, index, f"{index:06d}", t_ns)


def open_side_by_side(path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open one video that holds both views, left half first.

    Raises
    ------
    SourceError
        If it cannot be read, has no rig, or a width that is not twice the rig's.
    MissingExtraError
        If PyAV is not installed.
    """
    info = probe(path)
    width, height = info.size_px
    if width % 2:
        raise SourceError(f"{path} is {width} pixels wide, but a side-by-side video has an even width: check the file")
    rig = rig or rig_beside(path.parent, (width // 2, height))
    if rig.left.size_px == (width, height):
        raise SourceError(
            f"{path} is {width}x{height}, the size of one camera of the rig, so it looks like one camera's video: give "
            "LEFT,RIGHT, or a video with both views side by side"
        )
    if (2 * rig.left.size_px[0], rig.left.size_px[1]) != (width, height):
        w, h = rig.left.size_px
        raise SourceError(f"{path} is {width}x{height}, but two {w}x{h} views of its rig side by side are {2 * w}x{h}")
    return VideoSource(path.stem, rig, path, None, info.step_ns, info.length, gray)


def open_two_videos(path: Path, rig: StereoRig | None, gray: bool) -> StereoSource:
    """Open a folder with `left.EXT` and `right.EXT`, or "LEFT,RIGHT".

    Raises
    ------
    SourceError
        If a video cannot be read, there is no rig, or a size is not the rig's.
    MissingExtraError
        If PyAV is not installed.
    """
    sides = two_videos(path)
    if sides is None:
        raise SourceError(f"{path} is no pair of videos: give a folder with left.mp4 and right.mp4, or LEFT,RIGHT")
    infos = [probe(side) for side in sides]
    rig = rig or rig_beside(sides[0].parent, infos[0].size_px)
    for side, info in zip(sides, infos, strict=True):
        if info.size_px != rig.left.size_px:
            (w, h), (rw, rh) = info.size_px, rig.left.size_px
            raise SourceError(f"{side} is {w}x{h}, but its rig is for {rw}x{rh}: choose the right rig with --rig FILE")
    name = path.name if path.is_dir() else sides[0].stem
    return VideoSource(name, rig, sides[0], sides[1], min(info.step_ns for info in infos), None, gray)
