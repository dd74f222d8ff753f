"""Calibration boards in front of a rig: pictures of them through the real lenses, and where their points truly are.

A board is a sheet of paper, flat or bowed, with one more square (for circles two steps) of pattern or white around its
points, held in front of something that is no board.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm, qmc

from roadblock.errors import ValueRefusedError
from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project, unproject
from roadblock.sim.board_rays import CHARUCO, CHESSBOARD, CIRCLES, RIM_SQUARES, Pattern, draw, meet
from roadblock.sim.render import sub_pixel_places
from roadblock.sim.scene import paper_rig
from roadblock.sim.sensor import Light, Sensor, Side, expose, in_range, through_lens, whole
from roadblock.values.board import Board
from roadblock.values.camera import Camera, StereoRig
from roadblock.values.checks import FloatArray, locked, rigid_transform
from roadblock.values.frame import Image, StereoPair

KINDS = {"chessboard": CHESSBOARD, "charuco": CHARUCO, "circles": CIRCLES}

SHADE = 0.12

SAMPLES = 128
"""Rays of a pixel that meets an edge."""

SENSOR = Sensor(psf_px=0.45, full_well_e=7_700, read_noise=math.sqrt(2), gamma=2.2, color=False)
"""Blur of 0.45 px; noise of two grey levels at mid grey, half of its variance from reading, half from counting."""

NARROW_PX = 1.0
"""Up to this sigma the optics' blur is rendered by rays; a wider one is smooth enough to blur the pixels."""

FARTHEST = 4.0
"""Rays are spread over so many sigmas."""

ROOM = 1.2
"""A pixel meets an edge that lies within its farthest ray times this."""

TILT_RAD = math.radians(45)
"""A board is turned away from the line of sight by up to this."""

ROLL_RAD = math.radians(25)

SHARE = (0.1, 0.5)
"""Width of the board's points over the width of the image, from the farthest to the nearest view."""

TRIES = 16
"""So many places are tried for each pose."""

PULLS = np.linspace(1.0, 0.3, 15)
"""A board that a camera does not see whole is drawn towards the middle of the image, to these shares of its way."""


@dataclass(frozen=True, eq=False)
class BoardTruth:
    """Where the points of a board are in both raw images.

    Attributes
    ----------
    left_px, right_px
        (n, 2) pixels; NaN where a camera does not see the point.
    """

    left_px: FloatArray
    right_px: FloatArray


def built_rig(rng: np.random.Generator) -> StereoRig:
    """Return the paper's rig as hands build it: lenses that bend, two of a kind but not alike, turned about all axes.

    Focal lengths vary by 1 % (between x and y by 0.1 %), principal points by 12 px, k1 is about -0.12, the cameras are
    turned against each other by about half a degree about each axis and stand off by millimetres.
    """
    ideal = paper_rig()

    def camera() -> Camera:
        f = ideal.left.fx_px * rng.normal(1, 0.01)
        cx, cy = np.array([ideal.left.cx_px, ideal.left.cy_px]) + rng.normal(0, 12, 2)
        k = rng.normal([-0.12, 0.06, 0.0, 0.0, -0.01], [0.04, 0.03, 7e-4, 7e-4, 0.01])
        return Camera(ideal.left.size_px, f, f * rng.normal(1, 1e-3), cx, cy, "brown_conrady", k)

    turn, shift = np.radians(rng.normal(0, 0.5, 3)), rng.normal(0, 0.003, 3)
    return StereoRig(camera(), camera(), pose(rotation_from_rotvec(turn), ideal.T_left_right[:3, 3] + shift))


def bowed_points(board: Board, bow_m: float) -> FloatArray:
    """Return (n, 3) the points of a board whose corners lie `bow_m` behind (> 0) its middle, metres.

    The paper is a paraboloid, `z = bow_m * (r / R)^2`, with R the way from the middle to the outermost points.
    """
    points = np.array(board.points_m)
    points[:, 2] = _curvature(board, bow_m) * ((points[:, :2] - _middle(board)) ** 2).sum(-1)
    return points


def board_truth(rig: StereoRig, board: Board, T_left_board: FloatArray, bow_m: float = 0.0) -> BoardTruth:
    """Return where both cameras see the points of a (bowed) board.

    Parameters
    ----------
    rig
        The cameras.
    board
        What they see.
    T_left_board
        4x4 its pose in the left camera's frame, metres.
    bow_m
        As in `bowed_points`.
    """
    in_left = transform(T_left_board, bowed_points(board, bow_m))
    both = (rig.left, in_left), (rig.right, transform(inverse(rig.T_left_right), in_left))
    return BoardTruth(*(_inside(camera, project(camera, points)) for camera, points in both))


