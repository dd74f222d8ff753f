"""Equations 1, 2, 4 and 5 and the three lenses: hand formulas, round trips, folds and Jacobians."""

import time

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from roadblock.errors import ValueRefusedError
from roadblock.geometry.projection import (
    camera_from_sensor,
    fold_radius,
    parameter_jacobian,
    project,
    project_jacobian,
    unproject,
)
from roadblock.values.camera import Camera

SIZE = (97, 61)
steady = settings(max_examples=80, deadline=None, derandomize=True)

SAMPLES = [
    Camera(SIZE, 71.0, 64.0, 43.3, 33.9),
    Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [-0.31, 0.11, 2e-3, -3e-3, -0.01]),
    Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [0.9, 0.4, -2e-3, 1e-3, 0.05, 1.2, 0.5, 0.06]),
    Camera(SIZE, 31.0, 27.0, 43.3, 33.9, "kannala_brandt", [0.06, -0.03, 0.01, -0.002]),
]
LENSES = pytest.mark.parametrize("camera", SAMPLES, ids=["pinhole", "brown5", "brown8", "kannala_brandt"])


def grid(camera: Camera) -> np.ndarray:
    """Every pixel centre and the outer corners of the image."""
    width, height = camera.size_px
    u, v = np.meshgrid(np.r_[-0.5, np.arange(width), width - 0.5], np.r_[-0.5, np.arange(height), height - 0.5])
    return np.stack([u, v], -1)


def corner_radius(size: tuple[int, int], fx: float, fy: float, cx: float, cy: float) -> float:
    return max(np.hypot((u - cx) / fx, (v - cy) / fy) for u in (-0.5, size[0]) for v in (-0.5, size[1]))


@st.composite
def sane_cameras(draw: st.DrawFn) -> Camera:
    """Crooked cameras with strong lenses whose radial curve climbs by at least 0.15 over the whole image."""
    lens = draw(st.sampled_from(["pinhole", "brown5", "brown8", "kannala_brandt"]))
    fx = draw(st.floats(35, 130))
    fy = fx * draw(st.floats(0.8, 0.97))
    cx, cy = 48 + draw(st.floats(-9, 9)), 30 + draw(st.floats(-7, 7))
    K = (SIZE, fx, fy, cx, cy)
    if lens == "pinhole":
        return Camera(*K)
    reach = 1.5 * corner_radius(*K)
    k = np.array(draw(st.lists(st.floats(-0.6, 0.6), min_size=6, max_size=6)))
    p = np.array(draw(st.lists(st.floats(-0.015, 0.015), min_size=2, max_size=2))) / reach
    powers = reach ** (2.0 * np.arange(1, 5))
    rho = np.linspace(0, 1, 400)[1:]
    for shrink in (1, 0.5, 0.25, 0.12, 0.06, 0):
        c = shrink * k
        up = 1 + c[0] * rho**2 + c[1] * rho**4 + c[2] * rho**6
        if lens == "kannala_brandt":
            up = up + c[3] * rho**8
        down = 1 + c[3] * rho**2 + c[4] * rho**4 + c[5] * rho**6 if lens == "brown8" else np.ones_like(rho)
        curve = rho * up / down
        if (down > 0.1).all() and (np.gradient(curve, rho) > 0.15).all() and curve[-1] > 0.75:
            break
    if lens == "kannala_brandt":
        assume(reach < 3.1)
        return Camera(*K, "kannala_brandt", c[:4] / powers)
    head = [c[0] / powers[0], c[1] / powers[1], *p, c[2] / powers[2]]
    return Camera(*K, "brown_conrady", head if lens == "brown5" else [*head, *(c[3:] / powers[:3])])


@st.composite
def wild_cameras(draw: st.DrawFn) -> Camera:
    """Cameras whose coefficients come from a broken calibration: folds, poles and tilts anywhere."""
    lens, count = draw(st.sampled_from([("brown_conrady", 5), ("brown_conrady", 8), ("kannala_brandt", 4)]))
    k = draw(st.lists(st.floats(-2, 2) | st.floats(-300, 300), min_size=count, max_size=count))
    return Camera(SIZE, 83.0, 59.0, 41.7, 34.2, lens, k)


# --- equations 1, 2, 4, 5 by hand ------------------------------------------------------------------------------------


