"""What a step finds: the ground, the free space, the obstacles, and the result of the frame."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray, finite, locked, numbers, positive
from roadblock.values.decision import Decision
from roadblock.values.motion import EgoMotion, Track

NEAREST_FACE_PERCENT = 10
"""What range means everywhere: the nearest visible face is this percentile of the forward distance over the surface."""

UNKNOWN_COV = locked(np.full((3, 3), np.nan))
"""Covariance of what nobody knows."""

EDGE_KINDS = ("none", "kerb", "verge")
"""What ends the road though no wall stands there: a step up to a pavement; grass, gravel, a bank."""

UNKNOWN_3 = locked(np.full(3, np.nan))
NO_OUTLINE = locked(np.empty((0, 2)))
UNRECOGNIZED: dict[str, Any] = {
    "cov_calib_m2": UNKNOWN_COV,
    "color_lab": UNKNOWN_3,
    "class_odds": {},
    "size_sigma_m": UNKNOWN_3,
    "outline_m": NO_OUTLINE,
}
"""What nobody has recognised yet."""

HEALTH_STATES = ("ok", "degraded", "failed")


@dataclass(frozen=True, eq=False)
class GroundPlane:
    """The road as a plane in the car frame (x right, y down, z forward), with a bend ahead.

    Attributes
    ----------
    normal
        (3,) unit normal, pointing up (its y is negative).
    height_m
        Distance of the car frame's origin above the plane, metres, at right angles to the road.
    bend_per_m
        Curvature q of the road's profile: ahead it rises by `q * z^2` over the plane; 0 for a flat road.
    inlier_share
        Share of the candidate points that lie on it, 0..1.
    range_m
        How far ahead it was seen.

    Raises
    ------
    ValueRefusedError
        If the normal is not one long (to 1e-6) or does not point up, the height not positive, or the bend not finite.
    """

    normal: FloatArray
    height_m: float
    bend_per_m: float = 0.0
    inlier_share: float = 1.0
    range_m: float = float("inf")

    def __post_init__(self) -> None:
        object.__setattr__(self, "normal", finite("normal", self.normal, (3,)))
        if abs(np.linalg.norm(self.normal) - 1) > 1e-6 or self.normal[1] >= 0:
            raise ValueRefusedError(f"normal must be one long and point up (y < 0), but got {self.normal.tolist()}")
        finite("bend_per_m", self.bend_per_m, ())
        object.__setattr__(self, "height_m", positive("height_m", self.height_m))

    @property
    def pitch_rad(self) -> float:
        """How far the cameras look down on the road, radians (> 0 = down)."""
        return float(np.arctan2(-self.normal[2], -self.normal[1]))

    @property
    def roll_rad(self) -> float:
        """How far the rig's left side is up, radians (> 0 = left up)."""
        return float(np.arctan2(-self.normal[0], -self.normal[1]))

    def height_of(self, points: FloatArray) -> FloatArray:
        """Return the height (...) of car-frame points (..., 3) above the road, metres; NaN where a point is NaN."""
        z = points[..., 2]
        return np.asarray(points @ self.normal + self.height_m - self.bend_per_m * z * z)

    def point_below(self, x_m: float, z_m: float) -> FloatArray:
        """Return the car-frame point (3,) of the road at `x_m` to the right and `z_m` ahead."""
        return np.array([x_m, self.y_below(x_m, z_m), z_m])

    def y_below(self, x_m: FloatArray | float, z_m: FloatArray | float) -> FloatArray:
        """Return y (...) of the road, car frame, metres, at each x (...) to the right and z (...) ahead."""
        n_x, n_y, n_z = self.normal
        return np.asarray((n_x * x_m + n_z * z_m + self.height_m - self.bend_per_m * z_m**2) / -n_y)


def road_numbers(ground: GroundPlane | None) -> FloatArray:
    """Return (5,) the normal, the height in metres and the bend per metre, as kernels take them; NaN without a road."""
    return np.full(5, np.nan) if ground is None else np.array([*ground.normal, ground.height_m, ground.bend_per_m])


