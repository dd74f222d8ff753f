"""RigDrift: what a turn means in pixels and metres, and what the value refuses."""

from typing import Any

import numpy as np
import pytest

from roadblock.errors import ValueRefusedError
from roadblock.values.drift import RigDrift


def drift(**change: Any) -> RigDrift:
    fields: dict[str, Any] = {
        "state": "ok",
        "reason": "",
        "turn_deg": (0.01, -0.02, 0.03),
        "cov_deg2": np.diag([0.0001, 0.0004, 0.0009]),
        "rig_cov_deg2": np.full((3, 3), np.nan),
        "epipolar_yaw_deg": np.nan,
        "epipolar_yaw_sigma_deg": np.nan,
        "frames": 30,
        "features": 211.5,
        "motions": 5,
        "f_px": 1033.0,
        "baseline_m": 0.205,
        "width_px": 1280,
    }
    return RigDrift(**(fields | change))


def test_a_turn_in_pixels() -> None:
    d = drift()
    assert d.vertical_offset_px == pytest.approx(1033 * np.tan(np.radians(0.01)), rel=1e-6)
    assert d.disparity_offset_px == pytest.approx(-0.3606, abs=1e-4)
    assert d.roll_offset_px == pytest.approx(640 * np.radians(0.03))
    assert d.yaw_deg == -0.02
    np.testing.assert_allclose(d.sigma_deg, [0.01, 0.02, 0.03])
    assert d.yaw_sigma_deg == pytest.approx(0.02)


@pytest.mark.parametrize(("yaw_deg", "sign"), [(0.01, -1), (-0.01, 1)])
def test_a_hundredth_of_a_degree_is_a_third_of_a_metre_at_20_m(yaw_deg: float, sign: int) -> None:
    assert drift(turn_deg=(0, yaw_deg, 0)).range_error_m(20.0) == pytest.approx(sign * 0.34, abs=0.01)


def test_beyond_infinity_and_unknown() -> None:
    assert drift(turn_deg=(0, -0.2, 0)).range_error_m(80.0) == np.inf
    assert np.isnan(drift(turn_deg=(0, np.nan, 0)).range_error_m(20.0))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"state": "fine"}, r"^state must be one of unknown, ok, moved, but got 'fine'"),
        ({"turn_deg": (0, 0)}, r"^turn_deg must have shape \(3,\)"),
        ({"cov_deg2": np.eye(2)}, r"^cov_deg2 must have shape \(3, 3\)"),
        ({"rig_cov_deg2": "much"}, r"^rig_cov_deg2 must be numbers"),
        ({"epipolar_yaw_deg": None}, r"^epipolar_yaw_deg must be numbers"),
        ({"f_px": 0}, r"^f_px must be "),
        ({"baseline_m": np.nan}, r"^baseline_m must be "),
        ({"frames": -1}, r"^frames must be >= 0, but got -1"),
        ({"features": np.nan}, r"^features must be finite"),
    ],
)
def test_what_is_no_drift(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueRefusedError, match=message):
        drift(**change)
