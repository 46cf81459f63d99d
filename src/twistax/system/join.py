"""Composition of systems."""

from __future__ import annotations

import graphlib
import itertools
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from ..checks import listed, short
from ..errors import ModelError, ShapeError
from ..expr import Constraint, Control, Expr, Leaf, Parameter, Stack, State, leaves_of, substitute, to_expr
from ..expr.fields import ExprLike
from ..expr.operations.soft import Asked, Soft, parts_of
from .composable import arguments_of, exchanged, named_leaves
from .declared import SlopesOnDemand, name_of
from .system import System


def join(
    *systems: Any,
    connect: Mapping[Leaf | str, ExprLike] | None = None,
    outputs: Mapping[str, ExprLike] | None = None,
    constraints: Mapping[str, Asked] | None = None,
) -> System:
    """One system composed of several, in which expressions of some systems replace controls and parameters of others.

    With $x_i' = f_i(x_i, u_i)$ and a connection $u_2 = h(x_1, u_1)$ it is $x_1' = f_1(x_1, u_1)$,
    $x_2' = f_2(x_2, h(x_1, u_1))$. States, controls, parameters, outputs and constraints are those of the systems in
    order, without the connected controls and parameters. The limits of a connected control become constraints.
    The result can be used like any other system: in problems, integrators, `renamed` and further joins.

    Args:
        systems: with different names; a control or parameter that is the same object in several of them is shared.
        connect: controls and parameters, by leaf or name, with the expressions of their shape that replace them,
            such as `{tug.force: engine.output("thrust")}`. These may depend on everything in the systems, including
            connected controls.
        outputs: additional outputs, expressions of states and leaves of all systems.
        constraints: additional constraints by name.
    Raises:
        ModelError: a name in two systems; a connection to a leaf that is not a control or parameter; circular
            connections (an algebraic loop), which the message names.
        ShapeError: an expression with another shape than the leaf that it replaces.

    An expression must have the unit of the leaf that it replaces. Source: P. Fritzson, Principles of Object-Oriented
    Modeling and Simulation with Modelica (2014), ch. 3, on directed connections.

    Example: `tx.join(engine, body, connect={body.F: engine.output("thrust")})`.
    """
    for system in systems:
        if not isinstance(system, System):
            raise ModelError(f"join expects systems, got {short(system)}")
    if not systems:
        raise ModelError("join expects at least one system, got none")
    _refuse_clashes(systems)
    leaves = {name: leaf for system in systems for name, leaf in named_leaves(system).items()}
    links = _checked_links(connect, leaves)
    exchange = _resolved(links, leaves)
    parts = [_part(system, links, exchange) for system in systems]
    merged: dict[str, Any] = {
        key: {n: e for part in parts for n, e in part[key].items()}
        for key in parts[0]
        if key not in (*_LISTS, "slopes")
    }
    slopes: list[SlopesOnDemand] = [part["slopes"] for part in parts]
    merged["slopes"] = SlopesOnDemand(
        lambda rates: {name: pairs for one in slopes for name, pairs in one.make(rates).items()},
        sum(one.scalars for one in slopes),
    )
    limits = {key: c for name in links if isinstance(leaf := leaves[name], Control) for key, c in _limits(leaf)}
    further = {"outputs": dict(outputs or {}), "constraints": {**limits, **(constraints or {})}}
    for family, new in further.items():
        for name, expr in new.items():
            if name in merged[family]:
                raise ModelError(
                    f"join: {family} has {name!r} twice.\n  fix: pass the additional one with another name"
                )
            merged[family][name] = exchanged(expr, exchange)
    lists: dict[str, Any] = {
        key: list({id(leaf): leaf for part in parts for leaf in part[key]}.values()) for key in _LISTS
    }
    written = [*exchange.values(), *(part for family in further for e in merged[family].values() for part in _exprs(e))]
    for leaf in leaves_of(*written):
        for argument, kind in _LISTS.items():
            if isinstance(leaf, kind) and leaf.name not in {other.name for other in lists[argument]}:
                lists[argument].append(leaf)
    return System(**merged, **lists)


def _exprs(value: Any) -> list[Expr]:
    return [e for e in (parts_of(value) if isinstance(value, (Soft, Constraint)) else [value]) if isinstance(e, Expr)]


_LISTS = {"controls": Control, "parameters": Parameter}


