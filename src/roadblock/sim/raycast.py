"""The hot loops of the renderer: rays against solids and road, solid textures, light.

Everything a surface point looks like (texture, its fading, shading, haze) is a function of that point alone, never of
the camera that sees it; so both cameras see the same world. Colours are linear light.

Beside its colour a point has a tag: which part, which face of it, which marking, whether the sun reaches it. Where the
tags of neighbouring pixels agree, nothing but a smooth texture lies in a pixel; elsewhere it is sampled more finely.

All kernels live in this one file: numba's cache notices changes only in the file of the function it is asked for.
"""

from typing import Any, NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

VOID, SKY, GROUND = -3, -2, -1
"""What a ray meets where the lens sees nothing, or it meets no part; parts count from 0."""

FINEST_M = 0.004
"""Cells of texture do not get smaller."""

HAZE_M = 900.0
"""Distance over which the air hides 63 % of a thing."""

FARTHEST_M = 5000.0
"""Where a search for the ground is given up."""

KERB_RUN_M, KERB_M = 0.02, 0.18
"""Width of a raised kerb's front face, and of the whole kerb."""

SMALL_PX = 1.5
"""What is drawn on a surface and narrower than this may slip between pixel centres."""

TILE_PX = 32
"""Pixels of a row that share one list of what they may see."""

SUN, SKYLIGHT = 0.9, 0.25
"""Light of the sun on a surface facing it, of the sky on one facing sideways: together 1 on level ground by default."""

Floats = NDArray[np.float64]

FLAGS: dict[str, Any] = {
    "cache": True,
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "arcp", "nsz"},
    "_nrt": False,
}
"""No kernel makes an array, so none needs to count who holds one: counting cost two thirds of the time, more still with
several threads, which all count on the same numbers."""

INLINED = FLAGS | {"forceinline": True}
"""For what would pass on most of its many arguments from pixel to pixel."""


class Ground(NamedTuple):
    """The road's surface as bare numbers: the fields of `Road`, and what follows from them.

    Attributes
    ----------
    low, high
        How far kerbs and cross fall reach below and above the profile, metres.
    plain
        Whether it is the plane z = 0.
    """

    right: float
    left: float
    curvature: float
    curve_from: float
    grade: float
    grade_from: float
    grade_over: float
    bank: float
    crown: float
    kerb: float
    low: float
    high: float
    plain: bool


class World(NamedTuple):
    """A scene as bare numbers.

    Attributes
    ----------
    part
        (n, 24) centre (3), rotation world <- part row by row (9), half sizes (3), squared radius of a ball around it,
        kind (0 box, 1 ellipsoid, 2 capsule, 3 cylinder or cone), linear red, green, blue, contrast, coarsest texture
        cell in metres, pattern (0 plain, 1 crate, 2 windows), texture seed.
    line
        (k, 4) place, width, dash, gap of each line on the road.
    mark
        (k, 5) kind, start, middle, length, width of each other mark on it.
    sun
        (3,) unit vector towards it.
    paint
        (7,) contrast of the asphalt, linear asphalt and verge colours.
    ground
        The road's surface.
    seed
        Of ground and sky.
    """

    part: Floats
    line: Floats
    mark: Floats
    sun: tuple[float, ...]
    paint: tuple[float, ...]
    ground: Ground
    seed: int


class View(NamedTuple):
    """One camera in the world.

    Attributes
    ----------
    eye
        (3,) its optical centre.
    axes
        (9,) rotation world <- camera, row by row.
    middle, ahead
        (3,) the point halfway between the cameras, and their common forward direction: what sets the detail of
        textures and the haze, the same for both.
    f_px
        Common focal length, likewise.
    round
        Whether pixels stand for equal angles (a fisheye) and not for equal areas of a plane.
    lens
        (4,) fx, fy, cx, cy where the camera is a pinhole; else unused.
    """

    eye: tuple[float, ...]
    axes: tuple[float, ...]
    middle: tuple[float, ...]
    ahead: tuple[float, ...]
    f_px: float
    round: bool
    lens: tuple[float, ...]


class Candidates(NamedTuple):
    """What each part can mean to one camera.

    Attributes
    ----------
    seen, dark
        (n, 4) half-open pixel boxes (u0, v0, u1, v1) outside of which this camera cannot see the part, or its shadow.
    fat
        (n, 24) `World.part`, each part larger by more than a pixel.
    small
        (n,) 0 an ordinary part, 1 one so thin that it may slip between pixel centres, 2 one so near that `fat` may
        hold the camera.
    """

    seen: NDArray[np.int64]
    dark: NDArray[np.int64]
    fat: Floats
    small: NDArray[np.int64]


@numba.njit(**INLINED)
def lattice(i, j, k, seed):  # type: ignore[no-untyped-def]
    """Return a fixed random number in -1..1 for a lattice point."""
    h = (i * 374761393 + j * 668265263 + k * 1103515245 + seed * 974711) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1911520717) & 0xFFFFFFFF
    return (h ^ (h >> 16)) * (2.0 / 4294967295.0) - 1.0


@numba.njit(**INLINED)
def noise2(x, y, seed):  # type: ignore[no-untyped-def]
    """Return smooth noise in -1..1 with cells of size 1 (quintic between lattice points)."""
    fx, fy = np.floor(x), np.floor(y)
    i, j = int(fx), int(fy)
    x, y = x - fx, y - fy
    s = x * x * x * (x * (6.0 * x - 15.0) + 10.0)
    t = y * y * y * (y * (6.0 * y - 15.0) + 10.0)
    a, b = lattice(i, j, 0, seed), lattice(i + 1, j, 0, seed)
    c, d = lattice(i, j + 1, 0, seed), lattice(i + 1, j + 1, 0, seed)
    a, c = a + s * (b - a), c + s * (d - c)
    return a + t * (c - a)


