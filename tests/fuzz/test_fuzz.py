"""The differential fuzzer: it is quick, its cases are varied, and it sees what is wrong."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from check import check
from groups_of_motion import bracket
from grow import drawn
from matrices import inverting
from oracle import oracle
from plans import MAKERS
from put_back import TABLE, located
from shrink import smallest
from term import Case, Term
from users_nodes import around

import twistax as tx


@pytest.mark.parametrize("number", range(8))
def test_every_path_gives_the_number_of_numpy(number: int, unchecked: None) -> None:
    case = drawn(12, number)
    case = replace(case, terms=case.terms[:3])
    assert check(case) == "", case.as_code()


@pytest.mark.parametrize("number", [43, 51, 59, 67, 75])
def test_so_does_every_path_of_a_tree(number: int, unchecked: None) -> None:
    """And its canonical form stays as it is."""
    case = drawn(12, number)
    assert check(case) == "", case.as_code()


def test_most_terms_say_something_and_all_operations_come() -> None:
    cases = [drawn(0, number) for number in range(120)]
    terms = [(case, term) for case in cases[:10] for term in case.terms]
    assert sum(oracle(*each) is not None for each in terms) > 0.6 * len(terms)
    code = "\n".join(term.code for case in cases for term in case.walk())
    parts = "tx.Where tx.Cond Solve Inv Vmap User [::-1 np.dot AdjointDual Stack Weighted Bilerp ANGULAR axis=1"
    assert [part for part in parts.split() if part not in code] == []
    for name in ("batched", "single", "differentiated", "whole", "narrow", "extreme"):
        assert any(getattr(case, name) for case in cases), name
    assert len(MAKERS) >= 10


def one(term: Term, leaves: dict[str, Any], **settings: bool) -> Case:
    return Case((term,), {name: np.array(value) for name, value in leaves.items()}, **settings)


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
    case = one(Term(code, numpy, (LEAF,), shape), {"s0": [0.5, 1.25, -2.0]})
    assert check(case).startswith(path)


@jax.custom_jvp
def twice(a: jax.Array) -> jax.Array:
    return 2.0 * a


twice.defjvp(lambda p, t: (twice(p[0]), 3.0 * t[0]))


class Twice(tx.Sin):
    """2 x, entry by entry, with a slope of 3."""

    def evaluate(self, *values: Any) -> Any:
        return twice(values[0])


def test_wrong_derivatives_are_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of right values, by the slopes of NumPy's."""
    monkeypatch.setattr(tx, "Twice", Twice, raising=False)
    case = one(Term("tx.Twice({0})", lambda a: 2.0 * a, (LEAF,), (3,)), {"s0": [0.5, 1.25, -2.0]}, differentiated=True)
    assert check(case).startswith("arrays, slope")
    assert check(replace(case, differentiated=False)) == ""


def test_ends_of_the_range_count_for_single_operations() -> None:
    leaves = {"s0": [np.nan, 1e200, -np.inf]}
    assert check(one(Term("tx.Abs({0})", np.abs, (LEAF,), (3,)), leaves, extreme=True)) == ""
    wrong = one(Term("tx.Sqrt({0} * {0})", np.abs, (LEAF,), (3,)), leaves, extreme=True)
    assert check(wrong).startswith("tx.lower")


def test_an_inverse_may_lose_what_elimination_loses() -> None:
    """In a product with a right-hand side of which most cancels; and no more than that."""
    left, right = np.linalg.qr(np.random.default_rng(1).normal(size=(2, 3, 3)))[0]
    A = (left * np.geomspace(1.0, 1e-4, 3)) @ right
    leaves = {"s0": A, "s1": A @ np.ones(3)}
    nodes = [Term(f'tx.State("{name}", shape={a.shape})', np.asarray, (), a.shape, name) for name, a in leaves.items()]

    def said(off: float, rounding: Callable[..., Any] | None = inverting) -> str:
        """Of an inverse that is off by so much of what may be."""
        far = off * np.finfo(float).eps * inverting(A)
        inverse = Term("tx.linalg.Inv({0})", lambda a: np.linalg.inv(a) + far, (nodes[0],), (3, 3), rounding=rounding)
        return check(one(Term("({0} @ {1})", np.matmul, (inverse, nodes[1]), (3,)), leaves))

    assert said(0.4) == ""
    assert said(10.0).startswith("tx.lower")
    assert said(0.4, rounding=None).startswith("tx.lower")


