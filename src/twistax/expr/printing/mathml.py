"""Conversion of the LaTeX of expressions to MathML, which browsers display without MathJax.

Source: MathML Core, https://www.w3.org/TR/mathml-core/.
"""

from __future__ import annotations

import dataclasses
import re
from html import escape

#: Commands that are signs.
_SIGNS = {
    "le": "≤", "ge": "≥", "lt": "<", "gt": ">", "ne": "≠", "cdot": "⋅", "cdots": "⋯", "times": "×", "in": "∈",
    "top": "⊤", "bot": "⊥", "wedge": "∧", "vee": "∨", "lnot": "¬", "land": "∧", "lor": "∨", "circ": "∘", "otimes": "⊗",
    "odot": "⊙", "sum": "∑", "infty": "∞", "to": "→", "pm": "±", "partial": "∂", "Omega": "Ω", "|": "‖", "{": "{",
    "}": "}", "%": "%", "&": "&", "#": "#", "_": "_",
}  # fmt: skip
_ACCENTS = {"dot": "˙", "ddot": "¨", "hat": "^", "bar": "¯", "tilde": "~"}
_ARGUMENTS = {"frac": 2, "sqrt": 1, **dict.fromkeys(_ACCENTS, 1)}
_BRACKETS = {"bmatrix": ("[", "]"), "pmatrix": ("(", ")"), "cases": ("{", ".")}
_TOKEN = re.compile(r"\\begin\{(\w+)\}|\\end\{\w+\}|\\([a-zA-Z]+|.)|(\d+(?:\.\d+)?)|(\S)")
#: Commands whose braces hold text.
_TEXT = ("mathrm", "operatorname", "text", "mathbf")


@dataclasses.dataclass
class _Part:
    """An open part: a group, the arguments of a command, a pair of fences or a table.

    Attributes:
        kind: the command, the environment, or nothing for a group.
        items: each with what stands below and above it on its right.
        opening: the left fence.
        rows: of a table, the cells that are complete.
        next_is: "_" or "^" before the next item.
    """

    kind: str = ""
    items: list[list[str]] = dataclasses.field(default_factory=list)
    opening: str = ""
    rows: list[list[str]] = dataclasses.field(default_factory=lambda: [[]])
    next_is: str = ""

    def row(self) -> str:
        return f"<mrow>{''.join(_scripted(*item) for item in self.items)}</mrow>"

    def end_cell(self) -> None:
        side = ("right", "left")[len(self.rows[-1]) % 2] if self.kind == "aligned" else "center"
        self.rows[-1].append(f'<mtd style="text-align: {side}">{self.row()}</mtd>')
        self.items = []


def mathml(latex: str) -> str:
    """A formula as a <math> element. Unknown commands are copied unchanged.

    A formula with unbalanced groups, fences or tables, for example from a user's node, is copied unchanged as a whole.
    """
    try:
        inside = _drawn(latex)
    except (IndexError, ValueError):
        inside = f"<mtext>{escape(latex)}</mtext>"
    return f'<math display="block" xmlns="http://www.w3.org/1998/Math/MathML">{inside}</math>'


def _drawn(latex: str) -> str:
    """What stands in the element. Raises IndexError or ValueError for what does not close."""
    open_parts = [_Part()]
    at = 0

    def add(item: str) -> None:
        """An item at the end of what is open, which may be the last argument of a command."""
        while True:
            part = open_parts[-1]
            if part.next_is and part.items:
                part.items[-1]["_^".index(part.next_is) + 1] = item
            else:
                part.items.append([item, "", ""])
            part.next_is = ""
            if len(part.items) != _ARGUMENTS.get(part.kind, -1):
                return
            item = _command(open_parts.pop())

    while token := _TOKEN.search(latex, at):
        at = token.end()
        environment, command, number, sign = token.groups()
        part = open_parts[-1]
        if environment or (command and command in _ARGUMENTS):
            open_parts.append(_Part(environment or command))
        elif token[0].startswith(r"\end{"):
            add(_table(open_parts.pop()))
        elif command in _TEXT:
            text, at = _braced(latex, at)
            add(f'<mi mathvariant="normal">{escape(text)}</mi>')
        elif command == "left":
            opening, at = _fence(latex, at)
            open_parts.append(_Part("left", opening=opening))
        elif command == "right":
            closing, at = _fence(latex, at)
            inside = open_parts.pop()
            add(f"<mrow>{_stretched(inside.opening)}{inside.row()}{_stretched(closing)}</mrow>")
        elif command == "\\":
            part.end_cell()
            part.rows.append([])
        elif sign == "&":
            part.end_cell()
        elif command in (",", ":", ";", " "):
            part.items.append(['<mspace width="0.17em"></mspace>', "", ""])
        elif command:
            known = _SIGNS.get(command)
            letter = f"<mi>{escape(command)}</mi>" if command.islower() else f"<mi>{escape(chr(92) + command)}</mi>"
            add(letter if known is None else f"<mo>{escape(known)}</mo>")
        elif number:
            add(f"<mn>{number}</mn>")
        elif sign == "{":
            open_parts.append(_Part())
        elif sign == "}":
            add(open_parts.pop().row())
        elif sign in "_^":
            part.next_is = sign
        else:
            add(f"<mi>{sign}</mi>" if sign.isalpha() else f"<mo>{'−' if sign == '-' else escape(sign)}</mo>")
    if len(open_parts) != 1:
        raise ValueError(f"{open_parts[-1].kind or 'a group'} is not closed")
    return open_parts[0].row()


def _scripted(base: str, below: str, above: str) -> str:
    if below and above:
        return f"<msubsup>{base}{below}{above}</msubsup>"
    if below:
        return f"<msub>{base}{below}</msub>"
    return f"<msup>{base}{above}</msup>" if above else base


def _command(part: _Part) -> str:
    arguments = "".join(_scripted(*item) for item in part.items)
    if part.kind in _ACCENTS:
        return f'<mover accent="true">{arguments}<mo>{_ACCENTS[part.kind]}</mo></mover>'
    return f"<m{part.kind}>{arguments}</m{part.kind}>"


def _table(part: _Part) -> str:
    part.end_cell()
    rows = "".join(f"<mtr>{''.join(cells)}</mtr>" for cells in part.rows)
    opening, closing = _BRACKETS.get(part.kind, (".", "."))
    aligned = ' displaystyle="true"' if part.kind == "aligned" else ""
    return f"<mrow>{_stretched(opening)}<mtable{aligned}>{rows}</mtable>{_stretched(closing)}</mrow>"


def _stretched(fence: str) -> str:
    return "" if fence == "." else f'<mo stretchy="true">{escape(fence)}</mo>'


def _fence(latex: str, at: int) -> tuple[str, int]:
    """What follows \\left or \\right, and where it ends."""
    token = _TOKEN.search(latex, at)
    if token is None:
        raise ValueError("a fence is missing")
    return _SIGNS.get(token[2], token[2]) if token[2] else token[0], token.end()


def _braced(latex: str, at: int) -> tuple[str, int]:
    """The text between the braces that open at a place, and where they end."""
    start, depth, at = at + 1, 1, at + 1
    while depth and at < len(latex):
        depth += {"{": 1, "}": -1}.get(latex[at], 0)
        at += 2 if latex[at] == "\\" else 1
    return re.sub(r"\\(.)", r"\1", latex[start : at - 1]), at
