"""The laws of a node class, tested on the examples that it declares."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ..errors import ImmutableError, InputError, ShapeError
from ..expr import Constant, Example, Expr, Inputs, evaluate_all
from ..jax_inside import quick_compile
from ..progress import watching
from .laws import STENCIL, Check, difference_quotient

#: The step of a difference quotient of fourth order, and what it resolves of slopes of order one.
_STEP, _RESOLVED = 2e-4, 1e-8
_SINGLE = 100.0 * float(np.finfo(np.float32).eps)


@watching("check_node")
def check_node(node_class: type[Expr]) -> None:
    """Check that a node class satisfies the laws of nodes, on its `cases` and `kinks`.

    It checks that the inferred shape is that of the value, and that wrong shapes raise ShapeError and no other error;
    that float32 stays float32, within 100 round-offs of its size and of the effect of its operands' round-off; jit =
    eager = vmap; derivatives forward = reverse = by finite differences, where a case is smooth, and finite at `kinks`;
    that `canonicalize` preserves the value and is idempotent; that equal trees have equal keys; that texts and formulas
    are complete; that nodes are immutable; that a rule of kinds is defined. It does not check units.

    Args:
        node_class: a subclass of `Expr` with `cases`.
    Raises:
        LawError: a law is violated, or there are no examples. The message names the law, the values and the likely
            cause.
        InputError: `node_class` is not a node class.
    Example: `tx.testing.check_node(tx.Sin)`.
    """
    if not (isinstance(node_class, type) and issubclass(node_class, Expr)):
        hint = f".\n  fix: give the class, {type(node_class).__name__}" if isinstance(node_class, Expr) else ""
        raise InputError(f"check_node expects a node class such as tx.Sin, got {node_class!r}{hint}")
    with jax.enable_x64(True):
        for case in cases_of(node_class):
            for law in LAWS:
                law(case)
        shapes_are_checked(node_class)


def function_of(*exprs: Expr) -> Callable[[Mapping[str, Any]], list[jax.Array]]:
    """The expressions as one function of {leaf name: array}."""

    def function(values: Mapping[str, Any]) -> list[jax.Array]:
        dtype = next((v.dtype for v in values.values()), jnp.zeros(()).dtype)
        inputs = Inputs(jnp.zeros((), dtype), {}, {}, {}, dtype)
        return evaluate_all(exprs, lambda leaf: leaf.read(inputs) if isinstance(leaf, Constant) else values[leaf.name])

    return function


@dataclasses.dataclass(frozen=True)
class Case:
    """One example of one node class."""

    node: type[Expr]
    number: int
    example: Example

    def __str__(self) -> str:
        return f"{self.node.__name__}{self.number}"

    @property
    def check(self) -> Check:
        """Comparisons whose messages name the class and the example."""
        return Check(f"{self.node.__name__}, case {self.number}: {self.example.expr!r},")

    def built_again(self) -> Expr:
        """The expression, built from new nodes."""
        return self.node.example()[self.number].expr

    @property
    def values(self) -> dict[str, np.ndarray]:
        """The values of the leaves, in double precision."""
        return {name: np.asarray(value, np.float64) for name, value in self.example.values.items()}

    def flat(self) -> tuple[np.ndarray, Callable[[jax.Array], Any]]:
        """The values as one vector, and the inverse function."""
        vector, back = ravel_pytree(self.values)
        return np.asarray(vector, np.float64), back


def cases_of(node_class: type[Expr]) -> list[Case]:
    """The examples of a class. Raises LawError if there are none, or if one contains no node of the class."""
    check, law = Check(node_class.__name__), "a node class has cases"
    fix = 'give the class cases = ({"a": [1.0, 2.0]},), values by the names of its operands'
    with check.running(law, fix):
        examples = node_class.example()
    message = "there are none" if not examples else "none of them has a node of the class"
    check.holds(law, any(isinstance(example.expr, node_class) for example in examples), message, fix)
    keys = [example.expr.key() + repr(sorted(example.values.items())) for example in examples]
    check.holds("cases differ", len(set(keys)) == len(keys), "two cases are the same", "leave one out")
    return [Case(node_class, i, example) for i, example in enumerate(examples)]


_COMPILED: dict[Any, Callable[..., dict[str, jax.Array]]] = {}


def _compiled(case: Case) -> Callable[..., dict[str, jax.Array]]:
    """All that is checked of an expression in one compiled function, shared by cases that differ in numbers alone."""
    expr = case.example.expr
    canonical = expr.canonicalize()
    key = expr.key(), tuple((name, value.shape) for name, value in sorted(case.values.items()))
    _, back = case.flat()

    def flat(z: jax.Array) -> jax.Array:
        return function_of(expr)(back(z))[0].astype(z.dtype).ravel()

    def everything(z: jax.Array, batch: jax.Array, tangent: jax.Array, cotangent: jax.Array) -> dict[str, jax.Array]:
        results = {"batch": jax.vmap(flat)(batch)}
        if canonical.key() != expr.key():
            (results["canonical"],) = function_of(canonical)(back(z))
        if expr.boolean:
            return results | {"value": flat(z)}
        results["value"], push = jax.linearize(flat, z)
        (vjp,) = jax.linear_transpose(push, z)(cotangent)
        spread = jnp.abs(jax.vmap(push)(jnp.diag(z))).sum(axis=0)
        return results | {"jvp": push(tangent), "vjp": vjp, "spread": spread}

    if key not in _COMPILED:
        # Nothing here depends on how much XLA optimises.
        _COMPILED[key] = jax.jit(everything, compiler_options=quick_compile(0))
    return _COMPILED[key]


def values_and_derivatives(case: Case) -> None:
    """jit = eager, vmap = single call, jvp = vjp = differences, float32 = float64; `canonicalize` preserves the
    value.
    """
    expr, check = case.example.expr, case.check
    point, _ = case.flat()
    at = case.values
    rng = np.random.default_rng(0)
    tangent, cotangent = rng.normal(size=point.shape), rng.normal(size=int(np.prod(expr.shape)))
    batch = np.stack([point + _STEP * k * tangent for k in STENCIL] + [point])

    fix = "look at evaluate"
    with check.running("its value can be computed and differentiated", fix):
        results = {name: np.asarray(value) for name, value in _compiled(case)(point, batch, tangent, cotangent).items()}
        eager = np.asarray(function_of(expr)({name: jnp.asarray(value) for name, value in at.items()})[0])
    law = "the inferred shape is that of the value"
    message = f"infer_shape says {expr.shape}, the value has {eager.shape}"
    check.holds(law, eager.shape == expr.shape, message, "look at infer_shape, or takes and gives, and at evaluate")
    near = lambda value: 1e-13 + 1e-12 * np.abs(value)  # noqa: E731
    value = np.ravel(eager)
    check.close("jit = eager", results["value"], value, near(value), fix, at)
    check.close("vmap = a single call", results["batch"][-1], value, near(value), fix, at)
    canonical = results.get("canonical", eager)
    check.close("canonicalize keeps the value", canonical, eager, near(eager), "look at simplify", at)
    if expr.boolean:
        return
    fix = "look at evaluate: a root, a quotient or a norm at zero has no derivative; choose its operand by jnp.where"
    for mode in ("jvp", "vjp"):
        check.holds("derivatives are finite", np.isfinite(results[mode]).all(), f"{mode} gives {results[mode]}", fix)
    scale = max(1.0, float(np.abs(results["jvp"]).max(initial=0.0)))
    forward, reverse = cotangent @ results["jvp"], results["vjp"] @ tangent
    check.close("reverse = forward", reverse, forward, 1e-12 * scale + 1e-11 * abs(forward), fix, at)
    if case.example.smooth:
        slope = difference_quotient(results["batch"][:-1], _STEP)
        fix = "look at custom derivatives; where there is none, the case belongs to kinks"
        check.close("the derivative is that of the values", results["jvp"], slope, _RESOLVED * scale, fix, at)
        _single_precision(case, results)


def _single_precision(case: Case, results: Mapping[str, np.ndarray]) -> None:
    """In single precision: at most 100 round-offs of the value and of what the operands' round-off makes of it."""
    short = {name: jnp.asarray(value, jnp.float32) for name, value in case.values.items()}
    if not short:
        return
    single = np.asarray(function_of(case.example.expr)(short)[0]).ravel()
    size = max(np.abs(results["value"]).max(initial=0.0), results["spread"].max(initial=0.0))
    law, fix = "float32 is float64 to 100 round-offs", "look at evaluate: differences of near numbers lose digits"
    case.check.close(law, single, results["value"], _SINGLE * size, fix, case.values)


