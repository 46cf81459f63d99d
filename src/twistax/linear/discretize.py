"""One interval with constant controls, and its derivatives in the tangent space."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence
from math import prod
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from ..checks import number, real_array, short, whole
from ..errors import InputError, TrajectoryError
from ..expr import Control, Inputs
from ..integrators import RKMK, ImplicitRKMK, VectorField
from ..integrators.method import Method
from ..integrators.tableaus import RK4
from ..progress import watching
from ..system.dynamics import Arrays, Dynamics, need_compiled
from ..system.inputs import Values, is_finite
from .second_order import second_order


class Controls:
    """The positions of the controls in the flat vector u, with each control read row by row.

    Attributes:
        dimension: length of the vector.
        slices: name -> slice.
    """

    def __init__(self, leaves: Sequence[Control]) -> None:
        self._shapes = {leaf.name: leaf.shape for leaf in leaves}
        ends = list(itertools.accumulate(map(prod, self._shapes.values()), initial=0))
        self.slices = dict(zip(self._shapes, itertools.starmap(slice, itertools.pairwise(ends))))
        self.dimension = ends[-1]

    def split(self, u: Any) -> dict[str, Any]:
        """The controls by name from the last axis of an array (..., dimension)."""
        return {
            name: u[..., self.slices[name]].reshape((*u.shape[:-1], *shape)) for name, shape in self._shapes.items()
        }

    def join(self, u: Mapping[str, Any], dtype: Any) -> jax.Array:
        """The flat vector; a control that no expression reads may be missing and is set to zero."""
        parts = [jnp.asarray(u.get(name, jnp.zeros(s, dtype)), dtype).reshape(-1) for name, s in self._shapes.items()]
        return jnp.concatenate(parts) if parts else jnp.zeros(0, dtype)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Discretization:
    """The linearised step of an interval: from $x (+) d$ with controls $u + du$ it ends at $x1 (+) d1$ with $d1 = A d +
    B du + D_h dh + D_t dt$.

    Attributes:
        x1: the end of the interval, by state name.
        A: (n, n), rows and columns in the order of declaration of the states.
        B: (n, m), columns in the order of declaration of the controls, each in row-major order.
        h_derivative: (n,), derivative with respect to the length of the interval; needed for a free final time.
        t_derivative: (n,), derivative with respect to the start time; zero if the rates do not depend on time.
        hessian: (N, N), N = n + m + 2, the symmetric second derivatives of weights . d1 with respect to (d, du, dh,
            dt); None without weights.
    """

    x1: Arrays
    A: jax.Array
    B: jax.Array
    h_derivative: jax.Array
    t_derivative: jax.Array
    hessian: jax.Array | None = None


class Rollout(NamedTuple):
    """The states at the ends of the substeps of an interval, starting with its start; with a leading axis of substeps +
    1.
    """

    ts: jax.Array
    xs: Arrays
    sensitivity: jax.Array  # (substeps + 1, n, n + m + 2): the states' tangents by [start, controls, h, t]


@watching("discretize")
def discretize(
    dynamics: Dynamics,
    t: Any,
    x: Values,
    u: Values | None,
    h: Any,
    params: Values | None = None,
    *,
    method: Method | None = None,
    substeps: int = 1,
    weights: Any = None,
) -> Discretization:
    """The end of an interval of length h with constant controls, and its derivatives in the tangent space.

    With $eta(d, u)$ the increment of an RKMK step from $x Exp(d)$, the step ends at $x Exp(d) Exp(eta)$, and the
    derivatives are

        $A = Ad(Exp(-eta)) + J_r(eta) d eta/dd, B = J_r(eta) d eta/du$,

    in closed form, without a logarithm, with the right Jacobian J_r. On Euclidean parts Ad and J_r are identities.
    Several substeps are combined by the chain rule. Traceable: jit, vmap and further derivatives apply.

    With weights, value, Jacobian and Hessian are one scalar program, for any explicit method: $d1 = Log(x1^-1 end)$ is
    differentiated as in `Dynamics.hessian`, with exponential coordinates at both ends. Other weights do not recompile.
    Operations without a scalar form, and other methods without weights, are differentiated by JAX.

    Args:
        u: the controls, constant over the interval.
        h: the length of the interval in s; may be traced.
        method: an explicit method; RKMK with RK4 by default.
        substeps: the number of steps of the method within the interval.
        weights: (n,), multipliers of the tangent difference d1, for the Hessian.
    Raises:
        InputError: the errors of a call of the dynamics; weights of another shape, or not finite.
        TrajectoryError: `substeps` is not a positive whole number, or the method is implicit.
        ModelError: the system is not compiled.
    """
    need_compiled("discretize", dynamics)
    whole("substeps", substeps, 1, TrajectoryError)
    inputs = dynamics.functions.prepare(t, x, u, params)
    flat = Controls(dynamics.controls).join(inputs.u, inputs.dtype)
    length = jnp.asarray(number("h", h), inputs.dtype)
    chosen = method if isinstance(method, Method) else method_of(method)
    if isinstance(chosen, ImplicitRKMK):
        raise TrajectoryError(f"method must be explicit, such as tx.RKMK(tx.tableaus.RK4), got {chosen!r}")
    if weights is not None or not isinstance(chosen, RKMK):
        return _differentiated(dynamics, chosen, inputs, length, substeps, weights)
    x, params = dict(inputs.x), dict(inputs.params)
    path = rollout(dynamics, chosen, inputs.t, x, flat, length, params, substeps)
    n, m, last = dynamics.dimension, flat.shape[0], path.sensitivity[-1]
    x1 = {name: values[-1] for name, values in path.xs.items()}
    return Discretization(x1, last[:, :n], last[:, n : n + m], last[:, n + m], last[:, n + m + 1])


def value_and_jacobian(function: Callable[[jax.Array], jax.Array], z: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The value of a function of a vector and its derivative, in forward mode."""
    slopes, value = jax.jacfwd(lambda z: (function(z),) * 2, has_aux=True)(z)
    return value, slopes


