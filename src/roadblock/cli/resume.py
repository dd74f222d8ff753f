"""Experiments that can be interrupted, and go on from what their `result.json` holds."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from roadblock.cli.terminal import progress_bar
from roadblock.errors import OutputError

Part = TypeVar("Part")


def earlier(
    path: Path,
    head: Mapping[str, Any],
    rows: Callable[[Sequence[Mapping[str, Any]]], Any],
    field: str = "readings",
    free: Sequence[str] = ("runs",),
) -> list[dict[str, Any]]:
    """Return the readings of an interrupted run of the same code and settings, to go on from; else none.

    Parameters
    ----------
    path
        The result.
    head
        Its first fields as they would be now; `settings` has the first `seed` and how many `runs`.
    rows
        What the experiment makes of readings; it fails where they are none.
    field
        Where the readings are, each with the `seed` of its run.
    free
        Settings that may differ.

    Raises
    ------
    OutputError
        If `path` is there and no result of this experiment.
    """
    try:
        found = json.loads(path.read_bytes())
        if found["experiment"] != head["experiment"]:
            raise ValueError
        readings, interrupted = list(found[field]), bool(found["interrupted"])
        rows(readings)
        before = {key: found[key] for key in head} | {"settings": found["settings"] | dict.fromkeys(free)}
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(
            f"{path} is no result of this experiment and would be overwritten: choose another folder with --out"
        ) from error
    wanted = {**head, "settings": head["settings"] | dict.fromkeys(free)}
    first, count = head["settings"]["seed"], head["settings"]["runs"]
    same = interrupted and before == wanted
    return [r for r in readings if r["seed"] in range(first, first + count)] if same else []


def take(
    what: str, todo: Sequence[Part], total: int, one: Callable[[Part], None], write: Callable[[bool], dict[str, Any]]
) -> dict[str, Any]:
    """Do all that is left, writing the result after each; Ctrl-C ends it early, and the result says so.

    Parameters
    ----------
    what
        What the progress bar says.
    todo, total
        What is left, and how many there are in all.
    one
        Does one of them.
    write
        Writes the result of those done, told whether some are left, and returns it.

    Returns
    -------
    The result as written last.
    """
    result = write(bool(todo))
    try:
        with progress_bar() as progress:
            task = progress.add_task(what, total=total, completed=total - len(todo))
            for number, part in enumerate(todo, 1):
                one(part)
                result = write(number < len(todo))
                progress.advance(task)
    except KeyboardInterrupt:
        pass
    return result