@numba.njit(**INLINED)
def noise3(x, y, z, seed):  # type: ignore[no-untyped-def]
    """Return `noise2` for a third dimension."""
    fx, fy, fz = np.floor(x), np.floor(y), np.floor(z)
    i, j, k = int(fx), int(fy), int(fz)
    x, y, z = x - fx, y - fy, z - fz
    s = x * x * x * (x * (6.0 * x - 15.0) + 10.0)
    t = y * y * y * (y * (6.0 * y - 15.0) + 10.0)
    r = z * z * z * (z * (6.0 * z - 15.0) + 10.0)
    a, b = lattice(i, j, k, seed), lattice(i + 1, j, k, seed)
    c, d = lattice(i, j + 1, k, seed), lattice(i + 1, j + 1, k, seed)
    e, f = lattice(i, j, k + 1, seed), lattice(i + 1, j, k + 1, seed)
    g, h = lattice(i, j + 1, k + 1, seed), lattice(i + 1, j + 1, k + 1, seed)
    a, c, e, g = a + s * (b - a), c + s * (d - c), e + s * (f - e), g + s * (h - g)
    a, e = a + t * (c - a), e + t * (g - e)
    return a + r * (e - a)


@numba.njit(**INLINED)
def kept(size):  # type: ignore[no-untyped-def]
    """Return how much is left of an octave whose cells are so many pixels large: none before it aliases."""
    return min(1.0, max(0.0, (size - 1.0) * (1.0 / 1.5)))


@numba.njit(**FLAGS)
def fractal2(x, y, coarsest, across, along, seed):  # type: ignore[no-untyped-def]
    """Return a texture of a plane with an amplitude spectrum of 1/f, about unit variance when seen near.

    Equal amplitude for each octave *is* 1/f in two dimensions. `across` and `along` are the pixel's footprint: rows
    average along it, which leaves a share of the contrast; across it octaves must vanish before they alias.
    """
    total, finest, cell = 0.0, max(across, FINEST_M), coarsest
    x, y, size, averaged = x / cell, y / cell, cell / across, np.sqrt(cell / along)
    while cell > finest:
        total += kept(size) * min(1.0, averaged) * noise2(x, y, seed)
        x, y = 1.6 * x - 1.2 * y + 6.2, 1.2 * x + 1.6 * y + 15.4
        cell, size, averaged = 0.5 * cell, 0.5 * size, 0.7071067811865476 * averaged
        seed += 1
    return total


@numba.njit(**INLINED)
def fractal3(x, y, z, coarsest, footprint, seed):  # type: ignore[no-untyped-def]
    """Return `fractal2` for a solid."""
    total, finest, cell = 0.0, max(footprint, FINEST_M), coarsest
    x, y, z, size = x / cell, y / cell, z / cell, cell / footprint
    while cell > finest:
        total += kept(size) * noise3(x, y, z, seed)
        x, y, z = (
            1.6 * x - 1.2 * y + 6.2,
            0.72 * x + 0.96 * y - 1.6 * z + 15.4,
            0.96 * x + 1.28 * y + 1.2 * z,
        )
        cell, size = 0.5 * cell, 0.5 * size
        seed += 1
    return total


@numba.njit(**INLINED)
def on_road(ground, x, y):  # type: ignore[no-untyped-def]
    """Return road coordinates (along, left) of a point, and the unit vector to the left there.

    The distance from the arc's centre is `1 / k - left`; written so that nothing cancels for small curvatures k.
    """
    k, ahead = ground.curvature, x - ground.curve_from
    if k == 0.0 or ahead <= 0.0:
        return x, y, 0.0, 1.0
    root = np.sqrt((k * ahead) ** 2 + (1.0 - k * y) ** 2)
    left = (2.0 * y - k * (ahead * ahead + y * y)) / (1.0 + root)
    return ground.curve_from + np.arctan2(k * ahead, 1.0 - k * y) / k, left, -k * ahead / root, (1.0 - k * y) / root


@numba.njit(**INLINED)
def profile(ground, x):  # type: ignore[no-untyped-def]
    """Return height and slope of the road's reference line."""
    ahead = x - ground.grade_from
    if ahead <= 0.0:
        return 0.0, 0.0
    if ahead >= ground.grade_over:
        return ground.grade * (ahead - 0.5 * ground.grade_over), ground.grade
    return 0.5 * ground.grade / ground.grade_over * ahead * ahead, ground.grade / ground.grade_over * ahead


@numba.njit(**INLINED)
def cross_fall(ground, left):  # type: ignore[no-untyped-def]
    """Return height over the profile, and its slope to the left: bank, crown, kerb."""
    inner = min(ground.left, max(ground.right, left))
    middle = 0.5 * (ground.left + ground.right)
    height = ground.bank * inner - ground.crown * ((inner - middle) ** 2 - middle * middle)
    slope = ground.bank - 2.0 * ground.crown * (inner - middle)
    if left == inner:
        return height, slope
    out = abs(left - inner)
    if out >= KERB_RUN_M:
        return height + ground.kerb, 0.0
    return height + ground.kerb * out / KERB_RUN_M, np.sign(left - inner) * ground.kerb / KERB_RUN_M


@numba.njit(**INLINED)
def ground_height(ground, x, y):  # type: ignore[no-untyped-def]
    """Return the height of the road's surface."""
    if ground.plain:
        return 0.0
    _, left, _, _ = on_road(ground, x, y)
    return profile(ground, x)[0] + cross_fall(ground, left)[0]


@numba.njit(**INLINED)
def ground_normal(ground, x, y):  # type: ignore[no-untyped-def]
    """Return the upward unit normal of the road's surface."""
    if ground.plain:
        return 0.0, 0.0, 1.0
    _, left, to_left_x, to_left_y = on_road(ground, x, y)
    across = cross_fall(ground, left)[1]
    slope_x, slope_y = profile(ground, x)[1] + across * to_left_x, across * to_left_y
    length = np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y)
    return -slope_x / length, -slope_y / length, 1.0 / length


