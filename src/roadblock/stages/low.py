"""Low: a rectified pair and the road in, low obstacles out.

The right image is laid over the left one by the road's own disparity. What is painted on the road then coincides; what
stands on it slides aside, the more the higher it is. Each patch is asked which of the two explains it better.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from scipy.sparse.csgraph import connected_components

from roadblock.kernels.compiled import low as kernels
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import GroundPlane, Region

BLOCKS = 6
"""Across the corridor, where the road's own offset is measured."""
STRIP_ROWS = 6
NOISE_FLOOR = 0.3
"""Least variance of a difference of two smoothed pixels: of rounding, and a little."""
MOST_HITS = 40
WEAK = 0.75
"""So much of the evidence makes a weak hit, which only helps to tell kerbs."""
NEARER = 0.7
"""Power of range by which nearer patches, which have more pixels, need more evidence, ..."""
AVERAGED_M = 10.0
"""... up to here: nearer pixels are averaged."""
KERB_M, KERB_HITS, KERB_OFF_M = 2.0, 5, 0.1
"""What goes on straight for longer than this, in so many hits no further off, is a kerb or a verge."""
REPORTED = 0.94
"""Share of the reach up to which something is reported: beyond, one sees how a kerb goes on."""
STRAYS = 5
"""So many weak hits that belong to nothing are images in a wet road, among which nothing can be told."""
MIRRORS = "the road mirrors: low obstacles cannot be told"


