from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.ndimage import shift

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations, triangulate
from roadblock.sim import raycast
from roadblock.sim.outlines import candidates
from roadblock.sim.render import Quality, _rays, render, render_linear, sub_pixel_places
from roadblock.sim.road import Line, Road
from roadblock.sim.scene import Scene, camera_pose, demo_street
from roadblock.sim.solids import Thing, box, placed
from roadblock.sim.things import crate, person
from roadblock.stages.rectify import plan_rectification, rectify
from roadblock.values.camera import Camera, Rectification, StereoRig

CAMERA = Camera((97, 61), 80.0, 80.0, 51.3, 27.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.3, 0, 0]))
RECTIFICATION = Rectification(80.0, 51.3, 27.6, 0.3, (97, 61))
GREY = (150, 150, 150)


def wall(depth_m, rgb=GREY, contrast=0.25, size_m=(0.1, 40.0, 40.0), left_m=0.0, number=1):
    return placed(Thing(number, "wall", "grey", (box(size_m, (0, 0, 0), rgb, contrast),)), depth_m, left_m)


def street(*things, **pose_of):
    return Scene(things, Road(), camera_pose(**pose_of))


def linear(image):
    return (image / 255.0) ** 2.2


@pytest.mark.parametrize(("pitch_rad", "roll_rad"), [(0.0, 0.0), (0.13, -0.05), (-0.02, 0.3)])
def test_road_disparities_lie_on_the_road(pitch_rad, roll_rad):
    rendered = render(street(height_m=1.3, pitch_rad=pitch_rad, roll_rad=roll_rad), RIG, quality="preview")
    d = rendered.disparity.d_px
    v, u = np.nonzero(d > 0.05)
    points = triangulate(RECTIFICATION, np.stack([u, v, d[v, u]], -1))
    assert len(points) > 1000
    assert np.abs(rendered.ground.height_of(points) / points[:, 2]).max() < 1e-5
    ground = rendered.ground
    assert (ground.height_m, ground.pitch_rad) == pytest.approx((1.3, pitch_rad), abs=1e-6 + abs(roll_rad * pitch_rad))
    # Horizon by hand: rays at right angles to the normal.
    rows, columns = np.mgrid[:61, :97]
    down = -np.stack([(columns - 51.3) / 80, (rows - 27.6) / 80, np.ones((61, 97))], -1) @ ground.normal
    assert np.array_equal(np.isnan(d), down <= 0)


def test_level_road_by_hand():
    d = render(street(height_m=1.3), RIG, quality="preview").disparity.d_px
    v = np.arange(28, 61)
    assert d[28:, 5] == pytest.approx(0.3 * (v - 27.6) / 1.3, rel=1e-6)
    assert np.isnan(d[:28]).all()
    assert d.dtype == np.float32


def test_box_face_has_one_disparity_and_ids_agree():
    rendered = render(
        street(placed(crate(4, "red", (200, 30, 30), (0.5, 1.0, 0.8)), 5.0, 0.4), height_m=1.39), RIG, quality="preview"
    )
    d, ids = rendered.disparity.d_px, rendered.ids
    face = (ids == 4) & (np.arange(61)[:, None] > 27.6 + 80 * 0.59 / 5)
    assert ids.dtype == np.int32
    assert set(np.unique(ids)) == {0, 4}
    assert d[face] == pytest.approx(80 * 0.3 / 5.0, rel=1e-6)
    assert (d[ids == 4] > 80 * 0.3 / 5.51).all()
    # Columns 39.3..55.3 and rows 37.04..49.84, by hand.
    assert face.sum() == 16 * 12


def estimated_shift(left, right, whole, columns, rows):
    """Disparity of a fronto-parallel texture by least squares with gain and offset, quintic interpolation."""
    left, right = left.astype(float).mean(2), right.astype(float).mean(2)
    template = left[rows, columns]
    gradient = np.gradient(left, axis=1)[rows, columns]
    part = 0.5
    for _ in range(8):
        moved = shift(right, (0, whole + part), order=5)[rows, columns]
        design = np.stack([gradient.ravel(), moved.ravel(), np.ones(gradient.size)], 1)
        part -= np.linalg.lstsq(design, template.ravel(), rcond=None)[0][0]
    return whole + part


