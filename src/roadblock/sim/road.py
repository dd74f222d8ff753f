"""The road: what is painted on it, how it bends, and where its surface lies.

Road coordinates: `along_m` runs on the reference line (the world's x axis, then the arc), `left_m` at right angles to
it. Heights are over the world's z = 0, in which the reference line starts level.
"""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import pose
from roadblock.sim import raycast
from roadblock.sim.solids import Rgb
from roadblock.values.checks import FloatArray, finite

MarkKind = Literal["zebra", "arrow", "gore", "patch", "manhole"]
MARKS: dict[str, int] = {kind: number for number, kind in enumerate(get_args(MarkKind))}

STEEPEST = 0.3
"""Largest slope of a road, along and across."""

TIGHTEST_PER_M = 0.1
"""Largest curvature of a road."""

HIGHEST_KERB_M = 0.3


@dataclass(frozen=True)
class Line:
    """A painted line along the road.

    Attributes
    ----------
    left_m
        Where its middle runs, metres to the left of the reference line.
    width_m
        Its width.
    dash_m, gap_m
        Lengths of dash and gap; gap 0 = unbroken.

    Raises
    ------
    ValueRefusedError
        If a number is not finite, width or dash not positive, or the gap negative.
    """

    left_m: float
    width_m: float = 0.14
    dash_m: float = 3.0
    gap_m: float = 0.0

    def __post_init__(self) -> None:
        _, width, dash, gap = finite("line", (self.left_m, self.width_m, self.dash_m, self.gap_m), (4,))
        if width <= 0 or dash <= 0 or gap < 0:
            raise ValueRefusedError(
                f"a line must have width and dash > 0 and a gap >= 0 m, but got {width:g}, {dash:g} and {gap:g}"
            )


@dataclass(frozen=True)
class Mark:
    """Something of limited size in the road's surface.

    Attributes
    ----------
    kind
        "zebra" (a crossing, stripes of half a metre along the road), "arrow" (straight on), "gore" (a hatched wedge
        that widens ahead, as before the nose of a fork), "patch" (newer asphalt), "manhole" (a round cover).
    along_m
        Where it starts.
    left_m
        Its middle.
    length_m, width_m
        Along and across the road.

    Raises
    ------
    ValueRefusedError
        If there is no such kind, a number is not finite, or a size not positive.
    """

    kind: MarkKind
    along_m: float
    left_m: float
    length_m: float
    width_m: float

    def __post_init__(self) -> None:
        if self.kind not in MARKS:
            raise ValueRefusedError(f"kind must be one of {', '.join(MARKS)}, but got {self.kind!r}")
        numbers = finite("mark", (self.along_m, self.left_m, self.length_m, self.width_m), (4,))
        if (numbers[2:] <= 0).any():
            raise ValueRefusedError(f"a mark must have a size > 0, but got {self.length_m:g} x {self.width_m:g} m")


@dataclass(frozen=True)
class Road:
    """The ground: asphalt from `right_m` to `left_m`, kerb stones along both edges, verges beyond.

    By default it is flat, and straight along the world's x axis.

    Attributes
    ----------
    right_m, left_m
        Edges of the asphalt, metres to the left of the reference line.
    lines, marks
        What is painted on it or let into it; later ones cover earlier ones.
    contrast
        Standard deviation of the asphalt's texture, as a share of its brightness.
    asphalt, verge
        sRGB 0..255.
    curvature_per_m, curve_from_m
        The reference line is straight up to x = `curve_from_m`, then an arc of this curvature; > 0 bends left.
    grade, grade_from_m, grade_over_m
        Level up to x = `grade_from_m`; over the next `grade_over_m` the slope changes evenly (a parabola) to `grade`
        (rise per metre), and stays.
    bank
        Rise per metre to the left, over the width of the road.
    crown_per_m
        The road falls off from its middle by `crown_per_m * distance^2`.
    kerb_m
        How high kerb stones and verges stand over the edge of the asphalt; 0 = flush.

    Raises
    ------
    ValueRefusedError
        If a number is not finite, the edges are swapped, a slope, curvature or kerb is beyond what roads have, the
        contrast outside 0..1, or a colour outside 0..255.
    """

    right_m: float = -3.1
    left_m: float = 5.6
    lines: tuple[Line, ...] = (Line(-2.85), Line(1.7, gap_m=4.5), Line(5.35))
    contrast: float = 0.17
    asphalt: Rgb = (112, 112, 116)
    verge: Rgb = (98, 128, 58)
    curvature_per_m: float = 0.0
    curve_from_m: float = 0.0
    grade: float = 0.0
    grade_from_m: float = 15.0
    grade_over_m: float = 20.0
    bank: float = 0.0
    crown_per_m: float = 0.0
    kerb_m: float = 0.0
    marks: tuple[Mark, ...] = ()

    def __post_init__(self) -> None:
        limits = {
            "contrast": 1.0,
            "curvature_per_m": TIGHTEST_PER_M,
            "grade": STEEPEST,
            "bank": STEEPEST,
            "crown_per_m": STEEPEST / 10,
            "kerb_m": HIGHEST_KERB_M,
        }
        for name in ("right_m", "left_m", "curve_from_m", "grade_from_m", "grade_over_m", *limits):
            value = float(finite(name, getattr(self, name), ()))
            if abs(value) > limits.get(name, np.inf):
                raise ValueRefusedError(f"{name} must lie within +-{limits[name]:g}, but got {value:g}")
        if min(self.kerb_m, self.contrast) < 0 or self.grade_over_m <= 0:
            raise ValueRefusedError(
                "kerb_m and contrast must be >= 0 and grade_over_m > 0, but got "
                f"{self.kerb_m:g}, {self.contrast:g} and {self.grade_over_m:g}"
            )
        for name in ("asphalt", "verge"):
            rgb = finite(name, getattr(self, name), (3,))
            if (rgb < 0).any() or (rgb > 255).any():
                raise ValueRefusedError(f"{name} must lie in 0..255, but got {rgb.tolist()}")
        if self.left_m <= self.right_m:
            raise ValueRefusedError(f"left_m must be > right_m, but got {self.left_m:g} and {self.right_m:g}")

    @property
    def is_flat(self) -> bool:
        """Whether it is the plane z = 0 everywhere."""
        return not (self.grade or self.bank or self.crown_per_m or self.kerb_m)


