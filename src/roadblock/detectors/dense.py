"""The `dense` detector: a dense matcher, then ground and segmentation on cells. Baseline and oracle."""

from collections.abc import Callable
from time import perf_counter

import numpy as np

from roadblock.config import Settings
from roadblock.stages.ground import RoadFinder
from roadblock.stages.match import match, stereo_network
from roadblock.stages.segment import find_free_space, find_regions, find_stixels, lift, to_cells
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections

REGION_CELL_PX, FREE_CELL_PX = 4, 2
"""Cells for objects; and finer ones for free space, which ends at thin and low things."""


def dense(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the detector; the road of the last frame lives as long as it does.

    Raises
    ------
    SettingsError
        If the matcher is a network, and it cannot be used.
    MissingExtraError
        If the library for networks is not installed then.
    """
    find_road = RoadFinder(settings.ground)
    if settings.match.matcher == "onnx":
        stereo_network(settings.match)  # what is wrong with it is said before the first frame

    def detect(pair: RectifiedPair) -> Detections:
        clock = [perf_counter()]
        disparity = match(pair, settings.match)
        clock.append(perf_counter())
        coarse, fine = to_cells(disparity, REGION_CELL_PX), to_cells(disparity, FREE_CELL_PX)
        ground = find_road(coarse, pair.rectification, pair.t_ns)
        clock.append(perf_counter())
        free_space = find_free_space(lift(fine, pair.rectification, ground), ground, settings.segment)
        colors = pair.left_colors(REGION_CELL_PX, REGION_CELL_PX)
        surface = lift(coarse, pair.rectification, ground)
        regions = find_regions(surface, colors, ground, settings.segment)
        stixels = find_stixels(surface, settings.segment)
        clock.append(perf_counter())
        spent_ms = (1e3 * np.diff(clock)).tolist()
        return Detections(
            regions,
            ground,
            free_space,
            matched_share=float(np.isfinite(disparity.d_px).mean()),
            timings_ms=dict(zip(("match", "ground", "segment"), spent_ms, strict=True)),
            stixels=stixels,
        )

    return detect
