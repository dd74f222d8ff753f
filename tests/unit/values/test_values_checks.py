"""The checks that values make of themselves."""

from typing import Any

import numpy as np
import pytest

from roadblock.errors import MissingExtraError, RoadblockError, ValueRefusedError
from roadblock.values.checks import finite, locked, positive, rigid_transform


def turned() -> np.ndarray:
    c, s = np.cos(0.3), np.sin(0.3)
    return np.array([[c, -s, 0, 0.2], [s, c, 0, -0.1], [0, 0, 1, 3.0], [0, 0, 0, 1]])


def test_locked_is_a_read_only_view_and_leaves_the_caller_s_array_alone() -> None:
    mine = np.arange(4.0)
    view = locked(mine)
    with pytest.raises(ValueError, match="read-only"):
        view[0] = 9
    mine[0] = 7
    assert view[0] == 7


def test_finite_copies_so_that_the_caller_cannot_change_the_value() -> None:
    mine = np.arange(3.0)
    value = finite("p", mine, (3,))
    mine[:] = 9
    np.testing.assert_array_equal(value, [0, 1, 2])
    assert value.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        value[0] = 1
    assert finite("p", [1, 2, np.float32(3)], (3,)).tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    "value",
    ["700", b"700", None, True, 1 + 2j, np.array(1 + 0j), {}, object(), "a\nb", [1, 2], [[1, 2], [3]], [None], 10**400],
)
def test_finite_refuses_what_is_no_number(value: Any) -> None:
    with pytest.raises(ValueRefusedError, match=r"^fx_px must ") as caught:
        finite("fx_px", value, ())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 200


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_finite_refuses_unknown_and_endless(value: float) -> None:
    with pytest.raises(ValueRefusedError, match="t must be finite, but got"):
        finite("t", [0, value, 1], (3,))


def test_finite_refuses_another_shape() -> None:
    with pytest.raises(ValueRefusedError, match=r"must have shape \(3,\), but got \(1, 3\)"):
        finite("t", [[1, 2, 3]], (3,))


def test_finite_speaks_in_one_line_about_big_arrays() -> None:
    with pytest.raises(ValueRefusedError) as caught:
        finite("t", np.full((3, 3), "a"), (3, 3))
    assert "\n" not in str(caught.value)


def test_positive() -> None:
    assert positive("f", np.float32(2.5)) == 2.5
    assert type(positive("f", 3)) is float


@pytest.mark.parametrize("value", [0, -0.0, -1])
def test_positive_refuses_nothing_and_less(value: float) -> None:
    with pytest.raises(ValueRefusedError, match="f must be > 0, but got"):
        positive("f", value)


def test_rigid_transform_takes_a_rotation_and_a_place() -> None:
    np.testing.assert_array_equal(rigid_transform("T", turned().tolist()), turned())


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({(0, 0): 1.0}, "orthonormal rotation"),
        ({(0, 0): np.cos(0.3) + 2e-6}, "orthonormal rotation"),
        ({(0, 0): 1e200, (0, 1): 1e200, (1, 0): -1e200}, "orthonormal rotation"),
        ({(2, 2): -1.0}, "mirrored"),
        ({(3, 0): 1e-9}, "end in the row 0 0 0 1"),
        ({(3, 3): 2.0}, "end in the row 0 0 0 1"),
        ({(0, 3): np.nan}, "must be finite"),
    ],
)
def test_rigid_transform_refuses(change: dict[tuple[int, int], float], words: str) -> None:
    T = turned()
    for where, number in change.items():
        T[where] = number
    with pytest.raises(ValueRefusedError, match=words):
        rigid_transform("T", T)


def test_a_missing_extra_says_how_to_install_it() -> None:
    error = MissingExtraError("reading a video", "video")
    assert isinstance(error, RoadblockError)
    assert "pip install 'roadblock[video]'" in str(error)
    assert "\n" not in str(error)
