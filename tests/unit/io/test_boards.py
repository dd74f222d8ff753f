from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.errors import SourceError
from roadblock.io import boards as module
from roadblock.io.boards import BoardVideo, open_board_images
from roadblock.io.sources.video import count_frames


def picture(value: int, size_px=(97, 61), dtype=np.uint8) -> np.ndarray:
    """Grey, the same nowhere else."""
    rng = np.random.default_rng(value)
    return rng.integers(0, 200, size_px[::-1]).astype(dtype)


def put(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(cv2.imencode(path.suffix, image)[1].tobytes())


def put_all(folder: Path, names: str, size_px=(97, 61), first: int = 0) -> None:
    for number, name in enumerate(names.split()):
        put(folder / name, picture(first + number, size_px))


@pytest.fixture
def shots(tmp_path: Path) -> Path:
    """Three pairs in one folder, and a left and a right one alone."""
    put_all(tmp_path / "shots", "left1.png left2.png left10.png left4.png")
    put_all(tmp_path / "shots", "right01.png right02.png right10.png right7.png", first=20)
    return tmp_path / "shots"


def test_one_folder_with_left_and_right_in_the_names(shots: Path) -> None:
    images = open_board_images(str(shots))
    assert (images.size_px, images.length, images.is_video, images.warnings) == ((97, 61), 5, False, [])
    for _ in range(2):
        seen = list(images)
        assert [shot.name for shot in seen] == ["left1", "left2", "left4", "right7", "left10"]
        assert [(shot.left is None, shot.right is None) for shot in seen] == (
            [(False, False), (False, False), (False, True), (True, False), (False, False)]
        )
        np.testing.assert_array_equal(seen[4].left, picture(2))
        np.testing.assert_array_equal(seen[4].right, picture(22))


def test_globs_folders_and_single_pictures(shots: Path, tmp_path: Path, monkeypatch) -> None:
    for left, right in ((f"{shots}/left*.png", f"{shots}/right*"), (f"{shots}/left1.png", f"{shots}/right01.png")):
        first = next(iter(open_board_images(left, right)))
        np.testing.assert_array_equal(first.left, picture(0))
        np.testing.assert_array_equal(first.right, picture(20))
    monkeypatch.chdir(tmp_path)
    assert open_board_images("shots/left*", "shots/right*").length == 5
    put_all(tmp_path / "both/cam0", "a.png b.png")
    put_all(tmp_path / "both/cam1", "b.png c.png", first=9)
    for spec in (("both",), ("both/cam0", "both/cam1")):
        seen = list(open_board_images(*spec))
        assert [(shot.name, shot.left is None, shot.right is None) for shot in seen] == (
            [("a", False, True), ("b", False, False), ("c", True, False)]
        )


def test_a_glob_of_a_name_with_brackets_that_is_there(tmp_path: Path) -> None:
    put_all(tmp_path / "shots [1]/left", "1.png")
    put_all(tmp_path / "shots [1]/right", "1.png", first=3)
    assert open_board_images(str(tmp_path / "shots [1]")).length == 1


def test_side_by_side_pictures(tmp_path: Path) -> None:
    put_all(tmp_path / "both", "s1.png s2.png", (194, 61))
    images = open_board_images(str(tmp_path / "both"))
    assert images.size_px == (97, 61)
    seen = list(images)
    assert [shot.name for shot in seen] == ["s1", "s2"]
    np.testing.assert_array_equal(np.hstack([seen[1].left, seen[1].right]), picture(1, (194, 61)))


def test_colour_and_deep_pictures_become_8_bit_grey(tmp_path: Path) -> None:
    colour = np.zeros((61, 97, 3), np.uint8)
    colour[..., 2] = np.arange(97)  # red, as OpenCV counts
    twelve_bits = 10 * picture(3).astype(np.uint16)
    put(tmp_path / "left1.png", colour)
    put(tmp_path / "right1.png", twelve_bits)
    shot = next(iter(open_board_images(str(tmp_path))))
    assert (shot.left.dtype, shot.left.shape, shot.right.dtype) == (np.uint8, (61, 97), np.uint8)
    assert np.abs(shot.left - 0.299 * np.arange(97)).max() <= 1
    assert shot.right.max() == 255
    assert np.abs(shot.right - twelve_bits * (255 / twelve_bits.max())).max() <= 0.5
    assert np.array_equal(module._eight_bit(np.zeros((2, 2), np.uint16)), np.zeros((2, 2)))


@pytest.mark.parametrize(
    ("names", "arguments", "words"),
    [
        ("", ("nowhere",), r"there is no 'nowhere': give a folder, a quoted glob"),
        ("", ("nowhere*.png",), r"nowhere\*\.png matches no images: check the pattern"),
        ("a/left1.png", ("a", "b"), "there is no 'b'"),
        ("a/left1.png b/note.txt", ("a", "b"), "b holds no images"),
        ("a/left1.png b/note.txt", ("a", "b/note.txt"), r"note\.txt is no picture and no video"),
        ("a/left1.png a/left2.png", ("a",), r"a holds left images only \(left1\.png \.\.\.\)"),
        ("a/x_right1.png", ("a",), "a holds right images only"),
        ("a/left1.png a/right1.png a/room.png", ("a",), r"images of left, of right, and others \(room\.png\)"),
        ("a/left1.png a/right1.png", ("a", "a"), r"a and a both hold left1\.png"),
        ("a/1.png b/2.png", ("a", "b"), r"no image of a \(1\.png \.\.\.\) has a partner in b .* paired by number"),
        ("a/1.png b/1.png a/1.bmp", ("a", "b"), "claim the same frame"),
        ("a/1.png", ("a",), "a is 97x61, which is not two views side by side"),
        ("a/left/1.png a/right/1.png a/l/1.png a/r/1.png", ("a",), "a holds several pairs of folders"),
        ("a/1.png b/1.png", ("a", "b"), r"a/1\.png and b/1\.png hold the very same picture"),
    ],
)
def test_what_cannot_be_opened(tmp_path: Path, monkeypatch, names: str, arguments: tuple[str], words: str) -> None:
    monkeypatch.chdir(tmp_path)
    for name in names.split():
        if name.endswith("txt"):
            Path(name).parent.mkdir(exist_ok=True)
            Path(name).touch()
        else:
            put(Path(name), picture(1))
    with pytest.raises(SourceError, match=words):
        list(open_board_images(*arguments))


def test_sizes(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    put(Path("a/1.png"), picture(1))
    put(Path("a/2.png"), picture(1, (95, 61)))
    put(Path("b/1.png"), picture(2, (96, 61)))
    with pytest.raises(SourceError, match=r"a/2\.png is 95x61, but 1\.png is 97x61: .* one size"):
        open_board_images("a", "b")
    Path("a/2.png").unlink()
    with pytest.raises(SourceError, match="a holds 97x61 images, b 96x61 ones"):
        open_board_images("a", "b")
    put(Path("c/1.png"), picture(2, (195, 61)))
    with pytest.raises(SourceError, match="c is 195x61, which is not two views"):
        open_board_images("c")


def test_a_picture_that_is_cut_short_is_named_when_it_is_read(shots: Path) -> None:
    path = shots / "right02.png"
    path.write_bytes(path.read_bytes()[:2000])
    images = open_board_images(str(shots))
    with pytest.raises(SourceError, match=r"right02\.png is a PNG file cut short"):
        list(images)


def test_a_folder_that_cannot_be_read(shots: Path, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied", "shots")

    monkeypatch.setattr(module, "list_images", refuse)
    with pytest.raises(SourceError, match="shots cannot be read: Permission denied"):
        open_board_images(str(shots))


# Videos


def film(path: Path, frames: list[np.ndarray], start: int = 0) -> None:
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        stream = container.add_stream("ffv1", rate=30)
        stream.height, stream.width = frames[0].shape
        stream.pix_fmt = "gray"
        stream.codec_context.time_base = Fraction(1, 30)
        for index, image in enumerate(frames, start):
            frame = av.VideoFrame.from_ndarray(image, format="gray")
            frame.pts, frame.time_base = index, Fraction(1, 30)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def test_a_side_by_side_video_is_looked_at_in_twos(tmp_path: Path) -> None:
    frames = [picture(i, (194, 62)) for i in range(30)]
    film(tmp_path / "a.mkv", frames)
    images = open_board_images(str(tmp_path / "a.mkv"), every=10)
    assert (images.size_px, images.length, images.is_video) == ((97, 62), 6, True)
    for _ in range(2):
        seen = list(images)
        assert [(shot.name, shot.index) for shot in seen] == [(f"frame {i}", i) for i in (0, 1, 10, 11, 20, 21)]
        np.testing.assert_array_equal(np.hstack([seen[3].left, seen[3].right]), frames[11])
    assert open_board_images(str(tmp_path / "a.mkv"), every=1).length == 30
    assert count_frames(tmp_path / "a.mkv") == 30


@pytest.mark.parametrize(("frames", "every"), [(0, 1), (100, 1), (200, 2), (201, 3), (1000, 10), (5000, 50)])
def test_about_200_frames_are_looked_at(tmp_path: Path, monkeypatch, frames: int, every: int) -> None:
    film(tmp_path / "a.mkv", [picture(1, (194, 62))])
    monkeypatch.setattr(module, "count_frames", lambda _: frames)
    images = open_board_images(str(tmp_path / "a.mkv"))
    assert isinstance(images, BoardVideo)
    assert (images.every, images.length <= module.MOST_FRAMES + 2) == (every, True)


def test_two_videos_are_paired_by_time(tmp_path: Path) -> None:
    film(tmp_path / "left.mkv", [picture(i) for i in range(5)])
    film(tmp_path / "right.mkv", [picture(50 + i) for i in range(1, 5)], start=1)
    left, right = str(tmp_path / "left.mkv"), str(tmp_path / "right.mkv")
    for spec in ((left, right), (str(tmp_path),), (f"{left},{right}",)):
        images = open_board_images(*spec)
        seen = list(images)
        assert images.warnings == ["left out 1 left and 0 right frames that have no partner in time"]
        assert len(seen) == 4
        np.testing.assert_array_equal(seen[0].left, picture(1))
        np.testing.assert_array_equal(seen[0].right, picture(51))


def test_videos_that_cannot_be(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    film(Path("a.mkv"), [picture(1)])
    film(Path("b.mkv"), [picture(1, (95, 61))])
    film(Path("c.mkv"), [picture(1)])
    put_all(Path("shots"), "1.png")
    for arguments, words in (
        (("a.mkv",), "a.mkv is 97x61, which is not two views side by side"),
        (("a.mkv", "a.mkv"), "a.mkv is given for both cameras"),
        (("a.mkv", "b.mkv"), "a.mkv is 97x61, b.mkv 95x61"),
        (("a.mkv", "shots"), "a.mkv and shots are a video and no video"),
        (("a.mkv", "c.mkv"), "a.mkv and c.mkv hold the very same picture"),
    ):
        with pytest.raises(SourceError, match=words):
            list(open_board_images(*arguments))


def test_frames_of_what_is_no_video_cannot_be_counted(tmp_path: Path) -> None:
    pytest.importorskip("av")
    (tmp_path / "a.mp4").write_bytes(b"nothing")
    assert count_frames(tmp_path / "a.mp4") == 0
