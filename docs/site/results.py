"""Results on pages: below each block of Python what it prints and draws; fences for examples and their gallery.

    ```{example} four_bar
    ```

is an example of the folder examples with its title, code, output and figures. A page has several. The fence
`{gallery} bodies mechanisms` shows pictures of all examples on these pages.
"""

from __future__ import annotations

import ast
import html
import re
import shutil
from pathlib import Path
from typing import Any

import execution
import snippets
from dark import dark_name
from execution import BLOCK, DOCS, LINES, Output, Program

EXAMPLE = re.compile(r"^```\{example\} (\w+)\n```$", re.MULTILINE)
GALLERY = re.compile(r"^```\{gallery\} ([\w ]+)\n```$", re.MULTILINE)
#: Below the folder of the site.
FOLDER, NOTEBOOKS = "executed", "notebooks"


def example(name: str) -> tuple[str, str, str]:
    """Title, description and code of an example: a docstring `Title: what happens.`, and what comes after it."""
    text = (execution.EXAMPLES / f"{name}.py").read_text()
    tree = ast.parse(text)
    doc = ast.get_docstring(tree) or ""
    code = "\n".join(text.splitlines()[tree.body[0].end_lineno :]).strip()
    return re.split(r"[:.]", doc)[0], doc, code


def gallery_pages(names: str) -> dict[str, list[str]]:
    """The examples of each page of the gallery, in order."""
    return {name: EXAMPLE.findall((DOCS / "gallery" / f"{name}.md").read_text()) for name in names.split()}


def programs() -> list[Program]:
    """All that the site shows results of."""
    alone = [page for page in pages() if page not in execution.TUTORIAL]
    names = [name for page in sorted(DOCS.rglob("*.md")) for name in EXAMPLE.findall(page.read_text())]
    examples = [execution.example_program(name) for name in names]
    written = snippets.programs()
    return [execution.page_program(*execution.TUTORIAL), *map(execution.page_program, alone), *examples, *written]


def pages() -> list[Path]:
    """The pages that have code."""
    return [page for page in sorted(DOCS.rglob("*.md")) if _shown(page)]


def _shown(page: Path) -> bool:
    """Pages of reports have no programs."""
    return "report" not in page.parts and bool(BLOCK.search(page.read_text()))


def copy_files(out: Path) -> None:
    """The files that programs wrote, into a folder of the site."""
    for program in programs():
        target = out / FOLDER / program.name
        target.mkdir(parents=True, exist_ok=True)
        for output in execution.executed(program):
            for name in output.files:
                shutil.copy(program.folder / name, target / name)


# ---- Sphinx ----------------------------------------------------------------------------------------------------------


def expand(app: Any, page: str, source: list[str]) -> None:
    """Put results below blocks, and examples in place of their fences."""
    path, up = DOCS / f"{page}.md", "../" * page.count("/")
    if app.builder.format != "html":
        return
    text = GALLERY.sub(lambda fence: _gallery(fence[1], up), source[0])
    if _shown(path):
        pages = execution.TUTORIAL if path in execution.TUTORIAL else [path]
        folder = f"{up}{FOLDER}/{execution.page_program(*pages).name}"
        outputs = iter(execution.page_outputs(path))
        text = BLOCK.sub(lambda block: f"{block[0]}\n\n{rendered(next(outputs), folder)}", text)
        link = f'<p class="notebook"><a href="{up}{NOTEBOOKS}/{page}.ipynb" download>Download as a notebook</a></p>'
        text = f"{text}\n\n{_raw(link)}\n"
    source[0] = EXAMPLE.sub(lambda fence: _example(fence[1], up), text)


def rendered(output: Output, folder: str) -> str:
    """The results of a block as Markdown."""
    parts = [_raw(output_of(output.text))] if output.text.strip() else []
    if output.latex:
        parts.append(f"$$\n{output.latex}\n$$")
    for name in output.files:
        file = f"{folder}/{name}"
        if name.endswith(".dark.png"):
            continue
        if name.endswith((".png", ".svg")):
            parts.append(_raw(picture(file, name, dark_name(name).name in output.files)))
        elif name.endswith(".html"):
            parts.append(_raw(f'<iframe class="animation" src="{file}" title="{name}" loading="lazy"></iframe>'))
    return "\n\n".join(parts)


def picture(file: str, text: str, is_twice: bool, kind: str = "output") -> str:
    """A figure as HTML; the theme shows the one that was drawn for its ground."""
    if not is_twice:
        return f'<img class="{kind}" src="{file}" alt="{text}" loading="lazy">'
    files = {"light": file, "dark": dark_name(file).as_posix()}
    return "".join(f'<img class="{kind} only-{g}" src="{f}" alt="{text}" loading="lazy">' for g, f in files.items())


def output_of(printed: str) -> str:
    """What a block prints, cut after some lines, as HTML."""
    lines = printed.rstrip().splitlines()
    text = "\n".join(lines if len(lines) <= LINES else [*lines[: LINES - 1], "..."])
    return f'<pre class="output">{html.escape(text)}</pre>'


def _raw(text: str) -> str:
    return f"```{{raw}} html\n{text}\n```"


def _example(name: str, up: str) -> str:
    title, doc, code = example(name)
    (output,) = execution.executed(execution.example_program(name))
    file = f"{up}{FOLDER}/examples/{name}"
    below = rendered(output, file)
    return f"({name})=\n## {title}\n\n{doc}\n\n`examples/{name}.py`\n\n```python\n{code}\n```\n\n{below}"


def _gallery(pages: str, up: str) -> str:
    parts = []
    for page, names in gallery_pages(pages).items():
        heading = re.search(r"^# (.*)$", (DOCS / "gallery" / f"{page}.md").read_text(), re.MULTILINE)
        assert heading is not None
        cards = [_card(page, name, up) for name in names]
        parts.append(f"## {heading[1]}\n\n" + _raw(f'<div class="gallery">{"".join(cards)}</div>'))
    return "\n\n".join(parts)


def _card(page: str, name: str, up: str) -> str:
    (output,) = execution.executed(execution.example_program(name))
    is_twice = dark_name(f"{name}.png").name in output.files
    thumbnail = picture(f"{up}{FOLDER}/examples/{name}/{name}.png", "", is_twice, "thumbnail")
    anchor = name.replace("_", "-")
    return f'<a href="{page}.html#{anchor}">{thumbnail}<span>{html.escape(example(name)[0])}</span></a>'


def setup(app: Any) -> dict[str, bool]:
    app.connect("source-read", expand)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
