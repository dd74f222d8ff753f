"""What is said of a thing without any network: contour, size, outline, direction, type, colour."""

import math
from dataclasses import replace

import numpy as np
import pytest

from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.stages.recognize import RecognizeSettings, make_recognizer, weigh_motion
from roadblock.stages.recognize.types import CLASSES, label, moving_odds, shipped_model
from roadblock.stages.triangulate import locate_all
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.motion import Track
from roadblock.values.scene import Detections, FreeSpace, GroundPlane, Obstacle, Region

F_PX, CX, CY, BASELINE_M = 700.0, 302.5, 121.0, 0.4
TWIN = Rectification(F_PX, CX, CY, BASELINE_M, (611, 301))
ROAD = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.5)
FREE = FreeSpace(np.arange(3.5, 611, 4), np.full(152, 30.0))
ROAD_GREY = 112
"""sRGB of asphalt in the light that lightness is told in."""


def scene(uvd: FloatArray, rgb: tuple[int, int, int] | None, box: tuple[int, int, int, int]) -> tuple:
    """Return a pair with one thing of one colour, exactly `box`, before a road; and what a detector sees of it."""
    image = np.full((301, 611, 3), ROAD_GREY, np.uint8)
    if rgb is not None:
        u0, v0, u1, v1 = box
        image[v0:v1, u0:u1] = rgb
    else:
        image = image[..., 0].copy()
    pair = RectifiedPair(image, image, TWIN)
    region = Region(box, np.array([[box[0], box[1]], [box[2] - 1, box[3] - 1]], np.int32), uvd, 0.2, np.full(3, 120.0))
    return pair, Detections((region,), ROAD, FREE, 0.9), (region,), locate_all([region], TWIN, ROAD, [None])


def cells_of(box: tuple[int, int, int, int], z_m: float = 10.0, foot_m: float = 0.35) -> FloatArray:
    """Return cells that cover a box, and as a matcher does a little more of it, from `foot_m` over the road upwards."""
    u0, v0, u1, _ = box
    foot = CY + F_PX * (1.5 - foot_m) / z_m
    u, v = np.meshgrid(np.arange((u0 - 2) // 4 * 4 + 1.5, u1 + 2, 4), np.arange(v0 // 4 * 4 + 1.5, foot, 4))
    return np.stack([u.ravel(), v.ravel(), np.full(u.size, F_PX * BASELINE_M / z_m)], -1)


def recognized(
    uvd: FloatArray,
    rgb: tuple[int, int, int] | None = (186, 36, 34),
    box: tuple[int, int, int, int] = (250, 91, 371, 227),
    T: FloatArray | None = None,
) -> Obstacle:
    return make_recognizer(RecognizeSettings(), T)(*scene(uvd, rgb, box))[0]


# --- contour and size -------------------------------------------------------------------------------------------------


def test_the_contour_follows_the_image_not_the_cells() -> None:
    """The box's edges lie inside cells: by 2, 3, 1 and 3 pixels."""
    box = (250, 91, 371, 227)
    found = recognized(cells_of(box), box=box)
    u, v = found.contour_px.T
    assert (u.min(), u.max()) == (pytest.approx(250, abs=1), pytest.approx(370, abs=1))
    assert v.min() == pytest.approx(91, abs=1)
    assert v.max() == pytest.approx(CY + F_PX * 1.5 / 10, abs=2)
    assert len(found.contour_px) > 20


def test_sizes_are_those_of_the_edges_and_their_sigmas_cover_them() -> None:
    box = (250, 91, 371, 227)
    found = recognized(cells_of(box), box=box)
    width_m, height_m = 121 * 10 / F_PX, 1.5 + (CY - 90.5) * 10 / F_PX
    assert found.size_m[0] == pytest.approx(width_m, abs=0.03)
    assert found.size_m[1] == pytest.approx(height_m, abs=0.03)
    assert 0.01 < found.size_sigma_m[0] < 0.2
    assert 0.01 < found.size_sigma_m[1] < 0.1
    assert np.isnan(found.size_m[2])
    assert np.isnan(found.size_sigma_m[2])


def test_a_vehicle_ends_over_the_road() -> None:
    """Below its lower edge, 0.15 m over the road, one sees the road under it: 10.5 px at 10 m."""

    class Sure:
        def __init__(self, name: str) -> None:
            self.name = name

        def probabilities(self, inputs: FloatArray) -> FloatArray:
            return np.array([[float(name == self.name) for name in CLASSES]] * len(inputs))

    ends = []
    for name in ("wall", "car"):
        recognize = make_recognizer(RecognizeSettings())
        recognize.model = Sure(name)
        found = recognize(*scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227)))[0]
        assert found.label == name
        ends.append(found.contour_px[:, 1].max())
    assert ends[0] - ends[1] == pytest.approx(0.15 * F_PX / 10, abs=1)


