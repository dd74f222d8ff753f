"""Rectify: StereoRig in, Rectification out; then StereoPair in, RectifiedPair out."""

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, PositiveInt

from roadblock.errors import RigError, SettingsError, SourceError
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.kernels.gray import gray8
from roadblock.values.camera import Camera, Rectification, StereoRig
from roadblock.values.checks import LARGEST_IMAGE_PX, FloatArray
from roadblock.values.frame import Image, RectifiedPair, StereoPair

LARGEST_PX = 2**25
"""Pixels of a rectified image: beyond it the settings are wrong, and the maps would not fit into memory."""


class RectifySettings(BaseModel):
    """What the rectified cameras look like."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    f_px: float | None = Field(None, gt=0, lt=1e6, description="Focal length; chosen to fill the width if not given.")
    size_px: tuple[PositiveInt, PositiveInt] | None = Field(
        None, description="Width and height; chosen to show what both see if not given."
    )
    view_deg: float = Field(120.0, gt=0, lt=175, description="Widest horizontal view cut from a fisheye.")


def plan_rectification(rig: StereoRig, settings: RectifySettings | None = None) -> Rectification:
    """Choose the twin cameras of a rig and the maps that lead there.

    The twins show the largest upright rectangle that both cameras see, as wide in pixels as the raw image. A rig
    that is already rectified keeps its images untouched, unless the settings ask for another focal length or size.

    Raises
    ------
    RigError
        If the two cameras share no view.
    SettingsError
        If the settings make the rectified images too large, or smaller than a pixel.
    """
    settings = settings or RectifySettings()
    if rig.is_rectified and settings.f_px is None and settings.size_px is None:
        c = rig.left
        return Rectification(c.fx_px, c.cx_px, c.cy_px, rig.baseline_m, c.size_px)
    R_left, R_right = rectifying_rotations(rig.T_left_right)
    limit = np.tan(np.radians(settings.view_deg / 2))
    windows = [_seen_window(camera, R, limit) for camera, R in ((rig.left, R_left), (rig.right, R_right))]
    x0, y0 = np.maximum(windows[0][:2], windows[1][:2])
    x1, y1 = np.minimum(windows[0][2:], windows[1][2:])
    if not (x1 - x0 > 0.05 and y1 - y0 > 0.05):
        raise RigError("the two cameras share no view after rectification: check the relative rotation of the rig")
    f_px = settings.f_px or (settings.size_px or rig.left.size_px)[0] / (x1 - x0)
    width, height = settings.size_px or (round(f_px * (x1 - x0)), round(f_px * (y1 - y0)))
    if min(width, height) < 1 or max(width, height) > LARGEST_IMAGE_PX or width * height > LARGEST_PX:
        raise SettingsError(
            f"the rectified images would be {width}x{height}, but must have 1 to {LARGEST_PX} pixels and no side over "
            f"{LARGEST_IMAGE_PX}: set another rectify.f_px or rectify.size_px"
        )
    cx_px, cy_px = (width - 1) / 2 - f_px * (x0 + x1) / 2, (height - 1) / 2 - f_px * (y0 + y1) / 2
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    rays = np.stack([(u - cx_px) / f_px, (v - cy_px) / f_px, np.ones(u.shape)], -1)
    return Rectification(
        f_px=float(f_px),
        cx_px=float(cx_px),
        cy_px=float(cy_px),
        baseline_m=rig.baseline_m,
        size_px=(width, height),
        R_rect_left=R_left,
        R_rect_right=R_right,
        maps_left=_maps(rig.left, rays @ R_left),
        maps_right=_maps(rig.right, rays @ R_right),
    )


def _seen_window(camera: Camera, R_rect: FloatArray, limit: float) -> FloatArray:
    """Return (x0, y0, x1, y1), the part of the plane z = 1 of the rectified frame seen up to the image's border."""
    width, height = camera.size_px
    across, down = np.linspace(0, width - 1, 64), np.linspace(0, height - 1, 64)
    sides = {
        "left": np.stack([np.zeros(64), down], -1),
        "top": np.stack([across, np.zeros(64)], -1),
        "right": np.stack([np.full(64, width - 1.0), down], -1),
        "bottom": np.stack([across, np.full(64, height - 1.0)], -1),
    }
    bounds = []
    for (name, pixels), sign in zip(sides.items(), (-1, -1, 1, 1), strict=True):
        rays = unproject(camera, pixels) @ R_rect.T
        axis = rays[:, 0] if name in ("left", "right") else rays[:, 1]
        inside = np.isfinite(axis) & (rays[:, 2] > 0.05)
        slopes = sign * axis[inside] / rays[inside, 2]
        # A border beyond the lens's reach or behind the camera does not limit the view.
        bounds.append(sign * min([limit, *slopes]))
    return np.array(bounds)


def _maps(camera: Camera, rays: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    raw = np.nan_to_num(project(camera, rays), nan=-1e4).astype(np.float32)
    return np.ascontiguousarray(raw[..., 0]), np.ascontiguousarray(raw[..., 1])


def rectify(pair: StereoPair, rectification: Rectification, raw_size_px: tuple[int, int]) -> RectifiedPair:
    """Resample a raw pair so that its rows are epipolar lines; pixels no camera saw are black.

    Raises
    ------
    SourceError
        If the images are not of the rig's size.
    """
    height, width = pair.left.shape[:2]
    if (width, height) != raw_size_px:
        raise SourceError(
            f"frame {pair.name}: images are {width}x{height}, but the rig is for {raw_size_px[0]}x{raw_size_px[1]}; "
            "give the rig of these images"
        )
    r = rectification
    about = (r, pair.index, pair.name, pair.t_ns)
    maps_left, maps_right = r.maps_left, r.maps_right
    if maps_left is None or maps_right is None or r.half_maps is None:
        return RectifiedPair(pair.left, pair.right, *about)
    u_left, v_left, u_right, v_right = r.half_maps
    left, right = gray8(pair.left, pair.right)
    half = _sample(left, (u_left, v_left)), _sample(right, (u_right, v_right))
    return RectifiedPair.deferred(
        lambda window: _sample(pair.left, (maps_left[0][window], maps_left[1][window])),
        lambda window: _sample(pair.right, (maps_right[0][window], maps_right[1][window])),
        half,
        (left, right),
        *about,
    )


def _sample(image: Image, maps: tuple[NDArray[np.float32], NDArray[np.float32]]) -> Image:
    if maps[0].size == 0:  # which OpenCV refuses
        return np.empty((*maps[0].shape, *image.shape[2:]), image.dtype)
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR))