def test_equations_1_and_2_turn_metres_on_the_sensor_into_pixels() -> None:
    camera = camera_from_sensor(SIZE, 3.1e-3, (3.0e-6, 3.5e-6), (43.25, 33.5))
    x, y = 41e-6, -27e-6  # a spot on the sensor, metres
    q, p = x / 3.0e-6 + 43.25, y / 3.5e-6 + 33.5  # eq. 1
    by_matrix = np.array([[1 / 3.0e-6, 0, 43.25], [0, 1 / 3.5e-6, 33.5], [0, 0, 1]]) @ [x, y, 1]  # eq. 2
    X, Y, Z = x * 7.0 / 3.1e-3, y * 7.0 / 3.1e-3, 7.0  # eq. 4: f / Z = x / X = y / Y
    np.testing.assert_allclose(project(camera, [X, Y, Z]), [q, p], rtol=0, atol=1e-11)
    np.testing.assert_allclose(project(camera, [X, Y, Z]), by_matrix[:2], rtol=0, atol=1e-11)


def test_equation_5_times_equation_2_is_the_camera_matrix() -> None:
    f, dx, dy, q0, p0 = 3.1e-3, 3.0e-6, 3.5e-6, 43.25, 33.5
    eq_2 = np.array([[1 / dx, 0, q0], [0, 1 / dy, p0], [0, 0, 1]])
    eq_5 = np.array([[f, 0, 0, 0], [0, f, 0, 0], [0, 0, 1, 0]])
    camera = camera_from_sensor(SIZE, f, (dx, dy), (q0, p0))
    np.testing.assert_allclose(camera.K, (eq_2 @ eq_5)[:, :3], rtol=1e-14)
    point = np.array([-0.7, 1.1, 5.3])
    homogeneous = eq_2 @ eq_5 @ [*point, 1]
    np.testing.assert_allclose(project(camera, point), homogeneous[:2] / homogeneous[2], rtol=0, atol=1e-11)


def test_the_paper_s_camera_has_1033_px() -> None:
    camera = camera_from_sensor((1280, 720), 3.1e-3, (3e-6, 3e-6), (639.5, 359.5))
    assert camera.fx_px == pytest.approx(1033.3333333, abs=1e-6)
    assert camera.fx_px == camera.fy_px


@pytest.mark.parametrize(("focal", "pitch"), [(0, (3e-6, 3e-6)), (3e-3, (0, 3e-6)), (3e-3, (3e-6, -1))])
def test_lengths_of_a_sensor_are_positive(focal: float, pitch: tuple[float, float]) -> None:
    with pytest.raises(ValueRefusedError, match="must be > 0"):
        camera_from_sensor(SIZE, focal, pitch, (43.0, 30.0))


def test_brown_conrady_by_hand() -> None:
    k1, k2, p1, p2, k3, k4, k5, k6 = k = (0.9, 0.4, -2e-3, 1e-3, 0.05, 1.2, 0.5, 0.06)
    x, y = 0.31, -0.22
    r2 = x * x + y * y
    radial = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
    u = 71 * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + 43.3
    v = 64 * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + 33.9
    camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", k)
    np.testing.assert_allclose(project(camera, [3 * x, 3 * y, 3]), [u, v], rtol=0, atol=1e-12)


@pytest.mark.parametrize("angle_deg", [10, 89.9, 90, 100, 130])
def test_kannala_brandt_by_hand_also_behind_the_image_plane(angle_deg: float) -> None:
    k = (0.06, -0.03, 0.01, -0.0009)
    camera = Camera(SIZE, 31.0, 27.0, 43.3, 33.9, "kannala_brandt", k)
    theta, phi = np.deg2rad(angle_deg), 0.7
    bent = theta * (1 + k[0] * theta**2 + k[1] * theta**4 + k[2] * theta**6 + k[3] * theta**8)
    point = 2.5 * np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
    expected = [31 * bent * np.cos(phi) + 43.3, 27 * bent * np.sin(phi) + 33.9]
    if theta >= fold_radius(camera):
        expected = [np.nan, np.nan]
    np.testing.assert_allclose(project(camera, point), expected, rtol=0, atol=1e-11)


