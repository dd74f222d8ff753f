import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from drawn import obstacle_at, result_of, rig_of

from roadblock.errors import MissingExtraError, OutputError
from roadblock.viz import sinks
from roadblock.viz.overlay import draw_overlay
from roadblock.viz.sinks import TIME_BASE, PictureSink, VideoSink, _Clock

av = pytest.importorskip("av")


def write_frames(sink, count: int, step_ns: int = 100_000_000, start_ns: int = 10**18) -> None:
    """Write frames that grow brighter, so that they can be told apart."""
    rig = rig_of(161, 91)
    for i in range(count):
        image = np.full((91, 161), 20 + 8 * i, np.uint8)
        sink.write(image, result_of(rig, obstacle_at(rig, 0, 9.0), index=i, t_ns=start_ns + i * step_ns), rig)


def read_video(path: Path) -> tuple[list[float], list[np.ndarray]]:
    with av.open(str(path)) as container:
        frames = list(container.decode(video=0))
    return [float(frame.pts * frame.time_base) for frame in frames], [f.to_ndarray(format="rgb24") for f in frames]


def test_pictures_are_the_overlays(tmp_path, rig, image):
    result = result_of(rig, obstacle_at(rig, 0, 9.0))
    with PictureSink(tmp_path / "new" / "overlay") as sink:
        sink.write(image, result, rig)
    assert [path.name for path in (tmp_path / "new" / "overlay").iterdir()] == ["000007.png"]
    stored = cv2.imread(str(tmp_path / "new" / "overlay" / "000007.png"))
    assert np.array_equal(stored[..., ::-1], draw_overlay(image, result, rig))


@pytest.mark.parametrize(
    ("names", "files"),
    [
        (("a/b", "c\\d e"), {"a_b.png", "c_d_e.png"}),
        (("../../x", ".hidden"), {"_.._x.png", "hidden.png"}),
        (("same", "same", "same"), {"same.png", "same_000001.png", "same_000002.png"}),
        (("", "x" * 500), {"_000000.png", "x" * 100 + ".png"}),
        (("a_000001", "a", "a"), {"a_000001.png", "a.png", "a_000002.png"}),
    ],
)
def test_every_name_becomes_a_file_of_its_own_in_the_folder(tmp_path, names, files):
    rig = rig_of(97, 61)
    with PictureSink(tmp_path) as sink:
        for index, name in enumerate(names):
            sink.write(np.zeros((61, 97), np.uint8), result_of(rig, index=index, name=name), rig)
    assert {path.name for path in tmp_path.iterdir()} == files


def test_picture_that_cannot_be_written_is_told(tmp_path, rig, image):
    (tmp_path / "000007.png").mkdir()
    with PictureSink(tmp_path) as sink, pytest.raises(OutputError, match=r"cannot write .*000007\.png"):
        sink.write(image, result_of(rig), rig)
    assert [path.name for path in tmp_path.iterdir()] == ["000007.png"]


@pytest.mark.parametrize("sink", [PictureSink, VideoSink])
def test_folder_that_cannot_be_made_is_told(tmp_path, sink):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        sink(tmp_path / "file" / "x" / "y").__enter__()


def test_video_carries_the_real_times(tmp_path):
    with VideoSink(tmp_path / "new" / "overlay.mp4") as sink:
        write_frames(sink, 7, step_ns=103_141_593)
    times, frames = read_video(tmp_path / "new" / "overlay.mp4")
    assert times == pytest.approx([0.103141593 * i for i in range(7)], abs=2 * float(TIME_BASE))
    assert all(size % 2 == 0 for size in frames[0].shape[:2])
    levels = [float(frame[60:80, 20:60].mean()) for frame in frames]
    assert np.diff(levels).min() > 3


def test_video_pictures_are_the_overlays(tmp_path):
    with VideoSink(tmp_path / "overlay.mp4") as sink:
        write_frames(sink, 2)
    rig = rig_of(161, 91)
    expected = draw_overlay(np.full((91, 161), 20, np.uint8), result_of(rig, obstacle_at(rig, 0, 9.0)), rig)
    height, width = expected.shape[:2]
    got = read_video(tmp_path / "overlay.mp4")[1][0][:height, :width]
    assert np.abs(got.astype(int) - expected).mean() < 6