def test_without_a_road_the_height_stays_what_was_measured() -> None:
    pair, found, regions, _ = scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227))
    obstacles = locate_all(regions, TWIN, None, [None])
    seen = make_recognizer(RecognizeSettings())(pair, replace(found, ground=None), regions, obstacles)[0]
    assert seen.size_m[1] == obstacles[0].size_m[1]
    assert len(seen.contour_px) > 20


def test_a_detector_that_does_not_match_keeps_its_own_shapes() -> None:
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227))
    seen = make_recognizer(RecognizeSettings())(pair, replace(found, matched_share=math.nan), regions, obstacles)[0]
    np.testing.assert_array_equal(seen.contour_px, regions[0].contour_px)
    np.testing.assert_array_equal(seen.size_m, obstacles[0].size_m)
    assert seen.color == "red"


# --- outline and direction --------------------------------------------------------------------------------------------


def box_cells(yaw_rad: float, length_m: float, width_m: float, x_m: float = 3.0, z_m: float = 12.0) -> FloatArray:
    """Return cells on the two visible faces of an upright box around (x, z), which runs `yaw_rad` to the right."""
    along, across = np.array([np.sin(yaw_rad), np.cos(yaw_rad)]), np.array([np.cos(yaw_rad), -np.sin(yaw_rad)])
    faces = []
    for normal, reach, side, half in ((along, length_m, across, width_m), (across, width_m, along, length_m)):
        middle = np.array([x_m, z_m]) - np.sign(normal @ (x_m, z_m)) * normal * reach / 2
        faces.append(middle + np.linspace(-half / 2, half / 2, 60)[:, None] * side)
    x, z = np.concatenate(faces).T
    rows = np.arange(60.0, 190, 8)
    u, d = (x + BASELINE_M / 2) / z * F_PX + CX, F_PX * BASELINE_M / z
    return np.stack([np.tile(u, len(rows)), np.repeat(rows, len(u)), np.tile(d, len(rows))], -1)


@pytest.mark.parametrize("yaw_deg", [-25.0, 20.0, 35.0])
def test_a_box_on_the_road_has_its_outline_and_direction(yaw_deg: float) -> None:
    found = recognized(box_cells(math.radians(yaw_deg), 4.4, 1.8), box=(300, 60, 600, 200))
    assert found.outline_m.shape == (4, 2)
    sides = sorted(np.linalg.norm(found.outline_m - np.roll(found.outline_m, 1, axis=0), axis=1)[:2])
    assert sides == pytest.approx([1.8, 4.4], rel=0.12)
    assert found.outline_m.mean(0) == pytest.approx([12.0, -3.0], abs=0.25)
    # To the right is a negative turn from x (forward) to y (left).
    off = (found.heading_rad + math.radians(yaw_deg) + math.pi / 2) % math.pi - math.pi / 2
    assert abs(off) < 2.5 * found.heading_sigma_rad
    assert found.heading_sigma_rad < 0.2


