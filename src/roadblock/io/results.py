"""Result sinks: the files a run leaves behind, and reading them back.

A run's folder holds `obstacles.jsonl` (one line per frame), `run.json` (what made it) and, if asked for, `overlay/` or
`overlay.mp4`.
"""

import json
import math
import os
from collections.abc import Sequence
from contextlib import suppress
from datetime import UTC, datetime
from io import FileIO
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import from_json

import roadblock
from roadblock.errors import OutputError, SourceError
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.schema import SCHEMA, FrameRecord
from roadblock.values.decision import Decision
from roadblock.values.motion import Track
from roadblock.values.scene import EDGE_KINDS, FrameResult, FreeSpace, GroundPlane, Obstacle, Stixels

RESULTS, RUN, OVERLAY, VIDEO = "obstacles.jsonl", "run.json", "overlay", "overlay.mp4"
"""The names of a run's own files in its folder."""

METRE_DIGITS, PX_DIGITS, RAD_DIGITS, MS_DIGITS, SHARE_DIGITS, LAB_DIGITS = 4, 2, 6, 3, 4, 1
LEAST_ODDS = 0.01
"""Classes less probable than this are not written."""


def number(value: float, digits: int) -> float | None:
    """Return `value` rounded, or None where it is unknown (NaN or infinite)."""
    value = float(value)
    return round(value, digits) + 0.0 if math.isfinite(value) else None


def numbers(values: Sequence[float] | np.ndarray, digits: int) -> list[float | None]:
    """Return `values` (n,) rounded, None where unknown."""
    return [number(value, digits) for value in np.asarray(values, float).tolist()]


def clean_text(text: str) -> str:
    """Return `text` with what no UTF-8 file can hold (half a character of a file name) replaced by '?'."""
    return text.encode("utf-8", "replace").decode("utf-8")


def frame_record(result: FrameResult) -> dict[str, Any]:
    """Return one frame in the public schema, ready for `json.dumps(record, allow_nan=False)`.

    Parameters
    ----------
    result
        What one step of the pipeline produced.

    Returns
    -------
    The fields of `roadblock.io.schema.FrameRecord`: metres rounded to 4 decimals, pixels to 2, radians to 6,
    milliseconds to 3, covariances to 9 significant digits; NaN and infinity become None.
    """
    return {
        "schema": SCHEMA,
        "frame": int(result.index),
        "name": clean_text(result.name),
        "t_ns": int(result.t_ns),
        "obstacles": [_obstacle_record(obstacle) for obstacle in result.obstacles],
        "free_space": _free_space_record(result.free_space),
        "ground": _ground_record(result.ground),
        "health": {"state": result.health.state, "reasons": [clean_text(reason) for reason in result.health.reasons]},
        "timings_ms": {name: number(ms, MS_DIGITS) for name, ms in result.timings_ms.items()},
        "stixels": _stixels_record(result.stixels),
        "decision": _decision_record(result.decision),
    }


def _decision_record(decision: Decision | None) -> dict[str, Any] | None:
    if decision is None:
        return None
    digits = {"ttc_s", "ttc_sigma_s", "deceleration_mps2", "curvature_per_m", "offset_m"}
    return {name: number(value, METRE_DIGITS) if name in digits else value for name, value in vars(decision).items()}


def _stixels_record(stixels: Stixels | None) -> dict[str, Any] | None:
    if stixels is None:
        return None
    return {
        "u_px": numbers(stixels.u_px, PX_DIGITS),
        "top_px": numbers(stixels.top_px, PX_DIGITS),
        "bottom_px": numbers(stixels.bottom_px, PX_DIGITS),
        "range_m": numbers(stixels.range_m, METRE_DIGITS),
        "height_m": numbers(stixels.height_m, METRE_DIGITS),
    }


def _obstacle_record(obstacle: Obstacle) -> dict[str, Any]:
    return {
        "id": None if obstacle.track is None else obstacle.track.id,
        "class": obstacle.label,
        "class_probability": number(obstacle.probability, SHARE_DIGITS),
        "class_odds": {k: round(p, SHARE_DIGITS) for k, p in obstacle.class_odds.items() if p >= LEAST_ODDS},
        "color": obstacle.color,
        "colors": list(obstacle.colors),
        "color_lab": numbers(obstacle.color_lab, LAB_DIGITS) if obstacle.colors else None,
        "position_m": numbers(obstacle.position_m, METRE_DIGITS),
        "range_m": number(obstacle.range_m, METRE_DIGITS),
        "range_sigma_m": number(obstacle.range_sigma_m, METRE_DIGITS),
        "range_sigma_calib_m": number(obstacle.range_sigma_calib_m, METRE_DIGITS),
        "cov_calib_m2": _covariance_rows(obstacle.cov_calib_m2),
        "size_m": numbers(obstacle.size_m, METRE_DIGITS),
        "size_sigma_m": numbers(obstacle.size_sigma_m, METRE_DIGITS),
        "outline_m": [numbers(corner, METRE_DIGITS) for corner in obstacle.outline_m],
        "heading_rad": number(obstacle.heading_rad, RAD_DIGITS),
        "heading_sigma_rad": number(obstacle.heading_sigma_rad, RAD_DIGITS),
        "box_px": [int(edge) for edge in obstacle.box_px],
        "seen_through": obstacle.is_seen_through,
        "contour_px": np.asarray(obstacle.contour_px, int).reshape(-1, 2).tolist(),
        **_track_record(obstacle.track),
    }


