"""What every thing must be: its size, its outline, its seed."""

from dataclasses import replace

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose
from roadblock.sim.render import render
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.solids import going, moved, placed
from roadblock.sim.things import (
    CARS,
    COLORS,
    SIGNS,
    TYPES,
    Order,
    bicycle,
    build,
    car,
    carton,
    crate,
    cyclist,
    fork,
    hedge,
    house,
    person,
    pole,
    railing,
    shaded,
    sign,
    stone,
    street_lamp,
    traffic_cone,
    tree,
    truck,
    tyre,
    van,
    wall,
)
from roadblock.sim.things.bikes import bent
from roadblock.values.camera import Camera, StereoRig

RED = (200, 30, 30)
MODELS = [(name, model) for name, kind in TYPES.items() for model in (kind.models or ("",))]


def bounds(thing):
    return thing.bounds_m(np.eye(4))


def outline(thing, distance_m=8.0, f_px=500, yaw_rad=np.pi / 2, size=(301, 221)):
    """What the left camera sees of a thing: a mask, and the pixels per metre at its nearest point."""
    height = 0.9
    camera = Camera(size, f_px, f_px, (size[0] - 1) / 2, size[1] * 0.55)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.02, 0, 0]))
    scene = Scene((placed(thing, distance_m, 0.01, yaw_rad),), Road(), camera_pose(height))
    return render(scene, rig, quality="preview", noise=0).ids == thing.id, f_px / distance_m, size[1] * 0.55, height


def rows_at(seen, height_m):
    """Widths (m) of the runs of a mask's row at this height over the road."""
    mask, scale, horizon, eye = seen
    edges = np.flatnonzero(np.diff(np.pad(mask[round(horizon + (eye - height_m) * scale)], 1).astype(int)))
    return (edges[1::2] - edges[::2]) / scale


@pytest.mark.parametrize(("name", "model"), MODELS)
def test_every_thing_stands_on_the_road_in_reasonable_size(name, model):
    thing = build(Order(name, 3, model=model, seed=4))
    assert (thing.id, thing.type, thing.color) == (3, name, TYPES[name].color)
    low, high = (at := placed(thing, 12.25, -1.0, 0.7)).bounds_m(at.T_world_thing)
    assert low[0] == pytest.approx(12.25, abs=1e-12)
    assert low[2] == pytest.approx(0, abs=1e-12)
    assert bounds(thing)[0, 2] == pytest.approx(0, abs=1e-9)
    assert 0.04 < (high - low).max() < 15


@pytest.mark.parametrize(("name", "model"), MODELS)
def test_every_thing_is_drawn_from_its_seed(name, model):
    def told(seed):
        parts = build(Order(name, 1, model=model, seed=seed)).parts
        return [(p.shape, p.rgb, p.T_thing_part.tolist(), p.half_m.tolist()) for p in parts]

    assert told(3) == told(3)
    if name not in ("railing", "fork", "cone") and model not in SIGNS:
        assert any(told(3) != told(seed) for seed in range(4, 9))


@pytest.mark.parametrize("height_m", [1.0, 1.2, 1.75, 1.95])
def test_a_standing_person_is_exactly_as_tall_as_said(height_m):
    thing = person(1, "blue", RED, RED, height_m, rng=np.random.default_rng(1))
    assert bounds(thing)[:, 2] == pytest.approx([0, height_m], abs=1e-9)
    assert 0.25 < thing.size_m[0] / height_m < 0.4


def test_a_childs_head_is_large_for_its_body():
    heads = [person(1, "", RED, RED, h).parts[-2].half_m[2] / h for h in (1.1, 1.75)]
    assert heads[0] > 1.2 * heads[1]


@pytest.mark.parametrize("stride", np.arange(0, 1, 0.1))
def test_a_walking_person_keeps_a_foot_on_the_ground_and_its_height(stride):
    low, high = bounds(person(1, "", RED, RED, stride=stride))
    assert low[2] == pytest.approx(0, abs=1e-9)
    assert 0.95 * 1.75 < high[2] < 1.755


def test_a_stride_is_widest_when_a_heel_touches_down():
    spread = {k: person(1, "", RED, RED, stride=k).size_m[2] for k in (0.0, 0.25, 0.5)}
    assert spread[0.0] > 1.4 * spread[0.25]
    assert spread[0.5] == pytest.approx(spread[0.0])


