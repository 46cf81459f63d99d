"""What every node class promises, checked on the examples it gives of itself."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from expr_cases import CASES, NODES, Case, function_of

from twistax.errors import ImmutableError, ShapeError
from twistax.expr import Expr

by_case = pytest.mark.parametrize("case", CASES, ids=str)
by_node = pytest.mark.parametrize("node", NODES, ids=lambda node: f"{node.__module__.split('.')[-1]}.{node.__name__}")

#: Step of the central difference of fourth order, its weights, and what it resolves of slopes of order one.
STEP, RESOLVED = 2e-4, 1e-8
STENCIL = {2: -1.0 / 12.0, 1: 2.0 / 3.0, -1: -2.0 / 3.0, -2: 1.0 / 12.0}


_COMPILED: dict[Any, Callable[..., dict[str, jax.Array]]] = {}


def compiled(case: Case) -> Callable[..., dict[str, jax.Array]]:
    """All that is checked of an expression in one compiled function, shared by examples that differ in numbers only."""
    expr = case.example.expr
    canonical = expr.canonicalize()
    key = expr.key(), tuple((name, value.shape) for name, value in sorted(case.values.items()))
    _, back = case.flat()

    def flat(z: jax.Array) -> jax.Array:
        return function_of(expr)(back(z))[0].astype(z.dtype).ravel()

    def everything(z: jax.Array, batch: jax.Array, along: jax.Array, across: jax.Array) -> dict[str, jax.Array]:
        found = {"batch": jax.vmap(flat)(batch)}
        if canonical.key() != expr.key():
            (found["canonical"],) = function_of(canonical)(back(z))
        if expr.boolean:
            return found | {"value": flat(z)}
        found["value"], push = jax.linearize(flat, z)
        (vjp,) = jax.linear_transpose(push, z)(across)
        return found | {"jvp": push(along), "vjp": vjp}

    if key not in _COMPILED:
        # Half the time of this suite is XLA's: nothing here depends on how much it optimises.
        _COMPILED[key] = jax.jit(everything, compiler_options={"xla_backend_optimization_level": 0})
    return _COMPILED[key]


@by_case
def test_values_and_derivatives(case: Case) -> None:
    """jit = eager, vmap = single call, jvp = vjp = finite difference; canonicalize keeps the value."""
    expr = case.example.expr
    point, _ = case.flat()
    rng = np.random.default_rng(0)
    along, across = rng.normal(size=point.shape), rng.normal(size=int(np.prod(expr.shape)))
    batch = np.stack([point + STEP * k * along for k in STENCIL] + [point])

    found = compiled(case)(point, batch, along, across)
    eager = function_of(expr)({name: jnp.asarray(value) for name, value in case.values.items()})[0]
    assert eager.shape == expr.shape
    same = {"rtol": 1e-12, "atol": 1e-13}
    np.testing.assert_allclose(found["value"], np.ravel(eager), **same)
    np.testing.assert_allclose(found["batch"][-1], np.ravel(eager), **same)
    np.testing.assert_allclose(found.get("canonical", eager), eager, **same)
    if expr.boolean:
        return
    assert np.isfinite(found["jvp"]).all()
    assert np.isfinite(found["vjp"]).all()
    scale = max(1.0, float(np.max(np.abs(found["jvp"]))))
    np.testing.assert_allclose(across @ found["jvp"], found["vjp"] @ along, rtol=1e-11, atol=1e-12 * scale)
    if case.example.smooth:
        slope = np.tensordot(list(STENCIL.values()), np.asarray(found["batch"][:-1]), 1) / STEP
        np.testing.assert_allclose(found["jvp"], slope, rtol=0.0, atol=RESOLVED * scale)


@by_case
def test_inferred_shape_and_precision(case: Case) -> None:
    """The inferred shape is the traced one; float32 stays float32 although x64 is on."""
    expr = case.example.expr
    for dtype in (jnp.float64, jnp.float32):
        structs = {name: jax.ShapeDtypeStruct(value.shape, dtype) for name, value in case.values.items()}
        if not structs and dtype == jnp.float32:
            continue
        (traced,) = jax.eval_shape(function_of(expr), structs)
        assert traced.shape == expr.check_shape()
        assert traced.dtype == (bool if expr.boolean else dtype)


@by_case
def test_canonical_form_is_stable(case: Case) -> None:
    expr = case.example.expr
    canonical = expr.canonicalize()
    assert canonical.check_shape() == expr.check_shape()
    assert canonical.canonicalize().key() == canonical.key()
    assert case.built_again().canonicalize().key() == canonical.key()


@by_case
def test_structure_and_printing(case: Case) -> None:
    expr = case.example.expr
    assert len(expr.children()) == len(expr.child_names())
    assert all(isinstance(child, Expr) for child in expr.children())
    assert expr.with_children(expr.children()) is expr
    assert case.built_again().key() == expr.key() == copy.deepcopy(expr).key()
    assert repr(expr)
    latex = expr.latex()
    assert latex.count("{") == latex.count("}")
    assert latex.count(r"\left") == latex.count(r"\right")
    assert expr._repr_latex_() == f"${latex}$"
    lines = expr.tree().splitlines()
    assert lines[0].startswith(type(expr).__name__)
    assert str(expr.shape) in lines[0]
    assert len(lines) >= 1 + len({id(child) for _, child in expr.outline()})


@by_case
def test_a_node_is_immutable(case: Case) -> None:
    expr = case.example.expr
    names = [field.name for field in expr._fields] or ["name"]
    for name in [*names, "anything"]:
        with pytest.raises(ImmutableError, match=type(expr).__name__):
            setattr(expr, name, 1.0)
        with pytest.raises(ImmutableError):
            delattr(expr, name)
    with pytest.raises(TypeError, match="truth value"):
        bool(expr)


@by_node
def test_examples_differ_and_belong_to_the_class(node: type[Expr]) -> None:
    examples = node.example()
    assert examples
    assert any(isinstance(example.expr, node) for example in examples)
    smooth = [example.expr.key() + repr(sorted(example.values.items())) for example in examples]
    assert len(set(smooth)) == len(smooth)


@by_node
def test_docstring(node: type[Expr]) -> None:
    """A first sentence, something about shapes, and what is raised, where something can be."""
    text = node.__doc__ or ""
    assert text.split("\n")[0].rstrip().endswith((".", ":"))
    assert re.search(r"[Ss]hape|entry by entry|scalar|vector|number", text)
    if wrong_shapes_raise(node):
        assert "Raises:" in text
        assert "ShapeError" in text


def wrong_shapes_raise(node: type[Expr]) -> bool:
    """Whether infer_shape rejects some shapes."""
    rng = np.random.default_rng(0)
    shapes = [(), (2,), (3,), (2, 3), (5, 5), (2, 5, 7)]
    for example in node.example():
        if not isinstance(example.expr, node) or not example.expr.children():
            continue
        for _ in range(30):
            tried = [shapes[i] for i in rng.integers(len(shapes), size=len(example.expr.children()))]
            try:
                example.expr.infer_shape(*tried)
            except ShapeError:
                return True
    return False


def test_all_families_are_found() -> None:
    names = {node.__name__ for node in NODES}
    assert {"Add", "Index", "Block", "Sin", "Cinterp", "Cond", "Solve", "SSMP", "Vmap", "Inequality", "Time"} <= names
    assert not names & {"Expr", "Leaf", "Variable", "Constraint", "Entrywise", "Placeholder"}
    assert len(NODES) >= 64
