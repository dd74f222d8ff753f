import numpy as np
import pytest

from roadblock.viz.colors import INK, PAPER, ink_on, range_color


def test_near_is_red_and_far_is_blue():
    near, far = range_color(2.0), range_color(80.0)
    assert near[0] > 150
    assert near[0] > 3 * max(near[1:])
    assert far[2] > 150
    assert far[2] > 2 * far[0]
    assert range_color(0.01) == near
    assert range_color(1e9) == far


def test_neighbouring_ranges_look_alike_and_far_ones_do_not():
    colors = np.array([range_color(r) for r in np.geomspace(4, 50, 100)], float)
    assert np.abs(np.diff(colors, axis=0)).max() < 25
    assert np.abs(colors[20] - colors[60]).max() > 80


@pytest.mark.parametrize(
    ("background", "ink"), [((255, 255, 255), INK), ((0, 0, 0), PAPER), ((200, 40, 10), PAPER), ((230, 220, 50), INK)]
)
def test_text_contrasts_with_its_background(background, ink):
    assert ink_on(background) == ink