@numba.njit(**FLAGS)
def first_root(a, b, c, near, far):  # type: ignore[no-untyped-def]
    """Return the smallest root of `a t^2 + 2 b t + c` in near..far, inf if there is none."""
    left = b * b - a * c
    if left < 0.0:
        return np.inf
    q = -(b + np.copysign(np.sqrt(left), b))
    found = np.inf
    if a != 0.0 and near <= q / a <= far:
        found = q / a
    if q != 0.0 and near <= c / q < found and c / q <= far:
        found = c / q
    return found


@numba.njit(**FLAGS)
def hit_profile(ground, lift, ox, oz, dx, dz):  # type: ignore[no-untyped-def]
    """Return where a ray first sinks to `lift` over the profile: plane, parabolic cylinder, plane, in closed form."""
    ahead, a = ox - ground.grade_from, 0.5 * ground.grade / ground.grade_over
    best, above = np.inf, oz - lift
    if above <= profile(ground, ox)[0]:
        return 0.0
    if a == 0.0:
        return -above / dz if dz < 0.0 else np.inf
    for piece in range(3):
        near, far = 0.0, np.inf
        low, high = (-np.inf, 0.0) if piece == 0 else (0.0, ground.grade_over)
        if piece == 2:
            low, high = ground.grade_over, np.inf
        if dx == 0.0:
            if ahead < low or ahead > high:
                continue
        else:
            s, t = (low - ahead) / dx, (high - ahead) / dx
            near, far = max(near, min(s, t)), min(far, max(s, t))
        if near > far:
            continue
        if piece == 1:
            t = first_root(-a * dx * dx, 0.5 * dz - a * dx * ahead, above - a * ahead * ahead, near, far)
        else:
            slope, offset = (0.0, 0.0) if piece == 0 else (ground.grade, -0.5 * ground.grade_over)
            t = first_root(0.0, 0.5 * (dz - slope * dx), above - slope * (ahead + offset), near, far)
        best = min(best, t)
    return best


@numba.njit(**INLINED)
def over_ground(ground, ox, oy, oz, dx, dy, dz, t):  # type: ignore[no-untyped-def]
    """Return how high a ray is over the road's surface."""
    return oz + t * dz - ground_height(ground, ox + t * dx, oy + t * dy)


