"""The monitor: rectified pairs of a drive in, one after the other; what the rig's drift is, after each, out."""

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from roadblock.errors import ValueRefusedError
from roadblock.kernels.features import Points
from roadblock.stages.selfcheck.epipolar import UNKNOWN, Turn, fit_turn, normalized, turn_slopes
from roadblock.stages.selfcheck.expansion import FAR_PX, Stretch, fit_stretch
from roadblock.stages.selfcheck.features import Gray, follow, gray_pair, match_pair, spread_corners
from roadblock.stages.selfcheck.settings import SelfcheckSettings
from roadblock.stages.selfcheck.trust import turn_covariance
from roadblock.stages.selfcheck.verdict import CLEARED, is_off, is_sure, measure, worded
from roadblock.values.camera import Rectification, StereoRig
from roadblock.values.checks import FloatArray
from roadblock.values.drift import RigDrift
from roadblock.values.frame import RectifiedPair

TELLING_PX = 1.0
"""A stretch that knows disparities to no better than this says nothing."""


class _Tracks(NamedTuple):
    """Features on their way: where and how far they were first (n, 3) u, v, d; where they are; how old."""

    first: NDArray[np.float32]
    points: Points
    d_px: NDArray[np.float32]
    started_with: int
    age: int


class RigMonitor:
    """Keeps the latest features of a drive and says after each pair whether the rig is still as its file says.

    Parameters
    ----------
    rig
        The rig the pairs are rectified with.
    settings
        Evidence and alarm.
    is_sequence
        Whether the pairs follow each other in time. Single frames show no motion: their yaw is unknown unless the rig
        says how sure its lenses are.
    """

    def __init__(self, rig: StereoRig, settings: SelfcheckSettings | None = None, is_sequence: bool = True) -> None:
        self.settings = settings or SelfcheckSettings()
        self.is_sequence = is_sequence
        self._rig_cov_rad2 = turn_covariance(rig)
        self._rectification: Rectification | None = None
        self._rows: deque[FloatArray] = deque(maxlen=self.settings.frames)
        self._stretches: deque[Stretch] = deque(maxlen=self.settings.motions)
        self._tracks: _Tracks | None = None
        self._previous: Gray | None = None
        self._agreeing = 0
        self._alarmed = False

    def update(self, pair: RectifiedPair) -> RigDrift:
        """Take the next pair in.

        Raises
        ------
        ValueRefusedError
            If it was rectified otherwise than the pairs before.
        """
        if self._rectification is None:
            self._rectification = pair.rectification
        if pair.rectification is not self._rectification:
            raise ValueRefusedError(
                f"frame {pair.name} is rectified otherwise than the frames before: give each rig a monitor of its own"
            )
        left, right = gray_pair(pair)
        if self._tracks is not None and self._previous is not None:
            self._tracks = self._followed(self._tracks, self._previous, left)
        if self._tracks is None:
            self._tracks = self._begun(left)
        self._tracks, rows = self._matched(self._tracks, left, right)
        self._rows.append(rows if len(rows) >= self.settings.least_features else rows[:0])
        turn = self._turn(pair.rectification)
        if self._is_over(self._tracks):
            self._finish(self._tracks, turn, pair.rectification)
            self._tracks = None
        self._previous = left
        return self._judged(turn, pair.rectification)

    def _followed(self, tracks: _Tracks, before: Gray, left: Gray) -> _Tracks | None:
        """Find the features of the frame before in this one; None where they are lost or too old to trust."""
        if not self.is_sequence or tracks.age >= self.settings.frames:
            return None
        points, good = follow(before, left, tracks.points, self.settings)
        if good.sum() < self.settings.least_features:
            return None
        return _Tracks(tracks.first[good], points[good], tracks.d_px[good], tracks.started_with, tracks.age + 1)

    def _begun(self, left: Gray) -> _Tracks:
        points = spread_corners(left, self.settings)
        unknown = np.full(len(points), np.nan, np.float32)
        return _Tracks(np.stack([*points.T, unknown], -1), points, unknown, 0, 0)

    def _matched(self, tracks: _Tracks, left: Gray, right: Gray) -> tuple[_Tracks, FloatArray]:
        """Match features with the right image; return those that fit, and (m, 3) u, v there and dv."""
        begins = tracks.age == 0
        found, good = match_pair(left, right, tracks.points, self.settings, None if begins else tracks.d_px)
        d_px = tracks.points[:, 0] - found[:, 0]
        rows = np.column_stack([found, found[:, 1] - tracks.points[:, 1]])[good].astype(float)
        points, d_px = tracks.points[good], d_px[good]
        first = np.column_stack([points, d_px]) if begins else tracks.first[good]
        return _Tracks(first, points, d_px, len(points) if begins else tracks.started_with, tracks.age), rows

    def _turn(self, r: Rectification) -> Turn:
        """Fit the turn to the vertical disparities of all pairs kept."""
        rows = np.concatenate(self._rows)
        return fit_turn(rows[:, :2], rows[:, 2], r) if len(rows) else UNKNOWN

    def _is_over(self, tracks: _Tracks) -> bool:
        """Whether a stretch has brought things enough nearer, lost too many, or can grow no older."""
        if not tracks.age:
            return False
        near = tracks.d_px > FAR_PX
        closing = np.median(np.abs(_growth(tracks)[near])) if near.any() else 0.0
        few = len(tracks.points) < self.settings.kept_share * tracks.started_with
        return bool(closing > np.log1p(self.settings.closing) or few or tracks.age >= self.settings.frames)

    def _finish(self, tracks: _Tracks, turn: Turn, r: Rectification) -> None:
        """Keep what a stretch says of the yaw, if it says anything."""
        grown = np.abs(_growth(tracks)) <= self.settings.growth * tracks.age
        if grown.sum() < self.settings.least_features or not np.isfinite(turn.turn_rad).all():
            return
        first, second = tracks.first[grown], np.column_stack([tracks.points, tracks.d_px])[grown]
        stretch = fit_stretch(_levelled(first, turn, r), _levelled(second, turn, r), r)
        turning = np.radians(self.settings.turning_deg) * tracks.age
        if stretch is not None and stretch.turned_rad < turning and r.f_px * stretch.sigma_rad < TELLING_PX:
            self._stretches.append(stretch)

    def _judged(self, turn: Turn, r: Rectification) -> RigDrift:
        """Return the drift, with an alarm that begins late and ends late."""
        frames = sum(len(rows) > 0 for rows in self._rows)
        drift = measure(turn, self._stretches, self._rig_cov_rad2, frames, r)
        off = is_off(drift, self.settings, CLEARED if self._alarmed else 1.0)
        self._agreeing = self._agreeing + 1 if off.any() else 0
        if self._alarmed:
            self._alarmed = bool(off.any()) or not is_sure(drift, self.settings)
        else:
            self._alarmed = self._agreeing >= self.settings.confirm
        return worded(drift, self._alarmed, self.settings)


def _growth(tracks: _Tracks) -> NDArray[np.float32]:
    """Return the logarithm (n,) of how much larger features have become; nearly 0 for what is far."""
    return np.asarray(np.log(np.maximum(tracks.d_px, FAR_PX) / np.maximum(tracks.first[:, 2], FAR_PX)))


def _levelled(uvd: NDArray[np.float32], turn: Turn, r: Rectification) -> FloatArray:
    """Return u, v, d (n, 3) as they would be without the right camera's pitch and roll."""
    u, v, d = uvd.astype(float).T
    by_u = turn_slopes(normalized(np.stack([u - d, v], -1), r))[0]
    return np.stack([u, v, d + r.f_px * (by_u[:, [0, 2]] @ turn.turn_rad[[0, 2]])], -1)
