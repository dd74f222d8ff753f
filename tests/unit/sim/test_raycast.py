from itertools import pairwise

import numpy as np
import pytest

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.sim import raycast
from roadblock.sim.render import KINDS
from roadblock.sim.solids import Part

CROOKED = pose(rotation_from_rotvec([0.4, -0.9, 0.7]), [6.0, -0.5, 0.8])
HALF = {
    "box": (0.3, 0.5, 0.9),
    "ellipsoid": (0.3, 0.5, 0.9),
    "capsule": (0.4, 0.4, 0.7),
    "cylinder": (0.4, 0.4, 0.7),
    "cone": (0.6, 0.1, 0.7),
}


def row_of(shape):
    """A part as the kernels take it; only place, size and kind matter here."""
    row = np.zeros((1, 24))
    row[0, :15] = [*CROOKED[:3, 3], *CROOKED[:3, :3].ravel(), *HALF[shape]]
    row[0, 16] = KINDS[shape]
    return row


def inside(shape, points):
    """Negative inside the solid, 0 on its surface, positive outside: its definition."""
    half, p = np.array(HALF[shape]), transform(inverse(CROOKED), points)
    if shape == "box":
        return (np.abs(p) - half).max(-1)
    if shape == "ellipsoid":
        return np.linalg.norm(p / half, axis=-1) - 1
    if shape in ("cylinder", "cone"):
        flare = (half[1] - half[0]) / (2 * half[2])
        side = np.linalg.norm(p[..., :2], axis=-1) - (half[0] + half[1]) / 2 - flare * p[..., 2]
        # The distance from a cone's side is measured at right angles to it.
        return np.maximum(side / np.hypot(1, flare), np.abs(p[..., 2]) - half[2])
    p[..., 2] -= np.clip(p[..., 2], -half[2], half[2])
    return np.linalg.norm(p, axis=-1) - half[0]


@pytest.mark.parametrize("shape", HALF)
def test_rays_enter_where_the_solid_begins(shape):
    rng = np.random.default_rng(2)
    eye = np.array([0.1, 0.2, 1.4])
    ways = (CROOKED[:3, 3] + rng.normal(0, 0.8, (400, 3)) - eye) / 6
    t = np.array([raycast.hit(row_of(shape), 0, *eye, *way) for way in ways])
    met = np.isfinite(t)
    assert 50 < met.sum() < 350
    assert np.abs(inside(shape, eye + t[met, None] * ways[met])).max() < 1e-12
    along = np.linspace(0, 1, 500)[:, None, None]
    assert (inside(shape, eye + 0.999999 * along * t[met, None] * ways[met]) > 0).all()
    assert (inside(shape, eye + 2 * 6 * along * ways[~met]) > 0).all()


@pytest.mark.parametrize("shape", HALF)
def test_solids_behind_the_eye_are_not_met(shape):
    assert raycast.hit(row_of(shape), 0, 20.0, -0.5, 0.8, 1.0, 0.0, 0.0) == np.inf


@pytest.mark.parametrize("shape", ["box", "ellipsoid", "cylinder", "cone"])
def test_an_eye_inside_sees_out(shape):
    assert raycast.hit(row_of(shape), 0, *CROOKED[:3, 3], 1.0, 0.2, 0.1) == np.inf


@pytest.mark.parametrize("shape", HALF)
def test_normal_is_the_gradient_of_the_solid(shape):
    rng = np.random.default_rng(3)
    half = np.array(HALF[shape])
    way = rng.normal(size=(100, 3))
    start = 3 * way / np.linalg.norm(way, axis=1, keepdims=True)
    rows = row_of(shape)
    rows[0, :12] = [0, 0, 0, *np.eye(3).ravel()]
    goal = rng.uniform(-0.3, 0.3, (100, 3)) * half
    for o, d in zip(start, goal - start, strict=True):
        p = o + raycast.hit(rows, 0, *o, *d) * d
        world = transform(CROOKED, p + 1e-6 * np.concatenate([np.eye(3), -np.eye(3)]) @ np.eye(3))
        slope = inside(shape, world)
        gradient = slope[:3] - slope[3:]
        assert raycast.facing(rows, 0, *p) == pytest.approx(gradient / np.linalg.norm(gradient), abs=1e-5)


def test_axis_parallel_rays_meet_boxes_and_capsules():
    rows = row_of("box")
    rows[0, :12] = [5, 0, 1, *np.eye(3).ravel()]
    assert raycast.hit(rows, 0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0) == pytest.approx(4.7)
    assert raycast.hit(rows, 0, 0.0, 0.6, 1.0, 1.0, 0.0, 0.0) == np.inf
    rows = row_of("capsule")
    rows[0, :12] = [0, 0, 5, *np.eye(3).ravel()]
    assert raycast.hit(rows, 0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0) == pytest.approx(5 - 0.7 - 0.4 - 1)


