import math

import pytest

from roadblock.errors import ValueRefusedError
from roadblock.values.decision import Decision


def test_nothing_to_do_is_said_with_its_reason() -> None:
    decision = Decision("none", "the way ahead is free")
    assert math.isnan(decision.ttc_s)
    assert (decision.deceleration_mps2, decision.curvature_per_m, decision.obstacle_id) == (0.0, 0.0, None)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"action": "fly"}, "action must be one of none, warn, brake, swerve, but got 'fly'"),
        ({"reason": ""}, "must have a reason"),
        ({"deceleration_mps2": -1.0}, "deceleration_mps2 must be >= 0"),
        ({"curvature_per_m": math.nan}, "curvature_per_m"),
    ],
)
def test_what_is_no_decision_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueRefusedError, match=message):
        Decision(**({"action": "brake", "reason": "a wall"} | change))  # type: ignore[arg-type]
