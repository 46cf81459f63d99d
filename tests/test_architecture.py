"""The house: each layer imports only the layers below it; importing changes nothing and stays light."""

import ast
import graphlib
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import jax.numpy as jnp
import jaxtyping
import pytest
from beartype.roar import BeartypeCallHintParamViolation

import twistax
from twistax.groups import so3

SOURCE = Path(twistax.__file__).parent
LAYERS = [
    "errors",
    "jax_inside",
    "checks",
    "progress",
    "units",
    "scalar",
    "groups",
    "plots",
    "view",
    "expr",
    "system",
    "solver",
    "integrators",
    "mechanics",
    "linear",
    "estimation",
    "trimming",
    "trajectory",
    "testing",
    "the public names",  # the package itself and its thin faces; what stands above is written against them
    "scenes",
    "report",
    "demo",
    "__main__",
]


def layer_of(module: str) -> int:
    """Layer number of `twistax.<module>`."""
    first = module.split(".")[0]
    return LAYERS.index(first if first in LAYERS else "the public names")


def imported_modules(path: Path) -> set[str]:
    """Modules of the package that a file imports, as names below `twistax`."""
    relative = path.relative_to(SOURCE).with_suffix("")
    package = list(relative.parts[:-1])
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            if node.level:
                base = package[: len(package) - (node.level - 1)]
                module = ".".join([*base, *(node.module.split(".") if node.module else [])])
                found |= {f"{module}.{alias.name}".lstrip(".") for alias in node.names} if not module else {module}
            elif node.module and node.module.split(".")[0] == "twistax":
                rest = node.module.split(".")[1:]
                found |= {".".join(rest)} if rest else {alias.name for alias in node.names}
        elif isinstance(node, ast.Import):
            found |= {
                a.name.removeprefix("twistax").lstrip(".") for a in node.names if a.name.split(".")[0] == "twistax"
            }
    return found


def upward_imports(path: Path) -> list[str]:
    mine = layer_of(".".join(path.relative_to(SOURCE).with_suffix("").parts))
    return [f"{path.name} imports {module}" for module in imported_modules(path) if layer_of(module) > mine]


def test_no_file_imports_a_higher_layer() -> None:
    assert [line for path in sorted(SOURCE.rglob("*.py")) for line in upward_imports(path)] == []


def test_the_check_sees_an_upward_import(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "groups").mkdir()
    bad = tmp_path / "groups" / "bad.py"
    bad.write_text("from ..expr.node import Expr\nfrom .. import system\nimport twistax.trajectory\n")
    monkeypatch.setattr(sys.modules[__name__], "SOURCE", tmp_path)
    assert len(upward_imports(bad)) == 3


def imports(source: Path) -> dict[str, set[str]]:
    """For each module the modules of the package that it imports, lazily or for types too; packages around it aside."""
    modules = {}
    for path in source.rglob("*.py"):
        parts = path.relative_to(source).with_suffix("").parts
        modules[parts[:-1] if parts[-1] == "__init__" else parts] = path
    graph: dict[str, set[str]] = {}
    for module, path in modules.items():
        package = module if path.name == "__init__.py" else module[:-1]
        below = graph.setdefault(".".join(module), set())
        for node in ast.walk(ast.parse(path.read_text())):
            if not isinstance(node, ast.ImportFrom):
                continue
            stem = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                stem = (*package[: len(package) - node.level + 1], *stem)
            elif stem[0] != "twistax":
                continue
            else:
                stem = stem[1:]
            for alias in node.names:
                target = (*stem, alias.name) if (*stem, alias.name) in modules else stem
                if target != module[: len(target)]:
                    below.add(".".join(target))
    return graph


def test_no_imports_go_round_in_circles() -> None:
    graphlib.TopologicalSorter(imports(SOURCE)).prepare()  # raises a CycleError that names a circle


