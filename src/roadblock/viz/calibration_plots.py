"""The plots of a calibration's page; each draws into matplotlib axes and needs no more than the calibration."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from roadblock.geometry.pose import inverse, transform
from roadblock.geometry.projection import project, unproject
from roadblock.geometry.stereo import rectifying_rotations
from roadblock.values.calibration import Calibration, ViewFit
from roadblock.values.checks import FloatArray
from roadblock.viz.page import INK_HEX

LEFT_HEX, RIGHT_HEX, BAD_HEX, SOFT_HEX = "#2f8fd8", "#d9822b", "#d0483e", "#8a94a0"
SIDES = (("left", LEFT_HEX), ("right", RIGHT_HEX))
MOST_ARROWS = 2500
MOST_BARS = 60
ROW_CELLS = (6, 8)
"""Rows and columns of the map of row errors."""


class Panel(NamedTuple):
    """One plot: its caption, what draws it into matplotlib axes, and its height in inches."""

    caption: str
    draw: Callable[[Any], None]
    height: float = 3.2


def _aspect(c: Calibration) -> float:
    width, height = c.rig.left.size_px
    return height / width


def _tall(c: Calibration) -> float:
    """Height of a plot that shows an image, inches."""
    return 0.9 + 4.2 * _aspect(c)


def range_panels(c: Calibration) -> list[Panel]:
    """Return the predicted range error over the image, at each distance where there is one."""
    maps = [(z_m, field) for z_m, field in c.range_sigma_m.items() if np.isfinite(field).any()]
    return [
        Panel(f"at {z_m:g} m, in {_unit(field)[1]}", partial(_draw_sigma, field=field, aspect=_aspect(c)), _tall(c))
        for z_m, field in maps
    ]


def residual_panels(c: Calibration) -> list[Panel]:
    """Return the residual vectors over each camera's image."""
    sides = enumerate(name for name, _ in SIDES)
    return [
        Panel(f"{name} image", partial(_draw_residuals, c=c, side=side), _tall(c)) for side, name in sides if c.used
    ]


def noise_panels(c: Calibration) -> list[Panel]:
    """Return the distribution of the residuals, and their trend with the distance from the centre."""
    if not c.used:
        return []
    return [
        Panel("All coordinates of all residuals", partial(_draw_histogram, c=c)),
        Panel("Mean residual outwards (full) and around (dashed), each camera alone", partial(_draw_rings, c=c)),
    ]


def view_panels(c: Calibration) -> list[Panel]:
    """Return the error of each view."""
    if not c.views:
        return []
    which = "All views" if len(c.views) <= MOST_BARS else f"The {MOST_BARS} worst of {len(c.views)} views"
    caption = f"{which}: RMS of the residuals, px (blue: left, orange: right; pale with a cross: left out)"
    return [Panel(caption, partial(_draw_bars, c=c), 0.9 + 0.2 * min(len(c.views), MOST_BARS))]


def coverage_panels(c: Calibration) -> list[Panel]:
    """Return which areas of the images, which turns and which distances of the board the views show."""
    counts = zip(SIDES, (c.coverage.left_counts, c.coverage.right_counts), strict=True)
    panels = [
        Panel(
            f"Points per area, {name} image",
            partial(_draw_counts, values=count, aspect=_aspect(c)),
            _tall(c),
        )
        for (name, _), count in counts
    ]
    if len(c.coverage.distances_m):
        panels.append(Panel("How boards were turned, and how far away they were", partial(_draw_tilts, c=c), 3.4))
        panels.append(Panel("Distances of the boards", partial(_draw_distances, c=c), 3.4))
    return panels


def shape_panels(c: Calibration) -> list[Panel]:
    """Return the row error after rectification, and the board's shape."""
    if not c.used:
        return []
    return [
        Panel("Mean row difference left minus right per area, px", partial(_draw_rows, c=c), _tall(c)),
        Panel("How far each point lies behind the board's plane, mm", partial(_draw_board, c=c)),
    ]


