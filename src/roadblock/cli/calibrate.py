"""`roadblock calibrate`: pictures of a board in; a rig with a known range error, and a report out."""

import math
import os
import re
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.rig import parse_unit
from roadblock.cli.terminal import note, progress_bar, say, show_table
from roadblock.errors import CalibrationError, MissingExtraError, OutputError, SettingsError
from roadblock.io.boards import BoardImages, BoardShot, open_board_images
from roadblock.io.calibration import baseline_sigma_m, calibration_record, write_calibration
from roadblock.io.rig import write_rig
from roadblock.stages.calibrate.advise import explain_missing
from roadblock.stages.calibrate.board import parse_board
from roadblock.stages.calibrate.calibrate import calibrate
from roadblock.stages.calibrate.choose import choose_views
from roadblock.stages.calibrate.detect import find_board
from roadblock.stages.calibrate.settings import CalibrateSettings
from roadblock.values.board import Board, BoardView
from roadblock.values.calibration import Calibration
from roadblock.values.frame import Image
from roadblock.viz.calibration_report import in_metres, scale_sentence, write_calibration_page

RIG, RECORD, PAGE = "rig.yaml", "calibration.json", "report.html"
LENSES = ("auto", "brown_conrady5", "brown_conrady8", "kannala_brandt")
HINT = "the whole board must be in the picture, sharp and uncovered, and --board counts inner corners, not squares"
UNSEEN_KEPT = 8
"""How many pictures without a board are kept to find out why."""
SHOWN = 5
"""How many of the views left out the terminal shows."""
SPAN_DISAGREES = 0.02


def calibrate_command(
    left: Annotated[
        str, typer.Argument(help="Left camera's pictures: folder, quoted glob or video; or both cameras'.")
    ],
    right: Annotated[str | None, typer.Argument(help="Right camera's pictures; not for side-by-side ones.")] = None,
    board: Annotated[
        str, typer.Option(help="Inner corners: chessboard:9x6; charuco:8x6:5x5_100:0.75; circles:4x11.")
    ] = "",
    square: Annotated[str | None, typer.Option(help="Side of a square with its unit, as 25mm.")] = None,
    span: Annotated[
        str | None, typer.Option(help="Measured distance of the outermost points along the longer side, as 200mm.")
    ] = None,
    span_error: Annotated[str, typer.Option(help="How sure that measurement is (one sigma).")] = "0.5mm",
    rig: Annotated[Path | None, typer.Option("--rig", "-o", help="Rig file to write, instead of DIR/rig.yaml.")] = None,
    out: Annotated[Path, typer.Option(help="Folder for rig.yaml, calibration.json and report.html.")] = Path(
        "calibration"
    ),
    lens: Annotated[str, typer.Option(help=f"Lens model: {', '.join(LENSES)}.")] = "auto",
    every: Annotated[int | None, typer.Option(help="Of a video, look at every N-th frame.", min=1)] = None,
    force: Annotated[bool, typer.Option("--force", help="Write the rig even if the calibration is refused.")] = False,
) -> None:
    """Calibrate a stereo rig from pictures of a board, and predict how far off its ranges will be."""
    started = datetime.now(UTC)
    known = measured_board(board, square, span, span_error)
    if lens not in LENSES:
        raise SettingsError(f"a lens must be one of {', '.join(LENSES)}, but got {lens!r:.40}")
    target = rig or out / RIG
    check_targets(out, target)
    images = open_board_images(left, right, every)
    settings = CalibrateSettings(lens=lens)
    try:
        found = look(images, known)
        with progress_bar() as progress:
            task = progress.add_task("calibrating", total=None)
            views = chosen(found, images, known)
            result = calibrate(
                views, known, images.size_px, settings,
                lambda what, done, total: progress.update(task, description=what, completed=done, total=total),
            )  # fmt: skip
        for warning in images.warnings:
            note(warning)
        asked = {"board": board, "square": square, "span": span, "span_error": span and span_error, "lens": lens}
        record = calibration_record(
            result,
            source={"left": left, "right": right, "every": every},
            settings={**asked, "force": force},
            started=started,
            without_board=[] if images.is_video else found.unseen,
        )
        write_results(result, record, out, target, force)
    except KeyboardInterrupt:
        note("interrupted; nothing was written")
        raise typer.Exit(INTERRUPTED) from None
    report(result, record, out, target, force)


