"""The two traditional algorithms of table 2, `mono_ground` and `mono_area`: the left image alone."""

from collections.abc import Callable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from roadblock.config import Settings
from roadblock.stages.mono.horizon import find_road, full_scale
from roadblock.stages.mono.measure import guess_kind, region_by_area, region_by_contact
from roadblock.stages.mono.outline import find_free_space, find_outlines, find_runs, look
from roadblock.stages.mono.settings import BUILDS, MonoSettings
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, FreeSpace, GroundPlane, Region

Measure = Callable[[NDArray[np.bool_], RectifiedPair, GroundPlane, MonoSettings], Region | None]


def mono_ground(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the detector that ranges by contact row and horizon (after the paper's ref. 15)."""
    return _detector(settings.mono, _by_contact)


def mono_area(settings: Settings) -> Callable[[RectifiedPair], Detections]:
    """Return the detector that ranges by the area of a known type (after the paper's ref. 16)."""
    return _detector(settings.mono, _by_area)


def _by_contact(
    mask: NDArray[np.bool_], pair: RectifiedPair, ground: GroundPlane, settings: MonoSettings
) -> Region | None:
    return region_by_contact(mask, pair.left, pair.rectification, ground, settings)


def _by_area(
    mask: NDArray[np.bool_], pair: RectifiedPair, ground: GroundPlane, settings: MonoSettings
) -> Region | None:
    kind, yaw_rad = guess_kind(mask, pair.rectification, ground, settings.kind)
    return region_by_area(mask, pair.left, pair.rectification, ground, settings, BUILDS[kind], yaw_rad)


def _detector(settings: MonoSettings, measure: Measure) -> Callable[[RectifiedPair], Detections]:
    def detect(pair: RectifiedPair) -> Detections:
        clock = [perf_counter()]
        left = full_scale(pair.left)
        ground = find_road(left, pair.rectification, settings)
        clock.append(perf_counter())
        if ground is None:
            u_px = np.arange(pair.left.shape[1], dtype=float)
            unseen = FreeSpace(u_px, np.full(len(u_px), np.nan))
            return Detections((), None, unseen, timings_ms={"horizon": 1e3 * (clock[1] - clock[0])})
        looks = look(left, pair.rectification, ground, settings)
        runs = find_runs(looks, pair.rectification, settings)
        masks = find_outlines(left, looks, runs, pair.rectification, settings)
        clock.append(perf_counter())
        measured = [measure(mask, pair, ground, settings) for mask in masks]
        clock.append(perf_counter())
        return Detections(
            tuple(region for region in measured if region is not None),
            ground,
            find_free_space(looks, runs, settings),
            timings_ms=dict(zip(("horizon", "outline", "measure"), (1e3 * np.diff(clock)).tolist(), strict=True)),
        )

    return detect
