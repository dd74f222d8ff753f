"""Where in a camera's image each solid may show, or throw its shadow: what keeps rays from asking every solid."""

import numpy as np
from numpy.typing import NDArray

from roadblock.geometry.projection import project
from roadblock.sim import raycast
from roadblock.values.camera import Camera
from roadblock.values.checks import FloatArray

NEAR_M = 0.05
"""What comes nearer than this to a camera is looked for in every pixel."""

FATTER_PX = 1.5
"""How far a solid is swollen for the question whether a pixel can touch it: more than half its diagonal."""

THIN_PX = 2.0
"""A solid thinner than this may slip between pixel centres."""

LENS_STEPS = 17
"""Points on each edge of a bounding box, for lenses that bend it; a pinhole needs the two ends."""

CONE = 3
"""Of the kinds of parts."""

CORNERS = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], float)
EDGES = np.array([(a, b) for a in range(8) for b in range(a) if np.abs(CORNERS[a] - CORNERS[b]).sum() == 2])
SWEPT_EDGES = np.concatenate([EDGES, EDGES + 8, [(a, a + 8) for a in range(8)]])


def candidates(
    part: FloatArray, reach_m: FloatArray, camera: Camera, T_camera_world: FloatArray, sun: FloatArray, lowest_m: float
) -> raycast.Candidates:
    """Return what each part can mean to one camera.

    Parameters
    ----------
    part
        (n, 24) as in `raycast.World`.
    reach_m
        (n, 3) half sizes of each part's own bounding box.
    camera, T_camera_world
        The camera, and the world's 4x4 pose in its frame.
    sun
        (3,) unit vector towards it.
    lowest_m
        Height down to which shadows fall.
    """
    R_world_part = part[:, 3:12].reshape(len(part), 3, 3)
    corners = (reach_m[:, None] * CORNERS) @ np.swapaxes(R_world_part, 1, 2) + part[:, None, :3]
    eye = -T_camera_world[:3, :3].T @ T_camera_world[:3, 3]
    slim = part[:, 12:15].copy()
    # A cone is as thin as its tip; the radii of all other shapes with two are equal.
    slim[part[:, 16] == CONE, :2] = slim[part[:, 16] == CONE, :2].min(1, keepdims=True)
    width_m = _narrowest(slim, (corners - eye) @ R_world_part)
    down = np.maximum(corners[..., 2:] - lowest_m, 0.0) / sun[2]
    swept = np.concatenate([corners, corners - down * sun], 1)
    corners, swept = (p @ T_camera_world[:3, :3].T + T_camera_world[:3, 3] for p in (corners, swept))
    far = _far(camera, corners).max(1)
    focal = min(camera.fx_px, camera.fy_px)
    fat = part.copy()
    fat[:, 12:15] += (FATTER_PX * far / focal)[:, None]
    near = _far(camera, corners).min(1) < NEAR_M + FATTER_PX * far / focal
    thin = width_m * focal < THIN_PX * far
    return raycast.Candidates(
        seen=_boxes(camera, corners, EDGES),
        dark=_boxes(camera, swept, SWEPT_EDGES),
        fat=fat,
        small=np.where(near, 2, np.where(thin, 1, 0)),
    )


def _narrowest(half_m: FloatArray, ways: FloatArray) -> FloatArray:
    """Return (n,) the smallest width of boxes with these half sizes (n, 3), seen along ways (n, m, 3) in their axes.

    A box's outline is a hexagon, narrowest at right angles to one of its sides: to the view and to an edge of the box.
    """
    across = np.cross(ways[:, :, None], np.eye(3))
    length = np.linalg.norm(across, axis=-1)
    width = 2 * (np.abs(across) * half_m[:, None, None]).sum(-1)
    # An edge seen end-on is no side of the outline.
    return np.asarray(np.where(length > 0, width / np.where(length > 0, length, 1.0), np.inf).min((1, 2)))


def _far(camera: Camera, points: FloatArray) -> FloatArray:
    """Return how far ahead points are; for a fisheye, how far away."""
    return np.asarray(np.linalg.norm(points, axis=-1) if camera.lens == "kannala_brandt" else points[..., 2])


def _boxes(camera: Camera, points: FloatArray, edges: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return (n, 4) half-open pixel boxes around bodies with these corners (n, m, 3) and edges.

    A body behind the camera has an empty one, a body around it that of the whole image and the pixels around that.
    """
    width, height = camera.size_px
    if camera.lens == "pinhole":
        around, outline = points[..., 2].min(1, initial=np.inf) < NEAR_M, points
    else:
        share = np.linspace(0.0, 1.0, LENS_STEPS)[:, None]
        ends = points[:, edges]
        outline = (ends[:, :, :1] * (1 - share) + ends[:, :, 1:] * share).reshape(
            len(points), len(edges) * LENS_STEPS, 3
        )
        middle = points.mean(1, keepdims=True)
        # Seen from near, even 17 points on an edge do not tell its course.
        around = np.linalg.norm(middle[:, 0], axis=1) < 2 * np.linalg.norm(points - middle, axis=2).max(1, initial=0.0)
    uv = project(camera, outline)
    lost = np.isnan(uv[..., 0])
    uv = np.clip(np.where(lost[..., None], 0.0, uv), -9.0, np.array([width, height]) + 9.0)
    low, high = np.floor(uv.min(1)) - 2, np.ceil(uv.max(1)) + 3
    boxes = np.concatenate([low, high], 1).astype(np.int64)
    boxes[around | lost.any(1)] = (-2, -2, width + 2, height + 2)
    boxes[lost.all(1) & (~around | (camera.lens == "pinhole"))] = 0
    return boxes
