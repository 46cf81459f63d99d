"""Pictures of values over time, by matplotlib, the extra `plot`, which is imported when something is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from numpy import ndarray as Array

from .checks import listed
from .errors import InputError, ModelError
from .groups import SE3, SO3, ElementPart, Group, euler

#: A panel with more curves than this has no legend.
_NAMED = 9
_LIMIT, _BAR = "#c0392b", "#1f5f99"


class Panel(NamedTuple):
    """One pair of axes.

    Attributes:
        title: what it shows; `unit` is that of its values.
        names: of the curves, one a column.
        curve: times (n,) and values (n, k), drawn as lines; None for none.
        marks: times and values drawn as dots.
        steps: the values hold until the next time.
        limits: bounds of the values.
    """

    title: str
    unit: str
    names: Sequence[str]
    curve: tuple[Array, Array] | None
    marks: tuple[Array, Array] | None = None
    steps: bool = False
    limits: Sequence[float] = ()


def panels(name: str, group: Group | None, pieces: Sequence[tuple[Array, Array]], unit: str = "") -> list[Panel]:
    """The panels of a leaf, from pieces of times (n,) and values (n, *shape) that follow each other.

    A pose becomes its position and its Euler angles, a rotation its Euler angles, in degrees and without jumps.
    """
    pieces = [(np.asarray(ts), np.asarray(values)) for ts, values in pieces]
    if group is None or group.flat or (len(group.parts) == 1 and not group.rigid):
        return [_entries(name, name, pieces, unit or "SI")]
    return [_of_part(name, part, [(ts, part.of(values)) for ts, values in pieces], unit) for part in group.parts]


def _entries(title: str, name: str, pieces: Sequence[tuple[Array, Array]], unit: str) -> Panel:
    shape = pieces[0][1].shape[1:] if pieces else ()
    names = [f"{name}[{', '.join(map(str, place))}]" for place in np.ndindex(*shape)] if shape else [name]
    return Panel(title, unit, names, _joined([(ts, v.reshape(len(v), -1)) for ts, v in pieces]))


def _of_part(name: str, part: ElementPart, pieces: Sequence[tuple[Array, Array]], unit: str) -> Panel:
    """The panel of a part of an element: of a rotation in degrees, of a position, or of entries."""
    title, shape = f"{part.name} of {name}", pieces[0][1].shape[1:] if pieces else ()
    if part.unit == "rad" and shape in ((3, 3), ()):
        return Panel(title, "deg", ["roll", "pitch", "yaw"], _joined([(ts, _angles(v)) for ts, v in pieces]))
    if part.sized and len(shape) == 1 and shape[0] <= 3:
        return Panel(title, unit or part.unit, list("xyz"[: shape[0]]), _joined(pieces))
    return _entries(title, f"{name}.{part.name}", pieces, part.unit or "SI")


def _joined(pieces: Sequence[tuple[Array, Array]]) -> tuple[Array, Array] | None:
    """One curve with gaps between the pieces."""
    if not pieces:
        return None
    gap = [(np.full(1, np.nan), np.full((1, values.shape[1]), np.nan)) for _, values in pieces]
    parts = [part for pair in zip(pieces, gap) for part in pair][:-1]
    return np.concatenate([ts for ts, _ in parts]), np.concatenate([values for _, values in parts])


def group_of(value: Array) -> Group | None:
    """SE3 or SO3 where all values are poses or rotations."""
    value = np.asarray(value)
    for group in (SE3, SO3):
        if value.shape[1:] == group.shape:
            R = value[:, :3, :3]
            turned = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max() < 1e-4 and (np.linalg.det(R) > 0).all()
            if turned and (group == SO3 or (value[:, 3] == [0.0, 0.0, 0.0, 1.0]).all()):
                return group
    return None


def _angles(values: Array) -> Array:
    angles = np.asarray(jax.vmap(euler)(values[:, :3, :3]))
    return np.rad2deg(np.unwrap(angles, axis=0))


def chosen(names: Sequence[str] | None, there: Sequence[str], units: Mapping[str, str] | None) -> list[str]:
    """The names to draw, all unless given. Raises InputError for one that is not there."""
    wrong = [name for name in [*(names or ()), *(units or {})] if name not in there]
    if wrong:
        raise InputError(f"plot: unknown name {wrong[0]!r}; there are: {listed(there, wrong[0])}")
    return list(there if names is None else names)


def draw(panels: Sequence[Panel], title: str = "", bars: Mapping[str, float] | None = None) -> Any:
    """A matplotlib figure of the panels over time, two in a row, and of bars by name in a last one.

    Raises:
        ModelError: matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise ModelError(f"plot needs matplotlib ({error}).\n  fix: pip install 'twistax[plot]'") from None
    count = len(panels) + bool(bars)
    across = min(2, count)
    rows = -(-count // across)
    figure = Figure(figsize=(5.5 * across, 2.4 * rows + 0.4), layout="constrained")
    places = list(np.ravel(figure.subplots(rows, across, squeeze=False)))
    for axes, panel in zip(places, panels):
        _draw(axes, panel)
    if bars:
        _draw_bars(places[len(panels)], bars)
    for axes in places[count:]:
        axes.remove()
    if title:
        figure.suptitle(title)
    return figure


def _draw(axes: Any, panel: Panel) -> None:
    for k, name in enumerate(panel.names):
        color = f"C{k % 10}"
        if panel.curve is not None:
            style = "steps-post" if panel.steps else "default"
            axes.plot(panel.curve[0], panel.curve[1][:, k], color=color, drawstyle=style, label=name, linewidth=1.2)
        if panel.marks is not None:
            label = name if panel.curve is None else None
            axes.plot(panel.marks[0], panel.marks[1][:, k], ".", color=color, markersize=5, label=label)
    for limit in panel.limits:
        axes.axhline(limit, color=_LIMIT, linestyle="--", linewidth=0.9)
    if 1 < len(panel.names) <= _NAMED:
        axes.legend(fontsize="x-small", ncols=3)
    axes.set_title(panel.title, fontsize="medium")
    axes.set_xlabel("time, s")
    axes.set_ylabel(panel.unit)
    axes.grid(alpha=0.25)


def _draw_bars(axes: Any, bars: Mapping[str, float]) -> None:
    names = list(bars)[::-1]
    axes.barh(names, [bars[name] for name in names], color=_BAR)
    axes.set_title("largest multipliers", fontsize="medium")
    axes.tick_params(axis="y", labelsize="x-small")
    axes.set_xlabel("objective over unit of the constraint")
