from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from roadblock.config import make_settings
from roadblock.detectors import DETECTORS, make_detector
from roadblock.detectors.mono import mono_area, mono_ground
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street, paper_rig
from roadblock.stages.mono import BUILDS, Build, MonoSettings
from roadblock.stages.mono.horizon import find_road
from roadblock.stages.mono.measure import region_by_area, region_by_contact
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.stages.triangulate import locate
from roadblock.values.frame import RectifiedPair

PITCH_RAD = 0.02


@cache
def street():
    """Return the demo street: the rectified pair and what was rendered."""
    rendered = render(demo_street(1, pitch_rad=PITCH_RAD), paper_rig(), seed=3)
    rectification = plan_rectification(paper_rig(), make_settings({}).rectify)
    return rectify(rendered.pair, rectification, paper_rig().left.size_px), rendered


def blank(value=90):
    pair, _ = street()
    image = np.full(pair.left.shape, value, np.uint8)
    return RectifiedPair(image, image, pair.rectification)


def range_of(region):
    pair, rendered = street()
    return locate(region, pair.rectification, rendered.ground).range_m


def ragged(mask, rng):
    """Move an outline in or out by a correlated noise of 1 px."""
    (rows, columns), moved = ndimage.find_objects(mask.astype(int))[0], np.zeros_like(mask)
    window = slice(max(0, rows.start - 9), rows.stop + 9), slice(max(0, columns.start - 9), columns.stop + 9)
    distance = ndimage.distance_transform_edt(mask[window]) - ndimage.distance_transform_edt(~mask[window])
    noise = ndimage.gaussian_filter(rng.normal(size=distance.shape), 1.0)
    moved[window] = distance - 0.5 * np.sign(distance) > noise / noise.std()
    return moved


@pytest.mark.parametrize(
    ("name", "factory"), [("mono_ground", mono_ground), ("mono_area", mono_area)], ids=["ground", "area"]
)
def test_both_are_in_the_table(name, factory) -> None:
    assert DETECTORS[name] is factory
    assert callable(make_detector(make_settings({"detector": name})))


@pytest.mark.parametrize("number", range(1, 7))
def test_exact_masks_reach_the_order_of_the_paper(number: int) -> None:
    """The bar: 0.1 to 0.6 m at 5 to 20 m, with 1 px of noise on the outline and the horizon as it is found."""
    pair, rendered = street()
    settings = MonoSettings()
    ground = find_road(pair.left, pair.rectification, settings)
    assert ground is not None
    true = next(thing for thing in rendered.objects if thing.id == number)
    build = BUILDS["person"] if true.type == "person" else Build(*true.size_m[[0, 1, 2]], 1.0)
    rng = np.random.default_rng(number)
    errors = []
    for _ in range(3):
        mask = ragged(rendered.ids == number, rng)
        regions = (
            region_by_contact(mask, pair.left, pair.rectification, ground, settings),
            region_by_area(mask, pair.left, pair.rectification, ground, settings, build),
        )
        errors.append([range_of(region) - true.range_m for region in regions if region is not None])
    limits = {5: (0.3, 0.4), 10: (0.6, 0.6), 20: (0.7, 0.8)}[round(true.range_m)]
    assert (np.sqrt(np.mean(np.square(errors), axis=0)) < limits).all()


def test_the_contact_row_ranges_what_the_left_image_shows() -> None:
    pair, rendered = street()
    found = mono_ground(make_settings({}))(pair)
    assert found.ground is not None
    assert found.ground.pitch_rad == pytest.approx(PITCH_RAD, abs=0.001)
    assert np.isnan(found.matched_share)
    assert list(found.timings_ms) == ["horizon", "outline", "measure"]
    errors = best_errors(found.regions, rendered)
    # The person in white at 20 m is as grey as the road: one camera that goes by colour may miss it.
    assert {1, 2, 3, 4, 5} <= set(errors)
    assert all(abs(error) < 0.06 * truth for truth, error in errors.values())


def test_the_area_ranges_persons_and_knows_how_little_it_knows_of_boxes() -> None:
    pair, rendered = street()
    found = mono_area(make_settings({}))(pair)
    errors = best_errors(found.regions, rendered)
    assert abs(errors[2][1]) < 0.6
    assert abs(errors[4][1]) < 1.0
    persons = mono_area(make_settings({"mono": {"kind": "person"}}))(pair)
    assert abs(best_errors(persons.regions, rendered)[2][1]) < 0.6


def best_errors(regions, rendered):
    """Return true range and error of each thing that a region covers, by id."""
    errors = {}
    for region in regions:
        u, v = region.surface_uvd_px[:, :2].astype(int).T
        mask = np.zeros(rendered.ids.shape, bool)
        mask[v, u] = True
        for true in rendered.objects:
            own = rendered.ids == true.id
            if (mask & own).sum() > 0.5 * (mask | own).sum():
                errors[true.id] = (true.range_m, range_of(region) - true.range_m)
    return errors


def test_the_right_image_is_not_looked_at() -> None:
    pair, _ = street()
    other = RectifiedPair(pair.left, blank().left, pair.rectification)
    a, b = (mono_ground(make_settings({}))(p) for p in (pair, other))
    assert [r.surface_uvd_px[0, 2] for r in a.regions] == [r.surface_uvd_px[0, 2] for r in b.regions]


def test_free_space_ends_at_the_nearest_things() -> None:
    pair, _ = street()
    free = mono_ground(make_settings({}))(pair).free_space
    red = free.range_m[(free.u_px > 970) & (free.u_px < 1090)]
    assert np.median(red) == pytest.approx(5.0, abs=0.2)
    open_road = free.range_m[(free.u_px > 500) & (free.u_px < 520)]
    assert (open_road > 8).all()


@pytest.mark.parametrize("name", ["mono_ground", "mono_area"])
def test_without_a_horizon_nothing_is_said(name: str) -> None:
    found = DETECTORS[name](make_settings({}))(blank())
    assert found.ground is None
    assert found.regions == ()
    assert np.isnan(found.free_space.range_m).all()
    assert len(found.free_space.u_px) == 1280


@pytest.mark.parametrize("name", ["mono_ground", "mono_area"])
def test_a_known_pitch_needs_no_horizon(name: str) -> None:
    found = DETECTORS[name](make_settings({"mono": {"pitch_deg": 1.0}}))(blank())
    assert found.ground is not None
    assert found.regions == ()
    # All of it looks like road.
    assert found.free_space.range_m == pytest.approx(40.0)


def test_what_is_out_of_reach_is_left_out() -> None:
    pair, _ = street()
    near = mono_ground(make_settings({"mono": {"reach_m": 7.0}}))(pair)
    assert {round(range_of(region)) for region in near.regions} == {5}
