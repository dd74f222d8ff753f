import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.sim.solids import Part, Thing, box, capsule, corners_m, ellipsoid, placed

GREY = (120, 120, 120)
CROOKED = pose(rotation_from_rotvec([0.4, -0.9, 0.7]), [1.0, -2.0, 3.0])


def surface_points(part, rng, n=200_000):
    """Points on the solid's surface in its own axes, from its definition."""
    way = rng.normal(size=(n, 3))
    if part.shape == "ellipsoid":
        return way / np.linalg.norm(way, axis=1, keepdims=True) * part.half_m
    if part.shape == "box":
        return way / np.abs(way).max(1, keepdims=True) * part.half_m
    round_end = way / np.linalg.norm(way, axis=1, keepdims=True) * part.half_m[0]
    return round_end + np.sign(round_end) * [0, 0, part.half_m[2]]


@pytest.mark.parametrize("shape", ["box", "ellipsoid", "capsule"])
def test_reach_is_the_extent_of_sampled_surface(shape):
    part = Part(shape, CROOKED, np.array([0.3, 0.3, 0.9]) if shape == "capsule" else np.array([0.3, 0.5, 0.9]), GREY)
    R = rotation_from_rotvec([-0.3, 0.8, 1.1])
    points = surface_points(part, np.random.default_rng(1)) @ R
    assert part.reach(R) == pytest.approx(points.max(0), abs=5e-3)
    assert (part.reach(R) >= points.max(0) - 1e-12).all()


def test_size_is_width_height_length():
    crate = Thing(1, "box", "red", (box((4.0, 2.0, 1.0), (0, 0, 0.5), GREY),))
    assert crate.size_m == pytest.approx([2.0, 1.0, 4.0])


def test_capsule_runs_between_its_ends():
    start, end = np.array([1.0, 2.0, 0.5]), np.array([1.2, 1.5, 2.0])
    part = capsule(start, end, 0.1, GREY)
    ends = transform(part.T_thing_part, [[0, 0, -part.half_m[2]], [0, 0, part.half_m[2]]])
    assert ends == pytest.approx(np.stack([start, end]))
    assert np.linalg.det(part.T_thing_part[:3, :3]) == pytest.approx(1)


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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": "cone"}, "shape must be one of box"),
        ({"pattern": "stripes"}, "pattern must be one of plain"),
        ({"T_thing_part": np.diag([1.0, 1.0, -1.0, 1.0])}, "mirrored"),
        ({"half_m": np.array([1.0, 0.0, 1.0])}, "half_m must be > 0"),
        ({"half_m": np.array([1.0, np.nan, 1.0])}, "half_m must be finite"),
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


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"id": -1}, "id must be >= 0"),
        ({"parts": ()}, "at least one part"),
        ({"T_world_thing": 2 * np.eye(4)}, "orthonormal"),
    ],
)
def test_thing_refuses(change, message):
    fields = {"id": 1, "type": "box", "color": "red", "parts": (box((1, 1, 1), (0, 0, 0), GREY),), **change}
    with pytest.raises(ValueRefusedError, match=message):
        Thing(**fields)
