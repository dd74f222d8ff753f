"""The compiled kernels of where surfaces are against their readable definitions."""

import numpy as np
import pytest

from roadblock.geometry.pose import R_VEHICLE_CAR, pose, rotation_from_rotvec
from roadblock.kernels.compiled import locate as compiled
from roadblock.kernels.reference import locate as reference

TWIN = np.array([83.0, 41.7, 24.2, 0.31])
ROADS = [np.array([0.03, -0.998, -0.055, 1.4, 0.0011]), np.full(5, np.nan)]
MOUNTED = pose(rotation_from_rotvec([0.02, -0.05, 0.3]) @ R_VEHICLE_CAR, [1.2, 0.1, 1.5])
SIZES = [[1], [1, 2, 3, 4, 200], []]


def figures_of(sizes: list[int], road: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return what both kernels say of crooked surfaces."""
    rng = np.random.default_rng(10)
    uvd = rng.uniform((0, 0, 0.5), (83, 50, 9), (sum(sizes), 3))
    uvd[::3] = np.rint(uvd[::3] + 0.5)  # equal disparities
    bounds = np.cumsum([0, *sizes]).astype(np.int32)
    fast, slow = np.empty((len(sizes), 8)), np.empty((len(sizes), 8))
    compiled.measure_surfaces(uvd, bounds, TWIN, road, 0.1, fast)
    reference.measure_surfaces(uvd, bounds, TWIN, road, 0.1, slow)
    return fast, slow


@pytest.mark.parametrize("road", ROADS, ids=["road", "none"])
@pytest.mark.parametrize("sizes", SIZES, ids=["one", "many", "none"])
def test_surfaces(sizes: list[int], road: np.ndarray) -> None:
    np.testing.assert_allclose(*figures_of(sizes, road), rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("road", ROADS, ids=["road", "none"])
@pytest.mark.parametrize("sizes", SIZES, ids=["one", "many", "none"])
@pytest.mark.parametrize("sigma_px", [0.05, 3.0], ids=["sure", "unsure"])
def test_feet(sizes: list[int], road: np.ndarray, sigma_px: float) -> None:
    figures = figures_of(sizes, road)[0]
    fast, slow = np.empty((2, len(sizes), reference.FIGURES))
    cut = np.arange(len(sizes)) % 2.0
    for kernels, out in ((compiled, fast), (reference, slow)):
        kernels.place_feet(figures, np.full(len(sizes), sigma_px), cut, TWIN, road, MOUNTED, out)
    np.testing.assert_allclose(fast, slow, rtol=1e-10, atol=1e-10)
    if sizes == SIZES[1]:
        assert np.isnan(fast[1:, 6]).any() == (sigma_px > 1)  # what is deep stands out of little noise only
