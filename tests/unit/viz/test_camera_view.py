import math

import numpy as np
import pytest
from drawn import obstacle_at, result_of, rig_of

from roadblock.errors import ValueRefusedError
from roadblock.values.motion import Track
from roadblock.values.scene import FreeSpace, GroundPlane, Obstacle, RoadEdges, Stixels
from roadblock.viz.camera_view import (
    OBSTACLE_ALPHA,
    _hidden,
    _overlaps,
    draw_camera_view,
    label_texts,
    place_labels,
    rgb8,
    road_rows,
    road_top,
    view_box,
)
from roadblock.viz.colors import EDGE_COLORS, range_color


def test_grey_and_colour_become_rgb_and_stay_untouched(image):
    assert np.array_equal(rgb8(image), image)
    grey = np.asfortranarray(image[..., 0])
    assert np.array_equal(rgb8(grey), np.dstack([grey] * 3))
    view = image.view()
    view.flags.writeable = False
    rgb8(view)[:] = 0  # a copy: the caller's image is not drawn on
    assert image.any()


@pytest.mark.parametrize("shape", [(40, 60), (40, 60, 3)])
def test_16_bit_is_stretched(shape):
    ramp = np.linspace(1000, 3000, math.prod(shape)).reshape(shape).astype(np.uint16)
    picture = rgb8(ramp)
    assert picture.dtype == np.uint8
    assert picture.shape == (40, 60, 3)
    assert picture.min() == 0
    assert picture.max() == 255
    middle = float(picture[20, 30].mean())
    assert middle == pytest.approx(127.5, abs=16)


def test_flat_16_bit_image_is_drawn():
    assert np.ptp(rgb8(np.full((9, 7), 500, np.uint16))) == 0


@pytest.mark.parametrize(
    "bad", [np.zeros((9, 7)), np.zeros((9, 7, 4), np.uint8), np.zeros(9, np.uint8), np.zeros((9, 7, 3, 1), np.uint8)]
)
def test_what_is_no_image_is_refused(bad):
    with pytest.raises(ValueRefusedError, match="must be grey or RGB"):
        rgb8(bad)


def test_road_rows_of_a_flat_road_by_hand(rig):
    # Cameras 1.6 m over a level road: v = cy + f * h / z.
    ground = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.6)
    free = FreeSpace(np.array([10.0, 300.0, 600.0]), np.array([5.0, 10.0, 40.0]))
    expected = rig.cy_px + rig.f_px * 1.6 / free.range_m
    assert road_rows(free, ground, rig) == pytest.approx(expected, abs=1e-9)


def test_road_rows_of_a_tilted_bent_road_by_construction(rig):
    ground = result_of(rig).ground
    free = FreeSpace(np.array([10.0, 300.0, 600.0]), np.array([5.0, 10.0, 40.0]))
    for u, z, v in zip(free.u_px, free.range_m, road_rows(free, ground, rig), strict=True):
        x = (u - rig.cx_px) / rig.f_px * z - rig.baseline_m / 2
        y = (v - rig.cy_px) / rig.f_px * z
        height = ground.normal @ (x, y, z) + ground.height_m - ground.bend_per_m * z**2
        assert height == pytest.approx(0, abs=1e-9)


def test_kerbs_and_verges_are_dotted_where_they_are(rig):
    u, z = np.array([100.0, 300.0, 500.0]), np.array([6.0, 9.0, math.nan])
    edges = RoadEdges(z, z / 60, np.array([1, 2, 0], np.uint8))
    grey = np.full((rig.size_px[1], rig.size_px[0]), 90, np.uint8)
    result = result_of(rig, free_space=FreeSpace(u, np.full(3, 15.0), None, edges))
    picture = draw_camera_view(grey, result, rig, 1.0, 13)
    rows = road_rows(FreeSpace(u, z), result.ground, rig)
    assert tuple(picture[round(rows[0]), 100]) == EDGE_COLORS["kerb"]
    assert tuple(picture[round(rows[1]), 300]) == EDGE_COLORS["verge"]
    others = draw_camera_view(grey, result_of(rig, free_space=FreeSpace(u, np.full(3, 15.0))), rig, 1.0, 13)
    assert (picture[:, 480:] == others[:, 480:]).all()


