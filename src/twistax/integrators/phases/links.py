"""The start of a phase: the last states of the previous phase, and jumps of some of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

from ...checks import callable_with, listed, real_array, short
from ...errors import ModelError, ShapeError
from ...expr import Constant, Expr, Inputs, Leaf, Parameter, State, Time, canonicalize_all, evaluate_all, leaves_of
from ...jax_inside import is_traced
from ...system import name_of
from ...system.dynamics import Arrays, Dynamics
from ...system.inputs import cast

#: What `integrate_phases` takes for a join.
Link = Mapping[Any, Any] | Callable[..., Any] | None


def check_link(place: str, link: Link, before: Dynamics, after: Dynamics) -> set[str]:
    """The names of the parameters that a link reads, if they are known.

    Raises:
        ModelError: it names a state that the next phase does not have, or reads a leaf that the previous phase does not
            have at its end.
        ShapeError: an expression of another shape.
    """
    last, parameters = {state.name: state for state in before.states}, set[str]()
    if callable(link):
        callable_with(place, link, ["t", "x", "params"], ModelError)
        return parameters
    if not isinstance(link, Mapping | None):
        raise ModelError(
            f"{place} expects a dict from states to expressions, or a function of (t, x, params), got {short(link)}"
        )
    link = by_name(place, link or {}, after)
    for state in after.states:
        name, expr = state.name, link.get(state.name)
        if name not in link and (name not in last or last[name].key() != state.key()):
            raise ModelError(
                f"{place} has no value for {name!r}, which the previous phase does not have with this "
                f"shape and group; its states are: {listed(last, name)}.\n  fix: links=[..., {{{name!r}: ...}}, ...]"
            )
        if not isinstance(expr, Expr):
            continue
        if expr.shape != state.shape:
            raise ShapeError(f"{place}[{name!r}] expects shape {state.shape}, got {expr.shape}")
        for leaf in leaves_of(expr):
            if not isinstance(leaf, Leaf) or isinstance(leaf, Constant | Time):
                continue
            state_before = last.get(leaf.name)
            known = isinstance(leaf, State) and state_before is not None and state_before.key() == leaf.key()
            if isinstance(leaf, Parameter) and leaf.name not in before.baked:
                parameters.add(leaf.name)
            elif not known:
                raise ModelError(
                    f"{place}[{name!r}] reads {type(leaf).__name__} {leaf.name!r}, which the previous "
                    f"phase does not have at its end; available are: {listed(last, leaf.name)}, parameters "
                    "that are not constants of the compiled system, and time"
                )
    return parameters


def by_name(place: str, link: Mapping[Any, Any], after: Dynamics) -> dict[str, Any]:
    """The values by names of states. Raises ModelError for a name that the next phase does not have."""
    states = [state.name for state in after.states]
    values = {name_of(key): value for key, value in link.items()}
    for name in values:
        if name not in states:
            raise ModelError(f"{place} names {name!r}; the states of the next phase are: {listed(states, name)}")
    return values


def linked(
    place: str, link: Link, before: Dynamics, after: Dynamics, t: Any, x: Arrays, params: Mapping[str, Any]
) -> dict[str, Any]:
    """The initial states of a phase, from the final states of the phase before."""
    dtype = next(iter(x.values())).dtype
    changes: Mapping[Any, Any] = link(t, dict(x), dict(params)) if callable(link) else link or {}
    if not isinstance(changes, Mapping):
        raise ModelError(f"{place} must return a dict from states to values, got {short(changes)}")
    jumps = by_name(place, changes, after)
    exprs = {name: value for name, value in jumps.items() if isinstance(value, Expr)}
    if exprs:
        jumps |= _values(exprs, before, t, x, params)
    start = {}
    for state in after.states:
        name = state.name
        if name not in jumps and name not in x:
            raise ModelError(f"{place} has no value for {name!r}, which the previous phase does not have")
        label = f"{place}[{name!r}]"
        start[name] = cast(label, real_array(label, jumps.get(name, x.get(name))), dtype, on_host=True)
    return start


def _values(exprs: dict[str, Expr], before: Dynamics, t: Any, x: Arrays, params: Mapping[str, Any]) -> Arrays:
    """The values of expressions, compiled once where numbers are known."""
    names = list(exprs)

    def make() -> Callable[..., list[jax.Array]]:
        roots = canonicalize_all([exprs[name] for name in names])

        def values(t: jax.Array, x: Arrays, params: Arrays) -> list[jax.Array]:
            inputs = Inputs(t, x, {}, params, t.dtype)
            return evaluate_all(list(roots), lambda leaf: leaf.read(inputs))

        return values

    dtype = next(iter(x.values())).dtype
    read = {leaf.name for expr in exprs.values() for leaf in leaves_of(expr) if isinstance(leaf, Parameter)}
    known = {name: jnp.asarray(value, dtype) for name, value in params.items() if name in read}
    arguments = (jnp.asarray(t, dtype), {name: jnp.asarray(value) for name, value in x.items()}, known)
    if is_traced(arguments):
        return dict(zip(names, make()(*arguments), strict=True))
    key = (linked, tuple(expr.key() for expr in exprs.values()))
    function = before.functions.loops.get(key, lambda: jax.jit(make()))
    return dict(zip(names, function(*arguments), strict=True))
