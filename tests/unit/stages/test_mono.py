import cv2
import numpy as np
import pytest

from roadblock.config import make_settings
from roadblock.errors import SettingsError, ValueRefusedError
from roadblock.geometry.pose import rotation_from_rotvec
from roadblock.geometry.stereo import image_from_car
from roadblock.stages.mono import AUTO, BUILDS, Build, MonoSettings
from roadblock.stages.mono.horizon import find_road, find_segments, full_scale, vanishing_point
from roadblock.stages.mono.measure import (
    contact_point,
    guess_kind,
    outline_area,
    region_by_area,
    region_by_contact,
)
from roadblock.stages.mono.outline import Looks, Runs, find_free_space, find_outlines, find_runs, look, road_edges
from roadblock.stages.mono.ranging import (
    area_sensitivity,
    contact_sensitivity,
    first_range_from_area,
    range_from_area,
    range_from_contact,
    road_range,
)
from roadblock.values.camera import Rectification
from roadblock.values.scene import GroundPlane

CROOKED = Rectification(83.0, 44.3, 27.9, 0.31, (97, 61))
PAPER = Rectification(1033.0, 652.3, 347.6, 0.205, (1280, 720))
CAMERA = Rectification(410.0, 203.3, 131.2, 0.3, (400, 280))
SETTINGS = MonoSettings()
LEVEL = GroundPlane(np.array([0.0, -1.0, 0.0]), 1.4)
DRAWN_PITCH_DEG, DRAWN_ROLL_DEG = 4.0, 2.5
DISTANCES_M = [5.0, 10.0, 20.0]


def plane(pitch_deg=0.0, roll_deg=0.0, height_m=1.4):
    normal = np.array([-np.tan(np.radians(roll_deg)), -1.0, -np.tan(np.radians(pitch_deg))])
    return GroundPlane(normal / np.linalg.norm(normal), height_m)


def pitched(ground, by_rad):
    """Turn the camera further down about its x axis."""
    return GroundPlane(rotation_from_rotvec([by_rad, 0.0, 0.0]) @ ground.normal, ground.height_m)


def scaled(build, by):
    return Build(build.width_m * by, build.height_m * by, build.length_m * by, build.fill)


# Ranges by contact row


@pytest.mark.parametrize("ground", [plane(), plane(5.0, -7.0, 1.2), plane(-3.0, 6.0, 0.6)])
def test_a_point_of_the_road_is_found_at_its_distance(ground: GroundPlane) -> None:
    rng = np.random.default_rng(1)
    for x, z in zip(rng.uniform(-4, 4, 20), rng.uniform(3, 40, 20), strict=True):
        u, v, _ = image_from_car(CROOKED, ground.point_below(x, z))
        assert range_from_contact(u, v, CROOKED, ground) == pytest.approx(z, rel=1e-9)


def test_range_is_f_h_over_rows_below_the_horizon() -> None:
    assert range_from_contact(100.0, PAPER.cy_px + 72.31, PAPER, LEVEL) == pytest.approx(1033 * 1.4 / 72.31)
    tilt = np.radians(2.0)
    horizon = PAPER.cy_px - 1033 * np.tan(tilt)
    expected = 1033 * 1.4 / (np.cos(tilt) * 90.0)
    assert range_from_contact(5.0, horizon + 90.0, PAPER, plane(2.0)) == pytest.approx(expected)


def test_above_the_horizon_is_no_road() -> None:
    rows = np.array([[10.0, 27.0], [10.0, 27.9], [10.0, 28.9]])
    assert np.isnan(road_range(rows, CROOKED, LEVEL)).tolist() == [True, True, False]
    moves = contact_sensitivity(10.0, 5.0, CROOKED, LEVEL)
    assert np.isnan([moves.per_measured, moves.per_rad, moves.per_size]).all()
    assert np.isnan(moves.sigma_m(1.0, 1.0, 1.0))


