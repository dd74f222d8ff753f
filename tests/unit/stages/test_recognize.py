"""The eleven basic colour terms."""

import numpy as np
import pytest

from roadblock.stages.recognize import name_colors

CANONICAL = {
    "black": [(0, 0, 0), (25, 25, 28), (45, 42, 44)],
    "gray": [(90, 90, 90), (128, 128, 128), (150, 155, 152)],
    "white": [(255, 255, 255), (235, 238, 240), (210, 210, 208)],
    "red": [(255, 0, 0), (190, 38, 34), (140, 20, 25)],
    "orange": [(255, 140, 0), (232, 116, 26)],
    "yellow": [(255, 255, 0), (226, 186, 30), (250, 230, 90)],
    "green": [(0, 255, 0), (36, 130, 62), (90, 120, 60)],
    "blue": [(0, 0, 255), (38, 70, 170), (110, 160, 220)],
    "purple": [(128, 0, 128), (120, 60, 160)],
    "pink": [(255, 192, 203), (255, 120, 170), (240, 130, 130)],
    "brown": [(139, 69, 19), (101, 67, 33), (90, 60, 30)],
}


@pytest.mark.parametrize(("name", "rgb"), [(name, rgb) for name, colors in CANONICAL.items() for rgb in colors])
def test_canonical_colours_have_their_names(name: str, rgb: tuple[int, int, int]) -> None:
    assert name_colors([np.array(rgb, float)]) == [name]


def test_the_terms_are_the_eleven() -> None:
    grid = np.stack(np.meshgrid(*3 * [np.linspace(0, 255, 12)]), -1).reshape(-1, 3)
    assert set(name_colors(list(grid))) == set(CANONICAL)


def test_greys_go_from_black_to_white_and_never_back() -> None:
    names = name_colors([np.full(3, float(level)) for level in range(256)])
    order = ["black", "gray", "white"]
    assert [n for n in order for _ in range(names.count(n))] == names
    assert all(names.count(n) > 40 for n in order)


@pytest.mark.parametrize("rgb", [(np.nan, np.nan, np.nan), (10.0, np.nan, 3.0), (np.inf, 0.0, 0.0)])
def test_an_unknown_colour_has_no_name(rgb: tuple[float, float, float]) -> None:
    red = np.array([255.0, 0.0, 0.0])
    assert name_colors([red, np.array(rgb), red]) == ["red", None, "red"]


def test_nothing_has_no_colours() -> None:
    assert name_colors([]) == []
