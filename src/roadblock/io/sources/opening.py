"""The table of everything that can be opened, and the door that looks things up in it."""

from difflib import get_close_matches
from pathlib import Path

from roadblock.errors import SourceError
from roadblock.io.sources.folders import is_folder_pair, is_list, open_folder_pair, open_list
from roadblock.io.sources.kitti import KITTI, Opener, Test
from roadblock.io.sources.source import StereoSource
from roadblock.io.sources.video import is_video, open_side_by_side, open_two_videos, two_videos
from roadblock.values.camera import StereoRig

SOURCES: tuple[tuple[str, Test, Opener], ...] = (
    ("folder", is_folder_pair, open_folder_pair),
    ("list", is_list, open_list),
    ("side-by-side", is_video, open_side_by_side),
    ("two-videos", lambda path: two_videos(path) is not None, open_two_videos),
    *KITTI,
)
"""Name, test and opener of each kind of recording."""


def open_source(
    spec: str | Path, *, rig: StereoRig | None = None, kind: str | None = None, gray: bool = False
) -> StereoSource:
    """Open a recording, whatever kind of `SOURCES` it is.

    Parameters
    ----------
    spec
        A folder, a file, or "LEFT,RIGHT" for two videos.
    rig
        The cameras, instead of what the recording brings.
    kind
        Name of a kind in `SOURCES`, needed only where several fit.
    gray
        Whether colour is turned into grey.

    Raises
    ------
    SourceError
        If nothing is there, it is no kind of recording or several, it cannot be read, or there is no rig.
    RigError, ValueRefusedError
        If its rig cannot be trusted.
    MissingExtraError
        If it is a video and PyAV is not installed.
    """
    path, kinds = Path(spec), [name for name, _, _ in SOURCES]
    if kind is not None and kind not in kinds:
        near = get_close_matches(kind, kinds, 1)
        hint = f"did you mean {near[0]}?" if near else "choose one of these"
        raise SourceError(f"{kind!r:.60} is no kind of recording; {hint} ({', '.join(kinds)})")
    try:
        fitting = [(name, opener) for name, fits, opener in SOURCES if kind in (None, name) and fits(path)]
        if len(fitting) == 1:
            return fitting[0][1](path, rig, gray)
        if fitting:
            names = ", ".join(name for name, _ in fitting)
            raise SourceError(f"{path} can be opened as {names}: choose with --kind NAME")
        raise SourceError(_why_not(path, kind))
    except OSError as error:
        raise SourceError(f"{error.filename or path} cannot be read: {error.strerror}; check the path") from error


def _why_not(path: Path, kind: str | None) -> str:
    if not path.exists():
        return f"there is no '{path}': give a folder, a video, a list of pairs, or LEFT,RIGHT for two videos"
    inside = sorted(entry.name for entry in path.iterdir())[:6] if path.is_dir() else []
    what = f"holds {', '.join(inside) or 'nothing'}" if path.is_dir() else f"is a {path.suffix or 'nameless'} file"
    expected = f"a {kind} recording" if kind else f"any kind of recording ({', '.join(name for name, _, _ in SOURCES)})"
    return f"'{path}' {what}, which is not {expected}; see docs/sources.md"
