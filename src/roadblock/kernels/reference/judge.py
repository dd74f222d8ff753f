"""The definition of what is concluded from what recognition measured: odds of types, names of colours, sizes, outlines.

Each kernel writes into arrays it is given.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.recognize import HUES

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Codes = NDArray[np.integer[Any]]

COLORS = ("pink", "red", "orange", "yellow", "green", "blue", "purple", "brown", "white", "gray", "black")
"""The eleven basic colour terms; the first are those of `HUE_ENDS_DEG`."""
PINK, RED, ORANGE, YELLOW, BROWN, WHITE, GRAY, BLACK = 0, 1, 2, 3, 7, 8, 9, 10
LEAST_SHARE, SECOND_SHARE = 0.18, 0.25
"""A hue is the body's from such a share of its places on, and names it beside another one from such a share on."""
BLACK_L, WHITE_L = 32.0, 50.0
"""What is darker, and what is lighter, of what is grey."""

LIMIT = 3.0
"""Inputs further from the mean than so many standard deviations count as that far."""

EDGE_PX, ROW_PX, ROAD_M, WIDTH_SHARE, SIZE_SHARE = 1.6, 1.6, 0.04, 0.07, 0.025
"""Standard deviations of an edge, of the upper end, of the foot, of what is hidden of its width, and of the rest."""
LEAST_HIGH_M = 0.05
CLEARANCE_M = 0.15
"""So far over the road vehicles end, at the face seen nearest: below it one sees the road under them."""
SIDES_RATIO = 1.4
"""The longer side is a thing's direction if it is so many times as long as the shorter one."""
HEADING_RAD, HEADING_SHARE = 0.035, 1.2
"""A direction is off by so much, and by this share of what a side's ends are off in range over its length (sigmas)."""
SUREST_RAD = 0.26
"""A direction less sure than this is none."""
CONTRAST = 0.12
"""So much better must the best rectangle explain the surface than any."""


def judge_types(
    inputs: Floats,
    mean: Singles,
    per_spread: Singles,
    hidden: Singles,
    hidden_bias: Singles,
    output: Singles,
    output_bias: Singles,
    odds: Floats,
) -> None:
    """Write (n, classes) the probability of each class: a hidden layer of rectified sums, then a softmax.

    Parameters
    ----------
    inputs
        (n, m) what was measured.
    mean, per_spread
        (m,) of each input over the training set; one over its standard deviation.
    hidden, hidden_bias, output, output_bias
        (m, h), (h,), (h, classes), (classes,) weights.
    odds
        Written.
    """
    scaled = np.clip((inputs - mean) * per_spread, -LIMIT, LIMIT)
    scores = np.maximum(scaled @ hidden + hidden_bias, 0) @ output + output_bias
    raised = np.exp(scores - scores.max(axis=1, keepdims=True))
    odds[:] = raised / raised.sum(axis=1, keepdims=True)


def name_colors(figures: Floats, codes: Codes, lab: Floats) -> None:
    """Write what colours things are called and are, given what `recognize.tally_colors` wrote.

    Parameters
    ----------
    figures
        (n, COLOR_FIGURES).
    codes
        (n, 2), written: places of one or two names in `COLORS`; -1 where there is no second one.
    lab
        (n, 3), written: CIELAB value.
    """
    for k, row in enumerate(figures):
        shares = row[0 : 4 * HUES : 4]
        first, second = np.argsort(-shares, kind="stable")[:2]
        grey, light, a, b = row[4 * HUES : 4 * HUES + 4]
        codes[k, 1] = -1
        if shares[first] < min(LEAST_SHARE, grey):
            codes[k, 0] = BLACK if light < BLACK_L else WHITE if light > WHITE_L else GRAY
            lab[k] = light, a, b
            continue
        lab[k] = row[4 * first + 1 : 4 * first + 4]
        codes[k, 0] = hue_name(int(first), *lab[k])
        if shares[second] >= SECOND_SHARE:
            other = hue_name(int(second), *row[4 * second + 1 : 4 * second + 4])
            codes[k, 1] = other if other != codes[k, 0] else -1
        elif grey >= 2 * SECOND_SHARE and light > WHITE_L:
            codes[k, 1] = WHITE


def hue_name(name: int, lightness: float, a: float, b: float) -> int:
    """Return what a hue is called that is as light and as strong as this."""
    weak = np.hypot(a, b) < 0.62 * lightness + 4 and lightness < 55
    if (name in (ORANGE, YELLOW) and (weak or lightness < 33)) or (name == RED and weak and b > 0.6 * a):
        return BROWN
    if name in (RED, PINK):
        return PINK if lightness > 62 else RED
    return name


