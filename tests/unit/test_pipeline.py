"""The flow chart from end to end on the simulated street, where the truth is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from roadblock.config import Settings, load_settings
from roadblock.errors import RigError, SettingsError, SourceError
from roadblock.geometry.pose import pose, rotation_from_rotvec
from roadblock.geometry.projection import unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.pipeline import Pipeline
from roadblock.sim.render import Rendered, render
from roadblock.sim.scene import demo_street, paper_rig
from roadblock.sim.truth import TrueObject
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters
from roadblock.values.frame import RectifiedPair, StereoPair
from roadblock.values.scene import FrameResult, Obstacle

HALF = Camera((640, 360), 516.5, 516.5, 325.9, 173.55)
STAGES = [
    "rectify",
    "match",
    "ground",
    "segment",
    "refine",
    "triangulate",
    "recognize",
    "egomotion",
    "fuse",
    "track",
    "total",
]


def half_rig(baseline_m: float = 0.205) -> StereoRig:
    return StereoRig(HALF, HALF, pose(np.eye(3), [baseline_m, 0, 0]))


@pytest.fixture(scope="module")
def street() -> Rendered:
    return render(demo_street(), paper_rig(), quality="preview", threads=1, index=3, name="demo", t_ns=77)


@pytest.fixture(scope="module")
def step(street: Rendered) -> tuple[FrameResult, RectifiedPair]:
    return Pipeline(paper_rig()).step(street.pair)


@pytest.fixture(scope="module")
def small() -> Rendered:
    return render(demo_street(pitch_rad=0.02), half_rig(), quality="demo", threads=1)


@pytest.fixture(scope="module")
def small_result(small: Rendered) -> FrameResult:
    return Pipeline(half_rig()).step(small.pair)[0]


def covering(obstacles: tuple[Obstacle, ...], true: TrueObject) -> Obstacle | None:
    """Return the obstacle whose box is the object's, by at least half of their union."""
    c0, d0, c1, d1 = true.box_px
    for obstacle in obstacles:
        a0, b0, a1, b1 = obstacle.box_px
        common = max(0, min(a1, c1) - max(a0, c0)) * max(0, min(b1, d1) - max(b0, d0))
        if common > 0.5 * ((a1 - a0) * (b1 - b0) + (c1 - c0) * (d1 - d0) - common):
            return obstacle
    return None


def ranges(result: FrameResult, truth: Rendered) -> dict[int, float]:
    """Return the range of each true object that was found."""
    found = {true.id: covering(result.obstacles, true) for true in truth.objects}
    return {number: obstacle.range_m for number, obstacle in found.items() if obstacle}


# --- the demo street --------------------------------------------------------------------------------------------------


