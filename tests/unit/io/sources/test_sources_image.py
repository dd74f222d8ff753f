import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.errors import SourceError
from roadblock.io.sources import image as module
from roadblock.io.sources.image import FORMATS, IMAGE_SUFFIXES, image_size, read_image

LOSSLESS = [s for s in IMAGE_SUFFIXES if s not in (".jpg", ".jpeg", ".webp", ".pgm")]


def encoded(image: np.ndarray, suffix: str, *options: int) -> bytes:
    """The file's bytes, taking colour as BGR."""
    return cv2.imencode(suffix, image, list(options))[1].tobytes()


@pytest.mark.parametrize("suffix", LOSSLESS)
def test_colour_comes_back_as_rgb(tmp_path: Path, images, put, suffix: str) -> None:
    path = tmp_path / f"ünï{suffix}"
    put(path, images[0])
    np.testing.assert_array_equal(read_image(path), images[0])
    assert image_size(path) == (97, 61)


@pytest.mark.parametrize("suffix", [".jpg", ".jpeg", ".webp"])
def test_lossy_colour_keeps_its_channels_in_order(tmp_path: Path, put, suffix: str) -> None:
    image = np.full((61, 97, 3), (200, 90, 20), np.uint8)
    put(tmp_path / f"a{suffix}", image)
    assert np.abs(read_image(tmp_path / f"a{suffix}").astype(int) - image).max() < 12
    assert image_size(tmp_path / f"a{suffix}") == (97, 61)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("suffix", [".png", ".tiff", ".pgm"])
def test_grey_keeps_its_bits(tmp_path: Path, put, dtype, suffix: str) -> None:
    image = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (61, 97)).astype(dtype)
    put(tmp_path / f"a{suffix}", image)
    got = read_image(tmp_path / f"a{suffix}")
    assert got.dtype == dtype
    np.testing.assert_array_equal(got, image)


def test_sixteen_bit_colour(tmp_path: Path, put) -> None:
    image = np.random.default_rng(1).integers(0, 65536, (61, 97, 3)).astype(np.uint16)
    put(tmp_path / "a.png", image)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)


def test_gray_weighs_the_colours(tmp_path: Path, images, put) -> None:
    put(tmp_path / "a.png", images[0])
    expected = images[0] @ np.array([0.299, 0.587, 0.114])
    got = read_image(tmp_path / "a.png", gray=True)
    assert got.shape == (61, 97)
    assert np.abs(got - expected).max() <= 1


def test_alpha_is_dropped(tmp_path: Path, images) -> None:
    bgra = np.dstack([images[0][..., ::-1], images[1][..., 0]])
    (tmp_path / "a.png").write_bytes(encoded(bgra, ".png"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), images[0])


def test_grey_with_alpha_is_grey(tmp_path: Path, images, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.png").write_bytes(encoded(images[0], ".png"))
    monkeypatch.setattr(module.cv2, "imdecode", lambda *_: images[0][..., :2])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), images[0][..., 0])


def webp_lossless(image: np.ndarray) -> bytes:
    return encoded(image, ".webp", cv2.IMWRITE_WEBP_QUALITY, 101)


def test_every_webp_flavour_declares_its_size(tmp_path: Path, images) -> None:
    alpha = np.dstack([images[0], images[1][..., 0]])
    files = {b"VP8 ": encoded(images[0], ".webp", cv2.IMWRITE_WEBP_QUALITY, 50), b"VP8L": webp_lossless(images[0])}
    files[b"VP8X"] = encoded(alpha, ".webp", cv2.IMWRITE_WEBP_QUALITY, 50)
    for flavour, data in files.items():
        assert data[12:16] == flavour
        (tmp_path / "a.webp").write_bytes(data)
        assert image_size(tmp_path / "a.webp") == (97, 61)


def test_big_endian_tiff_with_short_sizes(tmp_path: Path) -> None:
    entries = struct.pack(">HHIHH", 256, 3, 1, 97, 0) + struct.pack(">HHII", 257, 4, 1, 61)
    (tmp_path / "a.tif").write_bytes(b"MM\0*" + struct.pack(">IH", 8, 2) + entries)
    assert image_size(tmp_path / "a.tif") == (97, 61)


def test_jpeg_with_a_long_preface_and_fill_bytes(tmp_path: Path, images) -> None:
    data = encoded(images[0], ".jpg")
    comments = b"\xff\xfe" + struct.pack(">H", 0xFFFF) + bytes(0xFFFD)
    (tmp_path / "a.jpg").write_bytes(data[:2] + 2 * comments + b"\xff" + data[2:])
    assert image_size(tmp_path / "a.jpg") == (97, 61)


def test_bottom_up_and_top_down_bmp(tmp_path: Path, images) -> None:
    data = bytearray(encoded(images[0], ".bmp"))
    data[22:26] = struct.pack("<i", -61)
    (tmp_path / "a.bmp").write_bytes(data)
    assert image_size(tmp_path / "a.bmp") == (97, 61)
    np.testing.assert_array_equal(read_image(tmp_path / "a.bmp"), images[0][::-1, :, ::-1])


