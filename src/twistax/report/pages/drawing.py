"""The one style of figures. Needs matplotlib, the extra `plot`."""

from __future__ import annotations

import io
from typing import Any

__all__ = ["as_svg", "panels"]


def panels(title: str, labels: tuple[str, str], size: tuple[float, float] = (7.0, 5.0), count: int = 1) -> Any:
    """A figure with panels below each other, which share the label of x.

    Raises:
        ImportError: matplotlib is not installed.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    for axes in figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]:
        axes.grid(alpha=0.25)
        axes.set_ylabel(labels[1], fontsize=11)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_title(title, fontsize=13, loc="left")
    figure.axes[-1].set_xlabel(labels[0], fontsize=11)
    return figure


def as_svg(figure: Any, columns: int = 2) -> bytes:
    """The figure with its legend below, as SVG: text stays text, and the same data gives the same file."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    out = io.BytesIO()
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "twistax", "font.family": "sans-serif"}):
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None})
    return out.getvalue()
