"""An interval with the second derivatives of its end: value, Jacobian and weighted Hessian as one program."""

from __future__ import annotations

import jax
import jax.numpy as jnp

from ..expr import Inputs
from ..integrators import VectorField
from ..integrators.method import Method
from ..scalar.backends import JAX
from ..scalar.jax_primitive import Derived, call_program
from ..system.dynamics import Arrays, Dynamics
from ..system.hessian import REFUSALS, WeightedHessian, hessian_in_arrays
from ..system.jacobian import Differentiated, along

#: What the end is differentiated by: the start, the controls, the length, and the time of the start.
_BY = ("x", "u", "h", "t")


def second_order(
    dynamics: Dynamics, method: Method, inputs: Inputs, h: jax.Array, substeps: int, weights: jax.Array | None
) -> tuple[Arrays, jax.Array, jax.Array | None]:
    """The end of an interval, its Jacobian (n, N), and the Hessian (N, N) of its weighted tangent difference.

    Let z be the tangents of [start, controls, length, start time], x1 = end(0), and e(z) = Log(x1^-1 end(z)). The
    Jacobian is de / dz, and the Hessian the second derivative of weights . e, both at z = 0, in exponential coordinates
    at both ends.

    Args:
        inputs: prepared arguments, with all controls.
        weights: the weights; None omits the Hessian.
    """
    functions = dynamics.functions
    places, arrays = functions.flat(inputs)
    arrays = [*arrays, h]
    names = [state.name for state in dynamics.states]
    plain = Dynamics(functions.run_by(JAX()))
    count = len(arrays)

    def end(*arrays: jax.Array) -> Arrays:
        t, x, u, params = functions.by_kind(places, arrays[:-1])
        field, step = VectorField(plain, lambda _: u, params), arrays[-1] / substeps
        for number in range(substeps):
            x = method.step(field, t + number * step, x, step)
        return x

    def gap(*arrays: jax.Array) -> list[jax.Array]:
        """The tangent difference between the end and a constant base point, and the end."""
        x_end = end(*arrays[:count])
        base = dict(zip(names, arrays[count:], strict=True))
        return [dynamics.group.difference(base, x_end), *(x_end[name] for name in names)]

    def make() -> Derived | None:
        closed = jax.make_jaxpr(gap)(*arrays, *(inputs.x[name] for name in names))
        all_places = [*places, ("h", "h"), *(("end", name) for name in names)]
        try:
            hessian = WeightedHessian(Differentiated(closed, all_places, dynamics.group, _BY), weighted=1)
        except REFUSALS:
            return None
        program = hessian.beside_values({count + k: 1 + k for k in range(len(names))})
        return functions.backend.derived(program)

    key = (functions.backend, method, substeps, places, inputs.dtype)
    derived = None if weights is None else functions.hessians.get(key, make)
    if derived is None:
        sizes, moved = along(dynamics.group, [*places, ("h", "h")], _BY, arrays)
        x_end, zero = end(*arrays), jnp.zeros(sum(sizes.values()), h.dtype)

        def difference(z: jax.Array) -> jax.Array:
            return gap(*moved(z), *(x_end[name] for name in names))[0]

        hessian = None if weights is None else hessian_in_arrays(lambda z: weights @ difference(z), zero)
        return x_end, jax.jacfwd(difference)(zero), hessian
    _, *ends, slopes, matrix = call_program(derived, *arrays, weights)
    return dict(zip(names, ends, strict=True)), slopes, matrix