def size_things(
    edges: Floats,
    u_px: Floats,
    range_m: Floats,
    sigma_m: Floats,
    twin: Floats,
    road: Floats,
    sizes: Floats,
    sigmas: Floats,
) -> None:
    """Improve sizes of things: edges in the image instead of edges of cells.

    Parameters
    ----------
    edges
        (n, 4) as `recognize.trace_things` wrote them.
    u_px, range_m, sigma_m
        (n,) where each is, and one standard deviation of its range.
    twin, road
        As in `recognize.describe_things`.
    sizes
        (n, 3) width, height and length, metres: width and, where there is a road, height are overwritten.
    sigmas
        (n, 3), written: one standard deviation of each.
    """
    f, cx, cy, baseline = twin
    n_x, n_y, n_z, height_m, bend = road
    per_px = range_m / f
    least, most, top, _ = edges.T
    sizes[:, 0] = np.maximum(most - least, per_px)
    if not np.isnan(n_x):
        x, y = (u_px - cx) * per_px - baseline / 2, (top - cy) * per_px
        over = n_x * x + n_y * y + n_z * range_m + height_m - bend * range_m**2
        sizes[:, 1] = np.maximum(over, LEAST_HIGH_M)
    relative = np.hypot(sigma_m / range_m, SIZE_SHARE)
    sigmas[:, 0] = np.sqrt(2 * (EDGE_PX * per_px) ** 2 + (relative**2 + WIDTH_SHARE**2) * sizes[:, 0] ** 2)
    sigmas[:, 1] = np.sqrt((ROW_PX * per_px) ** 2 + ROAD_M**2 + (relative * sizes[:, 1]) ** 2)
    sigmas[:, 2] = np.hypot(2 * sigma_m, 0.1 * sizes[:, 2])


def lift_contours(
    contours: NDArray[np.int32], counts: NDArray[np.int32], longest_end_m: Floats, range_m: Floats, f_px: float
) -> None:
    """Lift the lower end of (n, m, 2) contours of `counts` (n,) points each, where they are of vehicles.

    `longest_end_m` is as in `place_outlines`, `range_m` how far away they are; `f_px` is the focal length.
    """
    for k in np.flatnonzero(longest_end_m > 0):
        rows = contours[k, : counts[k], 1]
        clear_px = min(np.rint(CLEARANCE_M * f_px / range_m[k]), np.ptp(rows) // 2)
        np.minimum(rows, rows.max() - int(clear_px), out=rows)


def place_outlines(
    figures: Floats,
    longest_end_m: Floats,
    sigma_m: Floats,
    road: Floats,
    mount: Floats,
    corners: Floats,
    headings: Floats,
) -> None:
    """Write rectangles on the road and directions of things, vehicle frame.

    Parameters
    ----------
    figures
        (n, OUTLINE_FIGURES) as `recognize.outline_things` wrote them.
    longest_end_m, sigma_m
        (n,) a vehicle's front and back are no wider than this: a longer side runs along it, a shorter one across; 0 for
        what is no vehicle, whose longer side is its direction. One standard deviation of the range.
    road, mount
        As in `recognize.describe_things`; (4, 4) pose of the car frame in the vehicle's.
    corners, headings
        (n, 4, 2) metres, and (n, 2) direction from -pi/2 to pi/2 and its standard deviation, radians, NaN where none is
        seen; written.
    """
    turn, front, back, low, high, best, mean = figures.T
    n_x, n_y, n_z, height_m, bend = road
    c, s = np.cos(turn)[:, None], np.sin(turn)[:, None]
    along, across = np.stack([front, front, back, back], -1), np.stack([low, high, high, low], -1)
    x, z = c * across + s * along, c * along - s * across
    y = np.zeros_like(x) if np.isnan(n_x) else (n_x * x + n_z * z + height_m - bend * z**2) / -n_y
    R, t = mount[:3, :3], mount[:3, 3]
    corners[:] = (np.stack([x, y, z], -1) @ R.T + t)[..., :2]
    long_m, wide_m = back - front, high - low
    longer, shorter = np.maximum(long_m, wide_m), np.minimum(long_m, wide_m)
    sigma = np.hypot(HEADING_RAD, HEADING_SHARE * sigma_m / np.maximum(longer, 0.1))
    sure = (
        (sigma < SUREST_RAD)
        & (best < (1 - CONTRAST) * mean)
        & ((longest_end_m > 0) | (longer >= SIDES_RATIO * shorter))
    )
    # The second axis is its direction: the longer one, or across a vehicle's end.
    second = (long_m <= wide_m) != ((longest_end_m > 0) & (longer <= longest_end_m))
    angle = turn + np.pi / 2 * second
    ahead, aside = (R[i, 0] * np.sin(angle) + R[i, 2] * np.cos(angle) for i in (0, 1))
    heading = (np.arctan2(aside, ahead) + np.pi / 2) % np.pi - np.pi / 2
    headings[:] = np.where(sure[:, None], np.stack([heading, sigma], -1), np.nan)
