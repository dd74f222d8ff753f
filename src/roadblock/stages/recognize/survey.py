"""All that is measured of a frame's obstacles to recognise them, in one pass over the images."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from roadblock.kernels.compiled.recognize import describe_things, outline_things, sum_up_colors, trace_things
from roadblock.kernels.gray import half_images
from roadblock.kernels.reference.recognize import INPUTS, OUTLINE_FIGURES, ROWS
from roadblock.stages.recognize.color import read_colors
from roadblock.values.checks import FloatArray
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, Region, road_numbers


@dataclass(frozen=True, eq=False)
class Survey:
    """What was measured of n things.

    Attributes
    ----------
    inputs
        (n, INPUTS) what the model of types looks at: shape, looks and surroundings, see
        `kernels.reference.recognize.describe_things`, and a summary of the colours (0 for grey cameras).
    colors
        (n, COLOR_FIGURES), see `tally_colors`; None for grey cameras.
    edges
        (n, 4) left and right edge, metres in the left camera's frame, and upper and lower row, pixels.
    contours, counts
        (n, 2 * ROWS, 2) outline in the image, pixels, and (n,) how many of its points there are.
    outlines
        (n, OUTLINE_FIGURES) rectangle on the road, see `fit_outline`.
    """

    inputs: FloatArray
    colors: FloatArray | None
    edges: FloatArray
    contours: NDArray[np.int32]
    counts: NDArray[np.int32]
    outlines: FloatArray


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
    n, clouds = len(regions), [region.surface_uvd_px for region in regions]
    uvd = np.concatenate(clouds) if n else np.zeros((0, 3))
    bounds = np.array([0, *accumulate(map(len, clouds))], np.int32)
    bottoms, sigma_px = np.array([[region.box_px[3] for region in regions], [region.sigma_d_px for region in regions]])
    road, twin, free, half = road_numbers(found.ground), r.numbers, found.free_space, half_images(pair)[0]
    inputs, edges, outlines = np.zeros((n, INPUTS)), np.empty((n, 4)), np.empty((n, OUTLINE_FIGURES))
    contours, counts = np.empty((n, 2 * ROWS, 2), np.int32), np.empty(n, np.int32)
    describe_things(half, uvd, bounds, twin, road, np.array(r.size_px, float), free.u_px, free.range_m, inputs)
    trace_things(half, uvd, bounds, bottoms, twin, road, edges, contours, counts)
    outline_things(uvd, bounds, twin, sigma_px, outlines)
    colors = read_colors(pair, uvd, bounds)
    if colors is not None:
        sum_up_colors(colors, inputs)
    return Survey(inputs, colors, edges, contours, counts, outlines)
