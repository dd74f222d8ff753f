"""Settings from TOML and from assignments, good and hostile; and that docs/pipeline.md lists them all."""

import re
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from roadblock.config import Settings, load_settings, make_settings
from roadblock.errors import SettingsError

PAGE = Path(__file__).parents[2] / "docs/pipeline.md"


def refusal(*assignments: str, path: Path | None = None) -> str:
    with pytest.raises(SettingsError) as caught:
        load_settings(path, assignments)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    return message


# --- what is read -----------------------------------------------------------------------------------------------------


def test_without_anything_all_is_as_described() -> None:
    assert load_settings() == Settings()


@pytest.mark.parametrize(
    ("assignment", "section", "key", "value"),
    [
        ("match.disparities=64", "match", "disparities", 64),
        (" match.disparities = 64", "match", "disparities", 64),
        ("segment.reach_m=40", "segment", "reach_m", 40.0),
        ("segment.reach_m=4.5e+1", "segment", "reach_m", 45.0),
        ("match.mode=3way", "match", "mode", "3way"),
        ("ground.height_m=[0.5, 2]", "ground", "height_m", (0.5, 2.0)),
        ("rectify.size_px=[640, 360]", "rectify", "size_px", (640, 360)),
        ("rectify.f_px=null", "rectify", "f_px", None),
        ("refine.level=off", "refine", "level", "off"),
        ("match.both_ways=yes", "match", "both_ways", True),
        ("match={disparities: 32, block_px: 5}", "match", "block_px", 5),
    ],
)
def test_an_assignment_sets_its_key_and_no_other(assignment: str, section: str, key: str, value: object) -> None:
    settings = load_settings(None, [assignment])
    assert getattr(getattr(settings, section), key) == value
    others = {name for name in Settings.model_fields if name != section}
    assert all(getattr(settings, name) == getattr(Settings(), name) for name in others)


def test_later_assignments_win_and_equal_signs_belong_to_the_value() -> None:
    assert load_settings(None, ["match.disparities=32", "match.disparities=96"]).match.disparities == 96
    assert load_settings(None, ["detector=a:b=c"]).detector == "a:b=c"


