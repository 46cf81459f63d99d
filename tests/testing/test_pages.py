"""The parts that pages write down pass the checks that the pages promise, each section run as it stands."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twistax as tx
from twistax.mechanics import joints

DOCS = Path(__file__).parents[2] / "docs"
SECTIONS = [
    ("extending.md", "A node", "check_node"),
    ("extending.md", "A group", "check_group"),
    ("extending.md", "A tableau", "check_tableau"),
    ("joints.md", "Adding a joint", "check_joint"),
    ("scenes.md", "A new scene", "check_scene"),
]


@pytest.mark.parametrize(("page", "heading", "check"), SECTIONS, ids=[heading for _, heading, _ in SECTIONS])
def test_what_a_page_writes_passes_its_check(
    page: str, heading: str, check: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = (DOCS / page).read_text()
    section = re.search(rf"^## {heading}\n(.*?)(?=^## |\Z)", text, re.DOTALL | re.MULTILINE)
    assert section is not None
    code = "\n".join(re.findall(r"```python\n(.*?)```", section[1], re.DOTALL))
    checked: list[Any] = []
    run = getattr(tx.testing, check)
    monkeypatch.setattr(tx.testing, check, lambda part: checked.append(part) or run(part))
    exec(compile(code, page, "exec"), {"__name__": "docs", "np": np, "tx": tx, "joints": joints})
    assert len(checked) == 1
