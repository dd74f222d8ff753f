"""Average precision by the rules of KITTI and nuScenes: plain numbers in; 0 to 1 out, NaN without truth.

KITTI (pairing as in the object benchmark's `evaluate_object.cpp`, AP over 40 recalls, Simonelli et al., 2019): found
and true things pair by overlap; those that are too small, hidden or cut off for a level, and things of a like class,
count neither way. The benchmark's program takes one recall per hit and so gives next to nothing for fewer than 40 true
things; here each recall is looked up by itself, which comes to the same for many and is right for few. nuScenes (Caesar
et al., 2020): they pair by the distance of their places on the road.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray

RECALLS = 40
LEAST_RECALL, LEAST_PRECISION = 0.1, 0.1
"""Of nuScenes: what is worse than these counts as nothing."""
NUSCENES_RECALLS = np.linspace(0, 1, 101)


@dataclass(frozen=True, eq=False)
class Candidates:
    """One class in one frame.

    Attributes
    ----------
    score
        (n,) of the found, higher = surer.
    overlap
        (n, m) of the found with the true things, 0..1; or their distances in metres (for nuScenes's rules).
    is_small
        (n,) found things that count neither way.
    is_optional
        (m,) true things that count neither way.
    in_doubt
        (n,) largest share of each found thing that lies in one area where nobody knows.

    Raises
    ------
    ValueRefusedError
        If the shapes do not fit together.
    """

    score: FloatArray
    overlap: FloatArray
    is_small: np.ndarray
    is_optional: np.ndarray
    in_doubt: FloatArray

    def __post_init__(self) -> None:
        n, m = len(self.score), len(self.is_optional)
        if self.overlap.shape != (n, m) or {len(self.is_small), len(self.in_doubt)} != {n}:
            raise ValueRefusedError(
                f"overlap must have shape {(n, m)} and the others fit it, but got {self.overlap.shape}, "
                f"{len(self.is_small)} and {len(self.in_doubt)}"
            )


def kitti_average_precision(frames: Sequence[Candidates], least_overlap: float) -> float:
    """Return the mean precision at the recalls 1/40, 2/40, ..., 1.

    Parameters
    ----------
    frames
        All frames of one class and level.
    least_overlap
        Found and true things pair above this overlap.

    Returns
    -------
    NaN where no true thing counts.
    """
    count = sum(int((~frame.is_optional).sum()) for frame in frames)
    if count == 0:
        return math.nan
    hits = np.sort(np.concatenate([_hit_scores(frame, least_overlap) for frame in frames]))[::-1]
    needed = -(-np.arange(1, RECALLS + 1) * count // RECALLS)  # hits that make up each recall, rounded up
    precision = {}
    for n in np.unique(needed[needed <= len(hits)]):
        right, wrong = np.sum([_count(frame, least_overlap, hits[n - 1]) for frame in frames], axis=0)
        precision[n] = right / max(right + wrong, 1)
    return float(np.mean([max((p for m, p in precision.items() if m >= n), default=0.0) for n in needed]))


def _hit_scores(frame: Candidates, least_overlap: float) -> FloatArray:
    """Return the scores of the found things that are a true one: each true thing takes the surest it overlaps."""
    free, scores = np.ones(len(frame.score), bool), []
    for j, is_optional in enumerate(frame.is_optional):
        fits = np.flatnonzero(free & (frame.overlap[:, j] > least_overlap))
        if len(fits):
            best = fits[np.argmax(frame.score[fits])]
            free[best] = False
            if not is_optional and not frame.is_small[best]:
                scores.append(frame.score[best])
    return np.array(scores, float)


def _count(frame: Candidates, least_overlap: float, threshold: float) -> tuple[int, int]:
    """Return how many found things are right and wrong at a threshold of the score."""
    sure = frame.score >= threshold
    free, right = sure.copy(), 0
    for j, is_optional in enumerate(frame.is_optional):
        fits = free & (frame.overlap[:, j] > least_overlap)
        counting = np.flatnonzero(fits & ~frame.is_small)
        if len(counting):
            free[counting[np.argmax(frame.overlap[counting, j])]] = False
            right += not is_optional
        elif fits.any():
            free[np.flatnonzero(fits)[0]] = False
    wrong = free & ~frame.is_small & (frame.in_doubt <= least_overlap)
    return right, int(wrong.sum())


def distance_average_precision(frames: Sequence[Candidates], largest_m: float) -> float:
    """Return nuScenes's average precision: over recalls above 0.1, of what the precision is above 0.1.

    Parameters
    ----------
    frames
        All frames of one class; `overlap` holds distances, metres (NaN where unknown: never a pair).
    largest_m
        Found and true things pair nearer than this: the surest first, each to the nearest that is left.

    Returns
    -------
    NaN where there is no true thing.
    """
    count = sum(len(frame.is_optional) for frame in frames)
    if count == 0:
        return math.nan
    order = sorted(
        ((frame.score[i], k, i) for k, frame in enumerate(frames) for i in range(len(frame.score))), key=_key
    )
    left = [np.where(np.isnan(frame.overlap), np.inf, frame.overlap) for frame in frames]
    is_right = np.zeros(len(order), bool)
    for n, (_, k, i) in enumerate(order):
        if left[k].shape[1] and left[k][i].min() < largest_m:
            is_right[n] = True
            left[k][:, left[k][i].argmin()] = np.inf
    if not is_right.any():
        return 0.0
    right = np.cumsum(is_right)
    precision = np.interp(NUSCENES_RECALLS, right / count, right / np.arange(1, len(order) + 1), right=0)
    above = precision[round(100 * LEAST_RECALL) + 1 :] - LEAST_PRECISION
    return float(np.maximum(above, 0).mean() / (1 - LEAST_PRECISION))


def _key(candidate: tuple[float, int, int]) -> tuple[float, int, int]:
    score, frame, index = candidate
    return -score, frame, index