def test_walking_moves_the_legs_and_two_steps_bring_them_back():
    walker = going(person(1, "", RED, RED, stride=0.1), 1.4)
    half, whole = moved(walker, 0.5), moved(walker, 1.0)

    def ankles(thing):
        return np.array([p.T_thing_part[:3, 3] for p in thing.parts])

    assert np.abs(ankles(half) - ankles(walker)).max() > 0.3
    assert ankles(whole) == pytest.approx(ankles(walker), abs=1e-9)
    assert person(1, "", RED, RED).gait is None


def test_a_walker_shows_two_legs_from_the_side():
    seen = outline(person(1, "", RED, RED, stride=0.0), 5.0)
    assert len(rows_at(seen, 0.3)) == 2
    assert len(rows_at(seen, 1.3)) == 1
    assert (rows_at(seen, 0.3) < 0.2).all()


def test_a_bicycle_has_its_size():
    low, high = bounds(bicycle(1, "red", RED))
    assert high - low == pytest.approx([1.73, 0.612, 1.06], abs=1e-9)
    small = bicycle(1, "red", RED, 0.7, rng=np.random.default_rng(2))
    assert small.size_m[2] == pytest.approx(0.7 * 1.73)


@pytest.mark.parametrize("make", [bicycle, lambda n, c, rgb: cyclist(n, c, rgb, rgb)])
def test_one_sees_through_a_wheel(make):
    thing = make(1, "red", RED)
    mask, scale, horizon, eye = outline(thing, 6.0, 700, size=(401, 301))
    # The thing faces left, so its front wheel's hub lies 0.525 m to the left, behind the grip or the elbow.
    rows, columns = np.mgrid[: mask.shape[0], : mask.shape[1]]
    x, z = (200 - columns) / scale, eye - (rows - horizon) / scale
    off = 6.0 / (6.0 + bounds(thing)[1, 1])
    radius = np.hypot(x / off - 0.525, (z - eye) / off + eye - 0.34)
    ahead = x / off > 0.6  # Where no fork and no tube is.
    assert mask[(np.abs(radius - 0.322) < 0.012) & ahead].mean() > 0.95
    inside = (radius > 0.05) & (radius < 0.27) & ahead
    assert inside.sum() > 500
    assert 0 < mask[inside].mean() < 0.25
    assert not mask[(radius > 0.36) & (radius < 0.42) & ahead].any()


def test_a_bicycles_triangle_is_open():
    widths = rows_at(outline(bicycle(1, "red", RED), 6.0, 700, size=(401, 301)), 0.62)
    assert len(widths) >= 4
    assert widths.sum() < 0.5


def test_a_riders_feet_stay_on_the_pedals():
    rider = going(cyclist(1, "", RED, RED, rng=np.random.default_rng(1)), 5.0)
    for t in np.linspace(0, 1, 7):
        thing = moved(rider, t)
        pedals = [p.T_thing_part[:3, 3] for p in thing.parts if p.shape == "box" and p.half_m[0] == 0.045]
        shoes = [p.T_thing_part[:3, 3] for p in thing.parts if p.shape == "ellipsoid" and p.half_m[0] == 0.13]
        assert len(pedals) == len(shoes) == 2
        assert np.linalg.norm(np.array(pedals) - shoes, axis=1).max() < 0.1
        assert len(thing.parts) == len(rider.parts)


def test_a_bent_joint_keeps_the_lengths_of_its_limbs():
    begin, end = np.array([0.0, 0.1, 1.0]), np.array([0.3, 0.0, 0.5])
    joint = bent(begin, end, 0.43, 0.42, np.array([1.0, 0.0, 0.0]))
    assert np.linalg.norm(joint - begin) == pytest.approx(0.43)
    assert np.linalg.norm(joint - end) == pytest.approx(0.42)
    assert joint[0] > 0.3
    far = bent(begin, begin + np.array([2.0, 0, 0]), 0.4, 0.4, np.array([0.0, 0.0, 1.0]))
    assert far == pytest.approx(begin + np.array([1.0, 0, 0]))


@pytest.mark.parametrize("size", CARS)
def test_a_car_has_its_size(size):
    shape = CARS[size]
    low, high = bounds(car(1, "red", RED, size))
    assert (high - low)[[0, 2]] == pytest.approx([shape.length_m, shape.height_m], abs=1e-9)
    assert low[2] == pytest.approx(0, abs=1e-9)
    mirrors = (high - low)[1] - shape.width_m
    assert 0.2 < mirrors < 0.4


