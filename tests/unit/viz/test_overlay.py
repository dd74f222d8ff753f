import math

import numpy as np
import pytest
from drawn import obstacle_at, result_of, rig_of

from roadblock.errors import ValueRefusedError
from roadblock.values.decision import Decision
from roadblock.values.scene import FreeSpace, Health
from roadblock.viz.colors import ACTION, INK, STATE
from roadblock.viz.overlay import draw_overlay, view_scale
from roadblock.viz.text import text_width


@pytest.mark.parametrize(
    ("size", "scale"),
    [((320, 240), 2), ((1242, 375), 1), ((1280, 720), 1), ((3840, 2160), 0.5), ((97, 61), 6), ((1000, 10), 1.92)],
)
def test_view_scale(size, scale):
    assert view_scale(size) == scale


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize("size", [(97, 61), (320, 240), (1242, 375), (400, 700)])
def test_any_image_gives_one_picture(size, channels, dtype):
    rig = rig_of(*size)
    image = np.random.default_rng(5).integers(0, np.iinfo(dtype).max, (size[1], size[0], *channels), dtype)
    before = image.copy()
    result = result_of(rig, obstacle_at(rig, 0.5, 8.0), obstacle_at(rig, -2.0, 200.0, sigma=math.nan))
    picture = draw_overlay(image, result, rig)
    assert picture.dtype == np.uint8
    assert picture.ndim == 3
    assert picture.shape[1] > size[0] * view_scale(size)
    assert picture.shape[0] > size[1] * view_scale(size)
    assert np.array_equal(image, before)


def test_ultra_high_definition_is_reduced():
    rig = rig_of(3840, 2160)
    picture = draw_overlay(np.zeros((2160, 3840), np.uint8), result_of(rig, obstacle_at(rig, 0.5, 8.0)), rig)
    assert picture.shape == (1080 + 60, 1920 + 864, 3)


def test_a_failed_frame_is_drawn(rig, image):
    unseen = FreeSpace(np.arange(3.5, 641, 8), np.full(80, math.nan))
    result = result_of(
        rig, ground=None, free_space=unseen, timings_ms={}, health=Health("failed", ("no road",) * 40), name="x" * 500
    )
    picture = draw_overlay(image, result, rig)
    assert np.array_equal(picture[-363:, :641], image)


def test_header_shows_the_decision_in_its_colour(rig, image):
    for action, color in ACTION.items():
        header = draw_overlay(image, result_of(rig, decision=Decision(action, "a wall ahead")), rig)[:40].astype(int)
        quiet = draw_overlay(image, result_of(rig, decision=Decision("none", "free")), rig)[:40].astype(int)
        nearest, before = (np.abs(strip - color).sum(axis=-1).min() for strip in (header, quiet))
        assert nearest < before / 2


def test_header_shows_the_state_in_its_colour(rig, image):
    for state, color in STATE.items():
        header = draw_overlay(image, result_of(rig, health=Health(state)), rig)[:20].astype(int)
        # Thin smoothed strokes may not reach the full colour, but come nearer to it than to the other states'.
        nearest = {other: np.abs(header - ink).sum(axis=-1).min() for other, ink in STATE.items()}
        assert min(nearest, key=lambda other: nearest[other]) == state, (color, nearest)


def test_header_texts_do_not_run_into_each_other(rig, image):
    result = result_of(rig, obstacle_at(rig, 0, 8.0), obstacle_at(rig, 2, 9.0), name="n" * 400)
    short, long = (draw_overlay(image, r, rig)[:26] for r in (result_of(rig), result))
    blank = (long == INK).all(axis=-1).all(axis=0)
    text_px = 13
    # "ok   12 ms" begins here, whatever stands left of it.
    right = short.shape[1] - 2 * text_px - text_width("ok", text_px) - text_width("12 ms", text_px)
    assert np.array_equal(short[:, right:], long[:, right:])
    assert blank[right - 8 : right].all()
    assert not blank[: right - 20].all()


@pytest.mark.parametrize("shape", [(363, 640, 3), (362, 641), (641, 363), (641,)])
def test_an_image_of_another_size_is_refused(rig, shape):
    with pytest.raises(ValueRefusedError, match="the rig is for 641x363"):
        draw_overlay(np.zeros(shape, np.uint8), result_of(rig), rig)


def test_an_image_of_another_type_is_refused(rig):
    with pytest.raises(ValueRefusedError, match="8 or 16 bit"):
        draw_overlay(np.zeros((363, 641), np.float32), result_of(rig), rig)
