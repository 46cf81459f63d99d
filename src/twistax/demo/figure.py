"""A landing as a figure of the path with attitude, plume, cone and all limits, and as a table.

The figure needs matplotlib (extra `plot`), which is imported when it is drawn.
"""

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

import twistax as tx

from ..scenes.powered_descent import Array, Lander, Limit
from ..scenes.touchdown import Descent

_INK, _PATH, _BODY, _FLAME, _LIMIT, _CONE = "#1b2a3a", "#1f5f99", "#37506b", "#f28c28", "#c0392b", "#5b9a68"
#: The stage is drawn this many times larger than it is, a plume at full thrust this long (m, before enlarging).
ENLARGED = 3.0
LENGTH, RADIUS, PLUME = 28.0, 2.4, 34.0
_POSES, _DEGREES = 9, 180.0 / np.pi

#: output, title, unit, factor of each panel
_PANELS = (
    ("thrust", "thrust", "kN", 1e-3),
    ("gimbal", "gimbal angle", "deg", _DEGREES),
    ("tilt", "tilt from vertical", "deg", _DEGREES),
    ("rate", "angular rate", "deg/s", _DEGREES),
    ("mass", "mass", "t", 1e-3),
    ("cone", "distance inside the cone", "m", 1.0),
)


def save_table(path: Path, descent: Descent) -> None:
    """Write a descent as CSV, one line per sample, with units in the first line."""
    outputs, quaternions = descent.outputs, np.asarray(jax.vmap(tx.lie.quaternion)(descent.rotation))
    columns: dict[str, Any] = {
        "time (s)": descent.ts,
        **dict(zip(("x (m)", "y (m)", "height (m)"), descent.position.T)),
        **dict(zip((f"velocity {axis} (m/s)" for axis in "xyz"), descent.velocity.T)),
        **dict(zip((f"quaternion {part}" for part in "wxyz"), quaternions.T)),
        **dict(zip((f"body rate {axis} (rad/s)" for axis in "xyz"), descent.xs["V"][:, 3:].T)),
        "mass (kg)": descent.xs["m"],
        **dict(zip((f"body thrust {axis} (N)" for axis in "xyz"), descent.us["T"].T)),
        "thrust (kN)": outputs["thrust"] / 1e3,
        **{
            f"{name} (deg{per})": outputs[name] * _DEGREES
            for name, per in (("gimbal", ""), ("tilt", ""), ("rate", "/s"))
        },
        "inside the cone (m)": outputs["cone"],
    }
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows([f"{value:.9g}" for value in row] for row in zip(*columns.values()))


