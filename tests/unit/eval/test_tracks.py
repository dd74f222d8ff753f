"""Scores of tracks against examples worked by hand."""

import math

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.tracks import SeenFrame, judge_tracks


def frame(trues: list[int], tracks: list[int], same: list[tuple[int, int]], similarity: float = 1.0) -> SeenFrame:
    s = np.zeros((len(trues), len(tracks)))
    for t, k in same:
        s[trues.index(t), tracks.index(k)] = similarity
    return SeenFrame(np.array(trues, np.int64), np.array(tracks, np.int64), s)


def test_perfect_tracks() -> None:
    scores = judge_tracks([frame([1, 2], [7, 8], [(1, 7), (2, 8)])] * 4)
    assert (scores.hota, scores.deta, scores.assa, scores.mota, scores.idf1, scores.switches) == (1, 1, 1, 1, 1, 0)


def test_one_thing_with_two_tracks_half_and_half() -> None:
    """10 frames, the track changes in the middle: every match has TPA 5, FNA 5, FPA 0, so AssA is 1/2."""
    scores = judge_tracks([frame([1], [7], [(1, 7)])] * 5 + [frame([1], [8], [(1, 8)])] * 5)
    assert scores.deta == 1
    assert scores.assa == pytest.approx(0.5)
    assert scores.hota == pytest.approx(math.sqrt(0.5))
    assert scores.mota == pytest.approx(0.9)  # one switch in ten
    assert scores.idf1 == pytest.approx(0.5)  # 2 * 5 / (10 + 10)
    assert scores.switches == 1


def test_a_missed_half_and_a_ghost() -> None:
    """4 frames: seen in 2, and a ghost in each: TP 2, FN 2, FP 4."""
    scores = judge_tracks([frame([1], [7, 9], [(1, 7)])] * 2 + [frame([1], [9], [])] * 2)
    assert scores.deta == pytest.approx(2 / 8)
    assert scores.assa == pytest.approx(0.5)  # TPA 2, FNA 2
    assert scores.mota == pytest.approx(1 - 6 / 4)
    assert (scores.missed, scores.false) == (2, 4)
    assert scores.idf1 == pytest.approx(4 / 10)


def test_a_similarity_of_06_counts_up_to_06() -> None:
    """12 of the 19 thresholds (.05 ... .60)."""
    scores = judge_tracks([frame([1], [7], [(1, 7)], 0.6)] * 3)
    assert scores.hota == pytest.approx(12 / 19)
    assert scores.loca == pytest.approx((12 * 0.6 + 7) / 19)  # where nothing matches LocA is 1, as in TrackEval
    assert scores.mota == 1


def test_whoever_was_matched_before_stays() -> None:
    """A second track that fits better does not make a switch."""
    near = SeenFrame(np.array([1]), np.array([7, 8]), np.array([[0.6, 0.9]]))
    assert judge_tracks([frame([1], [7], [(1, 7)]), near, near]).switches == 0


def test_only_the_frame_before_holds_two_together_but_a_switch_is_one_whenever() -> None:
    """1-7, then 7 is gone from 1 for a frame, then 8 fits better than 7: TrackEval takes 8, and counts the switch."""
    away = frame([1], [7], [])
    near = SeenFrame(np.array([1]), np.array([7, 8]), np.array([[0.6, 0.9]]))
    assert judge_tracks([frame([1], [7], [(1, 7)]), away, near]).switches == 1
    nothing_shown = frame([1], [], [])  # forgets nothing
    assert judge_tracks([frame([1], [7], [(1, 7)]), nothing_shown, near]).switches == 0


def test_two_things_exchange_their_tracks() -> None:
    """Four frames, things 1 and 2; after two of them tracks 7 and 8 are exchanged.

    At every threshold TP 8, FN 0, FP 0, so DetA 1; each match has TPA 2, FNA 2, FPA 2, so AssA 1/3. IDTP 4 of 8.
    """
    s = judge_tracks([frame([1, 2], [7, 8], [(1, 7), (2, 8)])] * 2 + [frame([1, 2], [7, 8], [(1, 8), (2, 7)])] * 2)
    assert (s.deta, s.assa, s.hota) == pytest.approx((1, 1 / 3, math.sqrt(1 / 3)))
    assert s.idf1 == pytest.approx(0.5)
    assert s.switches == 2
    assert s.mota == pytest.approx(1 - 2 / 8)


def test_nothing_gives_nan() -> None:
    scores = judge_tracks([])
    assert all(math.isnan(value) for value in (scores.hota, scores.mota, scores.idf1))
    assert math.isnan(judge_tracks([frame([], [], [])]).deta)


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(ValueRefusedError, match=r"similarity must have shape \(1, 1\), but got \(2, 1\)"):
        SeenFrame(np.array([1]), np.array([2]), np.zeros((2, 1)))
    with pytest.raises(ValueRefusedError, match=r"at most once, but got \[3, 3\]"):
        SeenFrame(np.array([1]), np.array([3, 3]), np.zeros((1, 2)))


def test_as_trackeval() -> None:
    """A random sequence; the expected figures were computed with TrackEval 1.3.0 (HOTA, CLEAR, Identity)."""
    rng, frames = np.random.default_rng(59), []
    for t in range(20):
        trues, tracks = np.flatnonzero(rng.random(5) < 0.75), np.flatnonzero(rng.random(7) < 0.6)
        s = rng.random((len(trues), len(tracks))) ** 2
        for a, b in np.argwhere(tracks[None] == (trues + (t > 10) * (trues % 2))[:, None]):
            s[a, b] = 0.4 + 0.6 * rng.random()
        frames.append(SeenFrame(trues, tracks, s))
    scores = judge_tracks(frames)
    expected = (0.30257463797692963, 0.44545958109892314, 0.2058434947750575, 0.8107526458710573)
    assert (scores.hota, scores.deta, scores.assa, scores.loca) == pytest.approx(expected)
    assert (scores.mota, scores.idf1) == pytest.approx((-0.012345679012345734, 0.4970414201183432))
    assert (scores.switches, scores.missed, scores.false) == (35, 20, 27)
