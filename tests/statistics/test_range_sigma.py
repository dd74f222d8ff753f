"""The stated sigma of a range, as detected, against the errors made on simulated streets."""

import numpy as np
import pytest

from roadblock.config import load_settings
from roadblock.geometry.pose import pose
from roadblock.pipeline import Pipeline
from roadblock.sim.render import Rendered, render
from roadblock.sim.scene import Road, Scene, camera_pose
from roadblock.sim.solids import Thing, placed
from roadblock.sim.things import crate, person
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.scene import Obstacle

SEEDS = range(6)
CAMERA = Camera((640, 360), 520.0, 520.0, 327.3, 171.6)
RIG = StereoRig(CAMERA, CAMERA, pose(np.eye(3), [0.205, 0, 0]))


def things(rng: np.random.Generator) -> tuple[Thing, ...]:
    """Five crates and persons between 5 and 18 m, each in a sector of its own."""
    made = []
    for number, slope in enumerate(np.linspace(-0.42, 0.42, 5), 1):
        ahead = rng.uniform(5, 18)
        left = ahead * (slope + rng.uniform(-0.04, 0.04))
        rgb = tuple(int(level) for level in rng.integers(40, 210, 3))
        size = (rng.uniform(0.6, 1.2), np.clip(ahead * rng.uniform(0.08, 0.12), 0.4, 1.3), rng.uniform(0.6, 1.3))
        thing = crate(number, "", rgb, size) if number % 2 else person(number, "", rgb, rgb, rng.uniform(1.6, 1.9))
        made.append(placed(thing, ahead, left, rng.uniform(-0.3, 0.3)))
    return tuple(made)


def overlap(a: tuple[int, ...], b: tuple[int, ...]) -> float:
    common = max(0, min(a[2], b[2]) - max(a[0], b[0])) * max(0, min(a[3], b[3]) - max(a[1], b[1]))
    return common / ((a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common)


def errors(rendered: Rendered, obstacles: tuple[Obstacle, ...]) -> list[tuple[float, float, float]]:
    """Return (true range, error, stated sigma) of each true object that one obstacle covers."""
    found = []
    for true in rendered.objects:
        best = max(obstacles, key=lambda o: overlap(o.box_px, true.box_px))
        if overlap(best.box_px, true.box_px) > 0.5:
            found.append((true.range_m, best.range_m - true.range_m, best.range_sigma_m))
    return found


@pytest.fixture(scope="module")
def measured() -> np.ndarray:
    """Return (n, 3): true range, error, stated sigma."""
    pipeline = Pipeline(RIG, load_settings())
    rows = []
    for seed in SEEDS:
        rng = np.random.default_rng(seed)
        scene = Scene(things(rng), Road(), camera_pose(1.4, rng.uniform(-0.02, 0.04)), seed=seed)
        rendered = render(scene, RIG, quality="demo", seed=seed, threads=1)
        rows += errors(rendered, pipeline.step(rendered.pair)[0].obstacles)
    return np.array(rows)


def test_nearly_all_are_found(measured: np.ndarray) -> None:
    assert len(measured) >= 0.85 * 5 * len(SEEDS)


def test_errors_stay_within_two_stated_sigmas(measured: np.ndarray) -> None:
    _, error, sigma = measured.T
    assert (np.abs(error) < 2 * sigma).mean() >= 0.85
    assert (np.abs(error) < 4 * sigma).all()


def test_the_stated_sigma_is_neither_padded_nor_bare(measured: np.ndarray) -> None:
    """Root mean square of error over sigma: 0.54 over 16 seeds, for the street is cleaner than a real one."""
    _, error, sigma = measured.T
    assert 0.35 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.2


def test_sigma_grows_with_the_square_of_range(measured: np.ndarray) -> None:
    true, _, sigma = measured.T
    slope = np.polyfit(np.log(true), np.log(sigma), 1)[0]
    assert slope == pytest.approx(2, abs=0.35)  # smaller in the image, things also have fewer cells
