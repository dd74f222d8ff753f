"""All that is measured of a frame's obstacles to recognise them, in one pass over the images."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.recognize import describe_things, outline_things, trace_things
from roadblock.kernels.gray import half_images
from roadblock.kernels.reference.recognize import FIGURES, HUES, OUTLINE_FIGURES, ROWS
from roadblock.stages.recognize.color import read_colors
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, Region, road_numbers

INPUTS = FIGURES + 8
"""How many numbers the model of types looks at."""


@dataclass(frozen=True, eq=False)
class Survey:
    """What was measured of n things.

    Attributes
    ----------
    figures
        (n, FIGURES) shape, looks and surroundings: see `kernels.reference.recognize.describe_things`.
    colors
        (n, COLOR_FIGURES), see `tally_colors`; None for grey cameras.
    edges
        (n, 4) left and right edge, metres in the left camera's frame, and upper and lower row, pixels.
    contours, counts
        (n, 2 * ROWS, 2) outline in the image, pixels, and (n,) how many of its points there are.
    outlines
        (n, OUTLINE_FIGURES) rectangle on the road, see `fit_outline`.
    """

    figures: FloatArray
    colors: FloatArray | None
    edges: FloatArray
    contours: NDArray[np.int32]
    counts: NDArray[np.int32]
    outlines: FloatArray

    @property
    def inputs(self) -> FloatArray:
        """(n, INPUTS) what the model of types looks at: the figures, and a summary of the colours (0 for grey)."""
        inputs = np.zeros((len(self.figures), INPUTS))
        inputs[:, :FIGURES] = self.figures
        if self.colors is not None:
            c, summary = self.colors, inputs[:, FIGURES:]
            summary[:, 0] = c[:, 4 * 4]
            summary[:, 1] = c[:, 4 * 1] + c[:, 4 * 2]
            summary[:, 2] = c[:, 4 * 3]
            summary[:, 3] = c[:, 4 * 5] + c[:, 4 * 6]
            summary[:, 4] = c[:, 4 * HUES]
            summary[:, 5:7] = c[:, 4 * HUES + 4 :] / 25
            summary[:, 7] = 1
        return inputs


def survey(pair: RectifiedPair, found: Detections, regions: Sequence[Region] | None = None) -> Survey:
    """Measure every region.

    Parameters
    ----------
    pair
        The images.
    found
        What a detector saw in them: its ground and free space, ...
    regions
        ... and its regions, or these instead.
    """
    regions, r = found.regions if regions is None else regions, pair.rectification
    n = len(regions)
    uvd = np.concatenate([region.surface_uvd_px for region in regions]) if n else np.zeros((0, 3))
    bounds = np.zeros(n + 1, np.int32)
    np.cumsum([len(region.surface_uvd_px) for region in regions], out=bounds[1:])
    road, twin = road_numbers(found.ground), r.numbers
    half = half_images(pair)[0]
    figures, edges, outlines = np.empty((n, FIGURES)), np.empty((n, 4)), np.empty((n, OUTLINE_FIGURES))
    contours, counts = np.empty((n, 2 * ROWS, 2), np.int32), np.empty(n, np.int32)
    free = found.free_space
    describe_things(half, uvd, bounds, twin, road, np.array(r.size_px, float), free.u_px, free.range_m, figures)
    boxes = np.array([region.box_px for region in regions], np.int32).reshape(n, 4)
    trace_things(half, uvd, bounds, boxes, twin, road, edges, contours, counts)
    outline_things(uvd, bounds, twin, np.array([region.sigma_d_px for region in regions]), outlines)
    return Survey(figures, read_colors(pair, uvd, bounds), edges, contours, counts, outlines)
