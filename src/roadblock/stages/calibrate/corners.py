"""Corners of a chessboard to the noise limit: the blurred picture of a corner, fitted to the raw pixels around it."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.special import erf

from roadblock.values.checks import FloatArray

MOST_HALF_PX = 15
"""Larger windows make nothing better: shade, lens and board bend more than the noise is averaged out."""
FIRST_HALF_PX = 7
"""A first, smaller window finds the bends of the lines and the blur."""
LEAST_BAND_PX = 2.0
BAND_BLURS = 4.0
"""Pixels farther than both from the edges say nothing about the corner."""
MARKER_EDGE_PX = 2.0
"""A marker's own blurred edge."""

START_BLUR_PX = 1.0
LEAST_BLUR_PX = 0.05
PIXEL_BLUR2 = 1 / 12
"""A pixel gathers light over its own area: this adds to the square of the optics' blur, in px^2."""
LONGEST_STEP = np.array([1.0, 1.0, 0.2, 0.2, 0.4, 255.0, 255.0, 0.02, 0.02, 0.1])
STRONGEST_TONE = 0.8
"""Of the sensor's curve: slopes of dark and bright differ by a factor ((1 + t) / (1 - t))^2, 81 here and 3.5 at 0.3."""
ITERATIONS = 20
WHOLE_STEPS = 8
"""Later ones are halved: pictures sharper than their pixels make whole ones swing."""
PLAIN_STEPS = 2
"""Before outliers are weighted down."""
DONE_PX = 1e-3
HUBER = 2.5
ROUNDING = 12**-0.5
"""Standard deviation of rounding to whole grey levels: no residual is believed to be smaller."""
REACH_PX = 4
"""Residuals of pixels farther apart are taken to be independent."""

LEAST_SQUARE_PX = 7.0
"""In narrower squares the blurred edges run into each other, ..."""
BLUR_SHARE = 0.25
"""... as they do where the blur is more than this share of a square."""
FEWEST_PIXELS = 25
LEAST_MOVE_PX = 1.5
MOVE_SHARE = 0.1
"""A corner is found within this share of a square of where it was expected, or within the pixels above."""
LEAST_CONTRAST = 4.0
"""Half the difference of black and white, grey levels; below it there is nothing to see."""
LEAST_SHARE = 0.3
"""A corner with this share of the usual contrast of its view, or this share of its pixels believed, is not one."""
WORST_NOISE = 4.0
"""A corner whose residuals are this many times the usual ones of its view is disturbed."""
WORST_SIGMA_PX = 0.5


@dataclass(frozen=True, eq=False)
class CornerFits:
    """Fitted corners, n of them, as they were given.

    Attributes
    ----------
    points_px
        (n, 2) positions, pixels.
    sigma_px
        (n,) one standard deviation of each coordinate, pixels, from the fit's own residuals and slopes.
    blur_px
        (n,) width (sigma) of the blurred edges, the pixel's own width included, pixels.
    contrast
        (n,) half of white minus black, grey levels; < 0 where the squares on the diagonal, before both lines and
        behind both lines, are the black ones.
    usable
        (n,) whether the fit succeeded; positions of the others mean nothing.
    """

    points_px: FloatArray
    sigma_px: FloatArray
    blur_px: FloatArray
    contrast: FloatArray
    usable: NDArray[np.bool_]


