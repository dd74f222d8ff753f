"""What `cells` and `fast` look at; what they find is in tests/contracts/test_detectors.py."""

import cv2
import numpy as np
import pytest

from roadblock.config import Settings, make_settings
from roadblock.detectors import make_detector
from roadblock.kernels.gray import halve
from roadblock.values.camera import Rectification
from roadblock.values.frame import Image, RectifiedPair, Window
from roadblock.values.scene import Detections

D_PX, F_PX, BASELINE_M = 12, 300.0, 0.3
WIDTH, HEIGHT = 323, 162
TWIN = Rectification(F_PX, 160.3, 80.6, BASELINE_M, (WIDTH, HEIGHT))
CELL_WIDTH_PX = {"cells": 4, "fast": 8}


def settings(name: str) -> Settings:
    return make_settings({"detector": name, "cells": {"disparities": 64}})


def wall() -> tuple[Image, Image]:
    """Return two grey pictures of an upright wall without a road, `D_PX` apart."""
    wide = np.random.default_rng(2).normal(128, 120, (HEIGHT, WIDTH + D_PX))
    picture = np.clip(cv2.GaussianBlur(wide, (0, 0), 1.5) * 2 - 128, 0, 255).astype(np.uint8)
    return picture[:, :WIDTH].copy(), picture[:, D_PX:].copy()


def is_wall(found: Detections, cell_width_px: int) -> None:
    """Check that the wall is one region, sampled in the middle of each cell, and that no road is claimed."""
    (region,) = found.regions
    u, v, d = region.surface_uvd_px.T
    assert ((u - (cell_width_px - 1) / 2) % cell_width_px == 0).all()
    assert ((v - 1.5) % 4 == 0).all()
    assert len(u) * cell_width_px * 4 > 0.7 * WIDTH * HEIGHT
    assert np.median(d) == pytest.approx(D_PX, abs=0.1)
    assert np.diff(found.free_space.u_px).tolist() == [cell_width_px] * (WIDTH // 2 // (cell_width_px // 2) - 1)
    assert found.ground is None


@pytest.mark.parametrize("name", CELL_WIDTH_PX)
def test_cells_are_as_wide_as_the_name_says(name: str) -> None:
    is_wall(make_detector(settings(name))(RectifiedPair(*wall(), TWIN)), CELL_WIDTH_PX[name])


@pytest.mark.parametrize("name", CELL_WIDTH_PX)
def test_of_a_pair_with_half_images_the_full_ones_are_never_made(name: str) -> None:
    left, right = wall()

    def middles(window: Window) -> Image:
        steps = [part.step for part in window]
        assert steps == [4, CELL_WIDTH_PX[name]] or left[window].size == 1, "the full left image was asked for"
        return left[window]

    def refuse(window: Window) -> Image:
        raise AssertionError(f"the right image was asked for: {window}")

    pair = RectifiedPair.deferred(middles, refuse, (halve(left), halve(right)), None, TWIN)
    found = make_detector(settings(name))(pair)
    is_wall(found, CELL_WIDTH_PX[name])
    full = make_detector(settings(name))(RectifiedPair(left, right, TWIN))
    np.testing.assert_array_equal(found.regions[0].surface_uvd_px, full.regions[0].surface_uvd_px)


def test_fast_keeps_the_other_settings() -> None:
    """A search that ends before the wall finds none."""
    left, right = wall()
    for strict, count in ((0, 1), (255, 0)):
        chosen = make_settings({"detector": "fast", "cells": {"disparities": 64, "margin": strict}})
        assert len(make_detector(chosen)(RectifiedPair(left, right, TWIN)).regions) == count
