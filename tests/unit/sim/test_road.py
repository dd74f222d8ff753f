from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.sim import raycast
from roadblock.sim.render import render
from roadblock.sim.road import Line, Mark, Road, ground_of, height_m, normal, place_on, pose_on
from roadblock.sim.scene import Scene, camera_pose
from roadblock.values.camera import Camera, StereoRig

BEND = Road(curvature_per_m=1 / 40, curve_from_m=5.0, kerb_m=0.15, crown_per_m=0.004, bank=0.02)
HILL = Road(grade=0.09, grade_from_m=8.0, grade_over_m=20.0, kerb_m=0.12)
DROP = Road(grade=-0.07, grade_from_m=6.0, grade_over_m=15.0, curvature_per_m=-1 / 60, bank=-0.04)
ROADS = {"flat": Road(), "straight": Road(curvature_per_m=1 / 30), "bend": BEND, "hill": HILL, "drop": DROP}


def surface(road, x, y):
    """The road's height from its definition in words: another way than the kernels'."""
    left = y
    if road.curvature_per_m and x > road.curve_from_m:
        radius = 1 / road.curvature_per_m
        left = radius - np.sign(radius) * np.hypot(x - road.curve_from_m, y - radius)
    slope_at = np.clip((x - road.grade_from_m) / road.grade_over_m, 0, 1) * road.grade
    on_parabola = np.clip(x - road.grade_from_m, 0, road.grade_over_m)
    profile = slope_at * on_parabola / 2 + road.grade * max(x - road.grade_from_m - road.grade_over_m, 0)
    inner, middle = np.clip(left, road.right_m, road.left_m), (road.right_m + road.left_m) / 2
    kerb = road.kerb_m * np.clip(abs(left - inner) / raycast.KERB_RUN_M, 0, 1)
    return profile + road.bank * inner - road.crown_per_m * (inner - middle) ** 2 + road.crown_per_m * middle**2 + kerb


@pytest.mark.parametrize("name", ROADS)
def test_heights_and_normals_are_those_of_the_definition(name):
    road = ROADS[name]
    rng = np.random.default_rng(4)
    for x, y in rng.uniform((-5, -12), (39, 12), (300, 2)):
        assert height_m(road, x, y) == pytest.approx(surface(road, x, y), abs=1e-12)
        step = 1e-6
        around = [surface(road, x + a, y + b) for a, b in ((step, 0), (-step, 0), (0, step), (0, -step))]
        slope = np.array([around[1] - around[0], around[3] - around[2], 2 * step])
        kinks = {road.right_m, road.left_m}
        left = raycast.on_road(ground_of(road), x, y)[1]
        if min(abs(abs(left - k) - w) for k in kinks for w in (0, raycast.KERB_RUN_M)) > 1e-4:
            assert normal(road, x, y) == pytest.approx(slope / np.linalg.norm(slope), abs=1e-6)


@pytest.mark.parametrize("name", ROADS)
@pytest.mark.parametrize("eye_m", [(0.0, 0.1, 1.4), (2.0, -1.3, 0.6)])
def test_rays_meet_the_surface_exactly_and_nothing_before_it(name, eye_m):
    road = ROADS[name]
    rng = np.random.default_rng(5)
    ways = np.stack([np.ones(400), rng.uniform(-0.7, 0.7, 400), rng.uniform(-0.4, 0.12, 400)], 1)
    eye = np.array(eye_m)
    met = 0
    for way in ways:
        t = raycast.hit_ground(ground_of(road), *eye, *way)
        reach = min(t, 300.0)
        before = [(s, eye + s * way) for s in np.linspace(0, 0.9999 * reach, 60)]
        assert all(z > surface(road, x, y) - 1e-9 for s, (x, y, z) in before)
        if t < np.inf:
            x, y, z = eye + t * way
            assert z == pytest.approx(surface(road, x, y), abs=1e-9)
            met += 1
    assert met > 250