@pytest.mark.parametrize("ground", [plane(), plane(5.0, -7.0, 1.2), plane(-3.0, 6.0, 0.6)])
def test_contact_sensitivity_is_the_derivative(ground: GroundPlane) -> None:
    u, v, _ = image_from_car(CROOKED, ground.point_below(1.1, 9.0))
    moves = contact_sensitivity(u, v, CROOKED, ground)
    e = 1e-5

    def central(plus, minus):
        return (plus - minus) / (2 * e)

    rows = [range_from_contact(u, v + s, CROOKED, ground) for s in (e, -e)]
    pitch = [range_from_contact(u, v, CROOKED, pitched(ground, s)) for s in (e, -e)]
    assert moves.per_measured == pytest.approx(central(*rows), rel=1e-5)
    assert moves.per_rad == pytest.approx(central(*pitch), rel=1e-5)
    assert moves.per_size == pytest.approx(9.0)


@pytest.mark.parametrize("z", DISTANCES_M)
def test_contact_errors_follow_the_closed_formulas(z: float) -> None:
    """The bar: 1 px of contact row, 0.1 deg of pitch and 5 % of size move the range as told, to 5 %."""
    f, h = 1033.0, 1.4
    u, v = 600.0, PAPER.cy_px + f * h / z

    def moved(u, v, plus, minus):
        return (range_from_contact(u, v + 0.5, PAPER, plus) - range_from_contact(u, v - 0.5, PAPER, minus)) / 1.0

    assert moved(u, v, LEVEL, LEVEL) == pytest.approx(-z * z / (f * h), rel=0.05)
    tilt = np.radians(0.1)
    by_pitch = range_from_contact(u, v, PAPER, pitched(LEVEL, tilt)) - z
    assert by_pitch == pytest.approx(-z * z / h * tilt, rel=0.05)
    by_height = range_from_contact(u, v, PAPER, GroundPlane(LEVEL.normal, 1.05 * h)) - z
    assert by_height == pytest.approx(0.05 * z, rel=0.05)
    moves = contact_sensitivity(u, v, PAPER, LEVEL)
    expected = [-z * z / (f * h), -z * z / h, z]
    assert [moves.per_measured, moves.per_rad, moves.per_size] == pytest.approx(expected)


def test_sigma_adds_independent_errors() -> None:
    moves = contact_sensitivity(600.0, PAPER.cy_px + 1033 * 1.4 / 10, PAPER, LEVEL)
    expected = np.hypot(np.hypot(2 * 100 / (1033 * 1.4), 0.003 * 100 / 1.4), 0.02 * 10)
    assert moves.sigma_m(2.0, 0.003, 0.02) == pytest.approx(expected)


# Ranges by area


def silhouette_by_opencv(build, z, x, ground, camera, yaw_deg=0.0):
    """Return area and middle column of the cuboid whose nearest bottom corner is z ahead, on a road without roll."""
    n = ground.normal
    ahead = np.array([0.0, -n[2], n[1]]) * -1
    across = np.array([1.0, 0.0, 0.0])
    turn = np.radians(yaw_deg)
    flat = [(a, b) for a in (-build.width_m / 2, build.width_m / 2) for b in (-build.length_m / 2, build.length_m / 2)]
    turned = [(a * np.cos(turn) - b * np.sin(turn), a * np.sin(turn) + b * np.cos(turn)) for a, b in flat]
    nearest = min(b for _, b in turned)
    # point_below speaks the car frame, OpenCV the left camera's: half a baseline apart.
    foot = ground.point_below(x - camera.baseline_m / 2, z) + np.array([camera.baseline_m / 2, 0, 0])
    bottom = [foot + a * across + (b - nearest) * ahead for a, b in turned]
    corners = np.array(bottom + [p + build.height_m * n for p in bottom])
    K = np.array([[camera.f_px, 0, camera.cx_px], [0, camera.f_px, camera.cy_px], [0, 0, 1]])
    pixels = cv2.projectPoints(corners, np.zeros(3), np.zeros(3), K, None)[0].reshape(-1, 2)
    return cv2.contourArea(cv2.convexHull(pixels.astype(np.float32))), camera.f_px * x / z + camera.cx_px


