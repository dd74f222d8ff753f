"""What the world is made of: solids with exact surfaces, joined to things.

Frames: `world` (x forward, y left, z up, origin on the road), `thing` (the same axes, its origin on the ground under
it, x where it faces), `part` (its own axes).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.values.checks import FloatArray, finite, rigid_transform

Shape = Literal["box", "ellipsoid", "capsule"]
Pattern = Literal["plain", "crate", "windows"]
Rgb = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Part:
    """One solid of a thing.

    Attributes
    ----------
    shape
        "box", "ellipsoid" or "capsule" (a cylinder along the part's z with round ends).
    T_thing_part
        4x4 pose of the part in its thing, metres.
    half_m
        (3,) half sizes of a box, half axes of an ellipsoid; for a capsule (radius, radius, half length of the
        cylinder between the centres of its ends).
    rgb
        Base colour, sRGB 0..255.
    contrast
        Standard deviation of the texture, as a share of the base colour; 0 = smooth paint.
    pattern
        What is drawn on the texture: nothing, the boards of a crate, the windows of a house.

    Raises
    ------
    ValueRefusedError
        If a name is unknown, a size not positive, a colour outside 0..255, or the contrast outside 0..1.
    """

    shape: Shape
    T_thing_part: FloatArray
    half_m: FloatArray
    rgb: Rgb
    contrast: float = 0.15
    pattern: Pattern = "plain"

    def __post_init__(self) -> None:
        for name, value, known in (("shape", self.shape, Shape), ("pattern", self.pattern, Pattern)):
            if value not in get_args(known):
                raise ValueRefusedError(f"{name} must be one of {', '.join(get_args(known))}, but got {value!r}")
        object.__setattr__(self, "T_thing_part", rigid_transform("T_thing_part", self.T_thing_part))
        half = finite("half_m", self.half_m, (3,))
        if (half <= 0).any():
            raise ValueRefusedError(f"half_m must be > 0, but got {half.tolist()}")
        object.__setattr__(self, "half_m", half)
        rgb = finite("rgb", self.rgb, (3,))
        if (rgb < 0).any() or (rgb > 255).any():
            raise ValueRefusedError(f"rgb must lie in 0..255, but got {self.rgb}")
        if not 0 <= float(finite("contrast", self.contrast, ())) <= 1:
            raise ValueRefusedError(f"contrast must lie in 0..1, but got {self.contrast}")

    def reach(self, R_part_axes: FloatArray) -> FloatArray:
        """Return (3,) how far the solid reaches from its centre along each column of a 3x3 rotation, metres."""
        if self.shape == "box":
            return np.asarray(self.half_m @ np.abs(R_part_axes))
        if self.shape == "ellipsoid":
            return np.asarray(np.linalg.norm(self.half_m[:, None] * R_part_axes, axis=0))
        return np.asarray(self.half_m[2] * np.abs(R_part_axes[2]) + self.half_m[0])


@dataclass(frozen=True, eq=False)
class Thing:
    """Something that stands in the world.

    Attributes
    ----------
    id
        Its number in the id map, >= 1 and unique in a scene; 0 = scenery, which has a disparity but no name.
    type, color
        What it is and the name of its main colour, as a person would say it.
    parts
        Its solids; they may overlap.
    T_world_thing
        4x4 pose, metres.

    Raises
    ------
    ValueRefusedError
        If the id is negative, there is no part, or the pose is no rigid transform.
    """

    id: int
    type: str
    color: str
    parts: tuple[Part, ...]
    T_world_thing: FloatArray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        if self.id < 0:
            raise ValueRefusedError(f"id must be >= 0, but got {self.id}")
        if not self.parts:
            raise ValueRefusedError(f"{self.type} {self.id} must have at least one part, but has none")
        object.__setattr__(self, "T_world_thing", rigid_transform("T_world_thing", self.T_world_thing))

    def bounds_m(self, T_a_thing: FloatArray) -> FloatArray:
        """Return the (2, 3) exact lower and upper bounds along the axes of frame a, given its pose there, metres."""
        poses = [T_a_thing @ part.T_thing_part for part in self.parts]
        reach = np.array([part.reach(T[:3, :3].T) for part, T in zip(self.parts, poses, strict=True)])
        centres = np.array([T[:3, 3] for T in poses])
        return np.stack([(centres - reach).min(0), (centres + reach).max(0)])

    @property
    def size_m(self) -> FloatArray:
        """(3,) width, height, length along its own axes, metres."""
        length, width, height = np.ptp(self.bounds_m(np.eye(4)), axis=0)
        return np.array([width, height, length])


def box(size_m: ArrayLike, centre_m: ArrayLike, rgb: Rgb, contrast: float = 0.15, pattern: Pattern = "plain") -> Part:
    """Return a box of (length, width, height) along x, y, z of its thing."""
    return Part("box", pose(np.eye(3), centre_m), np.asarray(size_m, float) / 2, rgb, contrast, pattern)


def ellipsoid(half_m: ArrayLike, centre_m: ArrayLike, rgb: Rgb, contrast: float = 0.15) -> Part:
    """Return an ellipsoid with half axes along x, y, z of its thing."""
    return Part("ellipsoid", pose(np.eye(3), centre_m), np.asarray(half_m, float), rgb, contrast)


def capsule(start_m: ArrayLike, end_m: ArrayLike, radius_m: float, rgb: Rgb, contrast: float = 0.15) -> Part:
    """Return a capsule between the centres of its round ends."""
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    length = float(np.linalg.norm(end - start))
    z = (end - start) / length
    across = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x = across / np.linalg.norm(across)
    R = np.stack([x, np.cross(z, x), z], 1)
    return Part("capsule", pose(R, (start + end) / 2), np.array([radius_m, radius_m, length / 2]), rgb, contrast)


def placed(thing: Thing, nearest_m: float, left_m: float, yaw_rad: float = 0.0) -> Thing:
    """Return the thing standing on the road, its nearest point exactly `nearest_m` ahead of the world's origin.

    Parameters
    ----------
    thing
        What to place; its own pose is forgotten.
    nearest_m
        Smallest x of its surface, metres.
    left_m
        y of its origin, metres.
    yaw_rad
        Its turn about the vertical, radians; 0 = facing away, like traffic ahead.
    """
    R = rotation_from_rotvec([0.0, 0.0, yaw_rad])
    low = thing.bounds_m(pose(R, np.zeros(3)))[0]
    return replace(thing, T_world_thing=pose(R, [nearest_m - low[0], left_m, -low[2]]))


def corners_m(part: Part, T_a_thing: FloatArray) -> FloatArray:
    """Return the (8, 3) corners of the part's own bounding box in frame a, metres."""
    signs: Sequence[tuple[int, int, int]] = [(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)]
    return transform(T_a_thing @ part.T_thing_part, np.array(signs) * part.reach(np.eye(3)))
