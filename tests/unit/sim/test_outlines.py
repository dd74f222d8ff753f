import numpy as np
import pytest

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project
from roadblock.sim.outlines import candidates
from roadblock.values.camera import Camera

CAMERA = Camera((97, 61), 80.0, 84.0, 51.3, 27.6)
LENSES = {
    "pinhole": CAMERA,
    "brown_conrady": Camera(
        (97, 61), 80.0, 84.0, 51.3, 27.6, "brown_conrady", np.array([-0.25, 0.06, 0.002, -0.003, 0])
    ),
    "kannala_brandt": Camera((97, 61), 40.0, 41.0, 51.3, 27.6, "kannala_brandt", np.array([-0.02, 0.004, -0.002, 0])),
}
SUN = np.array([0.3, -0.5, 0.4]) / np.linalg.norm([0.3, -0.5, 0.4])
T_WORLD_CAMERA = pose(
    np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]) @ rotation_from_rotvec([0.05, 0.1, -0.04]), [0, 0, 1.3]
)


def boxes_of(rng, count=60):
    """Rows of boxes, small to long, around the camera."""
    rows = np.zeros((count, 24))
    for row in rows:
        row[:3] = rng.uniform((-5, -12, 0), (30, 12, 3))
        row[3:12] = rotation_from_rotvec(rng.normal(size=3)).ravel()
        row[12:15] = rng.uniform(0.02, 0.6, 3) * rng.choice([1, 8], p=[0.8, 0.2])
    return rows


def surface(row, rng, count=3000):
    way = rng.uniform(-1, 1, (count, 3))
    way /= np.abs(way).max(1, keepdims=True)
    return transform(pose(row[3:12].reshape(3, 3), row[:3]), way * row[12:15])


@pytest.mark.parametrize("lens", LENSES)
def test_boxes_hold_all_that_is_seen_of_a_part_and_of_its_shadow(lens):
    rng = np.random.default_rng(7)
    rows, camera, T_camera_world = boxes_of(rng), LENSES[lens], inverse(T_WORLD_CAMERA)
    found = candidates(rows, rows[:, 12:15], camera, T_camera_world, SUN, -0.5)
    seen_at_all, empty = 0, 0
    for row, seen, dark in zip(rows, found.seen, found.dark, strict=True):
        points = surface(row, rng)
        fall = rng.uniform(0, 1, (len(points), 1)) * np.maximum(points[:, 2:] + 0.5, 0) / SUN[2]
        for box, cloud in ((seen, points), (dark, points - fall * SUN)):
            uv = project(camera, transform(T_camera_world, cloud))
            uv = uv[(np.abs(uv - (48, 30)) <= (49, 31)).all(1)]
            assert (uv >= box[:2] + 0.5).all()
            assert (uv <= box[2:] - 1.5).all()
            seen_at_all += bool(len(uv))
        empty += seen[0] == seen[2]
    assert seen_at_all > 40
    assert empty > 2 or lens == "kannala_brandt"
    # Most parts are looked for in a part of the image alone.
    assert ((found.seen[:, 2] - found.seen[:, 0]) < 90).mean() > 0.5


def test_a_plate_is_thin_from_its_edge_and_not_from_its_face():
    rows = np.zeros((3, 24))
    for row, half in zip(rows, [(0.01, 1, 1), (1, 0.01, 1), (0.6, 0.6, 0.6)], strict=True):
        row[:3], row[3:12], row[12:15] = (20.0, 0.0, 1.3), np.eye(3).ravel(), half
    level = pose(np.array([[0, 0, 1.0], [-1, 0, 0], [0, -1, 0]]), [0, 0, 1.3])
    assert candidates(rows, rows[:, 12:15], CAMERA, inverse(level), SUN, 0.0).small.tolist() == [0, 1, 0]
    rows[2, 12:15], rows[2, 16] = (0.6, 0.01, 0.6), 3
    assert candidates(rows, rows[:, 12:15], CAMERA, inverse(level), SUN, 0.0).small.tolist() == [0, 1, 1]
    rows[:, 0] = 0.05
    assert candidates(rows, rows[:, 12:15], CAMERA, inverse(level), SUN, 0.0).small.tolist() == [2, 2, 2]


def test_a_world_without_parts_has_no_candidates():
    for camera in LENSES.values():
        found = candidates(np.zeros((0, 24)), np.zeros((0, 3)), camera, inverse(T_WORLD_CAMERA), SUN, 0.0)
        assert found.seen.shape == found.dark.shape == (0, 4)
