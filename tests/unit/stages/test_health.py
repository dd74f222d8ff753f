"""Verdicts on made-up detections, and exchanged images."""

import cv2
import numpy as np
import pytest
from pydantic import ValidationError
from stage_examples import plane

from roadblock.stages.health import HealthSettings, judge, looks_swapped
from roadblock.values.camera import Rectification
from roadblock.values.frame import RectifiedPair
from roadblock.values.scene import Detections, FreeSpace, GroundPlane

SETTINGS = HealthSettings(matched_share=0.4, failed_share=0.1)
FREE = FreeSpace(np.zeros(0), np.zeros(0))
ROAD = plane()


@pytest.mark.parametrize(
    ("share", "ground", "state", "words"),
    [
        (0.9, ROAD, "ok", []),
        (0.4, ROAD, "ok", []),
        (float("nan"), ROAD, "ok", []),
        (0.39, ROAD, "degraded", ["39%"]),
        (0.1, ROAD, "degraded", ["10%"]),
        (0.09, ROAD, "failed", ["9%"]),
        (0.0, None, "failed", ["0%", "no road"]),
        (0.9, None, "degraded", ["no road"]),
        (float("nan"), None, "degraded", ["no road"]),
    ],
)
def test_the_verdict_says_what_is_wrong(share: float, ground: GroundPlane | None, state: str, words: list[str]) -> None:
    verdict = judge(Detections((), ground, FREE, share), SETTINGS)
    assert verdict.state == state
    assert len(verdict.reasons) == len(words)
    for reason, word in zip(verdict.reasons, words, strict=True):
        assert word in reason
        assert "\n" not in reason


def test_what_a_detector_doubts_is_said() -> None:
    verdict = judge(Detections((), ROAD, FREE, 0.9, ("it is foggy",)), SETTINGS)
    assert (verdict.state, verdict.reasons) == ("degraded", ("it is foggy",))


def texture(width: int, height: int, seed: int = 0, sigma_px: float = 1.6) -> np.ndarray:
    noise = np.random.default_rng(seed).normal(size=(height, width)).astype(np.float32)
    smooth = cv2.GaussianBlur(noise, (0, 0), sigma_px)
    return np.clip(128 + smooth * (50 / smooth.std()), 0, 255).astype(np.uint8)


def pair(left: np.ndarray, right: np.ndarray) -> RectifiedPair:
    height, width = left.shape[:2]
    return RectifiedPair(left, right, Rectification(150.0, 80.3, 40.2, 0.2, (width, height)))


def street(d_px: int = 30, size: tuple[int, int] = (330, 121)) -> tuple[np.ndarray, np.ndarray]:
    wall = texture(size[0] + d_px, size[1])
    return wall[:, : size[0]].copy(), wall[:, d_px:].copy()


@pytest.mark.parametrize("d_px", [8, 30, 80])
@pytest.mark.parametrize("colour", [False, True])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_exchanged_images_are_told_from_right_ones(d_px: int, colour: bool, dtype: type) -> None:
    left, right = ((i * np.array(257 if dtype == np.uint16 else 1, dtype)).astype(dtype) for i in street(d_px))
    if colour:
        left, right = (np.repeat(i[..., None], 3, 2) for i in (left, right))
    assert looks_swapped(pair(right, left))
    assert not looks_swapped(pair(left, right))


def test_unrelated_and_even_images_are_not_called_exchanged() -> None:
    a, b = texture(330, 121, 1), texture(330, 121, 2)
    flat = np.full((121, 330), 90, np.uint8)
    for left, right in ((a, b), (b, a), (a, a), (flat, flat), (a, flat), (flat, a)):
        assert not looks_swapped(pair(left, right))


@pytest.mark.parametrize("size", [(1, 1), (161, 121), (330, 31), (2, 300)])
def test_images_too_small_to_tell_are_not_called_exchanged(size: tuple[int, int]) -> None:
    left, right = street(8, size)
    assert not looks_swapped(pair(right, left))


@pytest.mark.parametrize("bad", [{"matched_share": 1.1}, {"failed_share": -0.1}, {"matched_share": float("nan")}])
def test_settings_that_make_no_sense_are_refused(bad: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        HealthSettings.model_validate(bad)