def render_board(
    rig: StereoRig,
    board: Board,
    T_left_board: FloatArray,
    rng: np.random.Generator,
    *,
    bow_m: float = 0.0,
    shade: float = SHADE,
    sensor: Sensor = SENSOR,
    samples: int = SAMPLES,
    index: int = 0,
    name: str = "0",
) -> StereoPair:
    """Take a picture of a board with both cameras: raw images, through their lenses.

    Parameters
    ----------
    rig, board, T_left_board, bow_m
        As in `board_truth`.
    rng
        Of the light on the board, what is behind it, and the noise. The same state gives the same bytes.
    shade
        How much brighter or darker, at most, the light gets from the middle of the board to each edge.
    sensor
        Optics and sensor; metering (`exposure` None) takes 1.
    samples
        Rays of a pixel that meets an edge. Below 64 the corners shift by more than 0.001 px.
    index, name
        As in `StereoPair`.

    Raises
    ------
    ValueRefusedError
        If the pose is none, `samples` or `shade` is outside of what it can be, or the bow is more than a tenth of the
        board's width.
    """
    whole("samples", samples, 1, 4096)
    in_range("shade", shade, 0.0, 0.5)
    rigid_transform("T_left_board", T_left_board)
    most = min(board.size_m) / 10
    if not abs(bow_m) <= most:
        raise ValueRefusedError(f"bow_m must be a tenth of the board's width at most ({most:g} m), but got {bow_m:g}")
    slope = rng.uniform(-shade, shade, 2)
    narrow_px = sensor.psf_px if sensor.psf_px <= NARROW_PX else 0.0
    rest = replace(sensor, psf_px=0.0) if narrow_px else sensor
    images = []
    sides: tuple[tuple[Side, Camera, FloatArray], ...] = (
        ("left", rig.left, T_left_board),
        ("right", rig.right, inverse(rig.T_left_right) @ T_left_board),
    )
    for side, camera, T in sides:
        light = _light(camera, board, T, _curvature(board, bow_m), slope, _behind(camera, rng), samples, narrow_px)
        images.append(_taken(light, camera, rest, side, rng))
    return StereoPair(images[0], images[1], index, name)


def calibration_poses(rig: StereoRig, board: Board, rng: np.random.Generator, count: int) -> list[FloatArray]:
    """Return poses `T_left_board` of a hand-held board as a careful person would hold it.

    Near and far (it fills 50 to 10 % of the image's width), everywhere in the images of both cameras and up to their
    edges, turned away by up to 45 degrees in all directions and rolled by up to 25. Every point, and half a square
    around it, is in both images.

    Parameters
    ----------
    rig, board
        What looks at what.
    rng
        Of the choice; the places fill the room evenly (Sobol).
    count
        How many.

    Raises
    ------
    ValueRefusedError
        If `count` is below 1, or the cameras have no room in common for the board.
    """
    whole("count", count, 1, 10_000)
    found: list[FloatArray] = []
    for tried, numbers in enumerate(_draws(rng, TRIES * count)):
        held = (_held(rig, board, numbers, pull, of_right=tried % 2 == 1) for pull in PULLS)
        T = next((T for T in held if _in_both(rig, board, T)), None)
        if T is not None:
            found.append(T)
        if len(found) == count:
            return found
    raise ValueRefusedError(
        f"both cameras must see the whole board, but that went well {len(found)} times in {TRIES * count}: "
        "take a smaller board, or cameras that look more alike"
    )


def _draws(rng: np.random.Generator, count: int) -> FloatArray:
    """Return (at least count, 6) numbers 0..1: a Sobol sequence, shifted at random."""
    return np.asarray((qmc.Sobol(6, scramble=False).random_base2((count - 1).bit_length()) + rng.random(6)) % 1)


def _held(rig: StereoRig, board: Board, numbers: FloatArray, pull: float, *, of_right: bool) -> FloatArray:
    """Return the pose of a board whose middle one of the cameras sees at a drawn place."""
    camera = rig.right if of_right else rig.left
    u, v, near, tilt, towards, roll = numbers
    ray = unproject(camera, (0.5 + pull * (np.array([u, v]) - 0.5)) * camera.size_px)
    far, close = SHARE
    share = close * (far / close) ** near
    middle = ray / ray[2] * board.size_m[0] * camera.fx_px / (share * camera.size_px[0])
    axis = 2 * math.pi * towards
    facing = rotation_from_rotvec(np.cross([0.0, 0.0, 1.0], ray))
    away = rotation_from_rotvec(TILT_RAD * math.sqrt(tilt) * np.array([math.cos(axis), math.sin(axis), 0.0]))
    R = facing @ away @ rotation_from_rotvec([0.0, 0.0, ROLL_RAD * (2 * roll - 1)])
    T = pose(R, middle - R @ [*_middle(board), 0.0])
    return rig.T_left_right @ T if of_right else T


