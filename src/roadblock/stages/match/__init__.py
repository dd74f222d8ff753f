"""Match: RectifiedPair in, DisparityMap out. OpenCV's BM and SGBM, the paper's region matching, and networks."""

import numpy as np

from roadblock.kernels.gray import gray8
from roadblock.stages.match.network import stereo_network
from roadblock.stages.match.opencv import in_pixels, match_bm, match_sgbm
from roadblock.stages.match.region import match_region
from roadblock.stages.match.settings import Matcher, MatchSettings
from roadblock.stages.match.views import balance, is_blank, match_both_ways
from roadblock.values.frame import DisparityMap, RectifiedPair

__all__ = ["MATCHERS", "MatchSettings", "Matcher", "match", "match_bm", "match_region", "match_sgbm", "stereo_network"]

MATCHERS: dict[str, Matcher] = {
    "sgbm": in_pixels(match_sgbm),
    "bm": in_pixels(match_bm),
    "region": match_region,
}


def match(pair: RectifiedPair, settings: MatchSettings) -> DisparityMap:
    """Return the dense disparity map of the left image; NaN where the matcher found none it trusts."""
    left, right = gray8(pair.left, pair.right)
    if settings.matcher == "onnx":
        d_px = stereo_network(settings)(pair)
    else:
        matcher = MATCHERS[settings.matcher]
        left, right = balance(left, right)
        both = settings.both_ways
        d_px = match_both_ways(matcher, left, right, settings) if both else matcher(left, right, settings)
    d_px[is_blank(left)] = np.nan
    return DisparityMap(d_px, settings.sigma_px)
