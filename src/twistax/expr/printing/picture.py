"""Expression graphs as SVG pictures. Shared parts are drawn once, with a line from each place that reads them."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

from ...errors import ModelError
from ..graph import Node, postorder

#: Larger graphs are no pictures.
_MOST = 300
#: Heights of boxes and rows, the width of a character, gaps between boxes, in pixels.
_BOX, _ROW, _CHARACTER, _GAP = 36, 64, 7.2, 16.0


class Picture(str):
    """The text of an SVG file. Notebooks display it; `path.write_text(picture)` saves it."""

    def _repr_svg_(self) -> str:
        return str(self)


def svg(roots: Mapping[str, Node]) -> Picture:
    """The graphs below roots, each root with its name; see `Expr.svg` and `System.svg`."""
    nodes = postorder(*roots.values())
    if len(nodes) > _MOST:
        raise ModelError(
            f"svg: {len(nodes):,} nodes are too many for a picture, at most {_MOST} are drawn.\n  fix: use tree()"
        )
    depth = {id(root): 0 for root in roots.values()}
    for node in reversed(nodes):  # parents before children
        for child in node.children():
            depth[id(child)] = max(depth.get(id(child), 0), depth[id(node)] + 1)
    names = {id(root): ", ".join(n for n, named in roots.items() if named is root and n) for root in roots.values()}
    texts = {id(node): _texts(node, names.get(id(node), "")) for node in nodes}
    width = {key: max(map(len, lines)) * _CHARACTER + 14 for key, lines in texts.items()}
    x = _places(nodes, depth, width)
    y = {key: _ROW * row + 4 for key, row in depth.items()}
    across = max(x[key] + width[key] for key in x) + 4
    down = _ROW * max(depth.values()) + _BOX + 8
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{across:.0f}" height="{down}" '
        f'viewBox="0 0 {across:.0f} {down}" font-family="monospace" font-size="12" text-anchor="middle">'
    ]
    for node in nodes:
        place = id(node)
        for child in node.children():
            begin, end = x[place] + width[place] / 2, x[id(child)] + width[id(child)] / 2
            lines.append(
                f'<line x1="{begin:.1f}" y1="{y[place] + _BOX}" x2="{end:.1f}" y2="{y[id(child)]}" stroke="#8a97a6"/>'
            )
    for node in nodes:
        place, fill = id(node), "#eaf1f8" if node.children() else "#f6efdf"
        middle = x[place] + width[place] / 2
        name, shape = texts[place]
        lines.append(
            f'<rect x="{x[place]:.1f}" y="{y[place]}" width="{width[place]:.1f}" height="{_BOX}" rx="5" fill="{fill}" '
            f'stroke="#37506b"/><text x="{middle:.1f}" y="{y[place] + 15}" fill="#1b2a3a">{escape(name)}</text>'
            f'<text x="{middle:.1f}" y="{y[place] + 30}" fill="#667788" font-size="10">{escape(shape)}</text>'
        )
    return Picture("\n".join([*lines, "</svg>"]))


def _texts(node: Node, label: str) -> tuple[str, str]:
    name = type(node).__name__ if node.children() else f"{type(node).__name__} {node.to_text()}"
    return _short(f"{label} = {name}" if label else name), str(node.check_shape())


def _short(text: str) -> str:
    return text if len(text) <= 28 else f"{text[:27]}…"


def _places(nodes: list[Node], depth: dict[int, int], width: dict[int, float]) -> dict[int, float]:
    """The left edges: a node above the middle of its children where that is free, else to the right of its row."""
    x: dict[int, float] = {}
    ends: dict[int, float] = {}
    for node in nodes:  # children before parents
        key, row = id(node), depth[id(node)]
        below = [x[id(child)] + width[id(child)] / 2 for child in node.children()]
        wanted = sum(below) / len(below) - width[key] / 2 if below else max(ends.values(), default=4.0 - _GAP) + _GAP
        x[key] = max(wanted, ends.get(row, 4.0 - _GAP) + _GAP)
        ends[row] = x[key] + width[key]
    return x