def test_the_check_sees_a_circle_of_lazy_imports(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def f():\n    from .b import g\n")
    (tmp_path / "b.py").write_text("from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from . import a\n")
    with pytest.raises(graphlib.CycleError, match="'a'"):
        graphlib.TopologicalSorter(imports(tmp_path)).prepare()


def sizes(root: Path) -> Iterator[tuple[str, int, int]]:
    """Everything of a tree that has a size, as (what, size, bound): lines of files and functions, files of folders."""
    for path in root.rglob("*.py"):
        text = path.read_text()
        yield str(path.relative_to(root)), len(text.splitlines()), 400
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                body = node.body[1:] if ast.get_docstring(node) and len(node.body) > 1 else node.body
                yield f"{path.relative_to(root)}: {node.name}", (node.end_lineno or 0) - body[0].lineno + 1, 60
    for folder in {path.parent for path in root.rglob("*.py")}:
        files = [path for path in folder.glob("*.py") if path.name != "__init__.py"]
        yield f"files in {folder.relative_to(root)}", len(files), 15


def test_files_functions_and_folders_are_small() -> None:
    assert [(what, size) for what, size, bound in sizes(SOURCE) if size > bound] == []
    lines = [(what, size) for what, size, bound in sizes(Path(__file__).parent) if size > bound == 400]
    assert lines == []


def test_the_check_sees_what_is_too_large(tmp_path: Path) -> None:
    (tmp_path / "long.py").write_text("def f():\n" + 401 * "    x = 1\n")
    for k in range(16):
        (tmp_path / f"file{k}.py").write_text("")
    assert len([what for what, size, bound in sizes(tmp_path) if size > bound]) == 3


def run(code: str) -> str:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def loaded_by(statement: str) -> set[str]:
    """The modules that a statement loads beyond `import jax`."""
    code = f"import jax, sys; before = set(sys.modules); {statement}; print(*sorted(set(sys.modules) - before))"
    return set(run(code).split())


#: What `import twistax` leaves to those who use it: it would double the time of `import jax`.
HEAVY = (
    "diffrax",
    "equinox",
    "jaxtyping",
    "scipy",
    "matplotlib",
    "llvmlite",
    "viser",
    "jax.extend",
    "jax.experimental",
    "jax.scipy",
)
LAYERS_ABOVE = (
    "scalar.backends",
    "scalar.primitives",
    "scalar.targets",
    "system.dynamics",
    "solver",
    "integrators",
    "mechanics",
    "linear",
    "estimation",
    "trimming",
    "trajectory",
    "scenes",
    "report",
    "demo",
    "jax_inside",
    "view",
)


def test_import_loads_the_language_alone() -> None:
    """Its time is a matter of what it loads: within 0.3 of `import jax`, where everything takes 0.85."""
    loaded = loaded_by("from twistax import progress")
    heavy = [*HEAVY, *(f"twistax.{layer}" for layer in LAYERS_ABOVE)]
    assert [name for name in loaded if any(f"{name}.".startswith(f"{each}.") for each in heavy)] == []
    assert len([name for name in loaded if name.split(".")[0] == "twistax"]) < 86


def test_what_is_loaded_later_is_what_type_checkers_see() -> None:
    block = next(
        node
        for node in ast.parse((SOURCE / "__init__.py").read_text()).body
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name)
    )
    seen = {
        f".{node.module}" if node.module else "": {alias.name for alias in node.names}
        for node in block.body
        if isinstance(node, ast.ImportFrom)
    }
    assert seen == {module: set(names) for module, names in twistax._LATER.items()}


#: Names that say nothing: the first column of the last table of the glossary.
_TABLE = (Path(__file__).parents[1] / "docs" / "glossary.md").read_text().rpartition("## Names")[2]
SAY_NOTHING = {name for row in re.findall(r"^\|(.*?)\|", _TABLE, re.MULTILINE) for name in re.findall(r"`(\w+)`", row)}
#: Fields that keep such a name: two are public or stand in saved files.
KEPT = {
    ("expr/transformations/rate.py", "along"),
    ("mechanics/models/daveml/static_checks.py", "found"),
    ("scalar/primitives/entry.py", "moves"),
}


