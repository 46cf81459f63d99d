"""Pages as Markdown and as HTML, each written once as a template."""

from __future__ import annotations

import base64
import html
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from ..rows import Row, number

__all__ = ["MISSING", "Picture", "bar_table", "duration", "render", "renew", "section_table"]

#: Said where the template engine is not installed.
MISSING = "the report needs jinja2, which is not installed; fix: pip install 'twistax[report]'"

Table = tuple[list[str], list[list[str]], int]


class Picture:
    """An SVG: beside the Markdown page under `path`, inside of the HTML page as `data`."""

    def __init__(self, path: str, svg: bytes) -> None:
        self.path, self.data = path, f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"


def render(name: str, context: Mapping[str, Any]) -> tuple[str, str]:
    """The page of a template `NAME.j2` as Markdown and as an HTML file that needs no other.

    Text may hold `code` and **strong** words.

    Raises:
        ImportError: jinja2 is not installed.
    """
    try:
        import jinja2
    except ImportError as error:
        raise ImportError(MISSING) from error
    folder = jinja2.FileSystemLoader(Path(__file__).with_name("templates"))
    # Text is escaped by the filters, as Markdown is no HTML.
    engine = jinja2.Environment(loader=folder, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    engine.filters |= {"flat": _flat, "cell": _cell, "inline": _inline, "number": _number, "duration": duration}
    page = engine.get_template(f"{name}.j2")
    markdown = page.render(context, form="markdown.j2")
    body = page.render(context, form="html.j2")
    return (
        re.sub(r"\n{3,}", "\n\n", markdown).strip() + "\n",
        engine.get_template("frame.html.j2").render(title=context["title"], body=re.sub(r"\n{2,}", "\n", body).strip()),
    )


def _flat(text: str) -> str:
    """One line."""
    return " ".join(text.split())


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _inline(text: str) -> str:
    escaped = html.escape(_flat(text), quote=False)
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)


def _number(value: float) -> str:
    return number(value) if math.isfinite(value) else "-"


def duration(seconds: float) -> str:
    """Three digits with a unit."""
    if not math.isfinite(seconds):
        return "-"
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-6:.3g} us"


# ---- tables ---------------------------------------------------------------------------------------------------------


def bar_table(rows: Sequence[Row]) -> Table:
    """Head, rows, and how many columns are words: what, by whom, with what, and what came of the bar."""
    named = any(row.setting for row in rows)
    head = ["what", "by", *(["setting"] if named else []), "measured", "bar", ""]
    table = [[r.what, r.by, *([r.setting] if named else []), r.came, r.bar, r.verdict] for r in rows]
    return head, table, len(head)


def section_table(rows: Sequence[Row], wide: bool) -> Table:
    """One row for each, or a column for each `by`, whose head has the bar that its rows share."""
    if not wide:
        return bar_table(rows)
    columns = list(dict.fromkeys(row.by for row in rows))
    bars = {by: {row.bar for row in rows if row.by == by and row.bar} for by in columns}
    shared = {by: next(iter(found)) if len(found) == 1 else "" for by, found in bars.items()}
    found = {(row.what, row.by): row for row in rows}
    head = ["", *(f"{by} ({shared[by]})" if shared[by] else by for by in columns)]
    table = [
        [what, *(_came(found.get((what, by)), not shared[by]) for by in columns)]
        for what in dict.fromkeys(row.what for row in rows)
    ]
    return head, table, 1


def _came(row: Row | None, barred: bool) -> str:
    if row is None:
        return ""
    text = f"{row.came} ({row.bar})" if barred and row.bar else row.came
    return f"**{text} MISSED**" if row.holds is False else text


def renew(path: Path, tables: Mapping[str, Table]) -> list[str]:
    """Put tables between the lines `<!-- NAME -->` and `<!-- end -->` of a Markdown file; gives the names found.

    Raises:
        ImportError: jinja2 is not installed.
    """
    text, names = path.read_text(), []
    for name, table in tables.items():
        if f"<!-- {name} -->" in text:
            written, _ = render("table", {"title": "", "table": table})
            before, _, rest = text.partition(f"<!-- {name} -->\n")
            text = f"{before}<!-- {name} -->\n\n{written}\n<!-- end -->{rest.partition('<!-- end -->')[2]}"
            names.append(name)
    path.write_text(text)
    return names


def listed(words: Iterable[str]) -> str:
    """a, b and c."""
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last
