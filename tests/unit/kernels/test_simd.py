"""Every vector operation against numpy, on all kinds of bytes."""

from typing import Any

import numba
import numpy as np
import pytest

from roadblock.kernels import simd

LANES = [16, 32, 64, 128]


def run(operation: Any, *inputs: np.ndarray) -> np.ndarray:
    """Apply an operation of one or two registers to each row, and return its rows."""
    two = len(inputs) == 2

    @numba.njit
    def each(a: Any, b: Any, into: Any) -> None:
        for i in range(len(a)):
            if two:
                simd.store(into, i, 0, operation(simd.load(a, i, 0), simd.load(b, i, 0)))
            else:
                simd.store(into, i, 0, operation(simd.load(a, i, 0)))

    into = np.zeros_like(inputs[0])
    each(*(simd.in_registers(x[:, None]) for x in (inputs[0], inputs[-1], into)))
    return into


@pytest.fixture(params=LANES)
def pair(request: pytest.FixtureRequest) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 256, (2, 40, request.param)).astype(np.uint8)
    b[::2] = np.where(rng.random(b[::2].shape) < 0.3, a[::2], b[::2])
    a[1], b[1], b[3] = 0, 255, a[3]
    return a, b


TWO = {
    "minimum": (simd.minimum, np.minimum),
    "maximum": (simd.maximum, np.maximum),
    "add": (simd.add, lambda a, b: np.minimum(a.astype(int) + b, 255)),
    "subtract": (simd.subtract, lambda a, b: np.maximum(a.astype(int) - b, 0)),
    "both": (simd.both, np.bitwise_and),
    "either": (simd.either, np.bitwise_or),
    "differing": (simd.differing, np.bitwise_xor),
    "equal": (simd.equal, lambda a, b: 255 * (a == b)),
}


@pytest.mark.parametrize("name", TWO)
def test_operations_on_two_registers(name: str, pair: tuple[np.ndarray, np.ndarray]) -> None:
    operation, expected = TWO[name]
    np.testing.assert_array_equal(run(operation, *pair), expected(*pair))


@numba.njit
def up_3(a: Any) -> Any:
    return simd.shift_up(a, 3)


@numba.njit
def down_1(a: Any) -> Any:
    return simd.shift_down(a, 1)


@numba.njit
def least_everywhere(a: Any) -> Any:
    return simd.splat(simd.least(a), a)


ONE = {
    "count_bits": (simd.count_bits, np.bitwise_count),
    "reverse": (simd.reverse, lambda a: a[:, ::-1]),
    "lane_numbers": (simd.lane_numbers, lambda a: np.broadcast_to(np.arange(a.shape[1]), a.shape)),
    "shift_up": (up_3, lambda a: np.pad(a, ((0, 0), (3, 0)), constant_values=255)[:, :-3]),
    "shift_down": (down_1, lambda a: np.pad(a, ((0, 0), (0, 1)), constant_values=255)[:, 1:]),
    "least": (least_everywhere, lambda a: np.broadcast_to(a.min(1, keepdims=True), a.shape)),
}


@pytest.mark.parametrize("name", ONE)
def test_operations_on_one_register(name: str, pair: tuple[np.ndarray, np.ndarray]) -> None:
    operation, expected = ONE[name]
    np.testing.assert_array_equal(run(operation, pair[0]), expected(pair[0]))


@pytest.mark.parametrize("lanes", LANES)
def test_the_first_equal_lane(lanes: int) -> None:
    @numba.njit
    def first(a: Any, byte: Any) -> Any:
        register = simd.load(a, 0, 0)
        return simd.first_equal(register, simd.splat(byte, register))

    numbers = np.arange(lanes, dtype=np.uint8)[None, None]
    registers = simd.in_registers(numbers)
    assert [first(registers, np.uint8(k)) for k in (0, 5, lanes - 1, 200)] == [0, 5, lanes - 1, lanes]
    numbers[0, 0, 3:] = 3
    assert first(registers, np.uint8(3)) == 3


def test_select_takes_a_where_the_mask_is_set() -> None:
    @numba.njit
    def pick(a: Any, b: Any, into: Any) -> None:
        x, y = simd.load(a, 0, 0), simd.load(b, 0, 0)
        simd.store(into, 0, 0, simd.select(simd.equal(x, y), simd.splat(7, x), y))

    a, b, into = np.arange(16, dtype=np.uint8), np.full(16, 4, np.uint8), np.zeros(16, np.uint8)
    pick(*(simd.in_registers(x[None, None]) for x in (a, b, into)))
    assert into.tolist() == [4, 4, 4, 4, 7, *[4] * 11]


def test_bytes_are_read_and_written_from_anywhere() -> None:
    @numba.njit
    def copy(image: Any, into: Any) -> None:
        lanes = simd.load_bytes(image, 1, 3, simd.zeros(16))
        simd.store(into, 2, 1, lanes)
        simd.store(into, 0, 5, simd.last(lanes, 2))

    image = np.arange(60, dtype=np.uint8).reshape(2, 30)
    into = np.zeros((3, 20), np.uint8)
    copy(image, into)
    expected = np.zeros_like(into)
    expected[2, 1:17], expected[0, 5:7] = image[1, 3:19], image[1, 17:19]
    np.testing.assert_array_equal(into, expected)


@pytest.mark.parametrize(
    "operation", ["load", "count_bits", "least", "reverse", "splat", "store", "load_bytes", "reals_of"]
)
def test_other_types_are_refused(operation: str) -> None:
    function = getattr(simd, operation)
    n = {"load": 3, "splat": 2, "store": 4, "load_bytes": 4}.get(operation, 1)
    wrong = {
        1: numba.njit(lambda x: function(x)),
        2: numba.njit(lambda x: function(x, x)),
        3: numba.njit(lambda x: function(x, x, x)),
        4: numba.njit(lambda x: function(x, x, x, x)),
    }[n]
    with pytest.raises(numba.TypingError):
        wrong(1.5)


@pytest.mark.parametrize(
    "operation", ["minimum", "both", "equal", "first_equal", "shift_up", "last", "zeros", "select"]
)
def test_counts_must_be_literal_and_registers_alike(operation: str) -> None:
    function = getattr(simd, operation)
    wrong = numba.njit((lambda x: function(x)) if operation == "zeros" else (lambda x: function(x, x)))
    if operation == "select":
        wrong = numba.njit(lambda x: function(x, x, x))
    with pytest.raises(numba.TypingError):
        wrong(1.5)
