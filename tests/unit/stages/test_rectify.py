"""Rectification on crooked rigs, against points projected by OpenCV."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from roadblock.errors import RigError, SettingsError, SourceError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.kernels.gray import gray8
from roadblock.stages.rectify import RectifySettings, plan_rectification, rectify
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.frame import StereoPair

SIZE = (97, 61)
BROWN = ([-0.31, 0.11, 2e-3, -3e-3, -0.01], [-0.2, 0.1, 1e-3, 2e-3, -0.02, 0.1, 0.05, -0.01])
FISHEYE = ([0.06, -0.03, 0.01, -0.002], [-0.02, 0.004, -0.003, 0.0005])
T = pose(rotation_from_rotvec([0.03, -0.05, 0.02]), [0.2, 0.011, -0.013])


def brown_rig() -> StereoRig:
    left = Camera(SIZE, 91.0, 84.0, 43.3, 33.9, "brown_conrady", BROWN[0])
    right = Camera(SIZE, 89.0, 93.0, 52.1, 27.4, "brown_conrady", BROWN[1])
    return StereoRig(left, right, T)


def fisheye_rig() -> StereoRig:
    left = Camera(SIZE, 31.0, 29.0, 47.3, 31.9, "kannala_brandt", FISHEYE[0])
    right = Camera(SIZE, 30.0, 32.0, 50.1, 28.4, "kannala_brandt", FISHEYE[1])
    return StereoRig(left, right, T)


def rectified_rig() -> StereoRig:
    twin = Camera(SIZE, 83.0, 83.0, 41.7, 34.2)
    return StereoRig(twin, twin, pose(np.eye(3), [0.2, 0, 0]))


def seen_by_opencv(camera: Camera, points: np.ndarray) -> np.ndarray:
    still = np.zeros(3)
    if camera.lens == "kannala_brandt":
        return cv2.fisheye.projectPoints(points[:, None], still, still, camera.K, np.array(camera.distortion))[0][:, 0]
    return cv2.projectPoints(points, still, still, camera.K, np.array(camera.distortion))[0][:, 0]


def pictures(dtype: type = np.uint8, channels: tuple[int, ...] = (), size: tuple[int, int] = SIZE) -> StereoPair:
    rng = np.random.default_rng(5)
    left, right = (rng.integers(0, np.iinfo(dtype).max, (*size[::-1], *channels)).astype(dtype) for _ in range(2))
    return StereoPair(left, right, 7, "seven", 123)


@pytest.mark.parametrize("rig", [brown_rig(), fisheye_rig()], ids=["brown_conrady", "kannala_brandt"])
def test_a_point_lands_on_one_row_of_both_and_its_disparity_is_its_range(rig: StereoRig) -> None:
    r = plan_rectification(rig)
    width, height = r.size_px
    rng = np.random.default_rng(1)
    v, d = rng.integers(2, height - 2, 200), rng.integers(1, 9, 200)
    u = rng.integers(12, width - 2, 200)
    z = r.f_px * rig.baseline_m / d
    in_rect = np.stack([(u - r.cx_px) / r.f_px * z, (v - r.cy_px) / r.f_px * z, z], -1)
    in_left = in_rect @ r.R_rect_left
    in_right = (in_rect - (rig.baseline_m, 0, 0)) @ r.R_rect_right
    np.testing.assert_allclose(in_right @ T[:3, :3].T + T[:3, 3], in_left, atol=1e-9)  # one and the same point
    assert r.maps_left is not None
    assert r.maps_right is not None
    for camera, maps, points, column in (
        (rig.left, r.maps_left, in_left, u),
        (rig.right, r.maps_right, in_right, u - d),
    ):
        here = np.stack([maps[0][v, column], maps[1][v, column]], -1)
        known = here[:, 0] > -1e3
        assert known.mean() > 0.9
        np.testing.assert_allclose(here[known], seen_by_opencv(camera, points)[known], atol=2e-4)


def test_the_maps_of_a_plain_lens_stay_inside_both_images_and_fill_them() -> None:
    r = plan_rectification(brown_rig())
    assert r.size_px[0] == SIZE[0]
    borders = []
    for maps in (r.maps_left, r.maps_right):
        assert maps is not None
        for m, side in zip(maps, SIZE, strict=True):
            assert m.min() > -0.05
            assert m.max() < side - 1 + 0.05
            borders += [m.min(), side - 1 - m.max()]
    assert sum(gap < 1 for gap in borders) >= 4  # no wider, no taller window would do


def test_a_fisheye_is_cut_to_the_widest_view() -> None:
    for view_deg in (60.0, 90.0, 110.0):
        r = plan_rectification(fisheye_rig(), RectifySettings(view_deg=view_deg))
        slopes = np.array([0 - r.cx_px, r.size_px[0] - 1 - r.cx_px]) / r.f_px
        seen_deg = np.degrees(np.arctan(slopes))
        np.testing.assert_allclose(seen_deg, [-view_deg / 2, view_deg / 2], atol=1.5)


def test_a_rectified_rig_keeps_its_images_as_they_are() -> None:
    rig = rectified_rig()
    r = plan_rectification(rig)
    assert (r.f_px, r.cx_px, r.cy_px, r.size_px) == (83.0, 41.7, 34.2, SIZE)
    assert (r.baseline_m, r.maps_left, r.maps_right) == (0.2, None, None)
    pair = pictures()
    out = rectify(pair, r, SIZE)
    assert out.left is not None
    assert np.shares_memory(out.left, pair.left)
    assert np.shares_memory(out.right, pair.right)
    np.testing.assert_array_equal(out.left, pair.left)
    assert out.half is None
    assert (out.index, out.name, out.t_ns) == (7, "seven", 123)
    assert out.rectification is r


def test_a_rectified_rig_obeys_a_focal_length_and_a_size() -> None:
    r = plan_rectification(rectified_rig(), RectifySettings(f_px=41.5))
    assert r.f_px == 41.5
    assert r.size_px == (48, 30)
    # Pixel (10, 10) of the new image shows the ray that the old one has at twice the distance from its centre.
    assert r.maps_left is not None
    assert r.maps_left[0][10, 10] == pytest.approx(41.7 + 2 * (10 - r.cx_px), abs=1e-4)
    assert r.maps_left[1][10, 10] == pytest.approx(34.2 + 2 * (10 - r.cy_px), abs=1e-4)
    assert plan_rectification(rectified_rig(), RectifySettings(size_px=(40, 20))).size_px == (40, 20)


@pytest.mark.parametrize(
    "settings",
    [RectifySettings(f_px=150.0), RectifySettings(size_px=(64, 64)), RectifySettings(f_px=60.0, size_px=(33, 20))],
)
def test_focal_length_and_size_are_obeyed_about_the_same_middle(settings: RectifySettings) -> None:
    chosen, asked = plan_rectification(brown_rig()), plan_rectification(brown_rig(), settings)
    if settings.f_px:
        assert asked.f_px == settings.f_px
    if settings.size_px:
        assert asked.size_px == settings.size_px
    assert middle_ray(asked) == pytest.approx(middle_ray(chosen), abs=1e-12)
    assert asked.baseline_m == chosen.baseline_m


def middle_ray(r: Rectification) -> list[float]:
    width, height = r.size_px
    return [((width - 1) / 2 - r.cx_px) / r.f_px, ((height - 1) / 2 - r.cy_px) / r.f_px]


def test_a_given_size_alone_is_filled_across() -> None:
    chosen = plan_rectification(brown_rig())
    half = plan_rectification(brown_rig(), RectifySettings(size_px=(SIZE[0] // 2, 30)))
    assert half.size_px[0] / half.f_px == pytest.approx(chosen.size_px[0] / chosen.f_px, rel=1e-12)


def test_cameras_without_a_common_view_are_refused() -> None:
    narrow = Camera(SIZE, 300.0, 310.0, 43.3, 33.9)
    for turn in ([0.0, 0.7, 0.0], [0.6, 0.0, 0.0]):
        with pytest.raises(RigError, match="share no view"):
            plan_rectification(StereoRig(narrow, narrow, pose(rotation_from_rotvec(turn), [0.2, 0, 0])))


@pytest.mark.parametrize(
    "settings",
    [
        RectifySettings(f_px=9e5),
        RectifySettings(f_px=1e-3),
        RectifySettings(size_px=(40_000, 9)),
        RectifySettings(size_px=(20_000, 2_000)),
    ],
)
def test_sizes_that_cannot_be_are_refused(settings: RectifySettings) -> None:
    with pytest.raises(SettingsError, match=r"rectified images would be \d+x\d+, .*rectify.f_px"):
        plan_rectification(brown_rig(), settings)


@pytest.mark.parametrize("bad", [{"f_px": 0}, {"view_deg": 175}, {"size_px": (0, 3)}, {"f_px": float("inf")}])
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        RectifySettings.model_validate(bad)


def test_images_of_another_size_are_refused() -> None:
    r = plan_rectification(brown_rig())
    with pytest.raises(SourceError, match="frame seven: images are 61x97, but the rig is for 97x61"):
        rectify(pictures(size=(61, 97)), r, SIZE)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_colour_and_depth_of_the_pixels_stay(dtype: type) -> None:
    r = plan_rectification(brown_rig())
    pair = pictures(dtype, (3,))
    out = rectify(pair, r, SIZE)
    assert out.left.dtype == dtype
    assert out.left.shape == (*r.size_px[::-1], 3)
    for channel in range(3):
        alone = rectify(
            StereoPair(pair.left[..., channel].copy(), pair.right[..., channel].copy(), name="seven"), r, SIZE
        )
        np.testing.assert_array_equal(out.left[..., channel], alone.left)
        np.testing.assert_array_equal(out.right[..., channel], alone.right)


def test_pixels_are_mixed_linearly_from_their_neighbours() -> None:
    """A ramp stays a ramp: the value of each pixel is the raw column it was taken from."""
    r = plan_rectification(brown_rig())
    ramp = np.tile(np.arange(SIZE[0], dtype=np.uint16) * 500, (SIZE[1], 1))
    out = rectify(StereoPair(ramp, ramp), r, SIZE)
    assert r.maps_left is not None
    inside = (r.maps_left[0] > 0) & (r.maps_left[0] < SIZE[0] - 1) & (r.maps_left[1] > 0) & (r.maps_left[1] < 60)
    # OpenCV rounds positions to 1/32 px.
    np.testing.assert_allclose(out.left[inside], 500 * r.maps_left[0][inside], atol=500 / 32)


def test_what_no_camera_saw_is_black() -> None:
    r = plan_rectification(brown_rig(), RectifySettings(f_px=60.0, size_px=(150, 120)))
    white = np.full(SIZE[::-1], 255, np.uint8)
    out = rectify(StereoPair(white, white), r, SIZE)
    assert out.left[0, 0] == 0
    assert out.right[-1, -1] == 0
    assert out.left[60, 75] == 255


@pytest.mark.parametrize("channels", [(), (3,)], ids=["grey", "rgb"])
@pytest.mark.parametrize("rig", [brown_rig(), fisheye_rig()], ids=["brown_conrady", "kannala_brandt"])
def test_half_images_are_the_means_of_four_full_pixels(rig: StereoRig, channels: tuple[int, ...]) -> None:
    """To two grey levels of a smooth picture."""
    r = plan_rectification(rig)
    v, u = np.mgrid[: SIZE[1], : SIZE[0]]
    left, right = (np.rint(128 + 90 * np.sin(u / 9 + k) * np.cos(v / 11)).astype(np.uint8) for k in (0, 1))
    if channels:
        left, right = (np.stack([image, 255 - image, image], -1) for image in (left, right))
    out = rectify(StereoPair(left, right), r, SIZE)
    assert out.half is not None
    rows, columns = r.size_px[1] // 2, r.size_px[0] // 2
    for half, full in zip(out.half, gray8(out.left, out.right), strict=True):
        assert half.dtype == np.uint8
        assert half.flags.c_contiguous
        means = full[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).mean((1, 3))
        seen = full[: 2 * rows, : 2 * columns].reshape(rows, 2, columns, 2).min((1, 3)) > 0
        assert seen.mean() > 0.9
        assert np.abs(half - means)[seen].max() <= 2


def test_half_images_of_sixteen_bits_have_eight_and_one_scale() -> None:
    r = plan_rectification(brown_rig())
    ramp = np.tile(np.arange(SIZE[0], dtype=np.uint16) * 100 + 9000, (SIZE[1], 1))
    out = rectify(StereoPair(ramp, ramp + np.uint16(1000)), r, SIZE)
    assert out.half is not None
    assert out.left.dtype == np.uint16
    assert out.half[0].dtype == out.half[1].dtype == np.uint8
    scale = 255 / 9600  # of a ramp of 96 columns
    assert r.half_maps is not None
    for half, maps, more in ((out.half[0], r.half_maps[:2], 0), (out.half[1], r.half_maps[2:], 1000)):
        expected = (maps[0] * 100 + more) * scale
        inside = (maps[0] > 0) & (maps[1] > 0) & (maps[1] < SIZE[1] - 1) & (expected > 3) & (expected < 252)
        np.testing.assert_allclose(half[inside], expected[inside], atol=2)


def test_full_images_are_resampled_when_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[tuple[int, ...]] = []
    remap = cv2.remap

    def counted(image: np.ndarray, *maps: np.ndarray | int) -> np.ndarray:
        sizes.append(np.asarray(maps[0]).shape)
        return remap(image, *maps)  # type: ignore[call-overload, no-any-return]

    monkeypatch.setattr(cv2, "remap", counted)
    r = plan_rectification(brown_rig())
    full, half = r.size_px[::-1], (r.size_px[1] // 2, r.size_px[0] // 2)
    out = rectify(pictures(), r, SIZE)
    assert sizes == [half, half]
    assert out.left is out.left
    assert sizes == [half, half, full]
    assert out.right is out.right
    assert sizes == [half, half, full, full]


@pytest.mark.parametrize("rig", [brown_rig(), rectified_rig()], ids=["resampled", "as it is"])
@pytest.mark.parametrize("channels", [(), (3,)])
@pytest.mark.parametrize(("width", "height"), [(4, 4), (8, 4), (1, 1), (200, 100)])
def test_the_middles_of_cells_are_pixels_of_the_whole(
    rig: StereoRig, channels: tuple[int, ...], width: int, height: int
) -> None:
    pair = rectify(pictures(channels=channels), plan_rectification(rig), SIZE)
    middles = pair.left_colors(width, height)
    if not channels:
        assert middles is None
        return
    assert middles is not None
    np.testing.assert_array_equal(middles, pair.left[height // 2 :: height, width // 2 :: width])
    assert middles.flags.c_contiguous
    assert not middles.flags.writeable
