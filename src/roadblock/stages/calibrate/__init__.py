"""Calibrate: pictures of a board in, a rig with a known range error out (the paper's sections 2.1 and 3.2)."""

from roadblock.stages.calibrate.board import parse_board
from roadblock.stages.calibrate.calibrate import calibrate
from roadblock.stages.calibrate.detect import find_board
from roadblock.stages.calibrate.settings import CalibrateSettings

__all__ = ["CalibrateSettings", "calibrate", "find_board", "parse_board"]
