"""Cells, free space and regions of small worlds in closed form."""

from itertools import pairwise

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from stage_examples import LONG, TWIN, Board, disparity_of, noisy, plane

from roadblock.geometry.stereo import triangulate
from roadblock.stages.segment import (
    SegmentSettings,
    Surface,
    find_free_space,
    find_regions,
    find_stixels,
    lift,
    to_cells,
)
from roadblock.values.frame import DisparityMap
from roadblock.values.scene import EDGE_KINDS, GroundPlane, Region

GROUND = plane(1.4, 0.02, 0.015)
SETTINGS = SegmentSettings()
SIDE, DOWN = TWIN.size_px
LEVEL = plane(1.4, 0.02)
NAN32 = np.float32(np.nan)


# --- to_cells ---------------------------------------------------------------------------------------------------------


def one_cell(values: list[float]) -> float:
    """Return the cell of 4 by 4 pixels that hold these values, scattered, and are unknown elsewhere."""
    pixels = np.full(16, NAN32)
    pixels[np.random.default_rng(len(values)).permutation(16)[: len(values)]] = values
    return float(to_cells(DisparityMap(pixels.reshape(4, 4), 0.5), 4).d_px[0, 0])


def test_a_cell_is_the_median_of_what_is_known() -> None:
    assert one_cell([5, 1, 9, 2, 30, 3, 4, 6, 7]) == 5  # nine values: the middle one
    assert one_cell([1, 2, 3, 4, 7, 8, 9, 90]) == 5.5  # eight: the mean of the two in the middle
    assert one_cell(list(range(1, 17))) == 8.5


def test_a_cell_needs_half_of_its_pixels() -> None:
    assert one_cell([3.0] * 8) == 3
    assert np.isnan(one_cell([3.0] * 7))
    assert np.isnan(one_cell([]))


