"""`shape`: type, colour, contour and outline of every obstacle, without any network."""

import math
from collections.abc import Sequence

import numpy as np

from roadblock.geometry.pose import vehicle_from_car
from roadblock.stages.recognize.color import name_colors
from roadblock.stages.recognize.settings import RecognizeSettings
from roadblock.stages.recognize.survey import Survey, survey
from roadblock.stages.recognize.types import CLASSES, label, shipped_model
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, Obstacle, Region

VEHICLES = ("car", "truck")
LONGEST_END_M = {"car": 2.2, "truck": 3.0}
"""Front and back of a vehicle are no wider: a longer side runs along it, a shorter one across it."""
SIDES_RATIO = 1.4
"""Of anything else the longer side is its direction if it is so many times as long as the shorter one."""
HEADING_RAD, HEADING_SHARE = 0.035, 1.2
"""A direction is off by so much, and by this share of what a side's ends are off in range over its length (sigmas)."""
SUREST_RAD = 0.26
"""A direction less sure than this is none."""
CONTRAST = 0.12
"""So much better must the best rectangle explain the surface than any."""
EDGE_PX, ROW_PX, ROAD_M, WIDTH_SHARE, SIZE_SHARE = 1.6, 1.6, 0.04, 0.07, 0.025
"""Standard deviations of an edge, of the upper end, of the foot, of what is hidden of its width, and of the rest."""