@pytest.mark.parametrize("d_px", [12.3, 12.5, 7.77])
def test_wall_is_shifted_by_its_disparity(d_px):
    camera = Camera((240, 120), 1033.0, 1033.0, 107.3, 90.6)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    pair = render(street(wall(1033 * 0.205 / d_px), height_m=3.0), rig, quality="evidence", noise=0).pair
    found = estimated_shift(pair.left, pair.right, int(d_px), slice(50, 210), slice(10, 110))
    assert found == pytest.approx(d_px, abs=0.004)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.8])
def test_edges_cover_pixels_by_area(share):
    # The left edge of the card in front (seen first by the sun, so without a shadow there) lies at a known column.
    u_edge = 40.5 - share
    left_m = -((u_edge - 51.3) / 80 * 5.0 - 0.15)
    card = wall(5.0, (230, 230, 230), 0.0, (0.1, 1.0, 2.4), left_m - 0.5, 2)
    scene = street(wall(9.0, (40, 40, 40), 0.0), card, height_m=1.3)
    for samples, tolerance in ((16, 0.01), (64, 0.003)):
        image = render_linear(scene, RIG, quality=Quality(samples, samples)).left.light[15:40]
        dark, bright = image[:, 36].mean(), image[:, 44].mean()
        covered = (image[:, 40].mean() - dark) / (bright - dark)
        assert covered == pytest.approx(share, abs=tolerance)


def test_sun_casts_shadows_away_from_it():
    lamp = replace(street(wall(6.0, GREY, 0.0, (1.0, 0.4, 3.0)), height_m=1.3), towards_sun=np.array([0.0, 1.0, 1.0]))
    image = linear(render(lamp, RIG, noise=0).pair.left).mean(2)
    row = round(27.6 + 80 * 1.3 / 6.34)
    columns = [round(51.3 + 80 * (x + 0.15) / 6.34) for x in (-1.5, 1.5)]
    assert image[row, columns[1]] < 0.6 * image[row, columns[0]]


def test_person_has_a_persons_outline():
    camera = Camera((120, 240), 420.0, 420.0, 66.3, 40.6)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    scene = street(placed(person(1, "blue", (30, 60, 170), (40, 60, 120)), 4.0, 0.1, np.pi))
    seen = render(scene, rig, quality="preview").ids == 1

    def runs(height_m):
        row = seen[round(40.6 + 420 * (1.4 - height_m) / 4.2)].astype(int)
        edges = np.flatnonzero(np.diff(row))
        return (edges[1::2] - edges[::2]) * 4.2 / 420

    head, chest, knees = runs(1.63), runs(1.3), runs(0.45)
    assert len(head) == 1
    assert len(knees) == len(runs(0.65)) == 2
    assert head[0] < 0.2
    assert chest.sum() > 2 * head[0]
    assert (knees < 0.15).all()
    assert len(runs(0.95)) == 3


def test_same_arguments_give_same_bytes_whatever_the_threads():
    scene = demo_street(3)
    first, again = (render(scene, RIG, threads=n, seed=5) for n in (1, 3))
    other = render(scene, RIG, seed=6)
    for side in ("left", "right"):
        assert np.array_equal(getattr(first.pair, side), getattr(again.pair, side))
        assert not np.array_equal(getattr(first.pair, side), getattr(other.pair, side))
    assert np.array_equal(first.disparity.d_px, other.disparity.d_px, equal_nan=True)
    assert not np.array_equal(render(demo_street(4), RIG, noise=0).pair.left, render(scene, RIG, noise=0).pair.left)


@pytest.mark.parametrize("rgb", [(60, 60, 60), (170, 170, 170)])
def test_noise_is_as_stated_and_its_own_in_both_cameras(rgb):
    scene = street(wall(5.0, rgb, 0.0), height_m=20.0)
    clean, noisy = (render(scene, RIG, noise=n, quality="preview").pair for n in (0.0, 2.0))
    left, right = (b.astype(float) - a for a, b in ((clean.left, noisy.left), (clean.right, noisy.right)))
    level = clean.left.mean()
    assert left.std() == pytest.approx(np.sqrt(4 * (0.5 + level / 256) + 1 / 12), rel=0.05)
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.03