def fit_corners(image: NDArray[np.uint8], grid_px: FloatArray, clear: float = 0.5) -> CornerFits:
    """Fit the model of a blurred corner to every corner of a grid.

    The model is `(a + b * t(erf(e1 / (sqrt(2) s)) * erf(e2 / (sqrt(2) s)))) * (1 + g . p)`: mean a, contrast b and
    shade g of the light, blur s, and the signed distances e1 and e2 to two lines through the corner, which bend as the
    rows and columns of the grid do (a line that the lens bends is not straight within a window either). The tone curve
    `t(x) = (x + k) / (1 + k x)` is the sensor's: most encode light by a power below 1, which widens the white side of
    an edge. It is the same for the whole picture: k is the median of what the corners say in a first fit, each alone.

    Fitted by Gauss-Newton with Huber's weights, to raw pixels. A corner looks the same turned by 180 degrees, so what
    the model leaves out (clipping, the rest of a curve) widens its residuals, but does not move it. A window ends
    halfway to the next corner: no pixel serves two corners, their errors are independent.

    Parameters
    ----------
    image
        (height, width) raw grey levels.
    grid_px
        (rows, columns, 2) where the corners are about, pixels, at least 2x2; NaN where one was not found.
    clear
        How far from the edges nothing else is printed in a square, in sides of a square: less than 0.5 where the
        squares hold markers.

    Returns
    -------
    Fits in the order of the grid, row by row.
    """
    steps = local_steps(grid_px)
    found = np.isfinite(grid_px).all(-1) & np.isfinite(steps).all((-1, -2))
    fits = _nothing(found.size)
    if not found.any():
        return fits
    start, around = _start(grid_px[found], steps[found]), steps[found]
    parity = np.where(np.indices(found.shape).sum(0) % 2, -1.0, 1.0)[found]
    with np.errstate(all="ignore"):
        near = _windows(image, start, around, clear, FIRST_HALF_PX, np.inf)
        first = _fit(near, start, np.zeros_like(start[:, :2]), with_tone=True)
        rough = grid_px.copy()
        rough[found] = np.where(first.done[:, None], first.x[:, :2], grid_px[found])
        blur = float(np.nanmedian(_blur(first.x)))
        again = np.where(first.done[:, None], first.x, start)
        again[:, 9] = _tone(first)
        windows = _windows(image, again, around, clear, MOST_HALF_PX, blur)
        fit = _fit(windows, again, bends(rough)[found])
        sigma, noise = _sigmas(windows, fit)
        usable = _usable(windows, fit, grid_px[found], around, parity, sigma, noise)
        sigma *= _togetherness(windows, fit, usable, noise)
    flat = found.ravel()
    fits.points_px[flat], fits.sigma_px[flat], fits.usable[flat] = fit.x[:, :2], sigma, usable
    fits.blur_px[flat], fits.contrast[flat] = _blur(fit.x), fit.x[:, 6]
    return fits


def local_steps(grid_px: FloatArray) -> FloatArray:
    """Return (rows, columns, 2, 2) the vectors to the next corner in the row and in the column, pixels.

    The mean of the steps from and to the neighbours. Neighbours that were not found (NaN) are taken to lie where the
    plane of all found corners has them; NaN if that cannot be told.
    """
    grid = _filled(grid_px)
    return np.stack([np.gradient(grid, axis=1), np.gradient(grid, axis=0)], -2)


def _filled(grid_px: FloatArray) -> FloatArray:
    found: NDArray[np.bool_] = np.asarray(np.isfinite(grid_px).all(-1))
    if found.all() or found.sum() < 4:
        return grid_px
    place = np.moveaxis(np.indices(found.shape), 0, -1).astype(np.float64)
    H: FloatArray | None = cv2.findHomography(place[found], grid_px[found])[0]  # type: ignore[assignment]
    if H is None:
        return grid_px
    flat = cv2.perspectiveTransform(place.reshape(-1, 1, 2), H).reshape(grid_px.shape)
    return np.where(found[..., None], grid_px, flat)


def bends(grid_px: FloatArray) -> FloatArray:
    """Return (rows, columns, 2) the curvature of the grid's row and column lines at every corner, 1/px.

    > 0 where the line bends towards its normal: the row's towards the next row, the column's towards the next
    column. From each corner and its two neighbours in the line (twice the area of the triangle over its sides), at
    the ends as next to them, 0 where too few were found.
    """
    curves = np.zeros((*grid_px.shape[:2], 2))
    for k, (axis, sign) in enumerate(((1, 1.0), (0, -1.0))):
        if grid_px.shape[axis] < 3:
            continue
        d = np.diff(grid_px, axis=axis)
        n = d.shape[axis]
        a, b = d.take(range(n - 1), axis), d.take(range(1, n), axis)
        lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1) * np.linalg.norm(a + b, axis=-1)
        inner = sign * 2 * (a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]) / lengths
        ends = np.concatenate([inner.take([0], axis), inner, inner.take([-1], axis)], axis)
        curves[..., k] = np.nan_to_num(ends)
    return curves


@dataclass(frozen=True, eq=False)
class _Windows:
    """The pixels that n corners are fitted to, m of each (the last ones of weight 0 where it has fewer).

    `uv` (n, 2, m) are their places, `from_center` (n, 2, m) the same from the pixel the corner began in, `grey` and
    `weight` (n, m) their grey levels and 1 or 0, `cell` (n, m) their index in a square of `side` pixels.
    """

    uv: FloatArray
    from_center: FloatArray
    grey: FloatArray
    weight: FloatArray
    cell: NDArray[np.intp]
    side: int


@dataclass(frozen=True, eq=False)
class _Fit:
    """Parameters x (n, 10), residuals and weights (n, m) there, slopes (n, 9 or 10, m), whether the steps ended."""

    x: FloatArray
    residual: FloatArray
    weight: FloatArray
    slopes: FloatArray
    done: NDArray[np.bool_]


