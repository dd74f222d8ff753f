"""What comes out of a calibration: the rig, how sure, and everything a person needs to judge it."""

from dataclasses import dataclass, field

import numpy as np

from roadblock.errors import ValueRefusedError
from roadblock.values.board import Board
from roadblock.values.camera import Camera, StereoRig, Verdict
from roadblock.values.checks import FloatArray, numbers, rigid_transform

RANGES_M = (5.0, 10.0, 20.0, 40.0)
"""Distances at which the range error caused by calibration is predicted."""


def _rms(squares: FloatArray) -> float:
    """Root of the mean of those that are known; NaN if none is."""
    known = squares[np.isfinite(squares)]
    return float(np.sqrt(known.mean())) if known.size else float("nan")


@dataclass(frozen=True, eq=False)
class ViewFit:
    """How well one view fits the calibration.

    Attributes
    ----------
    name
        Of the view.
    T_left_board
        4x4 pose of the board in the left camera's frame, metres; None for a view that no pose was found for.
    residual_left_px, residual_right_px
        (n, 2) measured minus predicted for every point of the board, pixels; NaN where it was not seen, and all NaN
        where there is no pose. Given for views that were left out, too.
    weight_left, weight_right
        (n,) weight 0..1 that the robust fit gave each point; NaN where it was not seen.
    left_out
        Why it was not used, in words; "" for a view that was.
    """

    name: str
    T_left_board: FloatArray | None
    residual_left_px: FloatArray
    residual_right_px: FloatArray
    weight_left: FloatArray
    weight_right: FloatArray
    left_out: str = ""

    def __post_init__(self) -> None:
        if self.T_left_board is not None:
            object.__setattr__(self, "T_left_board", rigid_transform("T_left_board", self.T_left_board))
        for name in ("residual_left_px", "residual_right_px"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), (-1, 2)))
        for name in ("weight_left", "weight_right"):
            object.__setattr__(self, name, numbers(name, getattr(self, name), (len(self.residual_left_px),)))

    @property
    def rms_px(self) -> tuple[float, float]:
        """Root mean square of the lengths of its residuals, (left, right), pixels; NaN where it was not seen."""
        squares = [(residual_px**2).sum(-1) for residual_px in (self.residual_left_px, self.residual_right_px)]
        left, right = (_rms(lengths_px2) for lengths_px2 in squares)
        return left, right


@dataclass(frozen=True, eq=False)
class CameraFit:
    """One camera calibrated alone, the paper's first step, and its error analysis.

    Attributes
    ----------
    camera
        As found from this camera's views alone.
    rms_px
        Root mean square of the lengths of its residuals (as OpenCV's), pixels.
    sigma_px
        Robust standard deviation of one coordinate of a residual, pixels.
    expected_sigma_px
        What the corner fits themselves expect of their noise, pixels: far below `sigma_px` means that something
        is wrong with the model (lens, board, moving views), not with the corners.
    radial_px
        (k, 2) distance from the principal point and mean residual away from it there, pixels; NaN in empty rings.
    tangential_px
        (k, 2) the same for the mean residual around it, clockwise.
    """

    camera: Camera
    rms_px: float
    sigma_px: float
    expected_sigma_px: float
    radial_px: FloatArray
    tangential_px: FloatArray


@dataclass(frozen=True)
class LensTrial:
    """How one lens model did on views that it was not fitted to.

    Attributes
    ----------
    lens
        "brown_conrady5", "brown_conrady8" or "kannala_brandt".
    parameters
        Of both cameras.
    fitted_rms_px, held_out_rms_px
        Robust root mean square of the residuals of views in, and not in the fit, pixels.
    verdict
        In words: chosen, or why not.
    """

    lens: str
    parameters: int
    fitted_rms_px: float
    held_out_rms_px: float
    verdict: str


@dataclass(frozen=True, eq=False)
class Coverage:
    """What the views show, and what they miss.

    Attributes
    ----------
    left_counts, right_counts
        (rows, columns) points of used views per area of the image, from its top left corner on.
    distances_m
        (n,) distance of each used view's board from the left camera, metres.
    tilts_deg
        (n, 2) turn of each used board about the image's vertical axis (> 0: its right side is farther) and about the
        horizontal one (> 0: its upper side is farther), degrees.
    missing
        In words, each one sentence; empty if nothing is.
    next_view
        The single next view that would help most, in words; "" if none helps.
    next_gain
        Predicted range sigma at 20 m with that view over the one without; NaN if there is none.
    """

    left_counts: FloatArray
    right_counts: FloatArray
    distances_m: FloatArray
    tilts_deg: FloatArray
    missing: tuple[str, ...] = ()
    next_view: str = ""
    next_gain: float = float("nan")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated rig and its evidence.

    Attributes
    ----------
    rig
        With its covariance.
    board, board_heights_m, board_heights_sigma_m
        The board, and (n,) how far each of its points lies behind (> 0) the plane through the board, metres, with
        its sigma.
    views
        Every view that showed a board to any camera, used or not.
    cameras_alone
        The left and the right camera, each calibrated alone.
    lens_trials
        The evidence for the lens; one entry where it was given.
    rms_px
        Root mean square of the lengths of all residuals of used views, pixels, unweighted (as OpenCV's stereo RMS).
    sigma_px
        Robust standard deviation of one coordinate of a residual, (left, right), pixels.
    epipolar_rms_px
        Root mean square of the row difference after rectification, in pixels of the rectified image.
    inflation
        Factor on the standard deviations because residuals within a view hang together (1 = they do not).
    range_sigma_m
        Distance in metres -> (rows, columns) predicted standard deviation of the forward distance, metres, over the
        left image; NaN where the right camera does not see that far point.
    coverage
        What the views show.
    verdict, reasons
        Whether it can be trusted, and why (not), in words.
    """

    rig: StereoRig
    board: Board
    board_heights_m: FloatArray
    board_heights_sigma_m: FloatArray
    views: tuple[ViewFit, ...]
    cameras_alone: tuple[CameraFit, CameraFit]
    lens_trials: tuple[LensTrial, ...]
    rms_px: float
    sigma_px: tuple[float, float]
    epipolar_rms_px: float
    inflation: float
    range_sigma_m: dict[float, FloatArray]
    coverage: Coverage
    verdict: Verdict
    reasons: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        if self.verdict not in ("good", "usable", "refused"):
            raise ValueRefusedError(f"verdict must be good, usable or refused, but got {self.verdict!r}")

    @property
    def range_rms_m(self) -> dict[float, float]:
        """Distance in metres -> `range_sigma_m` as root mean square over the image area that both cameras see."""
        return {distance_m: _rms(sigma_m**2) for distance_m, sigma_m in self.range_sigma_m.items()}

    @property
    def used(self) -> tuple[ViewFit, ...]:
        """The views that the rig was fitted to."""
        return tuple(view for view in self.views if not view.left_out)
