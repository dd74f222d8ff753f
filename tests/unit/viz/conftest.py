"""The rig and the image most pictures are drawn on."""

import numpy as np
import pytest
from drawn import rig_of

from roadblock.values.camera import Rectification


@pytest.fixture
def rig() -> Rectification:
    return rig_of(641, 363)


@pytest.fixture
def image(rig) -> np.ndarray:
    width, height = rig.size_px
    return np.random.default_rng(3).integers(40, 200, (height, width, 3), dtype=np.uint8)