def _places(c: Calibration, side: int) -> FloatArray:
    """Return (views, points, 2) where each point was measured in one camera's image, pixels; NaN where it was not seen.

    Of used views.
    """
    points = c.board.points_m + np.nan_to_num(c.board_heights_m)[:, None] * (0.0, 0.0, 1.0)
    camera = (c.rig.left, c.rig.right)[side]
    T_camera_left = np.eye(4) if side == 0 else inverse(c.rig.T_left_right)
    found = np.full((len(c.used), len(points), 2), np.nan)
    for i, view in enumerate(c.used):
        if view.T_left_board is not None:
            predicted = project(camera, transform(T_camera_left @ view.T_left_board, points))
            found[i] = predicted + (view.residual_left_px, view.residual_right_px)[side]
    return found


def _row_errors(c: Calibration, places: Sequence[FloatArray]) -> FloatArray:
    """Return (views, points) row of the left minus of the right rectified image, pixels; NaN where unseen."""
    focal_px = (c.rig.left.fy_px + c.rig.right.fy_px) / 2
    rows = []
    for camera, R, place in zip(
        (c.rig.left, c.rig.right), rectifying_rotations(c.rig.T_left_right), places, strict=True
    ):
        rays = unproject(camera, place) @ R.T
        rows.append(focal_px * rays[..., 1] / rays[..., 2])
    return np.asarray(rows[0] - rows[1])


def _residuals(c: Calibration) -> list[FloatArray]:
    """All coordinates of the residuals of used views, left and right, pixels."""
    sides = ([v.residual_left_px for v in c.used], [v.residual_right_px for v in c.used])
    both = (np.concatenate(side).ravel() for side in sides)
    return [side[np.isfinite(side)] for side in both]


def _frame(axes: Any, c: Calibration) -> None:
    """Make axes an image: rows downwards, in pixels."""
    width, height = c.rig.left.size_px
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    axes.tick_params(labelsize="small")


def _draw_residuals(axes: Any, c: Calibration, side: int) -> None:
    from matplotlib.collections import LineCollection

    residuals = np.stack([(v.residual_left_px, v.residual_right_px)[side] for v in c.used]).reshape(-1, 2)
    starts = _places(c, side).reshape(-1, 2)
    seen = np.flatnonzero(np.isfinite(residuals + starts).all(-1))
    shown = seen[np.linspace(0, len(seen) - 1, min(len(seen), MOST_ARROWS)).astype(int)] if len(seen) else seen
    lengths_px = np.linalg.norm(residuals[shown], axis=-1)
    typical_px = float(np.percentile(lengths_px, 90)) if len(shown) else 1.0
    enlarged = 0.04 * c.rig.left.size_px[0] / max(typical_px, 1e-9)
    ends = starts[shown] + enlarged * residuals[shown]
    color = SIDES[side][1]
    axes.add_collection(LineCollection(list(np.stack([starts[shown], ends], 1)), colors=color, linewidths=0.7))
    axes.plot(*starts[shown].T, ".", color=color, markersize=1.6)
    _frame(axes, c)
    axes.set_title(f"{len(seen)} points, {enlarged:.0f} times enlarged", fontsize="medium")


def _draw_histogram(axes: Any, c: Calibration) -> None:
    both = _residuals(c)
    reach_px = 4 * max([float(s) for s in c.sigma_px if math.isfinite(s)] or [1.0])
    edges = np.linspace(-reach_px, reach_px, 49)
    line = np.linspace(-reach_px, reach_px, 200)
    sides = zip(SIDES, both, c.sigma_px, c.cameras_alone, strict=True)
    for (name, color), residual_px, sigma_px, alone in sides:
        if len(residual_px) and sigma_px > 0:
            kept = np.clip(residual_px, -reach_px, reach_px)
            axes.hist(kept, edges, density=True, color=color, alpha=0.35, label=name)
            axes.plot(
                line, _normal(line, sigma_px), "--", color=color, linewidth=1.4, label=f"normal, {sigma_px:.3f} px"
            )
        if alone.expected_sigma_px > 0:
            expected = f"{name} corner fits expect {alone.expected_sigma_px:.3f} px"
            axes.axvline(alone.expected_sigma_px, color=color, linewidth=0.8, linestyle=":", label=expected)
            axes.axvline(-alone.expected_sigma_px, color=color, linewidth=0.8, linestyle=":")
    axes.set(xlabel="residual (px)", yticks=[])
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False, fontsize="small")


