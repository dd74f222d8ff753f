"""What every entry of DETECTORS must do, and how one of your own is plugged in."""

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.config import Settings, load_settings
from roadblock.detectors import DETECTORS, make_detector
from roadblock.errors import SettingsError
from roadblock.geometry.pose import pose
from roadblock.sim.render import render
from roadblock.sim.scene import Road, Scene, camera_pose
from roadblock.sim.solids import placed
from roadblock.sim.things import crate
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections

SIZE = (331, 183)
F, CX, CY, B = 300.0, 171.3, 83.6, 0.3
TWIN = Rectification(F, CX, CY, B, SIZE)
OPTIONS = ("match.disparities=48", "match.block_px=5", "segment.area_px=100")
TOLD = ("mono.height_m=1.3", "bands.camera_height_m=1.3", "bands.pitch_deg=2")
"""What is found by `dense` alone: one camera cannot tell its height, and the paper's method looks for no road."""

RANGE_REL = {"cells": 0.05, "fast": 0.05, "dense": 0.05, "bands": 0.1, "mono_ground": 0.05, "mono_area": 0.2}
"""How far a crate's range may be off: `bands` sees only its silhouette, and its size is none that `mono_area` knows."""

MONO = ("mono_ground", "mono_area")


@pytest.fixture(params=sorted(DETECTORS))
def settings(request: pytest.FixtureRequest) -> Settings:
    return load_settings(None, [f"detector={request.param}", *OPTIONS])


@pytest.fixture
def told(settings: Settings) -> Settings:
    """Settings that also say what only `dense` finds by itself."""
    return load_settings(None, [f"detector={settings.detector}", *OPTIONS, *TOLD])


@pytest.fixture(scope="module")
def street() -> RectifiedPair:
    """Two crates at 4 and 8 m on an empty road, seen from 1.3 m, looking 2 degrees down."""
    things = (
        placed(crate(1, "red", (190, 38, 34), (0.8, 0.9, 0.9)), 4.0, 0.9),
        placed(crate(2, "blue", (40, 60, 180), (1.0, 1.2, 1.1)), 8.0, -1.4),
    )
    camera = Camera(SIZE, F, F, CX, CY)
    rig = StereoRig(camera, camera, pose(np.eye(3), [B, 0, 0]))
    made = render(Scene(things, Road(), camera_pose(1.3, np.radians(2)), seed=3), rig, quality="demo", threads=1).pair
    return RectifiedPair(made.left, made.right, TWIN)


