"""The rows of a section that have a place, both axes logarithmic. Needs matplotlib, imported when a figure is drawn."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..work_precision.figure import as_svg
from .outcome import Outcome

__all__ = ["draw"]

#: Numbers of zero are drawn here.
_FLOOR = 1e-17


def draw(outcomes: Sequence[Outcome]) -> bytes | None:
    """The figure of one section as SVG, a cross at the upper edge where a flight ended early; None without places.

    Raises:
        ImportError: matplotlib is not installed.
    """
    placed = [each for each in outcomes if each.row.place is not None]
    axes_labels = outcomes[0].section.axes if outcomes else None
    if not placed or axes_labels is None:
        return None
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    lines = list(dict.fromkeys(each.row.place.line for each in placed if each.row.place))
    numbers = [each.found.number for each in placed if math.isfinite(each.found.number)]
    top = 10.0 * max([*numbers, _FLOOR])
    for number, line in enumerate(lines):
        on_line = [(each.row.place.x, each.found) for each in placed if each.row.place and each.row.place.line == line]
        colour, marker = f"C{number % 10}", "osD^vP<>X*"[number % 10]
        good = [(x, max(found.number, _FLOOR)) for x, found in on_line if math.isfinite(found.number)]
        ended = [x for x, found in on_line if not math.isfinite(found.number)]
        axes.loglog(*zip(*good, strict=True), color=colour, marker=marker, ms=4.5, lw=1.5, label=line) if good else None
        if ended:
            label = None if good else line
            axes.loglog(ended, [top] * len(ended), color=colour, marker="x", ms=8, ls="", label=label)
    if any(not math.isfinite(each.found.number) for each in placed):
        axes.text(0.01, 0.985, "x: ends by name", transform=axes.transAxes, ha="left", va="top", fontsize=9)
    axes.set_xlabel(axes_labels[0], fontsize=11)
    axes.set_ylabel(axes_labels[1], fontsize=11)
    axes.set_title(outcomes[0].section.title, fontsize=13, loc="left")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, fontsize=9, frameon=False)
    return as_svg(figure)
