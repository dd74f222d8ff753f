"""Which frames of a video to calibrate from: those where the board stands still, each in another place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadblock.values.board import Board, BoardView
from roadblock.values.checks import FloatArray

STILL_PX = 1.0
"""A board that moved further from one frame to the next is blurred, and the two cameras may not see it at once."""
ENOUGH = 20
"""As many of the stillest views are kept, however far their boards moved."""
MOST_VIEWS = 60
ALIKE_SHARE = 0.01
"""Boards nearer to each other than this share of the image's diagonal show the same."""


@dataclass(frozen=True)
class Choice:
    """The views chosen from a video, in their order, and how many were passed over because of what."""

    views: tuple[BoardView, ...]
    moving: int
    alike: int
    motion_px: float
    """Largest motion of a chosen view's board from one frame to the next; NaN where no neighbours were seen."""


def choose_views(
    views: Sequence[BoardView], frames: Sequence[int], board: Board, size_px: tuple[int, int], most: int = MOST_VIEWS
) -> Choice:
    """Choose still and different views among the frames of a video.

    Parameters
    ----------
    views
        In the order of the video, each of a frame that showed the board.
    frames
        The number of each view's frame; numbers that follow each other are neighbours in time.
    board
        The board.
    size_px
        (width, height) of the images.
    most
        How many to choose at most: each next one is the one farthest from all chosen before.

    Returns
    -------
    The views; those without a neighbour count as still, since nothing speaks against them.
    """
    count = len(board.points_m)
    placed = np.array([_placed(view, count) for view in views]).reshape(len(views), 2 * count, 2)
    motion_px = np.full(len(views), np.nan)
    for i in range(1, len(views)):
        if frames[i] == frames[i - 1] + 1:
            moved_px = _apart(placed[i], placed[i - 1 : i])[0]
            motion_px[i - 1 : i + 1] = np.fmin(motion_px[i - 1 : i + 1], moved_px)
    by_motion = np.argsort(np.nan_to_num(motion_px, nan=0.0), kind="stable")
    still = [i for rank, i in enumerate(by_motion) if rank < ENOUGH or not motion_px[i] > STILL_PX]
    kept = _different(placed, sorted(still), ALIKE_SHARE * float(np.hypot(*size_px)), most)
    seen = motion_px[kept]
    return Choice(
        tuple(views[i] for i in kept),
        moving=len(views) - len(still),
        alike=len(still) - len(kept),
        motion_px=float(np.nanmax(seen)) if np.isfinite(seen).any() else float("nan"),
    )


def _placed(view: BoardView, points: int) -> FloatArray:
    """(2 * points, 2) where the board's points are in the left, then in the right image; NaN where they are not."""
    places = np.full((2, points, 2), np.nan)
    for side, sighting in enumerate((view.left, view.right)):
        if sighting is not None:
            places[side, sighting.ids] = sighting.points_px
    return places.reshape(-1, 2)


def _apart(place: FloatArray, others: FloatArray) -> FloatArray:
    """(n,) median distance of the points that `place` shares with each of `others`, pixels; inf where none is."""
    distances = np.linalg.norm(others - place, axis=-1)
    shares = np.isfinite(distances).any(-1)
    apart = np.full(len(others), np.inf)
    apart[shares] = np.nanmedian(distances[shares], -1)
    return apart


def _different(placed: FloatArray, candidates: list[int], least_px: float, most: int) -> list[int]:
    """Choose farthest points first, until the next one lies nearer than `least_px` to one chosen."""
    if not candidates:
        return []
    chosen, nearest = [candidates[0]], _apart(placed[candidates[0]], placed[candidates])
    while len(chosen) < most:
        far = int(np.argmax(nearest))
        if nearest[far] < least_px:
            break
        chosen.append(candidates[far])
        nearest = np.minimum(nearest, _apart(placed[candidates[far]], placed[candidates]))
        nearest[far] = 0.0
    return sorted(chosen)
