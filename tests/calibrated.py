"""A calibration made by hand for tests of what shows one: known numbers, no solver."""

import numpy as np

from roadblock.geometry.pose import inverse, pose, rotation_from_rotvec, transform
from roadblock.geometry.projection import project
from roadblock.values.board import Board
from roadblock.values.calibration import RANGES_M, Calibration, CameraFit, Coverage, LensTrial, ViewFit
from roadblock.values.camera import Camera, RigCovariance, StereoRig, rig_parameters

NAN = float("nan")
SIGMA_PX = 0.03
SCALES = {"fx_px": 0.4, "fy_px": 0.4, "cx_px": 0.3, "cy_px": 0.2}


def crooked_rig(size_px=(97, 61)):
    """Two lenses that differ, not square, off centre, turned about all axes."""
    width, height = size_px
    lens = ("brown_conrady", (-0.21, 0.06, 0.001, -0.0007, -0.01))
    left = Camera(size_px, 0.81 * width, 0.8 * width, 0.47 * width, 0.55 * height, *lens)
    right = Camera(size_px, 0.82 * width, 0.79 * width, 0.52 * width, 0.46 * height, *lens)
    names = rig_parameters(left, right)
    sigmas = [SCALES.get(name.partition(".")[2], 1e-4) for name in names]
    T = pose(rotation_from_rotvec([0.012, -0.021, 0.008]), [0.12, 0.002, -0.003])
    return StereoRig(left, right, T, covariance=RigCovariance(names, np.diag(np.square(sigmas))))


def made_up_calibration(size_px=(97, 61), views=9, verdict="usable", square_sigma_m=NAN, seed=3):
    """Views of a 5x4 board with noise of `SIGMA_PX`; the right camera misses the second, the last is left out."""
    rng = np.random.default_rng(seed)
    rig, board = crooked_rig(size_px), Board("chessboard", 5, 4, 0.03, square_sigma_m)
    count = len(board.points_m)
    fits = [_view(rng, rig, board, index, views) for index in range(views)]
    fold = np.linspace(-1, 1, count)
    ring = np.linspace(0, 0.5 * size_px[0], 6)
    alone = [
        CameraFit(camera, 1.4 * SIGMA_PX, SIGMA_PX, 0.8 * SIGMA_PX, np.stack([ring, 0.1 * SIGMA_PX * fold[:6]], -1),
                  np.stack([ring, 0 * ring], -1))
        for camera in (rig.left, rig.right)
    ]  # fmt: skip
    rim = np.hypot(*np.meshgrid(np.linspace(-1, 1, 7), np.linspace(-0.6, 0.6, 5)))
    fields = {z_m: 2e-5 * z_m**2 * (1 + rim) for z_m in RANGES_M}
    for field in fields.values():
        field[:, 0] = np.nan
    coverage = Coverage(
        left_counts=rng.integers(0, 90, (6, 8)).astype(float),
        right_counts=rng.integers(0, 90, (6, 8)).astype(float),
        distances_m=rng.uniform(0.4, 1.6, views - 1),
        tilts_deg=rng.uniform(-40, 40, (views - 1, 2)),
        missing=("The upper right corner of both images is empty.", "No board is farther than 1.6 m."),
        next_view="hold the board at the upper right, 2 m away, tilted left",
        next_gain=0.71,
    )
    trials = (
        LensTrial("brown_conrady5", 24, 0.041, 0.044, "chosen: fits unseen views best"),
        LensTrial("kannala_brandt", np.int64(22), 0.062, NAN, "fits worse"),
    )
    return Calibration(
        rig, board, 1e-4 * fold**2, np.full(count, 1e-5), tuple(fits), (alone[0], alone[1]), trials,
        rms_px=1.41 * SIGMA_PX, sigma_px=(SIGMA_PX, SIGMA_PX), epipolar_rms_px=0.05, inflation=1.2,
        range_sigma_m=fields, coverage=coverage, verdict=verdict, reasons=("The range error at 20 m is above 1 %.",),
    )  # fmt: skip


def _view(rng, rig, board, index, views):
    width, height = board.size_m
    R = rotation_from_rotvec(rng.uniform(-0.5, 0.5, 3))
    center = [rng.uniform(-0.15, 0.25), rng.uniform(-0.12, 0.12), rng.uniform(0.4, 0.9)]
    T = pose(R, center - R @ [width / 2, height / 2, 0])
    noise = rng.normal(0, SIGMA_PX, (2, len(board.points_m), 2))
    for camera, T_camera_left, residuals in zip(
        (rig.left, rig.right), (np.eye(4), inverse(rig.T_left_right)), noise, strict=True
    ):
        seen = project(camera, transform(T_camera_left @ T, board.points_m))
        residuals[~((seen >= 0) & (seen < camera.size_px)).all(-1)] = np.nan
    if index == 1:
        noise[1] = np.nan
    left_out = "its corners lie 0.37 px off: the board moved, or is another one" if index == views - 1 else ""
    if left_out:
        noise *= 9
    weights = np.where(np.isfinite(noise[..., 0]), 1.0, np.nan)
    return ViewFit(f"left{index:02d}", T, noise[0], noise[1], weights[0], weights[1], left_out)
