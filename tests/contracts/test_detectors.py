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


@pytest.fixture(params=sorted(DETECTORS))
def settings(request: pytest.FixtureRequest) -> Settings:
    return load_settings(None, [f"detector={request.param}", *OPTIONS])


@pytest.fixture(scope="module")
def street() -> RectifiedPair:
    """Two crates at 4 and 8 m on an empty road, seen from 1.3 m, looking 2 degrees down."""
    things = (
        placed(crate(1, "red", (190, 38, 34), (0.8, 0.9, 0.9)), 4.0, 0.9),
        placed(crate(2, "blue", (40, 60, 180), (1.0, 1.2, 1.1)), 8.0, -1.4),
    )
    camera = Camera(SIZE, F, F, CX, CY)
    rig = StereoRig(camera, camera, pose(np.eye(3), [B, 0, 0]))
    made = render(Scene(things, Road(), camera_pose(1.3, np.radians(2)), seed=3), rig, samples=2, threads=1).pair
    return RectifiedPair(made.left, made.right, TWIN)


def pair(left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    height, width = left.shape[:2]
    return RectifiedPair(left, right, Rectification(F, width / 2 + 3.3, height / 2 - 2.4, B, (width, height)))


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


def test_a_street_is_understood(settings: Settings, street: RectifiedPair) -> None:
    found = make_detector(settings)(street)
    check(found, street)
    assert found.ground is not None
    assert found.ground.height_m == pytest.approx(1.3, abs=0.05)
    assert np.degrees(found.ground.pitch_rad) == pytest.approx(2, abs=0.4)
    ranges = sorted(F * B / float(np.percentile(r.surface_uvd_px[:, 2], 90)) for r in found.regions)
    assert ranges[:2] == pytest.approx([4.0, 8.0], rel=0.05)
    assert not np.isfinite(found.matched_share) or found.matched_share > 0.4
    at_crate = found.free_space.range_m[np.abs(found.free_space.u_px - (CX + F * (-0.9 + B / 2) / 4)) < 20]
    assert np.nanmedian(at_crate) == pytest.approx(4.0, rel=0.05)


def test_grey_and_deep_images_give_the_same_obstacles(settings: Settings, street: RectifiedPair) -> None:
    detect = make_detector(settings)
    colour = detect(street)
    gray = [cv2.cvtColor(np.asarray(i), cv2.COLOR_RGB2GRAY) for i in (street.left, street.right)]
    found = detect(RectifiedPair(gray[0], gray[1], TWIN))
    check(found, RectifiedPair(gray[0], gray[1], TWIN))
    assert [r.box_px for r in found.regions] == [r.box_px for r in colour.regions]
    deep = [i.astype(np.uint16) * 257 for i in (street.left, street.right)]
    found = detect(RectifiedPair(deep[0], deep[1], TWIN))
    check(found, RectifiedPair(deep[0], deep[1], TWIN))
    assert abs(len(found.regions) - len(colour.regions)) <= 1


def test_the_same_pair_gives_the_same_detections(settings: Settings, street: RectifiedPair) -> None:
    a, b = (make_detector(settings)(street) for _ in range(2))
    assert [r.box_px for r in a.regions] == [r.box_px for r in b.regions]
    for one, other in zip(a.regions, b.regions, strict=True):
        np.testing.assert_array_equal(one.surface_uvd_px, other.surface_uvd_px)
    np.testing.assert_array_equal(a.free_space.range_m, b.free_space.range_m)
    assert a.ground is not None
    assert b.ground is not None
    np.testing.assert_array_equal(a.ground.normal, b.ground.normal)


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
    """A few cells match by accident and may be reported; but hardly any match, which health calls failed."""
    covered = np.full_like(street.left, 12)
    for left, right in ((street.left, covered), (covered, street.right)):
        found = make_detector(settings)(pair(left, right))
        check(found, pair(left, right))
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


@pytest.mark.parametrize("option", ["match.matcher=sgbm", "match.matcher=bm", "segment.gap_cells=8"])
@pytest.mark.parametrize("size", [(1, 1), (2, 1), (3, 5), (16, 16), (7, 90), (90, 3), (40, 60), (47, 33)])
def test_tiny_images_do_not_crash(settings: Settings, size: tuple[int, int], option: str) -> None:
    rng = np.random.default_rng(1)
    given = pair(*(rng.integers(0, 256, size[::-1], np.uint8) for _ in range(2)))
    made = make_detector(load_settings(None, [f"detector={settings.detector}", *OPTIONS, "segment.area_px=0", option]))
    check(made(given), given)
    same = pair(given.left, given.left)
    check(made(same), same)


def test_a_wall_before_the_bumper_is_reported_without_a_road(settings: Settings) -> None:
    noise = np.random.default_rng(2).normal(size=(183, 331 + 30)).astype(np.float32)
    wall = cv2.GaussianBlur(noise, (0, 0), 1.5)
    wall = np.clip(128 + wall * (50 / wall.std()), 0, 255).astype(np.uint8)
    given = pair(wall[:, :331].copy(), wall[:, 30:].copy())
    found = make_detector(settings)(given)
    check(found, given)
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


@pytest.mark.parametrize("name", ["dence", "", "Dense", "os.system", "something else"])
def test_an_unknown_name_is_refused_and_the_nearest_is_named(name: str) -> None:
    with pytest.raises(SettingsError, match="did you mean dense") as caught:
        make_detector(Settings(detector=name))
    assert "package.module:factory" in str(caught.value)


def test_the_default_is_in_the_table() -> None:
    assert Settings().detector in DETECTORS


def test_no_file_of_the_repository_is_named_like_the_plugins() -> None:
    assert not list(Path(__file__).parents[2].glob("**/roadblock_test_*.py"))
