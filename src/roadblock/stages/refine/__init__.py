"""Refine: RectifiedPair and Regions in; the same Regions out, their disparities measured at full resolution."""

from roadblock.stages.refine.measure import refine
from roadblock.stages.refine.settings import RefineSettings

__all__ = ["RefineSettings", "refine"]
