import builtins
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from roadblock.errors import MissingExtraError, SourceError
from roadblock.io.sources import VideoSource, open_source
from roadblock.io.sources import video as module
from roadblock.io.sources.video import open_two_videos, probe, two_videos
from roadblock.values.camera import Camera, StereoRig

av = pytest.importorskip("av")

TICK = Fraction(1, 30_000)
UNEVEN = (0, 1001, 2002, 4004, 5005)  # ticks of 1/30000 s; the fourth frame was dropped


def write_video(
    path: Path, frames: Sequence[np.ndarray], ticks: Sequence[int] = UNEVEN, codec: str = "ffv1", format_: str = "bgr0"
) -> None:
    """Write RGB or grey frames without loss, at exact moments."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(30_000, 1001))
        stream.height, stream.width = frames[0].shape[:2]
        stream.pix_fmt = format_
        stream.codec_context.time_base = TICK
        for image, tick in zip(frames, ticks, strict=False):
            deep = image.dtype == np.uint16
            plain = ("gray16le" if deep else "gray") if image.ndim == 2 else ("rgb48le" if deep else "rgb24")
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), format=plain).reformat(format=format_)
            frame.pts, frame.time_base = tick, TICK
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)


@pytest.fixture
def rig_even(rig: StereoRig) -> StereoRig:
    left, right = (Camera((96, 60), c.fx_px, c.fy_px, c.cx_px, c.cy_px) for c in (rig.left, rig.right))
    return StereoRig(left, right, rig.T_left_right)


@pytest.fixture
def both(images) -> list[np.ndarray]:
    """Five side-by-side frames of 2 * 97 x 61."""
    return [np.hstack((images[i], images[i + 1])) for i in range(5)]


@pytest.mark.parametrize(("suffix", "codec", "format_"), [(".mkv", "ffv1", "bgr0"), (".mov", "png", "rgb24")])
def test_side_by_side_is_exact(tmp_path: Path, both, rig_text: str, suffix: str, codec: str, format_: str) -> None:
    (tmp_path / "rig.yaml").write_text(rig_text)
    path = tmp_path / f"fährt{suffix}"
    write_video(path, both, codec=codec, format_=format_)
    # Matroska counts milliseconds, MOV keeps the ticks
    step = Fraction(1, 1000) if suffix == ".mkv" else Fraction(1, 30_000)
    expected = [round(round(tick * TICK / step) * step * 10**9) for tick in UNEVEN]
    source = open_source(path)
    assert (source.name, source.is_sequence) == ("fährt", True)
    for _ in range(2):
        pairs = list(source)
        assert [pair.t_ns for pair in pairs] == expected
        assert [(pair.index, pair.name) for pair in pairs] == [(i, f"00000{i}") for i in range(5)]
        for pair, image in zip(pairs, both, strict=True):
            np.testing.assert_array_equal(pair.left, image[:, :97])
            np.testing.assert_array_equal(pair.right, image[:, 97:])
        assert source.warnings == []
    assert (source.rigs, source.ground_truth) == (None, None)


def test_length_where_the_header_can_be_believed(tmp_path: Path, both, rig: StereoRig) -> None:
    even = [1001 * i for i in range(5)]
    write_video(tmp_path / "a.mov", both, even, "png", "rgb24")
    assert open_source(tmp_path / "a.mov", rig=rig).length == 5
    write_video(tmp_path / "a.mkv", both, even)
    assert open_source(tmp_path / "a.mkv", rig=rig).length is None


@pytest.mark.parametrize(("suffix", "codec", "format_"), [(".mkv", "ffv1", "bgr0"), (".mov", "png", "rgb24")])
def test_a_video_that_starts_late_is_whole(
    tmp_path: Path, both, rig: StereoRig, suffix: str, codec: str, format_: str
) -> None:
    write_video(tmp_path / f"a{suffix}", both, [60_000 + tick for tick in UNEVEN], codec, format_)
    source = open_source(tmp_path / f"a{suffix}", rig=rig)
    assert next(iter(source)).t_ns == 2_000_000_000
    assert len(list(source)) == 5
    assert source.warnings == []


def test_one_frame_is_a_video_too(tmp_path: Path, both, rig: StereoRig) -> None:
    write_video(tmp_path / "a.mkv", both[:1])
    assert len(list(open_source(tmp_path / "a.mkv", rig=rig))) == 1


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_keeps_its_bits(tmp_path: Path, rig: StereoRig, dtype) -> None:
    rng = np.random.default_rng(3)
    frames = [rng.integers(0, np.iinfo(dtype).max, (61, 194)).astype(dtype) for _ in range(3)]
    write_video(tmp_path / "a.mkv", frames, format_="gray" if dtype == np.uint8 else "gray16le")
    pairs = list(open_source(tmp_path / "a.mkv", rig=rig))
    for pair, image in zip(pairs, frames, strict=True):
        np.testing.assert_array_equal(np.hstack((pair.left, pair.right)), image)


def test_deep_colour_and_gray(tmp_path: Path, both, rig: StereoRig) -> None:
    deep = [257 * image.astype(np.uint16) for image in both]
    write_video(tmp_path / "a.mkv", deep, format_="gbrp16le")
    pair = next(iter(open_source(tmp_path / "a.mkv", rig=rig)))
    np.testing.assert_array_equal(pair.left, deep[0][:, :97])
    write_video(tmp_path / "b.mkv", both)
    pair = next(iter(open_source(tmp_path / "b.mkv", rig=rig, gray=True)))
    assert np.abs(pair.left - both[0][:, :97] @ [0.299, 0.587, 0.114]).max() < 3


def two(tmp_path: Path, images, lefts: Sequence[int], rights: Sequence[int]) -> Path:
    """Two videos whose frames show when they were taken: image `k` at tick 1001 * k."""
    for side, ticks in (("left", lefts), ("right", rights)):
        frames = [np.full((61, 97, 3), 10 * round(tick / 1001) + (side == "right"), np.uint8) for tick in ticks]
        write_video(tmp_path / f"{side}.mov", frames, ticks, "png", "rgb24")
    return tmp_path


def moments(source: VideoSource) -> list[tuple[int, int]]:
    return [(int(pair.left[0, 0, 0]), int(pair.right[0, 0, 0])) for pair in source]


def test_two_videos(tmp_path: Path, images, rig_text: str) -> None:
    ticks = [1001 * i for i in range(6)]
    (tmp_path / "rig.yaml").write_text(rig_text)
    folder = two(tmp_path, images, ticks, ticks)
    source = open_source(folder)
    assert (source.name, source.length, source.is_sequence) == (tmp_path.name, None, True)
    assert moments(source) == [(10 * i, 10 * i + 1) for i in range(6)]
    assert source.warnings == []
    spec = f"{tmp_path / 'left.mov'},{tmp_path / 'right.mov'}"
    assert open_source(spec).name == "left"
    assert moments(open_source(spec)) == [(10 * i, 10 * i + 1) for i in range(6)]


def test_dropped_frames_never_shift_what_follows(tmp_path: Path, images, rig: StereoRig) -> None:
    lefts = [1001 * i for i in range(12) if i not in (2, 7, 8)]
    rights = [1001 * i + 300 for i in range(15) if i not in (0, 5)]  # its clock runs 0.3 frames late
    source = open_source(two(tmp_path, images, lefts, rights), rig=rig)
    assert moments(source) == [(10 * i, 10 * i + 1) for i in (1, 3, 4, 6, 9, 10, 11)]
    # left alone: 0, 5; right alone: 2, 7, 8, and 12, 13, 14 after the end
    assert source.warnings == ["left out 2 left and 6 right frames that have no partner in time"]
    assert len(list(source)) == 7
    assert len(source.warnings) == 1


def test_left_goes_on_longer(tmp_path: Path, images, rig: StereoRig) -> None:
    ticks = [1001 * i for i in range(6)]
    source = open_source(two(tmp_path, images, ticks, ticks[:4]), rig=rig)
    assert len(moments(source)) == 4
    assert source.warnings == ["left out 2 left and 0 right frames that have no partner in time"]


def test_no_common_moment(tmp_path: Path, images, rig: StereoRig) -> None:
    folder = two(tmp_path, images, [1001 * i for i in range(4)], [20_020 + 1001 * i for i in range(4)])
    with pytest.raises(SourceError, match="share no moment"):
        list(open_source(folder, rig=rig))


def test_several_left_videos(tmp_path: Path) -> None:
    for name in ("left.mp4", "left.avi", "right.mp4"):
        (tmp_path / name).touch()
    with pytest.raises(SourceError, match=r"holds left\.avi, left\.mp4, right\.mp4, but must hold one video per side"):
        open_source(tmp_path)


def test_no_pair_of_videos(tmp_path: Path) -> None:
    assert two_videos(Path("left.mp4,right.txt")) is None
    with pytest.raises(SourceError, match="is no pair of videos"):
        open_two_videos(tmp_path, None, False)


def test_missing_half(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match=r"a\.mp4 is missing or no plain file"):
        open_source(f"{tmp_path / 'a.mp4'},{tmp_path / 'b.mp4'}")


def test_sizes(tmp_path: Path, both, images, rig: StereoRig, rig_even: StereoRig) -> None:
    path = tmp_path / "a.mkv"
    write_video(path, both)
    with pytest.raises(SourceError, match="is 194x61, but two 96x60 views of its rig side by side are 192x60"):
        open_source(path, rig=rig_even)
    with pytest.raises(SourceError, match="holds no rig file"):
        open_source(path)
    write_video(path, [image[:60, :96] for image in images])
    with pytest.raises(SourceError, match="looks like one camera's video"):
        open_source(path, rig=rig_even)
    write_video(path, images)
    with pytest.raises(SourceError, match="is 97 pixels wide, but a side-by-side video has an even width"):
        open_source(path, rig=rig)
    with pytest.raises(SourceError, match=r"a\.mkv is 97x61, but its rig is for 96x60"):
        open_source(f"{path},{path}", rig=rig_even)


@pytest.mark.parametrize("content", [b"", b"no video at all", bytes(5000), b"#EXTM3U\n#EXTINF:1,\nother.ts\n"])
def test_no_video(tmp_path: Path, rig: StereoRig, content: bytes) -> None:
    (tmp_path / "a.mp4").write_bytes(content)
    with pytest.raises(SourceError, match=r"a\.mp4 cannot be opened as a video"):
        open_source(tmp_path / "a.mp4", rig=rig)


def test_sound_without_pictures(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        frame = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        frame.rate = 8000
        for packet in (*stream.encode(frame), *stream.encode()):
            container.mux(packet)
    with pytest.raises(SourceError, match="holds no video that can be decoded"):
        probe(tmp_path / "a.mkv")


def test_impossible_size(tmp_path: Path, both, monkeypatch: pytest.MonkeyPatch) -> None:
    write_video(tmp_path / "a.mkv", both)
    monkeypatch.setattr(module, "MAX_PIXELS", 1000)
    with pytest.raises(SourceError, match=r"declares 194x61 pixels at .* at most 1000 pixels"):
        probe(tmp_path / "a.mkv")


def test_cut_short_gives_the_whole_frames_and_says_so(tmp_path: Path, both, rig: StereoRig) -> None:
    frames, ticks = 4 * both, [1001 * i for i in range(20)]
    write_video(tmp_path / "a.mkv", frames, ticks)
    data = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "a.mkv").write_bytes(data[: len(data) // 2])
    source = open_source(tmp_path / "a.mkv", rig=rig)
    pairs = list(source)
    assert 5 <= len(pairs) <= 11
    for pair, image in zip(pairs, frames, strict=False):
        np.testing.assert_array_equal(pair.left, image[:, :97])
    assert len(source.warnings) == 1
    assert f"breaks off after {len(pairs)} whole frames: its last frame is at 0." in source.warnings[0]


def test_sound_beside_the_pictures_says_nothing_about_their_end(tmp_path: Path) -> None:
    container = SimpleNamespace(streams=type("Streams", (), {"video": [None], "__len__": lambda _: 2})(), duration=9)
    assert module._cut_short(container, 0) == ""


class Frames:
    """Stands in for PyAV's container: gives the frames it is told to, then the error it is told to."""

    def __init__(self, frames: Sequence[object], error: Exception | None = None) -> None:
        self.streams = type("Streams", (), {"video": [None], "__len__": lambda _: 2})()
        self.frames, self.error = frames, error

    def __enter__(self) -> "Frames":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def decode(self, _: object):
        yield from self.frames
        if self.error:
            raise self.error


