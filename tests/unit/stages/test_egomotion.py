"""Ego-motion of a rendered camera pair that moves before a textured wall and road, in closed form."""

import itertools

import cv2
import numpy as np
import pytest

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec
from roadblock.kernels.gray import halve
from roadblock.stages.egomotion import EgomotionSettings, Odometer
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair

TWIN = Rectification(310.0, 318.0, 121.0, 0.41, (641, 257))
STEP_NS = 100_000_000
LENGTH_SHARE = 0.03
"""Half a pixel of such a small picture (160 px of focal length) is 3 % of the range at 5 m."""
TEXTURE = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (1200, 1200)).astype(np.uint8), (0, 0), 2.5)
TEXTURE = cv2.normalize(TEXTURE, None, 0, 255, cv2.NORM_MINMAX)
PLANES = (  # a point of it, and the two directions of its texture; car frame of the beginning, metres
    ((0.0, 1.5, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
    ((-6.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((7.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, 38.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
)
"""A street of road, two walls, and an end."""


def view(T_world_car: np.ndarray, side: float) -> np.ndarray:
    """Return what one camera sees: per pixel the nearest plane's texture, 30 texels a metre."""
    width, height = TWIN.size_px
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - TWIN.cx_px) / TWIN.f_px, (v - TWIN.cy_px) / TWIN.f_px, np.ones(u.shape)], -1)
    rays = rays @ T_world_car[:3, :3].T
    eye = T_world_car[:3, :3] @ [side * TWIN.baseline_m / 2, 0, 0] + T_world_car[:3, 3]
    nearest, image = np.full(u.shape, np.inf), np.zeros(u.shape, np.uint8)
    for number, (point, across, along) in enumerate(PLANES):
        normal = np.cross(across, along)
        with np.errstate(all="ignore"):
            t = ((np.array(point) - eye) @ normal) / (rays @ normal)
            hit = eye + rays * t[..., None] - point
        x = ((hit @ across) * 30 + 300 * number + 600).astype(np.float32)
        y = ((hit @ along) * 30 + 600).astype(np.float32)
        colour = cv2.remap(TEXTURE, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        seen = (t > 0.1) & (t < nearest)
        nearest[seen], image[seen] = t[seen], colour[seen]
    return image


def pair(T_world_car: np.ndarray, t_ns: int, right: np.ndarray | None = None) -> RectifiedPair:
    other = view(T_world_car, 1.0) if right is None else right
    return RectifiedPair(view(T_world_car, -1.0), other, TWIN, t_ns=t_ns)


def path(steps: int, speed_m: float = 0.8, yaw_rad: float = 0.02) -> list[np.ndarray]:
    poses = [pose(rotation_from_rotvec([0.01, 0.0, 0.02]), [0.3, 0.0, 1.0])]
    for _ in range(steps):
        step = pose(rotation_from_rotvec([0.0, yaw_rad, 0.0]), [0.0, 0.0, speed_m])
        poses.append(poses[-1] @ step)
    return poses


@pytest.fixture(scope="module")
def drive() -> list[RectifiedPair]:
    return [pair(T, (i + 1) * STEP_NS) for i, T in enumerate(path(4))]


def test_motion_of_a_drive_in_a_curve(drive: list[RectifiedPair]) -> None:
    odometer, truth = Odometer(TWIN), inverse(pose(rotation_from_rotvec([0.0, 0.02, 0.0]), [0.0, 0.0, 0.8]))
    assert odometer(drive[0]) is None
    for before, now in itertools.pairwise(drive):
        found = odometer(now)
        assert (found.before_t_ns, found.t_ns) == (before.t_ns, now.t_ns)
        assert found.T_now_before is not None, found.reason
        off = found.T_now_before @ inverse(truth)
        assert np.linalg.norm(off[:3, 3]) < LENGTH_SHARE * 0.8
        sigma = np.sqrt(np.diag(found.cov))
        assert (np.abs(off[:3, 3]) < 4 * sigma[3:]).all()
        assert (np.abs([off[2, 1], off[0, 2], off[1, 0]]) < 4 * sigma[:3]).all()
        assert (sigma < 0.05).all()
        assert found.used > 80
        assert found.flow is not None
        assert np.median(np.abs(found.flow.off_px)) < 0.5


def test_halves_at_hand_are_used(drive: list[RectifiedPair]) -> None:
    plain, ready = Odometer(TWIN), Odometer(TWIN)
    for frame in drive[:2]:
        expected = plain(frame)
        other = RectifiedPair(frame.left, frame.right, TWIN, t_ns=frame.t_ns)
        other.half = halve(frame.left), halve(frame.right)
        found = ready(other)
    assert np.array_equal(found.T_now_before, expected.T_now_before)


def test_a_camera_that_has_turned_is_found_out() -> None:
    """All disparities are 0.7 px too small: the motion would be too long, but expansion tells."""
    shift = np.array([[1, 0, 0.7], [0, 1, 0]])
    odometer, errors = Odometer(TWIN), []
    for i, T in enumerate(path(6)):
        right = cv2.warpAffine(view(T, 1.0), shift, TWIN.size_px, borderMode=cv2.BORDER_REPLICATE)
        found = odometer(pair(T, (i + 1) * STEP_NS, right))
        if found is not None:
            errors.append(np.linalg.norm(found.T_now_before[:3, 3]) / 0.8 - 1)
    assert abs(np.mean(errors[2:])) < LENGTH_SHARE


def test_standing_still() -> None:
    T = path(0)[0]
    odometer = Odometer(TWIN)
    odometer(pair(T, STEP_NS))
    found = odometer(pair(T, 2 * STEP_NS))
    assert found.T_now_before == pytest.approx(np.eye(4), abs=1e-3)


@pytest.mark.parametrize("late_ns", [0, -STEP_NS // 2])
def test_frames_out_of_order_are_passed_over(drive: list[RectifiedPair], late_ns: int) -> None:
    odometer = Odometer(TWIN)
    odometer(drive[0])
    odometer(drive[1])
    late = RectifiedPair(drive[3].left, drive[3].right, TWIN, t_ns=drive[1].t_ns + late_ns)
    assert odometer(late) is None
    assert odometer(drive[2]).before_t_ns == drive[1].t_ns


def test_a_clock_set_back_begins_anew(drive: list[RectifiedPair]) -> None:
    odometer = Odometer(TWIN)
    odometer(RectifiedPair(drive[0].left, drive[0].right, TWIN, t_ns=10**12))
    assert odometer(drive[0]) is None
    assert odometer(drive[1]).T_now_before is not None


def reason(before: RectifiedPair, now: RectifiedPair, **settings: float) -> str:
    odometer = Odometer(TWIN, EgomotionSettings(**settings))
    assert odometer(before) is None
    found = odometer(now)
    assert found.T_now_before is None
    assert np.isnan(found.cov).all()
    assert found.flow is None
    return found.reason


def test_it_says_when_and_why_it_does_not_know(drive: list[RectifiedPair]) -> None:
    rng = np.random.default_rng(2)
    height, width = TWIN.size_px[1], TWIN.size_px[0]
    gray = np.full((height, width), 90, np.uint8)
    dark = RectifiedPair(gray, gray, TWIN, t_ns=2 * STEP_NS)
    assert reason(drive[0], dark) == "only 0 features could be followed"
    assert reason(RectifiedPair(gray, gray, TWIN, t_ns=1), drive[0]) == "only 0 features could be followed"
    noise = [rng.integers(0, 255, (height, width)).astype(np.uint8) for _ in range(2)]
    assert "features" in reason(drive[0], RectifiedPair(*noise, TWIN, t_ns=2 * STEP_NS))
    far = RectifiedPair(drive[1].left, drive[1].right, TWIN, t_ns=4 * 10**9)
    assert reason(drive[0], far) == "no frame for 3.9 s"
    assert reason(drive[0], drive[1], features=300, least_share=1.0).endswith("features agree on one motion")


def test_a_motion_that_no_car_makes_is_not_believed(drive: list[RectifiedPair]) -> None:
    odometer = Odometer(TWIN)
    odometer(drive[0])
    odometer(drive[1])
    jump = RectifiedPair(drive[3].left, drive[3].right, TWIN, t_ns=drive[1].t_ns + STEP_NS)
    assert "acceleration" in odometer(jump).reason


def test_no_motion_found(drive: list[RectifiedPair], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cv2, "solvePnPRansac", lambda *_, **__: (False, np.zeros(3), np.zeros(3), None))
    assert reason(drive[0], drive[1]) == "no motion that the features agree on"


def turned() -> tuple[Rectification, np.ndarray]:
    """Return the twin cameras of a left camera that is turned, and `T_left_car`."""
    R = rotation_from_rotvec([0.02, -0.1, 0.03])
    twin = Rectification(TWIN.f_px, TWIN.cx_px, TWIN.cy_px, TWIN.baseline_m, TWIN.size_px, R_rect_left=R)
    return twin, pose(R.T, np.zeros(3)) @ pose(np.eye(3), [TWIN.baseline_m / 2, 0, 0])


def test_a_recording_that_says_how_it_moved(drive: list[RectifiedPair]) -> None:
    """Exactly as it says, in the car frame; the features stand still."""
    twin, T_left_car = turned()
    odometer = Odometer(twin, EgomotionSettings(source="recording"))
    poses = [pose(rotation_from_rotvec([0.3, 0.2, 0.1]), [5.0, 6.0, 7.0]) @ T @ inverse(T_left_car) for T in path(2)]
    assert odometer(drive[0], poses[0]) is None
    found = odometer(drive[1], poses[1])
    truth = inverse(pose(rotation_from_rotvec([0.0, 0.02, 0.0]), [0.0, 0.0, 0.8]))
    assert found.T_now_before == pytest.approx(truth, abs=1e-9)
    assert np.sqrt(np.diag(found.cov)) == pytest.approx([2e-4] * 3 + [0.008] * 3, rel=0.01)
    assert len(found.flow.uvd_px) > 80
    assert np.median(np.abs(found.flow.off_px)) < 0.5


def test_a_recording_that_does_not_say_how_it_moved(drive: list[RectifiedPair]) -> None:
    odometer = Odometer(TWIN, EgomotionSettings(source="recording"))
    assert odometer(drive[0], np.eye(4)) is None
    assert odometer(drive[1]).reason == odometer(drive[2], np.eye(4)).reason == "the recording does not say"
    assert odometer(drive[3], np.eye(4)).T_now_before == pytest.approx(np.eye(4))
