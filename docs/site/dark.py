"""Figures twice: as they are, and for pages on a dark ground, as NAME.dark.png beside NAME.png.

Black, white and greys change places, and colours stay: curves have the same colour in both.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

#: How far the channels of a grey may be apart.
GREY = 0.06
#: The ground of the dark theme, and the brightest text on it; white and black become these.
GROUND, TEXT = np.array([0.075, 0.078, 0.086]), 0.85


def dark_name(path: str | Path) -> Path:
    return Path(path).with_suffix(f".dark{Path(path).suffix}")


def save_figures_twice() -> None:
    """From now on each figure that is saved as PNG is saved in dark colours, too. Without matplotlib none is."""
    try:
        from matplotlib.figure import Figure
    except ImportError:
        return
    save: Callable[..., Any] = Figure.savefig

    def twice(figure: Any, path: Any, *arguments: Any, **options: Any) -> None:
        save(figure, path, *arguments, **options)
        if isinstance(path, (str, Path)) and str(path).endswith(".png"):
            before = list(_colors(figure))
            for artist, name, color in before:
                getattr(artist, f"set_{name}")(swapped(color))
            layout = figure.get_layout_engine()
            figure.set_layout_engine("none")  # its parts stand where they are: to place them takes half of the time
            save(figure, dark_name(path), *arguments, **options)
            figure.set_layout_engine(layout)
            for artist, name, color in before:
                getattr(artist, f"set_{name}")(color)

    Figure.savefig = twice


def _colors(figure: Any) -> Iterator[tuple[Any, str, Any]]:
    """The colours of all parts of a figure. Images and colour maps keep theirs."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.text import Text

    faces = ("facecolor", "edgecolor")
    lines = ("color", "markerfacecolor", "markeredgecolor")
    kinds = {Text: ("color",), Line2D: lines, Patch: faces, Collection: faces}
    for artist in figure.findobj():
        names = next((names for kind, names in kinds.items() if isinstance(artist, kind)), ())
        if isinstance(artist, Collection) and artist.get_array() is not None:
            continue
        for name in names:
            yield artist, name, getattr(artist, f"get_{name}")()


def swapped(color: Any) -> Any:
    """A colour, or several, with greys from white to black as those from the dark ground to its text."""
    from matplotlib.colors import to_rgba_array

    if isinstance(color, str) and color in ("none", "auto"):
        return color
    rgba = to_rgba_array(color)
    if not len(rgba):
        return color
    grey = np.ptp(rgba[:, :3], axis=1) < GREY
    light = rgba[:, :3].mean(axis=1, keepdims=True)
    rgba[:, :3] = np.where(grey[:, None], TEXT + light * (GROUND - TEXT), rgba[:, :3])
    return rgba if np.ndim(color) == 2 else tuple(rgba[0])