def frame(pts: int | None, corrupt: bool = False) -> SimpleNamespace:
    parts = SimpleNamespace(name="gray", components=[SimpleNamespace(bits=8)])
    picture = np.zeros((61, 194), np.uint8)
    return SimpleNamespace(
        pts=pts,
        time_base=TICK,
        is_corrupt=corrupt,
        format=parts,
        to_ndarray=lambda format: picture,  # noqa: A006
    )


@pytest.mark.parametrize(
    ("frames", "error", "warning"),
    [
        ([frame(0), frame(1001, corrupt=True), frame(2002)], None, "left out 1 broken frames"),
        ([frame(0), frame(1001)], "broken packet", "breaks off after 2 whole frames: broken packet"),
    ],
)
def test_broken_frames_are_left_out_and_a_break_ends_the_video(
    tmp_path: Path, monkeypatch, rig, frames, error, warning
) -> None:
    failure = av.error.InvalidDataError(1094995529, error) if error else None
    monkeypatch.setattr(av, "open", lambda *_, **__: Frames(frames, failure))
    source = VideoSource("a", rig, tmp_path / "a.mp4", None, Fraction(1))
    assert len(list(source)) == 2
    assert warning in source.warnings[0]


@pytest.mark.parametrize(
    ("frames", "error", "words"),
    [
        ([], None, r"holds no whole frame \(empty\)"),
        ([], "broken packet", r"holds no whole frame \(broken packet\)"),
        ([frame(None)], None, "frame 0 has no time stamp later than"),
        ([frame(5), frame(5)], None, "frame 1 has no time stamp later than"),
    ],
)
def test_videos_without_frames_or_moments(tmp_path: Path, monkeypatch, rig, frames, error, words: str) -> None:
    failure = av.error.InvalidDataError(1094995529, error) if error else None
    monkeypatch.setattr(av, "open", lambda *_, **__: Frames(frames, failure))
    with pytest.raises(SourceError, match=words):
        list(VideoSource("a", rig, tmp_path / "a.mp4", None, Fraction(1)))


def test_a_frame_of_another_size(tmp_path: Path, monkeypatch, rig_even: StereoRig) -> None:
    monkeypatch.setattr(av, "open", lambda *_, **__: Frames([frame(0)]))
    with pytest.raises(SourceError, match="a frame 0 left is 96x61, but its rig is for 96x60"):
        list(VideoSource("a", rig_even, tmp_path / "a.mp4", None, Fraction(1)))


def test_without_pyav(tmp_path: Path, both, rig: StereoRig, monkeypatch: pytest.MonkeyPatch) -> None:
    write_video(tmp_path / "a.mkv", both)
    true_import = builtins.__import__

    def no_av(name: str, *args: object) -> object:
        if name == "av":
            raise ImportError(name)
        return true_import(name, *args)

    monkeypatch.setattr(builtins, "__import__", no_av)
    with pytest.raises(MissingExtraError, match=r"roadblock\[video\]"):
        open_source(tmp_path / "a.mkv", rig=rig)
