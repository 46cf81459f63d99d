"""The picture of a landing: the path with attitude, plume and approach cone, and every limit over time.

Needs matplotlib, the extra `plot`; imported when a figure is drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..scenes.powered_descent import Array, Limit, Vehicle
from ..scenes.touchdown import Descent

__all__ = ["save_figure"]

_INK, _PATH, _BODY, _FLAME, _LIMIT, _CONE = "#1b2a3a", "#1f5f99", "#37506b", "#f28c28", "#c0392b", "#5b9a68"

#: The stage is drawn this many times larger than it is, a plume at full thrust this long (m, before enlarging).
_ENLARGED = 3.0
_LENGTH, _RADIUS, _PLUME = 28.0, 2.4, 34.0
_POSES = 9

#: output, title, unit, factor of each panel
_PANELS = (
    ("thrust", "thrust", "kN", 1e-3),
    ("gimbal", "gimbal angle", "deg", 180.0 / np.pi),
    ("tilt", "tilt from vertical", "deg", 180.0 / np.pi),
    ("rate", "angular rate", "deg/s", 180.0 / np.pi),
    ("mass", "mass", "t", 1e-3),
    ("cone", "distance inside the cone", "m", 1.0),
)


def save_figure(
    path: Path, title: str, dense: Descent, nodes: Descent, limits: Sequence[Limit], vehicle: Vehicle, dpi: int = 100
) -> None:
    """Draw a landing into a PNG file.

    Args:
        dense: the rollout of the controls, densely sampled.
        nodes: the optimiser's own nodes.
    Raises:
        ImportError: matplotlib is not installed.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12.0, 7.0), facecolor="white")
    FigureCanvasAgg(figure)
    figure.suptitle(title, x=0.5, y=0.975, fontsize=14, color=_INK, fontweight="bold")
    grid = figure.add_gridspec(3, 2, left=0.52, right=0.985, top=0.88, bottom=0.145, hspace=0.42, wspace=0.27)
    scene = figure.add_axes((0.01, 0.145, 0.47, 0.795), projection="3d", proj_type="ortho")
    _draw_scene(scene, dense, nodes, vehicle)
    for number, panel in enumerate(_PANELS):
        axes = figure.add_subplot(grid[number // 2, number % 2])
        _draw_panel(axes, panel, dense, nodes, limits)
        if number >= len(_PANELS) - 2:
            axes.set_xlabel("time, s", fontsize=10)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(
        handles, labels, loc="lower center", bbox_to_anchor=(0.74, 0.005), ncols=3, fontsize=9.5, frameon=False
    )
    figure.legend(
        handles=_scene_handles(vehicle),
        loc="lower center",
        bbox_to_anchor=(0.25, 0.005),
        ncols=2,
        fontsize=9.5,
        frameon=False,
    )
    figure.savefig(path, dpi=dpi)


def _draw_panel(
    axes: Any, panel: tuple[str, str, str, float], dense: Descent, nodes: Descent, limits: Sequence[Limit]
) -> None:
    output, title, unit, factor = panel
    values, held = dense.outputs[output] * factor, output in ("thrust", "gimbal")
    marks = nodes.outputs[output] * factor
    kept = slice(None, -1) if held else slice(None)
    axes.plot(dense.ts, values, color=_PATH, lw=1.6, label="rollout of the controls (RKMK4)")
    axes.plot(nodes.ts[kept], marks[kept], "o", color=_INK, ms=3.0, label="nodes of the optimiser")
    bounds = [limit.bound * factor for limit in limits if limit.output == output]
    for bound in bounds:
        axes.axhline(bound, color=_LIMIT, lw=1.3, ls="--", label="limit" if bound == bounds[0] else None)
    low, high = min([*bounds, values.min(), marks.min()]), max([*bounds, values.max(), marks.max()])
    room = 0.1 * max(high - low, 1e-9)
    axes.set_ylim(low - room, high + room)
    axes.set_xlim(0.0, dense.ts[-1])
    axes.locator_params(axis="x", integer=True)
    axes.set_title(f"{title}, {unit}", fontsize=10.5, loc="left", color=_INK)
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_scene(axes: Any, dense: Descent, nodes: Descent, vehicle: Vehicle) -> None:
    path = dense.position
    _draw_cone(axes, vehicle, radius=_cone_radius(path))
    axes.plot(path[:, 0], path[:, 1], 0.0 * path[:, 2], color="0.55", lw=1.0, ls=":")
    axes.plot(*path.T, color=_PATH, lw=1.8)
    axes.plot(*nodes.position.T, "o", color=_INK, ms=2.2)
    for time in np.linspace(0.0, dense.ts[-1], _POSES):
        _draw_stage(axes, dense, int(np.argmin(np.abs(dense.ts - time))), vehicle)
    axes.scatter([0.0], [0.0], [0.0], marker="x", s=40, color=_LIMIT, depthshade=False)
    _equal_axes(axes, path)
    axes.set_xlabel("x, m", fontsize=10, labelpad=2)
    axes.set_ylabel("y, m", fontsize=10, labelpad=2)
    axes.set_zlabel("height, m", fontsize=10, labelpad=2)
    axes.tick_params(labelsize=8, pad=0)
    axes.view_init(elev=14.0, azim=-72.0)
    for pane in (axes.xaxis, axes.yaxis, axes.zaxis):
        pane.set_pane_color((0.97, 0.97, 0.98, 1.0))


def _scene_handles(vehicle: Vehicle) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    opening = np.rad2deg(vehicle.glide_slope)
    return [
        Line2D([], [], color=_PATH, lw=1.8, marker="o", ms=3.0, mfc=_INK, mec=_INK, label="path and nodes"),
        Line2D([], [], color="0.55", lw=1.0, ls=":", label="ground track"),
        Patch(color=_BODY, label=f"stage, drawn {_ENLARGED:g} times as large"),
        Patch(color=_FLAME, label="plume, length by thrust"),
        Patch(color=_CONE, alpha=0.4, label=f"approach cone, {opening:.0f} deg"),
        Line2D([], [], color=_LIMIT, ls="", marker="x", ms=6.0, label="pad"),
    ]


def _cone_radius(path: Array) -> float:
    return 0.5 * max(float(np.linalg.norm(path[:, :2], axis=1).max()), 0.4 * float(path[:, 2].max()))


def _draw_cone(axes: Any, vehicle: Vehicle, radius: float) -> None:
    turn, out = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 49), np.linspace(0.0, radius, 9))
    height = out / np.tan(vehicle.glide_slope)
    axes.plot_surface(out * np.cos(turn), out * np.sin(turn), height, color=_CONE, alpha=0.22, linewidth=0, shade=False)
    rim = np.linspace(0.0, 2.0 * np.pi, 97)
    axes.plot(radius * np.cos(rim), radius * np.sin(rim), height.max() + 0.0 * rim, color=_CONE, lw=1.0)