def _nothing(n: int) -> CornerFits:
    nans = np.full((3, n), np.nan)
    return CornerFits(np.full((n, 2), np.nan), nans[0], nans[1], nans[2], np.zeros(n, bool))


def _start(points_px: FloatArray, steps: FloatArray) -> FloatArray:
    """Return parameters (n, 10): u, v, angles of both lines, log of the optics' blur, mean, contrast, shades, tone."""
    x = np.zeros((len(points_px), 10))
    x[:, :2] = points_px
    x[:, 2:4] = np.arctan2(steps[..., 1], steps[..., 0])
    x[:, 4] = np.log(START_BLUR_PX)
    return x


def _windows(
    image: NDArray[np.uint8], x: FloatArray, steps: FloatArray, clear: float, most_half_px: int, blur_px: float
) -> _Windows:
    """Gather the pixels around corners at `x` that are theirs and say something about them."""
    half = int(np.clip(np.ceil(np.abs(steps).sum(1).max() / 2), 2, most_half_px))
    dv, du = (a.ravel() for a in np.mgrid[-half : half + 1, -half : half + 1])
    center = np.rint(x[:, :2])[..., None]
    uv = center + np.stack([du, dv])
    height, width = image.shape
    inside = ((uv >= 0) & (uv <= np.array([[width - 1], [height - 1]]))).all(1)
    chosen = inside & _near(uv - x[:, :2, None], steps, clear, half, blur_px)
    cell = np.argsort(~chosen, axis=1, kind="stable")[:, : max(1, int(chosen.sum(1).max()))]
    uv = np.take_along_axis(uv, cell[:, None], 2)
    column, row = np.moveaxis(np.clip(uv, 0, np.array([[width - 1], [height - 1]])).astype(int), 1, 0)
    grey = image[row, column].astype(np.float64)
    weight = np.take_along_axis(chosen, cell, 1).astype(np.float64)
    return _Windows(uv, uv - center, grey, weight, cell, 2 * half + 1)


def _near(q: FloatArray, steps: FloatArray, clear: float, half_px: int, blur_px: float) -> NDArray[np.bool_]:
    """Whether pixels (n, 2, m) from a corner are its own, free of markers, and near enough to its edges."""
    share = np.abs(np.linalg.inv(steps.swapaxes(1, 2)) @ q)
    spacing = np.abs(np.linalg.det(steps))[:, None] / np.linalg.norm(steps, axis=-1)[:, ::-1]
    to_edge = (share * spacing[..., None]).min(1)
    own = (share <= 0.5).all(1) & (np.abs(q).max(1) <= half_px + 0.5)
    reach = np.maximum(BAND_BLURS * blur_px, LEAST_BAND_PX)
    if clear < 0.5:
        reach = np.minimum(reach, clear * spacing.min(-1, keepdims=True) - MARKER_EDGE_PX)
    return np.asarray(own & (to_edge <= reach))


def _fit(windows: _Windows, x: FloatArray, curves: FloatArray, *, with_tone: bool = False) -> _Fit:
    """Gauss-Newton from `x`, all corners at once; `curves` (n, 2) are the bends of lines, the tone may be free."""
    x, free = x.copy(), slice(9 + with_tone)
    x[:, 5:9] = _light(windows, x, curves)
    weight, done = windows.weight, np.zeros(len(x), bool)
    for i in range(ITERATIONS):
        model, slopes = _model(windows, x, curves)
        slopes = slopes[:, free]
        residual = windows.grey - model
        if i >= PLAIN_STEPS:
            weight = windows.weight * _huber(residual, windows.weight)
        weighted = slopes * weight[:, None]
        step = _solve(weighted @ slopes.swapaxes(1, 2), (weighted @ residual[..., None])[..., 0])
        x[:, free] += np.clip(step, -LONGEST_STEP[free], LONGEST_STEP[free]) * (1.0 if i < WHOLE_STEPS else 0.5)
        x[:, 4] = np.maximum(x[:, 4], np.log(LEAST_BLUR_PX))
        x[:, 9] = np.clip(x[:, 9], -STRONGEST_TONE, STRONGEST_TONE)
        done = np.abs(step[:, :2]).max(-1) < DONE_PX
        if i > PLAIN_STEPS and (done | ~np.isfinite(step[:, 0])).all():
            break
    return _Fit(x, residual, weight, slopes, done)


def _tone(fit: _Fit) -> float:
    """Return the tone curve that most corners agree on; none where no fit ended."""
    return float(np.median(fit.x[fit.done, 9])) if fit.done.any() else 0.0


