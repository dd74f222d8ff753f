"""Health: can this frame's result be trusted? Says what is wrong, in words."""

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from roadblock.values.frame import Image, RectifiedPair
from roadblock.values.scene import Detections, Health


class HealthSettings(BaseModel):
    """When a frame is called degraded or failed."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    matched_share: float = Field(0.25, ge=0, le=1, description="Less of the image matched is degraded.")
    failed_share: float = Field(0.10, ge=0, le=1, description="Less than this is failed.")


def judge(found: Detections, settings: HealthSettings) -> Health:
    """Return the verdict on one frame."""
    reasons = []
    share = found.matched_share
    if share < settings.matched_share:
        reasons.append(f"little of the image could be matched: {share:.0%} (dark, covered, or the rig has moved)")
    if found.ground is None:
        reasons.append("no road found")
    reasons += found.doubts
    state = "failed" if share < settings.failed_share else "degraded" if reasons else "ok"
    return Health(state, tuple(reasons))


def looks_swapped(pair: RectifiedPair) -> bool:
    """Whether left and right were exchanged: far more of the pair matches the other way round."""
    height, width = pair.left.shape[:2]
    if height < 32 or width < 162:
        return False
    left, right = (_small_gray(image) for image in (pair.left, pair.right))
    matcher = cv2.StereoBM.create(64, 15)

    def share(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
        return float((matcher.compute(a, b) > 0).mean())

    return share(right, left) > 1.5 * share(left, right) + 0.05


def _small_gray(image: Image) -> NDArray[np.uint8]:
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) if image.ndim == 3 else image
    half = cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA).astype(np.float32)
    low, high = half.min(), half.max()
    return np.asarray((half - low) * (255 / max(high - low, 1.0)), np.uint8)
