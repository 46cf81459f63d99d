"""Prose in the vocabulary of the field: phrases that readers did not understand are refused."""

import ast
import functools
import inspect
import re
from pathlib import Path

import pytest

from test_docs import module_of_site

ROOT = Path(__file__).parent.parent
DOCS = ROOT / "docs"
#: Pages that programs write, and lists of facts for developers.
NOT_PAGES = {"changelog.md", "measured.md", "roadmap.md"}
#: What users read: these pages are held to more.
FIRST = [
    ROOT / "README.md",
    *(page for page in sorted(DOCS.glob("*.md")) if page.name not in NOT_PAGES),
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
#: Refused on the pages for users, in the examples, in docstrings of public names and in messages of errors.
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
    r"\banew\b(?=\.)": "again; recompile",
    r"\bcompiles? nothing\b": "does not recompile",
    r"\bmakes? sense\b": "is defined, is feasible",
    r"\bhangs? on\b": "depends on",
    r"\bunless (told|said) otherwise\b|\bunless given\b": "by default",
    r"\bas given\b": "as passed, the argument",
    r"\bwhat else\b": "name it: further outputs",
    r"\bforms? in scalars\b": "scalar form",
    r"\b(is|are) (sought|looked for)\b": "is unknown, is computed",
    r"\bon the word of\b": "is trusted",
    r"\bup to there\b": "up to this point",
    r"\bat hand\b": "is available",
    r"\bdo(es)? no harm\b": "is ignored, has no effect",
    r"\bwithout a word\b": "silently",
    r"\bround without end\b": "an infinite loop",
    r"\b(is|are) yours\b": "you provide, the user provides",
    r"\bfor the engineer\b": "state what the page describes",
    r"\bwhoever\b": "those who",
    r"\ba hair (nearer|above|below)\b": "slightly",
    r"\bpays\b": "is faster, is useful",
    r"\bone after the other\b": "successively, in series, concatenated",
    r"\bspoils\b": "state the effect",
    r"\bof (your|one's) own\b": "custom",
    r"\bstands? (twice|beside|above|below|in line)\b": "occurs, is listed",
    r"\bsays (which|what|whether)\b": "states, names, lists",
    r"\bwhat became of\b": "the status of",
    r"\bto begin with\b": "initial, first",
    r"\bin one go\b": "in one call, in one experiment",
    r"\bfor ever\b": "at all times, endlessly",
    r"\b(as|than) \w+ ha(s|ve) (it|them)\b": "executed by, in the form of",
    r"\bno words for\b": "cannot express",
    r"\bgain(s|ed)? nothing\b|\bnothing is gained\b": "gives no speed-up",
    r"\bturns? (round|anew)\b": "is reversed",
    r"(?<!there )\b(is|are) no (pose|rotation|parameter|state|output|element|model|list|name)\b": "is not a",
    r"\ball told\b": "in total",
    r"\b(puts?|brings?) back\b": "projects, restores",
    r"\bran out\b": "reached the limit",
    r"\bcarry on\b": "continue",
}


def messages(path: Path) -> list[str]:
    """The constant parts of the messages that a module raises."""
    raised = (node.exc for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Raise) and node.exc)
    parts = (part for error in raised for part in ast.walk(error) if isinstance(part, ast.Constant))
    return [part.value for part in parts if isinstance(part.value, str)]


@functools.cache
def spoken(path: Path) -> str:
    """The lines of a file without code in backticks."""
    return "\n".join(re.sub(r"`[^`]*`", "", line) for line in path.read_text().splitlines())


def lines_with(phrase: str, paths: list[Path]) -> list[str]:
    """The places of a phrase outside of code in backticks, without regard to case."""
    refused, found = re.compile(phrase, re.IGNORECASE), []
    for path in paths:
        for number, line in enumerate(spoken(path).split("\n"), 1):
            if refused.search(line):
                found.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()[:90]}")
    return found


@pytest.mark.parametrize("phrase", REFUSED)
def test_a_refused_phrase_is_nowhere(phrase: str) -> None:
    assert lines_with(phrase, ALL) == [], f"write instead: {REFUSED[phrase]}"


@pytest.mark.parametrize("phrase", REFUSED_FIRST)
def test_a_refused_phrase_is_on_no_page_for_new_users(phrase: str) -> None:
    assert lines_with(phrase, FIRST) == [], f"write instead: {REFUSED_FIRST[phrase]}"


@pytest.fixture(scope="module")
def texts() -> dict[str, str]:
    """Docstrings of public names, and messages of errors by file, without code in backticks."""
    found = {path.relative_to(ROOT).as_posix(): "\n".join(messages(path)) for path in (ROOT / "src").rglob("*.py")}
    for name in module_of_site("names").public_names():
        found[name.path] = inspect.getdoc(name.value) or ""
        found |= {f"{name.path}.{part}": inspect.getdoc(getattr(name.value, part)) or "" for part in name.members()}
    return {place: re.sub(r"`[^`]*`", "", text) for place, text in found.items()}


def test_no_public_docstring_and_no_message_has_a_refused_phrase(texts: dict[str, str]) -> None:
    assert len(texts) > 1000
    refused = re.compile("|".join(REFUSED | REFUSED_FIRST), re.IGNORECASE)
    assert [f"{place}: {hit[0]}" for place, text in texts.items() if (hit := refused.search(text))] == []


def test_no_message_shows_a_placeholder() -> None:
    """A string without its f shows the braces to the user."""
    lost = re.compile(r"\{[a-z_]\w*(\.\w+|\[\w+\])*(![rs])?\}")
    assert [
        (path.name, text) for path in (ROOT / "src").rglob("*.py") for text in messages(path) if lost.search(text)
    ] == []


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