def test_a_mounting_turns_outline_and_direction_with_it() -> None:
    """A rig that looks 90 degrees to the left of the vehicle sees what stands to the vehicle's left."""
    from roadblock.geometry.pose import R_VEHICLE_CAR

    T = pose(rotation_from_rotvec([0, 0, math.pi / 2]) @ R_VEHICLE_CAR, [1.0, 0.0, 1.5])
    cells, box = box_cells(math.radians(20), 4.4, 1.8), (300, 60, 600, 200)
    plain, turned = recognized(cells, box=box), recognized(cells, box=box, T=T)
    x, y = plain.outline_m.T
    np.testing.assert_allclose(turned.outline_m, np.stack([1 - y, x], -1), atol=1e-9)
    off = turned.heading_rad - plain.heading_rad - math.pi / 2
    assert abs((off + math.pi / 2) % math.pi - math.pi / 2) < 1e-9


def test_what_has_no_side_to_tell_has_no_direction() -> None:
    found = recognized(cells_of((250, 91, 371, 227)))
    assert found.outline_m.shape == (4, 2)


# --- types ------------------------------------------------------------------------------------------------------------


def test_the_model_gives_probabilities() -> None:
    model = shipped_model()
    inputs = np.random.default_rng(0).normal(model.mean, model.spread, (50, len(model.mean)))
    odds = model.probabilities(inputs)
    assert odds.shape == (50, len(CLASSES))
    np.testing.assert_allclose(odds.sum(1), 1)
    assert (odds > 0).all()
    by_hand = np.maximum(np.clip((inputs[3] - model.mean) / model.spread, -3, 3) @ model.hidden + model.hidden_bias, 0)
    scores = (by_hand @ model.output + model.output_bias) / model.temperature
    np.testing.assert_allclose(np.log(odds[3] / odds[3, 0]), scores - scores[0], atol=1e-4)


def test_what_is_not_sure_is_unknown() -> None:
    assert label({"car": 0.6, "wall": 0.4}, 0.5) == ("car", 0.6)
    name, probability = label({"car": 0.45, "wall": 0.3, "unknown": 0.25}, 0.5)
    assert name == "unknown"
    assert math.isnan(probability)
    assert label({"car": 0.3, "unknown": 0.7}, 0.5)[0] == "unknown"


def test_walls_do_not_walk() -> None:
    odds = moving_odds({"person": 0.3, "wall": 0.7})
    assert odds == {"person": pytest.approx(0.3 / 0.314), "wall": pytest.approx(0.014 / 0.314)}


def obstacle_on(motion: str, velocity_mps: tuple[float, float]) -> Obstacle:
    track = Track(
        3, 2.0, 0.0, np.zeros(3), np.eye(3), np.array(velocity_mps), 0.01 * np.eye(2), True, motion, math.nan, math.nan
    )
    return recognized(cells_of((250, 91, 371, 227))).recognized(
        track=track, class_odds={"person": 0.3, "wall": 0.7}, label="wall", probability=0.7
    )


def test_what_moves_is_weighed_anew_and_faces_where_it_goes() -> None:
    walks, stands = weigh_motion([obstacle_on("moving", (0.0, -1.4)), obstacle_on("standing", (0.0, 0.0))], 0.5)
    assert (walks.label, walks.probability) == ("person", pytest.approx(0.3 / 0.314))
    assert walks.heading_rad == pytest.approx(-math.pi / 2)
    assert walks.heading_sigma_rad == pytest.approx(0.1 / 1.4)
    assert stands.label == "wall"


def test_what_creeps_keeps_its_direction() -> None:
    slow = obstacle_on("moving", (0.5, 0.0))
    before = slow.heading_rad
    after = weigh_motion([slow.recognized(class_odds={})], 0.5)[0]
    np.testing.assert_equal(after.heading_rad, before)
    assert after.label == "wall"


# --- colour -----------------------------------------------------------------------------------------------------------