def test_stixels_tint_their_place(rig):
    stixels = Stixels(*np.array([[101.5, 105.5], [40, 50], [90, 95], [8.0, 30.0]]), np.ones(2))
    grey = np.full((rig.size_px[1], rig.size_px[0]), 90, np.uint8)
    unseen = FreeSpace(np.zeros(0), np.zeros(0))
    picture = draw_camera_view(grey, result_of(rig, stixels=stixels, free_space=unseen), rig, 1.0, 13)
    for column, row, range_m in ((100, 41, 8.0), (103, 89, 8.0), (104, 51, 30.0), (107, 94, 30.0)):
        expected = OBSTACLE_ALPHA * np.array(range_color(range_m)) + (1 - OBSTACLE_ALPHA) * 90
        np.testing.assert_allclose(picture[row, column], expected, atol=1)
    for column, row in ((99, 60), (108, 60), (101, 39), (101, 90), (105, 95)):
        assert (picture[row, column] == 90).all()


def test_unobserved_columns_are_not_free(rig):
    ranges = np.array([8.0, math.nan, math.inf, 0.0, -3.0, 8.0])
    free = FreeSpace(np.arange(3.5, 48, 8), ranges)
    top = road_top(free, result_of(rig).ground, rig, 1.0, rig.size_px[0])
    known = np.isfinite(top)
    assert known[:8].all()
    assert not known[8:40].any()
    assert known[40:48].all()
    assert not known[48:].any()


@pytest.mark.parametrize("scale", [1.0, 2.0, 3.0])
def test_road_top_follows_the_scale(rig, scale):
    width = round(rig.size_px[0] * scale)
    free = FreeSpace(np.array([100.0]), np.array([8.0]))
    top = road_top(free, result_of(rig).ground, rig, scale, width)
    row = road_rows(free, result_of(rig).ground, rig)[0]
    columns = np.flatnonzero(np.isfinite(top))  # a single column stands for its own pixel alone
    assert columns.mean() == pytest.approx((100 + 0.5) * scale - 0.5, abs=0.5)
    assert len(columns) == max(1, scale)
    assert top[columns] == pytest.approx((row + 0.5) * scale - 0.5)


def test_only_the_free_road_is_tinted(rig, image):
    u = np.arange(3.5, 641, 8)
    ranges = np.where(u < 320, 8.0, math.nan)
    result = result_of(rig, free_space=FreeSpace(u, ranges))
    picture = draw_camera_view(image, result, rig, 1.0, 13)
    changed = (picture != image).any(axis=2)
    top = road_rows(result.free_space, result.ground, rig)[10]
    column = int(u[10])
    assert not changed[: math.ceil(top), column].any()
    assert changed[math.ceil(top) :, column].all()
    assert not changed[:, 325:].any()
    greener = picture.astype(int) - image
    assert greener[-40:, :300, 1].mean() > greener[-40:, :300, 0].mean() + 20


def test_without_ground_or_free_space_nothing_is_tinted(rig, image):
    unseen = FreeSpace(np.arange(3.5, 641, 8), np.full(80, math.nan))
    for result in (result_of(rig, ground=None), result_of(rig, free_space=unseen)):
        assert np.array_equal(draw_camera_view(image, result, rig, 1.0, 13), image)


@pytest.mark.parametrize("scale", [0.37, 1.0, 2.0])
def test_box_is_half_open_and_cut_to_the_picture(rig, scale):
    obstacle = obstacle_at(rig, 0.0, 10.0, box_px=(-50, 20, 100, 5000))
    assert view_box(obstacle, scale, (200, 150)) == (0, round(20 * scale), round(100 * scale), 150)
    outside = obstacle_at(rig, 0.0, 10.0, box_px=(900, 900, 950, 950))
    assert view_box(outside, scale, (200, 150)) == (199, 149, 200, 150)


