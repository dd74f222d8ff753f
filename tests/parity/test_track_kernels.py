"""The compiled kernels of tracking against their readable definition."""

import numpy as np
import pytest

from roadblock.geometry.pose import (
    inverse,
    pose,
    rotation_from_rotvec,
    rotvec_from_rotation,
    transform,
    vehicle_from_car,
)
from roadblock.geometry.stereo import image_from_car, image_jacobian, triangulate
from roadblock.kernels.compiled import track as compiled
from roadblock.kernels.reference import track as reference
from roadblock.values.camera import Rectification

RECTIFICATION = Rectification(705.0, 601.0, 171.0, 0.52, (1240, 374))
TWIN = np.array([705.0, 601.0, 171.0, 0.52])
T_VEHICLE_CAR = vehicle_from_car(None) @ pose(rotation_from_rotvec([0.03, -0.02, 0.01]), [0.1, -1.4, 0.3])
T_CAR_VEHICLE = inverse(T_VEHICLE_CAR)
EGO_COV = np.diag([1e-4] * 3 + [0.01] * 3) + 1e-5
COUNTS = [0, 1, 7]
WRITES = ("correct", "correct_velocity")
"""The kernels that change what they are given."""


def tracks(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Return states, some of them behind the cameras, and covariances of all magnitudes."""
    rng = np.random.default_rng(seed)
    x = np.concatenate([rng.uniform([-5, -8, 0], [50, 8, 2], (n, 3)), rng.normal(0, 4, (n, 2))], 1)
    A = rng.normal(0, 1, (n, 5, 5)) * 10 ** rng.uniform(-2, 1, (n, 1, 1))
    return x, A @ A.swapaxes(1, 2) + 1e-3 * np.eye(5)


def covariances(n: int, seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(0, 1, (n, 3, 3))
    return A @ A.swapaxes(1, 2) + 0.1 * np.eye(3)


def agree(name: str, *arguments: object) -> list[np.ndarray]:
    """Return what the definition gives, or writes, once the compiled kernel does too."""
    found = []
    for kernels in (compiled, reference):
        mine = [np.array(a) if isinstance(a, np.ndarray) else a for a in arguments]
        result = getattr(kernels, name)(*mine)
        result = [] if result is None else [result] if isinstance(result, np.ndarray) else list(result)
        found.append([*result, *mine] if name in WRITES else result)
        for a, b in zip(mine, arguments, strict=True):
            assert name in WRITES or np.array_equal(a, b, equal_nan=True)
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-9)
    return found[1]


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.01, 0.02, -0.1], [1.0, -1.5, 2.0]])
def test_carry(turn: list[float]) -> None:
    """A small motion on top of one is, in the other frame, that of its adjoint."""
    T, small = pose(rotation_from_rotvec(turn), [-0.8, 0.05, 0.01]), np.array([2, -1, 3, 4, 1, -2]) * 1e-7
    there, cov, twist = agree("carry", T, np.outer(small, small), T_VEHICLE_CAR, 0.1)
    np.testing.assert_allclose(there, T_VEHICLE_CAR @ T @ T_CAR_VEHICLE, atol=1e-12)
    np.testing.assert_allclose(0.1 * twist[:3], rotvec_from_rotation(there[:3, :3]), atol=1e-12)
    np.testing.assert_allclose(0.1 * twist[3:], there[:3, 3])
    on_top = T_VEHICLE_CAR @ pose(rotation_from_rotvec(small[:3]), small[3:]) @ T_CAR_VEHICLE
    moved = np.concatenate([rotvec_from_rotation(on_top[:3, :3]), on_top[:3, 3]])
    np.testing.assert_allclose(cov, np.outer(moved, moved), rtol=1e-4, atol=1e-20)


@pytest.mark.parametrize("dt_s", [0.1, -0.25])
@pytest.mark.parametrize("n", COUNTS)
def test_predict(n: int, dt_s: float) -> None:
    T = pose(rotation_from_rotvec([0.01, 0.02, -0.1]), [-0.8, 0.05, 0.01])
    agree("predict", *tracks(n), np.linspace(0.1, 1.0, n), dt_s, T, EGO_COV, 0.5, 0.1)


@pytest.mark.parametrize("n", COUNTS)
def test_expect(n: int) -> None:
    x, P = tracks(n)
    uvd, J, _ = agree("expect", x, P, TWIN, T_CAR_VEHICLE)
    car = transform(T_CAR_VEHICLE, x[:, :3])
    np.testing.assert_allclose(uvd, image_from_car(RECTIFICATION, car))
    np.testing.assert_allclose(J, image_jacobian(RECTIFICATION, car) @ T_CAR_VEHICLE[:3, :3])


@pytest.mark.parametrize("n", COUNTS)
def test_roughen(n: int) -> None:
    rng = np.random.default_rng(2)
    boxes = np.sort(rng.uniform(0, 300, (n, 2, 2)), 1).reshape(n, 4)
    agree("roughen", covariances(n, 3), rng.uniform(1, 60, (n, 3)), boxes, np.array([0.3, -0.2, 1.0]), TWIN)


@pytest.mark.parametrize("m", COUNTS)
@pytest.mark.parametrize("n", COUNTS)
def test_compare(n: int, m: int) -> None:
    rng = np.random.default_rng(4)
    expected, measured = rng.normal(0, 3, (n, 3)), rng.normal(0, 3, (m, 3))
    expected[n // 2 :][:1] = np.nan  # behind the cameras
    looks, sizes = rng.normal(0, 0.3, (n, 2)), rng.normal(0, 0.3, (m, 2))
    rows, columns = np.arange(n)[::-1].copy(), np.arange(m)[::2].copy()
    boxes = np.sort(rng.uniform(0, 60, (m, 2, 2)), 1).reshape(m, 4)
    arguments = expected, covariances(n, 5), looks, measured, covariances(m, 6), sizes, boxes, 16.3
    (cost,) = agree("compare", rows, columns, *arguments)
    assert cost.shape == (n, len(columns))
    if n * m == 49:
        assert 3 < (cost < reference.FAR).sum() < 25


def some(n: int) -> np.ndarray:
    """Return most rows of n, in another order."""
    return np.arange(n)[::-1][: max(1, n - 2)].copy()


@pytest.mark.parametrize("n", COUNTS)
def test_correct(n: int) -> None:
    x, P = tracks(n)
    rng = np.random.default_rng(7)
    J, expected, measured = rng.normal(0, 5, (n, 3, 3)), rng.normal(0, 2, (n, 3)), rng.normal(0, 2, (9, 3))
    rows = some(n)
    columns, grown_px2 = rng.permutation(9)[: len(rows)], rng.uniform(0, 9, (len(rows), 3))
    agree("correct", rows, columns, x, P, expected, J, measured, covariances(9, 9), grown_px2)


@pytest.mark.parametrize("n", COUNTS)
def test_correct_velocity(n: int) -> None:
    x, P = tracks(n)
    rows = some(n)
    v_mps = x[rows, 3:] + np.random.default_rng(10).normal(0, 2, (len(rows), 2))
    cov, known = np.ascontiguousarray(covariances(len(rows), 11)[:, :2, :2]) / 9, np.arange(len(rows)) != 1
    against = np.array([1, 0, 1, 1, 1, 0, 1])[:n]
    arguments = agree("correct_velocity", rows, x, P, against, np.linspace(0.1, 1.0, n), v_mps, cov, known, 0.7)
    if n == 7:
        reset, kept = (arguments[1][rows, 3:] == v_mps).all(1), (arguments[1][rows] == x[rows]).all(1)
        assert reset.any()
        assert kept.any()
        assert not (reset & kept).any()


def features(
    velocity_mps: tuple[float, float], z_m: np.ndarray, dt_s: float, noise_px: float
) -> tuple[np.ndarray, ...]:
    """Return where features are, how far off they are from where they would be if they stood, and their information."""
    rng = np.random.default_rng(12)
    n = len(z_m)
    uvd = np.stack([rng.uniform(500, 700, n), rng.uniform(100, 250, n), 705 * 0.52 / z_m], -1)
    went_m = T_CAR_VEHICLE[:3, :2] @ velocity_mps * dt_s
    off_px = uvd - image_from_car(RECTIFICATION, triangulate(RECTIFICATION, uvd) - went_m)
    return uvd, off_px + noise_px * rng.standard_normal((n, 3)), np.tile(np.eye(3) / 0.3**2, (n, 1, 1))


@pytest.mark.parametrize("n", COUNTS)
def test_feel(n: int) -> None:
    rng = np.random.default_rng(13)
    flow = features((-6.0, 1.0), rng.uniform(5, 40, 60), 0.1, 0.5)
    flow[0][3, 2], flow[1][4, 2] = -1.0, 200.0  # nowhere; and where it would be nowhere halfway
    low = rng.uniform([450, 50], [600, 150], (n, 2))
    boxes = np.concatenate([low, low + rng.uniform(5, 150, (n, 2))], 1)
    agree("feel", some(n), *flow, 0.1, boxes, rng.uniform(5, 40, n), rng.uniform(0, 10, n), TWIN, T_CAR_VEHICLE)


@pytest.mark.parametrize("kernels", [compiled, reference])
def test_features_of_what_is_fast_say_how_fast(kernels) -> None:
    """11 m/s from 8 m: over a tenth of a second, its disparity grows by 14 %."""
    flow = features((-11.0, 0.5), np.full(10, 8.0), 0.1, 0.0)
    box, range_m = np.array([[0.0, 0.0, 1240.0, 374.0]]), np.array([8.0])
    v_mps, cov, count = kernels.feel(np.zeros(1, np.intp), *flow, 0.1, box, range_m, np.zeros(1), TWIN, T_CAR_VEHICLE)
    assert count == pytest.approx(10, abs=0.1)
    np.testing.assert_allclose(v_mps, [[-11.0, 0.5]], atol=0.06)
    assert (np.sqrt(cov[0, [0, 1], [0, 1]]) >= reference.FLOOR_MPS).all()


@pytest.mark.parametrize("kernels", [compiled, reference])
@pytest.mark.parametrize(("long_m", "known"), [(0.0, False), (16.0, True)])
def test_features_along_a_long_thing_belong_to_it(kernels, long_m: float, known: bool) -> None:
    """Of a rail from 10 to 26 m, whose features begin at 15 m."""
    flow = features((0.0, 0.0), np.linspace(15, 25, 8), 0.1, 0.1)
    box = np.array([[0.0, 0.0, 1240.0, 374.0]])
    found = kernels.feel(
        np.zeros(1, np.intp), *flow, 0.1, box, np.array([10.0]), np.array([long_m]), TWIN, T_CAR_VEHICLE
    )
    assert (found[2] > 0).tolist() == [known]


@pytest.mark.parametrize("kernels", [compiled, reference])
def test_the_foot_that_carries_a_walker_does_not_say_that_it_stands(kernels) -> None:
    """Of four features on who crosses at 1.4 m/s, and six at the foot; a car as high as wide has no such foot."""
    walks, stands = (features((0.0, y), np.full(n, 10.0), 0.1, 0.0) for y, n in ((1.4, 4), (0.0, 6)))
    walks[0][:, 1], stands[0][:, 1] = 150.0, 300.0
    flow = [np.concatenate(pair) for pair in zip(walks, stands, strict=True)]
    for u0, u1, v_mps in ((500.0, 700.0, 1.4), (300.0, 900.0, 0.0)):
        box = np.array([[u0, 0.0, u1, 374.0]])
        found = kernels.feel(np.zeros(1, np.intp), *flow, 0.1, box, np.array([10.0]), np.zeros(1), TWIN, T_CAR_VEHICLE)
        assert found[2].all()
        assert found[0][0, 1] == pytest.approx(v_mps, abs=0.2)


@pytest.mark.parametrize("kernels", [compiled, reference])
def test_limbs_that_go_up_and_down_do_not_say_that_a_walker_comes(kernels) -> None:
    """What is seen of who crosses goes up by 4 cm; of things as wide as high a sign of going away."""
    flow = features((0.0, 1.4), np.full(6, 10.0), 0.1, 0.0)
    flow[0][:, 1] = np.linspace(240, 245, 6)
    for u0, u1, least_mps, most_mps in ((500.0, 700.0, 0.0, 0.1), (300.0, 900.0, 1.0, 20.0)):
        box, off_px = np.array([[u0, 0.0, u1, 374.0]]), flow[1] - [0.0, 2.5, 0.0]
        found = kernels.feel(
            np.zeros(1, np.intp), flow[0], off_px, flow[2], 0.1, box, np.array([10.0]), np.zeros(1), TWIN, T_CAR_VEHICLE
        )
        assert least_mps <= abs(found[0][0, 0]) <= most_mps


@pytest.mark.parametrize("n", COUNTS)
def test_approach(n: int) -> None:
    x, P = tracks(n)
    ahead = T_CAR_VEHICLE[2].copy()
    eye = transform(T_VEHICLE_CAR, [-0.26, 0.0, 0.0])
    twist = np.array([0.01, -0.02, 0.2, -8.0, 0.1, 0.05])
    ttc_s, _, _, places = agree("approach", x, P / 100, ahead, eye, 705 * 0.52, twist, EGO_COV)
    uvd = image_from_car(RECTIFICATION, transform(T_CAR_VEHICLE, x[:, :3]))
    further = transform(T_VEHICLE_CAR, triangulate(RECTIFICATION, uvd - [0, 0, 1e-6])) - x[:, :3]
    seen = np.isfinite(uvd[:, 0])
    shared = further[:, :, None] * further[:, None, :] * (reference.BIAS_PX / 1e-6) ** 2
    np.testing.assert_allclose(places[seen], (P[:, :3, :3] / 100 + shared)[seen], rtol=1e-2, atol=1e-4)
    if n == 7:
        assert 0 < np.isfinite(ttc_s).sum() < 7


@pytest.mark.parametrize("n", COUNTS)
def test_deviation(n: int) -> None:
    x, P = tracks(n)
    agree("deviation", np.ascontiguousarray(x[:, 3:]), np.ascontiguousarray(P[:, 3:, 3:]))


@pytest.mark.parametrize("n", COUNTS)
def test_learn(n: int) -> None:
    rng, rows = np.random.default_rng(14), some(n)
    expected, measured, columns = rng.normal(0, 2, (n, 3)), rng.normal(0, 2, (9, 3)), rng.permutation(9)[: len(rows)]
    noise = np.array([0.0, -1.39, 2.19])
    (learnt,) = agree("learn", rows, columns, noise, expected, covariances(n, 15), measured, covariances(9, 16))
    assert (learnt >= reference.NOISE_LIMITS[0]).all()
    assert (learnt <= reference.NOISE_LIMITS[1]).all()


@pytest.mark.parametrize("n", COUNTS)
def test_clearance(n: int) -> None:
    rng, columns = np.random.default_rng(17), np.arange(3.5, 400, 8.0)
    free_m = np.where(rng.random(50) < 0.4, np.nan, rng.uniform(3, 60, 50))
    free_m[-8:] = np.nan
    u_px = np.linspace(20, 390, n) if n else np.zeros(0)
    found, least = agree("clearance", u_px, np.linspace(4, 20, n), np.linspace(4, 60, n), columns, free_m)
    if n == 7:
        assert 0 < np.isfinite(found).sum() < 7
        assert (least[np.isfinite(found)] <= found[np.isfinite(found)]).all()


@pytest.mark.parametrize("kernels", [compiled, reference])
@pytest.mark.parametrize(("against", "speeds_mps"), [(0, [5.0, 0.0]), (1, [0.0, 0.0])])
def test_features_must_contradict_twice_what_they_told_before(kernels, against: int, speeds_mps: list[float]) -> None:
    """A cyclist at 5 m/s before a parked van; and a rail, whose features were never seen, that seems to go along."""
    x, P = np.array([[10.0, 0, 1, 5, 0]]), np.diag([0.1, 0.1, 0.1, 0.04, 0.04])[None].copy()
    count, row, cov = np.array([against]), np.zeros(1, np.intp), 0.04 * np.eye(2)[None]
    calm, sure = np.ones(1), np.array([True])
    for speed_mps in speeds_mps:
        kernels.correct_velocity(row, x, P, count, calm, np.zeros((1, 2)), cov, sure, 0.7)
        assert x[0, 3] == pytest.approx(speed_mps)
    kernels.correct_velocity(row, x, P, count, calm, np.zeros((1, 2)), cov, sure, 0.7)
    assert count[0] == 0


@pytest.mark.parametrize("kernels", [compiled, reference])
def test_what_does_as_expected_is_taken_to_change_less_until_it_surprises(kernels) -> None:
    x, P = np.array([[10.0, 0, 1, 5, 0]]), np.diag([0.1, 0.1, 0.1, 0.04, 0.04])[None].copy()
    calm, row, cov = np.ones(1), np.zeros(1, np.intp), 0.04 * np.eye(2)[None]

    def told(speed_mps: float) -> float:
        v_mps = np.array([[speed_mps, 0.0]])
        kernels.correct_velocity(row, x, P, np.zeros(1, np.int64), calm, v_mps, cov, np.array([True]), 0.7)
        return float(calm[0])

    assert told(5.0) == pytest.approx(0.7)
    assert [told(5.0) for _ in range(9)][-1] == pytest.approx(reference.CALMEST)
    still = [
        kernels.predict(x, P, np.array([c]), 0.1, np.eye(4), np.zeros((6, 6)), 0.5, 0.5)[1] for c in (0.0, calm[0])
    ]
    assert (still[1] - still[0])[0, 3, 3] == pytest.approx(reference.CALMEST * 0.5 * 0.1)
    assert told(6.0) == 1.0
