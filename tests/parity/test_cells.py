"""The compiled cell kernels against their readable definitions: the same bits, on crooked and degenerate inputs."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from roadblock.kernels.compiled import cells as compiled
from roadblock.kernels.reference import cells as reference

SHAPES = [(37, 101), (2, 8), (2, 4), (3, 141), (9, 41), (40, 5), (12, 36)]
LANES = [32, 64, 128]


def picture(shape: tuple[int, int], kind: str, seed: int) -> np.ndarray:
    if kind == "flat":
        return np.full(shape, 90, np.uint8)
    top = 256 if kind == "noise" else 4
    return np.random.default_rng(seed).integers(0, top, shape).astype(np.uint8)


def filled(shape: tuple[int, ...], seed: int, top: int = 256) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, top, shape).astype(np.uint8)


def grid(shape: tuple[int, int], cell_columns: int) -> tuple[int, int]:
    return shape[0] // reference.CELL_ROWS, shape[1] // cell_columns


@pytest.mark.parametrize("kind", ["noise", "few", "flat"])
@pytest.mark.parametrize("shape", SHAPES)
def test_codes(shape: tuple[int, int], kind: str) -> None:
    image = picture(shape, kind, 1)
    fast, slow = filled(shape, 2), filled(shape, 3)
    compiled.encode(image, fast)
    reference.encode(image, slow)
    np.testing.assert_array_equal(fast, slow)
    turned = filled((shape[0], shape[1] + 32), 4), filled((shape[0], shape[1] + 32), 5)
    compiled.turn(fast, turned[0])
    reference.turn(fast, turned[1])
    np.testing.assert_array_equal(*turned)


@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("cell_columns", [2, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_costs(shape: tuple[int, int], cell_columns: int, lanes: int) -> None:
    left = filled(shape, 1)
    turned = np.zeros((shape[0], shape[1] + lanes), np.uint8)
    reference.turn(filled(shape, 2), turned)
    fast, slow = (filled((*grid(shape, cell_columns), lanes), seed) for seed in (3, 4))
    compiled.cost_cells(left, turned, cell_columns, fast)
    reference.cost_cells(left, turned, cell_columns, slow)
    np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("top", [1, 30, 256])
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("shape", SHAPES)
def test_paths(shape: tuple[int, int], lanes: int, top: int) -> None:
    costs = filled((*grid(shape, 2), lanes), 1, top)
    for p1, p2 in ((3, 14), (0, 0), (100, 127)):
        fast, slow = filled(costs.shape, 2), filled(costs.shape, 3)
        compiled.sum_paths(costs, p1, p2, fast)
        reference.sum_paths(costs, p1, p2, slow)
        np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("top", [1, 12, 256])
@pytest.mark.parametrize("shape", SHAPES)
def test_weak(shape: tuple[int, int], top: int) -> None:
    texture, margin = filled(grid(shape, 2), 1, top), filled(grid(shape, 2), 2, 30)
    assert compiled.measure_noise(texture) == reference.measure_noise(texture)
    blocks = np.zeros((2, *texture.shape), np.int16)
    for least in (0, 1, 6, 130):
        fast, slow = np.ones((2, *texture.shape), np.float32)
        compiled.drop_weak(texture, margin, least, 4, blocks[0], fast)
        reference.drop_weak(texture, margin, least, 4, blocks[1], slow)
        np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("top", [1, 7, 64])
@pytest.mark.parametrize("cell_columns", [2, 4])
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("shape", SHAPES)
def test_repeated(shape: tuple[int, int], lanes: int, cell_columns: int, top: int) -> None:
    places = grid(shape, cell_columns)
    costs, texture = filled((*places, lanes), 1, top), filled(places, 2)
    d_px = np.random.default_rng(3).uniform(1, 2 * lanes - 3, places).astype(np.float32)
    d_px[filled(places, 4, 4) == 0] = np.nan
    marks, fast, slow = filled((2, *places), 5), d_px.copy(), d_px.copy()
    compiled.drop_repeated(costs, texture, cell_columns, marks[0], fast)
    reference.drop_repeated(costs, texture, cell_columns, marks[1], slow)
    np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("top", [1, 5, 256])
@pytest.mark.parametrize("cell_columns", [2, 4])
@pytest.mark.parametrize("lanes", LANES)
@pytest.mark.parametrize("shape", SHAPES)
def test_choice(shape: tuple[int, int], lanes: int, cell_columns: int, top: int) -> None:
    costs, sums = (filled((*grid(shape, cell_columns), lanes), seed, top) for seed in (0, 1))
    prices = (3, 14)
    for tolerance, least in ((0, 0), (2, 1), (255, 200)):
        fast, slow = (np.zeros(sums.shape[:2], np.float32) for _ in range(2))
        margins = filled(sums.shape[:2], 2), filled(sums.shape[:2], 3)
        compiled.choose(costs, sums, *prices, cell_columns, tolerance, least, fast, margins[0])
        reference.choose(costs, sums, *prices, cell_columns, tolerance, least, slow, margins[1])
        np.testing.assert_array_equal(fast, slow)
        np.testing.assert_array_equal(*margins)


@pytest.mark.parametrize("kind", ["noise", "few", "flat"])
@pytest.mark.parametrize("cell_columns", [2, 4])
@pytest.mark.parametrize("shape", SHAPES)
def test_texture(shape: tuple[int, int], cell_columns: int, kind: str) -> None:
    image = picture(shape, kind, 1)
    fast, slow = (filled(grid(shape, cell_columns), seed) for seed in (2, 3))
    compiled.measure_texture(image, cell_columns, fast)
    reference.measure_texture(image, cell_columns, slow)
    np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("known", [1.0, 0.7])
@pytest.mark.parametrize("levels", [1, 2, 5])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (23, 31)])
def test_speckles(shape: tuple[int, int], levels: int, known: float) -> None:
    rng = np.random.default_rng(levels)
    fast = (3 * rng.integers(0, levels, shape)).astype(np.float32)
    fast[rng.random(shape) > known] = np.nan
    slow = fast.copy()
    labels = np.empty((2, fast.size), np.int32)
    compiled.drop_speckles(fast, 1.5, 6, labels)
    reference.drop_speckles(slow, 1.5, 6, labels)
    np.testing.assert_array_equal(fast, slow)


@pytest.mark.parametrize("known", [1.0, 0.8])
@pytest.mark.parametrize("shape", [(1, 1), (2, 9), (9, 2), (3, 3), (23, 31)])
def test_smoothing(shape: tuple[int, int], known: float) -> None:
    rng = np.random.default_rng(4)
    d_px = rng.uniform(0, 4, shape).astype(np.float32)
    d_px[rng.random(shape) > known] = np.nan
    fast, slow = np.empty_like(d_px), np.empty_like(d_px)
    compiled.smooth(d_px, 1.5, fast)
    reference.smooth(d_px, 1.5, slow)
    np.testing.assert_array_equal(fast, slow)


TARGETS = {
    "avx2": ("haswell", "+avx2,+avx,+bmi,+popcnt,+sse4.2,+sse4.1,+ssse3,+sse3"),
    "sse2": ("x86-64", "+sse2"),
}


@pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="these are targets of x86-64")
@pytest.mark.parametrize("target", TARGETS)
def test_forced_targets(target: str, tmp_path: Path) -> None:
    """The same tests in a process whose compiler takes the processor for a lesser one; a few shapes, 64 lanes."""
    cpu, features = TARGETS[target]
    forced = {
        "NUMBA_CPU_NAME": cpu,
        "NUMBA_CPU_FEATURES": features,
        "NUMBA_CACHE_DIR": str(tmp_path),
        "PYTEST_ADDOPTS": "",
    }
    chosen = "shape3 and not forced and not 32 and not 128"
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", chosen, __file__]
    done = subprocess.run(command, env=os.environ | forced, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout
    assert " passed" in done.stdout