def test_toml_is_read_and_assignments_go_on_top(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    path.write_text('detector = "dense"\n[match]\ndisparities = 64\nblock_px = 5\n[ground]\nheight_m = [0.5, 2.0]\n')
    settings = load_settings(path, ["match.block_px=7"])
    assert (settings.match.disparities, settings.match.block_px) == (64, 7)
    assert settings.ground.height_m == (0.5, 2.0)


def test_settings_survive_their_own_record() -> None:
    settings = load_settings(None, ["match.disparities=64", "rectify.size_px=[64, 36]"])
    assert make_settings(settings.model_dump(mode="json")) == settings


def test_settings_cannot_be_changed() -> None:
    settings = Settings()
    with pytest.raises(ValidationError, match="frozen"):
        settings.match.disparities = 32


# --- what is refused --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["", "match.disparities", "=3", " =3", "match.disparities:64"])
def test_what_is_no_assignment_is_refused(text: str) -> None:
    assert f"must look like stage.key=value, but got {text!r}" in refusal(text)


@pytest.mark.parametrize(
    ("assignment", "nearest"),
    [
        ("match.disparites=64", "match.disparities"),
        ("mach.disparities=64", "match"),
        ("segment.reachm=3", "segment.reach_m"),
        ("detecter=dense", "detector"),
        ("match..disparities=3", "match."),
        ("segment.split.deeper=3", "segment.split_m"),
    ],
)
def test_an_unknown_key_is_refused_and_the_nearest_is_named(assignment: str, nearest: str) -> None:
    message = refusal(assignment)
    assert message.startswith("unknown setting ")
    assert f"did you mean {nearest}" in message


def test_an_unknown_key_lists_the_known_ones() -> None:
    message = refusal("health.foo=1")
    assert message == "unknown setting health.foo: did you mean health.failed_share? Known: matched_share, failed_share"


@pytest.mark.parametrize(
    ("assignments", "says"),
    [
        (["match=3"], "setting match = 3: Input should be a valid dictionary"),
        (["match=", "match.disparities=64"], "match.disparities: match is a value, not a section"),
        (["match=3", "match.disparities=64"], "match.disparities: match is a value, not a section"),
        (["match.disparities=64", "match.disparities.x=64"], "match.disparities.x: disparities is a value"),
        (["match.disparities.x=64"], "setting match.disparities = {'x': 64}: Input should be a valid integer"),
        (["match.disparities=many"], "setting match.disparities = 'many': Input should be a valid integer"),
        (["match.disparities="], "setting match.disparities = None: Input should be a valid integer"),
        (["match.disparities=100"], "multiple of 16"),
        (["match.disparities=[64]"], "= [64]: Input should be a valid integer"),
        (["match.block_px=4"], "setting match.block_px = 4: must be odd"),
        (["match.matcher=elas"], "'bm' or 'onnx'"),
        (["detector=3"], "setting detector = 3: Input should be a valid string"),
        (["ground.height_m=[2, 1]"], "the first must be below the second"),
        (["ground.height_m=[1]"], "ground.height_m.1"),
        (["ground.near_m=.inf"], "finite"),
        (["ground.near_m=.nan"], "finite"),
        (["ground.near_m=-3"], "greater than 0"),
        (["rectify.size_px=[640.5, 360]"], "rectify.size_px.0 = 640.5"),
        (["rectify.size_px=[0, 360]"], "greater than 0"),
        (["match={1: 2}"], "Keys should be strings"),
    ],
)
def test_a_value_that_does_not_fit_is_refused(assignments: list[str], says: str) -> None:
    assert says in refusal(*assignments)


@pytest.mark.parametrize("section", [name for name in Settings.model_fields if name != "detector"])
def test_every_section_refuses_strangers_and_infinities(section: str) -> None:
    assert "unknown setting" in refusal(f"{section}.stranger=1")
    fields = type(getattr(Settings(), section)).model_fields
    for key in (name for name, info in fields.items() if "float" in str(info.annotation)):
        value = "[.inf, .inf]" if "tuple" in str(fields[key].annotation) else ".inf"
        assert "finite" in refusal(f"{section}.{key}={value}")


BOMB = "{" + ", ".join(f"k{i}: &k{i} [{', '.join([f'*k{i - 1}'] * 9) if i else 'lol'}]" for i in range(30)) + "}"


@pytest.mark.parametrize(
    "value",
    [
        BOMB,
        "&a [*a]",
        "!!python/object/apply:os.system [ls]",
        "!!binary |",
        "[" * 1200,
        "9" * 5000,
        "2001-13-45",
        "0x_",
        "{[1]: 2}",
        '"open',
        "a: b: c",
        "\x00\x07",
        "- 1\n- x",
        "word\nword",
    ],
)
@pytest.mark.parametrize("key", ["match.disparities", "ground.height_m", "stranger\nkey"])
def test_hostile_values_are_one_clear_line(key: str, value: str) -> None:
    assert refusal(f"{key}={value}")


@pytest.mark.parametrize("value", ["2001-13-45", "0x_", '"open', "=", "a: b: c", "[" * 1200])
def test_what_is_no_yaml_is_a_word(value: str) -> None:
    assert load_settings(None, [f"detector={value}"]).detector == value


@pytest.mark.parametrize(
    "content",
    [b"match = ", b"\xff\xfe\x00", b"a = 1\na = 2", b"a = " + b"[" * 5000, b"a = " + b"9" * 5000, b"[match\n", b"\x00"],
    ids=["cut", "binary", "twice", "deep", "long", "open", "zero"],
)
def test_files_that_are_no_toml_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "set.toml"
    path.write_bytes(content)
    assert "cannot be read as TOML settings" in refusal(path=path)


def test_files_that_are_none_are_refused(tmp_path: Path) -> None:
    assert "cannot be read" in refusal(path=tmp_path / "missing.toml")
    assert "cannot be read" in refusal(path=tmp_path)
    assert "cannot be read" in refusal(path=Path("with\0zero"))


def test_a_file_with_an_unknown_key_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "set.toml"
    path.write_text("[match]\ndisparites = 64\n")
    assert "did you mean match.disparities" in refusal(path=path)
    path.write_text("match = 3\n")
    assert "match is a value, not a section" in refusal("match.disparities=64", path=path)


# --- the page ---------------------------------------------------------------------------------------------------------


def settings_table() -> str:
    """Return the table that docs/pipeline.md must hold."""
    rows = ["| setting | default | limits | meaning |", "| --- | --- | --- | --- |"]
    rows += rows_of("", Settings)
    return "\n".join(rows)


def rows_of(prefix: str, model: type[BaseModel]) -> list[str]:
    rows = []
    for name, info in model.model_fields.items():
        if isinstance(info.default, BaseModel):
            rows += rows_of(f"{name}.", type(info.default))
            continue
        limits = ", ".join(text for item in info.metadata if (text := limit(item)))
        default = list(info.default) if isinstance(info.default, tuple) else info.default
        shown = "not given" if default is None else f"`{default}`"
        rows.append(f"| `{prefix}{name}` | {shown} | {choices(info.annotation) or limits} | {info.description} |")
    return rows


def limit(item: Any) -> str:
    found = re.fullmatch(r"(Ge|Gt|Le|Lt|MultipleOf)\(\w+=(.*)\)", str(item))
    assert found, f"a limit of a kind the table does not know: {item}"
    signs = {"Ge": ">=", "Gt": ">", "Le": "<=", "Lt": "<", "MultipleOf": "multiple of"}
    return f"{signs[found[1]]} {float(found[2]):g}"


def choices(annotation: Any) -> str:
    found = re.fullmatch(r"typing\.Literal\[(.*)\]", str(annotation))
    return found[1].replace("'", "`") if found else ""


def test_every_setting_is_described() -> None:
    for name, info in Settings.model_fields.items():
        if not isinstance(info.default, BaseModel):
            assert info.description, name
            continue
        for key, inner in type(info.default).model_fields.items():
            assert inner.description, f"{name}.{key}"
            assert inner.description.endswith((".", "...")), f"{name}.{key}"


def test_the_page_lists_every_setting_as_it_is() -> None:
    """When this fails, put the output of `python tests/unit/test_config.py` into the page."""
    assert settings_table() in PAGE.read_text("utf-8")


if __name__ == "__main__":
    print(settings_table())  # noqa: T201
