"""Magnus methods: one exponential per step, for body velocities that depend on time but not on the pose."""

from __future__ import annotations

import dataclasses
from math import sqrt
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ...checks import instance
from ...errors import ModelError
from ...groups import Group
from ...system.dynamics import Arrays, Dynamics
from ..charts.chart import Exponential, compensated
from ..charts.coordinates import Blocks, StateCoordinates
from ..method import Method, VectorField
from ..tableaus import DOP853, RK4, ButcherTableau
from .rkmk import stage_slopes

# Omega with g(t + h) = g(t) Exp(Omega), from the velocities A at the Gauss nodes of the step, one a row. The formulas
# are those for Y' = A Y. Here g' = g A^, which is Y' = -A Y for Y = g^-1, so that Omega is minus the Omega of -A: every
# bracket changes its sign.


def _fourth(A: jax.Array, h: jax.Array, group: Group) -> jax.Array:
    """Source: Iserles, Munthe-Kaas, Norsett, Zanna, Lie-group methods, Acta Numerica 9 (2000), on Magnus methods."""
    return 0.5 * h * (A[0] + A[1]) + sqrt(3.0) / 12.0 * h * h * group.bracket(A[0], A[1])


def _sixth(A: jax.Array, h: jax.Array, group: Group) -> jax.Array:
    """Source: Blanes, Casas, Oteo, Ros, The Magnus expansion and some of its applications, Physics Reports 470 (2009),
    on numerical integrators: the method of order 6 with Gauss nodes and three commutators.
    """
    first, second = h * A[1], sqrt(15.0) / 3.0 * h * (A[2] - A[0])
    third = 10.0 / 3.0 * h * (A[2] - 2.0 * A[1] + A[0])
    once = -group.bracket(first, second)
    twice = group.bracket(first, 2.0 * third + once) / 60.0
    outer = group.bracket(-20.0 * first - third + once, second + twice)
    return first + third / 12.0 - outer / 240.0


#: By order: the number of nodes, Omega, and the tableau that moves states without a group to the nodes.
_EXPANSIONS = {4: (2, _fourth, RK4), 6: (3, _sixth, DOP853)}


