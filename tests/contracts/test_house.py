"""House rules that no linter keeps."""

import ast
from pathlib import Path

import pytest

import roadblock

SOURCES = sorted(Path(roadblock.__file__).parent.rglob("*.py"))
LONGEST = 60


def lines_of(function: ast.FunctionDef) -> int:
    """Count the lines of a function without decorators and docstring."""
    assert function.end_lineno is not None
    body = function.body[0]
    documented = (
        isinstance(body, ast.Expr) and isinstance(body.value, ast.Constant) and isinstance(body.value.value, str)
    )
    docstring = body.end_lineno - body.lineno + 1 if documented and body.end_lineno is not None else 0
    return function.end_lineno - function.lineno + 1 - docstring


def is_kernel(function: ast.FunctionDef) -> bool:
    return any("njit" in ast.unparse(decorator) for decorator in function.decorator_list)


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: "/".join(path.parts[-2:]))
def test_functions_are_short(path: Path) -> None:
    functions = [node for node in ast.walk(ast.parse(path.read_text("utf-8"))) if isinstance(node, ast.FunctionDef)]
    long = {f.name: lines_of(f) for f in functions if not is_kernel(f) and lines_of(f) > LONGEST}
    assert not long


def test_length_is_counted_without_docstring() -> None:
    function = ast.parse('def f():\n    """Say.\n\n    More.\n    """\n    a = 1\n    return a\n').body[0]
    assert isinstance(function, ast.FunctionDef)
    assert lines_of(function) == 3


def importers(library: str) -> set[str]:
    """Return the files that import a library."""
    found = set()
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.partition(".")[0] == library for name in names):
                found.add(path.name)
    return found


def test_the_video_library_has_one_door_in_and_one_out() -> None:
    assert importers("av") == {"video.py", "sinks.py"}


def test_the_network_library_has_one_door() -> None:
    assert importers("onnxruntime") == {"session.py"}


def test_settings_reach_no_further_than_the_stages() -> None:
    """Pydantic builds settings and checks foreign files; values stay plain dataclasses."""
    assert not {path.name for path in SOURCES if path.parent.name == "values"} & importers("pydantic")
