"""Bands: the paper's own method (sections 2.2 and 2.3). A pair in, the end points of each target out; no dense map.

Each step is a function of its own, in the paper's order: `segment`, `separate`, `band_interval_px`, `project_band`,
`match_segments`, `measure_targets`; and `measure_target` for given masks of a single target.
"""

from roadblock.stages.bands.matching import band_interval_px, match_segments, project_band
from roadblock.stages.bands.measure import Ends, lies_flat, measure_target, measure_targets, merged
from roadblock.stages.bands.segmentation import Targets, find_targets, horizon_row, segment, separate
from roadblock.stages.bands.settings import BandsSettings

__all__ = [
    "BandsSettings",
    "Ends",
    "Targets",
    "band_interval_px",
    "find_targets",
    "horizon_row",
    "lies_flat",
    "match_segments",
    "measure_target",
    "measure_targets",
    "merged",
    "project_band",
    "segment",
    "separate",
]
