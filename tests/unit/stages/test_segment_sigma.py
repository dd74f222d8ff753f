import numpy as np
import pytest

from roadblock.stages.segment import SegmentSettings, find_regions, lift
from roadblock.values.camera import Rectification
from roadblock.values.frame import DisparityMap

RECTIFICATION = Rectification(300.0, 51.3, 27.6, 0.3, (240, 160))
SETTINGS = SegmentSettings(area_px=16, link_px=8)


def sigma_px(d_px, unknown_px=0.7):
    """The stated sigma of the one region in a map of cells."""
    surface = lift(DisparityMap(d_px.astype(np.float32), unknown_px, 4), RECTIFICATION, None)
    (region,) = find_regions(surface, None, None, SETTINGS)
    return region.sigma_d_px


def a_wall(noise_px, seed=0, slope=0.0):
    d_px = np.full((40, 60), np.nan)
    v, u = np.mgrid[:30, :40]
    d_px[5:35, 8:48] = 9 + slope * (u + 0.5 * v) + np.random.default_rng(seed).normal(0, noise_px, u.shape)
    return d_px


@pytest.mark.parametrize("noise_px", [0.1, 0.4, 0.8])
@pytest.mark.parametrize("slope", [0.0, 0.05])
def test_the_scatter_of_cells_is_found_on_any_plane(noise_px, slope):
    expected = np.hypot(SETTINGS.locking_px, noise_px)
    assert sigma_px(a_wall(noise_px, slope=slope)) == pytest.approx(expected, rel=0.08)


def test_without_scatter_the_locking_stays():
    assert sigma_px(a_wall(0.0)) == pytest.approx(SETTINGS.locking_px)


def test_a_step_is_no_scatter():
    d_px = a_wall(0.0)
    d_px[:, 30:] += 3
    assert sigma_px(d_px) == pytest.approx(SETTINGS.locking_px)


def test_a_region_too_thin_to_show_its_scatter_takes_the_matcher_s():
    d_px = np.full((40, 60), np.nan)
    d_px[10:12, 20:22] = 9
    assert sigma_px(d_px) == pytest.approx(np.hypot(SETTINGS.locking_px, 0.7))