def test_video_at_a_given_rate(tmp_path):
    with VideoSink(tmp_path / "overlay.mp4", fps=25) as sink:
        write_frames(sink, 4, step_ns=0)
    assert read_video(tmp_path / "overlay.mp4")[0] == pytest.approx([0, 0.04, 0.08, 0.12], abs=1e-4)


def test_clock_always_grows():
    clock = _Clock(None)
    moments = [5_000_000_000, 5_200_000_000, 5_200_000_000, 4_000_000_000, 4_000_000_001, 4_050_000_001]
    ticks = [clock.tick(t) for t in moments]
    assert [tick / TIME_BASE.denominator for tick in ticks] == pytest.approx([0, 0.2, 0.3, 0.4, 0.5, 0.55])


def test_no_frames_leave_no_video(tmp_path):
    with VideoSink(tmp_path / "overlay.mp4"):
        pass
    assert list(tmp_path.iterdir()) == []


KILLED = """
import os, sys
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from roadblock.viz import sinks
from test_sinks import write_frames
sinks.CODECS = sinks.CODECS[int(sys.argv[3]):]
with sinks.VideoSink(Path(sys.argv[1])) as sink:
    write_frames(sink, 12)
    os._exit(3)
"""


@pytest.mark.parametrize("codec", range(len(sinks.CODECS)))
def test_killed_video_plays(tmp_path, codec):
    path = tmp_path / "overlay.mp4"
    command = [sys.executable, "-c", KILLED, str(path), str(Path(__file__).parent), str(codec)]
    assert subprocess.run(command, timeout=60, check=False).returncode == 3
    times, _ = read_video(path)
    assert len(times) >= 11
    assert times == pytest.approx([0.1 * i for i in range(len(times))], abs=1e-4)


def test_build_without_the_best_encoder_takes_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr(sinks, "CODECS", (("no_such_codec", {}), sinks.CODECS[1]))
    with VideoSink(tmp_path / "overlay.mp4") as sink:
        write_frames(sink, 3)
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == 3


def test_build_without_any_encoder_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(sinks, "CODECS", (("no_such_codec", {}),))
    with VideoSink(tmp_path / "overlay.mp4") as sink, pytest.raises(OutputError, match="encoders no_such_codec"):
        write_frames(sink, 1)


def test_missing_library_is_told_with_its_install_line(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'roadblock\[video\]'"):
        VideoSink(tmp_path / "overlay.mp4").__enter__()


def test_video_that_cannot_be_opened_is_told(tmp_path):
    (tmp_path / "overlay.mp4").mkdir()
    with VideoSink(tmp_path / "overlay.mp4") as sink, pytest.raises(OutputError, match=r"cannot write .*overlay\.mp4"):
        write_frames(sink, 1)


def test_change_of_size_is_told_and_the_video_stays_whole(tmp_path, rig, image):
    with VideoSink(tmp_path / "overlay.mp4") as sink:
        write_frames(sink, 3)
        with pytest.raises(OutputError, match="frame 000007 draws as"):
            sink.write(image, result_of(rig), rig)
    assert len(read_video(tmp_path / "overlay.mp4")[0]) == 3


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_full_disk_is_told():
    with pytest.raises(OutputError, match="cannot write /dev/full"), VideoSink(Path("/dev/full")) as sink:
        write_frames(sink, 3)


class Full:
    """Stands for a container whose disk fills up at the end."""

    def mux(self, packets) -> None:
        raise av.error.FFmpegError(28, "No space left on device")


def test_end_that_cannot_be_written_is_told(tmp_path):
    sink = VideoSink(tmp_path / "overlay.mp4")
    sink.__enter__()
    write_frames(sink, 2)
    real, sink._container = sink._container, Full()
    with pytest.raises(OutputError, match="No space left on device"):
        sink.__exit__(None, None, None)
    real.close()