def test_pgm_comments_are_passed_over(tmp_path: Path) -> None:
    (tmp_path / "a.pgm").write_bytes(b"P5 # 12 34\n97 #w\n61\n255\n" + bytes(97 * 61))
    assert image_size(tmp_path / "a.pgm") == (97, 61)


def refusal(path: Path) -> str:
    with pytest.raises(SourceError) as caught:
        read_image(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_cut_short(tmp_path: Path, images, suffix: str) -> None:
    data = encoded(images[0], suffix)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(data + bytes(20))
    assert read_image(path).shape == (61, 97, 3)  # padding does no harm
    path.write_bytes(data[: len(data) * 2 // 3])
    assert "cut short" in refusal(path)


@pytest.mark.parametrize("suffix", [".bmp", ".tiff", ".ppm", ".webp"])
def test_cut_short_seen_by_the_decoder(tmp_path: Path, images, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.write_bytes(encoded(images[0], suffix)[:3000])
    refusal(path)


def test_broken_inside(tmp_path: Path, images) -> None:
    data = bytearray(encoded(images[0], ".png"))
    data[len(data) // 2] ^= 255
    (tmp_path / "a.png").write_bytes(data)
    assert "broken inside" in refusal(tmp_path / "a.png")


def test_decoder_error_is_ours(tmp_path: Path, images, put, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise cv2.error("too many pixels")

    put(tmp_path / "a.png", images[0])
    monkeypatch.setattr(module.cv2, "imdecode", fail)
    assert "broken inside" in refusal(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "is empty"),
        (b"not an image at all", "begins with b'not an i'"),
        (b"<svg></svg>", "must be one of PNG, JPEG"),
        (b"BM", "header is broken"),
        (b"P5 wide high 255\n", "header is broken"),
        (b"P6\n# nothing\n", "header is broken"),
        (b"II*\0" + bytes(3), "header is broken"),
        (b"II*\0" + struct.pack("<IH", 8, 0), "header is broken"),
        (b"\xff\xd8\xff\xff\xd9", "header is broken"),
        (b"\xff\xd8\xff\xe0\x00\x02xx\xff\xd9", "header is broken"),
        (b"\xff\xd8\xff\xe0\0\x02x\xc0\0\x08\x08\0\x3d\0\x61\x03\xff\xd9", "header is broken"),
        (b"\xff\xd8" + b"\xff" * 20_000 + b"\xc0\0\x08\x08\0\x3d\0\x61\x03\xff\xd9", "header is broken"),
        (b"BM" + bytes(16) + struct.pack("<ii", 0, 61), "0x61"),
        (b"P5 99999 99999 255\n", "99999x99999"),
        (b"RIFFxxxxWEBPVP8X" + bytes(8) + b"\xff" * 6, "16777216x16777216"),
    ],
)
def test_no_image(tmp_path: Path, data: bytes, words: str) -> None:
    (tmp_path / "a.png").write_bytes(data)
    assert words in refusal(tmp_path / "a.png")


def test_a_bomb_is_refused_before_it_is_decoded(tmp_path: Path, images, monkeypatch: pytest.MonkeyPatch) -> None:
    data = bytearray(encoded(images[0], ".png"))
    data[16:24] = struct.pack(">II", 40_000, 40_000)
    (tmp_path / "a.png").write_bytes(data)
    monkeypatch.setattr(module.cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    assert "40000x40000" in refusal(tmp_path / "a.png")


def test_float_pixels(tmp_path: Path) -> None:
    (tmp_path / "a.tiff").write_bytes(encoded(np.zeros((61, 97), np.float32), ".tiff"))
    assert "float32" in refusal(tmp_path / "a.tiff")


def test_missing_folder_and_pipe(tmp_path: Path) -> None:
    (tmp_path / "folder.png").mkdir()
    os.mkfifo(tmp_path / "pipe.png")
    for name in ("missing.png", "folder.png", "pipe.png"):
        assert "no plain file" in refusal(tmp_path / name)


def test_huge_file(tmp_path: Path) -> None:
    with (tmp_path / "a.png").open("wb") as file:
        file.truncate(module.MAX_BYTES + 1)  # sparse: takes no room
    assert "1073741825 bytes" in refusal(tmp_path / "a.png")


def test_unreadable(tmp_path: Path, images, put, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    put(tmp_path / "a.png", images[0])
    monkeypatch.setattr(Path, "open", fail)
    assert "Permission denied" in refusal(tmp_path / "a.png")


def test_formats_are_told_by_content_not_by_name(tmp_path: Path, images) -> None:
    (tmp_path / "a.jpg").write_bytes(encoded(images[0], ".png"))
    np.testing.assert_array_equal(read_image(tmp_path / "a.jpg"), images[0][..., ::-1])
    assert len({row.name for row in FORMATS}) == len(FORMATS)