def _refuse_clashes(systems: Iterable[System]) -> None:
    """Raise ModelError for a name that two systems have for two things."""
    known: dict[str, tuple[int, Any]] = {}
    for place, system in enumerate(systems):
        things: dict[str, Any] = {**named_leaves(system)}
        things |= {f"output {name}": None for name in system.outputs}
        things |= {f"constraint {name}": None for name in system.constraints}
        for name, thing in things.items():
            first, other = known.setdefault(name, (place, thing))
            if first == place or (thing is not None and thing is other and not isinstance(thing, State)):
                continue
            kind = "" if thing is None else f"{type(thing).__name__} "
            shared = ", or use one object in both" if isinstance(thing, (Control, Parameter)) else ""
            raise ModelError(
                f"join: system {first} and system {place} both have the {kind}{name!r}.\n"
                f'  fix: rename one of them, system.renamed("b_"){shared}'
            )


def _checked_links(connect: Mapping[Any, Any] | None, leaves: Mapping[str, Leaf]) -> dict[str, Expr]:
    if connect is not None and not isinstance(connect, Mapping):
        raise ModelError(f"join: connect expects a dict from controls to expressions, got {short(connect)}")
    links: dict[str, Expr] = {}
    for key, value in (connect or {}).items():
        name = name_of(key)
        leaf = leaves.get(name)
        if leaf is None or (isinstance(key, Leaf) and key.key() != leaf.key()):
            inputs = {n: e for n, e in leaves.items() if not isinstance(e, State)}
            raise ModelError(
                f"join: connect names {name!r}, which is neither a control nor a parameter of the systems: "
                f"{listed(inputs, str(name))}"
            )
        if isinstance(leaf, State):
            raise ModelError(
                f"join: connect names the State {name!r}, which has a rate.\n"
                "  fix: connect a Control of the other system to it"
            )
        try:
            links[name] = to_expr(value)
        except ModelError as error:
            raise ModelError(f"join: connect[{name!r}]: {error}") from None
        if links[name].shape != leaf.shape:
            raise ShapeError(
                f"join: connect[{name!r}] expects shape {leaf.shape}, got {links[name].shape}",
                at=repr(links[name]),
                hint="select or stack entries of the output: tx.Stack([a, b]), a[2]",
            )
    return links


def _resolved(links: Mapping[str, Expr], leaves: Mapping[str, Leaf]) -> dict[str, Expr]:
    """The expressions by the keys of the leaves whose places they take, none of which they read any more."""
    reads = {
        name: [leaf.name for leaf in leaves_of(expr) if isinstance(leaf, (Control, Parameter)) and leaf.name in links]
        for name, expr in links.items()
    }
    try:
        order = list(graphlib.TopologicalSorter(reads).static_order())
    except graphlib.CycleError as error:
        circle = list(reversed(error.args[1]))
        pairs = itertools.pairwise(circle)
        lines = [f"  {name!r} = {links[name]!r}, which reads {other!r}" for name, other in pairs]
        raise ModelError(
            "join closes an algebraic loop:\n"
            + "\n".join(lines)
            + "\n  fix: make one of these outputs depend on a state in place of the control, such as the "
            "state of an actuator, or solve the loop for one of them"
        ) from None
    exchange: dict[str, Expr] = {}
    for name in order:
        exchange[leaves[name].key()] = substitute(links[name], exchange)
    return exchange


def _part(system: System, links: Mapping[str, Expr], exchange: Mapping[str, Expr]) -> dict[str, Any]:
    """The arguments of one system of a join."""
    part = arguments_of(system, exchange)
    part["controls"] = [leaf for leaf in system.controls if leaf.name not in links]
    part["parameters"] = [leaf for leaf in system.parameters if leaf.name not in links]
    part["labels"] = {name: pairs for name, pairs in part["labels"].items() if name not in links}
    if any(leaf.name in links for leaf in system.parameters):
        part["slopes"] = SlopesOnDemand(lambda _: {})  # they are at fixed parameters
    return part


def _limits(control: Control) -> Iterable[tuple[str, Any]]:
    """The limits of a control that is connected, as constraints by name, entries without a limit left out."""
    for side, bound, sign in (("min", control.min, 1.0), ("max", control.max, -1.0)):
        places = [] if bound is None else [at for at in np.ndindex(*control.shape) if np.isfinite(bound[at])]
        if bound is not None and places:
            entries = Stack([sign * (control[at] if at else control) for at in places])
            yield f"{control.name} {side}", entries >= sign * np.array([bound[at] for at in places])