@dataclasses.dataclass(frozen=True)
class Magnus(Method):
    """The Magnus method of order 4 or 6, exact for constant velocities, with one exponential a step.

    It requires that no rate depends on a rotation or a pose. Examples are attitude from measured rates, prescribed
    twists and free bodies. Rates may depend on time, controls, parameters and states without a group, which an explicit
    Runge-Kutta method integrates from one Gauss node to the next. A step that rotates by more than a full turn fails.

    Attributes:
        order: 4 or 6.
        inner: the tableau for states without a group; RK4 or DOP853 by default.

    Raises:
        ModelError: another order, or an inner that is not a tableau. When integrated: a rate that depends on a rotation
            or a pose.

    Source: Magnus, On the exponential solution of differential equations for a linear operator (1954); the papers of
    the two expansions.
    """

    order: int = 4
    inner: Any = None

    def __post_init__(self) -> None:
        if not isinstance(self.order, int) or self.order not in _EXPANSIONS:
            raise ModelError(f"Magnus expects order 4 or 6, got {self.order!r}")
        if self.inner is None:
            object.__setattr__(self, "inner", _EXPANSIONS[self.order][2])
        instance("Magnus: inner", self.inner, ButcherTableau, "a tableau like tx.tableaus.RK4", ModelError)

    @property
    def name(self) -> str:
        return f"Magnus {self.order}"

    @property
    def evaluations(self) -> int:
        """The evaluations for a system whose velocities do not depend on states without a group."""
        return _EXPANSIONS[self.order][0]

    def evaluations_of(self, dynamics: Dynamics) -> int:
        """Evaluations of the right-hand side in a step on a system."""
        stages, flat = len(self.inner.counted.c), _flat_names(dynamics)
        if _fed(dynamics):
            # The first stage of each part is the evaluation at the node.
            return (self.evaluations + 1) * stages
        return self.evaluations + (stages if flat else 0)

    @property
    def _nodes(self) -> np.ndarray:
        return 0.5 * (np.polynomial.legendre.leggauss(_EXPANSIONS[self.order][0])[0] + 1.0)

    def check(self, dynamics: Dynamics) -> None:
        """Raises ModelError, which names the state, if a rate reads a rotation or a pose."""
        turning = {name for name in dynamics.group.factors if name not in _flat_names(dynamics)}
        for state in dynamics.states:
            read = sorted(dynamics.functions.rate_reads(state.name) & turning)
            if read:
                raise ModelError(
                    f"{self.name} needs rates that do not depend on rotations and poses, but the rate of "
                    f"{state.name!r} reads {', '.join(map(repr, read))}.\n"
                    "  fix: use tx.RKMK(tx.tableaus.RK4) or another tableau, which integrate every system"
                )

    def coordinates(self, dynamics: Dynamics) -> StateCoordinates:
        return compensated(Exponential(), dynamics.group)

    def advance(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        local = self.coordinates(field.dynamics)
        return local.settle(local.move(y, self._moves(field, t, y, h)))

    def increment(self, field: VectorField, t: jax.Array, x: Arrays, h: jax.Array) -> Arrays:
        """The tangent eta of one step, so that the step ends at x Exp(eta): Omega for rotations and poses, and the
        increments of other states.
        """
        local = self.coordinates(field.dynamics)
        return local.tangent(self._moves(field, t, local.enter(x), h))

    def _moves(self, field: VectorField, t: jax.Array, y: Blocks, h: jax.Array) -> Blocks:
        """The coordinates of the end of the step around its start."""
        dynamics = field.dynamics
        local, flat = self.coordinates(dynamics), _flat_names(dynamics)
        flat_coordinates = StateCoordinates({name: local.parts[name] for name in flat})

        def rates(time: jax.Array, moved: Blocks) -> Arrays:
            # Rotations and poses stay where they were: no rate reads them.
            return field(time, local.value(y | flat_coordinates.move({name: y[name] for name in flat}, moved)))

        def part(moved: Blocks, share: jax.Array, length: jax.Array) -> tuple[Blocks, Arrays]:
            """The state a length further from a share of the step, and the velocities there."""
            start = t + share * h
            rate = rates(start, moved)

            def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, None]:
                return flat_coordinates.rate(rates(time, _sum(moved, z))), None

            slopes, _ = stage_slopes(self.inner.counted, slope, flat_coordinates.rate(rate), None, start, length * h)
            further = slopes.combine(self.inner.b, length * h)
            return _sum(moved, further), {name: rate[name] for name in rate if name not in flat}

        moved = flat_coordinates.rate({name: jnp.zeros_like(local.parts[name].value(y[name])) for name in flat})
        starts = np.append(0.0, self._nodes)
        velocities: Arrays
        if _fed(dynamics):
            entries = tuple(jnp.asarray(a, h.dtype) for a in (starts, np.diff(starts, append=1.0)))
            moved, velocities = jax.lax.scan(lambda moved, entry: part(moved, *entry), moved, entries)
            velocities = {name: A[1:] for name, A in velocities.items()}
        else:
            velocities = jax.lax.map(
                lambda share: {n: v for n, v in rates(t + share * h, moved).items() if n not in flat},
                jnp.asarray(self._nodes, h.dtype),
            )
            if flat:
                moved, _ = part(moved, *jnp.asarray([0.0, 1.0], h.dtype))
        groups, omega = dynamics.group.factors, _EXPANSIONS[self.order][1]
        return moved | {n: local.parts[n].rate(omega(A, h, groups[n])) for n, A in velocities.items()}


def _flat_names(dynamics: Dynamics) -> list[str]:
    return [name for name, group in dynamics.group.factors.items() if group.flat]


def _fed(dynamics: Dynamics) -> bool:
    """Whether the velocity of a rotation or a pose reads a state without a group."""
    flat = set(_flat_names(dynamics))
    return any(dynamics.functions.rate_reads(name) & flat for name in dynamics.group.factors if name not in flat)


def _sum(a: Blocks, b: Blocks) -> Blocks:
    return jax.tree.map(jnp.add, a, b)
