"""What every node class promises, checked on the examples it gives of itself by the laws of `tx.testing`."""

import re

import pytest
from expr_cases import CASES, NODES

from twistax.expr import Expr
from twistax.testing import nodes

by_case = pytest.mark.parametrize("case", CASES, ids=str)
by_node = pytest.mark.parametrize("node", NODES, ids=lambda node: f"{node.__module__.split('.')[-1]}.{node.__name__}")


@by_case
def test_values_and_derivatives(case: nodes.Case) -> None:
    nodes.values_and_derivatives(case)


@by_case
def test_inferred_shape_and_precision(case: nodes.Case) -> None:
    nodes.shape_and_precision(case)


@by_case
def test_canonical_form_is_stable(case: nodes.Case) -> None:
    nodes.canonical_form(case)


@by_case
def test_structure_and_printing(case: nodes.Case) -> None:
    nodes.structure_and_printing(case)


@by_case
def test_a_node_is_immutable(case: nodes.Case) -> None:
    nodes.immutability(case)


@by_case
def test_a_rule_of_kinds_is_stated(case: nodes.Case) -> None:
    nodes.rule_of_kinds(case)


def test_no_law_is_left_out() -> None:
    """Each law of `check_node` has a test of its own above, so that a failure names its case."""
    called = {name for test in globals().values() for name in getattr(getattr(test, "__code__", None), "co_names", ())}
    assert {law.__name__ for law in nodes.LAWS} <= called


@by_node
def test_docstring(node: type[Expr]) -> None:
    """A first sentence, something about shapes, and what is raised, where something can be."""
    text = node.__doc__ or ""
    assert text.split("\n")[0].rstrip().endswith((".", ":"))
    assert re.search(r"[Ss]hape|entry by entry|scalar|vector|number", text)
    if nodes.shapes_are_checked(node):
        assert "Raises:" in text
        assert "ShapeError" in text


def test_all_families_are_found() -> None:
    names = {node.__name__ for node in NODES}
    assert {"Add", "Index", "Block", "Sin", "Cinterp", "Cond", "Solve", "SSMP", "Vmap", "Inequality", "Time"} <= names
    assert not names & {"Expr", "Leaf", "Variable", "Constraint", "Entrywise", "Placeholder"}
    assert len(NODES) >= 64