def _track_record(track: Track | None) -> dict[str, Any]:
    if track is None:
        return {"velocity_mps": None, "ttc_s": None}
    return {
        "velocity_mps": [*numbers(track.velocity_mps, METRE_DIGITS), 0.0],
        "velocity_sigma_mps": numbers(track.velocity_sigma_mps, METRE_DIGITS),
        "velocity_over_ground": track.is_over_ground,
        "motion": track.motion,
        "ttc_s": number(track.ttc_s, METRE_DIGITS),
        "ttc_sigma_s": number(track.ttc_sigma_s, METRE_DIGITS),
        "age_s": number(track.age_s, METRE_DIGITS),
        "coasted_s": number(track.coasted_s, METRE_DIGITS),
    }


def _covariance_rows(cov: np.ndarray) -> list[list[float]] | None:
    """Return a covariance with enough digits to stay one, though its directions differ by orders of magnitude."""
    if not np.isfinite(cov).all():
        return None
    return [[float(f"{value:.9g}") for value in row] for row in cov.tolist()]


def _free_space_record(free_space: FreeSpace) -> dict[str, Any]:
    edges = free_space.edges
    return {
        "u_px": numbers(free_space.u_px, PX_DIGITS),
        "range_m": numbers(free_space.range_m, METRE_DIGITS),
        "blocked": None if free_space.is_blocked is None else free_space.is_blocked.tolist(),
        "edges": edges
        and {
            "range_m": numbers(edges.range_m, METRE_DIGITS),
            "height_m": numbers(edges.height_m, METRE_DIGITS),
            "kind": [EDGE_KINDS[kind] if kind else None for kind in edges.kind.tolist()],
        },
    }


def _ground_record(ground: GroundPlane | None) -> dict[str, Any] | None:
    if ground is None:
        return None
    return {
        "height_m": number(ground.height_m, METRE_DIGITS),
        "pitch_rad": number(ground.pitch_rad, RAD_DIGITS),
        "roll_rad": number(ground.roll_rad, RAD_DIGITS),
    }


def read_results(path: Path) -> list[dict[str, Any]]:
    """Return the records of an `obstacles.jsonl`, one per frame, as `frame_record` wrote them.

    Raises
    ------
    SourceError
        If the file cannot be read, its last line is cut off, or a line is no record of this schema version.
    """
    return read_records(path, FrameRecord, SCHEMA, "results")


def read_records(path: Path, model: type[BaseModel], schema: int, what: str) -> list[dict[str, Any]]:
    """Return the records of a file of JSON lines that roadblock wrote.

    Parameters
    ----------
    path
        The file.
    model, schema
        What each line must be, and its version.
    what
        What the file holds, in words.

    Raises
    ------
    SourceError
        If the file cannot be read, its last line is cut off, or a line is no record of this schema version.
    """
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise SourceError(f"cannot read {what} {path}: {error.strerror or error}") from error
    *lines, rest = data.split(b"\n")
    if rest:
        raise SourceError(
            f"{path}: the last line ({len(lines) + 1}) is cut off: the run was broken while writing; "
            "delete that line or run again"
        )
    return [_parse_line(f"{path}, line {number}", line, model, schema) for number, line in enumerate(lines, start=1)]


def _parse_line(where: str, line: bytes, model: type[BaseModel], schema: int) -> dict[str, Any]:
    try:
        record = from_json(line, allow_inf_nan=False)
    except ValueError as error:
        raise SourceError(f"{where}: no JSON object as roadblock writes it ({error})") from error
    if not isinstance(record, dict):
        raise SourceError(f"{where}: expected one JSON object per line, but got {str(record)[:40]!r}")
    if record.get("schema") != schema:
        raise SourceError(
            f"{where}: schema is {record.get('schema')!r:.40}, but this version of roadblock reads {schema}; "
            "read it with the version that wrote it (see run.json)"
        )
    try:
        model.model_validate(record)
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(map(str, first["loc"]))
        raise SourceError(f"{where}: field {field}: {first['msg']}; the file was changed by hand or broken") from error
    return record


