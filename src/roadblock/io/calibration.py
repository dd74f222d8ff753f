"""`calibration.json`: what a calibration found, how sure it is, and what made it."""

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

import roadblock
from roadblock.geometry.pose import rotvec_from_rotation
from roadblock.io.machine import machine_record, package_commit
from roadblock.io.results import clean_text, write_run
from roadblock.values.board import Board
from roadblock.values.calibration import Calibration, CameraFit, ViewFit
from roadblock.values.camera import Camera, StereoRig

CALIBRATION_SCHEMA = 1
DIGITS = 9
"""Significant digits of a number."""


def lens_name(camera: Camera) -> str:
    """Return a camera's lens as `LensTrial` names it: "brown_conrady5", "kannala_brandt"."""
    return f"{camera.lens}{len(camera.distortion)}" if camera.lens == "brown_conrady" else camera.lens


def calibration_record(
    calibration: Calibration,
    *,
    source: Mapping[str, Any],
    settings: Mapping[str, Any],
    started: datetime,
    without_board: Sequence[str] = (),
) -> dict[str, Any]:
    """Return what `calibration.json` says, ready for `json.dumps(record, allow_nan=False)`; unknown is None.

    Parameters
    ----------
    calibration
        What was found.
    source, settings
        Where the pictures came from and what was asked for, in plain JSON types.
    started
        When the work began; a time with a zone.
    without_board
        Names of pictures that showed no board to any camera; they count among the views, as left out.
    """
    c = calibration
    left_out = [{"view": clean_text(view.name), "reason": view.left_out} for view in c.views if view.left_out]
    left_out += [{"view": clean_text(name), "reason": "no board found in it"} for name in without_board]
    return {
        "schema": CALIBRATION_SCHEMA,
        "verdict": c.verdict,
        "reasons": list(c.reasons),
        "baseline_m": _plain(c.rig.baseline_m),
        "baseline_sigma_m": _plain(baseline_sigma_m(c.rig)),
        "rms_px": _plain(c.rms_px),
        "sigma_px": _plain(c.sigma_px),
        "epipolar_rms_px": _plain(c.epipolar_rms_px),
        "inflation": _plain(c.inflation),
        "views_total": len(c.views) + len(without_board),
        "views_used": len(c.used),
        "left_out": left_out,
        "range_sigma_m": {f"{z_m:g}": _plain(sigma_m) for z_m, sigma_m in c.range_rms_m.items()},
        "range_sigma_map_m": {f"{z_m:g}": _plain(sigma_m) for z_m, sigma_m in c.range_sigma_m.items()},
        "lens": lens_name(c.rig.left),
        "lens_trials": [{key: _plain(value) for key, value in vars(trial).items()} for trial in c.lens_trials],
        "parameters": parameter_records(c.rig),
        "size_px": list(c.rig.left.size_px),
        "board": _board_record(c),
        "cameras_alone": {
            side: _camera_record(fit) for side, fit in zip(("left", "right"), c.cameras_alone, strict=True)
        },
        "views": [_view_record(view) for view in c.views],
        "coverage": {key: _plain(value) for key, value in vars(c.coverage).items()},
        "source": _plain(source),
        "settings": _plain(settings),
        "version": roadblock.__version__,
        "commit": package_commit(),
        "machine": machine_record(),
        "started": started.astimezone(UTC).isoformat(timespec="milliseconds"),
        "finished": datetime.now(UTC).isoformat(timespec="milliseconds"),
    }


def write_calibration(path: Path, record: dict[str, Any]) -> None:
    """Write `calibration.json`, whole or not at all.

    Raises
    ------
    OutputError
        If the file cannot be written, or the record holds what JSON cannot.
    """
    write_run(path, record)


def baseline_sigma_m(rig: StereoRig) -> float:
    """Return the standard deviation of the rig's baseline, metres; NaN where no covariance is known."""
    if rig.covariance is None:
        return math.nan
    along = rig.T_left_right[:3, 3] / rig.baseline_m
    return math.sqrt(along @ rig.covariance.matrix[-3:, -3:] @ along)


def parameter_records(rig: StereoRig) -> list[dict[str, Any]]:
    """Return name, value and standard deviation of each of the rig's parameters; the turn as a rotation vector."""
    if rig.covariance is None:
        return []
    values = [
        *(number for camera in (rig.left, rig.right) for number in _camera_values(camera)),
        *rotvec_from_rotation(rig.T_left_right[:3, :3]),
        *rig.T_left_right[:3, 3],
    ]
    sigmas = np.sqrt(rig.covariance.matrix.diagonal())
    rows = zip(rig.covariance.names, values, sigmas, strict=True)
    return [{"name": name, "value": _plain(value), "sigma": _plain(sigma)} for name, value, sigma in rows]


def _camera_values(camera: Camera) -> list[float]:
    return [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion]


def _board_record(c: Calibration) -> dict[str, Any]:
    described = {name: _plain(getattr(c.board, name)) for name in Board.__dataclass_fields__}
    heights = {"heights_m": _plain(c.board_heights_m), "heights_sigma_m": _plain(c.board_heights_sigma_m)}
    return {**described, **heights}


def _camera_record(fit: CameraFit) -> dict[str, Any]:
    alone = dict(zip(fit.camera.parameters, map(_plain, _camera_values(fit.camera)), strict=True))
    evidence = ("rms_px", "sigma_px", "expected_sigma_px", "radial_px", "tangential_px")
    return {**alone, **{name: _plain(getattr(fit, name)) for name in evidence}}


def _view_record(view: ViewFit) -> dict[str, Any]:
    points = [int(np.isfinite(weight).sum()) for weight in (view.weight_left, view.weight_right)]
    return {
        "view": clean_text(view.name),
        "used": not view.left_out,
        "left_out": view.left_out,
        "points": points,
        "rms_px": _plain(view.rms_px),
        "T_left_board": _plain(view.T_left_board),
    }


def _plain(value: Any) -> Any:
    """Return a value in JSON's types: arrays as lists, NaN and infinity as None."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, (float, np.floating)):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if isinstance(value, np.integer):
        return int(value)
    return clean_text(value) if isinstance(value, str) else value
