"""Prose in the vocabulary of the field: phrases that readers did not understand are refused."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
#: What a user reads first: these pages are held to more.
FIRST = [
    ROOT / "README.md",
    *(DOCS / f"{name}.md" for name in ("index", "install", "landing", "mechanics", "migration", "release")),
    *sorted((DOCS / "tutorial").glob("*.md")),
    *sorted((DOCS / "howto").glob("*.md")),
    *sorted((DOCS / "gallery").glob("*.md")),
    *sorted((ROOT / "examples").glob("*.py")),
]
#: All that is read: pages but for those that programs write and the changelog, and the docstrings of the package.
ALL = [
    *FIRST,
    *(page for page in sorted(DOCS.glob("*.md")) if page not in FIRST),
    *sorted((DOCS / "reference").glob("*.md")),
    *sorted((ROOT / "src").rglob("*.py")),
]

#: Refused everywhere, with the term that says it.
REFUSED = {
    r"look who\b": "name what the code prints",
    r"\bwas worth\b": "is discarded, is reset",
    r"\bis forgotten\b": "is discarded, is reset",
    r"\bis said before\b|\bbefore \w+ is said\b": "the status is returned",
    r"\bin a row of less than\b": "iterations with a step below",
    r"\bfor who\b(?! )|\bfor who (?=\w+s\b)": "for those who",
    r"\bof who\b": "of those who",
    r"\bthinks nothing of\b": "ignores",
    r"\bmay well be\b": "may be",
}
#: Refused on the pages for new users, and in the examples.
REFUSED_FIRST = {
    r"\b(is|are|was) said\b": "the message states, the status is",
    r"\bsaid of\b": "notes",
    r"\b(is|are) looked at\b": "is checked, is evaluated",
    r"\blook at the mesh\b": "mesh check",
    r"\b(solvers?|packages?|functions?) of others\b": "other solvers",
    r"\bnobody\b": "passive voice, or name who",
    r"\bsays so\b": "states it",
    r"\b(is|are) told\b": "is reported",
    r"\b(is|are) wanted\b": "is required, the target",
    r"\bcomes? out\b": "is the result",
    r"\bgoes on\b": "continues",
    r"\bwhat stands\b": "name it",
    r"\bis off by\b": "has an error of",
    r"\bas it comes\b": "by default",
    r"\bon the way\b": "during the integration, during the solve",
    r"\bstays what it\b": "is conserved, is constant",
    r"\bto be worth\b|\bis worth\b": "state the effect",
    r"\bthat much\b": "name the quantity",
    r"\banew\b(?=\.|,)": "again; recompile",
    r"\bcompiles? nothing\b": "does not recompile",
    r"\bmakes? sense\b": "is defined, is feasible",
    r"\bhangs? on\b": "depends on",
}


def lines_with(phrase: str, paths: list[Path]) -> list[str]:
    """The places of a phrase outside of code in backticks, without regard to case."""
    found = []
    for path in paths:
        for number, line in enumerate(path.read_text().splitlines(), 1):
            if re.search(phrase, re.sub(r"`[^`]*`", "", line), re.IGNORECASE):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:90]}")
    return found


@pytest.mark.parametrize("phrase", REFUSED)
def test_a_refused_phrase_is_nowhere(phrase: str) -> None:
    assert lines_with(phrase, ALL) == [], f"write instead: {REFUSED[phrase]}"


@pytest.mark.parametrize("phrase", REFUSED_FIRST)
def test_a_refused_phrase_is_on_no_page_for_new_users(phrase: str) -> None:
    assert lines_with(phrase, FIRST) == [], f"write instead: {REFUSED_FIRST[phrase]}"


def test_no_page_for_new_users_writes_a_prime_for_a_rate_or_a_transpose() -> None:
    """$\\dot q$ and $A^T$, typeset; programs have `'` in text and code only."""
    prime = re.compile(r"(?<![\w'])[A-Za-z]{1,2}'(?=[\s(,.]) ?(?![a-z]{2})")
    pages = [path for path in FIRST if path.suffix == ".md"]
    code = re.compile(r"^```.*?^```|`[^`]*`|\$[^$]*\$", re.DOTALL | re.MULTILINE)
    found = [f"{page.name}: {hit[0]}" for page in pages for hit in prime.finditer(code.sub("", page.read_text()))]
    assert found == []


def test_the_readme_is_short_and_has_two_commands() -> None:
    lines = (ROOT / "README.md").read_text().splitlines()
    assert len(lines) < 120
    commands = [line for line in lines if line.startswith("python3.11 -m venv")]
    assert [("twistax demo" in line, "pytest" in line) for line in commands] == [(True, False), (False, True)]


def test_phrases_are_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import test_prose

    monkeypatch.setattr(test_prose, "ROOT", tmp_path)
    page = tmp_path / "page.md"
    page.write_text("Look who it is:\nThe status is said.\n`is said`\n")
    assert lines_with(r"look who\b", [page]) == ["page.md:1: Look who it is:"]
    assert lines_with(r"\b(is|are|was) said\b", [page]) == ["page.md:2: The status is said."]
