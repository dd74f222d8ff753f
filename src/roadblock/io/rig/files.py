"""What all rig formats share: guarded reading of small text files, and writing whole files or nothing."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from roadblock.errors import OutputError, RigError, RoadblockError

MAX_BYTES = 1_000_000
MAX_DEPTH = 16
_LOADER = yaml.CBaseLoader if yaml.__with_libyaml__ else yaml.BaseLoader
"""The base loader keeps every scalar as text: YAML 1.1's octal 010, sexagesimal 1:30 and `1e3` cannot surprise."""

_OPENCV_TAGS = ("tag:yaml.org,2002:opencv-matrix", "tag:yaml.org,2002:opencv-nd-matrix")


@dataclass(frozen=True)
class Asked:
    """What the caller adds to a file.

    Attributes
    ----------
    unit_m
        Metres per unit of the file's lengths, on top of the format's own unit.
    size_px
        (width, height) of the images, where the file does not say or describes several.
    pair
        Numbers of the left and right camera, where the file holds more than two.
    """

    unit_m: float = 1.0
    size_px: tuple[int, int] | None = None
    pair: tuple[int, int] | None = None


@contextmanager
def named(paths: tuple[Path, ...]) -> Iterator[None]:
    """Put the files' names before whatever is wrong with them.

    Raises
    ------
    RigError
        In place of every RoadblockError raised inside.
    """
    try:
        yield
    except RoadblockError as error:
        raise RigError(f"{' + '.join(path.name or str(path) for path in paths)}: {error}") from error


def read_text(path: Path) -> str:
    """Return the text of a small UTF-8 file.

    Raises
    ------
    RigError
        If it is missing, a folder, unreadable, empty, larger than `MAX_BYTES` or no text.
    """
    try:
        if path.is_dir():
            raise RigError("is a folder, but a rig file was expected")
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise RigError(f"there is no such file ({path})") from error
    except (OSError, ValueError) as error:
        raise RigError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > MAX_BYTES:
        raise RigError(f"is larger than {MAX_BYTES // 1000} kB, but a rig file is a small text: is it a recording?")
    if not data.strip():
        raise RigError("is empty, but a rig file was expected")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise RigError("is no text (not UTF-8), but a rig file was expected") from error
    if "\0" in text:
        raise RigError("is no text (it holds zero bytes), but a rig file was expected")
    return text


def parse_yaml(text: str) -> dict[str, Any]:
    """Return a YAML mapping with every scalar as text; OpenCV's own tags and first line are let pass.

    Raises
    ------
    RigError
        If it is no YAML, no mapping, repeats a key, or uses aliases, other tags or deep nesting.
    """
    if text.startswith("%YAML"):
        text = "#" + text
    try:
        _refuse_tricks(text)
        document = yaml.load(text, Loader=_LOADER)  # noqa: S506 - builds text, lists and mappings only
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        what = getattr(error, "problem", None) or str(error).splitlines()[0]
        if "nesting depth" in what:  # the parser's own limit, in recent versions
            raise RigError(f"is nested deeper than {MAX_DEPTH} levels{where}: this is no rig file") from error
        raise RigError(f"is not valid YAML: {what}{where} (truncated?)") from error
    if not isinstance(document, dict):
        raise RigError(f"must hold names with values, but holds {_kind(document)}")
    return document


def _refuse_tricks(text: str) -> None:
    """Refuse what a rig file never needs and a hostile one lives on, before anything is built."""
    open_nodes: list[tuple[bool, list[str | None]]] = []
    for event in yaml.parse(text, Loader=_LOADER):
        if isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            is_mapping, children = open_nodes.pop()
            keys = Counter(children[::2] if is_mapping else ())
            twice = [key for key, count in keys.items() if count > 1]
            if twice:
                raise RigError(f"says {twice[0]!r} more than once in one place: keep one")
        if not isinstance(event, yaml.NodeEvent):
            continue
        line = event.start_mark.line + 1 if event.start_mark else 0
        if event.anchor is not None:
            raise RigError(f"uses a YAML anchor or alias at line {line}, which rig files do not need: write it out")
        tag = getattr(event, "tag", None)
        if tag is not None and tag not in _OPENCV_TAGS:
            raise RigError(f"uses the YAML tag {tag!r:.60} at line {line}, which rig files do not need: remove it")
        if open_nodes:
            open_nodes[-1][1].append(event.value if isinstance(event, yaml.ScalarEvent) else None)
        if isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            open_nodes.append((isinstance(event, yaml.MappingStartEvent), []))
            if len(open_nodes) > MAX_DEPTH:
                raise RigError(f"is nested deeper than {MAX_DEPTH} levels at line {line}: this is no rig file")


def _kind(value: object) -> str:
    kinds: tuple[tuple[type, str], ...] = ((dict, "names with values"), (list, "a list"), (str, "a single text"))
    return next((words for kind, words in kinds if isinstance(value, kind)), "nothing")


def entry(mapping: Mapping[str, Any], key: str, where: str = "") -> Any:
    """Return `mapping[key]`.

    Raises
    ------
    RigError
        If it is missing.
    """
    if key not in mapping:
        raise RigError(f"{where}{key} is missing (found: {', '.join(map(str, mapping)) or 'nothing'})"[:300])
    return mapping[key]


def section(mapping: Mapping[str, Any], key: str, where: str = "") -> dict[str, Any]:
    """Return the mapping `mapping[key]`.

    Raises
    ------
    RigError
        If it is missing or no mapping.
    """
    value = entry(mapping, key, where)
    if not isinstance(value, dict):
        raise RigError(f"{where}{key} must hold names with values, but holds {_kind(value)} ({value!r:.40})")
    return value


def write_whole(contents: Mapping[Path, str]) -> list[Path]:
    """Write text files so that each is there whole or not at all, replacing what was there; return their paths.

    Raises
    ------
    OutputError
        If one cannot be written; the files that were there stay as they were.
    """
    parts = {path: path.with_name(f".{path.name}.{os.getpid()}.part") for path in contents}
    try:
        for path, text in contents.items():
            if path.is_dir():
                raise OutputError(f"{path} is a folder, but a file was to be written there: name a file")
            path.parent.mkdir(parents=True, exist_ok=True)
            parts[path].write_text(text, encoding="utf-8")
        for path, part in parts.items():
            part.replace(path)
    except OSError as error:
        raise OutputError(f"{path} cannot be written: {error.strerror or error}") from error
    finally:
        for part in parts.values():
            with suppress(OSError):
                part.unlink(missing_ok=True)
    return list(contents)
