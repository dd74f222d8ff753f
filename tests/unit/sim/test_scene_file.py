from pathlib import Path

import numpy as np
import pytest

from roadblock.errors import OutputError, RoadblockError, SettingsError
from roadblock.sim.scene_file import MAX_BYTES, SceneFile, parse_scene, read_scene, scene_text, staged, write_scene
from roadblock.sim.scenes import SCENES

HEAD = "roadblock_scene: 1\n"
LISTED = """roadblock_scene: 1
seed: 4
height_m: 1.25
pitch_deg: 3
speed_mps: 1e1
conditions: [rain]
towards_sun: [-1, 2, 2]
texture: 0.5
duration_s: 2.5
fps: 20
quality: preview
rig: cameras/rig.yaml
road:
  kerb_m: 0.1
  lines: [{left_m: 0.5}, {left_m: -3, gap_m: 4}]
  marks:
  - {kind: zebra, along_m: 12, left_m: 0, length_m: 3, width_m: 6}
things:
- {type: person, nearest_m: 7.5, left_m: -1.5, yaw_deg: 90, speed_mps: 1.4, color: red, height_m: 1.6}
- {type: car, nearest_m: 14, left_m: 1, model: small, texture: 0}
"""


def drive(text, folder=Path("somewhere")):
    return staged(parse_scene(text), folder)


def test_a_ready_scene_by_name_is_the_ready_scene():
    made, ready = drive(HEAD + "scene: debris\nseed: 5\n").scene, SCENES["debris"](5)
    assert [t.T_world_thing.tolist() for t in made.things] == [t.T_world_thing.tolist() for t in ready.things]
    assert [p.contrast for t in made.things for p in t.parts] == [p.contrast for t in ready.things for p in t.parts]
    assert made.T_world_car == pytest.approx(ready.T_world_car)
    assert (made.speed_mps, made.seed, made.road) == (ready.speed_mps, 5, ready.road)
    assert made.towards_sun == pytest.approx(ready.towards_sun)


def test_a_ready_scene_takes_changes():
    found = drive(HEAD + "scene: paper\nheight_m: 1.7\nroll_deg: -2\nspeed_mps: 0\nconditions: []\ntexture: 0\n")
    assert found.scene.T_world_car[:3, 3] == pytest.approx([0, 0, 1.7])
    # Rolled by -2 deg, the right side is up.
    assert found.scene.T_world_car[:3, 0] == pytest.approx([0, -np.cos(np.radians(2)), np.sin(np.radians(2))])
    assert found.scene.speed_mps == 0
    assert {p.contrast for t in found.scene.things for p in t.parts} == {0.0}
    assert (found.settings.frames, found.settings.fps, found.rig) == (30, 10, None)
    pitched = drive(HEAD + "scene: night\npitch_deg: 4\n").scene
    assert pitched.T_world_car[2, 3] == pytest.approx(SCENES["night"](0).T_world_car[2, 3])
    assert pitched.T_world_car[2, 2] == pytest.approx(-np.sin(np.radians(4)))


def test_a_list_of_things_on_a_road():
    scene, settings, rig = drive(LISTED, Path("a/b"))
    assert rig == Path("a/b/cameras/rig.yaml")
    assert (settings.frames, settings.fps, settings.seed, settings.quality) == (50, 20, 4, "preview")
    assert settings.effects.weather.rain_mm_h > 0
    person, car = scene.things
    low = person.bounds_m(person.T_world_thing)[0]
    assert (person.id, person.type, person.color) == (1, "person", "red")
    assert low[0] == pytest.approx(7.5, abs=1e-12)
    assert person.size_m[1] == pytest.approx(1.6)
    assert person.velocity_mps == pytest.approx([0, 1.4, 0])
    assert {p.contrast for p in car.parts} == {0.0}
    assert (scene.speed_mps, scene.conditions, scene.seed) == (10.0, ("rain",), 4)
    assert scene.towards_sun == pytest.approx(np.array([-1, 2, 2]) / 3)
    assert scene.T_world_car[2, 3] == 1.25
    assert (scene.road.kerb_m, len(scene.road.lines), scene.road.marks[0].kind) == (0.1, 2, "zebra")
    assert drive(HEAD + "things: []\n").scene.things == ()


def test_a_file_written_is_the_file_read(tmp_path):
    file = parse_scene(LISTED)
    assert parse_scene(scene_text(file)) == file
    write_scene(file, tmp_path / "new.yaml")
    assert [p.name for p in tmp_path.iterdir()] == ["new.yaml"]
    found = read_scene(tmp_path / "new.yaml")
    assert found.rig == tmp_path / "cameras/rig.yaml"
    assert len(found.scene.things) == 2
    assert scene_text(SceneFile(roadblock_scene=1, scene="fork", seed=2)) == HEAD + "scene: fork\nseed: 2\n"


def test_a_bom_is_no_harm(tmp_path):
    (tmp_path / "scene.yaml").write_bytes(b"\xef\xbb\xbf" + HEAD.encode() + b"scene: empty\n")
    assert read_scene(tmp_path / "scene.yaml").scene.things == ()