@pytest.mark.parametrize("yaw_deg", [0.0, 25.0, 90.0, 200.0])
@pytest.mark.parametrize("pitch_deg", [0.0, 6.0, -4.0])
def test_a_cuboid_is_found_at_its_distance(yaw_deg: float, pitch_deg: float) -> None:
    ground = plane(pitch_deg, 0.0, 1.3)
    build = Build(0.9, 0.7, 1.6, 0.8)
    for z, x in ((4.0, 1.2), (11.0, -2.0), (26.0, 0.3)):
        area, u = silhouette_by_opencv(build, z, x, ground, PAPER, yaw_deg)
        found = range_from_area(build.fill * area, u, build, PAPER, ground, np.radians(yaw_deg))
        assert found == pytest.approx(z, rel=1e-4)


def test_a_rolled_camera_sees_the_same_area_straight_ahead() -> None:
    """Rolling about the optical axis turns the picture, so a cuboid on the axis keeps its area."""
    twin = Rectification(1033.0, 652.3, 347.6, 1e-9 + 0.005, (1280, 720))
    level, tilted = plane(0.0, 0.0, 1.4), plane(0.0, 8.0, 1.4)
    build = Build(0.8, 1.75, 0.4, 1.0)
    u = 652.3
    area = 1033**2 * 0.8 * 1.75 / 100
    flat = range_from_area(area, u, build, twin, level)
    assert range_from_area(area, u, build, twin, tilted) == pytest.approx(flat, rel=2e-3)


def test_the_first_estimate_is_that_of_a_panel() -> None:
    assert first_range_from_area(1000 * 900 * 2.5 / 12.0**2, 2.5, 1000.0, 900.0) == pytest.approx(12.0)
    panel = Build(1.2, 1.3, 1e-6, 1.0)
    area = 1033**2 * 1.2 * 1.3 / 15.0**2
    assert range_from_area(area, 700.0, panel, PAPER, LEVEL) == pytest.approx(15.0, rel=1e-5)
    assert first_range_from_area(area, 1.2 * 1.3, 1033.0, 1033.0) == pytest.approx(15.0)


@pytest.mark.parametrize("ground", [plane(0.0, 0.0, 1.2), plane(5.0, -7.0, 1.2)])
@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_area_sensitivity_is_the_derivative(ground: GroundPlane, yaw: float) -> None:
    build = Build(1.1, 0.6, 2.0, 0.9)
    area, u = 90.0, 61.0
    z = range_from_area(area, u, build, CROOKED, ground, yaw)
    assert 3 < z < 20
    moves = area_sensitivity(area, u, build, CROOKED, ground, yaw)
    e = 1e-5

    def central(of):
        return (of(e) - of(-e)) / (2 * e)

    by_area = central(lambda s: range_from_area(area + s, u, build, CROOKED, ground, yaw))
    by_pitch = central(lambda s: range_from_area(area, u, build, CROOKED, pitched(ground, s), yaw))
    by_size = central(lambda s: range_from_area(area, u, scaled(build, 1 + s), CROOKED, ground, yaw))
    assert moves.per_measured == pytest.approx(by_area, rel=1e-4)
    assert moves.per_rad == pytest.approx(by_pitch, rel=1e-4)
    assert moves.per_size == pytest.approx(by_size, rel=1e-4)


@pytest.mark.parametrize("z", DISTANCES_M)
def test_area_errors_follow_the_closed_formulas(z: float) -> None:
    """The bar, for a panel: 5 % of size is 5 % of range, 0.1 deg of pitch nothing, area half its share."""
    panel = Build(1.0, 1.0, 1e-6, 1.0)
    area = 1033**2 / z**2
    moves = area_sensitivity(area, 650.0, panel, PAPER, LEVEL)
    assert moves.per_measured == pytest.approx(-z / (2 * area), rel=1e-4)
    assert moves.per_size == pytest.approx(z, rel=1e-4)
    bigger = range_from_area(area, 650.0, scaled(panel, 1.05), PAPER, LEVEL)
    assert bigger - z == pytest.approx(0.05 * z, rel=0.05)
    # One more pixel all round: the area grows by its outline.
    around = 4 * 1033 / z
    assert range_from_area(area + around, 650.0, panel, PAPER, LEVEL) - z == pytest.approx(
        moves.per_measured * around, rel=0.08
    )
    # A box of real depth: pitch shows a little more or less of its top.
    box = Build(1.0, 1.0, 1.0, 1.0)
    pitch = area_sensitivity(area, 650.0, box, PAPER, LEVEL).per_rad
    moved = range_from_area(area, 650.0, box, PAPER, pitched(LEVEL, np.radians(0.1)))
    still = range_from_area(area, 650.0, box, PAPER, LEVEL)
    assert moved - still == pytest.approx(pitch * np.radians(0.1), rel=0.05, abs=1e-4)


