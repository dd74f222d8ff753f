"""What the world is made of: solids with exact surfaces, joined to things.

Frames: `world` (x forward, y left, z up, origin on the road), `thing` (the same axes, its origin on the ground under
it, x where it faces), `part` (its own axes).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.values.checks import FloatArray, finite, locked, rigid_transform

Shape = Literal["box", "ellipsoid", "capsule", "cylinder", "cone"]
Pattern = Literal["plain", "crate", "windows"]
Rgb = tuple[int, int, int]


@dataclass(frozen=True, eq=False)
class Part:
    """One solid of a thing.

    Attributes
    ----------
    shape
        "box"; "ellipsoid"; and along the part's z: "capsule" (a cylinder with round ends), "cylinder" (flat ends),
        "cone" (flat ends, truncated).
    T_thing_part
        4x4 pose of the part in its thing, metres.
    half_m
        (3,) half sizes of a box, half axes of an ellipsoid; else (radius at the lower end, radius at the upper end,
        half length between the centres of the ends). The two radii differ in a cone only.
    rgb
        Base colour, sRGB 0..255.
    contrast
        Standard deviation of the texture, as a share of the base colour; 0 = smooth paint.
    pattern
        What is drawn on the texture: nothing, the boards of a crate, the windows of a house.

    Raises
    ------
    ValueRefusedError
        If a name is unknown, a size not positive, the radii of a capsule or cylinder differ, a colour lies outside
        0..255, or the contrast outside 0..1.
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
        if self.shape in ("capsule", "cylinder") and half[0] != half[1]:
            raise ValueRefusedError(f"a {self.shape} has one radius, but got {half[0]:g} and {half[1]:g} m")
        object.__setattr__(self, "half_m", half)
        rgb = finite("rgb", self.rgb, (3,))
        if (rgb < 0).any() or (rgb > 255).any():
            raise ValueRefusedError(f"rgb must lie in 0..255, but got {self.rgb}")
        if not 0 <= float(finite("contrast", self.contrast, ())) <= 1:
            raise ValueRefusedError(f"contrast must lie in 0..1, but got {self.contrast}")

    def reach(self, R_part_axes: FloatArray) -> FloatArray:
        """Return (3,) how far the solid reaches from its centre along each column of a 3x3 matrix of unit vectors, m.

        The columns need not be at right angles. How far it reaches the other way is `reach(-R_part_axes)`.
        """
        if self.shape == "box":
            return np.asarray(self.half_m @ np.abs(R_part_axes))
        if self.shape == "ellipsoid":
            return np.asarray(np.linalg.norm(self.half_m[:, None] * R_part_axes, axis=0))
        if self.shape == "capsule":
            return np.asarray(self.half_m[2] * np.abs(R_part_axes[2]) + self.half_m[0])
        up = self.half_m[2] * R_part_axes[2]
        lower, upper = self.half_m[:2, None] * np.hypot(R_part_axes[0], R_part_axes[1])
        return np.asarray(np.maximum(lower - up, upper + up))


