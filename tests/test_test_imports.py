"""Tests use public names; what has none is tested in tests/internals."""

import ast
from pathlib import Path

import pytest

import twistax

TESTS = Path(__file__).parent
PUBLIC = {path.stem for path in Path(twistax.__file__).parent.iterdir()}

#: Folders whose tests import no module within a package of twistax. Oracles and helpers beside them may.
FOLDERS = [
    "bad_calls",
    "expr",
    "fuzz",
    "groups",
    "integrators",
    "linear",
    "lowering",
    "mechanics",
    "scenes",
    "testing",
    "trimming",
    "view",
]


def internal_imports(source: str) -> list[str]:
    """Modules of twistax that a source imports and that are not `twistax.<name>`."""
    modules: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            modules.append(node.module or "")
        elif isinstance(node, ast.Import):
            modules += [alias.name for alias in node.names]
    parts = [module.split(".") for module in modules if module.startswith("twistax.")]
    return [".".join(part) for part in parts if len(part) > 2 or part[1] not in PUBLIC]


@pytest.mark.parametrize("folder", FOLDERS)
def test_tests_import_public_names(folder: str) -> None:
    files = sorted((TESTS / folder).rglob("test_*.py"))
    assert files
    found = {path.name: modules for path in files if (modules := internal_imports(path.read_text()))}
    assert found == {}, "use public names, or move what needs these to tests/internals"


def test_an_internal_import_is_seen() -> None:
    source = "import twistax as tx\nfrom twistax.mechanics import joints\nfrom twistax.expr.node import Expr\n"
    assert internal_imports(source) == ["twistax.expr.node"]