def test_an_area_that_no_distance_gives_is_unknown() -> None:
    build = BUILDS["person"]
    assert np.isnan(range_from_area(1e-3, 600.0, build, PAPER, LEVEL))
    assert np.isnan(range_from_area(1e12, 600.0, build, PAPER, LEVEL))
    moves = area_sensitivity(1e-3, 600.0, build, PAPER, LEVEL)
    assert np.isnan([moves.per_measured, moves.per_rad, moves.per_size]).all()


@pytest.mark.parametrize(
    ("area", "build", "words"),
    [
        (0.0, BUILDS["car"], "area_px must be > 0"),
        (float("nan"), BUILDS["car"], "area_px must be finite"),
        (100.0, Build(0.0, 1.0, 1.0, 1.0), "width_m must be > 0"),
        (100.0, Build(1.0, -1.0, 1.0, 1.0), "height_m must be > 0"),
        (100.0, Build(1.0, 1.0, 0.0, 1.0), "length_m must be > 0"),
        (100.0, Build(1.0, 1.0, 1.0, 1.2), "fill must be at most 1, but got 1.2"),
    ],
)
def test_impossible_areas_and_builds_are_refused(area: float, build: Build, words: str) -> None:
    with pytest.raises(ValueRefusedError, match=words):
        range_from_area(area, 600.0, build, PAPER, LEVEL)


@pytest.mark.parametrize(("area_px", "area_m2"), [(0.0, 1.0), (1.0, 0.0)])
def test_the_first_estimate_needs_areas(area_px: float, area_m2: float) -> None:
    with pytest.raises(ValueRefusedError, match="must be > 0"):
        first_range_from_area(area_px, area_m2, 100.0, 100.0)


# What is read from a mask


def block(v0, v1, u0, u1, size=(720, 1280)):
    mask = np.zeros(size, bool)
    mask[v0:v1, u0:u1] = True
    return mask


def test_the_contact_is_the_lower_border_of_the_lowest_part() -> None:
    assert contact_point(block(100, 300, 50, 90)) == (69.5, 299.5)
    two_feet = block(100, 280, 50, 90) | block(280, 300, 55, 62) | block(280, 296, 70, 78)
    assert contact_point(two_feet) == (58.0, 299.5)
    ragged = block(100, 300, 50, 90)
    ragged[300, 50:90:2] = True
    assert contact_point(ragged)[1] == pytest.approx(300.0)


def test_the_area_has_its_holes_filled() -> None:
    ring = block(10, 30, 40, 70) & ~block(15, 20, 45, 50)
    assert outline_area(ring) == (600.0, 2 * (19 + 29), 54.5)
    assert outline_area(block(3, 4, 5, 6))[:2] == (1.0, 4.0)


@pytest.mark.parametrize("measure", [contact_point, outline_area, lambda mask: guess_kind(mask, PAPER, LEVEL)])
def test_an_empty_mask_is_refused(measure) -> None:
    with pytest.raises(ValueRefusedError, match="at least one pixel"):
        measure(np.zeros((720, 1280), bool))


def standing(width_m, height_m, z, ground=LEVEL):
    end = round(PAPER.cy_px + 1033 * 1.4 / z + 0.5)
    half = round(1033 * width_m / z / 2)
    return block(end - round(1033 * height_m / z), end, 600 - half, 600 + half)


@pytest.mark.parametrize(
    ("width_m", "height_m", "expected"),
    [
        (0.5, 1.7, ("person", 0.0)),
        (1.7, 1.0, ("bicycle", np.pi / 2)),
        (0.6, 1.0, ("bicycle", 0.0)),
        (1.7, 1.4, ("car", 0.0)),
        (4.2, 1.5, ("car", np.pi / 2)),
        (1.0, 0.9, ("box", 0.0)),
        (1.0, 1.25, ("box", 0.0)),
        (4.1, 2.3, ("fork", 0.0)),
    ],
)
def test_the_type_is_that_of_the_nearest_size(width_m: float, height_m: float, expected: tuple[str, float]) -> None:
    for z in (6.0, 18.0):
        assert guess_kind(standing(width_m, height_m, z), PAPER, LEVEL) == expected