def test_a_ray_straight_down_or_beside_the_slope_is_met_too():
    for road in (HILL, DROP):
        for x in (0.0, 12.0, 40.0):
            t = raycast.hit_ground(ground_of(road), x, 0.5, 9.0, 0.0, 0.0, -1.0)
            assert 9.0 - t == pytest.approx(surface(road, x, 0.5), abs=1e-9)
    assert raycast.hit_ground(ground_of(DROP), 0.0, 0.0, 1.0, 1.0, 0.0, 0.3) == np.inf
    t = raycast.hit_ground(ground_of(HILL), 90.0, 0.0, 20.0, -1.0, 0.0, -0.3)
    assert 20 - 0.3 * t == pytest.approx(surface(HILL, 90 - t, 0.0), abs=1e-9)
    assert t < 70


def test_road_coordinates_follow_the_arc():
    # A quarter of a circle of 40 m to the left from x = 5: its centre is (5, 40).
    along, left, x, y = raycast.on_road(ground_of(BEND), 5 + 40 - 1.5, 40.0)
    assert (along, left) == pytest.approx((5 + 40 * np.pi / 2, 1.5))
    assert (x, y) == pytest.approx((-1, 0), abs=1e-12)
    # The numbers of nearly straight roads do not jump.
    nearly = replace(BEND, curvature_per_m=1e-13)
    assert raycast.on_road(ground_of(nearly), 30.0, 2.0)[:2] == pytest.approx((30.0, 2.0), abs=1e-9)


@pytest.mark.parametrize("name", ROADS)
@pytest.mark.parametrize("along_m", [-3.0, 7.0, 31.0])
def test_what_stands_on_the_road_stands_where_its_coordinates_say(name, along_m):
    road = ROADS[name]
    for upright in (True, False):
        T = pose_on(road, along_m, 1.3, 0.4, upright=upright)
        x, y, z = T[:3, 3]
        along, left, to_left_x, to_left_y = raycast.on_road(ground_of(road), x, y)
        assert (along, left) == pytest.approx((along_m, 1.3), abs=1e-9)
        assert place_on(road, x, y) == pytest.approx((along_m, 1.3, np.arctan2(-to_left_x, to_left_y)), abs=1e-9)
        assert z == pytest.approx(surface(road, x, y), abs=1e-12)
        assert T[:3, 2] == pytest.approx([0, 0, 1] if upright else normal(road, x, y))
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1)
        heading = np.arctan2(T[1, 0], T[0, 0]) - np.arctan2(-to_left_x, to_left_y)
        assert heading == pytest.approx(0.4, abs=1e-9)


def test_true_ground_touches_the_road_under_the_cameras_and_bends_with_it():
    camera = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
    rig = StereoRig(camera, camera, np.array([[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    road = Road(grade=0.06, grade_from_m=-10.0, grade_over_m=200.0, bank=0.03)
    scene = Scene((), road, pose_on(road, 0.0, 0.0) @ camera_pose(1.3, 0.02))
    rendered = render(scene, rig, quality="preview")
    ground, z = rendered.ground, rendered.depth_m
    assert (ground.height_m, ground.bend_per_m) == pytest.approx((1.3, 0.06 / 200 / 2), rel=1e-3)
    v, u = np.nonzero((z < 40) & (np.abs(np.arange(97) - 51.3) < 20))
    z = z[v, u]
    points = np.stack([(u - 51.3) / 80 * z - 0.15, (v - 27.6) / 80 * z, z], 1)
    on_asphalt = np.abs(points[:, 0]) < 2.5
    assert np.abs(ground.height_of(points[on_asphalt])).max() < 0.01
    level = replace(ground, bend_per_m=0.0)
    assert np.abs(level.height_of(points[on_asphalt])).max() > 0.1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"grade": 0.5}, r"grade must lie within \+-0.3, but got 0.5"),
        ({"curvature_per_m": -1.0}, "curvature_per_m must lie within"),
        ({"bank": np.nan}, "bank must be finite"),
        ({"grade_from_m": np.inf}, "grade_from_m must be finite"),
        ({"kerb_m": -0.1}, "kerb_m and contrast must be >= 0"),
        ({"contrast": -0.1}, "kerb_m and contrast must be >= 0 and grade_over_m > 0, but got 0, -0.1 and 20"),
        ({"contrast": 1.5}, "contrast must lie within"),
        ({"asphalt": (0, 0, 300)}, r"asphalt must lie in 0..255, but got \[0.0, 0.0, 300.0\]"),
        ({"verge": (-1, 0, 0)}, "verge must lie in 0..255"),
        ({"verge": (1, 0)}, r"verge must have shape \(3,\)"),
        ({"grade_over_m": 0.0}, "grade_over_m > 0, but got 0, 0.17 and 0"),
        ({"left_m": -4.0}, "left_m must be > right_m, but got -4 and -3.1"),
    ],
)
def test_impossible_roads_are_refused(change, message):
    with pytest.raises(ValueRefusedError, match=message):
        Road(**change)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "hole"}, "kind must be one of zebra, arrow, gore, patch, manhole, but got 'hole'"),
        ({"along_m": np.nan}, "mark must be finite"),
        ({"width_m": 0.0}, "a mark must have a size > 0, but got 3 x 0 m"),
    ],
)
def test_impossible_marks_are_refused(change, message):
    fields = {"kind": "zebra", "along_m": 5.0, "left_m": 0.0, "length_m": 3.0, "width_m": 2.0, **change}
    with pytest.raises(ValueRefusedError, match=message):
        Mark(**fields)


