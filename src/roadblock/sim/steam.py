"""Steam: clouds that take light away and add their own."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from roadblock.geometry.pose import pose
from roadblock.sim.solids import Part, Thing, ellipsoid
from roadblock.values.checks import FloatArray

THICKNESS, FADE_M = 0.6, 1.2
"""Optical thickness of a fresh puff through its middle; after so much way, a puff has 1/e of that."""
BRIGHTNESS = 0.75
"""Of thick steam in the sun."""
PUFFS, LEAST_M, GROWTH = 16, 0.16, 0.22
"""Sigma of a fresh puff, and by how much it grows on each metre of its way."""
WAY_M = 3.0
"""So far puffs come before they are gone."""
SPEED_MPS = 0.7


def steam(rng: np.random.Generator) -> Thing:
    """Return a manhole's cloud at the world's origin: it rises, leans, grows and thins, and there is always new one."""
    aside = rng.uniform(-0.5, 0.5, 2)
    rise = np.array([*aside, 1.0]) / np.linalg.norm([*aside, 1.0])
    off, begun = rng.normal(0, 0.12, (PUFFS, 3)), (np.arange(PUFFS) + rng.random(PUFFS)) * WAY_M / PUFFS

    def puffs(gone_m: float) -> tuple[Part, ...]:
        way = (begun + gone_m) % WAY_M
        at = (way - gone_m)[:, None] * rise + off
        return tuple(
            ellipsoid(np.full(3, 2 * (LEAST_M + GROWTH * s)), p, (255, 255, 255)) for p, s in zip(at, way, strict=True)
        )

    return Thing(0, "steam", "white", puffs(0.0), pose(np.eye(3), np.zeros(3)), SPEED_MPS * rise, 0.0, puffs)


def veiled(light: NDArray[np.float32], far_m: FloatArray, ways: FloatArray, eye_m: FloatArray, cloud: Thing) -> None:
    """Put a cloud before what a camera sees, in place.

    Parameters
    ----------
    light
        (h, w, 3) linear.
    far_m, ways
        (h, w) distance along each pixel's ray, and (h, w, 3) its unit vector in the world.
    eye_m
        (3,) the camera in the world.
    cloud
        Its parts are puffs: balls of Gaussian density, two sigmas to each side.
    """
    thickness = np.zeros(far_m.shape)
    for part in cloud.parts:
        sigma = part.half_m[0] / 2
        to = cloud.T_world_thing[:3, 3] + part.T_thing_part[:3, 3] - eye_m
        nearest = ways @ to
        apart2 = to @ to - nearest**2
        near = apart2 < (4 * sigma) ** 2
        t, way_m = nearest[near], max(0.0, (sigma - LEAST_M) / GROWTH)
        inside = ndtr((far_m[near] - t) / sigma) - ndtr(-t / sigma)
        thickness[near] += THICKNESS * np.exp(-way_m / FADE_M - apart2[near] / (2 * sigma**2)) * inside
    through = np.exp(-thickness)[..., None].astype(np.float32)
    light *= through
    light += np.float32(BRIGHTNESS) * (1 - through)