def test_above_the_horizon_only_the_ratio_speaks() -> None:
    for rows in (50, 100):
        mask = block(10, 10 + rows, 100, 100 + round(rows * 4.4 / 1.5))
        assert guess_kind(mask, PAPER, LEVEL) == ("car", np.pi / 2)


def test_a_known_type_is_kept() -> None:
    assert guess_kind(standing(0.5, 1.7, 8.0), PAPER, LEVEL, "car") == ("car", 0.0)
    assert guess_kind(standing(4.0, 1.3, 8.0), PAPER, LEVEL, "car") == ("car", np.pi / 2)
    with pytest.raises(ValueRefusedError, match="kind must be auto or one of person"):
        guess_kind(standing(0.5, 1.7, 8.0), PAPER, LEVEL, "horse")


def test_regions_tell_their_range_as_a_disparity() -> None:
    mask = standing(1.0, 1.0, 10.0)
    image = np.full((720, 1280, 3), (90, 20, 10), np.uint8)
    box = Build(1.0, 1.0, 1.0, 1.0)
    found = region_by_contact(mask, image, PAPER, LEVEL, SETTINGS)
    assert found is not None
    z = range_from_contact(*contact_point(mask), PAPER, LEVEL)
    assert z == pytest.approx(10.0, abs=0.05)
    d = found.surface_uvd_px[:, 2]
    assert np.ptp(d) == 0
    assert 1033 * 0.205 / d[0] == pytest.approx(z)
    assert len(d) == mask.sum()
    assert found.box_px == (548, 390, 652, 493)
    assert found.color_rgb.tolist() == [90, 20, 10]
    sigma_m = found.sigma_d_px * z**2 / (1033 * 0.205)
    pitch = np.radians(SETTINGS.pitch_sigma_deg)
    assert sigma_m == pytest.approx(
        np.linalg.norm([z * z / (1033 * 1.4), z * z / 1.4 * pitch, z * SETTINGS.height_sigma, 0.15]), rel=1e-6
    )
    by_area = region_by_area(mask, image, PAPER, LEVEL, SETTINGS, box)
    assert by_area is not None
    assert by_area.contour_px.tolist() == found.contour_px.tolist()


def test_colours_of_every_kind_of_image() -> None:
    mask = standing(1.0, 1.0, 10.0)
    deep = np.full((720, 1280, 3), (257 * 90, 257 * 20, 257 * 10), np.uint16)
    grey = np.full((720, 1280), 80, np.uint8)
    colors = [region_by_contact(mask, image, PAPER, LEVEL, SETTINGS).color_rgb for image in (deep, grey)]
    assert colors[0].tolist() == [90, 20, 10]
    assert np.isnan(colors[1]).all()


def test_what_is_out_of_reach_is_no_region() -> None:
    image = np.zeros((720, 1280), np.uint8)
    sky, far, tiny = block(10, 60, 30, 90), standing(0.5, 1.7, 60.0), block(500, 501, 30, 31)
    assert region_by_contact(sky, image, PAPER, LEVEL, SETTINGS) is None
    assert region_by_contact(far, image, PAPER, LEVEL, SETTINGS) is None
    assert region_by_area(tiny, image, PAPER, LEVEL, SETTINGS, BUILDS["car"]) is None


def test_a_type_that_varies_more_is_ranged_less_surely() -> None:
    image = np.zeros((720, 1280), np.uint8)
    mask = standing(1.0, 1.0, 10.0)
    sigmas = [
        region_by_area(mask, image, PAPER, LEVEL, SETTINGS, Build(1.0, 1.0, 1.0, 1.0, spread)).sigma_d_px
        for spread in (0.02, 0.2)
    ]
    assert sigmas[1] > 3 * sigmas[0]


# The horizon


