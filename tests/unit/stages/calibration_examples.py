"""Synthetic calibration views with exact truth: a crooked rig, a board held at random, Gaussian corner noise."""

import numpy as np

from roadblock.geometry.pose import pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project
from roadblock.geometry.stereo import right_from_left
from roadblock.values.board import Board, BoardView, Sighting
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray

LENSES = {
    "brown_conrady5": ("brown_conrady", (-0.12, 0.06, 0.0011, -0.0007, -0.01), (-0.10, 0.04, -0.0006, 0.0009, 0.015)),
    "brown_conrady8": (
        "brown_conrady",
        (0.4, 0.05, 0.0011, -0.0007, 0.01, 0.8, 0.25, 0.02),
        (0.5, 0.04, -0.0006, 0.0009, 0.02, 0.9, 0.2, 0.03),
    ),
    "kannala_brandt": ("kannala_brandt", (0.05, -0.02, 0.008, -0.002), (0.04, -0.01, 0.005, -0.001)),
}
"""Lens of both cameras -> model, left and right coefficients."""

FLAT = Board("chessboard", 9, 6, 0.025)


def example_rig(lens: str = "brown_conrady5", *, size_px: tuple[int, int] = (1280, 720), fov: float = 1.0) -> StereoRig:
    """Return a rig as wide as the paper's, but crooked: cameras that differ, turned about all axes.

    `fov` scales the width of view on the plane x/z: 1 sees as the paper's cameras do (f = 0.807 widths).
    """
    width, height = size_px
    model, left_k, right_k = LENSES[lens]
    f = 0.807 * width / fov
    left = Camera(size_px, f, 1.003 * f, 0.51 * width - 0.5, 0.483 * height - 0.5, model, left_k)
    right = Camera(size_px, 0.994 * f, 0.998 * f, 0.492 * width - 0.5, 0.515 * height - 0.5, model, right_k)
    T_left_right = pose(rotation_from_rotvec([0.006, -0.021, 0.011]), [0.2047, 0.0031, -0.0049])
    return StereoRig(left, right, T_left_right)


def bow(board: Board, bow_m: float) -> FloatArray:
    """Return (n,) heights of a board bent to a bowl, `bow_m` from its middle to its corners, with the plane taken off.

    Bent more along x than along y, as a leaning board is.
    """
    x, y = (board.points_m[:, :2] - board.points_m[:, :2].mean(0)).T / (np.array(board.size_m)[:, None] / 2)
    heights = bow_m * (0.7 * x * x + 0.3 * y * y)
    plane = np.stack([np.ones_like(x), x, y], -1)
    return heights - plane @ np.linalg.lstsq(plane, heights, rcond=None)[0]


def example_pose(rig: StereoRig, board: Board, rng: np.random.Generator, distance_m: tuple[float, float]) -> FloatArray:
    """Draw `T_left_board`: its middle anywhere in the left image, tilted up to 45 deg, its front to the cameras."""
    width, height = rig.left.size_px
    u, v = rng.uniform((0.1 * width, 0.1 * height), (0.95 * width, 0.9 * height))
    z = rng.uniform(*distance_m)
    middle = z * np.array([(u - rig.left.cx_px) / rig.left.fx_px, (v - rig.left.cy_px) / rig.left.fy_px, 1.0])
    tilt = rotation_from_rotvec(np.radians([*rng.uniform(-40, 40, 2), 0.0]))
    R = tilt @ rotation_from_rotvec([0.0, 0.0, np.radians(rng.uniform(-25, 25))])
    return pose(R, middle - R @ board.points_m.mean(0))


def example_sighting(
    camera: Camera, points: FloatArray, rng: np.random.Generator, noise_px: float, partly: bool, told_px: float
) -> Sighting | None:
    """See camera-frame points with noise; None if fewer than 6, or not all where `partly` is off, are in the image."""
    pixels = project(camera, points) + rng.normal(0, noise_px, (len(points), 2))
    with np.errstate(invalid="ignore"):
        inside = ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1.0)).all(-1)
    if inside.sum() < 6 or not (partly or inside.all()):
        return None
    ids = np.flatnonzero(inside)
    return Sighting(ids, pixels[ids], np.full(len(ids), told_px))


def example_views(
    rig: StereoRig,
    board: Board,
    rng: np.random.Generator,
    count: int,
    noise_px: float,
    bow_m: float = 0.0,
    *,
    distance_m: tuple[float, float] = (0.5, 1.4),
    partly: bool = True,
    told_px: float | None = None,
) -> tuple[BoardView, ...]:
    """Draw views of a board held at random, each seen by at least one camera.

    Parameters
    ----------
    rig, board
        The truth.
    rng
        Draws poses and noise.
    count
        How many views.
    noise_px
        Standard deviation of each coordinate of a corner.
    bow_m
        The board's true shape, see `bow`.
    distance_m
        From the left camera, least and most.
    partly
        Whether a camera that has only a part of the board in its image sees that part; else it sees nothing.
    told_px
        What the sightings say that their noise is; by default the truth.
    """
    points = board.points_m + bow(board, bow_m)[:, None] * (0.0, 0.0, 1.0)
    told = told_px or noise_px or 0.1
    views: list[BoardView] = []
    while len(views) < count:
        in_left = transform(example_pose(rig, board, rng, distance_m), points)
        left = example_sighting(rig.left, in_left, rng, noise_px, partly, told)
        right = example_sighting(rig.right, right_from_left(rig, in_left), rng, noise_px, partly, told)
        if left is not None or right is not None:
            views.append(BoardView(f"{len(views):02d}", left, right))
    return tuple(views)
