"""A system in the form that diffrax requires: its term; rates, coordinates and errors in a chart; one explicit step."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, NoReturn

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from ...errors import ModelError
from ...jax_inside import wrapped_terms
from ...scalar.small_call import small_call
from ...system.dynamics import Arrays, Dynamics, need_compiled
from ..ambient import AmbientSystem, Arguments, read_arguments
from ..charts.chart import Chart, coordinates_of
from ..charts.coordinates import Blocks, StateCoordinates
from ..loop.loop import all_finite
from ..methods.rkmk import stage_slopes
from ..tableaus import StageRows, lower_triangle


class LieTerm(diffrax.AbstractTerm):
    """A system as a term for `LieSolver`. Its rates are body velocities, which diffrax's own solvers cannot add to a
    state.
    """

    dynamics: Dynamics = eqx.field(static=True)

    def vf(self, t: Any, y: Any, args: Any) -> Arrays:
        """The rates at y with args = (u, params), or None. Raises InputError as a call of the dynamics does."""
        return read_arguments(self.dynamics, t, y, args).rates(self.dynamics)

    def contr(self, t0: Any, t1: Any, **kwargs: Any) -> Any:
        """The length of the step."""
        return t1 - t0

    def prod(self, vf: Any, control: Any) -> NoReturn:
        """Raises ModelError, because a solver that calls it would add body velocities to poses."""
        raise ModelError(
            "a term of tx.diffrax.lie_term has body velocities, which a plain solver cannot add to poses.\n"
            "  fix: wrap the solver, tx.diffrax.LieSolver(diffrax.Tsit5(), dynamics), or pass "
            "tx.diffrax.ambient_term(dynamics) to a plain solver. This error also occurs for "
            "BacksolveAdjoint with a custom solver: omit it"
        )


def lie_term(dynamics: Dynamics) -> LieTerm:
    """A system as a term for `LieSolver`, with args = (u, params) in the form of `tx.integrate`, or None.

    Raises:
        ModelError: the system is not compiled.
    """
    need_compiled("lie_term", dynamics)
    return LieTerm(dynamics)


class _Refusing(type(diffrax.AbstractTerm)):  # type: ignore[misc]
    """The type of `LieTerms`: its instance check raises an error with the reason why a term is refused."""

    def __instancecheck__(cls, term: Any) -> bool:
        return bool(parts_of(term))


class LieTerms(diffrax.AbstractTerm, metaclass=_Refusing):
    """The terms that `LieSolver` accepts: one of `lie_term`, or a MultiTerm of these. Others raise ModelError with the
    reason.
    """


class DirectedSystem(NamedTuple):
    """One of the systems in the terms, and the direction of time: 1, or -1 if diffrax integrates backwards."""

    dynamics: Dynamics
    direction: Any


def parts_of(terms: Any) -> tuple[DirectedSystem, ...]:
    """The systems among the terms of a solver or a controller. Raises ModelError for other terms."""
    WrapTerm, AdjointTerm = wrapped_terms()

    def part(term: Any) -> DirectedSystem:
        direction: Any = 1
        while isinstance(term, WrapTerm):
            direction, term = direction * term.direction, term.term
        if isinstance(term, AdjointTerm):
            raise ModelError(
                "BacksolveAdjoint cannot work on groups: it integrates the state backwards together with an adjoint "
                "that would have to live in the cotangent space of every pose.\n"
                "  fix: leave adjoint out, or use diffrax.RecursiveCheckpointAdjoint(); for forward "
                "derivatives use diffrax.ForwardMode()"
            )
        if not isinstance(term, LieTerm):
            raise ModelError(
                f"tx.diffrax.LieSolver and tx.diffrax.controller need terms of tx.diffrax.lie_term, got "
                f"{type(term).__name__}.\n"
                "  fix: diffeqsolve(tx.diffrax.lie_term(dynamics), tx.diffrax.LieSolver(...), ...); for a "
                "plain term use a plain solver and diffrax.PIDController"
            )
        return DirectedSystem(term.dynamics, direction)

    return tuple(map(part, terms.terms if isinstance(terms, diffrax.MultiTerm) else (terms,)))


@dataclasses.dataclass(frozen=True)
class ChartedSystem:
    """A system in a chart, with coordinates around the start of a step. Hashable. Numbers are
    passed as flat vectors.
    """

    dynamics: Dynamics
    chart: Chart

    @property
    def local(self) -> StateCoordinates:
        return coordinates_of(self.chart, self.dynamics.group)

    @property
    def ambient(self) -> AmbientSystem:
        """The state in its matrices, for errors and plain rates."""
        return AmbientSystem(self.dynamics, quaternion=False)

    def rate(self, dynamics: Dynamics, arguments: Arguments, t: jax.Array, h: jax.Array) -> Blocks:
        """The rate at arguments.t and arguments.x for controls within the step from t to t + h."""
        rates = arguments.rates(dynamics, t, h)
        return self.local.rate({name: rate.reshape(-1) for name, rate in rates.items()})

    def packed(self, x: Arrays) -> tuple[jax.Array, Callable[[jax.Array], Blocks]]:
        """The coordinates of x around x itself, flat, and the function that unpacks flat ones."""
        return self.local.packed(self.local.enter(x), self.dynamics.group)

    def errors(self, x: Arrays, end: Blocks, e: Blocks) -> Arrays:
        """An error e of the coordinates of `end`, as the change of the entries of its value x: [R W, R v; 0 0] for a
        pose and a deviation [v; w]. Infinite if x is not finite.
        """
        parts = self.local.parts
        velocities = {name: parts[name].velocity(d) for name, d in self.local.deviation(e, end).items()}
        good = all_finite(x)
        return {name: jnp.where(good, a, jnp.inf) for name, a in self.ambient.rates(x, velocities).items()}

    def deviations(self, x: Mapping[str, Any], errors: Mapping[str, Any]) -> Blocks:
        """The deviations, the inverse of `errors`."""
        groups, parts = self.dynamics.group.factors, self.local.parts
        return {
            name: parts[name].rate(group.body_velocity(x[name], errors[name]).reshape(group.tangent_shape))
            for name, group in groups.items()
        }


class Stepped(NamedTuple):
    """The result of a step."""

    x: Arrays  # the state at its end
    error: Arrays  # its estimated error, in the form of the state
    z: jax.Array  # the coordinates of the end, flat
    k: jax.Array  # (stages, n) the increments of all stages
    rate: jax.Array  # of the last stage, flat


def explicit_step(
    frame: ChartedSystem, tableau: diffrax.ButcherTableau, arguments: Arguments, h: jax.Array, rate: jax.Array | None
) -> Stepped:
    """The step of an explicit Runge-Kutta solver of diffrax, compiled as one small function if this is supported.

    The tableau is that of diffrax, the loop over stages that of `RKMK`. The rate of the last stage is passed to the
    next step as a body velocity, which needs no change of chart. `rate`, if known, is the rate at the start, flat.
    Traceable.
    """
    stages, local = StageRows(lower_triangle(tableau.a_lower), np.append(0.0, tableau.c)), frame.local

    def take_step(arguments: Arguments, h: jax.Array, known: jax.Array | None) -> Stepped:
        start = local.enter(arguments.x)

        def rate_of(time: jax.Array, y: Blocks) -> Blocks:
            return frame.rate(frame.dynamics, dataclasses.replace(arguments, t=time, x=local.value(y)), arguments.t, h)

        def slope(time: jax.Array, z: Blocks) -> tuple[Blocks, jax.Array]:
            moved = local.move(start, z)
            rate = rate_of(time, moved)
            return local.slope(z, moved, rate), ravel_pytree(rate)[0]

        if known is None:
            first = rate_of(arguments.t, start)
        else:
            groups = frame.dynamics.group.factors
            still = {name: jnp.zeros(group.dimension, known.dtype) for name, group in groups.items()}
            first = ravel_pytree(local.rate(still))[1](known)
        slopes, last = stage_slopes(
            stages, slope, local.first_slope(start, first), ravel_pytree(first)[0], arguments.t, h
        )
        z = slopes.combine(tableau.b_sol, h)
        end = local.settle(local.move(start, z))
        x = local.value(end)
        error = frame.errors(x, end, slopes.combine(tableau.b_error, h))
        return Stepped(x, error, ravel_pytree(z)[0], h * slopes.rows, last)

    step = jax.custom_jvp(lambda *operands: small_call(take_step, *operands))
    step.defjvp(lambda primals, tangents: jax.jvp(take_step, primals, tangents))
    return step(arguments, h, rate)
