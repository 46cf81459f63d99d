"""Animations of pages, written when the site is built by what the page shows.

A page has a fence

    ```{animation} flight.html
    solution.show("flight.html")
    ```

whose code is shown, with the file that it writes below it. The Python blocks of the page and these fences, one after
another, are one program, which runs in a process of its own beside Sphinx.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import twistax

FENCE = re.compile(r"```\{animation\} (\S+)\n(.*?)```", re.DOTALL)
_CODE = re.compile(r"```(?:python|\{animation\} \S+)\n(.*?)```", re.DOTALL)
#: Below the folder of the site.
FOLDER = "animations"


def program(text: str) -> str:
    """The code of a page that writes its animations."""
    return "\n".join(_CODE.findall(text))


class Running(NamedTuple):
    """The program of a page, under way."""

    page: Path
    process: subprocess.Popen[str]


def begin(docs: Path, out: Path) -> list[Running]:
    """Start the programs of all pages that have animations, to write them into a folder of the site."""
    folder = out / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    source = str(Path(twistax.__file__).resolve().parents[1])
    paths = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH")]))
    surroundings = {**os.environ, "JAX_PLATFORMS": "cpu", "PYTHONPATH": paths}
    return [
        Running(
            page,
            subprocess.Popen(
                [sys.executable, "-c", program(page.read_text())],
                cwd=folder,
                env=surroundings,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            ),
        )
        for page in sorted(docs.rglob("*.md"))
        if FENCE.search(page.read_text())
    ]


def end(running: list[Running]) -> list[str]:
    """Wait for them: what the programs that failed say."""
    said = [(one.page, one.process.communicate()[1], one.process.returncode) for one in running]
    return [f"{page}: the animation was not written\n{text}" for page, text, code in said if code]


def expand(app: Any, page: str, source: list[str]) -> None:
    """Fences become code with a frame below."""

    def shown(fence: re.Match[str]) -> str:
        file = f"{'../' * page.count('/')}{FOLDER}/{fence[1]}"
        frame = f'<iframe class="animation" src="{file}" title="{fence[1]}" loading="lazy"></iframe>'
        return f"```python\n{fence[2]}```\n\n```{{raw}} html\n{frame}\n```"

    source[0] = FENCE.sub(shown, source[0])


def setup(app: Any) -> dict[str, bool]:
    app.connect("source-read", expand)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
