import math

import numpy as np
import pytest

from roadblock.viz.text import draw_text, fit_text, measure_text, text_width


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (12.34, 0.21, "12.3 ± 0.2 m"),
        (12.34, 0.0951, "12.3 ± 0.1 m"),
        (5.0, 0.042, "5.00 ± 0.04 m"),
        (1.6, 0.0042, "1.600 ± 0.004 m"),
        (75.0, 4.44, "75.0 ± 4.4 m"),
        (12.34, math.nan, "12.3 m"),
    ],
)
def test_measure_text(value, sigma, text):
    assert measure_text(value, sigma) == text


@pytest.mark.parametrize("height", [13, 20, 30])
@pytest.mark.parametrize("text", ["12.3 ± 0.2 m", "red obstacle", "±", ""])
def test_drawn_text_stays_within_its_stated_width(text, height):
    image = np.zeros((80, 600, 3), np.uint8)
    draw_text(image, text, (20, 50), height, (255, 255, 255))
    _, columns = np.nonzero(image.any(axis=2))
    assert len(columns) > 0 or not text
    assert ((columns >= 18) & (columns <= 20 + text_width(text, height) + 1)).all()


def test_plus_minus_is_a_plus_over_a_bar():
    image = np.zeros((60, 60, 3), np.uint8)
    draw_text(image, "±", (10, 45), 30, (255, 255, 255))
    ink = image[..., 0] > 128
    widths = ink.sum(axis=1)
    rows = np.flatnonzero(widths)
    bars = np.flatnonzero(widths == widths.max())
    assert bars.min() > rows.min()  # the upright sticks out above the cross bar
    assert bars.max() >= rows.max() - 1  # the lower bar is lowest
    assert (widths == 0)[bars.min() : bars.max()].any()  # and apart from the plus


def test_fit_text_shortens_to_the_width():
    text = "left and right exposure differ"
    full = text_width(text, 13)
    assert fit_text(text, 13, full) == text
    short = fit_text(text, 13, full // 2)
    assert short.endswith("...")
    assert text.startswith(short[:-3])
    assert text_width(short, 13) <= full // 2
    assert fit_text(text, 13, 2) == ""
