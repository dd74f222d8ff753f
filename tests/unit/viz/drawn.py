"""A small crooked scene to draw: off-centre rig, tilted road, a few obstacles."""

import math

import numpy as np

from roadblock.geometry.stereo import image_from_car
from roadblock.values.camera import Rectification
from roadblock.values.scene import FrameResult, FreeSpace, GroundPlane, Health, Obstacle


def rig_of(width: int, height: int) -> Rectification:
    return Rectification(0.8 * width, 0.47 * width, 0.41 * height, 0.31, (width, height))


def obstacle_at(rig: Rectification, x: float, z: float, sigma: float = 0.2, **changes) -> Obstacle:
    """An obstacle 1.8 m wide and 1.5 m high on a road 1.6 m below the cameras."""
    u0, v0, _ = image_from_car(rig, [x - 0.9, 0.1, z])
    u1, v1, d = image_from_car(rig, [x + 0.9, 1.6, z])
    box = (int(u0), int(v0), int(u1) + 1, int(v1) + 1)
    fields = {
        "position_m": np.array([z, -x, -1.6]),
        "range_m": z,
        "range_sigma_m": sigma,
        "size_m": np.array([1.8, 1.5, math.nan]),
        "uvd_px": np.array([(u0 + u1) / 2, (v0 + v1) / 2, d]),
        "cov_uvd_px2": np.eye(3),
        "cov_match_m2": np.eye(3),
        "box_px": box,
        "contour_px": np.array([[box[0], box[1]], [box[2], box[1]], [box[2], box[3]], [box[0], box[3]]], np.int32),
        "color": "red",
    }
    return Obstacle(**(fields | changes))


def result_of(rig: Rectification, *obstacles: Obstacle, **changes) -> FrameResult:
    u = np.arange(3.5, rig.size_px[0], 8)
    normal = np.array([0.03, -1.0, -0.02])
    fields = {
        "index": 0,
        "name": "000007",
        "t_ns": 0,
        "obstacles": obstacles,
        "free_space": FreeSpace(u, np.full(len(u), 15.0)),
        "ground": GroundPlane(normal / np.linalg.norm(normal), 1.6, bend_per_m=0.001),
        "health": Health(),
        "timings_ms": {"total": 12.0},
    }
    return FrameResult(**(fields | changes))
