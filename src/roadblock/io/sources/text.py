"""Small text files beside the images: their lines, and the time stamps in them."""

from datetime import UTC, datetime
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

from roadblock.errors import SourceError

MAX_BYTES = 64 << 20
MAX_STAMP = 64
MIN_STEP_NS = 100_000


def read_lines(path: Path) -> list[tuple[int, str]]:
    """(line number from 1, stripped text) of each line that is neither empty nor a `#` comment.

    Raises
    ------
    SourceError
        If the file cannot be read, is no UTF-8 text, or is larger than 64 MiB.
    """
    try:
        if not path.is_file() or path.stat().st_size > MAX_BYTES:
            raise SourceError(f"{path} is missing, no plain file, or larger than {MAX_BYTES >> 20} MiB: check it")
        lines = path.read_bytes().decode("utf-8-sig").splitlines()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}; check its permissions") from error
    except UnicodeDecodeError as error:
        raise SourceError(f"{path} is no text: byte {error.start} is not UTF-8; check the file") from error
    rows = ((number, line.strip()) for number, line in enumerate(lines, 1))
    return [(number, line) for number, line in rows if line and not line.startswith("#")]


def _to_ns(text: str) -> int:
    """Nanoseconds of one stamp, exact: a date with time, whole nanoseconds, or seconds with a point or exponent."""
    if ":" in text:
        whole, _, fraction = text.partition(".")
        moment = datetime.strptime(whole, "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
        if len(fraction) > 9 or (fraction and not fraction.isdecimal()):
            raise ValueError(text)
        return int(moment.timestamp()) * 10**9 + int(fraction.ljust(9, "0"))
    number = Decimal(text)
    if len(text) > MAX_STAMP or not 0 <= number < 2**63:  # before a number of a million digits is written out
        raise ValueError(text)
    ns = int(number) if text.lstrip("+-").isdecimal() else round(number * 10**9)
    if ns >= 2**63:
        raise ValueError(text)
    return ns


def read_timestamps(path: Path) -> list[int]:
    """Read one time stamp per line as int ns.

    A line is a date and time with up to nine decimals ("2011-09-26 14:05:40.864025856", taken as UTC), a whole number
    of nanoseconds, or seconds with a decimal point or exponent ("1.036224e-01").

    Raises
    ------
    SourceError
        If the file cannot be read, a line is no time stamp, or a stamp does not lie at least 0.1 ms after the one
        before.
    """
    rows = read_lines(path)
    stamps = []
    for number, line in rows:
        try:
            stamps.append(_to_ns(line))
        except (ValueError, ArithmeticError) as error:
            raise SourceError(
                f"{path} line {number} is {line!r:.40}, but must be a time stamp: a date with time, whole nanoseconds, "
                "or seconds with a decimal point"
            ) from error
    check_increasing(path, stamps)
    return stamps


def check_increasing(path: Path, stamps: list[int]) -> None:
    """Check that each stamp lies after the one before.

    Raises
    ------
    SourceError
        If one does not, or lies less than 0.1 ms after it: then the unit is wrong.
    """
    for index, (before, after) in enumerate(pairwise(stamps), 1):
        if after - before < MIN_STEP_NS:
            raise SourceError(
                f"{path}: time stamp {index} lies {after - before} ns after the one before, but frames are at least "
                "0.1 ms apart: put them in order; seconds need a decimal point"
            )