class LowSettings(BaseModel):
    """Where low obstacles are looked for, and how sure one must be."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    enabled: bool = Field(False, description="Look for them at all; costs about a tenth of StereoBM's time.")
    side_m: float = Field(2.5, gt=0, description="Half the width of the corridor.")
    reach_m: tuple[float, float] = Field((5.0, 35.0), description="From here to there, ahead.")
    heights_m: tuple[float, ...] = Field((0.08, 0.14, 0.25), description="Heights that are tried.")
    width_m: float = Field(0.12, gt=0, description="Width of a patch.")
    sample_m: float = Field(0.03, gt=0, description="Pixels finer than this are averaged, two by two.")
    evidence: float = Field(7.2, gt=0, description="Least log-likelihood ratio against the road at the far end, ...")
    gain: float = Field(1.0, gt=0, description="... and how much of it each pixel must give at least.")


def _grey(image: Image) -> Image:
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image


@dataclass
class Band:
    """Rows of one averaging: tables per row, and scratch images."""

    bin_px: int
    rows: NDArray[np.int64]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    d_px: FloatArray
    slope: FloatArray
    middle: float
    z_m: FloatArray
    near: NDArray[np.float32]
    far: NDArray[np.float32]
    weight: NDArray[np.float32]
    variance: float = 1.0

    @property
    def strips(self) -> int:
        """How many groups of rows the road is measured in."""
        return max(1, len(self.rows) // STRIP_ROWS)

    def warp(self, left: Image, right: Image, gain: FloatArray | float, tilt: float, step: int = 1) -> None:
        """Fill `near` and `far` (see the kernel)."""
        gains = np.broadcast_to(np.asarray(gain, float), self.d_px.shape).copy()
        kernels.warp(
            left,
            right,
            self.bin_px,
            self.rows,
            self.first,
            self.last,
            self.d_px,
            self.slope,
            self.middle,
            gains,
            tilt,
            step,
            self.near,
            self.far,
        )

    def measure(self, step: int = 1) -> NDArray[np.float32]:
        """Return the sums of each block (see the kernel)."""
        sums = np.empty((self.strips, BLOCKS, 8), np.float32)
        kernels.road_sums(self.near, self.far, self.first, self.last, step, sums)
        return sums

    def blocks(self) -> tuple[FloatArray, FloatArray]:
        """Return where the blocks are: column from the middle and row, full-resolution pixels."""
        at = (np.arange(self.strips) + 0.5) * len(self.rows) / self.strips
        a, z = self.first[at.astype(int)], self.last[at.astype(int)]
        u = a[:, None] + (z - a)[:, None] * (np.arange(BLOCKS) + 0.5) / BLOCKS - self.middle
        v = np.broadcast_to((self.rows[0] + at)[:, None], u.shape)
        return self.bin_px * u, self.bin_px * v


class LowFinder:
    """Owns the scratch images."""

    def __init__(self, settings: LowSettings | None = None) -> None:
        self.settings = settings or LowSettings()
        self.scratch: dict[int, NDArray[np.float32]] = {}

    def __call__(self, pair: RectifiedPair, ground: GroundPlane | None) -> tuple[tuple[Region, ...], str | None]:
        """Return what stands low on the road in the corridor, and why nothing could be told, if so."""
        if ground is None:
            return (), None
        left, right = (_grey(image) for image in (pair.left, pair.right))
        bands, hits = examine(self, left, right, pair.rectification, ground)
        return regions_of(bands, hits, pair.left, pair.rectification, REPORTED * self.settings.reach_m[1])

    def images(self, c: int, rows: int, width: int) -> NDArray[np.float32]:
        """Return (3, at least rows, width) scratch images of one averaging, made once."""
        have = self.scratch.get(c)
        if have is None or have.shape[1] < rows or have.shape[2] != width:
            have = self.scratch[c] = np.zeros((3, rows + 8, width), np.float32)
        return have

    def bands(self, r: Rectification, ground: GroundPlane) -> list[Band]:
        """Return the corridor's rows, from coarse (near) to full resolution (far)."""
        s = self.settings
        width, height = r.size_px
        v = np.arange(height, dtype=float)
        bands = []
        z_full = road_z(r, ground, np.full(height, r.cx_px), v)
        near, far = s.reach_m
        for c in (4, 2, 1):
            # This averaging holds while a sample is no coarser than sample_m (c = 1: all that is left).
            limit = s.sample_m * r.f_px / c
            z_lo, z_hi = (near if c == 4 else s.sample_m * r.f_px / (2 * c)), (far if c == 1 else limit)
            z_lo, z_hi = max(z_lo, near), min(z_hi, far)
            use = np.flatnonzero(np.isfinite(z_full) & (z_full >= z_lo) & (z_full <= z_hi))
            if len(use) < 8 * c or z_hi <= z_lo:
                continue
            up = int(max(s.heights_m) * r.f_px / z_hi) + 2 * c
            top, bottom = max(0, use.min() - up), min(use.max(), height - 1)
            rows = np.arange(top // c + 1, bottom // c)
            at = c * rows + (c - 1) / 2
            middle = r.cx_px
            z = road_z(r, ground, np.full(len(rows), middle), at)
            ok = np.isfinite(z)
            rows, at, z = rows[ok], at[ok], z[ok]
            d = r.f_px * r.baseline_m / z
            slope = (r.f_px * r.baseline_m / road_z(r, ground, np.full(len(rows), middle + 100.0), at) - d) / 100
            # A foot's columns are needed in the rows above it as well.
            z_foot = z[np.minimum(np.arange(len(z)) + (up // c), len(z) - 1)]
            left = r.cx_px + (-s.side_m + r.baseline_m / 2) * r.f_px / z_foot
            right = r.cx_px + (s.side_m + r.baseline_m / 2) * r.f_px / z_foot
            left = np.maximum(left, d + np.abs(slope) * (middle - left) + 10 * c)
            first = np.maximum(np.ceil(left / c).astype(np.int64), 2)
            last = np.minimum(np.floor(right / c).astype(np.int64), width // c - 6)
            last = np.maximum(last, first)
            images = self.images(c, len(rows), width // c)
            n = len(rows)
            mid = (middle - (c - 1) / 2) / c
            bands.append(Band(c, rows, first, last, d / c, slope, mid, z, *(images[k][:n] for k in range(3))))
        return bands


@dataclass(frozen=True)
class Hit:
    """A patch that stands: band, foot row, columns, rows, in binned pixels; its evidence."""

    band: int
    foot: int
    column: int
    tall: int
    wide: int
    evidence: float
    is_sure: bool


def examine(
    finder: LowFinder, left: Image, right: Image, r: Rectification, ground: GroundPlane
) -> tuple[list[Band], list[Hit]]:
    """Lay the images over each other by the road, correct the road by itself, and return the patches that stand."""
    s = finder.settings
    bands = finder.bands(r, ground)
    if not bands:
        return [], []
    measured = []
    for b in bands:
        b.warp(left, right, 1.0, 0.0, step=2)
        measured.append((b.bin_px, *b.blocks(), b.measure(step=2)))
    line, (g0, gu, gv) = road_offset(measured)
    hits = []
    for number, b in enumerate(bands):
        v = b.bin_px * b.rows
        b.d_px += (line[0] * v + line[1]) / b.bin_px
        b.warp(left, right, g0 + gv * v, gu * b.bin_px)
        sums = b.measure()
        b.variance = max(NOISE_FLOOR, float(np.percentile(sums[..., 5] / np.maximum(sums[..., 0], 1), 40)))
        kernels.weigh(b.near, b.far, b.first, b.last, b.variance, b.weight)
        tall = np.maximum(np.round(np.outer(r.f_px / b.z_m / b.bin_px, s.heights_m)), 1).astype(np.int64)
        chosen, i = [], len(b.rows) - 1
        while i - tall[i, -1] >= 0:
            chosen.append(i)
            i -= max(1, int(tall[i, 0] // 3))
        if not chosen:
            continue
        feet = np.array(chosen)
        wide = np.maximum(np.round(s.width_m * r.f_px / b.z_m[feet] / b.bin_px), 3).astype(np.int64)
        tall = tall[feet]
        scores = np.empty((len(feet), b.near.shape[1]), np.float32)
        which = np.empty(scores.shape, np.int8)
        kernels.score(b.near, b.far, b.weight, b.first, b.last, b.d_px, feet, tall, wide, scores, which)
        hits += _hits(number, b, scores, which, feet, tall, wide, s)
    return bands, hits


def _hits(
    number: int,
    b: Band,
    scores: NDArray[np.float32],
    which: NDArray[np.int8],
    feet: NDArray[np.int64],
    tall: NDArray[np.int64],
    wide: NDArray[np.int64],
    s: LowSettings,
) -> list[Hit]:
    """Take the best patches; if one is sure, also the weak ones, which show what goes on along the road."""
    hits: list[Hit] = []
    raw = np.empty((MOST_HITS, 4))
    for least in (s.evidence, WEAK * s.evidence):
        count = kernels.pick(scores, which, feet, tall, wide, least, raw)
        for k, u, t, value in raw[:count]:
            i, n = int(k), int(tall[int(k), int(t)])
            share, gain = kernels.confirm(b.near, b.far, b.weight, b.d_px, b.first, b.last, feet[i], n, int(u), wide[i])
            # Nearer patches have more pixels, and the model's small errors add up.
            need = s.evidence * (s.reach_m[1] / max(b.z_m[feet[i]], AVERAGED_M)) ** NEARER
            sure = bool(value * min(share, 1.0) >= need and gain >= s.gain)
            hits.append(Hit(number, int(feet[i]), int(u), n, int(wide[i]), float(value), sure))
        if not any(hit.is_sure for hit in hits):
            break
    return hits


def road_offset(
    measured: list[tuple[int, FloatArray, FloatArray, NDArray[np.float32]]],
) -> tuple[FloatArray, FloatArray]:
    """Fit the road's own offset, full-resolution px, as a line over the image row, and the gain."""
    u, v = np.concatenate([m[1].ravel() for m in measured]), np.concatenate([m[2].ravel() for m in measured])
    scale = np.concatenate([np.full(m[1].size, m[0]) for m in measured])
    sums = np.concatenate([m[3].reshape(-1, 8) for m in measured])
    n, g, e, gg, ge, _, near, far = sums.astype(float).T
    n = np.maximum(n, 1)
    info = np.maximum(gg - g * g / n, 1e-6)
    offset = -scale * (ge - g * e / n) / info
    ratio = near / np.maximum(far, 1)
    A = np.stack([np.ones_like(u), u, v], 1)
    gain = np.array([np.median(ratio), 0.0, 0.0])
    for _ in range(6):
        w = n / (1 + ((ratio - A @ gain) / 0.01) ** 2)
        gain = np.linalg.lstsq((A.T * w) @ A, (A.T * w) @ ratio, rcond=1e-9)[0]
    w0 = info / scale**2
    w0 = np.minimum(w0, np.percentile(w0, 80))
    order = np.argsort(offset)
    line = np.array([0.0, offset[order][np.searchsorted(np.cumsum(w0[order]), w0.sum() / 2)]])
    A = np.stack([v - v.mean(), np.ones_like(v)], 1)
    line = np.array([0, line[1]])
    for _ in range(8):
        w = w0 / (1 + ((offset - A @ line) / 0.15) ** 2) ** 2
        line = np.linalg.solve((A.T * w) @ A + np.diag([1e-3, 0]), (A.T * w) @ offset)
    return np.array([line[0], line[1] - line[0] * v.mean()]), gain


def regions_of(
    bands: list[Band], hits: list[Hit], image: Image, r: Rectification, reported_m: float
) -> tuple[tuple[Region, ...], str | None]:
    """Join hits side by side to regions; what goes on along the road (a kerb, a verge) is none.

    Returns
    -------
    The regions up to `reported_m` ahead, and why there can be none: `MIRRORS`, or None.
    """
    if not hits:
        return (), None
    z = np.array([bands[h.band].z_m[h.foot] for h in hits])
    box = np.array([box_of(bands[h.band], h) for h in hits])
    x = (box[:, [0, 2]] - r.cx_px) * z[:, None] / r.f_px
    gap = np.maximum(x[:, None, 0] - x[None, :, 1], x[None, :, 0] - x[:, None, 1])
    apart = np.abs(z[:, None] - z[None, :])
    noise = z * z / (r.f_px * r.baseline_m)
    near_by = (gap < 0.3 + 0.4 * apart) & (apart < 1.0 + 0.15 * z[:, None] + 0.3 * noise[:, None])
    sure = np.array([h.is_sure for h in hits])
    count, chain = connected_components(near_by)
    on_kerb = np.zeros(len(hits), bool)
    for c in range(count):
        mine = np.flatnonzero(chain == c)
        on_kerb[mine] = _go_on(z[mine], x[mine].mean(1), noise[mine].max())
    if np.count_nonzero(~sure & ~on_kerb & ~(near_by & (sure | on_kerb)).any(1)) >= STRAYS:
        return (), MIRRORS
    _, group = connected_components((gap < 0.15) & (apart < 0.3 + 0.5 * noise[:, None]) & sure & sure[:, None])
    found = []
    for g in range(group.max() + 1):
        mine = np.flatnonzero((group == g) & sure)
        if len(mine) and not on_kerb[mine].any() and np.median(z[mine]) <= reported_m:
            found.append(_region([bands[hits[k].band] for k in mine], [hits[k] for k in mine], box[mine], image))
    return tuple(found), None


def _go_on(z_m: FloatArray, x_m: FloatArray, noise_m: float) -> NDArray[np.bool_]:
    """Return which hits lie on a straight line that goes on for long, as those of a kerb or a verge do."""
    along_m = max(0.0, float(np.ptp(z_m)) - 0.3 * noise_m)
    if len(z_m) < KERB_HITS or np.hypot(along_m, np.ptp(x_m)) <= KERB_M:
        return np.zeros(len(z_m), bool)
    i, j = np.triu_indices(len(z_m), 1)
    dx, dz = x_m[j] - x_m[i], z_m[j] - z_m[i]
    length_m = np.hypot(dx, dz)
    far = length_m > KERB_M / 2
    i, dx, dz = i[far], (dx[far] / length_m[far])[:, None], (dz[far] / length_m[far])[:, None]
    off_m = np.abs((x_m - x_m[i, None]) * dz - (z_m - z_m[i, None]) * dx)
    on = off_m < KERB_OFF_M * np.abs(dz) + (KERB_OFF_M + 0.3 * noise_m) * np.abs(dx)
    return np.asarray(on[on.sum(1) >= KERB_HITS].any(0))


def box_of(b: Band, h: Hit) -> tuple[int, int, int, int]:
    """Return a hit's box in full-resolution pixels, half open, down to its foot."""
    c, u, v = b.bin_px, h.column - h.wide // 2, int(b.rows[h.foot])
    return u * c, (v - h.tall) * c, (u + h.wide) * c, v * c


def _region(bands: list[Band], hits: list[Hit], boxes: NDArray[np.int64], image: Image) -> Region:
    (u0, v0), (u1, v1) = boxes[:, :2].min(0), boxes[:, 2:].max(0)
    surface = []
    for b, h, (a0, b0, a1, b1) in zip(bands, hits, boxes, strict=True):
        d = b.bin_px * (b.d_px[h.foot] + b.d_px[h.foot - 1]) / 2
        v, u = np.mgrid[b0 + 0.5 : b1 - 0.5 : 4j, a0 + 0.5 : a1 - 0.5 : 4j]
        surface.append(np.stack([u, v, np.full(u.shape, d)], -1).reshape(-1, 3))
    corners = np.concatenate([boxes[:, [i, j]] for i in (0, 2) for j in (1, 3)]).astype(np.int32)
    patch = image[max(v0, 0) : v1, max(u0, 0) : u1]
    color = patch.reshape(-1, 3).mean(0) if image.ndim == 3 else np.full(3, np.nan)
    slope = float(np.mean([b.d_px[h.foot] - b.d_px[h.foot - 1] for b, h in zip(bands, hits, strict=True)]))
    stride = max(b.bin_px for b in bands)
    return Region(
        box_px=(int(u0), int(v0), int(u1), int(v1)),
        contour_px=np.asarray(cv2.convexHull(corners), np.int32).reshape(-1, 2),
        surface_uvd_px=np.concatenate(surface),
        sigma_d_px=float(np.hypot(0.15, slope * stride)),
        color_rgb=color,
    )


def drop_covered(low: tuple[Region, ...], ordinary: tuple[Region, ...]) -> tuple[Region, ...]:
    """Return the low regions that no ordinary region explains.

    An ordinary one explains what lies half inside its box, and what lies in the strip to its left that only the left
    camera sees past it.
    """

    def explains(big: Region, small: Region) -> bool:
        (a0, b0, a1, b1), (c0, d0, c1, d1) = small.box_px, big.box_px
        hidden = np.median(big.surface_uvd_px[:, 2]) - np.median(small.surface_uvd_px[:, 2])
        left = c0 - max(0.0, float(hidden))
        common = max(0.0, min(a1, c1) - max(a0, left)) * max(0, min(b1, d1) - max(b0, d0))
        return common >= 0.5 * (a1 - a0) * (b1 - b0)

    return tuple(region for region in low if not any(explains(big, region) for big in ordinary))


def road_z(r: Rectification, ground: GroundPlane, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return the forward distance of the road at pixels of the rectified left image, metres; NaN over the horizon."""
    n_x, n_y, n_z = ground.normal
    b = n_x * (u - r.cx_px) / r.f_px + n_y * (v - r.cy_px) / r.f_px + n_z
    h = ground.height_m - n_x * r.baseline_m / 2
    with np.errstate(all="ignore"):
        inverse = (-b + np.sqrt(b * b + 4 * h * ground.bend_per_m)) / (2 * h)
        return np.where(inverse > 0, 1 / inverse, np.nan)