def _in_both(rig: StereoRig, board: Board, T_left_board: FloatArray) -> bool:
    """Whether both cameras see every point and half a square around it."""
    around = np.array([[x, y, 0.0] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]) * board.square_m
    in_left = transform(T_left_board, (board.points_m[:, None] + around).reshape(-1, 3))
    both = (rig.left, in_left), (rig.right, transform(inverse(rig.T_left_right), in_left))
    return all(bool(np.isfinite(_inside(camera, project(camera, points))).all()) for camera, points in both)


def _inside(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Return pixels, NaN where they are outside of the image."""
    seen = ((pixels >= 0) & (pixels <= np.array(camera.size_px) - 1)).all(-1, keepdims=True)
    return np.where(seen, pixels, np.nan)


def _middle(board: Board) -> FloatArray:
    return np.array(board.size_m) / 2


def _curvature(board: Board, bow_m: float) -> float:
    """Return c of the surface `z = c r^2`, 1/m."""
    return float(bow_m / (_middle(board) ** 2).sum())


def _light(
    camera: Camera,
    board: Board,
    T_camera_board: FloatArray,
    curvature: float,
    slope: FloatArray,
    behind: Light,
    samples: int,
    psf_px: float,
) -> Light:
    """Return (height, width) the light that reaches a camera from a board and from what is behind it."""
    width, height = camera.size_px
    eye = inverse(T_camera_board)
    onto = np.empty((height + 2, width + 2, 2))
    meet(_rays(camera), eye, curvature, _middle(board), board.square_m, onto)
    light = np.empty((height, width), np.float32)
    places = spread_places(sub_pixel_places(height, samples), psf_px)
    bits = _marker_bits(board)
    share = board.marker_share if board.kind == "charuco" else 1.0
    reach_x, reach_y = (float(round(size / board.square_m) + 2 * RIM_SQUARES) for size in board.size_m)
    pattern = Pattern(KINDS[board.kind], board.columns, board.rows, reach_x, reach_y, bits, share)
    draw(onto, pattern, slope, places, ROOM * float(np.abs(places).max(initial=0.5)), behind, light)
    return light


def spread_places(places: FloatArray, psf_px: float) -> FloatArray:
    """Return places -0.5..0.5 in a pixel spread as a Gaussian blur of that sigma and the pixel's area do together.

    Optics blur before the pixels sample. A narrow blur of pixels afterwards depends on where in its pixel an edge lies:
    at 0.45 px edges along rows or columns were off by up to 4 grey levels.
    """
    if psf_px == 0:
        return places
    t = np.linspace(-0.5 - FARTHEST * psf_px, 0.5 + FARTHEST * psf_px, 4001)
    below = [x * norm.cdf(x / psf_px) + psf_px * norm.pdf(x / psf_px) for x in (t + 0.5, t - 0.5)]
    return np.asarray(np.interp(places + 0.5, below[0] - below[1], t))


def _behind(camera: Camera, rng: np.random.Generator) -> Light:
    """Return (height, width) a soft background."""
    coarse = rng.uniform(0.12, 0.45, (5, 8)).astype(np.float32)
    soft = cv2.resize(coarse, camera.size_px, interpolation=cv2.INTER_CUBIC)
    return np.asarray(np.maximum(soft, 0.01), np.float32)


def _taken(light: Light, camera: Camera, sensor: Sensor, side: Side, rng: np.random.Generator) -> Image:
    grey = through_lens(np.repeat(light[..., None], 3, 2), camera, sensor)
    return expose(grey, sensor, side, 1.0 if sensor.exposure is None else sensor.exposure, rng)


@lru_cache(maxsize=4)
def _rays(camera: Camera) -> FloatArray:
    """Return (height + 2, width + 2, 3) rays of the pixels and one more on each side; NaN where the lens sees none."""
    width, height = camera.size_px
    pixels = np.stack(np.meshgrid(np.arange(-1.0, width + 1), np.arange(-1.0, height + 1)), -1)
    return np.asarray(locked(unproject(camera, pixels)))


def _marker_bits(board: Board) -> NDArray[np.uint8]:
    """Return (rows + 1, columns + 1, n, n) ink of the marker in each square, 1 = black; empty for other boards."""
    if board.kind != "charuco":
        return np.zeros((0, 0, 1, 1), np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}"))
    side = dictionary.markerSize + 2
    bits = np.zeros((board.rows + 1, board.columns + 1, side, side), np.uint8)
    white = np.argwhere(np.indices(bits.shape[:2]).sum(0) % 2 == 1)
    for number, (row, column) in enumerate(white):
        bits[row, column] = cv2.aruco.generateImageMarker(dictionary, number, side) < 128
    return bits
