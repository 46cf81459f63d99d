"""Runge-Kutta-Munthe-Kaas: a Runge-Kutta method in exponential coordinates around the start of each step."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping

import jax
import jax.numpy as jnp

from ..lowering import Dynamics
from ..lowering.dynamics import Arrays
from .tableau import ButcherTableau

__all__ = ["RKMK", "ControlsAt", "increment"]

#: Beyond this many stages a loop over them, which compiles once, saves more than it costs: the first step of a forced
#: rigid body with DOP853 takes 8.0 s with its stages one after another and 1.4 s in a loop.
_MOST_UNROLLED = 7

#: The prepared controls at a stage time.
ControlsAt = Callable[[jax.Array], Arrays]


def increment(
    dynamics: Dynamics,
    tableau: ButcherTableau,
    t: jax.Array,
    x: Arrays,
    u_at: ControlsAt,
    params: Arrays,
    h: jax.Array,
    *,
    rolled: bool = False,
) -> Arrays:
    """The tangent eta of one step, so that the step ends at x (+) eta = x Exp(eta).

    With Omega(t, x) the body velocities of all states, stage i stands at x Exp(eta_i) and

        eta_i = h sum_j a_ij k_j,   k_i = J_r(eta_i)^-1 Omega(t + c_i h, x Exp(eta_i)),   eta = h sum_i b_i k_i,

    because eta' = J_r(eta)^-1 Omega for g = g_0 Exp(eta) and g' = g Omega^, with J_r the right Jacobian. For states
    without a group both are the identity, and this is the Runge-Kutta method itself.

    Arguments are prepared (`Dynamics.prepare`). Pure and traceable: jit, vmap and derivatives apply.

    Args:
        u_at: the prepared controls at a stage time.
        h: the length of the step in s.
        rolled: one traced stage in a loop instead of all of them in a row: about half the time to compile where
            derivatives are taken, and a little slower to run.
    Returns:
        name -> tangent (dimension of the state,), of states without a group read row by row.

    Source: Munthe-Kaas, High order Runge-Kutta methods on manifolds (1999); Iserles, Munthe-Kaas, Norsett, Zanna,
    Lie-group methods (2000), both for right-trivialised equations, where the Jacobian is the left one.
    """
    factors = dynamics.group.factors

    def slope(time: jax.Array, eta: Arrays) -> Arrays:
        point = {name: group.retract(x[name], eta[name]) for name, group in factors.items()}
        rates = _flat(dynamics.vector_field(time, point, u_at(time), params))
        return {name: group.right_jacobian_inv_apply(eta[name], rates[name]) for name, group in factors.items()}

    if rolled:
        return _rolled_increment(slope, tableau, {n: group.dimension for n, group in factors.items()}, t, h)
    slopes: list[Arrays] = []
    for row, node in zip(tableau.a.tolist(), tableau.c.tolist(), strict=True):
        time = t + node * h if node else t
        if any(row):
            slopes.append(slope(time, _combine(row, slopes, h)))
        else:
            slopes.append(_flat(dynamics.vector_field(time, x, u_at(time), params)))
    return _combine(tableau.b.tolist(), slopes, h)


def _rolled_increment(
    slope: Callable[[jax.Array, Arrays], Arrays],
    tableau: ButcherTableau,
    dimensions: Mapping[str, int],
    t: jax.Array,
    h: jax.Array,
) -> Arrays:
    """The increment by a loop over stages; stages that are still to come count zero."""
    a, b, c = (jnp.asarray(table, h.dtype) for table in (tableau.a, tableau.b, tableau.c))

    def stage(slopes: Arrays, row: tuple[jax.Array, jax.Array, jax.Array]) -> tuple[Arrays, None]:
        number, weights, node = row
        found = slope(t + node * h, {name: h * (weights @ k) for name, k in slopes.items()})
        return {name: k.at[number].set(found[name]) for name, k in slopes.items()}, None

    start = {name: jnp.zeros((tableau.stages, n), h.dtype) for name, n in dimensions.items()}
    slopes, _ = jax.lax.scan(stage, start, (jnp.arange(tableau.stages), a, c))
    return {name: h * (b @ k) for name, k in slopes.items()}


@dataclasses.dataclass(frozen=True)
class RKMK:
    """The explicit Runge-Kutta-Munthe-Kaas method of a tableau, in exponential coordinates. See `increment`.

    On states without a group it is the Runge-Kutta method. Methods are values: equal tableaus, equal methods.
    """

    tableau: ButcherTableau

    @property
    def evaluations(self) -> int:
        """Evaluations of the right-hand side a step."""
        return self.tableau.stages

    def step(
        self, dynamics: Dynamics, t: jax.Array, x: Arrays, u_at: ControlsAt, params: Arrays, h: jax.Array
    ) -> Arrays:
        """The state after one step of length h, from prepared arguments. Pure and traceable.

        Products of rotations lose orthonormality by round-off, linearly in the number of steps where the twist is
        constant; tightening once a step keeps it at round-off.
        """
        rolled = self.tableau.stages > _MOST_UNROLLED
        eta = increment(dynamics, self.tableau, t, x, u_at, params, h, rolled=rolled)
        return {n: group.tighten(group.retract(x[n], eta[n])) for n, group in dynamics.group.factors.items()}


def _combine(weights: Iterable[float], slopes: list[Arrays], h: jax.Array) -> Arrays:
    """h sum_i weights[i] slopes[i], zeros skipped."""
    used = [(weight, slope) for weight, slope in zip(weights, slopes) if weight]

    def total(name: str) -> jax.Array:
        terms = [slope[name] if weight == 1.0 else weight * slope[name] for weight, slope in used]
        return h * sum(terms[1:], terms[0])

    return {name: total(name) for name in used[0][1]}


def _flat(rates: Arrays) -> Arrays:
    return {name: rate.reshape(-1) for name, rate in rates.items()}
