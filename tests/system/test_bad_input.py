"""Each kind of bad input gives the one line that `docs/bad-input.md` promises, and nothing half done."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest
from bad_inputs import BAD, Bad

from roadblock.io.results import read_results

PAGE = Path(__file__).parents[2] / "docs/bad-input.md"
KINDS = [bad for area in BAD.values() for bad in area]


def table_of(page: str) -> dict[str, dict[str, tuple[str, str]]]:
    """Area -> what is wrong -> (command, line), as the page has it."""
    areas: dict[str, dict[str, tuple[str, str]]] = {}
    for line in page.splitlines():
        if line.startswith("## "):
            areas[area := line[3:]] = {}
        elif line.startswith("| ") and not line.startswith(("| what", "| ---")):
            what, command, says = (cell.strip() for cell in line.strip("|").split("|"))
            areas[area][what] = command.strip("`") or Bad._field_defaults["command"], says.strip("` ")
    return {area: rows for area, rows in areas.items() if rows}


PROMISED = table_of(PAGE.read_text("utf-8"))


def test_the_page_lists_what_is_tested() -> None:
    shown = {area: [(what, command) for what, (command, _) in rows.items()] for area, rows in PROMISED.items()}
    assert shown == {area: [(bad.what, bad.command) for bad in bads] for area, bads in BAD.items()}
    assert len(KINDS) == len({bad.what for bad in KINDS}) > 100


@pytest.mark.parametrize("bad", KINDS, ids=lambda bad: bad.what.replace("`", ""))
def test_bad_input_gives_one_line(
    bad: Bad, work: Path, small_street: Path, street: Path, boards: Path, roadblock
) -> None:
    shutil.copytree(small_street, "recording")
    Path("street").symlink_to(street)
    Path("boards").symlink_to(boards)
    bad.spoil()
    before = {path: path.read_bytes() for path in work.rglob("*") if path.is_file()}

    ran = roadblock(*shlex.split(bad.command))

    assert (ran.code, ran.out) == (2, "")
    lines = [line for line in ran.err.splitlines() if not line.startswith("libpng ")]  # the picture library's own
    assert len(lines) == 1
    says = next(rows[bad.what] for rows in PROMISED.values() if bad.what in rows)[1]
    assert len(says.replace("…", "")) > 30
    assert re.fullmatch(re.escape("error: " + says).replace("…", ".+"), lines[0]), f"{lines[0]}\nis not\n{says}"

    results = Path("results")
    if results.exists():
        assert {path.name for path in results.iterdir()} == {"obstacles.jsonl", "run.json"}
        assert len(read_results(results / "obstacles.jsonl")) == bad.whole_lines
        run = json.loads((results / "run.json").read_text())
        assert (run["frames_written"], run["interrupted"]) == (bad.whole_lines, True)
    after = {path: path.read_bytes() for path in work.rglob("*") if path.is_file() and results not in path.parents}
    assert after.keys() - before.keys() <= {work / "results" / name for name in ("obstacles.jsonl", "run.json")}
    assert before.items() <= after.items()