def names_of_values(path: Path) -> Iterator[str]:
    """The variables, fields and parameters of a file."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id


def test_values_are_named_after_what_they_are() -> None:
    assert len(SAY_NOTHING) > 30
    names = ((path.relative_to(SOURCE).as_posix(), names_of_values(path)) for path in SOURCE.rglob("*.py"))
    assert {(path, name) for path, of_file in names for name in of_file if name in SAY_NOTHING} == KEPT


def test_every_public_name_is_there() -> None:
    assert len(set(twistax.__all__)) == len(twistax.__all__)
    assert [name for name in twistax.__all__ if getattr(twistax, name, None) is None] == []
    assert set(twistax.__all__) <= set(dir(twistax))
    # What the face of mechanics imports is public: type checkers take nothing else from it.
    own = vars(twistax.mechanics)
    functions = {name for name, value in own.items() if getattr(value, "__module__", "").startswith("twistax.")}
    assert functions <= set(twistax.mechanics.__all__)


def test_every_public_thing_has_one_home() -> None:
    faces = [
        "lie",
        "linalg",
        "spatial",
        "tableaus",
        "charts",
        "compositions",
        "diffrax",
        "mechanics",
        "trajectory",
        "estimation",
    ]
    modules = {"tx": twistax} | {f"tx.{name}": getattr(twistax, name) for name in faces}
    homes: dict[int, set[str]] = {}
    for place, module in modules.items():
        for name in module.__all__:
            homes.setdefault(id(getattr(module, name)), set()).add(place)
    assert [places for places in homes.values() if len(places) > 1] == []


def test_import_leaves_the_configuration_alone() -> None:
    code = (
        "import jax, os; keep = (dict(jax.config.values), dict(os.environ)); import twistax;"
        "print(keep == (dict(jax.config.values), dict(os.environ)))"
    )
    assert run(code) == "True"


def test_lazy_names_resolve() -> None:
    assert twistax.trajectory.Problem is not None
    assert twistax.diffrax.ambient_term is not None
    assert issubclass(twistax.Minimize, twistax.trajectory.Objective)
    with pytest.raises(AttributeError, match="nonsense"):
        _ = twistax.nonsense


@pytest.mark.parametrize(
    ("name", "fix"),
    [
        ("Clip", r"np.clip\(...\) takes"),
        ("norm", r"tx.linalg.Norm\?"),
        ("RK4", r"tx.tableaus.RK4\?"),
        ("ATan2", r"tx.Atan2\?"),
        ("intergrate", r"tx.integrate\?"),
    ],
)
def test_a_name_that_is_none_says_where_it_is(name: str, fix: str) -> None:
    with pytest.raises(AttributeError, match=f"no attribute '{name}'.\n  fix: .*{fix}"):
        getattr(twistax, name)
    assert not hasattr(twistax, f"{name}.{name}")
    assert twistax._where_else("scenes") == ".\n  fix: import twistax.scenes"


@pytest.mark.parametrize("tier", ["smoke", "thorough", "slow"])
def test_a_tier_names_tests_that_exist(tier: str) -> None:
    tests = Path(__file__).parent
    named = tomllib.loads((tests / "tiers.toml").read_text())[tier]["tests"]
    assert len(named) == len(set(named))
    for file, _, test in (name.partition("::") for name in named):
        assert f"def {test.partition('[')[0]}" in (tests / file).read_text(), f"{file} {test}"
    packages = {path.name for path in SOURCE.iterdir() if path.is_dir() and path.name != "__pycache__"}
    packages = {"lowering" if name in ("scalar", "system") else name for name in packages} - {
        "monte_carlo",
        "jax_inside",
    }
    assert tier != "smoke" or packages - {"report"} <= {name.split("/")[0] for name in named}


def test_types_and_shapes_are_checked_while_tests_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the hook of conftest.py, which leaves shapes to the functions of groups: it would be gone in silence."""
    with pytest.raises(BeartypeCallHintParamViolation):
        twistax.checks.listed(3)
    monkeypatch.setattr(so3, "rigid_polynomial", lambda *_: jnp.zeros((2, 2)))
    with pytest.raises(jaxtyping.TypeCheckError):
        so3.exp.__wrapped__(jnp.zeros(3))  # an earlier call left its program
    annotating = [path.name for path in SOURCE.rglob("*.py") if "from jaxtyping" in path.read_text()]
    assert annotating == ["annotations.py"]


def test_a_journey_of_the_page_for_contributors_has_at_most_twelve_files() -> None:
    page = (Path(__file__).parents[1] / "docs" / "contributing.md").read_text()
    section = page.partition("## Journeys\n")[2].partition("\n## ")[0]
    parts = re.split(r"^\*\*(.+?)\.\*\*", section, flags=re.MULTILINE)[1:]
    files = [re.findall(r"`[\w/]+\.(?:py|json)`", text) for text in parts[1::2]]
    assert len(files) >= 7
    assert {title: len(names) for title, names in zip(parts[::2], files, strict=True) if len(names) > 12} == {}
