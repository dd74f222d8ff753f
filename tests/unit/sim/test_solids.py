from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.sim.solids import (
    Part,
    Thing,
    box,
    capsule,
    carried,
    cone,
    corners_m,
    cylinder,
    ellipsoid,
    going,
    grounded,
    moved,
    placed,
    ring,
    scaled,
    slab,
    textured,
    xyz,
)

GREY = (120, 120, 120)
CROOKED = pose(rotation_from_rotvec([0.4, -0.9, 0.7]), [1.0, -2.0, 3.0])
HALF = {
    "box": (0.3, 0.5, 0.9),
    "ellipsoid": (0.3, 0.5, 0.9),
    "capsule": (0.3, 0.3, 0.9),
    "cylinder": (0.3, 0.3, 0.9),
    "cone": (0.7, 0.2, 0.5),
}


def surface_points(part, rng, n=200_000):
    """Points on the solid's surface in its own axes, from its definition."""
    way = rng.normal(size=(n, 3))
    if part.shape == "ellipsoid":
        return way / np.linalg.norm(way, axis=1, keepdims=True) * part.half_m
    if part.shape == "box":
        return way / np.abs(way).max(1, keepdims=True) * part.half_m
    if part.shape == "capsule":
        round_end = way / np.linalg.norm(way, axis=1, keepdims=True) * part.half_m[0]
        return round_end + np.sign(round_end) * [0, 0, part.half_m[2]]
    height, angle = rng.choice([-1.0, 1.0, 0.3], n), rng.uniform(0, 2 * np.pi, n)
    radius = part.half_m[0] + (part.half_m[1] - part.half_m[0]) * (height + 1) / 2
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height * part.half_m[2]], 1)


@pytest.mark.parametrize("shape", HALF)
def test_reach_is_the_extent_of_sampled_surface(shape):
    part = Part(shape, CROOKED, np.array(HALF[shape]), GREY)
    R = rotation_from_rotvec([-0.3, 0.8, 1.1])
    points = surface_points(part, np.random.default_rng(1)) @ R
    for sign in (1, -1):
        assert part.reach(sign * R) == pytest.approx((sign * points).max(0), abs=5e-3)
        assert (part.reach(sign * R) >= (sign * points).max(0) - 1e-12).all()


def test_bounds_of_a_cone_are_not_symmetric():
    low, high = Thing(1, "cone", "", (cone((0, 0, 0), (1, 0, 0), 0.4, 0.1, GREY),)).bounds_m(np.eye(4))
    assert low == pytest.approx([0, -0.4, -0.4])
    assert high == pytest.approx([1, 0.4, 0.4])
    leaning = pose(rotation_from_rotvec([0, 0.5, 0]), np.zeros(3))
    low, high = Thing(1, "cone", "", (cone((0, 0, 0), (0, 0, 1), 0.4, 0.1, GREY),)).bounds_m(leaning)
    # Base and top are discs at right angles to the axis (sin 0.5, cos 0.5).
    s, c = np.sin(0.5), np.cos(0.5)
    assert low[0] == pytest.approx(-0.4 * c)
    assert high[0] == pytest.approx(max(0.4 * c, s + 0.1 * c))
    assert (low[2], high[2]) == pytest.approx((-0.4 * s, c + 0.1 * s))


def test_size_is_width_height_length():
    crate = Thing(1, "box", "red", (box((4.0, 2.0, 1.0), (0, 0, 0.5), GREY),))
    assert crate.size_m == pytest.approx([2.0, 1.0, 4.0])


@pytest.mark.parametrize("make", [capsule, cylinder])
def test_round_parts_run_between_their_ends(make):
    start, end = np.array([1.0, 2.0, 0.5]), np.array([1.2, 1.5, 2.0])
    part = make(start, end, 0.1, GREY)
    ends = transform(part.T_thing_part, [[0, 0, -part.half_m[2]], [0, 0, part.half_m[2]]])
    assert ends == pytest.approx(np.stack([start, end]))
    assert np.linalg.det(part.T_thing_part[:3, :3]) == pytest.approx(1)


