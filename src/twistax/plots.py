"""Plots of values over time, by matplotlib (extra `plot`), which is imported when something is drawn."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from numpy import ndarray as Array

from .checks import listed
from .errors import InputError, ModelError
from .groups import SE3, SO3, ElementPart, Group, euler
from .progress import watching

#: A panel with more curves than this has no legend.
_NAMED = 12
#: From a unit to one that a user may ask for.
_FACTORS = {
    ("rad", "deg"): 180.0 / np.pi,
    ("rad/s", "deg/s"): 180.0 / np.pi,
    ("rad/s", "rpm"): 30.0 / np.pi,
    ("m", "mm"): 1e3,
    ("m", "km"): 1e-3,
    ("m/s", "km/h"): 3.6,
}
_LIMIT, _BAR = "#c0392b", "#1f5f99"


#: By name of a leaf, pairs of name and unit of its entries.
Labels: TypeAlias = Mapping[str, Sequence[tuple[str, str]]]


class Panel(NamedTuple):
    """One pair of axes of a plot.

    Attributes:
        title, unit: its title, and the unit of its values.
        names: the names of the curves, one for each column.
        curve: times (n,) and values (n, k), drawn as lines; None for no curve.
        marks: times and values drawn as dots.
        steps: whether values are constant until the next time.
        limits: bounds of the values.
        columns, factor: the entries of a leaf that it shows, None for all; and the factor of a unit conversion.
    """

    title: str
    unit: str
    names: Sequence[str]
    curve: tuple[Array, Array] | None
    marks: tuple[Array, Array] | None = None
    steps: bool = False
    limits: Sequence[float] = ()
    columns: Sequence[int] | None = None
    factor: float = 1.0


def panels(
    name: str,
    group: Group | None,
    pieces: Sequence[tuple[Array, Array]],
    unit: str = "",
    labels: Sequence[tuple[str, str]] = (),
) -> list[Panel]:
    """The panels of a leaf, from consecutive pieces of times (n,) and values (n, *shape).

    A pose becomes its position and its Euler angles, a rotation its Euler angles, in degrees and without jumps. Entries
    with labels, pairs of name and unit, become a panel for each unit; `unit` converts units that it supports. A unit
    such as "m/s, rad/s" has one unit for each half of the entries.
    """
    pieces = [(np.asarray(ts), np.asarray(values)) for ts, values in pieces]
    units, size = unit.split(", "), pieces[0][1][0].size if pieces and len(pieces[0][1]) else 0
    if (group is None or group.flat) and len(units) > 1 and size and size % len(units) == 0:
        labels = labels or [(f"{name}[{k}]", units[k * len(units) // size]) for k in range(size)]
        unit = ""
    if labels and pieces:
        return _labelled(name, [(ts, v.reshape(len(v), -1)) for ts, v in pieces], unit, labels)
    if group is None or group.flat or (len(group.parts) == 1 and not group.rigid):
        return [_entries(name, name, pieces, unit or "SI")]
    return [_of_part(name, part, [(ts, part.of(values)) for ts, values in pieces], unit) for part in group.parts]


def _labelled(
    name: str, pieces: Sequence[tuple[Array, Array]], unit: str, labels: Sequence[tuple[str, str]]
) -> list[Panel]:
    """A panel for each unit of the entries."""
    by_unit: dict[str, list[int]] = {}
    for column, (_, label_unit) in enumerate(labels):
        by_unit.setdefault(label_unit, []).append(column)
    if unit and unit not in by_unit and not any((label_unit, unit) in _FACTORS for label_unit in by_unit):
        known = [to for start, to in _FACTORS if start in by_unit]
        raise InputError(
            f"plot: {name!r} is in {' and '.join(by_unit)}, which is not converted to {unit!r}; it expects "
            f"{listed([*by_unit, *known], unit)}"
        )
    drawn = []
    for label_unit, columns in by_unit.items():
        shown, factor = (unit, _FACTORS[label_unit, unit]) if (label_unit, unit) in _FACTORS else (label_unit, 1.0)
        curve = _joined([(ts, factor * values[:, columns]) for ts, values in pieces])
        title = name if len(by_unit) == 1 else f"{name}, {shown}"
        drawn.append(Panel(title, shown, [labels[i][0] for i in columns], curve, columns=columns, factor=factor))
    return drawn


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
    """SE3 or SO3 if all values are poses or rotations."""
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


def chosen(names: Sequence[Any], there: Iterable[str], units: Mapping[str, str] | None) -> list[str]:
    """The names that were passed to a plot: strings or leaves, or one sequence of them; empty for all.

    Raises:
        InputError: an unknown name.
    """
    several = (
        names[0] if len(names) == 1 and isinstance(names[0], Sequence) and not isinstance(names[0], str) else names
    )
    wanted = [str(getattr(name, "name", name)) for name in several]
    known = list(dict.fromkeys(there))
    wrong = [name for name in [*wanted, *(units or {})] if name not in known]
    if wrong:
        raise InputError(f"plot: unknown name {wrong[0]!r}; there are: {listed(known, str(wrong[0]))}")
    return wanted


class Pictured(NamedTuple):
    """The quantities that a plot may show: values over time by name, and names and units of their entries.

    Attributes:
        shown: the names of the leaves that are drawn by default.
        more: the names of outputs.
        pieces: a function from a name to its pieces of times and values.
        labels: by name of a leaf, pairs of name and unit; the name of a joint draws all entries with that name.
        units: the units that the user requests, by name.
        declared: labels of leaves without joints, from their declared units.
    """

    shown: Sequence[str]
    more: Sequence[str]
    pieces: Callable[[str], Sequence[tuple[Array, Array]]]
    labels: Labels
    units: Mapping[str, str] | None
    declared: Labels

    def panels(self, names: Sequence[Any]) -> list[Panel]:
        """The panels of the names that were passed to a plot. Raises InputError for an unknown one."""
        joints = joints_of(self.labels, self.shown)
        wanted = chosen(names, [*self.shown, *self.more, *joints], self.units) or list(self.shown)
        return [panel for name in wanted for panel in self._of(name, joints.get(name))]

    def _of(self, name: str, columns: Mapping[str, list[int]] | None) -> list[Panel]:
        units = self.units or {}
        if columns is None:
            pieces = self.pieces(name)
            group = group_of(pieces[0][1]) if pieces else None
            labels = self.labels.get(name) or self.declared.get(name, ())
            return panels(name, group, pieces, units.get(name, ""), labels)
        drawn = []
        for leaf, entries in columns.items():
            pieces = [(ts, np.asarray(values).reshape(len(ts), -1)[:, entries]) for ts, values in self.pieces(leaf)]
            some = [self.labels[leaf][i] for i in entries]
            unit = units.get(name, units.get(leaf, ""))
            converted = any((label_unit, unit) in _FACTORS for _, label_unit in some)  # q in deg, and not qd
            drawn += panels(f"{leaf} of {name}", None, pieces, unit if converted else "", some)
        return drawn


def joints_of(labels: Labels, leaves: Iterable[str]) -> dict[str, dict[str, list[int]]]:
    """For each joint in the labels, its entries by leaf; a joint with several degrees of freedom counts as one."""
    joints: dict[str, dict[str, list[int]]] = {}
    for leaf in leaves:
        for column, (label, _) in enumerate(labels.get(leaf, ())):
            for name in {label, label.rpartition(" ")[0] or label}:
                joints.setdefault(name, {}).setdefault(leaf, []).append(column)
    return joints


@watching("plot")
def draw(
    panels: Sequence[Panel], title: str = "", bars: Mapping[str, float] | None = None, over: str = "time, s"
) -> Any:
    """A matplotlib figure of the panels over time, two in a row, and of bars by name in the last panel.

    Args:
        over: the label of the horizontal axis.

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
        _draw(axes, panel, over)
    if bars:
        _draw_bars(places[len(panels)], bars)
    for axes in places[count:]:
        axes.remove()
    if title:
        figure.suptitle(textwrap.fill(title, 50 * across), fontsize="medium")
    return figure


