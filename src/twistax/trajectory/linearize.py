"""Continuous-time error dynamics in the tangent space."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp

from ..lowering import Dynamics
from ..lowering.dynamics import not_compiled
from ..lowering.inputs import Values
from .flat import Controls, flat_rates

__all__ = ["Linearization", "linearize"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Linearization:
    """d' = A d + B du to first order, with x(t) (+) d the neighbour of the trajectory.

    Attributes:
        rate: the rates as one tangent vector, (n,).
        A: (n, n), rows and columns in the order of declaration of the states.
        B: (n, m), columns in the order of declaration of the controls, each read row by row.
    """

    rate: jax.Array
    A: jax.Array
    B: jax.Array


def linearize(
    dynamics: Dynamics, t: Any, x: Values, u: Values | None = None, params: Values | None = None
) -> Linearization:
    """The error dynamics of a system around a point, with right perturbations x (+) d.

    With the body velocity xi(t, x, u) of all states stacked, the neighbour x Exp(d) obeys to first order

        d' = (D xi - ad_xi) d + D_u xi du,

    where D xi = d xi(x Exp(d)) / dd at 0 and ad of a Euclidean part is zero. Units are those of the states a second.
    Source: Sola, Deray, Atchuthan, A micro Lie theory for state estimation in robotics (2018), sections on
    perturbations and on Jacobians of group actions; the ad term is the transport of d along the flow.

    Traceable: jit, vmap and further derivatives apply.

    Raises:
        InputError: as a call of the dynamics does.
        ModelError: the system is not compiled.
    """
    if not isinstance(dynamics, Dynamics):
        raise not_compiled("linearize", dynamics)
    inputs = dynamics._functions.prepare(t, x, u, params)
    controls = Controls(dynamics.controls)
    flat = controls.join(inputs.u, inputs.dtype)
    n = dynamics.dimension

    def velocity(z: jax.Array) -> tuple[jax.Array, jax.Array]:
        moved = dynamics.group.retract(inputs.x, z[:n])
        rates = dynamics._functions.vector_field(inputs.t, moved, controls.split(z[n:]), dict(inputs.params))
        flat_rate = flat_rates(dynamics, rates)
        return flat_rate, flat_rate

    jacobian, rate = jax.jacfwd(velocity, has_aux=True)(jnp.concatenate([jnp.zeros(n, inputs.dtype), flat]))
    return Linearization(rate, jacobian[:, :n] - dynamics.group.ad(rate), jacobian[:, n:])