def bundle(point, count, rng, ends_px=0.0):
    """Return segments that aim at a point from below."""
    angle = rng.uniform(0.3, np.pi - 0.3, count)
    near, long = rng.uniform(40, 250, count), rng.uniform(25, 120, count)
    way = np.stack([np.cos(angle), np.sin(angle)], -1)
    ends = np.concatenate([point + near[:, None] * way, point + (near + long)[:, None] * way], 1)
    return ends + rng.normal(0, ends_px, ends.shape) if ends_px else ends


def longest_first(segments):
    return segments[np.argsort(-np.hypot(*(segments[:, 2:] - segments[:, :2]).T))]


def test_segments_vote_for_where_the_road_ends() -> None:
    rng = np.random.default_rng(4)
    point = np.array([688.0, 310.0])
    stray = rng.uniform((0, 0, 0, 0), (1280, 720, 1280, 720), (40, 4))
    found = vanishing_point(longest_first(bundle(point, 20, rng)), PAPER, SETTINGS)
    assert found == pytest.approx(point, abs=0.01)
    noisy = longest_first(np.r_[bundle(point, 25, rng, 0.4), stray])
    assert vanishing_point(noisy, PAPER, SETTINGS) == pytest.approx(point, abs=4.0)


def test_too_few_segments_make_no_horizon() -> None:
    rng = np.random.default_rng(5)
    assert vanishing_point(np.zeros((0, 4)), PAPER, SETTINGS) is None
    two = np.array([[700.0, 400.0, 760.0, 520.0], [640.0, 400.0, 560.0, 520.0]])
    assert vanishing_point(longest_first(two), PAPER, SETTINGS) is None
    three = np.r_[two, [[670.0, 360.0, 670.0 + 1e-3, 460.0]], two + np.array([1.0, 0, 1, 0])]
    assert vanishing_point(longest_first(three), PAPER, SETTINGS) is not None
    assert vanishing_point(longest_first(bundle(np.array([688.0, 10.0]), 20, rng)), PAPER, SETTINGS) is None


def test_a_horizon_that_is_hardly_known_is_none() -> None:
    narrow = longest_first(np.array([[600.0 + s * 40, 500 + 4 * s, 640.0 + s * 20, 420 + 2 * s] for s in range(4)]))
    loose = MonoSettings(horizon_px=1000.0)
    assert vanishing_point(narrow, PAPER, loose) is not None
    assert vanishing_point(narrow, PAPER, MonoSettings(horizon_px=0.01)) is None


def test_a_blank_image_has_neither_segments_nor_road() -> None:
    blank = np.full((280, 400), 90, np.uint8)
    assert find_segments(blank, 20.0).shape == (0, 4)
    assert find_road(blank, CAMERA, SETTINGS) is None


def test_a_known_pitch_is_taken_as_it_is() -> None:
    blank = np.full((280, 400), 90, np.uint8)
    ground = find_road(blank, CAMERA, MonoSettings(pitch_deg=3.0, roll_deg=-2.0, height_m=1.1))
    assert ground is not None
    assert np.degrees([ground.pitch_rad, ground.roll_rad]) == pytest.approx([3.0, -2.0])
    assert ground.height_m == 1.1


# A drawn road


