"""Decide: obstacles with tracks, free space and the vehicle's own motion in; what to do, and why, out."""

from roadblock.stages.decide.decider import Decider
from roadblock.stages.decide.settings import DecideSettings

__all__ = ["DecideSettings", "Decider"]