class ShapeRecognizer:
    """Recognises by shape and colour.

    Parameters
    ----------
    settings
        How sure a type must be.
    T_vehicle_car
        The rig's mounting, or None.
    """

    def __init__(self, settings: RecognizeSettings, T_vehicle_car: FloatArray | None = None) -> None:
        self.settings, self.model = settings, shipped_model()
        self._T_vehicle_car = vehicle_from_car(T_vehicle_car)

    def __call__(
        self, pair: RectifiedPair, found: Detections, regions: Sequence[Region], obstacles: Sequence[Obstacle]
    ) -> tuple[Obstacle, ...]:
        """Return the obstacles with what can be said of them.

        Parameters
        ----------
        pair
            The images.
        found
            What the detector saw in them.
        regions, obstacles
            Its regions, and what was measured of each.
        """
        if not obstacles:
            return ()
        seen = survey(pair, found, regions)
        odds = self.model.probabilities(seen.inputs)
        looks = self._looks(seen, odds)
        shapes = self._shapes(seen, pair.rectification, found, obstacles, [look["label"] for look in looks])
        return tuple(o.recognized(**look, **shape) for o, look, shape in zip(obstacles, looks, shapes, strict=True))

    def _looks(self, seen: Survey, odds: FloatArray) -> list[dict[str, object]]:
        """Return type and colour of each thing."""
        colors = [None] * len(odds) if seen.colors is None else name_colors(seen.colors)
        looks: list[dict[str, object]] = []
        for row, color in zip(odds.tolist(), colors, strict=True):
            by_class = dict(zip(CLASSES, row, strict=True))
            name, probability = label(by_class, self.settings.least_probability)
            look: dict[str, object] = {"label": name, "probability": probability, "class_odds": by_class}
            if color is not None:
                look |= {"color": color.names[0], "colors": color.names, "color_lab": np.array(color.lab)}
            looks.append(look)
        return looks

    def _shapes(
        self,
        seen: Survey,
        r: Rectification,
        found: Detections,
        obstacles: Sequence[Obstacle],
        labels: Sequence[object],
    ) -> list[dict[str, object]]:
        """Return contour, size, outline and direction of each thing; nothing for a detector that does not match."""
        if np.isnan(found.matched_share):
            return [{} for _ in obstacles]
        range_m = np.array([o.range_m for o in obstacles])
        sigma_m = np.array([o.range_sigma_m for o in obstacles])
        sizes, sigmas = self._sizes(seen, r, found, obstacles, range_m, sigma_m)
        outlines, headings, heading_sigmas = self._outlines(seen, found, labels, sigma_m)
        return [
            {
                "contour_px": seen.contours[i, : seen.counts[i]],
                "size_m": sizes[i],
                "size_sigma_m": sigmas[i],
                "outline_m": outlines[i],
                "heading_rad": headings[i],
                "heading_sigma_rad": heading_sigmas[i],
            }
            for i in range(len(obstacles))
        ]

    def _sizes(
        self,
        seen: Survey,
        r: Rectification,
        found: Detections,
        obstacles: Sequence[Obstacle],
        range_m: FloatArray,
        sigma_m: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Return (n, 3) sizes and their standard deviations: edges in the image instead of edges of cells."""
        sizes = np.array([o.size_m for o in obstacles])
        per_px = range_m / r.f_px
        least, most, top, _ = seen.edges.T
        sizes[:, 0] = np.maximum(most - least, per_px)
        if found.ground is not None:
            y = (top - r.cy_px) * per_px
            x = np.array([(o.uvd_px[0] - r.cx_px) for o in obstacles]) * per_px - r.baseline_m / 2
            sizes[:, 1] = np.maximum(found.ground.height_of(np.stack([x, y, range_m], -1)), 0.05)
        relative = np.hypot(sigma_m / range_m, SIZE_SHARE)
        sigmas = np.full_like(sizes, np.nan)
        sigmas[:, 0] = np.sqrt(2 * (EDGE_PX * per_px) ** 2 + (relative**2 + WIDTH_SHARE**2) * sizes[:, 0] ** 2)
        sigmas[:, 1] = np.sqrt((ROW_PX * per_px) ** 2 + ROAD_M**2 + (relative * sizes[:, 1]) ** 2)
        sigmas[:, 2] = np.where(np.isnan(sizes[:, 2]), np.nan, np.hypot(2 * sigma_m, 0.1 * sizes[:, 2]))
        return sizes, sigmas

    def _outlines(
        self, seen: Survey, found: Detections, labels: Sequence[object], sigma_m: FloatArray
    ) -> tuple[FloatArray, list[float], list[float]]:
        """Return (n, 4, 2) rectangles on the road, vehicle frame, and their directions with sigmas; NaN unknown."""
        turn, front, back, low, high, best, mean = seen.outlines.T
        c, s = np.cos(turn), np.sin(turn)
        along, across = np.stack([front, front, back, back], -1), np.stack([low, high, high, low], -1)
        x, z = (c[:, None] * across + s[:, None] * along), (c[:, None] * along - s[:, None] * across)
        y = np.zeros_like(x)
        if found.ground is not None:
            y = found.ground.y_below(x, z)
        R, t = self._T_vehicle_car[:3, :3], self._T_vehicle_car[:3, 3]
        corners = np.stack([x, y, z], -1) @ R.T + t
        long_m, wide_m = back - front, high - low
        sigma = np.hypot(HEADING_RAD, HEADING_SHARE * sigma_m / np.maximum(np.maximum(long_m, wide_m), 0.1))
        sure = (sigma < SUREST_RAD) & (best < (1 - CONTRAST) * mean)
        sizes = zip(map(str, labels), long_m.tolist(), wide_m.tolist(), strict=True)
        angle = turn + np.pi / 2 * np.where(sure, [_direction(*size) for size in sizes], np.nan)
        forward = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], -1) @ R.T
        heading = (np.arctan2(forward[:, 1], forward[:, 0]) + np.pi / 2) % np.pi - np.pi / 2
        return corners[..., :2], heading.tolist(), np.where(np.isnan(heading), np.nan, sigma).tolist()


def _direction(name: str, long_m: float, wide_m: float) -> float:
    """Return 0 where a thing runs along its rectangle's first axis, 1 along its second, NaN where none is seen."""
    longer, shorter = max(long_m, wide_m), min(long_m, wide_m)
    if name in VEHICLES:
        if longer > LONGEST_END_M[name]:
            return 0 if long_m > wide_m else 1
        return 1 if long_m > wide_m else 0
    if longer < SIDES_RATIO * shorter:
        return math.nan
    return 0 if long_m > wide_m else 1