def pair(left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    height, width = left.shape[:2]
    return RectifiedPair(left, right, Rectification(F, width / 2 + 3.3, height / 2 - 2.4, B, (width, height)))


def same(a: Detections, b: Detections) -> None:
    """Check that two detections are the same to the bit; ranges that are unknown in both are the same."""
    assert len(a.regions) == len(b.regions)
    for one, other in zip(a.regions, b.regions, strict=True):
        assert one.box_px == other.box_px
        np.testing.assert_array_equal(one.surface_uvd_px, other.surface_uvd_px)
        assert one.sigma_d_px == other.sigma_d_px
    np.testing.assert_array_equal(a.free_space.range_m, b.free_space.range_m)
    assert (a.ground is None) == (b.ground is None)
    if a.ground is not None and b.ground is not None:
        np.testing.assert_array_equal(a.ground.normal, b.ground.normal)
        assert a.ground.height_m == b.ground.height_m


def nothing_claimed(found: Detections) -> None:
    """Check that neither road nor obstacle nor free way is claimed."""
    assert found.ground is None
    assert found.regions == ()
    assert np.isnan(found.free_space.range_m).all()


def check(found: Detections, given: RectifiedPair) -> None:
    """Check what must be true of any detections, of whatever pair."""
    width, height = given.rectification.size_px
    assert not found.matched_share < 0
    assert not found.matched_share > 1
    assert found.timings_ms
    assert all(np.isfinite(ms) and ms >= 0 for ms in found.timings_ms.values())
    free = found.free_space
    assert (np.diff(free.u_px) > 0).all()
    assert ((free.u_px >= 0) & (free.u_px <= width - 1)).all()
    known = free.range_m[np.isfinite(free.range_m)]
    assert not np.isinf(free.range_m).any()
    assert (known > 0).all()
    for region in found.regions:
        u0, v0, u1, v1 = region.box_px
        assert all(type(side) is int for side in region.box_px)
        assert 0 <= u0 < u1 <= width
        assert 0 <= v0 < v1 <= height
        assert (region.contour_px >= (u0, v0)).all()
        assert (region.contour_px < (u1, v1)).all()
        assert len(region.contour_px) >= 1
        assert np.isfinite(region.surface_uvd_px).all()
        assert (region.surface_uvd_px[:, 2] > 0).all()
        assert 0 < region.sigma_d_px < 10
        rgb = region.color_rgb
        assert np.isnan(rgb).all() if given.left.ndim == 2 else ((rgb >= 0) & (rgb <= 255)).all()


def test_each_detector_states_its_accuracy() -> None:
    assert RANGE_REL.keys() == DETECTORS.keys()


def test_a_street_is_understood(told: Settings, street: RectifiedPair) -> None:
    found = make_detector(told)(street)
    check(found, street)
    assert found.ground is not None
    assert found.ground.height_m == pytest.approx(1.3, abs=0.05)
    assert np.degrees(found.ground.pitch_rad) == pytest.approx(2, abs=0.4)
    rel = RANGE_REL[told.detector]
    nearest = sorted((F * B / float(np.percentile(r.surface_uvd_px[:, 2], 90)), r.box_px) for r in found.regions)[:2]
    assert [z for z, _ in nearest] == pytest.approx([4.0, 8.0], rel=rel)
    for (_, (u0, _, u1, _)), middle in zip(
        nearest, (CX + F * (-0.9 + B / 2) / 4, CX + F * (1.4 + B / 2) / 8), strict=True
    ):
        assert u0 < middle < u1
    assert not np.isfinite(found.matched_share) or found.matched_share > 0.4
    at_crate = found.free_space.range_m[np.abs(found.free_space.u_px - (CX + F * (-0.9 + B / 2) / 4)) < 20]
    assert np.nanmedian(at_crate) == pytest.approx(4.0, rel=min(rel, 0.1))


def test_what_is_not_told_is_known_to_dense_alone(settings: Settings, street: RectifiedPair) -> None:
    """One camera takes the settings' height for the true one, the paper's method then knows of no road."""
    ground = make_detector(settings)(street).ground
    if settings.detector == "bands":
        assert ground is None
    else:
        assert ground is not None
        expected = settings.mono.height_m if settings.detector in MONO else pytest.approx(1.3, abs=0.05)
        assert ground.height_m == expected


def test_grey_and_deep_images_give_the_same_obstacles(told: Settings, street: RectifiedPair) -> None:
    """Of both cameras; one camera tells road by colour: in grey it keeps what is lighter or darker than the road."""
    detect = make_detector(told)
    colour = detect(street)
    gray = [cv2.cvtColor(np.asarray(i), cv2.COLOR_RGB2GRAY) for i in (street.left, street.right)]
    found = detect(RectifiedPair(gray[0], gray[1], TWIN))
    check(found, RectifiedPair(gray[0], gray[1], TWIN))
    if told.detector in MONO:
        same(found, detect(RectifiedPair(*(np.repeat(g[..., None], 3, 2) for g in gray), TWIN)))
        blue = max(colour.regions, key=lambda r: r.box_px[0]).box_px
        assert any(np.abs(np.subtract(r.box_px, blue)).max() <= 5 for r in found.regions), "dark in grey too"
        at_red = np.abs(found.free_space.u_px - (CX + F * (-0.9 + B / 2) / 4)) < 20
        assert np.nanmedian(found.free_space.range_m[at_red]) > 8, "as light as the road, the red front is taken for it"
    else:
        assert [r.box_px for r in found.regions] == [r.box_px for r in colour.regions]
    deep = [i.astype(np.uint16) * 257 for i in (street.left, street.right)]
    found = detect(RectifiedPair(deep[0], deep[1], TWIN))
    check(found, RectifiedPair(deep[0], deep[1], TWIN))
    if told.detector in MONO:
        assert [r.box_px for r in found.regions] == [r.box_px for r in colour.regions]
    assert abs(len(found.regions) - len(colour.regions)) <= 1


@pytest.mark.parametrize("bits", [10, 12])
def test_cameras_of_few_bits_see_the_same_obstacles(told: Settings, street: RectifiedPair, bits: int) -> None:
    """16-bit files whose highest bits are empty."""
    deep = [i.astype(np.uint16) << (bits - 8) for i in (street.left, street.right)]
    given = RectifiedPair(deep[0], deep[1], TWIN)
    detect = make_detector(told)
    found, eight = detect(given), detect(street)
    check(found, given)
    assert found.ground is not None
    near, far = sorted(eight.regions, key=lambda r: -np.median(r.surface_uvd_px[:, 2]))[:2]
    for crate_seen in (near, far):
        assert any(np.abs(np.subtract(r.box_px, crate_seen.box_px)).max() <= 8 for r in found.regions)
    assert abs(len(found.regions) - len(eight.regions)) <= 1


def test_the_same_pair_gives_the_same_detections(told: Settings, street: RectifiedPair) -> None:
    a, b = (make_detector(told)(street) for _ in range(2))
    assert len(a.regions) >= 2
    assert a.ground is not None
    same(a, b)


@pytest.mark.parametrize("level", [0, 127, 255])
@pytest.mark.parametrize("shape", [(183, 331), (183, 331, 3)])
def test_blank_images_invent_nothing(settings: Settings, level: int, shape: tuple[int, ...]) -> None:
    blank = np.full(shape, level, np.uint8)
    given = pair(blank, blank)
    found = make_detector(settings)(given)
    check(found, given)
    assert found.regions == ()
    assert found.ground is None
    assert np.isnan(found.free_space.range_m).all()
    assert not found.matched_share > 0.01


def test_a_covered_camera_knows_of_no_road(settings: Settings, street: RectifiedPair) -> None:
    """A few cells match by accident and may be reported; but hardly any match, which health calls failed.

    One camera cannot know that the other is covered: it finds what it finds with both.
    """
    covered = np.full_like(street.left, 12)
    for left, right in ((street.left, covered), (covered, street.right)):
        found = make_detector(settings)(pair(left, right))
        check(found, pair(left, right))
        if settings.detector in MONO and left is street.left:
            assert found.regions
            assert np.isnan(found.matched_share), "nothing is said of the right camera"
            same(found, make_detector(settings)(pair(left, street.right)))
            continue
        assert found.ground is None
        assert np.isnan(found.free_space.range_m).all()
        assert not found.matched_share > 0.1


def test_noise_alone_is_no_road(settings: Settings) -> None:
    rng = np.random.default_rng(0)
    given = pair(*(rng.integers(0, 256, (183, 331), np.uint8) for _ in range(2)))
    found = make_detector(settings)(given)
    check(found, given)
    assert found.ground is None
    assert np.isnan(found.free_space.range_m).all()


@pytest.mark.parametrize("option", ["match.matcher=sgbm", "match.matcher=bm", "segment.gap_px=32"])
@pytest.mark.parametrize("size", [(1, 1), (2, 1), (3, 5), (16, 16), (7, 90), (90, 3), (40, 60), (47, 33)])
def test_tiny_images_do_not_crash(settings: Settings, size: tuple[int, int], option: str) -> None:
    rng = np.random.default_rng(1)
    given = pair(*(rng.integers(0, 256, size[::-1], np.uint8) for _ in range(2)))
    made = make_detector(load_settings(None, [f"detector={settings.detector}", *OPTIONS, "segment.area_px=0", option]))
    check(made(given), given)
    twice = pair(given.left, given.left)
    check(made(twice), twice)


def test_a_wall_before_the_bumper_is_reported_without_a_road(settings: Settings) -> None:
    """By what matches the whole image. The others know things by the road around them, and claim nothing without."""
    noise = np.random.default_rng(2).normal(size=(183, 331 + 30)).astype(np.float32)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wall = np.clip(128 + wall * (50 / wall.std()), 0, 255).astype(np.uint8)
    given = pair(wall[:, :331].copy(), wall[:, 30:].copy())
    found = make_detector(settings)(given)
    check(found, given)
    if settings.detector not in ("cells", "fast", "dense"):
        nothing_claimed(found)
        return
    assert found.ground is None
    assert len(found.regions) >= 1
    assert F * B / np.median(found.regions[0].surface_uvd_px[:, 2]) == pytest.approx(3.0, rel=0.02)


# --- one's own --------------------------------------------------------------------------------------------------------

PLUGIN = """
import numpy as np
from roadblock.values.scene import Detections, FreeSpace
from roadblock.errors import SettingsError

def blind(settings):
    def detect(pair):
        return Detections((), None, FreeSpace(np.zeros(0), np.zeros(0)), timings_ms={"blind": settings.match.sigma_px})
    return detect

def refuses(settings):
    raise SettingsError("my own reason")

def wrong_settings(settings):
    raise ValueError("no such thing")

def makes_nothing(settings):
    return None

def wants_more(settings, more):
    return None

number = 3
"""


@pytest.fixture(scope="module")
def plugin(tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("plugin")
    (folder / "roadblock_test_plugin.py").write_text(PLUGIN)
    (folder / "roadblock_test_broken.py").write_text("def (:\n")
    (folder / "roadblock_test_importless.py").write_text("import roadblock_test_nothing_of_this_name\n")
    sys.path.insert(0, str(folder))
    yield "roadblock_test_plugin"  # type: ignore[misc]
    sys.path.remove(str(folder))


def test_a_detector_of_ones_own_is_named_by_its_factory(plugin: str) -> None:
    detect = make_detector(load_settings(None, [f"detector={plugin}:blind", "match.sigma_px=0.25"]))
    image = np.zeros((4, 5), np.uint8)
    assert detect(pair(image, image)).timings_ms == {"blind": 0.25}


@pytest.mark.parametrize(
    ("name", "says"),
    [
        ("roadblock_test_plugin:missing", "has no attribute 'missing'"),
        ("roadblock_test_plugin:", "cannot be loaded"),
        ("roadblock_test_plugin:number", "not callable"),
        ("roadblock_test_plugin:wants_more", "missing 1 required positional argument"),
        ("roadblock_test_plugin:wrong_settings", "no such thing"),
        ("roadblock_test_plugin:makes_nothing", "must return a function of a pair, but returned None"),
        ("roadblock_test_broken:x", "invalid syntax"),
        ("roadblock_test_importless:x", "No module named 'roadblock_test_nothing_of_this_name'"),
        ("roadblock_test_none:x", "No module named 'roadblock_test_none'"),
        (":x", "Empty module name"),
        (".relative:x", "relative"),
        (":", "Empty module name"),
    ],
)
def test_one_that_cannot_be_made_is_refused(plugin: str, name: str, says: str) -> None:
    with pytest.raises(SettingsError, match=r"^detector ") as caught:
        make_detector(Settings(detector=name))
    assert says in str(caught.value)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)


def test_its_own_refusal_passes(plugin: str) -> None:
    with pytest.raises(SettingsError, match=r"^my own reason$"):
        make_detector(Settings(detector=f"{plugin}:refuses"))


@pytest.mark.parametrize("name", ["cell", "", "Cells", "os.system", "something else"])
def test_an_unknown_name_is_refused_and_the_nearest_is_named(name: str) -> None:
    """Or the default, where none is near."""
    with pytest.raises(SettingsError, match="did you mean cells") as caught:
        make_detector(Settings(detector=name))
    assert "package.module:factory" in str(caught.value)


@pytest.mark.parametrize(
    ("name", "nearest"),
    [("dence", "dense"), ("band", "bands"), ("mono_grund", "mono_ground"), ("mono-area", "mono_area")],
)
def test_the_nearest_of_all_names_is_named(name: str, nearest: str) -> None:
    with pytest.raises(SettingsError, match=f"did you mean {nearest}\\?"):
        make_detector(Settings(detector=name))


def test_the_default_is_in_the_table() -> None:
    assert Settings().detector in DETECTORS


def test_no_file_of_the_repository_is_named_like_the_plugins() -> None:
    assert not list(Path(__file__).parents[2].glob("**/roadblock_test_*.py"))