def draw(box=True, dtype=np.uint8, gray=False, shade=1.0):
    """Draw a road with lines, verges and a red panel 8 m ahead, by casting rays at a plane."""
    fine, ground = 4, plane(DRAWN_PITCH_DEG, DRAWN_ROLL_DEG, 1.3)
    width, height = CAMERA.size_px
    u, v = np.meshgrid((np.arange(width * fine) + 0.5) / fine - 0.5, (np.arange(height * fine) + 0.5) / fine - 0.5)
    rays = np.stack([(u - CAMERA.cx_px) / CAMERA.f_px, (v - CAMERA.cy_px) / CAMERA.f_px, np.ones_like(u)], -1)
    n = ground.normal
    h = ground.height_of(np.array([-CAMERA.baseline_m / 2, 0, 0]))
    with np.errstate(divide="ignore"):
        z = np.where(rays @ n < 0, -h / (rays @ n), np.inf)
    right = np.array([1.0, 0, 0]) - n[0] * n
    right /= np.linalg.norm(right)
    ahead = np.cross(n, right)
    seen = np.isfinite(z)
    points = rays * np.where(seen, z, 0.0)[..., None]
    x, y = points @ right, points @ ahead
    image = np.full((*u.shape, 3), (150, 180, 220), float)
    image[seen] = (70, 120, 50)
    image[seen & (np.abs(x) < 3.2)] = np.array([105, 105, 108]) * shade
    for line in (-3.0, -1.1, 1.2, 3.0):
        image[seen & (np.abs(x - line) < 0.07)] = 235
    if box:
        # A panel across the road: where the ray meets the plane `ahead = 8`, and how high over the road.
        far = 8.0 / (rays @ ahead)
        hit = rays * far[..., None]
        up = hit @ n + h
        image[(far > 0) & (np.abs(hit @ right - 0.3) < 0.5) & (up > 0) & (up < 0.9)] = (110, 10, 8)
    del y
    small = cv2.resize(image, CAMERA.size_px, interpolation=cv2.INTER_AREA)
    small += np.random.default_rng(7).normal(0, 1.0, small.shape)
    picture = np.clip(small, 0, 255)
    picture = picture.mean(-1) if gray else picture
    return (picture * (257 if dtype is np.uint16 else 1)).astype(dtype), ground


DRAWN = MonoSettings(height_m=1.3, roll_deg=DRAWN_ROLL_DEG)


@pytest.fixture(scope="module", params=["8 bit", "16 bit", "grey"])
def drawn(request):
    return draw(dtype=np.uint16 if request.param == "16 bit" else np.uint8, gray=request.param == "grey")


def test_the_drawn_road_is_found(drawn) -> None:
    image, truth = drawn
    ground = find_road(image, CAMERA, DRAWN)
    assert ground is not None
    assert ground.pitch_rad == pytest.approx(truth.pitch_rad, abs=1.0 / CAMERA.f_px)
    assert ground.roll_rad == pytest.approx(truth.roll_rad, abs=1e-9)
    assert ground.height_m == 1.3


def test_the_thing_on_the_drawn_road_is_cut_out(drawn) -> None:
    image, ground = drawn
    looks = look(image, CAMERA, ground, DRAWN)
    runs = find_runs(looks, CAMERA, DRAWN)
    masks = find_outlines(image, looks, runs, CAMERA, DRAWN)
    assert len(masks) == 1
    corners = [ground.point_below(0.3 - 0.15 + side * 0.5, 8.0) for side in (-1, 1)]
    u = [float(image_from_car(CAMERA, corner)[0]) for corner in corners]
    area = (410 / 8.0) ** 2 * 0.9
    assert masks[0].sum() == pytest.approx(area, rel=0.08)
    columns = np.flatnonzero(masks[0].any(0))
    assert columns[[0, -1]] == pytest.approx(u, abs=5.0)
    # The panel is 8 m along the road; the forward distance is along the axis, which looks down on it.
    along = 8.0 * np.cos(ground.pitch_rad)
    assert range_from_contact(*contact_point(masks[0]), CAMERA, ground) == pytest.approx(along, abs=0.25)


def test_free_space_ends_at_the_thing(drawn) -> None:
    image, ground = drawn
    looks = look(image, CAMERA, ground, DRAWN)
    free = find_free_space(looks, find_runs(looks, CAMERA, DRAWN), DRAWN)
    inside = (free.u_px > 200) & (free.u_px < 220)
    assert free.range_m[inside] == pytest.approx(7.9, abs=0.5)
    assert np.nanmax(free.range_m) <= DRAWN.reach_m


def test_the_edges_of_the_drawn_road() -> None:
    image, ground = draw()
    looks = look(image, CAMERA, ground, DRAWN)
    right, left = road_edges(looks, CAMERA)
    assert right == pytest.approx(3.0, abs=0.5)
    assert left == pytest.approx(-3.0, abs=0.5)


def test_a_second_road_beyond_the_verge_is_not_ours() -> None:
    range_m = road_range(np.stack(np.meshgrid(np.arange(400.0), np.arange(280.0)), -1), CAMERA, plane(4.0))
    aside_m = (np.arange(400) - CAMERA.cx_px) * range_m / CAMERA.f_px
    looks = Looks(range_m, (np.abs(aside_m) < 1.6) | (np.abs(aside_m) > 3.8))
    assert road_edges(looks, CAMERA) == pytest.approx((1.6, -1.6), abs=0.21)


