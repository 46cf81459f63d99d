"""The code in README and docs runs as it is printed."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def blocks(page: Path) -> str:
    """The Python blocks of a page, one after another, as one program."""
    return "\n".join(re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))


@pytest.mark.parametrize("page", [p for p in PAGES if blocks(p)], ids=lambda p: p.name)
def test_code_blocks_run(page: Path) -> None:
    exec(compile(blocks(page), str(page), "exec"), {"__name__": "docs"})


def test_links_lead_somewhere() -> None:
    links = [(page, target) for page in PAGES for target in re.findall(r"\]\(([^)#]+)\)", page.read_text())]
    inside = [(page, target) for page, target in links if "://" not in target]
    assert len(inside) > 20
    assert [f"{page.name}: {target}" for page, target in inside if not (page.parent / target).exists()] == []


def test_files_that_are_named_exist() -> None:
    named = [
        (page, name)
        for page in PAGES
        for name in re.findall(r"`((?:src|tests|examples|docs)/[\w/.]*\w)", page.read_text())
    ]
    assert len(named) > 20
    assert [f"{page.name}: {name}" for page, name in named if not (ROOT / name).exists()] == []