def test_kannala_brandt_sees_beyond_90_degrees_and_back() -> None:
    camera = Camera(SIZE, 17.0, 15.0, 43.3, 33.9, "kannala_brandt", [0.01, -0.002, 0.0003, -1e-5])
    theta, phi = np.meshgrid(np.deg2rad([0, 45, 90, 120, 170]), np.linspace(0, 6, 7))
    rays = np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], -1)
    np.testing.assert_allclose(unproject(camera, project(camera, rays)), rays, rtol=0, atol=1e-12)


# --- round trips -----------------------------------------------------------------------------------------------------


@steady
@given(sane_cameras())
def test_pixel_to_ray_to_pixel_is_exact(camera: Camera) -> None:
    pixels = grid(camera)[::4, ::4]
    rays = unproject(camera, pixels)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=-1), 1, rtol=0, atol=1e-15)
    np.testing.assert_allclose(project(camera, rays), pixels, rtol=0, atol=1e-9)


@steady
@given(sane_cameras(), st.integers(0, 2**32 - 1))
def test_point_to_pixel_to_ray_is_exact(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    rays = unproject(camera, rng.uniform((-0.5, -0.5), (96.5, 60.5), (40, 2)))
    points = rays * rng.uniform(0.1, 90, (40, 1))
    pixels = project(camera, points)
    np.testing.assert_allclose(unproject(camera, pixels) * camera.fx_px, rays * camera.fx_px, rtol=0, atol=1e-9)
    np.testing.assert_allclose(project(camera, 3.7 * points), pixels, rtol=0, atol=1e-9)


@steady
@given(wild_cameras(), st.integers(0, 2**32 - 1))
def test_wild_coefficients_give_the_right_ray_or_nan(camera: Camera, seed: int) -> None:
    rng = np.random.default_rng(seed)
    scale = min(fold_radius(camera), 3.0)
    aside = rng.uniform(0, 1.3 * scale, 200)[:, None] * rng.normal(size=(200, 2))
    points = np.c_[aside, np.ones(200)] * rng.uniform(0.1, 50, (200, 1))
    pixels = project(camera, points)
    rays, truth = unproject(camera, pixels), points / np.linalg.norm(points, axis=-1, keepdims=True)
    # Where the curve is nearly flat, the pixel's own rounding moves the ray: compare in the image, and there
    # allow for the slope (J is symmetric, so its smallest singular value is the flattest direction).
    again = project(camera, rays)
    ok = np.isfinite(again).all(-1)
    np.testing.assert_allclose(again[ok], pixels[ok], rtol=1e-12, atol=1e-9)
    seen = np.isfinite(rays).all(-1) & np.isfinite(pixels).all(-1)
    slope = np.linalg.svd(project_jacobian(camera, truth[seen]), compute_uv=False)[:, 1]
    wrong = np.linalg.norm(rays - truth, axis=-1)[seen] > 1e-6 + 1e-8 * (1 + np.abs(pixels[seen]).max(-1)) / slope
    assert not wrong.any(), points[seen][wrong]


@steady
@given(wild_cameras())
def test_wild_coefficients_give_a_consistent_pixel_or_nan(camera: Camera) -> None:
    pixels = grid(camera)[::5, ::5]
    again = project(camera, unproject(camera, pixels))
    ok = np.isfinite(again).all(-1)
    np.testing.assert_allclose(again[ok], pixels[ok], rtol=0, atol=1e-9)


def test_a_tilted_lens_never_answers_with_another_point() -> None:
    # Tangential terms alone fold the plane: 1 - 6 |p| r is the flattest slope.
    camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [0, 0, 0.3, -0.4, 0])
    assert fold_radius(camera) == pytest.approx(1 / (6 * 0.5), rel=1e-9)
    xy = np.random.default_rng(3).uniform(-2, 2, (4000, 2))
    points = np.c_[xy, np.ones(len(xy))]
    pixels = project(camera, points)
    seen = np.isfinite(pixels).all(-1)
    assert 0 < seen.sum() < len(xy)
    assert np.isnan(pixels[np.hypot(*xy.T) > 0.334]).all()
    rays = unproject(camera, pixels[seen])
    truth = points[seen] / np.linalg.norm(points[seen], axis=-1, keepdims=True)
    np.testing.assert_allclose(rays, truth, rtol=0, atol=1e-9)


