"""An example for every public class and function: statements that the site executes, and the cases of nodes.

Files of the folder `docs/reference/examples` have blocks that begin with a comment of names,

    # tx.lie.so3.exp tx.lie.so3.log
    R = tx.lie.so3.exp(np.array([0.0, 0.0, 1.0]))

and run one after another as one program. A name without such a block has the shortest statement of a page or of an
example of the gallery that uses it, and a node the first of the cases that the tests run.
"""

from __future__ import annotations

import ast
import functools
import importlib
import inspect
import re
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import execution
from execution import BLOCK, DOCS, EXAMPLES, Program
from names import Name, public_names

FOLDER = DOCS / "reference" / "examples"
#: The longest statement that is shown, in lines.
LINES = 14
_NAMES = re.compile(r"^((?:# (?:tx[\w.]+ ?)+\n)+)", re.MULTILINE)
#: What every file of the folder begins with, unseen.
IMPORTS = "import jax\nimport jax.numpy as jnp\nimport numpy as np\n\nimport twistax as tx\n"


class Snippet(NamedTuple):
    """Code with what it prints; for a statement of a page or of an example, its file below the checkout."""

    code: str
    printed: str = ""
    source: str = ""


def program_of(file: Path) -> Program:
    """The blocks of a file of examples, after the imports that all share."""
    return Program(f"reference/{file.stem}", (IMPORTS, *(code for _, code in _blocks(file))))


def _blocks(file: Path) -> list[tuple[list[str], str]]:
    parts = _NAMES.split(file.read_text())[1:]
    return [(names.replace("#", "").split(), code.strip()) for names, code in zip(parts[::2], parts[1::2])]


def programs() -> list[Program]:
    return [program_of(file) for file in sorted(FOLDER.glob("*.py"))]


def written() -> dict[str, str]:
    """The code of the blocks by full name."""
    blocks = [block for file in sorted(FOLDER.glob("*.py")) for block in _blocks(file)]
    return {name.replace("tx.", "twistax.", 1): code for names, code in blocks for name in names}


def _executed() -> dict[str, Snippet]:
    execution.execute(programs())
    found = {}
    for file in sorted(FOLDER.glob("*.py")):
        for (names, code), output in zip(_blocks(file), execution.executed(program_of(file))[1:], strict=True):
            for name in names:
                found[name.replace("tx.", "twistax.", 1)] = Snippet(code, output.text.rstrip())
    return found


@functools.cache
def snippets() -> dict[str, Snippet]:
    """The example of each name that has one."""
    return {**_of_nodes(), **_of_pages(), **_executed()}


# ---- statements of pages and examples --------------------------------------------------------------------------------


@functools.cache
def _of_pages() -> dict[str, Snippet]:
    """The shortest statement that uses a name, with its imports resolved."""
    by_identity: dict[int, list[Name]] = {}
    for name in public_names():
        by_identity.setdefault(id(name.value), []).append(name)
    found: dict[str, Snippet] = {}
    pages = [page for page in sorted(DOCS.rglob("*.md")) if "report" not in page.parts]
    files = [*((file, [file.read_text()]) for file in sorted(EXAMPLES.glob("*.py")))]
    files += [(page, BLOCK.findall(page.read_text())) for page in pages]
    for file, blocks in files:
        scope: dict[str, Any] = {}
        for block in blocks:
            for statement in _statements(ast.parse(block), scope):
                code = ast.get_source_segment(block, statement, padded=True) or ""
                if not 0 < code.count("\n") + 1 <= LINES:
                    continue
                snippet = Snippet(inspect.cleandoc(code), source=str(file.relative_to(DOCS.parent)))
                for name in [name for value in _used(statement, scope) for name in by_identity.get(id(value), ())]:
                    if name.path not in found or len(snippet.code) < len(found[name.path].code):
                        found[name.path] = snippet
    return found


def _statements(tree: ast.Module, scope: dict[str, Any]) -> list[ast.stmt]:
    """The statements of a module and of its functions; what it imports of twistax goes into the scope."""
    kept: list[ast.stmt] = []
    for statement in ast.walk(tree):
        if isinstance(statement, ast.Import):
            for part in statement.names:
                if part.name == "twistax":
                    scope[part.asname or part.name] = importlib.import_module("twistax")
        elif isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith("twistax"):
            module = importlib.import_module(statement.module or "")
            scope |= {part.asname or part.name: getattr(module, part.name, None) for part in statement.names}
        elif isinstance(statement, (ast.Assign, ast.Expr, ast.Return, ast.AugAssign)):
            kept.append(statement)
    return kept


def _used(statement: ast.stmt, scope: dict[str, Any]) -> list[Any]:
    """What the names and attributes of a statement are, where they lead into twistax."""

    def value(node: ast.expr) -> Any:
        if isinstance(node, ast.Name):
            return scope.get(node.id)
        inner = value(node.value) if isinstance(node, ast.Attribute) else None
        return getattr(inner, node.attr, None) if isinstance(inner, ModuleType) else None

    values = [value(node) for node in ast.walk(statement) if isinstance(node, (ast.Name, ast.Attribute))]
    return [found for found in values if found is not None]


# ---- nodes -----------------------------------------------------------------------------------------------------------


@functools.cache
def _of_nodes() -> dict[str, Snippet]:
    cases = {name.path: _of_node(name) for name in public_names() if name.is_node}
    return {path: Snippet(code) for path, code in cases.items() if code}


def _of_node(name: Name) -> str:
    """The states of the first case of a node, and its call; empty where it is no plain call."""
    case = next((case for case in name.value.example() if type(case.expr) is name.value), None)
    if case is None:
        return ""
    shapes = {leaf: f", shape={value.shape}" if value.shape else "" for leaf, value in case.values.items()}
    leaves = [f'{leaf} = tx.State("{leaf}"{shape})' for leaf, shape in shapes.items()]
    arguments = []
    for field in name.value._fields:
        value = getattr(case.expr, field.name)
        if field.variadic:
            arguments += [_printed(part) for part in value]
        elif field.operand:
            arguments.append(_printed(value))
        elif repr(value) != repr(field.default):
            arguments.append(f"{field.name}={value!r}")
    code = "\n".join([*leaves, f"{name.path.replace('twistax.', 'tx.')}({', '.join(arguments)})"])
    try:
        made = _run(code)
    except Exception:
        return ""
    return code if type(made) is name.value else ""


def _printed(operand: Any) -> str:
    return str(getattr(operand, "name", None) or operand)


def _run(code: str) -> Any:
    """The value of the last line."""
    *before, last = code.splitlines()
    scope: dict[str, Any] = {}
    exec("import numpy as np\nimport twistax as tx\n" + "\n".join(before), scope)
    return eval(last, scope)