def test_a_car_stands_on_wheels_and_narrows_to_its_roof():
    seen = outline(car(1, "red", RED), 9.0)
    wheels = rows_at(seen, 0.1)
    assert len(wheels) == 2
    assert (wheels < 0.75).all()
    belt, roof = rows_at(seen, 0.6), rows_at(seen, 1.35)
    assert belt == pytest.approx([4.35], abs=0.3)
    assert 1.4 < roof.sum() < 0.6 * belt.sum()


@pytest.mark.parametrize(("make", "length_m", "height_m"), [(van, 5.2, 2.3), (truck, 8.2, 3.5)])
def test_vans_and_trucks_have_their_size(make, length_m, height_m):
    low, high = bounds(make(1, "white", RED))
    assert (high - low)[[0, 2]] == pytest.approx([length_m, height_m], abs=1e-9)
    drawn = make(1, "white", RED, rng=np.random.default_rng(3)).size_m
    assert drawn[2] == pytest.approx(length_m, rel=0.031)
    assert drawn[2] != length_m


def test_one_sees_under_a_truck():
    widths = rows_at(outline(truck(1, "blue", RED), 18.0), 0.3)
    assert len(widths) == 2
    assert (widths < 1.3).all()


@pytest.mark.parametrize("bars", [True, False])
def test_a_railing_has_its_size_and_gaps(bars):
    rail = railing(1, "grey", RED, 6.0, 1.1, bars=bars)
    low, high = bounds(rail)
    assert (high - low)[[0, 2]] == pytest.approx([6.0, 1.1], abs=1e-9)
    mask, *_ = seen = outline(rail, 9.0, 450, size=(401, 221))
    middle = rows_at(seen, 0.3)
    assert len(middle) > (30 if bars else 3)
    assert middle.sum() < 2.0
    assert mask.any()


def test_a_fork_is_a_nose_with_free_road_on_both_sides():
    thing = fork(1, "yellow", RED, 10.0)
    low, high = bounds(thing)
    assert (low[0], high[0]) == pytest.approx((0, 10), abs=0.06)
    assert low[1] == pytest.approx(-high[1])
    front = [p for p in thing.parts if p.T_thing_part[0, 3] < 0.6]
    nose = replace(thing, parts=tuple(front))
    assert nose.size_m[0] < 1.2
    assert thing.size_m[0] > 3.5
    # The panel is the foremost thing, and flat: chevrons all in one plane.
    stripes = [p for p in thing.parts if p.rgb == RED]
    assert len(stripes) >= 4
    assert [bounds(replace(thing, parts=(p,)))[0, 0] for p in stripes] == pytest.approx([0.0] * len(stripes), abs=1e-12)


def test_a_forks_chevrons_stay_on_their_board():
    thing = fork(1, "yellow", RED)
    board = next(p for p in thing.parts if p.shape == "box" and p.half_m[1] == 0.45)
    low, high = bounds(replace(thing, parts=(board,)))
    for part in thing.parts:
        if part.rgb == RED:
            a, b = bounds(replace(thing, parts=(part,)))
            assert (a[1:] > low[1:] - 1e-9).all()
            assert (b[1:] < high[1:] + 1e-9).all()


@pytest.mark.parametrize(
    ("thing", "size_m"),
    [
        (crate(1, "red", RED, (0.7, 0.9, 0.8)), [0.9, 0.8, 0.7]),
        (carton(1, "brown", RED, (0.3, 0.2, 0.1)), [0.2, 0.101, 0.3]),
        (wall(1, "brown", RED, (0.3, 4.0, 1.6)), [4.0, 1.6, 0.3]),
        (wall(1, "brown", RED, (0.3, 4.0, 1.6), rng=np.random.default_rng(0)), [4.0, 1.6, 0.3]),
        (traffic_cone(1, "orange", RED, 0.5), [0.26, 0.5, 0.26]),
        (tyre(1, radius_m=0.3), [0.6, 0.348, 0.6]),
        (tyre(1, radius_m=0.3, lying=False), [0.348, 0.6, 0.6]),
        (pole(1, "grey", RED, 4.0, 0.1), [0.3, 4.0, 0.3]),
    ],
)
def test_things_of_the_street_have_their_size(thing, size_m):
    assert thing.size_m == pytest.approx(size_m, abs=1.1e-3)
    assert bounds(thing)[0, 2] == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("size_m", [0.05, 0.3])
