"""How far the renderer's pictures are from the truth, in pixels: what the accuracy figures stand on.

All shifts are measured on linear light without noise, at "evidence" quality. The bar is 0.003 px.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, spline_filter
from scipy.ndimage import shift as moved

from roadblock.geometry.pose import pose
from roadblock.sim.render import QUALITIES, Quality, render_linear
from roadblock.sim.road import Road
from roadblock.sim.scene import Scene, camera_pose
from roadblock.sim.solids import Thing, box, placed
from roadblock.sim.things import person
from roadblock.values.camera import Camera, StereoRig

F_PX, BASELINE_M = 1033.0, 0.205
BAR_PX = 0.003
EVIDENCE = QUALITIES["evidence"]


def rig_of(width, height, cx_px, cy_px):
    camera = Camera((width, height), F_PX, F_PX, cx_px, cy_px)
    return StereoRig(camera, camera, pose(np.eye(3), [BASELINE_M, 0, 0]))


def wall_scene(depth_m, contrast=0.25):
    wall = placed(
        Thing(1, "wall", "grey", (box((0.1, 40.0, 40.0), (0, 0, 0), (150, 150, 150), contrast),)), depth_m, 0.0
    )
    return Scene((wall,), Road(), camera_pose(3.0), seed=4)


def wall_shift(seen, d_px):
    """Disparity of the wall by least squares on the whole patch, quintic interpolation, gradient of the template."""
    left, right = (side.light.astype(float).mean(2) for side in (seen.left, seen.right))
    rows, columns = slice(8, -8), slice(28, -8)
    right = spline_filter(right, 5)
    template, gradient = left[rows, columns], np.gradient(left, axis=1)[rows, columns]
    found = np.floor(d_px) + 0.5
    for _ in range(12):
        again = moved(right, (0, found), order=5, prefilter=False)[rows, columns]
        found += (gradient * (again - template)).sum() / (gradient**2).sum()
    return found


@pytest.mark.parametrize("d_px", [12.0, 12.2, 12.37, 12.5, 12.81, 7.77])
def test_a_textured_wall_is_shifted_by_its_disparity(d_px):
    scene, rig = wall_scene(F_PX * BASELINE_M / d_px), rig_of(200, 100, 90.3, 70.6)
    found = wall_shift(render_linear(scene, rig, quality="evidence"), d_px)
    assert found == pytest.approx(d_px, abs=BAR_PX)


@pytest.mark.parametrize("d_px", [12.2, 9.63])
def test_the_wall_of_the_demo_quality_is_right_as_well(d_px):
    scene, rig = wall_scene(F_PX * BASELINE_M / d_px), rig_of(200, 100, 90.3, 70.6)
    assert wall_shift(render_linear(scene, rig, quality="demo"), d_px) == pytest.approx(d_px, abs=2 * BAR_PX)


def walker(distance_m, left_m, yaw_rad, seed):
    """A person, and a rig whose images are cut close around it in both views."""
    thing = placed(person(1, "blue", (38, 70, 170), (44, 62, 122)), distance_m, left_m, np.pi + yaw_rad)
    scene = Scene((thing,), Road(), camera_pose(), seed=seed)
    half = 0.45 * F_PX / distance_m + BASELINE_M / 2 * F_PX / distance_m
    height = 2.1 * F_PX / distance_m
    return scene, rig_of(int(2 * half), int(height), half + left_m * F_PX / distance_m + 0.3, 0.28 * height)


def moved_by(light, truth, mask):
    """How far an image is shifted against the true one, by least squares in a mask."""
    gradient = np.gradient(truth, axis=1)[mask].ravel()
    return -(gradient @ (light - truth)[mask].ravel()) / (gradient @ gradient)


def disparity_error(seen, truth):
    shifts = []
    for side in ("left", "right"):
        got, true = getattr(seen, side), getattr(truth, side)
        shifts.append(moved_by(got.light, true.light, binary_dilation(true.ids == 1)))
    return shifts[0] - shifts[1]


@pytest.mark.parametrize("distance_m", [10.0, 20.0])
def test_a_person_has_no_bias_against_1024_samples(distance_m):
    errors = []
    for seed, (left_m, yaw_rad) in enumerate([(0.013, 0.4), (-0.127, -0.3)]):
        scene, rig = walker(distance_m, left_m, yaw_rad, seed)
        truth = render_linear(scene, rig, quality=Quality(16, 1024))
        errors.append(disparity_error(render_linear(scene, rig, quality="evidence"), truth))
    assert np.abs(errors).max() < BAR_PX


def test_twice_the_samples_change_less_than_a_tenth_of_sigma():
    """Sigma is the bound of a shift from this texture with 1.5 grey levels of noise in both images.

    On the person it is that of all its pixels and a known background, so the smallest there can be.
    """
    scene, rig = walker(10.0, 0.1, 0.2, 3)
    once, twice = (render_linear(scene, rig, quality=Quality(n * EVIDENCE.inner, n * EVIDENCE.mixed)) for n in (1, 2))
    mask = binary_dilation(once.left.ids == 1)
    grey = 255 * np.clip(twice.left.light.mean(2), 0, 1) ** (1 / 2.2)
    sigma = np.sqrt(2) * 1.5 / np.sqrt((np.gradient(grey, axis=1)[mask] ** 2).sum())
    assert abs(disparity_error(once, twice)) < 0.1 * max(sigma, 0.01)
    scene, rig = wall_scene(F_PX * BASELINE_M / 12.37), rig_of(200, 100, 90.3, 70.6)
    once, twice = (render_linear(scene, rig, quality=Quality(n * EVIDENCE.inner, n * EVIDENCE.mixed)) for n in (1, 2))
    grey = 255 * np.clip(twice.left.light.mean(2), 0, 1)[8:-8, 28:-8] ** (1 / 2.2)
    sigma = np.sqrt(2) * 1.5 / np.sqrt((np.gradient(grey, axis=1) ** 2).sum())
    assert abs(wall_shift(once, 12.37) - wall_shift(twice, 12.37)) < 0.1 * sigma


def card_edges(slope, share, samples):
    """Measured and exact coverage of pixels along a straight edge, `slope` columns per row."""
    height, depth_m = 41, 5.0
    rig = rig_of(60, height, 30.0, 20.0)
    turn = -np.arctan(slope)
    axis = np.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]])
    # The left camera sees the edge pass through (30 + share, 20).
    edge_m = BASELINE_M / 2 - share * depth_m / F_PX
    card = Thing(1, "card", "", (box((0.02, 1.0, 3.0), (0, 0, 0), (230, 230, 230), 0.0),))
    centre = np.array([depth_m + 0.01, edge_m, 3.0]) - axis @ [0, 0.5, 0]
    card = replace(card, T_world_thing=pose(axis, centre))
    wall = placed(Thing(2, "wall", "", (box((0.1, 40.0, 40.0), (0, 0, 0), (40, 40, 40), 0.0),)), 30.0, 0.0)
    sun = np.array([-1.0, 0.01, 0.2])
    light = render_linear(Scene((card, wall), Road(), camera_pose(3.0), sun), rig, quality=samples).left.light[..., 1]
    measured = (light - light[:, :1]) / (light[:, -1:] - light[:, :1])
    # Exact by integrating the clipped distance to the edge over the rows of each pixel.
    sub = (np.arange(2000) + 0.5) / 2000 - 0.5
    u, v = np.meshgrid(np.arange(60.0), np.arange(float(height)))
    places = 30 + share + slope * (v[..., None] + sub - 20.0)
    exact = np.clip(u[..., None] + 0.5 - places, 0, 1).mean(-1)
    return measured, exact


@pytest.mark.parametrize("slope", [0.0, 0.013, 0.3, 1.0])
@pytest.mark.parametrize("share", [0.03, 0.26, 0.61])
def test_edges_cover_pixels_exactly(slope, share):
    measured, exact = card_edges(slope, share, EVIDENCE)
    assert np.abs(measured - exact).max() < 0.05
    # The place of the edge in a row is the sum of what is covered.
    place = (exact - measured).sum(1)
    assert abs(place.mean()) < BAR_PX
    assert place.std() < 0.02


def test_edges_of_the_demo_quality_are_as_good_as_four_samples():
    measured, exact = card_edges(0.3, 0.26, "demo")
    assert (exact - measured).sum(1).std() < 0.12


def pole_light(width_m, distance_m, left_m):
    pole = placed(
        Thing(1, "pole", "", (box((0.03, width_m, 3.0), (0, 0, 1.5), (230, 230, 230), 0.0),)), distance_m, left_m
    )
    wall = placed(Thing(2, "wall", "", (box((0.1, 90.0, 90.0), (0, 0, 0), (40, 40, 40), 0.0),)), 90.0, 0.0)
    scene = Scene((pole, wall), Road(), camera_pose(), np.array([-1.0, 0.3, 0.5]))
    # With one ray in smooth pixels nothing but the care for thin things can find it.
    seen = render_linear(scene, rig_of(40, 30, 19.7, 15.2), quality=Quality(1, EVIDENCE.mixed))
    return [side.light[3:14, :, 1].astype(float) for side in (seen.left, seen.right)]


def test_a_thin_pole_keeps_its_width_and_place():
    """3 cm at 60 m is half a pixel: pixel centres miss it in one of the cameras, its light must still be there."""
    distance_m, left_m, u = 60.0, 0.0371, np.arange(40)
    thin, thick = pole_light(0.03, distance_m, left_m), pole_light(0.6, distance_m, left_m)
    for light, full, at in zip(thin, thick, (-BASELINE_M / 2, BASELINE_M / 2), strict=True):
        dark, middle = light[:, :3].mean(), 19.7 - (left_m + at) / distance_m * F_PX
        covered = (light - dark).mean(0) / (full[:, round(middle)].mean() - dark)
        half = 0.015 / distance_m * F_PX
        exact = np.clip(np.minimum(u + 0.5, middle + half) - np.maximum(u - 0.5, middle - half), 0, 1)
        assert covered == pytest.approx(exact, abs=0.01)