@dataclass(frozen=True, eq=False)
class RoadEdges:
    """Where a kerb or a verge crosses each image column, before its free space ends.

    Attributes
    ----------
    range_m
        (n,) forward distance to the first one, metres; NaN where none was seen.
    height_m
        (n,) how much higher the ground behind it is, metres; NaN where none was seen.
    kind
        (n,) uint8 index into `EDGE_KINDS`.

    Raises
    ------
    ValueRefusedError
        If they are no numbers, of unequal length, or there is no such kind.
    """

    range_m: FloatArray
    height_m: FloatArray
    kind: NDArray[np.uint8]

    def __post_init__(self) -> None:
        for name in ("range_m", "height_m"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), (len(self.kind),)))
        if self.kind.dtype != np.uint8 or (self.kind >= len(EDGE_KINDS)).any():
            raise ValueRefusedError(f"kind must be uint8 of 0..{len(EDGE_KINDS) - 1}, but got {self.kind.tolist()}")
        object.__setattr__(self, "kind", locked(self.kind))


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """How far the road is free, per image column.

    Attributes
    ----------
    u_px
        (n,) column centres in the rectified left image.
    range_m
        (n,) forward distance to the first thing standing on the road; NaN where nothing of the road or of an
        obstacle was observed: unobserved is never free.
    is_blocked
        (n,) whether something standing was seen there; False where the road was seen no further, or nothing was. None
        for a detector that does not tell.
    edges
        Kerbs and verges before that range; None where they were not looked for.

    Raises
    ------
    ValueRefusedError
        If they are no numbers, of unequal length, or a column is not finite.
    """

    u_px: FloatArray
    range_m: FloatArray
    is_blocked: NDArray[np.bool_] | None = None
    edges: RoadEdges | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "u_px", finite("u_px", self.u_px, (-1,)))
        object.__setattr__(self, "range_m", numbers("range_m", self.range_m, (len(self.u_px),)))
        if self.is_blocked is not None:
            if self.is_blocked.shape != (len(self.u_px),) or self.is_blocked.dtype != bool:
                got = f"{self.is_blocked.dtype} {self.is_blocked.shape}"
                raise ValueRefusedError(f"is_blocked must be bool ({len(self.u_px)},), but got {got}")
            object.__setattr__(self, "is_blocked", locked(self.is_blocked))
        if self.edges is not None and len(self.edges.range_m) != len(self.u_px):
            raise ValueRefusedError(f"edges must have {len(self.u_px)} columns, but got {len(self.edges.range_m)}")

    @property
    def ends(self) -> NDArray[np.bool_]:
        """(n,) which columns end at something; where the detector does not tell, all that are observed."""
        return np.isfinite(self.range_m) if self.is_blocked is None else self.is_blocked

    @property
    def grid(self) -> FloatArray:
        """(2,) the first column, and how far they are apart, pixels; 0 and 1 where there is none, or only one."""
        u = self.u_px
        return np.array([u[0] if len(u) else 0.0, u[1] - u[0] if len(u) > 1 else 1.0])


@dataclass(frozen=True, eq=False)
class Stixels:
    """What stands, column by column: upright pieces of one range each. A column has none, one, or several.

    Attributes
    ----------
    u_px
        (n,) middle of its column in the rectified left image.
    top_px, bottom_px
        (n,) its rows, half open.
    range_m
        (n,) its forward distance, metres.
    height_m
        (n,) height of its top over the road, metres; NaN without a road.

    Raises
    ------
    ValueRefusedError
        If they are no numbers or of unequal length, or all but the height are not finite.
    """

    u_px: FloatArray
    top_px: FloatArray
    bottom_px: FloatArray
    range_m: FloatArray
    height_m: FloatArray

    def __post_init__(self) -> None:
        for name in ("u_px", "top_px", "bottom_px", "range_m"):
            object.__setattr__(self, name, finite(name, getattr(self, name), (len(self.u_px),)))
        object.__setattr__(self, "height_m", numbers("height_m", self.height_m, (len(self.u_px),)))


