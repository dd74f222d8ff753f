"""What things leave where they were: the free space of the last moments, and whether a track's outline really moved."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.traces import judge, spans
from roadblock.stages.track.bank import KEPT, Bank
from roadblock.values.checks import FloatArray
from roadblock.values.scene import FreeSpace

BETWEEN_S, LONGEST_S, SHORTEST_S = 0.09, 1.0, 0.15
"""Frames are kept so far apart, and compared with the oldest within the second, if it is older than the third."""


class Verdict(NamedTuple):
    """What the road says of tracks (n,): `moved` from where they were; `slid`, though they seem to have moved."""

    moved: NDArray[np.bool_]
    slid: NDArray[np.bool_]


class Traces:
    """Keeps the free space of the latest second; `twin` as in the kernels."""

    def __init__(self, twin: FloatArray) -> None:
        self._twin = twin
        self._t_ns, self._T, self._next = np.zeros(KEPT, np.int64), np.tile(np.eye(4), (KEPT, 1, 1)), 0
        self._range_m, self._is_blocked = np.zeros((KEPT, 0)), np.zeros((KEPT, 0), bool)

    def move(self, T_now_before: FloatArray | None) -> None:
        """Take in how the cameras moved, car frame; None, unknown, forgets all."""
        if T_now_before is None:
            self._t_ns[:] = 0
        else:
            self._T = T_now_before @ self._T

    def judge(self, bank: Bank, free: FreeSpace, t_ns: int) -> Verdict:
        """Return what became of where tracks measured now were, by their speeds."""
        lag_s = (t_ns - self._t_ns) / 1e9
        lag_s[(self._t_ns == 0) | (lag_s < SHORTEST_S) | (lag_s > LONGEST_S)] = 0.0
        no = np.zeros(len(bank), bool)
        if len(free.u_px) != self._range_m.shape[1] or not len(bank) or not lag_s.any():
            return Verdict(no, no)
        is_seen = bank.seen_ns == t_ns
        then = self._range_m, self._is_blocked, self._T
        speed_mps = np.hypot(bank.x[:, 3], bank.x[:, 4])
        now = spans(bank.boxes, bank.range_m, bank.long_m)
        return Verdict(
            *judge(now, bank.spans, is_seen, speed_mps, lag_s, free.grid, free.range_m, free.ends, *then, self._twin)
        )

    def keep(self, bank: Bank, free: FreeSpace, t_ns: int) -> None:
        """Remember a frame, unless the one before is only just over."""
        if len(free.u_px) != self._range_m.shape[1]:
            self._range_m, self._is_blocked = np.zeros((KEPT, len(free.u_px))), np.zeros((KEPT, len(free.u_px)), bool)
            self._t_ns[:] = 0
        if t_ns - self._t_ns.max() < 1e9 * BETWEEN_S:
            return
        k, self._next = self._next, (self._next + 1) % KEPT
        self._t_ns[k], self._T[k] = t_ns, np.eye(4)
        self._range_m[k], self._is_blocked[k] = free.range_m, free.ends
        bank.spans[:, k] = spans(bank.boxes, bank.range_m, bank.long_m)
        bank.spans[bank.seen_ns != t_ns, k] = 0.0