@pytest.mark.parametrize(
    ("kind", "points"),
    [
        ("zebra", {(1.0, 0.2): 1, (1.0, -0.1): 1, (1.0, 0.7): 0, (-0.1, 0.2): 0, (3.1, 0.2): 0, (1.0, 1.3): 0}),
        ("arrow", {(0.5, 0.0): 1, (0.5, 0.5): 0, (1.9, 0.9): 1, (2.9, 0.9): 0, (2.9, 0.01): 1}),
        ("gore", {(2.9, 1.15): 1, (0.1, 0.5): 0, (2.5, 0.0): 1, (1.7, 0.05): 0}),
        ("patch", {(1.5, 0.0): 2, (0.02, 0.0): 3, (1.5, 1.19): 3}),
        ("manhole", {(1.53, 0.09): 5, (0.01, 1.19): 0, (1.5, 1.19): 5, (1.53, 0.03): 4}),
    ],
)
def test_marks_are_where_they_should_be(kind, points):
    number = ("zebra", "arrow", "gore", "patch", "manhole").index(kind)
    mark = np.array([[number, 10.0, 1.0, 3.0, 2.4]])
    assert {at: raycast.marked(mark, 0, 10 + at[0], 1 + at[1]) for at in points} == points


def test_marks_and_kerbs_show_in_the_picture():
    camera = Camera((160, 120), 130.0, 130.0, 81.3, 30.6)
    rig = StereoRig(camera, camera, np.array([[1, 0, 0, 0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]))

    def grey(road):
        return render(Scene((), road, camera_pose(1.4)), rig, quality="preview", noise=0).pair.left.mean(2)

    bare = Road(lines=(), contrast=0.0)
    plain = grey(bare)
    for kind, brighter in (("zebra", True), ("arrow", True), ("gore", True), ("patch", False), ("manhole", False)):
        change = grey(replace(bare, marks=(Mark(kind, 4.0, 0.0, 3.0, 2.0),))) - plain
        assert (change.max() > 30) == brighter
        assert (change.min() < -20) != brighter
        rows = np.flatnonzero(np.abs(change).max(1) > 5)
        # 4 to 7 m ahead, 1.4 m below the cameras.
        assert rows.min() >= 30.6 + 130 * 1.4 / 7 - 1
        assert rows.max() <= 30.6 + 130 * 1.4 / 4 + 1
    assert np.abs(grey(replace(bare, kerb_m=0.15)) - plain).max() > 20


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"left_m": np.nan}, "line must be finite"),
        ({"width_m": 0.0}, "width and dash > 0 and a gap >= 0 m, but got 0, 3 and 0"),
        ({"dash_m": 0.0}, "but got 0.14, 0 and 0"),
        ({"gap_m": -1.0}, "but got 0.14, 3 and -1"),
    ],
)
def test_impossible_lines_are_refused(change, message):
    with pytest.raises(ValueRefusedError, match=message):
        Line(**{"left_m": 1.0, **change})