def test_both_cameras_see_the_same_street():
    camera = Camera((320, 180), 258.25, 258.25, 162.7, 86.4)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    rendered = render(demo_street(), rig, quality="evidence", noise=0)
    d = rendered.disparity.d_px
    rows, columns = np.mgrid[:180, :320].astype(np.float32)
    seen_again = cv2.remap(rendered.pair.right, columns - np.nan_to_num(d), rows, cv2.INTER_CUBIC)
    off = np.abs(seen_again.astype(float) - rendered.pair.left).max(2)[:, 16:]
    assert np.median(off) <= 1
    assert (off < 8).mean() > 0.93


def test_a_semi_global_matcher_finds_the_true_disparities():
    camera = Camera((640, 360), 516.5, 516.5, 325.9, 173.5)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.205, 0, 0]))
    rendered = render(demo_street(), rig)
    grays = [cv2.cvtColor(i, cv2.COLOR_RGB2GRAY) for i in (rendered.pair.left, rendered.pair.right)]
    found = cv2.StereoSGBM.create(0, 48, 5, 200, 800, 1, 31, 5, 100, 1).compute(*grays) / 16.0
    valid = (found > 0) & (rendered.disparity.d_px > 0)
    error = np.abs(found - rendered.disparity.d_px)[valid]
    assert valid.mean() > 0.4
    # Such a matcher leans towards whole pixels by 0.2 px; what the renderer adds is measured above.
    assert np.median(error) < 0.35
    assert (error < 1).mean() > 0.9


def test_looks_like_a_street():
    """Sky is bright and blue, verge green, asphalt grey with white lines: what a person would name."""
    image = linear(render(Scene((), Road(), camera_pose()), RIG, quality="evidence", noise=0).pair.left)
    sky, asphalt, verge = image[:8].mean((0, 1)), image[50:, 40:46].mean((0, 1)), image[36:40, :5].mean((0, 1))
    assert sky[2] > sky[0]
    assert np.ptp(asphalt) < 0.1 * asphalt.mean()
    assert verge[1] > 1.2 * max(verge[0], verge[2])
    lines = Road(lines=(Line(0.0, 0.4),), contrast=0.0)
    image = linear(render(Scene((), lines, camera_pose()), RIG, quality="evidence", noise=0).pair.left)
    middle = round(51.3 + 80 * 0.15 / (80 * 1.4 / (55 - 27.6)))
    assert image[55, middle].mean() > 2 * image[55, middle - 15].mean()


def test_everyday_patterns_are_drawn():
    plain = crate(1, "red", (200, 30, 30), (0.5, 1.5, 1.2))
    for pattern in ("crate", "windows"):
        (part,) = plain.parts
        drawn = replace(plain, parts=(replace(part, pattern=pattern),))
        bare = replace(plain, parts=(replace(part, pattern="plain"),))
        a, b = (render(street(placed(t, 2.5, 0.0)), RIG, noise=0).pair.left.astype(int) for t in (drawn, bare))
        assert 0.02 < (np.abs(a - b).max(2) > 20).mean() < 0.5


def test_things_around_the_cameras_are_cut_not_lost():
    beside = wall(-2.0, size_m=(8.0, 0.4, 2.0), left_m=1.5)
    behind = wall(-9.0, size_m=(1.0, 1.0, 1.0), number=2)
    rendered = render(street(beside, behind), RIG, quality="preview")
    assert [o.id for o in rendered.objects] == [1]
    (true,) = rendered.objects
    assert true.box_px[0] == 0
    # The wall's inner side, y = 1.3 m, enters the view at the left border; the left camera sits at y = 0.15 m.
    assert rendered.disparity.d_px[28, 0] == pytest.approx(0.3 * 51.3 / (1.3 - 0.15), rel=1e-6)


def test_results_are_read_only():
    rendered = render(street(), RIG, quality="preview")
    for array in (rendered.ids, rendered.disparity.d_px, rendered.pair.left):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"quality": "best"}, "quality must be one of preview, demo, evidence, but got 'best'"),
        ({"threads": 0}, "threads must be >= 1, but got 0"),
        ({"noise": -1.0}, "noise must be >= 0 grey levels, but got -1"),
        ({"noise": float("nan")}, "noise must be >= 0 grey levels, but got nan"),
        ({"noise": float("inf")}, "noise must be >= 0 grey levels, but got inf"),
    ],
)
def test_impossible_settings_are_refused(change, message):
    with pytest.raises(ValueRefusedError, match=message):
        render(street(), RIG, **change)