def _normal(x: FloatArray, sigma: float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * (x / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi)))


def _draw_rings(axes: Any, c: Calibration) -> None:
    axes.axhline(0, color=INK_HEX, linewidth=0.8)
    for (name, color), alone in zip(SIDES, c.cameras_alone, strict=True):
        axes.plot(*alone.radial_px.T, "o-", color=color, markersize=3, label=f"{name}, outwards")
        axes.plot(*alone.tangential_px.T, "s--", color=color, markersize=3, label=f"{name}, around")
    axes.set(xlabel="distance from the principal point (px)", ylabel="px")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=2, frameon=False, fontsize="small")


def _bars(c: Calibration) -> list[ViewFit]:
    """Return the views with bars: all, or the worst where there are many."""
    if len(c.views) <= MOST_BARS:
        return list(c.views)
    worst = sorted(c.views, key=lambda view: -float(np.nan_to_num(view.rms_px).max()))[:MOST_BARS]
    return [view for view in c.views if view in worst]


def _draw_bars(axes: Any, c: Calibration) -> None:
    views = _bars(c)
    rms_px = np.array([view.rms_px for view in views])
    out = np.array([bool(view.left_out) for view in views])
    rows = np.arange(len(views))
    used_px = rms_px[~out & np.isfinite(rms_px).any(-1)]
    reach_px = 1.6 * float(np.nanmax(used_px)) if used_px.size else float(np.nanmax(np.nan_to_num(rms_px, nan=1.0)))
    for side, (_, color) in enumerate(SIDES):
        width_px = np.minimum(np.nan_to_num(rms_px[:, side]), reach_px)
        where = rows + 0.4 * side - 0.2
        axes.barh(where[~out], width_px[~out], height=0.36, color=color)
        axes.barh(where[out], width_px[out], height=0.36, color=color, alpha=0.3)
    for row, error_px in zip(rows, np.nan_to_num(rms_px).max(-1), strict=True):
        if error_px > reach_px:
            axes.annotate(f" {error_px:.2f}", (reach_px, row), va="center", fontsize="small", annotation_clip=False)
    axes.plot(np.zeros(out.sum()), rows[out], "x", color=BAD_HEX, markersize=5, clip_on=False)
    axes.set_yticks(rows, [view.name[-24:] for view in views], fontsize="small")
    axes.set(ylim=(len(views) - 0.4, -0.6), xlim=(0, reach_px), xlabel="RMS (px)")
    axes.grid(axis="x", alpha=0.25, color=INK_HEX, linewidth=0.6)


def _draw_cells(
    axes: Any, values: FloatArray, aspect: float, write: Callable[[float], str], norm: Any, colors: str
) -> None:
    """Draw (rows, columns) numbers as coloured cells of an image."""
    mesh = axes.pcolormesh(np.ma.masked_invalid(values), cmap=colors, norm=norm)
    for (row, column), value in np.ndenumerate(values):
        red, green, blue, _ = mesh.cmap(mesh.norm(value)) if math.isfinite(value) else (0, 0, 0, 0)
        bright = 0.299 * red + 0.587 * green + 0.114 * blue > 0.5
        ink = ("#101418" if bright else "#f0f3f6") if math.isfinite(value) else INK_HEX
        text = write(value) if math.isfinite(value) else "–"  # noqa: RUF001
        axes.text(column + 0.5, row + 0.5, text, ha="center", va="center", fontsize="small", color=ink)
    axes.set(xticks=[], yticks=[], aspect=aspect * values.shape[1] / values.shape[0])
    axes.invert_yaxis()
    axes.spines[:].set_visible(False)


def _draw_counts(axes: Any, values: FloatArray, aspect: float) -> None:
    from matplotlib.colors import Normalize

    _draw_cells(axes, values, aspect, "{:.0f}".format, Normalize(0, max(float(values.max()), 1.0)), "viridis")