class ResultSink(Protocol):
    """Where results go: a context manager that takes one frame after the other."""

    def __enter__(self) -> Self:
        """Open it."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it, whatever happened."""
        ...

    def write(self, result: FrameResult) -> None:
        """Take one frame."""
        ...


class JsonlSink:
    """Writes `obstacles.jsonl`: each frame is one whole line, on its way to the disk when `write` returns.

    An interruption, even a kill, leaves whole lines: each goes out in one unbuffered call, and a line that a full disk
    cut short is taken back.

    Parameters
    ----------
    path
        The file; replaced where it exists, its folder made where it is missing.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._file: FileIO | None = None

    def __enter__(self) -> Self:
        """Open the file.

        Raises
        ------
        OutputError
            If it cannot be written.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._file = self.path.open("wb", buffering=0)
        except OSError as error:
            raise OutputError(_cannot_write(self.path, error)) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def write(self, result: FrameResult) -> None:
        """Append one frame.

        Raises
        ------
        OutputError
            If the disk is full or gone; the lines before stay whole.
        """
        assert self._file is not None, "write inside `with JsonlSink(path) as sink`"  # noqa: S101
        line = json.dumps(frame_record(result), allow_nan=False, separators=(",", ":")).encode() + b"\n"
        start = self._file.tell()
        try:
            written = self._file.write(line)
            while written < len(line):
                written += self._file.write(line[written:])
        except OSError as error:
            with suppress(OSError):
                self._file.seek(start)
                self._file.truncate()
            raise OutputError(_cannot_write(self.path, error)) from error


def _cannot_write(path: Path, error: OSError) -> str:
    return f"cannot write {path}: {error.strerror or error}; choose another folder with --out, or free this one"


def prepare_folder(folder: Path) -> Path:
    """Make `folder` ready for a new run, and return it.

    What an earlier run left (`obstacles.jsonl`, `run.json`, `overlay.mp4`, the pictures in `overlay/`) goes, so that
    nothing stale stands beside new results; everything else stays.

    Raises
    ------
    OutputError
        If the folder cannot be made or cleared, or holds overlays or a `run.json` that no run of ours left there.
    """
    folder = Path(folder)
    results, overlay = folder / RESULTS, folder / OVERLAY
    try:
        folder.mkdir(parents=True, exist_ok=True)
        others = [name for name in (RUN, VIDEO, OVERLAY) if os.path.lexists(folder / name)]
        if others and (not results.is_file() or overlay.is_symlink()):
            raise OutputError(
                f"{folder} holds {others[0]} of something else than a run (no {RESULTS} beside it): "
                "choose another folder with --out"
            )
        for path in (folder / RUN, folder / VIDEO, *overlay.glob("*.png")):
            path.unlink(missing_ok=True)
        with suppress(OSError):
            overlay.rmdir()
        results.unlink(missing_ok=True)  # last: as long as it is there, the rest is known to be a run's
    except OSError as error:
        raise OutputError(_cannot_write(folder, error)) from error
    return folder


def write_run(path: Path, record: dict[str, Any]) -> None:
    """Write `run.json`, whole or not at all.

    Raises
    ------
    OutputError
        If the record holds what JSON cannot (NaN, unknown types), or the file cannot be written.
    """
    path = Path(path)
    try:
        text = json.dumps(record, indent=2, allow_nan=False) + "\n"
    except (TypeError, ValueError) as error:
        raise OutputError(f"{path.name} cannot hold this run's record: {error}") from error
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside.write_text(text, encoding="utf-8")
        beside.replace(path)
    except OSError as error:
        with suppress(OSError):
            beside.unlink()
        raise OutputError(_cannot_write(path, error)) from error


def run_record(
    *,
    source: dict[str, Any],
    settings: dict[str, Any],
    rig: dict[str, Any],
    started: datetime,
    frames: int,
    interrupted: bool,
) -> dict[str, Any]:
    """Return what `run.json` says of a run that ends now.

    Parameters
    ----------
    source
        Where the frames came from: its `name`, `kind`, `path` and `frames` (null where their number is unknown).
    settings, rig
        As resolved for this run, in plain JSON types.
    started
        When the run began; a time with a zone.
    frames
        How many frames were written.
    interrupted
        Whether it was stopped before the source's end.
    """
    return {
        "version": roadblock.__version__,
        "commit": package_commit(),
        "machine": machine_record(),
        "source": source,
        "settings": settings,
        "rig": rig,
        "started": started.astimezone(UTC).isoformat(timespec="milliseconds"),
        "finished": datetime.now(UTC).isoformat(timespec="milliseconds"),
        "frames_written": frames,
        "interrupted": interrupted,
    }
