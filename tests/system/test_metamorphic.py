"""What must not change, or must change in a known way, when the input is changed: through the whole pipeline."""

import numpy as np
import pytest
from scipy.stats import spearmanr

from roadblock.config import Settings, load_settings
from roadblock.geometry.pose import pose
from roadblock.pipeline import Pipeline
from roadblock.sim.render import render
from roadblock.sim.scene import demo_street
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.frame import StereoPair

SIZE = WIDTH, HEIGHT = 640, 360
F_PX, CX_PX, CY_PX, BASELINE_M = 516.5, 326.15, 173.8, 0.205
"""The paper's rig at half its resolution."""

CELL_PX = 4
"""Of the detector: boxes and sides are known to a cell."""


# Matching one way, the default, is good to a step of OpenCV's sixteenth of a pixel: more than these limits.
BOTH_WAYS = load_settings(None, ["detector=dense", "match.both_ways=true"])


def rig(cx_px=CX_PX, scale=1.0):
    camera = Camera(SIZE, F_PX, F_PX, cx_px, CY_PX)
    return StereoRig(camera, camera, pose(np.eye(3), [scale * BASELINE_M, 0, 0]))


def find(left, right, cameras=None, settings=None):
    return Pipeline(cameras or rig(), settings or BOTH_WAYS).step(StereoPair(left, right))[0].obstacles


def overlap(a, b):
    a, b = np.array(a, float), np.array(b, float)
    common = np.prod(np.maximum(np.minimum(a[2:], b[2:]) - np.maximum(a[:2], b[:2]), 0))
    return common / (np.prod(a[2:] - a[:2]) + np.prod(b[2:] - b[:2]) - common)


def at(obstacles, box_px):
    """Return the obstacle at a box; there must be one."""
    best = max(obstacles, key=lambda obstacle: overlap(obstacle.box_px, box_px))
    assert overlap(best.box_px, box_px) > 0.4
    return best


@pytest.fixture(scope="module")
def streets():
    """Boxes and persons at 5 and 10 m, without noise: (picture, boxes)."""
    pictures = [render(demo_street(seed), rig(), noise=0.0) for seed in (0, 1)]
    return [(picture.pair, [true.box_px for true in picture.objects if true.range_m < 12]) for picture in pictures]


@pytest.fixture(scope="module")
def found(streets):
    """What is found in them: in each street four obstacles."""
    return [[at(find(pair.left, pair.right), box) for box in boxes] for pair, boxes in streets]


def test_a_mirrored_pair_with_its_cameras_exchanged_gives_mirrored_obstacles(streets, found):
    for (pair, _), obstacles in zip(streets, found, strict=True):
        left, right = (np.ascontiguousarray(image[:, ::-1]) for image in (pair.right, pair.left))
        mirrored = find(left, right, rig(WIDTH - 1 - CX_PX))
        for obstacle in obstacles:
            u0, v0, u1, v1 = obstacle.box_px
            d_px = obstacle.uvd_px[2]
            twin = at(mirrored, (WIDTH - u1 + d_px, v0, WIDTH - u0 + d_px, v1))
            assert twin.uvd_px[2] == pytest.approx(d_px, abs=0.05)
            side_m = 2 * CELL_PX * obstacle.range_m / F_PX
            assert twin.position_m[1] == pytest.approx(-obstacle.position_m[1], abs=side_m)


def scaled(settings, scale):
    """Return the settings with every length in metres scaled."""
    values = settings.model_dump()
    for section in ("ground", "segment"):
        for name, value in values[section].items():
            if name.endswith("_m"):
                values[section][name] = tuple(scale * v for v in value) if isinstance(value, tuple) else scale * value
    return Settings.model_validate(values)


@pytest.mark.parametrize("scale", [0.5, 1.7, 4.0])
def test_a_scaled_world_gives_scaled_ranges(streets, found, scale):
    """A world and a baseline of twice the size make the very same images."""
    for (pair, _), obstacles in zip(streets, found, strict=True):
        larger = find(pair.left, pair.right, rig(scale=scale), scaled(BOTH_WAYS, scale))
        for obstacle in obstacles:
            twin = at(larger, obstacle.box_px)
            assert twin.range_m == pytest.approx(scale * obstacle.range_m, rel=1e-6)
            np.testing.assert_allclose(twin.position_m, scale * obstacle.position_m, rtol=1e-3, atol=1e-3 * scale)
            assert twin.range_sigma_m == pytest.approx(scale * obstacle.range_sigma_m, rel=1e-6)


@pytest.fixture(scope="module")
def dark(streets):
    """The streets a little darker, so that no gain cuts anything off at white: that would be lost, not amplified."""
    return [((0.8 * pair.left, 0.8 * pair.right), boxes) for pair, boxes in streets]


@pytest.fixture(scope="module")
def found_dark(dark):
    return [find(levels(left), levels(right)) for (left, right), _ in dark]


def levels(image):
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("gains", [(1, 0.8), (1, 0.9), (1, 1.1), (1, 1.25), (0.8, 1), (1.25, 1)])
def test_the_gain_of_one_camera_does_not_move_a_range(dark, found_dark, gains):
    for ((left, right), boxes), plain in zip(dark, found_dark, strict=True):
        gained = find(levels(gains[0] * left), levels(gains[1] * right))
        for box in boxes:
            assert at(gained, box).range_m == pytest.approx(at(plain, box).range_m, rel=0.005)


def test_more_noise_means_a_larger_sigma(streets):
    pair, boxes = streets[0]
    strengths = (0, 1, 2, 3, 5, 8, 12)
    rng = np.random.default_rng(7)
    sigmas_px = []
    for strength in strengths:
        obstacles = find(*(levels(view + rng.normal(0, strength, view.shape)) for view in (pair.left, pair.right)))
        sigmas_px.append([np.sqrt(at(obstacles, box).cov_uvd_px2[2, 2]) for box in boxes])
    for per_strength in np.transpose(sigmas_px):
        assert spearmanr(strengths, per_strength)[0] >= 0.9
