"""Self-check while driving: RectifiedPairs in, RigDrift out. Says when the rig has moved; never applies anything.

Two witnesses. Vertical disparities tell pitch and roll (`epipolar`); they would tell the yaw as well if the lenses
were exactly known. Image expansion tells the yaw while driving (`expansion`), whatever the lenses are.
"""

from roadblock.stages.selfcheck.monitor import RigMonitor
from roadblock.stages.selfcheck.settings import SelfcheckSettings
from roadblock.stages.selfcheck.trust import proposed_rig
from roadblock.stages.selfcheck.verdict import RANGE_M, offset_sigmas_px, offsets_px

__all__ = ["RANGE_M", "RigMonitor", "SelfcheckSettings", "offset_sigmas_px", "offsets_px", "proposed_rig"]
