"""The text, LaTeX and tree of expressions. Shared parts of large graphs are shown once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..graph import Node, postorder

#: Above this many nodes (shared parts counted as often as they are printed) only the top of a graph is printed, and of
#: a node with more operands only the first ones.
_LONGEST = 400
#: A tree is printed to this depth, and so many lines of it.
_DEEPEST, _MOST_LINES = 60, 2000


def wrap(node: Node, text: str, level: int) -> str:
    """Parentheses around an operand that binds more weakly than its position requires."""
    return text if node.precedence >= level else f"({text})"


def wrap_latex(node: Node, text: str, level: int) -> str:
    """As `wrap`, with growing parentheses, also around negative numbers that are not terms of a sum."""
    plain = node.precedence >= level and not (text.startswith("-") and level > 10)
    return text if plain else rf"\left({text}\right)"


def number_latex(value: Any, digits: int = 6) -> str:
    """A number in the usual notation."""
    if isinstance(value, (bool, np.bool_)):
        return r"\top" if value else r"\bot"
    text = f"{value:.{digits}g}".replace("inf", r"\infty").replace("nan", r"\mathrm{nan}")
    mantissa, _, exponent = text.partition("e")
    if not exponent:
        return text
    power = rf"10^{{{int(exponent)}}}"
    return power if mantissa == "1" else rf"{mantissa} \times {power}"


def name_latex(name: str) -> str:
    """A name; the part after its first underscore is a subscript."""
    head, _, tail = name.partition("_")
    symbol = head if len(head) == 1 else rf"\mathrm{{{head}}}"
    tail = tail.replace("_", r"\_")
    return f"{symbol}_{{\\mathrm{{{tail}}}}}" if tail else symbol


def matrix_latex(rows: Sequence[Sequence[str]]) -> str:
    """Entries between brackets."""
    body = r" \\ ".join(" & ".join(row) for row in rows)
    return rf"\begin{{bmatrix}} {body} \end{{bmatrix}}"


def render(root: Node, method: str, ellipsis: str) -> str:
    """The text or LaTeX of a graph, by the method `to_text` or `to_latex` of its nodes."""
    sizes: dict[int, int] = {}  # how many nodes each subtree prints, shared parts counted every time
    done: dict[int, str] = {}
    for node in postorder(root):
        below = node.children()
        sizes[id(node)] = 1 + sum(sizes[id(child)] for child in below)
        texts = [done[id(child)] if sizes[id(child)] <= _LONGEST else ellipsis for child in below[:_LONGEST]]
        texts += [ellipsis] * (len(below) > _LONGEST)
        done[id(node)] = getattr(node, method)(*texts)
    return done[id(root)]


def tree(root: Node) -> str:
    """A line for each node with its shape; a repeated part is shown as a reference to its first occurrence."""
    lines: list[str] = []
    numbers: dict[int, int] = {}
    stack: list[tuple[Node, str, str, str]] = [(root, "", "", "")]
    while stack and len(lines) < _MOST_LINES:
        node, field, lead, indent = stack.pop()
        name = f"{field}: " if field else ""
        if id(node) in numbers and node.children():
            lines.append(f"{lead}{name}{type(node).__name__} (line {numbers[id(node)]})")
            continue
        numbers[id(node)] = len(lines) + 1
        head = " ".join([type(node).__name__, *(node.details() if node.children() else [node.to_text()])])
        try:
            lines.append(f"{lead}{name}{head} {node.check_shape()}")
        except ValueError:
            lines.append(f"{lead}{name}{head} (shape does not fit)")
        below = node.outline()
        if len(indent) >= 3 * _DEEPEST and below:
            lines[-1] += " ..."
            continue
        for i, (child_name, child) in reversed(list(enumerate(below))):
            last = i == len(below) - 1
            stack.append((child, child_name, indent + ("└─ " if last else "├─ "), indent + ("   " if last else "│  ")))
    return "\n".join([*lines, f"... ({len(postorder(root)):,} nodes in all)"] if stack else lines)
