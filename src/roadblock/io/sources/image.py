"""One image file in, one grey or RGB array out; refuses what is broken, huge or no image, before decoding it."""

import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from roadblock.errors import SourceError
from roadblock.values.frame import Image

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".pnm", ".webp")
MAX_PIXELS = 100_000_000
MAX_BYTES = 1 << 30
HEAD_BYTES = 1 << 16
MAX_SEGMENTS = 10_000

Size = tuple[int, int]
"""(width, height) in pixels."""


def _png_size(data: bytes) -> Size:
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _bmp_size(data: bytes) -> Size:
    width, height = struct.unpack_from("<ii", data, 18)
    return width, abs(height)  # a negative height only says that the rows run downwards


def _jpeg_size(data: bytes) -> Size:
    at = 2
    for _ in range(MAX_SEGMENTS):
        mark, kind, length = struct.unpack_from(">BBH", data, at)
        if mark != 0xFF:
            raise ValueError("no segment where one must start")
        if kind == 0xFF:  # fill byte
            at += 1
            continue
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):  # start of frame
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        at += 2 + length
    raise ValueError("no start of frame")


def _pnm_size(data: bytes) -> Size:
    words = re.sub(rb"#[^\n]*", b"", data[2:4096]).split(None, 2)
    return int(words[0]), int(words[1])


def _tiff_size(data: bytes) -> Size:
    order = "<" if data[:2] == b"II" else ">"
    (start,) = struct.unpack_from(f"{order}I", data, 4)
    (count,) = struct.unpack_from(f"{order}H", data, start)
    found = {}
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag, kind = struct.unpack_from(f"{order}HH", data, at)
        if tag in (256, 257):  # ImageWidth, ImageLength
            (found[tag],) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, at + 8)
    return found[256], found[257]


def _webp_size(data: bytes) -> Size:
    kind = data[12:16]
    if kind == b"VP8X":
        return 1 + int.from_bytes(data[24:27], "little"), 1 + int.from_bytes(data[27:30], "little")
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, height = struct.unpack_from("<HH", data, 26)
    return width & 0x3FFF, height & 0x3FFF


def _ends_in(tail: bytes) -> Callable[[bytes], bool]:
    return lambda data: data.rstrip(b"\0").endswith(tail)  # OpenCV 4 fills up a cut JPEG silently


def _any_end(_: bytes) -> bool:
    return True  # the decoder itself refuses these when they are cut short


class Format(NamedTuple):
    """An image format: name, how a file begins, size from its header, whether its end is there."""

    name: str
    begins: re.Pattern[bytes]
    size_of: Callable[[bytes], Size]
    is_whole: Callable[[bytes], bool]


FORMATS = (
    Format("PNG", re.compile(rb"\x89PNG\r\n\x1a\n"), _png_size, _ends_in(b"IEND\xaeB`\x82")),
    Format("JPEG", re.compile(rb"\xff\xd8\xff"), _jpeg_size, _ends_in(b"\xff\xd9")),
    Format("TIFF", re.compile(rb"II\*\0|MM\0\*"), _tiff_size, _any_end),
    Format("BMP", re.compile(rb"BM"), _bmp_size, _any_end),
    Format("PGM/PPM", re.compile(rb"P[2356]\s"), _pnm_size, _any_end),
    Format("WebP", re.compile(rb"RIFF.{4}WEBP", re.DOTALL), _webp_size, _any_end),
)


def _read_bytes(path: Path, limit: int = MAX_BYTES) -> bytes:
    try:
        if not path.is_file():
            raise SourceError(f"{path} is missing or no plain file, but must be an image: check the recording")
        if (size := path.stat().st_size) > MAX_BYTES:
            raise SourceError(f"{path} holds {size} bytes, but an image may hold {MAX_BYTES} at most: check the file")
        with path.open("rb") as file:
            return file.read(limit)
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}; check its permissions") from error


def _format_of(path: Path, data: bytes) -> Format:
    for row in FORMATS:
        if row.begins.match(data):
            return row
    what = f"begins with {data[:8]!r}" if data else "is empty"
    raise SourceError(f"{path} {what}, but must be one of {', '.join(row.name for row in FORMATS)}: check the file")


def _declared_size(path: Path, data: bytes, kind: Format) -> Size:
    try:
        width, height = kind.size_of(data)
    except (struct.error, ValueError, KeyError, IndexError) as error:
        raise SourceError(f"{path} begins as a {kind.name} file, but its header is broken: copy it again") from error
    if not 0 < width * height <= MAX_PIXELS:
        raise SourceError(
            f"{path} declares {width}x{height} pixels, but an image must have between 1 and {MAX_PIXELS} pixels"
        )
    return width, height


def image_size(path: Path) -> Size:
    """(width, height) of an image file, read from its header alone.

    Raises
    ------
    SourceError
        If the file cannot be read, is no image, or declares an impossible size.
    """
    data = _read_bytes(path, HEAD_BYTES)
    kind = _format_of(path, data)
    if kind.name == "TIFF" or (len(data) == HEAD_BYTES and kind.name == "JPEG"):  # theirs may lie anywhere
        data = _read_bytes(path)
    return _declared_size(path, data, kind)


def read_image(path: Path, *, gray: bool = False) -> Image:
    """Read an image file as (height, width) grey or (height, width, 3) RGB, uint8 or uint16; alpha is dropped.

    Parameters
    ----------
    path
        PNG, JPEG, TIFF, BMP, PGM/PPM or WebP; its first bytes decide, not its name.
    gray
        Whether to turn colour into grey.

    Raises
    ------
    SourceError
        If the file cannot be read, is no image, is cut short or broken, declares an impossible size, or holds other
        numbers than 8 or 16 bit unsigned ones.
    """
    data = _read_bytes(path)
    kind = _format_of(path, data)
    if not kind.is_whole(data):
        raise SourceError(f"{path} is a {kind.name} file cut short ({len(data)} bytes): copy it again")
    _declared_size(path, data, kind)
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise SourceError(f"{path} cannot be decoded: it is broken inside; copy it again")
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError(f"{path} holds {image.dtype} pixels, but must be 8 or 16 bit: convert it")
    if image.ndim == 2:
        return image
    if image.shape[2] == 2:  # grey and alpha
        return np.ascontiguousarray(image[..., 0])
    code = cv2.COLOR_BGR2GRAY if gray else cv2.COLOR_BGR2RGB
    return cv2.cvtColor(np.ascontiguousarray(image[..., :3]), code)
