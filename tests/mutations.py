"""Mutation testing of the numerical core: operators make errors in it, one at a time, and a test must fail for each.

    python tests/mutations.py [--count N] [--seed S] [--only FOLDER ...] [--budget SECONDS] [--list]

A mutant is one expression of one file, replaced by what an operator makes of it. The sample takes the folders in turn,
in each the operators in turn, and of each operator the mutants in the order of a hash of the seed and their text: a
change elsewhere in the code, or a move of a file, leaves the sample nearly as it is. A mutant stands in a copy of the
tree, where the tests of its folder run in a process. It is killed if one fails or crashes. The exit status is 0 if none
survives.
"""

import argparse
import ast
import collections
import hashlib
import itertools
import lzma
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = Path("src", "twistax")

#: Folders of the package, and the files below tests/ that concern them. The longest prefix of a file counts, and tests
#: named after the file come first.
TESTS = {
    "groups": "groups/test_se3_forms.py groups/test_group_[sai]*.py groups/test_*.py integrators/test_charts.py",
    "expr": "expr/test_node_values.py expr/test_[acefiou]*.py expr/test_[nr]*.py internals/test_sp*.py",
    "expr/lie": "expr/test_lie_*.py expr/test_attitude_nodes.py expr/test_coscrews.py",
    "system": "lowering/test_dynamics.py lowering/test_hessian.py lowering/test_lower.py lowering/test_[bcflrs]*.py",
    "scalar": "internals/scalar/test_*.py lowering/test_range.py",
    "scalar/targets/cuda": "internals/native/test_cuda_*.py",
    "scalar/targets/llvm": "internals/native/test_*.py lowering/native/test_*.py",
    "system/export": "lowering/export/test_*.py",
    "integrators": "integrators/test_fixed.py integrators/test_[acefims]*.py internals/test_s*.py",
    "integrators/splitting": "integrators/test_split*.py integrators/test_compositions.py",
    "integrators/diffrax_bridge": "integrators/test_lie_solver*.py",
    "mechanics": "mechanics/test_two_bodies.py mechanics/test_serial*.py mechanics/test_[bcjmrst]*.py",
    "mechanics/flight": "mechanics/test_flight*.py mechanics/test_f16.py mechanics/test_two_stage_rocket.py",
    "mechanics/environment": "mechanics/test_environment.py mechanics/test_gravity*.py mechanics/test_flight*.py",
    "mechanics/models": "mechanics/test_m*.py mechanics/test_urdf_files.py mechanics/test_daveml.py",
    "solver": "solver/test_*.py",
    "linear": "linear/test_*.py",
    "estimation": "estimation/test_*.py",
    "trimming": "trimming/test_*.py",
    "trajectory": "internals/trajectory/test_*.py trajectory/test_known_answers.py trajectory/test_[bcdhlnoptu]*.py",
    "trajectory/sensitivity": "trajectory/test_sens*.py trajectory/test_solution*.py trajectory/test_by_node.py",
    "trajectory/adapters": "trajectory/test_external.py",
}

#: What a run of the tests reads.
PARTS = ["src", "tests", "docs", "examples", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "LICENSE"]
PARTS += ["pyproject.toml"]

#: Seconds after which the run of a mutant is stopped. Nothing is known of it then: it may loop without an end.
LIMIT = 600

#: Statements whose text is for people or for the type checker.
UNCHANGED = (ast.Raise, ast.Assert, ast.JoinedStr, ast.Import, ast.ImportFrom)

#: Functions and attributes of classes that are text or cases for tests.
NOT_TESTED = {"__repr__", "__str__", "cases", "kinks", "example", "examples"}

#: Functions whose arguments in another order are a TypeError that any call sees, or give the same.
ORDERED = {"isinstance", "issubclass", "hasattr", "getattr", "setattr", "zip", "max", "min", "print", "partial", "cast"}
ORDERED |= {
    "add",
    "mul",
    "multiply",
    "minimum",
    "maximum",
    "dot",
    "logical_and",
    "logical_or",
    "hypot",
    "gcd",
    "reduce",
}