def measured_board(text: str, square: str | None, span: str | None, span_error: str) -> Board:
    """Return the board that the options describe.

    Raises
    ------
    SettingsError
        If no board or no length is given, a length has no unit, or two lengths disagree.
    ValueRefusedError, SettingsError
        If there is no such board.
    """
    if not text:
        raise SettingsError("say what board it is: --board chessboard:9x6 (inner corners), charuco:..., circles:...")
    side_m = None if square is None else parse_length("--square", square)
    if span is None:
        if side_m is None:
            raise SettingsError("say how large the board is: --square 25mm, or better a measured --span 200mm")
        return parse_board(text, side_m)
    steps = max(parse_board(text, 0.025).size_m) / 0.025
    span_m, sigma_m = parse_length("--span", span), parse_length("--span-error", span_error)
    step_m = span_m / steps
    if side_m is not None and abs(side_m / step_m - 1) > SPAN_DISAGREES:
        raise SettingsError(
            f"--span {span} over {steps:g} steps makes squares of {1000 * step_m:.4g} mm, but --square says {square}: "
            "measure between the outermost points (inner corners) along the longer side"
        )
    return parse_board(text, step_m, sigma_m / steps)


def parse_length(option: str, text: str) -> float:
    """Return metres of a number with a unit, as "25mm".

    Raises
    ------
    SettingsError
        If it is none, or lacks the unit.
    """
    if re.fullmatch(r"\s*[0-9]*\.?[0-9]+\s*", text):
        raise SettingsError(f"{option} is {text.strip()}, which may be any unit: write it as {text.strip()}mm")
    if not re.match(r"\s*[0-9.]", text):
        raise SettingsError(f"{option} must be a number with its unit (25mm), but got {text!r:.40}")
    return parse_unit(text)


def check_targets(out: Path, target: Path) -> None:
    """Check, before the work, that the results can be written.

    Raises
    ------
    OutputError
        If a file stands where the folder belongs or the other way round, or the folder holds a rig or a report of
        something else.
    """
    for path in (out, *out.parents):
        if path.exists() and not path.is_dir():
            raise OutputError(f"{path} is a file, but results need a folder: choose another with --out")
    others = [name for name in (RIG, PAGE) if (out / name).exists()]
    if others and not (out / RECORD).is_file():
        raise OutputError(
            f"{out} holds a {others[0]} of something else than a calibration (no {RECORD} beside it): "
            "choose another folder with --out"
        )
    for path in (target, out / RECORD, out / PAGE):
        if path.is_dir():
            raise OutputError(f"{path} is a folder, but a file is to be written there: remove it, or choose another")


@dataclass
class Found:
    """What was found in the pictures: views with the numbers of their frames, and what showed no board."""

    views: list[BoardView] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    unseen: list[str] = field(default_factory=list)
    blind: dict[str, list[Image]] = field(default_factory=lambda: {"left": [], "right": []})
    """Some pictures of each camera in which nothing was found."""


def look(images: BoardImages, board: Board) -> Found:
    """Look for the board in all pictures.

    Raises
    ------
    CalibrationError
        If a camera never sees it, or both never at once.
    """
    found = Found()
    with progress_bar() as progress:
        task = progress.add_task("finding the board", total=images.length)
        for shot, view in in_threads(images, board):
            progress.advance(task)
            seen = (("left", shot.left, view.left), ("right", shot.right, view.right))
            for side, image, sighting in seen:
                if image is not None and sighting is None and len(found.blind[side]) < UNSEEN_KEPT:
                    found.blind[side].append(image)
            if view.left is None and view.right is None:
                found.unseen.append(shot.name)
            else:
                found.views.append(view)
                found.frames.append(shot.index)
    for side in ("left", "right"):
        if all(getattr(view, side) is None for view in found.views):
            why = explain_missing(found.blind[side], board)
            raise CalibrationError(f"the board was found in no {side} picture: {why or HINT}")
    if not any(view.left and view.right for view in found.views):
        raise CalibrationError(
            f"in none of {len(found.views)} views do both cameras see the board at once: hold it where both see it, "
            "and give both pictures of a moment the same name or number"
        )
    return found


