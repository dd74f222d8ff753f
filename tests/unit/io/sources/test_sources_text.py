from pathlib import Path

import pytest

from roadblock.errors import SourceError
from roadblock.io.sources import text as module
from roadblock.io.sources.text import read_lines, read_timestamps


def stamps(tmp_path: Path, content: str) -> list[int]:
    path = tmp_path / "timestamps.txt"
    path.write_text(content)
    return read_timestamps(path)


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        # date -u -d "2011-09-26 14:05:40" +%s gives 1317045940
        ("2011-09-26 14:05:40.864025856\n2011-09-26 14:05:41\n", [1317045940864025856, 1317045941000000000]),
        ("2011-09-26 14:05:40.5\n", [1317045940500000000]),
        ("1403636579763555584\n1403636579813555456\n", [1403636579763555584, 1403636579813555456]),
        ("0.000000e+00\n1.036224e-01\n", [0, 103622400]),
        ("\n# seconds\n1403636579.763555584\n", [1403636579763555584]),
        ("", []),
    ],
)
def test_stamps_are_exact(tmp_path: Path, content: str, expected: list[int]) -> None:
    assert stamps(tmp_path, content) == expected


@pytest.mark.parametrize(
    "bad",
    ["soon", "nan", "inf", "1e999999999", "-1.0", "-5", "2011-13-26 14:05:40", "14:05:40", "1 2", "9" * 30,
     "2011-09-26 14:05:40.1234567891", "2011-09-26 14:05:40.x", "9.3e9", "0.5" + 70 * "0", "1e999990"],
)  # fmt: skip
def test_no_time_stamp(tmp_path: Path, bad: str) -> None:
    with pytest.raises(SourceError, match=r"line 2 is .* must be a time stamp"):
        stamps(tmp_path, f"0.5\n{bad}\n")


def test_order_and_unit(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="time stamp 2 lies -500000000 ns after"):
        stamps(tmp_path, "0.5\n1.5\n1.0\n")
    with pytest.raises(SourceError, match="seconds need a decimal point"):
        stamps(tmp_path, "1\n2\n3\n")


def test_text_files_that_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "a.txt"
    with pytest.raises(SourceError, match="missing"):
        read_lines(path)
    path.write_bytes(b"\x80\x81")
    with pytest.raises(SourceError, match="is no text: byte 0"):
        read_lines(path)
    with path.open("wb") as file:
        file.truncate(module.MAX_BYTES + 1)
    with pytest.raises(SourceError, match="larger than 64 MiB"):
        read_lines(path)

    def fail(*_: object) -> None:
        raise PermissionError(13, "Permission denied")

    path.write_text("x")
    monkeypatch.setattr(Path, "read_bytes", fail)
    with pytest.raises(SourceError, match="Permission denied"):
        read_lines(path)
