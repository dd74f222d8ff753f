"""The colours: one scale for range, and one set for everything that is no obstacle."""

import math
from functools import cache

import cv2
import numpy as np

Color = tuple[int, int, int]
"""RGB, 0..255."""

NEAR_M, FAR_M = 4.0, 50.0
"""Where the range scale starts (red) and ends (blue); logarithmic between, as a driver's seconds to react are."""

INK: Color = (12, 14, 18)
PAPER: Color = (236, 240, 244)
MUTED: Color = (150, 158, 168)
FREE: Color = (40, 200, 110)
PANEL: Color = (20, 22, 27)
IN_VIEW: Color = (40, 44, 52)
FREE_GROUND: Color = (32, 94, 62)
GRID: Color = (78, 84, 94)
EDGE_COLORS: dict[str, Color] = {"kerb": (255, 160, 30), "verge": (235, 90, 220)}
STATE: dict[str, Color] = {"ok": (70, 210, 120), "degraded": (250, 180, 60), "failed": (240, 80, 70)}
ACTION: dict[str, Color] = {"warn": (250, 180, 60), "brake": (240, 80, 70), "swerve": (250, 120, 200)}


@cache
def _scale() -> np.ndarray:
    """Return the middle of OpenCV's Turbo (its dark ends drown on asphalt), (n, 3) RGB, near first."""
    turbo = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_TURBO)[:, 0, ::-1]
    return turbo[222:28:-1]


def range_color(range_m: float) -> Color:
    """Return the colour of a range (> 0): red at `NEAR_M` and nearer, blue at `FAR_M` and beyond."""
    scale = _scale()
    share = math.log(range_m / NEAR_M) / math.log(FAR_M / NEAR_M)
    r, g, b = scale[round(min(max(share, 0.0), 1.0) * (len(scale) - 1))]
    return int(r), int(g), int(b)


def ink_on(background: Color) -> Color:
    """Return the text colour that reads well on `background`: dark or light."""
    r, g, b = background
    return INK if 0.299 * r + 0.587 * g + 0.114 * b > 120 else PAPER