@numba.njit(**FLAGS)
def hit_ground(ground, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return where a ray meets the road's surface, inf where it does not.

    Bank, crown and kerbs stay within `low..high` of the profile, so the place lies between two places in closed form;
    from there by steps and then by the secant method kept inside its bracket, to 1e-12 m of height.
    """
    if ground.plain:
        return -oz / dz if dz < 0.0 else np.inf
    near = hit_profile(ground, ground.high, ox, oz, dx, dz)
    if near == np.inf or ground.low == ground.high:
        return near
    far = hit_profile(ground, ground.low, ox, oz, dx, dz)
    if far < near + FARTHEST_M and ground.bank == 0.0 and ground.crown == 0.0 and ground.curvature == 0.0:
        # Between kerbs the surface is the profile itself, beyond them the profile lifted.
        right, left = oy + min(near * dy, far * dy), oy + max(near * dy, far * dy)
        if ground.right <= right and left <= ground.left:
            return far
        if left <= ground.right - KERB_RUN_M or right >= ground.left + KERB_RUN_M:
            return near
    far = min(far, near + FARTHEST_M)
    over = over_ground(ground, ox, oy, oz, dx, dy, dz, near)
    if over <= 0.0:
        return near
    # Steps grow: the first cover the kerb of a near road, the last reach the crest far away.
    a, fa, b, fb = near, over, far, -1.0
    for step in range(1, 25):
        b = near + (far - near) * (step / 24.0) ** 2
        fb = over_ground(ground, ox, oy, oz, dx, dy, dz, b)
        if fb <= 0.0:
            break
        a, fa = b, fb
    if fb > 0.0:
        # At the lower bound the height is 0 but for rounding; without such a bound there is no ground.
        return b if fb < 1e-9 else np.inf
    for turn in range(100):
        t = (a * fb - b * fa) / (fb - fa)
        if turn % 3 == 2 or not a < t < b:
            t = 0.5 * (a + b)
        f = over_ground(ground, ox, oy, oz, dx, dy, dz, t)
        if abs(f) < 1e-12 or b - a < 1e-12:
            return t
        if f > 0.0:
            a, fa = t, f
        else:
            b, fb = t, f
    return 0.5 * (a + b)


@numba.njit(**INLINED)
def into_part(g, n, x, y, z):  # type: ignore[no-untyped-def]
    """Turn a direction of the world into the part's axes."""
    return (
        g[n, 3] * x + g[n, 6] * y + g[n, 9] * z,
        g[n, 4] * x + g[n, 7] * y + g[n, 10] * z,
        g[n, 5] * x + g[n, 8] * y + g[n, 11] * z,
    )


@numba.njit(**INLINED)
def slab(o, d, half, near, far):  # type: ignore[no-untyped-def]
    """Narrow the span of a ray to one pair of faces."""
    if d == 0.0:
        return (near, far) if abs(o) <= half else (np.inf, -np.inf)
    a, b = (-half - o) / d, (half - o) / d
    return max(near, min(a, b)), min(far, max(a, b))


@numba.njit(**INLINED)
def hit_ball(ox, oy, oz, dx, dy, dz, radius):  # type: ignore[no-untyped-def]
    """Return where a ray enters a ball around the origin, inf where it does not."""
    a, b = dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz
    # Measured from the foot of the perpendicular: the textbook discriminant loses digits far away.
    px, py, pz = ox - b / a * dx, oy - b / a * dy, oz - b / a * dz
    left = radius * radius - (px * px + py * py + pz * pz)
    if left < 0.0:
        return np.inf
    t = -b / a - np.sqrt(left / a)
    return t if t > 0.0 else np.inf


@numba.njit(**INLINED)
def hit_capsule(ox, oy, oz, dx, dy, dz, radius, half):  # type: ignore[no-untyped-def]
    """Return where a ray enters a capsule along z: its cylinder if it meets that between the ends, else an end."""
    a, b = dx * dx + dy * dy, ox * dx + oy * dy
    if a > 0.0:
        px, py = ox - b / a * dx, oy - b / a * dy
        left = radius * radius - (px * px + py * py)
        if left < 0.0:
            return np.inf
        t = -b / a - np.sqrt(left / a)
        if t > 0.0 and abs(oz + t * dz) <= half:
            return t
    return min(
        hit_ball(ox, oy, oz - half, dx, dy, dz, radius),
        hit_ball(ox, oy, oz + half, dx, dy, dz, radius),
    )


@numba.njit(**INLINED)
def hit_cone(ox, oy, oz, dx, dy, dz, lower, upper, half):  # type: ignore[no-untyped-def]
    """Return where a ray enters a truncated cone along z with flat ends, inf where it does not."""
    # From the foot of the perpendicular, as for the ball.
    foot = -(ox * dx + oy * dy + oz * dz) / (dx * dx + dy * dy + dz * dz)
    ox, oy, oz = ox + foot * dx, oy + foot * dy, oz + foot * dz
    near, far = slab(oz, dz, half, -np.inf, np.inf)
    if near > far or far + foot <= 0.0:
        return np.inf
    flare = 0.5 * (upper - lower) / half
    radius, widens = 0.5 * (lower + upper) + flare * oz, flare * dz
    a, b = dx * dx + dy * dy - widens * widens, ox * dx + oy * dy - radius * widens
    c = ox * ox + oy * oy - radius * radius
    start = max(near, -foot)
    if a * start * start + 2.0 * b * start + c <= 0.0:
        return near + foot if near > -foot else np.inf
    return first_root(a, b, c, start, far) + foot


@numba.njit(**FLAGS)
def hit(g, n, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return the parameter where a ray enters a part, inf where it does not."""
    ox, oy, oz = into_part(g, n, ox - g[n, 0], oy - g[n, 1], oz - g[n, 2])
    dx, dy, dz = into_part(g, n, dx, dy, dz)
    kind = g[n, 16]
    if kind == 0.0:
        near, far = slab(ox, dx, g[n, 12], 0.0, np.inf)
        near, far = slab(oy, dy, g[n, 13], near, far)
        near, far = slab(oz, dz, g[n, 14], near, far)
        return near if 0.0 < near <= far else np.inf
    if kind == 1.0:
        return hit_ball(ox / g[n, 12], oy / g[n, 13], oz / g[n, 14], dx / g[n, 12], dy / g[n, 13], dz / g[n, 14], 1.0)
    if kind == 2.0:
        return hit_capsule(ox, oy, oz, dx, dy, dz, g[n, 12], g[n, 14])
    return hit_cone(ox, oy, oz, dx, dy, dz, g[n, 12], g[n, 13], g[n, 14])


@numba.njit(**INLINED)
def facing(g, n, x, y, z):  # type: ignore[no-untyped-def]
    """Return the outward unit normal, in the part's axes, at a point of its surface given in them."""
    nx, ny, nz = x, y, z
    kind = g[n, 16]
    if kind == 0.0:
        ax, ay, az = abs(x) - g[n, 12], abs(y) - g[n, 13], abs(z) - g[n, 14]
        nx = np.sign(x) if ax >= ay and ax >= az else 0.0
        ny = np.sign(y) if nx == 0.0 and ay >= az else 0.0
        nz = np.sign(z) if nx == 0.0 and ny == 0.0 else 0.0
    elif kind == 1.0:
        nx, ny, nz = x / g[n, 12] ** 2, y / g[n, 13] ** 2, z / g[n, 14] ** 2
    elif kind == 2.0:
        nz = z - min(g[n, 14], max(-g[n, 14], z))
    else:
        flare, wide = 0.5 * (g[n, 13] - g[n, 12]) / g[n, 14], np.sqrt(x * x + y * y)
        inside = 0.5 * (g[n, 12] + g[n, 13]) + flare * z - wide
        if abs(z) - g[n, 14] >= -inside / np.sqrt(1.0 + flare * flare):
            return 0.0, 0.0, np.sign(z)
        nz = -flare * wide
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@numba.njit(**INLINED)
def face(g, n, mx, my, mz):  # type: ignore[no-untyped-def]
    """Return the number of the flat face with this normal in the part's axes; 0 where the part is round."""
    if g[n, 16] == 1.0 or g[n, 16] == 2.0:
        return 0
    if mz > 0.999999:
        return 1
    if mz < -0.999999:
        return 2
    if g[n, 16] == 0.0:
        return 3 if mx > 0.5 else (4 if mx < -0.5 else (5 if my > 0.5 else 6))
    return 0


@numba.njit(**INLINED)
def lit(part, sun, shades, count, x, y, z):  # type: ignore[no-untyped-def]
    """Return whether the sun reaches a point, past the parts `shades[:count]`."""
    sx, sy, sz = sun[0], sun[1], sun[2]
    for i in range(count):
        n = shades[i]
        cx, cy, cz = part[n, 0] - x, part[n, 1] - y, part[n, 2] - z
        along = cx * sx + cy * sy + cz * sz
        off = cx * cx + cy * cy + cz * cz - along * along
        if off < part[n, 15] and hit(part, n, x, y, z, sx, sy, sz) < np.inf:
            return False
    return True


@numba.njit(**INLINED)
def drawn(pattern, g, n, x, y, z, nx, ny, footprint):  # type: ignore[no-untyped-def]
    """Return brightness and share of glass of what is drawn on a box, at a point in its axes, and whether it is busy.

    That is, whether the pixel around it may hold more of the drawing than its and its neighbours' centres tell.
    """
    wide, half = (y, g[n, 13]) if abs(nx) > 0.5 else (x, g[n, 12])
    blur = 0.75 * footprint
    if pattern == 1:
        tall, top = (z, g[n, 14]) if abs(nx) > 0.5 or abs(ny) > 0.5 else (y, g[n, 13])
        inside, below = half - abs(wide), top - abs(tall)
        board = (tall + top) / 0.16
        from_gap = 0.16 * (board - np.floor(board))
        near = min(abs(inside - 0.065), abs(below - 0.065)) < 0.005 + blur
        near = near or (min(inside, below) > 0.07 - blur and (from_gap < 0.0128 + blur or from_gap > 0.16 - blur))
        busy = 1 if near and SMALL_PX * footprint > 0.01 else 0
        if inside < 0.07 or below < 0.07:
            return (0.45 if inside > 0.06 or below > 0.06 else 0.8), 0.0, busy
        return (0.45 if from_gap < 0.0128 else 1.0), 0.0, busy
    if abs(nx) < 0.5 and abs(ny) < 0.5:
        return 1.0, 0.0, 0
    count = max(1.0, np.round(2.0 * half / 2.8))
    cell = (wide + half) / (2.0 * half) * count
    u = abs(cell - np.floor(cell) - 0.5) * 2.0 * half / count
    floors = max(1.0, np.round(2.0 * g[n, 14] / 2.7))
    level = (z + g[n, 14]) / (2.0 * g[n, 14]) * floors
    v = abs(level - np.floor(level) - 0.55) * 2.0 * g[n, 14] / floors
    pane = 0.04 + blur < u < 0.5 - blur and 0.04 + blur < v < 0.65 - blur
    busy = 1 if u < 0.6 + blur and v < 0.75 + blur and not pane and SMALL_PX * footprint > 0.04 else 0
    if u < 0.5 and v < 0.65:
        return 1.0, (1.0 if u > 0.04 and v > 0.04 else 0.0), busy
    return (1.35 if u < 0.6 and v < 0.75 else 1.0), 0.0, busy


@numba.njit(**INLINED)
def sunlight(part, sun, shades, count, nx, ny, nz, x, y, z):  # type: ignore[no-untyped-def]
    """Return red, green, blue light on a surface, and whether something keeps the sun off: sky, sun."""
    direct, shadow = nx * sun[0] + ny * sun[1] + nz * sun[2], 0
    if direct > 0.0:
        lift = 1e-3
        direct *= SUN
        if not lit(part, sun, shades, count, x + lift * nx, y + lift * ny, z + lift * nz):
            direct, shadow = 0.0, 1
    else:
        direct = 0.0
    sky = SKYLIGHT + 0.47 * SKYLIGHT * nz
    return direct + 0.92 * sky, 0.95 * direct + sky, 0.85 * direct + 1.12 * sky, shadow


@numba.njit(**INLINED)
def part_color(part, sun, view, shades, count, n, x, y, z, far, given):  # type: ignore[no-untyped-def]
    """Return the light a part's surface sends out at a world point, its tag, and its texture (`given`, unless NaN)."""
    px, py, pz = into_part(part, n, x - part[n, 0], y - part[n, 1], z - part[n, 2])
    mx, my, mz = facing(part, n, px, py, pz)
    nx = part[n, 3] * mx + part[n, 4] * my + part[n, 5] * mz
    ny = part[n, 6] * mx + part[n, 7] * my + part[n, 8] * mz
    nz = part[n, 9] * mx + part[n, 10] * my + part[n, 11] * mz
    ex, ey, ez = view.middle[0] - x, view.middle[1] - y, view.middle[2] - z
    slant = abs(ex * nx + ey * ny + ez * nz) / np.sqrt(ex * ex + ey * ey + ez * ez)
    footprint = far / view.f_px / max(slant, 0.2)
    grain = given
    if grain != grain:
        grain = fractal3(px, py, pz, part[n, 21], footprint, int(part[n, 23])) if part[n, 20] > 0.0 else 0.0
    shade = max(0.08, 1.0 + part[n, 20] * grain)
    code, busy = 4 * face(part, n, mx, my, mz), 0
    red, green, blue = part[n, 17], part[n, 18], part[n, 19]
    if part[n, 22] > 0.0:
        bright, glass, busy = drawn(part[n, 22], part, n, px, py, pz, mx, my, footprint)
        shade *= bright
        code += 1 if glass > 0.0 else (2 if bright < 0.6 else (3 if bright != 1.0 else 0))
        if glass > 0.0:
            shade, red, green, blue = 1.0, 0.05, 0.07, 0.10
    r, q, b, shadow = sunlight(part, sun, shades, count, nx, ny, nz, x, y, z)
    return shade * red * r, shade * green * q, shade * blue * b, (code * 2 + shadow) * 2 + busy, grain


@numba.njit(**FLAGS)
def marked(mark, i, s, t):  # type: ignore[no-untyped-def]
    """Return what a mark shows at a point of the road: 0 nothing, 1 paint, 2 patch, 3 seam, 4 iron, 5 its relief."""
    kind, a, b = mark[i, 0], s - mark[i, 1], t - mark[i, 2]
    length, half = mark[i, 3], 0.5 * mark[i, 4]
    if a < 0.0 or a >= length or abs(b) >= half:
        return 0
    if kind == 0.0:
        stripe = (b + half) / 0.5
        return 1 if stripe - 2.0 * np.floor(0.5 * stripe) < 1.0 else 0
    if kind == 1.0:
        wide = 0.25 * half if a < 0.6 * length else half * (length - a) / (0.4 * length)
        return 1 if abs(b) < wide else 0
    if kind == 2.0:
        edge = half * a / length - abs(b)
        chevron = (a + abs(b)) / 2.0
        return 1 if edge > 0.0 and (edge < 0.15 or chevron - np.floor(chevron) < 0.4) else 0
    if kind == 3.0:
        return 3 if min(a, length - a, half - abs(b)) < 0.04 else 2
    p, q = 2.0 * a / length - 1.0, b / half
    r2 = p * p + q * q
    if r2 >= 1.0:
        return 0
    return 5 if r2 > 0.8 or (np.floor(a / 0.06) + np.floor(b / 0.06)) % 2.0 == 0.0 else 4


@numba.njit(**INLINED)
def ground_color(part, line, mark, sun, paint, ground, seed, view, shades, count, x, y, z, far, given):  # type: ignore[no-untyped-def]
    """Return the light the ground sends out at a world point, its tag, and the texture of its asphalt.

    There is asphalt (`given` is its texture, unless NaN), what is on it, kerb, verge; off the asphalt that is NaN.
    """
    nx, ny, nz = ground_normal(ground, x, y)
    ex, ey, ez = view.middle[0] - x, view.middle[1] - y, view.middle[2] - z
    slant = abs(ex * nx + ey * ny + ez * nz) / np.sqrt(ex * ex + ey * ey + ez * ez)
    across = far / view.f_px
    along = across / max(slant, 1e-3)
    s, t, _, _ = on_road(ground, x, y)
    out = max(ground.right - t, t - ground.left)
    code, busy, grain = 0, 0, np.nan
    if out > KERB_M:
        blades = fractal2(x, y, 0.35, across, along, seed + 50)
        patches = fractal2(x, y, 6.0, 0.4, 0.4, seed + 70)
        shade = max(0.1, 1.0 + 0.3 * blades + 0.10 * patches)
        red, green, blue = shade * paint[4] * (1.0 + 0.16 * patches), shade * paint[5], shade * paint[6]
        code = 1
    elif out > 0.0:
        joint = s - np.floor(s)
        shade = 0.36 * (1.0 + 0.12 * fractal2(x, y, 0.6, across, along, seed + 20))
        shade *= 0.6 if joint < 0.02 else 1.0
        red, green, blue = shade, shade, 0.97 * shade
        code, busy = (2 if out > KERB_RUN_M or ground.kerb == 0.0 else 3), 1
    else:
        grain = given if given == given else fractal2(x, y, 0.8, across, along, seed)
        shade = max(0.1, 1.0 + paint[0] * grain)
        white = 0.62 * (1.0 + 0.6 * paint[0] * grain)
        red, green, blue = shade * paint[1], shade * paint[2], shade * paint[3]
        for i in range(len(line)):
            if abs(t - line[i, 0]) < 0.5 * line[i, 1]:
                period = line[i, 2] + line[i, 3]
                if line[i, 3] > 0.0 and s - period * np.floor(s / period) >= line[i, 2]:
                    continue
                red, green, blue = white, white, 0.96 * white
                code = 8 + i
            # Far off a line may lie between two pixel centres.
            if SMALL_PX * across > line[i, 1] and abs(t - line[i, 0]) < line[i, 1] + across:
                busy = 1
        for i in range(len(mark)):
            shown = marked(mark, i, s, t)
            if shown == 1:
                red, green, blue = white, white, 0.96 * white
            elif shown == 2 or shown == 3:
                old = 0.72 if shown == 2 else 0.45
                red, green, blue = old * shade * paint[1], old * shade * paint[2], old * shade * paint[3]
            elif shown > 3:
                iron = 0.10 if shown == 4 else 0.16
                red, green, blue = iron, iron, iron
            if shown:
                code = 1000 + 8 * i + shown
            a, b = s - mark[i, 1], abs(t - mark[i, 2])
            if -along < a < mark[i, 3] + along and b < 0.5 * mark[i, 4] + along:
                fine = 0.06 if mark[i, 0] == 4.0 else (0.04 if shown == 3 else 0.15)
                busy = 1 if SMALL_PX * along > fine else busy
    r, q, b, shadow = sunlight(part, sun, shades, count, nx, ny, nz, x, y, z)
    return red * r, green * q, blue * b, (code * 2 + shadow) * 2 + busy, grain


@numba.njit(**INLINED)
def sky_color(dx, dy, dz, pixel, seed):  # type: ignore[no-untyped-def]
    """Return the light from infinity in a direction, and its tag: two rows of hills, sky, clouds.

    `pixel` is its angle, radians.
    """
    azimuth, rise = np.arctan2(dy, dx), dz / np.sqrt(dx * dx + dy * dy)
    if rise < 0.15:
        near = 0.020 + 0.014 * fractal2(azimuth, 0.5, 0.35, 0.01, 0.01, seed + 90)
        if rise < near:
            shade = 1.0 + 0.22 * fractal2(azimuth, rise, 0.03, pixel, pixel, seed + 92)
            return 0.16 * shade, 0.23 * shade, 0.15 * shade, 4
        far = 0.050 + 0.020 * fractal2(azimuth, 0.5, 0.5, 0.02, 0.02, seed + 91)
        if rise < far:
            shade = 1.0 + 0.07 * fractal2(azimuth, rise, 0.06, pixel, pixel, seed + 93)
            return 0.29 * shade, 0.37 * shade, 0.44 * shade, 8
    height = rise + 0.16
    cloud = 0.5 + 0.42 * fractal2(azimuth / height, 1.6 / height, 2.2, 0.05, 0.05, seed + 94)
    cloud = min(1.0, max(0.0, cloud)) ** 2
    high = min(1.0, max(0.0, rise / 0.45))
    red, green, blue = 0.62 - 0.38 * high, 0.74 - 0.30 * high, 0.88 - 0.16 * high
    return red + cloud * (0.93 - red), green + cloud * (0.94 - green), blue + cloud * (0.95 - blue), 0


@numba.njit(**INLINED)
def way(view, rays, u, v, du, dv):  # type: ignore[no-untyped-def]
    """Return the direction in the world of the ray through a place `du, dv` from the centre of pixel u, v.

    A pinhole's has a forward component of 1. Other lenses have `rays`: (height + 4, width + 4, 3) exact unit vectors of
    the pixel centres in the camera frame, two more on each side; between them a parabola per axis.
    """
    if rays.shape[0] == 0:
        x, y, z = (u + du - view.lens[2]) / view.lens[0], (v + dv - view.lens[3]) / view.lens[1], 1.0
    else:
        i, j = v + 2, u + 2
        x, y, z = rays[i, j, 0], rays[i, j, 1], rays[i, j, 2]
        if du != 0.0 or dv != 0.0:
            a, b, c, d = 0.5 * du * (du - 1.0), 0.5 * du * (du + 1.0), 0.5 * dv * (dv - 1.0), 0.5 * dv * (dv + 1.0)
            e = -du * du - dv * dv
            x += a * rays[i, j - 1, 0] + b * rays[i, j + 1, 0] + c * rays[i - 1, j, 0] + d * rays[i + 1, j, 0] + e * x
            y += a * rays[i, j - 1, 1] + b * rays[i, j + 1, 1] + c * rays[i - 1, j, 1] + d * rays[i + 1, j, 1] + e * y
            z += a * rays[i, j - 1, 2] + b * rays[i, j + 1, 2] + c * rays[i - 1, j, 2] + d * rays[i + 1, j, 2] + e * z
    axes = view.axes
    return (
        axes[0] * x + axes[1] * y + axes[2] * z,
        axes[3] * x + axes[4] * y + axes[5] * z,
        axes[6] * x + axes[7] * y + axes[8] * z,
    )


@numba.njit(**INLINED)
def first_hit(part, ground, eye, dx, dy, dz, near, count):  # type: ignore[no-untyped-def]
    """Return what a ray meets first among `near[:count]` and the ground, and where."""
    met, depth = SKY, hit_ground(ground, eye[0], eye[1], eye[2], dx, dy, dz)
    if depth < np.inf:
        met = GROUND
    for i in range(count):
        t = hit(part, near[i], eye[0], eye[1], eye[2], dx, dy, dz)
        if t < depth:
            met, depth = near[i], t
    return met, depth


@numba.njit(**INLINED)
def light(part, line, mark, sun, paint, ground, seed, view, shades, count, met, depth, dx, dy, dz, given):  # type: ignore[no-untyped-def]
    """Return the linear light that comes from a ray's first hit, its tag, and its texture (`given`, unless NaN)."""
    if met == SKY:
        red, green, blue, tag = sky_color(dx, dy, dz, 1.0 / view.f_px, seed)
        return red, green, blue, tag, np.nan
    x, y, z = view.eye[0] + depth * dx, view.eye[1] + depth * dy, view.eye[2] + depth * dz
    mx, my, mz = x - view.middle[0], y - view.middle[1], z - view.middle[2]
    if view.round:
        far = np.sqrt(mx * mx + my * my + mz * mz)
    else:
        far = max(1e-3, mx * view.ahead[0] + my * view.ahead[1] + mz * view.ahead[2])
    if met == GROUND:
        red, green, blue, tag, grain = ground_color(
            part, line, mark, sun, paint, ground, seed, view, shades, count, x, y, z, far, given
        )
    else:
        red, green, blue, tag, grain = part_color(part, sun, view, shades, count, met, x, y, z, far, given)
    clear = np.exp(-far / HAZE_M)
    fog = 1.0 - clear
    return (
        clear * red + 0.5 * fog,
        clear * green + 0.56 * fog,
        clear * blue + 0.62 * fog,
        ((met - SKY) << 16) + tag,
        grain,
    )


@numba.njit(**FLAGS)
def in_tile(box, u0, v0, u1, v1, found):  # type: ignore[no-untyped-def]
    """Write the numbers of the boxes that meet a tile of pixels into `found`; return how many."""
    count = 0
    for n in range(len(box)):
        if box[n, 0] < u1 and box[n, 2] > u0 and box[n, 1] < v1 and box[n, 3] > v0:
            found[count] = n
            count += 1
    return count


@numba.njit(**INLINED)
def in_pixel(box, u, v, tile, tile_count, found):  # type: ignore[no-untyped-def]
    """Write those of a tile's numbers whose boxes hold a pixel into `found`; return how many."""
    count = 0
    for i in range(tile_count):
        n = tile[i]
        if box[n, 0] <= u < box[n, 2] and box[n, 1] <= v < box[n, 3]:
            found[count] = n
            count += 1
    return count


@numba.njit(**INLINED)
def in_reach(fat, small, eye, dx, dy, dz, near, count, all_parts):  # type: ignore[no-untyped-def]
    """Keep those of `near[:count]` that a pixel around this ray can meet; return how many, and whether one is thin.

    Where one ray alone is to be sent, asking all parts costs more than it saves: then the thin ones only.
    """
    left, thin = 0, False
    for i in range(count):
        n = near[i]
        asked = small[n] == 1 or (all_parts and small[n] == 0)
        if not asked or hit(fat, n, eye[0], eye[1], eye[2], dx, dy, dz) < np.inf:
            near[left] = n
            left += 1
            thin = thin or small[n] == 1
    return left, thin


@numba.njit(**FLAGS)
def glance(world, view, rays, candidates, first, last, scratch, image, depth, met, tags):  # type: ignore[no-untyped-def]
    """Look once through the centre of each pixel of the rows first..last-1, and of one more pixel on each side.

    Fills `image` (height, width, 3) float32 light, `depth` (height, width) ray parameter (sky: infinite, no ray: NaN),
    `met` (height, width) part, `GROUND`, `SKY` or `VOID`, and `tags` (height + 2, width + 2).
    """
    part, line, mark = world.part, world.line, world.mark
    sun, paint, ground, seed = world.sun, world.paint, world.ground, world.seed
    seen, dark, fat, small = candidates.seen, candidates.dark, candidates.fat, candidates.small
    height, width = depth.shape
    tile, near, shade_tile, shades = scratch[0], scratch[1], scratch[2], scratch[3]
    for start in range(-1, width + 1, TILE_PX):
        end = min(start + TILE_PX, width + 1)
        tile_count = in_tile(seen, start, first, end, last, tile)
        dark_count = in_tile(dark, start, first, end, last, shade_tile)
        for v in range(first, last):
            for u in range(start, end):
                dx, dy, dz = way(view, rays, u, v, 0.0, 0.0)
                if dx != dx:
                    tags[v + 1, u + 1] = VOID
                    if 0 <= v < height and 0 <= u < width:
                        image[v, u, 0], image[v, u, 1], image[v, u, 2] = 0.0, 0.0, 0.0
                        depth[v, u], met[v, u] = np.nan, VOID
                    continue
                count = in_pixel(seen, u, v, tile, tile_count, near)
                count, thin = in_reach(fat, small, view.eye, dx, dy, dz, near, count, False)
                what, t = first_hit(part, ground, view.eye, dx, dy, dz, near, count)
                dark_here = in_pixel(dark, u, v, shade_tile, dark_count, shades)
                red, green, blue, tag, _ = light(
                    part, line, mark, sun, paint, ground, seed, view, shades, dark_here, what, t, dx, dy, dz, np.nan
                )
                tags[v + 1, u + 1] = (tag | 1) if thin else tag
                if 0 <= v < height and 0 <= u < width:
                    image[v, u, 0], image[v, u, 1], image[v, u, 2] = red, green, blue
                    depth[v, u], met[v, u] = t, what


@numba.njit(**INLINED)
def is_mixed(tags, u, v):  # type: ignore[no-untyped-def]
    """Return whether more than one smooth surface may lie in a pixel."""
    tag = tags[v + 1, u + 1]
    if tag & 1:
        return True
    for i in range(3):
        for j in range(3):
            if tags[v + i, u + j] != tag:
                return True
    return False


@numba.njit(**FLAGS)
def refine(world, view, rays, candidates, tags, inner, mixed, first, last, scratch, textures, image):  # type: ignore[no-untyped-def]
    """Average the light over the pixels of the rows first..last-1 of `image`.

    `inner` and `mixed`, (height, samples, 2), hold sub-pixel places of each row's samples, the same for all of its
    pixels and for both cameras: so both have one point spread, and whatever it is, it cannot shift one against the
    other. `mixed` is for pixels in which several surfaces may meet. With one sample a pixel stays as it is, and so does
    the smooth sky.

    A texture is smooth inside a pixel: where many samples are taken for the sake of outlines, later ones take the mean
    texture that earlier ones found on the same part; `textures`, (2, parts + 1), is scratch for that.
    """
    part, line, mark = world.part, world.line, world.mark
    sun, paint, ground, seed = world.sun, world.paint, world.ground, world.seed
    seen, dark, fat, small = candidates.seen, candidates.dark, candidates.fat, candidates.small
    width = image.shape[1]
    tile, near, shade_tile, shades = scratch[0], scratch[1], scratch[2], scratch[3]
    for start in range(0, width, TILE_PX):
        end = min(start + TILE_PX, width)
        tile_count = in_tile(seen, start, first, end, last, tile)
        dark_count = in_tile(dark, start, first, end, last, shade_tile)
        for v in range(first, last):
            for u in range(start, end):
                tag = tags[v + 1, u + 1]
                many = is_mixed(tags, u, v)
                samples = mixed.shape[1] if many else inner.shape[1]
                if samples == 1 or tag == VOID or (tag == 0 and not many):
                    continue
                dx, dy, dz = way(view, rays, u, v, 0.0, 0.0)
                count = in_pixel(seen, u, v, tile, tile_count, near)
                count, _ = in_reach(fat, small, view.eye, dx, dy, dz, near, count, True)
                dark_here = in_pixel(dark, u, v, shade_tile, dark_count, shades)
                textures[:, 0] = 0.0
                for i in range(count):
                    textures[:, near[i] + 1] = 0.0
                textured = max(4, samples // 8) if many else samples
                red, green, blue = 0.0, 0.0, 0.0
                for s in range(samples):
                    du, dv = (mixed[v, s, 0], mixed[v, s, 1]) if many else (inner[v, s, 0], inner[v, s, 1])
                    dx, dy, dz = way(view, rays, u, v, du, dv)
                    if dx != dx:
                        continue
                    what, t = first_hit(part, ground, view.eye, dx, dy, dz, near, count)
                    given = np.nan
                    if s >= textured and what != SKY and textures[1, what + 1] > 0.0:
                        given = textures[0, what + 1] / textures[1, what + 1]
                    r, g, b, _, grain = light(
                        part, line, mark, sun, paint, ground, seed, view, shades, dark_here, what, t, dx, dy, dz, given
                    )
                    if grain == grain and given != given:
                        textures[0, what + 1] += grain
                        textures[1, what + 1] += 1.0
                    red, green, blue = red + r, green + g, blue + b
                image[v, u, 0], image[v, u, 1], image[v, u, 2] = red / samples, green / samples, blue / samples
