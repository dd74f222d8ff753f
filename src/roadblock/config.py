"""Settings: each stage's own settings, composed, from TOML and from the command line."""

import difflib
import reprlib
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from roadblock.errors import SettingsError
from roadblock.stages.bands import BandsSettings
from roadblock.stages.decide import DecideSettings
from roadblock.stages.egomotion import EgomotionSettings
from roadblock.stages.fuse import FuseSettings
from roadblock.stages.ground import GroundSettings
from roadblock.stages.health import HealthSettings
from roadblock.stages.low import LowSettings
from roadblock.stages.match import MatchSettings
from roadblock.stages.match.cells import CellSettings
from roadblock.stages.mono import MonoSettings
from roadblock.stages.recognize import RecognizeSettings
from roadblock.stages.rectify import RectifySettings
from roadblock.stages.refine import RefineSettings
from roadblock.stages.segment import SegmentSettings
from roadblock.stages.track import TrackSettings


class Settings(BaseModel):
    """Everything that can be set, one section a stage."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    detector: str = Field("cells", description="Entry of DETECTORS, or package.module:factory.")
    rectify: RectifySettings = RectifySettings()
    match: MatchSettings = MatchSettings()
    cells: CellSettings = CellSettings()
    ground: GroundSettings = GroundSettings()
    segment: SegmentSettings = SegmentSettings()
    low: LowSettings = LowSettings()
    refine: RefineSettings = RefineSettings()
    recognize: RecognizeSettings = RecognizeSettings()
    bands: BandsSettings = BandsSettings()
    mono: MonoSettings = MonoSettings()
    health: HealthSettings = HealthSettings()
    egomotion: EgomotionSettings = EgomotionSettings()
    track: TrackSettings = TrackSettings()
    fuse: FuseSettings = FuseSettings()
    decide: DecideSettings = DecideSettings()


def load_settings(path: Path | None = None, assignments: Iterable[str] = ()) -> Settings:
    """Read settings from a TOML file, then apply `stage.key=value` assignments on top.

    Raises
    ------
    SettingsError
        If the file cannot be read, a key is unknown (the nearest known one is named), or a value does not fit.
    """
    values: dict[str, Any] = {} if path is None else _read_toml(path)
    for assignment in assignments:
        key, equals, text = assignment.partition("=")
        if not equals or not key.strip():
            raise SettingsError(f"a setting must look like stage.key=value, but got {assignment!r}")
        section = values
        *sections, last = key.strip().split(".")
        for name in sections:
            section = section.setdefault(name, {})
            if not isinstance(section, dict):
                raise SettingsError(f"{key}: {name} is a value, not a section")
        section[last] = _parse(text)
    return make_settings(values)


def make_settings(values: Mapping[str, Any]) -> Settings:
    """Build settings from a nested mapping; see `load_settings` for the errors."""
    try:
        return Settings.model_validate(values)
    except ValidationError as error:
        raise SettingsError(" ".join(_first_problem(error).split())) from error


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(path.read_text("utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise SettingsError(f"{path}: cannot be read as TOML settings: {error}") from error


def _parse(text: str) -> Any:
    """Read a value as YAML does, so that 3, 0.5, true, [1, 2] and words need no quotes; what is no YAML is a word.

    So are on, off, yes and no, which YAML takes for truth values.
    """
    if text.strip().lower() in ("on", "off", "yes", "no"):
        return text.strip()
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text


def _first_problem(error: ValidationError) -> str:
    problem = error.errors()[0]
    location = [str(part) for part in problem["loc"]]
    name = ".".join(location)
    if problem["type"] == "extra_forbidden":
        known = _known_keys(location[:-1])
        nearest = difflib.get_close_matches(location[-1], known, 1, 0.0)
        return f"unknown setting {name}: did you mean {'.'.join([*location[:-1], *nearest])}? Known: {', '.join(known)}"
    # reprlib stops early, however deep a hostile value is nested.
    return f"setting {name} = {reprlib.repr(problem['input']):.60}: {problem['msg'].removeprefix('Value error, ')}"


def _known_keys(sections: list[str]) -> list[str]:
    model: Any = Settings
    for name in sections:
        model = model.model_fields[name].annotation
    return list(model.model_fields)