def flattest_slope(camera: Camera, radius: float) -> float:
    """The smallest eigenvalue of the lens's own Jacobian on a circle of its plane."""
    angle = np.linspace(0, 2 * np.pi, 721)
    points = np.c_[radius * np.cos(angle), radius * np.sin(angle), np.ones(721)]
    J = project_jacobian(camera, points)[:, :, :2] / [[camera.fx_px], [camera.fy_px]]
    return float(np.linalg.eigvalsh(J).min())


def test_a_tilted_lens_may_first_fold_in_a_slanting_direction() -> None:
    # A curve that creeps along g' = 6 |p| r: both g' and g / r stay positive, yet a direction between them folds.
    k1, k2, k3, k4, k5, k6 = 69.0, 300.0, 79.0, 17.0, 20.0, 0.4
    r = np.linspace(1e-3, 1, 4000)
    num, den = 1 + k1 * r**2 + k2 * r**4 + k3 * r**6, 1 + k4 * r**2 + k5 * r**4 + k6 * r**6
    p = 0.9999 * (np.gradient(r * num / den, r) / (6 * r))[1:-1].min()
    camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [k1, k2, 0.6 * p, 0.8 * p, k3, k4, k5, k6])
    fold = fold_radius(camera)
    assert all(flattest_slope(camera, radius) > 0 for radius in fold * np.linspace(0.01, 0.999, 100))
    assert fold < 0.99


def test_beyond_the_fold_is_nan() -> None:
    # r - 0.25 r^3 stops growing at r = sqrt(1 / 0.75); without the guard a point at r = 2 lands on the centre.
    camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [-0.25, 0, 0, 0, 0])
    edge = np.sqrt(1 / 0.75)
    assert fold_radius(camera) == pytest.approx(edge, rel=1e-12)
    assert np.isfinite(project(camera, [0.999 * edge, 0, 1])).all()
    assert np.isnan(project(camera, [[1.001 * edge, 0, 1], [2, 0, 1], [0, 1.5, 1]])).all()
    top = 71 * edge * (1 - 0.25 * edge**2) + 43.3
    assert np.isfinite(unproject(camera, [top - 1e-3, 33.9])).all()
    assert np.isnan(unproject(camera, [top + 1e-3, 33.9])).all()


def test_kannala_brandt_folds_too_and_ends_at_180_degrees() -> None:
    folded = Camera(SIZE, 31.0, 27.0, 43.3, 33.9, "kannala_brandt", [-0.1, 0, 0, 0])
    assert fold_radius(folded) == pytest.approx(np.sqrt(1 / 0.3), rel=1e-12)
    plain = Camera(SIZE, 31.0, 27.0, 43.3, 33.9, "kannala_brandt", [0, 0, 0, 0])
    assert fold_radius(plain) == np.pi
    assert np.isnan(unproject(plain, [43.3 + 31 * 3.2, 33.9])).all()


def test_a_pole_of_the_rational_lens_is_a_fold() -> None:
    camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [0, 0, 0, 0, 0, -0.5, 0, 0])
    assert fold_radius(camera) == pytest.approx(np.sqrt(2), rel=1e-9)
    assert np.isnan(project(camera, [1.5, 0, 1])).all()


@pytest.mark.parametrize("tiny", [-1e-9, -1e-100, -4e-311])
def test_a_fold_far_outside_the_image_changes_nothing_in_it(tiny: float) -> None:
    k = [-0.01, 0, 0, 0, 0.0016, 0, 0, 0]
    plain = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", k)
    far = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, "brown_conrady", [*k[:7], tiny])
    np.testing.assert_allclose(unproject(far, grid(far)), unproject(plain, grid(plain)), rtol=0, atol=1e-7)


@pytest.mark.parametrize("lens", ["brown_conrady", "kannala_brandt"])
@pytest.mark.parametrize("huge", [1e12, 1e30, -1e30])
def test_the_largest_coefficients_do_not_break_the_lens(lens: str, huge: float) -> None:
    for count in (5, 8) if lens == "brown_conrady" else (4,):
        for where in range(count):
            camera = Camera(SIZE, 71.0, 64.0, 43.3, 33.9, lens, huge * np.eye(count)[where])
            assert fold_radius(camera) > 0
            again = project(camera, unproject(camera, grid(camera)[::9, ::9]))
            assert (np.isnan(again) | (np.abs(again - grid(camera)[::9, ::9]) < 1e-9)).all()
        assert fold_radius(Camera(SIZE, 71.0, 64.0, 43.3, 33.9, lens, np.full(count, huge))) > 0


