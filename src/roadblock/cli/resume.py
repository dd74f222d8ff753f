"""Go on with an experiment that was interrupted, from the readings in its `result.json`."""

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from roadblock.errors import OutputError


def earlier(
    path: Path, head: Mapping[str, Any], rows: Callable[[Sequence[Mapping[str, Any]]], Any]
) -> list[dict[str, Any]]:
    """Return the readings of an interrupted run of the same code and settings, to go on from; else none.

    Parameters
    ----------
    path
        The result.
    head
        Its first fields as they would be now; `settings` has the first `seed` and how many `runs`: they may differ.
    rows
        What the experiment makes of readings; it fails where they are none.

    Raises
    ------
    OutputError
        If `path` is there and no result of this experiment.
    """
    try:
        found = json.loads(path.read_bytes())
        if found["experiment"] != head["experiment"]:
            raise ValueError
        readings, interrupted = list(found["readings"]), bool(found["interrupted"])
        rows(readings)
        before = {key: found[key] for key in head} | {"settings": found["settings"] | {"runs": None}}
    except FileNotFoundError:
        return []
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(
            f"{path} is no result of this experiment and would be overwritten: choose another folder with --out"
        ) from error
    wanted = {**head, "settings": head["settings"] | {"runs": None}}
    first, count = head["settings"]["seed"], head["settings"]["runs"]
    same = interrupted and before == wanted
    return [r for r in readings if r["seed"] in range(first, first + count)] if same else []