def test_cylinders_and_cones_by_hand():
    rows = row_of("cone")
    rows[0, :12] = [5, 0, 1, *np.eye(3).ravel()]
    # Its radius is 0.35 halfway up, 0.6 at the foot, 0.1 at the top.
    assert raycast.hit(rows, 0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0) == pytest.approx(5 - 0.35)
    assert raycast.hit(rows, 0, 0.0, 0.0, 0.3, 1.0, 0.0, 0.0) == pytest.approx(5 - 0.6)
    assert raycast.hit(rows, 0, 0.0, 0.0, 1.7 + 1e-9, 1.0, 0.0, 0.0) == np.inf
    assert raycast.hit(rows, 0, 5.05, 0.0, 4.0, 0.0, 0.0, -1.0) == pytest.approx(4 - 1.7)
    assert raycast.hit(rows, 0, 5.35, 0.0, 4.0, 0.0, 0.0, -1.0) == pytest.approx(4 - 1.0)
    assert raycast.hit(rows, 0, 5.35, 0.0, -4.0, 0.0, 0.0, 1.0) == pytest.approx(4.3)
    # Along the side of a cone the quadratic term of the ray vanishes: 45 degrees here.
    rows[0, 12:15] = [1.2, 0.2, 0.5]
    assert raycast.hit(rows, 0, 5.0, 0.0, 3.0, -1.0, 0.0, -1.0) == np.inf
    assert raycast.hit(rows, 0, 3.0, 0.0, 2.0, 1.0, 0.0, -1.0) == pytest.approx(1.15)


@pytest.mark.parametrize(
    ("shape", "normal", "number"), [("cone", (0, 0, 1), 1), ("cone", (0, 0, -1), 2), ("cone", (1, 0, 0), 0)]
)
def test_flat_faces_have_numbers(shape, normal, number):
    assert raycast.face(row_of(shape), 0, *map(float, normal)) == number


def test_the_faces_of_a_box_differ():
    normals = [*np.eye(3), *-np.eye(3)]
    assert len({raycast.face(row_of("box"), 0, *way) for way in normals}) == 6
    assert {raycast.face(row_of(shape), 0, *normals[2]) for shape in ("ellipsoid", "capsule")} == {0}


def test_a_root_is_the_first_in_its_span():
    assert raycast.first_root(1.0, -2.0, 3.0, 0.0, 9.0) == pytest.approx(1)  # (t - 1)(t - 3)
    assert raycast.first_root(1.0, -2.0, 3.0, 1.5, 9.0) == pytest.approx(3)
    assert raycast.first_root(1.0, -2.0, 3.0, 3.5, 9.0) == np.inf
    assert raycast.first_root(1.0, 0.0, 1.0, -9.0, 9.0) == np.inf
    assert raycast.first_root(0.0, 0.5, -2.0, 0.0, 9.0) == pytest.approx(2)


@pytest.mark.parametrize("noise", [raycast.noise2, raycast.noise3])
def test_noise_is_smooth_bounded_and_about_zero(noise):
    rng = np.random.default_rng(5)
    count = 2 if noise is raycast.noise2 else 3
    at = rng.uniform(-400, 400, (20_000, count))
    here = np.array([noise(*p, 7) for p in at])
    there = np.array([noise(*p, 7) for p in at + 1e-4])
    assert np.abs(here).max() <= 1
    assert abs(here.mean()) < 0.02
    assert 0.3 < here.std() < 0.5
    assert np.abs(here - there).max() < 4e-3


def test_texture_has_about_unit_variance_near_and_fades_far():
    rng = np.random.default_rng(6)
    at = rng.uniform(-50, 50, (5000, 3))

    def spread(footprint_m):
        flat = [raycast.fractal2(x, y, 1.6, footprint_m, footprint_m, 3) for x, y, _ in at]
        solid = [raycast.fractal3(x, y, z, 0.4, footprint_m, 3) for x, y, z in at]
        return np.std(flat), np.std(solid)

    assert spread(0.001) == pytest.approx((1.2, 0.95), abs=0.2)
    assert spread(1.7) == (0, 0)


def test_texture_spectrum_falls_like_one_over_f():
    step = 0.01
    y, x = np.mgrid[:256, :256] * step
    image = np.vectorize(lambda x, y: raycast.fractal2(x, y, 1.6, 0.004, 0.004, 11))(x, y)
    window = np.hanning(256)
    power = np.abs(np.fft.fft2(image * window * window[:, None])) ** 2
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(256, step), np.fft.fftfreq(256, step)))
    bands = np.geomspace(1.5, 30, 9)
    mean = [power[(frequency >= a) & (frequency < b)].mean() for a, b in pairwise(bands)]
    slope = np.polyfit(np.log(np.sqrt(bands[:-1] * bands[1:])), np.log(mean), 1)[0]
    assert slope / 2 == pytest.approx(-1, abs=0.3)


def test_one_part_serves_python_and_kernel_alike():
    """The kernel's rows and the values describe the same solids: their extents agree."""
    part = Part("capsule", CROOKED, np.array(HALF["capsule"]), (9, 9, 9))
    top = CROOKED[2, 3] + part.reach(CROOKED[:3, :3].T)[2]
    low = part.half_m[2] * np.sign(CROOKED[2, 2]) * CROOKED[:3, 2] + CROOKED[:3, 3]
    assert raycast.hit(row_of("capsule"), 0, low[0], low[1], 9.0, 0.0, 0.0, -1.0) == pytest.approx(9 - top)