def test_a_pinhole_never_folds() -> None:
    assert fold_radius(SAMPLES[0]) == np.inf


# --- unknown and impossible ------------------------------------------------------------------------------------------


@LENSES
def test_behind_the_camera_is_nan(camera: Camera) -> None:
    behind = [[0, 0, -1], [0, 0, 0], [0.0, 0.0, -1e-300]]
    if camera.lens != "kannala_brandt":
        behind += [[1, 2, -3], [1, 0, 0]]
    assert np.isnan(project(camera, behind)).all()
    assert np.isnan(project_jacobian(camera, behind)).all()


@LENSES
def test_one_unknown_coordinate_makes_the_pixel_unknown(camera: Camera) -> None:
    points = np.full((3, 3), 2.0) + np.diag([np.nan] * 3)
    assert np.isnan(project(camera, points)).all()
    assert np.isnan(project_jacobian(camera, points)).all()
    assert np.isnan(unproject(camera, [[np.nan, 3], [3, np.nan]])).all()


@LENSES
def test_extreme_numbers_neither_warn_nor_lie(camera: Camera) -> None:
    extremes = [0.0, -0.0, 5e-324, 1e-200, 1.0, 1e200, 1.7e308, np.inf, -np.inf, np.nan]
    points = np.stack(np.meshgrid(extremes, extremes, extremes), -1)
    pixels, slopes = project(camera, points), project_jacobian(camera, points)
    assert pixels.shape == (10, 10, 10, 2)
    assert slopes.shape == (10, 10, 10, 2, 3)
    assert np.isnan(pixels[~np.isfinite(points[..., :2]).all(-1)]).all()
    rays = unproject(camera, np.stack(np.meshgrid(extremes, extremes), -1))
    length = np.linalg.norm(rays, axis=-1)
    assert (np.isnan(length) | (np.abs(length - 1) < 1e-14)).all()
    assert np.isnan(rays[7:, 4]).all()


def test_one_extreme_pixel_does_not_disturb_the_others() -> None:
    pixels = grid(SAMPLES[2])[::6, ::6].reshape(-1, 2)
    alone = unproject(SAMPLES[2], pixels)
    together = unproject(SAMPLES[2], np.r_[pixels, [[1e250, 3.0], [np.inf, 0], [np.nan, 1]]])
    assert np.isfinite(alone).all()
    np.testing.assert_allclose(together[:-3], alone, rtol=0, atol=1e-13)


@LENSES
def test_empty_and_single_inputs_keep_their_shape(camera: Camera) -> None:
    assert project(camera, np.zeros((0, 3))).shape == (0, 2)
    assert unproject(camera, np.zeros((4, 0, 2))).shape == (4, 0, 3)
    assert project_jacobian(camera, np.zeros((0, 3))).shape == (0, 2, 3)
    assert project(camera, [0.1, 0.1, 1]).shape == (2,)
    assert unproject(camera, [40, 30]).shape == (3,)
    assert project_jacobian(camera, [0.1, 0.1, 1]).shape == (2, 3)


@LENSES
def test_inputs_stay_as_they_are(camera: Camera) -> None:
    points, pixels = np.array([[0.3, -0.2, 2.0]]), np.array([[11.0, 50.0]])
    project(camera, points), project_jacobian(camera, points), unproject(camera, pixels)
    np.testing.assert_array_equal(points, [[0.3, -0.2, 2.0]])
    np.testing.assert_array_equal(pixels, [[11.0, 50.0]])


# --- Jacobians -------------------------------------------------------------------------------------------------------