def test_all_six_are_found_where_they_stand(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    result, _ = step
    assert len(street.objects) == 6
    for true in street.objects:
        obstacle = covering(result.obstacles, true)
        assert obstacle, f"{true.color} {true.type} at {true.range_m:.1f} m"
        assert abs(obstacle.range_m - true.range_m) < 3 * obstacle.range_sigma_m
        assert obstacle.range_m == pytest.approx(true.range_m, rel=0.04)
        assert obstacle.position_m[0] == pytest.approx(obstacle.range_m)
        assert obstacle.position_m[1] == pytest.approx(true.position_m[1], abs=0.25)  # edges: to about four cells
        assert obstacle.position_m[2] == pytest.approx(true.position_m[2], abs=0.12)
        assert obstacle.size_m[1] == pytest.approx(true.size_m[1], rel=0.12)
        # Beyond 15 m who stands may be taken for who rides towards the car: docs/recognition.md, limits.
        people = ("person", "unknown", *(["bicycle"] if true.range_m > 15 else []))
        assert obstacle.label in {"person": people, "box": ("debris", "wall", "unknown")}[true.type]


def test_colours_are_named(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    named = {true.color: covering(step[0].obstacles, true) for true in street.objects}
    for color in ("red", "blue", "yellow", "orange"):
        obstacle = named[color]
        assert obstacle is not None
        assert obstacle.color == color


def test_nothing_is_invented_on_the_road(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    ours = {id(covering(step[0].obstacles, true)) for true in street.objects}
    others = [o for o in step[0].obstacles if id(o) not in ours]
    assert all(o.range_m > 24 for o in others), "only houses and trees are left, and they begin at 27 m"


def test_the_road_and_the_verdict(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    result, _ = step
    assert result.ground is not None
    assert result.ground.height_m == pytest.approx(street.ground.height_m, abs=0.02)
    assert result.ground.pitch_rad == pytest.approx(street.ground.pitch_rad, abs=0.003)
    assert result.ground.roll_rad == pytest.approx(street.ground.roll_rad, abs=0.005)
    assert (result.health.state, result.health.reasons) == ("ok", ())


def test_free_space_ends_at_the_things(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    free = step[0].free_space
    for true in street.objects:
        u0, _, u1, _ = true.box_px
        inner = (free.u_px > u0 + 0.3 * (u1 - u0)) & (free.u_px < u1 - 0.3 * (u1 - u0))
        assert np.nanmedian(free.range_m[inner]) == pytest.approx(true.range_m, rel=0.06)


def test_the_record_is_complete_and_sorted(street: Rendered, step: tuple[FrameResult, RectifiedPair]) -> None:
    result, rectified = step
    assert (result.index, result.name, result.t_ns) == (3, "demo", 77)
    assert (rectified.index, rectified.name, rectified.t_ns) == (3, "demo", 77)
    assert [o.range_m for o in result.obstacles] == sorted(o.range_m for o in result.obstacles)
    assert list(result.timings_ms) == STAGES
    assert all(ms >= 0 for ms in result.timings_ms.values())
    assert result.timings_ms["total"] == pytest.approx(sum(result.timings_ms[name] for name in STAGES[:-1]))
    assert result.timings_ms["match"] > 1
    np.testing.assert_array_equal(rectified.left, street.pair.left)


def test_obstacles_are_sorted_whatever_the_detector_does(small: Rendered, small_result: FrameResult) -> None:
    pipeline = Pipeline(half_rig())
    found = pipeline.detect(pipeline.step(small.pair)[1])
    pipeline.detect = lambda pair: replace(found, regions=found.regions[::-1])
    result, _ = pipeline.step(small.pair)
    assert len(result.obstacles) > 3
    assert [o.range_m for o in result.obstacles] == [o.range_m for o in small_result.obstacles]


# --- the same world, told otherwise -----------------------------------------------------------------------------------


def test_half_the_resolution_finds_what_it_can(small: Rendered, small_result: FrameResult) -> None:
    """The box and the person at 20 m, 19 px apart here, become one obstacle: a limit that docs/pipeline.md names."""
    found = ranges(small_result, small)
    assert {1, 2, 3, 4} <= set(found)
    for true in small.objects:
        middle = (true.box_px[0] + true.box_px[2]) / 2
        at = [o for o in small_result.obstacles if o.box_px[0] < middle < o.box_px[2]]
        assert at[0].range_m == pytest.approx(true.range_m, rel=0.07)  # 0.35 px of disparity at 20 m
    assert small_result.ground is not None
    assert small_result.ground.pitch_rad == pytest.approx(0.02, abs=0.004)


def test_the_same_pair_gives_the_same_result(small: Rendered, small_result: FrameResult) -> None:
    again = Pipeline(half_rig()).step(small.pair)[0]
    assert len(again.obstacles) == len(small_result.obstacles)
    for a, b in zip(again.obstacles, small_result.obstacles, strict=True):
        assert (a.range_m, a.range_sigma_m, a.box_px, a.color) == (b.range_m, b.range_sigma_m, b.box_px, b.color)
        np.testing.assert_array_equal(a.position_m, b.position_m)
        np.testing.assert_array_equal(a.cov_match_m2, b.cov_match_m2)
        np.testing.assert_array_equal(a.contour_px, b.contour_px)
    np.testing.assert_array_equal(again.free_space.range_m, small_result.free_space.range_m)


def test_the_second_frame_does_not_know_the_first(small: Rendered, small_result: FrameResult) -> None:
    pipeline = Pipeline(half_rig())
    pipeline.step(StereoPair(small.pair.left[:, ::-1].copy(), small.pair.left[:, ::-1].copy()))
    assert ranges(pipeline.step(small.pair)[0], small) == ranges(small_result, small)


@pytest.mark.parametrize("scale", [0.93, 1.1])
def test_a_longer_baseline_is_a_larger_world(small: Rendered, small_result: FrameResult, scale: float) -> None:
    scaled = ranges(Pipeline(half_rig(0.205 * scale)).step(small.pair)[0], small)
    plain = ranges(small_result, small)
    assert len(scaled.keys() & plain.keys()) >= 4
    for number in scaled.keys() & plain.keys():
        assert scaled[number] == pytest.approx(scale * plain[number], rel=0.01)


@pytest.mark.parametrize(("gain", "offset"), [(0.8, 0), (1.2, 0), (1.0, 15)])
def test_gain_and_offset_of_one_camera_hardly_matter(
    small: Rendered, small_result: FrameResult, gain: float, offset: float
) -> None:
    right = np.clip(small.pair.right * gain + offset, 0, 255).astype(np.uint8)
    other = ranges(Pipeline(half_rig()).step(StereoPair(small.pair.left, right))[0], small)
    plain = ranges(small_result, small)
    assert len(other.keys() & plain.keys()) >= 4
    for number in other.keys() & plain.keys():
        assert other[number] == pytest.approx(plain[number], rel=0.02)


def test_raw_images_of_a_crooked_rig_tell_the_same(small: Rendered) -> None:
    """Bend the rectified pictures into those of two crooked cameras, and let the pipeline undo it."""
    k = [-0.11, 0.03, 1e-3, -1e-3, 0.0]
    left = Camera((652, 371), 473.0, 468.0, 321.4, 178.2, "brown_conrady", k)
    right = Camera((652, 371), 470.0, 474.0, 330.7, 181.9, "brown_conrady", np.multiply(k, 0.8))
    toed = rotation_from_rotvec([0.01, -0.02, 0.015])
    rig = StereoRig(
        left, right, pose(toed, 0.205 * np.array([0.9995, 0.02, -0.024]) / np.linalg.norm([0.9995, 0.02, -0.024]))
    )
    raw = [
        bent(camera, R, image)
        for camera, R, image in zip((left, right), rectifying_rotations(rig.T_left_right), pictures(small), strict=True)
    ]
    result = Pipeline(rig).step(StereoPair(*raw))[0]
    assert result.ground is not None
    assert result.ground.height_m == pytest.approx(1.4, abs=0.03)
    assert result.ground.pitch_rad == pytest.approx(0.02, abs=0.004)
    for near in (true for true in small.objects if true.range_m < 12):
        away = [np.hypot(*(o.position_m - near.position_m)[:2]) for o in result.obstacles]
        closest = result.obstacles[int(np.argmin(away))]
        assert closest.range_m == pytest.approx(near.range_m, rel=0.05)
        # Edges are known to a few cells (4 px, which is 0.08 m at 10 m in this small image); a walker's nearest face
        # is a swinging limb, smaller than the cells it is seen in.
        aside_m = 0.35
        assert closest.position_m[1] == pytest.approx(near.position_m[1], abs=aside_m)


def pictures(rendered: Rendered) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(rendered.pair.left), np.asarray(rendered.pair.right)


def bent(camera: Camera, R_rect_camera: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return what a crooked camera sees, looked up in the picture of its rectified twin."""
    width, height = camera.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    x, y, z = np.moveaxis(unproject(camera, np.stack([u, v], -1)) @ R_rect_camera.T, -1, 0)
    maps = (HALF.fx_px * x / z + HALF.cx_px, HALF.fy_px * y / z + HALF.cy_px)
    return cv2.remap(image, *(m.astype(np.float32) for m in maps), cv2.INTER_CUBIC)


def test_a_mounting_moves_every_place(small: Rendered, small_result: FrameResult) -> None:
    T = pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [1.5, 0.0, 1.4])
    rig = StereoRig(HALF, HALF, half_rig().T_left_right, T)
    mounted = Pipeline(rig).step(small.pair)[0]
    for a, b in zip(mounted.obstacles, small_result.obstacles, strict=True):
        np.testing.assert_allclose(a.position_m, b.position_m + np.array([1.5, 0, 1.4]))
        assert a.range_m == b.range_m


# --- what is refused, and what is doubted -----------------------------------------------------------------------------


def test_a_covariance_of_the_rig_reaches_every_obstacle(small: Rendered, small_result: FrameResult) -> None:
    """0.01 degrees of vergence are Z^2 / B * angle, at the middle of the image."""
    plain = half_rig()
    names = rig_parameters(plain.left, plain.right)
    sigma_rad = np.radians(0.01)
    variances = np.where(np.array(names) == "ry_rad", sigma_rad**2, 0.0)
    rig = replace(plain, covariance=RigCovariance(names, np.diag(variances)))
    result = Pipeline(rig).step(small.pair)[0]
    assert len(result.obstacles) == len(small_result.obstacles) > 3
    for told, before in zip(result.obstacles, small_result.obstacles, strict=True):
        assert told.range_m == before.range_m
        assert np.isnan(before.cov_calib_m2).all()
        slope = (told.position_m[1] + 0.1025) / told.range_m  # in the right camera, left of its axis
        expected = told.range_m**2 / 0.205 * sigma_rad * (1 + slope**2)
        assert told.range_sigma_calib_m == pytest.approx(expected, rel=0.02)
        assert told.cov_calib_m2[0, 0] == pytest.approx(told.range_sigma_calib_m**2)


def test_exchanged_images_are_refused(small: Rendered) -> None:
    swapped = StereoPair(small.pair.right, small.pair.left, name="000012")
    with pytest.raises(SourceError, match=r"frame 000012: .* look swapped: exchange them"):
        Pipeline(half_rig()).step(swapped)


def test_images_of_another_size_are_refused(small: Rendered) -> None:
    half = StereoPair(*(i[::2, ::2].copy() for i in pictures(small)))
    with pytest.raises(SourceError, match="images are 320x180, but the rig is for 640x360"):
        Pipeline(half_rig()).step(half)


def test_without_a_road_the_frame_is_degraded() -> None:
    noise = np.random.default_rng(2).normal(size=(120, 260)).astype(np.float32)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wall = np.clip(128 + wall * (50 / wall.std()), 0, 255).astype(np.uint8)
    camera = Camera((240, 120), 200.0, 200.0, 121.3, 58.4)
    rig = StereoRig(camera, camera, pose(np.eye(3), [0.3, 0, 0]))
    result, _ = Pipeline(rig).step(StereoPair(wall[:, :240].copy(), wall[:, 20:].copy()))
    assert result.ground is None
    assert result.health.state == "degraded"
    assert result.health.reasons == ("no road found",)
    assert result.obstacles[0].range_m == pytest.approx(3.0, rel=0.02)
    assert np.isnan(result.free_space.range_m).all()


@pytest.mark.parametrize("level", [0, 90])
def test_covered_cameras_fail_the_frame(small: Rendered, level: int) -> None:
    covered = np.full_like(pictures(small)[0], level)
    for left, right in ((covered, covered), (small.pair.left, covered), (covered, small.pair.right)):
        result, _ = Pipeline(half_rig()).step(StereoPair(left, right))
        assert result.health.state == "failed"
        assert result.ground is None
        assert np.isnan(result.free_space.range_m).all()


def test_a_detector_that_is_none_and_a_rig_that_sees_nothing_are_refused() -> None:
    with pytest.raises(SettingsError, match="unknown detector"):
        Pipeline(half_rig(), Settings(detector="cells2"))
    narrow = Camera((97, 61), 300.0, 310.0, 43.3, 33.9)
    with pytest.raises(RigError, match="share no view"):
        Pipeline(StereoRig(narrow, narrow, pose(rotation_from_rotvec([0.0, 0.7, 0.0]), [0.2, 0, 0])))


@pytest.mark.parametrize("matcher", ["sgbm", "bm"])
def test_settings_reach_their_stages(small: Rendered, matcher: str) -> None:
    options = [f"match.matcher={matcher}", "match.block_px=9", "match.disparities=64", "segment.reach_m=15"]
    result, _ = Pipeline(half_rig(), load_settings(None, options)).step(small.pair)
    assert result.obstacles
    assert all(o.range_m < 15 for o in result.obstacles)
    few = Pipeline(half_rig(), load_settings(None, ["segment.area_px=1e+9", "ground.height_m=[3, 4]"])).step(
        small.pair
    )[0]
    assert (few.obstacles, few.ground) == ((), None)


# --- over time --------------------------------------------------------------------------------------------------------


def again(pair: StereoPair, t_ns: int) -> StereoPair:
    return StereoPair(pair.left, pair.right, t_ns=t_ns)


def test_a_drive_is_tracked(small: Rendered) -> None:
    pipeline, steps = Pipeline(half_rig()), [10**9 + i * 10**8 for i in range(5)]
    results = [pipeline.step(again(small.pair, t_ns))[0] for t_ns in steps]
    assert results[0].ego is None
    assert all(o.track is None for o in results[0].obstacles)
    last = results[-1]
    assert last.ego is not None
    assert last.ego.T_now_before == pytest.approx(np.eye(4), abs=1e-3)
    found = [covering(last.obstacles, true) for true in small.objects]
    tracks = [o.track for o in found if o is not None]
    assert len(tracks) >= 4
    motions = {track.motion for track in tracks if track}
    assert "standing" in motions
    assert "moving" not in motions
    before = [o.track.id for o in results[1].obstacles if o.track]
    assert {track.id for track in tracks if track} <= set(before)


def test_tracking_can_be_left_out(small: Rendered) -> None:
    pipeline = Pipeline(half_rig(), load_settings(assignments=["track.enabled=false"]))
    for t_ns in (10**9, 2 * 10**9):
        result, _ = pipeline.step(again(small.pair, t_ns))
    assert all(o.track is None for o in result.obstacles)
    assert result.ego is None
    assert "track" not in result.timings_ms


def test_decisions_are_made_when_they_are_wanted(small: Rendered) -> None:
    for wanted in ("true", "false"):
        pipeline = Pipeline(half_rig(), load_settings(assignments=[f"decide.enabled={wanted}"]))
        steps = [10**9 + i * 10**8 for i in range(3)]
        result = [pipeline.step(again(small.pair, t_ns))[0] for t_ns in steps][-1]
        assert (result.decision is not None) == (wanted == "true") == ("decide" in result.timings_ms)


def test_single_frames_are_not_tracked(small: Rendered) -> None:
    pipeline = Pipeline(half_rig())
    for _ in range(3):
        result, _ = pipeline.step(again(small.pair, 0))
    assert all(o.track is None for o in result.obstacles)
    assert "track" not in result.timings_ms
