"""Any expression alone as a JAX function."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax

from ..errors import ModelError
from ..expr import Constraint, Expr, evaluate_all, leaves_of, to_expr
from .inputs import Values, prepare

Lowered = Callable[..., Any]


def lower(expr: Any) -> Lowered:
    """Turn an expression, or a tuple, list or dict of them, into a function `f(t, x, u, params)`.

    The function is pure and untransformed: jit, grad, jacfwd, jacrev, hessian, vmap and scan apply. x, u and params
    are dicts by leaf name; u and params may be left out, missing parameters take their own value. Every distinct
    subtree is evaluated once. Precision is that of x.

    Returns:
        f(t, x, u=None, params=None) -> array, or a tuple, list or dict of arrays like `expr`.

    Raises:
        ShapeError: at once, if a shape does not fit.
        InputError: at call time, for an unknown key, a wrong shape or a missing value.
    """
    roots, treedef = jax.tree_util.tree_flatten(expr, is_leaf=lambda node: isinstance(node, Expr))
    if not roots:
        raise ModelError("nothing to lower: give an expression, or a tuple, list or dict of them")
    nodes = [to_expr(root) for root in roots]
    for node in nodes:
        node.check_shape()
    leaves = list({leaf.key(): leaf for leaf in leaves_of(*nodes)}.values())
    required = {leaf.name for leaf in leaves}

    def function(t: Any, x: Values | None = None, u: Values | None = None, params: Values | None = None) -> Any:
        inputs = prepare(leaves, required, t, x, u, params)
        values = evaluate_all(nodes, lambda leaf: leaf.read(inputs))
        return jax.tree_util.tree_unflatten(treedef, values)

    function.__name__ = "lowered"
    function.__doc__ = f"Lowered from {expr!r}" if not isinstance(expr, Mapping | Constraint) else "Lowered expression."
    return function
