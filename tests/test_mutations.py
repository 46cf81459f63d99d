"""Mutation testing: what the operators do, what they leave alone, and a sample of the core that the tests must kill."""

import ast
import itertools
from pathlib import Path

import pytest

from mutations import OPERATORS, PACKAGE, ROOT, TESTS, files_for, mutants_of, mutants_of_llvm, run, sampled


def mutated(source: str) -> set[tuple[str, str]]:
    """Operator and text of every mutant of a source."""
    return {(m.operator, m.applied(source.encode()).decode()) for m in mutants_of(Path("some.py"), source.encode())}


@pytest.mark.parametrize(
    ("operator", "source", "result"),
    [
        ("arithmetic swapped", "é = a + b  # ö", "é = (a - b)  # ö"),
        ("arithmetic swapped", "x = f(a *\n    b)", "x = f((a / b))"),
        ("factors swapped", "x = R @ v", "x = (v @ R)"),
        ("sign dropped", "x = -w", "x = (w)"),
        ("bound moved", "x = a < b", "x = (a <= b)"),
        ("comparison negated", "x = a is None", "x = (a is not None)"),
        ("constant changed", "x = 0.5 * a", "x = (1.0) * a"),
        ("transposition dropped", "x = A.T @ b", "x = (A) @ b"),
        ("transposition dropped", "x = jnp.swapaxes(A, -1, -2)", "x = (A)"),
        ("transposition dropped", "x = A.transpose()", "x = (A)"),
        ("arguments swapped", "x = cross(a, b)", "x = (cross(b, a))"),
        ("index moved", "x = parts[0]", "x = (parts[1])"),
        ("operand returned", "def f(a, b):\n    return a - b", "def f(a, b):\n    return (a)"),
    ],
)
def test_an_operator(operator: str, source: str, result: str) -> None:
    assert (operator, result) in mutated(source)
    assert operator in {*OPERATORS, "operand returned"}


@pytest.mark.parametrize(
    "source",
    [
        'raise ValueError("a" + b)',
        'x = "a" + b',
        'x = f"{a + b}"',
        "x: tuple[1] = a",
        "def f(a: tuple[1]) -> list[2]: ...",
        "def __repr__(self):\n    return a + b",
        "class A:\n    cases = (0.5, -w)",
        "x = isinstance(a, b)",
        "x = f(a, a)",
    ],
)
def test_what_no_test_could_see_is_left_alone(source: str) -> None:
    assert mutated(source) == set()


def test_the_core_of_the_solver_has_mutants() -> None:
    source = b"  %3 = fadd contract double %1, %2\n  %4 = fcmp contract olt double %3, %1\n  ret double %3\n"
    first, second = mutants_of_llvm(Path("core.ll.xz"), source)
    assert first.applied(source) == source.replace(b"fadd", b"fsub")
    assert second.applied(source) == source.replace(b"olt", b"oge")
    assert (first.line, second.line) == (1, 2)


def test_every_folder_of_the_core_has_mutants_that_are_python_and_tests() -> None:
    mutants = list(itertools.islice(sampled(0, TESTS), 100))
    for folder, patterns in TESTS.items():
        assert any(mutant.path.is_relative_to(folder) for mutant in mutants), folder
        assert all(list((ROOT / "tests").glob(pattern)) for pattern in patterns.split()), folder
    for mutant in mutants:
        if mutant.path.suffix == ".py":
            source = (ROOT / PACKAGE / mutant.path).read_bytes()
            assert ast.dump(ast.parse(mutant.applied(source))) != ast.dump(ast.parse(source)), mutant


def test_tests_of_the_name_of_a_file_come_first() -> None:
    files = files_for(Path("integrators", "adaptive.py"))
    assert files[0] == "tests/integrators/test_adaptive.py"
    assert len(files) == len(set(files)) > 5


def test_a_sample_is_killed() -> None:
    """The first mutants of a seed, as many as 90 s allow. Of new code one in four may survive."""
    killed, survivors = run(sampled(SEED, SAMPLED), budget=90.0)
    assert killed
    assert len(survivors) <= len(killed) / 3, "\n".join(map(str, survivors))


#: A seed and folders whose first mutants are known to be killed, each within seconds.
SEED = 0
SAMPLED = ["groups", "expr/lie", "scalar", "integrators", "mechanics"]
