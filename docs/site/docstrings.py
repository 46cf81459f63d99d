"""Our docstrings as reStructuredText: plain sentences, indented code, and sections such as `Args:` and `Raises:`."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence

from formulas import to_latex

SECTIONS = {"Args": "Arguments", "Attributes": "Attributes", "Raises": "Raises", "Returns": "Returns"}
_HEAD = re.compile(rf"({'|'.join(SECTIONS)}):(?: (.*))?$")
_ITEM = re.compile(r"([*\w`.]+(?:, [*\w`.]+)*): (.*)$")

#: From the text between backticks to reStructuredText.
Link = Callable[[str], str]


def to_rst(lines: Sequence[str], link: Link) -> list[str]:
    """A docstring, its indentation taken off, with what stands in backticks as `link` has it."""
    written: list[str] = []
    rest = list(lines)
    while rest:
        head = _HEAD.match(rest[0])
        if head:
            first = [head[2]] if head[2] else []
            block, rest = _until(rest[1:], lambda line: bool(line.strip()) and not line.startswith(" "))
            written += _section(head[1], first + _dedented(block), link)
        elif rest[0].startswith("    "):
            block, rest = _until(rest, lambda line: bool(line.strip()) and not line.startswith("    "))
            formula = " ".join(" ".join(block).split())
            marked = re.fullmatch(r"\$([^$]+)\$[.,]?", formula)
            written += [f".. math:: {to_latex(marked[1])}", ""] if marked else ["::", "", *block, ""]
        else:
            block, rest = _until(rest, lambda line: bool(_HEAD.match(line)) or line.startswith("    "), least=1)
            written += [*_text(block, link), ""]
    return written


def _until(lines: list[str], ends: Callable[[str], bool], least: int = 0) -> tuple[list[str], list[str]]:
    """The lines before the first one that ends a block, and those from there on."""
    count = next((i for i, line in enumerate(lines) if i >= least and ends(line)), len(lines))
    return lines[:count], lines[count:]


def _dedented(lines: list[str]) -> list[str]:
    return [line.removeprefix("    ") for line in lines]


def _section(name: str, lines: list[str], link: Link) -> list[str]:
    """A field with a list of what its lines name, or with their text."""
    items: list[tuple[str, list[str]]] = []
    for line in lines:
        item = None if line.startswith(" ") else _ITEM.match(line)
        if item:
            items.append((item[1], [item[2]]))
        elif items:
            items[-1][1].append(line.strip())
        else:
            items.append(("", [line]))
    written = [f":{SECTIONS[name]}:"]
    for names, text in items:
        if names:
            # Names of arguments are no names of ours; those of errors are.
            write = link if name == "Raises" else "``{}``".format
            parts = ", ".join(write(part.strip("`")) for part in names.split(", "))
            written.append(f"    - {parts}: {' '.join(_text(text, link))}".rstrip())
        else:
            written += [f"    {line}" for line in _text(text, link)]
            written.append("")
    return [*written, ""]


def _text(lines: list[str], link: Link) -> list[str]:
    """Sentences; code in backticks and formulas between dollars may go on over a line's end."""
    errors_too = re.sub(r"(?<![\w`.])(\w+Error)\b(?!`)", r"`\1`", "\n".join(lines))
    parts = re.split(r"(`[^`]+`|\$[^$]+\$)", errors_too)
    for i, part in enumerate(parts):
        own = " ".join(part[1:-1].split())
        if i % 2:
            parts[i] = link(own) if part[0] == "`" else f":math:`{to_latex(own)}`"
        else:
            parts[i] = re.sub(r"([\\*_|])", r"\\\1", part)
    text = ""
    for i, part in enumerate(parts):
        # A role needs white space or punctuation on both sides.
        glued = i % 2 and text and (text[-1].isalnum() or text[-1] in "=^")
        text += ("\\ " if glued else "") + part
        if i % 2 and i + 1 < len(parts) and parts[i + 1][:1].isalnum():
            text += "\\ "
    return text.split("\n")
