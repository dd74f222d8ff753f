"""The `cells` detector: semi-global matching on a grid of cells at half resolution. Real time; the default."""

from collections.abc import Callable
from time import perf_counter

import numpy as np

from roadblock.config import Settings
from roadblock.kernels.gray import half_images
from roadblock.stages.ground import RoadFinder
from roadblock.stages.low import LowFinder, drop_covered
from roadblock.stages.match.cells import CellMatcher
from roadblock.stages.segment import find_free_space, find_regions, find_stixels, lift
from roadblock.values.frame import DisparityMap, RectifiedPair
from roadblock.values.scene import Detections

FAST = {"cell_width_px": 8, "p1": 6, "p2": 28}
"""Cells twice as wide: half the cost."""


def cells(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the detector; its matcher's buffers and the road of the last frame live as long as it does."""
    matcher, find_road, find_low = CellMatcher(settings.cells), RoadFinder(settings.ground), LowFinder(settings.low)

    def detect(pair: RectifiedPair) -> Detections:
        clock = [perf_counter()]
        found = matcher(*half_images(pair))
        disparity = DisparityMap(found.d_px, settings.match.sigma_px, found.cell_width_px, found.cell_height_px)
        clock.append(perf_counter())
        ground = find_road(disparity, pair.rectification, pair.t_ns)
        clock.append(perf_counter())
        surface = lift(disparity, pair.rectification, ground)
        free_space = find_free_space(surface, ground, settings.segment)
        colors = pair.left_colors(disparity.cell_px, disparity.cell_height_px)
        regions = find_regions(surface, colors, ground, settings.segment)
        stixels = find_stixels(surface, settings.segment)
        doubts: tuple[str, ...] = ()
        if settings.low.enabled:
            low, doubt = find_low(pair, ground)
            regions += drop_covered(low, regions)
            doubts = (doubt,) if doubt else ()
        clock.append(perf_counter())
        spent_ms = (1e3 * np.diff(clock)).tolist()
        return Detections(
            regions,
            ground,
            free_space,
            matched_share=float(np.count_nonzero(found.d_px > 0) / max(1, found.d_px.size)),
            doubts=doubts,
            timings_ms=dict(zip(("match", "ground", "segment"), spent_ms, strict=True)),
            stixels=stixels,
        )

    return detect


def fast(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the same with wider cells."""
    return cells(settings.model_copy(update={"cells": settings.cells.model_copy(update=FAST)}))