def _draw(axes: Any, panel: Panel, over: str) -> None:
    for k, name in enumerate(panel.names):
        color = f"C{k % 10}"
        if panel.curve is not None:
            style = "steps-post" if panel.steps else "default"
            axes.plot(panel.curve[0], panel.curve[1][:, k], color=color, drawstyle=style, label=name, linewidth=1.2)
        if panel.marks is not None:
            label = name if panel.curve is None else None
            axes.plot(panel.marks[0], panel.marks[1][:, k], ".", color=color, markersize=5, label=label)
    values = ", ".join(f"{limit:.6g}" for limit in panel.limits)
    named = textwrap.fill(f"limit{'s' if len(panel.limits) > 1 else ''} {values}", 20)
    for number, limit in enumerate(panel.limits):
        axes.axhline(limit, color=_LIMIT, linestyle="--", linewidth=0.9, label=None if number else named)
    if 1 < len(panel.names) + bool(panel.limits) <= _NAMED:
        # Beside the axes: no curve is hidden.
        axes.legend(fontsize="x-small", loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    axes.set_title(panel.title, fontsize="medium")
    axes.set_xlabel(over)
    axes.set_ylabel(panel.unit)
    axes.grid(alpha=0.25)


def _draw_bars(axes: Any, bars: Mapping[str, float]) -> None:
    names = list(bars)[::-1]
    axes.barh(range(len(names)), [bars[name] for name in names], color=_BAR)
    axes.set_yticks(range(len(names)), [textwrap.fill(name, 24) for name in names])
    axes.set_title("largest multipliers", fontsize="medium")
    axes.tick_params(axis="y", labelsize="x-small")
    axes.set_xlabel("objective over unit of the constraint")
