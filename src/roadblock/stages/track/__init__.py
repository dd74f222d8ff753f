"""Track: Obstacles of one frame after the other in; the same Obstacles with what is known of them over time, out."""

from roadblock.stages.track.settings import TrackSettings
from roadblock.stages.track.tracker import Tracker

__all__ = ["TrackSettings", "Tracker"]
