"""Where pictures go: one file per frame, or a video."""

import os
from contextlib import suppress
from fractions import Fraction
from pathlib import Path
from types import ModuleType, TracebackType
from typing import TYPE_CHECKING, Any, Protocol, Self

import cv2
import numpy as np

from roadblock.errors import MissingExtraError, OutputError
from roadblock.values.camera import Rectification
from roadblock.values.frame import Image
from roadblock.values.scene import FrameResult
from roadblock.viz.overlay import draw_overlay

if TYPE_CHECKING:
    from av.container import OutputContainer
    from av.video.stream import VideoStream

CODECS: tuple[tuple[str, dict[str, str]], ...] = (
    ("libx264", {"preset": "veryfast", "tune": "zerolatency", "crf": "20"}),
    ("mpeg4", {"b": "8M"}),
)
"""Video encoders and their options, best first; a build of the video library may lack the first."""
TIME_BASE = Fraction(1, 60_000)
"""Of the video's time stamps, seconds; MPEG-4 takes no denominator over 65535."""
FRAME_S = 0.1
"""Time from frame to frame where the source knows none."""
KEYFRAME_EVERY = 20
MP4_OPTIONS = {"movflags": "frag_every_frame+empty_moov+default_base_moof", "flush_packets": "1"}
"""A fragment per frame, each flushed: what was written before an interruption can be played."""


class OverlaySink(Protocol):
    """A context manager that takes one frame after the other and draws it."""

    def __enter__(self) -> Self:
        """Open it."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it, whatever happened."""
        ...

    def write(self, image: Image, result: FrameResult, rectification: Rectification) -> None:
        """Draw `result` on the rectified left image and keep the picture."""
        ...


class PictureSink:
    """Writes one PNG per frame, named after it; each appears whole or not at all.

    Parameters
    ----------
    folder
        Made where it is missing.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = Path(folder)
        self._names: set[str] = set()

    def __enter__(self) -> Self:
        """Make the folder.

        Raises
        ------
        OutputError
            If that is not possible.
        """
        _make_folder(self.folder)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Do nothing: every picture is on the disk."""

    def write(self, image: Image, result: FrameResult, rectification: Rectification) -> None:
        """Draw one frame.

        Raises
        ------
        OutputError
            If the picture cannot be written.
        ValueRefusedError
            As `draw_overlay`.
        """
        picture = cv2.cvtColor(draw_overlay(image, result, rectification), cv2.COLOR_RGB2BGR)
        path = self.folder / f"{self._free_name(result)}.png"
        beside = path.with_name(f".{os.getpid()}.part")
        try:
            beside.write_bytes(cv2.imencode(".png", picture)[1].tobytes())
            beside.replace(path)
        except OSError as error:
            with suppress(OSError):
                beside.unlink()
            raise OutputError(_cannot_write(path, error)) from error

    def _free_name(self, result: FrameResult) -> str:
        """Return the frame's name as a file may be called, with its index where another frame has that name."""
        allowed = (sign if sign.isalnum() or sign in "-_." else "_" for sign in result.name)
        name = "".join(allowed).lstrip(".")[:100]
        while not name or name in self._names:
            name = f"{name}_{result.index:06d}"
        self._names.add(name)
        return name


