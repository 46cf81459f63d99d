"""The entries of the site's search: sections of pages and public names, with their text, as one script.

Browsers let a page opened from a file load scripts and fetch nothing, so the text of excerpts is in the index.
`static/search.js` ranks the entries.
"""

from __future__ import annotations

import inspect
import json
import re
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

from docutils.nodes import make_id
from execution import DOCS
from names import FENCE, Name, asked

#: Characters kept of the text of an entry.
TEXT = 4000
_HEADING = re.compile(r"^(#{1,4}) +(.*?)(?: *\{#.*\})?$")
_EXAMPLE = re.compile(r"^```\{example\} (\w+)\n```$", re.MULTILINE)
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")


class Entry(NamedTuple):
    """One thing to find.

    Attributes:
        kind: `name`, `member` of a class, `page`, or `section` of a page.
        title: a heading, or the full name.
        context: the title of the page.
        address: relative to the folder of the site.
        text: what is searched and quoted.
    """

    kind: str
    title: str
    context: str
    address: str
    text: str


def entries() -> list[Entry]:
    """All entries: pages in alphabetical order, each followed by the names that it lists."""
    return [entry for page in sorted(DOCS.rglob("*.md")) for entry in page_entries(page)]


def page_entries(page: Path) -> list[Entry]:
    """The sections of a page, and the names of its fences with their methods."""
    source, file = page.read_text(), page.relative_to(DOCS).with_suffix(".html").as_posix()
    sections = _sections(FENCE.sub("", source))
    context = sections[0][0] if sections else page.stem
    counts: Counter[str] = Counter()
    written = []
    for number, (title, text) in enumerate(sections):
        anchor = make_id(title)
        counts[anchor] += 1
        # docutils numbers what comes again, and what has no letters: the page itself is as good there.
        place = f"#{anchor}" if number and anchor and counts[anchor] == 1 else ""
        written.append(Entry("section" if number else "page", title, context, f"{file}{place}", _plain(text)))
    for namespace, wanted in FENCE.findall(source):
        for name in asked(namespace, wanted):
            written += _name_entries(name, context, file)
    return written


def _name_entries(name: Name, context: str, file: str) -> list[Entry]:
    own = Entry("name", name.path, context, f"{file}#{name.path}", _docstring(name.value))
    members = [(f"{name.path}.{member}", getattr(name.value, member)) for member in name.members()]
    return [own, *(Entry("member", path, context, f"{file}#{path}", _docstring(value)) for path, value in members)]


def _docstring(value: object) -> str:
    return _plain(inspect.getdoc(value) or "") if hasattr(value, "__module__") or isinstance(value, property) else ""


def _sections(source: str) -> list[tuple[str, str]]:
    """Title and text of each section; a hash within code is no heading."""
    sections: list[tuple[str, list[str]]] = []
    code = False
    for line in source.splitlines():
        code ^= line.startswith(("```", ":::"))
        heading = None if code else _HEADING.match(line)
        if heading:
            sections.append((_plain(heading[2]), []))
        elif sections:
            sections[-1][1].append(line)
    return [(title, "\n".join(lines)) for title, lines in sections]


def _plain(text: str) -> str:
    """Text as an excerpt shows it: without fences, marks of Markdown and rules of tables."""
    text = re.sub(r"^(```|:::).*$|^\|[-|: ]+\|$", "", text, flags=re.MULTILINE)
    text = re.sub(r"[`*|]|\$\$|^#+ ", " ", _LINK.sub(r"\1", text), flags=re.MULTILINE)
    return " ".join(text.split())[:TEXT]


def write(out: Path) -> list[Entry]:
    """Write the index into the folder of static files, as a script that a page can load from a file."""
    found = entries()
    script = f"const searchEntries = {json.dumps([list(entry) for entry in found], ensure_ascii=False)};\n"
    (out / "_static" / "search_entries.js").write_text(script, encoding="utf-8")
    return found


def _without_the_search_of_sphinx(app: Any) -> None:
    app.builder.search = False


def setup(app: Any) -> dict[str, bool]:
    app.connect("builder-inited", _without_the_search_of_sphinx)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
