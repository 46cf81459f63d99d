"""Times of one quantity, a panel for each case. Needs matplotlib, the extra `plot`; imported when a figure is drawn."""

from __future__ import annotations

from collections.abc import Sequence

from ..work_precision.figure import as_svg
from .case import CASES
from .contenders import CONTENDERS
from .quantity import Quantity
from .row import Row

__all__ = ["draw"]


def draw(rows: Sequence[Row], quantity: Quantity) -> bytes | None:
    """The figure as SVG; dots at the median, lines between the quartiles. None where nothing was timed.

    Raises:
        ImportError: matplotlib is not installed.
    """
    timed = [row for row in rows if row.quantity == quantity.name and row.done]
    if not timed:
        return None
    from matplotlib.figure import Figure

    cases = [case for name, case in CASES.items() if any(row.case == name for row in timed)]
    uses = list(dict.fromkeys(row.use for row in timed))
    shown = [each for each in CONTENDERS if any(row.contender == each.name for row in timed)]
    figure = Figure(figsize=(7.4, 0.9 + len(cases) * (0.5 + 0.33 * len(uses))), layout="constrained")
    panels = figure.subplots(len(cases), 1, sharex=True, squeeze=False)[:, 0]
    for axes, case in zip(panels, cases, strict=True):
        for place, use in enumerate(uses):
            for number, contender in enumerate(shown):
                height = place + 0.7 * ((number + 0.5) / len(shown) - 0.5)
                for row in timed:
                    if (row.case, row.use, row.contender) == (case.name, use, contender.name):
                        style = {"color": contender.colour, "lw": 2.0}
                        axes.plot([1e6 * row.lower, 1e6 * row.upper], [height, height], **style)
                        axes.plot([1e6 * row.median], [height], marker="o", ms=5, ls="", color=contender.colour)
        axes.set_xscale("log")
        axes.set_yticks(range(len(uses)), uses)
        axes.invert_yaxis()
        axes.set_title(case.title, fontsize=11, loc="left")
        axes.grid(axis="x", alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    panels[-1].set_xlabel("time of one evaluation, us (to the left: faster)", fontsize=11)
    handles = [panels[0].plot([], [], marker="o", ls="", color=each.colour, label=each.name)[0] for each in shown]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, fontsize=10, frameon=False)
    return as_svg(figure)
