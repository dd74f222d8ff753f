"""Fuse: FreeSpace of each frame and the vehicle's own motion in; FreeSpace that remembers a moment, out.

What ended a column's free space in the frames before is carried along with the motion. Where these frames agree
that something stands nearer than this frame says, this frame overlooked it: the column ends there. Nothing is ever made
longer, and what this frame did not observe stays unobserved.
"""

from typing import NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace

BESIDE_PX = 4.0
"""A column takes the nearest end before in the image, no further aside than this."""


class FuseSettings(BaseModel):
    """How free space is remembered."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    frames: int = Field(4, ge=0, le=20, description="Of so many frames before; 0 = each frame by itself.")
    memory_s: float = Field(0.5, gt=0, description="None of them older than this.")
    agree: int = Field(4, ge=1, description="So many of them must have seen something standing there, ...")
    nearer: float = Field(0.9, gt=0, lt=1, description="... nearer than this share of what this frame says, ...")
    nearer_px: float = Field(1.5, ge=0, description="... and by so much disparity.")


class _Ends(NamedTuple):
    """Where the blocked columns of an earlier frame ended: (n,) x and z in the car frame of now, metres."""

    t_ns: int
    x_m: FloatArray
    z_m: FloatArray


class FreeSpaceMemory:
    """Keeps the ends of free space of the latest frames of a drive.

    Parameters
    ----------
    rectification
        The twin cameras of all frames.
    settings
        How much is remembered.
    """

    def __init__(self, rectification: Rectification, settings: FuseSettings) -> None:
        self.rectification = rectification
        self.settings = settings
        self._before: tuple[_Ends, ...] = ()

    def __call__(self, free: FreeSpace, t_ns: int, ego: EgoMotion | None) -> FreeSpace:
        """Return the free space of the next frame, as far as the frames before allow.

        Parameters
        ----------
        free
            As a detector found it in this frame.
        t_ns
            Moment of the frame.
        ego
            How the cameras moved since the frame before. Where that is unknown, or there is no frame before, everything
            is forgotten.
        """
        s = self.settings
        if s.frames == 0 or free.is_blocked is None:
            return free
        oldest_ns = t_ns - round(1e9 * s.memory_s)
        before = []
        if ego is not None and ego.T_now_before is not None:
            before = [_moved(ends, ego.T_now_before) for ends in self._before if ends.t_ns >= oldest_ns]
        r, z = self.rectification, free.range_m
        x = (free.u_px - r.cx_px) / r.f_px * z - r.baseline_m / 2
        mine = _Ends(t_ns, x[free.is_blocked], z[free.is_blocked])
        self._before = (mine, *before)[: s.frames]
        if len(before) < s.agree:
            return free
        ranges = np.sort([self._per_column(ends, free.u_px) for ends in before], axis=0)
        with np.errstate(invalid="ignore"):
            fb = self.rectification.f_px * self.rectification.baseline_m
            count = (ranges < np.minimum(s.nearer * z, fb / (fb / z + s.nearer_px))).sum(0)
            agreed = ranges[np.maximum(count - 1, 0), np.arange(len(z))]
            late = count >= s.agree
        return FreeSpace(free.u_px, np.where(late, agreed, z), free.is_blocked | late, free.edges)

    def _per_column(self, ends: _Ends, u_px: FloatArray) -> FloatArray:
        """Return (n,) the range at which the thing that ended a column before is now; infinity where none did."""
        r = self.rectification
        ahead = ends.z_m > 0
        x, z = ends.x_m[ahead], ends.z_m[ahead]
        if len(z) == 0:
            return np.full(len(u_px), np.inf)
        at = (x + r.baseline_m / 2) / z * r.f_px + r.cx_px
        order = np.argsort(at)
        at, z = at[order], z[order]
        after = np.clip(np.searchsorted(at, u_px), 1, max(1, len(at) - 1))
        nearest = np.minimum(np.where(u_px - at[after - 1] < at[after % len(at)] - u_px, after - 1, after), len(at) - 1)
        return np.where(np.abs(at[nearest] - u_px) <= BESIDE_PX, z[nearest], np.inf)


def _moved(ends: _Ends, T: FloatArray) -> _Ends:
    """Return the ends as they are now; a road is level enough for their height not to matter."""
    return _Ends(
        ends.t_ns,
        T[0, 0] * ends.x_m + T[0, 2] * ends.z_m + T[0, 3],
        T[2, 0] * ends.x_m + T[2, 2] * ends.z_m + T[2, 3],
    )