def ground_of(road: Road) -> raycast.Ground:
    """Return the road's surface as the kernels take it."""
    edges = np.linspace(road.right_m, road.left_m, 101)
    middle = (road.left_m + road.right_m) / 2
    fall = road.bank * edges - road.crown_per_m * ((edges - middle) ** 2 - middle**2)
    # A parabola between samples may reach higher by this much.
    slack = road.crown_per_m * (edges[1] - edges[0]) ** 2 if road.crown_per_m else 0.0
    return raycast.Ground(
        right=float(road.right_m),
        left=float(road.left_m),
        curvature=float(road.curvature_per_m),
        curve_from=float(road.curve_from_m),
        grade=float(road.grade),
        grade_from=float(road.grade_from_m),
        grade_over=float(road.grade_over_m),
        bank=float(road.bank),
        crown=float(road.crown_per_m),
        kerb=float(road.kerb_m),
        low=float(fall.min() - abs(slack)),
        high=float(fall.max() + abs(slack) + road.kerb_m),
        plain=road.is_flat,
    )


def height_m(road: Road, x_m: float, y_m: float) -> float:
    """Return the height of the road's surface under a point of the world, metres."""
    return float(raycast.ground_height(ground_of(road), float(x_m), float(y_m)))


def normal(road: Road, x_m: float, y_m: float) -> FloatArray:
    """Return the (3,) upward unit normal of the road's surface under a point of the world."""
    return np.array(raycast.ground_normal(ground_of(road), float(x_m), float(y_m)))


def place_on(road: Road, x_m: float, y_m: float) -> tuple[float, float, float]:
    """Return where a point of the world is on the road, along and to the left, and where the road leads there, rad."""
    along, left, _, _ = raycast.on_road(ground_of(road), float(x_m), float(y_m))
    return along, left, road.curvature_per_m * max(along - road.curve_from_m, 0.0)


def pose_on(road: Road, along_m: float, left_m: float, yaw_rad: float = 0.0, *, upright: bool = False) -> FloatArray:
    """Return the 4x4 pose in the world of what stands on the road.

    Parameters
    ----------
    road
        What it stands on.
    along_m, left_m
        Where, in road coordinates.
    yaw_rad
        How far it is turned to the left of the road's direction there.
    upright
        Whether its z is the world's (a person, a pole), or at right angles to the surface (a car).
    """
    bent = max(along_m - road.curve_from_m, 0.0)
    turn = road.curvature_per_m * bent
    x = (along_m - bent) + bent * np.sinc(turn / np.pi) - left_m * np.sin(turn)
    y = bent * turn / 2 * np.sinc(turn / (2 * np.pi)) ** 2 + left_m * np.cos(turn)
    up = np.array([0.0, 0.0, 1.0]) if upright else normal(road, x, y)
    # Seen from above it heads exactly there; its slope is the surface's.
    ahead = np.array([np.cos(turn + yaw_rad), np.sin(turn + yaw_rad), 0.0])
    ahead[2] = -(ahead @ up) / up[2]
    ahead /= np.linalg.norm(ahead)
    return pose(np.stack([ahead, np.cross(up, ahead), up], 1), [x, y, height_m(road, x, y)])