@pytest.mark.parametrize("counts", [(0, 4), (4, 0)])
def test_a_quality_without_rays_is_refused(counts):
    with pytest.raises(ValueRefusedError, match="at least one ray, but got"):
        Quality(*counts)


@pytest.mark.parametrize("delays", [(np.zeros(60), np.zeros(61)), (np.zeros(61), np.full(61, np.nan))])
def test_delays_must_be_a_number_for_each_row(delays):
    with pytest.raises(ValueRefusedError, match="row_delays_s must"):
        render_linear(street(), RIG, row_delays_s=delays)


def test_light_has_the_stated_scale():
    """White ground in the default sun is 1 (its texture off), and the sky stays below."""
    white = Road(-90.0, 90.0, lines=(), contrast=0.0, asphalt=(255, 255, 255))
    seen = render_linear(Scene((), white, camera_pose()), RIG, quality="preview")
    assert seen.left.light.dtype == np.float32
    assert seen.left.light[-1].mean() == pytest.approx(1.0, abs=0.05)
    assert seen.left.light[:20].max() < 0.96
    assert seen.left.T_car_camera[0, 3] == pytest.approx(-0.15)
    assert seen.right.T_car_camera[0, 3] == pytest.approx(0.15)


def test_samples_fill_the_pixel_evenly():
    offsets = sub_pixel_places(50, 64)
    assert offsets.shape == (50, 64, 2)
    assert np.abs(offsets).max() <= 0.5
    for row in offsets:
        # One in each of 64 columns, of 64 rows, and of 8 x 8 blocks.
        for cells in (np.floor((row + 0.5) * 64), np.floor((row + 0.5) * 8) @ [[8, 0], [1, 0]]):
            assert set(cells[:, 0].astype(int)) == set(range(64))
        assert len(set(np.floor((row[:, 1] + 0.5) * 64))) == 64
    assert not np.array_equal(offsets[0], offsets[1])
    assert sub_pixel_places(3, 20).shape == (3, 20, 2)
    sub_pixel_places.cache_clear()
    assert np.array_equal(sub_pixel_places(50, 64), offsets)


TILT = rotation_from_rotvec([0.03, -0.05, 0.04])
RAW = {
    "pinhole": (
        Camera((97, 61), 80.0, 84.0, 51.3, 27.6),
        Camera((97, 61), 82.0, 81.0, 45.9, 31.2),
    ),
    "brown_conrady": (
        Camera((97, 61), 80.0, 84.0, 51.3, 27.6, "brown_conrady", np.array([-0.25, 0.06, 0.002, -0.003, 0.0])),
        Camera((97, 61), 82.0, 81.0, 45.9, 31.2, "brown_conrady", np.array([-0.2, 0.05, -0.002, 0.001, 0.0])),
    ),
    "kannala_brandt": (
        Camera((97, 61), 40.0, 41.0, 51.3, 27.6, "kannala_brandt", np.array([-0.02, 0.004, -0.002, 0.0])),
        Camera((97, 61), 42.0, 41.5, 45.9, 31.2, "kannala_brandt", np.array([-0.01, 0.003, -0.001, 0.0])),
    ),
}


def raw_rig(lens):
    return StereoRig(*RAW[lens], pose(TILT, [0.3, 0.02, -0.03]))


def crates():
    return tuple(
        placed(crate(i + 1, "red", (200, 30, 30), (0.5, 1.1, 1.0)), x, y)
        for i, (x, y) in enumerate([(4.0, 0.3), (6.0, -2.4), (7.0, 3.5), (12.0, 0.0)])
    )


def front_points(thing):
    """Points of a crate's front face, 16 % away from its edges."""
    low, high = thing.bounds_m(thing.T_world_thing)
    b, c = np.meshgrid(np.linspace(0.16, 0.84, 12), np.linspace(0.16, 0.84, 12))
    return np.stack(
        [np.full(144, low[0]), *(low[1:, None] + np.stack([b.ravel(), c.ravel()]) * np.ptp([low, high], 0)[1:, None])],
        1,
    )


