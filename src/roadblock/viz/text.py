"""Text in pictures, with the one sign that OpenCV's fonts lack: ±."""

import cv2
import numpy as np

from roadblock.viz.colors import Color

FONT = cv2.FONT_HERSHEY_SIMPLEX
PLUS_MINUS = "\N{PLUS-MINUS SIGN}"


def _style(height_px: int) -> tuple[float, int]:
    thickness = max(1, round(height_px / 24))
    return cv2.getFontScaleFromHeight(FONT, height_px, thickness), thickness


def text_width(text: str, height_px: int) -> int:
    """Return the width of one line of text, pixels."""
    parts = text.split(PLUS_MINUS)
    return sum(_part_width(part, height_px) for part in parts) + (len(parts) - 1) * _sign_width(height_px)


def _part_width(part: str, height_px: int) -> int:
    return int(cv2.getTextSize(part, FONT, *_style(height_px))[0][0]) if part else 0


def _sign_width(height_px: int) -> int:
    return round(0.62 * height_px)


def draw_text(image: np.ndarray, text: str, left_base: tuple[int, int], height_px: int, color: Color) -> None:
    """Draw one line of text into `image` (RGB, changed in place).

    Parameters
    ----------
    image
        (height, width, 3) uint8.
    text
        ASCII and ±; other signs appear as the font has them.
    left_base
        (u, v) where the line starts: left end of its base line.
    height_px
        Height of a line's letters from base to top, about.
    color
        RGB.
    """
    u, v = left_base
    for index, part in enumerate(text.split(PLUS_MINUS)):
        if index:
            _draw_sign(image, (u, v), height_px, color)
            u += _sign_width(height_px)
        if part:
            scale, thickness = _style(height_px)
            cv2.putText(image, part, (u, v), FONT, scale, color, thickness, cv2.LINE_AA)
            u += _part_width(part, height_px)


def _draw_sign(image: np.ndarray, left_base: tuple[int, int], height_px: int, color: Color) -> None:
    """Draw ± from three strokes as wide as the letters'."""
    u, v = left_base
    half, thick = round(0.22 * height_px), max(1, round(height_px / 12))
    middle, cross = u + _sign_width(height_px) // 2, v - round(0.48 * height_px)
    for a, b in (((-half, cross), (half, cross)), ((-half, v - 1), (half, v - 1))):
        cv2.line(image, (middle + a[0], a[1]), (middle + b[0], b[1]), color, thick)
    cv2.line(image, (middle, cross - half), (middle, cross + half), color, thick)


def fit_text(text: str, height_px: int, width_px: int) -> str:
    """Return `text`, shortened with "..." until it is at most `width_px` wide; "" where not even that fits."""
    if text_width(text, height_px) <= width_px:
        return text
    for length in range(len(text) - 1, -1, -1):
        short = text[:length].rstrip() + "..."
        if text_width(short, height_px) <= width_px:
            return short
    return ""


def measure_text(value: float, sigma: float) -> str:
    """Return "12.3 ± 0.2 m" for a length and its standard deviation, metres; without ± where that is unknown."""
    if not np.isfinite(sigma):
        return f"{value:.1f} m"
    digits = 1 + (sigma < 0.095) + (sigma < 0.0095)
    return f"{value:.{digits}f} {PLUS_MINUS} {sigma:.{digits}f} m"