@dataclass(frozen=True)
class Refinement:
    """What least squares over all pixels of a region measured at full resolution.

    Attributes
    ----------
    mean_d_px, sigma_mean_d_px
        Disparity of the mean visible surface, that is of its mean forward distance, and its standard deviation, pixels.
    nearest_d_px, sigma_nearest_d_px
        Disparity of the nearest visible face (10th percentile of the forward distance) and its standard deviation,
        pixels. Both sigmas are from the images alone (noise, and what noise does not explain); nothing of the
        calibration is in them.
    moved_px
        How far the mean is from the detector's, pixels.
    residual
        Root mean square difference of both images in the region after the fit, grey levels.
    used
        Share of its pixels that the fit explains, 0..1.
    down_px
        By how much the right image was found to lie lower than the rig says, pixels; 0 where nobody looked.

    Raises
    ------
    ValueRefusedError
        If a disparity or a sigma is not positive.
    """

    mean_d_px: float
    sigma_mean_d_px: float
    nearest_d_px: float
    sigma_nearest_d_px: float
    moved_px: float
    residual: float
    used: float
    down_px: float = 0.0

    def __post_init__(self) -> None:
        for name in ("mean_d_px", "sigma_mean_d_px", "nearest_d_px", "sigma_nearest_d_px"):
            positive(name, getattr(self, name))


@dataclass(frozen=True, eq=False)
class Region:
    """One thing standing on the road, as the detector sees it in the rectified left image.

    Attributes
    ----------
    box_px
        (u0, v0, u1, v1), half open, down to the road.
    contour_px
        (n, 2) outline, pixels, closed (the first point is not repeated).
    surface_uvd_px
        (m, 3) its visible surface: column, row and disparity of each cell.
    sigma_d_px
        One standard deviation of the disparity of the whole region, pixels.
    color_rgb
        (3,) mean colour 0..255; NaN for grey cameras.
    refined
        Its disparity measured at full resolution; None where that was not done, or did not work out.
    is_seen_through
        Whether it is seen through a nearer obstacle that is a lattice: a fence, a railing, twigs.
    """

    box_px: tuple[int, int, int, int]
    contour_px: NDArray[np.int32]
    surface_uvd_px: FloatArray
    sigma_d_px: float
    color_rgb: FloatArray
    refined: Refinement | None = None
    is_seen_through: bool = False

    def __post_init__(self) -> None:
        for name in ("contour_px", "surface_uvd_px", "color_rgb"):
            object.__setattr__(self, name, locked(getattr(self, name)))
        object.__setattr__(self, "sigma_d_px", positive("sigma_d_px", self.sigma_d_px))


@dataclass(frozen=True, eq=False)
class Detections:
    """What a detector returns for one pair.

    Attributes
    ----------
    regions
        In no particular order.
    ground
        None where no road was found.
    free_space
        Per column.
    matched_share
        Share of the image whose disparity is known, 0..1; NaN for a detector that does not match.
    doubts
        What it could not tell, and why, in words.
    timings_ms
        Milliseconds per inner stage.
    stixels
        What stands, column by column; None where that is not wanted.
    """

    regions: tuple[Region, ...]
    ground: GroundPlane | None
    free_space: FreeSpace
    matched_share: float = float("nan")
    doubts: tuple[str, ...] = ()
    timings_ms: dict[str, float] = field(default_factory=dict)
    stixels: Stixels | None = None


