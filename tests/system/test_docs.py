"""The pages do not lie: their Python runs, and their commands exist."""

import contextlib
import io
import re
import shlex
import shutil
from pathlib import Path

import pytest
import typer

from roadblock.cli import app
from roadblock.geometry.pose import pose
from roadblock.io.rig import write_rig
from roadblock.values.camera import Camera, StereoRig

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md")])
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
COMMANDS = ("sh", "bash", "console")


def blocks(page: Path, *languages: str) -> list[str]:
    return [text for language, text in BLOCK.findall(page.read_text("utf-8")) if language in languages]


def with_blocks(*languages: str) -> list[Path]:
    return [page for page in PAGES if blocks(page, *languages)]


def commands(page: Path) -> list[list[str]]:
    """The arguments of each `roadblock ...` in a page's shell blocks."""
    lines = [line for text in blocks(page, *COMMANDS) for line in text.replace("\\\n", " ").splitlines()]
    parts = [part for line in lines for part in re.split(r"&&|;", line.removeprefix("$ "))]
    words = [shlex.split(part, comments=True) for part in parts]
    return [rest for first, *rest in filter(None, words) if first == "roadblock"]


@pytest.fixture
def shown(work: Path, street: Path, roadblock) -> Path:
    """A folder with what the pages speak of: a recording, results, and a rig of two files in squares of 25 mm."""
    shutil.copytree(street, "recording")
    assert roadblock("detect", "recording", "--out", "out").code == 0
    camera = Camera((640, 480), 536.0, 535.0, 342.0, 235.0)
    calibration = StereoRig(camera, camera, pose([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [0.0835, 0, 0]))
    write_rig(calibration, "metres", "ros")
    for name in ("left.yaml", "right.yaml"):
        text = Path("metres", name).read_text()
        squares = re.sub(r"-44\.\d+", lambda match: repr(float(match[0]) / 0.025), text)
        Path("calibration").mkdir(exist_ok=True)
        Path("calibration", name).write_text(squares)
    return work


def test_the_pages_are_there() -> None:
    assert {"README.md", "sources.md", "rigs.md", "results.md", "bad-input.md"} <= {page.name for page in PAGES}
    assert with_blocks("python")
    assert sum(len(commands(page)) for page in PAGES) >= 4


def test_the_front_page_leads_to_every_page() -> None:
    linked = re.findall(r"\]\(([\w/.-]+\.md)\)", (ROOT / "README.md").read_text("utf-8"))
    assert set(linked) >= {page.relative_to(ROOT).as_posix() for page in PAGES if page.parent == ROOT / "docs"}


@pytest.mark.parametrize("page", with_blocks("python"), ids=lambda page: page.name)
def test_python_blocks_run(page: Path, shown: Path) -> None:
    names: dict[str, object] = {"__name__": page.stem}
    for number, text in enumerate(blocks(page, "python"), 1):
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(text, f"{page.name} block {number}", "exec"), names)


@pytest.mark.parametrize("page", with_blocks(*COMMANDS), ids=lambda page: page.name)
def test_commands_exist_with_their_options(page: Path) -> None:
    for arguments in commands(page):
        command, context, rest = typer.main.get_command(app), None, arguments
        while rest is not None:
            context = command.make_context(command.name or "roadblock", list(rest), parent=context)
            rest = None
            if words := [*getattr(context, "_protected_args", ()), *context.args]:
                _, command, rest = command.resolve_command(context, words)


@pytest.mark.parametrize("page", with_blocks(*COMMANDS), ids=lambda page: page.name)
def test_commands_run_where_their_files_are_there(page: Path, shown: Path, roadblock) -> None:
    """In the order of the page; `demo` has tests of its own."""
    for arguments in commands(page):
        needs = [word for word in arguments if word.startswith(("recording", "calibration", "out/"))]
        if arguments[0] == "doctor" or (needs and all(Path(word).exists() for word in needs)):
            ran = roadblock(*arguments)
            assert ran.code == 0, f"roadblock {shlex.join(arguments)}: {ran.err}"