def method_of(method: Any) -> RKMK:
    """The method, by default RK4. Raises TrajectoryError unless derivatives of its steps are available."""
    if method is not None and not isinstance(method, RKMK):
        raise TrajectoryError(
            f"method must be a tx.RKMK, whose steps have derivatives in closed form, got {method!r}.\n"
            "  fix: use tx.RKMK(tx.tableaus.RK4)"
        )
    return method or RKMK(RK4)


def _differentiated(
    dynamics: Dynamics, method: Method, inputs: Inputs, h: jax.Array, substeps: int, weights: Any
) -> Discretization:
    n, controls = dynamics.dimension, Controls(dynamics.controls)
    multipliers = None
    if weights is not None:
        multiplier_values = real_array("weights", weights)
        if multiplier_values.shape != (n,):
            raise InputError(
                f"weights expects shape ({n},), one number for each tangent of the final state, got "
                f"{multiplier_values.shape}"
            )
        if not is_finite(multiplier_values):
            raise InputError(f"weights expects finite numbers, got {short(multiplier_values)}")
        multipliers = jnp.asarray(multiplier_values, inputs.dtype)
    constant_u = controls.split(controls.join(inputs.u, inputs.dtype))
    x1, slopes, hessian = second_order(
        dynamics, method, dataclasses.replace(inputs, u=constant_u), h, substeps, multipliers
    )
    A, B, by_h, by_t = jnp.split(slopes, [n, n + controls.dimension, n + controls.dimension + 1], axis=1)
    return Discretization(x1, A, B, by_h[:, 0], by_t[:, 0], hessian)


def rollout(
    dynamics: Dynamics,
    method: Method,
    t: jax.Array,
    x: Arrays,
    u: jax.Array,
    h: jax.Array,
    params: Arrays,
    substeps: int,
) -> Rollout:
    """All substeps of an interval with their sensitivities. Arguments are prepared; u is flat."""
    n, m = dynamics.dimension, u.shape[0]
    start = jnp.concatenate([jnp.eye(n, dtype=u.dtype), jnp.zeros((n, m + 2), u.dtype)], axis=1)
    step = h / substeps

    def advance(carry: tuple[jax.Array, Arrays, jax.Array], number: jax.Array) -> tuple[Any, Any]:
        time, state, sensitivity = carry
        state, by_state, by_control, by_length, by_time = step_derivatives(
            dynamics, method, time, state, u, step, params
        )
        # The substep starts at t + number h / substeps and is h / substeps long.
        by_h = (by_length + number * by_time) / substeps
        direct = jnp.concatenate([jnp.zeros((n, n), u.dtype), by_control, by_h[:, None], by_time[:, None]], axis=1)
        carry = (time + step, state, by_state @ sensitivity + direct)
        return carry, carry

    first = (t, x, start)
    _, rest = jax.lax.scan(advance, first, jnp.arange(substeps, dtype=u.dtype))
    return Rollout(*jax.tree.map(lambda a, b: jnp.concatenate([a[None], b]), first, rest))


def step_derivatives(
    dynamics: Dynamics, method: Method, t: jax.Array, x: Arrays, u: jax.Array, h: jax.Array, params: Arrays
) -> tuple[Arrays, jax.Array, jax.Array, jax.Array, jax.Array]:
    """The end of one RKMK step and its derivatives with respect to state, controls, length and time of start."""
    group, controls = dynamics.group, Controls(dynamics.controls)
    n, m = group.dimension, u.shape[0]

    def eta(z: jax.Array) -> jax.Array:
        constant_u = controls.split(z[n : n + m])
        moved = group.retract(x, z[:n])
        field = VectorField(dynamics, lambda _: constant_u, params)
        return group.join(method.increment(field, z[n + m + 1], moved, z[n + m]))

    point = jnp.concatenate([jnp.zeros(n, u.dtype), u, h[None], t[None]])
    value, slopes = value_and_jacobian(eta, point)
    # Ad(Exp(-eta)) = I - J_r(eta) ad_eta, which spares an exponential.
    transported = slopes.at[:, :n].add(-group.ad(value))
    increments = group.right_jacobian(value) @ transported
    by_state = jnp.eye(n, dtype=u.dtype) + increments[:, :n]
    return group.retract(x, value), by_state, increments[:, n : n + m], increments[:, n + m], increments[:, n + m + 1]