class VideoSink:
    """Writes an MP4 that can be played even if the writing was broken off.

    Parameters
    ----------
    path
        The file; replaced where it exists. It appears with the first frame.
    fps
        Frames per second; None takes the frames' own times `t_ns`, and 10 per second where these do not grow.
    """

    def __init__(self, path: Path, fps: float | None = None) -> None:
        self.path = Path(path)
        self._clock = _Clock(fps)
        self._av: ModuleType | None = None
        self._container: OutputContainer | None = None
        self._stream: VideoStream | None = None

    def __enter__(self) -> Self:
        """Find the video library and make the folder.

        Raises
        ------
        MissingExtraError
            If the video library is not installed.
        OutputError
            If the folder cannot be made.
        """
        self._av = _video_library()
        _make_folder(self.path.parent)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Finish the video.

        Raises
        ------
        OutputError
            If its end cannot be written.
        """
        if self._container is None or self._stream is None or self._av is None:
            return
        try:
            self._container.mux(self._stream.encode(None))
            self._container.close()
        except self._av.error.FFmpegError as failure:
            raise OutputError(_cannot_write(self.path, failure)) from failure

    def write(self, image: Image, result: FrameResult, rectification: Rectification) -> None:
        """Draw one frame.

        Raises
        ------
        OutputError
            If the video cannot be written, or the pictures change their size.
        ValueRefusedError
            As `draw_overlay`.
        """
        assert self._av is not None, "write inside `with VideoSink(path) as sink`"  # noqa: S101
        picture = _even(draw_overlay(image, result, rectification))
        try:
            if self._container is None or self._stream is None:
                self._container, self._stream = _open_video(self._av, self.path, picture.shape)
            if picture.shape[:2] != (self._stream.height, self._stream.width):
                raise OutputError(
                    f"frame {result.name} draws as {picture.shape[1]}x{picture.shape[0]}, but the video {self.path} is "
                    f"{self._stream.width}x{self._stream.height}: write pictures instead, or one video per size"
                )
            frame = self._av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.time_base, frame.pts = TIME_BASE, self._clock.tick(result.t_ns)
            self._container.mux(self._stream.encode(frame))
        except self._av.error.FFmpegError as failure:
            raise OutputError(_cannot_write(self.path, failure)) from failure


class _Clock:
    """Turns moments into the video's time stamps, which must grow.

    Parameters
    ----------
    fps
        A constant rate; None follows the moments.
    """

    def __init__(self, fps: float | None) -> None:
        self._follows = fps is None
        self._step_ns = round(1e9 * (FRAME_S if fps is None else 1 / fps))
        self._last_t_ns: int | None = None
        self._now_ns = 0

    def tick(self, t_ns: int) -> int:
        """Return the time stamp, in `TIME_BASE`, of a frame of the moment `t_ns`; the first one's is 0."""
        if self._last_t_ns is not None:
            grown_ns = t_ns - self._last_t_ns
            grows = self._follows and grown_ns * TIME_BASE.denominator >= 1_000_000_000
            self._now_ns += grown_ns if grows else self._step_ns
        self._last_t_ns = t_ns
        return self._now_ns * TIME_BASE.denominator // 1_000_000_000


def _video_library() -> ModuleType:
    try:
        import av
    except ImportError as error:
        raise MissingExtraError("writing a video", "video") from error
    return av


def _open_video(av: ModuleType, path: Path, shape: tuple[int, ...]) -> tuple["OutputContainer", "VideoStream"]:
    container = av.open(str(path), "w", format="mp4", options=MP4_OPTIONS)
    name, options = _codec(av)
    stream = container.add_stream(name, rate=round(1 / FRAME_S), options=options)
    stream.height, stream.width = shape[:2]
    stream.pix_fmt, stream.gop_size = "yuv420p", KEYFRAME_EVERY
    stream.codec_context.time_base = TIME_BASE
    return container, stream


def _codec(av: ModuleType) -> tuple[str, dict[str, str]]:
    """Return the best encoder of `CODECS` that this build of the video library has."""
    for name, options in CODECS:
        with suppress(av.codec.codec.UnknownCodecError):
            av.Codec(name, "w")
            return name, options
    raise OutputError(
        f"the installed video library has none of the encoders {', '.join(name for name, _ in CODECS)}: "
        "reinstall it with pip install --force-reinstall av, or write pictures instead"
    )


def _even(picture: np.ndarray) -> np.ndarray:
    """Return the picture with its last row and column doubled where their number is odd, as video codecs need."""
    height, width = picture.shape[:2]
    return cv2.copyMakeBorder(picture, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)


def _make_folder(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(_cannot_write(folder, error)) from error


def _cannot_write(path: Path, error: Any) -> str:
    return f"cannot write {path}: {error.strerror or error}; choose another folder with --out, or free this one"
