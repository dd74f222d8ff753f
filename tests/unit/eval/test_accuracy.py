import math

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.eval.accuracy import Reading, accuracy, by_type_and_range, read_drive, read_frame

TYPES = ("person", "bicycle", "fork")


def truth_of_a_drive(frames=40, seed=3):
    """A drive of boxes that do not overlap, in the fields of `truth.jsonl`."""
    rng = np.random.default_rng(seed)
    return [
        {
            "schema": 1,
            "frame": index,
            "name": f"{index:06d}",
            "objects": [
                {
                    "id": k + 1,
                    "type": TYPES[k],
                    "range_m": float(rng.uniform(4, 40)),
                    "box_px": [100 * k + 7, 20, 100 * k + 60, 95],
                }
                for k in range(3)
            ],
        }
        for index in range(frames)
    ]


def perturbed(truth, errors_m, sigma_m=0.1, missed=()):
    """The results of a system that errs by `errors_m` (frames, 3), in the fields of `obstacles.jsonl`, shuffled."""
    rng = np.random.default_rng(5)
    frames = []
    for i, frame in enumerate(truth):
        obstacles = [
            {
                "class": "unknown",
                "range_m": thing["range_m"] + errors_m[i, k],
                "range_sigma_m": sigma_m,
                "box_px": (np.array(thing["box_px"]) + rng.integers(-4, 5, 4)).tolist(),
            }
            for k, thing in enumerate(frame["objects"])
            if (i, k) not in missed
        ]
        obstacles.append({"range_m": 12.0, "range_sigma_m": None, "box_px": [600, 20, 640, 90]})
        rng.shuffle(obstacles)
        frames.append({"name": frame["name"], "obstacles": obstacles})
    rng.shuffle(frames)
    return frames


def test_a_perturbed_truth_is_scored_at_exactly_its_errors():
    """The judge is judged: every figure comes back as it was put in, at every type."""
    truth = truth_of_a_drive()
    errors_m = np.random.default_rng(8).normal([0.05, -0.2, 0.0], [0.1, 0.3, 0.5], (len(truth), 3))
    missed = {(3, 0), (4, 1), (5, 1)}
    readings = read_drive(perturbed(truth, errors_m, 0.25, missed), truth)
    assert len(readings) == 120
    for k, name in enumerate(TYPES):
        kept = np.array([errors_m[i, k] for i in range(len(truth)) if (i, k) not in missed])
        result = accuracy(reading for reading in readings if reading.type == name)
        assert (result.n, result.missed) == (40, 40 - len(kept))
        assert result.bias_m == pytest.approx(sum(kept) / len(kept), abs=1e-12)
        assert result.rms_m == pytest.approx(math.sqrt(sum(kept**2) / len(kept)), abs=1e-12)
        size = np.sort(np.abs(kept))
        assert result.median_abs_m == pytest.approx((size[(len(kept) - 1) // 2] + size[len(kept) // 2]) / 2, abs=1e-12)
        at = 0.95 * (len(kept) - 1)
        low = int(at)
        assert result.p95_abs_m == pytest.approx(size[low] + (at - low) * (size[low + 1] - size[low]), abs=1e-12)
        assert result.within_1_sigma == pytest.approx(np.mean(size <= 0.25))
        assert result.within_2_sigma == pytest.approx(np.mean(size <= 0.5))


def test_an_unperturbed_truth_has_no_error():
    truth = truth_of_a_drive(5)
    result = accuracy(read_drive(perturbed(truth, np.zeros((5, 3))), truth))
    assert (result.n, result.missed, result.bias_m, result.rms_m, result.p95_abs_m) == (15, 0, 0, 0, 0)
    assert (result.within_1_sigma, result.within_2_sigma) == (1, 1)


def test_errors_are_signed_and_a_miss_is_no_error():
    true = [{"range_m": 10.0, "box_px": [0, 0, 9, 9]}, {"type": "car", "range_m": 20.0, "box_px": [50, 0, 59, 9]}]
    near, far = read_frame([{"range_m": 10.5, "box_px": [0, 0, 9, 9]}], true)
    assert (near.type, near.error_m) == ("unknown", 0.5)
    assert math.isnan(near.range_sigma_m)
    assert far.type == "car"
    assert math.isnan(far.error_m)


def test_without_readings_or_sigmas_the_figures_are_nan():
    nothing = accuracy([])
    assert (nothing.n, nothing.missed) == (0, 0)
    assert math.isnan(nothing.rms_m)
    missed = accuracy([Reading("car", 8.0)])
    assert (missed.n, missed.missed) == (1, 1)
    assert math.isnan(missed.bias_m)
    unsure = accuracy([Reading("car", 8.0, 8.5), Reading("car", 8.0, 7.5, 0.6)])
    assert (unsure.bias_m, unsure.rms_m, unsure.within_1_sigma) == (0, 0.5, 1)
    assert math.isnan(accuracy([Reading("car", 8.0, 8.5)]).within_2_sigma)


def test_bins_are_half_open_and_sorted():
    readings = [Reading("person", z, z + 0.1) for z in (5.0, 9.9, 10.0, 30.0)] + [Reading("car", 10.0, 10.2)]
    table = by_type_and_range(readings, [5, 10, 20])
    assert list(table) == [("car", 10, 20), ("person", 5, 10), ("person", 10, 20)]
    assert table["person", 5, 10].n == 2
    assert table["car", 10, 20].bias_m == pytest.approx(0.2)


@pytest.mark.parametrize("edges", [[], [5], [5, 5], [10, 5]])
def test_edges_must_rise(edges):
    with pytest.raises(ValueRefusedError, match="at least two rising ranges"):
        by_type_and_range([], edges)


FRAME = {"name": "a", "obstacles": [], "objects": []}


@pytest.mark.parametrize(
    ("found", "true", "message"),
    [
        ([FRAME], [FRAME, {"name": "b", "objects": []}], "frame 'b' is in the truth but not in the results"),
        ([FRAME, {"name": "b", "obstacles": []}], [FRAME], "frame 'b' is in the results but not in the truth"),
        ([FRAME, FRAME], [FRAME], "1 frames of the results repeat a name"),
        ([FRAME], [FRAME, FRAME], "1 frames of the truth repeat a name"),
        ([{"name": "a"}], [FRAME], "frame 0 of the results must have a name and obstacles"),
        ([FRAME], [{"objects": []}], "frame 0 of the truth must have a name and objects"),
    ],
)
def test_frames_that_do_not_belong_together_are_refused(found, true, message):
    with pytest.raises(ValueRefusedError, match=message):
        read_drive(found, true)


def test_a_sigma_must_be_a_number():
    box = {"box_px": [0, 0, 9, 9], "range_m": 5.0}
    with pytest.raises(ValueRefusedError, match="range_sigma_m must be numbers"):
        read_frame([{**box, "range_sigma_m": "small"}], [box])
