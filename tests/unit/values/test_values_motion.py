import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.values.motion import EgoMotion, Track

COV = np.eye(6)


def test_a_known_motion_and_an_unknown_one() -> None:
    T = np.eye(4)
    T[0, 3] = 0.3
    known = EgoMotion(5, 9, T, COV)
    T[0, 3] = 9.0
    assert known.T_now_before is not None
    assert known.T_now_before[0, 3] == 0.3
    unknown = EgoMotion.unknown(5, 9, "dark")
    assert unknown.T_now_before is None
    assert unknown.reason == "dark"
    assert np.isnan(unknown.cov).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((9, 9, np.eye(4), COV), "t_ns must be after 9, but got 9"),
        ((5, 9, None, COV), "must be known, or unknown for a reason"),
        ((5, 9, np.eye(4), COV, "dark"), "must be known, or unknown for a reason"),
        ((5, 9, 2 * np.eye(4), COV), "orthonormal"),
        ((5, 9, np.eye(4), np.eye(3)), "cov must have shape"),
    ],
)
def test_motions_that_are_none(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(ValueRefusedError, match=message):
        EgoMotion(*arguments)


def track(motion: str) -> Track:
    zero = np.zeros(3)
    return Track(1, 0.1, 0.0, zero, np.eye(3), zero[:2], np.diag([4.0, 9.0]), True, motion, np.nan, np.nan)


def test_a_track_says_how_sure_its_velocity_is() -> None:
    assert track("moving").velocity_sigma_mps == pytest.approx([2.0, 3.0])


def test_a_track_knows_three_motions() -> None:
    with pytest.raises(ValueRefusedError, match="motion must be one of moving, standing, unknown, but got 'fast'"):
        track("fast")