@pytest.mark.parametrize("u", [2, 150])
def test_a_thing_too_thin_to_cut_out_keeps_its_column(u: int) -> None:
    image = np.full((280, 400, 3), 105, np.uint8)
    image[100:215, u] = (150, 10, 10)
    looks = Looks(np.full((280, 400), 45.0), np.zeros((280, 400), bool))
    runs = Runs(np.array([u]), np.array([100]), np.array([215]), np.array([45.0]))
    (mask,) = find_outlines(image, looks, runs, CAMERA, MonoSettings(tallest_m=60.0))
    rows, columns = np.nonzero(mask)
    assert abs(columns - u).max() <= 1
    assert rows.max() == pytest.approx(214, abs=2)


def test_a_part_of_a_thing_is_no_thing_of_its_own() -> None:
    """A hand of another colour, hanging beside a thing, seems to stand further away."""
    image, ground = draw()
    image = image.copy()
    image[122:150, 247:258] = (20, 20, 160)
    looks = look(image, CAMERA, ground, DRAWN)
    runs = find_runs(looks, CAMERA, DRAWN)
    assert (runs.u > 248).any()
    assert len(find_outlines(image, looks, runs, CAMERA, DRAWN)) == 1


def test_an_empty_road_has_nothing_on_it() -> None:
    image, ground = draw(box=False)
    looks = look(image, CAMERA, ground, DRAWN)
    runs = find_runs(looks, CAMERA, DRAWN)
    assert find_outlines(image, looks, runs, CAMERA, DRAWN) == ()


def test_unseen_road_is_not_free() -> None:
    image, ground = draw(box=False)
    image = image.copy()
    image[200:, 150:200] = (20, 160, 30)
    looks = look(image, CAMERA, ground, DRAWN)
    free = find_free_space(looks, find_runs(looks, CAMERA, DRAWN), DRAWN)
    assert np.isnan(free.range_m[155:195]).all()
    assert np.isfinite(free.range_m[220:260]).all()


def test_where_no_road_is_in_view_nothing_is() -> None:
    """A camera that looks up at the sky."""
    image = np.full((280, 400, 3), 90, np.uint8)
    looks = look(image, CAMERA, plane(-40.0), SETTINGS)
    assert not looks.is_road.any()
    assert road_edges(looks, CAMERA) == (0.0, 0.0)
    runs = find_runs(looks, CAMERA, SETTINGS)
    assert len(runs.u) == 0
    assert np.isnan(find_free_space(looks, runs, SETTINGS).range_m).all()


# Settings


def test_settings_know_their_types() -> None:
    assert make_settings({"mono": {"kind": "bicycle"}}).mono.kind == "bicycle"
    assert SETTINGS.kind == AUTO
    with pytest.raises(SettingsError, match=r"mono\.kind = 'horse': must be auto or one of person"):
        make_settings({"mono": {"kind": "horse"}})


def test_settings_refuse_what_rises_the_wrong_way() -> None:
    assert make_settings({"mono": {"road_lightness": [0.5, 1.2]}}).mono.road_lightness == (0.5, 1.2)
    with pytest.raises(SettingsError, match="the first must be below the second"):
        make_settings({"mono": {"road_lightness": [1.2, 0.6]}})


@pytest.mark.parametrize(("brightest", "factor"), [(1023, 64), (1024, 32), (4095, 16), (32768, 1), (65535, 1)])
def test_empty_high_bits_of_16_bit_images_are_filled(brightest: int, factor: int) -> None:
    image = np.array([[0, 1], [brightest // 3, brightest]], np.uint16)
    assert full_scale(image).dtype == np.uint16
    np.testing.assert_array_equal(full_scale(image), image.astype(int) * factor)


def test_black_and_8_bit_images_stay_as_they_are() -> None:
    assert not full_scale(np.zeros((2, 3), np.uint16)).any()
    eight = np.array([[3, 90]], np.uint8)
    assert full_scale(eight) is eight