def _light(windows: _Windows, x: FloatArray, curves: FloatArray) -> FloatArray:
    """Mean, contrast and no shade to begin with: a line through grey levels over the model's pattern."""
    pattern, _ = _pattern(x, windows.uv - x[:, :2, None], curves)
    n = windows.weight.sum(-1)
    mean_p, mean_g = (windows.weight * pattern).sum(-1) / n, (windows.weight * windows.grey).sum(-1) / n
    dp = windows.weight * (pattern - mean_p[:, None])
    contrast = (dp * windows.grey).sum(-1) / (dp * pattern).sum(-1)
    return np.stack([mean_g - contrast * mean_p, contrast, 0 * n, 0 * n], -1)


def _pattern(x: FloatArray, q: FloatArray, curves: FloatArray) -> tuple[FloatArray, list[FloatArray]]:
    """Return what a corner of contrast 1 looks like at `q` (n, 2, m) pixels from it, (n, m), and its slopes.

    The expectation of the product of the signs of both distances under the blur. For lines at right angles a product
    of two erf; otherwise the blur moves both distances together, which the series of Mehler takes in to third order.

    Slopes are over the distances of the row line and of the column line, over the log of the optics' blur, and over
    the two angles; the small terms (of the series and of the bends) are left out of them.
    """
    blur = _blur(x)[:, None]
    c, s = np.cos(x[:, 2:4]), np.sin(x[:, 2:4])
    along = c[:, :, None] * q[:, None, 0] + s[:, :, None] * q[:, None, 1]
    off = (c[:, :, None] * q[:, None, 1] - s[:, :, None] * q[:, None, 0]) * np.array([[1.0], [-1.0]])
    e = (off - curves[:, :, None] / 2 * along * along) / blur[:, :, None]
    f, bell = erf(e * 0.5**0.5), np.exp(-e * e / 2)
    r = -(c[:, 0] * c[:, 1] + s[:, 0] * s[:, 1])[:, None]
    h, k = e[:, 0], e[:, 1]
    series = r + r * r * h * k / 2 + r**3 * (h * h - 1) * (k * k - 1) / 6
    pattern = f[:, 0] * f[:, 1] + 2 / np.pi * bell[:, 0] * bell[:, 1] * series
    peak = (2 / np.pi) ** 0.5 / blur
    d1, d2 = peak * bell[:, 0] * f[:, 1], peak * bell[:, 1] * f[:, 0]
    return pattern, [d1, d2, -np.exp(2 * x[:, 4, None]) / blur * (d1 * h + d2 * k), -d1 * along[:, 0], d2 * along[:, 1]]


def _blur(x: FloatArray) -> FloatArray:
    return np.sqrt(np.exp(2 * x[:, 4]) + PIXEL_BLUR2)


