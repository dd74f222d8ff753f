"""The `bands` detector on drawn streets: what it reports, what it leaves out, and what it does not claim."""

import numpy as np
import pytest

from roadblock.config import Settings, make_settings
from roadblock.detectors import DETECTORS, make_detector
from roadblock.detectors.bands import counts
from roadblock.geometry.pose import pose
from roadblock.geometry.stereo import triangulate
from roadblock.pipeline import Pipeline
from roadblock.stages.bands import BandsSettings, Ends
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.frame import RectifiedPair, StereoPair
from roadblock.values.scene import Detections, Region

F, CX, HORIZON, BASELINE, CAMERA_M = 302.7, 171.4, 61.3, 0.213, 1.37
WIDTH, HEIGHT = 331, 197
R = Rectification(F, CX, HORIZON, BASELINE, (WIDTH, HEIGHT))
FB = F * BASELINE


class Street:
    """Two grey pictures of a flat road, with upright boards and paint on it."""

    def __init__(self, road: float = 170.0) -> None:
        self.images = [np.full((HEIGHT, WIDTH), road) for _ in range(2)]
        for image in self.images:
            image[: int(HORIZON) + 1] = 240

    def fill(self, v: int, u0: float, d: float, width_px: float, grey: float) -> None:
        u = np.arange(WIDTH)
        for image, shift in zip(self.images, (0, d), strict=True):
            a, b = u0 - shift, u0 - shift + width_px
            share = np.clip(np.minimum(u + 0.5, b) - np.maximum(u - 0.5, a), 0, 1)
            image[v] += share * (grey - image[v])

    def board(self, z: float, u0: float, width_m: float, height_m: float, grey: float = 70) -> None:
        foot, top = HORIZON + F * CAMERA_M / z, HORIZON + F * (CAMERA_M - height_m) / z
        for v in range(round(top), round(foot) + 1):
            self.fill(v, u0, FB / z, width_m * F / z, grey)

    def paint(self, u0: float, width_m: float, z_near: float, z_far: float, grey: float = 235) -> None:
        rows = range(round(HORIZON + F * CAMERA_M / z_far), round(HORIZON + F * CAMERA_M / z_near) + 1)
        for v in rows:
            z = F * CAMERA_M / (v - HORIZON)
            self.fill(v, CX + (u0 - CX) * (v - HORIZON) / 50, FB / z, width_m * F / z, grey)

    def pair(self, noise: float = 2.0, kind: str = "grey") -> RectifiedPair:
        rng = np.random.default_rng(9)
        grays = [np.clip(np.rint(i + rng.normal(0, noise, i.shape)), 0, 255).astype(np.uint8) for i in self.images]
        if kind == "rgb":
            grays = [np.repeat(g[..., None], 3, axis=2) for g in grays]
        if kind == "deep":
            grays = [np.repeat(g[..., None], 3, axis=2).astype(np.uint16) * 257 for g in grays]
        return RectifiedPair(grays[0], grays[1], R)


def find(street: Street, kind: str = "grey", **changes: object) -> Detections:
    return make_detector(make_settings({"detector": "bands", "bands": changes}))(street.pair(kind=kind))


def nearest_first(found: Detections) -> list[Region]:
    return sorted(found.regions, key=lambda region: -float(np.median(region.surface_uvd_px[:, 2])))


def range_of(region: Region) -> float:
    return FB / float(np.median(region.surface_uvd_px[:, 2]))


def two_boards() -> Street:
    street = Street()
    street.board(5, 200.3, 0.6, 1.2)
    street.board(11, 80.7, 0.9, 1.3)
    return street


def test_it_is_in_the_table() -> None:
    assert "bands" in DETECTORS


@pytest.mark.parametrize("kind", ["grey", "rgb", "deep"])
def test_boards_are_found_at_their_ranges(kind: str) -> None:
    near, far = nearest_first(find(two_boards(), kind))
    assert range_of(near) == pytest.approx(5, abs=0.06)
    assert range_of(far) == pytest.approx(11, abs=0.15)
    for region, z, u0, width_m, top_m in ((near, 5, 200.3, 0.6, 1.2), (far, 11, 80.7, 0.9, 1.3)):
        edges = (u0, HORIZON + F * (CAMERA_M - top_m) / z, u0 + width_m * F / z, HORIZON + F * CAMERA_M / z)
        np.testing.assert_allclose(region.box_px, edges, atol=2.5)
        assert abs(range_of(region) - z) < 3 * z**2 / FB * region.sigma_d_px
        u, v = region.contour_px.T
        assert (u.min(), v.min(), u.max() + 1, v.max() + 1) == region.box_px
        # The rim of road in the mask brightens the grey of 70.
        assert np.isnan(region.color_rgb).all() if kind == "grey" else (np.abs(region.color_rgb - 77) < 8).all()


def test_the_pipeline_gives_metres() -> None:
    camera = Camera((WIDTH, HEIGHT), F, F, CX, HORIZON)
    rig = StereoRig(camera, camera, pose(np.eye(3), [BASELINE, 0, 0]))
    settings = make_settings({"detector": "bands", "bands": {"camera_height_m": CAMERA_M}})
    pair = two_boards().pair()
    result, _ = Pipeline(rig, settings).step(StereoPair(pair.left, pair.right))
    near, far = result.obstacles
    assert (near.range_m, far.range_m) == pytest.approx((5, 11), rel=0.02)
    assert near.size_m[0] == pytest.approx(0.6, abs=0.05)
    assert near.size_m[1] == pytest.approx(1.2, abs=0.1)
    assert near.position_m[2] == pytest.approx(-CAMERA_M)


