"""What motion says of a type: walls do not walk. And which way is forward."""

import math
from collections.abc import Sequence

from roadblock.stages.recognize.types import label, moving_odds
from roadblock.values.scene import Obstacle

SLOWEST_MPS = 1.0
"""What moves at least so fast faces where it goes."""


def weigh_motion(obstacles: Sequence[Obstacle], least_probability: float) -> tuple[Obstacle, ...]:
    """Return the obstacles with what their tracks say of their types and directions.

    Parameters
    ----------
    obstacles
        Recognised and tracked.
    least_probability
        See `RecognizeSettings`.
    """
    return tuple(_weighed(o, least_probability) if o.track and o.track.motion == "moving" else o for o in obstacles)


def _weighed(obstacle: Obstacle, least: float) -> Obstacle:
    assert obstacle.track is not None  # noqa: S101
    known: dict[str, object] = {}
    if obstacle.class_odds:
        odds = moving_odds(obstacle.class_odds)
        name, probability = label(odds, least)
        known |= {"class_odds": odds, "label": name, "probability": probability}
    v_x, v_y = obstacle.track.velocity_mps[:2]
    speed = math.hypot(v_x, v_y)
    if speed >= SLOWEST_MPS and obstacle.track.is_over_ground:
        sigma = float(max(obstacle.track.velocity_sigma_mps)) / speed
        known |= {"heading_rad": math.atan2(v_y, v_x), "heading_sigma_rad": sigma}
    return obstacle.recognized(**known)
