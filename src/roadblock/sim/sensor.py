"""What a camera makes of the light that reaches it: lens, exposure, noise, encoding. Linear light in, image out.

Light is linear and without unit: 1 is what level white ground sends back in full sun. Every effect is off by default;
all that is random comes from a generator the caller hands in. Grey levels are those of 8 bit, whatever the depth.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ive

from roadblock.errors import ValueRefusedError
from roadblock.geometry.projection import unproject
from roadblock.values.camera import Camera
from roadblock.values.checks import FloatArray, finite, locked
from roadblock.values.frame import Image

Light = NDArray[np.float32]
"""(height, width, 3) linear RGB, or (height, width) luminance; 1 = level white ground in full sun."""

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")

LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Shares of linear red, green and blue (Rec. 709 primaries)."""

MIDDLE_GREY = 0.18
"""What metering brings the geometric mean of the luminance to."""

METER_RANGE = (1 / 8, 400.0)
"""Smallest and largest exposure that metering chooses."""

LONGEST_EXPOSURE = 8.0
"""Up to here a longer shutter gathers more light; beyond, only the gain rises and the noise with it."""

WIDEST_PSF_PX = 50.0


@dataclass(frozen=True)
class Sensor:
    """A pair of cameras, apart from their geometry.

    Attributes
    ----------
    exposure
        Factor on the light, for both cameras; 1 = level white ground in full sun just fills the sensor. None = metered
        (see `meter`).
    psf_px
        Standard deviation of the Gaussian point spread, the same for both cameras; 0 = none.
    vignetting
        Power of the cosine law by which light falls off with the angle from the axis; 0 = none, 4 = natural.
    full_well_e
        Electrons of a full pixel: the fewer, the more shot noise; infinity = none.
    read_noise
        Standard deviation of what read-out adds, grey levels of the encoded image.
    gain
        Factors (left, right) on what the sensors caught.
    offset
        Grey levels (left, right) added to the encoded image.
    gamma
        Of the encoding, `level = light ** (1 / gamma)`; 1 = linear.
    bits
        8 or 16.
    color
        RGB, or else grey.
    right_delay_s
        How much later than the left camera the right one exposes.
    rolling_shutter_s
        From the exposure of the first row to that of the last; the middle row's moment is the frame's.

    Raises
    ------
    ValueRefusedError
        If a number is not finite (but `full_well_e`) or outside of what it can be.
    """

    exposure: float | None = 1.0
    psf_px: float = 0.0
    vignetting: float = 0.0
    full_well_e: float = math.inf
    read_noise: float = 0.0
    gain: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    gamma: float = 2.2
    bits: int = 8
    color: bool = True
    right_delay_s: float = 0.0
    rolling_shutter_s: float = 0.0

    def __post_init__(self) -> None:
        ranges = {
            "exposure": (1e-6, 1e6),
            "psf_px": (0.0, WIDEST_PSF_PX),
            "vignetting": (0.0, 16.0),
            "full_well_e": (1.0, math.inf),
            "read_noise": (0.0, 255.0),
            "gamma": (0.1, 10.0),
            "right_delay_s": (-1.0, 1.0),
            "rolling_shutter_s": (-1.0, 1.0),
        }
        for name, (low, high) in ranges.items():
            if getattr(self, name) is not None:
                in_range(name, getattr(self, name), low, high)
        for name, (low, high) in {"gain": (1e-3, 1e3), "offset": (-255.0, 255.0)}.items():
            both = finite(name, getattr(self, name), (2,))
            object.__setattr__(self, name, (float(both[0]), float(both[1])))
            for value in both:
                in_range(name, float(value), low, high)
        if self.bits not in (8, 16):
            raise ValueRefusedError(f"bits must be 8 or 16, but got {self.bits}")


def in_range(name: str, value: float, low: float, high: float) -> None:
    """Check that a number lies in low..high, both included.

    Raises
    ------
    ValueRefusedError
        If it does not, or is none.
    """
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ValueRefusedError(f"{name} must be a number from {low:g} to {high:g}, but got {value!r:.40}")