def shape_and_precision(case: Case) -> None:
    """The inferred shape is that of the traced value; float32 values remain float32 with x64 enabled."""
    expr, check = case.example.expr, case.check
    for dtype in (jnp.float64, jnp.float32):
        structs = {name: jax.ShapeDtypeStruct(value.shape, dtype) for name, value in case.values.items()}
        if not structs and dtype == jnp.float32:
            continue
        fix = "look at infer_shape, or takes and gives, and at evaluate"
        with check.running("the inferred shape is that of the value", fix):
            (traced,) = jax.eval_shape(function_of(expr), structs)
            inferred = expr.check_shape()
        message = f"infer_shape says {inferred}, the value has {traced.shape}"
        check.holds("the inferred shape is that of the value", traced.shape == inferred, message, fix)
        wanted = bool if expr.boolean else dtype
        message = f"operands of {jnp.dtype(dtype)} give {traced.dtype}"
        fix = "look at evaluate: arrays of NumPy promote, so give them the dtype of the operands"
        check.holds("the precision is that of the operands", traced.dtype == wanted, message, fix)


def canonical_form(case: Case) -> None:
    """Its shape is that of the node, it is its own canonical form, and equal trees have equal canonical forms."""
    expr, check, fix = case.example.expr, case.check, "look at simplify"
    canonical = expr.canonicalize()
    message = f"{canonical!r} has shape {canonical.check_shape()}"
    check.holds("canonicalize keeps the shape", canonical.check_shape() == expr.check_shape(), message, fix)
    again = canonical.canonicalize()
    stable = again.key() == canonical.key()
    check.holds("canonicalize is done after once", stable, f"{canonical!r} becomes {again!r}", fix)
    other = case.built_again().canonicalize()
    same = other.key() == canonical.key()
    check.holds("equal trees have equal canonical forms", same, f"{canonical!r} and {other!r}", fix)


