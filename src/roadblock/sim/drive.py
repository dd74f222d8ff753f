"""What a recorded drive says about itself: one JSON object of truth per frame (schema in docs/simulation.md)."""

from typing import Any

from roadblock.sim.render import Rendered
from roadblock.sim.truth import TrueObject

TRUTH_SCHEMA = 1
"""Version of the record."""


def truth_record(rendered: Rendered) -> dict[str, Any]:
    """Return the truth of one picture as plain JSON values; unknown would be None, never NaN."""
    pair, ground = rendered.pair, rendered.ground
    return {
        "schema": TRUTH_SCHEMA,
        "frame": pair.index,
        "name": pair.name,
        "t_ns": pair.t_ns,
        "objects": [_object_record(true) for true in rendered.objects],
        # Adding zero turns a level road's -0.0 into 0.0.
        "ground": {
            "height_m": ground.height_m,
            "pitch_rad": ground.pitch_rad + 0.0,
            "roll_rad": ground.roll_rad + 0.0,
        },
    }


def _object_record(true: TrueObject) -> dict[str, Any]:
    return {
        "id": true.id,
        "type": true.type,
        "color": true.color or None,
        "position_m": true.position_m.tolist(),
        "range_m": true.range_m,
        "mean_range_m": true.mean_range_m,
        "size_m": true.size_m.tolist(),
        "box_px": list(true.box_px),
        "visible_px": true.visible_px,
    }