def central(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Fourth-order central differences of `project`, (2, 3)."""
    step = 1e-3 * np.linalg.norm(point)
    columns = []
    for axis in np.eye(3) * step:
        near, far = (project(camera, point + k * axis) - project(camera, point - k * axis) for k in (1, 2))
        columns.append((8 * near - far) / (12 * step))
    return np.stack(columns, -1)


@steady
@given(sane_cameras(), st.floats(0, 96), st.floats(0, 60), st.floats(0.3, 40))
def test_project_jacobian_against_finite_differences(camera: Camera, u: float, v: float, far: float) -> None:
    point = unproject(camera, [u, v]) * far
    J = project_jacobian(camera, point)
    np.testing.assert_allclose(J, central(camera, point), rtol=1e-6, atol=1e-6 * np.abs(J).max())


@LENSES
@pytest.mark.parametrize("offset", [0, 1e-15, 1e-9, 3e-9, 1e-6, 1e-3])
def test_project_jacobian_on_and_near_the_axis(camera: Camera, offset: float) -> None:
    point = np.array([0.6, -0.8, 0]) * offset + [0, 0, 2.5]
    J = project_jacobian(camera, point)
    np.testing.assert_allclose(J, central(camera, point), rtol=0, atol=1e-6 * np.abs(J).max())
    if offset == 0:
        np.testing.assert_allclose(J, [[camera.fx_px / 2.5, 0, 0], [0, camera.fy_px / 2.5, 0]], rtol=0, atol=1e-12)


def with_parameters(camera: Camera, values: np.ndarray) -> Camera:
    return Camera(camera.size_px, *values[:4], camera.lens, values[4:])


def central_parameters(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Fourth-order central differences of `project` by the camera's parameters, (2, 4 + k)."""
    values = np.r_[camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, camera.distortion]
    columns = []
    for i in range(len(values)):
        axis = np.eye(len(values))[i] * (0.5 if i < 4 else 1e-4 * max(1.0, abs(values[i])))
        near, far = (
            project(with_parameters(camera, values + k * axis), point)
            - project(with_parameters(camera, values - k * axis), point)
            for k in (1, 2)
        )
        columns.append((8 * near - far) / (12 * axis[i]))
    return np.stack(columns, -1)


@LENSES
@pytest.mark.parametrize("point", [[0.7, -0.4, 2.0], [-0.9, 0.6, 2.5], [0.2, 0.5, 1.7], [0.0, 0.0, 3.0]])
def test_parameter_jacobian_against_finite_differences(camera: Camera, point: list[float]) -> None:
    J = parameter_jacobian(camera, point)
    assert J.shape == (2, len(camera.parameters))
    np.testing.assert_allclose(J, central_parameters(camera, np.array(point)), rtol=1e-7, atol=1e-8)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(sane_cameras(), st.floats(5, 91), st.floats(5, 55), st.floats(0.3, 40))
def test_parameter_jacobian_of_any_sane_camera(camera: Camera, u: float, v: float, far: float) -> None:
    point = unproject(camera, [u, v]) * far
    # A step may carry the fold over the point: there is nothing to compare with.
    expected = central_parameters(camera, point)
    assume(np.isfinite(expected).all())
    J = parameter_jacobian(camera, point)
    np.testing.assert_allclose(J, expected, rtol=1e-6, atol=1e-6 * np.abs(J).max())


@LENSES
def test_parameter_jacobian_is_unknown_where_the_pixel_is(camera: Camera) -> None:
    points = np.array([[[0.1, 0.2, 1.0], [0.0, 0.0, -1.0]], [[np.nan, 0.0, 2.0], [0.1, 0.2, 1.0]]])
    J = parameter_jacobian(camera, points)
    assert J.shape == (2, 2, 2, len(camera.parameters))
    assert np.isnan(J[0, 1]).all()
    assert np.isnan(J[1, 0]).all()
    np.testing.assert_array_equal(J[0, 0], J[1, 1])
    np.testing.assert_array_equal(J[0, 0], parameter_jacobian(camera, [0.1, 0.2, 1.0]))
    assert parameter_jacobian(camera, np.zeros((0, 3))).shape == (0, 2, len(camera.parameters))


# --- speed -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("lens", "k"),
    [("brown_conrady", [-0.379, 0.206, 7e-4, 1.8e-3, -0.0725]), ("kannala_brandt", [0.02, -0.01, 3e-3, -4e-4])],
)
def test_a_whole_image_is_unprojected_in_reasonable_time(lens: str, k: list[float]) -> None:
    camera = Camera((1392, 512), 959.8, 956.9, 696.0, 224.2, lens, k)
    pixels = np.stack(np.meshgrid(np.arange(1392.0), np.arange(512.0)), -1)
    start = time.process_time()
    rays = unproject(camera, pixels)
    assert time.process_time() - start < 4  # 0.4 s on an idle core
    np.testing.assert_allclose(project(camera, rays), pixels, rtol=0, atol=1e-9)