Gait = Callable[[float], tuple[Part, ...]]


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
    velocity_mps
        (3,) of its origin, along the axes of the world.
    yaw_rate_radps
        How fast it turns about the world's vertical, > 0 = to the left; its velocity turns with it.
    gait
        Its parts after so many metres of way, for what walks; None = they do not change.
    gone_m
        The way it has gone.

    Raises
    ------
    ValueRefusedError
        If the id is negative, there is no part, the pose is no rigid transform, or a motion is not finite.
    """

    id: int
    type: str
    color: str
    parts: tuple[Part, ...]
    T_world_thing: FloatArray = field(default_factory=lambda: np.eye(4))
    velocity_mps: FloatArray = field(default_factory=lambda: np.zeros(3))
    yaw_rate_radps: float = 0.0
    gait: Gait | None = None
    gone_m: float = 0.0

    def __post_init__(self) -> None:
        if self.id < 0:
            raise ValueRefusedError(f"id must be >= 0, but got {self.id}")
        if not self.parts:
            raise ValueRefusedError(f"{self.type} {self.id} must have at least one part, but has none")
        object.__setattr__(self, "T_world_thing", rigid_transform("T_world_thing", self.T_world_thing))
        object.__setattr__(self, "velocity_mps", finite("velocity_mps", self.velocity_mps, (3,)))
        finite("yaw_rate_radps", self.yaw_rate_radps, ())
        finite("gone_m", self.gone_m, ())

    def bounds_m(self, T_a_thing: FloatArray) -> FloatArray:
        """Return the (2, 3) exact lower and upper bounds along the axes of frame a, given its pose there, metres."""
        poses = [T_a_thing @ part.T_thing_part for part in self.parts]
        low = [T[:3, 3] - part.reach(-T[:3, :3].T) for part, T in zip(self.parts, poses, strict=True)]
        high = [T[:3, 3] + part.reach(T[:3, :3].T) for part, T in zip(self.parts, poses, strict=True)]
        return np.stack([np.min(low, axis=0), np.max(high, axis=0)])

    @cached_property
    def size_m(self) -> FloatArray:
        """(3,) width, height, length along its own axes, metres."""
        length, width, height = np.ptp(self.bounds_m(np.eye(4)), axis=0)
        return np.asarray(locked(np.array([width, height, length])))

    @cached_property
    def lowest_m(self) -> float:
        """Height of its lowest point in the world, metres."""
        return float(self.bounds_m(self.T_world_thing)[0, 2])


def box(size_m: ArrayLike, centre_m: ArrayLike, rgb: Rgb, contrast: float = 0.15, pattern: Pattern = "plain") -> Part:
    """Return a box of (length, width, height) along x, y, z of its thing."""
    return Part("box", pose(np.eye(3), centre_m), np.asarray(size_m, float) / 2, rgb, contrast, pattern)


def ellipsoid(half_m: ArrayLike, centre_m: ArrayLike, rgb: Rgb, contrast: float = 0.15) -> Part:
    """Return an ellipsoid with half axes along x, y, z of its thing."""
    return Part("ellipsoid", pose(np.eye(3), centre_m), np.asarray(half_m, float), rgb, contrast)


def capsule(start_m: ArrayLike, end_m: ArrayLike, radius_m: float, rgb: Rgb, contrast: float = 0.15) -> Part:
    """Return a capsule between the centres of its round ends."""
    return _along("capsule", start_m, end_m, (radius_m, radius_m), rgb, contrast)


def cylinder(start_m: ArrayLike, end_m: ArrayLike, radius_m: float, rgb: Rgb, contrast: float = 0.15) -> Part:
    """Return a cylinder between the centres of its flat ends."""
    return _along("cylinder", start_m, end_m, (radius_m, radius_m), rgb, contrast)


def cone(
    start_m: ArrayLike, end_m: ArrayLike, radius_start_m: float, radius_end_m: float, rgb: Rgb, contrast: float = 0.15
) -> Part:
    """Return a truncated cone between the centres of its flat ends; both radii > 0."""
    return _along("cone", start_m, end_m, (radius_start_m, radius_end_m), rgb, contrast)


def _along(
    shape: Shape, start_m: ArrayLike, end_m: ArrayLike, radii_m: tuple[float, float], rgb: Rgb, contrast: float
) -> Part:
    """Return a round part whose z runs from start to end."""
    start, end = np.asarray(start_m, float), np.asarray(end_m, float)
    length = float(np.linalg.norm(end - start))
    if not length > 0:
        raise ValueRefusedError(f"a {shape} must end elsewhere than it starts, but does both at {start.tolist()}")
    z = (end - start) / length
    across = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
    x = across / np.linalg.norm(across)
    R = np.stack([x, np.cross(z, x), z], 1)
    return Part(shape, pose(R, (start + end) / 2), np.array([*radii_m, length / 2]), rgb, contrast)


def xyz(x: float, y: float, z: float) -> FloatArray:
    """Return a point or a way as an array."""
    return np.array([x, y, z])


def slab(
    start_xz_m: ArrayLike,
    end_xz_m: ArrayLike,
    depth_m: float,
    width_m: float,
    rgb: Rgb,
    contrast: float = 0.15,
    y_m: float = 0.0,
) -> Part:
    """Return a box whose upper face runs from one point of the x-z plane to another further ahead.

    It is `depth_m` thick at right angles to that face, and `width_m` wide around `y_m`.
    """
    start, end = np.asarray(start_xz_m, float), np.asarray(end_xz_m, float)
    length = float(np.hypot(*(end - start)))
    slope = np.arctan2(end[1] - start[1], end[0] - start[0])
    middle = (start + end) / 2 + depth_m / 2 * np.array([np.sin(slope), -np.cos(slope)])
    T = pose(rotation_from_rotvec([0.0, -slope, 0.0]), [middle[0], y_m, middle[1]])
    return Part("box", T, np.array([length, width_m, depth_m]) / 2, rgb, contrast)


def ring(
    centre_m: ArrayLike,
    radius_m: float,
    tube_m: float,
    rgb: Rgb,
    contrast: float = 0.15,
    count: int = 24,
) -> tuple[Part, ...]:
    """Return an upright ring across y of `count` capsules, `tube_m` thick (radius); it reaches `radius_m`."""
    angles = 2 * np.pi * np.arange(count + 1) / count
    points = np.asarray(centre_m, float) + (radius_m - tube_m) * np.stack(
        [np.sin(angles), 0 * angles, np.cos(angles)], 1
    )
    return tuple(capsule(a, b, tube_m, rgb, contrast) for a, b in pairwise(points))


def carried(parts: Iterable[Part], T_a_b: FloatArray) -> tuple[Part, ...]:
    """Return parts of a frame b as parts of the frame a in which b has this pose."""
    return tuple(replace(part, T_thing_part=T_a_b @ part.T_thing_part) for part in parts)


def scaled(parts: Iterable[Part], factor: float) -> tuple[Part, ...]:
    """Return the parts of a thing `factor` times as large, around its origin."""
    return tuple(
        replace(
            part,
            T_thing_part=pose(part.T_thing_part[:3, :3], part.T_thing_part[:3, 3] * factor),
            half_m=part.half_m * factor,
        )
        for part in parts
    )


def grounded(parts: Iterable[Part]) -> tuple[Part, ...]:
    """Return the parts of a thing, lifted or lowered until the lowest touches z = 0."""
    parts = tuple(parts)
    lowest = min(part.T_thing_part[2, 3] - part.reach(-part.T_thing_part[:3, :3].T)[2] for part in parts)
    return carried(parts, pose(np.eye(3), [0.0, 0.0, -lowest]))


def textured(thing: Thing, richness: float) -> Thing:
    """Return the thing with `richness` times the contrast of its textures (0 = smooth paint), at most 1.

    Raises
    ------
    ValueRefusedError
        If it is negative or not finite.
    """
    if finite("richness", richness, ()) < 0:
        raise ValueRefusedError(f"richness must be >= 0, but got {richness:g}")

    def rich(parts: tuple[Part, ...]) -> tuple[Part, ...]:
        return tuple(replace(part, contrast=min(1.0, richness * part.contrast)) for part in parts)

    gait = thing.gait
    return replace(thing, parts=rich(thing.parts), gait=None if gait is None else lambda gone: rich(gait(gone)))


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


def moved(thing: Thing, dt_s: float) -> Thing:
    """Return the thing `dt_s` seconds later: exact along its line or arc, its limbs where its gait has them then."""
    turn = thing.yaw_rate_radps * dt_s
    # The chord of an arc: half the turn to its side, shortened by sinc.
    chord = rotation_from_rotvec([0.0, 0.0, turn / 2]) @ thing.velocity_mps * dt_s * np.sinc(turn / (2 * np.pi))
    R = rotation_from_rotvec([0.0, 0.0, turn])
    gone = thing.gone_m + float(np.linalg.norm(thing.velocity_mps)) * dt_s
    return replace(
        thing,
        T_world_thing=pose(R @ thing.T_world_thing[:3, :3], thing.T_world_thing[:3, 3] + chord),
        velocity_mps=R @ thing.velocity_mps,
        gone_m=gone,
        parts=thing.parts if thing.gait is None or gone == thing.gone_m else thing.gait(gone),
    )


def going(thing: Thing, speed_mps: float, yaw_rate_radps: float = 0.0) -> Thing:
    """Return the thing on its way where it faces (backwards if the speed is negative)."""
    return replace(thing, velocity_mps=speed_mps * thing.T_world_thing[:3, 0], yaw_rate_radps=yaw_rate_radps)