def test_a_stones_longest_side_is_its_size(size_m):
    assert max(stone(1, "grey", RED, size_m, rng=np.random.default_rng(5)).size_m) == pytest.approx(size_m)
    assert max(stone(1, "grey", RED, size_m).size_m) == pytest.approx(size_m)


def test_a_hedge_fills_its_bounds_with_lumps():
    low, high = bounds(hedge(1, "green", RED, (1.0, 3.0, 1.5)))
    assert high - low == pytest.approx([1.0, 3.0, 1.5], abs=0.1)
    low, high = bounds(hedge(1, "green", RED, (1.0, 3.0, 1.5), rng=np.random.default_rng(6)))
    assert (high - low <= np.array([1.0, 3.0, 1.5]) + 1e-9).all()


def test_one_sees_through_a_standing_tyre():
    mask, scale, horizon, eye = outline(tyre(1, lying=False), 5.0, 700, yaw_rad=np.pi / 2)
    hub = round(horizon + (eye - 0.32) * scale)
    assert not mask[hub, 150]
    assert mask[hub].sum() > 0.3 * scale


@pytest.mark.parametrize("model", SIGNS)
def test_a_sign_is_a_pole_with_a_plate_on_top(model):
    thing = sign(1, "red", RED, model, 2.5)
    assert thing.type == "pole"
    assert bounds(thing)[:, 2] == pytest.approx([0, 2.5])
    assert thing.size_m[0] == pytest.approx(0.64 if model != "triangle" else 0.764, abs=1e-9)
    # From behind one sees the post, from before the plate.
    assert bounds(thing)[1, 0] < 0.03


def test_scenery_has_no_name():
    rng = np.random.default_rng(0)
    for thing in (house((200, 200, 200), RED, (10.0, 8.0, 5.0)), tree((70, 110, 50), 7.0, rng), street_lamp(RED)):
        assert thing.id == 0


def test_house_stands_on_the_ground_with_a_roof_over_its_eaves():
    low, high = bounds(house((200, 200, 200), (150, 60, 50), (10.0, 8.0, 5.0)))
    assert low[2] == 0
    # A right-angled gable over 8 m and 0.4 m of eaves on both sides.
    assert high[2] == pytest.approx(5 + 4.4)


def test_tree_is_drawn_from_its_generator():
    a, b = (bounds(tree((70, 110, 50), 7.0, np.random.default_rng(seed))) for seed in (3, 4))
    assert not np.array_equal(a, b)


def test_shaded_stays_a_colour():
    assert shaded((100, 200, 30), 1.5) == (150, 255, 45)


def test_an_order_is_obeyed():
    thing = build(Order("wall", 5, color="red", length_m=0.4, width_m=2.0, height_m=1.1))
    assert (thing.id, thing.color) == (5, "red")
    assert thing.size_m == pytest.approx([2.0, 1.1, 0.4])
    assert build(Order("person", 1, height_m=1.5)).size_m[1] == pytest.approx(1.5)
    assert build(Order("person", 1, walking=True)).gait is not None
    assert build(Order("bicycle", 1, height_m=0.53)).size_m[2] == pytest.approx(1.73 / 2)
    assert build(Order("stone", 1, length_m=0.07)).size_m.max() == pytest.approx(0.07)
    assert any(p.rgb == COLORS["blue"] for p in build(Order("car", 1, color="blue")).parts)


@pytest.mark.parametrize(
    ("order", "message"),
    [
        (Order("persn", 1), "'persn' is no known type; did you mean person?"),
        (Order("zzz", 1), "'zzz' is no known type; choose one of these"),
        (Order("car", 1, color="redd"), "no known color; did you mean red?"),
        (Order("car", 1, model="smal"), "no known model; did you mean small?"),
        (Order("truck", 1, model="small"), "a truck has no models"),
        (Order("car", 1, length_m=4.0), "a car takes no length_m: one can choose nothing"),
        (Order("person", 1, width_m=0.4), "a person takes no width_m: one can choose height_m and walking only"),
        (Order("wall", 1, height_m=0.0), "height_m of a wall must lie in"),
        (Order("wall", 1, height_m=float("nan")), "height_m of a wall must lie in"),
        (Order("car", 1, walking=True), "a car does not walk"),
    ],
)
def test_orders_that_cannot_be_are_refused(order, message):
    with pytest.raises(ValueRefusedError, match=message):
        build(order)