THING = HEAD + "things:\n- {type: car, nearest_m: 9"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "must hold names with values"),
        ("just words", "must hold names with values"),
        ("- 1\n- 2", "must hold names with values"),
        ("scene: paper", "is no scene file: it must begin with the line roadblock_scene: 1"),
        ("roadblock_scene: 2\nscene: paper", "version '2', but this program reads version 1"),
        ("roadblock_scene: [1]\nscene: paper", "version .* but this program reads version 1"),
        (HEAD + "scene: papr", "'papr' is no ready scene; did you mean paper?"),
        (HEAD + "scene: qqqq", "'qqqq' is no ready scene; choose one of these"),
        (HEAD, "must have either scene: a ready one's name, or things: a list"),
        (HEAD + "scene: paper\nthings: []", "must have either scene"),
        (HEAD + "scene: paper\nroad: {}", "has both scene and road"),
        (HEAD + "scene: paper\nheigth_m: 2", "heigth_m is no known name; did you mean height_m?"),
        (HEAD + "scene: paper\nzzzz: 2", "zzzz is no known name; known: roadblock_scene, scene"),
        (HEAD + "scene: paper\nheight_m: high", "height_m: .*valid number.*, but got 'high'"),
        (HEAD + "scene: paper\nheight_m: -1", "height_m: .*greater than or equal to 0.1, but got '-1'"),
        (HEAD + "scene: paper\nfps: .nan", "fps: .*but got '.nan'"),
        (HEAD + "scene: paper\nfps: nan", "fps: .*finite number, but got 'nan'"),
        (HEAD + "scene: paper\nspeed_mps: inf", "speed_mps: .*, but got 'inf'"),
        (HEAD + "scene: paper\nseed: 1.5", "seed: .*integer.*, but got '1.5'"),
        (HEAD + "scene: paper\nseed: ", "seed: .*, but got ''"),
        (HEAD + "scene: paper\nduration_s: 0", "duration_s: "),
        (HEAD + "scene: paper\ntowards_sun: [1, 2]", "towards_sun.3"),
        (HEAD + "scene: paper\ntowards_sun: [1, 0, -1]", "above the horizon"),
        (HEAD + "scene: paper\nquality: best", "quality must be one of preview"),
        (HEAD + "scene: paper\nconditions: [rane]", "'rane' is no condition; did you mean rain?"),
        (HEAD + "scene: paper\nconditions: rain", "conditions: .*, but got 'rain'"),
        (THING + ", colour: red}", "things.1.colour is no known name; did you mean color?"),
        (THING + "}\n- {type: van}", "things.2.nearest_m is missing"),
        (THING + ", walking: perhaps}", "things.1.walking: .*boolean.*, but got 'perhaps'"),
        (THING + ", model: big}", "things.1: 'big' is no known model"),
        (THING + "}\n- {type: cra, nearest_m: 3}", "things.2: 'cra' is no known type; did you mean car?"),
        (THING + ", height_m: 3}", "things.1: a car takes no height_m"),
        (THING + "}\n- 5", "things.2: "),
        (HEAD + "things: {type: car, nearest_m: 9}", "things: "),
        (HEAD + "things: []\nroad: {bank: 9}", "bank must lie within"),
        (HEAD + "things: []\nroad: {slope: 9}", "road.slope is no known name"),
        (HEAD + "things: []\nroad: {marks: [{kind: zebra, along: 3}]}", "road.marks.1"),
        (HEAD + "things: []\nroad: {lines: [{left: 3, left_m: 1}]}", "road.lines.1.left is no known name; .*left_m"),
        (HEAD + "things: [" + "{type: cone, nearest_m: 3}," * 501 + "]", "things: .*at most 500 items"),
        (HEAD + "scene: paper\nscene: fork", r"says 'scene' twice in one place \(line 3\)"),
        (HEAD + "? [a, b]\n: 1", "must have plain names"),
        (HEAD + "scene: &a paper\nseed: *a", "anchor, alias or tag at line 2"),
        (HEAD + "seed: *a", "anchor, alias or tag|not valid YAML"),
        (HEAD + "scene: !!python/name:os.system x", "anchor, alias or tag at line 2"),
        (HEAD + "things: " + "[" * 50 + "]" * 50, "nested deeper than 6 levels"),
        (HEAD + "things: [1, 2", "is not valid YAML: .* at line"),
        (HEAD + "scene: paper\n\t- x", "is not valid YAML"),
        (HEAD + "scene: pa\x00per", "is not valid YAML: "),
        (HEAD + "---\nscene: paper", "is not valid YAML: "),
    ],
)
def test_what_does_not_fit_is_refused_in_one_line(text, message, tmp_path):
    with pytest.raises(RoadblockError, match=message):
        drive(text)
    (tmp_path / "odd.yaml").write_text(text, "utf-8")
    with pytest.raises(SettingsError, match=f"odd.yaml: .*{message}") as caught:
        read_scene(tmp_path / "odd.yaml")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\xff\xfe\x00\x01\x80", "is no text"),
        (b"# " + b"x" * MAX_BYTES, "is larger than 200 kB"),
        (b"", "must hold names with values"),
    ],
)
def test_files_that_are_none_are_refused(data, message, tmp_path):
    (tmp_path / "odd.yaml").write_bytes(data)
    with pytest.raises(SettingsError, match=f"odd.yaml: {message}"):
        read_scene(tmp_path / "odd.yaml")


def test_missing_files_and_folders_are_refused(tmp_path):
    with pytest.raises(SettingsError, match="there is no such file"):
        read_scene(tmp_path / "none.yaml")
    with pytest.raises(SettingsError, match="cannot be read: "):
        read_scene(tmp_path)
    with pytest.raises(SettingsError, match="cannot be read: "):
        read_scene(Path("a\0b"))
    with pytest.raises(OutputError, match="cannot write"):
        write_scene(SceneFile(roadblock_scene=1, scene="fork"), tmp_path / "no" / "such" / "scene.yaml")