def test_a_cone_is_wide_where_it_starts():
    part = cone((0, 0, 2), (0, 0, 1), 0.3, 0.1, GREY)
    assert part.half_m == pytest.approx([0.3, 0.1, 0.5])
    assert transform(part.T_thing_part, [0, 0, -0.5]) == pytest.approx([0, 0, 2])


def test_a_slab_has_its_upper_face_between_two_points():
    part = slab((1.0, 2.0), (3.0, 3.5), 0.4, 1.2, GREY, y_m=0.3)
    face = transform(part.T_thing_part, part.half_m * [[-1, -1, 1], [1, 1, 1]])
    assert face == pytest.approx(np.array([[1.0, -0.3, 2.0], [3.0, 0.9, 3.5]]))
    # The other face lies below, at right angles: the slope is 3 : 4.
    below = transform(part.T_thing_part, part.half_m * [-1, -1, -1])
    assert below == pytest.approx([1.0 + 0.4 * 0.6, -0.3, 2.0 - 0.4 * 0.8])


def test_a_ring_reaches_its_radius_and_is_hollow():
    parts = ring((1.0, 0.5, 2.0), 0.34, 0.02, GREY)
    low, high = Thing(1, "ring", "", parts).bounds_m(np.eye(4))
    assert low == pytest.approx([0.66, 0.48, 1.66])
    assert high == pytest.approx([1.34, 0.52, 2.34])
    centres = np.array([p.T_thing_part[:3, 3] for p in parts]) - [1.0, 0.5, 2.0]
    assert (np.hypot(centres[:, 0], centres[:, 2]) > 0.31).all()


def test_carried_scaled_grounded():
    part = capsule((0, 0, 1), (0.2, 0, 1.5), 0.1, GREY, 0.3)
    (there,) = carried([part], CROOKED)
    assert there.T_thing_part == pytest.approx(CROOKED @ part.T_thing_part)
    (double,) = scaled([part], 2.0)
    assert double.half_m == pytest.approx(2 * part.half_m)
    assert double.T_thing_part[:3, 3] == pytest.approx([0.2, 0, 2.5])
    (low,) = grounded([part])
    assert Thing(1, "a", "", (low,)).bounds_m(np.eye(4))[0, 2] == pytest.approx(0, abs=1e-12)
    assert low.T_thing_part[:2, 3] == pytest.approx(part.T_thing_part[:2, 3])
    assert (there.rgb, double.contrast, low.shape) == (GREY, 0.3, "capsule")
    assert xyz(1, 2, 3).tolist() == [1, 2, 3]


def test_placed_touches_distance_and_road_exactly():
    thing = Thing(1, "egg", "red", (ellipsoid((0.5, 0.2, 0.3), (0.1, 0.2, 5), GREY),))
    yaw = 0.6
    low, high = (at := placed(thing, 7.0, -1.5, yaw)).bounds_m(at.T_world_thing)
    assert low[0] == pytest.approx(7.0, abs=1e-12)
    assert low[2] == pytest.approx(0.0, abs=1e-12)
    # An ellipse turned by yaw reaches sqrt((a cos)^2 + (b sin)^2).
    assert high[0] - low[0] == pytest.approx(2 * np.hypot(0.5 * np.cos(yaw), 0.2 * np.sin(yaw)))
    assert at.T_world_thing[1, 3] == -1.5


def test_corners_of_a_capsule_hold_its_round_ends():
    part = capsule((0, 0, 1), (0, 0, 2), 0.25, GREY)
    corners = corners_m(part, np.eye(4))
    assert corners.min(0) == pytest.approx([-0.25, -0.25, 0.75])
    assert corners.max(0) == pytest.approx([0.25, 0.25, 2.25])


BRICK = Thing(1, "box", "red", (box((0.4, 0.2, 0.1), (0, 0, 0.05), GREY),))


def test_a_thing_goes_where_it_faces():
    thing = moved(going(placed(BRICK, 5.0, 1.0, np.pi / 6), 3.0), 2.0)
    start = placed(BRICK, 5.0, 1.0, np.pi / 6).T_world_thing
    way = thing.T_world_thing[:3, 3] - start[:3, 3]
    assert way == pytest.approx([6 * np.cos(np.pi / 6), 3.0, 0])
    assert thing.T_world_thing[:3, :3] == pytest.approx(start[:3, :3])
    assert thing.gone_m == pytest.approx(6.0)