CANONICAL = {
    "black": [(25, 25, 28), (45, 42, 44), (38, 38, 42)],
    "gray": [(90, 90, 90), (112, 114, 118), (100, 102, 101)],
    "white": [(255, 255, 255), (235, 238, 240), (210, 210, 208)],
    "red": [(255, 0, 0), (190, 38, 34), (140, 20, 25)],
    "orange": [(255, 140, 0), (232, 116, 26)],
    "yellow": [(255, 255, 0), (226, 186, 30), (250, 230, 90)],
    "green": [(0, 255, 0), (36, 130, 62), (90, 120, 60)],
    "blue": [(0, 0, 255), (38, 70, 170), (110, 160, 220)],
    "purple": [(128, 0, 128), (104, 52, 132)],
    "pink": [(255, 192, 203), (255, 120, 170), (240, 130, 130)],
    "brown": [(112, 76, 50), (101, 67, 33), (90, 60, 30)],
}


@pytest.mark.parametrize(("name", "rgb"), [(name, rgb) for name, colors in CANONICAL.items() for rgb in colors])
def test_canonical_colours_have_their_names(name: str, rgb: tuple[int, int, int]) -> None:
    found = recognized(cells_of((250, 91, 371, 227)), rgb)
    assert found.color == name
    assert found.colors == (name,)


def test_the_value_is_cielab() -> None:
    """CIELAB of sRGB (190, 38, 34) by the formula: 41.9, 58.3, 41.2."""
    assert recognized(cells_of((250, 91, 371, 227)), (190, 38, 34)).color_lab == pytest.approx(
        [41.9, 58.3, 41.2], abs=1.5
    )


def test_shade_over_all_changes_no_name() -> None:
    """Half the light: every level is 0.73 of what it was, the road's too."""
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (226, 226, 222), (250, 91, 371, 227))
    image = (0.73 * pair.left).astype(np.uint8)
    dim = RectifiedPair(image, image, TWIN)
    assert make_recognizer(RecognizeSettings())(dim, found, regions, obstacles)[0].color == "white"


def test_glass_tyres_and_lamps_do_not_change_the_body() -> None:
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (38, 70, 170), (250, 91, 371, 227))
    image = pair.left.copy()
    image[95:135, 260:360] = (24, 30, 36)
    image[180:195, 250:371] = (236, 236, 226)
    mixed = RectifiedPair(image, image, TWIN)
    seen = make_recognizer(RecognizeSettings())(mixed, found, regions, obstacles)[0]
    assert seen.color == "blue"
    assert seen.color_lab[2] < -30


def test_two_colours_have_two_names() -> None:
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (226, 186, 30), (250, 91, 371, 227))
    image = pair.left.copy()
    image[91:140, 250:371] = (38, 70, 170)
    mixed = RectifiedPair(image, image, TWIN)
    assert set(make_recognizer(RecognizeSettings())(mixed, found, regions, obstacles)[0].colors) == {"yellow", "blue"}
    image[91:165, 250:371] = (226, 226, 222)
    mixed = RectifiedPair(image, image, TWIN)
    assert make_recognizer(RecognizeSettings())(mixed, found, regions, obstacles)[0].colors == ("yellow", "white")


def test_a_grey_camera_knows_no_colour() -> None:
    found = recognized(cells_of((250, 91, 371, 227)), None)
    assert found.color is None
    assert found.colors == ()
    assert np.isnan(found.color_lab).all()


def test_sixteen_bits_are_as_good() -> None:
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227))
    deep = RectifiedPair(pair.left.astype(np.uint16) * 257, pair.left.astype(np.uint16) * 257, TWIN)
    assert make_recognizer(RecognizeSettings())(deep, found, regions, obstacles)[0].color == "red"


# --- the table --------------------------------------------------------------------------------------------------------


def test_none_says_nothing() -> None:
    pair, found, regions, obstacles = scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227))
    assert make_recognizer(RecognizeSettings(recognizer="none"))(pair, found, regions, obstacles) == tuple(obstacles)


def test_nothing_stays_nothing() -> None:
    pair, found, _, _ = scene(cells_of((250, 91, 371, 227)), (186, 36, 34), (250, 91, 371, 227))
    assert make_recognizer(RecognizeSettings())(pair, replace(found, regions=()), (), ()) == ()