@dataclass(frozen=True, eq=False)
class Obstacle:
    """One thing standing on the road, measured.

    Attributes
    ----------
    position_m
        (3,) foot point of the nearest visible face in the vehicle frame (x forward, y left, z up), metres.
    range_m
        Forward distance from the point halfway between the cameras to the nearest visible face (10th percentile over
        the visible surface), metres.
    range_sigma_m
        Its standard deviation from matching noise alone, metres: independent from frame to frame.
    size_m
        (3,) width, height, length, metres; length NaN where it is not visible.
    uvd_px, cov_uvd_px2
        The measurement and its covariance, pixels.
    cov_match_m2
        (3, 3) covariance of `position_m` from matching noise, and from where the detector cut the thing out: nearly
        independent from frame to frame. A foot point moves along the road as its range does.
    box_px, contour_px
        As in `Region`.
    color
        Name of its body's colour, None for grey cameras.
    label, probability
        Class and its probability; "unknown" and NaN until recognised.
    cov_calib_m2
        (3, 3) covariance of `position_m` from the rig's calibration. **The same every frame: a bias, never averaged
        away**, and shared by all obstacles of one rig. NaN where the rig has no covariance.
    range_sigma_calib_m
        Standard deviation of `range_m` from the rig's calibration, metres; likewise a bias, and NaN where unknown.
    track
        What is known of it over time; None where nothing is (single frames, things just seen for the first time).
    is_seen_through
        As in `Region`.
    colors, color_lab
        One or two names of its body's colours, `color` first, and (3,) the CIELAB value in the road's light; empty and
        NaN where unknown.
    class_odds
        Probability of each class by name; empty until recognised.
    size_sigma_m
        (3,) standard deviations of `size_m`, metres; NaN where unknown.
    outline_m
        (n, 2) polygon of what is seen of it on the road, vehicle frame x and y, metres; empty where unknown.
    heading_rad, heading_sigma_rad
        Which way it runs, from the vehicle's x to its y, and the standard deviation. Front and back look alike: -pi/2
        to pi/2, unless it moves, then -pi to pi. NaN where its visible faces do not tell.

    Raises
    ------
    ValueRefusedError
        If the position is not finite, the range not positive, or `cov_calib_m2` not 3x3.
    """

    position_m: FloatArray
    range_m: float
    range_sigma_m: float
    size_m: FloatArray
    uvd_px: FloatArray
    cov_uvd_px2: FloatArray
    cov_match_m2: FloatArray
    box_px: tuple[int, int, int, int]
    contour_px: NDArray[np.int32]
    color: str | None = None
    label: str = "unknown"
    probability: float = float("nan")
    cov_calib_m2: FloatArray = field(default_factory=lambda: UNKNOWN_COV)
    range_sigma_calib_m: float = float("nan")
    track: Track | None = None
    is_seen_through: bool = False
    colors: tuple[str, ...] = ()
    color_lab: FloatArray = field(default_factory=lambda: UNKNOWN_3)
    class_odds: dict[str, float] = field(default_factory=dict)
    size_sigma_m: FloatArray = field(default_factory=lambda: UNKNOWN_3)
    outline_m: FloatArray = field(default_factory=lambda: NO_OUTLINE)
    heading_rad: float = float("nan")
    heading_sigma_rad: float = float("nan")

    def __post_init__(self) -> None:
        object.__setattr__(self, "position_m", finite("position_m", self.position_m, (3,)))
        if self.cov_calib_m2 is not UNKNOWN_COV:
            object.__setattr__(self, "cov_calib_m2", numbers("cov_calib_m2", self.cov_calib_m2, (3, 3)))
        object.__setattr__(self, "range_m", positive("range_m", self.range_m))

    def with_track(self, track: Track) -> "Obstacle":
        """Return the same obstacle with its track; `dataclasses.replace` would check all numbers once more."""
        return self.recognized(track=track)

    def recognized(self, **known: object) -> "Obstacle":
        """Return the same obstacle with fields that need no check, from a stage that made them itself."""
        made = object.__new__(type(self))
        fields = made.__dict__  # frozen: written to directly, an eighth of the time of `unchecked`
        fields.update(self.__dict__)
        fields.update(known)
        return made


@dataclass(frozen=True)
class Health:
    """Whether this frame's result can be trusted: a state of `HEALTH_STATES` and the reasons in words.

    Raises
    ------
    ValueRefusedError
        If there is no such state.
    """

    state: str = "ok"
    reasons: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.state not in HEALTH_STATES:
            raise ValueRefusedError(f"state must be one of {', '.join(HEALTH_STATES)}, but got {self.state!r}")


@dataclass(frozen=True, eq=False)
class FrameResult:
    """Everything one step produced.

    Attributes
    ----------
    index, name, t_ns
        As in `StereoPair`.
    obstacles
        Nearest first.
    free_space, ground
        As in `Detections`; ground None where no road was found.
    health
        The verdict.
    timings_ms
        Milliseconds per stage, and their `total`.
    ego
        How the vehicle moved since the frame before; None for single frames.
    stixels
        As in `Detections`.
    decision
        What the car should do; None for single frames.
    """

    index: int
    name: str
    t_ns: int
    obstacles: tuple[Obstacle, ...]
    free_space: FreeSpace
    ground: GroundPlane | None
    health: Health
    timings_ms: dict[str, float]
    ego: EgoMotion | None = None
    stixels: Stixels | None = None
    decision: Decision | None = None
