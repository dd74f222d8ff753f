"""Free space that remembers: columns in closed form before a vehicle that drives straight on."""

import numpy as np
import pytest
from stage_examples import TWIN

from roadblock.geometry.pose import pose
from roadblock.stages.fuse import FreeSpaceMemory, FuseSettings
from roadblock.values.motion import EgoMotion
from roadblock.values.scene import FreeSpace

U = np.arange(1.5, 320, 4)
WALL_M, STEP_M, FRAME_NS = 12.0, 0.8, 100_000_000
MIDDLE = slice(30, 50)


def frame(range_m: np.ndarray, blocked: np.ndarray | None = None) -> FreeSpace:
    return FreeSpace(U, range_m, np.isfinite(range_m) if blocked is None else blocked)


def ahead(t_ns: int, reason: str = "") -> EgoMotion:
    if reason:
        return EgoMotion.unknown(t_ns - FRAME_NS, t_ns, reason)
    return EgoMotion(t_ns - FRAME_NS, t_ns, pose(np.eye(3), [0.0, 0.0, -STEP_M]), np.eye(6))


def drive(last: FreeSpace, *, frames: int = 5, reason: str = "", settings: FuseSettings | None = None) -> FreeSpace:
    """Return what is remembered after `frames` frames before a wall, at the one in which `last` was found."""
    remember = FreeSpaceMemory(TWIN, settings or FuseSettings())
    for k in range(frames):
        seen = frame(np.full(len(U), WALL_M - k * STEP_M))
        same = remember(seen, (k + 1) * FRAME_NS, ahead((k + 1) * FRAME_NS) if k else None)
        np.testing.assert_array_equal(same.range_m, seen.range_m)
    t_ns = (frames + 1) * FRAME_NS
    return remember(last, t_ns, ahead(t_ns, reason))


def overlooked(range_m: float = 30.0) -> FreeSpace:
    """Return the frame after the fifth in which the middle of the wall is not seen."""
    found, blocked = np.full(len(U), WALL_M - 5 * STEP_M), np.ones(len(U), bool)
    found[MIDDLE], blocked[MIDDLE] = range_m, False
    return FreeSpace(U, found, blocked)


def test_what_all_frames_before_saw_one_frame_cannot_overlook() -> None:
    fused = drive(overlooked())
    np.testing.assert_allclose(fused.range_m, WALL_M - 5 * STEP_M, rtol=1e-9)
    assert fused.is_blocked is not None
    assert fused.is_blocked.all()


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": 3},  # too few before
        {"reason": "too dark"},  # nobody knows where they are now
        {"settings": FuseSettings(frames=0)},
        {"settings": FuseSettings(memory_s=0.25)},  # they are too old
    ],
)
def test_what_is_not_known_for_sure_changes_nothing(changes: dict) -> None:
    last = overlooked()
    fused = drive(last, **changes)
    np.testing.assert_array_equal(fused.range_m, last.range_m)


def test_free_space_is_never_made_longer_and_unobserved_stays_so() -> None:
    found = np.full(len(U), 3.0)
    found[MIDDLE] = np.nan
    fused = drive(frame(found))
    np.testing.assert_array_equal(fused.range_m, found)


def test_a_small_difference_is_noise() -> None:
    last = overlooked(1.08 * (WALL_M - 5 * STEP_M))
    np.testing.assert_array_equal(drive(last).range_m, last.range_m)


def test_where_the_road_was_only_seen_no_further_it_may_be_free_now() -> None:
    remember = FreeSpaceMemory(TWIN, FuseSettings())
    for k in range(5):
        seen = frame(np.full(len(U), WALL_M), np.zeros(len(U), bool))
        remember(seen, (k + 1) * FRAME_NS, ahead((k + 1) * FRAME_NS) if k else None)
    last = frame(np.full(len(U), 30.0))
    np.testing.assert_array_equal(remember(last, 6 * FRAME_NS, ahead(6 * FRAME_NS)).range_m, last.range_m)


def test_a_detector_that_does_not_tell_what_ends_it_is_left_alone() -> None:
    free = FreeSpace(U, np.full(len(U), 9.0))
    assert drive(free) is free
