"""Steps 3 to 5 of the paper's section 2.2: bands, projection to line segments, and their matching by length."""

import numpy as np
from numpy.typing import NDArray

from roadblock.stages.bands.segmentation import HALF
from roadblock.stages.bands.settings import BandsSettings
from roadblock.values.checks import FloatArray


def band_interval_px(height_px: float, settings: BandsSettings) -> int:
    """Return the height of the bands a target is cut into (section 2.2: smaller for fast or low targets).

    Parameters
    ----------
    height_px
        Of the target in the image.
    settings
        With the relative speed v, the speed v0 that halves the interval, and the number of bands n at rest.

    Returns
    -------
    ``height / n / (1 + |v| / v0)``, rounded, within `settings.interval_px`. The formula is ours: the paper only says
    which way it goes.
    """
    speed = abs(settings.relative_speed_mps) / settings.halving_speed_mps
    low, high = settings.interval_px
    return int(np.clip(round(height_px / settings.bands / (1 + speed)), low, high))


def project_band(share: NDArray[np.floating]) -> FloatArray:
    """Project one target's grey block in a band on the abscissa (section 2.2, "banded regions").

    Parameters
    ----------
    share
        (rows, width) of the band: how much of each pixel belongs to the target, 0..1.

    Returns
    -------
    (n, 2) the ends of its line segments, columns, left to right: where the mean over the rows crosses one half,
    linearly between two columns. What touches the image's side has no end there and is left out.
    """
    profile = share.mean(axis=0, dtype=float)
    inside = profile >= HALF
    steps = np.flatnonzero(inside[1:] != inside[:-1])
    before, after = profile[steps], profile[steps + 1]
    crossings = steps + (HALF - before) / (after - before)
    first = 1 if inside[0] else 0
    last = len(crossings) - ((len(crossings) - first) % 2)
    return np.asarray(crossings[first:last]).reshape(-1, 2)


def match_segments(left: FloatArray, right: FloatArray, settings: BandsSettings) -> NDArray[np.intp]:
    """Match line segments at the same height by closest length, from left to right (section 2.2).

    Parameters
    ----------
    left, right
        (n, 2) and (m, 2) ends of the segments of one band, left to right.
    settings
        How unlike matched lengths may be, and the largest disparity.

    Returns
    -------
    (k, 2) rows (i, j): left segment i is right segment j. Both columns rise (left to right), and the sum of the
    differences in length is the least possible, where a segment without partner costs half of `length_px` plus half
    of `length_share` of its length; so lengths further apart than both together stay alone. Both pairs of ends must
    have disparities in 0 .. `disparity_px`.
    """
    n, m = len(left), len(right)
    len_l, len_r = np.diff(left)[:, 0], np.diff(right)[:, 0]
    alone_l, alone_r = (0.5 * (settings.length_px + settings.length_share * x) for x in (len_l, len_r))
    unlike = np.abs(len_l[:, None] - len_r)
    disparity = left[:, None] - right
    possible = ((disparity >= 0) & (disparity <= settings.disparity_px)).all(-1)
    unlike[~possible] = np.inf
    # best[i, j]: least cost of the first i left and j right segments.
    best = np.zeros((n + 1, m + 1))
    best[1:, 0], best[0, 1:] = np.cumsum(alone_l), np.cumsum(alone_r)
    for i in range(n):
        for j in range(m):
            best[i + 1, j + 1] = min(
                best[i, j] + unlike[i, j], best[i, j + 1] + alone_l[i], best[i + 1, j] + alone_r[j]
            )
    pairs = []
    i, j = n, m
    while i and j:
        if best[i, j] == best[i - 1, j - 1] + unlike[i - 1, j - 1]:
            i, j = i - 1, j - 1
            pairs.append((i, j))
        elif best[i, j] == best[i - 1, j] + alone_l[i - 1]:
            i -= 1
        else:
            j -= 1
    return np.array(pairs[::-1], np.intp).reshape(-1, 2)