def _draw_stage(axes: Any, descent: Descent, sample: int, vehicle: Vehicle) -> None:
    """The stage as a cylinder with a nose, and its plume against the thrust, down to the ground at most."""
    p = descent.position[sample]
    heights = _ENLARGED * _LENGTH * np.array([0.0, 0.0, 0.82, 1.0])
    radii = _ENLARGED * _RADIUS * np.array([0.0, 1.0, 1.0, 0.0])
    _draw_solid(axes, p, descent.rotation[sample, :, 2], heights, radii, _BODY)
    size = float(np.linalg.norm(descent.thrust[sample]))
    if size > 0.0:
        down = -descent.thrust[sample] / size
        length = _ENLARGED * _PLUME * size / vehicle.max_thrust
        if down[2] < 0.0:
            length = min(length, max(p[2], 0.0) / -down[2])
        _draw_solid(axes, p, down, np.linspace(0.0, length, 3), radii[1] * np.array([0.55, 0.8, 0.0]), _FLAME)


def _draw_solid(axes: Any, origin: Array, axis: Array, along: Array, radii: Array, color: str) -> None:
    """A solid of revolution: distances along a unit axis from the origin, and the radius at each."""
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0.0, 2.0 * np.pi, 13)[:, None]
    ring = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    points = origin + along[:, None, None] * axis + radii[:, None, None] * ring
    axes.plot_surface(*np.moveaxis(points, 2, 0), color=color, linewidth=0)


def _equal_axes(axes: Any, path: Array) -> None:
    """The same length of a metre along every axis, around path, cone and pad."""
    radius, room = _cone_radius(path), 60.0
    low = np.minimum(path.min(axis=0), [-radius, -radius, 0.0]) - [room, room, 0.0]
    high = np.maximum(path.max(axis=0), [radius, radius, 0.0]) + [room, room, room]
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_zlim(low[2], high[2])
    axes.set_box_aspect(high - low, zoom=1.1)
    for axis, a, b in zip((axes.xaxis, axes.yaxis, axes.zaxis), low, high):
        step = 200.0 if b - a <= 1200.0 else 100.0 * np.ceil((b - a) / 600.0)
        axis.set_ticks(np.arange(np.ceil(a / step) * step, b, step))
