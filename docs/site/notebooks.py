"""Pages as Jupyter notebooks: their text as Markdown cells, their blocks of Python as code cells, without results."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import execution
from execution import BLOCK, DOCS

_TOC = re.compile(r"^```\{toctree\}.*?^```$", re.DOTALL | re.MULTILINE)


def cells(page: Path) -> list[dict[str, Any]]:
    """The cells of a page; those of a later page of the tutorial come after the code of the pages before it."""
    pages = execution.TUTORIAL if page in execution.TUTORIAL else [page]
    before = [block for other in pages[: pages.index(page)] for block in BLOCK.findall(other.read_text())]
    written = [_code(block) for block in before]
    for number, part in enumerate(BLOCK.split(_TOC.sub("", page.read_text()))):
        if number % 2:
            written.append(_code(part))
        elif part.strip():
            written.append({"cell_type": "markdown", "metadata": {}, "source": part.strip()})
    return written


def _code(text: str) -> dict[str, Any]:
    return {"cell_type": "code", "metadata": {}, "execution_count": None, "outputs": [], "source": text.rstrip()}


def write(out: Path, pages: list[Path]) -> None:
    """Write the notebooks of pages into a folder of the site."""
    kernel = {"kernelspec": {"name": "python3", "display_name": "Python 3", "language": "python"}}
    for page in pages:
        path = out / page.relative_to(DOCS).with_suffix(".ipynb")
        path.parent.mkdir(parents=True, exist_ok=True)
        notebook = {"nbformat": 4, "nbformat_minor": 4, "metadata": kernel, "cells": cells(page)}
        path.write_text(json.dumps(notebook, indent=1))
