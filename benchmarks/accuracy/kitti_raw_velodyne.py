"""Judge the first obstacle per image column of a KITTI raw recording against its Velodyne scans.

    roadblock detect ../shared/data/kitti_raw_0926 --out out/raw
    python benchmarks/accuracy/kitti_raw_velodyne.py ../shared/data/kitti_raw_0926 out/raw

Truth per column: the scan is turned into the rectified left camera, its own road plane is found (robustly, from the
scan alone), and the nearest range at which at least 3 points stand 0.3 to 2.5 m above it within 0.5 m or 5 %, in a
window of 9 pixels, is the first obstacle. Columns without one within 40 m are not counted.
"""

import json
import sys
from pathlib import Path

import numpy as np

from roadblock.geometry.pose import pose, transform
from roadblock.io.rig.native import read_native  # noqa: F401 - the rig comes from the run's record
from roadblock.io.sources import open_source
from roadblock.stages.rectify import plan_rectification
