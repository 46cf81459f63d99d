"""Inlining of called functions in JAX functions, which leaves operations, loops and branches."""

from __future__ import annotations

import functools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp

from ...jax_inside import ClosedJaxpr, Literal, Var, alone, closed, expansion, jaxpr_as_fun, part, scan_parts
from ..array_primitive import written_out

#: Calls that are inlined once derivatives are taken.
_CALLS = {"jit": "jaxpr", "remat2": "jaxpr", "custom_jvp_call": "call_jaxpr", "custom_vjp_call": "call_jaxpr"}

#: The most iterations that `unrolled` writes out: methods have at most so many stages.
_SHORT = 16


def inlined(program: ClosedJaxpr, *, kernels: bool = True) -> ClosedJaxpr:
    """The function with called functions inlined. Their custom derivatives are lost.

    Args:
        kernels: also functions that kernels call, whose loops would then be parts of this function.
    """
    jaxpr = program.jaxpr
    if all(_called(eqn, kernels)[0] is None for eqn in jaxpr.eqns):
        return program
    eqns: list[Any] = []
    constants: dict[int, tuple[Var, Any]] = {}
    outputs = _copied(program, jaxpr.invars, eqns, constants, kernels)
    return part(jaxpr, eqns, jaxpr.invars, outputs, dict(constants.values()))


def _copied(
    program: ClosedJaxpr, inputs: Iterable[Any], eqns: list[Any], constants: dict[int, tuple[Var, Any]], kernels: bool
) -> list[Any]:
    """Append the equations of a function to others, with new variables.

    Args:
        inputs: variables and numbers in place of its arguments.
        constants: by identity, the variables of those met so far.
    Returns:
        Variables and numbers in place of its results.
    """
    jaxpr = program.jaxpr
    new: dict[Any, Any] = dict(zip(jaxpr.invars, inputs, strict=True))
    for v, value in zip(jaxpr.constvars, program.consts, strict=True):
        new[v] = constants.setdefault(id(value), (Var(v.aval), value))[0]
    for eqn in jaxpr.eqns:
        inside, operands = _called(eqn, kernels)
        values = [v if isinstance(v, Literal) else new[v] for v in operands]
        if inside is None:
            outputs: list[Any] = [Var(v.aval) for v in eqn.outvars]
            eqns.append(eqn.replace(invars=values, outvars=outputs))
        else:
            outputs = _copied(inside, values, eqns, constants, kernels)
        new.update(zip(eqn.outvars, outputs, strict=True))
    return [v if isinstance(v, Literal) else new[v] for v in jaxpr.outvars]


def unrolled(program: ClosedJaxpr) -> ClosedJaxpr:
    """The function with its short loops unrolled, too, such as those over the stages of a method."""
    avals: list[Any] = [v.aval for v in program.jaxpr.invars]
    shapes = (jax.ShapeDtypeStruct(a.shape, a.dtype) for a in avals)
    return jax.make_jaxpr(functools.partial(_evaluate, program))(*shapes)


def _iterated(eqn: Any, values: list[Any]) -> list[Any]:
    """The results of a scan, iteration by iteration."""
    fixed, carried = scan_parts(eqn)
    length, body = eqn.params["length"], closed(eqn.params["jaxpr"])
    state = values[fixed : fixed + carried]
    rows: list[Any] = [None] * length
    for k in reversed(range(length)) if eqn.params["reverse"] else range(length):
        at = [a[k] for a in values[fixed + carried :]]
        results = _evaluate(body, *values[:fixed], *state, *at)
        state, rows[k] = results[:carried], results[carried:]
    return [*state, *(jnp.stack(column) for column in zip(*rows, strict=True))]


def _evaluate(program: ClosedJaxpr, *arguments: Any) -> list[Any]:
    """The results, with calls inlined and short loops unrolled."""
    program = inlined(program)
    jaxpr = program.jaxpr
    values = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*program.consts, *arguments], strict=True))
    for eqn in jaxpr.eqns:
        if eqn.primitive.name == "scan" and 0 < eqn.params["length"] <= _SHORT:
            outputs = _iterated(eqn, [value_of(v, values) for v in eqn.invars])
        else:
            variables = list(dict.fromkeys(v for v in eqn.invars if not isinstance(v, Literal)))
            outputs = jaxpr_as_fun(alone(jaxpr, eqn, variables))(*(values[v] for v in variables))
        values.update(zip(eqn.outvars, outputs, strict=True))
    results: list[Any] = jaxpr.outvars
    return [value_of(v, values) for v in results]


def _called(eqn: Any, kernels: bool) -> tuple[ClosedJaxpr | None, list[Any]]:
    """What an equation calls, and the operands of that; None: it is an operation, a loop or a branch."""
    name, p = eqn.primitive.name, eqn.params
    if name == "custom_linear_solve":
        counts = p["const_lengths"]
        skip = counts.matvec + counts.vecmat
        return closed(p["jaxprs"].solve), [*eqn.invars[skip : skip + counts.solve], *eqn.invars[sum(counts) :]]
    inside = written_out(eqn)
    if inside is not None and not kernels and getattr(p["program"], "inside_kernels", None) is not None:
        return None, eqn.invars
    if inside is None:
        inside = closed(p[_CALLS[name]]) if name in _CALLS else expansion(eqn)
    return inside, eqn.invars


def value_of(v: Any, values: dict[Any, Any]) -> Any:
    """The value of an operand, a variable or a number, with its type."""
    aval: Any = getattr(v, "aval", None)
    return jnp.asarray(v.val, aval.dtype) if isinstance(v, Literal) else values[v]