def whole(name: str, value: int, low: int, high: int) -> None:
    """Check that a number is whole and lies in low..high, both included.

    Raises
    ------
    ValueRefusedError
        If it does not, or is none.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
        raise ValueRefusedError(f"{name} must be a whole number from {low} to {high}, but got {value!r:.40}")


def luminance(light: Light) -> Light:
    """Return the (height, width) luminance of linear RGB."""
    return np.asarray(light @ LUMINANCE, np.float32)


def meter(light: Light) -> float:
    """Return the exposure that brings the geometric mean of the luminance to `MIDDLE_GREY`, within `METER_RANGE`."""
    seen = np.maximum(luminance(light) if light.ndim == 3 else light, 1e-6)
    low, high = METER_RANGE
    return min(high, max(low, MIDDLE_GREY / math.exp(float(np.log(seen).mean(dtype=np.float64)))))


def blur(light: Light, sigma_px: float) -> Light:
    """Return light spread by a Gaussian: separable, symmetric, keeping all energy (mirrored at the borders).

    Its weights are those of the discrete Gaussian (Lindeberg 1990), `exp(-s) I_n(s)` with `s = sigma^2`, whose variance
    is exactly sigma^2 at any sigma; a sampled Gaussian of 0.45 px would be as narrow as 0.38 px.
    """
    if sigma_px == 0:
        return light
    reach = math.ceil(8 * sigma_px + 3)
    weights = ive(np.abs(np.arange(-reach, reach + 1)), sigma_px**2)
    weights = weights / weights.sum()
    return np.asarray(cv2.sepFilter2D(light, -1, weights, weights, borderType=cv2.BORDER_REFLECT), np.float32)


@lru_cache(maxsize=4)
def vignette(camera: Camera, power: float) -> Light:
    """Return the (height, width) share of the light that the lens lets through: `cos(angle from the axis) ** power`.

    Read-only. Where the lens model sees nothing it is 0.
    """
    width, height = camera.size_px
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1)
    cosine = np.nan_to_num(unproject(camera, pixels)[..., 2], nan=0.0)
    return locked((np.maximum(cosine, 0.0) ** power).astype(np.float32))


def through_lens(light: Light, camera: Camera, sensor: Sensor) -> Light:
    """Return the light that reaches the sensor behind a lens: dimmer towards the corners, and spread."""
    if sensor.vignetting > 0:
        light = light * vignette(camera, sensor.vignetting)[..., None]
    return blur(light, sensor.psf_px)


def expose(light: Light, sensor: Sensor, side: Side, exposure: float, rng: np.random.Generator) -> Image:
    """Return the image of the light on a sensor.

    Parameters
    ----------
    light
        (height, width, 3), behind the lens.
    sensor
        What it is.
    side
        Which of its two gains and offsets.
    exposure
        Factor on the light (of `Sensor.exposure`, or metered).
    rng
        Of the noise; a generator of its own for each camera and frame.

    Returns
    -------
    (height, width, 3) RGB or (height, width) grey, uint8 or uint16.

    Notes
    -----
    Electrons are counted with the mean n of the light and the variance `n + 1/8` (a squared Gaussian, which is skewed
    as a count is, and costs a third of it): a share x of the full well w becomes
    `255 x^(1/gamma)` with the variance `(255 / gamma * x^(1/gamma - 1))^2 * x / w + read_noise^2`, plus 1/12 for the
    rounding.
    """
    at = SIDES.index(side)
    caught = np.minimum((light if sensor.color else luminance(light)) * np.float32(exposure), np.float32(1.0))
    if math.isfinite(sensor.full_well_e):
        well = np.float32(sensor.full_well_e * min(1.0, LONGEST_EXPOSURE / exposure))
        root = np.sqrt(caught * well) + rng.standard_normal(caught.shape, np.float32) / 2
        caught = (root * root - np.float32(0.25)) / well
    level = np.clip(caught * np.float32(sensor.gain[at]), 0.0, 1.0) ** np.float32(1 / sensor.gamma)
    grey = level * np.float32(255.0) + np.float32(sensor.offset[at])
    if sensor.read_noise > 0:
        grey = grey + np.float32(sensor.read_noise) * rng.standard_normal(grey.shape, np.float32)
    step, kind = (1, np.uint8) if sensor.bits == 8 else (257, np.uint16)
    return np.asarray(np.clip(np.rint(grey * np.float32(step)), 0, 255 * step), kind)


def row_delays(sensor: Sensor, side: Side, height: int) -> FloatArray:
    """Return (height,) how much later than the frame's moment each row is exposed, seconds."""
    along = np.linspace(-0.5, 0.5, height) if height > 1 else np.zeros(1)
    return np.asarray(along * sensor.rolling_shutter_s + (sensor.right_delay_s if side == "right" else 0.0))
