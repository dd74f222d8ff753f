"""The hot loops of the renderer: rays against solids and ground, solid textures, light.

Everything a surface point looks like (texture, its fading, shading, haze) is a function of that point alone, never of
the camera that sees it; so both cameras see the same world. Rays have a forward component of 1, so their parameter is
the forward distance. Colours are linear light until `paint` encodes them.
"""

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

SKY, GROUND = -2, -1
"""What a ray meets where it meets no part; parts count from 0."""

FINEST_M = 0.004
"""Cells of texture do not get smaller."""

HAZE_M = 900.0
"""Distance over which the air hides 63 % of a thing."""

Floats = NDArray[np.float64]


class World(NamedTuple):
    """A scene as bare numbers, n parts in m things.

    The kernels hand its arrays down one by one: numba counts the references of every array in a tuple at every call,
    which cost two thirds of the time.

    Attributes
    ----------
    part
        (n, 24) centre (3), rotation world <- part row by row (9), half sizes (3), squared radius of a ball around it,
        kind (0 box, 1 ellipsoid, 2 capsule), linear red, green, blue, contrast, coarsest texture cell in metres,
        pattern (0 plain, 1 crate, 2 windows), texture seed.
    ball
        (m, 6) a ball around each thing (centre, radius), its first part, and one past its last.
    line
        (k, 4) y, width, dash, gap of each line on the road.
    sun
        (3,) unit vector towards it.
    road
        (9,) y of its right and left edge, contrast, linear asphalt and verge colours.
    seed
        Of ground and sky.
    """

    part: Floats
    ball: Floats
    line: Floats
    sun: tuple[float, ...]
    road: tuple[float, ...]
    seed: int


class View(NamedTuple):
    """One camera in the world.

    Attributes
    ----------
    eye, middle
        (3,) its optical centre, and the point halfway between the cameras.
    axes
        (9,) rotation world <- camera, row by row.
    f_px, cx_px, cy_px
        Its intrinsics.
    """

    eye: tuple[float, ...]
    middle: tuple[float, ...]
    axes: tuple[float, ...]
    f_px: float
    cx_px: float
    cy_px: float


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lattice(i, j, k, seed):  # type: ignore[no-untyped-def]
    """Return a fixed random number in -1..1 for a lattice point."""
    h = (i * 374761393 + j * 668265263 + k * 1103515245 + seed * 974711) & 0xFFFFFFFF
    h = ((h ^ (h >> 15)) * 1274126177) & 0xFFFFFFFF
    h = ((h ^ (h >> 13)) * 1911520717) & 0xFFFFFFFF
    return (h ^ (h >> 16)) * (2.0 / 4294967295.0) - 1.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def kept(cell, footprint):  # type: ignore[no-untyped-def]
    """Return how much of an octave is left under a pixel of this footprint: from all to none before it aliases."""
    return min(1.0, max(0.0, cell / footprint - 1.0))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fractal2(x, y, coarsest, across, along, seed):  # type: ignore[no-untyped-def]
    """Return a texture of a plane with an amplitude spectrum of 1/f, about unit variance when seen near.

    Equal amplitude for each octave *is* 1/f in two dimensions. `across` and `along` are the pixel's footprint: rows
    average along it, which leaves a share of the contrast; across it octaves must vanish before they alias.
    """
    total, cell = 0.0, coarsest
    while cell > across and cell > FINEST_M:
        total += kept(cell, across) * min(1.0, np.sqrt(cell / along)) * noise2(x / cell, y / cell, seed)
        x, y = 0.8 * x - 0.6 * y + 3.1 * cell, 0.6 * x + 0.8 * y + 7.7 * cell
        cell *= 0.5
        seed += 1
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def fractal3(x, y, z, coarsest, footprint, seed):  # type: ignore[no-untyped-def]
    """Return `fractal2` for a solid."""
    total, cell = 0.0, coarsest
    while cell > footprint and cell > FINEST_M:
        total += kept(cell, footprint) * noise3(x / cell, y / cell, z / cell, seed)
        x, y, z = 0.8 * x - 0.6 * y + 3.1 * cell, 0.36 * x + 0.48 * y - 0.8 * z, 0.48 * x + 0.64 * y + 0.6 * z
        cell *= 0.5
        seed += 1
    return total


