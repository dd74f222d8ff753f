"""What the tests of the sources share: a crooked rig, small images, and files made of them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from roadblock.geometry.pose import pose
from roadblock.values.camera import Camera, StereoRig

WIDTH, HEIGHT = 97, 61


def write_image(path: Path, image: np.ndarray) -> None:
    """Write RGB or grey, whatever the path is named."""
    path.parent.mkdir(parents=True, exist_ok=True)
    bgr = image[..., ::-1] if image.ndim == 3 else image
    path.write_bytes(cv2.imencode(path.suffix, np.ascontiguousarray(bgr))[1].tobytes())


@pytest.fixture
def rig() -> StereoRig:
    a, b, c = 0.02, -0.03, 0.01
    turn, _ = cv2.Rodrigues(np.array([a, b, c]))
    left = Camera((WIDTH, HEIGHT), 103.1, 101.7, 45.2, 33.9)
    right = Camera((WIDTH, HEIGHT), 104.4, 102.8, 50.3, 28.1)
    return StereoRig(left, right, pose(turn, (0.21, 0.003, -0.004)))


@pytest.fixture
def images() -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    return [rng.integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8) for _ in range(8)]


@pytest.fixture
def rig_text(rig: StereoRig) -> str:
    """The text of a rig.yaml, written by hand."""

    def camera(c: Camera) -> str:
        return (
            f"  size_px: [{WIDTH}, {HEIGHT}]\n  fx_px: {c.fx_px}\n  fy_px: {c.fy_px}\n  cx_px: {c.cx_px}\n"
            f"  cy_px: {c.cy_px}\n  lens: pinhole\n  distortion: []\n"
        )

    rows = "".join(f"  - {row.tolist()}\n" for row in rig.T_left_right)
    return f"roadblock_rig: 1\nleft:\n{camera(rig.left)}right:\n{camera(rig.right)}T_left_right:\n{rows}"


@pytest.fixture
def folder(tmp_path: Path, images: list[np.ndarray], rig_text: str) -> Path:
    """A folder pair of three frames with its rig."""
    root = tmp_path / "drive é"
    for i in range(3):
        write_image(root / "left" / f"{i:03d}.png", images[2 * i])
        write_image(root / "right" / f"{i:03d}.png", images[2 * i + 1])
    (root / "rig.yaml").write_text(rig_text)
    return root


@pytest.fixture
def put():
    """Write an image file (`write_image`)."""
    return write_image