@pytest.mark.parametrize("lens", RAW)
def test_raw_pictures_show_each_thing_where_its_lens_puts_it(lens):
    rig, things = raw_rig(lens), crates()[:3]
    scene = street(*things, height_m=1.3, pitch_rad=0.04)
    seen = render_linear(scene, rig, quality="preview")
    assert seen.disparity is None
    R_rect_left, _ = rectifying_rotations(rig.T_left_right)
    T_left_world = (
        pose(R_rect_left.T, [0, 0, 0]) @ pose(np.eye(3), [rig.baseline_m / 2, 0, 0]) @ inverse(scene.T_world_car)
    )
    both = ((rig.left, T_left_world, seen.left), (rig.right, inverse(rig.T_left_right) @ T_left_world, seen.right))
    for camera, T_camera_world, sighted in both:
        assert inverse(sighted.T_car_camera) @ inverse(scene.T_world_car) == pytest.approx(T_camera_world)
        checked = 0
        for thing in things:
            points = transform(T_camera_world, front_points(thing))
            uv = project(camera, points)
            u, v = np.rint(uv).astype(int).T
            inside = (uv[:, 0] > 0) & (uv[:, 0] < 96) & (uv[:, 1] > 0) & (uv[:, 1] < 60)
            assert (sighted.ids[v[inside], u[inside]] == thing.id).all()
            assert sighted.depth_m[v[inside], u[inside]] == pytest.approx(points[inside, 2], abs=0.12)
            checked += inside.sum()
        assert checked > 150


@pytest.mark.parametrize("lens", RAW)
def test_raw_depths_and_truth_are_exact(lens):
    rig, (thing, *_) = raw_rig(lens), crates()
    scene = street(thing, height_m=1.3)
    rendered = render(scene, rig, quality="preview")
    v, u = np.nonzero(rendered.ids == 1)
    rays = unproject(rig.left, np.stack([u, v], -1).astype(float))
    points = rays / rays[:, 2:] * rendered.depth_m[v, u][:, None]
    R_rect_left, _ = rectifying_rotations(rig.T_left_right)
    car = points @ R_rect_left.T - (rig.baseline_m / 2, 0, 0)
    front = np.abs(car[:, 2] - 4.0) < 1e-9
    assert front.sum() > 60
    low, high = thing.bounds_m(thing.T_world_thing)
    world = transform(scene.T_world_car, car)
    assert (world > low - 1e-9).all()
    assert (world < high + 1e-9).all()
    (true,) = rendered.objects
    assert true.range_m == pytest.approx(4.0, abs=1e-9)
    assert true.position_m == pytest.approx([4.0, 0.3, -1.3], abs=0.06)


@pytest.mark.parametrize("lens", ["brown_conrady", "kannala_brandt"])
def test_rays_between_pixel_centres_are_those_of_the_lens(lens):
    camera = RAW[lens][0]
    rays = _rays(camera)
    view = raycast.View((0.0,) * 3, tuple(np.eye(3).ravel()), (0.0,) * 3, (0.0,) * 3, 1.0, False, (0.0,) * 4)
    rng = np.random.default_rng(8)
    for u, v in rng.integers((0, 0), (97, 61), (200, 2)):
        du, dv = rng.uniform(-0.5, 0.5, 2)
        way = np.array(raycast.way(view, rays, u, v, du, dv))
        assert project(camera, way) == pytest.approx([u + du, v + dv], abs=2e-3)
        assert raycast.way(view, rays, u, v, 0.0, 0.0) == pytest.approx(unproject(camera, [float(u), float(v)]), abs=0)


def test_a_raw_picture_rectified_is_the_rectified_rigs_picture():
    k = np.array([-0.25, 0.06, 0.002, -0.003, 0.0])
    camera = Camera((320, 200), 260.0, 262.0, 162.7, 96.4, "brown_conrady", k)
    rig = StereoRig(camera, camera, pose(TILT, [0.3, 0.01, 0.0]))
    raw = render(demo_street(), rig, quality=Quality(16, 16), noise=0)
    plan = plan_rectification(rig)
    twin = Camera(plan.size_px, plan.f_px, plan.f_px, plan.cx_px, plan.cy_px)
    ideal = render(
        demo_street(), StereoRig(twin, twin, pose(np.eye(3), [rig.baseline_m, 0, 0])), quality=Quality(16, 16), noise=0
    )
    pair = rectify(raw.pair, plan, camera.size_px)
    for side in ("left", "right"):
        off = np.abs(getattr(pair, side).astype(float) - getattr(ideal.pair, side)).max(2)[2:-2, 2:-2]
        assert np.median(off) < 3
        assert (off < 16).mean() > 0.93