@numba.njit(cache=True, nogil=True, error_model="numpy")
def into_part(g, n, x, y, z):  # type: ignore[no-untyped-def]
    """Turn a direction of the world into the part's axes."""
    return (
        g[n, 3] * x + g[n, 6] * y + g[n, 9] * z,
        g[n, 4] * x + g[n, 7] * y + g[n, 10] * z,
        g[n, 5] * x + g[n, 8] * y + g[n, 11] * z,
    )


@numba.njit(cache=True, nogil=True, error_model="numpy")
def slab(o, d, half, near, far):  # type: ignore[no-untyped-def]
    """Narrow the span of a ray to one pair of faces."""
    if d == 0.0:
        return (near, far) if abs(o) <= half else (np.inf, -np.inf)
    a, b = (-half - o) / d, (half - o) / d
    return max(near, min(a, b)), min(far, max(a, b))


@numba.njit(cache=True, nogil=True, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def hit(g, n, ox, oy, oz, dx, dy, dz):  # type: ignore[no-untyped-def]
    """Return the parameter where a ray enters a part, inf where it does not."""
    ox, oy, oz = into_part(g, n, ox - g[n, 0], oy - g[n, 1], oz - g[n, 2])
    dx, dy, dz = into_part(g, n, dx, dy, dz)
    if g[n, 16] == 0.0:
        near, far = slab(ox, dx, g[n, 12], 0.0, np.inf)
        near, far = slab(oy, dy, g[n, 13], near, far)
        near, far = slab(oz, dz, g[n, 14], near, far)
        return near if 0.0 < near <= far else np.inf
    if g[n, 16] == 1.0:
        return hit_ball(ox / g[n, 12], oy / g[n, 13], oz / g[n, 14], dx / g[n, 12], dy / g[n, 13], dz / g[n, 14], 1.0)
    return hit_capsule(ox, oy, oz, dx, dy, dz, g[n, 12], g[n, 14])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def facing(g, n, x, y, z):  # type: ignore[no-untyped-def]
    """Return the outward unit normal, in the part's axes, at a point of its surface given in them."""
    nx, ny, nz = x, y, z
    if g[n, 16] == 0.0:
        ax, ay, az = abs(x) - g[n, 12], abs(y) - g[n, 13], abs(z) - g[n, 14]
        nx = np.sign(x) if ax >= ay and ax >= az else 0.0
        ny = np.sign(y) if nx == 0.0 and ay >= az else 0.0
        nz = np.sign(z) if nx == 0.0 and ny == 0.0 else 0.0
    elif g[n, 16] == 1.0:
        nx, ny, nz = x / g[n, 12] ** 2, y / g[n, 13] ** 2, z / g[n, 14] ** 2
    else:
        nz = z - min(g[n, 14], max(-g[n, 14], z))
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length


@numba.njit(cache=True, nogil=True, error_model="numpy")
def lit(part, ball, sun, x, y, z):  # type: ignore[no-untyped-def]
    """Return whether the sun reaches a point."""
    sx, sy, sz = sun[0], sun[1], sun[2]
    for thing in range(len(ball)):
        cx, cy, cz, radius = ball[thing, 0] - x, ball[thing, 1] - y, ball[thing, 2] - z, ball[thing, 3]
        along = cx * sx + cy * sy + cz * sz
        off = cx * cx + cy * cy + cz * cz - along * along
        if along > -radius and off < radius * radius:
            for n in range(int(ball[thing, 4]), int(ball[thing, 5])):
                cx, cy, cz = part[n, 0] - x, part[n, 1] - y, part[n, 2] - z
                along = cx * sx + cy * sy + cz * sz
                off = cx * cx + cy * cy + cz * cz - along * along
                if off < part[n, 15] and hit(part, n, x, y, z, sx, sy, sz) < np.inf:
                    return False
    return True


@numba.njit(cache=True, nogil=True, error_model="numpy")
def drawn(pattern, g, n, x, y, z, nx, ny):  # type: ignore[no-untyped-def]
    """Return brightness and share of glass of what is drawn on a box, at a point in its axes."""
    wide, half = (y, g[n, 13]) if abs(nx) > 0.5 else (x, g[n, 12])
    if pattern == 1:
        tall, top = (z, g[n, 14]) if abs(nx) > 0.5 or abs(ny) > 0.5 else (y, g[n, 13])
        if half - abs(wide) < 0.07 or top - abs(tall) < 0.07:
            return (0.45 if half - abs(wide) > 0.06 or top - abs(tall) > 0.06 else 0.8), 0.0
        board = (tall + top) / 0.16
        return (0.45 if board - np.floor(board) < 0.08 else 1.0), 0.0
    if abs(nx) < 0.5 and abs(ny) < 0.5:
        return 1.0, 0.0
    count = max(1.0, np.round(2.0 * half / 2.8))
    cell = (wide + half) / (2.0 * half) * count
    u = abs(cell - np.floor(cell) - 0.5) * 2.0 * half / count
    floors = max(1.0, np.round(2.0 * g[n, 14] / 2.7))
    level = (z + g[n, 14]) / (2.0 * g[n, 14]) * floors
    v = abs(level - np.floor(level) - 0.55) * 2.0 * g[n, 14] / floors
    if u < 0.5 and v < 0.65:
        return 1.0, (1.0 if u > 0.04 and v > 0.04 else 0.0)
    return (1.35 if u < 0.6 and v < 0.75 else 1.0), 0.0


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sunlight(part, ball, sun, nx, ny, nz, x, y, z):  # type: ignore[no-untyped-def]
    """Return red, green, blue light on a surface: sky from above, and the sun if nothing stands before it."""
    direct = nx * sun[0] + ny * sun[1] + nz * sun[2]
    if direct > 0.0:
        lift = 1e-3
        direct = direct * 1.05 if lit(part, ball, sun, x + lift * nx, y + lift * ny, z + lift * nz) else 0.0
    else:
        direct = 0.0
    sky = 0.30 + 0.14 * nz
    return direct + 0.92 * sky, 0.95 * direct + sky, 0.85 * direct + 1.12 * sky


@numba.njit(cache=True, nogil=True, error_model="numpy")
def part_color(part, ball, sun, view, n, x, y, z, depth):  # type: ignore[no-untyped-def]
    """Return the light a part's surface sends out at a world point."""
    px, py, pz = into_part(part, n, x - part[n, 0], y - part[n, 1], z - part[n, 2])
    mx, my, mz = facing(part, n, px, py, pz)
    nx = part[n, 3] * mx + part[n, 4] * my + part[n, 5] * mz
    ny = part[n, 6] * mx + part[n, 7] * my + part[n, 8] * mz
    nz = part[n, 9] * mx + part[n, 10] * my + part[n, 11] * mz
    ex, ey, ez = view.middle[0] - x, view.middle[1] - y, view.middle[2] - z
    slant = abs(ex * nx + ey * ny + ez * nz) / np.sqrt(ex * ex + ey * ey + ez * ez)
    footprint = depth / view.f_px / max(slant, 0.2)
    shade = max(0.08, 1.0 + part[n, 20] * fractal3(px, py, pz, part[n, 21], footprint, int(part[n, 23])))
    glass = 0.0
    if part[n, 22] > 0.0:
        bright, glass = drawn(part[n, 22], part, n, px, py, pz, mx, my)
        shade *= bright
    red, green, blue = shade * part[n, 17], shade * part[n, 18], shade * part[n, 19]
    if glass > 0.0:
        red, green, blue = 0.05, 0.07, 0.10
    r, q, b = sunlight(part, ball, sun, nx, ny, nz, x, y, z)
    return red * r, green * q, blue * b


@numba.njit(cache=True, nogil=True, error_model="numpy")
def ground_color(part, ball, line, sun, road, seed, view, x, y, depth):  # type: ignore[no-untyped-def]
    """Return the light the ground sends out at a world point: asphalt, lines, kerb stones, verge."""
    across = depth / view.f_px
    along = across * max(1.0, depth / view.middle[2])
    right, left = y - road[0], road[1] - y
    if right < -0.18 or left < -0.18:
        blades = fractal2(x, y, 0.35, across, along, seed + 50)
        patches = fractal2(x, y, 6.0, 0.4, 0.4, seed + 70)
        shade = max(0.1, 1.0 + 0.3 * blades + 0.10 * patches)
        red, green, blue = shade * road[6] * (1.0 + 0.16 * patches), shade * road[7], shade * road[8]
    elif right < 0.0 or left < 0.0:
        joint = x - np.floor(x)
        shade = 0.36 * (1.0 + 0.12 * fractal2(x, y, 0.6, across, along, seed + 20))
        shade *= 0.6 if joint < 0.02 else 1.0
        red, green, blue = shade, shade, 0.97 * shade
    else:
        grain = fractal2(x, y, 0.8, across, along, seed)
        shade = max(0.1, 1.0 + road[2] * grain)
        red, green, blue = shade * road[3], shade * road[4], shade * road[5]
        for i in range(len(line)):
            if abs(y - line[i, 0]) < 0.5 * line[i, 1]:
                period = line[i, 2] + line[i, 3]
                if line[i, 3] > 0.0 and x - period * np.floor(x / period) >= line[i, 2]:
                    continue
                paint = 0.62 * (1.0 + 0.6 * road[2] * grain)
                red, green, blue = paint, paint, 0.96 * paint
    r, q, b = sunlight(part, ball, sun, 0.0, 0.0, 1.0, x, y, 0.0)
    return red * r, green * q, blue * b


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sky_color(dx, dy, dz, pixel, seed):  # type: ignore[no-untyped-def]
    """Return the light from infinity in a direction: two rows of hills, sky, clouds. `pixel` is its angle, radians."""
    azimuth, rise = np.arctan2(dy, dx), dz / np.sqrt(dx * dx + dy * dy)
    if rise < 0.15:
        near = 0.020 + 0.014 * fractal2(azimuth, 0.5, 0.35, 0.01, 0.01, seed + 90)
        if rise < near:
            shade = 1.0 + 0.22 * fractal2(azimuth, rise, 0.03, pixel, pixel, seed + 92)
            return 0.16 * shade, 0.23 * shade, 0.15 * shade
        far = 0.050 + 0.020 * fractal2(azimuth, 0.5, 0.5, 0.02, 0.02, seed + 91)
        if rise < far:
            shade = 1.0 + 0.07 * fractal2(azimuth, rise, 0.06, pixel, pixel, seed + 93)
            return 0.29 * shade, 0.37 * shade, 0.44 * shade
    height = rise + 0.16
    cloud = 0.5 + 0.42 * fractal2(azimuth / height, 1.6 / height, 2.2, 0.05, 0.05, seed + 94)
    cloud = min(1.0, max(0.0, cloud)) ** 2
    high = min(1.0, max(0.0, rise / 0.45))
    red, green, blue = 0.62 - 0.38 * high, 0.74 - 0.30 * high, 0.88 - 0.16 * high
    return red + cloud * (0.93 - red), green + cloud * (0.94 - green), blue + cloud * (0.95 - blue)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def first_hit(part, view, u, v, near, count):  # type: ignore[no-untyped-def]
    """Return what the ray through a pixel position meets first among `near[:count]` and ground, its depth, its way."""
    x, y = (u - view.cx_px) / view.f_px, (v - view.cy_px) / view.f_px
    axes, eye = view.axes, view.eye
    dx = axes[0] * x + axes[1] * y + axes[2]
    dy = axes[3] * x + axes[4] * y + axes[5]
    dz = axes[6] * x + axes[7] * y + axes[8]
    met, depth = SKY, np.inf
    if dz < 0.0:
        met, depth = GROUND, -eye[2] / dz
    for i in range(count):
        t = hit(part, near[i], eye[0], eye[1], eye[2], dx, dy, dz)
        if t < depth:
            met, depth = near[i], t
    return met, depth, dx, dy, dz


@numba.njit(cache=True, nogil=True, error_model="numpy")
def light(part, ball, line, sun, road, seed, view, u, v, near, count):  # type: ignore[no-untyped-def]
    """Return the linear light that comes along one ray."""
    met, depth, dx, dy, dz = first_hit(part, view, u, v, near, count)
    if met == SKY:
        return sky_color(dx, dy, dz, 1.0 / view.f_px, seed)
    x, y, z = view.eye[0] + depth * dx, view.eye[1] + depth * dy, view.eye[2] + depth * dz
    if met == GROUND:
        red, green, blue = ground_color(part, ball, line, sun, road, seed, view, x, y, depth)
    else:
        red, green, blue = part_color(part, ball, sun, view, met, x, y, z, depth)
    clear = np.exp(-depth / HAZE_M)
    return clear * red + 0.5 * (1 - clear), clear * green + 0.56 * (1 - clear), clear * blue + 0.62 * (1 - clear)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def in_row(box, v, near):  # type: ignore[no-untyped-def]
    """Write the parts that row v may see into `near`; return how many."""
    count = 0
    for n in range(len(box)):
        if box[n, 1] <= v < box[n, 3]:
            near[count] = n
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def in_pixel(box, u, row, row_count, near):  # type: ignore[no-untyped-def]
    """Write those of a row's parts that column u may see into `near`; return how many."""
    count = 0
    for i in range(row_count):
        if box[row[i], 0] <= u < box[row[i], 2]:
            near[count] = row[i]
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def encoded(value):  # type: ignore[no-untyped-def]
    """Return linear light as a grey level 0..255 (gamma 2.2, clipped)."""
    return 255.0 * min(1.0, max(0.0, value)) ** (1.0 / 2.2)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def paint(world, view, box, offsets, first, last, image):  # type: ignore[no-untyped-def]
    """Fill rows first..last-1 of `image`, (height, width, 3) float32 grey levels.

    `offsets`, (height, samples, 2), holds the sub-pixel positions of each row's samples, the same for all of its
    pixels and for both cameras: so both have one point spread, and whatever it is, it cannot shift one against the
    other. `box`, (n, 4), holds the half-open pixel box (u0, v0, u1, v1) outside of which this camera cannot see a part.
    """
    samples = offsets.shape[1]
    row, near = np.empty(len(box), np.int64), np.empty(len(box), np.int64)
    part, ball, line = world.part, world.ball, world.line
    sun, road, seed = world.sun, world.road, world.seed
    for v in range(first, last):
        row_count = in_row(box, v, row)
        for u in range(image.shape[1]):
            count = in_pixel(box, u, row, row_count, near)
            red, green, blue = 0.0, 0.0, 0.0
            for s in range(samples):
                x, y = u + offsets[v, s, 0], v + offsets[v, s, 1]
                r, g, b = light(part, ball, line, sun, road, seed, view, x, y, near, count)
                red, green, blue = red + r, green + g, blue + b
            image[v, u, 0] = encoded(red / samples)
            image[v, u, 1] = encoded(green / samples)
            image[v, u, 2] = encoded(blue / samples)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def measure(world, view, box, first, last, depth, met):  # type: ignore[no-untyped-def]
    """Fill rows first..last-1 of `depth` (metres; sky inf) and `met` (part, `GROUND`, `SKY`), at pixel centres."""
    row, near = np.empty(len(box), np.int64), np.empty(len(box), np.int64)
    part = world.part
    for v in range(first, last):
        row_count = in_row(box, v, row)
        for u in range(depth.shape[1]):
            count = in_pixel(box, u, row, row_count, near)
            met[v, u], depth[v, u], _, _, _ = first_hit(part, view, float(u), float(v), near, count)
