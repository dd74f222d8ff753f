"""Judges of tracks: MOTA, IDF1 and HOTA from how well each true thing and each track agree in each frame.

All three are defined as TrackEval has them. HOTA (Luiten et al., IJCV 2021) is the mean over the thresholds
.05, .10, ..., .95 of the similarity; MOTA (Bernardin and Stiefelhagen 2008) and IDF1 (Ristani et al. 2016) match at .5.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from roadblock.errors import ValueRefusedError
from roadblock.values.checks import FloatArray

ALPHAS = np.arange(0.05, 0.99, 0.05)
MATCH_AT = 0.5
TINY = 1e-9
"""A similarity this little below a threshold reaches it."""
STAY = 1000.0
"""What a match of the frame before weighs against any similarity."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """One frame for the judges.

    Attributes
    ----------
    true_ids, track_ids
        (n,) and (m,) identities; each at most once.
    similarity
        (n, m) how well they agree, 0 (not at all) .. 1.

    Raises
    ------
    ValueRefusedError
        If the similarity has another shape, or an identity comes twice.
    """

    true_ids: NDArray[np.int64]
    track_ids: NDArray[np.int64]
    similarity: FloatArray

    def __post_init__(self) -> None:
        shape = (len(self.true_ids), len(self.track_ids))
        if self.similarity.shape != shape:
            raise ValueRefusedError(f"similarity must have shape {shape}, but got {self.similarity.shape}")
        for ids in (self.true_ids, self.track_ids):
            if len(np.unique(ids)) < len(ids):
                raise ValueRefusedError(f"every identity must be in a frame at most once, but got {ids.tolist()}")


@dataclass(frozen=True)
class TrackScores:
    """What the judges say; 1 is best, MOTA may be negative; NaN where there is nothing to judge.

    Attributes
    ----------
    hota, deta, assa, loca
        HOTA and its parts: how well things are detected, how well they keep their identity, how well boxes fit.
    mota, idf1
        As named.
    switches
        How often a thing's track changes.
    missed, false
        True things without a track, and tracks without a true thing, over all frames.
    """

    hota: float
    deta: float
    assa: float
    loca: float
    mota: float
    idf1: float
    switches: int
    missed: int
    false: int


def judge_tracks(frames: Sequence[SeenFrame]) -> TrackScores:
    """Return all scores of a sequence."""
    hota, deta, assa, loca = _hota(frames)
    mota, switches, missed, false = _mota(frames)
    return TrackScores(hota, deta, assa, loca, mota, _idf1(frames), switches, missed, false)


def _numbered(frames: Sequence[SeenFrame]) -> tuple[list[NDArray[np.intp]], list[NDArray[np.intp]], int, int]:
    """Return the identities of each frame numbered from 0, and how many there are."""
    trues = np.unique(np.concatenate([f.true_ids for f in frames] or [np.zeros(0, np.int64)]))
    tracks = np.unique(np.concatenate([f.track_ids for f in frames] or [np.zeros(0, np.int64)]))
    rows = [np.searchsorted(trues, f.true_ids) for f in frames]
    return rows, [np.searchsorted(tracks, f.track_ids) for f in frames], len(trues), len(tracks)


def _hota(frames: Sequence[SeenFrame]) -> tuple[float, float, float, float]:
    rows, columns, n, m = _numbered(frames)
    seen, shown, together = np.zeros(n), np.zeros(m), np.zeros((n, m))
    for f, i, j in zip(frames, rows, columns, strict=True):
        seen[i] += 1
        shown[j] += 1
        s = f.similarity
        either = s.sum(0)[None] + s.sum(1)[:, None] - s
        together[np.ix_(i, j)] += np.divide(s, either, out=np.zeros_like(s), where=either > TINY)
    total = seen.sum() + shown.sum()
    if total == 0:
        return np.nan, np.nan, np.nan, np.nan
    alignment = together / np.maximum(seen[:, None] + shown[None] - together, TINY)
    true_positive, fit = np.zeros(len(ALPHAS)), np.zeros(len(ALPHAS))
    pairs = np.zeros((len(ALPHAS), n, m))
    for f, i, j in zip(frames, rows, columns, strict=True):
        a, b = linear_sum_assignment(-alignment[np.ix_(i, j)] * f.similarity)
        for k, alpha in enumerate(ALPHAS):
            good = f.similarity[a, b] >= alpha - TINY
            true_positive[k] += good.sum()
            fit[k] += f.similarity[a[good], b[good]].sum()
            pairs[k, i[a[good]], j[b[good]]] += 1
    deta = true_positive / (total - true_positive)
    agree = pairs / np.maximum(seen[:, None] + shown[None] - pairs, 1)
    assa = (pairs * agree).sum((1, 2)) / np.maximum(true_positive, 1)
    loca = np.divide(fit, true_positive, out=np.ones_like(fit), where=true_positive > 0)
    return float(np.sqrt(deta * assa).mean()), float(deta.mean()), float(assa.mean()), float(loca.mean())


def _mota(frames: Sequence[SeenFrame]) -> tuple[float, int, int, int]:
    """Match frame by frame; whoever were matched in the frame before stay together if they can."""
    ever: dict[int, int] = {}
    before: dict[int, int] = {}
    switches = missed = false = total = 0
    for f in frames:
        trues, tracks = f.true_ids.tolist(), f.track_ids.tolist()
        matched: dict[int, int] = {}
        if trues and tracks:
            same = np.array([[before.get(t) == k for k in tracks] for t in trues], float)
            allowed = f.similarity >= MATCH_AT - TINY
            a, b = linear_sum_assignment(-np.where(allowed, STAY * same + f.similarity, 0.0))
            matched = {trues[i]: tracks[j] for i, j in zip(a, b, strict=True) if allowed[i, j]}
            switches += sum(ever.get(t, k) != k for t, k in matched.items())
            ever |= matched
            before = matched  # a frame without things or tracks forgets nothing, as in TrackEval
        missed += len(trues) - len(matched)
        false += len(tracks) - len(matched)
        total += len(trues)
    return (1 - (missed + false + switches) / total if total else np.nan), switches, missed, false


def _idf1(frames: Sequence[SeenFrame]) -> float:
    """Match whole identities once, so that most frames agree."""
    rows, columns, n, m = _numbered(frames)
    agree = np.zeros((n, m))
    for f, i, j in zip(frames, rows, columns, strict=True):
        agree[np.ix_(i, j)] += f.similarity >= MATCH_AT - TINY
    a, b = linear_sum_assignment(-agree)
    total = sum(len(f.true_ids) + len(f.track_ids) for f in frames)
    return float(2 * agree[a, b].sum() / total) if total else np.nan
