"""Every example is a script that runs as a user would run it, without a warning; those of the gallery draw."""

import ast
import importlib
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "docs" / "site"))
execution, results = importlib.import_module("execution"), importlib.import_module("results")

EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.py"))
PAGES = " ".join(path.stem for path in sorted((ROOT / "docs" / "gallery").glob("*.md")) if path.stem != "index")
GALLERY = [name for names in results.gallery_pages(PAGES).values() for name in names]
#: Processes that share the examples: JAX is imported once in each, and workers take them side by side.
SHARES = 8


@pytest.mark.parametrize("share", range(SHARES))
def test_examples_run(share: int) -> None:
    names = EXAMPLES[share::SHARES]
    programs = [execution.example_program(name) for name in names]
    execution.execute(programs)
    for name, program in zip(names, programs):
        (output,) = execution.executed(program)
        assert output.text.strip(), f"{name} prints nothing"
        assert name not in GALLERY or f"{name}.png" in output.files, f"{name} draws nothing"


def test_the_gallery_has_short_examples_with_titles() -> None:
    assert len(GALLERY) >= 24
    assert len(set(GALLERY)) == len(GALLERY)
    assert set(GALLERY) <= set(EXAMPLES)
    for name in GALLERY:
        title, doc, code = results.example(name)
        assert len((ROOT / "examples" / f"{name}.py").read_text().splitlines()) < 80, name
        assert 3 < len(title) < 50, (name, title)
        assert len(doc) > len(title) + 20, name
        ast.parse(code)


def test_the_index_of_the_gallery_has_all_pages() -> None:
    text = (ROOT / "docs" / "gallery" / "index.md").read_text()
    assert sorted(results.GALLERY.findall(text)[0].split()) == sorted(PAGES.split())


def test_there_are_examples() -> None:
    assert len(EXAMPLES) >= 2 * SHARES
    assert set(execution.BRIEF) <= set(EXAMPLES)