def test_what_the_lens_does_not_see_is_black_and_unknown():
    camera = Camera((97, 61), 80.0, 80.0, 51.3, 27.6, "brown_conrady", np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))
    seen = render_linear(street(), StereoRig(camera, camera, pose(np.eye(3), [0.3, 0, 0])), quality="demo")
    dark = np.isnan(unproject(camera, np.stack(np.meshgrid(np.arange(97.0), np.arange(61.0)), -1))[..., 0])
    assert 0.02 < dark.mean() < 0.9
    assert np.array_equal(np.isnan(seen.left.depth_m), dark)
    assert (seen.left.light[dark] == 0).all()
    assert (seen.left.ids[dark] == 0).all()
    assert np.isfinite(seen.left.light).all()
    assert (seen.left.light[~dark].max(1) > 0).mean() > 0.9


def everywhere(part, reach_m, camera, T_camera_world, sun, lowest_m):
    """No culling: every part may be seen, and throw its shadow, everywhere."""
    found = candidates(part, reach_m, camera, T_camera_world, sun, lowest_m)
    whole = np.tile([-2, -2, camera.size_px[0] + 2, camera.size_px[1] + 2], (len(part), 1))
    return found._replace(seen=whole, dark=whole, small=np.where(found.small == 1, 1, 2))


@pytest.mark.parametrize("lens", ["rectified", *RAW])
def test_culling_changes_nothing(lens, monkeypatch):
    rig = RIG if lens == "rectified" else raw_rig(lens)
    rail = Thing(9, "rail", "", (box((30.0, 0.05, 0.3), (0, 0, 0.6), GREY),))
    behind = placed(person(8, "red", (200, 0, 0), (90, 0, 0)), -6.0, 1.0)
    people = [placed(person(5 + i, "blue", (0, 0, 200), (0, 0, 90)), 9.0 + 9 * i, y) for i, y in enumerate((1.0, -2.0))]
    scene = replace(
        street(*crates(), *people, behind, placed(rail, -4.0, -2.6)), towards_sun=np.array([-0.6, 0.5, 0.25])
    )
    fast = render_linear(scene, rig, quality=Quality(4, 4))
    monkeypatch.setattr("roadblock.sim.render.candidates", everywhere)
    slow = render_linear(scene, rig, quality=Quality(4, 4))
    for side in ("left", "right"):
        assert np.array_equal(getattr(fast, side).ids, getattr(slow, side).ids)
        assert np.array_equal(getattr(fast, side).light, getattr(slow, side).light)


def test_rows_and_cameras_can_see_different_moments():
    pole = Thing(1, "pole", "red", (box((0.2, 0.4, 9.0), (0, 0, 0), GREY),), velocity_mps=np.array([0, 4.0, 0]))
    scene = street(placed(pole, 5.0, 0.0), height_m=1.3)
    mixed = render_linear(scene, RIG, quality="preview", row_delays_s=(np.zeros(61), np.full(61, 0.1)))
    now, later = (render_linear(moment, RIG, quality="preview") for moment in (scene, scene.at(0.1)))
    assert np.array_equal(mixed.left.light, now.left.light)
    assert np.array_equal(mixed.right.light, later.right.light)
    assert not np.array_equal(mixed.right.light, now.right.light)
    rolling = np.linspace(-0.1, 0.1, 61)
    seen = render_linear(scene, RIG, quality="preview", row_delays_s=(rolling, rolling)).left.ids == 1
    rows = np.flatnonzero(seen.any(1))
    middle = np.array([np.flatnonzero(seen[row]).mean() for row in rows])
    # It moves to the left by 80 * 4 / 5 px/s; a row is exposed 1/300 s after the one above, in steps of 8 rows.
    assert np.polyfit(rows, middle, 1)[0] == pytest.approx(-64 / 300, rel=0.1)
    assert len(rows) > 45
