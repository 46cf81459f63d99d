"""Scalar programs as JAX operations on scalars."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ...jax_inside import jaxpr_as_fun
from ..graph import OpaqueCall, ScalarGraph
from ..primitives.interface import Nodes, flat
from ..primitives.operations import OPERATIONS
from ..program import ScalarProgram, called_names
from ..reader import emitted_form

#: Operations in a function of its own. XLA recomputes values that several results share for each of them, but not
#: across functions; in one piece a recursion over 30 links takes twenty times as many operations as written.
_PIECE = 100

_MUL, _DIV = OPERATIONS["mul"], OPERATIONS["div"]


@dataclasses.dataclass(eq=False)
class _Piece:
    """Operations in a row, as a function of the scalars they need from before.

    Attributes:
        nodes: the operations in order.
        needs: scalars from before that are no constants.
        gives: what later ones or the results need.
    """

    graph: ScalarGraph
    nodes: list[int]
    needs: list[int]
    gives: list[int]

    def __call__(self, *needed: jax.Array) -> list[jax.Array]:
        g = self.graph
        values = dict(zip(self.needs, needed, strict=True))
        #: The product of the constant factors that XLA would form.
        joined: dict[int, float] = {}
        for i in self.nodes:
            operation: Any = g.operation(i)
            arguments = g.arguments(i)
            for a in arguments:
                if a not in values:
                    values[a] = jnp.asarray(g.numbers[a], g.dtypes[a])
            separate = [False] * len(arguments)
            if operation is _DIV:
                # XLA would make (a / b) / c a / (b c), and a / (b / c) (a c) / b: the products may be out of range.
                separate = [g.operation(a) is _DIV for a in arguments]
            elif operation is _MUL and g.dtypes[i] == g.dtype:
                numbers = [joined.get(a, 1.0) if g.numbers[a] is None else abs(g.numbers[a]) for a in arguments]
                joined[i] = numbers[0] * numbers[1]
                if not self.least < joined[i] < 1.0 / self.least:
                    separate, joined[i] = [a in joined for a in arguments], 1.0
            pairs = zip(arguments, separate)
            operands = (lax.optimization_barrier(values[a]) if alone else values[a] for a, alone in pairs)
            values[i] = operation.array(*operands)
        return [values[i] for i in self.gives]

    @functools.cached_property
    def least(self) -> float:
        """Numbers above it, and below its inverse, can be multiplied with one another."""
        return float(np.sqrt(np.finfo(self.graph.dtype).tiny))


def as_function(
    program: ScalarProgram, outline: Callable[[_Piece], Callable[..., list[jax.Array]]] | None = None
) -> Callable[..., list[jax.Array]]:
    """The program as a function of arrays, one member at a time; pure and traceable.

    Args:
        outline: makes a separate function of a piece; by default `jax.jit`, which XLA may inline.
    """
    outline = outline or functools.partial(jax.jit, inline=False)
    form = emitted_form(program)
    g = form.graph
    steps = _steps(form)
    # Arrays that are moved as they are stay arrays: of long rows XLA would compile each entry.
    parts = [_part(g, nodes) for nodes in form.outputs]
    rest = form.restricted([nodes for nodes, part in zip(form.outputs, parts, strict=True) if part is None])

    def function(*arguments: jax.Array) -> list[jax.Array]:
        # Barriers: else XLA recomputes shared values for each entry of an array.
        entries = lax.optimization_barrier([jnp.reshape(a, -1) for a in arguments])
        values: dict[int, jax.Array] = {}
        for i in rest.live:
            place = g.input_of(i)
            if place is not None:
                values[i] = lax.index_in_dim(entries[place[0]], place[1], keepdims=False)
            elif g.numbers[i] is not None:
                values[i] = jnp.asarray(g.numbers[i], g.dtypes[i])

        def array(nodes: Any, dtype: Any) -> jax.Array:
            if not nodes.size:
                return jnp.zeros(nodes.shape, dtype)
            return jnp.stack([values[i] for i in flat(nodes)]).reshape(nodes.shape)

        for step in steps:
            if isinstance(step, _Piece):
                run = outline(step) if len(steps) > 1 else step
                values.update(zip(step.gives, run(*(values[i] for i in step.needs)), strict=True))
            else:
                types = [v.aval.dtype for v in step.jaxpr.jaxpr.invars]
                results = jaxpr_as_fun(step.jaxpr)(*map(array, step.arguments, types))
                for nodes, result in zip(step.results, results, strict=True):
                    row = jnp.reshape(result, -1)
                    values.update({j: row[k] for k, j in enumerate(flat(nodes))})
        needed = sorted(set(rest.flat))
        values.update(zip(needed, lax.optimization_barrier([values[i] for i in needed]), strict=True))
        results = [
            array(nodes, dtype)
            if part is None
            else jnp.reshape(lax.slice_in_dim(entries[part[0]], part[1], part[1] + nodes.size), nodes.shape)
            for nodes, dtype, part in zip(form.outputs, form.types, parts, strict=True)
        ]
        return lax.optimization_barrier(results)

    return function


def _part(g: ScalarGraph, nodes: Nodes) -> tuple[int, int] | None:
    """The argument and its first entry of which an array has some entries in their order; None for other arrays."""
    places = [g.input_of(i) for i in flat(nodes)]
    first = places[0] if len(places) > 1 else None
    if first is None or places != [(first[0], first[1] + k) for k in range(len(places))]:
        return None
    return first


def without_barriers(program: ScalarProgram) -> Callable[..., list[jax.Array]]:
    """The program without optimization barriers, which have no Taylor series, for `jax.experimental.jet`.

    Raises:
        NotImplementedError: it calls functions of JAX.
    """
    form = emitted_form(program)
    if form.calls:
        names = called_names(form.calls)
        raise NotImplementedError(f"jet: no Taylor series of {names} in a compiled system; use backend=tx.JAX()")

    def function(*arguments: jax.Array) -> list[jax.Array]:
        values = form.computed(
            lambda argument, place: jnp.reshape(arguments[argument], -1)[place],
            lambda value, dtype: jnp.asarray(value, dtype),
            lambda operation, _, *entries: operation.array(*entries),
        )
        return [jnp.stack([values[i] for i in flat(nodes)]).reshape(nodes.shape) for nodes in form.outputs]

    return function


def _steps(form: ScalarProgram) -> list[_Piece | OpaqueCall]:
    """The program in order: pieces, and what it calls."""
    g = form.graph
    steps: list[_Piece | OpaqueCall] = []
    called: set[int] = set()
    for i in form.live:
        call = g.call_of(i)
        if call is not None and id(call) not in called:
            called.add(id(call))
            steps.append(call)
        elif g.operation(i) is not None:
            last = steps[-1] if steps else None
            if not isinstance(last, _Piece) or len(last.nodes) == _PIECE:
                last = _Piece(g, [], [], [])
                steps.append(last)
            last.nodes.append(i)
    wanted = set(form.flat)
    for step in reversed(steps):
        if isinstance(step, _Piece):
            computed = set(step.nodes)
            step.gives = [i for i in step.nodes if i in wanted]
            read = dict.fromkeys(a for i in step.nodes for a in g.arguments(i))
            step.needs = [a for a in read if a not in computed and g.numbers[a] is None]
            wanted.update(step.needs)
        else:
            wanted.update(flat(*step.arguments))
    return steps