Operator = Callable[[ast.expr], Iterator[ast.expr]]
OPERATORS: dict[str, Operator] = {}


def operator(function: Operator) -> Operator:
    """Registers a function that yields what stands in place of an expression."""
    OPERATORS[function.__name__.replace("_", " ")] = function
    return function


def _with(node: ast.expr, **fields: object) -> ast.expr:
    return type(node)(**{name: getattr(node, name) for name in node._fields} | fields)  # type: ignore[arg-type]


def _same(a: ast.AST, b: ast.AST) -> bool:
    return ast.dump(a) == ast.dump(b)


@operator
def arithmetic_swapped(node: ast.expr) -> Iterator[ast.expr]:
    other = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
    text = (ast.JoinedStr, ast.List, ast.Tuple)
    if isinstance(node, ast.BinOp) and type(node.op) in other:
        sides = (node.left, node.right)
        if not any(isinstance(s, text) or (isinstance(s, ast.Constant) and isinstance(s.value, str)) for s in sides):
            yield _with(node, op=other[type(node.op)]())


@operator
def factors_swapped(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.MatMult) and not _same(node.left, node.right):
        yield _with(node, left=node.right, right=node.left)


@operator
def sign_dropped(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        yield node.operand


@operator
def bound_moved(node: ast.expr) -> Iterator[ast.expr]:
    other = {ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt}
    if isinstance(node, ast.Compare) and type(node.ops[0]) in other:
        yield _with(node, ops=[other[type(node.ops[0])](), *node.ops[1:]])


@operator
def comparison_negated(node: ast.expr) -> Iterator[ast.expr]:
    other = {ast.Lt: ast.GtE, ast.LtE: ast.Gt, ast.Gt: ast.LtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
    other |= {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
    if isinstance(node, ast.Compare):
        yield _with(node, ops=[other[type(node.ops[0])](), *node.ops[1:]])


@operator
def constant_changed(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Constant) and isinstance(node.value, float) and node.value in (0.5, 1.0, 2.0):
        yield ast.Constant({0.5: 1.0, 1.0: 2.0, 2.0: 1.0}[node.value])


@operator
def transposition_dropped(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Attribute) and node.attr in ("T", "mT"):
        yield node.value
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        if node.func.attr == "transpose" and not node.args:
            yield node.func.value
        if node.func.attr in ("swapaxes", "transpose", "matrix_transpose") and node.args:
            yield node.args[0]


@operator
def arguments_swapped(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Call) and len(node.args) > 1 and not any(isinstance(a, ast.Starred) for a in node.args):
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        first, second, *others = node.args
        words = any(isinstance(a, ast.Constant) and isinstance(a.value, str) for a in (first, second))
        if name not in ORDERED and not words and not _same(first, second):
            yield _with(node, args=[second, first, *others])


@operator
def index_moved(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Subscript) and isinstance(node.slice, ast.Constant) and isinstance(node.slice.value, int):
        yield _with(node, slice=ast.Constant(node.slice.value + 1))


@dataclass(frozen=True, order=True)
class Mutant:
    """One expression replaced.

    Attributes:
        path: the file below src/twistax.
        line: where the expression begins.
        operator: what was done to it.
        span: its bytes in the file, from and to.
        before, after: the text of the expression.
    """

    path: Path
    line: int
    operator: str
    span: tuple[int, int]
    before: str
    after: str

    def applied(self, source: bytes) -> bytes:
        return source[: self.span[0]] + self.after.encode() + source[self.span[1] :]

    def __str__(self) -> str:
        return f"{self.path}:{self.line}  {self.operator}: {self.before}  ->  {self.after}"


def _values(node: ast.AST) -> Iterator[tuple[str, ast.expr, ast.expr]]:
    """Operator, expression and replacement within a node: no annotations, decorators, errors or tests of types."""
    names = [node.name] if isinstance(node, ast.FunctionDef) else getattr(node, "targets", [])
    if isinstance(node, UNCHANGED) or any(getattr(name, "id", name) in NOT_TESTED for name in names):
        return
    if isinstance(node, ast.Return) and isinstance(node.value, ast.BinOp):
        yield "operand returned", node.value, node.value.left
    if isinstance(node, ast.expr):
        yield from ((name, node, new) for name, make in OPERATORS.items() for new in make(node))
    for field, value in ast.iter_fields(node):
        if field not in ("annotation", "returns", "decorator_list", "type_params"):
            for child in value if isinstance(value, list) else [value]:
                if isinstance(child, ast.AST):
                    yield from _values(child)


def mutants_of(path: Path, source: bytes) -> Iterator[Mutant]:
    """All mutants of a file of Python."""
    starts = [0, *itertools.accumulate(len(line) for line in source.splitlines(keepends=True))]
    for name, old, new in _values(ast.parse(source)):
        span = (starts[old.lineno - 1] + old.col_offset, starts[old.end_lineno - 1] + old.end_col_offset)  # type: ignore[operator]
        yield Mutant(path, old.lineno, name, span, ast.unparse(old), f"({ast.unparse(new)})")


def mutants_of_llvm(path: Path, source: bytes) -> Iterator[Mutant]:
    """All mutants of the solver's core, whose C stands compiled into LLVM's language: other arithmetic and bounds."""
    other = {b"fadd": "fsub", b"fsub": "fadd", b"fmul": "fdiv", b"fdiv": "fmul", b"olt": "oge", b"ogt": "ole"}
    line, before = 1, 0
    for match in re.finditer(rb" = (?:contract )?(fadd|fsub|fmul|fdiv|fcmp (?:contract )?(?:olt|ogt)) .*", source):
        word = match[1].split()[-1]
        span = (match.end(1) - len(word), match.end(1))
        line, before = line + source.count(b"\n", before, span[0]), span[0]
        yield Mutant(path, line, "instruction", span, match[0].decode(), other[word])


MAKERS = {".py": mutants_of, ".xz": mutants_of_llvm}


def read(path: Path) -> bytes:
    return lzma.decompress(path.read_bytes()) if path.suffix == ".xz" else path.read_bytes()


def write(path: Path, source: bytes) -> None:
    path.write_bytes(lzma.compress(source, preset=0) if path.suffix == ".xz" else source)


def folder_of(path: Path) -> str:
    """The longest key of TESTS that a file stands in; nothing outside of the core."""
    return max((key for key in TESTS if path.is_relative_to(key)), key=len, default="")


def files_for(path: Path, tree: Path = ROOT) -> list[str]:
    """The test files of a tree that concern a file of the package: those of its name, then those of its folder."""
    tests = tree / "tests"
    name = f"test_{path.stem}"
    files = sorted(tests.rglob(f"{name}*.py"), key=lambda file: (file.stem != name, file))
    files += [file for pattern in TESTS[folder_of(path)].split() for file in sorted(tests.glob(pattern))]
    return [str(file.relative_to(tree)) for file in dict.fromkeys(files)]


def in_turn(queues: Iterable[Iterable[Mutant]]) -> Iterator[Mutant]:
    for row in itertools.zip_longest(*queues):
        yield from (mutant for mutant in row if mutant is not None)


def sampled(seed: int, folders: Iterable[str]) -> Iterator[Mutant]:
    """Mutants of these folders in turn, of the operators in turn, each in the order of a hash of its text."""
    strata: dict[str, dict[str, list[tuple[str, Mutant]]]] = {folder: {} for folder in folders}
    repeated: collections.Counter[str] = collections.Counter()
    for file in sorted((ROOT / PACKAGE).rglob("*")):
        path = file.relative_to(ROOT / PACKAGE)
        if (make := MAKERS.get(path.suffix)) and folder_of(path) in strata:
            for mutant in make(path, read(file)):
                text = f"{seed} {path.stem} {mutant.operator} {mutant.before}"
                repeated[text] += 1
                place = hashlib.sha256(f"{text} {repeated[text]}".encode()).hexdigest()
                strata[folder_of(path)].setdefault(mutant.operator, []).append((place, mutant))
    return in_turn(
        in_turn([mutant for _, mutant in queue] for queue in sorted(map(sorted, operators.values())))
        for operators in strata.values()
    )


def copy_to(folder: str, parts: Iterable[str] = PARTS) -> Path:
    """A copy of the tree, with the times of its files: what Python has compiled of them stays good."""
    tree = Path(folder)
    for part in parts:
        source = ROOT / part
        (shutil.copytree if source.is_dir() else shutil.copy2)(source, tree / part)
    return tree


def pytest(tree: Path, tests: list[str], limit: float) -> tuple[int, str]:
    """Exit status and output of the tests of a tree. Raises TimeoutExpired."""
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", "--tb=no", "-rfE", "-x", "-n", "0", *tests]
    environment = os.environ | {"PYTHONPATH": str(tree / "src"), "JAX_PLATFORMS": "cpu"}
    run = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=limit)
    return run.returncode, run.stdout + run.stderr


def killed_by(tree: Path, mutant: Mutant, limit: float) -> str:
    """What the tests say of a mutant: the test that fails, or nothing where it survives.

    Raises:
        RuntimeError: no test could run.
        subprocess.TimeoutExpired: they are stopped.
    """
    file = tree / PACKAGE / mutant.path
    packed, source = file.read_bytes(), read(file)
    write(file, mutant.applied(source))
    try:
        status, output = pytest(tree, files_for(mutant.path, tree), limit)
    finally:
        file.write_bytes(packed)
    # 1 is a test that failed, 2 an error while tests are collected, a negative number a process that crashed.
    if status not in (0, 1, 2) and status > 0:
        raise RuntimeError(f"{mutant}\n{output[-2000:]}")
    failed = re.search(r"^(?:FAILED|ERROR) (\S.*?)(?: - .*)?$", output, re.MULTILINE)
    return "" if status == 0 else failed[1] if failed else f"the process ends with status {status}"


def run(mutants: Iterable[Mutant], budget: float, limit: float = LIMIT) -> tuple[list[Mutant], list[Mutant]]:
    """The mutants that are killed and those that survive, of as many as the seconds of the budget allow."""
    killed, survivors, end = [], [], time.monotonic() + budget
    with tempfile.TemporaryDirectory(prefix="mutation_") as folder:
        tree = copy_to(folder)
        for mutant in mutants:
            begin = time.monotonic()
            if begin >= end:
                break
            try:
                test = killed_by(tree, mutant, min(limit, end - begin))
                (killed if test else survivors).append(mutant)
            except subprocess.TimeoutExpired:
                test = "stopped"
            print(f"{time.monotonic() - begin:4.0f} s  {mutant}  |  {test or 'SURVIVES'}", flush=True)
    return killed, survivors


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=40, help="how many mutants are tried")
    parser.add_argument("--seed", type=int, default=0, help="which ones")
    parser.add_argument("--only", nargs="+", default=list(TESTS), choices=list(TESTS), help="folders of the package")
    parser.add_argument("--budget", type=float, default=float("inf"), help="seconds that all may take")
    parser.add_argument("--limit", type=float, default=LIMIT, help="seconds that each may take")
    parser.add_argument("--list", action="store_true", help="print the sample and run nothing")
    arguments = parser.parse_args()
    mutants = itertools.islice(sampled(arguments.seed, arguments.only), arguments.count)
    if arguments.list:
        print(*mutants, sep="\n")
        return 0
    killed, survivors = run(mutants, arguments.budget, arguments.limit)
    print(f"{len(killed)} of {len(killed) + len(survivors)} mutants are killed. Survivors:", *survivors, sep="\n  ")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
