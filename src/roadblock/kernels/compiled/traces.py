"""The kernels of `reference.traces`, compiled: same names, same arguments, same numbers."""

import numba
import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.reference.traces import (
    BESIDE_SHARE,
    CLEAR_M,
    COLUMN_SIGMA_PX,
    FAR_ENOUGH,
    LEAST,
    MOST,
    MOVED_SHARE,
    NEAREST_M,
    SIGMAS,
    Flags,
    Floats,
)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def slack(z_m: float, twin: Floats) -> float:
    """See `reference.traces.slack`."""
    return CLEAR_M + SIGMAS * COLUMN_SIGMA_PX * z_m * z_m / (twin[0] * twin[3])  # type: ignore[no-any-return]


@numba.njit(cache=True, nogil=True, error_model="numpy")
def revisit(
    slots: NDArray[np.int64],
    spans: Floats,
    spans_then: Floats,
    grid: Floats,
    range_m: Floats,
    is_blocked: Flags,
    ranges_then: Floats,
    blocked_then: Flags,
    T_now_then: Floats,
    twin: Floats,
) -> NDArray[np.int64]:
    """See `reference.traces.revisit`."""
    counts = np.zeros((len(slots), 4), np.int64)
    for i in range(len(slots)):
        k = slots[i]
        if k < 0:
            continue
        T = T_now_then[k]
        R = T[:3, :3].T
        back = np.empty((3, 4))
        for a in range(3):
            back[a, 3] = 0.0
            for b in range(3):
                back[a, b] = R[a, b]
                back[a, 3] -= R[a, b] * T[b, 3]
        _ask(counts[i, :2], spans[i], range_m, is_blocked, back, ranges_then[k], blocked_then[k], grid, twin)
        _ask(counts[i, 2:], spans_then[i, k], ranges_then[k], blocked_then[k], T, range_m, is_blocked, grid, twin)
    return counts


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _ask(
    counts: NDArray[np.int64],
    span: Floats,
    range_m: Floats,
    is_blocked: Flags,
    T: Floats,
    there_m: Floats,
    blocked_there: Flags,
    grid: Floats,
    twin: Floats,
) -> None:
    """Count what the ends of a thing's columns are in another frame: free road, or where something stands."""
    f, cx, _, baseline_m = twin
    columns = len(range_m)
    first = max(0, int(np.ceil((span[0] - grid[0]) / grid[1])))
    last = min(columns, int(np.ceil((span[1] - grid[0]) / grid[1])))
    found = 0
    for c in range(first, last):
        found += is_blocked[c] and span[2] <= range_m[c] <= span[3]
    step, number = 1 + found // MOST, -1
    for c in range(first, last):
        z = range_m[c]
        if not (is_blocked[c] and span[2] <= z <= span[3]):
            continue
        number += 1
        if number % step:
            continue
        x = (grid[0] + grid[1] * c - cx) / f * z - baseline_m / 2
        x, z = T[0, 0] * x + T[0, 2] * z + T[0, 3], T[2, 0] * x + T[2, 2] * z + T[2, 3]
        if z < NEAREST_M:
            continue
        column = ((x + baseline_m / 2) / z * f + cx - grid[0]) / grid[1]
        if not 0 <= column < columns - 1:
            continue
        k = int(column)
        one, other = there_m[k], there_m[k + 1]
        slack_m = slack(z, twin)
        if one > z + slack_m and other > z + slack_m:
            counts[0] += 1
        elif blocked_there[k] and blocked_there[k + 1]:
            counts[1] += max(one, other) > z - slack_m and min(one, other) <= z + slack_m


@numba.njit(cache=True, nogil=True, error_model="numpy")
def spans(boxes: Floats, range_m: Floats, long_m: Floats) -> Floats:
    """See `reference.traces.spans`."""
    found = np.empty((len(boxes), 4))
    for i in range(len(boxes)):
        near_m = BESIDE_SHARE * range_m[i] + long_m[i]
        found[i, 0], found[i, 1] = boxes[i, 0], boxes[i, 2]
        found[i, 2], found[i, 3] = range_m[i] - near_m, range_m[i] + near_m
    return found


@numba.njit(cache=True, nogil=True, error_model="numpy")
def judge(
    spans_now: Floats,
    spans_then: Floats,
    is_seen: Flags,
    speed_mps: Floats,
    lag_s: Floats,
    grid: Floats,
    range_m: Floats,
    is_blocked: Flags,
    ranges_then: Floats,
    blocked_then: Flags,
    T_now_then: Floats,
    twin: Floats,
) -> tuple[Flags, Flags]:
    """See `reference.traces.judge`."""
    n = len(spans_now)
    slots, longest_s = np.full(n, -1, np.int64), np.zeros(n)
    for i in range(n):
        for k in range(len(lag_s)):
            if is_seen[i] and spans_then[i, k, 1] > 0 and lag_s[k] > longest_s[i]:
                slots[i], longest_s[i] = k, lag_s[k]
    counts = revisit(
        slots, spans_now, spans_then, grid, range_m, is_blocked, ranges_then, blocked_then, T_now_then, twin
    )
    moved, slid = np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    for i in range(n):
        came, came_not, left, left_not = counts[i]
        moved[i] = (came >= LEAST and came > MOVED_SHARE * (came + came_not)) or (
            left >= LEAST and left > MOVED_SHARE * (left + left_not)
        )
        z = (spans_now[i, 2] + spans_now[i, 3]) / 2
        slid[i] = not moved[i] and speed_mps[i] * longest_s[i] > FAR_ENOUGH * slack(z, twin)
    return moved, slid