def save_figure(
    path: Path, title: str, dense: Descent, nodes: Descent, limits: Sequence[Limit], vehicle: Lander
) -> None:
    """Draw a landing into a PNG file: its dense rollout, and the nodes of the optimiser.

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
        axes.set_xlabel("time, s" if number >= len(_PANELS) - 2 else "", fontsize=10)
    style: dict[str, Any] = {"loc": "lower center", "fontsize": 9.5, "frameon": False}
    for shown, place, columns in ((axes, 0.74, 3), (scene, 0.25, 2)):
        handles = shown.get_legend_handles_labels()[0]
        figure.legend(handles=handles, bbox_to_anchor=(place, 0.005), ncols=columns, **style)
    figure.savefig(path, dpi=100)


def _draw_panel(
    axes: Any, panel: tuple[str, str, str, float], dense: Descent, nodes: Descent, limits: Sequence[Limit]
) -> None:
    output, title, unit, factor = panel
    values, marks = dense.outputs[output] * factor, nodes.outputs[output] * factor
    last = -1 if output in ("thrust", "gimbal") else None  # a control has no value of its own at the last node
    axes.plot(dense.ts, values, color=_PATH, lw=1.6, label="rollout of the controls (RKMK4)")
    axes.plot(nodes.ts[:last], marks[:last], "o", color=_INK, ms=3.0, label="nodes of the optimiser")
    bounds = [limit.bound * factor for limit in limits if limit.output == output]
    for bound in bounds:
        axes.axhline(bound, color=_LIMIT, lw=1.3, ls="--", label="limit" if bound == bounds[0] else None)
    low, high = min([*bounds, values.min(), marks.min()]), max([*bounds, values.max(), marks.max()])
    room = 0.1 * max(high - low, 1e-9)
    axes.set(xlim=(0.0, dense.ts[-1]), ylim=(low - room, high + room))
    axes.locator_params(axis="x", integer=True)
    axes.set_title(f"{title}, {unit}", fontsize=10.5, loc="left", color=_INK)
    axes.tick_params(labelsize=9)
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_scene(axes: Any, dense: Descent, nodes: Descent, vehicle: Lander) -> None:
    path = dense.position
    radius = 0.5 * max(float(np.linalg.norm(path[:, :2], axis=1).max()), 0.4 * float(path[:, 2].max()))
    axes.plot(*path.T, color=_PATH, lw=1.8)
    axes.plot(*nodes.position.T, "o", color=_INK, ms=2.2)
    axes.plot([], [], color=_PATH, lw=1.8, marker="o", ms=3.0, mfc=_INK, mec=_INK, label="path and nodes")
    axes.plot(*path[:, :2].T, 0.0 * path[:, 2], color="0.55", lw=1.0, ls=":", label="ground track")
    for time in np.linspace(0.0, dense.ts[-1], _POSES):
        _draw_stage(axes, dense, int(np.argmin(np.abs(dense.ts - time))), vehicle)
    for color, label in ((_BODY, f"stage, drawn {ENLARGED:g} times as large"), (_FLAME, "plume, length by thrust")):
        axes.plot([], [], color=color, lw=7.0, label=label)
    # The approach cone, and its rim.
    slope, label = np.tan(vehicle.glide_slope), f"approach cone, {np.rad2deg(vehicle.glide_slope):.0f} deg"
    turn, out = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 49), np.linspace(0.0, radius, 9))
    x, y = np.cos(turn), np.sin(turn)
    axes.plot_surface(out * x, out * y, out / slope, color=_CONE, alpha=0.22, linewidth=0, shade=False)
    axes.plot(radius * x[-1], radius * y[-1], radius / slope + 0.0 * x[-1], color=_CONE, lw=1.0)
    axes.plot([], [], color=_CONE, lw=7.0, alpha=0.4, label=label)
    axes.plot([0.0], [0.0], [0.0], color=_LIMIT, ls="", marker="x", ms=6.0, label="pad")
    # The same length of a metre along every axis, around path, cone and pad.
    room = 60.0
    low = np.minimum(path.min(axis=0), [-radius, -radius, 0.0]) - [room, room, 0.0]
    high = np.maximum(path.max(axis=0), [radius, radius, 0.0]) + [room, room, room]
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), zlim=(low[2], high[2]))
    axes.set_box_aspect(high - low, zoom=1.1)
    axes.tick_params(labelsize=8, pad=0)
    axes.view_init(elev=14.0, azim=-72.0)
    for axis, name, a, b in zip((axes.xaxis, axes.yaxis, axes.zaxis), ("x", "y", "height"), low, high):
        step = 200.0 if b - a <= 1200.0 else 100.0 * np.ceil((b - a) / 600.0)
        axis.set_ticks(np.arange(np.ceil(a / step) * step, b, step))
        axis.set_label_text(f"{name}, m", fontsize=10)
        axis.labelpad = 2
        axis.set_pane_color((0.97, 0.97, 0.98, 1.0))


def _draw_stage(axes: Any, descent: Descent, sample: int, vehicle: Lander) -> None:
    """The stage as a cylinder with a nose, and its plume against the thrust, down to the ground at most."""
    p = descent.position[sample]
    heights = ENLARGED * LENGTH * np.array([0.0, 0.0, 0.82, 1.0])
    radii = ENLARGED * RADIUS * np.array([0.0, 1.0, 1.0, 0.0])
    _draw_solid(axes, p, descent.rotation[sample, :, 2], heights, radii, _BODY)
    size = float(np.linalg.norm(descent.thrust[sample]))
    if size > 0.0:
        down = -descent.thrust[sample] / size
        length = ENLARGED * PLUME * size / vehicle.max_thrust
        if down[2] < 0.0:
            length = min(length, max(p[2], 0.0) / -down[2])
        _draw_solid(axes, p, down, np.linspace(0.0, length, 3), radii[1] * np.array([0.55, 0.8, 0.0]), _FLAME)


def _draw_solid(axes: Any, origin: Array, axis: Array, distances: Array, radii: Array, color: str) -> None:
    """A solid of revolution: distances along a unit axis from the origin, and the radius at each."""
    side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    side /= np.linalg.norm(side)
    turn = np.linspace(0.0, 2.0 * np.pi, 13)[:, None]
    ring = np.cos(turn) * side + np.sin(turn) * np.cross(axis, side)
    points = origin + distances[:, None, None] * axis + radii[:, None, None] * ring
    axes.plot_surface(*np.moveaxis(points, 2, 0), color=color, linewidth=0)