def test_products_of_a_sum_may_be_rounded_or_not() -> None:
    """In one instruction a b - c d is what the rounding of c d leaves, where NumPy has zero."""
    a, b = [-1.0, 16777217.0, 398600441800000.0], [-2.0, 16777217.0, 398600441800000.0]
    other = Term('tx.State("s1", shape=(3,))', np.asarray, (), (3,), leaf="s1")
    plan = bracket("tx.linalg.Cross({0}, {1})", lambda a: np.cross(np.eye(3), a), (3,), (3,))
    for off, right in ((1.5e5, True), (1e9, False)):
        cross = lambda a, b, off=off: np.cross(a, b) + [off, 0.0, 0.0]  # noqa: E731
        term = Term(plan.code, cross, (LEAF, other), (3,), rounding=plan.rounding)
        assert (check(one(term, {"s0": a, "s1": b})) == "") is right


def test_values_beside_the_first_are_seen() -> None:
    """Of a batch, and of calls one by one; and shrinking keeps the one that is wrong."""
    wrong = Term("tx.Sin({0})", lambda a: np.where(a > 2.0, 0.0, np.sin(a)), (LEAF,), (3,))
    more = tuple({"s0": np.array([0.5, k, -2.0])} for k in (1.0, 2.5))
    for settings in ({}, {"batched": True}, {"called": True}):
        case = one(wrong, {"s0": [0.5, 1.25, -2.0]}, **settings)
        assert check(case) == ""
        said = check(replace(case, more=more))
        assert said.startswith("tx.lower")
    small, _ = smallest(replace(case, more=more), check, said)
    assert not small.more
    assert small.leaves["s0"][1] == 2.5


def test_a_wrong_case_is_shrunk_to_its_core() -> None:
    wrong = Term("tx.Sin({0})", lambda a: np.sin(a) + 1e-3, (LEAF,), (3,))
    cosine = Term("tx.Cos({0})", np.cos, (LEAF,), (3,))
    more = Term("({0} + {1})", np.add, (wrong, cosine), (3,))
    whole = Term("tx.linalg.Sum({0})", np.sum, (Term("({0} * 2.0)", lambda a: a * 2.0, (more,), (3,)),), ())
    case = Case((cosine, whole), {"s0": np.array([0.5, 1.25, -2.0])}, batched=True)
    small, said = smallest(case, check, check(case))
    assert len(small.terms) == 1
    assert sum(1 for _ in small.walk()) == 2
    assert said.startswith("tx.lower")
    assert "tx.Sin(s0)" in small.as_code()
    assert not small.batched


@pytest.mark.parametrize("narrow", [False, True])
def test_the_script_of_a_case_prints_its_value(narrow: bool, capsys: pytest.CaptureFixture[str]) -> None:
    code = "tx.Sin({0}) + {1} * tx.Constant(np.array(2.0))"
    control = Term('tx.Control("c1", shape=())', np.asarray, (), (), leaf="c1")
    leaves = {"s0": [0.5, np.inf, -2.0], "c1": 2.0}
    case = one(Term(code, lambda a, b: np.sin(a) + 2.0 * b, (LEAF, control), (3,)), leaves, whole=True, narrow=narrow)
    with jax.enable_x64(True):
        exec(case.as_code(), {"__name__": "script"})
        jax.config.update("jax_enable_x64", True)
    said = capsys.readouterr().out
    assert "4.479" in said
    assert "nan" in said


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row[0])
def test_errors_can_still_be_put_back(row: tuple[str, str, str]) -> None:
    assert located(row[1]).exists()


def test_a_term_without_a_form_leaves_the_others_theirs(monkeypatch: pytest.MonkeyPatch) -> None:
    """What draws random numbers has no kernel; what is compiled with it keeps its own."""

    def broken(*_: Any, **__: Any) -> None:
        raise RuntimeError("a kernel is made")

    random = "jax.random.normal(jax.random.key(3), a.shape, jnp.float32).astype(a.dtype)"
    plan = around(f"a * {random}", (3,))
    foreign = Term(plan.code, plan.numpy, (LEAF,), (3,), setup=plan.setup)
    sine = Term("tx.Sin({0})", np.sin, (LEAF,), (3,))
    case = one(foreign, {"s0": [0.5, 1.25, -2.0]})
    monkeypatch.setattr(type(tx.Native().runner), "built", broken)
    assert check(case) == ""
    assert "a kernel is made" in check(replace(case, terms=(foreign, sine)))


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
    assert check(one(Term(code, numpy, (LEAF,), (3,), setup=setup), {"s0": [0.5, 1.25, -2.0]})) == ""
