"""The printed forms of a node: one line of text, LaTeX, a tree and a picture."""

from __future__ import annotations

import re
from typing import Any, ClassVar

from .mathml import mathml
from .picture import Picture, svg
from .text import render, tree, wrap_latex


class Printed:
    """Base class of nodes: their printed forms."""

    #: Name used in repr, trees and messages; the class name unless a node says otherwise.
    label: ClassVar[str] = "Expr"
    #: The operator between the operands in texts; none for functions.
    infix: ClassVar[str] = ""
    #: The function's name in formulas; the label in upright letters unless a node says otherwise.
    latex_name: ClassVar[str] = ""
    #: The formula, with <i> for operand i and <i:p> for it in parentheses where it binds weaker than p.
    formula: ClassVar[str] = ""
    #: Binding strength in printed formulas: 100 binds tightest (names, functions).
    precedence: ClassVar[int] = 100

    def details(self: Any) -> list[str]:
        """The static fields that texts and trees show: those that differ from their defaults."""
        return [f"{f.name}={getattr(self, f.name)!r}" for f in self._fields if f.shown(getattr(self, f.name))]

    def to_text(self: Any, *operands: str) -> str:
        """The text of the node in one line, from the operands' texts."""
        if self.infix:
            return f"({f' {self.infix} '.join(operands)})"
        return f"{self.label}({', '.join([*operands, *self.details()])})"

    def to_latex(self: Any, *operands: str) -> str:
        """The LaTeX of the node, from the operands' LaTeX."""
        if self.formula:
            children = self.children()
            return re.sub(
                r"<(\d)(?::(\d+))?>",
                lambda at: wrap_latex(children[int(at[1])], operands[int(at[1])], int(at[2] or 0)),
                self.formula,
            )
        name = self.latex_name or rf"\operatorname{{{self.label}}}".replace("_", r"\_")
        return rf"{name}\left({', '.join(operands)}\right)"

    def __repr__(self: Any) -> str:
        return render(self, "to_text", "...")

    def _repr_latex_(self: Any) -> str:
        return f"${self.latex()}$"

    def _repr_html_(self: Any) -> str:
        return mathml(self.latex())

    def latex(self: Any) -> str:
        """The formula in LaTeX, without dollar signs."""
        return render(self, "to_latex", r"\cdots")

    def tree(self: Any) -> str:
        """The tree as text, one line for each node; shared subtrees are printed once."""
        return tree(self)

    def svg(self: Any) -> Picture:
        """The graph as a picture, the text of an SVG file, which notebooks display; shared parts are drawn once.

        Raises: ModelError for more than 300 nodes.
        """
        return svg({"": self})
