"""Error against run time of one scene, both on logarithmic scales.

Needs matplotlib, the extra `plot`; imported when a figure is drawn.
"""

from __future__ import annotations

import io
from typing import Any

from .findings import TARGETS, Findings

__all__ = ["as_svg", "draw"]


def draw(findings: Findings, scene: str, title: str) -> bytes:
    """The figure of a scene as SVG: all flights of the lines that are drawn, the best of each line connected.

    Raises:
        ImportError: matplotlib is not installed.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 5.6), layout="constrained")
    axes = figure.add_subplot()
    for line in findings.drawn(scene):
        rows = [row for row in findings.curve(scene, line).rows if row.error > 0.0]
        colour, dash, marker = line.style
        best = ([row.error for row in rows], [1e3 * row.seconds for row in rows])
        axes.loglog(*best, color=colour, ls=dash, marker=marker, ms=4.5, lw=1.5, label=line.title)
    for target in TARGETS:
        axes.axvline(target, color="0.6", lw=0.8, ls="--", zorder=0)
    axes.set_xlim(1e-1, 1e-13)
    axes.set_xlabel("error at the end (to the right: more accurate)", fontsize=11)
    axes.set_ylabel("time of one flight, ms (lower: faster)", fontsize=11)
    axes.set_title(title, fontsize=13, loc="left")
    axes.grid(alpha=0.25)
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", ncols=2, fontsize=10, frameon=False)
    return as_svg(figure)


def as_svg(figure: Any) -> bytes:
    """A matplotlib figure as SVG: text stays text, and the same data gives the same file."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    out = io.BytesIO()
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "twistax", "font.family": "sans-serif"}):
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None})
    return out.getvalue()
