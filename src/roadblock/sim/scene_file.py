"""SCENE.yaml: a drive as a text file, version 1. Either a ready scene with changes, or a list of things on a road."""

import math
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from roadblock.errors import OutputError, RoadblockError, SettingsError, ValueRefusedError
from roadblock.sim.conditions import combined
from roadblock.sim.drive import DriveSettings
from roadblock.sim.road import Line, Mark, MarkKind, Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.scenes import SCENES, Stand, stood
from roadblock.sim.solids import textured
from roadblock.sim.things import Order
from roadblock.values.checks import FloatArray

VERSION = 1
MAX_BYTES = 200_000
MAX_DEPTH = 6
MAX_THINGS = 500

Far = Annotated[float, Field(ge=-500, le=500)]
Positive = Annotated[float, Field(gt=0, le=500)]
Speed = Annotated[float, Field(ge=-70, le=70)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Richness = Annotated[float, Field(ge=0, le=10)]
Seed = Annotated[int, Field(ge=0, le=10**6)]


class _Checked(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LineEntry(_Checked):
    """One line of `road.lines`; the fields of `Line`."""

    left_m: Far
    width_m: Positive = 0.14
    dash_m: Positive = 3.0
    gap_m: Annotated[float, Field(ge=0, le=500)] = 0.0


class MarkEntry(_Checked):
    """One mark of `road.marks`; the fields of `Mark`."""

    kind: MarkKind
    along_m: Far
    left_m: Far
    length_m: Positive
    width_m: Positive


class RoadEntry(_Checked):
    """The section `road`; the fields of `Road`."""

    right_m: Far = -3.1
    left_m: Far = 5.6
    contrast: Annotated[float, Field(ge=0, le=1)] = 0.17
    lines: tuple[LineEntry, ...] | None = None
    marks: tuple[MarkEntry, ...] = ()
    curvature_per_m: float = 0.0
    curve_from_m: Far = 0.0
    grade: float = 0.0
    grade_from_m: Far = 15.0
    grade_over_m: Positive = 20.0
    bank: float = 0.0
    crown_per_m: float = 0.0
    kerb_m: float = 0.0


class ThingEntry(_Checked):
    """One thing of `things`: what can be said in an `Order` and a `Stand`, and how rich its textures are."""

    type: str
    nearest_m: Far
    left_m: Far = 0.0
    yaw_deg: Angle = 0.0
    speed_mps: Speed = 0.0
    model: str = ""
    color: str = ""
    length_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    walking: bool = False
    texture: Richness = 1.0
    seed: Seed = 0


class SceneFile(_Checked):
    """The whole file, every field checked. What is not given is as in the ready scene, or as in `Scene`."""

    roadblock_scene: int
    scene: str | None = None
    road: RoadEntry | None = None
    things: tuple[ThingEntry, ...] | None = Field(None, max_length=MAX_THINGS)
    seed: Seed = 0
    height_m: Annotated[float, Field(ge=0.1, le=10)] | None = None
    pitch_deg: Annotated[float, Field(ge=-45, le=45)] | None = None
    roll_deg: Annotated[float, Field(ge=-45, le=45)] | None = None
    speed_mps: Speed | None = None
    towards_sun: tuple[float, float, float] | None = None
    conditions: tuple[str, ...] | None = None
    texture: Richness = 1.0
    duration_s: Annotated[float, Field(gt=0, le=36_000)] = 3.0
    fps: Annotated[float, Field(ge=0.1, le=1000)] = 10.0
    quality: str = "demo"
    maps: bool = False
    rig: str | None = None


class Drive(NamedTuple):
    """What a scene file asks for.

    Attributes
    ----------
    scene
        The world at the first frame.
    settings
        How it is recorded.
    rig
        The rig file, or None = the paper's rig.
    """

    scene: Scene
    settings: DriveSettings
    rig: Path | None


def read_scene(path: Path) -> Drive:
    """Return the drive that a file describes.

    Parameters
    ----------
    path
        The file; a rig is looked for from its folder.

    Raises
    ------
    SettingsError
        If it cannot be read, is no such file, a name is unknown (the nearest known one is named), a value does not fit,
        or what it describes cannot be.
    """
    try:
        return staged(parse_scene(_read_text(path)), path.parent)
    except RoadblockError as error:
        raise SettingsError(f"{path.name or path}: {error}") from error


def _read_text(path: Path) -> str:
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except FileNotFoundError as error:
        raise SettingsError(f"there is no such file ({path}); ready scenes need none: name one of them") from error
    except (OSError, ValueError) as error:
        raise SettingsError(f"cannot be read: {getattr(error, 'strerror', None) or error}") from error
    if len(data) > MAX_BYTES:
        raise SettingsError(f"is larger than {MAX_BYTES // 1000} kB, but a scene file is a small text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise SettingsError("is no text (not UTF-8), but a scene file was expected") from error


def parse_scene(text: str) -> SceneFile:
    """Return what a scene file says.

    Raises
    ------
    SettingsError
        As `read_scene`, without a file's name.
    """
    document = _document(text)
    version = document.get("roadblock_scene")
    if version is None:
        raise SettingsError(f"is no scene file: it must begin with the line roadblock_scene: {VERSION}")
    if version != str(VERSION):
        raise SettingsError(f"is a scene file of version {version!r:.20}, but this program reads version {VERSION}")
    try:
        return SceneFile.model_validate(document)
    except ValidationError as error:
        raise SettingsError(_first_problem(error)) from error


def _document(text: str) -> dict[str, Any]:
    """Return a YAML mapping, every scalar as text; refuse what a scene file never needs and a hostile one lives on."""
    depth = 0
    try:
        for event in yaml.parse(text, Loader=yaml.BaseLoader):
            line = event.start_mark.line + 1 if event.start_mark else 0
            if isinstance(event, yaml.NodeEvent) and (event.anchor or getattr(event, "tag", None)):
                raise SettingsError(f"uses a YAML anchor, alias or tag at line {line}: write it out plainly")
            depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
            if depth > MAX_DEPTH:
                raise SettingsError(f"is nested deeper than {MAX_DEPTH} levels at line {line}: this is no scene file")
        node = yaml.compose(text, Loader=yaml.BaseLoader)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f" at line {mark.line + 1}" if mark else ""
        what = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise SettingsError(f"is not valid YAML: {what}{where}") from error
    if not isinstance(node, yaml.MappingNode):
        raise SettingsError("must hold names with values (roadblock_scene: 1, scene: paper, ...), but holds none")
    document: dict[str, Any] = _plain(node)
    return document


def _plain(node: yaml.Node) -> Any:
    if isinstance(node, yaml.SequenceNode):
        return [_plain(child) for child in node.value]
    if not isinstance(node, yaml.MappingNode):
        return node.value
    found: dict[str, Any] = {}
    for key, value in node.value:
        line = key.start_mark.line + 1
        if not isinstance(key, yaml.ScalarNode):
            raise SettingsError(f"must have plain names, but has a list or mapping as a name at line {line}")
        if key.value in found:
            raise SettingsError(f"says {key.value!r:.40} twice in one place (line {line}): keep one")
        found[key.value] = _plain(value)
    return found


_SECTIONS: dict[str, type[BaseModel]] = {
    "things": ThingEntry,
    "lines": LineEntry,
    "marks": MarkEntry,
    "road": RoadEntry,
}


def _first_problem(error: ValidationError) -> str:
    """Return one line about the first thing that does not fit."""
    problem = error.errors(include_url=False)[0]
    where = problem["loc"]
    # A person counts from 1.
    name = ".".join(str(part + 1) if isinstance(part, int) else part for part in where)
    if problem["type"] == "extra_forbidden":
        section = next((_SECTIONS[part] for part in reversed(where[:-1]) if part in _SECTIONS), SceneFile)
        known = tuple(section.model_fields)
        near = get_close_matches(str(where[-1]), known, 1)
        return f"{name:.80} is no known name; " + (f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}")
    if problem["type"] == "missing":
        return f"{name} is missing"
    return " ".join(f"{name}: {problem['msg']}, but got {problem['input']!r:.60}".split())


def staged(file: SceneFile, folder: Path = Path()) -> Drive:
    """Return the drive that a scene file describes; its rig is looked for from `folder`.

    Raises
    ------
    SettingsError
        If it has both a ready scene and a road or things, or neither; if there is no such scene or condition; or a
        thing cannot be as described.
    ValueRefusedError
        If the road, the sun or the recording cannot be as described.
    """
    if (file.scene is None) == (file.things is None):
        raise SettingsError("must have either scene: a ready one's name, or things: a list (which may be empty: [])")
    ready = _listed(file) if file.scene is None else _ready(file, file.scene)
    scene = replace(
        ready,
        things=ready.things if file.texture == 1 else tuple(textured(thing, file.texture) for thing in ready.things),
        T_world_car=_cameras(file, ready),
        speed_mps=ready.speed_mps if file.speed_mps is None else file.speed_mps,
        conditions=ready.conditions if file.conditions is None else file.conditions,
        towards_sun=ready.towards_sun if file.towards_sun is None else np.array(file.towards_sun),
    )
    settings = DriveSettings(
        frames=max(1, round(file.duration_s * file.fps)),
        fps=file.fps,
        seed=file.seed,
        quality=file.quality,
        effects=combined(scene.conditions),
        maps=file.maps,
    )
    return Drive(scene, settings, None if file.rig is None else folder / file.rig)


def _ready(file: SceneFile, name: str) -> Scene:
    if file.road is not None:
        raise SettingsError("has both scene and road, but a ready scene has its own road: list the things instead")
    if name not in SCENES:
        near = get_close_matches(name, SCENES, 1)
        hint = f"did you mean {near[0]}?" if near else "choose one of these"
        raise SettingsError(f"{name!r:.40} is no ready scene; {hint} ({', '.join(SCENES)})")
    return SCENES[name](file.seed)


def _listed(file: SceneFile) -> Scene:
    road = _road(file.road or RoadEntry())
    things = []
    for number, entry in enumerate(file.things or (), 1):
        try:
            things.append(textured(stood(_stand(entry), number, road, file.seed), entry.texture))
        except ValueRefusedError as error:
            raise SettingsError(f"things.{number}: {error}") from error
    return Scene(tuple(things), road, camera_pose(), seed=file.seed)


def _stand(entry: ThingEntry) -> Stand:
    order = Order(
        entry.type,
        0,
        model=entry.model,
        color=entry.color,
        length_m=entry.length_m,
        width_m=entry.width_m,
        height_m=entry.height_m,
        walking=entry.walking,
        seed=entry.seed,
    )
    return Stand(order, entry.nearest_m, entry.left_m, entry.yaw_deg, entry.speed_mps)


def _road(entry: RoadEntry) -> Road:
    painted = tuple(Line(at.left_m, at.width_m, at.dash_m, at.gap_m) for at in entry.lines or ())
    return Road(
        right_m=entry.right_m,
        left_m=entry.left_m,
        lines=Road().lines if entry.lines is None else painted,
        contrast=entry.contrast,
        curvature_per_m=entry.curvature_per_m,
        curve_from_m=entry.curve_from_m,
        grade=entry.grade,
        grade_from_m=entry.grade_from_m,
        grade_over_m=entry.grade_over_m,
        bank=entry.bank,
        crown_per_m=entry.crown_per_m,
        kerb_m=entry.kerb_m,
        marks=tuple(Mark(at.kind, at.along_m, at.left_m, at.length_m, at.width_m) for at in entry.marks),
    )


def _cameras(file: SceneFile, scene: Scene) -> FloatArray:
    """Return where the cameras are: as in the scene, unless the file says otherwise."""
    if file.height_m is file.pitch_deg is file.roll_deg is None:
        return scene.T_world_car
    height = scene.T_world_car[2, 3] if file.height_m is None else file.height_m
    return camera_pose(float(height), math.radians(file.pitch_deg or 0.0), math.radians(file.roll_deg or 0.0))


def scene_text(file: SceneFile) -> str:
    """Return a scene file as text that `parse_scene` reads back; what is as usual is left out."""
    said = file.model_dump(mode="json", exclude_defaults=True)
    return yaml.safe_dump({"roadblock_scene": VERSION, **said}, sort_keys=False, allow_unicode=True)


def write_scene(file: SceneFile, path: Path) -> None:
    """Write a scene file, whole or not at all.

    Raises
    ------
    OutputError
        If it cannot be written.
    """
    part = path.with_name(f".{path.name}.part")
    try:
        part.write_text(scene_text(file), "utf-8")
        part.replace(path)
    except (OSError, ValueError) as error:
        raise OutputError(f"cannot write {path}: {getattr(error, 'strerror', None) or error}") from error