def test_the_ground_is_only_what_the_settings_say() -> None:
    assert find(two_boards()).ground is None
    ground = find(two_boards(), camera_height_m=1.37, pitch_deg=1.5).ground
    assert ground is not None
    assert ground.height_m == 1.37
    assert ground.pitch_rad == pytest.approx(np.radians(1.5))


def test_paint_is_no_obstacle_unless_wanted() -> None:
    street = two_boards()
    street.paint(150, 0.12, 4.2, 15)
    assert len(find(street).regions) == 2
    assert len(find(street, keep_flat=True).regions) == 3


def test_what_is_too_low_for_an_obstacle_is_left_out_where_the_height_is_known() -> None:
    street = Street()
    street.board(5, 140.3, 0.9, 0.08)
    assert len(find(street).regions) == 1
    assert len(find(street, camera_height_m=CAMERA_M).regions) == 0
    assert len(find(street, camera_height_m=CAMERA_M, height_m=0.04).regions) == 1


def test_what_hangs_over_the_road_is_left_out_where_the_height_is_known() -> None:
    street = Street()
    for v in range(round(HORIZON) + 3, round(HORIZON) + 13):
        street.fill(v, 120.3, FB / 4, 80, 60)
    assert len(find(street).regions) == 1
    # The ten rows are 1.16 to 1.33 m over the road, were they 4 m away.
    assert len(find(street, camera_height_m=CAMERA_M).regions) == 0
    assert len(find(street, camera_height_m=CAMERA_M, overhead_m=1.4).regions) == 1


def test_what_is_out_of_reach_is_left_out() -> None:
    (near,) = find(two_boards(), reach_m=8).regions
    assert range_of(near) == pytest.approx(5, abs=0.1)


def test_too_few_segments_are_no_target() -> None:
    assert len(find(two_boards(), least_segments=1000).regions) == 0


def test_a_dark_and_a_bright_half_of_one_target_are_one_again() -> None:
    street = Street()
    street.board(6, 150.3, 0.7, 1.25, 60)
    street.board(6, 150.3, 0.7, 0.6, 250)
    (whole,) = find(street).regions
    assert range_of(whole) == pytest.approx(6, abs=0.1)
    assert whole.box_px[3] - whole.box_px[1] == pytest.approx(1.25 * F / 6, abs=4)


def test_neighbours_at_one_range_stay_two() -> None:
    street = Street()
    street.board(6, 100.3, 0.6, 1.2)
    street.board(6, 160.3, 0.6, 1.2)
    assert len(find(street).regions) == 2


def test_free_space_ends_at_targets_and_claims_nothing_else() -> None:
    street = two_boards()
    # Paint before the far board, and something the right camera does not see.
    for v in range(150, 160):
        street.fill(v, 95, (v - HORIZON) * BASELINE / CAMERA_M, 8, 240)
    street.images[0][100:120, 10:40] = 60
    free = find(street).free_space
    np.testing.assert_array_equal(free.u_px, np.arange(WIDTH))
    np.testing.assert_allclose(free.range_m[204:234], 5, atol=0.06)
    known = np.isfinite(free.range_m)
    assert not known[:75].any(), "no target, or none that was matched"
    assert not known[110:195].any(), "mere road"
    far = free.range_m[84:103]
    np.testing.assert_allclose(far[np.isfinite(far)], 11, atol=0.3)
    assert 0 < np.isfinite(far).sum() < len(far), "where paint lies before it, the road was not seen"


def test_an_empty_road_has_nothing_and_claims_nothing() -> None:
    found = find(Street())
    assert found.regions == ()
    assert np.isnan(found.free_space.range_m).all()
    assert np.isnan(found.matched_share)
    assert set(found.timings_ms) == {"segment", "match", "regions"}


@pytest.mark.parametrize("size", [(1, 1), (3, 2), (7, 60), (60, 7)])
def test_tiny_and_even_images_do_not_crash(size: tuple[int, int]) -> None:
    detect = DETECTORS["bands"](Settings())
    image = np.random.default_rng(1).integers(0, 256, size[::-1], np.uint8)
    for picture in (image, np.zeros_like(image)):
        found = detect(RectifiedPair(picture, picture, Rectification(30.0, size[0] / 2, 0.4, 0.2, size)))
        assert len(found.free_space.u_px) == size[0]


def test_a_speck_before_a_target_is_no_road_seen() -> None:
    street = two_boards()
    for image in street.images:
        image[170:175, 210:215] = 60
    free = find(street).free_space.range_m
    assert np.isnan(free[210:215]).all()
    np.testing.assert_allclose(free[[205, 230]], 5, atol=0.06)


def test_what_is_infinitely_far_is_no_obstacle() -> None:
    uvd = np.column_stack([np.full(8, 50.0), np.repeat(np.arange(100.0, 120, 5), 2), np.full(8, 4.0)])
    uvd[3, 2] = 0
    ends = Ends(uvd, triangulate(R, uvd), 0.1)
    assert not counts(ends, HORIZON, BandsSettings())
    uvd[3, 2] = 4
    assert counts(Ends(uvd, triangulate(R, uvd), 0.1), HORIZON, BandsSettings())