@pytest.mark.parametrize("cell_px", [1, 2, 3, 4])
def test_cells_are_numpys_medians(cell_px: int) -> None:
    rng = np.random.default_rng(2)
    d = rng.uniform(1, 60, (23, 37)).astype(np.float32)
    d[rng.random(d.shape) < 0.45] = np.nan
    cells = to_cells(DisparityMap(d, 0.4), cell_px)
    assert (cells.cell_px, cells.sigma_px) == (cell_px, 0.4)
    assert cells.d_px.shape == (23 // cell_px, 37 // cell_px)  # what is left over at the far borders is dropped
    for row, column in np.ndindex(cells.d_px.shape):
        block = d[row * cell_px : (row + 1) * cell_px, column * cell_px : (column + 1) * cell_px]
        known = block[np.isfinite(block)]
        expected = np.median(known) if 2 * known.size >= cell_px**2 else np.nan
        np.testing.assert_allclose(cells.d_px[row, column], expected, rtol=1e-6)


def test_an_image_smaller_than_a_cell_has_none() -> None:
    tiny = to_cells(DisparityMap(np.ones((3, 9), np.float32), 0.5), 4)
    assert tiny.d_px.shape == (0, 2)
    surface = lift(tiny, TWIN, None)
    assert find_regions(surface, None, None, SETTINGS) == ()
    free = find_free_space(surface, None, SETTINGS)
    np.testing.assert_array_equal(free.u_px, [1.5, 5.5])
    assert np.isnan(free.range_m).all()


# --- lift -------------------------------------------------------------------------------------------------------------


def test_cells_are_lifted_to_their_place_over_the_road() -> None:
    board = Board(8.0, -1.0, 1.0, 1.7, 0.6)
    surface = lift(disparity_of(GROUND, (board,)), TWIN, GROUND)
    on_board = np.abs(surface.points[..., 2] - 8.0) < 1e-4
    h = surface.height_m[on_board]
    assert h.min() == pytest.approx(0.6, abs=0.11)  # a cell is 0.10 m there
    assert h.max() == pytest.approx(1.7, abs=0.11)
    road = ~on_board & np.isfinite(surface.height_m)
    np.testing.assert_allclose(surface.height_m[road], 0, atol=1e-3)
    assert np.isnan(lift(disparity_of(GROUND, (board,)), TWIN, None).height_m).all()


# --- free space -------------------------------------------------------------------------------------------------------


def free_range(
    disparity: DisparityMap, settings: SegmentSettings = SETTINGS, ground: GroundPlane = GROUND
) -> np.ndarray:
    free = find_free_space(lift(disparity, TWIN, ground), ground, settings)
    np.testing.assert_array_equal(free.u_px, disparity.uvd_px[0, :, 0])
    return free.range_m


def columns_of(board: Board, cell_px: int) -> np.ndarray:
    """Return the columns of cells whose rays meet the board."""
    u = np.arange(SIDE // cell_px) * cell_px + (cell_px - 1) / 2
    x = (u - TWIN.cx_px) / TWIN.f_px * board.z_m - TWIN.baseline_m / 2
    return (x >= board.left_m) & (x < board.right_m)


def test_free_space_ends_at_the_first_thing_on_the_road() -> None:
    near, far = Board(9.0, -1.5, 0.2, 1.2), Board(15.0, -30.0, 30.0, 2.4)
    range_m = free_range(disparity_of(GROUND, (near, far), cell_px=2))
    at_near = columns_of(near, 2)
    np.testing.assert_allclose(range_m[at_near], 9.0, rtol=1e-4)
    beside = ~np.convolve(at_near, np.ones(5), "same").astype(bool)
    np.testing.assert_allclose(range_m[beside], 15.0, rtol=1e-4)


@pytest.mark.parametrize(("high_m", "low_m"), [(0.15, 0.0), (4.0, 2.6)])
def test_what_one_drives_over_or_under_does_not_end_it(high_m: float, low_m: float) -> None:
    thing = Board(8.0, -1.0, 1.0, high_m, low_m)
    range_m = free_range(disparity_of(GROUND, (thing, Board(20.0, -30, 30, 3.0)), cell_px=2))
    assert (range_m[columns_of(thing, 2)] > 12).all()


def test_free_space_ends_where_the_road_was_last_seen() -> None:
    range_m = free_range(disparity_of(GROUND, road_to_m=20.0, cell_px=2))
    assert (range_m < 20).all()
    assert (range_m > 16).all()  # rows of two pixels are 1.9 m apart there, and the last four cells do not count


def test_unobserved_columns_are_unknown() -> None:
    d = disparity_of(GROUND, (Board(12.0, -30, 30, 2.0),), cell_px=2).d_px.copy()
    d[:, 60:100] = np.nan
    range_m = free_range(DisparityMap(d, 0.5, 2))
    assert np.isnan(range_m[62:98]).all()
    assert np.isfinite(range_m[:59]).all()
    assert np.isfinite(range_m[101:]).all()


def test_without_a_road_nothing_is_free() -> None:
    surface = lift(disparity_of(GROUND, (Board(12.0, -30, 30, 2.0),), cell_px=2), TWIN, None)
    free = find_free_space(surface, None, SETTINGS)
    np.testing.assert_array_equal(free.u_px, np.arange(0, SIDE, 2) + 0.5)
    assert np.isnan(free.range_m).all()


def rows_between(near_m: float, far_m: float) -> np.ndarray:
    """Return the rows of cells of 2 px that show the road between two ranges."""
    depth = lift(disparity_of(GROUND, cell_px=2), TWIN, GROUND).points[:, 80, 2]
    return np.flatnonzero((depth > near_m) & (depth < far_m))


def test_a_hole_that_could_hide_something_leaves_its_columns_unknown() -> None:
    d = disparity_of(GROUND, (Board(25.0, -60, 60, 3.0),), cell_px=2).d_px.copy()
    hole = rows_between(6.0, 9.0)
    assert len(hole) * 2 * 6 > 0.35 * 310  # as tall in the image as 0.35 m at 6 m
    d[hole, 40:80] = np.nan
    range_m = free_range(DisparityMap(d, 0.5, 2))
    assert np.isnan(range_m[40:80]).all()  # up to its edges, though a cell is also seen if one beside it is
    np.testing.assert_allclose(range_m[84:], 25, rtol=1e-3)


def test_a_hole_right_before_what_stands_shortens_free_space() -> None:
    d = disparity_of(GROUND, (Board(11.8, -60, 60, 3.0),), cell_px=2).d_px.copy()
    d[rows_between(11.0, 11.8)] = np.nan
    range_m = free_range(DisparityMap(d, 0.5, 2), SegmentSettings(free_gap_m=0.02))
    assert ((range_m > 0.9 * 11.0) & (range_m < 11.8)).all()


def test_a_hole_too_small_to_hide_anything_is_passed() -> None:
    d = disparity_of(GROUND, (Board(25.0, -60, 60, 3.0),), cell_px=2).d_px.copy()
    hole = rows_between(6.0, 6.4)
    assert 0 < len(hole) * 2 * 6.6 < 0.35 * 310
    d[hole] = np.nan
    np.testing.assert_allclose(free_range(DisparityMap(d, 0.5, 2)), 25, rtol=1e-3)
    small = SegmentSettings(free_gap_m=0.03)
    assert np.isnan(free_range(DisparityMap(d, 0.5, 2), small)).all()


def test_a_hole_at_the_lower_border_leaves_everything_unknown() -> None:
    d = disparity_of(GROUND, (Board(25.0, -60, 60, 3.0),), cell_px=2).d_px.copy()
    d[-40:, 40:80] = np.nan
    range_m = free_range(DisparityMap(d, 0.5, 2))
    assert np.isnan(range_m[43:77]).all()
    np.testing.assert_allclose(range_m[84:], 25, rtol=1e-3)


def test_cameras_that_look_at_the_sky_know_of_no_hole() -> None:
    up = plane(1.4, -0.6)
    assert np.isnan(free_range(disparity_of(up, cell_px=2), ground=up)).all()


def test_cameras_that_look_down_see_road_in_every_row() -> None:
    down = plane(2.5, 0.5)
    disparity = disparity_of(down, cell_px=2)
    assert np.isfinite(disparity.d_px).all()
    farthest = lift(disparity, TWIN, down).points[0, :, 2]
    range_m = free_range(disparity, ground=down)
    assert (range_m <= farthest).all()
    assert (range_m > 0.9 * farthest).all()


@pytest.mark.parametrize("seed", range(6))
def test_free_space_is_never_longer_than_it_is(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boards = []
    for _ in range(6):
        z, x = rng.uniform(4, 25), rng.uniform(-6, 6)
        boards.append(Board(z, x, x + rng.uniform(0.6, 2), rng.uniform(0.7, 2.4)))
    boards.append(Board(28.0, -80, 80, 3.0))
    truth = np.min([np.where(columns_of(b, 2), b.z_m, np.inf) for b in boards], axis=0)
    range_m = free_range(disparity_of(GROUND, tuple(boards), cell_px=2))
    assert (range_m <= truth * 1.01).all()
    assert np.mean(range_m > 0.9 * truth) > 0.85


def test_a_support_larger_than_the_image_asks_for_all_of_it() -> None:
    tiny = DisparityMap(np.full((1, 7), 9.0, np.float32), 0.5, 2)
    assert find_free_space(lift(tiny, TWIN, GROUND), GROUND, SETTINGS).range_m.shape == (7,)
    free_range(disparity_of(GROUND, cell_px=2), SegmentSettings(free_area_px=1e6))


def test_one_stray_cell_ends_nothing() -> None:
    d = disparity_of(GROUND, (Board(20.0, -60, 60, 3.0),), cell_px=2).d_px.copy()
    d[40, 80] = 310 * 0.31 / 5.0
    np.testing.assert_allclose(free_range(DisparityMap(d, 0.5, 2)), 20, rtol=1e-3)


def test_one_stray_cell_before_a_thing_does_not_move_it() -> None:
    d = disparity_of(GROUND, (Board(10.0, -60, 60, 2.0),), cell_px=2).d_px.copy()
    d[45, 80] = 310 * 0.31 / 9.7
    np.testing.assert_allclose(free_range(DisparityMap(d, 0.5, 2)), 10, rtol=1e-3)


# --- regions ----------------------------------------------------------------------------------------------------------


def regions_of(
    disparity: DisparityMap,
    settings: SegmentSettings = SETTINGS,
    ground: GroundPlane | None = GROUND,
    image: np.ndarray | None = None,
) -> tuple[Region, ...]:
    w, h = disparity.cell_px, disparity.cell_height_px
    colors = None if image is None else image[h // 2 :: h, w // 2 :: w]
    found = find_regions(lift(disparity, TWIN, ground), colors, ground, settings)
    for region in found:
        check(region)
    return found


def check(region: Region) -> None:
    u0, v0, u1, v1 = region.box_px
    assert 0 <= u0 < u1 <= SIDE
    assert 0 <= v0 < v1 <= DOWN
    contour = region.contour_px
    assert contour.dtype == np.int32
    assert contour.shape[1] == 2
    assert (contour >= (u0, v0)).all()
    assert (contour < (u1, v1)).all()
    u, v, d = region.surface_uvd_px.T
    assert (d > 0).all()
    assert ((u > u0) & (u < u1) & (v > v0) & (v < v1)).all()


def box_of(board: Board) -> np.ndarray:
    """Return the true box of a board that stands on the road."""
    f, z, half = TWIN.f_px, board.z_m, TWIN.baseline_m / 2
    middle = (board.left_m + board.right_m) / 2
    foot = GROUND.point_below(middle, z)[1] * f / z + TWIN.cy_px
    head = (GROUND.point_below(middle, z)[1] - board.high_m / -GROUND.normal[1]) * f / z + TWIN.cy_px
    left, right = ((x + half) * f / z + TWIN.cx_px for x in (board.left_m, board.right_m))
    return np.array([left, head, right, foot])


LEFT_BOX, RIGHT_BOX = Board(8.0, -2.6, -1.3, 1.3), Board(8.0, 0.3, 1.4, 1.1)


def test_two_boxes_are_two_regions_with_their_boxes_down_to_the_road() -> None:
    found = regions_of(disparity_of(GROUND, (LEFT_BOX, RIGHT_BOX)))
    assert len(found) == 2
    for region, board in zip(sorted(found, key=lambda r: r.box_px), (LEFT_BOX, RIGHT_BOX), strict=True):
        np.testing.assert_allclose(region.box_px, box_of(board), atol=4.1)  # one cell
        assert abs(region.box_px[3] - box_of(board)[3]) < 2.5  # though cells below 0.35 m do not count
        area = cv2.contourArea(region.contour_px)
        width, height = np.subtract(region.box_px[2:], region.box_px[:2])
        assert area > 0.85 * width * height
        np.testing.assert_allclose(region.surface_uvd_px[:, 2], 310 * 0.31 / 8, rtol=1e-5)


def test_one_before_the_other_is_two_regions_nearest_first() -> None:
    found = regions_of(disparity_of(GROUND, (Board(14.0, -1.5, 2.5, 2.6), Board(7.0, -0.5, 0.6, 1.2))))
    assert [round(310 * 0.31 / float(np.median(r.surface_uvd_px[:, 2]))) for r in found] == [7, 14]


def striped(cells: int) -> DisparityMap:
    d = disparity_of(GROUND, (Board(6.0, -1.5, 1.5, 1.5),)).d_px.copy()
    d[:, 40 : 40 + cells] = np.nan
    return DisparityMap(d, 0.5, 4)


def test_small_holes_are_bridged() -> None:
    assert len(regions_of(striped(1))) == 1
    assert len(regions_of(striped(2))) == 2
    assert len(regions_of(striped(1), SegmentSettings(gap_px=4))) == 2
    assert len(regions_of(striped(5), SegmentSettings(gap_px=24))) == 1


@pytest.mark.parametrize("gap_px", [1, 3, 7])
def test_direct_neighbours_belong_together_though_cells_are_larger_than_the_gap(gap_px: int) -> None:
    d = np.full((5, 9), 12.0, np.float32)
    for cell in ((4, 4), (8, 4), (64, 64)):
        surface = lift(DisparityMap(d, 0.5, *cell), TWIN, None)
        (region,) = find_regions(surface, None, None, SegmentSettings(gap_px=gap_px, area_px=0))
        assert len(region.surface_uvd_px) == d.size


def test_neighbours_of_like_disparity_belong_together_though_metres_apart() -> None:
    """Two halves at 30 and 32 m differ by 0.2 px."""
    halves = (Board(30.0, -3.0, 0.0, 3.0), Board(32.0, -0.1, 3.0, 3.0))
    assert len(regions_of(disparity_of(GROUND, halves))) == 1
    assert len(regions_of(disparity_of(GROUND, halves), SegmentSettings(link_px=0.05))) == 2


def hedge_ranges(from_m: float, to_m: float, settings: SegmentSettings = SETTINGS) -> list[tuple[float, float]]:
    """Return nearest and farthest range of each piece of a hedge beside the road."""
    slices = tuple(Board(z, -5.0, -4.6, 1.6) for z in np.arange(from_m, to_m, 0.1))
    surface = lift(disparity_of(GROUND, slices, twin=LONG), LONG, GROUND)
    depths = [900 * 0.5 / r.surface_uvd_px[:, 2] for r in find_regions(surface, None, GROUND, settings)]
    return [(float(z.min()), float(z.max())) for z in depths]


def test_a_long_hedge_is_cut_into_pieces() -> None:
    pieces = hedge_ranges(13.0, 40.0)
    assert len(pieces) >= 2
    assert pieces[0][0] == pytest.approx(13.0, abs=0.2)
    assert pieces[-1][1] == pytest.approx(40.0, abs=2)
    assert all(begin >= end - 1e-6 for (_, end), (begin, _) in pairwise(pieces))
    assert pieces[0][1] - pieces[0][0] < 8


def test_a_short_hedge_is_whole() -> None:
    assert len(hedge_ranges(13.0, 19.0)) == 1
    assert len(hedge_ranges(13.0, 19.0, SegmentSettings(split_m=2.0))) >= 2


def test_things_hanging_over_the_road_are_left_out() -> None:
    assert regions_of(disparity_of(GROUND, (Board(12.0, -3, 3, 3.4, 2.2),))) == ()
    assert len(regions_of(disparity_of(GROUND, (Board(12.0, -3, 3, 3.4, 0.7),)))) == 1
    assert len(regions_of(disparity_of(GROUND, (Board(12.0, -3, 3, 3.4, 2.2),)), SegmentSettings(overhead_m=3.0))) == 1


def test_low_things_and_far_things_are_left_out() -> None:
    assert regions_of(disparity_of(GROUND, (Board(8.0, -2, 2, 0.3),))) == ()
    assert len(regions_of(disparity_of(GROUND, (Board(8.0, -2, 2, 0.3),)), SegmentSettings(height_m=(0.1, 4.0)))) == 1
    wall = disparity_of(GROUND, (Board(50.0, -10, 10, 4.0),))
    assert len(regions_of(wall)) == 1
    assert regions_of(wall, SegmentSettings(reach_m=45.0)) == ()


def test_specks_are_dropped() -> None:
    speck = disparity_of(GROUND, (Board(20.0, -0.5, 0.5, 1.0),))  # 15 by 10 px count
    assert regions_of(speck) == ()
    assert len(regions_of(speck, SegmentSettings(area_px=60))) == 1


def windowed(board: Board, far_m: float) -> DisparityMap:
    """A board with a window in its middle, half as wide and high, that shows something far."""
    d = disparity_of(GROUND, (board,)).d_px.copy()
    u0, v0, u1, v1 = (box_of(board) / 4).astype(int)
    d[v0 + 2 : (v0 + v1) // 2, u0 + 4 : u1 - 4] = 310 * 0.31 / far_m
    return DisparityMap(d, 0.5, 4)


def test_what_is_seen_through_a_nearer_solid_thing_is_left_out() -> None:
    found = regions_of(windowed(Board(6.0, -1.6, 1.4, 1.9), 13.0))
    assert len(found) == 1
    assert np.median(found[0].surface_uvd_px[:, 2]) == pytest.approx(310 * 0.31 / 6, rel=1e-4)


def test_what_is_seen_through_an_open_frame_is_kept() -> None:
    d = disparity_of(GROUND, (Board(6.0, -1.6, 1.4, 1.9),)).d_px.copy()
    u0, v0, u1, v1 = (box_of(Board(6.0, -1.6, 1.4, 1.9)) / 4).astype(int)
    inner = disparity_of(GROUND, (Board(13.0, -5, 5, 3.0),)).d_px
    d[v0 + 2 : v1 + 1, u0 + 2 : u1 - 2] = inner[v0 + 2 : v1 + 1, u0 + 2 : u1 - 2]
    ranges = [float(np.median(310 * 0.31 / r.surface_uvd_px[:, 2])) for r in regions_of(DisparityMap(d, 0.5, 4))]
    assert ranges == pytest.approx([6, 13], rel=1e-3)


def test_without_a_road_what_is_near_is_still_reported() -> None:
    only = disparity_of(None, (Board(7.0, -1.0, 1.0, 0.8, -0.6),))
    (region,) = regions_of(only, ground=None)
    z = 310 * 0.31 / region.surface_uvd_px[:, 2]
    np.testing.assert_allclose(z, 7, rtol=1e-4)
    rows = only.uvd_px[np.isfinite(only.d_px)][:, 1]
    assert region.box_px[3] == rows.max() + 2.5  # no road to reach down to


def test_a_thing_with_an_arm_reaches_the_road_under_its_body_only() -> None:
    body, arm = Board(6.0, -0.5, 0.5, 1.6), Board(6.0, 0.4, 1.6, 1.5, 1.1)
    (region,) = regions_of(disparity_of(GROUND, (body, arm)))
    filled = np.zeros((DOWN, SIDE), np.uint8)
    cv2.drawContours(filled, [region.contour_px], -1, 1, cv2.FILLED)
    arm_columns = slice(int(box_of(arm)[0]) + 10, int(box_of(arm)[2]) - 4)
    at_foot = int(box_of(body)[3]) - 6
    assert not filled[at_foot, arm_columns].any()
    assert filled[at_foot, int(box_of(body)[0]) + 6 : int(box_of(body)[2]) - 6].all()
    assert filled[int(box_of(arm)[1]) + 8, arm_columns].all()


def test_a_region_carries_the_mean_colour_of_its_cells() -> None:
    image = np.zeros((DOWN, SIDE, 3), np.uint8)
    image[:] = (10, 200, 30)
    u0, v0, u1, v1 = box_of(LEFT_BOX).astype(int)
    image[v0 - 8 : v1 + 8, u0 - 8 : u1 + 8] = (180, 40, 90)
    disparity = disparity_of(GROUND, (LEFT_BOX, RIGHT_BOX))
    left, right = sorted(regions_of(disparity, image=image), key=lambda r: r.box_px)
    np.testing.assert_allclose(left.color_rgb, (180, 40, 90))
    np.testing.assert_allclose(right.color_rgb, (10, 200, 30))
    deep, _ = sorted(regions_of(disparity, image=image.astype(np.uint16) * 257), key=lambda r: r.box_px)
    np.testing.assert_allclose(deep.color_rgb, (180, 40, 90))
    grey, _ = regions_of(disparity)
    assert np.isnan(grey.color_rgb).all()


def test_the_noise_of_a_region_is_its_shared_error_and_the_scatter_of_its_cells() -> None:
    (smooth,) = regions_of(disparity_of(GROUND, (LEFT_BOX,)))
    assert smooth.sigma_d_px == pytest.approx(0.25)
    (rough,) = regions_of(noisy(disparity_of(GROUND, (LEFT_BOX,)), 0.15, 0))
    assert rough.sigma_d_px == pytest.approx(np.hypot(0.25, 0.15), rel=0.1)


@pytest.mark.parametrize("seed", range(3))
def test_noise_neither_tears_nor_joins_the_boxes(seed: int) -> None:
    found = regions_of(noisy(disparity_of(GROUND, (LEFT_BOX, RIGHT_BOX)), 0.15, seed))
    assert len(found) == 2
    for region, board in zip(sorted(found, key=lambda r: r.box_px), (LEFT_BOX, RIGHT_BOX), strict=True):
        np.testing.assert_allclose(region.box_px, box_of(board), atol=6)


@pytest.mark.parametrize("shape", [(1, 1), (1, 9), (9, 1), (2, 3), (3, 2)])
def test_grids_smaller_than_the_gaps_are_linked_all_the_same(shape: tuple[int, int]) -> None:
    d = np.full(shape, 12.0, np.float32)
    surface = lift(DisparityMap(d, 0.5, 4), TWIN, None)
    settings = SegmentSettings(gap_px=32, area_px=0)
    (region,) = find_regions(surface, None, None, settings)
    assert len(region.surface_uvd_px) == d.size


def test_every_cell_may_stand() -> None:
    disparity = DisparityMap(np.full((2, 2), 9.0, np.float32), 0.5, 4)
    surface = Surface(disparity, TWIN, np.full((2, 2), 5, np.float32), np.ones((2, 2), np.float32))
    assert len(find_regions(surface, None, None, SegmentSettings(area_px=0))) == 1


@pytest.mark.parametrize(
    ("bad", "says"),
    [
        ({"height_m": (4.0, 0.35)}, "the first must be below the second"),
        ({"free_height_m": (2.5, 2.5)}, "the first must be below the second"),
        ({"split_m": 1e-9}, "greater than or equal to 0.5"),
        ({"reach_m": float("inf")}, "finite"),
        ({"gap_px": 65}, "less than or equal to 64"),
        ({"free_area_px": 0}, "greater than 0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object], says: str) -> None:
    with pytest.raises(ValidationError, match=says):
        SegmentSettings.model_validate(bad)


# --- kerbs, stixels, lattices -----------------------------------------------------------------------------------------


def with_pavement(kerb_m: float, left_m: float) -> DisparityMap:
    """Return the road with a pavement `kerb_m` higher to the left of x = `left_m`, in closed form."""
    road, pavement = disparity_of(LEVEL, cell_px=2), disparity_of(plane(1.4 - kerb_m, 0.02), cell_px=2)
    face = road.d_px.copy()
    x_m = triangulate(TWIN, pavement.uvd_px)[..., 0]
    x_road_m = triangulate(TWIN, road.uvd_px)[..., 0]
    u = road.uvd_px[..., 0]
    is_face = (x_m >= left_m) & (x_road_m < left_m)
    with np.errstate(invalid="ignore", divide="ignore"):
        face_d = TWIN.f_px * TWIN.baseline_m / ((left_m + TWIN.baseline_m / 2) * TWIN.f_px / (u - TWIN.cx_px))
    d = np.where(x_m < left_m, pavement.d_px, np.where(is_face, face_d, face)).astype(np.float32)
    return DisparityMap(d, 0.5, 2)


def test_a_pavement_is_a_kerb_and_no_obstacle() -> None:
    disparity = with_pavement(0.14, -1.5)
    surface = lift(disparity, TWIN, LEVEL)
    free = find_free_space(surface, LEVEL, SETTINGS)
    assert free.edges is not None
    seen = np.isfinite(free.edges.range_m)
    assert seen.sum() >= 15
    assert {EDGE_KINDS[kind] for kind in free.edges.kind[seen]} == {"kerb"}
    np.testing.assert_allclose(free.edges.height_m[seen], 0.14, atol=0.04)
    x_m = (free.u_px - TWIN.cx_px) / TWIN.f_px * free.edges.range_m - TWIN.baseline_m / 2
    np.testing.assert_allclose(x_m[seen], -1.5, atol=0.1)
    assert (free.range_m[seen] > free.edges.range_m[seen] + 1).all()
    assert find_regions(surface, None, LEVEL, SETTINGS) == ()


def test_an_even_road_and_what_stands_on_it_have_no_kerb() -> None:
    for boards in ((), (Board(9.0, -1.5, 0.2, 1.2), Board(6.0, 0.5, 1.0, 0.15))):
        for seed in range(3):
            disparity = noisy(disparity_of(GROUND, boards, cell_px=2), 0.1, seed)
            free = find_free_space(lift(disparity, TWIN, GROUND), GROUND, SETTINGS)
            assert free.edges is not None
            assert np.isnan(free.edges.range_m).all()


def test_stixels_are_the_columns_of_what_stands() -> None:
    near, far = Board(8.0, -1.0, 0.0, 1.5), Board(14.0, -3.0, 3.0, 3.0)
    disparity = disparity_of(GROUND, (near, far))
    surface = lift(disparity, TWIN, GROUND)
    assert find_stixels(surface, SETTINGS) is None
    stixels = find_stixels(surface, SegmentSettings(stixels=True))
    assert stixels is not None
    is_near = np.isclose(stixels.range_m, 8.0, rtol=1e-4)
    np.testing.assert_allclose(stixels.range_m[~is_near], 14.0, rtol=1e-4)
    columns = disparity.uvd_px[0, :, 0]
    np.testing.assert_array_equal(np.unique(stixels.u_px[is_near]), columns[columns_of(near, 4)])
    assert set(columns[columns_of(near, 4)]) <= set(stixels.u_px[~is_near])  # what looks over it is one of its own
    np.testing.assert_allclose(stixels.height_m[is_near], 1.5, atol=0.12)
    assert (stixels.bottom_px > stixels.top_px).all()


def test_what_stands_behind_a_fence_is_seen_through_it() -> None:
    car = Board(12.0, -1.5, 1.5, 1.5)
    pickets = tuple(Board(6.0, x, x + 0.13, 1.2) for x in np.arange(-2, 2, 0.35))
    person = Board(6.0, -0.3, 0.3, 1.8)
    for before, through in ((pickets, True), ((person,), False), ((), False)):
        surface = lift(disparity_of(GROUND, (car, *before), cell_px=2), TWIN, GROUND)
        regions = find_regions(surface, None, GROUND, SETTINGS)
        at_car = [r for r in regions if np.median(r.surface_uvd_px[:, 2]) < TWIN.f_px * TWIN.baseline_m / 10]
        assert at_car
        assert {region.is_seen_through for region in at_car} == {through}
