"""`shape`: type, colour, contour and outline of every obstacle, without any network."""

import math
from collections.abc import Sequence

import numpy as np

from roadblock.geometry.pose import vehicle_from_car
from roadblock.kernels.compiled.judge import lift_contours, place_outlines, size_things
from roadblock.stages.recognize.color import call_colors
from roadblock.stages.recognize.settings import RecognizeSettings
from roadblock.stages.recognize.survey import Survey, survey
from roadblock.stages.recognize.types import CLASSES, label, shipped_model
from roadblock.values.camera import Rectification
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, Obstacle, Region, road_numbers

LONGEST_END_M = {"car": 2.2, "truck": 3.0}
"""Front and back of a vehicle are no wider: a longer side runs along it, a shorter one across it."""


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
        known = self._looks(seen)
        if not math.isnan(found.matched_share):  # else it keeps its own shapes
            self._add_shapes(known, seen, pair.rectification, found, obstacles)
        return tuple(o.recognized(**more) for o, more in zip(obstacles, known, strict=True))

    def _looks(self, seen: Survey) -> list[dict[str, object]]:
        """Return type and colour of each thing."""
        looks: list[dict[str, object]] = []
        for row in self.model.probabilities(seen.inputs).tolist():
            by_class = dict(zip(CLASSES, row, strict=True))
            name, probability = label(by_class, self.settings.least_probability)
            looks.append({"label": name, "probability": probability, "class_odds": by_class})
        if seen.colors is not None:
            for look, names, lab in zip(looks, *call_colors(seen.colors), strict=True):
                look["color"], look["colors"], look["color_lab"] = names[0], names, lab
        return looks

    def _add_shapes(
        self,
        known: Sequence[dict[str, object]],
        seen: Survey,
        r: Rectification,
        found: Detections,
        obstacles: Sequence[Obstacle],
    ) -> None:
        """Add contour, size, outline and direction of each thing to what is known of it."""
        n, road = len(obstacles), road_numbers(found.ground)
        u_px, range_m, sigma_m = np.array([(o.uvd_px[0], o.range_m, o.range_sigma_m) for o in obstacles]).T.copy()
        end_m = np.array([LONGEST_END_M.get(str(more["label"]), 0.0) for more in known])
        lift_contours(seen.contours, seen.counts, end_m, range_m, r.f_px)
        sizes, sigmas = np.array([o.size_m for o in obstacles]), np.empty((n, 3))
        size_things(seen.edges, u_px, range_m, sigma_m, r.numbers, road, sizes, sigmas)
        corners, headings = np.empty((n, 4, 2)), np.empty((n, 2))
        place_outlines(seen.outlines, end_m, sigma_m, road, self._T_vehicle_car, corners, headings)
        for more, contour, count, size, sigma, outline, (heading, heading_sigma) in zip(
            known, seen.contours, seen.counts.tolist(), sizes, sigmas, corners, headings.tolist(), strict=True
        ):
            more["contour_px"], more["outline_m"] = contour[:count], outline
            more["size_m"], more["size_sigma_m"] = size, sigma
            more["heading_rad"], more["heading_sigma_rad"] = heading, heading_sigma
