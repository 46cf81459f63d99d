"""A page as a list of blocks, written as Markdown or as HTML.

Text may hold `code` and **strong** words.
"""

from __future__ import annotations

import base64
import dataclasses
import html
import re
from abc import ABC, abstractmethod
from collections.abc import Sequence

__all__ = ["Block", "Bullets", "Details", "Figure", "Heading", "Paragraph", "Table", "as_html", "as_markdown"]


class Block(ABC):
    """One part of a page."""

    @abstractmethod
    def markdown(self) -> str:
        """As Markdown, without a newline at the end."""

    @abstractmethod
    def html(self) -> str:
        """As HTML."""


@dataclasses.dataclass(frozen=True)
class Heading(Block):
    level: int
    text: str

    def markdown(self) -> str:
        return f"{'#' * self.level} {self.text}"

    def html(self) -> str:
        return f"<h{self.level}>{_inline(self.text)}</h{self.level}>"


@dataclasses.dataclass(frozen=True)
class Paragraph(Block):
    text: str

    def markdown(self) -> str:
        return self.text

    def html(self) -> str:
        return f"<p>{_inline(self.text)}</p>"


@dataclasses.dataclass(frozen=True)
class Bullets(Block):
    items: Sequence[str]

    def markdown(self) -> str:
        return "\n".join(f"- {item}" for item in self.items)

    def html(self) -> str:
        return "<ul>\n" + "\n".join(f"<li>{_inline(item)}</li>" for item in self.items) + "\n</ul>"


@dataclasses.dataclass(frozen=True)
class Table(Block):
    """The first `words` columns are set to the left, the others, numbers, to the right."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: int = 1

    def markdown(self) -> str:
        rule = ["---" if column < self.words else "---:" for column in range(len(self.head))]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in (self.head, rule, *self.rows))

    def html(self) -> str:
        head = self._row("th", self.head)
        body = "\n".join(self._row("td", row) for row in self.rows)
        return f'<div class="wide"><table>\n<thead>{head}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>'

    def _row(self, tag: str, cells: Sequence[str]) -> str:
        kinds = (' class="word"' if column < self.words else "" for column in range(len(cells)))
        return f"<tr>{''.join(f'<{tag}{kind}>{_inline(cell)}</{tag}>' for cell, kind in zip(cells, kinds))}</tr>"


@dataclasses.dataclass(frozen=True)
class Figure(Block):
    """An SVG picture, beside the Markdown page under `path`, inside of the HTML page."""

    path: str
    svg: bytes
    alt: str

    def markdown(self) -> str:
        return f"![{self.alt}]({self.path})"

    def html(self) -> str:
        picture = base64.b64encode(self.svg).decode()
        return f'<img alt="{html.escape(self.alt)}" src="data:image/svg+xml;base64,{picture}">'


@dataclasses.dataclass(frozen=True)
class Details(Block):
    """Folded up until it is clicked."""

    summary: str
    blocks: Sequence[Block]

    def markdown(self) -> str:
        inner = "\n\n".join(block.markdown() for block in self.blocks)
        return f"<details><summary>{_inline(self.summary)}</summary>\n\n{inner}\n\n</details>"

    def html(self) -> str:
        inner = "\n".join(block.html() for block in self.blocks)
        return f"<details><summary>{_inline(self.summary)}</summary>\n{inner}\n</details>"


def as_markdown(blocks: Sequence[Block]) -> str:
    """The page as Markdown."""
    return "\n\n".join(block.markdown() for block in blocks) + "\n"


def as_html(title: str, blocks: Sequence[Block]) -> str:
    """The page as one HTML file that needs no other."""
    body = "\n".join(block.html() for block in blocks)
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{html.escape(title)}</title>\n<style>{_STYLE}</style>\n</head>\n<body>\n{body}\n</body>\n</html>\n"
    )


_STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1b2a3a; background: #fff; }
body { margin: 0 auto; max-width: 52rem; padding: 1rem; }
h1, h2, h3 { line-height: 1.2; margin: 2rem 0 .6rem; }
h1 { margin-top: .5rem; }
code { font-size: .9em; background: #f1f4f7; padding: .1em .25em; border-radius: 3px; overflow-wrap: anywhere; }
img { display: block; width: 100%; height: auto; }
.wide { overflow-x: auto; margin: .8rem 0; }
table { border-collapse: collapse; font-size: .88rem; }
th, td { padding: .25rem .6rem; border-bottom: 1px solid #d8dfe6; text-align: right; }
.word { text-align: left; }
details { margin: .8rem 0; }
summary { cursor: pointer; color: #1f5f99; }
li { margin: .3rem 0; }
"""


def _inline(text: str) -> str:
    escaped = html.escape(text, quote=False)
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)