def _model(windows: _Windows, x: FloatArray, curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Grey levels (n, m) of the model, and their slopes (n, 10, m) over its parameters."""
    a, b, gu, gv, tone = (x[:, i, None] for i in range(5, 10))
    pattern, (d1, d2, d_blur, d_row, d_column) = _pattern(x, windows.uv - x[:, :2, None], curves)
    du, dv = windows.from_center[:, 0], windows.from_center[:, 1]
    light = 1 + gu * du + gv * dv
    white = np.sign(b)
    under = 1 + tone * white * pattern
    toned = (pattern + tone * white) / under
    grey = a + b * toned
    c, s = np.cos(x[:, 2:4, None]), np.sin(x[:, 2:4, None])
    shape = [d1 * s[:, 0] - d2 * s[:, 1], d2 * c[:, 1] - d1 * c[:, 0], d_row, d_column, d_blur]
    scale = b * light * (1 - tone * tone) / under**2
    by_tone = np.abs(b) * light * (1 - pattern * pattern) / under**2
    slopes = np.stack([*(scale * d for d in shape), light, light * toned, grey * du, grey * dv, by_tone], 1)
    return grey * light, slopes


def _huber(residual: FloatArray, window: FloatArray) -> FloatArray:
    """Huber's weights (n, m); the scale is the median of each window."""
    scale = np.maximum(1.4826 * np.nanmedian(np.where(window > 0, np.abs(residual), np.nan), axis=-1), ROUNDING)
    return np.minimum(1.0, HUBER * scale[:, None] / np.maximum(np.abs(residual), 1e-9))


def _solve(A: FloatArray, g: FloatArray) -> FloatArray:
    """Solve A x = g, (n, k, k) and (n, k), a little damped; NaN where that has no answer."""
    bad = np.atleast_1d(~(np.isfinite(A).all((-1, -2)) & np.isfinite(g).all(-1)))
    A = np.where(bad[:, None, None], np.eye(A.shape[-1]), A)
    scale = 1 / np.sqrt(np.maximum(np.einsum("nii->ni", A), 1e-12))
    A = A * scale[:, :, None] * scale[:, None, :] + 1e-9 * np.eye(A.shape[-1])
    x = scale * np.linalg.solve(A, (scale * g)[..., None])[..., 0]
    return np.where(bad[:, None], np.nan, x)


def _influence(windows: _Windows, fit: _Fit) -> FloatArray:
    """How far each pixel's grey level moves the corner, (n, 2, m) in px per level."""
    slopes = fit.slopes * windows.weight[:, None]
    A = slopes @ fit.slopes.swapaxes(1, 2)
    unit = [_solve(A, np.broadcast_to(np.eye(9)[k], (len(A), 9))) for k in (0, 1)]
    return np.asarray(np.stack(unit, 1) @ slopes)


def _sigmas(windows: _Windows, fit: _Fit) -> tuple[FloatArray, FloatArray]:
    """Return each corner's sigma of a coordinate, pixels, and that of its residuals, grey levels (Huber's formula)."""
    believed = (windows.weight * (fit.weight == 1)).sum(-1) / windows.weight.sum(-1)
    noise2 = ((fit.weight * fit.residual) ** 2).sum(-1) / np.maximum(windows.weight.sum(-1) - 9, 1) / believed**2
    noise = np.sqrt(np.maximum(noise2, ROUNDING**2))
    return noise * np.sqrt((_influence(windows, fit) ** 2).sum((1, 2)) / 2), noise


def _togetherness(windows: _Windows, fit: _Fit, usable: NDArray[np.bool_], noise: FloatArray) -> FloatArray:
    """Return (n,) the factor >= 1 on the sigmas because residuals of neighbouring pixels hang together.

    Compression, demosaicing, sharpening and all that the model leaves out do that. The correlation of residuals is
    taken over all usable corners of the view; the variance of a corner is the sum of it over all pairs of its pixels,
    up to `REACH_PX` apart, each with its influence on the corner.
    """
    if not usable.any():
        return np.ones(len(usable))
    side = windows.side
    n = fft.next_fast_len(side + REACH_PX + 1, real=True)

    def correlated(values: FloatArray) -> FloatArray:
        square = np.zeros((*values.shape[:-1], side * side))
        np.put_along_axis(square, np.broadcast_to(cell, values.shape), values, -1)
        power = np.abs(fft.rfft2(square.reshape(*values.shape[:-1], side, side), (n, n))) ** 2
        return np.asarray(fft.irfft2(power, (n, n)))

    cell = windows.cell[usable]
    residual = correlated((fit.weight * windows.weight * fit.residual)[usable] / noise[usable, None]).sum(0)
    pairs = correlated(windows.weight[usable]).sum(0)
    lag = np.abs(fft.fftfreq(n) * n)
    taper = np.clip(1 - lag / (REACH_PX + 1), 0, None)
    correlation = residual / np.maximum(pairs, 0.5) * taper[:, None] * taper
    cell = windows.cell[:, None]
    influence = correlated(_influence(windows, fit)).sum(1)
    factor2 = (influence * correlation / correlation[0, 0]).sum((1, 2)) / influence[:, 0, 0]
    return np.asarray(np.sqrt(np.maximum(factor2, 1)))


def _usable(
    windows: _Windows,
    fit: _Fit,
    start_px: FloatArray,
    steps: FloatArray,
    parity: FloatArray,
    sigma: FloatArray,
    noise: FloatArray,
) -> NDArray[np.bool_]:
    """Whether each fit ended, near its start, and looks like its neighbours; `parity` (n,) +-1 in turns."""
    square = np.abs(np.linalg.det(steps)) / np.linalg.norm(steps, axis=-1).max(-1)
    blur, contrast = _blur(fit.x), fit.x[:, 6] * parity
    contrast = contrast * np.sign(np.nanmedian(contrast))
    moved = np.hypot(*(fit.x[:, :2] - start_px).T)
    pixels = windows.weight.sum(-1)
    good = fit.done & (moved < np.maximum(LEAST_MOVE_PX, MOVE_SHARE * square)) & (pixels >= FEWEST_PIXELS)
    good &= (square >= LEAST_SQUARE_PX) & (blur < BLUR_SHARE * square) & (sigma < WORST_SIGMA_PX)
    good &= (contrast > LEAST_CONTRAST) & (fit.weight.sum(-1) > LEAST_SHARE * pixels)
    if good.any():
        good &= contrast > LEAST_SHARE * np.median(contrast[good])
        good &= noise < WORST_NOISE * np.median(noise[good])
    return np.asarray(good)
