"""Expressions that have no finite value, or slope, at a node of a trajectory."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from ...expr import Control, Expr, Inputs, Leaf, State, evaluate_all, leaves_of
from ...jax_inside import in_double
from ...scalar.walk import walk
from ..transcription.iterate import Iterate
from ..transcription.methods import Collocation

if TYPE_CHECKING:
    from ..problem.stated_phase import StatedPhase

#: The number of characters of an expression in a message.
_SHOWN = 80


def singular(problem: StatedPhase, point: Iterate, params: Mapping[str, Any], durations: Any) -> str | None:
    """The message that names the first expression without a finite value or derivative at the first or last node, with
    a remedy.

    The first one is the expression whose operands are finite: 1 / v if v is zero. Nodes before the last are evaluated
    with the control after them, the last one with the control before it.
    """
    shooting, ts = problem.shooting, problem.shooting.times(np.asarray(durations))
    exprs = shooting.local.expressions
    controls = shooting.local.controls.split(np.asarray(point.us))
    for k in (0, shooting.intervals):
        x = {name: jnp.asarray(a[k]) for name, a in point.xs.items()}
        u = {name: jnp.asarray(a[min(k, shooting.intervals - 1)]) for name, a in controls.items()}
        with in_double():
            inputs = Inputs(jnp.asarray(ts[k]), x, u, {n: jnp.asarray(a) for n, a in params.items()}, jnp.float64)
            expression = _first([*exprs.rates, *exprs.rows, *exprs.running], inputs)
        if expression is not None:
            what, node = expression
            at = {leaf.name: {**x, **u}[leaf.name] for leaf in leaves_of(node) if isinstance(leaf, (State, Control))}
            where = ", ".join(f"{name} is {_shown(a)}" for name, a in at.items())
            return f"{what} at node {k}, where {where}. {_remedy(problem, k)}"
    return None


def _first(roots: list[Expr], inputs: Inputs) -> tuple[str, Expr] | None:
    """The first expression that is not finite although its operands are, with its value."""
    values: dict[str, jax.Array] = {}
    read = lambda leaf: leaf.read(inputs)  # noqa: E731
    slopes: tuple[str, Expr] | None = None
    for node in walk(roots, Expr.children, Expr.key):
        below = [values[child.key()] for child in node.children()]
        is_whole = isinstance(node, Leaf) or len(node.eager_children()) < len(below)
        value = evaluate_all([node], read)[0] if is_whole else node.evaluate(*below)
        values[node.key()] = value
        text = repr(node) if len(repr(node)) <= _SHOWN else f"{repr(node)[:_SHOWN]}..."
        if not jnp.isfinite(value).all():
            return f"{text} is {_shown(value)}", node
        numbers = [k for k, a in enumerate(below) if jnp.issubdtype(a.dtype, jnp.floating)]
        if slopes is None and numbers and not is_whole and jnp.issubdtype(value.dtype, jnp.floating):
            jacobian = jax.jacfwd(node.evaluate, argnums=tuple(numbers))(*below)
            if not all(jnp.isfinite(a).all() for a in jacobian):
                slopes = f"the slope of {text} is not finite", node
    return slopes


def _shown(value: Any) -> str:
    return f"{float(value):.3g}" if np.ndim(value) == 0 else np.array2string(np.asarray(value), precision=3)


def _remedy(problem: StatedPhase, k: int) -> str:
    if k == 0 and not isinstance(problem.transcription, Collocation):
        return (
            "For a singular start use transcription=Collocation(tx.tableaus.RADAU_IIA5), which does not evaluate the "
            "start, and a guess that moves away from it"
        )
    return (
        "Guess states and controls for which it is finite after this node, or choose start and end states where it is "
        "finite"
    )
