"""The presentation of results: pages and tables as Markdown and HTML, each from one template, and figures."""

import base64
import html
import io
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from .rows import ReportRow, duration, plain

_TEMPLATES = Path(__file__).with_name("templates")

#: Head, rows, and how many columns are words.
Table = tuple[list[str], list[list[str]], int]


class PageFigure:
    """An SVG: beside the Markdown page under `path`, inside of the HTML page as `data`."""

    def __init__(self, path: str, svg: bytes) -> None:
        self.path, self.data = path, f"data:image/svg+xml;base64,{base64.b64encode(svg).decode()}"


def render(name: str, context: Mapping[str, Any]) -> tuple[str, str]:
    """The page of a template `NAME.j2` as Markdown and as an HTML file that needs no other; ImportError without jinja2.

    Text may hold `code` and **strong** words.
    """
    import jinja2

    folder = jinja2.FileSystemLoader(_TEMPLATES)
    # Text is escaped by the filters, as Markdown is no HTML.
    engine = jinja2.Environment(loader=folder, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined)
    engine.filters |= {"flat": _flat, "cell": lambda text: _flat(text).replace("|", "\\|"), "inline": _inline}
    engine.filters |= {"duration": duration, "plain": plain, "listed": _listed, "span": _span, "bar_table": bar_table}
    page, frame = engine.get_template(f"{name}.j2"), engine.get_template("frame.html.j2")
    markdown, body = (page.render(context, form=form) for form in ("markdown.j2", "html.j2"))
    framed = frame.render(title=context["title"], body=re.sub(r"\n{2,}", "\n", body).strip())
    return re.sub(r"\n{3,}", "\n\n", markdown).strip() + "\n", framed


def texts(report: str) -> dict[str, Any]:
    """What the page of a report says beside rows: title, about, note, and those of its sections."""
    return dict(tomllib.loads((_TEMPLATES / "sections.toml").read_text())[report])


_flat: Callable[[str], str] = lambda text: " ".join(text.split())  # noqa: E731


def _inline(text: str) -> str:
    escaped = html.escape(_flat(text), quote=False)
    escaped = re.sub(r"`([^`]+)`", r"<code>\1</code>", escaped)
    return re.sub(r"\*\*([^*]+)\*\*", r"<strong>\1</strong>", escaped)


def _listed(words: Iterable[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} and {last}" if first else last


def _span(values: Iterable[float]) -> str:
    """The range of numbers: 0.50 to 1.20."""
    ends = sorted(values)
    low, high = f"{ends[0]:.2f}", f"{ends[-1]:.2f}"
    return low if low == high else f"{low} to {high}"


def bar_table(rows: Sequence[ReportRow]) -> Table:
    """One line for each row: what, by whom, with what, and what came of the bar."""
    settings = any(row.setting for row in rows)
    head = ["what", "by", *(["setting"] if settings else []), "measured", "bar", ""]
    table = [[r.what, r.by, *([r.setting] if settings else []), r.came, r.bar, r.verdict] for r in rows]
    return head, table, len(head)


def table_of(rows: Sequence[ReportRow], wide: bool) -> Table:
    """As `bar_table`, or with a column for each `by`, whose head has the bar that its rows share."""
    if not wide:
        return bar_table(rows)
    columns = list(dict.fromkeys(row.by for row in rows))
    bars = {by: {row.bar for row in rows if row.by == by and row.bar} for by in columns}
    shared = {by: words.pop() if len(words) == 1 else "" for by, words in bars.items()}
    cells = {(row.what, row.by): _cell(row, not shared[row.by]) for row in rows}
    head = ["", *(f"{by} ({shared[by]})" if shared[by] else by for by in columns)]
    names = dict.fromkeys(row.what for row in rows)
    return head, [[what, *(cells.get((what, by), "") for by in columns)] for what in names], 1


def _cell(row: ReportRow, with_bar: bool) -> str:
    text = f"{row.came} ({row.bar})" if with_bar and row.bar else row.came
    return f"**{text} MISSED**" if row.holds is False else text


def renew(path: Path, tables: Mapping[str, Table]) -> list[str]:
    """Put tables between the lines `<!-- NAME -->` and `<!-- end -->` of a Markdown file; gives the names it has."""
    text, names = path.read_text(), []
    for name, table in tables.items():
        if f"<!-- {name} -->" in text:
            written, _ = render("table", {"title": "", "table": table})
            before, _, after = text.partition(f"<!-- {name} -->\n")
            text = f"{before}<!-- {name} -->\n\n{written}\n<!-- end -->{after.partition('<!-- end -->')[2]}"
            names.append(name)
    path.write_text(text)
    return names


def panels(title: str, labels: Sequence[str], size: tuple[float, float] = (7.0, 5.0), count: int = 1) -> Any:
    """A figure with panels below each other, which share the label of x. Raises ImportError without matplotlib."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    for axes in figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]:
        axes.grid(alpha=0.25)
        axes.set_ylabel(labels[1], fontsize=11)
        axes.spines[["top", "right"]].set_visible(False)
    figure.axes[0].set_title(title, fontsize=13, loc="left")
    figure.axes[-1].set_xlabel(labels[0], fontsize=11)
    return figure


def as_svg(figure: Any, columns: int = 2) -> bytes:
    """The figure with its legend below, as SVG: text stays text, and the same data gives the same file."""
    import matplotlib
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    out = io.BytesIO()
    handles, names = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "twistax", "font.family": "sans-serif"}):
        FigureCanvasSVG(figure).print_svg(out, metadata={"Date": None})
    return out.getvalue()