def in_threads(images: Iterable[BoardShot], board: Board) -> Iterator[tuple[BoardShot, BoardView]]:
    """Look for the board in a few pictures at once; they come back in their order."""
    workers = max(1, min(os.cpu_count() or 1, 8))

    def find(shot: BoardShot) -> BoardView:
        left, right = (None if image is None else find_board(image, board) for image in (shot.left, shot.right))
        return BoardView(shot.name, left, right)

    with ThreadPoolExecutor(workers) as pool:
        waiting: deque[tuple[BoardShot, Future[BoardView]]] = deque()
        try:
            for shot in images:
                waiting.append((shot, pool.submit(find, shot)))
                if len(waiting) > workers:
                    first, view = waiting.popleft()
                    yield first, view.result()
            while waiting:
                first, view = waiting.popleft()
                yield first, view.result()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def chosen(found: Found, images: BoardImages, board: Board) -> list[BoardView]:
    """Return the views to calibrate from: all, of a video the still and different ones."""
    if not images.is_video:
        return found.views
    choice = choose_views(found.views, found.frames, board, images.size_px)
    note(
        f"of {len(found.views)} frames with a board {len(choice.views)} are used: {choice.moving} show it moving, "
        f"{choice.alike} where another one shows it already"
    )
    return list(choice.views)


def write_results(result: Calibration, record: dict[str, Any], out: Path, target: Path, force: bool) -> None:
    """Write the report and, unless it is refused, the rig; each file whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    write_calibration(out / RECORD, record)
    (out / PAGE).unlink(missing_ok=True)
    try:
        write_calibration_page(out / PAGE, result, record)
    except MissingExtraError as error:
        note(str(error))
    if result.verdict != "refused" or force:
        write_rig(replace(result.rig, verdict=result.verdict), target)
    elif target == out / RIG:
        target.unlink(missing_ok=True)  # of an earlier run: it would pass for this one's


def report(result: Calibration, record: dict[str, Any], out: Path, target: Path, force: bool) -> None:
    """Print what was found, how far it can be trusted and what to do next.

    Raises
    ------
    CalibrationError
        If it is refused and was not forced.
    """
    show_table(f"calibration: {result.verdict}", ("what", "value"), summary(result, record))
    for reason in result.reasons:
        say(f"- {reason}")
    for left_out in record["left_out"][:SHOWN]:
        say(f"left out: {left_out['view']}: {left_out['reason']}")
    if (more := len(record["left_out"]) - SHOWN) > 0:
        say(f"left out: {more} more, see {out / RECORD}")
    if math.isnan(result.board.square_sigma_m):
        note(scale_sentence(result))
    if result.coverage.next_view:
        say(f"next: {result.coverage.next_view}")
    if (out / PAGE).is_file():
        say(f"report: {out / PAGE}")
    if result.verdict == "refused" and not force:
        why = result.reasons[0].rstrip(".") if result.reasons else "the pictures cannot support a rig"
        raise CalibrationError(f"refused, no rig written: {why}; --force writes it, marked as refused")
    say(f"rig: {target}{' (REFUSED, written by force)' if result.verdict == 'refused' else ''}")


def summary(result: Calibration, record: dict[str, Any]) -> list[tuple[str, str]]:
    """Return rows (what, value) about a calibration."""
    verdicts = [trial.verdict for trial in result.lens_trials if trial.verdict.startswith("chosen")]
    why = verdicts[0].removeprefix("chosen: ") if verdicts else "given"
    heights_m = result.board_heights_m
    sigma_m = baseline_sigma_m(result.rig)
    baseline = f"{1000 * result.rig.baseline_m:.3f} mm"
    rows = [
        ("views", f"{record['views_used']} of {record['views_total']} used"),
        ("residuals", f"{result.rms_px:.3f} px RMS; rows {result.epipolar_rms_px:.3f} px RMS apart once rectified"),
        ("lens", f"{record['lens']} ({why})"),
        ("baseline", baseline if math.isnan(sigma_m) else f"{baseline} ± {1000 * sigma_m:.3f} mm"),
        ("board", f"out of its plane by {1000 * float(heights_m.max() - heights_m.min()):.2f} mm in all"),
    ]
    for z_m, field_m in result.range_sigma_m.items():
        known_m = field_m[np.isfinite(field_m)]
        if not known_m.size:
            rows.append((f"range error at {z_m:g} m", "unknown"))
            continue
        median, worst, rms = map(in_metres, (np.median(known_m), known_m.max(), result.range_rms_m[z_m]))
        rows.append((f"range error at {z_m:g} m", f"± {median} (median over the image; at worst {worst}, RMS {rms})"))
    return rows
