"""Fleets: many copies of one system, with a leading axis of copies."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..checks import listed, short, whole
from ..errors import ModelError
from ..expr import Concat, Control, Expr, Leaf, Parameter, Reshaped, State, Vmap, leaves_of, postorder, substitute
from ..expr.operations.comparisons import Complementarity
from ..expr.operations.soft import Soft
from ..expr.transformations.vmap import elements_by
from ..groups.power import GroupPower
from ..scalar.backends import JAX, Backend, Emission
from ..scalar.fast import part_of_package
from ..scalar.graph import TooLarge
from ..scalar.jax_primitive import call_program
from ..scalar.parts.member_program import MemberProgram
from ..scalar.reader import scalarize
from ..scalar.targets.llvm.backend import Native, installed
from .composable import named_leaves
from .system import System


def repeat(system: Any, count: Any, *, shared: Any = (), per_copy: Any = ()) -> System:
    """A fleet: n copies of a system without interaction, as arrays with a leading axis of length n.

    $x_k' = f(t, x_k, u_k, p)$ for k = 0, ..., n - 1. States and controls of shape s become (n, *s). States on a group G
    become elements of $G^n$, (n, *shape), whose rates are the concatenated body velocities, (n d,). Outputs and
    constraints have the leading axis too. The rates are one batched function: the size of the program is that of one
    copy. Names are unchanged; `tx.join` connects a fleet to others, with entries such as `fleet.p[2]`.

    Args:
        system: the system of one copy.
        count: the number n of copies.
        shared: names of controls that all copies have in common.
        per_copy: names of parameters that are separate for each copy, (n, *s); others are common to all.
    Raises:
        ModelError: a count below one; a name in `shared` that is not a control, or in `per_copy` that is not a
            parameter.

    Units are those of the system. Source: R. Frostig, M. Johnson, C. Leary, Compiling machine learning programs via
    high-level tracing (2018), on functions mapped over a leading axis.

    Example: `fleet = tx.repeat(quadrotor, 4)`; `tx.compile(fleet)(0.0, {"p": np.zeros((4, 3)), ...})`.
    """
    if not isinstance(system, System):
        raise ModelError(f"repeat expects a System, got {short(system)}")
    count = whole("repeat: count", count, 1, ModelError)
    for names, leaves, argument in ((shared, system.controls, "shared"), (per_copy, system.parameters, "per_copy")):
        known = {leaf.name for leaf in leaves}
        for name in [names] if isinstance(names, str) else names:
            if name not in known:
                raise ModelError(f"repeat: {argument} names {name!r}; it expects some of: {listed(known, str(name))}")
    common = {p.name for p in system.parameters} - set(per_copy) | set(shared)
    fleet = _Fleet(
        count, {name: (leaf, _many(leaf, count)) for name, leaf in named_leaves(system).items() if name not in common}
    )
    return System(
        rates=_tangents(fleet, system.states, system.rates),
        outputs={name: fleet.copies(expr) for name, expr in system.outputs.items()},
        constraints={name: fleet.constraint(system.soft.get(name, c)) for name, c in system.constraints.items()},
        corrections=_tangents(fleet, [s for s in system.states if s.name in system.corrections], system.corrections),
        controls=[fleet.leaf(control) for control in system.controls],
        parameters=[fleet.leaf(parameter) for parameter in system.parameters],
        labels={
            name: [(f"{label} {k}", unit) for k in range(count if name in fleet.leaves else 1) for label, unit in pairs]
            for name, pairs in system.labels.items()
        },
    )


@dataclasses.dataclass(frozen=True)
class _Fleet:
    """The leaves of one copy by name, each with that of all copies."""

    count: int
    leaves: Mapping[str, tuple[Leaf, Leaf]]

    def leaf(self, leaf: Leaf) -> Any:
        return self.leaves[leaf.name][1] if leaf.name in self.leaves else leaf

    def copies(self, expr: Expr) -> Any:
        """An expression of one copy for all of them, (n, *shape)."""
        pairs = list(self.leaves.values())

        def one(*elements: Expr) -> Expr:
            keys = (leaf.key() for leaf, _ in pairs)
            return substitute(expr, dict(zip(keys, elements, strict=True)))

        return Vmap(one, [many for _, many in pairs])

    def constraint(self, constraint: Any) -> Any:
        if isinstance(constraint, Complementarity):
            return Complementarity(self.copies(constraint.lhs), self._weight(constraint.rhs))
        if not isinstance(constraint, Soft):
            return self.copies(constraint)
        weights = {"l1": constraint.l1, "l2": constraint.l2}
        copied = {key: self._weight(weight) for key, weight in weights.items() if weight is not None}
        return Soft(self.copies(constraint.constraint), **copied)

    def _weight(self, weight: Expr) -> Expr:
        if not (weight.shape or any(leaf.name in self.leaves for leaf in leaves_of(weight))):
            return weight
        return self.copies(weight)


def _tangents(fleet: _Fleet, states: Any, exprs: Mapping[str, Expr]) -> dict[Any, Expr]:
    """Rates or corrections of all copies: one batch of all of them, of which each state takes its columns."""
    if not states:
        return {}
    columns = fleet.copies(Concat(*(_flat(exprs[state.name]) for state in states))).of_copies()
    result, start = dict[Any, Expr](), 0
    for state in states:
        end, many = start + state.group.dimension, fleet.leaf(state)
        rows = columns[:, start:end]
        shape = many.group.tangent_shape
        result[many] = rows if shape == rows.shape else Reshaped(rows, shape)
        start = end
    return result


def _flat(expr: Expr) -> Expr:
    """The entries of an expression as a vector."""
    if expr.ndim <= 1:
        return Concat(expr)
    return Concat(*(_flat(expr[i]) for i in range(expr.shape[0])))


def _many(leaf: Any, count: int) -> Leaf:
    """The leaf of all copies of a state, control or parameter."""

    def spread(value: Any) -> Any:
        return None if value is None else np.broadcast_to(value, (count, *np.shape(value)))

    facts = {"kind": leaf.kind, "unit": leaf.unit}
    if isinstance(leaf, Parameter):
        return Parameter(leaf.name, (count, *leaf.shape), value=spread(leaf.value), **facts)
    guess = leaf.guess
    if guess is not None:
        guess = spread(guess) if guess.ndim == len(leaf.shape) else np.stack([guess] * count, axis=1)
    if isinstance(leaf, Control):
        options = {"min": spread(leaf.min), "max": spread(leaf.max), "scale": spread(leaf.scale)}
        return Control(leaf.name, (count, *leaf.shape), guess=guess, **options, **facts)
    ends = facts | {"initial": spread(leaf.initial), "final": spread(leaf.final), "guess": guess}
    if leaf.group.flat:
        options = {"min": spread(leaf.min), "max": spread(leaf.max), "scale": spread(leaf.scale)}
        return State(leaf.name, (count, *leaf.shape), **ends, **options)
    scale = None if leaf.scale is None else np.tile(leaf.scale, count)
    return State(leaf.name, group=GroupPower(leaf.group, count), scale=scale, **ends)


#: Programs of members by their keys, of the functions and of the shapes and types of their arguments.
_MEMBERS: dict[Hashable, MemberProgram] = {}
_MOST_MEMBERS = 64


def traced_once(function: Callable[..., jax.Array], key: str) -> Callable[..., jax.Array]:
    """A function of one member of a batch, as a program that is traced once and written out for all members.

    Args:
        key: equal for functions that compute the same.
    """

    def traced(*arguments: jax.Array) -> jax.Array:
        types = tuple((jnp.shape(a), jnp.result_type(a)) for a in arguments)
        program = _MEMBERS.get((key, types))
        if program is None:
            shapes = list(itertools.starmap(jax.ShapeDtypeStruct, types))
            try:
                scalars = scalarize(lambda *values: [function(*values)], *shapes)
            except TooLarge:
                return function(*arguments)
            if scalars.calls:
                return function(*arguments)
            program = _MEMBERS[key, types] = MemberProgram(scalars)
            if len(_MEMBERS) > _MOST_MEMBERS:
                _MEMBERS.pop(next(iter(_MEMBERS)), None)
        return call_program(program, *arguments)[0]

    return traced


def copies_in_a_kernel(
    emission: Emission, backend: Backend, roots: Mapping[str, Sequence[Expr]], traced: Callable[[], tuple[Any, Any]]
) -> Emission:
    """Execution of expressions with batches of copies as arrays, each batch as one kernel over the copies.

    Args:
        emission: how the backend would execute all of them.
        roots: the expressions by name.
        traced: returns their function, traced again, and the structure of its results.
    """
    if emission.program is not None or not isinstance(backend, Native) or not installed():
        return emission
    nodes = postorder(*itertools.chain.from_iterable(roots.values()))
    if not any(isinstance(node, Vmap) and node.copies for node in nodes):
        return emission
    # One copy has a kernel also where it would be too small for one alone.
    of_one = backend if type(backend) is Native else Native(threads=backend.threads)
    with elements_by(copies=lambda function, _: part_of_package(function, backend=of_one)):
        return dataclasses.replace(JAX().emit(traced()[0]), reason="a batch of one kernel for all copies")