def test_a_quarter_turn_is_a_quarter_circle():
    # 8 m/s at a turn of 0.5 rad/s to the left is a circle of 16 m.
    thing = moved(going(BRICK, 8.0, 0.5), np.pi)
    assert thing.T_world_thing[:3, 3] == pytest.approx([16, 16, 0])
    assert thing.T_world_thing[:3, 0] == pytest.approx([0, 1, 0])
    assert thing.velocity_mps == pytest.approx([0, 8, 0])
    back = moved(thing, -np.pi)
    assert back.T_world_thing == pytest.approx(np.eye(4), abs=1e-12)


def test_many_small_moves_are_one_large_move():
    thing = going(placed(BRICK, 3.0, -1.0, 0.4), 5.0, -0.3)
    once, often = moved(thing, 2.0), thing
    for _ in range(40):
        often = moved(often, 0.05)
    assert often.T_world_thing == pytest.approx(once.T_world_thing)


def test_a_gait_moves_the_limbs_with_the_way():
    def gait(gone_m):
        return (box((0.4, 0.2, 0.1 + gone_m), (0, 0, 0), GREY),)

    walking = going(Thing(1, "walker", "", gait(0.0), gait=gait), -2.0)
    assert moved(walking, 1.5).size_m[1] == pytest.approx(3.1)


def test_textured_scales_the_contrast_also_of_a_gait():
    def gait(gone_m):
        return (box((1, 1, 1 + gone_m), (0, 0, 0), GREY, 0.4),)

    walking = going(Thing(1, "walker", "", gait(0.0), gait=gait), 1.0)
    assert [textured(walking, k).parts[0].contrast for k in (0, 0.5, 10)] == [0, 0.2, 1]
    assert moved(textured(walking, 0.5), 1.0).parts[0].contrast == pytest.approx(0.2)
    assert textured(BRICK, 2.0).gait is None


@pytest.mark.parametrize("richness", [-0.1, np.nan, np.inf])
def test_textured_refuses(richness):
    with pytest.raises(ValueRefusedError, match="richness must be"):
        textured(BRICK, richness)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": "pyramid"}, "shape must be one of box"),
        ({"pattern": "stripes"}, "pattern must be one of plain"),
        ({"T_thing_part": np.diag([1.0, 1.0, -1.0, 1.0])}, "mirrored"),
        ({"half_m": np.array([1.0, 0.0, 1.0])}, "half_m must be > 0"),
        ({"half_m": np.array([1.0, np.nan, 1.0])}, "half_m must be finite"),
        ({"shape": "capsule", "half_m": np.array([1.0, 2.0, 1.0])}, "a capsule has one radius, but got 1 and 2 m"),
        ({"shape": "cylinder", "half_m": np.array([1.0, 0.5, 1.0])}, "a cylinder has one radius"),
        ({"rgb": (0, 0, 256)}, "rgb must lie in"),
        ({"rgb": (-1, 0, 0)}, "rgb must lie in"),
        ({"contrast": 1.5}, "contrast must lie in"),
        ({"contrast": float("nan")}, "contrast must be finite"),
    ],
)
def test_part_refuses(change, message):
    fields = {"shape": "box", "T_thing_part": np.eye(4), "half_m": np.ones(3), "rgb": GREY, **change}
    with pytest.raises(ValueRefusedError, match=message):
        Part(**fields)


def test_round_parts_need_a_length():
    with pytest.raises(ValueRefusedError, match="a cone must end elsewhere than it starts"):
        cone((1, 2, 3), (1, 2, 3), 0.2, 0.1, GREY)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": -1}, "id must be >= 0"),
        ({"parts": ()}, "at least one part"),
        ({"T_world_thing": 2 * np.eye(4)}, "orthonormal"),
        ({"velocity_mps": np.array([0, np.nan, 0])}, "velocity_mps must be finite"),
        ({"yaw_rate_radps": np.inf}, "yaw_rate_radps must be finite"),
        ({"gone_m": np.nan}, "gone_m must be finite"),
    ],
)
def test_thing_refuses(change, message):
    with pytest.raises(ValueRefusedError, match=message):
        replace(BRICK, **change)