def test_the_outline_lies_on_the_box(rig):
    black = np.zeros((363, 641, 3), np.uint8)
    obstacle = obstacle_at(rig, 1.0, 10.0)
    picture = draw_camera_view(black, result_of(rig, obstacle, ground=None), rig, 1.0, 13)
    u0, v0, u1, v1 = obstacle.box_px
    assert picture[v1 - 1, u0:u1].any(axis=1).all()
    assert picture[v0:v1, u1 - 1].any(axis=1).all()
    assert picture[(v0 + v1) // 2, (u0 + u1) // 2].any()  # filled, half transparent
    assert not picture[v1 + 4 :].any()


def test_obstacles_without_contour_are_framed(rig, image):
    obstacle = obstacle_at(rig, 1.0, 10.0, contour_px=np.zeros((0, 2), np.int32))
    picture = draw_camera_view(image, result_of(rig, obstacle, ground=None), rig, 1.0, 13)
    assert (picture != image).any()


def test_label_names_the_class_or_else_the_colour(rig):
    assert label_texts(obstacle_at(rig, 0, 10.0)) == ("red obstacle 10.0 ± 0.2 m", "10.0 ± 0.2 m")
    assert label_texts(obstacle_at(rig, 0, 10.0, color=None))[0] == "obstacle 10.0 ± 0.2 m"
    assert label_texts(obstacle_at(rig, 0, 10.0, label="car"))[0] == "red car 10.0 ± 0.2 m"


def tracked(obstacle: Obstacle, motion: str, ttc_s: float) -> Obstacle:
    zero, cov = np.zeros(3), np.eye(3)
    v = np.array([3.0, -4.0])
    return obstacle.with_track(Track(12, 1.0, 0.0, zero, cov, v, cov[:2, :2], True, motion, ttc_s, 0.1))


def test_label_of_a_track_has_its_number_and_what_is_urgent(rig):
    obstacle = obstacle_at(rig, 0, 10.0)
    assert label_texts(tracked(obstacle, "standing", np.nan))[1] == "#12 10.0 ± 0.2 m"
    assert label_texts(tracked(obstacle, "moving", 8.0))[1] == "#12 10.0 ± 0.2 m, 5.0 m/s"
    assert label_texts(tracked(obstacle, "moving", 1.234))[1] == "#12 10.0 ± 0.2 m, 5.0 m/s"  # 4.9 m aside by then
    ahead = obstacle_at(rig, -5.0, 11.0)
    assert label_texts(tracked(ahead, "moving", 1.234))[0] == "red obstacle #12 11.0 ± 0.2 m, 5.0 m/s, in 1.2 s"


@pytest.mark.parametrize("size", [(320, 240), (641, 363), (1920, 1080)])
def test_labels_of_a_crowd_never_overlap_nor_leave_the_picture(size):
    rig = rig_of(*size)
    random = np.random.default_rng(11)
    crowd = tuple(
        obstacle_at(rig, x, z) for x, z in zip(random.uniform(-9, 9, 60), random.uniform(2, 70, 60), strict=True)
    )
    labels = place_labels(crowd, 1.0, 13, size)
    assert 4 <= len(labels) < 60
    for index, (_, rect, _) in enumerate(labels):
        assert 0 <= rect[0] < rect[2] <= size[0]
        assert 0 <= rect[1] < rect[3] <= size[1]
        assert not _overlaps(rect, [other for _, other, _ in labels[:index]])


@pytest.mark.parametrize("seed", range(3))
def test_no_label_hides_much_of_its_own_or_a_nearer_box(rig, seed):
    random, size = np.random.default_rng(seed), (641, 363)
    crowd = [obstacle_at(rig, x, z) for x, z in zip(random.uniform(-6, 6, 30), random.uniform(10, 40, 30), strict=True)]
    labels = place_labels(tuple(crowd), 1.0, 13, size)
    assert len(labels) >= 4
    boxes = {range_color(o.range_m): (o.range_m, view_box(o, 1.0, size)) for o in crowd}
    for _, rect, color in labels:
        mine_m, _ = boxes[color]
        assert all(_hidden(rect, box) <= 0.1 for range_m, box in boxes.values() if range_m <= mine_m)


def test_the_nearest_is_labelled_in_full_whatever_the_order(rig):
    near, far = obstacle_at(rig, 0.0, 6.0), obstacle_at(rig, 0.1, 30.0)
    for order in ((near, far), (far, near)):
        assert place_labels(order, 1.0, 13, (641, 363))[0][0] == "red obstacle 6.0 ± 0.2 m"


def test_a_label_avoids_nearer_obstacles_where_it_can(rig):
    near = obstacle_at(rig, 0.0, 6.0)
    far = obstacle_at(rig, 1.2, 20.0)
    labels = place_labels((near, far), 1.0, 13, (641, 363))
    assert len(labels) == 2
    assert not _overlaps(labels[1][1], [view_box(near, 1.0, (641, 363))])


def test_overlap_is_half_open():
    assert _overlaps((0, 0, 10, 10), [(9, 9, 20, 20)])
    assert not _overlaps((0, 0, 10, 10), [(10, 0, 20, 10), (0, 10, 10, 20)])
