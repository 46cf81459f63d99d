"""The differential fuzzer: it is quick, its cases are varied, and it sees what is wrong."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from grow import Grower
from operations import MAKERS
from paths import check, oracle
from shrink import smallest
from term import Case, Term


def drawn(number: int, depth: int) -> Case:
    return Grower(Random(f"tests:{number}"), special=0.2 * (number % 2)).case(depth)


@pytest.mark.parametrize("number", range(10))
def test_every_path_gives_the_number_of_numpy(number: int, unchecked: None) -> None:
    case = drawn(number, 1 + number % 3)
    assert check(case) == "", case.as_code()


def test_most_cases_say_something_and_all_operations_come() -> None:
    cases = [drawn(number, 3) for number in range(150)]
    assert sum(oracle(case) is not None for case in cases) > 75
    code = "\n".join(term.code for case in cases for term in case.term.walk())
    for part in (
        "tx.Where",
        "tx.Cond",
        "Solve",
        "Inv",
        "Vmap",
        "User",
        "[::-1",
        "None",
        "np.dot",
        "AdjointDual",
        "Stack",
    ):
        assert part in code
    assert len(MAKERS) >= 10


LEAF = Term('tx.State("s0", shape=(3,))', np.asarray, (), (3,), leaf="s0")


@pytest.mark.parametrize(
    ("code", "numpy", "path"),
    [
        ("tx.Sin({0})", np.cos, "tx.lower"),
        ("tx.Sin({0} + 1e-9)", np.sin, "tx.lower"),
        ("{0}[:2]", lambda a: a[1:], "tx.lower"),
        ("tx.linalg.Norm({0}[:1])", lambda a: np.abs(a), "tx.lower"),
        ("tx.Sine({0})", np.sin, "after build"),
    ],
)
def test_what_is_wrong_is_seen(code: str, numpy: Callable[..., Any], path: str) -> None:
    shape = np.shape(numpy(np.zeros(3)))
    case = Case(Term(code, numpy, (LEAF,), shape), {"s0": np.array([0.5, 1.25, -2.0])})
    assert check(case).startswith(path)


def test_a_wrong_case_is_shrunk_to_its_core() -> None:
    wrong = Term("tx.Sin({0})", lambda a: np.sin(a) + 1e-3, (LEAF,), (3,))
    more = Term("({0} + {1})", np.add, (wrong, Term("tx.Cos({0})", np.cos, (LEAF,), (3,))), (3,))
    whole = Term("tx.linalg.Sum({0})", np.sum, (Term("({0} * 2.0)", lambda a: a * 2.0, (more,), (3,)),), ())
    case = Case(whole, {"s0": np.array([0.5, 1.25, -2.0])}, batched=True)
    small, said = smallest(case, check, check(case))
    assert small.term.size() == 2
    assert said.startswith("tx.lower")
    assert "tx.Sin(s0)" in small.as_code()
    assert not small.batched


def test_the_script_of_a_case_prints_its_value(capsys: pytest.CaptureFixture[str]) -> None:
    code = "tx.Sin({0}) + {1} * tx.Constant(np.array(2.0))"
    control = Term('tx.Control("c1", shape=())', np.asarray, (), (), leaf="c1")
    leaves = {"s0": np.array([0.5, np.inf, -2.0]), "c1": np.array(0.25)}
    case = Case(Term(code, lambda a, b: np.sin(a) + 2.0 * b, (LEAF, control), (3,)), leaves, batched=True)
    exec(case.as_code(), {"__name__": "script"})
    said = capsys.readouterr().out
    assert "0.979" in said
    assert "nan" in said


def test_users_nodes_reach_scalars() -> None:
    """The update function of `apply` is part of the operation."""
    code = "User({0})"
    setup = (
        "class User(tx.Expr):\n"
        '    """A node of the user."""\n'
        "    a: tx.expr.fields.Operand\n"
        "    def infer_shape(self, a): return a\n"
        "    def evaluate(self, a): return a.at[:2].apply(jnp.tanh)"
    )
    numpy = lambda a: np.asarray(jnp.asarray(a).at[:2].apply(jnp.tanh))  # noqa: E731
    case = Case(Term(code, numpy, (LEAF,), (3,), setup=setup), {"s0": np.array([0.5, 1.25, -2.0])})
    assert check(case) == ""