def _unit(field: FloatArray) -> tuple[float, str]:
    """Return the factor from metres, and the unit, in which a map of lengths reads well."""
    return (1000.0, "mm") if float(np.nanmedian(field)) < 0.0995 else (1.0, "m")


def _draw_sigma(axes: Any, field: FloatArray, aspect: float) -> None:
    from matplotlib.colors import LogNorm

    values = np.maximum(_unit(field)[0] * field, 1e-9)
    norm = LogNorm(float(np.nanmin(values)), 1.001 * float(np.nanmax(values)))
    _draw_cells(axes, values, aspect, _two_digits, norm, "YlOrRd")


def _two_digits(value: float) -> str:
    return f"{value:.{max(0, 1 - math.floor(math.log10(value)))}f}"


def _draw_rows(axes: Any, c: Calibration) -> None:
    from matplotlib.colors import Normalize

    places = _places(c, 0), _places(c, 1)
    errors_px = _row_errors(c, places).ravel()
    u, v = places[0].reshape(-1, 2).T
    known = np.isfinite(errors_px)
    width, height = c.rig.left.size_px
    rows, columns = ROW_CELLS
    cell = np.clip((v[known] + 0.5) * rows // height, 0, rows - 1) * columns
    cell = (cell + np.clip((u[known] + 0.5) * columns // width, 0, columns - 1)).astype(int)
    counts = np.bincount(cell, minlength=rows * columns)
    sums = np.bincount(cell, errors_px[known], rows * columns)
    means = np.divide(sums, counts, out=np.full(rows * columns, np.nan), where=counts > 0)
    reach_px = max(float(np.nanmax(np.abs(means), initial=0.0)), 1e-6)
    norm = Normalize(-reach_px, reach_px)
    _draw_cells(axes, means.reshape(rows, columns), _aspect(c), "{:+.2f}".format, norm, "RdBu_r")


def _draw_board(axes: Any, c: Calibration) -> None:
    x, y, _ = 1000 * c.board.points_m.T
    heights_mm = 1000 * c.board_heights_m
    reach = max(float(np.nanmax(np.abs(np.nan_to_num(heights_mm)))), 1e-6)
    size = 9000 / len(x)
    drawn = axes.scatter(x, y, s=min(size, 160), c=heights_mm, cmap="RdBu_r", vmin=-reach, vmax=reach, marker="s")
    axes.set(aspect="equal", xlabel="along a row (mm)", ylabel="down the rows (mm)")
    axes.invert_yaxis()
    axes.margins(0.08)
    _color_bar(axes, drawn, "mm")


def _draw_tilts(axes: Any, c: Calibration) -> None:
    drawn = axes.scatter(*c.coverage.tilts_deg.T, c=c.coverage.distances_m, cmap="viridis_r", s=34, edgecolors=SOFT_HEX)
    axes.axhline(0, color=INK_HEX, linewidth=0.5)
    axes.axvline(0, color=INK_HEX, linewidth=0.5)
    reach = max(30.0, 1.1 * float(np.nanmax(np.abs(c.coverage.tilts_deg))))
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.set(xlabel="right side farther (deg)", ylabel="upper side farther (deg)")
    _color_bar(axes, drawn, "distance (m)")


def _draw_distances(axes: Any, c: Calibration) -> None:
    axes.hist(c.coverage.distances_m, bins=16, color=SOFT_HEX)
    axes.set(xlabel="distance of the board (m)", ylabel="views", xlim=(0, None))


def _color_bar(axes: Any, drawn: Any, label: str) -> None:
    low, high = drawn.get_clim()
    bar = axes.inset_axes([1.03, 0.0, 0.04, 1.0])  # the library's own would be a bitmap
    steps = np.linspace(low, high, 33)
    bar.pcolormesh([0, 1], steps, (steps[:-1, None] + steps[1:, None]) / 2, cmap=drawn.cmap, norm=drawn.norm)
    bar.set_xticks([])
    bar.yaxis.tick_right()
    bar.set_title(label, fontsize="small")
    bar.tick_params(labelsize="small")
