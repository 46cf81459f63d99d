"""The code in README and docs runs as it is printed."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
#: All but the kept pages of reports, which programs wrote.
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(set(DOCS.rglob("*.md")) - set(DOCS.glob("report/*.md")))]
#: Pages that are one program: each goes on where the one before ends.
TUTORIAL = [DOCS / "tutorial" / f"{name}.md" for name in ("body", "rollout", "optimal", "c_code")]
PROGRAMS = [[page] for page in PAGES if page not in TUTORIAL] + [TUTORIAL]


def blocks(pages: list[Path]) -> str:
    """The Python blocks of pages, one after another, as one program."""
    return "\n".join(code for page in pages for code in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL))


@pytest.mark.parametrize("pages", [p for p in PROGRAMS if blocks(p)], ids=lambda p: "/".join(p[0].parts[-2:]))
def test_code_blocks_run(pages: list[Path]) -> None:
    exec(compile(blocks(pages), str(pages[0]), "exec"), {"__name__": "docs"})


def test_the_tutorial_is_all_there() -> None:
    assert {*TUTORIAL, DOCS / "tutorial" / "index.md"} == set((DOCS / "tutorial").glob("*.md"))


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
