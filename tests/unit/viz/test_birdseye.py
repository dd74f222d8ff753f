import math

import numpy as np
import pytest
from drawn import obstacle_at, result_of, rig_of

from roadblock.values.camera import Rectification
from roadblock.values.scene import FreeSpace, RoadEdges
from roadblock.viz.birdseye import draw_birds_eye, plot_range_m
from roadblock.viz.colors import EDGE_COLORS, FREE_GROUND, IN_VIEW, PANEL, PAPER, range_color

SIZE, TEXT = (300, 380), 13
MARGIN = 1.9 * TEXT


def pixel_of(rig: Rectification, x: float, z: float) -> tuple[int, int]:
    """Row and column of a point of the road, by hand: equal scales, origin at the middle of the lower margin."""
    scale = (SIZE[1] - 2 * MARGIN) / plot_range_m(rig)
    return round(SIZE[1] - MARGIN - scale * z), round(SIZE[0] / 2 + scale * x)


def draw(rig, *obstacles, **changes):
    return draw_birds_eye(result_of(rig, *obstacles, **changes), rig, SIZE, TEXT)


def shares(picture, rows, columns, color):
    return (picture[rows, columns] == color).all(axis=-1).mean()


def test_plot_reaches_as_far_as_the_rig_measures():
    # 0.2 * f * B, down to the next step: KITTI, a 0.2 m rig, a webcam pair, a toy.
    cases = {(721.5, 0.537): 60, (1033.0, 0.205): 40, (500.0, 0.12): 10, (300.0, 0.06): 10, (5000.0, 1.0): 60}
    for (f, baseline), expected in cases.items():
        assert plot_range_m(Rectification(f, 10, 10, baseline, (97, 61))) == expected


def test_free_is_green_up_to_its_range_and_grey_behind():
    rig = rig_of(641, 363)
    picture = draw(rig)  # free up to 15 m everywhere; the plot reaches 30 m
    assert plot_range_m(rig) == 30
    for x in (-2.0, 1.0, 3.0):
        assert tuple(picture[pixel_of(rig, x, 12.0)]) == FREE_GROUND
        assert tuple(picture[pixel_of(rig, x, 18.0)]) == IN_VIEW


def test_unobserved_sectors_are_hatched_and_never_green():
    rig = rig_of(641, 363)
    u = np.arange(3.5, 641, 8)
    picture = draw(rig, free_space=FreeSpace(u, np.where(u < rig.cx_px, 15.0, math.nan)))
    row, column = pixel_of(rig, 3.0, 12.0)
    patch = (slice(row - 9, row + 9), slice(column - 9, column + 9))
    assert shares(picture, *patch, FREE_GROUND) == 0
    assert 0.2 < shares(picture, *patch, IN_VIEW) < 0.8
    assert 0.2 < shares(picture, *patch, PANEL) < 0.8
    assert tuple(picture[pixel_of(rig, -3.0, 12.0)]) == FREE_GROUND


def test_edges_are_dots_on_the_free_road():
    rig = rig_of(641, 363)
    u, z = np.array([200.5, 400.5]), np.array([9.0, 12.0])
    edges = RoadEdges(z, z / 90, np.array([1, 2], np.uint8))
    picture = draw(rig, free_space=FreeSpace(u, np.full(2, 15.0), None, edges))
    for column, range_m, kind in zip(u, z, ("kerb", "verge"), strict=True):
        x = (column - rig.cx_px) / rig.f_px * range_m - rig.baseline_m / 2
        assert tuple(picture[pixel_of(rig, x, range_m)]) == EDGE_COLORS[kind]


@pytest.mark.parametrize(
    "free",
    [
        FreeSpace(np.zeros(0), np.zeros(0)),
        *(FreeSpace(np.arange(3.5, 641, 8), np.full(80, r)) for r in (math.nan, math.inf, 0.0, -9.0)),
    ],
)
def test_nothing_observed_shows_no_green(free):
    picture = draw(rig_of(641, 363), free_space=free)
    assert shares(picture, slice(None), slice(None), FREE_GROUND) == 0


def test_outside_the_view_is_dark():
    rig = rig_of(641, 363)
    assert tuple(draw(rig)[pixel_of(rig, -5.0, 1.0)]) == PANEL


def test_obstacle_stands_where_it_is_as_wide_as_it_is():
    rig = rig_of(641, 363)
    obstacle = obstacle_at(rig, 2.0, 20.0, sigma=math.nan)
    picture = draw(rig, obstacle)
    rows, columns = np.nonzero((picture == range_color(20.0)).all(axis=-1))
    row, column = pixel_of(rig, 2.0, 20.0)
    scale = (SIZE[1] - 2 * MARGIN) / 30
    assert columns.mean() == pytest.approx(column, abs=1)
    assert np.ptp(columns) + 1 == pytest.approx(1.8 * scale, abs=3)
    assert rows.max() <= row  # it extends behind its front face


def test_known_length_is_drawn():
    rig = rig_of(641, 363)
    long = draw(rig, obstacle_at(rig, 2.0, 10.0, sigma=math.nan, size_m=np.array([1.8, 1.5, 8.0])))
    rows, _ = np.nonzero((long == range_color(10.0)).all(axis=-1))
    assert np.ptp(rows) + 1 == pytest.approx(8.0 * (SIZE[1] - 2 * MARGIN) / 30, abs=4)


def test_sigma_bar_lies_along_the_line_of_sight():
    rig = rig_of(641, 363)
    x, z, sigma = 4.0, 20.0, 5.0
    sure, unsure = (draw(rig, obstacle_at(rig, x, z, sigma=s)) for s in (math.nan, sigma))
    changed = (sure != unsure).any(axis=-1)
    rows, columns = np.nonzero(changed)
    near, far = (pixel_of(rig, x / z * r, r) for r in (z - sigma, z + sigma))
    assert rows.max() == pytest.approx(near[0], abs=4)
    assert rows.min() == pytest.approx(far[0], abs=4)
    assert columns[rows >= near[0] - 1].mean() == pytest.approx(near[1], abs=3)
    assert unsure[changed].min(axis=-1).max() > 0.7 * min(PAPER)  # light, whatever it lies on


def test_a_bar_of_no_length_is_drawn():
    rig = rig_of(641, 363)
    draw(rig, obstacle_at(rig, 4.0, 20.0, sigma=0.0))


def test_what_does_not_fit_is_counted():
    rig = rig_of(641, 363)
    corner = (slice(0, 2 * TEXT), slice(SIZE[0] // 2, None))
    beyond = (obstacle_at(rig, 0.0, 90.0), obstacle_at(rig, 14.0, 20.0))
    assert (draw(rig, *beyond)[corner] != draw(rig)[corner]).any()
    rest = draw(rig, *beyond)
    rest[corner] = draw(rig)[corner]
    assert np.array_equal(rest, draw(rig))