def structure_and_printing(case: Case) -> None:
    """Children, keys, copies, texts and formulas."""
    expr, check = case.example.expr, case.check
    children = expr.children()
    named = len(children) == len(expr.child_names()) and all(isinstance(child, Expr) for child in children)
    check.holds("children are expressions with names", named, f"{children}, {expr.child_names()}", "look at children")
    same = expr.with_children(children) is expr
    check.holds("with its own children a node is itself", same, "it is another one", "look at with_children")
    keys = {case.built_again().key(), expr.key(), copy.deepcopy(expr).key()}
    fix = "look at static_key: every field that is no operand must be a value that compares by content"
    check.holds("equal trees have equal keys", len(keys) == 1, f"got {sorted(keys)}", fix)
    check.holds("a node has a text", bool(repr(expr)), "repr is empty", "look at to_text")
    latex = expr.latex()
    pairs = (("{", "}"), (r"\left", r"\right"))
    balanced = all(latex.count(left) == latex.count(right) for left, right in pairs)
    check.holds("the formula has pairs of parentheses", balanced, latex, "look at formula and to_latex")
    check.holds("the formula is shown", expr._repr_latex_() == f"${latex}$", latex, "look at to_latex")
    lines = expr.tree().splitlines()
    shown = lines[0].startswith(type(expr).__name__) and str(expr.shape) in lines[0]
    shown = shown and len(lines) >= 1 + len({id(child) for _, child in expr.outline()})
    check.holds("the tree shows the node, its shape and its children", shown, "\n".join(lines), "look at outline")


def immutability(case: Case) -> None:
    """Fields cannot be assigned or deleted, and a node has no truth value."""
    expr, check = case.example.expr, case.check
    fix = "leave __setattr__, __delattr__ and __bool__ as Expr has them"
    for name in [*([field.name for field in type(expr)._fields] or ["name"]), "anything"]:
        for change in (lambda name=name: setattr(expr, name, 1.0), lambda name=name: delattr(expr, name)):
            message = f"{name!r} can be changed"
            check.holds("nodes never change", _raises(change, ImmutableError), message, fix)
    check.holds("a node has no truth value", _raises(lambda: bool(expr), TypeError), f"{expr!r} has one", fix)


def _raises(call: Callable[[], Any], error: type[Exception]) -> bool:
    try:
        call()
    except error:
        return True
    return False


def rule_of_kinds(case: Case) -> None:
    """The class declares a rule for kinds, frames and units."""
    fix = "name one: kinds = tx.kinds.OPEN says nothing, tx.kinds.FixedUnits(takes, gives) has units"
    case.check.holds("a node states a rule of kinds", case.node.kinds is not None, "kinds is None", fix)


#: What holds of every case.
LAWS: tuple[Callable[[Case], None], ...] = (
    shape_and_precision,
    values_and_derivatives,
    canonical_form,
    structure_and_printing,
    immutability,
    rule_of_kinds,
)


def shapes_are_checked(node_class: type[Expr]) -> bool:
    """Whether some shapes of operands are rejected; LawError if the error is not a ShapeError."""
    rng, refused = np.random.default_rng(0), False
    shapes = [(), (2,), (3,), (2, 3), (5, 5), (2, 5, 7)]
    check, fix = Check(node_class.__name__), "look at infer_shape: raise tx.ShapeError(sentence, hint=...)"
    for example in node_class.example():
        if not isinstance(example.expr, node_class) or not example.expr.children():
            continue
        for _ in range(30):
            tried = [shapes[i] for i in rng.integers(len(shapes), size=len(example.expr.children()))]
            with check.running(f"shapes that do not fit give ShapeError, here {tried}", fix):
                try:
                    example.expr.infer_shape(*tried)
                except ShapeError:
                    refused = True
    return refused
