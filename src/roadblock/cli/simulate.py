"""`roadblock simulate`: a scene in; a recorded drive with exact truth out, which `detect` opens like any other."""

from collections import Counter
from dataclasses import replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated

import typer

from roadblock.cli.detect import INTERRUPTED
from roadblock.cli.rig import FormatOption, SizeOption, UnitOption, open_rig
from roadblock.cli.terminal import frames, note, progress_bar, say
from roadblock.errors import SettingsError
from roadblock.io.rig import write_rig
from roadblock.sim import drive
from roadblock.sim.conditions import CONDITIONS, combined
from roadblock.sim.drive import DriveSettings
from roadblock.sim.render import QUALITIES
from roadblock.sim.scene import Scene, paper_rig
from roadblock.sim.scene_file import read_scene
from roadblock.sim.scenes import SCENES
from roadblock.values.camera import StereoRig

RIG = "rig.yaml"


def simulate(
    scene: Annotated[str | None, typer.Argument(help="Name of a ready scene (see --list), or a SCENE.yaml.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the recording.")] = None,
    seed: Annotated[
        int | None, typer.Option(help="Of a ready scene and its noise; of a SCENE.yaml's noise alone.", min=0)
    ] = None,
    number: Annotated[int | None, typer.Option("--frames", help="How many pairs.", min=1)] = None,
    fps: Annotated[float | None, typer.Option(help="Pairs per second.")] = None,
    quality: Annotated[str | None, typer.Option(help=f"Of the rendering: {', '.join(QUALITIES)}.")] = None,
    condition: Annotated[
        list[str] | None, typer.Option(help=f"Weather: {', '.join(CONDITIONS)}; may be repeated.")
    ] = None,
    rig: Annotated[Path | None, typer.Option(help="Rig file, instead of the scene's or the paper's rig.")] = None,
    maps: Annotated[bool, typer.Option("--maps", help="Write disparities and ids of every pixel as well.")] = False,
    listed: Annotated[bool, typer.Option("--list", help="Show the ready scenes and leave.")] = False,
    unit: UnitOption = "m",
    size: SizeOption = None,
    rig_format: FormatOption = None,
) -> None:
    """Record a drive through a simulated scene; an interrupted one goes on where it stopped."""
    if listed:
        for name, make in SCENES.items():
            say(f"{name:9} {in_words(make(0))}")
        return
    if scene is None:
        raise SettingsError("name a scene: a ready one (see roadblock simulate --list) or a SCENE.yaml")
    if out is None:
        raise SettingsError("a drive needs a folder to be recorded into: add --out DIR")
    world, settings, rig_file = open_scene(scene, seed)
    settings = replace(
        settings,
        seed=settings.seed if seed is None else seed,
        frames=settings.frames if number is None else number,
        fps=settings.fps if fps is None else fps,
        quality=quality or settings.quality,
        effects=combined(tuple(condition)) if condition else settings.effects,
        maps=maps or settings.maps,
    )
    chosen = rig or rig_file
    cameras = paper_rig() if chosen is None else open_rig(chosen, rig_format, unit, size)
    record(world, cameras, settings, out)


def open_scene(name: str, seed: int | None) -> tuple[Scene, DriveSettings, Path | None]:
    """Return the scene of a name or a file, how it is recorded unless options say otherwise, and its rig file.

    Raises
    ------
    SettingsError
        If there is neither a scene nor a file of that name, or the file is none of ours.
    """
    if name in SCENES:
        scene = SCENES[name](seed or 0)
        return scene, DriveSettings(seed=seed or 0, effects=combined(scene.conditions)), None
    path = Path(name)
    if path.suffix.lower() not in (".yaml", ".yml") and not path.is_file():
        near = get_close_matches(name, SCENES, 1)
        hint = f"did you mean {near[0]}?" if near else "choose one of these"
        raise SettingsError(f"{name!r:.40} is no ready scene and no file; {hint} ({', '.join(SCENES)})")
    return read_scene(path)


def record(scene: Scene, rig: StereoRig, settings: DriveSettings, out: Path) -> None:
    """Record a drive under a progress bar, and say where it is; leave with 130 after Ctrl-C."""
    taken = drive.simulate(scene, rig, settings, out)
    write_rig(rig, out / RIG)
    done = 0
    try:
        with progress_bar() as progress:
            task = progress.add_task("rendering", total=settings.frames)
            for done in taken:
                progress.update(task, completed=done)
    except KeyboardInterrupt:
        note(f"interrupted after {frames(done)} of {settings.frames}; the same command goes on from there")
        raise typer.Exit(INTERRUPTED) from None
    say(f"recording: {out} ({frames(done)})")


def in_words(scene: Scene) -> str:
    """Return one line about a scene: what stands and moves in it, where, how fast, and the weather."""
    counts = Counter(thing.type for thing in scene.things if thing.id)
    things = ", ".join(f"{count} {kind}" for kind, count in counts.most_common()) or "nothing on the road"
    road = [word for word, has in (("bends", scene.road.curvature_per_m), ("climbs", scene.road.grade)) if has]
    speed = f"at {scene.speed_mps * 3.6:.0f} km/h" if scene.speed_mps else "standing"
    return "; ".join([things, *(f"the road {word}" for word in road), speed, *scene.conditions])
