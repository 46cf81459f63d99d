"""Lowering of expressions to JAX functions, without a system."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import jax

from ..errors import ModelError
from ..expr import Constant, Constraint, Expr, Inputs, Leaf, Time, evaluate_all, leaves_of, postorder, to_expr
from ..expr.fields import freeze
from ..expr.transformations.vmap import no_elements
from ..jax_inside import is_traced
from ..progress import FirstCalls
from ..scalar.backends import as_arrays
from .inputs import CallArguments, Values
from .system import System

Lowered = Callable[..., Any]

#: A longer chain of nodes may be one on which XLA ends the process.
_LARGE = 1000
#: Outside of `jit`, functions of so many nodes are compiled: one by one nodes take 30 us each.
_COMPILED = range(200, 20_000)


def lower(expr: Any) -> Lowered:
    """Turn an expression, or a tuple, list or dict of them, into a function `f(t, x, u, params)`.

    The function is pure and not transformed: jit, grad, jacfwd, jacrev, hessian, vmap and scan apply. Outside of these,
    an expression of 200 nodes or more is compiled at its first call; smaller ones are evaluated node by node. x, u and
    params are dicts by leaf name. u and params are optional, and missing parameters have their default values. x may
    have states that the expression does not depend on. Every distinct subtree is evaluated once. The result has the
    precision of x.

    Returns:
        f(t, x, u=None, params=None) -> array, or a tuple, list or dict of arrays like `expr`.

    Raises:
        ShapeError: immediately, if a shape does not match.
        ModelError: immediately, if there is no expression, or if two leaves with one name differ.
        InputError: at call time, for an unknown control or parameter, a wrong shape or a missing value.
        ModelError: during tracing, for a chain of more than 30,000 array operations, which would make XLA crash.
    Example: `tx.lower({"M": mass_matrix(arm)})(0.0, {"q": np.zeros(arm.dofs)})["M"]` has shape (n, n).
    """
    wanted = "lower expects an expression, or a tuple, list or dict of them"
    if isinstance(expr, System):
        raise ModelError(f"{wanted}, got {expr!r}.\n  fix: tx.compile takes a System")
    roots, treedef = jax.tree_util.tree_flatten(expr, is_leaf=lambda node: isinstance(node, Expr))
    if not roots:
        raise ModelError(f"{wanted}; there is no expression in {expr!r}")
    try:
        nodes = [to_expr(root) for root in roots]
    except ModelError as error:
        raise ModelError(f"{wanted}: {error}") from None
    for node in nodes:
        node.check_shape()
    no_elements(leaves_of(*nodes))
    leaves = _distinct(leaves_of(*nodes))
    required, arguments = {leaf.name for leaf in leaves}, CallArguments(leaves)
    count = len(postorder(*nodes))

    def values(structure: Any, dtype: Any, *arrays: Any) -> list[jax.Array]:
        t, x, u, params = jax.tree.unflatten(structure, arrays)
        inputs = Inputs(t, x, u, params, dtype)
        return evaluate_all(nodes, lambda leaf: leaf.read(inputs))

    compiled, first_calls = jax.jit(values, static_argnums=(0, 1)), FirstCalls("compile")

    def function(t: Any, x: Values | None = None, u: Values | None = None, params: Values | None = None) -> Any:
        inputs = arguments.prepare(required, t, x, u, params, spare=True)
        arrays, structure = jax.tree.flatten((inputs.t, inputs.x, inputs.u, inputs.params))
        run: Callable[..., list[jax.Array]] = functools.partial(values, structure, inputs.dtype)
        if is_traced(arrays):
            run = as_arrays(jax.make_jaxpr(run)(*arrays)) if count > _LARGE else run
        elif count in _COMPILED:
            run = functools.partial(compiled, structure, inputs.dtype)
        with first_calls((structure, inputs.dtype)):
            return jax.tree_util.tree_unflatten(treedef, run(*arrays))

    function.__name__ = "lowered"
    function.__doc__ = f"Lowered from {expr!r}" if not isinstance(expr, Mapping | Constraint) else "Lowered expression."
    return function


def _distinct(leaves: Iterable[Leaf]) -> list[Leaf]:
    """The named leaves, each once: x, u and params are read by name, so leaves of one name must be one."""
    leaves_by_name: dict[tuple[type[Leaf], str], Leaf] = {}
    for leaf in leaves:
        if isinstance(leaf, (Constant, Time)):
            continue
        other = leaves_by_name.setdefault((type(leaf), leaf.name), leaf)
        if other.key() != leaf.key() or freeze(getattr(other, "value", None)) != freeze(getattr(leaf, "value", None)):
            raise ModelError(
                f"two {type(leaf).__name__}s are named {leaf.name!r} and differ: shapes {other.shape} and {leaf.shape}"
                f"{'' if other.shape != leaf.shape else ', different groups or values'}.\n  fix: rename one"
            )
    return list(leaves_by_name.values())
